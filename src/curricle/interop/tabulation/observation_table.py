"""What is observed in each state of a table, and the state that an observation shows."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray, IntArray
from curricle.display import brief_repr
from curricle.errors import TaskError
from curricle.frozen_arrays import Frozen, adopted
from curricle.tasks.observation_task import batch_size
from curricle.transfer.mapping import UNMAPPED

Leaf = npt.NDArray[Any]
POSITION = "#"
"""Begins the name of a part of a tuple, before its position."""


class Unseen:
    """Stands for an observation that a step did not make, as nobody may look at it."""


@dataclass(frozen=True, eq=False)
class ObservationTable(Frozen):
    """The observation of each of S states.

    Parameters
    ----------
    parts : dict of str to (S, ...) arrays
        Numbers or text, by their place in an observation: ``""`` if it is one array, else the keys
        on the way to it, joined by ``/``; ``#0`` is the first part of a tuple.
    terminal : (S,) bool array
        Which states end an episode: another state that looks the same is preferred.

    Examples
    --------
    >>> table = ObservationTable({"": np.array([[0.0], [1.0], [1.0]])}, np.zeros(3, bool))
    >>> table.state([0.0]), table.state([1.0]), table.ambiguous.tolist()
    (0, -1, [False, True, True])
    """

    parts: Mapping[str, Leaf]
    terminal: BoolArray

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "parts", {name: adopted(a, a.dtype) for name, a in self.parts.items()}
        )
        object.__setattr__(self, "terminal", adopted(self.terminal, np.bool_))

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self.__post_init__()  # arrays in a dict are writable in a copy

    def batch(self, states: Any = None) -> Any:
        """Return the observations of some states (default: all), stacked; (n, ...) arrays.

        In tuples and dicts where an observation has them, as vector environments stack them.
        """
        chosen = {name: a if states is None else a[states] for name, a in self.parts.items()}
        return _assembled(chosen)

    def state(self, observation: Any) -> int:
        """Return the state that an observation shows; `UNMAPPED` if none or several do."""
        return self._states.get(self._key(parts_of(observation)), UNMAPPED)

    def many(self, observations: Any) -> IntArray:
        """Return the states that n stacked observations show, (n,) int64; as :meth:`state`."""
        stacked = parts_of(observations)
        rows = range(batch_size(observations))
        found = (self._key({name: a[i] for name, a in stacked.items()}) for i in rows)
        return np.array([self._states.get(key, UNMAPPED) for key in found], dtype=np.int64)

    @cached_property
    def ambiguous(self) -> BoolArray:
        """Which states look like another, (S,) bool: no observation shows them."""
        unique = np.zeros(len(self.terminal), dtype=bool)
        unique[[state for state in self._states.values() if state != UNMAPPED]] = True
        return ~unique

    @cached_property
    def _states(self) -> dict[bytes, int]:
        """The state of each observation, `UNMAPPED` where several look the same."""
        found = dict[bytes, int]()
        for ends in (False, True):
            of_these = dict[bytes, int]()
            for state in np.flatnonzero(self.terminal == ends).tolist():
                key = self._key({name: a[state] for name, a in self.parts.items()})
                of_these[key] = UNMAPPED if key in of_these else state
            found = of_these | found
        return found

    def _key(self, parts: Mapping[str, Any]) -> bytes:
        """Return what is equal for equal observations; of another shape, equal to no other."""
        if parts.keys() != self.parts.keys():
            return b""
        words = []
        for name, kept in self.parts.items():
            part = np.asarray(parts[name])
            if kept.dtype.kind == "U" or part.dtype.kind == "U":
                words.append(str(part).encode())
            else:
                same = part.astype(kept.dtype, copy=False)
                words.append(same.tobytes() if (same == part).all() else b"other")
            words.append(b"%r" % (part.shape,))
        return b"\0".join(words)


def stacked_observations(observations: Sequence[Any], terminal: Iterable[bool]) -> ObservationTable:
    """Return the table of the observations of S states; TaskError where they cannot be stacked."""
    of_states = [parts_of(one) for one in observations]
    parts = dict[str, Leaf]()
    for name in of_states[0]:
        each: list[Any] = [parts.get(name) for parts in of_states]
        shapes = {np.shape(part) for part in each}
        if len(shapes) > 1 or any(len(parts) != len(of_states[0]) for parts in of_states):
            raise TaskError(
                f"observations must have one shape to be tabulated: {name or 'they'} came in "
                f"{len(shapes)} shapes"
            )
        parts[name] = np.array(each)
        if parts[name].dtype.kind not in "biufU":
            raise TaskError(
                "observations must be numbers or text, or tuples and dicts of these, to be "
                f"tabulated: got {observations[0]!r}"
            )
    return ObservationTable(parts, np.array(list(terminal), dtype=bool))


def parts_of(observation: Any) -> dict[str, Any]:
    """Return the arrays, numbers and texts in an observation, by their places.

    Examples
    --------
    >>> parts_of({"sight": (1, 2), "goal": "key"})
    {'sight/#0': 1, 'sight/#1': 2, 'goal': 'key'}
    """
    if isinstance(observation, Mapping):
        inner = [(str(key), part) for key, part in observation.items()]
    elif isinstance(observation, tuple):
        inner = [(f"{POSITION}{i}", part) for i, part in enumerate(observation)]
    else:
        return {"": observation}
    return {
        f"{key}/{path}".rstrip("/"): leaf
        for key, part in inner
        for path, leaf in parts_of(part).items()
    }


def same_observation(one: Any, other: Any) -> bool:
    """Return whether two observations are equal, part by part; one that is unseen equals all.

    Examples
    --------
    >>> same_observation({"a": np.zeros(2)}, {"a": np.zeros(2)}), same_observation((1, 2), (1, 3))
    (True, False)
    """
    if isinstance(one, Unseen) or isinstance(other, Unseen):
        return True
    mine, yours = parts_of(one), parts_of(other)
    return mine.keys() == yours.keys() and all(
        np.array_equal(mine[name], yours[name], equal_nan=_is_float(mine[name])) for name in mine
    )


def _is_float(value: Any) -> bool:
    return bool(np.asarray(value).dtype.kind == "f")


def _assembled(parts: Mapping[str, Leaf]) -> Any:
    """Return parts in the tuples and dicts that they were taken from."""
    if list(parts) == [""]:
        return parts[""]
    inner = dict[str, dict[str, Leaf]]()
    for name, part in parts.items():
        key, _, path = name.partition("/")
        inner.setdefault(key, {})[path] = part
    if all(key.startswith(POSITION) for key in inner):
        return tuple(_assembled(part) for part in inner.values())
    return {key: _assembled(part) for key, part in inner.items()}
