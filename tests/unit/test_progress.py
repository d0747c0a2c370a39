"""What ``progress`` shows on a terminal, in a notebook and elsewhere; the pace of a run."""

import io
from functools import partial
from itertools import count
from time import sleep

import numpy as np
import pytest
from rich.console import Console

import curricle as cr
from curricle import progress as progress_module
from curricle.cli.progress_bars import Lines
from curricle.comparison.plan import Unit
from curricle.errors import SettingError
from curricle.progress import Bars, Screen, shown
from curricle.study.running import Pace, Progress

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


ZERO = cr.StateShaping(np.zeros(MAZE.states.size))
FOUND = [search.__name__ for search in cr.transfer.search.SEARCHES]


def other_mapping(**how):
    """Mappings of other tasks each time: what was found for the same ones is remembered."""
    return cr.transfer.auto_mapping(cr.GridWorld(f"S{'.' * next(LENGTHS)}T"), LINE, **how)


COMPARE = partial(cr.compare, plan(), seeds=2, controls=["negated"], opponents=())
SEARCH = partial(cr.transfer.find_mappings, MAZE, CORNER, searches=SEARCHES)
ARMS = ["scratch", "transfer", "transfer, negated"]
BARS = ["scratch: maze", "transfer: corner", "transfer: maze", "transfer, negated: maze"]
FORECAST = partial(cr.forecast, plan(), seeds=2, trial=False)
# Each function, the parts that a user's function is called with, and the bars that are full.
LONG = {
    "learn": (partial(cr.learn, MAZE, budget=500, seeds=2), [0, 1], ["learning: 2"]),
    "train": (partial(plan().train, 2), ["corner", "maze"], ["corner: 2", "maze: 2"]),
    "compare": (COMPARE, ARMS, [f"{bar}: 2" for bar in BARS]),
    "forecast": (FORECAST, ["corner"], ["corner: 2"]),
    "find_mappings": (SEARCH, ["by_name", "by_homomorphism"], ["searches: 2"]),
    "auto_mapping": (other_mapping, FOUND, [f"searches: {len(FOUND)}"]),
    "tabulate": (partial(cr.tabulate, "FrozenLake-v1", discount=0.9), [], ["FrozenLake-v1: 16"]),
    "solve": (partial(cr.solve, MAZE), ["float"], []),
    "evaluate": (partial(cr.evaluate, MAZE, [0] * 15), ["float"], []),
    "certify": (partial(cr.certify, MAZE, ZERO), ["Certificate"], []),
}
each_function = pytest.mark.parametrize("name", LONG)


def in_words(part):
    return part if isinstance(part, str | int) else type(part).__name__


@each_function
def test_a_function_is_called_with_each_part_and_nothing_is_shown_unasked(name, capsys):
    long, parts, _ = LONG[name]
    calls = []
    long(progress=calls.append)
    assert [in_words(part) for part in calls] == parts
    for silent in (False, None):
        long(progress=silent)
    assert capsys.readouterr() == ("", "")


@each_function
def test_a_line_is_printed_for_each_full_bar_where_there_is_no_terminal(name, capsys):
    long, _, lines = LONG[name]
    long(progress=True)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.splitlines() == [f"{line} done" for line in lines]


@each_function
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
    assert " 0/?" in other
    assert "1200/?" in sweeps


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
    corner = next(picture for picture in pictures if "corner" in picture["text/html"])
    assert "0/3" in corner["text/html"]
    assert "maze" in pictures[-1]["text/plain"]
    assert "3/3" in pictures[-1]["text/plain"]
    assert set(last.values()) == {""}


@pytest.fixture
def terminal(monkeypatch):
    """What a terminal shows where nobody asked for bars; they come after 0.05 seconds."""
    written = io.StringIO()
    console = partial(Console, file=written, force_terminal=True, width=100)
    monkeypatch.setattr(progress_module, "Console", lambda stderr: console())
    monkeypatch.setattr(progress_module, "_watched", lambda: True)
    monkeypatch.setattr(progress_module, "DELAY", 0.05)
    return written


