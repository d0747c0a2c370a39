"""A study killed at any moment goes on from what is whole, to the same results, bit for bit."""

import subprocess
import sys
from pathlib import Path

STUDY = """
name = "corner"
seeds = "0-3"
seeds_per_unit = 2
eval_freq = 200
[tasks.maze]
type = "maze"
map = '''
S...P
.F...
...PT
'''
budget = 4000
[tasks.corner]
type = "crop"
of = "maze"
rows = [1, 3]
columns = [2, 5]
budget = { max_steps = 2000, threshold = 100.0, patience = 2 }
[[transfers]]
source = "corner"
target = "maze"
mapping = "same_position"
[arms.initialise]
[arms.state]
shaping = "StateShaping"
"""
VOLATILE = {"runs.json", ".lock"}


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in files
        if path.name not in VOLATILE
    }


def test_fifty_kills_change_nothing(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    script = Path(__file__).with_name("killed.py")
    done = subprocess.run(
        [sys.executable, script, tmp_path / "study.toml", tmp_path, "50"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    kills = [int(line) for line in done.stdout.split()]
    assert sum(kills) >= 50
    whole = contents(tmp_path / "whole")
    assert {"study.json", "results.parquet", "decisions.parquet"} <= set(whole)
    for attempt in range(len(kills)):
        assert contents(tmp_path / str(attempt)) == whole
