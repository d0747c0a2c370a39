"""Gymnasium, both ways: any environment as a task, and Curricle's tasks as environments."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from copy import deepcopy
from dataclasses import replace
from difflib import get_close_matches
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from operator import index
from typing import TYPE_CHECKING, Any, Literal, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec, registry
from gymnasium.envs.toy_text.blackjack import BlackjackEnv
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.spaces import Discrete
from gymnasium.wrappers import TimeLimit as StepLimit

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import brief, one_of, text, whole_number
from curricle.errors import CurricleError, SettingError, TaskError
from curricle.interop.discrete import (
    Coding,
    Form,
    Number,
    Point,
    counts_from_0,
    is_discrete,
    space_of,
)
from curricle.interop.encoders import Bins
from curricle.interop.search import time_limit_of
from curricle.interop.states import HARMLESS, TOY_CONSTANTS, TOY_TEXT, acts_as, fingerprint
from curricle.tasks.grid import cell_space
from curricle.tasks.gridworld import GridWorld, Rewards
from curricle.tasks.kernel import compiled, draw
from curricle.tasks.live import OLD_GYM, LiveMDP, is_live
from curricle.tasks.mdp import FiniteMDP, Task, available_actions, generative_model
from curricle.tasks.models import check_answers, first_state, has_users_code, transition
from curricle.tasks.observation_task import (
    EnvironmentMaker,
    ObservationTask,
    check_spaces,
    layers_of,
)
from curricle.tasks.pursuit import LARGEST_SPACE, Pursuit
from curricle.tasks.spaces import MISSING, Component, Space
from curricle.tasks.toy_text import CliffWalking, FrozenLake, Taxi

if TYPE_CHECKING:
    from curricle.pictures.scenes import Scene

Environment = gym.Env[Any, Any] | str | EnvSpec | EnvironmentMaker | Callable[..., Any]
TimeLimit = int | None | Literal["own"]
TableRows = Sequence[Sequence[Sequence[tuple[float, int, float, bool]]]]
"""[state][action] -> (probability, next state, reward, terminated) of each outcome."""


class TableWorld(Protocol):
    """What is read of a toy-text environment with a transition table."""

    P: TableRows
    observation_space: Discrete[np.int64]
    action_space: Discrete[np.int64]
    initial_state_distrib: FloatArray


def from_gymnasium(
    environment: Environment,
    *,
    discount: float,
    time_limit: TimeLimit = "own",
    names: Sequence[str] | None = None,
    sizes: Sequence[int] | None = None,
    states: Space | None = None,
    actions: Space | Sequence[str] | None = None,
    encode: Callable[[Any], Any] | None = None,
    live: bool = False,
    action_masks: bool = False,
    **make_arguments: object,
) -> FiniteMDP | LiveMDP:
    """Return a Gymnasium environment of discrete spaces as a task: by its table, or live.

    A transition table (``env.unwrapped.P``: FrozenLake, CliffWalking, Taxi) is copied into a
    :class:`FiniteMDP`. Every other environment, a subclass or wrapper with its own `step` too, is a
    :class:`LiveMDP`: learning calls ``env.step``.

    Parameters
    ----------
    environment : str, gymnasium.EnvSpec, gymnasium.Env or callable
        An id, a specification, an environment (whose specification makes another for each seed),
        or a class or function that makes one.
    discount : float
    time_limit : int, None or "own"
        Steps after which episodes are truncated; the environment's own by default.
    names : sequence of str, optional
        Names of a state's components, in the order of the numbers in an observation.
    sizes : sequence of int, optional
        Number of values of each component, where an observation is a single number in which the
        last component counts fastest: row * columns + column.
    states : Space, optional
        The states that `encode` returns, needed where it has no attribute ``states``. Without
        `encode`, other names and labels for the observations, in their order.
    actions : sequence of str or Space, optional
        A label for each action, or other names for the actions, in their order. Actions called
        north, east, south and west, or up, right, down and left, are drawn as arrows.
    encode : callable, optional
        Returns the number of the state that an observation shows, or the tuple of its components'
        values, such as :class:`Bins`.
    live : bool
        Whether to use ``env.step`` even if there is a table.
    action_masks : bool
        Whether only available actions are taken: ``info["action_mask"]``, as Taxi has it, or the
        method ``action_masks()`` of sb3-contrib flags them. By default every action can be taken.
    **make_arguments
        Arguments of ``gymnasium.make``, or of the class or function.

    Returns
    -------
    FiniteMDP or LiveMDP
        Gymnasium's toy-text environments have named components and labelled actions. Others have
        components `state` and `action`, numbered if there are several, or the keys of a ``Dict``.

    Raises
    ------
    TaskError
        When ``gymnasium.make`` fails, a space is not discrete and there is no `encode`, names do
        not fit, or an environment cannot be made again, such as after a change of its `step`.

    Examples
    --------
    >>> lake = from_gymnasium("FrozenLake-v1", discount=0.99)
    >>> lake
    FiniteMDP(16 states, 4 actions, 5 terminal, discount 0.99, time limit 100)
    >>> lake.states.label(6), lake.actions.label(1)
    ('row=1 column=2', 'move=south')
    >>> car = Bins({"position": [-1.2, -0.5, 0.6], "velocity": [-0.07, 0, 0.07]})
    >>> from_gymnasium("MountainCar-v0", encode=car, discount=0.99)
    LiveMDP(4 states, 3 actions, discount 0.99, time limit 200)
    """
    if names is None and sizes is not None:
        raise TaskError(
            f"sizes need the names of their components: got sizes {sizes!r} without names"
        )
    if names is not None and states is not None:
        raise TaskError(
            f"names must be left out with states, which name the components: got names {names!r}"
        )
    names = None if names is None else name_list(names)
    make = maker_of(environment, time_limit, make_arguments)
    with opened(environment, make) as env:
        world: Any = env.unwrapped
        stated = getattr(env.spec, "max_episode_steps", None)
        limit: Any = time_limit_of(env, stated) if time_limit == "own" else time_limit
        named, moves = names_of(env)
        act, actions = actions_of(env.action_space, actions, moves)
        number = encode
        outcomes = outcomes_of(world) if encode is None and not live and has_table(env) else None
        if outcomes is not None and action_masks:
            outcomes = outcomes_available(world, outcomes)
        if outcomes is not None:
            space = Space([Component("state", len(outcomes))])
        else:
            if make.recipe is None:
                raise TaskError(
                    "an environment without a specification cannot be made again for each seed; "
                    f"give a function that makes it: got {environment}"
                )
            if isinstance(environment, gym.Env):
                _check_unchanged(env, make)
            number, space = _observations(env.observation_space, encode, states)
        if encode is None and named is not None and named.size == space.size:
            space = named
        states = with_space("states", space, states)
        if names is not None:
            if sizes is None and len(space.names) == 1 < len(names):
                raise TaskError(
                    f"observations are one number, so sizes must say how many values each of "
                    f"{', '.join(names)} has: got names without sizes"
                )
            states = with_names(space, names, sizes)
        if outcomes is None:
            return LiveMDP(states, actions, make, number, act, discount, limit, action_masks)
        start = np.zeros(len(outcomes))  # the end that `outcomes_of` may add is no start
        start[: len(world.initial_state_distrib)] = world.initial_state_distrib
        table: dict[str, Any] = {"start": start, "states": states, "actions": actions}
        return FiniteMDP.from_outcomes(outcomes, **table, discount=discount, time_limit=limit)


def _observations(
    space: gym.Space[Any], encode: Callable[[Any], Any] | None, states: Space | None
) -> tuple[Callable[[Any], Any] | None, Space]:
    """Return the function from observations to states, None if they are states; and the space."""
    if encode is None:
        if not is_discrete(space):
            raise TaskError(
                "observations must be discrete, fewer than 2^63, or be made so by encode=Bins(...) "
                "or a function of your own with states=Space(...); tabulate finds the states where "
                f"they are few, and observation_task makes a network's task: got {brief(space)}"
            )
        return None if counts_from_0(space) else Number(space), space_of(space, "state")
    encoded = getattr(encode, "states", None) if states is None else states
    if encoded is None:
        raise TaskError(
            "an encode function needs the states it encodes to, as states=Space(...) or as its "
            f"attribute states: got neither for {encode!r}"
        )
    if isinstance(encode, Bins) and space.shape != (len(encode.edges),):
        raise TaskError(
            f"bins must have edges for each entry of an observation, {space.shape}: they have "
            f"edges for {len(encode.edges)}"
        )
    return encode, encoded


def actions_of(
    space: gym.Space[Any], actions: Space | Sequence[str] | None, moves: Space | None
) -> tuple[Callable[[int], Any], Space]:
    """Return the function from an action's number to the environment's action, and the space."""
    if not is_discrete(space):
        raise TaskError(
            "actions must be discrete (gymnasium.wrappers.DiscretizeAction makes them so), fewer "
            f"than 2^63: got {space}"
        )
    act = index if counts_from_0(space) else Point(space)
    named = space_of(space, "action")
    if moves is not None and moves.size == named.size:
        named = moves
    if actions is None or isinstance(actions, Space):
        return act, with_space("actions", named, actions)
    if len(named.components) > 1:
        raise TaskError(
            "actions of several components must be named by a Space, not by labels: these have "
            f"{', '.join(named.names)}"
        )
    if isinstance(actions, str) or len(actions) != named.size:
        raise TaskError(f"actions must hold {named.size} labels in order: got {actions!r}")
    return act, Space([replace(named.components[0], labels=tuple(actions))])


def _check_unchanged(env: gym.Env[Any, Any], make: EnvironmentMaker) -> None:
    """Raise TaskError if an environment was changed so that its specification makes another."""
    changed = any({"step", "reset"} & vars(layer).keys() for layer in layers_of(env))
    if not changed and acts_as(env.unwrapped, *TOY_TEXT):
        with refusals_of_make(make), closing(make()) as new:
            tables = [[vars(e.unwrapped).get(name) for name in TOY_CONSTANTS] for e in (env, new)]
        changed = fingerprint(tables[0]) != fingerprint(tables[1])
    if changed:
        raise TaskError(
            "an environment whose step, reset or table was changed cannot be made again for each "
            f"seed; give a function that makes it so: got {env}"
        )


def opened(environment: Environment, make: EnvironmentMaker) -> AbstractContextManager[Any]:
    """Return a context with the caller's environment, or a new environment that it closes."""
    if isinstance(environment, gym.Env):
        return nullcontext(environment)
    with refusals_of_make(environment):
        made: Any = make()
    if not isinstance(made, gym.Env):
        old = any(kind.__module__.partition(".")[0] == "gym" for kind in type(made).__mro__)
        raise TaskError(
            f"an environment must be a gymnasium.Env: {environment!r} made {made!r}"
            f"{f'; {OLD_GYM}' * old}"
        )
    check_spaces(made)
    return closing(made)


