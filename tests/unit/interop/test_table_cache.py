"""Tables on disk: found again by what made them, whole or not at all."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

import curricle as cr
from curricle.errors import SettingError, StoreError, TaskError
from curricle.interop import DeepCopy
from tests.worlds_to_tabulate import Corridor, Counting, Slippery


def tabulated(folder, *, make=Corridor, discount=0.5, seeds=2, **settings):
    return cr.tabulate(make, discount=discount, seeds=seeds, cache=folder, **settings)


def assert_same(one, other):
    for name in ("probability", "next_state", "reward", "terminal", "start", "outcome_row"):
        np.testing.assert_array_equal(getattr(one.mdp, name), getattr(other.mdp, name))
    assert one.states == other.states
    assert one.actions == other.actions
    for name, part in one.observations.parts.items():
        np.testing.assert_array_equal(part, other.observations.parts[name])
        assert part.dtype == other.observations.parts[name].dtype


def test_tables_are_found_again(tmp_path):
    folder = tmp_path / "not" / "there"
    first = tabulated(folder)
    assert sorted(path.suffix for path in folder.iterdir()) == [".json", ".npz"]
    second = tabulated(folder)
    assert_same(first, second)
    assert second.record == replace(first.record, cached=True)
    assert tabulated(folder, discount=0.9, time_limit=5).record.cached  # neither is in the tables
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("name", ["FrozenLake-v1", "Taxi-v4"])
def test_listed_tables_are_found_again(tmp_path, name):
    first, second = (cr.tabulate(name, discount=0.9, cache=tmp_path) for _ in range(2))
    assert second.record.cached
    assert_same(first, second)


OTHERS = {
    "seeds": {"seeds": 3},
    "an argument": {"cells": 5},
    "the state": {"state": DeepCopy(ignore=["nothing"])},
    "functions": {
        "state": (
            lambda env: (env.place, env.lit),
            lambda env, s: (setattr(env, "place", s[0]), setattr(env, "lit", s[1])),
        )
    },
    "samples": {"samples": 3},
    "the environment": {"make": lambda: Slippery("environment", 0.0)},
}


@pytest.mark.parametrize("what", OTHERS)
def test_other_tables_are_not_confused(tmp_path, what):
    tabulated(tmp_path)
    assert not tabulated(tmp_path, **OTHERS[what]).record.cached
    assert tabulated(tmp_path, **OTHERS[what]).record.cached


CODE = """
from tests.worlds_to_tabulate import Corridor
from {rules} import PAYS, pays


class Mine(Corridor):
    def step(self, action):
        seen, reward, *rest = super().step(action)
        return seen, pays(reward) + PAYS, *rest
"""
RULES = """
import random
import numpy as np

PAYS, FACTOR, TABLE = 0, 1, {"lit": [np.ones(2), np.zeros(2)]}


def pays(reward):
    return helped(reward) * FACTOR + TABLE["lit"][1][0]


def helped(reward):
    return reward
"""
CHANGES = {
    "nothing": ("", ""),
    "a constant": ("PAYS, FACTOR, TABLE = 0", "PAYS, FACTOR, TABLE = 2"),
    "a constant of a function": ("= 0, 1", "= 0, 2"),
    "an array": ("np.zeros(2)", "np.ones(2)"),
    "a function": ("    return reward\n", "    return -reward\n"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_code_that_changed_is_noticed(tmp_path, monkeypatch, what):
    """Wherever it is: in the class's module, in one that this imports, or in no file at all."""
    found = []
    for old, new in (CHANGES["nothing"], CHANGES[what]):
        for name, text in (("its_rules", RULES.replace(old, new)), ("its_world", CODE)):
            module = ModuleType(name)
            monkeypatch.setitem(sys.modules, name, module)
            exec(text.replace("{rules}", "its_rules"), vars(module))  # as a notebook does
        found.append(tabulated(tmp_path, make=module.Mine).record.cached)
    assert found == [False, what == "nothing"]


@pytest.mark.parametrize("world", ["tests.worlds_to_tabulate:Corridor", "MiniGrid-Empty-5x5-v0"])
def test_another_process_finds_tables(tmp_path, world):
    program = (
        "import curricle as cr, minigrid, sys; from tests import worlds_to_tabulate;"
        "world = getattr(worlds_to_tabulate, sys.argv[1].partition(':')[2], sys.argv[1]);"
        "print(cr.tabulate(world, discount=0.5, cache=sys.argv[2]).record.cached)"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", program, world, str(tmp_path)],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for seed in ("1", "2")
    ]
    assert found == ["False", "True"]


@pytest.mark.parametrize("suffix", ["npz", "json"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: content[:100] + b"x" + content[101:],
        lambda content: None,
    ],
    ids=["empty", "half", "a byte", "gone"],
)
def test_damaged_tables_are_made_anew(tmp_path, suffix, damage):
    first = tabulated(tmp_path)
    (path,) = tmp_path.glob(f"*.{suffix}")
    damaged = damage(path.read_bytes())
    if damaged is None:
        path.unlink()
    else:
        path.write_bytes(damaged)
    again = tabulated(tmp_path)
    assert_same(first, again)
    found = tabulated(tmp_path)
    assert found.record.cached
    assert_same(first, found)


def test_a_format_of_another_version_is_made_anew(tmp_path):
    tabulated(tmp_path)
    (path,) = tmp_path.glob("*.json")
    about = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps({**about, "format": 0}), "utf-8")
    assert not tabulated(tmp_path).record.cached


def test_nothing_is_written_where_nothing_is_made(tmp_path):
    folder = tmp_path / "cache"
    for make, settings in (
        (Counting, {"max_states": 50}),
        (lambda: Slippery("environment"), {}),
        (Corridor, {"max_seconds": 0}),
    ):
        with pytest.raises(TaskError):
            tabulated(folder, make=make, **settings)
    assert not folder.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_a_cache_that_cannot_be_written_to_is_refused_before_states_are_visited(
    monkeypatch,
):
    monkeypatch.setattr("curricle.interop.tabulation.plan.explore", None)
    rule = "a cache must be a folder that can be written to: .* failed with "
    with pytest.raises(StoreError, match=rule):
        tabulated("/proc/no folder")


def test_a_cache_that_cannot_be_written_to_is_read(tmp_path, monkeypatch):
    first = tabulated(tmp_path)
    monkeypatch.setattr("curricle.interop.tabulation.table_cache.write_whole", None)
    monkeypatch.setattr("curricle.interop.tabulation.table_cache.part_in", None)
    assert_same(first, tabulated(tmp_path))


@pytest.mark.parametrize("cache", [3, True, ["tables"], ""])
def test_a_cache_is_named_by_a_path(cache):
    with pytest.raises(SettingError, match="cache must be the path of a folder: got"):
        tabulated(cache)


def test_a_cache_that_is_no_folder_is_refused_before_anything_is_done(tmp_path):
    (tmp_path / "file").write_text("mine", "utf-8")
    made = []
    with pytest.raises(StoreError, match=r"a cache must be a folder: .* is a file"):
        tabulated(tmp_path / "file", make=lambda: made.append(1) or Corridor())
    assert made == []
    with pytest.raises(StoreError, match="a cache must be a folder"):
        tabulated(tmp_path / "file" / "below")
    assert (tmp_path / "file").read_text("utf-8") == "mine"
