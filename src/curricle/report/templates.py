"""HTML pages, rendered from the templates in ``assets``."""

import base64
import hashlib
import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from curricle.checks import listed
from curricle.errors import StoreError
from curricle.files import write_whole
from curricle.plotting.scales import rounded
from curricle.plotting.styles import shades_of
from curricle.text import counted

WHITE = "\n\t\u00a0\u202f"
"""Characters that are not printable and stay: breaks of lines, tabs and narrow spaces."""


def render(template: str, **values: Any) -> str:
    """Return a template filled in; text is escaped, ``Markup`` is not.

    Parameters
    ----------
    template : str
        File name in ``assets``.
    **values
        What the template names. A missing one raises ``UndefinedError``.

    Examples
    --------
    >>> page = render("paper.html", title="A < B", counts={}, sections=[], seeds="")
    >>> "<h1>A &lt; B</h1>" in page
    True
    """
    environment = Environment(
        loader=PackageLoader("curricle.report", "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_visible,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "sort_keys": True}
    environment.globals.update(shades=shades_of, style_sheets=_style_sheets)
    environment.filters.update(signs=_signs, rounded=rounded, listed=listed, evidence=_evidence)
    environment.filters.update(counted=counted)
    return environment.get_template(template).render(values)


def _visible(value: Any) -> Any:
    """Return a text with control and format characters written out: some reverse what follows."""
    if not isinstance(value, str) or isinstance(value, Markup) or value.isprintable():
        return value
    return "".join(c if c.isprintable() or c in WHITE else ascii(c)[1:-1] for c in value)


def _style_sheets(*names: str) -> Markup:
    """Return style sheets in ``assets``, one after the other."""
    return Markup("").join(Markup(asset(name)) for name in names)


def asset(name: str) -> str:
    """Return the text of a file in ``assets``."""
    return (files("curricle.report") / "assets" / name).read_text("utf-8")


@dataclass(frozen=True)
class Script:
    """A script of a page, which the page's policy names by its digest."""

    text: Markup
    digest: str  # sha256-...

    @classmethod
    def of(cls, name: str) -> Self:
        """Return a script in ``assets``."""
        text = asset(name)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        return cls(Markup(text), f"sha256-{digest}")


def write_page(page: str, path: str | Path) -> Path:
    """Write a page, whole or not at all, and return its path; StoreError if that fails."""
    try:
        write_whole(Path(path), page.encode())
    except OSError as error:
        raise StoreError(f"a report cannot be written to {path}: {error.strerror}") from None
    return Path(path)


def _signs(words: str) -> str:
    """Return a sentence whose negative numbers have a minus sign in place of the hyphen."""
    return re.sub(r"(?<![\w)\]])-(?=\d)", "−", words)


def _evidence(value: Any) -> str:
    """Return one number, interval or text of a claim's evidence."""
    if isinstance(value, dict) and "estimate" in value:
        estimate, low, high = (value[name] for name in ("estimate", "low", "high"))
        if low is None or high is None:
            return f"{_number(estimate)} (no interval)"
        return f"{_number(estimate)} [{_number(low)}, {_number(high)}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
