"""What is wrong with study files: a sentence for each mistake, with its line and key path."""

import re
import textwrap
import tomllib
from pathlib import Path

import pytest

from curricle.errors import ConfigError
from curricle.study import read_study
from curricle.study_file.file import line_numbers
from curricle.study_file.own_code import load
from tests.support.studies import (
    NUMBERED_HUNT as HUNT,
    NUMBERED_MAZES as MAZES,
    OBSERVED_HUNT,
    complaints_of,
)
from tests.unit.test_config_families import HUNT as MEMBERS, LANES, OWN_FAMILY, STARTS
from tests.unit.test_config_own_code import ENCODED, OWN_LEVEL, OWN_ROOM, ROOMS
from tests.unit.test_config_sweeps import MAZES as SWEPT
from tests.unit.test_deep_config import CART, DEEP, FIRST, OWN as OWN_CART

TUNED = f"{SWEPT}[tune.space]\nlearner.epsilon = {{ low = 0.1, high = 0.3 }}\n"
PLACED = f'{HUNT}[sweep]\n"learner.learning_rate" = ["fast"]\n'
LEVEL = ENCODED.replace("ENCODE", "'MiniGridView'")
SHORT = {
    "LEARNER": "[learner]\nepsilon = 0.1",
    "KIND": 'type = "pursuit"\nsize = 3\npred',
    "PROJECT": 'project = { predator = "predator_1" }',
    "CROP": "[tasks.part]\ntype = 'crop'\nof = 'hunt'\nrows = [0, 1]\ncolumns = [0, 1]\n",
    "BACK": "[[transfers]]\nsource = 'hunt'\ntarget = 'chase'\nproject = {}\n",
    "TURNED": "transfers = [{ source = 'hunt', target = 'chase', project = {} }]",
    "START": "{ distance = [1, 3] }",
    "VIEW": "'MiniGridView'",
    "RING": 'family = "pursuit"\nsize = 3\npredators = 1',
    "GUARD": "shaping = { portfolio = true, type =",
    "FIRST": FIRST,
    "DEEP": DEEP,
    "SEEN": '[tasks.cart]\ntype = "observation_task"\nid = "CartPole-v1"\ndiscount = 0.98',
    "TABLE": '[tasks.cart]\ntype = "maze"\nmap = "ST"\nlearner = { type = "QLearning" }',
    "RATES": "learner.learning_rate=[0.1, 0.3]",
}
"""Longer texts, as the table below has them."""
FILES = {
    "hunt": HUNT,
    "mazes": MAZES,
    "members": MEMBERS,
    "lanes": LANES,
    "starts": STARTS,
    "rooms": ROOMS,
    "level": LEVEL,
    "network": OBSERVED_HUNT,
    "cart": CART,
    "swept": SWEPT,
    "tuned": TUNED,
    "placed": PLACED,
}
OWN = {"members": OWN_FAMILY, "lanes": OWN_FAMILY, "rooms": OWN_ROOM, "level": OWN_LEVEL}
OWN |= {"network": OWN_CART, "cart": OWN_CART}
MISTAKES = r"""
[hunt]
+ | [tasks.other]\ntype = 'pursuit' | line 7: tasks must have one that no other builds
+ | BACK | line 17: transfers must have no cycle: got
+ | CROP | line 23: tasks.part.of must name a task of type maze, crop, … : got 'hunt'
+ | [arms.scratch] | line 21: arms.scratch must have another name: it is the arm without
+ | [arms.a]\ntasks.chace.size = 5 | line 22: arms.a.tasks.chace is unknown, did you
+ | [arms.a]\nseeds = 3 | line 22: arms.a.seeds is unknown: known are tasks, transfers,
+ | [arms.a]\ntransfers = [1] | line 22: arms.a.transfers[0] must name transfers of the
+ | [arms.a]\ntasks.chase.budget = 2_000 | line 21: arms.a changes nothing: its settings
+ | [arms.a]\n[arms.b]\nTURNED | line 21: arms must all have the same target: a has hunt
tasks.chse.budget=3 | as set: tasks.chse is unknown, did you mean 'chase'?
transfers.4.scale=3 | as set: transfers[4] is unknown: known are 0
tasks.chase.time_limit=0 | line 7, as set: tasks.chase is refused: time_limit in
snapshots=-1 | as set: snapshots must be at least 0: got -1
shaping=WeightTransfer | as set: shaping must be for tables, to learn hunt: got 'WeightTransfer'
PROJECT | observations = 'own:at' | transfers[0].observations must be left out: hunt
KIND | type = "persuit"\npred | line 8: tasks.chase.type must be one of maze, crop,
PROJECT | mapping = 'same_positon' | line 20: transfers[0].mapping must be 'identity',
LEARNER | shaping.portfolio = 3 | line 4: shaping.portfolio must be true, false or a table: got
epsilon = 0.1 | epsilon = nan | line 5: learner.epsilon must be finite: got nan
source = "chase" | source = "chse" | line 18: transfers[0].source must … 'chase'?
PROJECT | project = {}\naligned.predator = 'end' | transfers[0].aligned.predator must be 'first',
PROJECT | PROJECT\naligned.tiger = 1 | transfers[0] is refused: aligned names components of
PROJECT | mapping = 'identity'\nunequal = 'clip' | transfers[0] has aligned or unequal, which go
PROJECT | mapping = 'identity'\nPROJECT | line 17: transfers[0] … project, mapping
PROJECT | function = 'cart' | line 20: transfers[0].function must name … got 'cart'
[mazes]
of = "maze" | of = 'corner' | line 12: tasks.corner.of must lead to a whole task: got
rows = [0, 2] | rows = [0, 2]\nstart = 'here' | line 14: tasks.corner.start must be
map = ''' | file = 'm.txt'\nmap = ''' | line 3: tasks.maze has both map and file: one
...T\nS... | ...T\nS.. | line 3: tasks.maze is refused: all lines of a map must be
mapping = "same_position" | project.row = 'raw' | component (row, column): got 'raw'
mapping = "same_position" | factory = 'own:f'\nunmapped_value = 3 | line 16: transfers[0] has
[members]
torus = true | torus = 1 | line 10: tasks.chase.torus must be True or False: got 1
size = 3 | size = 2000 | line 8: tasks.chase.size must lie in [2
predators = 1 | predators = 1\ncapture = 2 | line 6: tasks.chase is refused: capture
RING | type = "pursuit"\nsize = 3 | line 24: transfers[0].mapping must map members of
[lanes]
length = 4 | length = 4, limit = 0.5 | line 6: tasks.short.limit must be a whole
length = 4 | length = 4, treasure = 13 | own:corridor failed: RuntimeError: no luck
family = "own:corridor" | family = "own:plain" | own:plain must be a TaskFamily
family = "own:corridor" | family = "own:lane" | own:lane has the parameter budget, which is a key of
[starts]
START | "reachble" | line 12: tasks.near.start_states must be 'uniform', 'reachable', or a
START | { distance = [3, 1] } | line 12: tasks.near.start_states.distance must be steps from
START | {} | line 12: tasks.near.start_states must have distance or visits: got neither
[rooms]
factory = "own:Room" | id = "own:Room" | ; a class or function of your own is named by
factory = "own:Room" | id = "a", factory = "own:Room" | id or factory: got both
, "column" |  | in the order of state_1, state_2: got 1, row
[level]
VIEW | 'MiniGridFullView' | must be a table, as MiniGridFullView needs width and height
VIEW | { type = 'MiniGridFullView', width = 4, height = 9 } | must fit into its encoder's 4 x
VIEW | 'own:half' | own:half failed with TypeError
[network]
id = | start_states = "uniform"\nid = | tasks.hunt.start_states must be left out for hunt
DEEP |  | line 4: learner must be { type = "deep", ... } for hunt, which is seen
aggr | GUARD 'QInitialisation' }\naggr | a portfolio is for QLearning alone
aggr | GUARD 'PolicyReuse' }\naggr | shaping.portfolio is unknown
budget = 3_000 | learner = { type = "deep" } | line 10: tasks.chase.learner must be
"deep",  | "deep", envs = 0,  | line 17: tasks.hunt.learner is refused: envs of a
aggregate = "minimum" | shaping = "RewardBonus" | line 5: shaping must be one of
FIRST | mapping = "same_position" | line 21: transfers[0].mapping must be left out, or
FIRST | factory = "own:broken" | line 18: transfers[0] is refused: own:broken failed:
FIRST | factory = "own:made"\nactions = [1] | line 18: transfers[0] has actions or
FIRST | observations = "own:leaning"\nactions = "left" | line 22: transfers[0].actions
learning_rate = 1e-3 | policy_kwargs = 8 | policy_kwargs of a deep learner must be a
[tasks.chase] | [tasks.x]\ntype = 'observation_task'\n[tasks.chase] | line 6: tasks.x
[cart]
id = "CartPole-v1" | id = "CratPole-v1" | tasks.short is refused: an environment must
id = "CartPole-v1" | factory = "own:no_environment" | tasks.short is refused: make
SEEN | TABLE | transfers[0].source must have tables as its target has: short is seen through
[swept]
sweep.tasks.corner.rows=[[0, 9]] | sweep.tasks.corner.rows is refused: a crop must lie
sweep.learner.epsilon=[1, 1] | must be a list of different values: 1 is there twice
sweep.budget=[1, 2] | changes nothing: each task or arm that it could apply to sets it
sweep.tasks.maze.budget=[1, 2] | must leave the target maze as it is
sweep.tasks=[1] | a key of one of the tasks, such as tasks.maze.budget
sweep.seeds=[1, 2] | must name a setting of tasks or transfers: seeds is unknown
sweep.RATES & sweep.unknown_value=[0.0] & sweep.mode=paired | must have as many values as
sweep.RATES & tune.space.RATES | is swept already: leave out one of
[tuned]
tune.space.learner.epsilon.low=1 | epsilon.high must be above low, 1: got 0.3
tune.space.tasks.corner.budget={ low = 10.0, high = 90.0 } | must be a whole number:
scratch=false | tune needs the comparison with scratch, … leave out scratch = false
"""
"""Of each file: what is set (by &), or a text and what takes its place (+ at the end); what the
sentence has (… and its end)."""
ROWS = [
    (name, *row.split(" | "))
    for name, rows in re.findall(
        r"^\[(\w+)\]\n(.*?)(?=^\[\w+\]$|\Z)", MISTAKES, re.MULTILINE | re.DOTALL
    )
    for row in rows.splitlines()
]


