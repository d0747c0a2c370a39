"""Generative models, NamedTuples from which compiled loops sample, and tasks given by functions."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from numba import njit, typeof, types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.extending import overload

from curricle.arrays import BoolArray, FloatArray, FloatTable, IntArray, frozen
from curricle.checks import brief, instance, number, whole_number
from curricle.errors import TaskError
from curricle.tasks.kernel import (
    INLINED,
    compiled,
    first_above,
    inlined,
    integers,
    overloaded,
    splitmix64,
    uniform,
)
from curricle.tasks.spaces import Space, action_name, state_name
from curricle.text import counted

LARGEST_REWARD = 1e30  # so that no return overflows, in single precision either
REWARD_RULE = f"rewards must be finite, at most {LARGEST_REWARD:g} in size"
LONGEST = 10**12  # steps that a time limit may have at most


def number_of(reward: Any) -> float:
    """Return a reward, alone or in an array, as a float; NaN where it is no number."""
    try:
        plain = reward.item() if isinstance(reward, np.ndarray) else reward
        return np.nan if isinstance(plain, str | bytes) else float(plain)
    except (TypeError, ValueError, OverflowError):
        return np.nan


def flag_of(value: Any, name: str, place: str = "") -> bool:
    """Return a flag as a bool; TaskError where it is not True or False, 1 or 0."""
    try:  # arrays and tensors of one element, of any library
        plain = value.item() if hasattr(value, "item") else value
    except (TypeError, ValueError, RuntimeError):  # of several elements
        plain = value
    if isinstance(plain, int | float) and plain in (0, 1):
        return bool(plain)
    raise TaskError(f"{name} must be True or False: got {brief(value)}{place}")


class Timed(Protocol):
    """What has a horizon: tasks of every kind."""

    @property
    def discount(self) -> float: ...  # noqa: D102
    @property
    def time_limit(self) -> int | None: ...  # noqa: D102


class TaskParts(Timed, Protocol):
    """What tasks with states have."""

    @property
    def states(self) -> Space: ...  # noqa: D102
    @property
    def actions(self) -> Space: ...  # noqa: D102


def check_horizon(task: Timed) -> None:
    """Check a frozen task's discount and time limit, and make them a float and an int."""
    discount = number("discount", task.discount, TaskError, low=0, high=1)
    object.__setattr__(task, "discount", discount)
    if task.time_limit is not None:
        limit = whole_number("time_limit in steps", task.time_limit, 1, TaskError)
        number("time_limit in steps", limit, TaskError, high=LONGEST)
        object.__setattr__(task, "time_limit", limit)


def check_parts(task: TaskParts, kind: str, *functions: str) -> None:
    """Check the spaces, functions and horizon of a task without tables, `kind` of which it is."""
    instance("states", task.states, Space, TaskError)
    instance("actions", task.actions, Space, TaskError)
    for name in functions:
        if not callable(getattr(task, name)):
            raise TaskError(f"{name} must be a function: got {getattr(task, name)!r}")
    check_horizon(task)
    if task.discount == 1 and task.time_limit is None:
        raise TaskError(f"a {kind} task with discount 1 needs a time limit, time_limit=: none set")


def described(task: TaskParts, *parts: str) -> str:
    """Return a task as text: its kind, its sizes, further parts and its horizon."""
    sizes = counted(task.states.size, "state"), counted(task.actions.size, "action")
    limit = "no time limit" if task.time_limit is None else f"time limit {task.time_limit}"
    facts = ", ".join((*sizes, *parts, f"discount {task.discount:g}", limit))
    return f"{type(task).__name__}({facts})"


# -- what loops ask of every generative model ------------------------------------------------------


@overloaded()
def first_state(model, bits):
    """Return the state an episode starts in, uint64, drawn with 64 random bits."""


@overloaded()
def transition(model, state, action, bits):
    """Return next state (uint64), reward and whether the episode terminated; 64 random bits."""


@overloaded(otherwise=lambda model: False)
def truncated(model):
    """Return whether the task itself truncated the episode just now; only live tasks do."""


@overloaded(otherwise=lambda model: False)
def has_failed(model):
    """Return whether the task has failed; its transitions are then invalid, and loops stop."""


