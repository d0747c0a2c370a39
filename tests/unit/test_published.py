"""The published settings of docs/what_survives.md: their facts, their audits, and the tables."""

import json

import numpy as np
import pytest

import curricle as cr
from benchmarks.published import __main__ as tables, grids, potentials, worlds
from curricle.planning import Target
from curricle.study import audit, read_study
from curricle.study.auditing import as_configured, as_fair

FEW = {
    "office": ["budget=2_000", "tasks.office.budget=2_000", "tasks.office.eval_freq=200"],
    "objects": ["tasks.maze.budget=200"],  # its threshold is stated
}


SLOW = {"grid_50": pytest.mark.slow, "advice": pytest.mark.slow}  # their levels take seconds


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=SLOW.get(name, ())) for name in tables.CLAIMS]
)
def test_every_claim_can_be_audited(name):
    study = read_study(tables.CLAIMS[name])
    assert len(study.seeds) == 100
    assert as_configured(study).scratch_curricula()
    fair = as_fair(study, 2)
    tasks = {len(plan.tasks) for plan in study.curricula.values()}
    assert {len(plan.tasks) for plan in fair.tune.arms.values()} == tasks
    played = len(study.arms) + len(study.scratch_curricula())
    informed = [arm for arm in fair.arms if arm.endswith(", informed optimist")]
    assert len(informed) == len(study.arms) if name not in ("graph", "objects") else informed
    settings = max(len(of.values) for of in fair.tune.variants.values())
    assert len(fair.tune.variants) == (2 * settings + 1) * (played + 1 + len(informed))
    json.dumps(fair.to_data())


def test_the_grid_of_ng_harada_russell():
    task = worlds.open_grid(10)
    # 18 steps at .85 - .05 a step each way, a little more at the edges
    assert cr.solve(task).start_value == pytest.approx(-21.8, abs=0.1)
    phi = worlds.distance(task)
    assert phi[int(task.start.argmax())] == -18 / 0.8
    assert phi[task.terminal].max() == 0.0
    np.testing.assert_array_equal(worlds.half_distance(task), phi / 2)


def test_the_office_of_toro_icarte():
    for as_run, steps in (True, 23), (False, 29):  # to the only reward
        best = cr.solve(worlds.office(as_run=as_run)).start_value
        assert 1 + np.log(best) / np.log(0.9) == pytest.approx(steps)
    office = worlds.office()
    states = office.automaton.states
    potentials = worlds.machine_values(office)
    of_state = office.states.decode()["automaton"]
    by_name = {name: float(potentials[of_state == n].max()) for n, name in enumerate(states)}
    assert by_name == {
        "neither": -0.9**2, "mail": -0.9, "coffee": -0.9, "both": -1.0, "home": 0.0, "broken": 0.0,
    }  # fmt: skip


def test_the_rooms_of_cipollone():
    study = read_study(tables.CLAIMS["rooms"])
    (edge,) = study.curricula["transfer"].transfers
    coverage = edge.mapping.coverage()
    assert coverage.mapped == 1.0
    # one potential for a room, which grows on the way to the last
    values = cr.solve(worlds.doors()).values
    assert values[0] < values[3] < values[4] < values[6]


def test_the_mazes_of_silva_and_costa():
    # steps to the treasure: returns of 18.37, 261.5 and 1,455 are those of their logs
    for name, treasure, steps in (
        ("maze", 200, 20), ("line", 200, 9), ("pits", 2000, 20), ("six", 2000, 4)
    ):  # fmt: skip
        late = 0.9 ** (steps - 1)
        value = cr.solve(grids.maze(name, treasure)).start_value
        assert value == pytest.approx(late * treasure - (1 - late) / 0.1)
    study = read_study(tables.CLAIMS["graph"])
    read = {
        edge.source: edge.mapping.coverage().mapped for edge in study.curricula["sum"].transfers
    }
    assert all(share > 0 for share in read.values())
    assert read["near"] == 1.0  # the free grid has all cells of the maze


@pytest.mark.parametrize("name", FEW)
def test_the_tables(name, tmp_path):
    study = read_study(tables.CLAIMS[name], set=["seeds=8", *FEW[name]])
    made = audit(study, tmp_path / name, trials=1, progress=False)
    audits = tables.played(tmp_path)
    assert [*audits] == [name]
    rows = [*tables.rows(audits)]
    assert [row[1] for row in rows] == [*study.arms]
    assert all(len(row) == len(tables.HEADS) for row in rows)
    plan = next(iter(study.curricula.values()))
    target = Target.of(plan.tasks[plan.target])
    way = target.optimum - target.random_return
    contrasts = made.fair.comparison.contrasts
    for arm, column in ((rows[0][1], 4), (f"{rows[0][1]}, informed optimist", 7)):
        gain = contrasts[arm].strong_gain.estimate / way
        assert rows[0][column].startswith(f"{gain:+.2f} [")
    same = made.fair.comparison.against("scratch")[rows[0][1]].gain.estimate / way
    assert rows[0][3].startswith(f"{same:+.2f} [")
    assert {row[0] for row in tables.made_of(made)} == {"as configured", "fair"}