@pytest.mark.parametrize("row", ROWS, ids=" ".join)
def test_a_mistake_is_a_sentence_with_its_place(tmp_path, monkeypatch, row):
    name, *changes, fragment = row
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN.get(name, ""), "utf-8")
    if name == "level":
        pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
    text, cells = FILES[name], []
    for cell in changes:
        for short, long in SHORT.items():
            cell = cell.replace(short, long)
        cells.append(cell.replace("\\n", "\n"))
    if len(cells) == 1:
        lines = complaints_of(text, set=cells[0].split(" & "))
    else:
        assert cells[0] == "+" or cells[0] in text
        lines = complaints_of(text + cells[1] if cells[0] == "+" else text.replace(*cells, 1))
    begin, _, end = fragment.partition(" … ")
    (line, *_) = [line for line in lines if begin in line and line.endswith(end)]
    assert "line " in line or "as set: " in line


def test_values_that_are_too_long(complaints):
    digits = f"budget = 1{400 * '0'}"
    (line,) = complaints(HUNT, ("budget = 2_000", digits))
    assert line.startswith("line 11: tasks.chase.budget must")
    assert line.endswith("00...")
    (line,) = complaints(SWEPT, set=[f"sweep.aggregate=['own:{120 * 'a'}', 'mean']"])
    assert "sweep makes an arm with a name that" in line
    (line,) = complaints(SWEPT, set=[f"sweep.unknown_value={[*range(101)]}"])
    assert "must make at most 100 arms: got 101 values" in line


