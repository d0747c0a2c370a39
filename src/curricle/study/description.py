"""In what two descriptions of results differ, so that their results may too."""

import json
from collections.abc import Iterator
from typing import Any

MAY_CHANGE = ("name", "seeds", "seeds_per_unit", "threshold", "window", "snapshots")
"""Keys of a study on which no stored result depends."""


def differences(mine: Any, yours: Any, name: str = "") -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the keys, with both values, in which two descriptions differ and results may too."""
    if isinstance(mine, list) and isinstance(yours, list) and len(mine) == len(yours):
        mine, yours = (dict(enumerate(each)) for each in (mine, yours))
    if not (isinstance(mine, dict) and isinstance(yours, dict)):
        if mine != yours:
            yield name, (mine, yours)
        return
    for key in sorted({*mine, *yours}):
        place = f"{name}.{key}" if name and name != "configuration" else key
        # The record follows from the configuration and the study's own functions.
        if not (name == "configuration" and key in MAY_CHANGE) and place != "record":
            yield from differences(mine.get(key), yours.get(key), place)


def shown(value: Any) -> str:
    """Return a value in a sentence, cut where it is long."""
    text = json.dumps(value)
    return "absent" if value is None else text if len(text) < 60 else text[:56] + " ..."
