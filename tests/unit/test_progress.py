"""What a run says of its progress: how far it is, how fast it goes, when it will end."""

import io

import pytest
from rich.console import Console

from curricle.cli import progress_bars
from curricle.cli.progress_bars import Lines
from curricle.comparison.plan import Unit
from curricle.progress import Bars, Screen
from curricle.study.progress import Pace, Progress


def units(number):
    return tuple(Unit("0f", "scratch", "maze", (seed,), {}, {}, 0) for seed in range(number))


class Clock:
    """Seconds that pass when it is told."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_the_rate_is_that_of_what_was_seen(clock):
    pace, every = Pace(clock), units(1_000)
    pace.note(Progress(every))
    for unit in every[:100]:  # 1 a second, then 10 a second
        clock.now += 1.0
        pace.note(Progress(every, unit))
    assert pace.rate() == pytest.approx(1.0)
    for unit in every[100:800]:
        clock.now += 0.1
        pace.note(Progress(every, unit))
    assert pace.rate() == pytest.approx(10.0, rel=0.05)
    assert pace.line() == "800 of 1,000 units, 1 worker, 10 units a second, 0:00:20 left"
    pace = Pace(clock)
    assert pace.line_of(40, 100) == "40 of 100 units"
    clock.now += 10.0
    assert pace.line_of(40, 100) == "40 of 100 units"
    assert pace.line_of(45, 100) == "45 of 100 units, 30 units a minute, 0:01:50 left"
    clock.now += 10.0
    assert pace.line_of(50, 200) == "50 of 200 units, 30 units a minute, 0:05:00 left"


def printed(capsys, clock, number):
    pace, every = Pace(clock), units(number)
    lines = Lines(pace)
    for unit in (None, *every):
        progress = Progress(every, unit)
        pace.note(progress)
        lines.show(progress)
        clock.now += 0.01
    return capsys.readouterr().err.splitlines()


def test_very_many_units_have_a_line_a_second(capsys, clock):
    number = progress_bars.MANY + 500
    found = printed(capsys, clock, number)
    assert len(found) == number // 100 + 1
    assert found[-1].startswith(f"{number:,} of {number:,} units, 1 worker, ")


@pytest.mark.parametrize("width", [40, 80])
def test_the_line_stands_below_the_bars(clock, width):
    console = Console(record=True, force_terminal=True, width=width, file=io.StringIO())
    pace, every = Pace(clock), units(4)
    pace.note(Progress(every))
    with Screen(console, pace.line) as screen:
        Bars(screen).bar("scratch: maze", 4)
        clock.now += 1.0
        pace.note(Progress(every, every[0]))
    *_, last = console.export_text().strip().splitlines()
    assert "0:00:03 left" in last
