"""The HTML page of a report: one file that opens from disk, pictures beside it."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from string import Template
from typing import Any


@dataclass(frozen=True)
class Section:
    """One figure on the page.

    Parameters
    ----------
    title, caption : str
    image : str
        Address of the SVG, relative to the page.
    settings : dict
        What was run, name -> value.
    claims : sequence of dict
        ``claim``, ``setting``, ``verdict``, ``evidence`` each.
    links : dict
        Text -> address of the data behind the figure.
    """

    title: str
    caption: str
    image: str
    settings: dict[str, str]
    claims: Sequence[dict[str, Any]]
    links: dict[str, str]


def page(title: str, introduction: str, sections: Sequence[Section]) -> str:
    """Return the page as HTML text.

    Examples
    --------
    >>> "<h1>Results</h1>" in page("Results", "", [])
    True
    """
    body = "\n".join(_section(section) for section in sections)
    return _PAGE.substitute(title=escape(title), introduction=introduction, body=body)


def _section(section: Section) -> str:
    settings = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
        for name, value in section.settings.items()
    )
    links = " · ".join(
        f'<a href="{escape(address)}">{escape(text)}</a>' for text, address in section.links.items()
    )
    return f"""<section>
<h2>{escape(section.title)}</h2>
<figure><img src="{escape(section.image)}" alt="{escape(section.title)}">
<figcaption>{escape(section.caption)}<br>{links}</figcaption></figure>
{_claims(section.claims)}
<details><summary>Settings</summary><table>{settings}</table></details>
</section>"""


def _claims(claims: Sequence[dict[str, Any]]) -> str:
    rows = "".join(
        f'<tr class="{escape(c["verdict"]).replace(" ", "-")}"><td>{escape(c["verdict"])}</td>'
        f"<td>{escape(c['claim'])}<br><small>{escape(c['setting'])}</small></td>"
        f"<td>{_evidence(c['evidence'])}</td></tr>"
        for c in claims
    )
    head = "<tr><th>verdict</th><th>claim and setting</th><th>evidence</th></tr>"
    return f'<div class="wide"><table class="claims">{head}{rows}</table></div>'


def _evidence(evidence: dict[str, Any]) -> str:
    lines = []
    for name, value in evidence.items():
        if isinstance(value, dict) and "estimate" in value:
            low, high = _number(value["low"]), _number(value["high"])
            text = f"{_number(value['estimate'])} [{low}, {high}]"
        elif isinstance(value, float):
            text = f"{value:.6g}"
        else:
            text = str(value)
        lines.append(f"{escape(name)}: {escape(text)}")
    return "<br>".join(lines)


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
       color: #222; }
h1, h2 { line-height: 1.2; }
section { border-top: 1px solid #ccc; margin-top: 2.5rem; }
figure { margin: 1rem 0; }
img { max-width: 100%; height: auto; }
figcaption, small { color: #555; font-size: 0.85rem; }
table { border-collapse: collapse; font-size: 0.85rem; }
th, td { text-align: left; vertical-align: top; padding: 0.3rem 0.6rem;
         border-bottom: 1px solid #ddd; }
.wide { overflow-x: auto; }
.claims { width: 100%; table-layout: fixed; min-width: 44rem; }
.claims th:first-child { width: 8.5rem; }
.claims td:first-child { white-space: nowrap; font-weight: 600; }
.reproduced td:first-child { color: #00664b; }
.explained td:first-child { color: #005a91; }
.not-reproduced td:first-child { color: #a33c00; }
</style>
</head>
<body>
<h1>$title</h1>
$introduction
$body
</body>
</html>
""")
