"""The match of docs/referee.md: its study files, and the maze of the claim."""

from importlib.util import find_spec

import pytest

import curricle as cr
from benchmarks.referee.__main__ import DOMAINS, HERE
from benchmarks.referee.claim import LASTING

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


def test_the_claims_maze_is_the_published_one():
    study = cr.read_study(HERE / "claim.toml")
    rates = [of.values["learner.learning_rate"] for of in study.variants.values()]
    assert (rates, study.threshold) == ([0.5, 0.9, 0.95], LASTING)
    task = next(iter(study.curricula.values())).tasks["maze"]
    assert cr.solve(task).start_value == pytest.approx(18.367886071, abs=1e-8)