@contextmanager
def refusals_of_make(source: object) -> Iterator[None]:
    """Raise TaskError for whatever ``gymnasium.make`` raises; errors of a function stay as is."""
    try:
        yield
    except CurricleError:
        raise
    except Exception as error:
        source = source.recipe if isinstance(source, EnvironmentMaker) else source
        if not isinstance(source, str | EnvSpec):
            raise
        name = source if isinstance(source, str) else source.id
        meant = suggested_ids(name)  # instead of Gymnasium's, without versions and modules
        said = str(error).partition(" Did you mean")[0].rstrip(".") if meant else str(error)
        if "required positional argument" in said:
            meant = "; arguments of its class are passed by name, argument=..."
        raise TaskError(
            f"an environment must be one that gymnasium.make makes: {name!r} failed with "
            f"{type(error).__name__}: {said}{meant}"
        ) from error


SUGGESTED = 3  # ids that a message about an unknown id names


def suggested_ids(name: str) -> str:
    """Return ``, did you mean ID?`` with similar ids of the registry, or the extra that has it.

    MiniGrid's are registered if it is installed, and have its module, as other processes find them.
    """
    if name in registry or name.partition(":")[2] in registry:
        return ""
    if find_spec("minigrid"):
        import_module("minigrid")
    elif name.startswith(("MiniGrid-", "BabyAI-", "minigrid:")):
        return ': pip install "curricle[minigrid]" adds environments of MiniGrid'
    ids = {entry.lower(): entry for entry in registry}
    written = name.lower()
    near = [entry for entry in ids if written in entry]
    near = near or get_close_matches(written, ids, SUGGESTED, 0.6)
    shown = [
        "minigrid:" * str(registry[entry].entry_point).startswith("minigrid") + entry
        for entry in map(ids.__getitem__, near[:SUGGESTED])
    ]
    return f", did you mean {' or '.join(shown)}?" if shown else ""