def test_a_long_function_shows_by_itself_how_far_it_is(terminal):
    with shown(None) as bars:
        grow = bars.bar("outer", 2)
        bars.partly("outer", lambda: 0.5)
        grow()
        bars.say("about an hour")
        with shown(None) as inner:  # as of a function that this one calls
            inner.bar("inner", 3)
            sleep(0.3)
        sleep(0.3)
        assert bars.screen.tasks[0].completed == 1.5
        grow()
        assert bars.screen.tasks[0].completed == 2
    seen = terminal.getvalue()
    assert "about an hour" in seen
    assert seen.count("outer") > seen.count("inner") > 0  # the inner bar ends as its function does


@pytest.mark.parametrize("asked", [False, lambda part: None])
def test_what_runs_inside_a_silent_function_is_silent(terminal, monkeypatch, asked):
    with shown(asked), shown(None) as inner:
        inner.bar("inner", 3)
        sleep(0.2)
    monkeypatch.setattr(progress_module, "DELAY", 60.0)
    cr.learn(MAZE, budget=500, seeds=2)  # as a short function does
    assert terminal.getvalue() == ""


def test_a_full_bar_has_one_line_and_bars_end_with_an_error(notebook, capsys, monkeypatch):
    def fails(potentials):
        raise RuntimeError

    broken = plan().replace("maze", aggregate=fails)
    with pytest.raises(RuntimeError):
        broken.train(progress=True)
    assert set(notebook[0].shown[-1].values()) == {""}
    monkeypatch.undo()  # no notebook
    with shown(True) as bars:
        for done, of in ((11, 12), (12, 12), (12, 12), (13, 14), (14, 14)):
            bars.at("tabulating", done, of)
        bars.bar("tabulating")
    lines = capsys.readouterr().err.splitlines()
    assert lines[-2:] == ["tabulating: 12 done", "tabulating: 14 done"]


def units(number):
    return tuple(Unit("0f", "scratch", "maze", (seed,), {}, {}, 0) for seed in range(number))


class Clock:
    """Seconds that pass when a test sets them."""

    now = 0.0

    def __call__(self):
        return self.now


def test_the_time_left_is_that_at_the_pace_so_far_and_stands_below_the_bars():
    clock, every = Clock(), units(1_000)
    pace = Pace(clock)
    assert pace.line() == ""
    pace.note(Progress(every))
    for unit in every[:800]:
        clock.now += 0.1
        pace.note(Progress(every, unit))
    assert pace.line() == "800 of 1,000 units, 1 worker, about 20 s left"
    console = Console(record=True, force_terminal=True, width=80, file=io.StringIO())
    with Screen(console, pace.line) as screen:
        Bars(screen).bar("scratch: maze", 4)
    *_, last = console.export_text().strip().splitlines()
    assert "about 20 s left" in last


def test_lines_in_a_pipe_come_at_each_tenth_and_every_ten_seconds_at_most(capsys):
    def lines(number, seconds, tuning=""):
        clock, every = Clock(), units(number)
        pace = Pace(clock)
        printer = Lines(pace)
        for unit in (None, *every):
            now = Progress(every, unit, 2, tuning)
            pace.note(now)
            printer.show(now)
            clock.now += seconds
        return capsys.readouterr().err.splitlines()

    quick = lines(1000, 0.001)
    assert [line.split()[0] for line in quick] == [*(f"{n}00" for n in range(1, 10)), "1,000"]
    slow = lines(120, 3.0)
    assert slow[0] == "4 of 120 units, 2 workers, about 6 min left"  # 12 seconds after the start
    assert slow[2] == "12 of 120 units, 2 workers, about 5 min left"
    assert slow[-1] == "120 of 120 units, 2 workers"
    assert lines(100, 0.001, "round 1") == ["round 1"]