def test_a_map_s_file_that_cannot_be_read(complaints, tmp_path):
    text = "name = 'x'\n[tasks.maze]\ntype = 'maze'\nfile = 'maze.txt'\n"
    assert complaints(text) == [
        "line 4: tasks.maze.file cannot be read: 'maze.txt', No such file or directory"
    ]
    (tmp_path / "maze.txt").write_bytes(b"\xff\xfe")
    assert "cannot be read: 'maze.txt', it is not UTF-8" in complaints(text)[0]


def test_a_mistake_of_the_study_is_told_once_however_many_arms_share_it(complaints):
    arms = "[arms.a]\n[arms.b]\ntransfers = [0]\ntasks.hunt.budget = 3\n"
    assert complaints(HUNT + arms, ("size = 3\npred", "size = 'x'\npred")) == [
        "line 9: tasks.chase.size must be a whole number: got 'x'"
    ]


def test_all_that_is_refused_is_told_at_once(complaints):
    changes = [
        ("...T\nS...", "...T\nS.."),
        ("[[tr", "learner.epsilon = 2\nbudget = 9\neval_freq = 0\n[[tr"),
    ]
    assert [line.split(" is refused")[0] for line in complaints(MAZES, *changes)] == [
        "line 3: tasks.maze",
        "line 16: tasks.corner.learner",
        "line 18: tasks.corner.eval_freq",
    ]


