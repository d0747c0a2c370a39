"""A study's modules are named on the terminal before they are imported."""

import subprocess
import sys

import pytest

RULES = """
import sys
print("RUNS", file=sys.stderr, flush=True)
import curricle as cr

def maze():
    return cr.GridWorld("S.T")
"""
STUDY = """
name = "own"
budget = 100
seeds = 1
[tasks.maze]
type = "factory"
factory = "rules:maze"
"""


@pytest.mark.parametrize("command", [["check"], ["run", "--dry-run"]])
def test_a_module_is_named_before_it_runs(tmp_path, command):
    (tmp_path / "rules.py").write_text(RULES)
    (tmp_path / "own.toml").write_text(STUDY)
    done = subprocess.run(
        [sys.executable, "-m", "curricle", *command, "own.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    named = lines.index("importing the study's module rules, beside the study file")
    assert named < lines.index("RUNS")
    assert lines.count("RUNS") == 1
