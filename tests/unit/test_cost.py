"""The estimate of what a study costs."""

import pytest

from curricle import Pursuit
from curricle.comparison import cost
from curricle.study import read_study
from curricle.study.arms import Arms, units_of

PACE = 1e-6


def costs(study):
    """Return what each task of a study costs."""
    arms = Arms.of(study)
    return cost.costs(arms, units_of(study, arms, {}))


@pytest.fixture
def estimates(study_file, monkeypatch):
    """The estimates for two seeds; a random step of any task takes a microsecond."""
    monkeypatch.setattr(cost, "random_pace", lambda task: PACE)
    study = read_study(study_file, set=["seeds=2"])
    return {(row.arm, row.task): row for row in costs(study)}


def test_a_learning_step_takes_a_few_random_ones(estimates):
    maze = estimates["scratch", "maze"]
    assert PACE <= maze.seconds / (maze.seeds * maze.steps) <= 10 * PACE


def test_exact_evaluations_are_counted(study_file, monkeypatch):
    monkeypatch.setattr(cost, "random_pace", lambda task: PACE)
    rare, often = (
        costs(study)[0].seconds
        for study in (read_study(study_file, set=[f"eval_freq={n}"]) for n in (100, 1))
    )
    assert often > 1.5 * rare  # in rare ones, learning takes most of the time


DISTILLED = """
name = "carts"
learner = { type = "deep", algorithm = "PPO" }
transfers = [{ source = "small", target = "large", mapping = "identity" }]
[tasks]
small = { type = "distilled", members = ["FrozenLake-v1"] }
large = { type = "observation_task", id = "FrozenLake-v1", shaping = "PolicyReuse" }
"""


def test_a_distillation_takes_seconds_and_the_steps_of_its_models(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "random_pace", lambda task: PACE)
    file = tmp_path / "carts.toml"
    file.write_text(DISTILLED)
    study = read_study(file)
    (row,) = (row for row in costs(study) if row.task == "small")
    assert row.steps == 44  # four actions in each of the lake's eleven squares
    assert row.seconds == pytest.approx(len(study.seeds) * (cost.DISTILLING + 44 * PACE))


def test_tables_too_large_to_be_solved_are_not_built(monkeypatch):
    class Untabulated(Pursuit):
        mdp = property(lambda self: pytest.fail("its tables were built"))

    monkeypatch.setattr(cost, "LARGEST_SOLVED", 1000)
    large = cost.solving_seconds(Untabulated(100, 1))
    assert large == pytest.approx(100**4 * 5 * cost.MOST_SWEEPS * cost.OUTCOME)
    small = Pursuit(3, 1)
    sweeps = small.mdp.probability.size * small.states.size
    assert cost.solving_seconds(small) == pytest.approx(sweeps * cost.OUTCOME)
