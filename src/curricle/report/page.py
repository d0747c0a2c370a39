"""A study as one HTML page without a network and without other files."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.scale import SymmetricalLogTransform

from curricle.arrays import FloatArray, IntArray
from curricle.comparison.comparison import Comparison
from curricle.errors import SettingError, in_words
from curricle.plotting.learning_curves import (
    controls_first,
    draw_learning_curves,
    places,
    random_level,
    shown_curve,
)
from curricle.plotting.scales import minus
from curricle.plotting.styles import ArmStyle, arm_styles, shades_of
from curricle.report.graph import Learnt, Reasons, graphs
from curricle.report.replay import Replay, replays
from curricle.report.sections import (
    MEASURES,
    WEAK,
    effects_sections,
    findings,
    forecast_sections,
    forest,
    headline,
    table,
    too_few,
)
from curricle.report.svg import inline_svg
from curricle.report.templates import Script, render
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import mean_interval
from curricle.study.effects import Effects
from curricle.study.record import Analysis, CurriculaRecord
from curricle.study.tuning import TuningRecord

# -- The learning curves of a page as data for its script ------------------------------------------

MOST_CHECKPOINTS = 400
"""Checkpoints of a mean that a page holds."""
MOST_SEEDS, MOST_SEED_VALUES = 100, 60_000
"""Seeds of an arm that a page shows, and the values of all of them that it holds at most."""
SEEN, SEEN_NEAR_ZERO = 4000, 100
"""Values are rounded to this share of a linear axis, or of the linear part of a symlog axis."""

Data = dict[str, Any]


def curve_data(
    comparison: Comparison, styles: Mapping[str, ArmStyle], panels: Mapping[str, Axes]
) -> Data:
    """Return what the script of a page draws curves from, as data for JSON.

    Returns are whole numbers of 10^-digits, and each row of numbers holds its first one, then
    differences, so that the text is short. None stands for a bound that does not exist.

    ``digits``; ``threshold`` and its words; ``random``, the return while sources are trained;
    ``symlog``, the return up to which its axis is linear and Matplotlib's ``linscale``, or None;
    ``panels``, the limits of each; ``steps`` (T,) and ``seed_steps`` (T',); ``arms`` in the order
    of drawing: for each panel the place of its first step, mean, low and high; for each seed its
    ``source_steps``, and in ``seeds`` its returns over target steps.
    """
    scale = panels["strong"].yaxis.get_transform()
    symlog = None
    if isinstance(scale, SymmetricalLogTransform):
        symlog = [float(scale.linthresh), float(scale.linscale)]
    low, high = panels["strong"].get_ylim()
    seen = symlog[0] / SEEN_NEAR_ZERO if symlog else (high - low) / SEEN
    digits = max(0, math.ceil(-math.log10(seen)))
    steps = comparison.scratch.curve.steps
    seeds = min(comparison.seeds, MOST_SEEDS)
    kept, kept_of_seeds = _kept(comparison, seeds)
    return {
        "digits": digits,
        "threshold": comparison.threshold,
        "threshold_words": minus(f"{comparison.threshold:.4g}"),
        "random": random_level(comparison),
        "symlog": symlog,
        "panels": {
            name: {"x": list(axes.get_xlim()), "y": list(axes.get_ylim())}
            for name, axes in panels.items()
        },
        "steps": _differences(steps[kept]),
        "seed_steps": _differences(steps[kept_of_seeds]),
        "arms": [
            {
                "name": name,
                "colour": style.colour,
                "dashes": style.svg_dashes,
                "control": style.control,
                **{panel: _band(comparison, name, panel, kept, digits) for panel in panels},
                "source_steps": comparison[name].curve.source_steps[:seeds].tolist(),
                "seeds": [
                    _numbers(row, digits)
                    for row in comparison[name].curve.filled()[:seeds, kept_of_seeds]
                ],
            }
            for name, style in controls_first(styles)
        ],
    }


def _kept(comparison: Comparison, seeds: int) -> tuple[IntArray, IntArray]:
    """Return the places of the checkpoints that are kept of means and of seeds."""
    steps = comparison.scratch.curve.steps
    begins = [shown_curve(comparison, name, strong=True)[1] for name in comparison.arms]
    budget = int(np.searchsorted(steps, comparison.budget, side="right")) - 1
    means = np.union1d(places(len(steps), MOST_CHECKPOINTS), [*begins, budget])
    most = max(2, MOST_SEED_VALUES // (seeds * len(comparison.arms)))
    return means, places(len(steps), min(most, MOST_CHECKPOINTS))


def _band(comparison: Comparison, name: str, panel: str, kept: IntArray, digits: int) -> Data:
    """Return the mean of an arm in a panel with its bounds, from the first of its places."""
    curve, begin = shown_curve(comparison, name, strong=panel == "strong")
    own = kept[(kept >= begin) & (kept < begin + len(curve.steps))]
    band = mean_interval(curve.filled()[:, own - begin], confidence=comparison.confidence)
    rows = {"mean": band.estimate, "low": band.low, "high": band.high}
    first = int(np.searchsorted(kept, begin))
    return {"first": first} | {key: _numbers(np.asarray(row), digits) for key, row in rows.items()}


def _numbers(values: FloatArray, digits: int) -> list[int | None]:
    """Return numbers as differences of whole numbers of 10^-digits; None for NaN."""
    known = ~np.isnan(values)
    whole = np.round(values[known] * 10**digits).astype(np.int64)
    found: list[int | None] = [None] * len(values)
    for place, difference in zip(np.flatnonzero(known), _differences(whole), strict=True):
        found[place] = difference
    return found


def _differences(numbers: IntArray) -> list[int]:
    """Return the first number, then the difference of each from the one before."""
    found: list[int] = np.diff(numbers, prepend=0).tolist()
    return found


# -- A study as one HTML page without a network and without other files ----------------------------

WIDTHS = {"wide": (8.6, 4.0, 300), "narrow": (3.4, 3.1, 120)}
"""Size of the curves on a desktop and on a phone, in inches, and the checkpoints drawn at most."""


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
    """Return why trainings ended, the most frequent reason first."""
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
