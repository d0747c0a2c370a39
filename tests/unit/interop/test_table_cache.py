"""Tables in a file that the user names, and that says what they were made of."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.errors import StoreError, TaskError
from curricle.files import read_saved, write_saved
from curricle.interop import DeepCopy
from curricle.interop.tabulation import KIND
from tests.worlds_to_tabulate import Corridor, Counting, Slippery


def tabulated(path, *, make=Corridor, discount=0.5, seeds=2, **settings):
    return cr.tabulate(make, discount=discount, seeds=seeds, cache=path, **settings)


def assert_same(task, other):
    for name in ("probability", "next_state", "reward", "terminal", "start", "outcome_row"):
        np.testing.assert_array_equal(getattr(task.mdp, name), getattr(other.mdp, name))
    assert task.states == other.states
    assert task.actions == other.actions
    for name, part in task.observations.parts.items():
        np.testing.assert_array_equal(part, other.observations.parts[name])
        assert part.dtype == other.observations.parts[name].dtype


def test_tables_are_read_again(tmp_path):
    first = tabulated(tmp_path / "lamps")
    assert [path.name for path in tmp_path.iterdir()] == ["lamps.npz"]
    second = tabulated(tmp_path / "lamps.npz")
    assert_same(first, second)
    assert second.record == replace(first.record, cached=True)
    # Neither is in the tables.
    assert tabulated(tmp_path / "lamps", discount=0.9, time_limit=5).record.cached
    for name in ("FrozenLake-v1", "Taxi-v4"):  # which list their outcomes
        first, second = (cr.tabulate(name, discount=0.9, cache=tmp_path / name) for _ in range(2))
        assert second.record.cached
        assert_same(first, second)


OTHERS = {
    "seeds": {"seeds": 3},
    "an argument": {"cells": 5},
    "a hidden argument": {"make": lambda: Corridor(5)},
    "the state": {"state": DeepCopy(ignore=["cells"])},
    "functions": {
        "state": (
            lambda env: (env.place, env.lit),
            lambda env, s: (setattr(env, "place", s[0]), setattr(env, "lit", s[1])),
        )
    },
    "samples": {"samples": 3},
    "the environment": {"make": lambda: Slippery("environment", 0.0)},
}


def test_tables_of_something_else_are_refused(tmp_path):
    tabulated(tmp_path / "lamps")
    for aspect, settings in OTHERS.items():
        with pytest.raises(StoreError, match="a cache must hold tables of the same "):
            tabulated(tmp_path / "lamps", **settings)
        assert not tabulated(tmp_path / aspect, **settings).record.cached
        assert tabulated(tmp_path / aspect, **settings).record.cached


def test_functions_of_another_content_are_another_setting(tmp_path):
    def functions(content):
        def save(env, *, again=True):  # which holds itself, as what calls itself does
            return save(env, again=False) if again else (env.place, env.lit, content)

        return save, lambda env, state: vars(env).update(place=state[0], lit=state[1])

    for cached in (False, True):
        assert tabulated(tmp_path / "lamps", state=functions(1)).record.cached == cached
    with pytest.raises(StoreError, match="tables of the same settings"):
        tabulated(tmp_path / "lamps", state=functions(2))


def test_a_file_says_what_it_was_made_of(tmp_path):
    tabulated(tmp_path / "lamps")
    about = read_saved(tmp_path / "lamps", KIND).about
    assert about["classes"] == ["tests.worlds_to_tabulate.Corridor"]
    assert about["seeds"] == [0, 1]
    assert about["versions"]["curricle"] == cr.__version__


def test_another_process_reads_them(tmp_path):
    program = (
        "import curricle as cr, minigrid, sys; from tests import worlds_to_tabulate;"
        "world = getattr(worlds_to_tabulate, sys.argv[1].partition(':')[2], sys.argv[1]);"
        "print(cr.tabulate(world, discount=0.5, cache=sys.argv[2]).record.cached)"
    )
    for n, world in enumerate(("tests.worlds_to_tabulate:Corridor", "MiniGrid-Empty-5x5-v0")):
        printed = [
            subprocess.run(
                [sys.executable, "-c", program, world, str(tmp_path / str(n))],
                env={**os.environ, "PYTHONHASHSEED": seed},
                capture_output=True,
                text=True,
                check=True,
            ).stdout.strip()
            for seed in ("1", "2")
        ]
        assert printed == ["False", "True"]


def test_a_damaged_file_is_refused_and_left_alone(tmp_path):
    tabulated(tmp_path / "lamps")
    whole = (tmp_path / "lamps.npz").read_bytes()
    for content in (b"", whole[: len(whole) // 2], whole[:100] + b"x" + whole[101:]):
        (tmp_path / "lamps.npz").write_bytes(content)
        with pytest.raises(StoreError, match="was changed since, cut off, or"):
            tabulated(tmp_path / "lamps")
        assert (tmp_path / "lamps.npz").read_bytes() == content
    write_saved(tmp_path / "lamps", KIND, {}, read_saved_about(whole, tmp_path))
    with pytest.raises(StoreError, match="is not as tabulate"):
        tabulated(tmp_path / "lamps")


def read_saved_about(content, folder):
    (folder / "whole.npz").write_bytes(content)
    about = read_saved(folder / "whole", KIND).about
    return {name: value for name, value in about.items() if name not in ("kind", "format")}


def test_nothing_is_written_where_nothing_is_made(tmp_path):
    for make, settings in (
        (Counting, {"max_states": 50}),
        (lambda: Slippery("environment"), {}),
        (Corridor, {"max_seconds": 0}),
    ):
        with pytest.raises(TaskError):
            tabulated(tmp_path / "lamps", make=make, **settings)
    assert not list(tmp_path.iterdir())


def test_a_cache_that_cannot_be_written_is_refused_before_states_are_visited(tmp_path, monkeypatch):
    monkeypatch.setattr("curricle.interop.tabulation.Search", None)
    with pytest.raises(StoreError, match="a cache must be a file in a folder that can be written"):
        tabulated(tmp_path / "no folder" / "lamps")