OWN_MODULES = {"own": "NUMBER = 3", "broken": "import nobody_has", "false": "def make(:"}
REFUSED = [
    (lambda: load("own", Path()), "a function must be named as module:function: got 'own'"),
    (lambda: load("nobody_has:make", Path()), "nobody_has:make names no module: nobody_has is"),
    (lambda: load("own:NUMBER", Path()), "own:NUMBER names no function: own has no NUMBER"),
    (lambda: load("broken:make", Path()), "broken:make failed: ModuleNotFoundError: No module"),
    (lambda: load("false:make", Path()), "false:make failed: SyntaxError: "),
    (lambda: read_study("missing.toml"), "missing.toml cannot be read: No such file"),
    (lambda: read_study("a" * 5000), "a ... cannot be read: File name too long"),
    (lambda: read_study("latin.toml"), "latin.toml cannot be read: it is not UTF-8"),
    (lambda: read_study("none.toml"), "none.toml is not valid TOML: Invalid value (at line 1"),
    (lambda: read_study(3), "a study file must be a path: got 3"),
    (lambda: read_study("hunt.toml", set="a=1"), "set must be a list of settings, each key=value"),
    (lambda: read_study("hunt.toml").curriculum("trasfer"), "hunt.toml: arm 'trasfer' is unknown"),
    (
        lambda: read_study("hunt.toml", arms=["trasfer"]),
        "arm 'trasfer' is unknown, did you mean 't",
    ),
    *(
        (lambda change=change: read_study("hunt.toml", set=[change]), "a setting must be key=")
        for change in (3, "tasks", "=3", "a b=3", "a..b=3", "")
    ),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_cannot_be_read_is_refused_in_a_sentence(tmp_path, monkeypatch, call, words):
    monkeypatch.chdir(tmp_path)
    for name, text in OWN_MODULES.items():
        Path(f"{name}.py").write_text(text)
    Path("latin.toml").write_bytes(b"name = '\xe4'")
    Path("none.toml").write_text("name = \n")
    Path("hunt.toml").write_text(HUNT)
    with pytest.raises(ConfigError) as caught:
        call()
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("return 3", "a task must be a FiniteMDP or have its tables as .mdp: got 3"),
        (
            "return 1 / 0",
            "own:make failed: ZeroDivisionError: division by zero (raised in make of own.py, "
            "line 3)",
        ),
        (
            "raise GeneratorExit",
            "own:make failed: GeneratorExit (raised in make of own.py, line 3)",
        ),
        (  # not by the name of the package in which modules of a study are imported
            "return type('Thing', (), {})",
            "a task must be a FiniteMDP or have its tables as .mdp: got <class 'own.Thing'>",
        ),
        ("return cr.GridWorld('S')", "a map needs a treasure T: there is none"),
    ],
)
def test_a_factory_that_makes_no_task(monkeypatch, tmp_path, body, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(f"import curricle as cr\ndef make():\n    {body}\n")
    Path("own.toml").write_text("name = 'x'\n[tasks.own]\ntype = 'factory'\nfactory = 'own:make'\n")
    with pytest.raises(ConfigError) as caught:
        _ = read_study("own.toml").curricula
    assert str(caught.value) == f"own.toml, line 2: tasks.own is refused: {text}"
    own_failure = caught.value.__cause__.__cause__
    assert isinstance(own_failure, ZeroDivisionError) is ("ZeroDivisionError" in text)


@pytest.mark.parametrize(
    "seeds", ["'0-'", "'a'", "'3-1'", "[1, 1]", "[]", "0", "-1", "1.5", "'0-99999999'"]
)
def test_malformed_seeds(complaints, seeds):
    (sentence,) = complaints(HUNT, ('"0-3"', seeds))
    assert sentence.startswith("line 2: seeds must be a number of seeds, a list of different ones")
    assert sentence.endswith(f"got {tomllib.loads(f'seeds = {seeds}')['seeds']!r}")


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file(complaints):
    changes = [("seeds", "sedes"), ("size = 3\npred", "size = 'x'\npredd"), ("source", "sorce")]
    assert complaints(HUNT, *changes) == [
        "line 2: sedes is unknown, did you mean 'seeds'?",
        "line 9: tasks.chase.size must be a whole number: got 'x'",
        "line 10: tasks.chase.preddators is unknown, did you mean 'predators'?",
        "line 17: transfers[0].source is missing",
        "line 18: transfers[0].sorce is unknown, did you mean 'source'?",
    ]


# -- the line of each key, whatever stands in comments and strings -------------------------


LINES = [
    """\
    k1 = "x" # k9 = 3
    [k2."5 x 5 k2"]
    k3 = '''
    k4 = 4
    [k5]
    '''
    k7.k7 = 1
    k8 = { k8 = 1, "a.b k8" = { k8 = 1.5 } }
    [[k9]]
    k10 = 1
    [[k11]]

      k13 = 2
    [k11.k14]
    k15 = "column"
    """,
    '''\
    k1 = """
    k2 = 1
    \\""" k3 = 1
    """
    k5 = [
      { inner-k5 = 1 }, # ]
      "k7 = 1",
    ]
    k9.k9 = 2024-01-01T00:00:00.5
    k10 = 1.5
    ''',
    "k1 = 1 # drawn in '''\nk2 = 2",
    'k1 = "# no comment"\nk2 = 2',
    'k1 = "\\"# still inside"\nk2 = 2',
    'k1 = """"quoted""""\nk2 = 2',
    "k1 = [1, 2] # [\nk2 = 2",
    "# '''\nk2 = 2",
]
"""Each key says its line; what is text or comment is none."""


def keys_in(node):
    for key, value in node.items() if isinstance(node, dict) else ():
        yield key
        for inner in value if isinstance(value, list) else [value]:
            yield from keys_in(inner)


@pytest.mark.parametrize("text", LINES)
def test_each_key_has_its_line(text):
    text = textwrap.dedent(text)
    lines = line_numbers(text)
    keys = {path: line for path, line in lines.items() if isinstance(path[-1], str)}
    assert all(path[-1].endswith(f"k{line}") for path, line in keys.items())
    assert {path[-1] for path in keys} == {*keys_in(tomllib.loads(text))}


def test_each_entry_of_a_list_has_the_line_of_its_statement():
    lines = line_numbers("a = [\n  { b = 1 }, # ]\n  2,\n]\n[[c]]\n[[c]]\nd = 1\n")
    assert [lines[path] for path in (("a", 0), ("a", 0, "b"), ("a", 1))] == [1, 1, 1]
    assert [lines[path] for path in (("c", 0), ("c", 1), ("c", 1, "d"))] == [5, 6, 7]
