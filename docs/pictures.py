"""Take or draw the documentation's pictures.

pictures.py [theory | survives | hunt FOLDER | PAGE SELECTOR NAME]

Without arguments the studies of PAGES are run in a temporary folder, as these pages say, and all
PICTURES are taken of their reports. Needs Chromium and Playwright (the extra ``test``).
With ``theory`` those of why_it_works.md are drawn, in half a minute; with ``survives`` that of
what_survives.md, from the table of the page; with ``hunt`` README's, of the folder of
``curricle run examples/tune.toml``.
"""

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import curricle as cr
from curricle.show.plots import draw_comparison

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent))

from tests.support.walk import walk  # noqa: E402 (found where the line above has Python look)

PAGES = ("tutorial.md", "howto/bring_a_task.md")
PICTURES = {
    "report_watch.png": ("maze-results", "#watch .viewer"),
    "report_findings.png": ("vault-results", "#findings"),
    "report_curves.png": ("vault-results", "#curves .answers"),
}
"""Of which study of the pages, and of what part of its report."""
WIDTH, HEIGHT = 860, 900


def of_pages() -> None:
    """Do what the pages say, and take all pictures of the reports of their studies."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as place:
        folder, variables = Path(place), {**os.environ, "PATH": programs}
        how = {"timed": False, "taken": lambda line: line.startswith("curricle ")}
        for page in PAGES:
            walk(HERE / page, folder, variables, **how)
        for name, (study, part) in PICTURES.items():
            subprocess.run(["curricle", "report", study], cwd=folder, env=variables, check=True)
            take(folder / study / "report.html", part, HERE / name)


def take(page: Path, part: str, picture: Path) -> None:
    """Take a picture of the element that a CSS selector finds.

    Replays are at their ends, and values of curves are read at three tenths of the steps.
    """
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        view = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme="light")
        view.goto(page.resolve().as_uri())
        for slider in ("#moment", "#tick"):
            view.locator(slider).press("End")
        for _ in range(7):
            view.locator("#chart").press("PageDown")
        view.evaluate("document.activeElement.blur()")
        taken = Image.open(io.BytesIO(view.locator(part).screenshot()))
        taken.convert("RGB").save(picture, optimize=True)
        browser.close()


# -- why it works -------------------------------------------------------------------------------

TEMPLATE = HERE.parent / "src/curricle/study/templates/maze.toml"
SIZE, RESOLUTION = (7.2, 2.9), 110  # inches, dots an inch
BUDGET, SEEDS, EVAL_FREQ = 40_000, 20, 400


def axes(title: str, x: str, y: str):
    """Return a figure on white, legible on light and dark pages, and its axes."""
    figure = Figure(SIZE, facecolor="white", layout="constrained")
    plot = figure.subplots()
    plot.set(title=title, xlabel=x, ylabel=y)
    plot.spines[["top", "right"]].set_visible(False)
    return figure, plot


def save(figure: Figure, name: str) -> None:
    """Write a figure into the folder of the pages."""
    figure.savefig(HERE / name, dpi=RESOLUTION, metadata={"Software": None})


def loops() -> None:
    """Rewards added on a way that goes back and forth ten times: a potential's, and a bonus."""
    line = cr.GridWorld("S....T")
    walk = np.array([0, *[1, 2, 3, 2, 1] * 10, 2, 3, 4, 5])
    place = line.states.decode()["column"][walk]
    phi = cr.StatePotential(line, line.states.decode()["column"].astype(float))
    ahead = np.diff(place) > 0
    discounts = line.mdp.discount ** np.arange(len(walk) - 1)
    figure, plot = axes("Ten times back and forth, then to the treasure", "steps", "added so far")
    plot.plot(
        np.cumsum([0, *discounts * ahead]), label="a bonus of 1 for each step ahead", color="C1"
    )
    added = phi.shaping_reward(walk[:-1], walk[1:])
    plot.plot(
        np.cumsum([0, *discounts * added]), label="F of the potential: the column", color="C0"
    )
    plot.axhline(0, color="0.6", linewidth=0.8)
    plot.legend(frameon=False)
    save(figure, "why_loops.png")


def maze_curves(title: str, shapings: dict[str, cr.QInitialisation | None], name: str) -> None:
    """Mean greedy returns in the maze, for each shaping."""
    figure, plot = axes(title, "steps", "greedy return")
    for label, shaping in shapings.items():
        result = cr.learn(
            milder(), budget=BUDGET, seeds=SEEDS, shaping=shaping, eval_freq=EVAL_FREQ
        )
        style = {"color": "0.5"} if shaping is None else {}
        style |= {"linestyle": "--"} if label.endswith("- 50") else {}
        plot.plot(result.steps, result.greedy_return.mean(axis=0), label=label, **style)
    figure.legend(frameon=False, loc="outside right upper")
    save(figure, name)


