"""What a stopping rule decided in a task, for all seeds, in a few words and as a table."""

from collections import Counter
from collections.abc import Iterable, Sequence

from curricle.display import block, table
from curricle.learning.stopping import Decision
from curricle.text_tables import counted


class Decisions(list[list[Decision]]):
    """What a stopping rule decided at each checkpoint of each seed: a list of K lists.

    Examples
    --------
    >>> from curricle import Curriculum, GridWorld, StoppingRule
    >>> rule = StoppingRule(max_steps=5_000, threshold=100.0)
    >>> plan = Curriculum({"maze": GridWorld("S..T")}, budget=rule)
    >>> plan.train(seeds=3).decisions("maze")
    Decisions(3 seeds: threshold reached (3))
    """

    def __init__(self, each: Iterable[list[Decision]], seeds: Sequence[int]):
        super().__init__(each)
        self.seeds = tuple(seeds)

    @property
    def in_words(self) -> str:
        """What ended training, and of how many seeds; empty without a rule."""
        ends = Counter(one[-1].criterion or "none yet" for one in self if one)
        return ", ".join(f"{words} ({number})" for words, number in ends.most_common())

    def __repr__(self) -> str:
        words = self.in_words or "no stopping rule"
        return f"Decisions({counted(len(self), 'seed')}: {words})"

    def _repr_html_(self) -> str:
        last = [(seed, one[-1]) for seed, one in zip(self.seeds, self, strict=True) if one]
        rows = [(seed, f"{one.step:,}", str(one)) for seed, one in last]
        head = ["seed", "step", "last decision"]
        return block(repr(self), rows and table(head, rows, wide=head[-1:]))
