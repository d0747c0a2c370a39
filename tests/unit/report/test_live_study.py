"""What a live page shows of a folder while units are stored, and that it never stops a run."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from time import sleep
from types import SimpleNamespace

import pytest

from curricle.errors import StoreError
from curricle.report import live_study
from curricle.report.live_study import LiveStudy, arms_so_far
from curricle.report.study_report import stored_page
from curricle.study.folders import in_use, locked
from curricle.study.results import StudyResults

SEEDS = 4


def words(stored, units):
    return f"{stored} of {units}"


@pytest.fixture
def live(finished, tmp_path):
    """A function: keys of tasks -> nothing; they are stored now. And the study that follows."""
    folder = tmp_path / "live"
    shutil.copytree(finished, folder, ignore=shutil.ignore_patterns("units", "*.parquet", "ana*"))
    keys = StudyResults(finished).record.keys

    def store(*places):
        for place in places:
            (unit,) = (finished / "units").glob(f"*-{keys[place]}")
            shutil.copytree(unit, folder / "units" / unit.name)

    return LiveStudy(folder, words), store


@pytest.fixture
def at_once(monkeypatch):
    """The report is made whenever something is new."""
    monkeypatch.setattr(live_study, "SHARE", 1e9)


@pytest.mark.usefixtures("at_once")
def test_progress_and_report_follow_the_folder(live, finished):
    study, store = live
    study.refresh()
    assert [(one.name, one.stored, one.seeds, one.curve) for one in study.rows] == [
        (name, 0, SEEDS, None)
        for name in (
            "scratch: maze",
            "chain, state: corner",
            "chain: easy",
            "chain: maze",
            "state: easy",
            "state: maze",
            "calibrated: easy",
            "calibrated: maze",
        )
    ]
    assert study.page == ""
    store(("scratch", "maze"))
    study.refresh()
    assert study.state()["line"] == "2 of 16"
    assert (study.rows[0].stored, study.rows[0].curve is not None) == (SEEDS, True)
    assert study.page == ""
    assert study.state()["note"].startswith("The report begins when")
    store(("chain", "corner"), ("chain", "easy"), ("chain", "maze"))
    study.refresh()
    assert study.state()["note"] == (
        "The report so far is of scratch, chain; to come: state, calibrated."
    )
    assert ">chain<" in study.page.replace("> ", ">").replace(" <", "<")
    first = study.page
    store(*((arm, task) for arm in ("state", "calibrated") for task in ("easy", "maze")))
    shutil.copy(finished / "analysis.json", study.folder)
    study.refresh()
    assert study.state()["note"] == "The report is of all arms."
    assert study.page == stored_page(StudyResults(finished)) != first
    assert [one.stored for one in study.rows] == [SEEDS] * len(study.rows)


def test_the_report_is_made_when_something_is_new_and_its_share_allows_it(live, monkeypatch):
    study, store = live
    made = []
    monkeypatch.setattr(live_study, "stored_page", lambda found: made.append(found) or "page")
    store(("scratch", "maze"), ("chain", "corner"), ("chain", "easy"), ("chain", "maze"))
    study.refresh()
    study.refresh()
    assert len(made) == 1
    now = study._next - 1
    monkeypatch.setattr(live_study, "monotonic", lambda: now)
    store(("state", "maze"))
    study.refresh()
    assert len(made) == 1
    assert study.state()["note"].endswith(
        "It was made when 8 of the 10 units that are stored were there."
    )
    now += 2
    study.refresh()
    assert len(made) == 2
    store(("calibrated", "easy"))
    now -= 2
    study.refresh(last=True)
    assert len(made) == 3


@pytest.mark.usefixtures("at_once")
def test_an_error_is_a_sentence_and_what_was_shown_stays(live, monkeypatch):
    study, store = live
    store(("scratch", "maze"), ("chain", "corner"), ("chain", "easy"), ("chain", "maze"))
    study.refresh()
    page = study.page
    store(("state", "easy"), ("state", "maze"))
    with monkeypatch.context() as broken:
        broken.setattr(live_study, "stored_page", lambda _: {}["a\nkey"])
        study.refresh()
    assert study.state()["trouble"] == r"The report is not up to date. KeyError: 'a\nkey'"
    assert study.page == page
    study.refresh()
    assert study.state()["trouble"] == ""
    assert study.page != page


@pytest.mark.usefixtures("at_once")
def test_a_file_that_is_merged_while_it_is_read_is_no_error(live, monkeypatch):
    study, store = live
    store(("scratch", "maze"), ("chain", "corner"), ("chain", "easy"), ("chain", "maze"))
    tries = []

    def merged_once(found):
        tries.append(found)
        if len(tries) == 1:
            raise StoreError("units/maze/seeds-0.npz cannot be read: No such file or directory")
        return stored_page(found)

    monkeypatch.setattr(live_study, "stored_page", merged_once)
    study.refresh()
    assert study.state()["trouble"] == ""
    assert "</html>" in study.page


def watched(folder):
    """What a page that follows a run elsewhere says of it."""
    study = LiveStudy(folder, words, elsewhere=True)
    study.refresh()
    return study.state()


@pytest.mark.usefixtures("at_once")
def test_a_run_elsewhere_that_no_process_is_at_is_said_to_be_none(live, finished):
    study, store = live
    store(("scratch", "maze"))
    stopped = watched(study.folder)
    assert stopped["standing"].startswith("No process is running it, ")
    assert "2 of 16 units are stored" in stopped["standing"]
    assert stopped["line"] == "2 of 16 units"  # no rate, and no time left
    with locked(study.folder):
        running = watched(study.folder)
        assert (running["standing"], running["line"]) == ("", "2 of 16")
        with pytest.raises(StoreError, match="another is at work"), locked(study.folder):
            pass
    assert watched(finished)["standing"] == "The study is finished: 16 of 16 units are stored."


def test_whoever_looks_whether_a_run_is_at_work_keeps_none_from_beginning(live):
    study, _ = live
    with ThreadPoolExecutor(1) as other:
        looking = other.submit(lambda: [sleep(0.002) or in_use(study.folder) for _ in range(300)])
        for _ in range(20):
            with locked(study.folder):
                pass
    assert {*looking.result()} <= {True, False}


def test_where_locks_cannot_be_read_only_the_end_is_known(live, finished, monkeypatch):
    monkeypatch.setattr(live_study, "in_use", lambda _: None)
    assert watched(live[0].folder)["standing"] == ""
    assert watched(finished)["standing"].startswith("The study is finished")


def test_a_folder_that_is_not_there_yet_is_waited_for(tmp_path):
    study = LiveStudy(tmp_path / "later", words)
    study.refresh()
    assert (study.state()["trouble"], study.rows, study.page) == ("", (), "")


@pytest.mark.usefixtures("at_once")
def test_a_study_without_scratch_has_progress_and_no_report(live):
    study, store = live
    (study.folder / "failures.json").write_text(
        f'[{{"key": "{StudyResults(study.folder).record.keys["scratch", "maze"]}", '
        '"seeds": [0], "error": "lost"}]'
    )
    store(("chain", "corner"))
    study.refresh()
    assert study.state()["note"].startswith("There is no report: ")
    assert study.rows[1].stored == SEEDS


def results(total=9, failed=(), learners=(), **seeds):
    """Results as far as the choice of arms reads them: arm -> number of seeds it has finished."""
    arms = {arm: SimpleNamespace(nodes=("maze",), scratch=arm in learners) for arm in seeds}
    return SimpleNamespace(
        record=SimpleNamespace(
            total=total,
            seeds=range(100),
            arms=arms,
            keys={(arm, "maze"): arm for arm in seeds},
        ),
        stored={arm: dict.fromkeys(range(n)) for arm, n in seeds.items()},
        failed=dict.fromkeys(failed),
    )


@pytest.mark.parametrize(
    ("study", "arms"),
    [
        (results(scratch=30, a=0, b=0), []),
        (results(scratch=0, a=30, b=30), []),
        (results(scratch=30, a=5, b=0), ["scratch", "a"]),
        (results(scratch=30, a=30, b=5), ["scratch", "a"]),
        (results(scratch=30, a=30, b=20), ["scratch", "a", "b"]),
        (results(scratch=100, a=20, b=20), ["scratch", "a", "b"]),
        (results(scratch=30, b=10, a=30), ["scratch", "a"]),
        (results(scratch=30, a=30, b=30, failed=["a"]), ["scratch", "b"]),
        (results(scratch=30, a=30, failed=["scratch"]), []),
        (results(scratch=30, a=30, learners=["a"]), []),
        (results(scratch=30, a=30, total=None), []),
        (results(a=30, b=30), []),
    ],
)
def test_the_arms_with_most_results_in_common_are_compared(study, arms):
    assert arms_so_far(study) == arms
