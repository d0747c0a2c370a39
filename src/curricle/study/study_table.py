"""A study and its results: in a few words, and as HTML for a notebook."""

from typing import Any

from curricle.checks import listed
from curricle.comparison.comparison import as_html
from curricle.display import block, shortened, table
from curricle.errors import CurricleError
from curricle.text_tables import counted


class ShownStudy:
    """How the results of a study show themselves."""

    def __repr__(self: Any) -> str:
        return shortened(f"StudyResults({self.record.name!r}, {_so_far(self)})")

    def _repr_html_(self: Any) -> str:
        """Return the comparison of the arms, or why there is none yet, and what failed."""
        failed = [f"arm {arm} failed: {error}" for arm, error in self.failed.items()]
        title = f"Study {self.record.name!r}: {_so_far(self)}"
        try:
            compared = as_html(self.comparison)
        except CurricleError as error:
            return block(title, str(error), *failed)
        return block(title, *failed) + compared


def _so_far(results: Any) -> str:
    arms = counted(len(results.record.arms), "arm")
    whole = counted(len(results.record.seeds), "seed")
    return f"{arms}, {len(results.seeds)} of {whole} complete"


def config_in_brief(study: Any) -> str:
    """Return a study in a few words: its seeds and arms."""
    seeds, arms = counted(len(study.seeds), "seed"), listed(study.arms)
    return shortened(f"StudyConfig({study.name!r}, {seeds}; arms: {arms})")


def config_html(study: Any) -> str:
    """Return a study as a table of the tasks of each arm, and one of the transfers."""
    tasks = [
        (arm, name, one.type, "" if one.budget is None else str(one.budget))
        for arm, tables in study.arms.items()
        for name, one in tables.tasks.items()
    ]
    transfers = [
        (arm, one.source, one.target, str(one.mapping))
        for arm, tables in study.arms.items()
        for one in tables.transfers
    ]
    return block(
        f"Study {study.name!r}, {counted(len(study.seeds), 'seed')}",
        table(["arm", "task", "type", "budget"], tasks, wide=["budget"]),
        transfers and table(["arm", "source", "target", "mapping"], transfers, wide=["mapping"]),
    )
