"""Environments as exact tables, in a study file."""

import numpy as np
import pytest

import curricle as cr
from tests.studies import only, reader
from tests.worlds_to_tabulate import Corridor

WORLD = """
from tests.worlds_to_tabulate import Corridor


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
    door = built(folder, "door")
    assert (door.states.size, door.mdp.time_limit) == (34, None)
