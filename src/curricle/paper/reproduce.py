"""Run the paper: every figure into a folder, with its data, its claims and a page."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib

from curricle.checks import one_of, whole_number
from curricle.errors import SettingError, StoreError, reason
from curricle.files import as_json, write_whole
from curricle.paper.figure4 import figure4
from curricle.paper.mazes import Progress, Studies, figure1, figure2, figure3, hacking
from curricle.paper.trust_figure import trust
from curricle.progress import Bars, shown
from curricle.show import STYLE, render
from curricle.text import counted

INTENDED_SEEDS = 30  # seeds that the verdicts are meant for
CLAIMS, STUDIES = "claims.json", "studies"
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
    """Write figures, data, claims and the page into a folder, and return the claims."""
    wanted = list(dict.fromkeys(figures))
    for name in wanted:
        one_of("a figure", name, FIGURES, SettingError)
    if seeds < 2:
        raise SettingError(f"intervals over seeds need at least 2 seeds: got {seeds}")
    if workers is not None:
        whole_number("workers", workers, 1, SettingError)
    folder, files, sections, part = Path(folder), dict[str, bytes](), [], ""
    try:
        if folder.exists() and any(folder.iterdir()) and not (folder / STUDIES).is_dir():
            raise StoreError(
                "the paper needs a new or empty folder, or one of an earlier run: "
                f"{folder} holds other files"
            )
        with shown(progress, lambda: part) as bars, matplotlib.rc_context(STYLE):

            def say(message: str) -> None:
                nonlocal part
                part = message
                bars.tell(message)

            (folder / STUDIES).mkdir(parents=True, exist_ok=True)
            studies = Studies(folder / STUDIES, seeds, workers, bars, say)
            grow = bars.bar("figures", len(wanted))
            for name in (name for name in FIGURES if name in wanted):
                made, section = FIGURES[name](studies).files(name)
                files |= made
                sections.append(section)
                grow()
        claims = [claim for section in sections for claim in section["claims"]]
        counts = Counter(claim["verdict"] for claim in claims)
        title = "Curriculum Learning via Reward Shaping, reproduced"
        values = {
            "title": title,
            "counts": counts,
            "sections": sections,
            "seeds": seeds_words(seeds),
        }
        files[CLAIMS] = as_json(claims)
        files["index.html"] = render("paper.html", values).encode()
        (folder / "data").mkdir(parents=True, exist_ok=True)
        for file, content in files.items():
            write_whole(folder / file, content)
    except OSError as error:
        raise StoreError(f"the paper cannot be written to {folder}: {reason(error)}") from None
    return claims


def seeds_words(seeds: int) -> str:
    """Return a sentence on the seeds of every learner, with a warning if they are too few."""
    sentence = f"Every learner is trained with {counted(seeds, 'seed')}."
    if seeds < INTENDED_SEEDS:
        sentence += (
            f" The verdicts are meant for {INTENDED_SEEDS}: with fewer they may differ, and a "
            "claim may be not reproduced for that reason alone."
        )
    return sentence
