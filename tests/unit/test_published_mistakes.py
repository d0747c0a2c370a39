"""One test for each mistake found in published reinforcement-learning code."""

import inspect

import numpy as np
import pytest

import curricle as cr

LEARNERS = [cr.QLearning, cr.SARSA, cr.ExpectedSARSA, cr.DoubleQLearning]
SHAPINGS = [cr.QInitialisation, cr.LookAheadAdvice, cr.RewardBonus]


def small_maze(**rules):
    return cr.GridWorld(["S..", ".P.", "..T"], **rules)


def one_step_task(reward=8.0):
    return cr.FiniteMDP.from_outcomes(
        [[[(1.0, 1, reward)]], [[]]], terminal=[False, True], start=0, discount=0.9
    )


@pytest.mark.parametrize("kind", LEARNERS)
def test_nothing_is_bootstrapped_through_a_terminal_state(kind):
    learner = kind(learning_rate=1.0, initial_value=1000.0)
    result = cr.learn(one_step_task(), learner, 100)
    assert result.values[0].tolist() == [[8.0], [0.0]]


@pytest.mark.parametrize("kind", LEARNERS)
def test_a_time_limit_is_not_a_termination(kind):
    # 1 a step for ever is worth 1 / (1 - 0.99) = 100, however short the episodes.
    task = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 0, 1.0)]]], terminal=[False], start=0, discount=0.99, time_limit=10
    )
    result = cr.learn(task, kind(learning_rate=0.5), 20_000)
    assert result.values[0, 0, 0] == pytest.approx(100.0)
    assert result.training_return[0, -1] == 10.0
    assert cr.solve(task).values[0] == pytest.approx(100.0)


def test_a_cut_episode_keeps_the_potential_of_its_last_state():
    task = cr.FiniteMDP.from_outcomes(
        [[[(1.0, 0, 1.0)]]], terminal=[False], start=0, discount=0.99, time_limit=10
    )
    phi = cr.StatePotential(task, [40.0])
    result = cr.learn(task, cr.QLearning(learning_rate=0.5), 20_000, shaping=cr.StateShaping(phi))
    assert result.values[0, 0, 0] == pytest.approx(100.0)


@pytest.mark.parametrize("way", [*SHAPINGS, cr.StateShaping])
def test_a_potential_never_reaches_terminal_rows(way):
    maze = small_maze()
    potential = cr.StateActionPotential(maze, np.full((9, 4), 50.0))
    assert not potential.values[maze.mdp.terminal].any()
    result = cr.learn(maze, cr.SARSA(), 2000, shaping=way(potential))
    assert not result.values[0, maze.mdp.terminal].any()


def test_a_state_potential_is_zero_in_terminal_states_in_every_frame():
    maze = small_maze()
    phi = cr.StatePotential(maze, np.full((2, 9), 50.0), frame_steps=(0, 5))
    assert not phi.values[:, maze.mdp.terminal].any()
    assert (phi.values[:, ~maze.mdp.terminal] == 50.0).all()


def test_training_the_target_leaves_the_source_as_it_was():
    maze = small_maze()
    curriculum = cr.Curriculum(
        tasks={"source": maze, "target": maze},
        transfers=[cr.Transfer("source", "target", cr.transfer.identity(maze))],
        learner=cr.QLearning(),
        budget=cr.StoppingRule(1000),
    )
    result = curriculum.train(seeds=2)
    alone = cr.learn(maze, budget=1000, seeds=2, stream="source")
    np.testing.assert_array_equal(result["source"].values, alone.values)
    assert not np.shares_memory(result["source"].values, result["target"].values)


def test_the_discount_has_one_owner():
    consumers = [
        *LEARNERS, cr.learn, cr.solve, cr.evaluate, cr.StatePotential, cr.StateActionPotential,
        cr.StatePotential.shaping_reward, cr.Transfer,
        cr.transfer.StateActionMapping, cr.Curriculum, cr.Curriculum.train, cr.planning.rollout,
    ]  # fmt: skip
    for consumer in consumers:
        assert not {"discount", "gamma"} & set(inspect.signature(consumer).parameters), consumer


@pytest.mark.parametrize("kind", LEARNERS)
def test_equal_seeds_agree_and_different_seeds_differ(kind):
    first, second = (cr.learn(small_maze(), kind(), 500, seeds=2) for _ in range(2))
    np.testing.assert_array_equal(first.values, second.values)
    np.testing.assert_array_equal(first.training_return, second.training_return)
    assert (first.values[0] != first.values[1]).any()
    other = cr.learn(small_maze(), kind(), 500, seeds=2, stream="other")
    assert (first.values[0] != other.values[0]).any()


@pytest.mark.parametrize(
    ("kind", "method"), [*((kind, "exact") for kind in LEARNERS[1:]), (cr.QLearning, "rollouts")]
)
def test_a_seed_does_not_depend_on_workers_or_on_other_seeds(kind, method):
    def run(seeds, workers):
        evaluation = cr.GreedyEvaluation(method=method, episodes=3)
        return cr.learn(
            small_maze(), kind(), 500, seeds=seeds, workers=workers, evaluation=evaluation
        )

    alone, crowd = run([3], 1), run([9, 3, 0, 5, 1], 4)
    for name in ("values", "training_return", "greedy_return", "episodes"):
        np.testing.assert_array_equal(getattr(alone, name)[0], getattr(crowd, name)[1])


def test_evaluation_does_not_disturb_learning():
    def values(eval_freq, method):
        return cr.learn(
            small_maze(),
            budget=1000,
            eval_freq=eval_freq,
            evaluation=cr.GreedyEvaluation(method=method),
        ).values

    often, seldom, exactly = values(7, "rollouts"), values(1000, "rollouts"), values(7, "exact")
    np.testing.assert_array_equal(often, seldom)
    np.testing.assert_array_equal(often, exactly)
