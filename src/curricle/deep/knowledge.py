"""What is known of observations: the values and the policy that a network is fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, Self

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, IntArray, adopted
from curricle.errors import PotentialError
from curricle.interop.tabulation.tabulated_task import action_probabilities, assembled, parts_of
from curricle.planning.solution import greedy_policy
from curricle.text import brief_repr

COLUMNS = ("values", "action_values", "policy", "states")
"""What is known, by row."""


@dataclass(frozen=True, eq=False)
class Knowledge(Frozen):
    """Values, action values and a policy over n different observations."""

    observations: Any  # n, stacked
    values: FloatArray  # (n,) V
    action_values: FloatArray | None  # (n, A) Q
    policy: FloatArray | None  # (n, A) the probability of each action
    states: IntArray  # (n,) how many states look like this: what is known is their mean

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        for name in ("values", "action_values", "policy"):
            found = getattr(self, name)
            if found is not None:
                object.__setattr__(self, name, adopted(found, np.float64))
        object.__setattr__(self, "states", adopted(self.states, np.int64))

    @classmethod
    def of(
        cls, observations: Any, action_values: FloatArray, policy: FloatArray | None = None
    ) -> Self:
        """Return what action values (S, A) say of S observations; greedy unless a policy is given.

        V is the largest of an observation's states' action values, then their mean.
        """
        action_values = np.asarray(action_values, np.float64)
        chosen = greedy_policy(action_values) if policy is None else np.asarray(policy)
        values = action_values.max(axis=1)
        return cls._merged(observations, values, action_values, chosen, np.ones(len(values), int))

    @classmethod
    def read(cls, values: Any, observations: Any) -> Self:
        """Return what a :class:`ValueSource` says of n observations.

        Its Q and the greedy policy where it has action values, else V, and the policy where it is
        of one actor-critic that is read as it is. Observations of which it knows nothing (NaN) are
        left out.
        """
        pairs = values.pairs(observations) if values.of_actions else None
        v = values.v(observations) if pairs is None else pairs.max(axis=1)
        known = np.isfinite(v)
        if not known.any():
            raise PotentialError(
                f"knowledge to distil must be of some observation: none of {len(v):,} is mapped"
            )
        seen = rows_of(observations, known)
        if pairs is not None:
            return cls.of(seen, pairs[known])
        actor = actor_of(values)
        policy = None if actor is None else action_probabilities(actor, seen)
        return cls._merged(seen, v[known], None, policy, np.ones(int(known.sum()), int))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return what several know together, each weighted by its states."""
        first = parts[0]
        seen = [parts_of(part.observations) for part in parts]
        observations = assembled({n: np.concatenate([each[n] for each in seen]) for n in seen[0]})
        columns = [
            None
            if getattr(first, name) is None
            else np.concatenate([getattr(part, name) for part in parts])
            for name in COLUMNS
        ]
        return cls._merged(observations, *columns)  # type: ignore[arg-type]

    @property
    def alike(self) -> float:
        """The share of states that look like another: what the observation hides."""
        return float(self.states[self.states > 1].sum() / self.states.sum())

    def shuffled(self, seed: int) -> Self:
        """Return the same values and policies, each with the observation of another."""
        order = np.random.default_rng(seed).permutation(len(self.values))
        columns = (getattr(self, name) for name in COLUMNS)
        mixed = [None if column is None else column[order] for column in columns]
        return type(self)(self.observations, *mixed)  # type: ignore[arg-type]

    @classmethod
    def _merged(
        cls,
        observations: Any,
        values: FloatArray,
        action_values: FloatArray | None,
        policy: FloatArray | None,
        states: IntArray,
    ) -> Self:
        first, group = _distinct(observations)
        weight = np.bincount(group, states)

        def mean(each: FloatArray | None) -> FloatArray | None:
            if each is None:
                return None
            total = np.zeros((len(first), *each.shape[1:]))
            np.add.at(total, group, (each.T * states).T)
            return np.asarray((total.T / weight).T)

        seen = rows_of(observations, first)
        v = np.asarray(mean(values))
        return cls(seen, v, mean(action_values), mean(policy), weight)


def actor_of(values: Any) -> Any:
    """Return the one network of a potential if it acts in the same observations; else None."""
    edges: Any = getattr(values, "edges", ())
    sources: Any = getattr(values, "values", ())
    if len(sources) != 1 or not edges[0].mapping.is_identity:
        return None
    return sources[0] if getattr(sources[0], "kind", "") == "value_net" else None


def rows_of(observations: Any, rows: IntArray | BoolArray) -> Any:
    """Return some of n stacked observations."""
    return assembled({name: part[rows] for name, part in parts_of(observations).items()})


def _distinct(observations: Any) -> tuple[IntArray, IntArray]:
    """Return the first row of each different observation, and which of them each row is, (n,)."""
    leaves = [np.ascontiguousarray(part) for part in parts_of(observations).values()]
    numbers = dict[bytes, int]()
    first, group = list[int](), np.empty(len(leaves[0]), np.int64)
    for row in range(len(leaves[0])):
        key = blake2b(b"".join(leaf[row].tobytes() for leaf in leaves), digest_size=16).digest()
        if key not in numbers:
            numbers[key] = len(first)
            first.append(row)
        group[row] = numbers[key]
    return np.array(first, np.int64), group
