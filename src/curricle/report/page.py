"""A study as one HTML page without a network and without other files."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup
from matplotlib.axes import Axes

from curricle.checks import fit_name
from curricle.comparison.comparison import Comparison
from curricle.curriculum.result import CurriculumResult
from curricle.errors import SettingError, in_words
from curricle.learning.budget import ended_by
from curricle.plotting.learning_curves import draw_learning_curves
from curricle.plotting.styles import arm_styles, shades_of
from curricle.report.curve_data import MOST_SEEDS, curve_data
from curricle.report.effects_section import effects_sections
from curricle.report.findings import MEASURES, WEAK, findings, forest, headline, table, too_few
from curricle.report.forecast_section import forecast_sections
from curricle.report.graph import Learnt, Reasons, graphs
from curricle.report.replay import Replay, replays
from curricle.report.svg import inline_svg
from curricle.report.templates import Script, render
from curricle.statistics.curves import SCRATCH
from curricle.study.analysis import analysed
from curricle.study.effects import Effects
from curricle.study.record import Analysis, CurriculaRecord
from curricle.study.recording import curricula_record
from curricle.study.tuning_record import TuningRecord

WIDTHS = {"wide": (8.6, 4.0, 300), "narrow": (3.4, 3.1, 120)}
"""Size of the curves on a desktop and on a phone, in inches, and the checkpoints drawn at most."""


def study_page(
    name: str,
    comparison: Comparison,
    results: Mapping[str, CurriculumResult],
    *,
    decisions: Reasons | None = None,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Return a study as one self-contained HTML page.

    It holds the findings, the curriculum graph, learning curves for weak and strong transfer, all
    measures, the forecast and certificates where the target is small enough, replays of training,
    and the settings. Without scripts, and on paper, the replays are still pictures.

    Parameters
    ----------
    name : str
        Of the study.
    comparison : Comparison
    results : dict of str to CurriculumResult
        Arm -> its training; the scratch baseline is a curriculum of one task. Controls may be left
        out.
    decisions : dict of (str, str) to sequence of str, optional
        (arm, task) -> for each seed why its training ended; by default its budget was spent.
    environment : dict of str to str, optional
        Versions, command and the like.

    Returns
    -------
    str
        HTML. It requests nothing over a network, and its policy forbids requests.

    Raises
    ------
    SettingError
        When there is no arm besides the scratch baseline, or the name is not one.

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
    >>> page = study_page("A <small> maze", compare(plan, seeds=2), {"transfer": plan.train(2)})
    >>> "<h1>A &lt;small&gt; maze</h1>" in page, "https:" in page
    (True, False)
    """
    fit_name("a study", name, SettingError)
    curricula = {arm: result.curriculum for arm, result in results.items()}
    record = curricula_record(curricula, {})
    learnt = {arm: result.nodes for arm, result in results.items()}
    reasons: dict[tuple[str, str], Sequence[str]] = {}
    for arm, nodes in learnt.items():
        for task, node in nodes.items():
            ended = curricula[arm].node(task)
            default = [
                rows[-1].criterion if rows else ended_by(ended.budget, full)
                for rows, full in zip(ended.decisions(node), node.out_of_memory, strict=True)
            ]
            reasons[arm, task] = (decisions or {}).get((arm, task)) or default
    study = ShownStudy(name, comparison, record, learnt, analysed(results, record), reasons)
    return page_of(study, environment or {})


@dataclass(frozen=True, eq=False)
class ShownStudy:
    """All that a page shows, in plain data."""

    name: str
    comparison: Comparison
    curricula: CurriculaRecord
    learnt: Learnt  # arm -> task -> its training
    analysis: Analysis
    reasons: Reasons  # (arm, task) -> for each seed why its training ended
    effects: tuple[Effects, ...] = ()
    tuning: TuningRecord | None = None


