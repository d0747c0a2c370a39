"""Old keys and flags are refused, each with its new name."""

import sys

import pytest

from curricle.cli.app import main
from curricle.errors import ConfigError
from curricle.study import read_study
from curricle.study.config.renamed_keys import FLAG, RENAMED, SETTING, STUDY

PLACES = {
    STUDY: ["{}"],
    SETTING: ["{}", "tasks.maze.{}", "arms.a.{}", "arms.a.tasks.maze.{}"],
    "task": ["tasks.maze.{}", "arms.a.tasks.maze.{}"],
}
BASE = 'name = "x"\narms.b.eval_freq = 5\ntasks.maze.map = "S.T"\n'


@pytest.mark.parametrize(("kind", "old"), [row for row in RENAMED if row[0] != FLAG])
def test_an_old_key_is_refused_wherever_it_may_stand(tmp_path, kind, old):
    key, _, value = old.partition(" = ")
    for place in PLACES[kind]:
        path = place.format(key)
        text = BASE + f"{path} = {repr(value) if value else 1}\n"
        if path != "tasks.maze.type":
            text += "tasks.maze.type = 'maze'\n"
        (tmp_path / "study.toml").write_text(text)
        with pytest.raises(ConfigError) as caught:
            read_study(tmp_path / "study.toml")
        assert str(caught.value) == (
            f"{tmp_path / 'study.toml'}, line 4: {path} was renamed: write {RENAMED[kind, old]}"
        )


def test_names_of_tasks_and_arguments_of_ones_own_are_no_old_keys(tmp_path):
    (tmp_path / "own.py").write_text("def make(block): pass")
    (tmp_path / "study.toml").write_text(
        "name = 'x'\n[tasks.every]\ntype = 'factory'\nfactory = 'own:make'\n"
        "arguments = { block = 3, how = 'fast' }\n"
    )
    assert list(read_study(tmp_path / "study.toml").arms["transfer"].tasks) == ["every"]


def test_an_old_key_that_is_set_is_refused_too(tmp_path):
    (tmp_path / "study.toml").write_text(BASE + "tasks.maze.type = 'maze'\n")
    with pytest.raises(ConfigError, match="as set: block was renamed: write seeds_per_unit"):
        read_study(tmp_path / "study.toml", set=["block=3"])


@pytest.mark.parametrize("flag", [old for kind, old in RENAMED if kind == FLAG])
@pytest.mark.parametrize("form", ["{} x", "{}=x"])
def test_an_old_flag_is_refused(flag, form, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["curricle", "show", "folder", *form.format(flag).split()])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    new = RENAMED[FLAG, flag]
    assert capsys.readouterr().err == f"curricle: {flag} was renamed: write {new}\n"
