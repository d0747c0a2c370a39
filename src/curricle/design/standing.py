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


def standing_recipe(target: Any) -> tuple[str, Recipe] | None:
    """Return the first standing recipe that a target has sources for, and its name; else None.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.tasks import CliffWalking
    >>> standing_recipe(GridWorld(["S...", "....", "....", "...T"]))[0]
    'parts around the goal'
    >>> standing_recipe(CliffWalking()) is None
    True
    """
    for name, recipe in STANDING.items():
        try:
            if recipe.sources(target):
                return name, recipe
        except CurricleError:
            continue
    return None
