"""Pages, and a browser that opens them offline."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.learning.record import Snapshots
from curricle.paper.reproduce import reproduce
from tests.study_pages import study_page

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
QUIET = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
DESK = {"width": 1200, "height": 900}
ODD = "<img src=x onerror=alert(1)>&\"' "


def kept_snapshots(task, budget, name, phi=None):
    """Three moments of training, each a training of its own."""
    steps = np.array([0, budget // 2, budget])
    first = np.zeros((task.states.size, task.actions.size)) if phi is None else phi.values
    later = [
        cr.learn(
            task, None, int(n), shaping=cr.QInitialisation(phi), eval_freq=int(n), stream=name
        ).values[0]
        for n in steps[1:]
    ]
    return Snapshots(0, steps, np.array([first, *later], dtype=np.float32))


def study_of(title, plan):
    """A study of one curriculum against its target alone: its comparison and its page."""
    comparison = cr.compare({f"{title} arm": plan}, seeds=3)
    target = plan.target
    scratch = cr.Curriculum({target: plan.tasks[target]}, budget=comparison.total)
    results = {"scratch": scratch.train(3), f"{title} arm": plan.train(3)}
    for arm, result in results.items():
        nodes = {}
        for name, node in result.nodes.items():
            phi = (result.potentials[name] or [None])[0]
            kept = kept_snapshots(node.task, int(node.steps_used[0]), name, phi)
            nodes[name] = replace(node, snapshots=kept)
        results[arm] = replace(result, nodes=nodes)
    return comparison, study_page(title, comparison, results)


def hunt():
    two, one = (cr.Pursuit(3, n, discount=0.9, time_limit=25) for n in (2, 1))
    names = two.predator_names
    return cr.Curriculum(
        {"chase": one, "hunt": two},
        [cr.Transfer("chase", "hunt", cr.project(two, one, predator=name)) for name in names],
        budget={"chase": 3000, "hunt": 6000},
    )


def maze():
    whole = cr.GridWorld(["......T", ".PP....", "F......", "S.#...."], time_limit=40)
    corner = whole.crop(rows=(0, 3), columns=(3, 7))
    return cr.Curriculum(
        {"corner": corner, "maze": whole},
        [cr.Transfer("corner", "maze", cr.same_position(whole, corner))],
        budget={"corner": 500, "maze": 3000},
    )


def chain():
    def line(n):
        rows = [[[(1.0, max(s - 1, 0), -1.0)], [(1.0, s + 1, -1.0)]] for s in range(n - 1)]
        ended = [False] * (n - 1) + [True]
        return cr.FiniteMDP.from_outcomes(
            [*rows, [[], []]], terminal=ended, start=0, discount=0.9, time_limit=25
        )

    long, short = line(9), line(5)
    f = cr.from_function(long, short, lambda s, a: ({"state": s["state"] - 4}, a))
    return cr.Curriculum(
        {f"{ODD} short": short, f"{ODD} long": long},
        [cr.Transfer(f"{ODD} short", f"{ODD} long", f)],
        budget={f"{ODD} short": 300, f"{ODD} long": 1500},
    )


@pytest.fixture(scope="session")
def studies():
    """The comparison and the page of each study."""
    plans = {"hunt": ("hunt", hunt()), "maze": ("maze", maze()), "chain": (ODD, chain())}
    return {name: study_of(*plan) for name, plan in plans.items()}


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
        own = {address} | {
            one.as_uri() for one in files[name].parent.glob("*.svg")
        }  # a paper's pictures
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
