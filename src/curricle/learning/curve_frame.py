"""The curves of a result as a tidy table: a row for each seed and checkpoint."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.learning.result_arrays import CURVES, Arrays

UNITS = {
    "seed": "",
    "checkpoint": "",
    "steps": "steps in the task",
    "source_steps": "steps in all sources",
    "training_return": "mean undiscounted return of an episode",
    "greedy_return": "return of the greedy policy",
    "guard_share": "share of steps",
    "episodes": "episodes ended",
}
"""Of each column."""


def curve_columns(arrays: Arrays, task: str | None = None) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a result's curves, each seed up to its own end.

    There is a column ``task`` if its name is given, and ``source_steps`` if they are among the
    arrays.
    """
    steps = arrays["steps"]
    reached = steps[None, :] <= arrays["steps_used"][:, None]
    seed, checkpoint = np.nonzero(reached)
    columns = {} if task is None else {"task": np.array([task] * len(seed), dtype=object)}
    columns |= {
        "seed": arrays["seeds"][seed],
        "checkpoint": checkpoint,
        "steps": steps[checkpoint],
    }
    if "source_steps" in arrays:
        columns["source_steps"] = arrays["source_steps"][seed]
    return columns | {name: arrays[name][reached] for name in CURVES}


def data_frame(columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    """Return columns as a pandas DataFrame, whose ``attrs["units"]`` are those of each column.

    ImportError where pandas is not installed.
    """
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise ImportError("a DataFrame needs pandas: pip install pandas") from None
    frame = pd.DataFrame(dict(columns))
    frame.attrs["units"] = {name: UNITS[name] for name in columns if UNITS.get(name)}
    return frame
