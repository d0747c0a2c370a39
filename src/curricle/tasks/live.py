"""Live tasks: compiled loops take every step in an environment, a Python object, by its address."""

from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass, field
from operator import index
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils

from curricle.arrays import BoolArray, FloatTable
from curricle.checks import brief, instance
from curricle.errors import ForeignError, TaskError, in_words, note_place
from curricle.tasks.kernel import inlined, lowered, splitmix64
from curricle.tasks.models import (
    LARGEST_REWARD,
    REWARD_RULE,
    AvailableTable,
    ComputedMDP,
    check_parts,
    described,
    drawn_among_available,
    evaluation_model,
    first_state,
    flag_of,
    has_failed,
    number_of,
    opened,
    permitted,
    transition,
    truncated,
)
from curricle.tasks.observation_task import check_observation, seed_shared, shared_restored
from curricle.tasks.spaces import MISSING, Space, action_name, state_name

RESET = -1  # sent instead of an action to start an episode
RUNNING, TRUNCATED, FAILED = range(3)  # the status after a step; it does not say termination


class Live(NamedTuple):
    """Two environments of one task: the one that is learnt in, and one to evaluate policies in."""

    address: npt.NDArray[np.uint64]  # (2,) of the callables of :func:`answer`
    status: npt.NDArray[np.int8]  # (2,) of each after its last step
    which: np.uint64  # the index of the environment that is used
    available: BoolArray  # (2, A) the actions that can be taken in the present state of each


first_state.body(Live)(lambda model, bits: _ask(model, RESET)[0])
transition.body(Live)(lambda model, state, action, bits: _ask(model, np.int64(action)))
truncated.body(Live)(lambda model: model.status[model.which] == TRUNCATED)
has_failed.body(Live)(lambda model: max(model.status[0], model.status[1]) == FAILED)


@evaluation_model.body(Live)
def _other_environment(model):
    return Live(model.address, model.status, np.uint64(1), model.available)


@permitted.body(Live)
def _permitted_now(model, state, action, bits):
    available, n_actions = AvailableTable(model.available), model.available.shape[1]
    return drawn_among_available(available, n_actions, model.which, action, bits)


@inlined
def _ask(model, action):
    state, reward, terminated, truncated = answer(model.address[model.which], action)
    if state < 0:
        model.status[model.which] = FAILED
        return np.uint64(0), 0.0, True
    model.status[model.which] = TRUNCATED if truncated else RUNNING
    return np.uint64(state), reward, terminated


PARTS = types.Tuple((types.int64, types.float64, types.boolean, types.boolean))


@lowered(lambda address, action: PARTS(types.uint64, types.int64))
def answer(context, builder, signature, args):
    """Return the :data:`Answer` of the Python callable at an address to a number.

    The callable must keep its exceptions and return that it failed: a raised one leaks memory.
    """
    api, flag = context.get_python_api(builder), ir.IntType(32)
    slots = [cgutils.alloca_once(builder, kind) for kind in (api.longlong, api.double, flag, flag)]
    parsed = cgutils.alloca_once_value(builder, ir.Constant(flag, 0))
    gil = api.gil_ensure()
    number = api.long_from_longlong(args[1])
    answered = api.call_function_objargs(builder.inttoptr(args[0], api.pyobj), [number])
    api.decref(number)
    with builder.if_then(cgutils.is_not_null(builder, answered)):
        expected = "Ldpp;an answer must be a state, a reward and two flags"
        kind = ir.FunctionType(flag, [api.pyobj, api.cstring], var_arg=True)
        parse = cgutils.get_or_insert_function(builder.module, kind, "PyArg_ParseTuple")
        constant = context.insert_const_string(builder.module, expected)
        builder.store(builder.call(parse, [answered, constant, *slots]), parsed)
        api.decref(answered)
    api.gil_release(gil)
    raised = cgutils.is_null(builder, builder.load(parsed))
    with builder.if_then(raised, likely=False):
        context.call_conv.return_exc(builder)
    state, reward, *flags = (builder.load(slot) for slot in slots)
    values = [state, reward, *(cgutils.is_not_null(builder, value) for value in flags)]
    return context.make_tuple(builder, signature.return_type, values)


