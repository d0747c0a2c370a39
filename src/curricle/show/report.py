"""The report of a study: one HTML page without a network and without other files.

It has curves twice: as pictures, for paper and for readers without scripts, and as numbers. An
interim report is made from the folder alone.
"""

import base64
import hashlib
import io
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from functools import partial
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from time import monotonic
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.scale import SymmetricalLogTransform

from curricle.arrays import FloatArray
from curricle.checks import listed
from curricle.comparison import sentences
from curricle.comparison.comparison import Comparison
from curricle.comparison.measures import Contrast
from curricle.comparison.plan import seed_ranges
from curricle.errors import StoreError, in_words
from curricle.files import Place, place_at, write_whole
from curricle.show.graph import graphs
from curricle.show.plots import (
    MOST_BANDS,
    controls_first,
    draw_learning_curves,
    places,
    random_level,
    shown_curve,
)
from curricle.show.replay import replays
from curricle.show.style import STYLE, ArmStyle, arm_styles, shades_of
from curricle.statistics.curves import SCRATCH
from curricle.study.auditing import HEADS, Audit
from curricle.study.record import Analysis, SectionRecord, StudyRecord
from curricle.study.results import StudyResults
from curricle.study.tuning import EFFECT_HEADS, effects_of, effects_rows, short, tuning_rows
from curricle.text import counted, minus, rounded, visible

# -- templates -------------------------------------------------------------------------------------


