"""Candidates from which a hazard, an agent or all penalties were removed.

What a hazard or an agent is depends on the task: pits and fires of a :class:`GridWorld` and holes
of a :class:`FrozenLake`, pits of a :class:`KeyLockPit`, and a predator of a :class:`Pursuit`. Of
any other table only this is defined: where most steps have one and the same reward, a penalty is a
lower one, and without penalties it is that reward.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from curricle.design.proposals import DesignTarget, Draft, Made, by_number
from curricle.tasks.frozen_lake import FrozenLake
from curricle.tasks.gridworld import OBJECTS, GridWorld
from curricle.tasks.key_lock_pit import KeyLockPit
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.pursuit import Pursuit
from curricle.text_tables import counted
from curricle.transfer.component_mapping import ComponentMapping, project
from curricle.transfer.mapping import same_position

Places = tuple[tuple[int, int], ...]


def removals(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target without all hazards, without each of them, without a predator, or penalties.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.proposals import design_target
    >>> [draft.name for draft in removals(design_target(GridWorld(["SPF", "..T"])))]
    ['no hazards', 'no fire', 'no pit', 'no pit at (0, 1)', 'no fire at (0, 2)', 'no penalties']
    """
    task = target.task
    if isinstance(task, Pursuit):
        yield from _fewer_predators(task)
    yield from _without_hazards(task)
    usual = usual_reward(target.mdp)
    if usual is not None and _has_less(target.mdp, usual):
        build = partial(_without_penalties, task, target.mdp, usual)
        yield Draft(
            "removed",
            "no penalties",
            "no reward is below that of most steps",
            build,
            "no penalties",
        )


# -- hazards on a map ----------------------------------------------------------------------------


def _without_hazards(task: Any) -> Iterator[Draft]:
    names = _hazards(task)
    found = [
        (names[character], (row, column))
        for row, line in enumerate(task.map if names else ())
        for column, character in enumerate(line)
        if character in names
    ]
    groups: list[tuple[str, Places]] = []
    kinds = sorted({name for name, _ in found})
    if len(kinds) > 1:
        groups.append(("no hazards", tuple(place for _, place in found)))
    for kind in kinds:
        places = tuple(place for name, place in found if name == kind)
        if len(places) > 1 or len(kinds) > 1:
            groups.append((f"no {kind}", places))
    for kind, (row, column) in found:
        at = row + task.origin[0], column + task.origin[1]
        groups.append((f"no {kind} at {at}", ((row, column),)))
    for name, places in groups:
        count = f"{counted(len(places), 'hazard')} removed"
        anywhere = None if " at (" in name else name
        build = partial(_cleared, task, places)
        yield Draft("removed", name, f"the same map, {count}", build, anywhere)


def _hazards(task: Any) -> dict[str, str]:
    """Return the characters of a task's map that are hazards, and their names."""
    if isinstance(task, GridWorld):
        rewards = {"F": task.rewards.fire, "P": task.rewards.pit}
        return {one: OBJECTS[one] for one, reward in rewards.items() if reward < 0}
    if isinstance(task, KeyLockPit):
        return {"P": "pit"} if task.pit_reward < 0 else {}
    if isinstance(task, FrozenLake):
        return {"H": "hole"}
    return {}


def _cleared(task: Any, places: Places) -> Made:
    """Return the task with free cells in these places of its map."""
    free = "F" if isinstance(task, FrozenLake) else "."
    lines = [list(line) for line in task.map]
    for row, column in places:
        lines[row][column] = free
    source = replace(task, map=tuple("".join(line) for line in lines))
    if isinstance(task, GridWorld):
        return source, same_position(task, source)
    return source, project(task, source)


# -- predators -----------------------------------------------------------------------------------


def _fewer_predators(task: Pursuit) -> Iterator[Draft]:
    if callable(task.prey) or (task.prey != "uniform" and len(task.prey) != task.cells):
        return  # a prey that looks at the predators has no policy without one of them
    for n in range(1, task.predators):
        name = counted(n, "predator")
        words = f"the same grid with {n} of {task.predators} predators"
        yield Draft("removed", name, words, partial(_with_predators, task, n), name)


def _with_predators(task: Pursuit, n: int) -> Made:
    """Return the pursuit with the first n predators; each group of them reads it in turn."""
    capture = min(task.capture, n) if isinstance(task.capture, int) else task.capture
    source = replace(task, predators=n, capture=capture)
    own, fewer = task.predator_names, source.predator_names
    groups = (
        {name: own[(first + i) % len(own)] for i, name in enumerate(fewer)}
        for first in range(len(own))
    )
    return source, [ComponentMapping(task, source, group) for group in groups]


# -- penalties of any table ----------------------------------------------------------------------


def usual_reward(mdp: FiniteMDP) -> float | None:
    """Return the reward of more than half of all possible outcomes of live pairs, else None.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> usual_reward(GridWorld("S..PT").mdp)
    -1.0
    """
    row = mdp.outcome_row[~mdp.terminal]
    rewards = mdp.reward[row][mdp.probability[row] > 0]
    values, counts = np.unique(rewards, return_counts=True)
    most = int(counts.argmax()) if counts.size else 0
    return float(values[most]) if counts.size and 2 * counts[most] > counts.sum() else None


def _has_less(mdp: FiniteMDP, usual: float) -> bool:
    """Return whether a possible outcome of a live pair has less than the usual reward."""
    row = mdp.outcome_row[~mdp.terminal]
    return bool((mdp.reward[row][mdp.probability[row] > 0] < usual).any())


def _without_penalties(task: Any, mdp: FiniteMDP, usual: float) -> Made:
    source = replace(mdp, reward=np.maximum(mdp.reward, usual))
    return source, by_number(task, source)
