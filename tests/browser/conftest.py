"""Pages, and a browser that opens them offline."""

import shutil
from pathlib import Path

import pytest

import curricle as cr
from curricle.comparison.other_runs import compare_files
from curricle.paper.reproduce import reproduce
from curricle.show.report import page_of_runs
from tests.unit.show.studies import chain_plan, hunt_plan, maze_plan, page_of, record

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
OFF = ("gpu", "quic", "background-networking", "component-update", "sync")
QUIET = ["--no-sandbox", "--no-first-run", *(f"--disable-{part}" for part in OFF)]
DESK = {"width": 1200, "height": 900}
RUNS = Path(__file__).parents[2] / "examples" / "other_runs" / "runs.csv"
ODD = "<img src=x onerror=alert(1)>&\"' "


@pytest.fixture(scope="session")
def studies():
    """The comparison and the page of each study."""
    plans = {"hunt": ("hunt", hunt_plan(cr.mean)), "maze": ("maze", maze_plan(3))}
    found = {}
    for name, (title, plan) in (plans | {"chain": (ODD, chain_plan(ODD))}).items():
        study = record(title, {f"{title} arm": plan}, 3, moments=3)
        found[name] = study.comparison, page_of(study)
    many = {
        f"{letter}, with a long_name_that_has_no_space_in_it": maze_plan(3) for letter in "abcdef"
    }
    five = {f"scaled by {n}": hunt_plan(cr.mean, scale=n) for n in range(1, 5)}  # and scratch
    study = record("five", five, 6)
    found["five"] = study.comparison, page_of(study)
    study = record("many", many, 2)
    found["many"] = study.comparison, page_of(study)
    runs = compare_files([RUNS], {"pretrained": "4096"})
    return found | {"runs": (runs, page_of_runs(runs))}


@pytest.fixture(scope="session")
def files(studies, tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("pages"), {}
    for name, (_, page) in studies.items():
        found[name] = folder / f"{name}.html"
        found[name].write_text(page, "utf-8")
    return found


@pytest.fixture(scope="session")
def paper_file(files, tmp_path_factory):
    """The page of the paper, with its quick figures, is among the files."""
    folder = tmp_path_factory.mktemp("paper")
    reproduce(folder, figures=["1", "hacking"], seeds=2)
    files["paper"] = folder / "index.html"


@pytest.fixture(scope="session")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if not CHROMIUM:
        pytest.skip("there is no Chromium on the path")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield launched
        launched.close()


@pytest.fixture
def visit(browser, files):
    """Opens a page; at the end of the test it must have logged and requested nothing."""
    contexts, heard = [], []

    def open_page(name, viewport=DESK, **settings):
        context = browser.new_context(viewport=viewport, **settings)
        contexts.append(context)
        page = context.new_page()
        address = files[name].as_uri()
        pictures = {file.as_uri() for file in files[name].parent.glob("*.svg")}  # of the paper
        own = {address, *pictures}
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on("dialog", lambda dialog: heard.append(dialog.message))
        page.on(
            "request",
            lambda r: heard.append(r.url) if r.url not in own and r.url[:5] != "data:" else None,
        )
        page.clock.install(time=0)
        page.goto(address)
        page.clock.pause_at(3600)  # from here on time passes only when a test advances it
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert heard == []
