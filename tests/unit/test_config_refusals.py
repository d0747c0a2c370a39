"""What is wrong with names, arms, settings and own functions of a study, each with its line."""

import textwrap
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from curricle.errors import ConfigError
from curricle.study import read_study
from curricle.study.config import configured
from curricle.study.file import Positions, line_numbers
from curricle.study.own_code import load
from tests.studies import NUMBERED_HUNT as HUNT, NUMBERED_MAZES as MAZES

# Names: tasks, crops, arms.


def test_a_cycle(complaints):
    back = "[[transfers]]\nsource = 'hunt'\ntarget = 'chase'\nproject = {}\n"
    (sentence,) = complaints(HUNT + back)
    assert sentence in {
        f"line 17: transfers must have no cycle: got {cycle}"
        for cycle in ("chase -> hunt -> chase", "hunt -> chase -> hunt")
    }


def test_more_than_one_target(complaints):
    assert complaints(HUNT + "[tasks.other]\ntype = 'pursuit'") == [
        "line 7: tasks must have one that no other builds on: got hunt, other"
    ]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('of = "maze"', "of = 'mze'", "line 12: tasks.corner.of must name a task: got 'mze', did"),
        ('of = "maze"', "of = 'corner'", "line 12: tasks.corner.of must lead to a whole task: got"),
        ("rows = [0, 2]", "", "line 10: tasks.corner.rows is missing"),
        ("rows = [0, 2]", "rows = [0, 2]\nstart = 'here'", "line 14: tasks.corner.start must be"),
        ("map = '''", "file = 'm.txt'\nmap = '''", "line 3: tasks.maze has both map and file: one"),
        ("...T\nS...", "...T\nS..", "line 3: tasks.maze is refused: all lines of a map must be"),
        ('mapping = "same_position"', "project.row = 'raw'", "component (row, column): got 'raw'"),
    ],
)
def test_mistakes_in_mazes(complaints, old, new, sentence):
    (line,) = complaints(MAZES, (old, new))
    assert sentence in line


def test_a_crop_is_of_a_maze(complaints):
    crop = "[tasks.part]\ntype = 'crop'\nof = 'hunt'\nrows = [0, 1]\ncolumns = [0, 1]\n"
    types = "maze, crop, four_rooms, key_lock_pit, family"
    sentence = f"line 23: tasks.part.of must name a task of type {types}: got 'hunt'"
    assert sentence in complaints(HUNT + crop)


def test_a_map_s_file_that_cannot_be_read(complaints, tmp_path):
    text = "name = 'x'\n[tasks.maze]\ntype = 'maze'\nfile = 'maze.txt'\n"
    assert complaints(text) == [
        "line 4: tasks.maze.file cannot be read: 'maze.txt', No such file or directory"
    ]
    (tmp_path / "maze.txt").write_bytes(b"\xff\xfe")
    assert "cannot be read: 'maze.txt', it is not UTF-8" in complaints(text)[0]


@pytest.mark.parametrize(
    ("arms", "sentence"),
    [
        ("[arms.scratch]", "line 21: arms.scratch must have another name: it is the arm without"),
        ("[arms.a]\ntasks.chace.size = 5", "line 22: arms.a.tasks.chace is unknown, did you"),
        ("[arms.a]\nseeds = 3", "line 22: arms.a.seeds is unknown: known are tasks, transfers, "),
        ("[arms.a]\ntransfers = [1]", "line 22: arms.a.transfers[0] must name transfers of the"),
        ("[arms.a]\ntasks.chase.budget = 2_000", "line 21: arms.a changes nothing: its settings"),
        ("[arms]\na = 3", "line 22: arms.a must be a table: got 3"),
        (
            "[arms.a]\n[arms.b]\ntransfers = [{ source = 'hunt', target = 'chase', project = {} }]",
            "line 21: arms must all have the same target: a has hunt, b has chase",
        ),
    ],
)
def test_mistakes_in_arms(complaints, arms, sentence):
    assert complaints(HUNT + arms)[0].startswith(sentence)


