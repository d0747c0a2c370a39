"""The published settings of docs/what_survives.md: their facts, their audits, and the tables."""

import json

import numpy as np
import pytest

import curricle as cr
from benchmarks.published import __main__ as tables, worlds
from curricle.study import audit, read_study
from curricle.study.auditing import as_configured, as_fair

FEW = {
    "office": ["budget=2_000", "tasks.office.budget=2_000", "tasks.office.eval_freq=200"],
    "grid": ["tasks.grid.budget=1_000", "tasks.grid.eval_freq=100"],
}


@pytest.mark.parametrize("name", tables.CLAIMS)
def test_every_claim_can_be_audited(name):
    study = read_study(tables.CLAIMS[name])
    assert len(study.seeds) == 100
    assert as_configured(study).scratch_curricula()
    if name != "grid_50":  # which takes seconds to solve
        fair = as_fair(study, 2)
        assert {len(plan.tasks) for plan in fair.tune.arms.values()} <= {
            len(plan.tasks) for plan in study.arms.values()
        }
        assert len(fair.tune.variants) == 3 * (len(study.arms) + 1)
        json.dumps(fair.to_data())


def test_the_grid_of_ng_harada_russell():
    task = worlds.open_grid(10)
    # 18 steps at .85 - .05 a step each way, a little more at the edges
    assert cr.solve(task).start_value == pytest.approx(-21.8, abs=0.1)
    phi = worlds.distance(np.zeros((1, 100, 4)))
    start = int(task.start.argmax())
    assert phi[start, 0] == -18 / 0.8
    assert phi[task.terminal].max() == 0.0
    np.testing.assert_array_equal(worlds.half_distance(np.zeros((1, 100, 4))), phi / 2)


def test_the_office_of_toro_icarte():
    for as_run, steps in (True, 23), (False, 29):  # to the only reward
        best = cr.solve(worlds.office(as_run=as_run)).start_value
        assert 1 + np.log(best) / np.log(0.9) == pytest.approx(steps)
    office = worlds.office()
    states = office.automaton.states
    potentials = worlds.machine_values(np.zeros((1, office.states.size, 4)))
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


@pytest.mark.parametrize("name", FEW)
def test_the_tables(name, tmp_path):
    study = read_study(tables.CLAIMS[name], set=["seeds=8", *FEW[name]])
    made = audit(study, tmp_path / name, trials=1, progress=False)
    audits = tables.played(tmp_path)
    assert [*audits] == [name]
    rows = [*tables.rows(audits)]
    assert [row[1] for row in rows] == [*study.arms]
    assert all(len(row) == len(tables.HEADS) for row in rows)
    low, high = (getattr(made.fair.comparison.reference, at) for at in ("random_return", "optimum"))
    gain = made.fair.comparison.contrasts[rows[0][1]].strong_gain.estimate / (high - low)
    assert rows[0][4].startswith(f"{gain:+.2f} [")
    assert {row[0] for row in tables.made_of(made)} == {"as configured", "fair"}
