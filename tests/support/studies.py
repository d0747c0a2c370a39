"""Study files that several tests read, and what reads them."""

import json
import textwrap
from pathlib import Path

import pytest

from curricle.errors import ConfigError
from curricle.study import StudyConfig, read_study

HUNT = """
name = "hunt"
opponents = []
seeds = "0-3"
seeds_per_unit = 2
threshold = -8.0
aggregate = "minimum"
[learner]
learning_rate = 0.2
epsilon = 0.1

[tasks.chase]
type = "pursuit"
size = 3
predators = 1
budget = 2_000

[tasks.hunt]
type = "pursuit"
size = 3
predators = 2
budget = 4_000

[[transfers]]
source = "chase"
target = "hunt"
project = { predator = "predator_1" }
scale = 2

[[transfers]]
source = "chase"
target = "hunt"
project = { predator = "predator_2" }
scale = 2
"""
OBSERVED_HUNT = """
name = "hunt"
seeds = 2
learner = { learning_rate = 0.2, epsilon = 0.2 }
aggregate = "minimum"
[tasks.chase]
type = "pursuit"
size = 3
predators = 1
budget = 3_000
[tasks.hunt]
type = "observation_task"
id = "Curricle/Pursuit-v0"
arguments = { size = 3, predators = 2, observation = "components" }
time_limit = 30
budget = 2_000
learner = { type = "deep", settings = { learning_rate = 1e-3 } }
[[transfers]]
source = "chase"
target = "hunt"
observations = "tests.support.hunters:first"
actions = [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 4, 4, 4, 4, 4]
[[transfers]]
source = "chase"
target = "hunt"
observations = "tests.support.hunters:second"
actions = [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0, 1, 2, 3, 4]
"""
MAZE = """
name = "maze"
opponents = []
[tasks.maze]
type = "maze"
map = '''
    ....T
    .PPP.
    S....
'''
"""
CORNER = f"""{MAZE}
[tasks.corner]
type = "crop"
of = "maze"
rows = [0, 2]
columns = [2, 5]
[[transfers]]
source = "corner"
target = "maze"
mapping = "same_position"
"""

# The crop is a part of the target, the middle task has a source and is one, the stopping rule ends
# each seed at its own step, and one arm doubles its source's values.
CHAIN = """
name = "chain"
opponents = []
seeds = 4
seeds_per_unit = 2
eval_freq = 50
[tasks.maze]
type = "maze"
map = '''
S...P
.#...
...PT
'''
time_limit = 40
budget = 600
[tasks.easy]
type = "maze"
map = '''
S....
.#...
...PT
'''
time_limit = 40
budget = 600
[tasks.corner]
type = "crop"
of = "maze"
rows = [1, 3]
columns = [2, 5]
eval_freq = 20
budget = { max_steps = 300, threshold = 194.5, patience = 3 }
[[transfers]]
source = "corner"
target = "easy"
mapping = "same_position"
[[transfers]]
source = "easy"
target = "maze"
mapping = "same_position"
[arms.chain]
[arms.state]
shaping = "StateShaping"
[[arms.scaled.transfers]]
source = "easy"
target = "maze"
mapping = "same_position"
scale = 2.0
"""
LINES = """
name = "lines"
opponents = []
seeds = 3
tasks.near = { type = "maze", map = "S.T", budget = 100 }
tasks.far = { type = "maze", map = "S...T", budget = 200 }
transfers = [{ source = "near", target = "far", mapping = "same_position" }]
"""


def reader(folder):
    """Return a function: text, what is set, name -> the study that a file of it describes."""

    def read_text(text, *, set=(), name="study.toml"):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(textwrap.dedent(text), "utf-8")
        return read_study(path, set=set)

    return read_text


OF_RUNS = {"runs.json", ".lock"}
"""Files that tell of a run and not of its results."""


def contents_of(folder):
    """Return what a folder's files hold, by name, and its folders; no caches of Python."""
    entries = (
        entry
        for entry in folder.rglob("*")
        if entry.name not in OF_RUNS and "__pycache__" not in entry.parts
    )
    return {
        str(entry.relative_to(folder)): entry.read_bytes() if entry.is_file() else None
        for entry in entries
    }


def only(study, arm="transfer"):
    """Return the curriculum of a study's only arm."""
    return study.curriculum(arm)


def again(study):
    """Return the study that its plain data describe, once they were a text."""
    return StudyConfig.from_data(json.loads(json.dumps(study.to_data())), study.folder)


NUMBERED_HUNT = """\
name = "hunt"
seeds = "0-3"

[learner]
epsilon = 0.1

[tasks.chase]
type = "pursuit"
size = 3
predators = 1
budget = 2_000

[tasks.hunt]
type = "pursuit"
size = 3

[[transfers]]
source = "chase"
target = "hunt"
project = { predator = "predator_1" }
"""
NUMBERED_MAZES = """\
name = "mazes"

[tasks.maze]
type = "maze"
map = '''
...T
S...
'''

[tasks.corner]
type = "crop"
of = "maze"
rows = [0, 2]
columns = [2, 4]

[[transfers]]
source = "corner"
target = "maze"
mapping = "same_position"
"""


def changed(text, *changes):
    """Return a text with new parts in place of old ones, each of which must be there once."""
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def complaints_of(text, *changes, set=()):
    """Return the sentences about a text, changed or not, at reading or at building."""
    Path("study.toml").write_text(textwrap.dedent(changed(text, *changes)), "utf-8")
    with pytest.raises(ConfigError) as caught:
        _ = read_study("study.toml", set=set).curricula
    lines = str(caught.value).splitlines()
    assert all(line.startswith("study.toml") for line in lines)
    return [line.removeprefix("study.toml").removeprefix(", ") for line in lines]
