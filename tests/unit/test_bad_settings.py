"""Learning settings and potentials that make no sense: each is refused in one sentence."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import PotentialError, SettingError
from curricle.planning import rollout
from tests.support.refusals import check_refusal

NAN, INF = float("nan"), float("inf")
LINE = cr.GridWorld("S.T")
NO_LIMIT = cr.GridWorld("S.T", time_limit=None)
PHI = cr.StateActionPotential(LINE, np.ones((3, 4)))
UNIFORM = np.full((3, 4), 0.25)


def ask(*args, **settings):
    """Learn briefly on the line."""
    learner = args[0] if args else cr.QLearning()
    return cr.learn(LINE, learner, **({"budget": 100} | settings))


SETTINGS = [
    (lambda: ask(budget=0), "a budget in steps must be a whole number, at least 1: got 0"),
    (lambda: ask(budget=cr.Episodes(0)), "in episodes must be a whole number, at least 1: got 0"),
    (lambda: cr.learn(NO_LIMIT, budget=cr.Episodes(5)), "needs a task with a time limit"),
    (lambda: ask(seeds=[3, 3]), r"different, .*got \[3, 3\]"),
    (lambda: ask(seeds=[0, -1]), "each of seeds must be a whole number, at least 0: got -1"),
    (lambda: ask(eval_freq=101), "exceed the budget of 100 steps: got 101"),
    (lambda: cr.GreedyEvaluation("best"), "must be one of auto, exact, rollouts, off: got 'best'"),
    (lambda: cr.GreedyEvaluation("rollouts", episodes=1_000_001), "episodes of an evaluation"),
    (lambda: ask(snapshots=10**40), "snapshots must be a whole number below"),
    (
        lambda: cr.learn(NO_LIMIT, budget=9, evaluation=cr.GreedyEvaluation(discounted=False)),
        "needs a task with a time limit",
    ),
    (lambda: cr.QLearning(learning_rate=1.5), r"learning_rate .*\[0, 1\]: got 1.5"),
    (lambda: cr.QLearning(learning_rate=cr.learning.linear(0.5, 2, steps=9)), r"rate .*got 2"),
    (lambda: cr.QLearning(epsilon=0.1, inverse_temperature=2.0), "and inverse_temperature=2.0"),
    (lambda: cr.QLearning(initial_value=INF), "finite: got inf"),
    (lambda: cr.learning.linear(1, 0, steps=0), "steps must be positive: got 0"),
    (lambda: ask(shaping=PHI), "shaping must be a Shaping, .* got StateActionPot"),
    (lambda: ask(shaping=cr.QInitialisation(PHI.to_state())), r"phi\(s, a\): got StatePotential"),
    (lambda: ask(shaping=[cr.QInitialisation(PHI)] * 2, seeds=3), "entry per seed, 3: got 2"),
    (lambda: ask(shaping=cr.QInitialisation(portfolio=cr.Portfolio())), "a shaping without one"),
    (lambda: cr.QInitialisation(PHI, portfolio=True), "must be a Portfolio: got True"),
    (lambda: cr.Portfolio(margin=-1), "margin of a portfolio must be .* 0"),
    (lambda: cr.Portfolio(value_range=(2, 1)), "value_range of a portfolio must have lowest"),
    (lambda: cr.evaluate(cr.GridWorld("S.T", discount=1), [3, 1, 0]), "1 needs .*from state 0"),
    (lambda: rollout(LINE, [1, 1]), r"\(3,\) or \(3, 4\): got \(2,\)"),
    (lambda: rollout(LINE, [1, 4, 0]), r"0\.\.3: state 1 has 4"),
    (lambda: rollout(LINE, [1.0, 1.0, 0.0]), "integers: got float64"),
    (lambda: cr.evaluate(LINE, NAN * UNIFORM), "sum to 1: state 0 has .nan"),
    (lambda: rollout(LINE, UNIFORM, start=2), "not terminal: got 2"),
    (lambda: rollout(NO_LIMIT, UNIFORM), "limit .*got None"),
]

POTENTIALS = [
    (lambda: cr.StateActionPotential(LINE, np.ones((4, 3))), r"\(3, 4\): got \(4, 3\)"),
    (lambda: cr.StatePotential(LINE, [1, 2]), r"\(3,\) or \(M, 3\): got \(2,\)"),
    (
        lambda: cr.StateActionPotential(LINE, np.where(np.arange(12) == 6, NAN, 0).reshape(3, 4)),
        r"phi must be finite: entry \(1, 2\) is nan",
    ),
    (lambda: cr.StatePotential(LINE, [0, -INF, 0]), r"Phi .*entry \(1,\) is -inf"),
    (lambda: cr.StatePotential(LINE, [0, 0, NAN]), r"Phi must be finite: entry \(2,\)"),  # an end
    (lambda: cr.StatePotential(LINE, np.ones((2, 3))), r"2 potentials: got \[0\]"),
    (lambda: cr.StatePotential(LINE, np.ones((3, 3)), frame_steps=[0, 5, 5]), r"got \[0, 5, 5\]"),
]


@pytest.mark.parametrize(("call", "says"), SETTINGS)
def test_bad_settings_are_refused_in_one_sentence(call, says):
    check_refusal(SettingError, call, says)


@pytest.mark.parametrize(("call", "says"), POTENTIALS)
def test_bad_potentials_are_refused_in_one_sentence(call, says):
    check_refusal(PotentialError, call, says)


@pytest.mark.parametrize("huge", [2**63, -(10**400), 10**5000, INF], ids=lambda _: "")
def test_a_number_beyond_64_bits_is_refused_in_one_sentence(huge):
    with pytest.raises(SettingError, match=r"^[^\n]{1,90}$"):
        ask(budget=huge)
    if abs(huge) > 2**63:
        with pytest.raises(SettingError, match=r"must be finite: got [^\n]{1,40}$"):
            cr.QLearning(learning_rate=huge)


def test_a_refused_learning_runs_nothing_and_leaves_the_potential():
    before = PHI.values.copy()
    for wrong in ({"eval_freq": 0}, {"seeds": []}, {"shaping": "magic"}, {"workers": 0}):
        with pytest.raises(SettingError):
            ask(
                **({"shaping": cr.QInitialisation(PHI), "budget": 2**40} | wrong)
            )  # would take weeks if it ran
    assert (PHI.values == before).all()
