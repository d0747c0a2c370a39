"""Edges of a curriculum: a source's values, read through a mapping, scaled and shifted."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray
from curricle.checks import number, whole_number
from curricle.display import block
from curricle.errors import CurriculumError, SettingError
from curricle.learning.potential import LARGEST_POTENTIAL
from curricle.text import brief_repr
from curricle.transfer.mapping import TaskMapping

CALIBRATION_EPISODES = 200  # default number of greedy episodes of a calibration
CALIBRATION_SHARE = 20
"""By default a calibration takes at most 1/20 of its target's budget: 5 %."""
LARGEST_SHARE = 4  # a stated number of steps is cut to a quarter of that budget


@dataclass(frozen=True)
class Calibrate:
    """The settings of a calibration, for ``Transfer(..., calibrate=...)``.

    Parameters
    ----------
    episodes : int
        Greedy episodes in the target, at most. Their steps are charged to the target.
    max_steps : int, optional
        Steps in the target after which the last episode is truncated. In a curriculum by default a
        twentieth of the target's budget, and at most a quarter of it.

    Examples
    --------
    >>> Calibrate(max_steps=5_000)
    Calibrate(episodes=200, max_steps=5000)
    """

    episodes: int = CALIBRATION_EPISODES
    max_steps: int | None = None

    def __post_init__(self) -> None:
        for name in ("episodes", "max_steps"):
            if (value := getattr(self, name)) is not None:
                whole = whole_number(f"{name} of a calibration", value, 1, SettingError)
                object.__setattr__(self, name, whole)

    def within(self, steps: int, episodes: int) -> "Calibrate":
        """Return the calibration for a target with a budget of `steps` and `episodes`."""
        most = max(1, steps // (CALIBRATION_SHARE if self.max_steps is None else LARGEST_SHARE))
        few = min(self.episodes, max(1, episodes // CALIBRATION_SHARE))
        return Calibrate(few, most if self.max_steps is None else min(self.max_steps, most))


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
    calibrate : bool or Calibrate
        Whether to fit the target's potential to the returns of its own greedy policy before the
        target is learnt (:func:`calibrate`). Transfers into one task must agree.

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
    calibrate: bool | Calibrate = False

    __repr__ = brief_repr

    def _repr_html_(self) -> str:
        title = f"{self.source} -> {self.target}, scale {self.scale:g}, shift {self.shift:g}"
        return block(title) + ("" if self.mapping is None else self.mapping._repr_html_())

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
        if not isinstance(self.calibrate, bool | Calibrate):
            raise CurriculumError(
                f"calibrate of {edge} must be True, False or a Calibrate: got {self.calibrate!r}"
            )

    @property
    def calibration(self) -> Calibrate | None:
        """The settings of the calibration; None without calibration."""
        if isinstance(self.calibrate, Calibrate):
            return self.calibrate
        return Calibrate() if self.calibrate else None

    def potential(self, source_values: npt.ArrayLike) -> FloatArray:
        """Return phi_i, (..., S, A), for source values (..., S', A')."""
        if self.mapping is None:
            raise CurriculumError(
                f"the mapping of {self.source} -> {self.target} is found when a curriculum is made "
                "with the transfer: it has none yet"
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
        phrases.append(f"{cover.mapped:.0%} of {cover.target_pairs:,} pairs mapped")
        phrases += [f"{cover.ended:.0%} at the source's end"] if cover.ended else []
        stated = "nothing known" if value is None else f"potential {value:g}"
        phrases += [f"{cover.unmapped:.0%} unmapped ({stated})"] if cover.unmapped else []
    phrases += [f"scaled by {transfer.scale:g}"] if transfer.scale != 1 else []
    phrases += [f"shifted by {transfer.shift:g}"] if transfer.shift else []
    phrases += [FOUND] if transfer.mapping.knows_target else []
    phrases += ["calibrated in the target"] if transfer.calibration is not None else []
    return "; ".join(phrases)


def same_transfer(transfer: Transfer, other: Transfer) -> bool:
    """Return whether two transfers are the same."""
    names = ("source", "target", "scale", "shift", "calibration")
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
