"""The page on Acrobot: its files make its study, here without the placebo and for few steps."""

from pathlib import Path

import pytest

from curricle.deep import WeightTransfer
from curricle.study import StudyResults, read_study, run_study
from tests.pages import File, put, steps

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "acrobot.md"
SMALL = [
    *("seeds=1", "tasks.acrobot.evaluation.episodes=2"),
    *("tasks.acrobot.budget=1_024", "tasks.acrobot.eval_freq=1_024"),
]


@pytest.fixture
def study(tmp_path):
    for step in steps(PAGE.read_text("utf-8")):
        if isinstance(step, File):
            put(step, tmp_path)
    file = tmp_path / "acrobot.toml"
    text, placebo, _ = file.read_text("utf-8").partition("[arms.placebo]")
    assert placebo
    file.write_text(text, "utf-8")
    return read_study(file, set=SMALL)


def test_the_page_makes_its_study(study):
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
