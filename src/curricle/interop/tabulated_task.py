"""An environment as tables: the observation of each state, and how the tables were made."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from inspect import signature
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, adopted
from curricle.errors import SettingError, TaskError
from curricle.files import read_saved, write_saved
from curricle.learning.tabular_policy import as_saved
from curricle.pictures.episode import TEXT, frame_of, own_text, with_pictures
from curricle.pictures.scenes import board
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.observation_task import EnvironmentMaker, batch_size
from curricle.tasks.spaces import Component, Space
from curricle.text import brief_repr, counted
from curricle.transfer.mapping import UNMAPPED

Leaf = npt.NDArray[Any]
POSITION = "#"  # begins the name of a part of a tuple, before its position


class Predicts(Protocol):
    """A model that acts, such as one of Stable-Baselines3."""

    def predict(self, observations: Any, *, deterministic: bool) -> Any:
        """Return actions for stacked observations, alone or first in a tuple."""


class Unseen:
    """Stands for an observation that a step did not compute, because it may never be read."""


@dataclass(frozen=True, eq=False)
class ObservationTable(Frozen):
    """The observation of each of S states.

    Parameters
    ----------
    parts : dict of str to (S, ...) arrays
        The arrays of all states, by place in an observation: ``""`` if it is a single array, else
        the keys on the way to it, joined by ``/``; ``#0`` is the first part of a tuple.
    terminal : (S,) bool array
        Which states end an episode; an observation shared with one of them shows the other state.

    Examples
    --------
    >>> table = ObservationTable({"": np.array([[0.0], [1.0], [1.0]])}, np.zeros(3, bool))
    >>> table.state([0.0]), table.state([1.0]), table.ambiguous.tolist()
    (0, -1, [False, True, True])
    """

    parts: Mapping[str, Leaf]
    terminal: BoolArray

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "parts", {name: adopted(a, a.dtype) for name, a in self.parts.items()}
        )
        object.__setattr__(self, "terminal", adopted(self.terminal, np.bool_))

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self.__post_init__()  # arrays in a dict are writable in a copy

    def batch(self, states: IntArray | None = None) -> Any:
        """Return the observations of some states (default: all), stacked; (n, ...) arrays."""
        chosen = {name: a if states is None else a[states] for name, a in self.parts.items()}
        return assembled(chosen)

    def state(self, observation: object) -> int:
        """Return the state that an observation shows; `UNMAPPED` if none or several do."""
        return self._states.get(self._key(parts_of(observation)), UNMAPPED)

    def many(self, observations: object) -> IntArray:
        """Return the states that n stacked observations show, (n,) int64; as :meth:`state`."""
        stacked = parts_of(observations)
        rows = range(batch_size(observations))
        keys = (self._key({name: a[i] for name, a in stacked.items()}) for i in rows)
        return np.array([self._states.get(key, UNMAPPED) for key in keys], dtype=np.int64)

    @cached_property
    def ambiguous(self) -> BoolArray:
        """Which states share their observation, (S,) bool: `state` does not return them."""
        unique = np.zeros(len(self.terminal), dtype=bool)
        unique[[state for state in self._states.values() if state != UNMAPPED]] = True
        return ~unique

    @cached_property
    def _states(self) -> dict[bytes, int]:
        """The state of each observation, `UNMAPPED` where several look the same."""
        states = dict[bytes, int]()
        for ends in (False, True):
            alike = dict[bytes, int]()  # of the states that end an episode, or do not
            for state in np.flatnonzero(self.terminal == ends).tolist():
                key = self._key({name: a[state] for name, a in self.parts.items()})
                alike[key] = UNMAPPED if key in alike else state
            states = alike | states
        return states

    def _key(self, parts: Mapping[str, Any]) -> bytes:
        """Return a key, equal for equal observations; that of another shape equals no other."""
        if parts.keys() != self.parts.keys():
            return b""
        contents = []
        for name, kept in self.parts.items():
            part = np.asarray(parts[name])
            if kept.dtype.kind == "U" or part.dtype.kind == "U":
                contents.append(str(part).encode())
            else:
                same = part.astype(kept.dtype, copy=False)
                contents.append(same.tobytes() if (same == part).all() else b"other")
            contents.append(b"%r" % (part.shape,))
        return b"\0".join(contents)


def stacked_observations(observations: Sequence[Any], terminal: Iterable[bool]) -> ObservationTable:
    """Return the table of the observations of S states; TaskError where they cannot be stacked."""
    of_states = [parts_of(observation) for observation in observations]
    parts = dict[str, Leaf]()
    for name in of_states[0]:
        leaves: list[Any] = [state_parts.get(name) for state_parts in of_states]
        shapes = {np.shape(leaf) for leaf in leaves}
        if len(shapes) > 1 or any(len(state) != len(of_states[0]) for state in of_states):
            raise TaskError(
                f"observations must have one shape to be tabulated: {name or 'they'} came in "
                f"{len(shapes)} shapes"
            )
        parts[name] = np.array(leaves)
        if parts[name].dtype.kind not in "biufU":
            raise TaskError(
                "observations must be numbers or text, or tuples and dicts of these, to be "
                f"tabulated: got {observations[0]!r}"
            )
    return ObservationTable(parts, np.array(list(terminal), dtype=bool))


def parts_of(observation: object) -> dict[str, Any]:
    """Return the arrays, numbers and texts in an observation by their places, as in "sight/#0"."""
    if isinstance(observation, Mapping):
        inner = [(_escaped(key), part) for key, part in observation.items()]
    elif isinstance(observation, tuple):
        inner = [(f"{POSITION}{i}", part) for i, part in enumerate(observation)]
    else:
        return {"": observation}
    return {
        f"{key}/{path}".rstrip("/"): leaf
        for key, part in inner
        for path, leaf in parts_of(part).items()
    }


def _escaped(key: object) -> str:
    """Return a key of a Dict as part of a place, escaped as in JSON pointers."""
    return str(key).replace("~", "~0").replace("/", "~1").replace(POSITION, "~2")


def _unescaped(key: str) -> str:
    return key.replace("~2", POSITION).replace("~1", "/").replace("~0", "~")


def same_observation(first: object, second: object) -> bool:
    """Return whether two observations are equal, part by part; an unseen part equals any other."""
    if isinstance(first, Unseen) or isinstance(second, Unseen):
        return True
    first_parts, second_parts = parts_of(first), parts_of(second)
    return first_parts.keys() == second_parts.keys() and all(
        np.array_equal(part, second_parts[name], equal_nan=np.asarray(part).dtype.kind == "f")
        for name, part in first_parts.items()
    )


def assembled(parts: Mapping[str, Leaf]) -> Any:
    """Return the observation that these parts were taken from."""
    if list(parts) == [""]:
        return parts[""]
    inner = dict[str, dict[str, Leaf]]()
    for name, part in parts.items():
        key, _, path = name.partition("/")
        inner.setdefault(key, {})[path] = part
    if all(key.startswith(POSITION) for key in inner):
        return tuple(assembled(part) for part in inner.values())
    return {_unescaped(key): assembled(part) for key, part in inner.items()}


def way_to(before: IntArray, state: int) -> tuple[int, list[int]]:
    """Return the number of a reset, and the actions that lead from there to a state.

    In `before`, (S, 2), are the state and the action before each, in a first one -1 and the number.
    """
    way = list[int]()
    while before[state, 0] >= 0:
        state, action = before[state].tolist()
        way.append(action)
    return int(before[state, 1]), way[::-1]


@dataclass(frozen=True, eq=False)
class Shown:
    """What an environment shows of each state of its tables, where actions lead; or its board."""

    make: EnvironmentMaker
    act: Callable[[int], Any]
    seeds: Sequence[int]
    before: IntArray | None  # as in `way_to`; None where actions are not sure to lead there
    observations: ObservationTable | None

    def __call__(self, state: int, mode: str) -> Any:
        """Return a state's text or pixels, by a mode of ``render``; None for neither."""
        table, shown = {} if self.observations is None else self.observations.parts, None
        parts = {name: part[state] for name, part in table.items()}
        with suppress(Exception):  # of the user's class: numbers name a state as well
            shown = self._rendered(state, mode, parts)
        return board(parts.get("", 0), mode) if shown is None else shown

    @cached_property
    def _modes(self) -> Sequence[str]:
        with closing(self.make()) as env:
            return env.metadata.get("render_modes", ())  # type: ignore[no-any-return]

    def _rendered(self, state: int, mode: str, parts: Mapping[str, Leaf]) -> Any:
        if self.before is None:
            return None
        make = with_pictures(self.make, mode) if mode in self._modes else self.make
        with closing(make()) as env:
            reset, way = way_to(self.before, state)
            observed, _ = env.reset(seed=self.seeds[reset])
            for action in way:
                observed, *_ = env.step(self.act(action))
            if parts and not same_observation(parts, parts_of(observed)):
                return None
            return own_text(env) if mode == TEXT else frame_of(env)