def page_of(study: ShownStudy, environment: Mapping[str, str], banner: str = "") -> str:
    """Return the page of a study; SettingError when it has no arm besides the scratch baseline.

    With a `banner` at its top it is an interim one, which is read again while the run goes on.
    """
    comparison, curricula, learnt = study.comparison, study.curricula, study.learnt
    if not comparison.contrasts:
        raise SettingError(f"a study's page needs an arm besides {SCRATCH!r}: got none")
    found, drawn = findings(comparison), graphs(curricula, learnt, study.reasons)
    shown, not_shown = replays(curricula, learnt, study.analysis)
    styles = arm_styles(comparison)
    curves, panels = _curves(comparison)
    return render(
        "study.html",
        name=study.name,
        comparison=comparison,
        environment=environment,
        headline=headline(comparison),
        too_few=too_few(comparison),
        failed={arm: in_words(error) for arm, error in comparison.failed.items()},
        findings=found,
        forest=forest(found),
        styles=styles,
        graphs=drawn,
        with_scratch=SCRATCH in learnt,
        curves=curves,
        curve_data=curve_data(comparison, styles, panels),
        most_seeds=MOST_SEEDS,
        table=table(comparison),
        measures=MEASURES,
        weak=WEAK,
        settings_sections=effects_sections(study.effects, study.tuning),
        sections=forecast_sections(study.analysis, curricula, learnt),
        replays=shown,
        menu={one.task: [other for other in shown if other.task == one.task] for one in shown},
        first=_first(shown, comparison),
        not_shown=not_shown,
        settings=_shared(_settings(curricula)),
        reasons=_shared(
            (*place, Counter(words).most_common()) for place, words in study.reasons.items()
        ),
        ends=ends(study.reasons),
        banner=banner,
        scripts=[
            Script.of(name)
            for name in ("scroll.js", "study.js", "curves.js", *["reload.js"] * bool(banner))
        ],
        data={
            "replays": {one.key: one.data() for one in shown},
            "palettes": {one.palette: shades_of(one.palette) for one in shown},
        },
    )


def _first(shown: Sequence[Replay], comparison: Comparison) -> str:
    """Return the key of the replay to begin with: the first curriculum in the target."""
    own = (one for one in shown if one.task == comparison.target)
    return next(
        (one.key for one in own if not {*one.arms} <= {*comparison.scratches}),
        shown[0].key if shown else "",
    )


def _curves(comparison: Comparison) -> tuple[dict[str, dict[str, Markup]], dict[str, Axes]]:
    """Return the drawn learning curves, and the panels that they were drawn in.

    The first are kind of transfer -> width -> SVG, the second kind of transfer -> axes.
    """
    drawn: dict[str, dict[str, Markup]] = {"weak": {}, "strong": {}}
    panels: dict[str, Axes] = {}
    for size, (width, height, most) in WIDTHS.items():
        pair = draw_learning_curves(comparison, width=width, height=height, most=most)
        for kind, figure in zip(drawn, pair, strict=True):
            steps = "target steps" if kind == "weak" else "target and source steps"
            label = f"Greedy return of each arm over {steps}; the table below has the numbers."
            drawn[kind][size] = inline_svg(figure, f"{kind}-{size}", label)
            panels[kind] = figure.axes[0]
    return drawn, panels


@dataclass(frozen=True)
class End:
    """A reason why training ended."""

    reason: str
    count: int  # seeds, over all tasks and arms
    total: int  # the same for all reasons
    tasks: tuple[str, ...]  # in which it happened


def ends(reasons: Reasons) -> tuple[End, ...]:
    """Return why trainings ended, the most frequent reason first.

    Examples
    --------
    >>> ends({("mean", "chase"): ["settled return reached", "all steps used"],
    ...       ("mean", "hunt"): ["all steps used"] * 2})[0]
    End(reason='all steps used', count=3, total=4, tasks=('chase', 'hunt'))
    """
    counts: Counter[str] = Counter()
    tasks: dict[str, dict[str, None]] = {}
    for (_, task), words in reasons.items():
        counts.update(words)
        for reason in words:
            tasks.setdefault(reason, {})[task] = None
    total = counts.total()
    return tuple(End(one, n, total, tuple(tasks[one])) for one, n in counts.most_common())


def _settings(curricula: CurriculaRecord) -> Iterator[tuple[str, str, dict[str, str]]]:
    """Yield arm, task, and the settings of its training, name -> text."""
    for arm, record in curricula.arms.items():
        for task, node in record.nodes.items():
            yield arm, task, {"task": curricula.task(arm, task).text, **node.settings}


def _shared(rows: Iterable[tuple[str, str, Any]]) -> list[tuple[list[str], str, Any]]:
    """Return rows of arm, task and content; those of equal task and content become one."""
    found: dict[str, tuple[list[str], str, Any]] = {}
    for arm, task, content in rows:
        found.setdefault(repr((task, content)), ([], task, content))[0].append(arm)
    return list(found.values())
