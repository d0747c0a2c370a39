"""Environments as exact tables, in a study file."""

import numpy as np
import pytest

import curricle as cr
from tests.studies import only, reader
from tests.worlds_to_tabulate import Corridor

WORLD = """
from tests.worlds_to_tabulate import Corridor, Slippery


def slippery():
    return Slippery("environment", 0.25)


def outcomes(state, action):
    place, lit = (int(part) for part in state)
    meant = (place, 1 - lit) if action == 2 else (min(place + 1, 3), lit) if action else None
    left = (max(place - 1, 0), lit)
    meant = left if meant is None else meant
    ends = meant[0] == 3
    return [(0.25, left, 0.0, False), (0.75, meant, float(ends and lit), ends)]


def corridor(cells=4):
    return Corridor(cells)
"""
STUDY = """
name = "lamps"
seeds = 2
budget = 300

[tasks]
short = { type = "tabulated", factory = "own:corridor", arguments = { cells = 3 } }
long = { type = "tabulated", factory = "own:corridor", reset_seeds = [0, 2], cache = "kept" }
listed = { type = "tabulated", factory = "own:slippery", outcomes = "own:outcomes" }
near = { type = "tabulated", factory = "own:slippery", samples = 400 }
lake = { type = "gymnasium", id = "FrozenLake-v1", live = true }
door = { type = "tabulated", id = "minigrid:MiniGrid-Empty-5x5-v0", time_limit = "none" }
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(WORLD, "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def alone(name):
    """Return the study with only one of its tasks."""
    lines = STUDY.splitlines()
    return "\n".join(line for line in lines if " type = " not in line or line.startswith(name))


def built(folder, name):
    study = reader(folder)(alone(name))
    assert only(type(study).from_data(study.to_data(), folder), *study.arms).tasks
    return only(study, *study.arms).tasks[name]


def assert_same(one, other):
    assert one.states == other.states
    for name in ("next_state", "reward", "terminal", "start"):
        np.testing.assert_array_equal(getattr(one.mdp, name), getattr(other.mdp, name))


def test_a_tabulated_environment_is_what_python_makes(folder):
    assert_same(built(folder, "short"), cr.tabulate(lambda: Corridor(3), discount=0.99))
    long = built(folder, "long")
    assert_same(long, cr.tabulate(Corridor, discount=0.99, seeds=[0, 2]))
    assert long.record.seeds == (0, 2)
    assert (folder / "kept.npz").exists()
    listed, near = built(folder, "listed"), built(folder, "near")
    assert (listed.exact, near.exact, near.record.samples) == (True, False, 400)
    assert cr.solve(listed).start_value == pytest.approx(cr.solve(near).start_value, abs=0.05)
    assert isinstance(built(folder, "lake"), cr.tasks.LiveMDP)
    door = built(folder, "door")
    assert (door.states.size, door.mdp.time_limit) == (34, None)
