"""Study files, names and paths that nobody writes by accident: a sentence, at once."""

import os
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.checks import unfit_name
from curricle.cli.app import main
from curricle.cli.output import graph, print_forecasts, print_table
from curricle.errors import ConfigError, CurriculumError, MappingError, SettingError
from curricle.learning.seeds import MOST_SEEDS, seed_tuple
from curricle.show.report import render
from curricle.study import StudyStore, read_study
from curricle.study.arms import Arms, units_of
from curricle.study.cost import costs
from tests.studies import MAZE, complaints_of

LONG = "x" * 300
REVERSED = "a\u202eb"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("depth", [60, 400, 5000])
@pytest.mark.parametrize(("begin", "end"), ["[]", ("{a = ", "}")])
def test_deep_nesting_is_refused(depth, begin, end):
    Path("study.toml").write_text(f"{MAZE}\ndeep = {begin * depth}0{end * depth}")
    with pytest.raises(ConfigError, match="not valid TOML: tables and lists must be at most 50 d"):
        read_study("study.toml")
    Path("study.toml").write_text(MAZE)
    with pytest.raises(ConfigError, match="a setting must be key=value"):
        read_study("study.toml", set=[".".join(["a"] * depth) + "=1"])


@pytest.mark.parametrize("number", ["1" + "0" * 5000, "0x1" + "0" * 5000])
def test_numbers_of_thousands_of_digits_are_refused(number):
    Path("study.toml").write_text(f"{MAZE}\nbudget = {number}")
    with pytest.raises(ConfigError, match="whole numbers must have at most 4,096 bits"):
        read_study("study.toml")


@pytest.mark.parametrize("place", ["study", "map"])
@pytest.mark.parametrize("kind", ["pipe", "device", "directory", "large"])
def test_what_is_no_file_is_not_waited_for(kind, place):
    path = Path("study.toml" if place == "study" else "map.txt")
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "directory":
            path.mkdir()
        case _:
            with path.open("wb") as file:
                file.truncate(2**34)  # 16 GB that take no place
    if place == "map":
        Path("study.toml").write_text("name = 'x'\ntasks.m = { type = 'maze', file = 'map.txt' }")
    with pytest.raises(ConfigError, match=r"regular file|directory|more than 10,000,000 bytes"):
        read_study("study.toml")


@pytest.mark.parametrize("name", [LONG, REVERSED, "a\nb", "a\0b", "\u200b", ""])
def test_names_that_no_table_can_show_are_refused(name):
    quoted = "".join(f"\\U{ord(text):08x}" for text in name)
    task = f"[tasks.\"{quoted}\"]\ntype = 'maze'\nmap = 'S.T'\n"
    assert any("has a name that must" in text for text in complaints_of(f"name = 'x'\n{task}"))
    arm = f'\n[arms."{quoted}"]\nbudget = 5'
    assert any("has a name that must" in text for text in complaints_of(MAZE + arm))
    (sentence,) = complaints_of(MAZE.replace('"maze"', f'"{quoted}"', 1))
    assert "name must" in sentence
    assert sentence.isprintable()
    assert len(sentence) < 200
    maze = cr.GridWorld("S.T")
    with pytest.raises(CurriculumError, match="the name of a task must"):
        cr.Curriculum({name: maze})
    with pytest.raises(CurriculumError, match="the name of an arm must"):
        cr.compare({name: cr.Curriculum({"maze": maze})})


@pytest.mark.parametrize("name", ["5 × 5", "Łódź", "漢字", "x" * 100, r"$\frac{a$", "a, b", "<b>"])
def test_other_names_are_names(name):
    assert not unfit_name(name)


@pytest.mark.parametrize("name", ["[red]b", "[/b]", ":bug:"])
def test_names_with_the_marks_of_terminals_are_shown_as_they_are(name, capsys):
    print_table(("", "seeds"), [(name, "2")])
    assert name in capsys.readouterr().out


def test_pages_write_control_and_format_characters_out():
    title = f"{REVERSED}\a <\u2066x>\u00a0"
    page = render("paper.html", title=title, counts={}, sections=[], seeds="")
    assert r"a\u202eb\x07 &lt;\u2066x&gt;" in page
    assert not {"\u202e", "\u2066", "\a"} & set(page)


