"""Pursuit against a plain enumeration of its joint dynamics, and its rules one by one."""

import itertools
import tracemalloc
from collections import Counter

import numpy as np
import pytest

from curricle import Pursuit
from curricle.errors import TaskError

STEPS = {"stay": (0, 0), "north": (-1, 0), "east": (0, 1), "south": (1, 0), "west": (0, -1)}


def names_of(moves):
    return list(STEPS)[5 - moves :]


def walk(cell, name, size, torus):
    row, column = divmod(cell, size)
    down, right = STEPS[name]
    row, column = row + down, column + right
    if torus:
        row, column = row % size, column % size
    elif not (0 <= row < size and 0 <= column < size):
        return cell
    return row * size + column


def joint_dynamics(game, position, action, prey_policy):
    """Return {(next position, reward): probability}; all move at once."""
    prey, *hunters = position
    moves = names_of(game.moves)
    after = [walk(h, moves[a], game.size, game.torus) for h, a in zip(hunters, action, strict=True)]
    outcomes = Counter()
    for name, chance in zip(moves, prey_policy(position), strict=True):
        there = walk(prey, name, game.size, game.torus)
        together = sum(h == there for h in after)
        need = {"all": game.predators, "any": 1, "as_published": game.predators}
        caught = together >= need.get(game.capture, game.capture)
        if chance:
            reward = game.capture_reward if caught else game.step_reward
            outcomes[(there, *after), reward] += chance
    return outcomes


def table_dynamics(game, state, action):
    mdp = game.mdp
    row = mdp.outcome_row[state, action]
    outcomes = Counter()
    for p, s, r in zip(mdp.probability[row], mdp.next_state[row], mdp.reward[row], strict=True):
        if p:
            where = game.states.decode(s)
            outcomes[tuple(int(where[n]) for n in game.states.names), float(r)] += p
    return outcomes


def agrees(game, prey_policy, pairs=None):
    """Compare every pair (or some) of the table with the enumeration."""
    positions = list(itertools.product(range(game.size**2), repeat=1 + game.predators))
    actions = list(itertools.product(range(game.moves), repeat=game.predators))
    assert (len(positions), len(actions)) == (game.states.size, game.actions.size)
    everything = itertools.product(range(len(positions)), range(len(actions)))
    for s, a in everything if pairs is None else pairs:
        if game.mdp.terminal[s]:
            continue
        expected = joint_dynamics(game, positions[s], actions[a], prey_policy)
        tabled = table_dynamics(game, s, a)
        assert tabled.keys() == expected.keys()
        assert all(abs(tabled[k] - expected[k]) < 1e-12 for k in expected)


def uniform(game):
    return lambda position: [1 / game.moves] * game.moves


RULES = [{"moves": m, "torus": t} for m in (4, 5) for t in (False, True)]


@pytest.mark.parametrize("rules", RULES, ids=lambda r: f"{r['moves']} moves, torus {r['torus']}")
@pytest.mark.parametrize(("size", "predators"), [(2, 1), (3, 1), (2, 2)])
def test_the_table_is_the_joint_dynamics(size, predators, rules):
    game = Pursuit(size=size, predators=predators, **rules)
    agrees(game, uniform(game))


@pytest.mark.parametrize("capture", ["all", "any", "as_published", 1, 2])
@pytest.mark.parametrize(("size", "predators"), [(3, 2), (2, 3)])
def test_the_table_is_the_joint_dynamics_under_every_capture_rule(size, predators, capture):
    game = Pursuit(
        size=size, predators=predators, capture=capture, step_reward=-2, capture_reward=5
    )
    rng = np.random.default_rng(0)
    pairs = zip(
        rng.integers(game.states.size, size=400),
        rng.integers(game.actions.size, size=400),
        strict=True,
    )
    agrees(game, uniform(game), pairs)


@pytest.mark.parametrize(
    ("capture", "ends_at"), [("all", 3), ("any", 1), ("as_published", 1), (1, 1), (2, 2), (3, 3)]
)
def test_an_episode_ends_when_enough_predators_touch_the_prey(capture, ends_at):
    game = Pursuit(size=2, predators=3, capture=capture)
    for s, (prey, *hunters) in enumerate(itertools.product(range(4), repeat=4)):
        assert game.mdp.terminal[s] == (hunters.count(prey) >= ends_at)


@pytest.mark.parametrize("capture", ["all", "any"])
def test_the_start_is_uniform_over_uncaught_states(capture):
    mdp = Pursuit(size=2, predators=2, capture=capture).mdp
    free = ~mdp.terminal
    assert free.sum() == {"all": 64 - 4, "any": 4 * 9}[capture]
    np.testing.assert_allclose(mdp.start, free / free.sum(), atol=1e-15)


def test_a_table_too_large_is_refused_before_anything_is_allocated():
    game = Pursuit(size=10, predators=3)
    assert game.states.size * game.actions.size == 10**8 * 125
    tracemalloc.start()
    with pytest.raises(TaskError, match=r"500,000,000.*100,000,000 states x 125 actions"):
        _ = game.mdp
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000
