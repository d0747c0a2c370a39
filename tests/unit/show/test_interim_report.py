"""The interim report of a run while units are stored, which never stops it."""

import re
import shutil
from time import sleep

import pytest

from curricle.checks import listed
from curricle.show import report as module
from curricle.show.report import InterimReport, arms_so_far
from curricle.study import run_study
from curricle.study.record import FailureRecord
from curricle.study.results import StudyResults, write_failures
from curricle.study.store import StudyStore
from tests.support.studies import CORNER, reader


class Followed:
    """An interim report of a folder without units, and what it said."""

    def __init__(self, finished, tmp_path):
        self.folder, self.path = tmp_path / "live", tmp_path / "page.html"
        left_out = shutil.ignore_patterns("units", "*.parquet", "ana*")
        shutil.copytree(finished, self.folder, ignore=left_out)
        self.finished, self.keys = finished, StudyResults(finished).record.keys
        self.said = []
        self.report = InterimReport(self.folder, self.path, self.said.append)

    def refresh(self, so_far, **how):
        """Write the page now, however long the last one took."""
        self.report._due = 0.0
        self.report.refresh(so_far, **how)

    def store(self, arm, *tasks):
        """Store the units of some tasks of an arm."""
        for task in tasks:
            (unit,) = (self.finished / "units").glob(f"*-{self.keys[arm, task]}")
            shutil.copytree(unit, self.folder / "units" / unit.name)

    def fail(self, *arms):
        """Record that the first seed of the target of some arms was lost."""
        lost = {"seeds": (0,), "error": "lost"}
        failures = tuple(FailureRecord(key=self.keys[arm, "maze"], **lost) for arm in arms)
        write_failures(StudyStore(self.folder), failures)

    @property
    def page(self):
        return self.path.read_text("utf-8")

    @property
    def banner(self):
        """What stands at the top of the page, in words, and the seconds until it is read again."""
        seconds, text = re.search(r'id="interim".*?seconds="(.*?)">(.*?)</p>', self.page).groups()
        return re.sub("<.*?>", "", text), float(seconds)


@pytest.fixture
def live(finished, tmp_path):
    return Followed(finished, tmp_path)


def test_the_page_follows_the_folder(live):
    live.refresh("0 of 16 units")
    text, seconds = live.banner
    assert re.match(r"Interim report, written at [\d:]+( [AP]M)?\. 0 of 16 units\.", text)
    assert "begins when scratch and another arm have finished a seed" in text
    assert seconds == 2
    live.store("scratch", "maze")
    live.refresh("2 of 16 units")
    assert "2 of 16 units. The report begins" in live.banner[0]
    live.store("chain", "corner", "easy", "maze")
    live.refresh("8 of 16 units")
    assert re.search(
        "8 of 16 units.* is of scratch, chain; to come: state, .*. There", live.banner[0]
    )
    assert re.search(r">\s*chain\s*<.*reload|reload.*>\s*chain\s*<", live.page, re.DOTALL)
    live.refresh("The run is over: 8 of 16 units", over=True)
    text, seconds = live.banner
    assert (text.startswith("Part of a report"), seconds) == (True, 0)


def test_a_page_that_took_long_is_not_written_for_long(live, monkeypatch):
    written = []
    monkeypatch.setattr(module, "write_page", lambda page, path: written.append(page))
    monkeypatch.setattr(module, "arms_so_far", lambda _: sleep(0.3) or [])
    live.report.refresh("1 of 16 units")
    live.report.refresh("2 of 16 units")
    assert len(written) == 1
    live.report._due = 0.0
    live.report.refresh("3 of 16 units")
    assert float(re.search('seconds="(.*?)"', written[1])[1]) >= 3
    live.report.refresh("4 of 16 units", over=True)
    assert len(written) == 3


def test_an_error_is_said_once_and_the_last_page_stays(live, monkeypatch):
    live.refresh("0 of 16 units")
    page = live.page
    with monkeypatch.context() as broken:
        broken.setattr(module, "arms_so_far", lambda _: {}["a\nkey"])
        live.refresh("1 of 16 units")
        live.refresh("1 of 16 units")
    (said,) = live.said
    assert said.startswith(r"the page of the run is not up to date. KeyError: 'a\nkey' (raised in ")
    assert live.page == page
    live.refresh("2 of 16 units")
    assert "2 of 16" in live.banner[0]


def test_a_page_that_cannot_be_written_is_told_and_without_curricula_there_is_none(live):
    arms = StudyResults(live.finished).record.arms
    names = [name for name, arm in arms.items() if not (arm.scratch or arm.control_of)]
    live.path.mkdir()
    live.refresh("0 of 16 units")
    (complaint,) = live.said
    assert "cannot be written" in complaint
    live.path.rmdir()
    live.fail(*names)
    live.store("scratch", "maze")
    live.refresh("2 of 16 units")
    assert f"There is no report: {listed(names)} failed. curricle show says" in live.banner[0]


def test_a_study_without_scratch_has_no_report(live):
    live.fail("scratch")
    live.store("chain", "corner")
    live.refresh("2 of 16 units")
    assert "There is no report: " in live.banner[0]


def test_a_control_waits_for_the_arm_that_it_is_of(tmp_path):
    changes = ["seeds=2", "tasks.maze.budget=400", "window=1", 'controls=["placebo"]']
    study = reader(tmp_path)(CORNER, set=changes)
    results = run_study(study, tmp_path / "out", progress=False)
    assert arms_so_far(results) == [
        "scratch",
        "transfer",
        "transfer, placebo",
        "transfer, placebo, alone",
    ]
    target = results.record.keys["transfer", "maze"]
    for unit in results.store.units():
        if unit.key == target:
            unit.path.unlink()
    assert arms_so_far(StudyResults(tmp_path / "out")) == []