# -- tasks that are learnt by acting ---------------------------------------------------------------

Answer = tuple[Any, Any, Any, Any]
"""A state (negative: it failed), a reward, whether the episode terminated or was truncated."""
RETURNED = {
    "reset": ("observation", "info"),
    "step": ("observation", "reward", "terminated", "truncated", "info"),
}
"""The parts that the methods of an environment return."""
BROKEN_DOWN: Answer = (-1, 0.0, True, False)


@dataclass(frozen=True)
class LiveMDP:
    """A task without tables or rules: every step is taken in an environment.

    Each seed has an environment to learn in and one to evaluate policies in, seeded from its random
    stream and closed at the end. :func:`from_gymnasium` makes these tasks.

    Parameters
    ----------
    states, actions : Space
        S states and A actions.
    make : callable
        ``make()`` returns a new environment with the methods ``reset(seed=...)``, ``step(action)``
        and ``close()`` of a ``gymnasium.Env``. Learners bootstrap where it truncates.
    encode : callable, optional
        ``encode(observation)`` is the number of a state or the tuple of its components' values; by
        default the observation itself.
    act : callable
        ``act(a)`` is the environment's action for action a; by default the number.
    discount, time_limit
        As in :class:`FiniteMDP`. Episodes are cut at the time limit even where the environment
        would go on.
    action_masks : bool
        Whether the environment says which actions are available, as flags for each action: in
        ``info["action_mask"]``, or by a method ``action_masks()``. They must depend on the state.

    Raises
    ------
    TaskError
        While learning, when an observation encodes to no state, or the available actions of a state
        are none, missing or others than before. An environment's exceptions pass.

    Examples
    --------
    >>> import curricle as cr
    >>> class Ring:                             # any gymnasium.Env; home is 0
    ...     def reset(self, seed=None):
    ...         self.place = 3
    ...         return self.place, {}
    ...     def step(self, action):
    ...         self.place = (self.place + (1 if action else -1)) % 8
    ...         return self.place, -1.0, self.place == 0, False, {}
    ...     def close(self):
    ...         pass
    >>> ring = LiveMDP(Space([cr.Component("place", 8)]), Space([cr.Component("move", 2)]), Ring)
    >>> cr.learn(ring, budget=2000, seeds=2).greedy_return[:, -1].round(4)
    array([-2.9701, -2.9701])
    """

    states: Space
    actions: Space
    make: Callable[[], Any] = field(hash=False)
    encode: Callable[[Any], Any] | None = field(default=None, hash=False)
    act: Callable[[int], Any] = field(default=index, hash=False)
    discount: float = 0.99
    time_limit: int | None = 200
    action_masks: bool = False

    def __post_init__(self) -> None:
        instance("action_masks", self.action_masks, bool, TaskError)
        encode = [] if self.encode is None else ["encode"]
        check_parts(self, "live", "make", "act", *encode)

    @property
    def terminal(self) -> None:
        """Unknown: only the environment decides which steps end an episode."""

    @property
    def model(self) -> tuple[()]:
        """Nothing: the generative model exists while environments are open."""
        return ()

    def open(self, start: int, tables: FloatTable | None) -> AbstractContextManager[Live]:
        """Return a context with the model of a run whose random stream starts at `start`."""
        return _Opened(self, start, tables)

    def __repr__(self) -> str:
        return described(self)


def is_live(task: object) -> bool:
    """Return whether a task is played in an environment, by one thread at a time."""
    return isinstance(task, LiveMDP)


def masks_actions(task: Any) -> bool:
    """Return whether only the environment of a live task knows which actions are available."""
    return is_live(task) and bool(task.action_masks)


def reset_state(task: LiveMDP) -> int:
    """Return the state that a new environment is in after a reset with seed 0."""
    with shared_restored(), closing(task.make()) as environment:
        return numbering(task)(_observed(seeded_reset(environment, 0)))


def open_model(
    task: Any, start: int, tables: FloatTable | None = None
) -> AbstractContextManager[Any]:
    """Return a context with a task's model; at its end it raises an environment's exception.

    A task with a method `open` makes its model for a run, such as :class:`LiveMDP`. An environment
    that masks actions writes -inf into `tables`, (n, m, S, A), as states are met.
    """
    if hasattr(task, "open"):
        return task.open(start, tables)  # type: ignore[no-any-return]
    return opened(task) if isinstance(task, ComputedMDP) else nullcontext(task.model)


