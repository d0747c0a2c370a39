"""What ``progress`` shows on a terminal, in a notebook and elsewhere, and what it calls."""

import io
from itertools import count

import numpy as np
import pytest
from rich.console import Console

import curricle as cr
from curricle import progress as progress_module
from curricle.errors import SettingError
from curricle.progress import Bars, Screen, shown

MAZE = cr.GridWorld(["....T", ".PPP.", "S...."])
CORNER = MAZE.crop(rows=(0, 2), columns=(2, 5))
SEARCHES = [cr.transfer.by_name, cr.transfer.by_homomorphism]
LINE, LENGTHS = cr.GridWorld("S.T"), count(1)


def plan():
    return cr.Curriculum(
        tasks={"corner": CORNER, "maze": MAZE},
        transfers=[cr.Transfer("corner", "maze", cr.same_position(MAZE, CORNER))],
        budget={"corner": 500, "maze": 1000},
    )


def zero():
    return cr.StateShaping(np.zeros(MAZE.states.size))


# Each function, the parts that a user's function is called with, and the bars that are shown.
LONG = {
    "learn": (
        lambda **how: cr.learn(MAZE, budget=500, seeds=2, **how),
        [0, 1],
        ["learning: 2 done"],
    ),
    "train": (
        lambda **how: plan().train(2, **how),
        ["corner", "maze"],
        ["corner: 2 done", "maze: 2 done"],
    ),
    "compare": (
        lambda **how: cr.compare(plan(), seeds=2, controls=["negated"], **how),
        ["scratch", "transfer", "transfer, negated"],
        [
            *["scratch: maze: 2 done", "transfer: corner: 2 done", "transfer: maze: 2 done"],
            "transfer, negated: maze: 2 done",
        ],
    ),
    "forecast": (
        lambda **how: cr.forecast(plan(), seeds=2, trial=False, **how),
        ["mean"],
        ["corner: 2 done", "potentials: 1 done"],
    ),
    "teach": (
        lambda **how: cr.teaching.teach({"maze": MAZE}, target="maze", budget=500, **how),
        [0],
        ["learning: 1 done"],
    ),
    "find_mappings": (
        lambda **how: cr.transfer.find_mappings(MAZE, CORNER, searches=SEARCHES, **how),
        ["by_name", "by_homomorphism"],
        ["searches: 2 done"],
    ),
    "auto_mapping": (
        # other tasks each time: what was found for the same ones is remembered
        lambda **how: cr.transfer.auto_mapping(
            cr.GridWorld(f"S{'.' * next(LENGTHS)}T"), LINE, **how
        ),
        [one.__name__ for one in cr.transfer.found_mappings.SEARCHES],
        [f"searches: {len(cr.transfer.found_mappings.SEARCHES)} done"],
    ),
    "lax_bisimulation": (
        lambda **how: cr.transfer.lax_bisimulation(cr.GridWorld("S..T"), LINE, **how),
        ["float"] * 3,
        [],
    ),
    "tabulate": (lambda **how: cr.tabulate("FrozenLake-v1", discount=0.9, **how), [], []),
    "solve": (lambda **how: cr.solve(MAZE, **how), ["float"], []),
    "evaluate": (lambda **how: cr.evaluate(MAZE, [0] * 15, **how), ["float"], []),
    "certify": (lambda **how: cr.certify(MAZE, zero(), **how), ["Certificate"], []),
}
each = pytest.mark.parametrize("name", LONG)


def in_words(part):
    return part if isinstance(part, str | int) else type(part).__name__


@each
def test_a_function_is_called_with_each_part(name):
    long, told, _ = LONG[name]
    parts = []
    long(progress=parts.append)
    assert [in_words(part) for part in parts] == told


@each
def test_a_line_is_printed_for_each_full_bar_where_there_is_no_terminal(name, capsys):
    long, _, lines = LONG[name]
    long(progress=True)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.splitlines() == lines


@each
@pytest.mark.parametrize("silent", [False, None])
def test_nothing_is_shown_unasked(name, silent, capsys):
    LONG[name][0](progress=silent)
    assert capsys.readouterr() == ("", "")


@each
@pytest.mark.parametrize("wrong", [3, "yes", [print]])
def test_anything_else_is_refused_in_a_sentence(name, wrong):
    with pytest.raises(SettingError) as error:
        LONG[name][0](progress=wrong)
    rule = "progress must be True, False, None or a function: got "
    assert str(error.value) in (f"{rule}{wrong!r}", f"{rule}[<built-in function print>]")


def test_bars_grow_on_a_terminal():
    console = Console(force_terminal=True, record=True, width=100, file=io.StringIO())
    screen = Screen(console)
    bars = Bars(screen).within("transfer")
    grow = bars.bar("[bold]maze", 2)
    grow()
    grow()
    bars.bar("[bold]maze", 2)  # more seeds of the same work
    bars.bar("certifying")
    bars.at("sweeps", 1200)  # of a number that nobody knows
    console.print(screen)
    row, other, sweeps = console.export_text().splitlines()
    assert row.startswith("transfer: [bold]maze")
    assert " 2/4 " in row
    assert other.startswith("transfer: certifying")
    assert "/" not in other
    assert " 1,200 " in sweeps
    assert "/" not in sweeps


class Place:
    """Where a notebook shows something, which is shown anew."""

    def __init__(self, first):
        self.shown = [first]

    def update(self, what, raw=False):
        self.shown.append(what if raw else what._repr_mimebundle_([], []))


@pytest.fixture
def notebook(monkeypatch):
    """The places of a notebook that something was shown in."""
    places = []

    def display(what, display_id):
        places.append(Place(what._repr_mimebundle_([], [])))
        return places[-1]

    monkeypatch.setattr("IPython.display.display", display)
    monkeypatch.setattr(
        progress_module, "Console", lambda stderr: Console(force_jupyter=True, width=100)
    )
    monkeypatch.setattr(progress_module, "BETWEEN", 0.0)
    return places


def test_a_notebook_shows_bars_in_one_place_that_is_empty_in_the_end(notebook):
    pytest.importorskip("IPython")
    plan().train(3, progress=True)
    (place,) = notebook
    *pictures, last = place.shown
    assert "corner" in pictures[0]["text/html"]
    assert "0/3" in pictures[0]["text/html"]
    assert "maze" in pictures[-1]["text/plain"]
    assert "3/3" in pictures[-1]["text/plain"]
    assert set(last.values()) == {""}


def test_bars_end_with_an_error(notebook):
    def fails(potentials):
        raise RuntimeError

    broken = plan().replace("maze", aggregate=fails)
    with pytest.raises(RuntimeError):
        broken.train(progress=True)
    assert set(notebook[0].shown[-1].values()) == {""}


def test_a_full_bar_has_one_line(capsys):
    with shown(True) as bars:
        for done in (11, 12, 12):
            bars.at("tabulating", done, 12)
        bars.bar("tabulating")
        assert capsys.readouterr().err == "tabulating: 12 done\n"
        bars.at("tabulating", 13, 14)
        bars.at("tabulating", 14, 14)
    assert capsys.readouterr().err == "tabulating: 14 done\n"
