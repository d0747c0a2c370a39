"""Search for a mapping between the components of two tasks (MASTER).

Taylor, Kuhlmann, Stone 2008 enumerate the assignments of target components to source components
and score each by the error with which the source's model then predicts the target. Several
assignments may be right: each predator of a pursuit can stand for the only one of the source.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import NamedTuple

import numpy as np

from curricle.array_types import IntArray
from curricle.display import brief_repr
from curricle.errors import MappingError, SettingError
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import MISSING
from curricle.tasks.task import Task, tables
from curricle.transfer.component_mapping import source_points
from curricle.transfer.mapping import StateActionMapping, pair_mapping
from curricle.transfer.mapping_scores import total_variation

MAX_ASSIGNMENTS = 10_000


@dataclass(frozen=True, eq=False)
class Projection:
    """One assignment of target components to the source's components.

    Attributes
    ----------
    states, actions : dict of str to str
        Source component -> target component.
    error : float
        Mean total variation distance, in [0, 1], between the source's next states and the
        target's, read through the assignment; NaN if nothing maps.
    mapping : StateActionMapping

    Examples
    --------
    >>> from curricle import Pursuit
    >>> chase = Pursuit(size=2, predators=1)
    >>> find_projections(chase, chase)[0].states
    {'prey': 'prey', 'predator': 'predator'}
    """

    states: dict[str, str]
    actions: dict[str, str]
    error: float
    mapping: StateActionMapping

    __repr__ = brief_repr


def find_projections(
    target: Task,
    source: Task,
    *,
    pairs: int = 5_000,
    seed: int = 0,
    unmapped_value: float | None = None,
) -> tuple[Projection, ...]:
    """Return every assignment of target components to the source's, best prediction first.

    Rewards are not compared: two tasks with different rewards may have the same dynamics.

    Parameters
    ----------
    target, source : Task
    pairs : int
        State-action pairs of the target to score on, drawn without repetition.
    seed : int
        Of that draw.
    unmapped_value : float, optional
        Of the mappings.

    Raises
    ------
    SettingError
        When `pairs` is less than 1.
    MappingError
        When there are more than 10,000 assignments.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> for found in find_projections(hunt, chase, pairs=500)[:2]:
    ...     print(found.states, found.actions, round(found.error, 2))
    {'prey': 'prey', 'predator': 'predator_1'} {'predator': 'predator_1'} 0.0
    {'prey': 'prey', 'predator': 'predator_2'} {'predator': 'predator_2'} 0.0
    """
    if pairs < 1:
        raise SettingError(f"pairs must be at least 1: got {pairs}")
    spaces = (target.states, source.states), (target.actions, source.actions)
    n_assignments = prod(len(mine.names) ** len(other.names) for mine, other in spaces)
    if n_assignments > MAX_ASSIGNMENTS:
        raise MappingError(
            f"a search may try at most {MAX_ASSIGNMENTS:,} assignments of components: these "
            f"tasks have {n_assignments:,}"
        )
    mdp, source_mdp = tables(target), tables(source)
    alive = np.flatnonzero(np.repeat(~mdp.terminal, mdp.actions.size))
    rng = np.random.default_rng(seed)
    drawn = np.sort(rng.choice(alive, size=min(pairs, len(alive)), replace=False))
    choices = [product(mine.names, repeat=len(other.names)) for mine, other in spaces]
    projections = []
    for state_names, action_names in product(*choices):
        states = dict(zip(source.states.names, state_names, strict=True))
        actions = dict(zip(source.actions.names, action_names, strict=True))
        state = source_points(target.states, source.states, states)
        action = source_points(target.actions, source.actions, actions)
        error = _prediction_error(mdp, source_mdp, state, action, drawn)
        mapping = pair_mapping(target, source, state[:, None], action, unmapped_value)
        projections.append(Projection(states, actions, error, mapping))
    return tuple(sorted(projections, key=lambda one: (np.isnan(one.error), one.error)))


def _prediction_error(
    target: FiniteMDP, source: FiniteMDP, state: IntArray, action: IntArray, drawn: IntArray
) -> float:
    """Return the mean total variation distance of the next source states over the pairs drawn."""
    s, a = np.divmod(drawn, target.actions.size)
    usable = (state[s] != MISSING) & (action[a] != MISSING)
    usable &= ~source.terminal[np.maximum(state[s], 0)]
    s, a = s[usable], a[usable]
    if not len(s):
        return float("nan")
    row, source_row = target.outcome_row[s, a], source.outcome_row[state[s], action[a]]
    return float(
        total_variation(
            state[target.next_state[row]],
            target.probability[row],
            source.next_state[source_row].astype(np.int64),
            source.probability[source_row],
        ).mean()
    )
