"""The example of Acrobot makes its study, here without the placebo and for few steps."""

from pathlib import Path

import pytest

from curricle.deep import WeightTransfer
from curricle.study import StudyResults, read_study, run_study

FILE = Path(__file__).parents[2] / "examples" / "acrobot" / "acrobot.toml"
SMALL = [
    *("seeds=1", "tasks.acrobot.evaluation.episodes=2"),
    *("tasks.acrobot.budget=1_024", "tasks.acrobot.eval_freq=1_024"),
]


@pytest.fixture
def study():
    return read_study(FILE, set=SMALL, arms=["distilled"])


def test_the_example_makes_its_study(study):
    plan = study.curriculum("distilled")
    assert plan.tasks["grid"].actions == plan.tasks["acrobot"].actions
    assert plan.node("acrobot").shaping == WeightTransfer(kl=0.1)


@pytest.mark.slow
def test_learning_starts_near_what_is_right(study, tmp_path):
    run_study(study, tmp_path / "results")
    results = StudyResults(tmp_path / "results")
    scratch, distilled = (
        results.result(arm, "acrobot").greedy_return[0, 0] for arm in ("scratch", "distilled")
    )
    assert scratch < -200 < -150 < distilled
