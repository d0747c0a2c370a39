"""What is wrong with a study file is said in sentences: file, line, table, key, what was meant."""

import textwrap
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from curricle.errors import ConfigError
from curricle.study import read_study
from curricle.study.config.positions import Positions
from curricle.study.config.reading import configured
from curricle.study.config.references import load

HUNT = """\
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
MAZES = """\
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


@pytest.fixture
def complaints(tmp_path, monkeypatch):
    """The sentences about a text, changed or not, at reading or at building."""
    monkeypatch.chdir(tmp_path)

    def collect(text, *changes, set=()):
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        Path("study.toml").write_text(textwrap.dedent(text), "utf-8")
        with pytest.raises(ConfigError) as caught:
            _ = read_study("study.toml", set=set).curricula
        lines = str(caught.value).splitlines()
        assert all(line.startswith("study.toml") for line in lines)
        return [line.removeprefix("study.toml").removeprefix(", ") for line in lines]

    return collect


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "predators",
            "predatrs",
            "line 10: tasks.chase.predatrs is unknown, did you mean 'predators'?",
        ),
        ("seeds", "sedes", "line 2: sedes is unknown, did you mean 'seeds'?"),
        ("[learner]", "[lerner]", "line 4: lerner is unknown, did you mean 'learner'?"),
        ("epsilon", "epsilom", "line 5: learner.epsilom is unknown, did you mean 'epsilon'?"),
        (
            "[learner]\nepsilon = 0.1",
            "[storage]\nqqq = 1",
            "line 5: storage.qqq is unknown: known are kind, dtype, memory_limit, save_values",
        ),
        (
            "size = 3\npred",
            "size = 'three'\npred",
            "line 9: tasks.chase.size must be a whole number: got 'three'",
        ),
        (
            "size = 3\npred",
            "size = 3.5\npred",
            "line 9: tasks.chase.size must be a whole number: got 3.5",
        ),
        (
            "size = 3\npred",
            "size = true\npred",
            "line 9: tasks.chase.size must be a whole number: got True",
        ),
        (
            "size = 3\npred",
            "torus = 1\npred",
            "line 9: tasks.chase.torus must be true or false: got 1",
        ),
        ("size = 3\npred", "moves = 6\npred", "line 9: tasks.chase.moves must be 4 or 5: got 6"),
        (
            "size = 3\npred",
            "discount = '1'\npred",
            "line 9: tasks.chase.discount must be a number: got '1'",
        ),
        (
            "size = 3\npred",
            "capture = 'al'\npred",
            "line 9: tasks.chase.capture must be 'all', 'any', 'as_published' or a number of "
            "predators: got 'al'",
        ),
        (
            "size = 3\npred",
            "prey = 'uniforn'\npred",
            "line 9: tasks.chase.prey must be 'uniform', rows of probabilities, or a function as "
            "module:function: got 'uniforn'",
        ),
        (
            'type = "pursuit"\nsize = 3\npred',
            'type = "persuit"\npred',
            "line 8: tasks.chase.type must be one of maze, crop, pursuit, gymnasium, factory, "
            "observation_task, vector_pursuit: got 'persuit', did you mean 'pursuit'?",
        ),
        (
            'type = "pursuit"\nsize = 3\npred',
            "pred",
            "line 7: tasks.chase.type is missing: one of maze, crop, pursuit, gymnasium, factory, "
            "observation_task, vector_pursuit",
        ),
        ('name = "hunt"\n', "", ": name is missing"),
        ('name = "hunt"', "name = ''", "line 1: name must not be empty: got ''"),
        (
            "epsilon = 0.1",
            "type = 'Sarsa'",
            "line 5: learner.type must be one of QLearning, SARSA, ExpectedSARSA, DoubleQLearning, "
            "deep: got 'Sarsa', did you mean 'SARSA'?",
        ),
        (
            "epsilon = 0.1",
            "epsilon = { type = 'linear', first = 1, lst = 0, steps = 5 }",
            "line 5: learner.epsilon.last is missing",
        ),
        (
            "[learner]\nepsilon = 0.1",
            "aggregate = 'minmum'",
            "line 4: aggregate must be one of maximum, mean, minimum, total, or a function as "
            "module:function: got 'minmum', did you mean 'minimum'?",
        ),
        (
            "[learner]\nepsilon = 0.1",
            "shaping = 'StateShapping'",
            "line 4: shaping must be one of QInitialisation, LookAheadAdvice, LookBackAdvice, "
            "StateShaping, DecayingAdvice, RewardBonus, WeightTransfer, PolicyReuse: got "
            "'StateShapping', did you mean 'StateShaping'?",
        ),
        (
            "[learner]\nepsilon = 0.1",
            "shaping.guard = 3",
            "line 4: shaping.guard must be true, false or a table: got 3",
        ),
        ("epsilon = 0.1", "epsilon = nan", "line 5: learner.epsilon must be finite: got nan"),
        (
            "[learner]\nepsilon = 0.1",
            "seeds_per_unit = 0",
            "line 4: seeds_per_unit must be at least 1: got 0",
        ),
        (
            "budget = 2_000",
            "budget = { epsiodes = 3 }",
            "line 11: tasks.chase.budget.max_steps is missing",
        ),
        (
            "budget = 2_000",
            "budget = 'x'",
            "line 11: tasks.chase.budget must be a whole number: got 'x'",
        ),
        ("[learner]\nepsilon = 0.1", "tasks.a = 3", "line 4: tasks.a must be a table: got 3"),
        (
            'source = "chase"',
            'source = "chse"',
            "line 18: transfers[0].source must name a task: got 'chse', did you mean 'chase'?",
        ),
        ('source = "chase"\n', "", "line 17: transfers[0].source is missing"),
        (
            "project = { predator",
            "mapping = 'identity'\nproject = { predator",
            "line 17: transfers[0] must have one of project, mapping, function, factory, "
            "observations: got project, mapping",
        ),
        (
            'project = { predator = "predator_1" }',
            "scale = 1",
            "line 17: transfers[0] must have one of project, mapping, function, factory, "
            "observations: got none",
        ),
        (
            'project = { predator = "predator_1" }',
            "function = 'cart'",
            "line 20: transfers[0].function must name a function as module:function: got 'cart'",
        ),
        (
            'project = { predator = "predator_1" }',
            "mapping = 'same_positon'",
            "line 20: transfers[0].mapping must be 'identity', 'same_position' or "
            "'relative_objects': got 'same_positon', did you mean 'same_position'?",
        ),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(complaints, old, new, sentence):
    assert sentence in complaints(HUNT, (old, new))


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


