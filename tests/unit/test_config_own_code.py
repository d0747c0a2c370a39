"""Study files: functions of the user's own, mappings, and Gymnasium's environments."""

import json
import subprocess
import sys

import numpy as np
import pytest

import curricle as cr
from curricle.study import StudyConfig
from curricle.study.schema import load
from tests.studies import MAZE, only

# Functions of the user's own.

OWN = """
import numpy as np
import curricle as cr
from .rules import LONG

def line(length=LONG, treasure=200.0):
    return cr.GridWorld("S" + "." * (length - 2) + "T", rewards=cr.Rewards(treasure=treasure))

def flee(state):
    return np.tile([1.0, 0, 0, 0, 0], (len(state["prey"]), 1))

def second(potentials):
    return potentials[-1]

def halves(state, action):
    return {"row": state["row"], "column": state["column"] // 2}, action

def same(target, source):
    return cr.same_position(target, source, unmapped_value=-3)
"""
LINES = """
name = "lines"
aggregate = "own:second"
[tasks]
short = { type = "factory", factory = "own:line", arguments = { length = 4, treasure = 3 } }
long = { type = "factory", factory = "own:line" }
[[transfers]]
source = "short"
target = "long"
function = "own:halves"
unmapped_value = -7
[[transfers]]
source = "short"
target = "long"
factory = "own:same"
"""


@pytest.fixture
def own(tmp_path):
    def write(folder, length):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "own.py").write_text(OWN)
        (tmp_path / folder / "rules.py").write_text(f"LONG = {length}\n")
        return tmp_path / folder

    return write


def test_functions_are_found_beside_the_file(read, own):
    own(".", 8)
    before = list(sys.path)
    curriculum = only(read(LINES))
    assert sys.path == before
    assert curriculum.tasks["short"] == cr.GridWorld("S..T", rewards=cr.Rewards(treasure=3))
    assert curriculum.tasks["long"] == cr.GridWorld("S......T")
    half, same = (transfer.mapping for transfer in curriculum.transfers)
    assert half.unmapped_value == -7
    assert half.index[:, 0].tolist() == [0, 0, 4, 4, 8, 8, -2, -2]
    assert same.unmapped_value == -3
    chosen = curriculum.setting("aggregate", "long")
    assert chosen(np.array([[[1.0]], [[2.0]]])) == 2


def test_modules_of_one_name_in_two_folders_stay_apart(read, own):
    own("a", 5), own("b", 6)
    one, other = read(LINES, name="a/study.toml"), read(LINES, name="b/study.toml")
    assert [only(study).tasks["long"].states.size for study in (one, other, one)] == [5, 6, 5]
    assert "own" not in sys.modules
    again = StudyConfig.from_data(one.to_data(), other.folder)
    assert only(again).tasks["long"].states.size == 6


def test_a_module_beside_the_file_comes_first(tmp_path):
    (tmp_path / "json.py").write_text("def dumps(): return 'mine'")
    assert load("json:dumps", tmp_path)() == "mine"
    assert json.dumps([]) == "[]"


def test_a_prey_may_be_a_function(read, own):
    own(".", 8)
    study = read("name='x'\ntasks.hunt={type='pursuit', size=2, prey='own:flee'}")
    probability = only(study).tasks["hunt"].mdp.probability
    assert (probability == [1, 0, 0, 0, 0]).all()


def test_other_mappings(read):
    words = MAZE + "[tasks.near]\ntype='crop'\nof='maze'\nrows=[0,3]\ncolumns=[0,5]\nstart='map'\n"
    edge = "[[transfers]]\nsource='near'\ntarget='maze'\n"
    maze = cr.GridWorld(["....T", ".PPP.", "S...."])
    for name in ("identity", "same_position", "relative_objects"):
        curriculum = only(read(f"{words}{edge}mapping='{name}'"))
        expected = cr.same_position(maze, maze).index
        np.testing.assert_array_equal(curriculum.transfers[0].mapping.index, expected)


# -- modules are named before they run -----------------------------------------------------------


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
