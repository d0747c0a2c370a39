"""Encoders in study files: by name, with settings, as functions; no torch is needed."""

import pytest

import curricle as cr
from curricle.errors import ConfigError
from curricle.interop import FlatDict, MiniGridFullView, MiniGridView, StackedFrames
from curricle.study import StudyConfig
from tests.studies import reader

pytest.importorskip("minigrid", reason="the extra minigrid is not installed")
LEVEL = "minigrid:MiniGrid-Empty-5x5-v0"
STUDY = f"""
name = "level"
budget = 100
[tasks.level]
type = "observation_task"
id = "{LEVEL}"
encode = ENCODE
learner = {{ type = "deep" }}
"""
OWN = """
import gymnasium

def image(env):
    return gymnasium.wrappers.FilterObservation(env, ["image"])

def half(image):
    return image / 2

def level(size):
    return gymnasium.make("minigrid:MiniGrid-Empty-5x5-v0", size=size)
"""


@pytest.fixture
def read(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    return lambda encode, text=STUDY: reader(tmp_path)(text.replace("ENCODE", encode))


@pytest.fixture
def complaint(read, tmp_path):
    def collect(encode):
        with pytest.raises(ConfigError) as caught:
            _ = read(encode).curricula
        return str(caught.value).replace(f"{tmp_path}/study.toml, ", "")

    return collect


def only_task(study):
    (curriculum,) = study.curricula.values()
    return curriculum.tasks["level"]


@pytest.mark.parametrize(
    ("encode", "made"),
    [
        ("'MiniGridView'", MiniGridView()),
        ("{ type = 'MiniGridView', picture = true }", MiniGridView(picture=True)),
        ("{ type = 'MiniGridFullView', width = 9, height = 7 }", MiniGridFullView(9, 7)),
        ("{ type = 'FlatDict', leave_out = ['mission'] }", FlatDict(["mission"])),
        (
            "{ type = 'StackedFrames', n = 2, of = 'MiniGridView' }",
            StackedFrames(2, MiniGridView()),
        ),
    ],
)
def test_an_encoder_has_its_name_and_settings(read, tmp_path, encode, made):
    study = read(encode)
    assert only_task(study) == cr.observation_task(LEVEL, encode=made)
    again = StudyConfig.from_data(study.to_data(), tmp_path)
    assert again.to_data() == study.to_data()
    assert only_task(again) == only_task(study)


def test_a_function_of_environments_is_one(read):
    task = only_task(read("{ type = 'StackedFrames', n = 2, of = 'MiniGridView' }"))
    assert task != only_task(read("'MiniGridView'"))
    text = STUDY.replace('type = "deep"', 'type = "deep", policy = "MultiInputPolicy"')
    with pytest.raises(ConfigError, match="reads pictures by NatureCNN"):
        _ = read("'own:image'", text).curricula
    own = STUDY.replace(f'id = "{LEVEL}"', "factory = 'own:level'\narguments = { size = 6 }")
    task = only_task(read("'MiniGridView'", own))
    assert task.observations.shape == (984,)
    assert task.environment().unwrapped.width == 6


def test_tables_are_encoded_too(read):
    text = STUDY.replace('"observation_task"', '"tabulated"')
    text = text.replace('learner = { type = "deep" }', "")
    table = only_task(read("'MiniGridView'", text))
    assert table.observations.batch().shape == (table.states.size, 984)


@pytest.mark.parametrize(
    ("encode", "sentence"),
    [
        ("'MiniGridVew'", "line 7: tasks.level.encode must be one of MiniGridView"),
        ("'MiniGridFullView'", "must be a table, as MiniGridFullView needs width and height"),
        ("{ type = 'MiniGridView', pictur = 1 }", "encode.pictur is unknown, did you mean"),
        ("{ type = 'MiniGridFullView', width = 4, height = 9 }", "must fit into its encoder's 4 x"),
        ("{ type = 'FlatDict', leave_out = ['words'] }", "must name keys of the Dict"),
        ("{ type = 'StackedFrames', of = 'MiniGridView' }", "encode.n is missing"),
        ("'own:half'", "own:half failed with TypeError"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_place(complaint, encode, sentence):
    assert sentence in complaint(encode)


def test_what_a_network_cannot_take_is_told_when_the_file_is_checked(read):
    with pytest.raises(ConfigError, match=r"'mission' is MissionSpace.*MiniGridView"):
        _ = read("", STUDY.replace("encode = ENCODE", "")).curricula