def test_the_mountain_car_of_wiewiora_cottrell_elkan():
    car = potentials.mountain_car()
    n, top = potentials.POSITIONS * potentials.VELOCITIES, car.terminal.argmax()
    assert (car.terminal.sum(), top) == (1, n)
    assert set(np.flatnonzero(car.start) // potentials.VELOCITIES) <= {11, 12, 13, 14, 15}
    on_actions, on_states = (
        advice(car) / potentials.SCALE for advice in (potentials.with_the_motion, potentials.energy)
    )
    np.testing.assert_array_equal(
        on_actions[[0, potentials.VELOCITIES - 1, n]], np.array([[1, 0, 0], [0, 0, 1], [0, 0, 0]])
    )
    assert on_states[top] == pytest.approx(1.0)
    assert on_states.min() == pytest.approx(0.0, abs=0.01)
    # the advice alone, without learning and without a time limit; the optimum is -99.6
    assert cr.evaluate(car, on_actions).start_value == pytest.approx(-130.8, abs=0.1)


def test_the_shift_of_mueller_and_kudenko_is_a_level():
    task = potentials.costly_grid(20)
    stated = potentials.linear_shifted(task), potentials.exponential_shifted(task)
    assert [(phi.min(), phi.max()) for phi in stated] == [(-100, -62), (-99, -68)]
    np.testing.assert_array_equal(potentials.linear(task), stated[0] + 100)
    study = read_study(tables.CLAIMS["bias"], set=["tasks.grid.budget=4_000"])
    low = read_study(
        tables.CLAIMS["bias"],
        set=["tasks.grid.budget=4_000", "tasks.grid.learner.initial_value=-100.0"],
    )
    shifted, started = (
        of.curricula[arm].train(range(20))["grid"].greedy_return
        for of, arm in ((study, "linear, shifted"), (low, "linear"))
    )
    np.testing.assert_allclose(shifted.mean(axis=0), started.mean(axis=0), atol=1.0)
    plain = study.curricula["linear"].train(range(20))["grid"].greedy_return
    assert shifted[:, -1].min() > -40 > -99 > plain[:, -1].max()


def test_the_iterations_of_adamczyk():
    # 82 or 83, and 62.55 on average at .291, are in their notebook
    assert potentials.iterations(0.0, 0) == potentials.iterations(0.0, 0, relaxed=1.0) == 82
    assert potentials.iterations(0.291, 0) in (62, 63)
    assert potentials.iterations(0.0, 0, relaxed=1.291) == pytest.approx(63, abs=1)
    after = potentials.moves(potentials.OPEN)
    best = (0.98**18 - 1) / 0.02
    for settings, last in (
        ((0.0, 0.9, -40.0, 0.1, False), best),
        ((0.5, 0.6, -15.0, 0.1, False), best),
        ((10.0, 1.0, 0.0, 0.1, False), -50),
        (potentials.OPTIMIST, best),
        (potentials.ARMS["optimist, eta"], best),
    ):
        returns = potentials.bootstrapped(after, settings, np.random.default_rng(0))
        assert returns[-1] == pytest.approx(last, abs=0.01)


def test_the_optimist_of_adamczyk_is_the_optimistic_learner():
    task = potentials.costly_grid(10, discount=0.98, time_limit=500)
    learner = cr.learning.OptimisticQLearning()
    result = cr.learn(task, learner, budget=10_000, eval_freq=100, seeds=20)
    ours = potentials.mean_returns(potentials.OPTIMIST, range(20))
    assert ours.mean() == pytest.approx(result.greedy_return[:, 1:].mean(), abs=3.0)


def test_a_rule_gets_its_best_of_the_trials():
    plain = potentials.PLAIN
    best = potentials.best_settings(plain, 6)
    assert (best.eta, best.optimist) == (0.0, False)
    returns = [potentials.mean_returns(of, range(33)).mean() for of in (plain, best)]
    assert returns[0] < returns[1]
    assert potentials.best_settings(plain, 0) == plain


def test_larger_claims_are_the_same_tasks_with_longer_sides():
    target = {"rooms": "cells", "graph": "maze", "objects": "maze"}
    for name in tables.LARGER:
        small, _, times = name.partition("_x")
        plans = [next(iter(tables.claim(of).curricula.values())) for of in (small, name)]
        before, after = (plan.tasks[target[small]].states.size for plan in plans)
        assert after == before * int(times) ** 2
        assert plans[1].transfers[0].mapping.coverage().mapped > 0
