"""Mappings between tasks whose components have no names and whose values are numbered anyhow.

Ravindran and Barto 2004 call a homomorphism structured where it maps components one by one. Here
each source component is assigned one of the target's of equal size, in every way, and for each way
the values are matched by the dynamics (:mod:`curricle.transfer.value_matching`).
"""

from collections.abc import Iterator
from itertools import islice, product
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING, Space
from curricle.transfer.mapping import pair_mapping
from curricle.transfer.partition_refinement import levels, merged_outcomes, numbered_rows
from curricle.transfer.proposal import NOT_PROVEN, Proposal, SearchedMapping
from curricle.transfer.task_pair import TaskPair
from curricle.transfer.value_matching import FactoredDynamics, Matcher, injections

MOST_ASSIGNMENTS = 1_000
LARGEST_BOX = 2_000_000
"""Pairs over all combinations of the source's values."""
LIVE, ENDS, ABSENT = 0, 1, 2
"""Of a combination of values: no state that has it ends the episode, one does, or none has it."""

Parts = tuple[tuple[int, ...], tuple[int, ...]]
"""Places of components, of states and of actions."""


def by_component_values(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mappings that take values of components to values so that the dynamics agree.

    For each assignment of the source's components to equally large ones of the target: how they
    move must not depend on the target's other components, and must be the source's up to the
    numbering of values and moves. States whose other components decide whether they end are not
    compared. If rewards and ends agree too this is a homomorphism, which proves that Q* is equal.

    Raises
    ------
    MappingError
        When the source has one component of states, when there are too many assignments or
        values, or when no assignment fits.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> for one in by_component_values(TaskPair(hunt, chase)):
    ...     print(one.how)
    values of components: prey is prey, predator is predator_1; actions: predator is predator_1
    values of components: prey is prey, predator is predator_2; actions: predator is predator_2
    """
    target, source = tasks.target_mdp, tasks.source_mdp
    if len(source.states.components) < 2:
        raise MappingError("values are matched by components: the source's states have only one")
    if np.prod(source.states.shape) * source.actions.size > LARGEST_BOX:
        raise MappingError(
            f"values are matched over up to {LARGEST_BOX:,} pairs: the source's components make "
            f"{np.prod(source.states.shape) * source.actions.size:,}"
        )
    choices = [
        list(islice(injections(theirs.shape, own.shape), MOST_ASSIGNMENTS + 1))
        for own, theirs in ((target.states, source.states), (target.actions, source.actions))
    ]
    if len(choices[0]) * len(choices[1]) > MOST_ASSIGNMENTS:
        raise MappingError(f"values are matched for up to {MOST_ASSIGNMENTS:,} assignments")
    found = False
    whole = tuple(range(len(source.states.shape))), tuple(range(len(source.actions.shape)))
    for states, actions in product(*choices):
        parts = states, actions
        for rewarded in (True, False):
            own = projected(target, parts, rewarded=rewarded)
            other = None if own is None else projected(source, whole, rewarded=rewarded)
            if own is None or other is None:
                continue
            matched = Matcher(own, other).matched()
            if matched is not None:
                found = True
                yield _proposal(tasks, parts, matched, proven=rewarded)
                break
    if not found:
        raise MappingError("no assignment of components makes the dynamics agree")


def projected(mdp: FiniteMDP, parts: Parts, *, rewarded: bool) -> FactoredDynamics | None:
    """Return how some components move; None where that depends on the others.

    With `rewarded` also the rewards, and whether the episode ends, must not depend on them.
    """
    shapes = [tuple(space.shape[p] for p in some) for space, some in _both(mdp, parts)]
    state, action = (_point(space, some) for space, some in _both(mdp, parts))
    n_states, n_actions = int(np.prod(shapes[0])), int(np.prod(shapes[1]))
    known, ended = (
        np.bincount(state, weights=weight, minlength=n_states)
        for weight in (np.ones(len(state)), mdp.terminal)
    )
    label = np.where(known == 0, ABSENT, np.where(ended > 0, ENDS, LIVE))
    if rewarded and ((ended > 0) & (ended < known)).any():
        return None
    after, chance = merged_outcomes(state[mdp.next_state], mdp.probability)
    mean = (mdp.probability * mdp.reward).sum(axis=1)
    reward = levels(mean) if rewarded else np.zeros(len(mean), np.int64)
    kind = numbered_rows(np.column_stack([reward, after, levels(chance)]))
    # Every pair with the same values must have the same kind of outcomes.
    compared = (label[state] == LIVE) & ~mdp.terminal
    group = (state[:, None] * n_actions + action)[compared].ravel()
    own = kind[mdp.outcome_row[compared]].ravel()
    row = np.full(n_states * n_actions, -1)
    row[group] = mdp.outcome_row[compared].ravel()
    if not np.array_equal(kind[row[group]], own):
        return None
    return FactoredDynamics(
        shapes[0] + shapes[1],
        len(shapes[0]),
        label,
        row.reshape(n_states, n_actions),
        np.maximum(after, 0),
        chance,
        mean if rewarded else np.zeros(len(mean)),
    )


def _both(mdp: FiniteMDP, parts: Parts) -> list[tuple[Space, tuple[int, ...]]]:
    return [(mdp.states, parts[0]), (mdp.actions, parts[1])]


def _point(space: Space, some: tuple[int, ...]) -> IntArray:
    """Return the combination of some components' values at each point of a space, (n,) int64."""
    values = space.decode()
    point = np.zeros(space.size, np.int64)
    for place in some:
        component = space.components[place]
        point = point * component.size + values[component.name] - component.low
    return point


def _proposal(tasks: TaskPair, parts: Parts, matched: list[IntArray], proven: bool) -> Proposal:
    """Return the mapping that values which were matched make."""
    (target, source), read, words = (tasks.target_mdp, tasks.source_mdp), [], []
    values = iter(matched)
    for own, other, some in (
        (target.states, source.states, parts[0]),
        (target.actions, source.actions, parts[1]),
    ):
        decoded, encoded = own.decode(), dict[str, Any]()
        for place, component in zip(some, other.components, strict=True):
            mine = own.components[place]
            encoded[component.name] = next(values)[decoded[mine.name] - mine.low] + component.low
            words.append(f"{component.name} is {mine.name}")
        read.append(other.encode(**encoded))
    n = len(parts[0])
    how = f"values of components: {', '.join(words[:n])}; actions: {', '.join(words[n:])}"
    assert (read[1] != MISSING).all()
    index = pair_mapping(tasks.target, tasks.source, read[0][:, None], read[1]).index
    error = tasks.target_solution.error_bound + tasks.source_solution.error_bound
    mapping = SearchedMapping(tasks.target, tasks.source, index, how=how)
    return Proposal(mapping, how, error if proven else NOT_PROVEN)
