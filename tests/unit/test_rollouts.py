"""Single episodes, and random ones."""

import numpy as np
import pytest

import curricle as cr
from curricle import FiniteMDP, GridWorld
from curricle.errors import SettingError
from curricle.planning import rollout, rollouts
from curricle.planning.rollouts import random_rollouts
from tests.support.certificates import MAZE
from tests.support.refusals import check_refusal

LINE = GridWorld("S..T", discount=0.5)


def test_an_episode_runs_to_the_end():
    episode = rollout(LINE, [1, 1, 1, 0])
    assert episode.states.tolist() == [0, 1, 2, 3]
    assert episode.actions.tolist() == [1, 1, 1]
    assert episode.rewards.tolist() == [-1, -1, 199]
    assert (episode.terminated, episode.truncated, len(episode)) == (True, False, 3)
    assert rollout(LINE, [1, 1, 1, 0], start=2).states.tolist() == [2, 3]
    episode = rollout(LINE, [1, 1, 1, 0])
    assert episode.discounted_return(0.5) == -1 - 0.5 + 199 / 4
    assert episode.discounted_return(1) == 197
    assert episode.discounted_return(0) == -1


def test_an_episode_is_cut_at_the_time_limit_or_at_steps():
    west = [3, 3, 3, 3]
    assert len(rollout(GridWorld("S..T", time_limit=7), west)) == 7
    cut = rollout(LINE, west, steps=4)
    assert (len(cut), cut.terminated, cut.truncated) == (4, False, True)
    assert not rollout(LINE, [1, 1, 1, 0], steps=3).truncated


def test_a_random_policy_follows_its_probabilities_and_its_seed():
    uniform = np.full((4, 4), 0.25)
    again = [rollout(LINE, uniform, seed=s).actions.tolist() for s in (1, 1, 2)]
    assert again[0] == again[1] != again[2]
    moves = np.concatenate([rollout(LINE, uniform, seed=s).actions for s in range(100)])
    assert np.bincount(moves) / len(moves) == pytest.approx([0.25] * 4, abs=0.05)


def ring_step(n, state, action, bits):
    after = (state + action) % n
    return after, -1.0, after == 0


RING = cr.ComputedMDP(
    cr.Space([cr.Component("place", 5)]),
    cr.Space([cr.Component("move", 2)]),
    lambda n, bits: 3,
    ring_step,
    data=5,
)


def test_tasks_with_and_without_tables_draw_alike():
    # The walk on the ring as a table: the same states, rewards, draws.
    place = np.arange(5)
    table = FiniteMDP.from_outcomes(
        [[[(1.0, (s + a) % 5, -1.0)] for a in range(2)] for s in place],
        terminal=place == 0,
        start=3,
        discount=0.99,
        time_limit=200,
    )
    uniform = np.full((5, 2), 0.5)
    for seed in range(5):
        computed, other = rollout(RING, uniform, seed=seed), rollout(table, uniform, seed=seed)
        assert computed.states.tolist() == other.states.tolist()
        assert computed.actions.tolist() == other.actions.tolist()
        assert computed.rewards.tolist() == other.rewards.tolist()
        assert (computed.terminated, computed.truncated) == (other.terminated, other.truncated)
    walked, tabled = (random_rollouts(task, episodes=9, length=7) for task in (RING, table))
    for drawn, read in zip((*walked[0], *walked[1]), (*tabled[0], *tabled[1]), strict=True):
        np.testing.assert_array_equal(drawn, read)


def test_a_long_episode_is_simulated_in_pieces(monkeypatch):
    uniform = np.full((5, 2), 0.5)
    whole = [rollout(RING, uniform, seed=seed) for seed in range(5)]
    monkeypatch.setattr(rollouts, "CHUNK", 2)
    for seed, expected in enumerate(whole):
        episode = rollout(RING, uniform, seed=seed)
        assert episode.states.tolist() == expected.states.tolist()
        assert episode.rewards.tolist() == expected.rewards.tolist()
        assert episode.terminated == expected.terminated


def after_each(steps, ends):
    """Return the state after each step of all episodes."""
    after = np.append(steps.states[1:], 0)
    after[np.cumsum(ends.lengths) - 1] = ends.last_states
    return after


def test_rollouts_follow_the_task():
    mdp, (steps, ends) = MAZE.mdp, random_rollouts(MAZE, episodes=200, length=60, seed=3)
    row = mdp.outcome_row[steps.states, steps.actions]
    np.testing.assert_array_equal(mdp.next_state[row, 0], after_each(steps, ends))
    assert not mdp.terminal[steps.states].any()
    np.testing.assert_array_equal(mdp.terminal[ends.last_states], ends.terminated)
    assert 0 < ends.terminated.sum() < 200 or ends.terminated.all()
    assert (ends.lengths[~ends.terminated] == 60).all()
    # Every action is as likely: 4 standard deviations, one false alarm in 4,000 streams.
    n = len(steps.states)
    counts = np.bincount(steps.actions, minlength=4)
    assert abs(counts / n - 0.25).max() < 4 * np.sqrt(0.25 * 0.75 / n)
    # What the task does does not depend on the draw of the action: within 5 standard deviations.
    chase = cr.Pursuit(size=9, predators=1)
    steps, ends = random_rollouts(chase, episodes=400, length=50)
    starts = np.cumsum(ends.lengths) - ends.lengths
    columns = steps.states[starts], after_each(steps, ends)[starts]
    first, then = (chase.states.decode(column)["prey"] for column in columns)
    joint = np.zeros((5, 5))
    moved = [0, -9, 1, 9, -1]
    inside = np.isin(first // 9, range(1, 8)) & np.isin(first % 9, range(1, 8))
    for prey, move in enumerate(moved):
        joint[:, prey] = np.bincount(
            steps.actions[starts][inside & (then - first == move)], minlength=5
        )  # fmt: skip
    assert joint.sum() == inside.sum()
    assert abs(joint - joint.sum() / 25).max() < 5 * np.sqrt(joint.sum() / 25)


def test_bad_rollouts_are_refused_in_one_sentence():
    says = "length of a random rollout in steps must be"
    check_refusal(SettingError, lambda: random_rollouts(MAZE, episodes=2, length=0), says)
