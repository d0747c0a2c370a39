"""Finite MDPs as frozen tables, and the interfaces of tasks that learning and planning read.

Pairs (s, a) with the same outcome distribution share a *row*: ``outcome_row[s, a]`` is one of Y
rows of up to O outcomes. A maze has Y = 2 S, a pursuit Y = S, an arbitrary MDP Y = S A.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, adopted, frozen
from curricle.checks import instance
from curricle.errors import TaskError
from curricle.tasks.graph import rows_in_use, steps_to
from curricle.tasks.models import (
    LARGEST_REWARD,
    REWARD_RULE,
    AvailableTable,
    DeterministicTables,
    Restricted,
    Tables,
    TaskParts,
    check_horizon,
    cumulated,
    described,
)
from curricle.tasks.readers import (
    Pairs,
    dense_pairs,
    listed_outcomes,
    listed_pairs,
    sparse_pairs,
    start_distribution,
    terminal_states,
)
from curricle.tasks.spaces import Component, Space, state_name, whole_by_type

Table = TypeVar("Table", bound=npt.NDArray[Any])
PROBABILITY_TOLERANCE = 1e-8
SINGLE_PRECISION = 1e-6
"""How far from 1 probabilities of float32 may sum; then they are divided by their sum."""
NO_LIMIT = np.int64(2**62)  # steps that stand for no limit in compiled loops


@dataclass(frozen=True, eq=False)
class FiniteMDP(Frozen):
    """A finite MDP with a start distribution, a discount and a time limit; validated and frozen.

    Use :meth:`from_dense`, :meth:`from_sparse`, :meth:`from_pairs` or :meth:`from_outcomes` unless
    you have the compact form.

    Parameters
    ----------
    states, actions : Space
        S states and A actions.
    outcome_row : (S, A) int32
        The outcome row of each pair, in 0 .. Y-1; rows of terminal states are never used.
    probability : (Y, O) float64
        Outcome probabilities. Rows (pad short ones with probability 0) sum to 1, within 1e-8, or
        within 1e-6, as float32 does, and are divided by their sums.
    next_state : (Y, O) int32
        Successor of each outcome.
    reward : (Y, O) float64
        Reward of each outcome, so that it may depend on s, a and s'. It becomes 0 where the outcome
        has probability 0, and in rows that only terminal states name.
    terminal : (S,) bool
        States that end the episode when entered; their value is 0.
    start : (S,) float64
        Probability of starting in each state; 0 in terminal states.
    discount : float
        In [0, 1]; 1 only where a way leads to an end from every state, or a time limit is set.
    time_limit : int, optional
        Steps after which an episode is truncated. This is not termination: learners bootstrap.
    available : (S, A) bool, optional
        Which actions can be taken in each state, by default all; None where all can. The outcome
        row of a pair that is not available becomes that of the state's first available action.

    Raises
    ------
    TaskError
        Naming the state and action that break a rule.

    Examples
    --------
    >>> mdp = FiniteMDP.from_outcomes(
    ...     [[[(1.0, 0, -1.0)], [(0.5, 0, -1.0), (0.5, 1, -1.0)]], [[], []]],
    ...     terminal=[False, True], start=0, discount=0.9)
    >>> mdp
    FiniteMDP(2 states, 2 actions, 1 terminal, discount 0.9, no time limit)
    """

    states: Space
    actions: Space
    outcome_row: npt.NDArray[np.integer[Any]]
    probability: FloatArray
    next_state: npt.NDArray[np.integer[Any]]
    reward: FloatArray
    terminal: BoolArray
    start: FloatArray
    discount: float
    time_limit: int | None = None
    available: BoolArray | None = None

    def __post_init__(self) -> None:
        instance("states", self.states, Space, TaskError)
        instance("actions", self.actions, Space, TaskError)
        n_states, table = self.states.size, np.shape(self.probability)
        if len(table) != 2:
            raise TaskError(f"probability must have shape (Y, O): got {table}")
        # Indices are checked as they were given, before they are narrowed to 32 bits. What is
        # checked is a copy: a thread or a lazy array could change the original afterwards.
        for name, label, size in (
            ("outcome_row", "outcome_row", table[0]),
            ("next_state", "next states", n_states),
        ):
            numbers = whole_by_type(getattr(self, name), label)
            numbers = adopted(numbers, numbers.dtype)
            if numbers.size and (numbers.min() < 0 or numbers.max() >= size):
                raise TaskError(
                    f"{label} must lie in 0..{size - 1}: got {numbers.min()}..{numbers.max()}"
                )
            numbers = adopted(numbers, np.int32)  # now, so that no wide copy stays meanwhile
            object.__setattr__(self, name, numbers)
        for name, dtype, shape in (
            ("outcome_row", np.int32, (n_states, self.actions.size)),
            ("probability", np.float64, table),
            ("next_state", np.int32, table),
            ("reward", np.float64, table),
            ("terminal", np.bool_, (n_states,)),
            ("start", np.float64, (n_states,)),
        ):
            array = _adopted(name, getattr(self, name), dtype)
            if array.shape != shape:
                raise TaskError(f"{name} must have shape {shape}: got {array.shape}")
            if name in ("probability", "start"):
                array = frozen(normalised(array))
            object.__setattr__(self, name, array)
        self._check_available()
        check_rows(self.probability, self.reward, self.outcome_row, self.terminal)
        used = rows_in_use(self.outcome_row, self.terminal, len(self.probability))
        paid = used[:, None] & (self.probability > 0)
        if (self.reward[~paid] != 0).any():  # bounds, goals and comparisons read all rewards
            object.__setattr__(self, "reward", frozen(np.where(paid, self.reward, 0.0)))
        start = self.start
        if abs(start.sum() - 1) > PROBABILITY_TOLERANCE:
            raise TaskError(f"start probabilities must sum to 1: they sum to {start.sum()}")
        for rule, bad in (
            (
                "start probabilities must be finite and not negative",
                ~(np.isfinite(start) & (start >= 0)),
            ),
            ("an episode must not start in a terminal state", (start > 0) & self.terminal),
        ):
            if bad.any():
                state = bad.argmax()
                raise TaskError(f"{rule}: state {state} has start probability {start[state]:g}")
        check_horizon(self)
        if self.discount == 1 and self.time_limit is None:
            endless = np.isinf(steps_to(self, self.terminal))
            if endless.any():
                raise TaskError(
                    "discount 1 needs a time limit or a way to an end from every state: none leads "
                    f"there from state {endless.argmax()}"
                )

    def _check_available(self) -> None:
        """Narrow the actions to those that are available, and make the others' rows duplicates."""
        # A duplicate changes no optimum, no bound and no state that can be reached: what reads
        # tables without choosing an action needs to know nothing of available actions.
        if self.available is None:
            return
        available = _adopted("available", self.available, np.bool_)
        if available.shape != self.outcome_row.shape:
            raise TaskError(
                f"available must have shape {self.outcome_row.shape}: got {available.shape}"
            )
        available = available | self.terminal[:, None]
        if not available.any(axis=1).all():
            state = state_name(self.states, int(available.any(axis=1).argmin()))
            raise TaskError(
                f"a state that does not end episodes needs an available action: {state} has none"
            )
        if available.all():
            object.__setattr__(self, "available", None)
            return
        object.__setattr__(self, "available", frozen(available))
        object.__setattr__(self, "outcome_row", frozen(duplicated(self.outcome_row, available)))

    @classmethod
    def from_dense(
        cls,
        transition: npt.ArrayLike,
        reward: npt.ArrayLike,
        *,
        terminal: npt.ArrayLike,
        start: npt.ArrayLike,
        discount: float,
        time_limit: int | None = None,
        states: Space | None = None,
        actions: Space | None = None,
        available: npt.ArrayLike | None = None,
    ) -> Self:
        """Return the MDP of dense arrays.

        Parameters
        ----------
        transition : (S, A, S) float array
            P(s' | s, a).
        reward : (S, A, S), (S, A) or (S,) float array
            Reward on s, a, s'; on s, a; or on the state that is left.
        terminal : (S,) bool array
        start : int or (S,) float array
            The start state, or its distribution.
        discount, time_limit, states, actions, available
            As in the class; spaces default to one component ``state`` and one ``action``.
            Transitions of pairs that are not available do not count.

        Examples
        --------
        >>> mdp = FiniteMDP.from_dense([[[0.0, 1.0]], [[0.0, 1.0]]], [[5.0], [0.0]],
        ...                            terminal=[False, True], start=0, discount=0.9)
        >>> float(mdp.reward.max())
        5.0
        """
        pairs = dense_pairs(transition, reward)
        every = np.ones(pairs.shape, np.bool_) if available is None else available
        spaces, horizon = (states, actions), (discount, time_limit)
        return cls._of_pairs(pairs, spaces, np.asarray(terminal), start, horizon, every)

    @classmethod
    def from_outcomes(
        cls,
        outcomes: object,
        *,
        start: npt.ArrayLike,
        discount: float,
        terminal: npt.ArrayLike | None = None,
        time_limit: int | None = None,
        states: Space | None = None,
        actions: Space | None = None,
    ) -> Self:
        """Return the MDP of outcome lists.

        Parameters
        ----------
        outcomes : nested sequences or dicts
            ``outcomes[s][a]`` is a list of ``(probability, next_state, reward)``, or of
            ``(probability, next_state, reward, terminated)`` as Gymnasium's toy-text tables
            have it. The list may be empty in terminal states; elsewhere an empty list means that
            the action is not available.
        terminal : (S,) bool array, optional
            Needed unless the outcomes carry ``terminated``.
        start, discount, time_limit, states, actions
            As in :meth:`from_dense`.
        """
        lists, pairs = listed_outcomes(outcomes)
        begins = start_distribution(start, len(lists))
        first = np.flatnonzero(begins).tolist()
        ends = terminal_states(lists, first) if terminal is None else np.asarray(terminal)
        spaces, horizon = (states, actions), (discount, time_limit)
        made = cls._of_pairs(pairs, spaces, ends, begins, horizon)
        terminal_states(lists, first, made.terminal)  # checks the flags where both are given
        return made

    @classmethod
    def from_sparse(cls, transition: Sequence[Any], reward: object, **settings: Any) -> Self:
        """Return the MDP of a matrix for each action, sparse or dense, as pymdptoolbox has them.

        Parameters
        ----------
        transition : sequence of A matrices (S, S)
            P(s' | s) of each action. A row without entries means that the action is not available.
        reward : (S,), (S, A), or sequence of A matrices (S, S)
            Reward on the state that is left; on s, a; or on s, a, s'.
        **settings
            As in :meth:`from_pairs`.

        Raises
        ------
        TaskError
            When shapes do not fit, or a probability, a reward or a setting breaks a rule.

        Examples
        --------
        >>> from scipy.sparse import csr_array
        >>> stay, go = csr_array([[1.0, 0.0], [0.0, 1.0]]), csr_array([[0.1, 0.9], [0.0, 0.0]])
        >>> mdp = FiniteMDP.from_sparse([stay, go], [0.0, 1.0], start=0, discount=0.5)
        >>> mdp.available
        array([[ True,  True],
               [ True, False]])
        """
        return cls.from_pairs(*sparse_pairs(transition, reward), **settings)

    @classmethod
    def from_pairs(
        cls,
        transition: object,
        reward: object,
        s_indices: npt.ArrayLike,
        a_indices: npt.ArrayLike,
        *,
        start: npt.ArrayLike,
        discount: float,
        terminal: npt.ArrayLike | None = None,
        time_limit: int | None = None,
        states: Space | None = None,
        actions: Space | None = None,
    ) -> Self:
        """Return the MDP of a row for each of L pairs (s, a), as QuantEcon's DiscreteDP has them.

        Parameters
        ----------
        transition : (L, S) matrix, sparse or dense
            P(s' | s, a) of each pair. Pairs that are not listed, or whose row has no entry, are not
            available.
        reward : (L,) float array or (L, S) matrix
            Reward on s, a; or on s, a, s'.
        s_indices, a_indices : (L,) int array
            The state and the action of each row.
        start : int or (S,) float array
            The start state, or its distribution.
        terminal : (S,) bool array, optional
            States that end the episode when entered; by default none. Their rows do not count.
        discount, time_limit, states, actions
            As in the class; there are as many actions as the largest index says by default.

        Raises
        ------
        TaskError
            When shapes do not fit, a pair is listed twice, or a probability, a reward or a setting
            breaks a rule.

        Examples
        --------
        >>> mdp = FiniteMDP.from_pairs([[0.5, 0.5], [0, 1], [0, 1]], [5.0, 10.0, -1.0],
        ...                            [0, 0, 1], [0, 1, 0], start=0, discount=0.9)
        >>> mdp.available.tolist(), mdp.reward[1, 0]
        ([[True, True], [True, False]], np.float64(10.0))
        """
        pairs = listed_pairs(transition, reward, s_indices, a_indices, actions)
        ends = np.zeros(pairs.shape[0], np.bool_) if terminal is None else np.asarray(terminal)
        return cls._of_pairs(pairs, (states, actions), ends, start, (discount, time_limit))

    @classmethod
    def _of_pairs(
        cls,
        pairs: Pairs,
        spaces: tuple[Space | None, Space | None],
        terminal: npt.NDArray[Any],
        start: npt.ArrayLike,
        horizon: tuple[float, int | None],
        available: Any = None,
    ) -> Self:
        """Return the MDP of pairs with their outcomes; by default those with any are available."""
        n_states, n_actions = pairs.shape
        states, actions = spaces
        outcome_row, listed, tables = pairs.tables()
        return cls(
            states or Space([Component("state", n_states)]),
            actions or Space([Component("action", n_actions)]),
            outcome_row,
            *tables,
            terminal,
            start_distribution(start, n_states),
            *horizon,
            listed if available is None else available,
        )

    @classmethod
    def one_row_a_pair(
        cls,
        states: Space,
        actions: Space,
        probability: Any,
        next_state: Any,
        reward: Any,
        **settings: Any,
    ) -> Self:
        """Return the MDP in which every pair has an outcome row to itself; tables are (S, A, O)."""
        n_states, n_actions, width = probability.shape
        return cls(
            states,
            actions,
            np.arange(n_states * n_actions).reshape(n_states, n_actions),
            *(array.reshape(-1, width) for array in (probability, next_state, reward)),
            **settings,
        )

    @property
    def mdp(self) -> Self:
        """The task itself, so that a FiniteMDP is a :class:`Task`."""
        return self

    @cached_property
    def model(self) -> Tables | DeterministicTables | Restricted:
        """The generative model for compiled loops."""
        model = learning_model(self)
        if self.available is None:
            return model
        return Restricted(model, AvailableTable(self.available))

    @cached_property
    def cumulative(self) -> FloatArray:
        """Cumulative outcome probabilities, (Y, O) float64; the last possible outcome gets 1."""
        return cumulated(self.probability)

    @cached_property
    def start_cumulative(self) -> FloatArray:
        """Cumulative start distribution over :attr:`start_states`, float64, ending in 1."""
        total = np.cumsum(self.start[self.start_states])
        total[-1] = 1.0
        return frozen(total)

    @cached_property
    def start_states(self) -> IntArray:
        """The states an episode may start in."""
        return frozen(np.flatnonzero(self.start))

    @property
    def random_policy(self) -> FloatArray:
        """The policy that takes each available action equally often, (S, A) float64.

        Examples
        --------
        >>> FiniteMDP.from_outcomes([[[(1.0, 1, 0.0)], []], [[], []]], terminal=[False, True],
        ...                         start=0, discount=0.9).random_policy
        array([[1. , 0. ],
               [0.5, 0.5]])
        """
        if self.available is None:
            return np.full(self.outcome_row.shape, 1 / self.actions.size)
        return np.asarray(self.available / self.available.sum(axis=1, keepdims=True))

    def __repr__(self) -> str:
        return described(self, f"{int(self.terminal.sum())} terminal")