@overloaded(otherwise=lambda model: model)
def evaluation_model(model):
    """Return the model to evaluate a policy in, which leaves the one learnt in unchanged."""


# -- actions that are not available everywhere -----------------------------------------------------


@overloaded(otherwise=lambda available, state, action: True)
def is_available(available, state, action):
    """Return whether an action can be taken in a state; by default every action can."""


@overloaded(otherwise=lambda model, state, action, bits: action)
def permitted(model, state, action, bits):
    """Return the action if it is available in the state, else one drawn among those that are."""


class AvailableTable(NamedTuple):
    """The available actions of every state."""

    table: BoolArray  # (S, A)


class AvailableFunction(NamedTuple):
    """The available actions as a user's compiled function computes them."""

    function: Any  # (data, state, action) -> bool
    data: Any


class OpenValues(NamedTuple):
    """The available actions as a learner's values show them, which are -inf where there is none."""

    values: FloatTable  # (S, A)


@is_available.body(AvailableTable)
def _is_listed(available, state, action):
    return available.table[state, action]


@is_available.body(AvailableFunction)
def _is_computed(available, state, action):
    return bool(available.function(available.data, np.uint64(state), np.uint64(action)))


@is_available.body(OpenValues)
def _is_open(available, state, action):
    return available.values[state, action] != -np.inf


@inlined
def drawn_among_available(available, n_actions, state, action, bits):
    """Return the action if it is available in a state, else a uniform draw among those that are."""
    # The bits have chosen the action, and mixed once they choose its outcome.
    if is_available(available, state, action):
        return action
    count, n_actions, chosen = np.uint64(0), np.uint64(n_actions), np.uint64(action)
    for other in range(n_actions):
        count += np.uint64(is_available(available, state, other))
    skipped = integers(splitmix64(~bits), count)
    for other in range(n_actions):
        if is_available(available, state, other):
            if skipped == np.uint64(0):
                chosen = other
            skipped -= np.uint64(1)
    return chosen


@inlined
def close_row(available, state, table, row):
    """Write -inf into the row of a state where an action is not available; nothing if none is."""
    n_actions, some = np.uint64(table.shape[1]), False
    for action in range(n_actions):
        some = some or is_available(available, state, action)
    if not some:  # at an end, which the task need not know
        return
    for action in range(n_actions):
        if not is_available(available, state, action):
            table[row, action] = -np.inf


def _close_rows(available, states, values):
    for row in range(values.shape[0]):
        close_row(available, np.uint64(states[row]), values, row)


class Restricted(NamedTuple):
    """A model of tables in which some actions are not available."""

    model: Any
    available: AvailableTable


first_state.body(Restricted)(lambda model, bits: first_state(model.model, bits))


@transition.body(Restricted)
def _restricted_step(model, state, action, bits):
    return transition(model.model, state, action, bits)


@permitted.body(Restricted)
def _permitted_by_table(model, state, action, bits):
    n_actions = model.available.table.shape[1]
    return drawn_among_available(model.available, n_actions, state, action, bits)


# -- tables ----------------------------------------------------------------------------------------


class Tables(NamedTuple):
    """The tables of a :class:`FiniteMDP`."""

    row_per_pair: bool  # pair (s, a) has row s * A + a, so that `outcome_row` need not be read
    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A) int32
    probability: FloatArray  # (Y, O)
    cumulative: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O) int32
    reward: FloatArray  # (Y, O)
    terminal: BoolArray  # (S,)
    start_states: IntArray  # (n,)
    start_cumulative: FloatArray  # (n,)


@first_state.body(Tables)
def _table_start(model, bits):
    index = first_above(model.start_cumulative, uniform(bits))
    return np.uint64(model.start_states[index])


@transition.body(Tables)
def _table_step(model, state, action, bits):
    if model.row_per_pair:
        row = state * np.uint64(model.outcome_row.shape[1]) + action
    else:
        row = np.uint64(model.outcome_row[state, action])
    outcome, last = np.uint64(0), np.uint64(model.cumulative.shape[1] - 1)
    if last > np.uint64(0):
        chance = uniform(bits)
        for i in range(last):  # to the end: leaving early would be mispredicted half the time
            outcome += np.uint64(chance >= model.cumulative[row, i])
    next_state = np.uint64(model.next_state[row, outcome])
    return next_state, model.reward[row, outcome], model.terminal[next_state]


