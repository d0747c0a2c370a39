"""The interim report of a folder while units are stored, and that it never stops a run."""

import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from threading import Thread
from time import monotonic, sleep
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from curricle.checks import listed
from curricle.errors import StoreError
from curricle.show import report as module
from curricle.show.report import InterimReport, arms_so_far, page_of
from curricle.study import run_study
from curricle.study.results import StudyResults
from curricle.study.store import in_use, locked
from tests.studies import CORNER, reader


class Followed:
    """An interim report of a folder without units, and what it said and opened."""

    def __init__(self, finished, tmp_path):
        self.folder, self.path = tmp_path / "live", tmp_path / "page.html"
        left_out = shutil.ignore_patterns("units", "*.parquet", "ana*")
        shutil.copytree(finished, self.folder, ignore=left_out)
        self.finished, self.keys = finished, StudyResults(finished).record.keys
        self.said, self.opened = [], []

    def report(self):
        settings = "{} of {} units".format, self.said.append, self.opened.append
        return InterimReport(self.folder, *settings, self.path)

    def store(self, arm, *tasks):
        """Store the units of some tasks of an arm."""
        for task in tasks:
            (unit,) = (self.finished / "units").glob(f"*-{self.keys[arm, task]}")
            shutil.copytree(unit, self.folder / "units" / unit.name)

    def store_all(self):
        shutil.copytree(self.finished, self.folder, dirs_exist_ok=True)

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


def test_the_page_follows_the_folder_to_the_report_of_the_run(live):
    report = live.report()
    report.refresh()
    text, seconds = live.banner
    assert re.match(r"Interim report, written at [\d:]+( [AP]M)?\. 0 of 16 units\.", text)
    assert "begins when scratch and another arm have finished a seed" in text
    assert seconds == 2
    live.store("scratch", "maze")
    report.refresh()
    assert "2 of 16 units. No process is at work now. The report begins" in live.banner[0]
    live.store("chain", "corner", "easy", "maze")
    report.refresh()
    text, seconds = live.banner
    assert re.search(
        "8 of 16 units.* is of scratch, chain; to come: state, calibrated. There", text
    )
    assert seconds >= 2
    assert re.search(r">\s*chain\s*<.*reload|reload.*>\s*chain\s*<", live.page, re.DOTALL)
    live.store_all()
    report.refresh()
    assert live.page == page_of(StudyResults(live.finished))
    assert "reload" not in live.page
    assert (live.said, live.opened) == ([], [live.path])


def test_the_page_is_written_when_something_is_new_and_rests_long_if_it_took_long(
    live, monkeypatch
):
    report, written = live.report(), []
    monkeypatch.setattr(module, "write_page", lambda page, path: written.append(page))
    for times in (1, 1, 2, 2):
        if (times, len(written)) == (2, 1):
            (live.folder / "units").mkdir()
            live.store("scratch", "maze")
        assert report.refresh() >= module.BETWEEN
        assert len(written) == times
    monkeypatch.setattr(module, "arms_so_far", lambda _: sleep(0.3) or [])
    assert live.report().refresh() >= 3
    assert float(re.search('seconds="(.*?)"', written[-1])[1]) >= 3


@pytest.fixture
def hasty(monkeypatch):
    monkeypatch.setattr(module, "BETWEEN", 0.01)
    monkeypatch.setattr(module, "REST", 0.0)


@pytest.mark.usefixtures("hasty")
def test_a_reader_at_any_moment_has_a_whole_page(live):
    seen, until = set(), monotonic() + 120
    thread = Thread(target=live.report().watch, daemon=True)
    thread.start()
    for line, arm, *tasks in (
        ("2 of 16", "scratch", "maze"),
        ("8 of 16", "chain", "corner", "easy", "maze"),
        ("10 of 16", "state", "easy"),
    ):
        live.store(arm, *tasks)
        while monotonic() < until and not any(line in page for page in seen):
            sleep(0.001)
            if live.path.exists():
                seen.add(live.page)
    live.store_all()
    thread.join(60)
    assert len(seen) >= 3
    assert all(page.rstrip().endswith("</html>") for page in seen)
    assert [*live.path.parent.glob(".*.part")] == []


def test_an_error_is_said_once_and_the_last_page_stays(live, monkeypatch):
    report = live.report()
    report.refresh()
    page = live.page
    live.store("scratch", "maze")
    with monkeypatch.context() as broken:
        broken.setattr(module, "arms_so_far", lambda _: {}["a\nkey"])
        report.refresh()
        report.refresh()
    assert live.said == [r"the page of the run is not up to date. KeyError: 'a\nkey'"]
    assert live.page == page
    report.refresh()
    assert "2 of 16" in live.banner[0]


def test_a_page_that_cannot_be_written_is_told(live):
    live.path.mkdir()
    live.report().refresh()
    (complaint,) = live.said
    assert "cannot be written" in complaint


def test_a_file_that_is_merged_while_it_is_read_is_no_error(live, monkeypatch):
    merged = StoreError("units/maze/seeds-0.npz cannot be read: No such file or directory")
    arms = Mock(side_effect=[merged, []])
    monkeypatch.setattr(module, "arms_so_far", arms)
    live.report().refresh()
    assert (arms.call_count, live.said) == (2, [])


