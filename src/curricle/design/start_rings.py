"""Candidates whose episodes start near the goal, in rings from the goal outwards.

Asada et al. 1996, "learning from easy missions"; Florensa et al. 2017, "reverse curriculum
generation for reinforcement learning".
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from curricle.design.proposals import DesignTarget, Draft, Made, by_number, spread
from curricle.tasks.start_states import GoalDistance, goal_distance, with_start


def start_rings(target: DesignTarget) -> Iterator[Draft]:
    """Yield the target with starts in 1 to d steps from the goal, half the way first.

    There is one for each d below the distance of the farthest start.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.proposals import design_target
    >>> [draft.name for draft in start_rings(design_target(GridWorld("S...T")))]
    ['starts 1..2 from the goal', 'starts 1 from the goal', 'starts 1..3 from the goal']
    """
    far = int(goal_distance(target.mdp, target.goal)[target.mdp.start_states].max(initial=0))
    for most in spread(range(1, far)):
        ring = "1" if most == 1 else f"1..{most}"
        words = f"episodes start {ring} step{'s' * (most > 1)} from the goal"
        build = partial(_ring, target, most)
        yield Draft("starts", f"starts {ring} from the goal", words, build, "", most / far)


def _ring(target: DesignTarget, most: int) -> Made:
    goal = np.flatnonzero(target.goal)
    source = with_start(target.task, GoalDistance(1, most, goal=goal))
    return source, by_number(target.task, source)