class DeterministicTables(NamedTuple):
    """The tables of a :class:`FiniteMDP` with one outcome a pair, which has a row of its own."""

    n_actions: np.uint64
    next_state: npt.NDArray[np.integer[Any]]  # (S * A,) int32
    reward: FloatArray  # (S * A,)
    terminal: BoolArray  # (S,)
    start_states: IntArray  # (n,)
    start_cumulative: FloatArray  # (n,)


first_state.body(DeterministicTables)(_table_start)


@transition.body(DeterministicTables)
def _deterministic_step(model, state, action, bits):
    pair = state * model.n_actions + action
    next_state = np.uint64(model.next_state[pair])
    return next_state, model.reward[pair], model.terminal[next_state]


def cumulated(probability: FloatArray) -> FloatArray:
    """Return cumulative probabilities along each row; the last possible outcome gets 1."""
    total = np.cumsum(probability, axis=1)
    remaining = np.cumsum(probability[:, ::-1], axis=1)[:, ::-1]
    after = np.concatenate([remaining[:, 1:], np.zeros((len(remaining), 1))], axis=1)
    return frozen(np.where(after == 0, 1.0, total))


# -- a prey and predators that move independently, for exact planning without tables ---------------

# All move at the same time on one map of cells, and the moves of each do not depend on where the
# others are. So the expectation over the prey's moves and the maximum over the predators' are taken
# one after the other, and planning (planning/models.py) needs no table of joint moves.

CellArray = npt.NDArray[np.int32]


class FactoredModel(NamedTuple):
    """A prey and k predators that move at the same time, independently of each other.

    In state ((p C + c_1) C + c_2) ... the prey is on cell p of C and predator i on cell c_i.
    """

    landing: CellArray  # (C, M): the cell that each move leads to from each cell
    prey_policy: FloatArray  # (C, M): the probability of each move of the prey, by its own cell
    predators: int  # k, at least 1
    rewards: FloatArray  # (k + 1,) of a step after which 0, 1, ..., k predators are on the prey
    ends: BoolArray  # (k + 1,): whether such a state is terminal
    discount: float


def joint_landing(landing: CellArray, predators: int) -> CellArray:
    """Return where joint moves lead k predators from each position, (C^k, M^k) int32, by (C, M)."""
    n_cells, n_moves = landing.shape
    joint = np.zeros((1, 1), dtype=np.int32)
    for _ in range(predators):
        both = joint[:, None, :, None] * np.int32(n_cells) + landing[None, :, None, :]
        joint = both.reshape(joint.shape[0] * n_cells, joint.shape[1] * n_moves)
    return frozen(joint)


def predators_on_prey(n_cells: int, predators: int) -> npt.NDArray[np.int8]:
    """Return how many predators are on the prey's cell in each state, (C^(1 + k),) int8."""
    same_cell = np.eye(n_cells, dtype=np.int8)
    count = np.zeros((n_cells, 1), dtype=np.int8)
    for _ in range(predators):
        count = (count[:, :, None] + same_cell[:, None, :]).reshape(n_cells, -1)
    return frozen(count.ravel())


# -- tasks given by compiled functions -------------------------------------------------------------

REAL = (types.Integer, types.Float, types.Boolean)
LARGEST = 2**62  # the most states: larger numbers do not fit the arrays that list them


