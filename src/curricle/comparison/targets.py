"""The transfers into a target, as forecasts and attributions take them."""

from curricle.checks import instance
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import CurriculumError
from curricle.transfer.edges import Transfer


def transfers_into(
    curriculum: Curriculum, target: str | None, what: str
) -> tuple[str, tuple[Transfer, ...]]:
    """Return the name of a target, the curriculum's by default, and the transfers into it.

    `what` needs them, such as "a forecast"; CurriculumError if there are none.
    """
    instance(f"the curriculum of {what}", curriculum, Curriculum, CurriculumError)
    name = curriculum.target if target is None else target
    edges = curriculum.in_edges(name)
    if not edges:
        raise CurriculumError(f"{what} needs a task with transfers into it: {name!r} has none")
    return name, tuple(edges)
