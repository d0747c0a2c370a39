"""Values of the wrong type: refused in one sentence of ours, never by an error from deep inside."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError

LINE = cr.GridWorld("S.T")
HUNT, CHASE = cr.Pursuit(size=2, predators=2), cr.Pursuit(size=2, predators=1)
FIRST = cr.project(HUNT, CHASE, predator="predator_1")
NAN, INF = float("nan"), float("inf")


def outcomes(lists, terminal=(0, 1)):
    return cr.FiniteMDP.from_outcomes(lists, terminal=terminal, start=0, discount=0.9)


def run(*arguments, **settings):
    return cr.learn(LINE, *(arguments or (None, 10)), **settings)


def alone(**settings):
    return cr.Curriculum(tasks={"line": LINE}, **settings)


CALLS = {
    "a fraction of a state": lambda: outcomes([[[(1.0, 1.7, 0.0)]], [[]]]),
    "no outcomes": lambda: outcomes([], ()),
    "no actions": lambda: outcomes([[]], (0,)),
    "outcome keys from 1": lambda: outcomes({1: {0: []}, 2: {0: []}}),
    "outcomes without a reward": lambda: outcomes([[[(1.0, 1)]], [[]]]),
    "ragged transitions": lambda: cr.FiniteMDP.from_dense(
        [[1], [1, 2]], [0], terminal=[0], start=0, discount=0.9
    ),
    "half a component": lambda: cr.Component("a", 2.5),
    "a lowest value as text": lambda: cr.Component("a", 2, low="1"),
    "labels twice": lambda: cr.Component("a", 2, labels=("x", "x")),
    "shapes that do not broadcast": lambda: HUNT.states.encode(
        prey=[1, 2], predator_1=[1, 2, 3], predator_2=1
    ),
    "half a step": lambda: cr.GridWorld("S.T", time_limit=2.5),
    "a limit of True": lambda: cr.GridWorld("S.T", time_limit=True),
    "an infinite limit": lambda: cr.GridWorld("S.T", time_limit=INF),
    "a limit beyond 64 bits": lambda: cr.GridWorld("S.T", time_limit=10**30),
    "discount as text": lambda: cr.GridWorld("S.T", discount="x"),
    "a map of numbers": lambda: cr.GridWorld([1, 2]),
    "a shaping as text": lambda: run(shaping="state"),
    "a warm-up as a number": lambda: run(warm_up=5),
    "warm-ups as numbers": lambda: run(seeds=1, warm_up=[5]),
    "no potential's values": lambda: cr.StatePotential(LINE, None),
    "complex values of a potential": lambda: cr.StatePotential(LINE, np.zeros(3, complex)),
    "no map": lambda: cr.GridWorld(None),
    "rewards as a number": lambda: cr.GridWorld("S.T", rewards=5),
    "a reward of None": lambda: cr.Rewards(step=None),
    "a reward that overflows": lambda: cr.Rewards(step=1e308),
    "one start cell, bare": lambda: cr.GridWorld("S.T", start=(0, 0)),
    "half a start cell": lambda: cr.GridWorld("S.T", start=[(0.7, 1.2)]),
    "no start": lambda: cr.GridWorld("S.T", start=None),
    "one row to crop": lambda: LINE.crop(rows=1, columns=(0, 1)),
    "an origin without a column": lambda: cr.GridWorld("S.T", origin=(0,)),
    "half a cell": lambda: cr.Pursuit(size=2.5),
    "no prey": lambda: cr.Pursuit(prey=None),
    "a prey's policy as a list": lambda: cr.Pursuit(prey=[0.2] * 5),
    "a ragged prey's policy": lambda: cr.Pursuit(prey=[[1], [1, 2]]),
    "a negative prey's policy": lambda: cr.Pursuit(size=2, prey=[[1.2, -0.2, 0, 0, 0]] * 4),
    "a learner as text": lambda: run("q", 10),
    "a learner's class": lambda: run(cr.QLearning, 10),
    "no kind of learner": lambda: cr.learning.Learner(),
    "a rate of NaN": lambda: cr.QLearning(learning_rate=NAN),
    "epsilon as text": lambda: cr.QLearning(epsilon="x"),
    "a schedule as initial value": lambda: cr.QLearning(initial_value=cr.learning.harmonic()),
    "a budget of NaN": lambda: run(None, NAN),
    "no budget": lambda: run(None, None),
    "a budget of more checkpoints than fit": lambda: run(None, cr.Episodes(10**17)),
    "seeds as text": lambda: run(seeds="12"),
    "half seeds": lambda: run(seeds=[1.7, 2.2]),
    "seeds of True": lambda: run(seeds=True),
    "no seeds": lambda: run(seeds=None),
    "every as text": lambda: run(eval_freq="x"),
    "every of True": lambda: run(eval_freq=True),
    "evaluation as text": lambda: run(evaluation="exact"),
    "half an episode": lambda: cr.GreedyEvaluation(episodes=1.5),
    "a number for whether rewards are discounted": lambda: cr.GreedyEvaluation(discounted=0),
    "text for whether actions are sampled": lambda: cr.GreedyEvaluation(sampled="no"),
    "half a worker": lambda: run(workers=1.5),
    "no task to learn": lambda: cr.learn(None, None, 10),
    "no task to solve": lambda: cr.solve(None),
    "no task to map": lambda: cr.transfer.identity(None),
    "a ragged mapping": lambda: cr.transfer.StateActionMapping(LINE, LINE, [[1], [1, 2]]),
    "a ragged potential": lambda: cr.StatePotential(LINE, [[1], [1, 2]]),
    "a potential of no frames": lambda: cr.StatePotential(LINE, np.ones((0, 3)), frame_steps=()),
    "a weight as text": lambda: cr.DecayingAdvice(np.zeros((3, 4)), weight="x"),
    "a ragged policy": lambda: cr.evaluate(LINE, [[1], [1, 2]]),
    "a tolerance as text": lambda: cr.solve(LINE, tolerance="x"),
    "values of NaN": lambda: cr.planning.greedy_policy([[NAN, 1.0]]),
    "a negative tolerance of ties": lambda: cr.planning.greedy_policy([[0.0, 1.0]], tolerance=-1),
    "a negative rollout seed": lambda: cr.planning.rollout(LINE, [1, 1, 1], seed=-1),
    "half a rollout start": lambda: cr.planning.rollout(LINE, [1, 1, 1], start=0.5),
    "a function that returns nothing": lambda: cr.from_function(LINE, LINE, lambda s, a: None),
    "a function that returns three": lambda: cr.from_function(LINE, LINE, lambda s, a: (s, a, a)),
    "an unmapped value as text": lambda: cr.transfer.identity(LINE).__class__(
        LINE, LINE, cr.transfer.identity(LINE).index, "x"
    ),
    "no mapping": lambda: cr.Transfer("chase", "hunt", 0),
    "one transfer, bare": lambda: alone(transfers=cr.Transfer("a", "b", FIRST)),
    "transfers as tuples": lambda: alone(transfers=[("a", "b", FIRST)]),
    "no transfers": lambda: alone(transfers=None),
    "tasks as a list": lambda: cr.Curriculum(tasks=[LINE]),
    "a task of None": lambda: cr.Curriculum(tasks={"a": None}),
    "an unknown shaping": lambda: alone(shaping="magic"),
    "an aggregate as text": lambda: alone(aggregate="min"),
    "a curriculum's learner as text": lambda: alone(learner="q"),
    "a curriculum's budget of 0": lambda: alone(budget=0),
    "a curriculum's every of 0": lambda: alone(eval_freq=0),
    "edges into an unknown task": lambda: alone().in_edges("hunt"),
    "ancestors of an unknown task": lambda: alone().ancestors("hunt"),
    "trained results as a number": lambda: alone().train(trained=5),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_a_wrong_type_is_refused_in_one_sentence(call):
    with pytest.raises(cr.CurricleError) as caught:
        call()
    assert isinstance(caught.value, ValueError)
    assert str(caught.value).strip()


@pytest.mark.parametrize("huge", [2**63, -(10**400), 10**5000, float("inf")], ids=lambda _: "")
def test_a_number_beyond_64_bits_is_refused_in_one_sentence(huge):
    with pytest.raises(SettingError, match=r"^[^\n]{1,90}$"):
        cr.learn(cr.GridWorld("S.T"), budget=huge)
    if abs(huge) > 2**63:
        with pytest.raises(SettingError, match=r"must be finite: got [^\n]{1,40}$"):
            cr.QLearning(learning_rate=huge)


def test_a_shaping_as_text_is_told_from_a_list_of_shapings():
    with pytest.raises(SettingError, match=r"^shaping must be a Shaping, .*: got str$"):
        run(shaping="state")


def test_numbers_of_single_precision_are_compared_without_a_warning():
    assert cr.QLearning(inverse_temperature=np.float32(0.5)).inverse_temperature == 0.5


def test_whole_numbers_may_be_written_as_floats():
    assert run(None, 1e3).steps_used.tolist() == [1000]


def test_one_kind_of_end_may_be_given_bare():
    assert cr.GridWorld("S.T", ends="treasure").ends == ("treasure",)


def test_a_start_cell_given_twice_counts_once():
    assert cr.GridWorld("S.T", start=[(0, 0), (0, 0)]).mdp.start.tolist() == [1, 0, 0]
