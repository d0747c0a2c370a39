"""Matplotlib's figures as SVG elements that stand inside an HTML page."""

import io
import re
from xml.etree import ElementTree

import matplotlib
from markupsafe import Markup
from matplotlib.figure import Figure

from curricle.plotting.figures import STYLE

_REFERENCE = re.compile(r"#([\w-]+)")
_DRAWN = ("d", "transform", "x", "y", "width", "height")
"""Attributes that hold coordinates."""


def inline_svg(figure: Figure, name: str, label: str) -> Markup:
    """Return a figure as an ``<svg>`` element, its text kept as text in the page's own font.

    It scales with the width that the page gives it, refers to nothing outside and shares no
    identifier with an element of another name.

    Parameters
    ----------
    figure : Figure
    name : str
        Unique in the page, of letters, digits and hyphens; identifiers begin with it.
    label : str
        What a reader who cannot see it is told.

    Returns
    -------
    Markup

    Examples
    --------
    >>> print(inline_svg(Figure(figsize=(2, 1)), "empty", "nothing <yet>"))
    <svg viewBox="0 0 144 72" role="img" aria-label="nothing &lt;yet&gt;" ...
    """
    content = io.BytesIO()
    with matplotlib.rc_context({**STYLE, "svg.fonttype": "none"}):
        figure.savefig(content, format="svg", metadata={"Date": None})
    root = ElementTree.fromstring(content.getvalue())
    for parent in list(root.iter()):
        for child in list(parent):
            # What describes the file; and a rule for *, which would rule the whole page.
            if child.tag.endswith(("}metadata", "}style")):
                parent.remove(child)
    eval_freq = [value for element in root.iter() for value in element.attrib.values()]
    used = {found for value in eval_freq for found in _REFERENCE.findall(value)}
    for element in root.iter():
        element.tag, element.text, element.tail = _local(element.tag), _kept(element.text), None
        given = {_local(key): value for key, value in element.attrib.items()}
        element.attrib.clear()
        for key, value in given.items():
            if key != "id":
                element.set(key, _plain(key, value, name))
            elif value in used:
                element.set(key, f"{name}-{value}")
    box = root.get("viewBox", "")
    root.attrib.clear()
    root.attrib.update({"viewBox": box, "role": "img", "aria-label": label})
    root.set("stroke-linejoin", "round")
    return Markup(ElementTree.tostring(root, encoding="unicode"))


def _local(name: str) -> str:
    """Return an XML name without its namespace, which HTML knows by itself."""
    return name.rpartition("}")[2]


def _kept(text: str | None) -> str | None:
    return text if text and text.strip() else None


def _plain(key: str, value: str, name: str) -> str:
    """Return an attribute's value: coordinates in hundredths, references renamed, no font."""
    if key in _DRAWN:
        value = re.sub(r"-?\d+\.\d{3,}", lambda found: f"{float(found[0]):z.2f}", value)
        return re.sub(r"\s+", " ", value).strip()
    if "url(" in value or key == "href":
        return _REFERENCE.sub(rf"#{name}-\1", value)
    return re.sub(r"font-family:[^;]*;\s*", "", value)