def test_seeds_are_as_many_and_as_large_as_can_be_counted():
    for seeds in (2**63, 2**62, MOST_SEEDS + 1):
        with pytest.raises(SettingError, match=r"below 2\^63|at most 100,000"):
            seed_tuple(seeds)
    with pytest.raises(SettingError, match=r"each of seeds must be .* below 2\^63"):
        seed_tuple([2**63])
    (sentence,) = complaints_of(f"seeds = [{2**63}]\n{MAZE}")
    assert "seeds must be a number of seeds, a list of different ones" in sentence


def test_units_of_many_seeds_are_made_at_once():
    Path("study.toml").write_text(f"seeds = {MOST_SEEDS}\nseeds_per_unit = 1\n{MAZE}")
    study = read_study("study.toml")
    units = units_of(study, Arms.of(study), {})
    assert len(units) == 2 * MOST_SEEDS
    assert np.unique([unit.snapshots > 0 for unit in units[:3]]).size == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ["new", "maze", LONG],
        ["check", LONG],
        ["run", "study.toml", "--out", LONG],
        ["run", "study.toml", "--out", f"a/{LONG}/b"],
        ["run", "study.toml", "--dry-run", "--out", LONG],
        ["show", LONG],
        ["report", LONG],
        ["compare", LONG],
        ["merge", "there", LONG],
        ["paper", "--figure", "1", "--out", LONG],
    ],
)
def test_paths_of_300_characters_are_refused(arguments, monkeypatch, capfd):
    Path("study.toml").write_text(MAZE)
    monkeypatch.setattr(sys, "argv", ["curricle", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    complaint = capfd.readouterr().err
    assert ended.value.code == 1
    assert complaint.startswith("curricle: ")
    assert "File name too long" in complaint
    assert "Traceback" not in complaint


def test_what_a_killed_run_left_is_swept_in_every_folder(tmp_path):
    for resume in (False, True):
        for folder in ("data", "units/maze-1"):
            (tmp_path / "out" / folder).mkdir(parents=True, exist_ok=True)
            (tmp_path / "out" / folder / ".0123456789abcdef.part").write_bytes(b"half")
        (tmp_path / "out" / ".link.part").symlink_to(tmp_path)
        with StudyStore.opened(tmp_path / "out", {"seeds": 2}, resume=True) as store:
            store.write_json("claims.json", [])
        assert not list((tmp_path / "out").rglob("*.part")), resume


def test_a_preview_of_a_target_too_large_to_count():
    text = textwrap.dedent("""
        name = "many"
        tasks.one = { type = "pursuit", size = 10, predators = 1, budget = 10 }
        tasks.all = { type = "pursuit", size = 10, predators = 5, budget = 10 }
        transfers = [{ source = "one", target = "all", project = { predator = "predator_1" } }]
    """)
    Path("study.toml").write_text(text)
    curriculum = read_study("study.toml").curriculum("transfer")
    assert not any("pairs mapped" in line for line in graph(curriculum))
    with pytest.raises(MappingError, match="index array for up to 500,000,000 target pairs: got"):
        curriculum.transfers[0].mapping.coverage()


def test_a_forecast_that_solves_an_enormous_source_is_not_begun(capsys, monkeypatch):
    monkeypatch.setattr("curricle.cli.output.LONGEST_COMPARING", 5.0)
    maze = "tasks.{} = {{ type = 'maze', map = '{}', discount = 0.99, time_limit = 9, budget = 9 }}"
    mazes = [maze.format("far", f"S{300_000 * '.'}T"), maze.format("near", "S..T")]
    edge = "transfers = [{ source = 'far', target = 'near', mapping = 'same_position' }]"
    Path("study.toml").write_text("\n".join(["name = 'far'", *mazes, edge]))
    study = read_study("study.toml")
    arms = Arms.of(study)
    print_forecasts(study, arms, costs(study, arms), whole=False)
    assert "no forecast: to compare the potentials in near could take" in capsys.readouterr().out


def test_a_forecast_of_endless_rollouts_is_not_begun(capsys):
    text = textwrap.dedent("""
        name = "endless"
        seeds = 2
        scratch = false
        learner = { type = "deep" }
        tasks.one = { type = "observation_task", id = "CartPole-v1", budget = 10 }
        tasks.all = { type = "observation_task", id = "CartPole-v1", budget = 10 }
        transfers = [{ source = "one", target = "all", mapping = "identity" }]
    """)
    Path("study.toml").write_text(text)
    study = read_study(
        "study.toml", set=["tasks.all.arguments={ max_episode_steps = 1_000_000_000 }"]
    )
    arms = Arms.of(study)
    print_forecasts(study, arms, costs(study, arms), whole=False)
    assert "no forecast: to compare the potentials in all could take" in capsys.readouterr().out
