"""A study as one HTML page that needs nothing but itself: no network, no files beside it."""

import base64
import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from curricle.comparison.comparison import Comparison
from curricle.curriculum.curriculum import SETTINGS, CurriculumResult
from curricle.errors import SettingError
from curricle.plotting.learning_curves import draw_learning_curves
from curricle.plotting.styles import Look, arm_looks
from curricle.report.findings import (
    FREE,
    MEASURES,
    figures,
    findings,
    forest,
    headline,
    table,
    too_few,
)
from curricle.report.forecast_section import promises
from curricle.report.graph import Reasons, default_reasons, graphs
from curricle.report.inline import inline_svg
from curricle.report.replay import SnapshotsByTask, Story, stories
from curricle.report.sharing import shared
from curricle.report.storyboard import shades_of
from curricle.statistics.curves import SCRATCH

WIDTHS = {"wide": (8.6, 4.0), "narrow": (3.4, 3.1)}
"""Inches of the curves on a desk and on a phone."""

OF_TARGETS = ("aggregate", "how", "guard")
"""Settings that mean nothing to a task without sources."""


@dataclass(frozen=True, eq=False)
class StudyRecord:
    """All that a page tells of a study.

    Attributes
    ----------
    name : str
    comparison : Comparison
    results : dict of str to CurriculumResult
        Arm -> what was trained; the direct learner's is a curriculum of one task. Controls may be
        left out.
    snapshots : dict of (str, str) to Snapshots
        (arm, task) -> the values of one seed while it learnt.
    decisions : dict of (str, str) to sequence of str
        (arm, task) -> for each seed why its training ended; its budget was spent, where left out.
    environment : dict of str to str
        Versions, command and the like.
    """

    name: str
    comparison: Comparison
    results: Mapping[str, CurriculumResult]
    snapshots: SnapshotsByTask = field(default_factory=dict)
    decisions: Reasons = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)


def study_page(study: StudyRecord) -> str:
    """Return a study as one HTML page, complete in itself.

    What paid, the curriculum graph, the learning curves on either axis, all measures, the forecast
    and certificates where the target is small enough, values and episodes while learning went, and
    what was run. Without scripts, and on paper, the page shows the same without motion.

    Parameters
    ----------
    study : StudyRecord

    Returns
    -------
    str
        HTML. It asks for nothing over a network, and forbids itself to.

    Raises
    ------
    SettingError
        When there is no arm besides the direct learner.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, compare, same_position
    >>> from curricle.curriculum.curriculum import Curriculum
    >>> maze = GridWorld(["..T", "S.."])
    >>> corner = maze.crop(rows=(0, 2), columns=(1, 3))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 100, "maze": 500})
    >>> study = StudyRecord("A <small> maze", compare(plan, seeds=2), {"transfer": plan.train(2)})
    >>> page = study_page(study)
    >>> "<h1>A &lt;small&gt; maze</h1>" in page, "https:" in page
    (True, False)
    """
    comparison = study.comparison
    if len(comparison.arms) < 2:
        raise SettingError(f"a study to tell of needs an arm besides {SCRATCH!r}: got none")
    found, drawn = findings(comparison), graphs(study.results, study.decisions)
    told, not_shown = stories(study.results, study.snapshots)
    script = _asset("study.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return _template().render(
        study=study,
        comparison=comparison,
        headline=headline(comparison),
        too_few=too_few(comparison),
        findings=found,
        forest=forest(found),
        looks={arm: _Drawn.of(look) for arm, look in arm_looks(comparison).items()},
        graphs=drawn,
        curves=_curves(comparison),
        table=table(comparison),
        measures=MEASURES,
        free=FREE,
        promises=promises(study.results, [graph.arms for graph in drawn if graph.edges]),
        stories=told,
        menu=_menu(told),
        first=_first(told, comparison.target),
        not_shown=not_shown,
        settings=_settings(study.results),
        reasons=_reasons(study),
        scratch=SCRATCH,
        style=Markup(_asset("study.css")),
        script=Markup(script),
        script_hash=digest,
        data={
            "stories": {one.key: one.data() for one in told},
            "palettes": {one.board.palette: shades_of(one.board.palette) for one in told},
        },
    )