@dataclass(frozen=True, eq=False)
class ComputedMDP:
    """An MDP whose successors are computed by a function, for tasks too large for tables.

    It can be learnt and take part in transfer, but :func:`solve` needs tables. Compiling
    takes some seconds in each process, as a user's code is not cached on disk.

    Parameters
    ----------
    states, actions : Space
        S states and A actions; their numbers are what the functions take and return.
    start : callable
        ``start(data, bits) -> state``, in which an episode starts. ``bits`` are 64 random bits, a
        uint64, for :func:`uniform`, :func:`integers`, :func:`bernoulli` and :func:`splitmix64`.
    step : callable
        ``step(data, state, action, bits) -> (next state, reward, terminated)``. `terminated` must
        depend on the next state alone. Both functions are Python that numba compiles, take state
        and action as uint64, and must not change `data`. Each step is checked.
    data : Any
        The data that the functions read: a number, an array, or a NamedTuple of such.
    discount, time_limit
        As in :class:`FiniteMDP`.
    available : callable, optional
        ``available(data, state, action) -> bool``, whether an action can be taken in a state; by
        default all can, also in a state for which it returns False of each.

    Raises
    ------
    TaskError
        While learning, when a function does not compile, or returns no state in 0..S-1 or a reward
        that is not finite.

    Examples
    --------
    A ring of n places with home at 0; a step goes the wrong way with probability 0.1.

    >>> import curricle as cr
    >>> def start(n, bits):
    ...     return 1 + cr.tasks.integers(bits, n - 1)
    >>> def step(n, state, action, bits):
    ...     right = (action == 1) != (cr.tasks.uniform(bits) < 0.1)
    ...     place = (state + (1 if right else n - 1)) % n
    ...     return place, -1.0, place == 0
    >>> ring = ComputedMDP(
    ...     Space([cr.Component("place", 50)]), Space([cr.Component("move", 2)]),
    ...     start, step, data=50, discount=0.99)
    >>> q = cr.learn(ring, budget=200_000).values[0]
    >>> q[[3, 47]].argmax(axis=1)  # home is near, to the left and to the right
    array([0, 1])
    """

    states: Space
    actions: Space
    start: Callable[..., Any]
    step: Callable[..., Any]
    data: Any = 0
    discount: float = 0.99
    time_limit: int | None = 200
    available: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        known = () if self.available is None else ("available",)
        check_parts(self, "computed", "start", "step", *known)
        if self.states.size > LARGEST:
            raise TaskError(
                f"a computed task may have at most 2^62 states: got {self.states.size:,}"
            )

    @property
    def terminal(self) -> None:
        """Unknown: only the step function decides which states end an episode."""

    @property
    def model(self) -> "Functions":
        """A generative model for the compiled loops of one run."""
        start, step, available = self._functions
        size, n_actions = np.uint64(self.states.size), np.uint64(self.actions.size)
        allowed = None if available is None else AvailableFunction(available, self.data)
        return Functions(start, step, self.data, size, np.zeros(1, FAILURE), n_actions, allowed)

    def available_rows(self, states: IntArray | None = None) -> BoolArray | None:
        """Return the available actions of n states, by default all, (n, A); None where all are."""
        if self.available is None:
            return None
        allowed = self.model.available
        rows = np.arange(self.states.size) if states is None else states
        values = np.zeros((len(rows), self.actions.size))
        compiled(_close_rows, True)(allowed, rows, values)
        return frozen(np.asarray(values == 0.0))

    @cached_property
    def _functions(self) -> tuple[Any, Any, Any]:
        """The functions, compiled for the types that loops call them with."""
        try:
            data = typeof(self.data)
        except ValueError:
            raise TaskError(
                f"the data of a computed task must be of types that numba knows: got {self.data!r}"
            ) from None
        return (
            _compiled("start", self.start, (data, types.uint64), "a state"),
            _compiled(
                "step", self.step, (data, *[types.uint64] * 3), "a state, a reward and a flag"
            ),
            None
            if self.available is None
            else _compiled("available", self.available, (data, *[types.uint64] * 2), "a flag"),
        )

    def __repr__(self) -> str:
        return described(self)


def _compiled(name: str, function: Callable[..., Any], kinds: Any, wanted: str) -> Any:
    """Return a function compiled for arguments of these types; TaskError if it returns others."""
    ready = function if isinstance(function, Dispatcher) else njit(nogil=True)(function)
    try:
        template: Any = ready.get_call_template(kinds, {})[0]
    except NumbaError as error:
        reason = " ".join(re.sub(r"\x1b\[[0-9;]*m", "", str(error)).split())
        raise TaskError(
            f"{name} of a computed task must be Python that numba compiles: {reason[:400]}"
        ) from error
    kind = template.cases[0].return_type
    parts = tuple(getattr(kind, "types", ())) if name == "step" else (kind,)
    count = 3 if name == "step" else 1
    if len(parts) != count or not all(isinstance(part, REAL) for part in parts):
        raise TaskError(f"{name} of a computed task must return {wanted}: it returns {kind}")
    return ready


