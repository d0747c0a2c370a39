"""Transfers in words, and whether two are the same."""

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from curricle.transfer.component_mapping import ComponentMapping, describe_renaming
from curricle.transfer.coverage import few_pairs
from curricle.transfer.edges import Transfer
from curricle.transfer.observation_mapping import ObservationMapping
from curricle.transfer.proposal import SearchedMapping

DIGEST_BYTES = 16
SIGNIFICANT = 6
"""Digits of values in a digest: the last ones may differ between machines."""

UNEQUAL = {"clip": "other values clipped", "scale": "ranges scaled"}
"""What becomes of values that the source lacks, in words."""


def mapping_words(transfer: Transfer) -> str:
    """Return the mapping of a transfer in words.

    Examples
    --------
    >>> from curricle import Pursuit, project
    >>> mapping = project(Pursuit(3, 2), Pursuit(3, 1), predator="predator_2")
    >>> mapping_words(Transfer("chase", "hunt", mapping))
    'predator is predator_2, prey by name'
    """
    mapping = transfer.mapping
    if isinstance(mapping, ComponentMapping):
        names = (*mapping.source.states.names, *mapping.source.actions.names)
        words = describe_renaming(names, mapping.renaming)
        return words if mapping.unequal == "unmapped" else f"{words}; {UNEQUAL[mapping.unequal]}"
    if isinstance(mapping, ObservationMapping):
        return mapping.description
    if isinstance(mapping, SearchedMapping):
        return f"found: {mapping.how}"
    return "state by state and action by action"


def transfer_words(transfer: Transfer) -> str:
    """Return a transfer in words: its mapping, coverage, scale and shift."""
    words = [mapping_words(transfer)]
    if countable(transfer.mapping):
        cover = transfer.mapping.coverage()
        words.append(f"{cover.mapped:.0%} of {cover.target_pairs:,} pairs mapped")
        if cover.ended:
            words.append(f"{cover.ended:.0%} at the source's end")
        if cover.unmapped:
            value = transfer.mapping.unmapped_value
            stated = "nothing known" if value is None else f"potential {value:g}"
            words.append(f"{cover.unmapped:.0%} unmapped ({stated})")
    if transfer.scale != 1:
        words.append(f"scaled by {transfer.scale:g}")
    if transfer.shift:
        words.append(f"shifted by {transfer.shift:g}")
    if transfer.calibration is not None:
        words.append("calibrated in the target")
    return "; ".join(words)


def countable(mapping: Any) -> bool:
    """Return whether the pairs of both tasks of a mapping are numbered, and few enough to count."""
    return not isinstance(mapping, ObservationMapping) and few_pairs(mapping.target, mapping.source)


def same_transfer(one: Transfer, other: Transfer) -> bool:
    """Return whether two transfers are the same."""
    names = ("source", "target", "scale", "shift", "calibration")
    if any(getattr(one, name) != getattr(other, name) for name in names):
        return False
    return one.mapping is other.mapping or _parts(one.mapping) == _parts(other.mapping)


def mappings_digest(transfers: Iterable[Transfer]) -> str:
    """Return a digest of what mappings with an index read, equal for equal mappings.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.transfer import identity, same_position
    >>> line = GridWorld("S.T")
    >>> one, other = (f(line, *more) for f, more in ((identity, []), (same_position, [line])))
    >>> mappings_digest([Transfer("a", "b", one)]) == mappings_digest([Transfer("a", "b", other)])
    True
    """
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for transfer in transfers:
        mapping = transfer.mapping
        digest.update(np.asarray(mapping.index, dtype=np.int64).tobytes())
        value = mapping.unmapped_value
        digest.update(("-" if value is None else f"{value:.{SIGNIFICANT}g} ").encode())
    return digest.hexdigest()


def _parts(mapping: Any) -> tuple[Any, ...]:
    """Return what tells a mapping from others."""
    if isinstance(mapping, ComponentMapping):
        return repr(mapping), mapping.unmapped_value
    if isinstance(mapping, ObservationMapping):
        actions = mapping.actions if callable(mapping.actions) else repr(mapping.actions)
        return mapping.observations, actions, mapping.status, mapping.unmapped_value
    return mapping.index.shape, mapping.index.tobytes(), mapping.unmapped_value
