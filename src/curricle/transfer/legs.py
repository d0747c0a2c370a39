"""The source as the first leg of the target: where the source ends, the target goes on.

A taxi fetches a passenger before it takes the passenger to a place. A source that drives to a place
and ends there fits both legs. On the first leg its values do not count what comes after, which MAXQ
calls the completion (Dietterich 2000); here it is one number.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from curricle.array_types import BoolArray, FloatArray
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.transfer.nearest_pairs import by_lax_bisimulation
from curricle.transfer.proposal import Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair

MOST_LEGS = 4
"""Legs for which pairs are compared; each takes as long as lax bisimulation of the whole."""


def by_legs(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mappings that read the source twice: on a first leg of the target, and after it.

    A first leg is the states with one value of a component that the source lacks, or those with
    any other, if every episode starts there and none ends there. For its nearest source pairs, by
    lax bisimulation, leaving the leg counts as an end that is paid as the source's is. What is read
    is shifted by what the rest is worth, at the exit where that is least. The states after the leg
    read the pairs nearest to them in the whole target.

    Raises
    ------
    MappingError
        When the target has no such leg or no component in common with the source, the source has
        no end, or as :func:`lax_bisimulation`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> next(by_legs(TaskPair(GridWorld("S..T"), GridWorld("S.T"))))
    Traceback (most recent call last):
    curricle.errors.MappingError: a leg is of a component that the source lacks, ... it lacks 0 of 2
    """
    names, others = (mdp.states.names for mdp in (tasks.target_mdp, tasks.source_mdp))
    lacking = [name for name in names if name not in others]
    if not lacking or len(lacking) == len(names):
        raise MappingError(
            "a leg is of a component that the source lacks, and others are in common: it lacks "
            f"{len(lacking)} of {len(names)}"
        )
    paid = end_reward(tasks.source_mdp)
    legs = list(first_legs(tasks, lacking))
    if not legs:
        raise MappingError("no part of the target begins every episode and ends none")
    rest = next(iter(by_lax_bisimulation(tasks))).mapping
    for words, inside in legs[:MOST_LEGS]:
        leg = TaskPair(ending_outside(tasks.target_mdp, inside, paid), tasks.source_mdp)
        nearest = next(iter(by_lax_bisimulation(leg))).mapping
        index = np.where(inside[:, None], nearest.index, rest.index)
        unshifted = SearchedMapping(tasks.target, tasks.source, index)
        phi = unshifted.read(tasks.source_solution.action_values)
        shift = completion(phi, inside, tasks)
        how = f"first leg: where {words} the source shifted by {shift:.3g}, and the source after it"
        shifts = np.where(inside[:, None], shift, np.zeros(index.shape))
        yield Proposal(replace(unshifted, shifts=shifts, how=how), how)


def first_legs(tasks: TaskPair, names: Sequence[str]) -> Iterator[tuple[str, BoolArray]]:
    """Yield the parts of the target in which all episodes start and none ends, (S,) bool each.

    A part is the states with one value of one of these components, or those with any other.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S..T"), GridWorld("S.T"))
    >>> for words, inside in first_legs(tasks, ["column"]):
    ...     print(words, inside)
    column is 0 [ True False False False]
    column is not 2 [ True  True False  True]
    """
    mdp, live = tasks.target_mdp, tasks.judged
    ends = ((mdp.probability > 0) & mdp.terminal[mdp.next_state]).any(axis=1)
    may_end = ends[mdp.outcome_row].any(axis=1)
    values, seen = mdp.states.decode(), set[bytes]()
    for name in names:
        component = mdp.states.component(name)
        for value in np.unique(values[name][live]):
            label = value if component.labels is None else component.labels[value - component.low]
            for inside, word in ((values[name] == value, "is"), (values[name] != value, "is not")):
                starts = not (mdp.start[~inside] > 0).any()
                goes_on = (~inside & live).any() and not (may_end & inside & live).any()
                if starts and goes_on and inside.tobytes() not in seen:
                    seen.add(inside.tobytes())
                    yield f"{name} {word} {label}", inside


def end_reward(source: FiniteMDP) -> float:
    """Return the largest expected reward of a pair that surely ends the source.

    Raises
    ------
    MappingError
        When no pair does.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> end_reward(GridWorld("S.T").mdp)
    199.0
    """
    surely = np.where(source.terminal[source.next_state], source.probability, 0.0).sum(axis=1) == 1
    ends = np.unique(source.outcome_row[~source.terminal])
    ends = ends[surely[ends]]
    if not len(ends):
        raise MappingError("a leg reads a source that ends: no pair of the source surely does")
    return float((source.probability * source.reward).sum(axis=1)[ends].max())


def ending_outside(mdp: FiniteMDP, inside: BoolArray, reward: float) -> FiniteMDP:
    """Return the part of a task: what leads out of it ends the episode and is paid this reward.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> line = GridWorld("S..T").mdp
    >>> ending_outside(line, np.array([True, True, False, False]), 5.0).terminal
    array([False, False,  True,  True])
    """
    live = inside & ~mdp.terminal
    leaves = ~inside[mdp.next_state] & ~mdp.terminal[mdp.next_state]
    return replace(
        mdp,
        reward=np.where(leaves, reward, mdp.reward),
        terminal=mdp.terminal | ~inside,
        start=live / live.sum(),
    )


def completion(phi: FloatArray, inside: BoolArray, tasks: TaskPair) -> float:
    """Return what a leg is worth beyond its phi: the least over the states that phi leaves it from.

    It is c with phi(s, a) + c = r + gamma sum_s' P(s') (max phi(s', .) + c [s' inside]), a being
    greedy; 0 where no greedy action leaves.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S..T"), GridWorld("S.T"))
    >>> phi = np.array([[0.0], [0.0], [100.0], [0.0]]) * np.ones(4)
    >>> float(completion(phi, np.array([True, True, False, False]), tasks))
    0.0
    """
    mdp = tasks.target_mdp
    best = np.where(mdp.terminal, 0.0, phi.max(axis=1))
    row = np.take_along_axis(mdp.outcome_row, phi.argmax(axis=1)[:, None], axis=1)[:, 0]
    expected = (mdp.probability * (mdp.reward + mdp.discount * best[mdp.next_state])).sum(axis=1)
    stays = (mdp.probability * inside[mdp.next_state]).sum(axis=1)[row]
    exits = inside & tasks.judged & (stays < 1)
    if not exits.any():
        return 0.0
    lacks = (expected[row] - best)[exits] / (1 - mdp.discount * stays[exits])
    return float(lacks.min())
