"""What the command line says: commands that can be pasted, and numbers that there are."""

import shutil

import pytest

from curricle.study import StudyStore

pytestmark = pytest.mark.usefixtures("quick_disk")


def test_commands_with_spaces_can_be_pasted(curricle, tmp_path):
    _, out, _ = curricle("new", "maze", "my maze.toml")
    check, run = "curricle check 'my maze.toml'", "curricle run 'my maze.toml'"
    assert out == f"Wrote my maze.toml: {check}, then {run}\n"
    code, out, complaint = curricle(
        "run", "my maze.toml", "--seeds", "1", "--set", "tasks.maze.budget=400"
    )
    assert code == 0, complaint
    show, report = "curricle show 'my maze-results'", "curricle report 'my maze-results'"
    assert out == f"Stored in my maze-results: {show}, {report}\n"
    code, out, _ = curricle("show", "my maze-results")  # one seed, which deviates from nothing
    assert code == 0
    assert "1 of 1 seed finished" in out
    assert "±" not in out


def test_a_report_that_would_be_refused_is_not_offered(curricle):
    curricle("new", "maze")
    small = ("--seeds", "1", "--set", "tasks.maze.budget=400", "--set", "scratch=false")
    code, out, complaint = curricle("run", "maze.toml", *small)
    assert code == 0, complaint
    assert out == "Stored in maze-results: curricle show maze-results\n"
    code, _, complaint = curricle("report", "maze-results")
    assert code == 1
    assert "a comparison needs the target learnt from scratch" in complaint


def test_show_before_the_first_unit_has_no_empty_table(curricle, finished, tmp_path):
    begun = tmp_path / "begun"
    shutil.copytree(finished, begun)
    for unit in StudyStore(begun).units():
        unit.path.unlink()
    code, out, _ = curricle("show", begun)
    assert code == 0
    assert "no unit is stored yet" in out
    assert "greedy return" not in out
