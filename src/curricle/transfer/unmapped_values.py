"""One value for the pairs of which a source knows nothing, from the target's Bellman equation.

Unmapped pairs are worth 0 by default. Where steps cost, 0 is too high: a learner leaves the mapped
part to try the unmapped one. A constant that fits the mapped values beside it does not lead away
from them. It minimises a weighted square of the Bellman residuals (Schweitzer, Seidmann 1985; Baird
1995) of states, not of pairs: the cost of one bad action does not say what a state is worth. No
optimal value of the target is used.
"""

from typing import NamedTuple

import numpy as np

from curricle.array_types import BoolArray, FloatArray
from curricle.transfer.mapping import UNMAPPED, StateActionMapping
from curricle.transfer.task_pair import TaskPair

EXPECTILE = 0.03
"""Expectile of the residuals that is 0; 0.5 is least squares. Values too low do less harm."""
SWEEPS = 100
"""Greedy policies that are fitted to at most."""
SETTLED = 1e-9
"""Two constants are one if they differ by less, in units of the larger."""


class Residuals(NamedTuple):
    """Bellman residuals of states, ``stated - factor * constant``, for greedy policies as they are.

    Examples
    --------
    >>> Residuals(np.array([-2.0, 1.0]), np.array([1.0, 1.0])).constant(0.5)
    -0.5
    """

    stated: FloatArray  # (n,) of a constant of 0
    factor: FloatArray  # (n,) by how much a constant of 1 lowers it

    def constant(self, expectile: float) -> float:
        """Return the constant at which this expectile of the residuals is 0; 0 where none acts."""
        found = 0.0
        for _ in range(SWEEPS):
            above = self.stated > self.factor * found
            weight = np.where(above, expectile, 1 - expectile)
            curvature = float((weight * self.factor**2).sum())
            if curvature == 0:
                return 0.0
            last, found = found, float((weight * self.factor * self.stated).sum()) / curvature
            if abs(found - last) <= SETTLED * max(abs(found), abs(last)):
                break
        return found


def fitted_unmapped_value(
    mapping: StateActionMapping,
    *,
    scale: float = 1.0,
    shift: float = 0.0,
    tasks: TaskPair | None = None,
) -> float | None:
    """Return the value of unmapped pairs that fits the mapped ones best, or None.

    It is the constant u at which the expectile of max_a (T phi)(s, a) - max_a phi(s, a), over the
    states of the target that can be reached, is 0; phi being the source's exact values where the
    mapping has any and u elsewhere, T the target's Bellman operator. It is not below what the worst
    reward for ever is worth. It is None where all is mapped; where u would not be below 0, which is
    what unmapped pairs are worth without; and where no way leads from some state to what is mapped,
    so that its worth is not known.

    Parameters
    ----------
    mapping : StateActionMapping
    scale, shift : float
        Of the transfer.
    tasks : TaskPair, optional
        The mapping's tasks, where they have been solved already.

    Raises
    ------
    TaskError
        When a task has no tables.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards, same_position
    >>> costs = Rewards(step=-1, treasure=0)
    >>> line = GridWorld("S....T", rewards=costs)
    >>> end = same_position(line, line.crop(rows=(0, 1), columns=(3, 6)))
    >>> round(fitted_unmapped_value(end), 1)  # V* are -5, -4, -3 there, and -2 where it is mapped
    -3.6
    """
    tasks = TaskPair(mapping.target, mapping.source) if tasks is None else tasks
    phi = mapping.read(tasks.source_solution.action_values, scale, shift)
    unmapped = (mapping.index == UNMAPPED) & np.isnan(phi)
    if not unmapped[tasks.judged].any() or not _leads_to(~unmapped.all(axis=1), tasks):
        return None
    rewards = (tasks.target_mdp.probability * tasks.target_mdp.reward).sum(axis=1)
    lowest = min(0.0, float(rewards.min())) / (1 - tasks.target_mdp.discount)
    found = 0.0
    for _ in range(SWEEPS):
        last = found
        found = _residuals(phi, unmapped, found, rewards, tasks).constant(EXPECTILE)
        found = min(0.0, max(lowest, found))
        if abs(found - last) <= SETTLED * max(abs(found), abs(last)):
            break
    return found if found < 0 else None


def _leads_to(mapped: BoolArray, tasks: TaskPair) -> bool:
    """Return whether some way leads from every state that can be reached to these states."""
    mdp = tasks.target_mdp
    reaches, before = mapped & tasks.judged, 0
    while int(reaches.sum()) > before:
        before = int(reaches.sum())
        row = ((mdp.probability > 0) & reaches[mdp.next_state]).any(axis=1)
        reaches = reaches | (row[mdp.outcome_row].any(axis=1) & tasks.judged)
    return bool(reaches[tasks.judged].all())


def _residuals(
    phi: FloatArray, unmapped: BoolArray, constant: float, rewards: FloatArray, tasks: TaskPair
) -> Residuals:
    """Return the residuals for what is greedy at this constant, before and after a step.

    `rewards` are the expected ones of the target's outcome rows.
    """
    mdp, states = tasks.target_mdp, np.arange(len(phi))
    action = np.where(unmapped, constant, phi).argmax(axis=1)
    live = ~mdp.terminal
    at_constant = unmapped[states, action] & live
    best = np.where(live & ~at_constant, phi[states, action], 0.0)
    after = rewards + mdp.discount * (mdp.probability * best[mdp.next_state]).sum(axis=1)
    share = mdp.discount * (mdp.probability * at_constant[mdp.next_state]).sum(axis=1)
    row = np.take_along_axis(
        mdp.outcome_row, (after + constant * share)[mdp.outcome_row].argmax(axis=1)[:, None], axis=1
    )[:, 0]
    kept = tasks.judged
    return Residuals((after[row] - best)[kept], (at_constant - share[row])[kept])
