"""Sweeps and tunings in study files: the arms they make, and a sentence for every mistake."""

import pytest

from curricle import QLearning
from curricle.study import StudyConfig
from curricle.study.arms import Arms
from tests.support.studies import CORNER

MAZES = CORNER.replace('name = "maze"', 'name = "mazes"\nseeds = 2\nlearner.epsilon = 0.2')
MAZES = MAZES.replace("[tasks.maze]", "[tasks.maze]\nbudget = 1_000")
MAZES = MAZES.replace("[tasks.corner]", "[tasks.corner]\nbudget = 200")
RATES = "sweep.learner.learning_rate=[0.1, 0.3]"


def of_each(curricula, which, task="maze"):
    """Return a setting of each curriculum, by its name."""
    return {name: curriculum.setting(which, task) for name, curriculum in curricula.items()}


def rates(curricula):
    return {name: made.learning_rate for name, made in of_each(curricula, "learner").items()}


@pytest.mark.parametrize("key", ["learner.learning_rate", '"learner.learning_rate"'])
def test_each_value_makes_an_arm_of_every_arm_and_of_scratch(read, key):
    arms = f"[arms.plain]\n[arms.state]\nshaping = 'StateShaping'\n[sweep]\n{key} = [0.1, 0.3]"
    study = read(f"{MAZES}\n{arms}")
    assert rates(study.curricula) == {
        "plain, learning_rate=0.1": 0.1,
        "plain, learning_rate=0.3": 0.3,
        "state, learning_rate=0.1": 0.1,
        "state, learning_rate=0.3": 0.3,
    }
    assert rates(study.scratch_curricula()) == {"scratch": 0.1, "scratch, learning_rate=0.3": 0.3}
    of_corner = of_each(study.curricula, "learner", "corner")
    assert of_corner["state, learning_rate=0.3"] == QLearning(0.3, 0.2)


def test_a_setting_that_does_not_touch_scratch_leaves_one_scratch(read):
    study = read(MAZES, set=["sweep.tasks.corner.budget=[100, 200]"])
    assert list(study.scratch_curricula()) == ["scratch"]
    budgets = of_each(study.curricula, "budget", "corner")
    assert list(budgets) == ["transfer, corner.budget=100", "transfer, corner.budget=200"]
    assert [budget.max_steps for budget in budgets.values()] == [100, 200]


def test_what_arms_share_is_trained_once(read):
    arms = Arms.of(read(MAZES, set=[RATES, "sweep.unknown_value=[0.0, 1.0]"]))
    assert len(arms.curricula) == 2 + 4
    sources = {key for (_, task), key in arms.keys.items() if task == "corner"}
    assert len(sources) == 2  # a learning rate each
    scratch = Arms.of(read(MAZES, set=["learner.learning_rate=0.3"])).keys["scratch", "maze"]
    assert arms.keys["scratch, learning_rate=0.3", "maze"] == scratch


def test_a_grid_has_every_combination_and_pairs_do_not(read):
    both = [RATES, "sweep.learner.initial_value=[0.0, 5.0]"]
    assert len(read(MAZES, set=both).arms) == 4
    assert list(read(MAZES, set=[*both, "sweep.mode=paired"]).arms) == [
        "transfer, learning_rate=0.1, initial_value=0.0",
        "transfer, learning_rate=0.3, initial_value=5.0",
    ]


def test_an_arm_that_sets_the_key_itself_is_there_once(read):
    text = f"{MAZES}[arms.swept]\n[arms.own]\nlearner.learning_rate = 0.3\n"
    study = read(text, set=[RATES])
    assert list(study.arms) == ["swept, learning_rate=0.1", "swept, learning_rate=0.3", "own"]
    assert len(Arms.of(study).curricula) == 5


def test_tables_and_transfers_are_swept_by_number(read):
    study = read(MAZES, set=["sweep.transfers.0.scale=[1.0, 2.0]"])
    scales = [curriculum.transfers[0].scale for curriculum in study.curricula.values()]
    assert scales == [1.0, 2.0]
    assert list(study.arms)[1] == "transfer, transfers.0.scale=2.0"
    kinds = read(MAZES, set=["sweep.learner=[{ type = 'SARSA' }, { type = 'QLearning' }]"])
    learners = of_each(kinds.curricula, "learner").values()
    assert [type(learner).__name__ for learner in learners] == ["SARSA", "QLearning"]
    assert next(iter(kinds.arms)) == "transfer, learner={type=SARSA}"


def test_further_learners_from_scratch_are_swept_too(read):
    text = f"{MAZES}\n[scratch_learners.optimistic]\ninitial_value = 50.0\n"
    assert rates(read(text, set=[RATES]).scratch_curricula()) == {
        "scratch": 0.1,
        "scratch, learning_rate=0.3": 0.3,
        "scratch, optimistic": 0.1,
        "scratch, optimistic, learning_rate=0.3": 0.3,
    }


def test_a_swept_study_is_plain_data(read):
    study = read(MAZES, set=[RATES, "tune.space.learner.epsilon={ low = 0.1, high = 0.3 }"])
    again = StudyConfig.from_data(study.to_data(), study.folder)
    assert again == study
    assert again.variants["transfer, learning_rate=0.3"].values == {"learner.learning_rate": 0.3}
