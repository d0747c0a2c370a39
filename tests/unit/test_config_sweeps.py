"""Sweeps and tunings in study files: the arms they make, and a sentence for every mistake."""

import pytest

from curricle import QLearning
from curricle.study import StudyConfig
from curricle.study.arms import Arms
from tests.studies import CORNER, NUMBERED_HUNT

MAZES = CORNER.replace('name = "maze"', 'name = "mazes"\nseeds = 2\nlearner.epsilon = 0.2')
MAZES = MAZES.replace("[tasks.maze]", "[tasks.maze]\nbudget = 1_000")
MAZES = MAZES.replace("[tasks.corner]", "[tasks.corner]\nbudget = 200")
RATES = "sweep.learner.learning_rate=[0.1, 0.3]"


def rates(curricula, task="maze"):
    return {name: one.setting("learner", task).learning_rate for name, one in curricula.items()}


# -- arms --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "written",
    [
        "[sweep]\nlearner.learning_rate = [0.1, 0.3]",
        '[sweep]\n"learner.learning_rate" = [0.1, 0.3]',
    ],
)
def test_each_value_makes_an_arm_of_every_arm_and_of_scratch(read, written):
    study = read(f"{MAZES}\n[arms.plain]\n[arms.state]\nshaping = 'StateShaping'\n{written}")
    assert rates(study.curricula) == {
        "plain, learning_rate=0.1": 0.1,
        "plain, learning_rate=0.3": 0.3,
        "state, learning_rate=0.1": 0.1,
        "state, learning_rate=0.3": 0.3,
    }
    assert rates(study.scratch_curricula()) == {"scratch": 0.1, "scratch, learning_rate=0.3": 0.3}
    assert study.curricula["state, learning_rate=0.3"].setting("learner", "corner") == QLearning(
        0.3, 0.2
    )


def test_a_setting_that_does_not_touch_scratch_leaves_one_scratch(read):
    study = read(MAZES, set=["sweep.tasks.corner.budget=[100, 200]"])
    assert list(study.scratch_curricula()) == ["scratch"]
    budgets = {name: one.setting("budget", "corner") for name, one in study.curricula.items()}
    assert list(budgets) == ["transfer, corner.budget=100", "transfer, corner.budget=200"]
    assert [one.max_steps for one in budgets.values()] == [100, 200]


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
    scales = [one.transfers[0].scale for one in study.curricula.values()]
    assert scales == [1.0, 2.0]
    assert list(study.arms)[1] == "transfer, transfers.0.scale=2.0"
    kinds = read(MAZES, set=["sweep.learner=[{ type = 'SARSA' }, { type = 'QLearning' }]"])
    found = [type(one.setting("learner", "maze")).__name__ for one in kinds.curricula.values()]
    assert found == ["SARSA", "QLearning"]
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


def test_a_study_without_them_is_as_it_was(read):
    assert not {"scratches", "variants", "tune", "total"} & read(MAZES).to_data().keys()


# -- mistakes ----------------------------------------------------------------------------------

SPACE = """
[tune.space]
learner.epsilon = { low = 0.1, high = 0.3 }
"""
NEW_SPACES = ("tune.space", "tune.space.learner.epsilon", "tune.space.learner.epslon")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ("sweep={}", "sweep must name a setting to sweep: got none"),
        ("sweep.tasks.corner.rows=[[0, 9]]", "sweep.tasks.corner.rows is refused: a crop must lie"),
        ("sweep.learner.epsilon=[1, 1]", "must be a list of different values: 1 is there twice"),
        ("sweep.learner.epsilon=[3.0]", "sweep.learner.epsilon is refused: epsilon must"),
        ("sweep.learner=[{ epslon = 1 }, {}]", "sweep.learner[0].epslon is unknown, did you mean"),
        ("sweep.budget=[1, 2]", "changes nothing: each task or arm that it could apply to sets it"),
        ("sweep.tasks.maze.budget=[1, 2]", "must leave the target maze as it is"),
        ("sweep.tasks=[1]", "a key of one of the tasks, such as tasks.maze.budget"),
        ("sweep.transfers.1.scale=[1]", "must name a key of one of the transfers: 1 is unknown"),
        ("sweep.seeds=[1, 2]", "must name a setting of tasks or transfers: seeds is unknown"),
        (f"sweep.unknown_value={[*range(101)]}", "must make at most 100 arms: got 101 values"),
        ("tune.trials=0", "tune.trials must be at least 1: got 0"),
        ("tune.seeds=0", "tune.seeds must be a number of seeds, a list of different ones"),
        ("tune.space={}", "tune.space must name a setting to tune: got none"),
        ("tune.space.learner.epsilon=1", "must be a list of two or more different values, or {"),
        ("tune.space.learner.epsilon={ low = 1 }", "tune.space.learner.epsilon.high is missing"),
        ("tune.space.learner.epsilon.low=1", "epsilon.high must be above low, 1: got 0.3"),
        ("tune.space.tasks.corner.budget={ low = 10.0, high = 90.0 }", "must be a whole number: "),
        ("scratch=false", "tune needs learning from scratch, which is tuned as every arm"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(complaints, changes, words):
    whole = changes.startswith("sweep") or changes.partition("=")[0] in ("tune", *NEW_SPACES)
    (line,) = complaints(MAZES + SPACE * (not whole), set=[changes])
    assert "as set: " in line or "line " in line
    assert words in line


def test_a_mistake_has_the_line_of_the_file(complaints):
    lines = f'{NUMBERED_HUNT}\n[sweep]\n"learner.learning_rate" = ["fast"]\n'
    number = lines.splitlines().index('"learner.learning_rate" = ["fast"]') + 1
    assert complaints(lines) == [
        f"line {number}: sweep.\"learner.learning_rate\" must be a number: got 'fast'"
    ]


def test_lists_that_are_paired_are_as_long_as_each_other(complaints):
    given = [RATES, "sweep.unknown_value=[0.0]", "sweep.mode=paired"]
    (line,) = complaints(MAZES, set=given)
    assert "sweep.unknown_value must have as many values as sweep.learner.learning_rate" in line
    assert line.endswith("got 1 and 2")


def test_what_is_swept_is_not_tuned(complaints):
    (line,) = complaints(MAZES, set=[RATES, "tune.space.learner.learning_rate=[0.1, 0.2]"])
    assert line.endswith("is swept already: leave out one of the two")


def test_a_name_that_is_too_long_is_refused(complaints):
    long = "a" * 120
    (line,) = complaints(MAZES, set=[f"sweep.aggregate=['own:{long}', 'mean']"])
    assert "sweep makes an arm with a name that" in line
