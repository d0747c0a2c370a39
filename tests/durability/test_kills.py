"""A study killed at any moment goes on from what is whole, to the same results, bit for bit."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.sent_folders import RULES, STUDY as OWN_CODE
from tests.support.studies import CHAIN, CORNER, contents_of

LIVE = """
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
"""
TUNED = f"{CHAIN}[tune]\ntrials = 2\nseeds = 1\n[tune.space]\nlearner.epsilon = [0.1, 0.3]\n"
CHOSEN = """
name = "chosen"
seeds = 2
budget = 300
eval_freq = 100
choose = true
[tasks.line]
type = "maze"
map = "S...T"
"""
LINE = CHOSEN.replace("choose = true\n", "opponents = []\n")
AUDITED = f"seeds = 2\nbudget = 300\neval_freq = 100\n{CORNER}"
MOVED = {"run": TUNED, "choose": CHOSEN, "report": LINE, "audit": AUDITED}
STUDIES = {"chain": CHAIN, "own_code": OWN_CODE, "live": LIVE}


def assert_kills_change_nothing(name, folder, kills, *more):
    (folder / "study.toml").write_text(STUDIES[name])
    (folder / "rules.py").write_text(RULES)
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
    whole = contents_of(folder / "whole")
    assert {"study.json", "results.parquet", "decisions.parquet"} <= set(whole)
    for attempt in range(len(killed)):
        assert contents_of(folder / str(attempt)) == whole


linux = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are of /proc")


def untimed(folder):
    """Return what a folder's files hold, its pages without the times at which runs started."""
    contents = contents_of(folder)
    for page in (name for name in contents if name.endswith(".html")):
        contents[page] = re.sub(rb"20\d\d-[-:T+\d]+", b"", contents[page])
    return contents


def assert_each_rename_may_be_the_last(name, folder, *first):
    (folder / "study.toml").write_text(MOVED[name])
    script, command = Path(__file__).with_name("killed_at_a_rename.py"), name
    arguments = ["run" if name == "choose" else command, folder / "study.toml", folder, *first]
    done = subprocess.run([sys.executable, script, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    whole, attempts = untimed(folder / "whole"), [*folder.glob("[0-9]*.moves")]
    assert len(attempts) == (abs(int(first[0])) if first else int(done.stdout))
    for attempt in attempts:
        assert untimed(attempt.with_suffix("")) == whole


@linux
@pytest.mark.parametrize(("name", "last"), [("run", "-5"), ("choose", "-1")])
def test_a_run_with_trials_killed_at_one_of_its_last_renames_is_completed(tmp_path, name, last):
    assert_each_rename_may_be_the_last(name, tmp_path, last)


@linux
@pytest.mark.slow
@pytest.mark.timeout(3600)  # a choice moves 324 files
@pytest.mark.parametrize("name", MOVED)
def test_a_kill_at_each_rename_changes_nothing(tmp_path, name):
    assert_each_rename_may_be_the_last(name, tmp_path)


@linux
def test_a_few_kills_change_nothing(tmp_path):
    assert_kills_change_nothing("chain", tmp_path, 2, "0")


@linux
@pytest.mark.slow
@pytest.mark.parametrize("how", ["threads", "processes"])
@pytest.mark.parametrize("name", STUDIES)
def test_of_200_kills_each_changes_nothing_and_leaves_no_process(tmp_path, name, how):
    seed = str(list(STUDIES).index(name))
    assert_kills_change_nothing(name, tmp_path, 25, seed, how)
