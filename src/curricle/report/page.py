"""A study as one HTML page without a network and without other files."""

import base64
import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup

from curricle.comparison.comparison import Comparison
from curricle.curriculum.curriculum import OF_TARGETS, SETTINGS, CurriculumResult
from curricle.errors import SettingError
from curricle.plotting.learning_curves import draw_learning_curves
from curricle.plotting.styles import ArmStyle, arm_styles, shades_of
from curricle.report.findings import MEASURES, WEAK, findings, forest, headline, table, too_few
from curricle.report.forecast_section import forecast_sections
from curricle.report.graph import Reasons, default_reasons, graphs
from curricle.report.replay import Replay, SnapshotsByTask, replays
from curricle.report.svg import inline_svg
from curricle.report.templates import asset, render
from curricle.statistics.curves import SCRATCH

WIDTHS = {"wide": (8.6, 4.0), "narrow": (3.4, 3.1)}
"""Size of the curves on a desktop and on a phone, in inches."""


@dataclass(frozen=True, eq=False)
class StudyRecord:
    """The contents of a study's page.

    Attributes
    ----------
    name : str
    comparison : Comparison
    results : dict of str to CurriculumResult
        Arm -> its training; the scratch baseline is a curriculum of one task. Controls may be left
        out.
    snapshots : dict of (str, str) to Snapshots
        (arm, task) -> the values of one seed during training.
    decisions : dict of (str, str) to sequence of str
        (arm, task) -> for each seed why its training ended; by default its budget was spent.
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
    """Return a study as one self-contained HTML page.

    It holds the findings, the curriculum graph, learning curves for weak and strong transfer, all
    measures, the forecast and certificates where the target is small enough, replays of training,
    and the settings. Without scripts, and on paper, the replays are still pictures.

    Parameters
    ----------
    study : StudyRecord

    Returns
    -------
    str
        HTML. It requests nothing over a network, and its policy forbids requests.

    Raises
    ------
    SettingError
        When there is no arm besides the scratch baseline.

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
        raise SettingError(f"a study's page needs an arm besides {SCRATCH!r}: got none")
    found, drawn = findings(comparison), graphs(study.results, study.decisions)
    shown, not_shown = replays(study.results, study.snapshots)
    script = asset("study.js")
    return render(
        "study.html",
        study=study,
        comparison=comparison,
        headline=headline(comparison),
        too_few=too_few(comparison),
        findings=found,
        forest=forest(found),
        styles={arm: _CssStyle.of(style) for arm, style in arm_styles(comparison).items()},
        graphs=drawn,
        curves=_curves(comparison),
        table=table(comparison),
        measures=MEASURES,
        weak=WEAK,
        sections=forecast_sections(study.results, [graph.arms for graph in drawn if graph.edges]),
        replays=shown,
        menu={one.task: [other for other in shown if other.task == one.task] for one in shown},
        first=_first(shown, comparison.target),
        not_shown=not_shown,
        settings=_settings(study.results),
        reasons=_reasons(study),
        scratch=SCRATCH,
        style=Markup(asset("study.css")),
        script=Markup(script),
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        data={
            "replays": {one.key: one.data() for one in shown},
            "palettes": {one.palette: shades_of(one.palette) for one in shown},
        },
    )


@dataclass(frozen=True)
class _CssStyle:
    """The style of an arm as CSS and SVG attributes."""

    colour: str
    dashes: str
    control: bool

    @classmethod
    def of(cls, one: ArmStyle) -> "_CssStyle":
        dashes = "" if one.dashes == "-" else " ".join(f"{2 * part:g}" for part in one.dashes[1])
        return cls(one.colour, dashes, one.control)


def _first(shown: Sequence[Replay], target: str) -> str:
    """Return the key of the replay to begin with: the first curriculum in the target."""
    return next(
        (one.key for one in shown if one.task == target and one.arms != (SCRATCH,)),
        shown[0].key if shown else "",
    )


def _curves(comparison: Comparison) -> dict[str, dict[str, Markup]]:
    """Return the drawn learning curves: kind of transfer -> width -> SVG."""
    axes: dict[str, dict[str, Markup]] = {"weak": {}, "strong": {}}
    for size, (width, height) in WIDTHS.items():
        pair = draw_learning_curves(comparison, width=width, height=height)
        for axis, figure in zip(axes, pair, strict=True):
            steps = "target steps" if axis == "weak" else "target and source steps"
            label = f"Greedy return of each arm over {steps}; the table below has the numbers."
            axes[axis][size] = inline_svg(figure, f"{axis}-{size}", label)
    return axes


def _settings(
    results: Mapping[str, CurriculumResult],
) -> list[tuple[tuple[str, ...], str, dict[str, str]]]:
    """Return the settings of each task: arms that share them, task, name -> text."""
    found: dict[str, tuple[list[str], str, dict[str, str]]] = {}
    for arm, result in results.items():
        for task in result.curriculum.order:
            words = {"task": repr(result.curriculum.tasks[task])}
            for name in SETTINGS:
                if name in OF_TARGETS and not result.curriculum.in_edges(task):
                    continue
                words[name] = _setting_text(result.curriculum.setting(name, task))
            found.setdefault(repr((task, words)), ([], task, words))[0].append(arm)
    return [(tuple(arms), task, words) for arms, task, words in found.values()]


def _setting_text(value: Any) -> str:
    """Return a setting as text: functions by name, numbers with commas."""
    if value is None:
        return "default"
    if isinstance(value, int):
        return f"{value:,}"
    return getattr(value, "__name__", None) or (value if isinstance(value, str) else repr(value))


def _reasons(study: StudyRecord) -> list[tuple[tuple[str, ...], str, list[tuple[str, int]]]]:
    """Return why trainings ended: arms, task, and each reason with its number of seeds."""
    found: dict[str, tuple[list[str], str, list[tuple[str, int]]]] = {}
    for arm, result in study.results.items():
        for task in result.nodes:
            reasons = study.decisions.get((arm, task)) or default_reasons(result, task)
            counts = Counter(reasons).most_common()
            found.setdefault(repr((task, counts)), ([], task, counts))[0].append(arm)
    return [(tuple(arms), task, counts) for arms, task, counts in found.values()]
