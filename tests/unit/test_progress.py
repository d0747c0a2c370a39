"""What ``progress`` shows on a terminal, in a notebook and elsewhere; the pace of a run."""

import io
import re
from itertools import count
from unittest.mock import Mock

import numpy as np
import pytest
from rich.console import Console

import curricle as cr
from curricle import progress as progress_module
from curricle.cli import progress_bars
from curricle.cli.progress_bars import Lines
from curricle.comparison.plan import Unit
from curricle.errors import SettingError
from curricle.progress import Bars, Screen, shown
from curricle.study.progress import Pace, Progress

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


def longer():
    """Other tasks each time: the mapping of the same ones is remembered."""
    return cr.GridWorld(f"S{'.' * next(LENGTHS)}T")


ALL = cr.transfer.search.SEARCHES
COMPARED = ["scratch: maze", "transfer: corner", "transfer: maze", "transfer, negated: maze"]
LONG = {  # each function, and the parts that a user's function is called with
    "learn": (lambda **how: cr.learn(MAZE, budget=500, seeds=2, **how), [0, 1]),
    "train": (lambda **how: plan().train(2, **how), ["corner", "maze"]),
    "compare": (
        lambda **how: cr.compare(plan(), seeds=2, controls=["negated"], **how),
        ["scratch", "transfer", "transfer, negated"],
    ),
    "forecast": (lambda **how: cr.forecast(plan(), seeds=2, trial=False, **how), ["mean"]),
    "teach": (
        lambda **how: cr.teaching.teach({"maze": MAZE}, target="maze", budget=500, **how),
        [0],
    ),
    "find_mappings": (
        lambda **how: cr.transfer.find_mappings(MAZE, CORNER, searches=SEARCHES, **how),
        ["by_name", "by_homomorphism"],
    ),
    "auto_mapping": (
        lambda **how: cr.transfer.auto_mapping(longer(), LINE, **how),
        [search.__name__ for search in ALL],
    ),
    "lax_bisimulation": (
        lambda **how: cr.transfer.lax_bisimulation(cr.GridWorld("S..T"), LINE, **how),
        ["float"] * 3,
    ),
    "tabulate": (lambda **how: cr.tabulate("FrozenLake-v1", discount=0.9, **how), []),
    "solve": (lambda **how: cr.solve(MAZE, **how), ["float"]),
    "evaluate": (lambda **how: cr.evaluate(MAZE, [0] * 15, **how), ["float"]),
    "certify": (lambda **how: cr.certify(MAZE, zero(), **how), ["Certificate"]),
}
BARS = {  # that are shown
    "learn": ["learning: 2 done"],
    "train": ["corner: 2 done", "maze: 2 done"],
    "compare": [f"{bar}: 2 done" for bar in COMPARED],
    "forecast": ["corner: 2 done", "potentials: 1 done"],
    "teach": ["learning: 1 done"],
    "find_mappings": ["searches: 2 done"],
    "auto_mapping": [f"searches: {len(ALL)} done"],
}
every = pytest.mark.parametrize("name", LONG)


def in_words(part):
    return part if isinstance(part, str | int) else type(part).__name__


@every
def test_a_function_is_called_with_each_part(name):
    long, expected = LONG[name]
    parts = []
    long(progress=parts.append)
    assert [in_words(part) for part in parts] == expected


@every
def test_a_line_is_printed_for_each_full_bar_where_there_is_no_terminal(name, capsys):
    LONG[name][0](progress=True)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.splitlines() == BARS.get(name, [])


@every
def test_nothing_is_shown_unasked_and_anything_else_is_refused(name, capsys):
    for silent in (False, None):
        LONG[name][0](progress=silent)
        assert capsys.readouterr() == ("", "")
    for wrong in (3, "yes", [print]):
        rule = rf"progress must be True, False, None or a function: got {re.escape(repr(wrong))}$"
        with pytest.raises(SettingError, match=rule):
            LONG[name][0](progress=wrong)


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


def units(number):
    return tuple(Unit("0f", "scratch", "maze", (seed,), {}, {}, 0) for seed in range(number))


@pytest.fixture
def clock():
    """A clock of which a test moves the hand, `now`."""
    made = Mock(now=0.0)
    made.side_effect = lambda: made.now
    return made


def test_the_rate_is_that_of_what_was_seen(clock):
    pace, all_units = Pace(clock), units(1_000)
    pace.note(Progress(all_units))
    for unit in all_units[:100]:  # 1 a second, then 10 a second
        clock.now += 1.0
        pace.note(Progress(all_units, unit))
    assert pace.rate() == pytest.approx(1.0)
    for unit in all_units[100:800]:
        clock.now += 0.1
        pace.note(Progress(all_units, unit))
    assert pace.rate() == pytest.approx(10.0, rel=0.05)
    assert pace.line() == "800 of 1,000 units, 1 worker, 10 units a second, 0:00:20 left"
    pace = Pace(clock)
    assert pace.line_of(40, 100) == "40 of 100 units"
    clock.now += 10.0
    assert pace.line_of(40, 100) == "40 of 100 units"
    assert pace.line_of(45, 100) == "45 of 100 units, 30 units a minute, 0:01:50 left"
    clock.now += 10.0
    assert pace.line_of(50, 200) == "50 of 200 units, 30 units a minute, 0:05:00 left"


def test_very_many_units_have_a_line_a_second(capsys, clock):
    number = progress_bars.MANY + 500
    pace, all_units = Pace(clock), units(number)
    lines = Lines(pace)
    for unit in (None, *all_units):
        progress = Progress(all_units, unit)
        pace.note(progress)
        lines.show(progress)
        clock.now += 0.01
    printed = capsys.readouterr().err.splitlines()
    assert len(printed) == number // 100 + 1
    assert printed[-1].startswith(f"{number:,} of {number:,} units, 1 worker, ")


@pytest.mark.parametrize("width", [40, 80])
def test_the_line_stands_below_the_bars(clock, width):
    console = Console(record=True, force_terminal=True, width=width, file=io.StringIO())
    pace, all_units = Pace(clock), units(4)
    pace.note(Progress(all_units))
    with Screen(console, pace.line) as screen:
        Bars(screen).bar("scratch: maze", 4)
        clock.now += 1.0
        pace.note(Progress(all_units, all_units[0]))
    *_, last = console.export_text().strip().splitlines()
    assert "0:00:03 left" in last
