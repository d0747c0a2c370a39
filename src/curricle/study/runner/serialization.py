"""A learning result as plain arrays, to be sent and stored, and back again."""

import re
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.curriculum.node import Node
from curricle.learning.result import LearningResult
from curricle.learning.snapshots import Snapshots
from curricle.learning.storage import SparseValues
from curricle.tasks.spaces import frozen

Arrays = Mapping[str, npt.NDArray[Any]]
PLAIN = (
    "steps",
    "training_return",
    "greedy_return",
    "trust",
    "episodes",
    "steps_used",
    "episodes_used",
    "out_of_memory",
)


def arrays_of(
    result: LearningResult,
    source_steps: npt.NDArray[np.int64],
    returned_steps: npt.NDArray[np.int64],
) -> dict[str, npt.NDArray[Any]]:
    """Return a result's arrays by name, with the steps that each seed spent on sources, (K,).

    ``returned_steps`` are those of them that were spent on going back to the sources.

    ``values`` are there if they were kept, or for each seed k the ``states_k`` and ``values_k`` of
    its sparse table, or the parameters of its network, ``values_k/name``; ``film_steps`` and
    ``film_values`` if there is a snapshots.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> none = np.zeros(1, np.int64)
    >>> sorted(arrays_of(learn(GridWorld("S.T"), budget=100), none, none))[-3:]
    ['training_return', 'trust', 'values']
    """
    found = {name: getattr(result, name) for name in PLAIN}
    found |= {"seeds": np.array(result.seeds, dtype=np.int64)}
    found |= {"source_steps": source_steps, "returned_steps": returned_steps}
    if isinstance(result.values, np.ndarray):
        found["values"] = result.values
    elif result.values is not None:
        for k, one in enumerate(result.values):
            if isinstance(one, SparseValues):
                found |= {f"states_{k}": one.states, f"values_{k}": one.values}
            else:
                found |= {f"values_{k}/{name}": each for name, each in one.parameters().items()}
    if result.snapshots is not None:
        found |= {"film_steps": result.snapshots.steps, "film_values": result.snapshots.values}
    return found


def result_of(node: Node, arrays: Arrays) -> LearningResult:
    """Return the result that :func:`arrays_of` was called on; without values if there are none.

    Those of networks are left out: :func:`recalled` makes them anew.
    """
    seeds = tuple(arrays["seeds"].tolist())
    values: Any = arrays.get("values")
    if f"states_{len(seeds) - 1}" in arrays:
        values = tuple(
            SparseValues(arrays[f"states_{k}"], arrays[f"values_{k}"]) for k in range(len(seeds))
        )
    snapshots = None
    if "film_steps" in arrays:
        snapshots = Snapshots(seeds[0], frozen(arrays["film_steps"]), frozen(arrays["film_values"]))
    plain: dict[str, Any] = {name: frozen(arrays[name]) for name in PLAIN}
    return LearningResult(
        task=node.task,
        learner=node.learner,
        seeds=seeds,
        values=frozen(values) if isinstance(values, np.ndarray) else values,
        snapshots=snapshots,
        **plain,
    )


def of_seeds(arrays: Arrays, seeds: Collection[int]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of some seeds; a snapshots stays if its seed, the first, is one of them."""
    rows = np.flatnonzero(np.isin(arrays["seeds"], list(seeds))).tolist()
    found = dict[str, npt.NDArray[Any]]()
    for name, array in arrays.items():
        own = re.fullmatch(r"(states|values)_(\d+)(/.*)?", name)
        if own and int(own[2]) in rows:
            found[f"{own[1]}_{rows.index(int(own[2]))}{own[3] or ''}"] = array
        elif name == "steps" or (name.startswith("film_") and 0 in rows):
            found[name] = array
        elif not own and not name.startswith("film_"):
            found[name] = array[rows]
    return found
