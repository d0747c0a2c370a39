"""Results as HTML for a notebook: tables, sentences, curves.

Names are a user's text and are escaped; parts made here are :class:`markupsafe.Markup`, which is
not escaped again. The HTML loads nothing from outside the notebook.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from markupsafe import Markup

from curricle.arrays import FloatArray

COLOURS = {
    "black": "#000000",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "green": "#009E73",
    "blue": "#0072B2",
    "vermillion": "#D55E00",
    "purple": "#CC79A7",
    "grey": "#777777",
}
"""The palette of Okabe and Ito, which colour-blind readers can tell apart."""
OWN_COLOURS = ("blue", "vermillion", "green", "orange", "purple", "sky")  # of curricula
MOST_POINTS, MOST_ROWS = 60, 30  # points of a line and rows of a table that are shown, at most
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 460, 190, 58, 8, 10, 30
"""Of the picture of curves, and the margins around them."""
MOST_LETTERS = 8  # in the left margin
DIV, DASHES = Markup("<div>{}</div>"), Markup(' stroke-dasharray="4 3"')
STYLE = Markup(
    "<style>.curricle{font-size:13px;line-height:1.45}"
    ".curricle>*{margin:.4em 0}.curricle>div:not(.wide):not(.row){max-width:62em}"
    ".curricle .wide{overflow-x:auto}"
    # only a table that scrolls shows this line: the animation runs where there is a way to scroll
    ".curricle .wide::before{content:'More to the side: scroll →';display:block;position:sticky;"
    "left:0;width:max-content;height:0;overflow:hidden;opacity:.7;"
    "animation:curricle-scrolls linear;animation-timeline:scroll(nearest inline)}"
    "@keyframes curricle-scrolls{from,to{height:1.5em}}"
    ".curricle table{border-collapse:collapse;margin:0;font-size:inherit}"
    ".curricle th,.curricle td{text-align:left;vertical-align:top;padding:.2em .7em .2em 0;"
    "border:0;border-bottom:1px solid rgba(128,128,128,.35);background:none;white-space:nowrap}"
    ".curricle th{font-weight:600}.curricle .n{text-align:right;font-variant-numeric:tabular-nums}"
    ".curricle .w{white-space:normal;min-width:14em}"
    ".curricle .row{display:flex;flex-wrap:wrap;gap:.4em 1.5em}"
    ".curricle .row>*{flex:1 1 280px;max-width:460px}.curricle pre{white-space:pre-wrap;margin:0}"
    ".curricle svg{display:block;width:100%;max-width:460px}"
    ".curricle .key span{white-space:nowrap;margin-right:1em}</style>"
)


@dataclass(frozen=True)
class Line:
    """A learning curve to draw: T steps and heights, and a band around them."""

    name: str
    steps: Any
    values: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str = "currentColor"
    dashed: bool = False


def block(title: str, *parts: Any) -> str:
    """Return the HTML of a result: its title, and its parts that are not empty, texts escaped."""
    shown = [part if isinstance(part, Markup) else DIV.format(part) for part in parts if part]
    head = Markup("<div><strong>{}</strong></div>").format(title)
    return str(STYLE + _element('<div class="curricle">{}</div>', [head, *shown]))


def _element(form: str, parts: Iterable[Markup]) -> Markup:
    """Return an element with parts in it."""
    return Markup(form).format(Markup("").join(parts))


def beside(parts: Mapping[str, Markup]) -> Markup:
    """Return parts with their names above them, beside each other where there is room."""
    form = Markup("<div><div>{}</div>{}</div>")
    return _element('<div class="row">{}</div>', [form.format(*item) for item in parts.items()])


def printed(result: Any) -> str:
    """Return the printed lines of a result as HTML; serves a class as ``_repr_html_``."""
    return block(type(result).__name__, Markup("<pre>{}</pre>").format(str(result)))


def pictured(task: Any) -> str | None:
    """Return a picture of a task whose states lie on a grid; serves a class as ``_repr_html_``."""
    # By its name: what draws tasks imports them.
    html: str | None = import_module("curricle.show.scenes").in_a_notebook(task)
    return html


def table(
    head: Sequence[str], rows: Iterable[Sequence[Any]], *, wide: Sequence[str] = ()
) -> Markup:
    """Return a table; numbers are aligned to the right, columns in `wide` wrap."""
    rows = [*rows]
    shown, left = rows[:MOST_ROWS], len(rows) - MOST_ROWS
    classes = []
    for column, name in enumerate(head):
        # A number, or a text that begins as one.
        texts = [_cell(row[column]).lstrip("> +-−") for row in shown]
        numeric = bool(texts) and all(t in ("", "none") or t[0].isdigit() for t in texts)
        classes.append(' class="w"' if name in wide else ' class="n"' if numeric else "")

    def line(tag: str, values: Sequence[Any]) -> Markup:
        forms = [Markup(f"<{tag}{kind}>{{}}</{tag}>") for kind in classes]
        cells = [form.format(_cell(value)) for form, value in zip(forms, values, strict=True)]
        return _element("<tr>{}</tr>", cells)

    body = Markup("").join([line("td", row) for row in shown])
    form = Markup('<div class="wide"><table><thead>{}</thead><tbody>{}</tbody></table></div>')
    more = DIV.format(f"and {left:,} more") if left > 0 else Markup()
    return form.format(line("th", head), body) + more


def _cell(value: Any) -> str:
    """Return the text of a cell; a dash where there is no number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return str(value)
    if isinstance(value, int | np.integer):
        return f"{value:,}"
    number = float(value)
    return "-" if np.isnan(number) else f"{number:,.4g}" if abs(number) < 1e4 else f"{number:,.0f}"