def maker_of(
    environment: Environment, time_limit: TimeLimit, arguments: dict[str, object]
) -> EnvironmentMaker:
    """Return the maker of environments; it makes None where an environment has no specification."""
    arguments = deepcopy(arguments)
    if isinstance(environment, EnvironmentMaker) and environment.encode is None:
        arguments = {**deepcopy(dict(environment.arguments)), **arguments}
        environment = environment.recipe
    if isinstance(environment, gym.Env) and arguments:
        raise TaskError(
            f"an environment that is already made takes no arguments: got {', '.join(arguments)}"
        )
    source = environment.spec if isinstance(environment, gym.Env) else environment
    if not (isinstance(environment, gym.Env | str | EnvSpec) or callable(source)):
        raise TaskError(
            "an environment must be an id, a specification, a gymnasium.Env, or a class or "
            f"function that makes one: got {source!r}"
        )
    if time_limit != "own" and time_limit is not None:
        time_limit = whole_number("time_limit in steps", time_limit, 1, TaskError)
    if time_limit != "own" and isinstance(source, str | EnvSpec):
        arguments["max_episode_steps"] = -1 if time_limit is None else time_limit
    return EnvironmentMaker(source, arguments)


def observation_task(
    environment: str | Callable[..., gym.Env[Any, Any]],
    *,
    discount: float = 0.99,
    time_limit: int | None = None,
    encode: Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]] | None = None,
    compiled_view: bool = True,
    **make_arguments: object,
) -> ObservationTask:
    """Return a Gymnasium environment as a task for deep learners, which see its observations.

    Parameters
    ----------
    environment : str or callable
        An id, or a class or function that makes an environment.
    discount : float
        gamma, which environments do not state.
    time_limit : int, optional
        Steps after which episodes are truncated, at most the environment's own, the default.
    encode : callable, optional
        Returns an environment with other observations: an encoder such as :class:`MiniGridView`, a
        wrapper's class such as ``gymnasium.wrappers.FlattenObservation``, or a function.
    compiled_view : bool
        Whether compiled code makes the observations of MiniGrid's environments. They are the same
        as by MiniGrid's own code, which an environment with methods of its own keeps.
    **make_arguments
        Arguments of ``gymnasium.make``, or of the class or function.

    Raises
    ------
    TaskError
        When ``gymnasium.make`` or the encoder fails, or does not return an environment.

    Examples
    --------
    >>> observation_task("CartPole-v1", discount=0.98)
    ObservationTask(CartPole-v1, discount 0.98, Box(4,) -> Discrete(2))
    """
    make: Callable[[], gym.Env[Any, Any]] = environment  # type: ignore[assignment]
    if isinstance(environment, str) or make_arguments or encode is not None:
        make = EnvironmentMaker(environment, make_arguments, encode)
    with refusals_of_make(make):
        return ObservationTask(make, discount, time_limit, compiled_view=compiled_view)


