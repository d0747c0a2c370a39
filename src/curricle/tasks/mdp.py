"""Finite Markov decision processes as frozen tables.

Pairs (s, a) with the same outcome distribution share a *row*: ``outcome_row[s, a]`` is one of Y
rows, and each row lists up to O outcomes with probability, successor and reward. This keeps domains
small whose moves are deterministic except for one random part (a maze: Y = 2 S; pursuit: Y = S,
O = moves of the prey); an arbitrary MDP has Y = S A.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, adopted, frozen
from curricle.checks import instance, number, numbers, whole_number
from curricle.errors import TaskError
from curricle.tasks.generative_models import (
    DeterministicTables,
    Tables,
    cumulated,
    learning_model,
)
from curricle.tasks.outcomes import (
    PROBABILITY_TOLERANCE,
    check_rows,
    normalised,
    outcome_lists,
    outcome_tables,
    terminal_states,
)
from curricle.tasks.spaces import Component, Space, whole_by_type
from curricle.text import counted


def edges_of(mdp: Any, allowed: BoolArray | None = None) -> tuple[IntArray, IntArray]:
    """Return where the edges of a graph of S states and Y outcome rows begin and end.

    A state leads to the rows of its `allowed` actions, none where it is terminal, and a row, whose
    node is S plus its number, to the states of its outcomes.
    """
    pairs = np.repeat(~mdp.terminal[:, None], mdp.outcome_row.shape[1], axis=1)
    if allowed is not None:
        pairs &= allowed
    state, _ = np.nonzero(pairs)
    row, outcome = np.nonzero(mdp.probability > 0)
    n_states = len(mdp.terminal)
    source = np.concatenate([state, n_states + row])
    return source, np.concatenate([n_states + mdp.outcome_row[pairs], mdp.next_state[row, outcome]])


def reachable_states(mdp: Any, allowed: BoolArray | None = None) -> BoolArray:
    """Return which states the `allowed` actions can reach from the start, (S,) bool."""
    # Imported here: every task is checked by this module, and the import takes a third of a second.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    # One more node leads to all first states.
    root, first = len(mdp.terminal) + len(mdp.probability), np.flatnonzero(mdp.start > 0)
    source, target = edges_of(mdp, allowed)
    source, target = np.append(source, np.full(len(first), root)), np.append(target, first)
    edges = np.ones(len(source), np.bool_), (source, target)
    graph = csr_array(edges, shape=(root + 1, root + 1))
    met = np.zeros(root + 1, dtype=bool)
    met[breadth_first_order(graph, root, return_predecessors=False)] = True
    return met[: len(mdp.terminal)]


def improper_states(mdp: Any, allowed: BoolArray | None = None) -> IntArray:
    """Return the states from which `allowed` actions can avoid all terminal states for ever.

    This is the largest set of states each of which has an allowed action whose every outcome stays
    in the set. It is empty exactly if every allowed policy is proper, which is to end with
    probability 1 (Bertsekas, Tsitsiklis 1991).
    """
    staying = ~mdp.terminal
    impossible = mdp.probability == 0
    while True:
        row_stays = (staying[mdp.next_state] | impossible).all(axis=1)
        pair_stays = row_stays[mdp.outcome_row]
        if allowed is not None:
            pair_stays &= allowed
        remains = staying & pair_stays.any(axis=1)
        if (remains == staying).all():
            return np.flatnonzero(staying)
        staying = remains


def steps_to(mdp: Any, goal: BoolArray, among: BoolArray | None = None) -> FloatArray:
    """Return the fewest steps with which each of some states may reach `goal`, (S,); or infinity.

    Both are (S,) bool; `among` is all states by default, and no way leads through others.
    """
    among = np.ones(len(goal), bool) if among is None else among
    steps = np.where(goal & among, 0.0, np.inf)
    while True:
        after = np.where(mdp.probability > 0, steps[mdp.next_state], np.inf).min(axis=1)
        nearer = np.minimum(steps, 1 + after[mdp.outcome_row].min(axis=1))
        nearer[~among] = np.inf
        if (nearer == steps).all():
            return steps
        steps = nearer


# -- tables ----------------------------------------------------------------------------------------


LONGEST = 10**12
"""Steps that a time limit may have at most."""
NO_LIMIT = np.int64(2**62)
"""Steps that stand for no limit in compiled loops."""


@dataclass(frozen=True, eq=False)
class FiniteMDP(Frozen):
    """A finite MDP with a start distribution, a discount and a time limit; validated and frozen.

    Use :meth:`from_dense` or :meth:`from_outcomes` unless you have the compact form.

    Parameters
    ----------
    states, actions : Space
        S states and A actions.
    outcome_row : (S, A) int32
        The outcome row of each pair, in 0 .. Y-1; those of terminal states are never used.
    probability : (Y, O) float64
        Outcome probabilities; rows (pad short rows with probability 0) sum to 1, within 1e-8, or
        within 1e-6, as float32 does, and are divided by their sums.
    next_state : (Y, O) int32
        Successor of each outcome.
    reward : (Y, O) float64
        Reward of each outcome, so that it may depend on s, a and s'.
    terminal : (S,) bool
        States that end the episode when entered; their value is 0.
    start : (S,) float64
        Probability of starting in each state; 0 in terminal states.
    discount : float
        In [0, 1]; 1 only where a way leads to an end from every state, or a time limit is set.
    time_limit : int, optional
        Steps after which an episode is truncated. This is not termination: learners bootstrap.

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

    def __post_init__(self) -> None:
        self._check_ranges()
        self._adopt_arrays()
        check_rows(self.probability, self.reward, self.outcome_row, self.terminal)
        self._check_start()
        self._check_discount()

    # -- constructors --------------------------------------------------------------------------

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
    ) -> Self:
        """Return the MDP given by dense arrays.

        Parameters
        ----------
        transition : (S, A, S) float array
            P(s' | s, a).
        reward : (S, A, S), (S, A) or (S,) float array
            Reward on s, a, s'; on s, a; or on the state that is left.
        terminal : (S,) bool array
        start : int or (S,) float array
            The start state, or its distribution.
        discount, time_limit, states, actions
            As in the class; spaces default to one component ``state`` and one ``action``.

        Examples
        --------
        >>> mdp = FiniteMDP.from_dense([[[0.0, 1.0]], [[0.0, 1.0]]], [[5.0], [0.0]],
        ...                            terminal=[False, True], start=0, discount=0.9)
        >>> float(mdp.reward.max())
        5.0
        """
        p = numbers("transition", transition, TaskError)
        if p.ndim != 3 or p.shape[0] != p.shape[2] or not p.size:
            raise TaskError(f"transition must have shape (S, A, S): got {p.shape}")
        n_states, n_actions, _ = p.shape
        r = numbers("reward", reward, TaskError)
        if r.shape not in (p.shape, p.shape[:2], p.shape[:1]):
            raise TaskError(
                f"reward must have shape {p.shape}, {p.shape[:2]} or {p.shape[:1]}: got {r.shape}"
            )
        r = np.broadcast_to(r.reshape(r.shape + (1,) * (3 - r.ndim)), p.shape)
        flat_p, flat_r = p.reshape(-1, n_states), r.reshape(-1, n_states)
        width = max(1, int((flat_p != 0).sum(axis=1).max(initial=0)))
        # The nonzero outcomes of each pair, first to last: a stable sort puts them in front.
        successor = np.argsort(flat_p == 0, axis=1, kind="stable")[:, :width]
        return cls._one_row_a_pair(
            np.take_along_axis(flat_p, successor, axis=1).reshape(n_states, n_actions, width),
            successor,
            np.take_along_axis(flat_r, successor, axis=1),
            terminal=np.asarray(terminal),
            start=start_distribution(start, n_states),
            discount=discount,
            time_limit=time_limit,
            states=states,
            actions=actions,
        )

    @classmethod
    def from_outcomes(
        cls,
        outcomes: Any,
        *,
        start: npt.ArrayLike,
        discount: float,
        terminal: npt.ArrayLike | None = None,
        time_limit: int | None = None,
        states: Space | None = None,
        actions: Space | None = None,
    ) -> Self:
        """Return the MDP given by outcome lists.

        Parameters
        ----------
        outcomes : nested sequences or dicts
            ``outcomes[s][a]`` is a list of ``(probability, next_state, reward)``, or of
            ``(probability, next_state, reward, terminated)`` as Gymnasium's toy-text tables
            have it. The list may be empty in terminal states.
        terminal : (S,) bool array, optional
            Needed unless the outcomes carry ``terminated``.
        start, discount, time_limit, states, actions
            As in :meth:`from_dense`.

        Examples
        --------
        >>> mdp = FiniteMDP.from_outcomes([[[(1.0, 1, 2.0, True)]], [[]]], start=0, discount=1.0)
        >>> mdp.terminal
        array([False,  True])
        """
        lists = outcome_lists(outcomes)
        begins = start_distribution(start, len(lists))
        if terminal is None:
            terminal = terminal_states(lists, np.flatnonzero(begins).tolist())
        return cls._one_row_a_pair(
            *outcome_tables(lists),
            terminal=np.asarray(terminal),
            start=begins,
            discount=discount,
            time_limit=time_limit,
            states=states,
            actions=actions,
        )

    @classmethod
    def _one_row_a_pair(
        cls,
        probability: FloatArray,
        next_state: npt.NDArray[Any],
        reward: FloatArray,
        *,
        states: Space | None,
        actions: Space | None,
        **rest: Any,
    ) -> Self:
        """Build the MDP in which every pair has an outcome row of its own, (S, A, O) tables."""
        n_states, n_actions, width = probability.shape
        return cls(
            states=states or Space([Component("state", n_states)]),
            actions=actions or Space([Component("action", n_actions)]),
            outcome_row=np.arange(n_states * n_actions).reshape(n_states, n_actions),
            probability=probability.reshape(-1, width),
            next_state=next_state.reshape(-1, width),
            reward=reward.reshape(-1, width),
            **rest,
        )

    # -- validation ----------------------------------------------------------------------------

    def _check_ranges(self) -> None:
        """Check indices as they were given, before they are narrowed to 32 bits."""
        instance("states", self.states, Space, TaskError)
        instance("actions", self.actions, Space, TaskError)
        if np.ndim(self.probability) != 2:
            raise TaskError(f"probability must have shape (Y, O): got {np.shape(self.probability)}")
        for name, what, size in (
            ("outcome_row", "outcome_row", len(self.probability)),
            ("next_state", "next states", self.states.size),
        ):
            given = whole_by_type(getattr(self, name), what)
            if given.size and (given.min() < 0 or given.max() >= size):
                raise TaskError(
                    f"{what} must lie in 0..{size - 1}: got {given.min()}..{given.max()}"
                )

    def _adopt_arrays(self) -> None:
        """Make the arrays frozen ones of the right type, and check their shapes."""
        one_a_state, table = (self.states.size,), np.shape(self.probability)
        for name, dtype, shape in (
            ("outcome_row", np.int32, (self.states.size, self.actions.size)),
            ("probability", np.float64, table),
            ("next_state", np.int32, table),
            ("reward", np.float64, table),
            ("terminal", np.bool_, one_a_state),
            ("start", np.float64, one_a_state),
        ):
            array = _adopted(name, getattr(self, name), dtype)
            if array.shape != shape:
                raise TaskError(f"{name} must have shape {shape}: got {array.shape}")
            if name in ("probability", "start"):
                array = frozen(normalised(array))
            object.__setattr__(self, name, array)

    def _check_start(self) -> None:
        bad = np.flatnonzero(~(np.isfinite(self.start) & (self.start >= 0)))
        if bad.size:
            raise TaskError(
                "start probabilities must be finite and not negative: state "
                f"{bad[0]} has {self.start[bad[0]]}"
            )
        if abs(self.start.sum() - 1) > PROBABILITY_TOLERANCE:
            raise TaskError(f"start probabilities must sum to 1: they sum to {self.start.sum()}")
        bad = np.flatnonzero((self.start > 0) & self.terminal)
        if bad.size:
            raise TaskError(
                f"an episode must not start in a terminal state: state {bad[0]} has start "
                f"probability {self.start[bad[0]]:g}"
            )

    def _check_discount(self) -> None:
        check_horizon(self)
        if self.discount == 1 and self.time_limit is None:
            endless = np.flatnonzero(np.isinf(steps_to(self, self.terminal)))
            if endless.size:
                raise TaskError(
                    "discount 1 needs a time limit or a way to an end from every state: none leads "
                    f"there from state {endless[0]}"
                )

    # -- derived -------------------------------------------------------------------------------

    @property
    def mdp(self) -> Self:
        """The task itself, so that a FiniteMDP is a :class:`Task`."""
        return self

    @cached_property
    def model(self) -> Tables | DeterministicTables:
        """The generative model for compiled loops."""
        return learning_model(self)

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

    def __repr__(self) -> str:
        return described(self, f"{int(self.terminal.sum())} terminal")


