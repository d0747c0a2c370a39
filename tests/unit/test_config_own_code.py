"""Study files with code of the user's own: functions, environments, encoders, exact tables."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.errors import ConfigError, CurriculumError
from curricle.interop import MiniGridFullView, MiniGridView
from curricle.study import StudyConfig, StudyResults, compare_studies, run_study
from curricle.study_file.own_code import load
from tests.support.studies import MAZE, again, only, reader
from tests.support.worlds_to_tabulate import Corridor, assert_same_tables

# Functions of the user's own.

OWN = """
import curricle as cr
from .rules import LONG

def line(length=LONG, treasure=200.0):
    return cr.GridWorld("S" + "." * (length - 2) + "T", rewards=cr.Rewards(treasure=treasure))

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


def test_modules_beside_the_file_import_each_other_as_scripts_do(own):
    for folder, length in (("a", 5), ("b", 7)):
        place = own(folder, length)
        (place / "own.py").write_text("import rules\nfrom rules import LONG\nline = lambda: LONG\n")
        line = load("own:line", place)
        assert line() == length
        neighbour = line.__globals__["rules"]
        assert neighbour.__spec__.name == neighbour.__name__ == f"{line.__module__[:-3]}rules"
        assert "rules" not in sys.modules


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
    first, second = read(LINES, name="a/study.toml"), read(LINES, name="b/study.toml")
    assert [only(study).tasks["long"].states.size for study in (first, second, first)] == [5, 6, 5]
    assert "own" not in sys.modules
    elsewhere = StudyConfig.from_data(first.to_data(), second.folder)
    assert only(elsewhere).tasks["long"].states.size == 6


def test_other_mappings(read):
    text = MAZE + "[tasks.near]\ntype='crop'\nof='maze'\nrows=[0,3]\ncolumns=[0,5]\nstart='map'\n"
    edge = "[[transfers]]\nsource='near'\ntarget='maze'\n"
    maze = cr.GridWorld(["....T", ".PPP.", "S...."])
    for name in ("identity", "same_position", "relative_objects"):
        curriculum = only(read(f"{text}{edge}mapping='{name}'"))
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
OWN_STUDY = """
name = "own"
budget = 100
seeds = 1
[tasks.maze]
type = "factory"
factory = "rules:maze"
"""