LARGEST_WITH_ROW_PER_PAIR = 100_000
"""Outcomes (S x A x O) up to which every pair gets a row of its own: one read less a step."""


def table_model(mdp: FiniteMDP) -> Tables:
    """Return the tables of a :class:`FiniteMDP` as a generative model."""
    rows = (mdp.outcome_row, mdp.probability, mdp.cumulative, mdp.next_state, mdp.reward)
    row_per_pair = mdp.outcome_row.size * mdp.probability.shape[1] <= LARGEST_WITH_ROW_PER_PAIR
    if row_per_pair:
        row = mdp.outcome_row.ravel()
        pairs = np.arange(row.size, dtype=np.int32).reshape(mdp.outcome_row.shape)
        rows = (frozen(pairs), *(frozen(array[row]) for array in rows[1:]))
    return Tables(row_per_pair, *rows, mdp.terminal, mdp.start_states, mdp.start_cumulative)


def learning_model(mdp: FiniteMDP) -> Tables | DeterministicTables:
    """Return the generative model of a :class:`FiniteMDP` for learning: the fastest that fits."""
    tables = table_model(mdp)
    if not tables.row_per_pair or tables.next_state.shape[1] > 1:
        return tables
    return DeterministicTables(
        np.uint64(mdp.actions.size),
        frozen(tables.next_state.ravel()),
        frozen(tables.reward.ravel()),
        *tables[-3:],
    )


