"""A curriculum of sources of one target: its transfers, edge by edge."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from curricle.design.between_sources import mappings_between
from curricle.design.proposals import SourceCandidate
from curricle.errors import CurriculumError
from curricle.transfer.edges import Calibrate, Transfer

TARGET = "target"
"""What the target is called in a curriculum of a design."""


def transfers_of(
    task: Any,
    sources: Sequence[SourceCandidate],
    edges: Iterable[tuple[str, str]],
    *,
    scale: float = 1.0,
    calibrate: bool | Calibrate = False,
) -> Iterator[Transfer]:
    """Yield the transfers of these edges between sources, and from them to the target.

    Parameters
    ----------
    task : Task
        The target.
    sources : sequence of SourceCandidate
        Of the target.
    edges : iterable of (str, str)
        Names of the source and of what reads it: another source, or :data:`TARGET`.
    scale, calibrate
        Of the transfers into the target, as in :class:`Transfer`.

    Raises
    ------
    CurriculumError
        When a name is unknown, or two sources cannot read each other.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.design.relations import Relation
    >>> maze = GridWorld(["S....", ".....", ".....", ".....", "....T"])
    >>> small, large = (Relation("crop", share).source_of(maze) for share in (0.4, 0.8))
    >>> edges = [(small.name, large.name), (large.name, TARGET)]
    >>> [(one.source, one.target) for one in transfers_of(maze, [small, large], edges)]
    [('rows 3..4, columns 3..4', 'rows 1..4, columns 1..4'), ('rows 1..4, columns 1..4', 'target')]
    """
    by_name = {one.name: one for one in sources}
    for before, after in edges:
        unknown = [name for name in (before, after) if name not in (*by_name, TARGET)]
        if unknown or before == TARGET:
            raise CurriculumError(
                f"an edge must lead from a source to another or to the target: got {before!r} to "
                f"{after!r}"
            )
        one = by_name[before]
        if after == TARGET:
            for mapping in one.mappings:
                yield Transfer(before, TARGET, mapping, scale=scale, calibrate=calibrate)
        else:
            for mapping in mappings_between(task, by_name[after], one):
                yield Transfer(before, after, mapping)
