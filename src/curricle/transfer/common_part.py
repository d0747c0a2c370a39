"""The common part of two deterministic tasks, grown from a transition that is rare in both.

A maze and a crop of it do not correspond exactly: at the crop's edge a move that goes on in the
maze stays. The search grows a common subgraph from one pair of states that stand for each other,
along transitions with equal rewards; each state is used once. It first matches moves to states of
the part, then the move whose next states have the most rewards in common.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from curricle.arrays import BoolArray, IntArray
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.text import counted
from curricle.transfer.bisimulation import joint_models, levels
from curricle.transfer.mapping import UNMAPPED, pair_mapping
from curricle.transfer.pair import Proposal, TaskPair

LARGEST = 50_000  # state-action pairs of a task
LARGEST_SOURCE = 250  # states of a source; growing a part takes time with their square
MOST_BEGINNINGS = 64  # pairs of states from which a part is grown
WORK = 300_000  # parts that are grown at most, times the square of the source's states
STAYS = -1
KEPT = 30  # parts that are proposed, the largest first
RESTARTS = 16
"""Parts that are grown from each beginning; guesses that are about as likely are drawn."""
TIES = 0.9  # rewards that do not count when guesses are compared


@dataclass(frozen=True, eq=False)
class Moves:
    """A deterministic task."""

    after: IntArray  # (S, A) next states; `STAYS` where it is the same
    reward: IntArray  # (S, A) numbers of rewards, equal in both tasks where the rewards are
    terminal: BoolArray  # (S,)
    around: tuple[Counter[int], ...]  # the rewards of each state's moves that go elsewhere


@dataclass(eq=False)
class Part:
    """A common part while it grows."""

    target: Moves
    source: Moves
    rng: np.random.Generator
    state: dict[int, int] = field(default_factory=dict)  # the source's for the target's
    of: dict[int, int] = field(default_factory=dict)  # the other way round
    move: dict[tuple[int, int], int] = field(default_factory=dict)  # (s, a) -> b
    taken: set[tuple[int, int]] = field(default_factory=set)  # (u, b)
    size: int = 0  # moves that correspond, less those of the source that should and do not

    def grow(self, s: int, u: int) -> None:
        """Grow the part from a pair of states."""
        self.state[s], self.of[u] = u, s
        unsettled = [(s, u)]
        while unsettled:
            met = self._match(unsettled, guess=False)
            if met is None:
                met = self._match(unsettled, guess=True)
            if met is None:
                met = self._enclosed()
            for to, there in met:
                self.state[to], self.of[there] = there, to
            unsettled += met
        wrong = sum(
            (u, b) not in self.taken and there != STAYS
            for u in self.of
            for b, there in enumerate(self.source.after[u])
        )
        self.size = len(self.move) - wrong

    def _match(self, unsettled: list[tuple[int, int]], guess: bool) -> list[tuple[int, int]] | None:
        """Match a move to a known state, or a guess; return the new pairs, or None."""
        best = None
        for s, u in list(unsettled):
            open_moves = False
            for b in range(self.source.after.shape[1]):
                if (u, b) in self.taken:
                    continue
                fits = [a for a in range(self.target.after.shape[1]) if self._fits(s, a, u, b)]
                open_moves |= bool(fits)
                to = {int(self.target.after[s, a]) for a in fits}
                known = (self._ends(there) or there in self.state for there in to)
                if len(to) == 1 and all(known):  # all that fit lead to a state of the part
                    return self._take(s, fits[0], u, b)
                for a in fits if guess else ():
                    likely = self._likely(s, a, u, b), -len(fits)
                    if best is None or likely > best[0]:
                        best = likely, (s, a, u, b)
            if not open_moves:
                unsettled.remove((s, u))
        return None if best is None else self._take(*best[1])

    def _enclosed(self) -> list[tuple[int, int]]:
        """Return two new states that several pairs lead to, at other rewards; none if in doubt."""
        votes = Counter[tuple[int, int]]()
        for s, u in self.state.items():
            ahead = [
                {int(to) for to in task.after[at] if to != STAYS and not task.terminal[to]} - known
                for task, at, known in (
                    (self.target, s, self.state.keys()),
                    (self.source, u, self.of.keys()),
                )
            ]
            votes.update((to, there) for to in ahead[0] for there in ahead[1])
        best = votes.most_common(2)
        counts = [count for _, count in best]
        clear = counts and counts[0] > 1 and counts[1:] != counts[:1]
        return [best[0][0]] if clear else []

    def _ends(self, to: int) -> bool:
        """Return whether a move of the target goes no further: it stays, or ends the episode."""
        return to == STAYS or bool(self.target.terminal[to])

    def _fits(self, s: int, a: int, u: int, b: int) -> bool:
        """Return whether a move may stand for another."""
        if (s, a) in self.move or self.target.reward[s, a] != self.source.reward[u, b]:
            return False
        to, there = int(self.target.after[s, a]), int(self.source.after[u, b])
        if STAYS in (to, there):
            return to == there
        if self.target.terminal[to] or self.source.terminal[there]:
            return bool(self.target.terminal[to] and self.source.terminal[there])
        return self.state.get(to, there) == there and self.of.get(there, to) == to

    def _likely(self, s: int, a: int, u: int, b: int) -> float:
        """Return the share of rewards that the next states have in common."""
        to, there = int(self.target.after[s, a]), int(self.source.after[u, b])
        if self._ends(to):
            return 0.0
        ahead, source_ahead = self.target.around[to], self.source.around[there]
        shared = sum((ahead & source_ahead).values()) - sum((source_ahead - ahead).values())
        return shared + TIES * self.rng.random()

    def _take(self, s: int, a: int, u: int, b: int) -> list[tuple[int, int]]:
        """Match a move; return the states that it leads to, if they are new."""
        self.move[s, a] = b
        self.taken.add((u, b))
        to, there = int(self.target.after[s, a]), int(self.source.after[u, b])
        return [] if self._ends(to) or to in self.state else [(to, there)]


def by_common_part(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mappings of the largest common parts found in two deterministic tasks.

    In the states of a part, target moves without a counterpart, such as moves over the edge of a
    crop, read the source's moves that no other move reads.

    Raises
    ------
    MappingError
        When a task is random, has more than 50,000 pairs, or is a source of more than 250 states;
        or when no reward is in common.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld(["S.P.", ".F..", "...T"])
    >>> crop = maze.crop(rows=(1, 3), columns=(2, 4))
    >>> next(by_common_part(TaskPair(maze, crop))).how
    'common part: 2 states, grown from a transition that is rare in both'
    """
    for mdp in (tasks.target_mdp, tasks.source_mdp):
        if ((mdp.probability > 0).sum(axis=1) > 1).any():
            raise MappingError("a common part is grown in deterministic tasks: one is random")
        if mdp.outcome_row.size > LARGEST:
            raise MappingError(
                f"a common part is grown in tasks of up to {LARGEST:,} pairs: one has "
                f"{mdp.outcome_row.size:,}"
            )
    n_states = tasks.source_mdp.states.size
    if n_states > LARGEST_SOURCE:
        raise MappingError(
            f"a common part is grown for sources of up to {LARGEST_SOURCE} states: got {n_states}"
        )
    target, source = _moves(tasks)
    rng = np.random.default_rng(tasks.seed)
    times = WORK // n_states**2
    parts: dict[frozenset[tuple[int, int]], Part] = {}
    for s, u in _beginnings(target, source)[: max(4, times // RESTARTS)]:
        for _ in range(RESTARTS):
            part = Part(target, source, rng)
            part.grow(s, u)
            states = frozenset(part.state.items())
            if states not in parts or part.size > parts[states].size:
                parts[states] = part
    if not parts:
        raise MappingError("the tasks have no reward in common")
    for part in sorted(parts.values(), key=lambda part: -part.size)[:KEPT]:
        yield _proposal(tasks, part)


def _moves(tasks: TaskPair) -> tuple[Moves, Moves]:
    """Return both tasks, their rewards numbered together."""
    target, source = tasks.target_mdp, tasks.source_mdp
    rewards = levels(np.concatenate([model.mean_reward for model in joint_models(tasks)]))
    of_rows = np.split(rewards, [len(target.probability)])

    def moves(mdp: FiniteMDP, of_row: IntArray) -> Moves:
        likely = mdp.probability.argmax(axis=1)[:, None]
        after = np.take_along_axis(mdp.next_state, likely, axis=1)[:, 0][mdp.outcome_row]
        after = np.where(after == np.arange(len(after))[:, None], STAYS, after).astype(np.int64)
        reward = of_row[mdp.outcome_row]
        around = (row[to != STAYS].tolist() for row, to in zip(reward, after, strict=True))
        return Moves(after, reward, mdp.terminal, tuple(map(Counter, around)))

    return moves(target, of_rows[0]), moves(source, of_rows[1])


def _beginnings(target: Moves, source: Moves) -> list[tuple[int, int]]:
    """Return pairs of states with a transition of a reward that is rare, the rarest first."""
    going = [(task.after != STAYS) & ~task.terminal[:, None] for task in (target, source)]
    counts, other_counts = (
        Counter(task.reward[moves].tolist())
        for task, moves in zip((target, source), going, strict=True)
    )
    common = sorted(set(counts) & set(other_counts), key=lambda r: counts[r] * other_counts[r])
    pairs: dict[tuple[int, int], None] = {}
    for reward in common:
        states, source_states = (
            np.flatnonzero(((task.reward == reward) & moves).any(axis=1)).tolist()
            for task, moves in zip((target, source), going, strict=True)
        )
        pairs |= dict.fromkeys(product(states, source_states))
        if len(pairs) >= MOST_BEGINNINGS:
            break
    return list(pairs)[:MOST_BEGINNINGS]


def _left_over(part: Part, s: int, a: int, u: int, left: list[int]) -> int | None:
    """Take and return one of the source's moves left for a move without a counterpart."""
    to = int(part.target.after[s, a])
    for b in left:
        there = int(part.source.after[u, b])
        if there == STAYS:
            fits = to not in part.state
        elif part.source.terminal[there]:
            fits = to != STAYS and bool(part.target.terminal[to])
        else:
            fits = part.state.get(to) == there
        if fits:
            left.remove(b)
            return b
    return None


def _proposal(tasks: TaskPair, part: Part) -> Proposal:
    """Return the mapping of a part."""
    n_actions, n_others = part.target.after.shape[1], part.source.after.shape[1]
    state, action = np.full((2, *part.target.after.shape), UNMAPPED)
    for s, u in part.state.items():
        left = [b for b in range(n_others) if (u, b) not in part.taken]
        for a in range(n_actions):
            b = part.move.get((s, a))
            if b is None:
                b = _left_over(part, s, a, u, left)
            if b is not None:
                state[s, a], action[s, a] = u, b
    index = pair_mapping(tasks.target_mdp, tasks.source_mdp, state, action).index
    size = counted(len(part.state), "state")
    how = f"common part: {size}, grown from a transition that is rare in both"
    return tasks.proposal(index, how)