def closed(values: Table, available: BoolArray | None) -> Table:
    """Return values of pairs, (..., S, A), with -inf where an action is not available."""
    if available is None:
        return values
    open_alone: Any = np.where(available, values, -np.inf)
    return open_alone  # type: ignore[no-any-return]


def duplicated(values: Table, available: BoolArray | None) -> Table:
    """Return values, (S, A), in which each unavailable pair has its state's first available one."""
    if available is None:
        return values
    first = available.argmax(axis=1)[:, None]
    copied: Any = np.where(available, values, np.take_along_axis(values, first, axis=1))
    return copied  # type: ignore[no-any-return]


def available_actions(task: object, states: IntArray | None = None) -> BoolArray | None:
    """Return the available actions of n states, by default all, (n, A) bool; None where all are.

    A live task does not know them before it is played.
    """
    rules: Any = generative_model(task)
    if hasattr(rules, "available_rows"):
        return rules.available_rows(states)  # type: ignore[no-any-return]
    listed: BoolArray | None = getattr(rules, "available", None)
    return listed if listed is None or states is None else listed[states]


def live_pairs(task: object) -> BoolArray:
    """Return the pairs of known live states with available actions, (S, A) bool."""
    rules, available = generative_model(task), available_actions(task)
    pairs = np.ones((rules.states.size, rules.actions.size), np.bool_)
    pairs[... if rules.terminal is None else rules.terminal] = rules.terminal is None
    return pairs if available is None else pairs & available


