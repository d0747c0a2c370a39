"""Trackers as one: failures switch a tracker off, and never stop the study."""

import json
import sys
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from curricle.errors import SettingError
from curricle.interop.trackers import Trackers, hyperparameters


def started(trackers, folder="results", report=None):
    opened = Trackers(trackers, report)
    opened.start("hunting", {}, folder)
    return opened


class Diary:
    """A tracker that notes its calls, and raises at one of them."""

    def __init__(self, raises_at="", error=None):
        self.calls = []
        self._raises_at, self._error = raises_at, error or OSError("no space\nleft")

    def _note(self, what):
        self.calls.append(what)
        if what == self._raises_at:
            raise self._error

    def start(self, study, configuration, folder):
        self._note("start")

    def record(self, arm, node, result):
        self._note(f"{arm}/{node}")

    def close(self):
        self._note("close")


ALL = ["start", "scratch/hunt", "mean/hunt", "close"]
PLACES = {
    "start": "at the start of the study",
    "scratch/hunt": "at arm 'scratch', task 'hunt'",
    "close": "at the end of the study",
}


@pytest.mark.parametrize("place", PLACES)
def test_a_failing_tracker_is_reported_and_off_and_stops_nobody(place):
    broken, well, reported = Diary(place), Diary(), []
    trackers = started([broken, well], report=reported.append)
    trackers.record("scratch", "hunt", None)
    trackers.record("mean", "hunt", None)
    trackers.close()
    assert broken.calls == ALL[: ALL.index(place) + 1]
    assert well.calls == ALL
    assert reported == [f"Diary failed {PLACES[place]} and is switched off: OSError: no space left"]


def test_each_of_two_failures_is_reported():
    reported = []
    trackers = started([Diary("start"), Diary("close", ValueError("x"))], report=reported.append)
    trackers.record("scratch", "hunt", None)
    trackers.close()
    assert [failure.split(": ")[1] for failure in reported] == ["OSError", "ValueError"]


def test_a_failure_is_printed_to_stderr_by_default(capsys):
    started([Diary("start")])
    assert capsys.readouterr().err.startswith("Diary failed at the start of the study and is")


@pytest.mark.parametrize("place", PLACES)
def test_an_interruption_passes(place):
    trackers = Trackers([Diary(place, KeyboardInterrupt())], report=pytest.fail)

    def study():
        trackers.start("hunting", {}, Path("results"))
        trackers.record("scratch", "hunt", None)
        trackers.close()

    with pytest.raises(KeyboardInterrupt):
        study()


def test_logs_that_stay_empty_are_reported(tmp_path):
    reported = []
    trackers = started(["tensorboard", Diary()], tmp_path, reported.append)
    trackers.close()
    assert reported == [
        "TensorBoard, Diary: nothing was logged, as this run finished no unit of work"
    ]


def test_no_trackers_do_nothing(tmp_path, capsys):
    trackers = started([], tmp_path)
    trackers.record("scratch", "hunt", None)
    trackers.close()
    assert not list(tmp_path.iterdir())
    assert capsys.readouterr() == ("", "")


def test_an_unknown_tracker_is_refused_with_the_valid_names():
    for unknown in ("tensorbord", "wandb", "", 3, None, object()):
        with pytest.raises(SettingError, match="a tracker must be one of tensorboard: got"):
            Trackers([unknown])


def test_a_tool_that_is_not_installed_is_named_with_its_cure(monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(SettingError, match=r'pip install "curricle\[tensorboard\]"$'):
        Trackers(["tensorboard"])


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@given(st.dictionaries(st.text(alphabet="abc", min_size=1), JSON, max_size=4))
def test_hyperparameters_are_single_values_that_hold_every_setting(configuration):
    flat = hyperparameters(configuration)
    assert all(isinstance(value, bool | int | float | str) for value in flat.values())

    def leaves(nested, prefix=""):
        for name, value in nested.items():
            if isinstance(value, dict) and value:
                yield from leaves(value, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", value

    for name, value in dict(leaves(configuration)).items():
        single = isinstance(value, bool | int | float | str)
        assert (flat[name] if single else json.loads(flat[name])) == value