def test_no_task(complaints):
    assert complaints("name = 'x'\n[tasks]\n") == [
        "line 2: tasks must have 1 or more entries: got {}"
    ]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            'of = "maze"',
            "of = 'mze'",
            "line 12: tasks.corner.of must name a task: got 'mze', did you mean 'maze'?",
        ),
        (
            'of = "maze"',
            "of = 'corner'",
            "line 12: tasks.corner.of must lead to a maze: got corner and so on",
        ),
        ("rows = [0, 2]", "rows = [0]", "line 13: tasks.corner.rows[1] is missing"),
        ("rows = [0, 2]", "", "line 10: tasks.corner.rows is missing"),
        (
            "rows = [0, 2]",
            "rows = [0, 'b']",
            "line 13: tasks.corner.rows[1] must be a whole number: got 'b'",
        ),
        (
            "rows = [0, 2]",
            "rows = [0, 2]\nstart = 'here'",
            "line 14: tasks.corner.start must be 'map', 'uniform' or a list of cells: got 'here'",
        ),
        (
            "map = '''",
            "ends = ['tresure']\nmap = '''",
            "line 5: tasks.maze.ends[0] must be 'treasure', 'pit' or 'fire': got 'tresure', did "
            "you mean 'treasure'?",
        ),
        (
            "map = '''",
            "file = 'm.txt'\nmap = '''",
            "line 3: tasks.maze has both map and file: one of them is enough",
        ),
    ],
)
def test_mistakes_in_mazes(complaints, old, new, sentence):
    assert complaints(MAZES, (old, new)) == [sentence]


def test_a_crop_is_of_a_maze(complaints):
    crop = "[tasks.part]\ntype = 'crop'\nof = 'hunt'\nrows = [0, 1]\ncolumns = [0, 1]\n"
    assert "line 23: tasks.part.of must name a maze or a crop: got 'hunt'" in complaints(
        HUNT + crop
    )


def test_a_map_s_file_that_cannot_be_read(complaints, tmp_path):
    text = "name = 'x'\n[tasks.maze]\ntype = 'maze'\nfile = 'maze.txt'\n"
    assert complaints(text) == [
        "line 4: tasks.maze.file cannot be read: maze.txt, No such file or directory"
    ]
    (tmp_path / "maze.txt").write_bytes(b"\xff\xfe")
    assert complaints(text) == ["line 4: tasks.maze.file cannot be read: maze.txt, not UTF-8"]