def test_a_mistake_of_the_study_is_told_once_however_many_arms_share_it(complaints):
    arms = "[arms.a]\n[arms.b]\ntransfers = [0]\ntasks.hunt.budget = 3\n"
    assert complaints(HUNT + arms, ("size = 3\npred", "size = 'x'\npred")) == [
        "line 9: tasks.chase.size must be a whole number: got 'x'"
    ]


# What Curricle refuses when it is built.


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


def test_transfers_that_disagree_are_refused_as_a_whole(complaints):
    other = "[[transfers]]\nsource = 'corner'\ntarget = 'maze'\nproject = {}\ncalibrate = true\n"
    assert complaints(MAZES + other) == [
        ": the study is refused: all transfers into a task are calibrated together and must agree "
        "on it: those into 'maze' do not"
    ]
    assert complaints(MAZES + "[arms.odd]\ntransfers.0.scale = 2\n" + other)[0].startswith(
        "line 20: arms.odd is refused: all transfers into a task"
    )


# What is set from outside.


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("tasks.chse.budget=3", "as set: tasks.chse is unknown, did you mean 'chase'?"),
        ("tasks.chase.size=x", "as set: tasks.chase.size must be a whole number: got 'x'"),
        ("arms.a.budget=3", "as set: arms.a is unknown"),
        ("transfers.4.scale=3", "as set: transfers[4] is unknown: known are 0"),
        ("tasks.chase.time_limit=0", "line 7, as set: tasks.chase is refused: time_limit in"),
        ("snapshots=-1", "as set: snapshots must be at least 0: got -1"),
    ],
)
def test_a_change_that_cannot_be_made(complaints, change, sentence):
    (found,) = complaints(HUNT, set=[change])
    assert found.startswith(sentence)


@pytest.mark.parametrize("change", ["tasks", "=3", "a b=3", "a..b=3", ""])
def test_what_is_no_assignment(tmp_path, change):
    (tmp_path / "study.toml").write_text(HUNT)
    with pytest.raises(ConfigError, match=r"^a setting is given as key=value, with dots"):
        read_study(tmp_path / "study.toml", set=[change])


# Functions of the user's own.


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        ("own", "a function is named as module:function: got 'own'"),
        ("nobody_has:make", "nobody_has:make names no module: nobody_has is neither"),
        ("own:NUMBER", "own:NUMBER names no function: own has no NUMBER to call"),
        ("broken:make", "broken:make failed: ModuleNotFoundError: No module named 'nobody_has'"),
        ("false:make", "false:make failed: SyntaxError: "),
    ],
)
def test_a_function_that_cannot_be_loaded(tmp_path, reference, text):
    (tmp_path / "own.py").write_text("NUMBER = 3")
    (tmp_path / "broken.py").write_text("import nobody_has")
    (tmp_path / "false.py").write_text("def make(:")
    with pytest.raises(ConfigError) as caught:
        load(reference, tmp_path)
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("return 3", "a task must be a FiniteMDP or have its tables as .mdp: got 3"),
        ("return 1 / 0", "own:make failed: ZeroDivisionError: division by zero"),
        ("return cr.GridWorld('S')", "a map needs a treasure T: there is none"),
    ],
)
def test_a_factory_that_makes_no_task(complaints, tmp_path, body, text):
    (tmp_path / "own.py").write_text(f"import curricle as cr\ndef make():\n    {body}\n")
    study = "name = 'x'\n[tasks.own]\ntype = 'factory'\nfactory = 'own:make'\n"
    assert complaints(study) == [f"line 2: tasks.own is refused: {text}"]


def test_the_error_of_a_user_s_function_is_the_cause(tmp_path):
    (tmp_path / "own.py").write_text("def make(): return 1 / 0")
    path = tmp_path / "study.toml"
    path.write_text("name = 'x'\n[tasks.own]\ntype = 'factory'\nfactory = 'own:make'\n")
    with pytest.raises(ConfigError) as caught:
        read_study(path).curriculum("transfer")
    assert isinstance(caught.value.__cause__.__cause__, ZeroDivisionError)


@pytest.mark.parametrize("which", ["factory = 'own:f'", "mapping = 'identity'"])
def test_a_value_that_nobody_reads(complaints, which):
    (found,) = complaints(MAZES, ('mapping = "same_position"', f"{which}\nunmapped_value = 3"))
    assert found.startswith("line 16: transfers[0] has an unmapped_value that is not used")


