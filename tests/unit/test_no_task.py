"""What is no task with tables is refused, and what was probably meant is said."""

import gymnasium as gym
import pytest

import curricle as cr
from curricle.errors import TaskError

MAZE = cr.GridWorld("S.T")
GYMNASIUM = "; from_gymnasium makes a task of an environment or of its id"


@pytest.mark.parametrize(
    ("given", "advice"),
    [
        (cr.GridWorld, "; give a task of this class, not the class"),
        ("FrozenLake-v1", GYMNASIUM),
        (gym.make("FrozenLake-v1"), GYMNASIUM),
        (cr.to_gymnasium(MAZE), ", whose task is its .task"),
        (
            cr.observation_task("CartPole-v1"),
            "; what is seen through observations is learnt by a network, a deep.DeepLearner",
        ),
        (3, ""),
        (int, ""),
    ],
    ids=lambda given: type(given).__name__,
)
def test_what_was_probably_meant_is_said(given, advice):
    expected = f"a task must be a FiniteMDP or have its tables as .mdp: got {given!r}{advice}"
    for use in (cr.solve, cr.learn, lambda task: cr.Curriculum({"task": task}).train(seeds=1)):
        with pytest.raises(TaskError) as caught:
            use(given)
        assert str(caught.value) == expected
