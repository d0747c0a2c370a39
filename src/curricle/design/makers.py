"""What candidates are made by: the kinds, in the order of their turns."""

from collections.abc import Callable, Iterator

from curricle.design.bottlenecks import bottlenecks
from curricle.design.coarser_tables import coarser_tables
from curricle.design.crops import crops
from curricle.design.family_members import family_members
from curricle.design.likeliest_outcomes import likeliest_outcomes
from curricle.design.proposals import DesignTarget, Draft
from curricle.design.removals import removals
from curricle.design.start_rings import start_rings

MAKERS: dict[str, Callable[[DesignTarget], Iterator[Draft]]] = {
    "member": family_members,
    "crop": crops,
    "removed": removals,
    "deterministic": likeliest_outcomes,
    "starts": start_rings,
    "bottleneck": bottlenecks,
    "coarser": coarser_tables,
}
KINDS = tuple(MAKERS)
"""What candidates are made by, in the order of their turns."""
