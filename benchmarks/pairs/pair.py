"""A pair: a target, a source, and how the target reads the source's values."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import curricle as cr
from curricle.planning.target import Target
from curricle.transfer import StateActionMapping
from curricle.transfer.mapping import PairMapping

Split = Literal["development", "verification", "fresh", "blind"]
SENSIBLE = ("near", "far")
"""Kinds whose source a person would call sensible."""
CHECKPOINTS = 40
UNLEARNT, TOO_LARGE = 0.02, 2.0
"""Budget of a source that has not learnt, in its own; of one far too large, in the target's."""


@dataclass(frozen=True, eq=False)
class Pair:
    """One target, one source and the mappings between them.

    Parameters
    ----------
    name : str
        ``family/label``, the label within its family.
    family : str
    split : {"development", "verification", "fresh", "blind"}
        Of the whole family.
    kind : str
        ``near`` and ``far`` are sensible. ``wrong goal``: the source's goal is not the target's.
        ``mirrored``: the mapping mirrors states or actions. ``negated``: a sensible potential times
        -1. ``unlearnt``: a sensible source that stops long before it has learnt. ``too large``: a
        sensible source that spends twice the target's budget. ``useless``: a source that says
        nothing of the target.
    sensible : bool
        Whether a person would call the source sensible.
    target_name : str
        Names the target within its family; pairs with one target share its name and its task.
    source, target : Task
    mappings : tuple of StateActionMapping
        One transfer each.
    source_budget, target_budget : int
        Steps.
    scale : float
        Of every transfer; -1 for a negated potential.
    aggregate : callable
        Of the transfers, where there are several.
    """

    name: str
    family: str
    split: Split
    kind: str
    sensible: bool
    target_name: str
    source: Any
    target: Any
    mappings: tuple[PairMapping, ...]
    source_budget: int
    target_budget: int
    scale: float = 1.0
    aggregate: Any = cr.mean

    @property
    def eval_freq(self) -> int:
        """Steps between checkpoints of the target."""
        return self.target_budget // CHECKPOINTS

    @property
    def label(self) -> str:
        """The name within its family."""
        return self.name.partition("/")[2]

    def transfers(self) -> list[cr.Transfer]:
        """Return the transfers."""
        return [cr.Transfer("source", "target", one, self.scale) for one in self.mappings]

    def curriculum(self, **settings: Any) -> cr.Curriculum:
        """Return the curriculum of a source and a target, by default by the raw potential.

        Checkpoints and their exact evaluation are how the benchmark looks, not how anything learns.
        Aggregates belong to the mapping of a pair.
        """
        given: dict[str, Any] = {
            "budget": {"source": cr.StoppingRule(self.source_budget), "target": self.target_budget},
            "eval_freq": {"source": max(1, self.source_budget // 10), "target": self.eval_freq},
            "evaluation": cr.GreedyEvaluation(method="exact"),
            "aggregate": self.aggregate,
            "shaping": cr.QInitialisation(),
        }
        return cr.Curriculum(
            {"source": self.source, "target": self.target},
            self.transfers(),
            **{**given, **settings},
        )


@cache
def levels(task: Any) -> tuple[float, float]:
    """Return the random policy's return in a task and the optimum, as checkpoints measure it."""
    target = Target.of(task, cr.GreedyEvaluation(method="exact"))
    return float(target.random_return), float(target.optimum)


class Family:
    """Collects the pairs of a family."""

    def __init__(self, name: str, split: Split) -> None:
        self.name, self.split = name, split
        self.pairs: dict[str, Pair] = {}
        self._target: tuple[str, Any, int]

    def target(self, name: str, task: Any, budget: int) -> Any:
        """Set the target of the pairs to come, and return it."""
        self._target = name, task, budget
        return task

    def add(
        self, kind: str, label: str, source: Any, *reads: Any, budget: int, turned: bool = False,
        **settings: Any,
    ) -> None:  # fmt: skip
        """Add a pair with the present target.

        Each of `reads` makes a transfer: a mapping, or a function as `cr.from_function` takes it;
        by default the source is read by the target's names. `turned`: the last action but so many.
        """
        target_name, target, target_budget = self._target
        mappings = [
            read if isinstance(read, PairMapping) else cr.from_function(target, source, read)
            for read in reads or [lambda state, action: (state, action)]
        ]
        if turned:
            mappings = [StateActionMapping(target, source, of.index[:, ::-1]) for of in mappings]
        name = f"{self.name}/{label}"
        self.pairs[name] = Pair(
            name=name,
            family=self.name,
            split=self.split,
            kind=kind,
            sensible=kind in SENSIBLE,
            target_name=target_name,
            source=source,
            target=target,
            mappings=tuple(mappings),
            source_budget=budget,
            target_budget=target_budget,
            **settings,
        )

    def spoil(self, label: str) -> None:
        """Add what spoils any sensible pair: negated, not learnt, learnt for far too long."""
        pair = self.pairs[f"{self.name}/{label}"]
        few = max(20, round(UNLEARNT * pair.source_budget))
        many = round(TOO_LARGE * pair.target_budget)
        for kind, change in (
            ("negated", {"scale": -pair.scale}),
            ("unlearnt", {"source_budget": few}),
            ("too large", {"source_budget": many}),
        ):
            name = f"{pair.name}, {kind}"
            self.pairs[name] = replace(pair, name=name, kind=kind, sensible=False, **change)