# -- names that a caller gives ---------------------------------------------------------------------


def name_list(names: Sequence[str]) -> tuple[str, ...]:
    """Return names of a state's components; TaskError where they are no list of different texts."""
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise TaskError(f"names of a state's components must be a list of text: got {names!r}")
    for name in names:
        text("one of the names of a state's components", name, TaskError)
    if len(set(names)) < len(names):
        raise TaskError(f"names of a state's components must differ: got {', '.join(names)}")
    return tuple(names)


def with_space(points: str, space: Space, other: Space | None) -> Space:
    """Return `other`, a space with as many points, in place of a space; by default the space."""
    if other is not None and other.size != space.size:
        raise TaskError(
            f"{points} must name all {space.size} of the environment's: got {other.size}"
        )
    return space if other is None else other


def with_names(space: Space, names: Sequence[str], sizes: object = None) -> Space:
    """Return a space of states with other names; `sizes`, of each name, split a single number."""
    components = ", ".join(space.names)
    if sizes is None and len(names) == len(space.names):
        pairs = zip(space.components, names, strict=True)
        return Space([replace(c, name=name) for c, name in pairs], space.points)
    if sizes is None:
        raise TaskError(
            "names must have a name for each component of a state, in the order of "
            f"{components}: got {len(names)}, {', '.join(names) or 'none'}"
        )
    if isinstance(sizes, str) or not isinstance(sizes, Sequence):
        raise TaskError(f"sizes must be a list of whole numbers: got {sizes!r}")
    if len(space.components) > 1:
        raise TaskError(f"sizes are for observations that are one number: these have {components}")
    if len(sizes) != len(names):
        raise TaskError(
            f"sizes must have a number for each name, {', '.join(names)}: got {list(sizes)}"
        )
    split, (number,) = Space([*map(Component, names, sizes)]), space.components
    numbered = number.labels is None and not number.arbitrary and number.low >= 0
    fits = split.size == space.size if space.is_box else numbered and number.high < split.size
    if not fits:
        raise TaskError(
            f"the product of sizes must be the environment's {space.size:,} states: "
            f"{' x '.join(map(str, sizes))} is {split.size:,}"
        )
    if space.is_box:
        return split
    # Tables may lack states, the last ones too, and hold them in the order of the search.
    points = np.stack(np.unravel_index(space.points[:, 0], split.shape), axis=1)
    return Space(split.components, points)


