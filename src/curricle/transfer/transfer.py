"""Edges of a curriculum: a source's values, read through a mapping, scaled and shifted."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray
from curricle.checks import number
from curricle.errors import CurriculumError
from curricle.learning.potential import LARGEST_POTENTIAL
from curricle.text import brief_repr
from curricle.transfer.mapping import PairMapping, TaskMapping


@dataclass(frozen=True, eq=False)
class Transfer:
    """A transfer from a source to a target: phi_i(s, a) = scale Q_source(f(s, a)) + shift.

    Parameters
    ----------
    source, target : str
        Names of tasks in the curriculum.
    mapping : StateActionMapping or ObservationMapping, optional
        From the target to the source. By default the curriculum searches it when it is made
        (:func:`auto_mapping`), and prints its scores and those of the runner-up.
    scale, shift : float
        Applied to mapped pairs and to ended pairs, whose value is 0. They do not change the
        optimal policy, but strongly affect learning.

    Raises
    ------
    CurriculumError
        When scale or shift is not finite or larger than 1e15 in size, or an argument has another
        type.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity
    >>> maze = GridWorld("S.T")
    >>> Transfer("a", "b", identity(maze), scale=2).potential(np.ones((3, 4)))[0]
    array([2., 2., 2., 2.])
    """

    source: str
    target: str
    mapping: Any = None
    scale: float = 1.0
    shift: float = 0.0

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        edge = f"{self.source} -> {self.target}"
        if not isinstance(self.mapping, TaskMapping | None):
            raise CurriculumError(
                f"mapping of {edge} must be a StateActionMapping or an ObservationMapping: got "
                f"{self.mapping!r}"
            )
        largest = LARGEST_POTENTIAL
        number(f"scale of {edge}", self.scale, CurriculumError, -largest, largest)
        number(f"shift of {edge}", self.shift, CurriculumError, -largest, largest)

    def potential(self, source_values: npt.ArrayLike) -> FloatArray:
        """Return phi_i, (..., S, A), for source values (..., S', A')."""
        if self.mapping is None:
            raise CurriculumError(
                f"the mapping of {self.source} -> {self.target} is found when a curriculum is made "
                "with the transfer: it has none yet"
            )
        if not isinstance(self.mapping, PairMapping):
            raise CurriculumError(
                f"a potential as a table needs a mapping of numbered states: that of {self.source} "
                f"-> {self.target} reads observations; ask it for the pairs or the states of some"
            )
        return np.asarray(self.mapping.read(source_values, self.scale, self.shift))


def transfer_names(transfers: Sequence[Transfer]) -> list[str]:
    """Return a name for each transfer, ``source -> target``, with a number if several share it."""
    return numbered([f"{transfer.source} -> {transfer.target}" for transfer in transfers])


def numbered(names: Sequence[str]) -> list[str]:
    """Return the names, with numbers for equal ones: "a [1]", "b", "a [2]"."""
    return [
        f"{name} [{names[: i + 1].count(name)}]" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


# -- in words --------------------------------------------------------------------------------------

FOUND = "mapping found in the target's model, 0 steps charged"
DIGEST_BYTES = 16
SIGNIFICANT = 6  # digits of values in a digest: further digits may differ between machines


def transfer_words(transfer: Transfer) -> str:
    """Return a transfer in words: its mapping, coverage, scale and shift."""
    phrases = [transfer.mapping.description]
    if transfer.mapping.countable:
        cover, value = transfer.mapping.coverage(), transfer.mapping.unmapped_value
        phrases.append(f"{cover.mapped:.0%} of {cover.size:,} pairs mapped")
        phrases += [f"{cover.ended:.0%} at the source's end"] if cover.ended else []
        stated = "nothing known" if value is None else f"potential {value:g}"
        phrases += [f"{cover.unmapped:.0%} unmapped ({stated})"] if cover.unmapped else []
    phrases += [f"scaled by {transfer.scale:g}"] if transfer.scale != 1 else []
    phrases += [f"shifted by {transfer.shift:g}"] if transfer.shift else []
    phrases += [FOUND] if transfer.mapping.knows_target else []
    return "; ".join(phrases)


def same_transfer(transfer: Transfer, other: Transfer) -> bool:
    """Return whether two transfers are the same."""
    names = ("source", "target", "scale", "shift")
    if any(getattr(transfer, name) != getattr(other, name) for name in names):
        return False
    mapping, other_mapping = transfer.mapping, other.mapping
    return mapping is other_mapping or bool(mapping.parts == other_mapping.parts)


def mappings_digest(transfers: Iterable[Transfer]) -> str:
    """Return a digest of the mappings that have an index; equal mappings have equal digests."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for transfer in transfers:
        mapping = transfer.mapping
        digest.update(np.asarray(mapping.index, dtype=np.int64).tobytes())
        value = mapping.unmapped_value
        digest.update(("-" if value is None else f"{value:.{SIGNIFICANT}g} ").encode())
    return digest.hexdigest()