def _adopted(name: str, values: Any, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return a frozen array of this type; TaskError where it is none, or flags are not 0 and 1."""
    try:
        array = adopted(values, dtype)
    except (TypeError, ValueError, OverflowError):
        raise TaskError(
            f"{name} must be an array of numbers: got {type(values).__name__}"
        ) from None
    if dtype == np.bool_ and not np.array_equal(array, values):
        kind = np.asarray(values).dtype
        raise TaskError(f"{name} must be flags, True or False: got other values, of {kind}")
    return array


def normalised(rows: FloatArray) -> FloatArray:
    """Return rows that sum to 1 within the rounding of float32 divided by their sums."""
    with np.errstate(over="ignore"):  # an infinite sum is left as it is, and refused
        sums = rows.sum(axis=-1, keepdims=True)
    error = abs(sums - 1)
    rounded = (error > PROBABILITY_TOLERANCE) & (error <= SINGLE_PRECISION)
    return rows / np.where(rounded, sums, 1.0) if rounded.any() else rows


def check_rows(
    probability: FloatArray,
    reward: FloatArray,
    outcome_row: npt.NDArray[np.integer[Any]],
    terminal: BoolArray,
) -> None:
    """Raise TaskError naming the first pair whose outcome row breaks a rule."""
    sums = probability.sum(axis=1)
    small = (reward >= -LARGEST_REWARD) & (reward <= LARGEST_REWARD)
    rules = (
        ("transition probabilities must sum to 1", abs(sums - 1) <= PROBABILITY_TOLERANCE, sums),
        ("transition probabilities must not be negative", probability >= 0, probability),
        (REWARD_RULE, small, reward),
    )
    for rule, holds, values in rules:
        if holds.all():
            continue
        used = rows_in_use(outcome_row, terminal, len(probability))
        bad = np.flatnonzero(used & ~holds.reshape(len(used), -1).all(axis=1))
        if bad.size:
            state, action = np.argwhere((outcome_row == bad[0]) & ~terminal[:, None])[0]
            value = values[bad[0]]
            has = f"sums to {value:.10g}" if values is sums else f"has {value.tolist()}"
            raise TaskError(f"{rule}: state {state}, action {action} {has}")


# -- tasks -----------------------------------------------------------------------------------------


class Task(Protocol):
    """A task to learn, solve and map: it has spaces and converts to tables."""

    @property
    def states(self) -> Space:
        """The state space, S points."""

    @property
    def actions(self) -> Space:
        """The action space, A points."""

    @property
    def mdp(self) -> FiniteMDP:
        """The task as tables."""


class GenerativeModel(TaskParts, Protocol):
    """A task as learning reads it: spaces, horizon, and a generative model for compiled loops."""

    @property
    def terminal(self) -> BoolArray | None: ...  # noqa: D102
    @property
    def model(self) -> Any: ...  # noqa: D102


def generative_model(task: Any) -> GenerativeModel:
    """Return the task itself if it has a generative model, else its tables."""
    is_model = isinstance(getattr(task, "model", None), tuple)
    generative: GenerativeModel = task if is_model else tables(task)
    return generative


def has_tables(task: object) -> bool:
    """Return whether a task can be converted to tables (if they fit)."""
    return hasattr(type(task), "mdp") or "mdp" in getattr(task, "__dict__", {})


def tables(task: object) -> FiniteMDP:
    """Return the tables of a task, or raise TaskError with the probable intention."""
    mdp = getattr(task, "mdp", None)
    if isinstance(mdp, FiniteMDP):
        return mdp
    if isinstance(getattr(task, "model", None), tuple):
        raise TaskError(
            "a task given by functions or played live has no tables (tabulate makes them of an "
            f"environment with few states): {task!r}"
        )
    advice, kind = "", type(task)
    if isinstance(task, type):
        advice = "; give a task of this class, not the class" if hasattr(task, "mdp") else ""
    elif hasattr(task, "task"):
        advice = ", whose task is its .task"
    elif isinstance(task, str) or (hasattr(task, "reset") and hasattr(task, "step")):
        advice = "; from_gymnasium makes a task of an environment or of its id"
    elif hasattr(kind, "observations") and hasattr(kind, "environment"):
        advice = "; a task seen through observations is learnt by a network, a deep.DeepLearner"
    raise TaskError(f"a task must be a FiniteMDP or have its tables as .mdp: got {task!r}{advice}")


def same_task(task: Task, other: Task) -> bool:
    """Return whether two tasks are the same: one object, or equal values."""
    return task is other or task == other
