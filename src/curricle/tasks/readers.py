"""Tables of MDPs as people have them: all readers make pairs (s, a) with their outcomes.

Dense arrays, a matrix for each action (pymdptoolbox), a row for each pair (QuantEcon) and outcome
lists (Gymnasium's toy-text tasks). :class:`FiniteMDP` checks what they mean.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import brief, indices, numbers
from curricle.errors import TaskError
from curricle.tasks.models import flag_of
from curricle.tasks.spaces import Space

MOST_ACTIONS = 2**15  # an action of a larger number is a mistake, where most are not listed


class Pairs(NamedTuple):
    """L pairs (s, a) of S states and A actions, and their n outcomes, one pair after the other."""

    shape: tuple[int, int]  # S and A
    state: IntArray  # (L,)
    action: IntArray  # (L,)
    outcomes: IntArray  # (L,) how many of each pair
    probability: FloatArray  # (n,)
    next_state: IntArray  # (n,)
    reward: FloatArray  # (n,)

    def tables(
        self,
    ) -> tuple[IntArray, BoolArray, tuple[FloatArray, IntArray, FloatArray]]:
        """Return the row of each pair, which pairs have outcomes, (S, A), and p, s', r, (L, O)."""
        rows, listed = np.zeros(self.shape, np.int64), np.zeros(self.shape, np.bool_)
        rows[self.state, self.action] = np.arange(len(self.outcomes))
        listed[self.state, self.action] = self.outcomes > 0
        row = np.repeat(np.arange(len(self.outcomes)), self.outcomes)
        place = np.arange(len(row)) - (np.cumsum(self.outcomes) - self.outcomes)[row]
        shape = len(self.outcomes), max(1, int(self.outcomes.max(initial=0)))
        p, after, r = np.zeros(shape), np.zeros(shape, np.int64), np.zeros(shape)
        p[row, place], after[row, place], r[row, place] = self[-3:]
        return rows, listed, (p, after, r)


def dense_pairs(transition: npt.ArrayLike, reward: npt.ArrayLike) -> Pairs:
    """Return the pairs of P(s' | s, a), (S, A, S), and rewards of one to three dimensions."""
    p = numbers("transition", transition, TaskError)
    if p.ndim != 3 or p.shape[0] != p.shape[2] or not p.size:
        raise TaskError(f"transition must have shape (S, A, S): got {p.shape}")
    r = numbers("reward", reward, TaskError)
    if r.shape not in (p.shape, p.shape[:2], p.shape[:1]):
        raise TaskError(
            f"reward must have shape {p.shape}, {p.shape[:2]} or {p.shape[:1]}: got {r.shape}"
        )
    r = np.broadcast_to(r.reshape(r.shape + (1,) * (3 - r.ndim)), p.shape)
    n_states, n_actions, _ = p.shape
    state, action, after = np.nonzero(p)
    count = np.bincount(state * n_actions + action, minlength=n_states * n_actions)
    pairs = np.divmod(np.arange(n_states * n_actions), n_actions)
    return Pairs((n_states, n_actions), *pairs, count, p[p != 0], after, r[p != 0])


def sparse_pairs(transition: object, reward: object) -> tuple[Any, Any, IntArray, IntArray]:
    """Return matrices of all actions below each other, their rewards, and each row's pair."""
    from scipy.sparse import issparse, vstack

    listed = Sequence, np.ndarray
    of_actions = [*map(_sparse, transition)] if isinstance(transition, listed) else []
    n_states, n_actions = of_actions[0].shape[0] if of_actions else 0, len(of_actions)
    square = [(n_states, n_states)] * n_actions
    if not n_states or [matrix.shape for matrix in of_actions] != square:
        raise TaskError(
            "transition must be a matrix (S, S) for each action: got "
            f"{[matrix.shape for matrix in of_actions] or brief(transition)}"
        )
    s, a = np.tile(np.arange(n_states), n_actions), np.repeat(np.arange(n_actions), n_states)
    if isinstance(reward, listed) and any(issparse(part) or np.ndim(part) == 2 for part in reward):
        parts = [_sparse(part, "reward") for part in reward]
        shape: Any = [part.shape for part in parts]
        rewards = vstack(parts, format="csr") if shape == square else None
    else:
        table = numbers("reward", reward, TaskError)
        fits = (shape := table.shape) in ((n_states,), (n_states, n_actions))
        rewards = table[(s, a)[: table.ndim]] if fits else None
    if rewards is None:
        raise TaskError(
            f"reward must have shape {(n_states,)} or {(n_states, n_actions)}, or a matrix "
            f"{square[0]} for each action: got {shape}"
        )
    return vstack(of_actions, format="csr"), rewards, s, a


def listed_pairs(
    transition: object,
    reward: Any,
    s_indices: npt.ArrayLike,
    a_indices: npt.ArrayLike,
    actions: Space | None,
) -> Pairs:
    """Return the pairs of a row of P(s' | s, a) each, (L, S), which name their state and action."""
    p = _sparse(transition)
    (n_rows, n_states), count = p.shape, np.diff(p.indptr)
    s = indices("s_indices", s_indices, n_states, TaskError)
    most = max(n_rows, MOST_ACTIONS) if actions is None else actions.size
    a = indices("a_indices", a_indices, most, TaskError)
    if not (s.shape == a.shape == (n_rows,) and n_rows):
        raise TaskError(
            f"s_indices and a_indices must have shape {(n_rows,)}, an entry for each row of "
            f"transition, at least one: got {s.shape} and {a.shape}"
        )
    row = np.repeat(np.arange(n_rows), count)
    if np.ndim(reward) == 2:
        paid = _sparse(reward, "reward")
        if paid.shape != p.shape:
            raise TaskError(f"reward must have shape {p.shape}: got {paid.shape}")
        rewards = np.asarray(paid[row, p.indices]).ravel()
    else:
        of_rows = numbers("reward", reward, TaskError)
        if of_rows.shape != (n_rows,):
            raise TaskError(f"reward must have shape {(n_rows,)}: got {of_rows.shape}")
        rewards = of_rows[row]
    shape = n_states, int(a.max()) + 1 if actions is None else actions.size
    named, times = np.unique(s * shape[1] + a, return_counts=True)
    if times.max() > 1:
        state, action = divmod(int(named[times > 1][0]), shape[1])
        raise TaskError(
            f"a pair must have one row: state {state}, action {action} has {times[times > 1][0]}"
        )
    return Pairs(shape, s, a, count, p.data, p.indices, rewards)