def milder() -> cr.GridWorld:
    """The maze that `curricle new maze` writes."""
    return cr.read_study(TEMPLATE).curriculum("transfer").tasks["maze"]


def levels() -> None:
    """Q started at Q* and at Q* plus or minus 50."""
    best = cr.solve(milder()).action_values
    started = {
        f"Q starts at {label}": cr.QInitialisation(best + level)
        for label, level in (("Q*", 0), ("Q* - 50", -50), ("Q* + 50", 50))
    }
    maze_curves(
        "The level of phi decides what is tried", {**started, "from scratch": None}, "why_level.png"
    )


def portfolio() -> None:
    """The corner's values and their negatives, alone and in a portfolio."""
    maze = milder()
    corner = maze.crop(rows=(0, 5), columns=(5, 10))
    phi = np.nan_to_num(cr.same_position(maze, corner).read(cr.solve(corner).action_values))
    shapings = {
        "phi": cr.QInitialisation(phi),
        "-phi": cr.QInitialisation(-phi),
        "phi, in a portfolio": cr.QInitialisation(phi, portfolio=cr.Portfolio()),
        "-phi, in a portfolio": cr.QInitialisation(-phi, portfolio=cr.Portfolio()),
        "from scratch": None,
    }
    maze_curves("A helpful and a misleading source", shapings, "why_portfolio.png")


def aggregates() -> None:
    """How far minimum, mean and maximum of two chases' values are above Q* of the hunt."""
    hunt, chase = cr.Pursuit(size=4, predators=2), cr.Pursuit(size=4, predators=1)
    best, source = cr.solve(hunt).action_values, cr.solve(chase).action_values
    read = [cr.project(hunt, chase, predator=f"predator_{i}").read(source) for i in (1, 2)]
    live = ~hunt.mdp.terminal
    figure, plot = axes(
        "Two predators, by the values of one", "phi - Q*, in return", "share of pairs"
    )
    for aggregate in (cr.minimum, cr.mean, cr.maximum):
        excess = (aggregate(np.stack(read)) - best)[live].ravel()
        bins = np.linspace(0, 4, 41)
        shares = np.histogram(excess, bins)[0] / excess.size
        plot.stairs(shares, bins, label=f"{aggregate.__name__}: {excess.mean():.2f} on average")
    plot.legend(frameon=False)
    save(figure, "why_aggregates.png")


# -- what survives --------------------------------------------------------------------------------

GAIN = re.compile(r"([+-][\d.]+) \[([+-][\d.]+), ([+-][\d.]+)\]")


def survives() -> None:
    """The gains of the page's table, as configured and against fair opponents."""
    lines = (HERE / "what_survives.md").read_text("utf-8").splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line[:1] == "|"]
    rows = [row for row in cells if len(row) == 8 and GAIN.match(row[2])]
    figure, plot = axes("What survives of published gains", "gain, as a share of the way", "")
    figure.set_size_inches(SIZE[0], 0.8 + 0.19 * len(rows))
    for column, colour, label, shift in (
        (2, "C0", "as configured, over scratch", -0.16),
        (4, "C1", "fair, over the best opponent", 0.16),
    ):
        gains = np.array(
            [[float(part) for part in GAIN.match(row[column]).groups()] for row in rows]
        )
        places = np.arange(len(rows)) + shift
        errors = np.abs(gains[:, 1:].T - gains[:, 0])
        plot.errorbar(gains[:, 0], places, xerr=errors, fmt="o", ms=4, color=colour, label=label)
    plot.axvline(0, color="0.6", linewidth=0.8)
    names = [re.sub(r"\[(.*?)\]\(.*?\)|, \d+$", r"\1", row[0]) for row in rows]
    labels = [f"{name}: {row[1]}" for name, row in zip(names, rows, strict=True)]
    plot.set_yticks(np.arange(len(rows)), labels, fontsize=7)
    plot.set_ylim(len(rows) - 0.5, -0.5)
    plot.legend(frameon=False, loc="center right")
    save(figure, "what_survives.png")


if __name__ == "__main__":
    if len(sys.argv) == 1:
        of_pages()
    elif sys.argv[1] == "theory":
        for draw in (loops, levels, portfolio, aggregates):
            draw()
    elif sys.argv[1] == "survives":
        survives()
    elif sys.argv[1] == "hunt":
        comparison = cr.study.StudyResults(sys.argv[2]).comparison
        save(draw_comparison(comparison, profiles=False), "tuned_hunt.png")
    else:
        take(Path(sys.argv[1]), sys.argv[2], HERE / sys.argv[3])
