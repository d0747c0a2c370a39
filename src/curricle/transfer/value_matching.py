"""Matching the values of two tasks' components, when neither names nor numbers say which is which.

Values are coloured, of states and actions, in both tasks together: at first alike, then by all
pairs in which they occur, each described by the colours of its values, of its next state's values
and their chances. This is colour refinement (Weisfeiler, Leman 1968) on the factored dynamics.
Where a symmetry leaves values alike, one of each task is singled out and refinement goes on (McKay,
Piperno 2014); at the end every value of the one task has the colour of one value of the other.
"""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray, IntArray
from curricle.transfer.partition_refinement import levels, merged_outcomes, numbered_rows

Colours: TypeAlias = list[IntArray]
"""For each component, first of states, then of actions, the colour of each value."""

MOST_TRIALS = 10_000
"""Refinements after which a matching is given up."""


class FactoredDynamics(NamedTuple):
    """Transitions over all combinations of component values."""

    sizes: tuple[int, ...]  # of the components, those of states first
    n_states: int  # components of states
    label: IntArray  # (X,) what is known of each combination of values of states
    row: IntArray  # (X, B) the outcome row of each pair; -1 where there are none
    after: IntArray  # (Y, O) combinations
    chance: FloatArray  # (Y, O)
    reward: FloatArray  # (Y,)


class Matcher:
    """Searches for the values of one task that stand for those of another."""

    def __init__(self, one: FactoredDynamics, other: FactoredDynamics):
        self.both = one, other
        # Numbers that must be equal up to rounding, numbered together.
        rewards = levels(np.concatenate([one.reward, other.reward]))
        self.rewards = rewards[: len(one.reward)], rewards[len(one.reward) :]
        self.trials = 0

    def matched(self) -> list[IntArray] | None:
        """Return for each component the other task's value for each of the one's; None if none."""
        sizes = self.both[0].sizes
        if sizes != self.both[1].sizes:
            return None
        blank: Colours = [np.zeros(size, np.int64) for size in sizes]
        found = self._search(blank, blank)
        if found is None:
            return None
        one, other = found
        return [np.argsort(b)[np.argsort(np.argsort(a))] for a, b in zip(one, other, strict=True)]

    def _search(self, one: Colours, other: Colours) -> tuple[Colours, Colours] | None:
        """Return refined colours that are all different and agree, or None."""
        self.trials += 1
        refined = self._refined(one, other) if self.trials <= MOST_TRIALS else None
        if refined is None:
            return None
        one, other = refined
        component = _most_ambiguous(one)
        if component is None:
            mine, theirs = self._signatures(one, other)
            return refined if np.array_equal(np.sort(mine), np.sort(theirs)) else None
        colours = one[component]
        counts = np.bincount(colours)
        colour = int(np.flatnonzero(counts > 1)[counts[counts > 1].argmin()])
        singled = int(np.flatnonzero(colours == colour)[0])
        for value in np.flatnonzero(other[component] == colour):
            here, there = ([c.copy() for c in each] for each in (one, other))
            here[component][singled] = there[component][value] = len(counts)
            found = self._search(here, there)
            if found is not None:
                return found
        return None

    def _refined(self, one: Colours, other: Colours) -> tuple[Colours, Colours] | None:
        """Return stable colours; None where the tasks have a colour in different numbers."""
        found = -1
        while True:
            for a, b in zip(one, other, strict=True):
                if not np.array_equal(np.sort(a), np.sort(b)):
                    return None
            kinds = sum(int(colours.max()) + 1 for colours in one)
            if kinds == found:
                return one, other
            found = kinds
            mine, theirs = self._signatures(one, other)
            one, other = _recoloured(self.both, (mine, theirs), (one, other))

    def _signatures(self, one: Colours, other: Colours) -> tuple[IntArray, IntArray]:
        """Return a number for each pair of both tasks, (X B,) each, equal where described alike."""
        described, chances, ends = [], [], []
        kinds = [int(colours.max()) + 1 for colours in one]
        width = max(task.after.shape[1] for task in self.both)
        for task, colours, reward in zip(self.both, (one, other), self.rewards, strict=True):
            k = task.n_states
            state = _codes(colours[:k], kinds[:k])
            action = _codes(colours[k:], kinds[k:])
            after, chance = merged_outcomes(state[task.after], task.chance)
            spare = ((0, 0), (0, width - after.shape[1]))
            rows = np.pad(after, spare, constant_values=-1)[task.row].reshape(task.row.size, width)
            there = task.row.ravel() >= 0
            rows = np.where(there[:, None], rows, -1)
            chances.append(np.pad(chance, spare))
            described.append(
                np.column_stack(
                    [
                        np.repeat(task.label, len(action)),
                        np.repeat(state, len(action)),
                        np.tile(action, len(state)),
                        np.where(there, reward[task.row.ravel()], -1),
                        rows,
                    ]
                )
            )
            ends.append(len(chance))
        level = levels(np.concatenate(chances))
        for i, (task, part) in enumerate(
            zip(self.both, (level[: ends[0]], level[ends[0] :]), strict=True)
        ):
            there = task.row.ravel() >= 0
            known = np.where(there[:, None], part[task.row.ravel()], -1)
            described[i] = np.column_stack([described[i], known])
        numbers = numbered_rows(np.concatenate(described))
        return numbers[: len(described[0])], numbers[len(described[0]) :]


def _codes(colours: Colours, kinds: list[int]) -> IntArray:
    """Return a number for each combination of values, equal where all colours are."""
    code = np.zeros(1, np.int64)
    for each, n in zip(colours, kinds, strict=True):
        code = (code[:, None] * n + each).ravel()
    return code


def _recoloured(
    both: tuple[FactoredDynamics, FactoredDynamics],
    signatures: tuple[IntArray, IntArray],
    colours: tuple[Colours, Colours],
) -> tuple[Colours, Colours]:
    """Return colours by the old colour and the signatures of all pairs in which a value occurs."""
    new: tuple[Colours, Colours] = ([], [])
    shaped = [_mixed(s).reshape(task.sizes) for task, s in zip(both, signatures, strict=True)]
    for i, size in enumerate(both[0].sizes):
        others = tuple(axis for axis in range(len(both[0].sizes)) if axis != i)
        # Sums modulo 2^64 of hashes stand for multisets; a matching is checked without them.
        sums = np.concatenate([one.sum(axis=others, dtype=np.uint64) for one in shaped])
        old = np.concatenate([each[i] for each in colours])
        numbers = numbered_rows(np.column_stack([old, sums.view(np.int64)]))
        new[0].append(numbers[:size])
        new[1].append(numbers[size:])
    return new


def _mixed(numbers: IntArray) -> npt.NDArray[np.uint64]:
    """Return numbers scattered over 64 bits (SplitMix64)."""
    z = numbers.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def _most_ambiguous(colours: Colours) -> int | None:
    """Return the component that has the most values of one colour; None if all differ."""
    most = [int(np.bincount(each).max()) for each in colours]
    return None if max(most) == 1 else int(np.argmax(most))


def injections(sizes: tuple[int, ...], others: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Yield each choice of a different place in `others` for each place in `sizes`, equally large.

    Examples
    --------
    >>> list(injections((4, 2), (2, 4, 4)))
    [(1, 0), (2, 0)]
    """

    def choices(place: int, taken: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if place == len(sizes):
            yield taken
            return
        for other, size in enumerate(others):
            if size == sizes[place] and other not in taken:
                yield from choices(place + 1, (*taken, other))

    return choices(0, ())