def _sparse(matrix: object, name: str = "transition") -> Any:
    """Return a matrix in SciPy's compressed rows, without zeros; TaskError where it is none."""
    from scipy.sparse import csr_matrix  # of which an index by arrays gives an array

    try:
        rows = csr_matrix(matrix, dtype=np.float64, copy=True)
    except (TypeError, ValueError):
        raise TaskError(f"{name} must be a matrix of numbers: got {brief(matrix)}") from None
    rows.sum_duplicates()
    rows.eliminate_zeros()
    return rows


def start_distribution(start: npt.ArrayLike, n_states: int) -> FloatArray:
    """Return the (S,) start distribution for a start state or a distribution."""
    begins = numbers("start", start, TaskError)
    if begins.ndim == 0 and np.issubdtype(np.asarray(start).dtype, np.integer):
        if not 0 <= begins < n_states:
            raise TaskError(f"the start state must lie in 0..{n_states - 1}: got {int(begins)}")
        return np.asarray(np.arange(n_states) == begins, dtype=np.float64)
    if begins.shape != (n_states,):
        raise TaskError(f"start must be a state or have shape ({n_states},): got {begins.shape}")
    return begins


def listed_outcomes(outcomes: Any) -> tuple[list[list[Any]], Pairs]:
    """Return outcomes as lists, [state][action], and the pairs that they make."""
    try:
        lists = [
            [list(outcomes[s][a]) for a in range(len(outcomes[s]))] for s in range(len(outcomes))
        ]
    except (TypeError, IndexError):
        raise TaskError(
            f"outcomes must be lists, outcomes[state][action]: got {brief(outcomes)}"
        ) from None
    except KeyError as missing:
        raise TaskError(
            f"states and actions of outcome dicts must be numbered from 0: {missing} is missing"
        ) from None
    if not lists or not lists[0]:
        raise TaskError(
            "outcomes need at least one state, and one action in each (without outcomes if it is "
            f"terminal): got {'no action in state 0' if lists else 'no state'}"
        )
    shape = len(lists), len(lists[0])
    flat = list[tuple[float, np.int64, float]]()
    for s, row in enumerate(lists):
        if len(row) != shape[1]:
            raise TaskError(
                f"every state must list the same number of actions: state {s} lists {len(row)}, "
                f"state 0 lists {shape[1]}"
            )
        for a, outcome in ((a, outcome) for a, pair in enumerate(row) for outcome in pair):
            try:
                probability, after, reward = outcome[:3]
                flat.append((float(probability), np.int64(after), float(reward)))
                fits = len(outcome) in (3, 4) and after == flat[-1][1]
            except (TypeError, ValueError, OverflowError, IndexError):
                fits = False
            if not fits:
                raise TaskError(
                    "an outcome must be (probability, next state, reward) and may have a "
                    f"terminated flag: state {s}, action {a} has {brief(outcome)}"
                )
            if not 0 <= after < len(lists):
                raise TaskError(
                    f"next states must lie in 0..{len(lists) - 1}: state {s}, action {a} has "
                    f"{brief(outcome)}"
                )
    count = np.array([len(pair) for row in lists for pair in row])
    columns = [np.array(column) for column in zip(*flat, strict=True)]
    pairs = np.divmod(np.arange(len(count)), shape[1])
    return lists, Pairs(shape, *pairs, count, *(columns or np.zeros((3, 0))))


def terminal_states(
    lists: list[list[Any]], first: list[int], declared: BoolArray | None = None
) -> BoolArray:
    """Return the ``terminated`` flags of outcome lists, one a state, as `declared`."""
    # Only states that can be reached from the `first` count: tables such as Taxi's also list
    # impossible states, whose flags contradict the others.
    flags = {} if declared is None else dict(enumerate(declared.tolist()))
    reached, waiting = set(first), list(first)
    for s in waiting:  # which grows meanwhile
        for a, pair in enumerate(lists[s]):
            for outcome in pair:
                if len(outcome) < 4 and declared is None:
                    raise TaskError(
                        "outcomes need a terminated flag where no terminal array is given: state "
                        f"{s}, action {a} has {outcome}"
                    )
                probability, after, _, ended = (*outcome, flags.get(outcome[1]))[:4]
                if probability == 0:
                    continue
                place = f": state {s}, action {a}"
                ended = bool(ended) if len(outcome) < 4 else flag_of(ended, "terminated", place)
                if not ended and after not in reached:
                    reached.add(after)
                    waiting.append(int(after))
                if flags.setdefault(after, ended) != ended:
                    raise TaskError(
                        "entering a state must end the episode always or never, as terminal has "
                        f"it where it is given: state {after} does both, at last from state {s}, "
                        f"action {a}"
                    )
    return np.array([flags.get(s, False) for s in range(len(lists))])