# -- Gymnasium's toy-text environments -------------------------------------------------------------


def has_table(env: gym.Env[Any, Any]) -> bool:
    """Return whether an environment has a transition table that describes it completely."""
    *wrappers, env = layers_of(env)
    for layer in wrappers:
        if not acts_as(layer, *HARMLESS) or (isinstance(layer, StepLimit) and layer.spec is None):
            return False
    states, actions, table = env.observation_space, env.action_space, getattr(env, "P", None)
    numbered = acts_as(env, *TOY_TEXT) and counts_from_0(states) and counts_from_0(actions)
    # A fickle passenger's taxi has moves that are not in its table.
    if not numbered or getattr(env, "fickle_passenger", False):
        return False
    try:
        pairs: Any = [table[s][a] for s in range(int(states.n)) for a in range(int(actions.n))]  # type: ignore[index,attr-defined]
        lists_outcomes = all(len(outcome) == 4 for pair in pairs for outcome in pair)
        return lists_outcomes and len(table) == states.n  # type: ignore[arg-type,attr-defined]
    except (TypeError, KeyError, IndexError):
        return False


def outcomes_of(world: TableWorld) -> TableRows:
    """Return a table's outcomes, in which entering a state ends the episode always or never."""
    n_states, n_actions = int(world.observation_space.n), int(world.action_space.n)
    outcomes = [
        [[(p, int(after), r, bool(ended)) for p, after, r, ended in world.P[s][a]]
         for a in range(n_actions)]
        for s in range(n_states)
    ]  # fmt: skip
    # Where an episode ends only sometimes, those ends go to one more state, the last.
    continuing = set(np.flatnonzero(world.initial_state_distrib).tolist())
    queue, ends = list(continuing), set[int]()
    while queue:
        for pair in outcomes[queue.pop()]:
            for probability, after, _, ended in pair:
                if ended and probability > 0:
                    ends.add(after)
                elif probability > 0 and after not in continuing:
                    continuing.add(after)
                    queue.append(after)
    both = continuing & ends  # the states in which an episode may end or go on
    if not both:
        return outcomes
    apart = [
        [[(p, n_states if ended and after in both else after, r, ended)
          for p, after, r, ended in pair]
         for pair in pairs]
        for pairs in outcomes
    ]  # fmt: skip
    return [*apart, [[] for _ in range(n_actions)]]