def _brief(value: float) -> str:
    """Return a number that fits into the left margin of a picture."""
    text = _cell(value)
    return text if len(text) <= MOST_LETTERS else f"{value:.2g}"


def curves(lines: Sequence[Line], across: str, up: str) -> Markup:
    """Return an SVG picture of curves with their bands, and a key below it if they are several."""
    lines = [line for line in map(_thinned, lines) if len(line.steps)]
    if not lines:
        return Markup()
    # Bands of few seeds may be many times as high as the curves: they take at most a third.
    least = min(float(np.min(line.values)) for line in lines)
    most = max(float(np.max(line.values)) for line in lines)
    room = (most - least) / 4 or max(abs(most), 1.0) / 2
    low = max(least - room, min(float(np.min(line.low)) for line in lines))
    high = min(most + room, max(float(np.max(line.high)) for line in lines))
    if not high > low:
        low, high = low - room, high + room
    last = max(float(line.steps[-1]) for line in lines) or 1.0

    def x(steps: Any) -> Any:
        return LEFT + np.asarray(steps) / last * (WIDTH - LEFT - RIGHT)

    def y(values: Any) -> Any:
        inside = np.clip(values, low, high)
        return TOP + (high - inside) / (high - low) * (HEIGHT - TOP - BOTTOM)

    text = Markup('<text x="{:.0f}" y="{:.0f}" text-anchor="{}">{}</text>')
    texts = [
        *[(LEFT - 5, float(y(v)) + 4, "end", _brief(v)) for v in (low, high)],
        (LEFT, HEIGHT - BOTTOM + 14, "middle", "0"),
        (WIDTH - RIGHT, HEIGHT - BOTTOM + 14, "end", _cell(last)),
        ((LEFT + WIDTH) / 2, HEIGHT - 4, "middle", across),
    ]
    picture = Markup(
        '<svg viewBox="0 0 {} {}" role="img" aria-label="{}" font-size="11" fill="currentColor">'
        '<path d="M{} {}V{}H{}" fill="none" stroke="currentColor" opacity=".5"/>{}'
        '<text transform="translate(11 {:.0f}) rotate(-90)" text-anchor="middle">{}</text></svg>'
    ).format(
        *(WIDTH, HEIGHT, f"{up} over {across}"),
        *(LEFT, TOP, HEIGHT - BOTTOM, WIDTH - RIGHT),
        Markup("").join([_drawn(line, x, y) for line in lines] + [text.format(*t) for t in texts]),
        *((HEIGHT - BOTTOM + TOP) / 2, up),
    )
    key = Markup(
        '<span><svg viewBox="0 0 22 8" style="display:inline-block;width:22px;height:8px">'
        '<path d="M0 4H22" stroke="{}" stroke-width="2"{}/></svg> {}</span> '
    )
    keys = [key.format(line.colour, DASHES * line.dashed, line.name) for line in lines]
    return picture + (_element('<div class="key">{}</div>', keys) if len(keys) > 1 else Markup())


def _thinned(line: Line) -> Line:
    """Return a line without points that are not finite, and with few enough of the others."""
    known = np.flatnonzero(np.isfinite(line.values))
    if len(known) > MOST_POINTS:
        known = known[np.linspace(0, len(known) - 1, MOST_POINTS).round().astype(int)]
    steps, values, *edges = (
        np.asarray(row)[known] for row in (line.steps, line.values, line.low, line.high)
    )
    low, high = (np.where(np.isfinite(edge), edge, values) for edge in edges)
    return replace(line, steps=steps, values=values, low=low, high=high)


def _drawn(line: Line, x: Any, y: Any) -> Markup:
    across = x(line.steps)

    def points(values: Any, along: Any) -> str:
        pairs = zip(along.tolist(), y(values).tolist(), strict=True)
        return " ".join(f"{a:.0f},{b:.1f}" for a, b in pairs)

    band = Markup()
    if np.any(line.high > line.low):
        edge = f"{points(line.high, across)} {points(line.low[::-1], across[::-1])}"
        band = Markup('<polygon points="{}" fill="{}" opacity=".16"/>').format(edge, line.colour)
    return band + Markup(
        '<polyline points="{}" fill="none" stroke="{}" stroke-width="1.5"{}/>'
    ).format(points(line.values, across), line.colour, DASHES * line.dashed)
