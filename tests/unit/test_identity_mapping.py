"""The identity between tasks of one shape."""

import gymnasium as gym
import numpy as np
import pytest

import curricle as cr
from curricle.errors import MappingError
from curricle.tasks.mdp import FiniteMDP
from curricle.transfer import identity


def chain(n=3, name="place", low=0, labels=("left", "right"), points=None):
    """A chain whose states have a name; entering the last one ends the episode."""
    states = cr.Space([cr.Component(name, n, low)], points)
    size = states.size
    outcomes = [[[(1.0, min(s + 1, size - 1), -1.0)]] * 2 for s in range(size)]
    terminal = np.arange(size) == size - 1
    actions = cr.Space([cr.Component("move", 2, labels=labels)])
    return FiniteMDP.from_outcomes(
        outcomes, terminal=terminal, start=0, discount=0.9, states=states, actions=actions
    )


def test_each_pair_reads_the_same_pair_whatever_names_are():
    target, source = chain(), chain(name="cell")
    mapping = identity(target, source)
    assert mapping.target is target
    assert mapping.source is source
    assert mapping.index.tolist() == [[0, 1], [2, 3], [cr.transfer.ENDED, cr.transfer.ENDED]]


def test_the_end_of_the_source_has_value_0():
    target, source = cr.GridWorld("S.PT", ends=["treasure"]), cr.GridWorld("S.PT")
    assert identity(target, source).index[2].tolist() == [cr.transfer.ENDED] * 4


def test_live_tasks_and_tables_may_be_mixed():
    lake = {live: cr.from_gymnasium("FrozenLake-v1", discount=0.9, live=live) for live in (0, 1)}
    assert identity(lake[1], lake[0]).coverage().ended > 0
    assert identity(lake[0], lake[1]).coverage().mapped == 1


WRONG = {
    "components": (
        lambda: (cr.Pursuit(3, 2), cr.Pursuit(3, 1)),
        "the target's states have prey, predator_1, predator_2, the source's prey, predator; ",
    ),
    "sizes": (lambda: (chain(4), chain()), r"states have place\[4\], the source's place\[3\]; "),
    "ranges": (lambda: (chain(low=1), chain()), r"place\[3 from 1\], the source's place\[3\]; "),
    "points": (
        lambda: (cr.GridWorld("S#.T"), cr.GridWorld("S.#T")),
        "states of row, column are 3 in the target and 3 in the source, not the same ones in the",
    ),
    "order of actions": (
        lambda: (chain(), chain(labels=("right", "left"))),
        "values of move are left, right in the target and right, left in the source; ",
    ),
    "observations": (
        lambda: (cr.observation_task("MountainCar-v0"), cr.observation_task("CartPole-v1")),
        r"target's observations are Box\(\[-1.2  -0.07\].*, the source's Box\(.*; a function of",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_shapes_that_differ_are_told(name):
    make, sentence = WRONG[name]
    with pytest.raises(MappingError, match=sentence):
        identity(*make())


def test_observations_of_one_shape_are_left_as_they_are():
    slow, fast = (cr.observation_task("MountainCar-v0", goal_velocity=v) for v in (0, 0.01))
    mapping = identity(fast, slow)
    assert mapping.is_identity
    assert mapping.source == slow
    assert identity(slow).target == slow


def test_dicts_of_observations_must_have_the_same_keys():
    def boxes(**parts):
        return cr.observation_task(lambda: Shown(gym.spaces.Dict(parts)))

    box = gym.spaces.Box(0, 1, (2,))
    assert identity(boxes(a=box), boxes(a=gym.spaces.Box(0, 5, (2,)))).is_identity
    with pytest.raises(MappingError, match="identity needs tasks of one shape"):
        identity(boxes(a=box), boxes(b=box))


class Shown(gym.Env):
    """Only its spaces are looked at."""

    def __init__(self, space):
        self.observation_space, self.action_space = space, gym.spaces.Discrete(2)