def outcomes_available(world: TableWorld, outcomes: TableRows) -> TableRows:
    """Return a table's outcomes, [state][action], none for the actions that a world masks."""
    mask_of = getattr(world, "action_mask", None)
    if not callable(mask_of):
        raise TaskError(
            "action_masks of a table needs a method action_mask(state), as Taxi has it: "
            f"{world} has none; live=True takes the masks of its steps"
        )
    rows = [[outcomes[s][a] for a in range(len(outcomes[s]))] for s in range(len(outcomes))]
    return [
        [pair if allowed else [] for pair, allowed in zip(row, mask_of(s), strict=True)]
        if any(row)  # else it is the end that `outcomes_of` adds
        else row
        for s, row in enumerate(rows)
    ]


def names_of(env: gym.Env[Any, Any]) -> tuple[Space | None, Space | None]:
    """Return named state and action spaces of a known environment, None for others."""
    *wrappers, world = layers_of(env)
    if not all(acts_as(wrapper, *HARMLESS, gym.RewardWrapper) for wrapper in wrappers):
        return None, None  # observations and actions may mean something else
    # Named as the library's own domains are, so that mappings by name work between the two.
    labels: Sequence[str]
    if isinstance(world, FrozenLakeEnv):
        states, labels = cell_space(*np.asarray(world.desc).shape), FrozenLake.ACTIONS
    elif isinstance(world, CliffWalkingEnv):
        states, labels = cell_space(*world.shape), CliffWalking.ACTIONS
    elif isinstance(world, TaxiEnv):
        states, labels = Taxi().states, Taxi.ACTIONS
    elif isinstance(world, BlackjackEnv):
        ace = Component("ace", 2, labels=("none", "usable"))
        states = Space([Component("player", 32), Component("dealer", 11), ace])
        labels = "stick", "hit"
    else:
        return None, None
    # A subclass with a step of its own may go anywhere, so that its actions have no labels.
    standard = acts_as(world, *TOY_TEXT, methods=["step"])
    return states, Space(
        [Component("move", len(labels), labels=tuple(labels) if standard else None)]
    )


# -- tasks as environments -------------------------------------------------------------------------

RenderMode = Literal["rgb_array", "ansi"]
FORMS = frozenset({"observation", "action", "render_mode"})  # settings that are not the task's
FIRST_MAZE = """
    .....P.T
    .#P#....
    ..F#.#P.
    S.......
"""
"""The map of ``Curricle/Maze-v0``: the short way passes a fire, a safe way takes two moves more."""


Stream = npt.NDArray[np.uint64]  # (1,): the state of a random stream


def _begun(model: tuple[object, ...], stream: Stream) -> int:
    return first_state(model, draw(stream))  # type: ignore[no-any-return]


def _moved(
    model: tuple[object, ...], state: int, action: int, stream: Stream
) -> tuple[int, float, bool]:
    bits, pair = draw(stream), (np.uint64(state), np.uint64(action))
    return transition(model, *pair, bits)  # type: ignore[no-any-return]