def test_the_page_of_a_watch_that_is_interrupted_says_so_and_is_read_no_more(live, monkeypatch):
    live.store("scratch", "maze")
    monkeypatch.setattr(module, "sleep", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        live.report().watch()
    assert "the run goes on by itself" in live.banner[0]
    assert live.banner[1] == 0


def test_a_study_without_scratch_has_no_report(live):
    (live.folder / "failures.json").write_text(
        f'[{{"key": "{live.keys["scratch", "maze"]}", "seeds": [0], "error": "lost"}}]'
    )
    live.store("chain", "corner")
    live.report().refresh()
    assert "There is no report: " in live.banner[0]


def test_a_study_whose_curricula_have_all_failed_has_no_report(live):
    arms = StudyResults(live.finished).record.arms
    names = [name for name, arm in arms.items() if not (arm.scratch or arm.control_of)]
    failures = [{"key": live.keys[name, "maze"], "seeds": [0], "error": "lost"} for name in names]
    (live.folder / "failures.json").write_text(json.dumps(failures))
    live.store("scratch", "maze")
    live.report().refresh()
    assert f"There is no report: {listed(names)} failed. curricle show says" in live.banner[0]


# -- runs elsewhere --------------------------------------------------------------------------------


@pytest.mark.usefixtures("hasty")
def test_watching_ends_when_the_run_lets_go_of_the_folder(live):
    live.store("scratch", "maze")
    with locked(live.folder):
        thread = Thread(target=live.report().watch, daemon=True)
        thread.start()
        until = monotonic() + 60
        while not live.opened and monotonic() < until:
            sleep(0.01)
        sleep(0.2)
        assert thread.is_alive()
        assert "No process" not in live.banner[0]
    thread.join(60)
    assert not thread.is_alive()
    assert "The run is over: 2 of 16 units are stored." in live.banner[0]
    assert live.banner[1] == 0


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("whole", [True, False])
def test_watching_ends_where_no_page_can_be_made(live, monkeypatch, whole):
    monkeypatch.setattr(module, "arms_so_far", Mock(side_effect=ValueError("no page")))
    monkeypatch.setattr(module, "page_of", Mock(side_effect=ValueError("no page")))
    with ThreadPoolExecutor(1) as other:
        with locked(live.folder):
            watching = other.submit(live.report().watch)
            until = monotonic() + 60
            while not live.said and monotonic() < until:
                sleep(0.01)
            if whole:
                live.store_all()
        with pytest.raises(StoreError, match=r"not up to date\. ValueError: no page"):
            watching.result(60)
    assert len(live.said) == 1


@pytest.mark.parametrize("locks", [True, False])
def test_a_run_that_has_not_begun_is_waited_for_and_watching_ends(live, monkeypatch, locks):
    if not locks:  # where they cannot be read only the end is known
        monkeypatch.setattr(module, "in_use", lambda _: None)
    report = live.report()
    report.refresh()
    assert ("No process is at work now." in live.banner[0], report.over) == (locks, False)
    live.store_all()
    live.report().watch()
    assert live.page == page_of(StudyResults(live.finished))


def test_whoever_looks_whether_a_run_is_at_work_keeps_none_from_beginning(live):
    with ThreadPoolExecutor(1) as other:
        looking = other.submit(lambda: [sleep(0.002) or in_use(live.folder) for _ in range(300)])
        for _ in range(20):
            with locked(live.folder):
                pass
    assert {*looking.result()} <= {True, False}


def results(total=9, failed=(), learners=(), **seeds):
    """Results as far as the choice of arms reads them: arm -> number of seeds it has finished."""
    kind = {"nodes": ("maze",), "control_of": ""}
    arms = {arm: SimpleNamespace(scratch=arm in learners, **kind) for arm in seeds}
    keys = {(arm, "maze"): arm for arm in seeds}
    record = SimpleNamespace(total=total, seeds=range(100), arms=arms, keys=keys)
    stored = {arm: dict.fromkeys(range(n)) for arm, n in seeds.items()}
    return SimpleNamespace(record=record, stored=stored, failed=dict.fromkeys(failed))


@pytest.mark.parametrize(
    ("study", "arms"),
    [
        (results(scratch=30, a=0, b=0), []),
        (results(scratch=30, a=5, b=0), ["scratch", "a"]),
        (results(scratch=30, a=30, b=5), ["scratch", "a"]),
        (results(scratch=100, a=20, b=20), ["scratch", "a", "b"]),
        (results(scratch=30, a=30, b=30, failed=["a"]), ["scratch", "b"]),
        (results(scratch=30, a=30, failed=["scratch"]), []),
        (results(scratch=30, a=30, learners=["a"]), []),
        (results(scratch=30, a=30, total=None), []),
        (results(a=30, b=30), []),
    ],
)
def test_the_arms_with_most_results_in_common_are_compared(study, arms):
    assert arms_so_far(study) == arms


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