class _Opened:
    """The environments of one run; no generator, in which their StopIteration is an error."""

    def __init__(self, task: LiveMDP, start: int, tables: FloatTable | None):
        self.closings = ExitStack()
        self.closings.enter_context(shared_restored())
        self.raised = list[BaseException]()
        # Two seeds below 2^31, which every environment takes.
        seeds = [splitmix64(start ^ which) >> 33 for which in (1, 2)]
        self.available = np.ones((2, task.actions.size), np.bool_)
        players = [
            _player(task, seed, self.closings, self.raised, (available, tables))
            for seed, available in zip(seeds, self.available, strict=True)
        ]
        for player in players:
            next(player)
        self.callables = [player.send for player in players]  # they must outlive their addresses

    def __enter__(self) -> Live:
        addresses = np.array([id(send) for send in self.callables], dtype=np.uint64)
        return Live(addresses, np.zeros(2, np.int8), np.uint64(0), self.available)

    def __exit__(self, *_: object) -> None:
        try:
            self.closings.close()
        finally:
            if self.raised:
                raise self.raised[0]


def _player(
    task: LiveMDP,
    seed: int,
    closings: ExitStack,
    raised: list[BaseException],
    closes: tuple[BoolArray, FloatTable | None],
) -> Generator[Answer | None, int, None]:
    """Yield the result of each action sent in an environment; `RESET` starts an episode."""
    # Nothing is raised, as compiled code is the caller. A generator also catches an interrupt that
    # arrives before the first line of a function would be reached.
    action = yield None
    try:
        environment = task.make()
        if not (callable(getattr(environment, "step", None)) and hasattr(environment, "close")):
            raise TaskError(f"make of a live task must return an environment: got {environment!r}")
        closings.enter_context(closing(environment))
        number, moves = numbering(task), [task.act(a) for a in range(task.actions.size)]
        step, reset, masks = environment.step, environment.reset, task.action_masks
        close = _closing(task, environment, *closes)
        begun = seeded_reset(environment, seed)
        while True:
            state = number(_observed(begun))
            if masks:
                close(state, begun[1])
            action = yield state, 0.0, False, False
            while action != RESET:
                followed = step(moves[action])
                try:  # here, as a call costs a tenth of a step
                    observation, reward, terminated, truncated, info = followed
                except (TypeError, ValueError):
                    raise TaskError(wrong_parts("step", followed)) from None
                earned = number_of(reward)
                if not -LARGEST_REWARD <= earned <= LARGEST_REWARD:
                    raise TaskError(
                        f"{REWARD_RULE}: the environment returned {reward!r} for "
                        f"{_at(task, action, state)}"
                    )
                if type(terminated) is not bool or type(truncated) is not bool:
                    try:  # the place is words that steps need not wait for
                        terminated = flag_of(terminated, "terminated")
                        truncated = flag_of(truncated, "truncated")
                    except TaskError as error:
                        raise TaskError(f"{error} for {_at(task, action, state)}") from None
                state = number(observation)
                if masks and not terminated:
                    close(state, info)
                action = yield state, earned, terminated, truncated
            begun = reset()
    except BaseException as error:
        if isinstance(error, GeneratorExit) and (at := error.__traceback__) and not at.tb_next:
            raise  # at a yield: this generator is closed
        note_place(error, "" if action in (None, RESET) else f", for {_at(task, action, state)}")
        told = error
        if not isinstance(error, Exception | KeyboardInterrupt | SystemExit):
            told = ForeignError(in_words(error))
            told.__cause__ = error
        raised.append(told)
    while True:
        yield BROKEN_DOWN


def _at(task: LiveMDP, action: int, state: int) -> str:
    """Return the action and the state of a step in words."""
    name = action_name(task.actions, action).removeprefix("action ")
    return f"action {name} in {state_name(task.states, state)}"