BATCH = 4096  # observations that a model is asked about at once
SPACES = ("states", "actions")
TABLES = ("outcome_row", "probability", "next_state", "reward", "terminal", "start")
OBSERVED = "observed "  # begins the names of arrays of observations in a file
POINTS = "points"


@dataclass(frozen=True)
class TabulationRecord:
    """How tables were made.

    Attributes
    ----------
    environment, seeds
        Name of the environment; seeds of the resets, which are equally likely starts.
    samples : int or None
        Steps by which each pair's outcomes were estimated; None if outcomes are exact.
    transitions, drawing, checked : int
        Pairs of a state and an action that were tried or listed; those that drew random numbers but
        led to a single state in all 8 repetitions; steps of episodes that agree with the tables.
    cut, explored : int
        States in which episodes are only ever truncated: every action stays there, with reward 0;
        and states before equivalent states were merged.
    seconds : float
        Wall-clock time of the search.
    note : str
        How the tables differ from the environment, such as in rewards.
    several : bool
        Whether resets with other seeds, of which 8 are tried, start in other states or levels.
    """

    environment: str
    seeds: tuple[int, ...]
    samples: int | None
    transitions: int
    drawing: int = 0
    checked: int = 0
    cut: int = 0
    explored: int = 0
    seconds: float = 0.0
    note: str = ""
    several: bool = False

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class TabulatedTask(Frozen):
    """A Gymnasium environment as tables of all states that can be reached (:func:`tabulate`).

    It is a :class:`Task`; mappings read its components by name.

    Attributes
    ----------
    mdp : FiniteMDP
        The tables, of S states and A actions.
    observations : ObservationTable or None
        None where listed outcomes are those of saved states, not of observations.
    record : TabulationRecord
        How the tables were made.

    Examples
    --------
    >>> import curricle as cr
    >>> lake = cr.tabulate("FrozenLake-v1", discount=0.99)
    >>> lake
    TabulatedTask(FrozenLake-v1: 16 states, 4 actions, 5 terminal, discount 0.99, ..., exact)
    >>> lake.state(6), lake.states.label(lake.state(6))
    (8, 'row=1 column=2')
    """

    mdp: FiniteMDP
    observations: ObservationTable | None
    record: TabulationRecord

    @property
    def states(self) -> Space:
        """The states, S points."""
        return self.mdp.states

    @property
    def actions(self) -> Space:
        """The actions, A points."""
        return self.mdp.actions

    @property
    def exact(self) -> bool:
        """Whether outcomes are the environment's own, not estimates."""
        return self.record.samples is None

    def start_from(self, start: FloatArray) -> Self:
        """Return the task with these probabilities of starting, (S,), for :func:`with_start`."""
        return replace(self, mdp=replace(self.mdp, start=start))

    def state(self, observation: object) -> int:
        """Return the state that an observation shows; `UNMAPPED` if none does, or several do."""
        return self._observations().state(observation)

    def many(self, observations: object) -> IntArray:
        """Return the states that n stacked observations show, (n,) int64; as :meth:`state`."""
        return self._observations().many(observations)

    def policy(self, model: "Predicts", *, deterministic: bool = True) -> IntArray | FloatArray:
        """Return the action of a model in each state, or the probability of each action.

        Parameters
        ----------
        model : object
            With a method ``predict(observations, deterministic=...)`` that returns actions for
            stacked observations, alone or first in a tuple; SettingError if it does not.
        deterministic : bool
            If False, return probabilities of actions; for policies with a distribution (A2C, PPO).

        Returns
        -------
        (S,) int64 or (S, A) float64 array
        """
        check_sight(model)
        if any(part.low for part in self.actions.components):
            raise SettingError(
                f"a model's actions must count from 0: those of {self.record.environment} do not; "
                "gymnasium.wrappers.TransformAction makes them, before it is tabulated"
            )
        table, n_states, answers = self._observations(), self.states.size, []
        for first in range(0, n_states, BATCH):
            n = min(BATCH, n_states - first)
            observations = table.batch(np.arange(first, first + n))
            if not deterministic:
                answers.append(action_probabilities(model, observations))
                continue
            predicted = model.predict(observations, deterministic=True)
            actions = np.asarray(predicted[0] if isinstance(predicted, tuple) else predicted)
            if actions.shape != (n,) or actions.dtype.kind not in "iu":
                raise SettingError(
                    f"a model must predict one action for each of {n} observations: got an array "
                    f"of {actions.dtype} of shape {actions.shape}"
                )
            answers.append(actions.astype(np.int64))
        chosen = np.concatenate(answers)
        low, high = chosen.min(), chosen.max()
        if deterministic and (low < 0 or high >= self.actions.size):
            raise SettingError(
                f"a model's actions must lie in 0..{self.actions.size - 1}: got {low}..{high}"
            )
        return chosen

    def save(self, path: str | Path) -> Path:
        """Write the tables into an ``.npz`` file and return its path; StoreError if it cannot."""
        arrays = {name: getattr(self.mdp, name) for name in TABLES}
        if self.mdp.available is not None:
            arrays["available"] = self.mdp.available
        about: dict[str, Any] = {"record": asdict(self.record)}
        about |= {name: getattr(self.mdp, name) for name in ("discount", "time_limit")}
        for name in SPACES:
            space: Space = getattr(self.mdp, name)
            about[name] = [asdict(component) for component in space.components]
            if space.points is not None:
                arrays[f"{name} {POINTS}"] = space.points
        about["observed"] = self.observations is not None
        if self.observations is not None:
            arrays |= {OBSERVED + name: part for name, part in self.observations.parts.items()}
        return write_saved(path, type(self).__name__, arrays, about)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the task in a file that :meth:`save` wrote; StoreError if it is damaged.

        Examples
        --------
        >>> from tempfile import mkdtemp
        >>> import curricle as cr
        >>> lake = cr.tabulate("FrozenLake-v1", discount=0.99)
        >>> TabulatedTask.load(lake.save(f"{mkdtemp()}/lake")).states == lake.states
        True
        """
        saved = read_saved(path, cls.__name__)
        arrays, about = saved.arrays, saved.about
        with as_saved(saved):
            states, actions = (
                Space([Component(**c) for c in about[name]], arrays.get(f"{name} {POINTS}"))
                for name in SPACES
            )
            fields: dict[str, Any] = {name: arrays[name] for name in TABLES}
            fields |= {name: about[name] for name in ("discount", "time_limit")}
            fields["available"] = arrays.get("available")
            mdp = FiniteMDP(states, actions, **fields)
            parts = {
                name.removeprefix(OBSERVED): part
                for name, part in arrays.items()
                if name.startswith(OBSERVED)
            }
            observations = ObservationTable(parts, mdp.terminal) if about["observed"] else None
            seeds = {"seeds": tuple(about["record"]["seeds"])}
            record = TabulationRecord(**{**about["record"], **seeds})
        return cls(mdp, observations, record)

    def _observations(self) -> ObservationTable:
        if self.observations is None:
            raise TaskError(
                "observations can be looked up only where tables have them: the listed outcomes of "
                f"{self.record.environment} are of saved states"
            )
        return self.observations

    def __repr__(self) -> str:
        record, kinds = self.record, list[str]()
        size = repr(self.mdp).removeprefix("FiniteMDP(").removesuffix(")")
        if record.samples is not None:
            kinds.append(f"estimated from {counted(record.samples, 'step')} a pair")
        if record.several:
            kinds.append(f"{len(record.seeds)} of several resets seen")
        kind = ", ".join(kinds or ["exact"])
        if record.drawing:
            kind += f" unless {record.drawing:,} pairs that draw random numbers rarely use them"
        note = f", {record.note}" if record.note else ""
        return f"TabulatedTask({record.environment}: {size}{note}, {kind})"


def needs_of(policy: object) -> str:
    """Return what a network's policy needs besides observations, "" for nothing."""
    if hasattr(policy, "predict") and "action_masks" in signature(policy.predict).parameters:
        return "masks of actions"
    return "memory" if hasattr(policy, "lstm_actor") else ""


def check_sight(model: object) -> None:
    """Raise SettingError unless a model acts by the observation alone."""
    policy = getattr(model, "policy", model)
    if needs := needs_of(policy):
        raise SettingError(
            f"a policy must act by the observation alone: {type(policy).__name__} needs {needs}, "
            "which learn_deep and TrainedPolicy.episode give it"
        )


def action_probabilities(model: object, observations: object) -> FloatArray:
    """Return the probability of each action under the policy of a model, (n, A)."""
    try:
        policy: Any = model.policy  # type: ignore[attr-defined]
        tensor, _ = policy.obs_to_tensor(observations)
        tensors = policy.get_distribution(tensor).distribution.probs
    except AttributeError as error:
        raise SettingError(
            "a policy that is not deterministic must have a distribution over numbered actions, as "
            f"those of A2C and PPO have: a {type(model).__name__} has none ({error})"
        ) from error
    p = tensors.detach().cpu().numpy().astype(np.float64)
    return np.asarray(p / p.sum(axis=1, keepdims=True))