@pytest.mark.parametrize(
    ("arms", "expected"),
    [
        (
            "[arms.scratch]",
            ["line 21: arms.scratch must have another name: it is the arm without sources"],
        ),
        (
            "[arms.a]\ntasks.chace.budget = 5",
            ["line 22: arms.a.tasks.chace is unknown, did you mean 'chase'?"],
        ),
        (
            "[arms.a]\nagregate = 'mean'",
            ["line 22: arms.a.agregate is unknown, did you mean 'aggregate'?"],
        ),
        (
            "[arms.a]\nseeds = 3",
            [
                "line 22: arms.a.seeds is unknown: known are tasks, transfers, aggregate, "
                "learner, budget, "
                "shaping, retrain, eval_freq, evaluation, storage"
            ],
        ),
        (
            "[arms.a]\ntasks.chase.size = 'x'",
            ["line 22: arms.a.tasks.chase.size must be a whole number: got 'x'"],
        ),
        (
            "[arms.a]\nlearner.epsilon = 'x'",
            ["line 22: arms.a.learner.epsilon must be a number: got 'x'"],
        ),
        (
            "[arms.a]\ntransfers = [1]",
            [
                "line 22: arms.a.transfers[0] must name transfers of the study by number, below 1: "
                "got 1"
            ],
        ),
        (
            "[arms.a]\ntransfers.7.scale = 2",
            [
                "line 22: arms.a.transfers must name transfers of the study by number, below 1: "
                "got '7'"
            ],
        ),
        (
            "[arms.a]\ntransfers.0.scale = 'x'",
            ["line 22: arms.a.transfers.0.scale must be a number: got 'x'"],
        ),
        (
            "[arms.a]\ntasks.chase.budget = 2_000",
            [
                "line 21: arms.a changes nothing: its settings are the study's, or a task has its own"
            ],
        ),
        ("[arms]\na = 3", ["line 22: arms.a must be a table: got 3"]),
        (
            "[arms.a]\n[arms.b]\ntransfers = [{ source = 'hunt', target = 'chase', project = {} }]",
            ["line 21: arms must all have the same target: a has hunt, b has chase"],
        ),
    ],
)
def test_mistakes_in_arms(complaints, arms, expected):
    found = complaints(HUNT + arms)
    assert found[: len(expected)] == expected


def test_a_mistake_of_the_study_is_told_once_however_many_arms_share_it(complaints):
    arms = "[arms.a]\n[arms.b]\ntransfers = [0]\ntasks.hunt.budget = 3\n"
    assert complaints(HUNT + arms, ("size = 3\npred", "size = 'x'\npred")) == [
        "line 9: tasks.chase.size must be a whole number: got 'x'"
    ]


# What Curricle refuses when it is built.


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "...T\nS...",
            "...T\nS..",
            "line 3: tasks.maze is refused: all lines of a map must be equally long: line 1 has 3 "
            "characters, line 0 has 4",
        ),
        (
            "columns = [2, 4]",
            "columns = [2, 9]",
            "line 10: tasks.corner is refused: a crop must lie within the map's columns 0..4: "
            "got 2..9",
        ),
        (
            "[tasks.corner]",
            "budget = 0\n[tasks.corner]",
            "line 10: tasks.maze.budget is refused: a budget in steps must be a whole number, at "
            "least 1: got 0",
        ),
        (
            "[tasks.corner]",
            "budget = 9\neval_freq = 10\n[tasks.corner]",
            "line 11: tasks.maze.eval_freq is refused: every must not exceed the budget of 9 steps: "
            "got 10",
        ),
        (
            "[tasks.corner]",
            "learner.epsilon = 2\n[tasks.corner]",
            "line 10: tasks.maze.learner is refused: epsilon must lie in [0, 1]: got 2",
        ),
        (
            "[tasks.corner]",
            "shaping.guard = { min_share = 0 }\n[tasks.corner]",
            "line 10: tasks.maze.shaping is refused: min_share of a guard must be above 0, or one "
            "learner would never act: got 0",
        ),
        (
            "[tasks.corner]",
            "shaping = 'LookBackAdvice'\n[tasks.corner]",
            "line 10: tasks.maze.shaping is refused: LookBackAdvice is valid for on-policy SARSA "
            "only: got QLearning",
        ),
        (
            'mapping = "same_position"',
            "project.row = 'raw'",
            "line 16: transfers[0] is refused: source component 'row' must be read from a target "
            "component (row, column): got 'raw'",
        ),
        (
            'mapping = "same_position"',
            "project = {}\ncalibrate.quantile = 2",
            "line 16: transfers[0] is refused: quantile of a calibration must lie between 0 and 1: "
            "got 2",
        ),
    ],
)
def test_what_curricle_refuses_has_its_place(complaints, old, new, sentence):
    assert complaints(MAZES, (old, new)) == [sentence]


