"""Mappings that a curriculum or a study file finds by itself, printed or refused."""

import pytest

import curricle as cr
from curricle import Transfer, read_study
from curricle.errors import CurriculumError, MappingError
from curricle.transfer import auto_mapping
from curricle.transfer.transfer import transfer_words
from tests.tasks import ring

MAZE = cr.GridWorld(["S..P", ".F..", "...T"], time_limit=50)
MIRRORED = cr.GridWorld([row[::-1] for row in MAZE.map], time_limit=50)


def test_a_transfer_without_a_mapping_gets_the_best_and_says_so(capsys):
    edge = Transfer("mirrored", "maze", scale=2)
    made = cr.Curriculum({"maze": MAZE, "mirrored": MIRRORED}, [edge], budget=100)
    out = capsys.readouterr().out
    assert out.startswith("mapping found for mirrored -> maze: exact homomorphism: 100%")
    assert "regains 100%" in out
    assert "\n  runner-up: " in out
    (found,) = made.transfers
    assert found.scale == 2
    assert "found: exact homomorphism" in transfer_words(found)
    assert (found.mapping.index == auto_mapping(MAZE, MIRRORED).mapping.index).all()
    made.train()
    assert made.replace("maze", budget=50).transfers == made.transfers


def test_a_transfer_that_is_not_in_a_curriculum_has_no_potential_yet():
    with pytest.raises(CurriculumError, match="found when a curriculum is made"):
        Transfer("a", "b").potential([[0.0]])


def test_a_source_with_another_goal_is_refused_in_one_sentence():
    other = cr.GridWorld(["T...", "....", "...S"], rewards=cr.Rewards(treasure=-50, step=1))
    with pytest.raises(MappingError, match=r"the best that is found, .*, regains .*% and leaves"):
        auto_mapping(MAZE, other)
    with pytest.raises(CurriculumError, match="no mapping for other -> maze: a mapping is used"):
        cr.Curriculum({"maze": MAZE, "other": other}, [Transfer("other", "maze")])


def test_a_task_without_tables_is_refused():
    edge = Transfer("ring", "maze")
    with pytest.raises(CurriculumError, match="with tables: the source has none, find_mappings"):
        cr.Curriculum({"maze": MAZE, "ring": ring()}, [edge])


STUDY = """
name = "mirror"
[tasks.maze]
type = "maze"
map = "S..P\\n.F..\\n...T"
budget = 100
[tasks.mirrored]
type = "maze"
map = "P..S\\n..F.\\nT..."
budget = 100
[[transfers]]
source = "mirrored"
target = "maze"
mapping = "auto"
"""


def test_a_study_file_finds_its_mapping(tmp_path, capsys):
    path = tmp_path / "mirror.toml"
    path.write_text(STUDY)
    study = read_study(path)
    (arm,) = study.arms
    (edge,) = study.curriculum(arm).transfers
    assert edge.mapping.how.startswith("exact homomorphism: 100%")
    assert "mapping found for mirrored -> maze" in capsys.readouterr().out