class TaskEnvironment(gym.Env[Any, Any]):
    """A task as a Gymnasium environment; made by :func:`to_gymnasium`."""

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array", "ansi"],
        "render_fps": 4,
    }

    def __init__(
        self,
        task: Task,
        *,
        observation: Form = "index",
        action: Form = "index",
        render_mode: RenderMode | None = None,
    ):
        self.task, self.render_mode = task, render_mode
        rules = generative_model(task)
        if is_live(task):
            raise TaskError(f"a live task is an environment already: got {task!r}")
        one_of("observation", observation, ("index", "components"), SettingError)
        one_of("action", action, ("index", "components"), SettingError)
        if render_mode is not None:
            one_of("render_mode", render_mode, self.metadata["render_modes"], SettingError)
        if action == "components" and not rules.actions.is_box:
            raise SettingError(
                f"actions by component need every combination to be an action: got {rules.actions}"
            )
        self._states = Coding(rules.states, observation)
        self._actions = Coding(rules.actions, action)
        self.observation_space, self.action_space = self._states.gym_space, self._actions.gym_space
        self._rules, self._model = rules, rules.model
        self._restricted = getattr(self._model, "available", None) is not None
        self._users_code = has_users_code(self._model)
        self._begun = compiled(_begun, self._users_code)
        self._moved = compiled(_moved, self._users_code)
        self._stream = np.zeros(1, np.uint64)
        self._state, self._steps, self._under_way = MISSING, 0, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int | IntArray, dict[str, Any]]:
        """Begin an episode, in ``options["state"]`` if given; return observation and info."""
        super().reset(seed=seed)
        # One draw an episode starts the random stream of the task's transitions.
        self._stream[0] = self.np_random.integers(2**64, dtype=np.uint64)
        if options:
            self._state = self._named_start(options)
        else:
            self._state = self._begun(self._model, self._stream)
            self._check()
        self._steps, self._under_way = 0, True
        return self._states.coded(self._state), self._info()

    def step(self, action: object) -> tuple[int | IntArray, float, bool, bool, dict[str, Any]]:
        """Act; return observation, reward, terminated, truncated and info."""
        if not self._under_way:
            raise SettingError("step() needs an episode under way: call reset() first")
        move = self._actions.number(action)
        if self._restricted and not self.action_masks()[move]:
            raise SettingError(
                f"an action must be available: {self._rules.actions.label(move)} is not in "
                f'{self._rules.states.label(self.state)}; info["action_mask"] has those that are'
            )
        self._state, reward, terminated = self._moved(self._model, self._state, move, self._stream)
        self._check()
        self._steps += 1
        truncated = not terminated and self._steps == self._rules.time_limit
        self._under_way = not (terminated or truncated)
        return self._states.coded(self._state), reward, terminated, truncated, self._info()

    def render(self) -> npt.NDArray[np.uint8] | str | None:
        """Return a picture of the state, (height, width, 3) uint8, or text, by `render_mode`."""
        if self.render_mode is None:
            gym.logger.warn("render() draws nothing without a render_mode: rgb_array or ansi")
            return None
        draws = self._scene.image if self.render_mode == "rgb_array" else self._scene.text
        return draws(self.state)

    @property
    def state(self) -> int:
        """The number of the state the task is in."""
        if self._state == MISSING:
            raise SettingError("there is no state before the first reset()")
        return self._state

    @cached_property
    def _scene(self) -> "Scene":
        from curricle.pictures.scenes import scene_of

        return scene_of(self.task)

    def _check(self) -> None:
        """Raise TaskError if a function of the task returned an invalid value."""
        if self._users_code and self._model.failure["by"][0]:
            self._under_way, model, self._model = False, self._model, self._rules.model
            task: Any = self.task
            check_answers(task, model)

    def action_masks(self) -> BoolArray:
        """Return which actions are available in the state, (A,) bool, as sb3-contrib asks it."""
        rows = available_actions(self._rules, np.array([self.state])) if self._restricted else None
        return np.ones(self._rules.actions.size, np.bool_) if rows is None else rows[0]

    def _info(self) -> dict[str, Any]:
        info = {"state": self._state, "label": self._rules.states.label(self._state)}
        if self._restricted:
            info["action_mask"] = self.action_masks().astype(np.int8)
        return info

    def _named_start(self, options: dict[str, Any]) -> int:
        if set(options) != {"state"}:
            raise SettingError(f"options may hold only 'state', to start in: got {options!r}")
        start, space = options["state"], self._rules.states
        if isinstance(start, Mapping):
            values = {name: space.component(name).value(start[name]) for name in start}
            state = int(space.encode(**values))
        else:
            state = whole_number("the state to start in", start, 0, SettingError)
        # Of too many states the terminal ones are not listed.
        terminal = self._rules.terminal if space.size <= LARGEST_SPACE else None
        if not 0 <= state < space.size or (terminal is not None and terminal[state]):
            raise SettingError(
                f"an episode must start in a state that is not terminal: got {start!r}"
            )
        return state


