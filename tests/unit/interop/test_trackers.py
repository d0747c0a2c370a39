"""Trackers: failures never stop a study, and every checkpoint has its values by tag."""

from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from curricle.interop.trackers import Trackers, checkpoints


def started(trackers, folder="results", report=None):
    opened = Trackers(trackers, report)
    opened.start("hunting", {}, folder)
    return opened


class Diary:
    """A tracker that notes its calls, and raises at one of them."""

    def __init__(self, raises_at="", error=None):
        self.calls = []
        self._raises_at, self._error = raises_at, error or OSError("no space\nleft")

    def _note(self, call):
        self.calls.append(call)
        if call == self._raises_at:
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
    (told,) = reported
    off = f"Diary failed {PLACES[place]} and is switched off: OSError: no space left"
    assert told.startswith(f"{off} (raised in _note of test_trackers.py, line ")


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
    trackers = started([Diary()], tmp_path, reported.append)
    trackers.close()
    assert reported == ["Diary: nothing was logged, as this run finished no unit of work"]


@pytest.mark.parametrize("other", ["tensorboard", 3, None, object()])
def test_what_is_no_tracker_is_refused(other):
    with pytest.raises(SettingError, match="a tracker must have start, record and close: got"):
        Trackers([other])


def test_checkpoints_are_those_of_the_seed_that_have_a_value():
    result = cr.learn(cr.GridWorld("S.T"), budget=500, eval_freq=100, seeds=2)
    shown = dict(checkpoints(result, 1))
    assert [*shown] == [0, 100, 200, 300, 400, 500]
    for t, values in enumerate(shown.values()):
        assert values["eval/mean_reward"] == result.greedy_return[1, t]
        assert values["time/episodes"] == result.episodes[1, t]
        training = result.training_return[1, t]
        assert np.array_equal(values.get("rollout/ep_rew_mean", np.nan), training, equal_nan=True)
