"""Run the paper: every figure into a folder, with its data, its claims and one page."""

from collections import Counter
from collections.abc import Iterable
from importlib import metadata
from math import isnan
from pathlib import Path
from typing import Any

import matplotlib

from curricle.checks import one_of
from curricle.errors import SettingError
from curricle.paper.figure4 import figure4
from curricle.paper.mazes import figure1, figure2, figure3, hacking
from curricle.paper.settings import FigureResult, Progress
from curricle.paper.trust_figure import trust
from curricle.progress import Bars, check_progress, shown
from curricle.show import STYLE, content_of, render
from curricle.statistics import Interval
from curricle.study import StudyStore
from curricle.text_tables import counted

INTENDED_SEEDS = 30
"""Seeds that the verdicts are meant for."""

FIGURES = {
    "1": figure1,
    "2": figure2,
    "3": figure3,
    "4": figure4,
    "trust": trust,
    "hacking": hacking,
}


def reproduce(
    folder: str | Path,
    *,
    figures: Iterable[str] = tuple(FIGURES),
    seeds: int = INTENDED_SEEDS,
    workers: int | None = None,
    progress: bool | Progress | Bars | None = True,
) -> list[dict[str, Any]]:
    """Write figures, data, claims and the page into a folder, and return all claims in it.

    Figures that are complete in the folder, which holds results of these settings only, are not run
    again. A function as `progress` is called with a short message for each part. SettingError on an
    unknown figure or fewer than 2 seeds; nothing is written then.
    """
    check_progress(progress)
    wanted = list(dict.fromkeys(figures))
    for name in wanted:
        one_of("a figure", name, FIGURES, SettingError)
    if seeds < 2:
        raise SettingError(f"intervals over seeds need at least 2 seeds: got {seeds}")
    if workers is not None and workers < 1:
        raise SettingError(f"workers must be at least 1: got {workers}")
    settings = {"curricle": metadata.version("curricle"), "seeds": seeds}
    now = ""
    with (
        StudyStore.opened(folder, settings, resume=True) as store,
        shown(progress, lambda: now) as bars,
    ):

        def say(words: str) -> None:
            nonlocal now
            now = words
            bars.tell(words)

        grow = bars.bar("figures", len(wanted))
        for name in wanted:
            if not store.has(_summary(name)):
                with matplotlib.rc_context(STYLE):
                    _save(store, name, FIGURES[name](seeds, workers, say))
            grow()
        return _assemble(store, seeds)


def seeds_words(seeds: int) -> str:
    """Return how many seeds everything is learnt with, and whether these are too few."""
    words = f"Every learner is trained with {counted(seeds, 'seed')}."
    if seeds < INTENDED_SEEDS:
        words += (
            f" The verdicts are meant for {INTENDED_SEEDS}: with fewer they may differ, and a "
            "claim may be not reproduced for that reason alone."
        )
    return words


def _summary(name: str) -> str:
    """Return the file of a figure that is written last: if it is there, the figure is complete."""
    return f"data/{'figure' * name.isdigit()}{name}.json"


def _save(store: StudyStore, name: str, result: FigureResult) -> None:
    for ending in (".png", ".svg"):
        store.write(result.name + ending, content_of(result.figure, ending))
    for table, columns in result.tables.items():
        store.write_table(f"data/{table}.parquet", columns)
    store.write_json(
        _summary(name),
        {
            "title": result.title,
            "caption": result.caption,
            "image": f"{result.name}.svg",
            "settings": dict(result.settings),
            "claims": [
                {"id": claim.id, "figure": name, **vars(claim)}
                | {"evidence": {key: _as_data(value) for key, value in claim.evidence.items()}}
                for claim in result.claims
            ],
            "links": {"PNG": f"{result.name}.png"}
            | {f"{table}.parquet": f"data/{table}.parquet" for table in result.tables},
        },
    )


def _as_data(value: Any) -> Any:
    """Return an interval as estimate, low, high and seeds; other evidence as it is."""
    if not isinstance(value, Interval):
        return value
    parts = {name: float(getattr(value, name)) for name in ("estimate", "low", "high")}
    # Bounds that do not exist are None, as JSON has no NaN.
    known = {name: None if isnan(part) else part for name, part in parts.items()}
    return {**known, "seeds": value.n}


def _assemble(store: StudyStore, seeds: int) -> list[dict[str, Any]]:
    """Write claims.json and index.html from all figures in the folder."""
    sections = [store.read_json(_summary(name)) for name in FIGURES if store.has(_summary(name))]
    claims = [claim for section in sections for claim in section["claims"]]
    store.write_json("claims.json", claims)
    title = "Curriculum Learning via Reward Shaping, reproduced"
    counts = Counter(claim["verdict"] for claim in claims)
    page = render(
        "paper.html", title=title, counts=counts, sections=sections, seeds=seeds_words(seeds)
    )
    store.write("index.html", page.encode())
    return claims