def render(template: str, values: Mapping[str, object]) -> str:
    """Return a template filled in; text is escaped, ``Markup`` is not.

    Parameters
    ----------
    template : str
        File name in ``assets``.
    values : dict of str to object
        Values of the names in it; ``UndefinedError`` if any is missing.

    Examples
    --------
    >>> page = render("paper.html", {"title": "A < B", "counts": {}, "sections": [], "seeds": ""})
    >>> "<h1>A &lt; B</h1>" in page
    True
    """
    environment = Environment(
        loader=PackageLoader("curricle.show", "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_visible,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "sort_keys": True}
    environment.globals.update(shades=shades_of, asset=asset, digest=_digest)
    environment.globals.update(sentences=sentences, forest=forest)
    # A sentence's negative numbers with a minus sign in place of the hyphen.
    environment.filters["signs"] = partial(re.sub, r"(?<![\w)\]])-(?=\d)", "−")
    environment.filters["evidence"] = _evidence
    environment.filters.update(rounded=rounded, listed=listed, counted=counted)
    return environment.get_template(template).render(values)


def _visible(value: object) -> object:
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def asset(name: str) -> Markup:
    """Return the text of a file in ``assets``."""
    return Markup((files("curricle.show") / "assets" / name).read_text("utf-8"))


def _digest(script: str) -> str:
    """Return the digest of a script, by which a page's content policy allows it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def write_page(page: str, path: str | Path) -> Path:
    """Write a page, whole or not at all, and return its path; StoreError if that fails."""
    try:
        write_whole(Path(path), page.encode())
    except OSError as error:
        raise StoreError(f"a report cannot be written to {path}: {error.strerror}") from None
    return Path(path)


def _evidence(value: object) -> str:
    """Return a number, an interval or a text of a claim's evidence."""
    if isinstance(value, dict) and "estimate" in value:
        ends = [value["low"], value["high"]]
        bounds = "(no interval)" if None in ends else f"[{', '.join(map(short, ends))}]"
        return f"{short(value['estimate'])} {bounds}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# -- a study's page ---------------------------------------------------------------------------


def write_report(folder: str | Place, out: str | Path | None = None) -> Path:
    """Write the report of a study's folder, and return its path.

    Parameters
    ----------
    folder : path or str
        Folder, or its URL.
    out : path, optional
        ``report.html`` in the folder by default; NAME-report.html here for the URL of NAME.

    Raises
    ------
    StoreError
        When there is nothing to compare yet, or the page cannot be written.
    """
    study = StudyResults(folder)
    path = default_page(study.store.path) if out is None else Path(out)
    return write_page(page_of(study), path)


def write_audit(audit: Audit, path: Path) -> Path:
    """Write the page of an audit, the report of its fair study with both columns; return it."""
    return write_page(page_of(audit.fair, audit=audit), path)


def default_page(place: Place) -> Path:
    """Return where the report of a folder is written by default."""
    return (
        place / "report.html"
        if isinstance(place, Path)
        else Path(f"{place.name or place.drive}-report.html")
    )


UPLOT = "vendor/uplot-1.6.32.min.js"
WIDTHS = {"wide": (8.6, 4.0, 300), "narrow": (3.4, 3.1, 120), "beside": (4.4, 3.2, 120)}
"""Width and height of the curves in each place, in inches, and the checkpoints drawn at most."""


def page_of(study: StudyResults, banner: str = "", audit: Audit | None = None) -> str:
    """Return the page of a study, an interim page with a `banner`."""
    comparison, analysis = study.comparison, study.analysis
    learnt = {arm: nodes for arm, nodes in study.results.items() if arm not in study.failed}
    curricula = study.record.only(learnt)
    reasons = {
        (arm, task): list(study.ended_by(arm, task).values())
        for arm, nodes in learnt.items()
        for task in nodes
    }
    if analysis is None:
        why = (
            "Certificates are left out, because the run has not ended: curricle run --resume makes "
            "them."
        )
        groups = [arms for arms in curricula.groups() if curricula.arms[arms[0]].has_potential]
        empty: Any = {"certificates": (), "left_out": (why,)}
        analysis = Analysis(of="", sections=tuple(SectionRecord(arms=a, **empty) for a in groups))
    values = _of_comparison(comparison, banner)
    films, not_shown = replays(curricula.only(values["styles"]), learnt, analysis)
    # The replay to begin with: the first curriculum in the target.
    in_target = [film for film in films if film.task == comparison.target]
    curricula_first = [film for film in in_target if not {*film.arms} <= {*comparison.scratches}]
    settings = [
        (arm, task, {"task": curricula.task(arm, task).text, **node.settings})
        for arm, record in curricula.arms.items()
        for task, node in record.nodes.items()
    ]
    counts = Counter(reason for why in reasons.values() for reason in why)
    tasks = {r: dict.fromkeys(t for (_, t), why in reasons.items() if r in why) for r in counts}
    ends = [(r, f"{n:,} of {counts.total():,}", listed(tasks[r])) for r, n in counts.most_common()]
    ended = [
        (*place, Markup("<br>").join(visible(f"{n}: {e}") for e, n in Counter(why).most_common()))
        for place, why in reasons.items()
    ]
    facts = values["facts"]
    for last in study.runs[-1:]:
        facts |= {"file": last.file, "started": last.started, "seeds": seed_ranges(study.seeds)}
        facts |= {"commit": last.commit or "none", "Python": last.python, "machine": last.machine}
        facts |= last.versions
    values |= {
        "name": study.record.name,
        "graphs": graphs(curricula, learnt, reasons),
        "with_scratch": SCRATCH in learnt,
        "audited": audit
        and (audit.sentence, [*HEADS], {arm: audit.rows(arm) for arm in comparison.verdicts}),
        "swept": effects_rows(effects_of(study)),
        "effect_heads": EFFECT_HEADS,
        "best": study.record.tuned and tuning_rows(study.record.tuned),
        "tuned": study.record.tuned,
        "sections": [part for part in analysis.sections if {*part.arms} <= curricula.arms.keys()],
        "replays": films,
        "menu": {
            film.task: [other for other in films if other.task == film.task] for film in films
        },
        "first": next((film.key for film in [*curricula_first, *films]), ""),
        "not_shown": not_shown,
        "settings": _shared(settings),
        "reasons": [(task, listed(arms), ended) for arms, task, ended in _shared(ended)],
        "ends": ends,
        "data": {
            "replays": {film.key: film.data() for film in films},
            "palettes": {film.palette: shades_of(film.palette) for film in films},
        },
    }
    return render("study.html", values)


def page_of_runs(comparison: Comparison) -> str:
    """Return the page of runs of other programs, of which there is no study."""
    values = _of_comparison(comparison) | dict.fromkeys(("audited", "swept", "best"))
    values |= {"name": comparison.target, "data": {"replays": {}, "palettes": {}}}
    return render("study.html", values)


def _of_comparison(comparison: Comparison, banner: str = "") -> dict[str, Any]:
    """Return what a page says of compared arms, without a study."""
    styles, columns = arm_styles(comparison), sentences.COLUMNS
    curves, panels = _curves(comparison)
    total, budget = f"{comparison.total:,}", f"{comparison.budget:,}"
    threshold = sentences.threshold_words(comparison)
    return {
        "comparison": comparison,
        "failed": {arm: in_words(error) for arm, error in comparison.failed.items()},
        "styles": styles,
        "curves": curves,
        "curve_data": curve_data(comparison, styles, panels),
        "most_seeds": MOST_SEEDS,
        "most_bands": MOST_BANDS,
        "kinds": {
            kind: [*keys] for kind, keys in groupby(columns, lambda key: columns[key].transfer)
        },
        "facts": {
            "arms": listed(comparison.arms),
            "steps": f"{total} in all; the budget of the target is {budget}",
            "threshold": f"{threshold}, smoothed over {counted(comparison.window, 'checkpoint')}",
        },
        "banner": banner,
        "scripts": ["study.js", UPLOT, "curves.js", *["reload.js"] * bool(banner)],
    }


def _curves(comparison: Comparison) -> tuple[dict[str, dict[str, Markup]], dict[str, Axes]]:
    """Return learning curves as kind of transfer -> width -> SVG, and the axes of each kind."""
    drawn: dict[str, dict[str, Markup]] = {"weak": {}, "strong": {}}
    panels = dict[str, Axes]()
    for size, (width, height, most) in WIDTHS.items():
        pair = draw_learning_curves(comparison, width=width, height=height, most=most)
        for kind, figure in zip(drawn, pair, strict=True):
            steps = "target steps" if kind == "weak" else "target and source steps"
            label = f"Greedy return of each arm over {steps}; the table below has the numbers."
            drawn[kind][size] = inline_svg(figure, f"{kind}-{size}", label)
            panels[kind] = figure.axes[0]
    return drawn, panels


def _shared(rows: Iterable[tuple[str, str, Any]]) -> list[tuple[list[str], str, Any]]:
    """Return rows of arm, task and content; rows with equal task and content are joined."""
    alike: dict[str, tuple[list[str], str, Any]] = {}
    for arm, task, content in rows:
        alike.setdefault(repr((task, content)), ([], task, content))[0].append(arm)
    return list(alike.values())


# -- figures as SVG --------------------------------------------------------------------------------

_REFERENCE = re.compile(r"#([\w-]+)")
_DRAWN = ("d", "transform", "x", "y", "width", "height")  # attributes that hold coordinates


def inline_svg(figure: Figure, name: str, label: str) -> Markup:
    """Return a figure as an ``<svg>`` element that shares no identifier with another name's."""
    content = io.BytesIO()
    with matplotlib.rc_context({**STYLE, "svg.fonttype": "none"}):
        figure.savefig(content, format="svg", metadata={"Date": None})
    root = ElementTree.fromstring(content.getvalue())
    for parent in list(root.iter()):
        for child in list(parent):
            # Metadata; and a style rule for *, which would apply to the whole page.
            if child.tag.endswith(("}metadata", "}style")):
                parent.remove(child)
    values = [value for element in root.iter() for value in element.attrib.values()]
    used = {name for value in values for name in _REFERENCE.findall(value)}
    for element in root.iter():
        element.text = element.text if element.text and element.text.strip() else None
        element.tag, element.tail = element.tag.rpartition("}")[2], None
        attributes = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
        element.attrib.clear()
        for key, value in attributes.items():
            if key in _DRAWN:  # in hundredths
                value = re.sub(r"-?\d+\.\d{3,}", lambda number: f"{float(number[0]):z.2f}", value)
                value = re.sub(r"\s+", " ", value).strip()
            elif "url(" in value or key == "href":
                value = _REFERENCE.sub(rf"#{name}-\1", value)
            elif key == "id":
                value = f"{name}-{value}" if value in used else ""
            else:
                value = re.sub(r"font-family:[^;]*;\s*", "", value)
            if value or key != "id":
                element.set(key, value)
    box = root.get("viewBox", "")
    root.attrib.clear()
    root.attrib.update({"class": "plot", "viewBox": box, "role": "img", "aria-label": label})
    root.set("stroke-linejoin", "round")
    return Markup(ElementTree.tostring(root, encoding="unicode"))


# -- learning curves as data for the script of the page --------------------------------------------

MOST_CHECKPOINTS = 400  # checkpoints of a mean that a page holds
MOST_SEEDS, MOST_SEED_VALUES = 100, 60_000  # seeds of an arm that a page shows, values of all
SEEN, SEEN_NEAR_ZERO = 4000, 100  # rounded to a share of an axis, of a symlog axis's linear part


def curve_data(
    comparison: Comparison, styles: Mapping[str, ArmStyle], panels: Mapping[str, Axes]
) -> dict[str, Any]:
    """Return the data for JSON from which the script of a page draws curves."""
    scale, symlog = panels["strong"].yaxis.get_transform(), None
    if isinstance(scale, SymmetricalLogTransform):
        symlog = 10.0 ** math.floor(math.log10(scale.linthresh))  # a round number to print
    low, high = panels["strong"].get_ylim()
    smallest = symlog / SEEN_NEAR_ZERO if symlog else (high - low) / SEEN
    digits = max(0, math.ceil(-math.log10(smallest)))
    steps, seeds = comparison.scratch.curve.steps, min(comparison.seeds, MOST_SEEDS)
    # The checkpoints of means that are kept, and those of seeds.
    begins = [shown_curve(comparison, name, strong=True)[1] for name in styles]
    budget = int(np.searchsorted(steps, comparison.budget, side="right")) - 1
    kept = np.union1d(places(len(steps), MOST_CHECKPOINTS), [*begins, budget])
    most = max(2, MOST_SEED_VALUES // (seeds * len(styles)))
    kept_of_seeds = places(len(steps), min(most, MOST_CHECKPOINTS))

    def row(values: FloatArray) -> list[float | None]:
        """Return rounded numbers; None for NaN."""
        return [None if np.isnan(value) else round(value, digits) for value in values.tolist()]

    def band(name: str, panel: str) -> dict[str, list[float | None]]:
        """Return the bounds and the mean at the kept checkpoints, None before they begin."""
        curve, begin = shown_curve(comparison, name, strong=panel == "strong")
        inside = kept[(kept >= begin) & (kept < begin + len(curve.steps))]
        mean = comparison.interval(curve.filled()[:, inside - begin])
        before = np.full(int(np.searchsorted(kept, begin)), np.nan)
        rows = {"low": mean.low, "high": mean.high, "mean": mean.estimate}
        return {part: row(np.append(before, values)) for part, values in rows.items()}

    return {
        "digits": digits,
        "returns": "return" if comparison.remarks else "greedy return",
        "most_bands": MOST_BANDS,
        "threshold": None if comparison.nobody else comparison.threshold,
        "threshold_words": minus(f"{comparison.threshold:.4g}"),
        "random": random_level(comparison),  # the return while sources are trained
        "symlog": symlog,
        "heights": [low, high],
        "steps": steps[kept].tolist(),
        "seed_steps": steps[kept_of_seeds].tolist(),
        "arms": [
            {
                "name": name,
                "colour": style.colour,
                "dashes": [float(dash) for dash in style.svg_dashes.split()],
                "control": style.control,
                **{panel: band(name, panel) for panel in panels},
                "source_steps": comparison[name].curve.source_steps[:seeds].tolist(),
                "seeds": [*map(row, comparison[name].curve.filled()[:seeds, kept_of_seeds])],
            }
            for name, style in controls_first(styles)
        ],
    }


# -- while units are stored ------------------------------------------------------------------------

BETWEEN = 2.0  # seconds between two interim reports at least
REST = 10.0  # after an interim report that took t seconds no other is begun for REST * t


class InterimReport:
    """The report of a run, which that run writes anew as it stores units."""

    def __init__(self, folder: str | Place, path: Path, say: Callable[[str], Any]):
        self.folder, self.path = place_at(folder), path
        self._say, self._said = say, set[str]()  # told why the page is old, once with the same
        self._pause, self._due = BETWEEN, 0.0

    def refresh(self, so_far: str, *, over: bool = False) -> None:
        """Write the page if one is due, with a line on how far the run is; no error stops a run."""
        begun = monotonic()
        if begun < self._due and not over:
            return
        try:
            self._write(so_far, 0.0 if over else self._pause)
        except Exception as error:
            sentence = f"the page of the run is not up to date. {' '.join(in_words(error).split())}"
            if sentence not in self._said:
                self._said.add(sentence)
                self._say(sentence)
        self._pause = max(BETWEEN, REST * (monotonic() - begun))
        self._due = monotonic() + self._pause

    def _write(self, so_far: str, seconds: float) -> None:
        """Write the page, which a browser reads again after some seconds, unless these are 0."""
        study = StudyResults(self.folder)
        arms = arms_so_far(study)
        sentence = f"{so_far}. {_remark(study.record, study.failed, arms)}"
        time, seconds = f"{datetime.now():%X}", round(seconds, 1)
        told = {"sentence": sentence, "time": time, "seconds": seconds}
        banner = Markup(render("banner.html", told))
        if arms:
            part = StudyResults(study.store, study.record.only({*arms, *study.failed}))
            page = page_of(part, banner)
        else:
            page = render("waiting.html", {"name": study.record.name, "banner": banner})
        write_page(page, self.path)


def arms_so_far(study: StudyResults) -> list[str]:
    """Return the arms that can be compared: scratch and others, with the most results in common."""
    record = study.record
    if record.total is None or SCRATCH not in record.arms or SCRATCH in study.failed:
        return []
    done = {
        name: set(record.seeds).intersection(
            *(study.stored.get(record.keys[name, task], {}) for task in arm.nodes)
        )
        for name, arm in record.arms.items()
        if name not in study.failed
    }
    finished = sorted(done.keys() - {SCRATCH}, key=lambda name: -len(done[name] & done[SCRATCH]))
    # The n arms for which n times the number of seeds that all have finished is largest.
    best, most, common = 0, 0, done[SCRATCH]
    for number, name in enumerate(finished, start=1):
        common = common & done[name]
        if common and (number + 1) * len(common) >= most:
            best, most = number, (number + 1) * len(common)
    chosen = {SCRATCH, *finished[:best]}
    # A control says nothing without the arm that it is of.
    kept = {name: arm for name, arm in record.arms.items() if name in chosen}
    kept = {name: arm for name, arm in kept.items() if arm.control_of in {"", *kept}}
    if all(arm.scratch or arm.control_of for name, arm in kept.items() if name != SCRATCH):
        return []
    return list(kept)


def _remark(record: StudyRecord, failed: Iterable[str], arms: Sequence[str]) -> str:
    if record.total is None or SCRATCH not in record.arms or SCRATCH in {*failed}:
        return "There is no report: it needs the target learnt from scratch, for a number of steps."
    curricula = [name for name, arm in record.arms.items() if not (arm.scratch or arm.control_of)]
    if curricula and {*curricula} <= {*failed}:
        return f"There is no report: {listed(curricula)} failed. curricle show says why."
    if not arms:
        return f"The report begins when {SCRATCH} and another arm have finished a seed."
    later = [arm for arm in record.arms if arm not in {*arms, *failed}]
    come = f" is of {listed(arms)}; to come: {listed(later)}" if later else " is of all arms"
    return f"The report so far{come}. There is no verdict before all seeds are there."


# -- gains on one axis; what was swept or tuned: what was best, main effects -----------------------


def forest(contrasts: Mapping[str, Contrast]) -> tuple[float, dict[str, list[float]]]:
    """Return the positions of 0 and each gain's low, estimate and high, in percent of an axis."""
    if not contrasts:
        return 0.0, {}
    gains = [contrast.strong_gain for contrast in contrasts.values()]
    low, middle, high = np.array([(g.low, g.estimate, g.high) for g in gains], float).T
    # One seed has no interval.
    ends = np.stack([np.where(np.isnan(low), middle, low), middle, np.fmax(middle, high)], axis=1)
    least = min(0.0, float(ends.min()))
    width = (max(0.0, float(ends.max())) - least) or 1.0
    percent = (100 * (ends - least) / width).tolist()
    return 100 * (0.0 - least) / width, dict(zip(contrasts, percent, strict=True))