# -- single keys ---------------------------------------------------------------------------------


LEARNER = "[learner]\nepsilon = 0.1"
SIZE = "size = 3\npred"
KIND = f'type = "pursuit"\n{SIZE}'
PROJECT = 'project = { predator = "predator_1" }'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (KIND, 'type = "persuit"\npred', "line 8: tasks.chase.type must be one of maze, crop, "),
        (PROJECT, "mapping = 'same_positon'", "line 20: transfers[0].mapping must be 'identity',"),
        (SIZE, "torus = 1\npred", "line 9: tasks.chase.torus must be true or false: got 1"),
        (SIZE, "moves = 6\npred", "line 9: tasks.chase.moves must be 4 or 5: got 6"),
        (LEARNER, "shaping.guard = 3", "line 4: shaping.guard must be true, false or a table: got"),
        (LEARNER, "seeds_per_unit = 0", "line 4: seeds_per_unit must be at least 1: got 0"),
        ("epsilon = 0.1", "epsilon = nan", "line 5: learner.epsilon must be finite: got nan"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(complaints, old, new, sentence):
    assert any(line.startswith(sentence) for line in complaints(HUNT, (old, new)))


@pytest.mark.parametrize(
    ("old", "new", "start", "end"),
    [
        (LEARNER, "[storage]\nqqq = 1", "line 5: storage.qqq is unknown: known are", "save_values"),
        (SIZE, "capture = 'al'\npred", "line 9: tasks.chase.capture must be", "mean 'all'?"),
        (SIZE, "prey = 'uni'\npred", "line 9: tasks.chase.prey must be", "mean 'uniform'?"),
        (KIND, "pred", "line 7: tasks.chase.type is missing", "observation_task, distilled"),
        (LEARNER, "aggregate = 'minmum'", "line 4: aggregate must be one of", "mean 'minimum'?"),
        ("budget = 2_000", f"budget = 1{400 * '0'}", "line 11: tasks.chase.budget must", "00..."),
        ('source = "chase"', 'source = "chse"', "line 18: transfers[0].source must", "'chase'?"),
        (PROJECT, f"mapping = 'identity'\n{PROJECT}", "line 17: transfers[0]", "project, mapping"),
        (PROJECT, "function = 'cart'", "line 20: transfers[0].function must name", "got 'cart'"),
    ],
)
def test_other_mistakes_name_their_place_and_what_is_there(complaints, old, new, start, end):
    lines = complaints(HUNT, (old, new))
    assert any(line.startswith(start) and line.endswith(end) for line in lines), lines


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


# Files that are none.


def test_a_file_that_is_no_toml(complaints):
    assert complaints("name = \n") == [" is not valid TOML: Invalid value (at line 1, column 8)"]


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match=r"missing\.toml cannot be read: No such file"):
        read_study(tmp_path / "missing.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe4'")
    with pytest.raises(ConfigError, match=r"a \.\.\. cannot be read: File name too long"):
        read_study("a" * 5000)
    with pytest.raises(ConfigError, match=r"latin\.toml cannot be read: it is not UTF-8"):
        read_study(tmp_path / "latin.toml")


def test_what_is_no_path_or_no_list_of_settings(tmp_path):
    with pytest.raises(ConfigError, match=r"^a study file must be a path: got 3$"):
        read_study(3)
    with pytest.raises(ConfigError, match=r"^set must be a list of settings, each .*: got 'a=1'$"):
        read_study(tmp_path / "none.toml", set="a=1")
    (tmp_path / "maze.toml").write_text("name = 'maze'")
    with pytest.raises(ConfigError, match=r"^a setting is given as key=value, .*: got 3$"):
        read_study(tmp_path / "maze.toml", set=[3])


def test_an_arm_that_is_not_there(tmp_path):
    (tmp_path / "study.toml").write_text(HUNT)
    with pytest.raises(ConfigError, match=r"arm 'trasfer' is unknown, did you mean 'transfer'\?$"):
        read_study(tmp_path / "study.toml").curriculum("trasfer")


