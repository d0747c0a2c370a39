"""Before networks are trained: cost, forecast, controls and what checking needs; without torch."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.comparison.controls import check_fit
from curricle.comparison.cost import costs
from curricle.comparison.forecasting import forecast
from curricle.comparison.task_differences import differences
from curricle.study.arms import Arms, units_of
from tests.support.hunters import observed, transfers
from tests.support.studies import OBSERVED_HUNT


def test_costs_are_foreseen(read):
    study = read(OBSERVED_HUNT, set=["seeds=2"])
    arms = Arms.of(study)
    by_task = {(cost.arm, cost.task): cost for cost in costs(arms, units_of(study, arms, {}))}
    hunt = by_task["scratch", "hunt"]
    assert hunt.steps == 5000
    evaluation_steps = (5000 // 20 + 1) * 5 * 30
    learning = hunt.seconds / 2 - evaluation_steps * hunt.step_seconds
    assert 5000 * 5e-4 < learning < 5000 * 5e-3


@pytest.fixture(scope="module")
def plan():
    chase = cr.Pursuit(3, 1, time_limit=30)
    hunt = observed(2, time_limit=30)
    return cr.Curriculum(
        {"chase": chase, "hunt": hunt},
        transfers(hunt, chase),
        aggregate=cr.minimum,
        learner={"chase": cr.QLearning(learning_rate=0.3), "hunt": cr.deep.DeepLearner()},
        budget={"chase": 20_000, "hunt": 1000},
    )


def test_a_forecast_follows_potentials_through_observations(plan):
    foreseen = forecast(plan, seeds=2)
    assert foreseen.start.random < -20
    assert foreseen.start.potential > -6  # two hunters by what one knows
    assert foreseen["minimum"].used
    for cover in foreseen.coverage.values():
        assert cover.mapped + cover.ended == pytest.approx(1.0)
        assert cover.size > 20
    assert "nan%" not in str(foreseen)
    again = forecast(plan, seeds=2, trained=foreseen.trained)
    assert str(again) == str(foreseen)


def test_a_potential_of_states_has_no_policy(plan):
    class Heights:
        of_actions = False

        def q(self, observations, actions):
            raise AssertionError

        def v(self, observations):
            return -np.abs(observations).sum(axis=1)

    hunt = plan.tasks["hunt"]
    edge = cr.Transfer("near", "hunt", cr.transfer.ObservationMapping(hunt, hunt))
    near = cr.Curriculum({"near": hunt, "hunt": hunt}, [edge], learner=cr.deep.DeepLearner())
    known = plan.train(1, only="chase")["chase"]
    learnt = type(known)(**{**vars(known), "task": hunt, "values": (Heights(),)})
    foreseen = forecast(near, seeds=1, trained={"near": learnt})
    assert foreseen.start is None
    assert foreseen.coverage["near -> hunt"].mapped == 1.0


def test_controls_that_make_no_sense_are_refused(plan):
    check_fit(["negated", "pretraining"], "transfer", plan)
    for control in ("placebo", "random_start"):
        with pytest.raises(cr.errors.CurriculumError, match="is seen through observations"):
            check_fit([control], "transfer", plan)
    with pytest.raises(cr.errors.CurriculumError, match="PolicyReuse"):
        check_fit(["negated"], "transfer", plan.replace("hunt", shaping=cr.deep.PolicyReuse()))


def test_tasks_seen_through_observations_are_told_apart(plan):
    hunt = plan.tasks["hunt"]
    assert differences(hunt, observed(2, time_limit=30)) == ()
    lines = differences(hunt, observed(3, discount=0.9, time_limit=30))
    assert [line.split()[0] for line in lines] == [
        "observations",
        "actions",
        "discount",
        "environment",
    ]
    (line,) = differences(hunt, cr.Pursuit(3, 2))
    assert line.startswith("observations (")


def test_checking_needs_no_torch_and_says_what_does(tmp_path):
    (tmp_path / "study.toml").write_text(OBSERVED_HUNT)
    code = """
        import sys
        class Missing:
            def find_spec(self, name, path=None, target=None):
                if name in ("torch", "stable_baselines3", "sb3_contrib"):
                    raise ModuleNotFoundError(name)
        sys.meta_path.insert(0, Missing())
        from curricle.cli.app import main
        for command in "check", "run":
            sys.argv = ["curricle", command, "study.toml"]
            try:
                main()
            except SystemExit as ended:
                print(ended.code)
    """

    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    command, env = [sys.executable, "-c", textwrap.dedent(code)], os.environ | {"PYTHONPATH": path}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=env)
    said = " ".join(done.stdout.split())
    assert 'Stable-Baselines3 is not installed: pip install "curricle[deep]"' in said
    assert "hunt: MultiDiscrete([9 9 9]) -> Discrete(25); DQN; 5,000 steps" in said
    assert "Forecast for 'hunt': whether it pays is open no trial: 'hunt' is seen through" in said
    assert said.endswith("1"), done.stderr
    assert done.stderr.endswith('pip install "curricle[deep]"\n')
    assert not (tmp_path / "study-results").exists()


def test_mappings_and_values_of_observations_that_make_no_sense_are_refused(plan):
    near, car = plan.tasks["hunt"], cr.observation_task("MountainCarContinuous-v0")
    mapping = cr.transfer.ObservationMapping(
        near, cr.GridWorld("S.T"), lambda rows: np.array([1.0, 0.5])[: len(rows)], [0] * 25
    )
    for call, says in (
        (lambda: mapping.coverage(np.zeros((2, *near.observations.shape))), r"numbers: got 0\.5"),
        (
            lambda: cr.transfer.ObservationMapping(car, car, actions=[0]),
            "needs a target with numbered actions: got",
        ),
        (lambda: cr.transfer.FunctionValues(lambda rows, actions: actions), "without actions"),
    ):
        with pytest.raises(cr.CurricleError, match=says):
            call()
