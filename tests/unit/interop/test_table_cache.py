"""Tables on disk: found again by what made them, whole or not at all."""

import importlib
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.errors import StoreError, TaskError
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


def test_code_that_changed_is_noticed(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    text = (
        "from tests.worlds_to_tabulate import Corridor\n\n\nclass Mine(Corridor):\n    pays = 1\n"
    )
    from curricle.interop.tabulation import table_cache

    for version, found in ((text, False), (text, True), (text.replace("1", "2"), False)):
        (tmp_path / "mine_to_tabulate.py").write_text(version, "utf-8")
        importlib.invalidate_caches()
        sys.modules.pop("mine_to_tabulate", None)
        table_cache._source.cache_clear()
        module = importlib.import_module("mine_to_tabulate")
        assert tabulated(tmp_path / "cache", make=module.Mine).record.cached is found
    sys.modules.pop("mine_to_tabulate")


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


def test_a_cache_that_is_no_folder_is_refused_before_anything_is_done(tmp_path):
    (tmp_path / "file").write_text("mine", "utf-8")
    made = []
    with pytest.raises(StoreError, match=r"a cache must be a folder: .* is a file"):
        tabulated(tmp_path / "file", make=lambda: made.append(1) or Corridor())
    assert made == []
    with pytest.raises(StoreError, match="a cache must be a folder"):
        tabulated(tmp_path / "file" / "below")
    assert (tmp_path / "file").read_text("utf-8") == "mine"
