"""A study killed at any moment goes on from what is whole, to the same results, bit for bit."""

import subprocess
import sys
from pathlib import Path

import pytest

STUDIES = {
    "maze": """
name = "corner"
opponents = []
seeds = "0-3"
seeds_per_unit = 2
eval_freq = 200
tasks.maze = { type = "maze", map = "S...P\\n.F...\\n...PT", budget = 4000 }
transfers = [{ source = "corner", target = "maze", mapping = "same_position" }]
arms.initialise = {}
arms.state = { shaping = "StateShaping" }
[tasks.corner]
type = "crop"
of = "maze"
rows = [1, 3]
columns = [2, 5]
budget = { max_steps = 2000, threshold = 100.0, patience = 2 }
""",
    "own_code": """
name = "own"
opponents = []
seeds = "0-3"
seeds_per_unit = 1
eval_freq = 200
budget = 2000
aggregate = "own:second"
tasks.short = { type = "factory", factory = "own:line", arguments = { length = 6 } }
tasks.long = { type = "factory", factory = "own:line", arguments = { length = 12 } }
transfers = [
    { source = "short", target = "long", function = "own:halves" },
    { source = "short", target = "long", mapping = "same_position", unmapped_value = 0.0 },
]
""",
    "stages": """
name = "stages"
opponents = []
seeds = "0-5"
seeds_per_unit = 2
eval_freq = 100
tasks.first = { type = "maze", map = "S...T", budget = 600 }
tasks.third = { type = "maze", map = "S......T", budget = 2000 }
transfers = [
    { source = "first", target = "second", mapping = "same_position" },
    { source = "second", target = "third", mapping = "same_position" },
]
[tasks.second]
type = "maze"
map = "S....T"
budget = { max_steps = 1000, threshold = 90.0, patience = 2 }
""",
    "live": """
name = "live"
opponents = []
seeds = "0-1"
seeds_per_unit = 1
eval_freq = 250
budget = 500
evaluation = { episodes = 10 }
tasks.cards = { type = "gymnasium", id = "Blackjack-v1" }
tasks.same = { type = "gymnasium", id = "Blackjack-v1" }
transfers = [{ source = "cards", target = "same", mapping = "identity" }]
""",
}
OWN = """
import curricle as cr
from .rules import TREASURE

def line(length):
    return cr.GridWorld("S" + "." * (length - 2) + "T", rewards=cr.Rewards(treasure=TREASURE))

def halves(state, action):
    return {"row": state["row"], "column": state["column"] // 2}, action

def second(potentials):
    return potentials[-1]
"""
VOLATILE = {"runs.json", ".lock"}


def contents(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in files
        if path.name not in VOLATILE
    }


def assert_kills_change_nothing(name, folder, kills, *more):
    (folder / "study.toml").write_text(STUDIES[name])
    (folder / "own.py").write_text(OWN)
    (folder / "rules.py").write_text("TREASURE = 50.0\n")
    script = Path(__file__).with_name("killed.py")
    done = subprocess.run(
        [sys.executable, script, folder / "study.toml", folder, str(kills), *more],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    *killed, left = (int(line) for line in done.stdout.split())
    assert sum(killed) >= kills
    assert left == 0
    whole = contents(folder / "whole")
    assert {"study.json", "results.parquet", "decisions.parquet"} <= set(whole)
    for attempt in range(len(killed)):
        assert contents(folder / str(attempt)) == whole


linux = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are of /proc")


@linux
def test_a_few_kills_change_nothing(tmp_path):
    assert_kills_change_nothing("maze", tmp_path, 3, "0")


@linux
@pytest.mark.slow
@pytest.mark.parametrize("how", ["threads", "processes"])
@pytest.mark.parametrize("name", STUDIES)
def test_of_200_kills_each_changes_nothing_and_leaves_no_process(tmp_path, name, how):
    seed = str(list(STUDIES).index(name))
    assert_kills_change_nothing(name, tmp_path, 25, seed, how)
