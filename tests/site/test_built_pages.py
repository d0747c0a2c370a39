"""The site that `make docs` has built, if any: no dead link, nothing fetched, search works."""

import re
import shutil
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

SITE = Path(__file__).parents[2] / "docs" / "_build"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SITE / "index.html").exists(), reason="make docs builds the site"),
]
FETCHING = {"src", "srcset", "data", "poster"}
"""Attributes whose addresses a browser fetches by itself; those of links it does not."""
WEB = re.compile(r"^(https?:)?//")
STYLES_FROM_THE_WEB = re.compile(r"""(?:url\(\s*['"]?|@import\s+['"])((?:https?:)?//[^'")]+)""")
WIDTHS = (390, 1300)


class Parsed(HTMLParser):
    """A page's links, what it fetches, and the places in it that a link can lead to."""

    def __init__(self, path: Path):
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.places: set[str] = set()
        text = path.read_text("utf-8")
        self.feed(text)
        self.fetched += STYLES_FROM_THE_WEB.findall(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.places |= {given[key] for key in ("id", "name") if given.get(key)}
        self.fetched += [given[key] for key in FETCHING & set(given) if given[key]]
        if href := given.get("href"):
            (self.fetched if tag == "link" else self.links).append(href)


@cache
def parsed(path: Path) -> Parsed:
    return Parsed(path)


def pages() -> list[Path]:
    return sorted(path for path in SITE.rglob("*.html") if "_static" not in path.parts)


def written_pages() -> list[Path]:
    """Return the pages but for those of single names."""
    return [path for path in pages() if "generated" not in path.parts]


def test_no_link_is_dead():
    dead = []
    for page in pages():
        for link in parsed(page).links:
            path, _, anchor = link.partition("#")
            if ":" in path or WEB.match(path):
                continue
            place = (page.parent / unquote(path)).resolve() if path else page
            lost = not place.exists()
            if not lost and anchor and place.suffix == ".html":
                lost = unquote(anchor) not in parsed(place).places
            if lost:
                dead.append(f"{page.relative_to(SITE)}: {link}")
    assert dead == []


def test_no_page_or_style_fetches_from_the_web():
    found = [
        f"{page.relative_to(SITE)}: {address}"
        for page in pages()
        for address in parsed(page).fetched
        if WEB.match(address)
    ]
    for style in SITE.rglob("*.css"):
        found += STYLES_FROM_THE_WEB.findall(style.read_text("utf-8"))
    assert found == []


@pytest.fixture(scope="module")
def browser():
    driver = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome")
    chromium = next(filter(None, map(shutil.which, names)), None)
    if chromium is None:
        pytest.skip("there is no Chromium")
    with driver.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.mark.parametrize("width", WIDTHS)
def test_pages_fit_and_ask_for_nothing(browser, width):
    """No page is wider than the window, logs an error, or asks for what is not its own."""
    view = browser.new_page(viewport={"width": width, "height": 900})
    asked, errors, wide = [], [], []
    view.on("request", lambda request: asked.append(request.url))
    view.on("pageerror", lambda error: errors.append(str(error)))
    for page in written_pages():
        view.goto(page.as_uri())
        if view.evaluate("document.scrollingElement.scrollWidth > window.innerWidth"):
            wide.append(page.name)
    assert wide == []
    assert errors == []
    assert {url.partition(":")[0] for url in asked} <= {"file", "data"}
    view.close()