def test_a_module_is_named_before_it_runs(tmp_path):
    (tmp_path / "rules.py").write_text(RULES)
    (tmp_path / "own.toml").write_text(OWN_STUDY)
    done = subprocess.run(
        [sys.executable, "-m", "curricle", "check", "own.toml"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    named = lines.index("importing the study's module rules, beside the study file")
    assert named < lines.index("RUNS")
    assert lines.count("RUNS") == 1


def test_the_module_of_an_id_obeys_the_rule_of_functions(read, tmp_path, monkeypatch):
    (tmp_path / "worlds.py").write_text(
        "import gymnasium as gym\nfrom gymnasium.envs.toy_text import FrozenLakeEnv\n"
        "gym.register('Beside-v0', entry_point=FrozenLakeEnv)\n"
    )

    def task(name):
        return only(read(f"name = 'x'\ntasks.it = {{ type = 'gymnasium', id = '{name}' }}"))

    assert task("worlds:Beside-v0").tasks["it"].states.size == 16
    for module, why in (
        ("antigravity", "Python's own library"),
        ("pandas", "CURRICLE_ALLOW=pand"),
        ("nowhere", "nowhere is neither beside the study file nor on"),
        ("../x", "an id with a module must be module:Name-v0"),
    ):
        with pytest.raises(ConfigError, match=why):
            task(f"{module}:Any-v0")
    assert "antigravity" not in sys.modules
    monkeypatch.setenv("CURRICLE_ALLOW", "pandas")
    with pytest.raises(ConfigError, match="'pandas:Any-v0' failed with NameNotFound"):
        task("pandas:Any-v0")
    with pytest.raises(ConfigError, match="observations must be discrete"):  # it was imported
        task("minigrid:MiniGrid-Empty-5x5-v0")


# -- Gymnasium's classes and functions of the user's own ----------------------------------------

OWN_ROOM = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Room(gym.Env):
    def __init__(self, size=3, discount=None):
        self.size, self.discount = size, discount
        self.observation_space = spaces.MultiDiscrete([size, 4])
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = 0
        return self._seen(), {}

    def step(self, action):
        self.place = min(self.place + action, 4 * self.size - 1)
        return self._seen(), float(action), self.place == 4 * self.size - 1, False, {}

    def _seen(self):
        return np.array(divmod(self.place, 4))


def numbered(size=3):
    return Numbered(Room(size))


class Numbered(gym.ObservationWrapper):
    def __init__(self, env):
        super().__init__(env)
        self.observation_space = spaces.Discrete(4 * env.size)

    def observation(self, observation):
        return int(observation @ [4, 1])


def seen(room):
    return gym.wrappers.FlattenObservation(room)
"""
ROOMS = """
name = "rooms"
budget = 300

[tasks]
room = { type = "gymnasium", factory = "own:Room", names = ["row", "column"], time_limit = 20 }
"""
ROOM = ROOMS.splitlines()[-1]


@pytest.fixture
def room_folder(tmp_path, monkeypatch):
    (tmp_path / "own.py").write_text(OWN_ROOM, "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def built_room(room_folder):
    """The task of the study in which a line stands for the room."""

    def task(line=ROOM):
        study = reader(room_folder)(ROOMS.replace(ROOM, line))
        assert again(study).to_data() == study.to_data()
        return only(again(study), *study.arms).tasks["room"]

    return task


def test_a_class_of_ones_own_is_a_task_with_named_components(built_room):
    task = built_room()
    assert repr(task) == "LiveMDP(12 states, 2 actions, discount 0.99, time limit 20)"
    assert task.states.names == ("row", "column")
    walked = cr.planning.rollout(task, np.ones(12, int))
    assert walked.states.tolist() == [*range(12)]


@pytest.mark.parametrize(
    ("said", "size", "label"),
    [
        ('factory = "own:Room", arguments = { size = 5, discount = 3 }', 20, "state_1=0 state_2=1"),
        ('factory = "own:numbered", names = ["y", "x"], sizes = [3, 4]', 12, "y=0 x=1"),
        ('id = "FrozenLake-v1", names = ["y", "x"], time_limit = 9', 16, "y=0 x=1"),
    ],
)
def test_arguments_and_names_are_those_of_the_file(built_room, said, size, label):
    task = built_room(f'room = {{ type = "gymnasium", {said} }}')
    assert (task.states.size, task.states.label(1), task.discount) == (size, label, 0.99)
    assert task.time_limit == (9 if "time_limit" in said else None)


def test_tables_and_networks_take_a_class_too(built_room):
    line = ROOM.replace('"gymnasium"', '"tabulated"')
    task = built_room(
        line.replace('"row", "column"', '"where"').replace("}", ', actions = ["no", "go"]}')
    )
    assert task.actions.label(1) == "action=go"
    assert task.states.label(task.state(np.array([1, 3]))) == "where=7"
    observed = ('room = { type = "observation_task", factory = "own:Room", encode = "own:seen", '
                'time_limit = 9, learner = { type = "deep" } }')  # fmt: skip
    seen = built_room(observed)
    assert seen.observations.shape == (7,)
    assert str(seen.make) == "own:Room(encode=own:seen)"  # as the file names them


# -- environments as exact tables ------------------------------------------------------------

OWN_LAMPS = """
from tests.support.worlds_to_tabulate import Corridor, Slippery


def slippery():
    return Slippery("environment", 0.25)


def outcomes(state, action):
    place, lit = (int(part) for part in state)
    meant = (place, 1 - lit) if action == 2 else (min(place + 1, 3), lit) if action else None
    left = (max(place - 1, 0), lit)
    meant = left if meant is None else meant
    ends = meant[0] == 3
    return [(0.25, left, 0.0, False), (0.75, meant, float(ends and lit), ends)]


def corridor(cells=4):
    return Corridor(cells)
"""


def test_a_tabulated_environment_is_what_python_makes(read, tmp_path):
    (tmp_path / "own.py").write_text(OWN_LAMPS, "utf-8")

    def built(said):
        study = read(f"name = 'lamps'\ntasks.it = {{ type = {said} }}")
        assert only(again(study)).tasks
        return only(study).tasks["it"]

    corridor = "'tabulated', factory = 'own:corridor'"
    short = built(f"{corridor}, arguments = {{ cells = 3 }}")
    long = built(f"{corridor}, reset_seeds = [0, 2]")
    for task, same in (
        (short, cr.tabulate(lambda: Corridor(3), discount=0.99)),
        (long, cr.tabulate(Corridor, discount=0.99, seeds=[0, 2])),
    ):
        assert_same_tables(task, same)
        assert task.states == same.states
    assert long.record.seeds == (0, 2)
    assert built("'tabulated', factory = 'own:slippery', outcomes = 'own:outcomes'").exact
    lake = built("'gymnasium', id = 'FrozenLake-v1', live = true")
    assert isinstance(lake, cr.tasks.LiveMDP)


# -- encoders: by name, with settings, as functions; no torch is needed -------------------------

LEVEL = "minigrid:MiniGrid-Empty-5x5-v0"
ENCODED = f"""
name = "level"
budget = 100
[tasks.level]
type = "observation_task"
id = "{LEVEL}"
encode = ENCODE
learner = {{ type = "deep" }}
"""
OWN_LEVEL = """
import gymnasium

def image(env):
    return gymnasium.wrappers.FilterObservation(env, ["image"])

def half(image):
    return image / 2

def level(size):
    return gymnasium.make("minigrid:MiniGrid-Empty-5x5-v0", size=size)
"""


@pytest.fixture
def read_level(tmp_path):
    pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
    (tmp_path / "own.py").write_text(OWN_LEVEL)
    return lambda encode, text=ENCODED: reader(tmp_path)(text.replace("ENCODE", encode))


def only_task(study):
    return only(study, *study.arms).tasks["level"]


@pytest.mark.parametrize(
    ("encode", "made"),
    [
        ("'MiniGridView'", MiniGridView()),
        ("{ type = 'MiniGridView', picture = true }", MiniGridView(picture=True)),
        ("{ type = 'MiniGridFullView', width = 9, height = 7 }", MiniGridFullView(9, 7)),
    ],
)
def test_an_encoder_has_its_name_and_settings(read_level, encode, made):
    study = read_level(encode)
    assert only_task(study) == cr.observation_task(LEVEL, encode=made) == only_task(again(study))
    assert again(study).to_data() == study.to_data()


def test_a_function_of_environments_is_one(read_level):
    text = ENCODED.replace('type = "deep"', 'type = "deep", policy = "MultiInputPolicy"')
    with pytest.raises(ConfigError, match="reads pictures by NatureCNN"):
        _ = read_level("'own:image'", text).curricula
    with pytest.raises(ConfigError, match=r"'mission' is MissionSpace.*MiniGridView"):
        _ = read_level("", ENCODED.replace("encode = ENCODE", "")).curricula
    text = ENCODED.replace(f'id = "{LEVEL}"', "factory = 'own:level'\narguments = { size = 6 }")
    task = only_task(read_level("'MiniGridView'", text))
    assert task.observations.shape == (984,)
    assert task.environment().unwrapped.width == 6
    text = ENCODED.replace('"observation_task"', '"tabulated"')
    table = only_task(read_level("'MiniGridView'", text.replace('learner = { type = "deep" }', "")))
    assert table.observations.batch().shape == (table.states.size, 984)


def test_live_targets_of_other_code_are_not_compared(room_folder):
    line = ROOM.replace(', names = ["row", "column"]', ", budget = 100")
    small, file = line.replace("room =", "small ="), Path("rooms.toml")
    edge = "[[transfers]]\nsource = 'small'\ntarget = 'room'\nmapping = 'identity'\n"
    file.write_text(f"{ROOMS.replace(ROOM, line)}{small}\n{edge}")
    for folder, changed in (("a", ""), ("c", "\nREWARD = 10\n")):
        Path("own.py").write_text(OWN_ROOM + changed)
        run_study(cr.read_study(file, set=["opponents=[]", "seeds=2"]), folder)
    shutil.copytree("a", "b")
    assert len(compare_studies([StudyResults("a"), StudyResults("b")]).arms) == 3
    with pytest.raises(CurriculumError, match="its code tells, which is not the same in a and c"):
        compare_studies([StudyResults("a"), StudyResults("c")])