def maze_environment(map: str | Sequence[str] = FIRST_MAZE, **settings: Any) -> TaskEnvironment:
    """Return a :class:`GridWorld`, with settings of both, as ``Curricle/Maze-v0``."""
    forms = {name: settings.pop(name) for name in FORMS & settings.keys()}
    if isinstance(settings.get("rewards"), Mapping):
        settings["rewards"] = Rewards(**settings["rewards"])
    return TaskEnvironment(GridWorld(map, **settings), **forms)


def pursuit_environment(**settings: Any) -> TaskEnvironment:
    """Return a :class:`Pursuit` whose predators act jointly: ``Curricle/Pursuit-v0``."""
    forms = {name: settings.pop(name) for name in FORMS & settings.keys()}
    return TaskEnvironment(Pursuit(**settings), **forms)


def to_gymnasium(
    task: Task,
    *,
    observation: Form = "index",
    action: Form = "index",
    render_mode: RenderMode | None = None,
) -> TaskEnvironment:
    """Return a task as a Gymnasium environment, with its own rewards, ends and time limit.

    An episode is `terminated` when it enters a terminal state and `truncated` when it reaches the
    time limit first. ``info`` has the number of the state, ``state``, and its ``label``; where not
    every action is available ``action_mask``, (A,) int8, as Taxi has it, and the environment a
    method ``action_masks()``, as sb3-contrib asks for.
    ``reset(options={"state": ...})`` starts in a state: its number, or a dict of values or labels.

    Parameters
    ----------
    task : Task
        Of any kind but :class:`LiveMDP`, which is an environment already.
    observation : {"index", "components"}
        The state's number, ``Discrete(S)``; or a number for each component, ``MultiDiscrete``,
        counted from its lowest value. Not every combination need be a state.
    action : {"index", "components"}
        The action's number, ``Discrete(A)``; or one number for each component.
    render_mode : {"rgb_array", "ansi"}, optional
        What ``render`` returns: a picture, (height, width, 3) uint8, or text: the state's label
        where a task is no maze or pursuit.

    Raises
    ------
    TaskError, SettingError
        When `task` is not a task, or a live one; when a form is unknown or not every combination of
        action components is an action; when an action is outside the space or not available, or no
        episode is under way; when a reset's options are unknown, or its state does not exist or is
        terminal.

    Examples
    --------
    >>> environment = to_gymnasium(GridWorld("S.T"), render_mode="ansi")
    >>> environment.reset(seed=1)
    (0, {'state': 0, 'label': 'row=0 column=0'})
    >>> environment.step(1)
    (1, -1.0, False, False, {'state': 1, 'label': 'row=0 column=1'})
    >>> print(environment.render())
    S@T
    >>> hunt = to_gymnasium(Pursuit(4, 2), observation="components", action="components")
    >>> hunt.observation_space, hunt.action_space
    (MultiDiscrete([16 16 16]), MultiDiscrete([5 5]))
    """
    return TaskEnvironment(task, observation=observation, action=action, render_mode=render_mode)
