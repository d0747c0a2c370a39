"""The policy of a table: what it does in a state, in Gymnasium, live, and in episodes."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError
from curricle.learning import SparseValues, TabularPolicy
from curricle.planning.target import Target
from tests.support.refusals import check_values
from tests.support.tasks import random_mdp

MAZE = cr.GridWorld(["..T", "S#."], time_limit=20)
HUNT = cr.Pursuit(3, 2)


@pytest.fixture(scope="module")
def learnt():
    return cr.learn(MAZE, budget=3000, seeds=3)


def test_it_takes_the_best_action_and_the_first_of_equals():
    values = np.zeros((5, 4))
    values[1, [1, 3]] = 2.0
    values[2, 3] = 0.5
    policy = TabularPolicy(MAZE, values)
    assert [policy.predict(state) for state in range(3)] == [0, 1, 3]
    assert isinstance(policy.predict(np.int64(2)), int)


def test_it_acts_in_the_gymnasium_form_of_its_task(learnt):
    for form in ("index", "components"):
        environment = cr.to_gymnasium(MAZE, observation=form)
        seen, about = environment.reset(seed=0)
        done, path = False, [about["label"]]
        while not done:
            seen, _, terminated, truncated, about = environment.step(learnt.policy.predict(seen))
            done = terminated or truncated
            path.append(about["label"])
        assert terminated
        assert path[0] == "row=1 column=0"
        assert path[1:] == ["row=0 column=0", "row=0 column=1", "row=0 column=2"]


def test_components_are_offsets_from_their_lowest_value():
    far = MAZE.crop(rows=(0, 2), columns=(1, 3))
    values = np.zeros((far.states.size, 4))
    state = int(far.states.encode(row=1, column=2))
    values[state, 2] = 1.0
    policy = TabularPolicy(far, values)
    environment = cr.to_gymnasium(far, observation="components")
    seen, _ = environment.reset(options={"state": {"row": 1, "column": 2}})
    assert policy.predict(seen) == policy.predict(state) == 2


def test_the_policy_is_that_of_the_best_last_return(learnt):
    assert len(learnt.policies) == 3
    best = int(learnt.greedy_return[:, -1].argmax())
    assert learnt.policy is learnt.policies[best]
    off = cr.learn(MAZE, budget=100, seeds=2, evaluation=cr.GreedyEvaluation("off"))
    assert off.policy is off.policies[0]


def test_a_curriculum_has_the_policy_of_its_target():
    result = cr.Curriculum({"maze": MAZE}, budget=300).train(seeds=2)
    assert result.policy is result["maze"].policy
    assert result.policies is result["maze"].policies
    assert repr(result.watch()) == repr(result.watch("maze")) == repr(result["maze"].watch())
    with pytest.raises(cr.errors.CurriculumError, match="a task must be one of maze: got 'no'"):
        result.watch("no")


def test_episodes_have_the_return_that_evaluation_expects():
    task = random_mdp(3, time_limit=15)
    policy = TabularPolicy(task, np.zeros((task.states.size, task.actions.size)))
    returns = [policy.episode(seed=seed).rewards.sum() for seed in range(400)]
    exact = cr.GreedyEvaluation(method="exact", discounted=False)
    wanted = Target.of(task, exact).random_return
    error = np.std(returns) / np.sqrt(len(returns))
    assert abs(np.mean(returns) - wanted) < 4 * error


def test_sparse_values_act_where_learning_was_and_draw_elsewhere():
    result = cr.learn(HUNT, budget=2000, storage=cr.Storage("sparse"))
    dense = cr.learn(HUNT, budget=2000, storage=cr.Storage("dense"))
    visited = result.values[0].states
    assert 0 < len(visited) < HUNT.states.size
    policy, whole = result.policy, dense.policy
    assert [policy.predict(s) for s in visited] == [whole.predict(s) for s in visited]
    new = np.setdiff1d(np.arange(HUNT.states.size), visited)[0]
    assert policy.predict(int(new)) == TabularPolicy(None, policy.values).predict(int(new)) == 0
    for values in (policy, whole):
        with pytest.raises(SettingError, match="a state must be below 729: got 729"):
            values.predict(HUNT.states.size)
    # In the states of this table alone, one action is right.
    rows = np.zeros((len(visited), HUNT.actions.size))
    rows[:, 7] = 1.0
    episode = TabularPolicy(HUNT, SparseValues(visited, rows)).episode(seed=4)
    assert 7 in episode.actions
    nowhere = SparseValues(np.array([0]), rows[:1])
    assert len(set(TabularPolicy(HUNT, nowhere).episode(seed=1).actions.tolist())) > 5


class Ring(gym.Env):
    """Home is 0; each step costs 1. It draws itself if asked to."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 7}  # noqa: RUF012 - Gymnasium's
    observation_space, action_space = gym.spaces.Discrete(6), gym.spaces.Discrete(2)

    def __init__(self, render_mode=None):
        self.render_mode, self.closed = render_mode, False

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 3
        return self.place, {}

    def step(self, action):
        self.place = (self.place + (1 if action else -1)) % 6
        return self.place, -1.0, self.place == 0, False, {}

    def render(self):
        return np.full((8, 10, 3), 40 * self.place, np.uint8)


class Blind(Ring):
    """The same without pictures."""

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's

    def __init__(self):
        super().__init__()


@pytest.mark.parametrize("kind", [Ring, Blind])
def test_a_live_task_is_played_in_its_environment(kind):
    ring = cr.from_gymnasium(kind, discount=0.9, time_limit=9)
    values = np.tile([1.0, 0.0], (6, 1))
    episode = TabularPolicy(ring, values).episode()
    assert (episode.actions.tolist(), episode.terminated) == ([0, 0, 0], True)
    assert TabularPolicy(ring, values).predict(3) == 0
    assert TabularPolicy(ring, values).episode(max_steps=2).terminated is False
    assert [*episode.texts][1] == "state=2"
    if kind is Ring:
        assert [frame[0, 0, 0] for frame in episode.frames] == [120, 80, 40, 0]
        assert episode.fps == 7
    else:
        assert episode.frames[0].shape[2] == 3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda p: TabularPolicy(None, p.values).predict([0, 0]), "takes only numbers"),
        (lambda p: TabularPolicy(random_mdp(1), np.zeros((6, 3))).episode(), "needs max_steps"),
        (
            lambda p: cr.learn(MAZE, budget=50, storage=cr.Storage(save_values=False)).policy,
            "these were not saved, see Storage",
        ),
    ],
)
def test_a_mistake_is_one_sentence(learnt, wrong, message):
    with pytest.raises(SettingError, match=message):
        wrong(learnt.policy)


def test_wrong_values_are_named(learnt):
    for state in (-1, 9, 0.5, [1, 2, 3], [7, 0]):
        with pytest.raises(SettingError, match=r"a state must|one for each of row, column: got"):
            learnt.policy.predict(state)
    check_values(SettingError, learnt.policy.episode, {"max_steps": [0], "seed": [-1]})
    wrong = {"values": [learnt.policy.values[:2], "values"]}
    check_values(SettingError, partial(TabularPolicy, MAZE), wrong)