def test_all_that_is_refused_is_told_at_once(complaints):
    changes = [("...T\nS...", "...T\nS.."), ("[[tr", "learner.epsilon = 2\neval_freq = 0\n[[tr")]
    assert [line.split(" is refused")[0] for line in complaints(MAZES, *changes)] == [
        "line 3: tasks.maze",
        "line 16: tasks.corner.learner",
        "line 17: tasks.corner.eval_freq",
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
        ("tasks.chase.bugdet=3", "as set: tasks.chase.bugdet is unknown, did you mean 'budget'?"),
        ("tasks.chase.size=x", "as set: tasks.chase.size must be a whole number: got 'x'"),
        ("arms.a.budget=3", "as set: arms.a is unknown"),
        ("transfers.4.scale=3", "as set: transfers[4] is unknown: known are 0"),
        ("transfers.0.scal=3", "as set: transfers[0].scal is unknown, did you mean 'scale'?"),
        ("sedes=3", "as set: sedes is unknown, did you mean 'seeds'?"),
        ("learner.lerning_rate=3", "as set: learner.lerning_rate is unknown, did you mean"),
        (
            "tasks.chase.budget=0",
            "as set: tasks.chase.budget is refused: a budget in steps must be",
        ),
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


# Files that are none.


def test_a_file_that_is_no_toml(complaints):
    assert complaints("name = \n") == [" is not valid TOML: Invalid value (at line 1, column 8)"]


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match=r"missing\.toml cannot be read: No such file"):
        read_study(tmp_path / "missing.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe4'")
    with pytest.raises(ConfigError, match=r"latin\.toml cannot be read: it is not UTF-8"):
        read_study(tmp_path / "latin.toml")


def test_an_arm_that_is_not_there(tmp_path):
    (tmp_path / "study.toml").write_text(HUNT)
    with pytest.raises(ConfigError, match=r"arm 'trasfer' is unknown, did you mean 'transfer'\?$"):
        read_study(tmp_path / "study.toml").curriculum("trasfer")


# Functions of the user's own.


@pytest.mark.parametrize(
    ("reference", "text"),
    [
        ("own", "a function is named as module:function: got 'own'"),
        ("own.:make", "a function is named as module:function: got 'own.:make'"),
        (
            "nobody_has_this:make",
            "nobody_has_this:make names no module: nobody_has_this is neither",
        ),
        ("own:nothing", "own:nothing names no function: own has no nothing to call"),
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


def test_a_factory_s_arguments_are_checked_by_itself(complaints, tmp_path):
    (tmp_path / "own.py").write_text("def make(size): return size")
    study = (
        "name = 'x'\n[tasks.own]\ntype = 'factory'\nfactory = 'own:make'\narguments = { sice = 3 }"
    )
    (found,) = complaints(study)
    assert "own:make failed: TypeError: make() got an unexpected keyword argument 'sice'" in found


def test_the_error_of_a_user_s_function_is_the_cause(tmp_path):
    (tmp_path / "own.py").write_text("def make(): return 1 / 0")
    path = tmp_path / "study.toml"
    path.write_text("name = 'x'\n[tasks.own]\ntype = 'factory'\nfactory = 'own:make'\n")
    with pytest.raises(ConfigError) as caught:
        read_study(path).curriculum("transfer")
    assert isinstance(caught.value.__cause__.__cause__, ZeroDivisionError)


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (
            "def f(state, action): return state['nowhere'], action",
            "own:f failed: KeyError: 'nowhere'",
        ),
        ("def f(state, action): return state", "the function must return two dicts"),
    ],
)
def test_a_function_that_maps_nothing(complaints, tmp_path, function, text):
    (tmp_path / "own.py").write_text(function)
    (found,) = complaints(MAZES, ('mapping = "same_position"', "function = 'own:f'"))
    assert found.startswith(f"line 16: transfers[0] is refused: {text}")


@pytest.mark.parametrize("which", ["factory = 'own:f'", "mapping = 'identity'"])
def test_a_value_that_nobody_reads(complaints, which):
    (found,) = complaints(MAZES, ('mapping = "same_position"', f"{which}\nunmapped_value = 3"))
    assert found.startswith("line 16: transfers[0] has an unmapped_value that is not used")


# Nothing that TOML can say ends in anything but a configuration or a ConfigError.

# fmt: off
WORDS = st.sampled_from([
    "a", "b", "type", "maze", "crop", "pursuit", "map", "file", "of", "rows", "size", "tasks",
    "transfers", "arms", "learner", "epsilon", "budget", "episodes", "max_steps", "source", "target",
    "project", "mapping", "identity", "calibrate", "shaping", "guard", "seeds", "name", "0", "1",
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
        configured(study, Path("nowhere"), Positions("x.toml", study))
    except ConfigError as error:
        sentences = str(error).splitlines()
    assert all(line.startswith("x.toml: ") for line in sentences)
