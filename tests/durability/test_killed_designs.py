"""A design killed at any moment goes on from its trainings, to the same recipe, byte for byte."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from curricle.errors import ConfigError
from curricle.study.recipes.designing import run_design

DESIGN = """
family = "maze"
[defaults]
pits = 0.2
[miniatures]
size = [4, 5]
seed = 3
[training]
steps = 10_000
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "design.toml").write_text(DESIGN)
    return tmp_path / "design.toml"


def assert_kills_change_nothing(file, kills, seed):
    script = Path(__file__).with_name("killed_designs.py")
    done = subprocess.run(
        [sys.executable, script, file, file.parent, str(kills), str(seed)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    killed = [int(line) for line in done.stdout.split()]
    assert sum(killed) >= kills
    whole = file.parent / "whole.toml"
    for attempt in range(len(killed)):
        again = file.parent / f"{attempt}.toml"
        assert again.read_bytes() == whole.read_bytes()
        names = (one.with_suffix(".trainings.jsonl") for one in (again, whole))
        assert len({one.read_bytes() for one in names}) == 1


def test_five_kills_change_nothing(file):
    assert_kills_change_nothing(file, 5, 0)


@pytest.mark.slow
def test_fifty_kills_change_nothing(file):
    assert_kills_change_nothing(file, 50, 1)


def test_trainings_of_another_design_are_refused(file):
    out = file.with_name("recipe.toml")
    out.with_suffix(".trainings.jsonl").write_text(json.dumps({"key": "a", "found": {}}) + "\n")
    with pytest.raises(ConfigError, match="holds another design: its training 1 is not that of"):
        run_design(file, "miniatures", out, budget=150_000, resume=True)
    assert not out.exists()
    assert out.with_suffix(".trainings.jsonl").exists()