@dataclass(frozen=True)
class _Drawn:
    """An arm's look in CSS's and SVG's words."""

    colour: str
    dashes: str
    control: bool

    @classmethod
    def of(cls, look: Look) -> "_Drawn":
        dashes = "" if look.dashes == "-" else " ".join(f"{2 * part:g}" for part in look.dashes[1])
        return cls(look.colour, dashes, look.control)


def _menu(told: Sequence[Story]) -> dict[str, list[Story]]:
    """Return the stories of each task."""
    return {one.task: [other for other in told if other.task == one.task] for one in told}


def _first(told: Sequence[Story], target: str) -> str:
    """Return the key of the story to begin with: the first curriculum in the target."""
    return next(
        (one.key for one in told if one.task == target and one.arms != (SCRATCH,)),
        told[0].key if told else "",
    )


def _asset(name: str) -> str:
    return (files("curricle.report") / "assets" / name).read_text("utf-8")


def _template() -> Template:
    rooms = Environment(
        loader=PackageLoader("curricle.report", "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    rooms.globals.update(shades=shades_of)
    rooms.filters.update(signs=_signs, figures=figures, listed=_listed)
    return rooms.get_template("study.html")


def _signs(words: str) -> str:
    """Return a sentence whose negative numbers have a sign that is not a hyphen."""
    return re.sub(r"(?<![\w)\]])-(?=\d)", "−", words)


def _listed(names: Sequence[str]) -> str:
    """Return names one after the other, told apart where they hold commas themselves."""
    return ("; " if any("," in name for name in names) else ", ").join(names)


def _curves(comparison: Comparison) -> dict[str, dict[str, Markup]]:
    """Return the drawn learning curves: axis -> width -> SVG."""
    axes: dict[str, dict[str, Markup]] = {"free": {}, "charged": {}}
    for size, (width, height) in WIDTHS.items():
        pair = draw_learning_curves(comparison, width=width, height=height)
        for axis, figure in zip(axes, pair, strict=True):
            steps = "steps in the target" if axis == "free" else "all steps, sources charged"
            label = f"Greedy return of each arm over {steps}; the table below has the numbers."
            axes[axis][size] = inline_svg(figure, f"{axis}-{size}", label)
    return axes


def _settings(
    results: Mapping[str, CurriculumResult],
) -> list[tuple[tuple[str, ...], str, dict[str, str]]]:
    """Return what tasks were trained with: arms that share it, task, settings in words."""
    found = dict[tuple[str, str], tuple[str, dict[str, str]]]()
    for arm, result in results.items():
        for task in result.curriculum.order:
            words = {"task": repr(result.curriculum.tasks[task])}
            for name in SETTINGS:
                if name in OF_TARGETS and not result.curriculum.in_edges(task):
                    continue
                words[name] = _said(result.curriculum.setting(name, task))
            found[arm, task] = task, words
    return [(tuple(arm for arm, _ in keys), *value) for keys, value in shared(found)]


def _said(value: Any) -> str:
    """Return a setting: functions by name, numbers with commas."""
    if value is None:
        return "by default"
    if isinstance(value, int):
        return f"{value:,}"
    return getattr(value, "__name__", None) or (value if isinstance(value, str) else repr(value))


def _reasons(study: StudyRecord) -> list[tuple[tuple[str, ...], str, list[tuple[str, int]]]]:
    """Return why trainings ended: arms, task, and each reason with its number of seeds."""
    found = dict[tuple[str, str], tuple[str, list[tuple[str, int]]]]()
    for arm, result in study.results.items():
        for task in result.nodes:
            said = study.decisions.get((arm, task)) or default_reasons(result, task)
            found[arm, task] = task, Counter(said).most_common()
    return [(tuple(arm for arm, _ in keys), *value) for keys, value in shared(found)]