# The results of a user's functions are checked at every step: a state that does not exist would lie
# outside of every table. From the first mistake on, episodes end at once.
class Functions(NamedTuple):
    """The compiled functions of a :class:`ComputedMDP`, the data they read, their first mistake."""

    start: Any  # (data, bits) -> state
    step: Any  # (data, state, action, bits) -> (next state, reward, terminated)
    data: Any
    n_states: np.uint64
    failure: npt.NDArray[np.void]  # (1,) of FAILURE
    n_actions: np.uint64
    available: "AvailableFunction | None"


FAILURE = np.dtype(
    [("by", "u8"), ("state", "u8"), ("action", "u8"), ("next_state", "f8"), ("reward", "f8")]
)
"""The first mistake of a user's functions: which function, for which pair, what it returned."""
START, STEP = 1, 2  # the function that made it; 0 is none


def state_number(returned, n_states):
    """Return a state that a user's function returned as uint64; `n_states` if it is no state."""


def _number_of_float(returned, n_states):
    if not 0.0 <= returned < np.float64(n_states):  # NaN, too
        return n_states
    number = np.uint64(returned)
    return number if np.float64(number) == returned else n_states


@overload(state_number, jit_options=INLINED)
def _state_number(returned, n_states):
    if isinstance(returned, types.Float):
        return _number_of_float
    return lambda returned, n_states: min(np.uint64(returned), n_states)  # negative: a large one


@first_state.body(Functions)
def _computed_start(model, bits):
    returned = model.start(model.data, bits)
    state = state_number(returned, model.n_states)
    if state >= model.n_states:
        if model.failure[0].by == 0:
            model.failure[0].by = START
            model.failure[0].next_state = np.float64(returned)
        return np.uint64(0)
    return state


@transition.body(Functions)
def _computed_step(model, state, action, bits):
    returned, reward, terminated = model.step(model.data, state, action, bits)
    next_state = state_number(returned, model.n_states)
    if next_state >= model.n_states or not abs(np.float64(reward)) <= LARGEST_REWARD:
        if model.failure[0].by == 0:
            model.failure[0].by = STEP
            model.failure[0].state, model.failure[0].action = state, action
            model.failure[0].next_state = np.float64(returned)
            model.failure[0].reward = np.float64(reward)
        return np.uint64(0), 0.0, True
    return next_state, np.float64(reward), bool(terminated)


@permitted.body(Functions)
def _permitted_by_function(model, state, action, bits):
    return drawn_among_available(model.available, model.n_actions, state, action, bits)


has_failed.body(Functions)(lambda model: model.failure[0].by != 0)


def has_users_code(model: object) -> bool:
    """Return whether a model is of functions, or of a class, from outside this library.

    Loops that they are compiled into are not kept on disk, as nothing tells when they change.
    """
    return isinstance(model, Functions) or not type(model).__module__.startswith("curricle.")


@contextmanager
def opened(task: ComputedMDP) -> Iterator[Functions]:
    """Return a context with a model that loops can run on, which checks the answers at its end."""
    model = task.model
    yield model
    check_answers(task, model)


def check_answers(task: ComputedMDP, model: Functions) -> None:
    """Raise TaskError if a function of the task returned an invalid value."""
    failure = model.failure[0]
    if not failure["by"]:
        return
    last, returned = task.states.size - 1, float(failure["next_state"])
    call = "start of a computed task"
    if failure["by"] == STEP:
        state = state_name(task.states, int(failure["state"]))
        action = action_name(task.actions, int(failure["action"]))
        call = f"step of a computed task for action {action} in {state}"
    if returned.is_integer() and 0 <= returned <= last:
        raise TaskError(f"{REWARD_RULE}: {call} returned {failure['reward']:g}")
    raise TaskError(f"a state must be a whole number in 0..{last}: {call} returned {returned:.20g}")