# Nothing that TOML can say ends in anything but a configuration or a ConfigError.

# fmt: off
WORDS = st.sampled_from([
    "a", "b", "type", "maze", "crop", "pursuit", "map", "file", "of", "rows", "size", "tasks",
    "transfers", "arms", "learner", "epsilon", "budget", "episodes", "max_steps", "source",
    "target", "project", "mapping", "identity", "calibrate", "shaping", "guard", "seeds", "name",
    "0", "1",
])
# fmt: on
VALUES = st.recursive(
    WORDS | st.integers(-2, 9) | st.booleans() | st.floats() | st.just("S.T"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=4),
    max_leaves=12,
)
TABLES = st.dictionaries(WORDS, VALUES, max_size=4)
STUDIES = st.fixed_dictionaries(
    {},
    optional={
        "name": VALUES,
        "seeds": VALUES,
        "learner": VALUES,
        "budget": VALUES,
        "shaping": VALUES,
        "tasks": VALUES | st.dictionaries(WORDS, TABLES, max_size=3),
        "transfers": VALUES | st.lists(TABLES, max_size=3),
        "arms": VALUES | st.dictionaries(WORDS, TABLES, max_size=2),
    },
)


@given(STUDIES)
def test_no_study_however_odd_is_worse_than_refused(study):
    sentences = []
    try:
        configured(study, Path("nowhere"), Positions("x.toml"))
    except ConfigError as error:
        sentences = str(error).splitlines()
    assert all(line.startswith("x.toml: ") for line in sentences)


# -- the line of each key, whatever stands in comments and strings -------------------------


def lines(text):
    text = textwrap.dedent(text)
    tomllib.loads(text)  # valid, as it is when lines are asked for
    return line_numbers(text)


def test_lines_of_tables_keys_and_entries():
    assert lines(
        """\
        name = "x" # size = 3
        [tasks."5 x 5"]
        map = '''
        size = 4
        [nothing]
        '''
        rewards.step = 1
        learner = { epsilon = 1, "a.b" = { c = 1.5 } }
        [[transfers]]
        scale = 1
        [[transfers]]

          scale = 2
        [transfers.project]
        row = "column"
        """
    ) == {
        ("name",): 1,
        ("tasks",): 2,
        ("tasks", "5 x 5"): 2,
        ("tasks", "5 x 5", "map"): 3,
        ("tasks", "5 x 5", "rewards"): 7,
        ("tasks", "5 x 5", "rewards", "step"): 7,
        ("tasks", "5 x 5", "learner"): 8,
        ("tasks", "5 x 5", "learner", "epsilon"): 8,
        ("tasks", "5 x 5", "learner", "a.b"): 8,
        ("tasks", "5 x 5", "learner", "a.b", "c"): 8,
        ("transfers",): 9,
        ("transfers", 0): 9,
        ("transfers", 0, "scale"): 10,
        ("transfers", 1): 11,
        ("transfers", 1, "scale"): 13,
        ("transfers", 1, "project"): 14,
        ("transfers", 1, "project", "row"): 15,
    }


@pytest.mark.parametrize(
    "first",
    [
        "a = 1 # drawn in '''",
        'a = 1 # or """',
        "a = \"'''\"",
        'a = \'"""\'',
        'a = "# no comment"',
        'a = "\\"# still inside"',
        "a = '''one line'''",
        'a = """"quoted""""',
        "a = [1, 2] # [",
        "# '''",
    ],
)
def test_quotes_in_comments_and_strings_hide_no_key(first):
    assert lines(f"{first}\nb = 2\n")[("b",)] == 2


def test_keys_after_strings_and_lists_of_several_lines():
    found = lines(
        '''\
        a = """
        b = 1
        \\""" c = 1
        """
        list = [
          { d = 1 }, # ]
          "e = 1",
        ]
        f.g = 2024-01-01T00:00:00.5
        h = 1.5
        '''
    )
    assert found == {
        ("a",): 1,
        ("list",): 5,
        ("list", 0): 6,
        ("list", 0, "d"): 6,
        ("list", 1): 7,
        ("f",): 9,
        ("f", "g"): 9,
        ("h",): 10,
    }
