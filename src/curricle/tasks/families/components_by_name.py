"""How members of a task family map onto each other, declared as data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from curricle.checks import one_of
from curricle.errors import TaskError

Unequal = Literal["unmapped", "clip", "scale"]


@dataclass(frozen=True)
class ComponentsByName:
    """Components of the source are read off those of the target by name.

    Components with labels correspond label by label, others number by number. :func:`project` is
    this mapping with ``unequal="unmapped"``.

    Parameters
    ----------
    unequal : {"unmapped", "clip", "scale"}
        What becomes of values without labels where the ranges of a component differ. With
        "unmapped" the numbers that the source lacks have no counterpart. With "clip" they become
        its nearest number. With "scale" the target's whole range is spread over the source's:
        low' + floor((v - low) size' / size).
    renaming : dict of str to str
        Source component -> target component, where the names differ.

    Examples
    --------
    >>> ComponentsByName("clip", {"predator": "predator_1"})
    ComponentsByName(unequal='clip', renaming=(('predator', 'predator_1'),))
    """

    unequal: Unequal = "unmapped"
    renaming: Any = ()

    def __post_init__(self) -> None:
        one_of("unequal", self.unequal, ("unmapped", "clip", "scale"), TaskError)
        given = self.renaming.items() if isinstance(self.renaming, Mapping) else self.renaming
        try:
            pairs = tuple(sorted((source, target) for source, target in given))
        except (TypeError, ValueError):
            pairs = ((None, None),)
        if not all(isinstance(name, str) for pair in pairs for name in pair):
            raise TaskError(
                "renaming must be a dict of source components to target components: got "
                f"{self.renaming!r}"
            )
        object.__setattr__(self, "renaming", pairs)
