"""The match of docs/referee.md: its study files, how arms are tuned elsewhere, and the claim."""

from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

import curricle as cr
from benchmarks.referee.__main__ import DOMAINS, HERE, interval
from benchmarks.referee.claim import LASTING
from curricle.statistics.curves import SCRATCH
from curricle.study.tuning import tuned_study

PLAYED_HERE = [name for name in DOMAINS if name != "DoorKey" or find_spec("minigrid")]


SLOW = {"DoorKey": pytest.mark.slow}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=SLOW.get(name, ())) for name in PLAYED_HERE]
)
def test_a_domains_targets_have_the_same_trials(name):
    file, development, judged = DOMAINS[name]
    studies = [case.study(file) for case in (development[0], *judged[:3])]
    trials = [study.trials for study in studies]
    assert all(study.curricula for study in studies)
    assert len({tuple(of.variants) for of in trials}) == 1
    # Source steps are tuned as a share of the target's.
    for label, variant in trials[0].variants.items():
        if "budget.max_steps" in variant.values:
            shares = [
                of.variants[label].values["budget.max_steps"] / case.budget
                for case, of in zip((development[0], *judged[:3]), trials, strict=True)
            ]
            assert max(shares) - min(shares) < 1e-3


def keys(case):
    file, development, judged = DOMAINS["key-lock-pit"]
    return (development[0] if case == "development" else judged[0]).study(file)


def trials_won_by(study, wins):
    """Return trials in which these win, of arms that the others lose."""
    variants = study.trials.variants
    returns = {label: np.array([float(label in wins)]) for label in variants}
    return SimpleNamespace(
        comparison=SimpleNamespace(returns=returns),
        record=SimpleNamespace(seeds=(1_000_000,), total=1),
    )


def test_the_best_trial_of_development_is_played_on_the_judged_target():
    wins = {f"{arm}, trial {n}" for arm, n in (("scratch", 3), ("half size", 5))}
    small, large = keys("development"), keys("judged")
    study = tuned_study(large, trials_won_by(small, wins))
    there, here = small.trials.variants, large.trials.variants
    tuned = study.tuned.arms
    assert tuned[SCRATCH].values == there["scratch, trial 3"].values
    assert tuned["half size"].values == here["half size, trial 5"].values
    assert tuned["half size"].trials == tuned[SCRATCH].trials == 60
    curriculum = study.curricula["half size"]
    assert curriculum.tasks["target"] == cr.tasks.KeyLockPit.room(8)
    learner = curriculum.setting("learner", "target")
    assert learner.learning_rate == here["half size, trial 5"].values["learner.learning_rate"]


def test_intervals_are_over_targets_where_they_are_many():
    few, many = [np.array([0.0, 2.0])] * 2, [np.full(3, float(n)) for n in range(10)]
    assert interval(few).startswith("+1.00 [-11.7")  # over two seeds: 1 +- 12.7 x 1
    assert interval([np.zeros(3)]) == "+0.00"
    assert interval(many).startswith("+4.50 [+2.3")  # over ten targets: 4.5 +- 2.26 x .957


def test_the_claims_maze_is_the_published_one():
    study = cr.read_study(HERE / "claim.toml")
    rates = [of.values["learner.learning_rate"] for of in study.variants.values()]
    assert (rates, study.threshold) == ([0.5, 0.9, 0.95], LASTING)
    task = next(iter(study.curricula.values())).tasks["maze"]
    assert cr.solve(task).start_value == pytest.approx(18.367886071, abs=1e-8)
