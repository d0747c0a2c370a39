"""Models that act on observations, evaluated exactly on tables."""

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError, TaskError
from curricle.planning import visit_distribution
from curricle.tasks import GoalDistance, with_start
from tests.support.worlds_to_tabulate import Corridor


class Rule:
    """Acts by a function of one observation; notes how many it is asked about."""

    def __init__(self, rule, bare=False):
        self.rule, self.bare, self.asked = rule, bare, []

    def predict(self, observations, deterministic):
        assert deterministic
        self.asked.append(len(observations))
        actions = np.array([self.rule(seen) for seen in observations])
        return actions if self.bare else (actions, None)


def played(rule, discount, seed):
    """The discounted return of a rule, step by step in the environment."""
    env = Corridor()
    seen, _ = env.reset(seed=seed)
    total, weight = 0.0, 1.0
    for _ in range(200):
        seen, reward, over, _, _ = env.step(rule(seen))
        total += weight * reward
        weight *= discount
        if over:
            break
    return total


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize(
    "rule",
    [lambda seen: 1 if seen[1] else 2, lambda seen: 1, lambda seen: 0, lambda seen: seen.sum() % 3],
    ids=["right", "in the dark", "back", "sum"],
)
def test_a_model_is_worth_what_it_earns(rule, bare):
    task = cr.tabulate(Corridor, discount=0.9, seeds=10)
    model = Rule(rule, bare)
    earned = np.mean([played(rule, 0.9, seed) for seed in range(10)])
    assert cr.evaluate(task, model).start_value == pytest.approx(earned, abs=1e-8)
    assert model.asked == [task.states.size]


def test_a_model_is_evaluated_from_other_starts():
    task, model = cr.tabulate(Corridor, discount=0.9), Rule(lambda seen: 1 if seen[1] else 2)
    near = with_start(task, GoalDistance(1))
    values = cr.evaluate(task, model).values
    (start,) = np.flatnonzero(near.mdp.start)
    assert cr.evaluate(near, model).start_value == pytest.approx(values[start]) == 1.0
    assert near.state(task.observations.batch([start])[0]) == start
    visits = with_start(task, visit_distribution(task))
    assert cr.evaluate(visits, model).start_value == pytest.approx(values @ visits.mdp.start)
    assert visits.record == task.record


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        (lambda seen: 3, r"actions must lie in 0\.\.2: got 3\.\.3"),
        (lambda seen: [0, 1], r"one action for each of 8 observations: .* of shape \(8, 2\)"),
    ],
)
def test_what_is_no_action_is_refused(rule, said):
    task = cr.tabulate(Corridor, discount=0.9)
    with pytest.raises(SettingError, match=said):
        cr.evaluate(task, Rule(rule))
    with pytest.raises(SettingError, match=r"must have a distribution .*: a Rule has none"):
        task.policy(Rule(rule), deterministic=False)


def test_a_model_needs_a_task_that_knows_its_observations():
    model = Rule(lambda seen: 1)
    with pytest.raises(SettingError, match=r"knows the observation of each state.*: got GridWorld"):
        cr.evaluate(cr.GridWorld("S.T"), model)

    def outcomes(state, action):
        place, lit = state
        if action == 2:
            lit = not lit
        else:
            place = min(max(place + (1 if action else -1), 0), 3)
        return [(1.0, (place, lit), float(place == 3 and lit), place == 3)]

    task = cr.tabulate(
        Corridor,
        discount=0.9,
        outcomes=outcomes,
        state=(lambda env: (env.place, env.lit), lambda env, state: None),
    )
    assert task.observations is None
    with pytest.raises(TaskError, match="only where tables have them"):
        cr.evaluate(task, model)