def _closing(
    task: LiveMDP, environment: object, available: BoolArray, tables: FloatTable | None
) -> Callable[[int, Any], None]:
    """Return the function that notes which actions are available in a state that is entered."""
    known, n_actions = dict[int, bytes](), task.actions.size

    def close(state: int, info: object) -> None:
        available[:] = mask = action_mask(environment, info, n_actions)
        if state not in known:
            known[state] = mask.tobytes()
            if tables is not None:
                tables[..., state, ~mask] = -np.inf
        if known[state] != mask.tobytes():
            raise TaskError(
                "which actions are available must depend on the state alone: in "
                f"{state_name(task.states, state)} they are {np.flatnonzero(mask).tolist()}, and "
                f"were {np.flatnonzero(np.frombuffer(known[state], np.bool_)).tolist()}"
            )

    return close


def action_mask(environment: Any, info: object, n_actions: int) -> BoolArray:
    """Return the available actions of an environment's present state, (A,); TaskError if none."""
    mask = info.get("action_mask") if isinstance(info, Mapping) else None
    if mask is None:
        asked = getattr(environment, "action_masks", None)
        behind = getattr(environment, "has_wrapper_attr", lambda _: False)
        if asked is None and behind("action_masks"):
            asked = environment.get_wrapper_attr("action_masks")
        if asked is None:
            raise TaskError(
                'action_masks needs an environment with info["action_mask"] or a method '
                f"action_masks(): {environment} has neither; leave it out where every action can "
                "be taken"
            )
        mask = asked()
    flags = np.asarray(mask)
    if flags.shape != (n_actions,) or flags.dtype.kind not in "biuf" or not flags.any():
        raise TaskError(
            f"a mask of actions must have a flag for each of {n_actions} actions, one of them "
            f"True: got {brief(mask)}"
        )
    return flags.astype(np.bool_)


def _observed(begun: object) -> Any:
    """Return the observation in the pair that a reset returned."""
    return checked_parts("reset", begun)[0]


OLD_GYM = (
    "an environment of the old gym becomes one of Gymnasium's by the package shimmy: "
    "shimmy.GymV26CompatibilityV0(env=...), or GymV21CompatibilityV0 where a step returns 4 parts"
)


def seeded_reset(environment: Any, seed: int) -> Any:
    """Return what an environment's reset with a seed returns; TaskError if it takes no seed.

    The shared generators are seeded, too, so that a class that draws from them follows its seed.
    """
    seed_shared(seed)
    try:
        return environment.reset(seed=seed)
    except TypeError as error:
        if "unexpected keyword argument 'seed'" not in str(error):
            raise
        raise TaskError(
            f"a reset must take a seed, as reset(self, *, seed=None, options=None) does: {error}; "
            f"{OLD_GYM}"
        ) from None


def checked_parts(method: str, returned: object) -> tuple[Any, ...]:
    """Return what a step or reset returned; TaskError unless it has the right parts."""
    if not isinstance(returned, tuple | list) or len(returned) != len(RETURNED[method]):
        raise TaskError(wrong_parts(method, returned))
    return tuple(returned)


def wrong_parts(method: str, returned: object) -> str:
    """Return the sentence on what a step or reset returned instead of its parts."""
    old = method == "reset" or (isinstance(returned, tuple) and len(returned) == 4)
    said = f"({', '.join(RETURNED[method])}): got {brief(returned)}{f'; {OLD_GYM}' * old}"
    return f"a {method} of an environment must return {said}"


def numbering(task: LiveMDP) -> Callable[[Any], int]:
    """Return the function from an observation to the number of its state, checked."""
    encode, encode_one, size = task.encode, task.states.encode_one, task.states.size

    def number(observation: Any) -> int:
        encoded = observation if encode is None else encode(observation)
        try:
            state = encode_one(encoded) if isinstance(encoded, tuple) else index(encoded)
        except TypeError:
            state = MISSING
        if 0 <= state < size:
            return state
        if isinstance(space := getattr(encode, "space", None), gymnasium.Space):
            check_observation(space, observation)
        raise TaskError(
            f"an observation must encode to a state, a number in 0..{size - 1} or the values of "
            f"{', '.join(task.states.names)}: {brief(observation)} gives {brief(encoded)}"
        )

    return number
