"""Standing recipes: what earlier designs found, for targets that are not worth a search."""

from typing import Any

from curricle.design.recipe import Recipe, Stage
from curricle.design.relations import Relation
from curricle.design.trends import Trend
from curricle.errors import CurricleError

CROPS = Recipe(
    [Stage(Relation("crop", share), Trend(23.5, slope=0.9, around=48.0)) for share in (0.35, 0.7)],
    annealed=True,
)
"""Found on random mazes of 6x6 and 8x8 (``python -m benchmarks.recipes_travel mazes``)."""
HUNTS = Recipe(
    [
        Stage(
            Relation("member", changes={"predators": 1}),
            Trend(74.7, slope=0.2, around=470.0),
        )
    ],
    aggregate="minimum",
    scale=1.5,
    annealed=True,
)
"""Found on hunts of up to 4,096 states (``python -m benchmarks.recipes_travel pursuit``)."""
MEMBERS = Recipe(
    [
        Stage(Relation("member", changes={"size": f"{share} n"}), Trend(23.5, 0.9, 48.0))
        for share in (0.35, 0.7)
    ],
    annealed=True,
)
"""As :data:`CROPS`, of a family with a size."""
STANDING = {"parts around the goal": CROPS, "one predator": HUNTS, "smaller members": MEMBERS}
"""The standing recipes by name, in the order in which they are tried."""


FASTEST = 0.2
"""The learning rate up to which they hold: they were found with 0.1. Learners with higher rates are
faster, also from scratch, and sources of as many steps then cost more than they save."""


def standing_recipe(target: Any, learner: Any = None) -> tuple[str, Recipe] | None:
    """Return the first standing recipe that fits a target and its learner, and its name; else None.

    The target has sources for it, and the learner, if one is given, a constant learning rate of at
    most 0.2.

    Examples
    --------
    >>> from curricle import GridWorld, QLearning
    >>> maze = GridWorld(["S...", "....", "....", "...T"])
    >>> standing_recipe(maze, QLearning(learning_rate=0.1))[0]
    'parts around the goal'
    >>> standing_recipe(maze, QLearning(learning_rate=0.9)) is None
    True
    """
    if learner is not None and not learns_slowly(learner):
        return None
    for name, recipe in STANDING.items():
        try:
            if recipe.sources(target):
                return name, recipe
        except CurricleError:
            continue
    return None


def learns_slowly(learner: Any) -> bool:
    """Return whether a learner has a constant learning rate of at most 0.2.

    Examples
    --------
    >>> from curricle import QLearning
    >>> learns_slowly(QLearning(learning_rate=0.1)), learns_slowly(QLearning(learning_rate=0.5))
    (True, False)
    """
    rate = getattr(learner, "learning_rate", None)
    return isinstance(rate, int | float) and rate <= FASTEST
