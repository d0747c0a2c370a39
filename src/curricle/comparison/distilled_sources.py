"""How well networks distilled from miniatures act on held-out levels."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from curricle.array_types import FloatArray
from curricle.curriculum.sources import SourceValues
from curricle.deep.miniature import Miniatures
from curricle.frozen_arrays import Frozen
from curricle.tasks.observation_task import made_by
from curricle.text_tables import counted


@dataclass(frozen=True, eq=False)
class DistilledSource(Frozen):
    """What networks of K seeds regain of the way from the random policy to the optimum.

    Exact, by the miniatures' tables. Prints as a sentence.

    Attributes
    ----------
    name : str
    members : tuple of str
        The miniatures, then those that are only tested on.
    levels : tuple of int
        How many levels each was examined on.
    shares : (K, M) float64
        What each seed regains in each.
    """

    name: str
    members: tuple[str, ...]
    levels: tuple[int, ...]
    shares: FloatArray

    @property
    def expected(self) -> float:
        """The share to expect of the target: that of the last member, which is the nearest to it.

        ``benchmarks/deep_forecast.py`` measures how well it ranks sources.
        """
        return float(self.shares[:, -1].mean())

    def __str__(self) -> str:
        each = zip(self.shares.mean(axis=0), self.levels, self.members, strict=True)
        told = [
            f"{round(x, 2) + 0.0:.0%} on {counted(n, 'level')} of {member}" for x, n, member in each
        ]
        return (
            f"{self.name}'s network regains {', '.join(told)}, held out, of the way from random to "
            "optimal"
        )


def distilled_sources(
    tasks: Mapping[str, object], sources: Mapping[str, SourceValues]
) -> dict[str, DistilledSource]:
    """Return how well each source that was distilled from miniatures acts, by its name."""
    found = {}
    for name, learnt in sources.items():
        task = tasks.get(name)
        if isinstance(task, Miniatures) and learnt.values is not None:
            each = [task.examined(values) for values in learnt.values]
            shares = np.array([[one.regained for one in examined] for examined in each])
            members = tuple(made_by(one.member.make) for one in each[0])
            levels = tuple(one.levels for one in each[0])
            found[name] = DistilledSource(name, members, levels, shares)
    return found