def described(task: Any, *parts: str) -> str:
    """Return a task as text: its kind, its sizes, further parts and its horizon."""
    sizes = counted(task.states.size, "state"), counted(task.actions.size, "action")
    limit = "no time limit" if task.time_limit is None else f"time limit {task.time_limit}"
    known = ", ".join((*sizes, *parts, f"discount {task.discount:g}", limit))
    return f"{type(task).__name__}({known})"


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


def check_parts(task: Any, kind: str, *functions: str) -> None:
    """Check the spaces, functions and horizon of a task without tables, `kind` of which it is."""
    instance("states", task.states, Space, TaskError)
    instance("actions", task.actions, Space, TaskError)
    for name in functions:
        if not callable(getattr(task, name)):
            raise TaskError(f"{name} must be a function: got {getattr(task, name)!r}")
    check_horizon(task)
    if task.discount == 1 and task.time_limit is None:
        raise TaskError(f"a {kind} task with discount 1 needs a time limit: none set")


def check_horizon(task: Any) -> None:
    """Check a frozen task's discount and time limit, and make them a float and an int."""
    discount = number("discount", task.discount, TaskError, low=0, high=1)
    object.__setattr__(task, "discount", discount)
    if task.time_limit is not None:
        limit = whole_number("time_limit in steps", task.time_limit, 1, TaskError)
        number("time_limit in steps", limit, TaskError, high=LONGEST)
        object.__setattr__(task, "time_limit", limit)


def start_distribution(start: npt.ArrayLike, n_states: int) -> FloatArray:
    """Return the (S,) start distribution for a start state or a distribution."""
    given = np.asarray(start)
    if given.ndim == 0 and np.issubdtype(given.dtype, np.integer):
        if not 0 <= given < n_states:
            raise TaskError(f"the start state must lie in 0..{n_states - 1}: got {given}")
        distribution = np.zeros(n_states)
        distribution[given] = 1.0
        return distribution
    if given.shape != (n_states,):
        raise TaskError(f"start must be a state or have shape ({n_states},): got {given.shape}")
    return given.astype(np.float64)
