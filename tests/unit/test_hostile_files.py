"""Files, names and paths that nobody writes by accident, or that somebody sent.

What they name is not run, links are left, sizes are bounded: each is refused in a sentence.
"""

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

import curricle as cr
from curricle.checks import unfit_name
from curricle.cli.output import graph, print_forecasts, print_table
from curricle.comparison.cost import costs
from curricle.errors import (
    LONGEST,
    ConfigError,
    CurriculumError,
    LostStoreError,
    MappingError,
    SettingError,
    StoreError,
    TaskError,
)
from curricle.files import opened_archive
from curricle.learning.seeds import MOST_SEEDS, seed_tuple
from curricle.show.report import render
from curricle.study import StudyConfig, StudyStore, read_study, run_study
from curricle.study.arms import Arms, units_of
from curricle.study.store import LOCK, STUDY, UNITS, locked
from curricle.study.tuning import TRIALS
from curricle.study_file.own_code import ALLOW, load
from tests.support.refusals import KINDS_OF_NO_FILE, no_file
from tests.support.studies import MAZE, complaints_of

REVERSED = "a\u202eb"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_toml_of_which_nobody_writes_so_much_is_refused(read):
    too_deep = "tables and lists must be at most 50 deep"
    values = {f"{b * n}0{e * n}": too_deep for n in (60, 5000) for b, e in ("[]", ("{a = ", "}"))}
    values |= {"1" + "0" * 5000: "4300 digits", "0x1" + "0" * 5000: "4,096 bits"}
    for value, words in values.items():
        with pytest.raises(ConfigError, match=f"not valid TOML: .*{words}"):
            read(f"{MAZE}\nbudget = {value}")
    with pytest.raises(ConfigError, match="a setting must be key=value"):
        read(MAZE, set=[".".join(["a"] * 5000) + "=1"])


@pytest.mark.parametrize("kind", KINDS_OF_NO_FILE)
def test_what_is_no_file_is_not_waited_for(kind):
    Path("study.toml").write_text("name = 'x'\ntasks.m = { type = 'maze', file = 'map.txt' }")
    no_file(Path("map.txt"), kind)
    no_file(Path("other.toml"), kind)
    for name in ("study.toml", "other.toml"):
        with pytest.raises(ConfigError, match=r"regular file|directory|more than 1,048,576 bytes"):
            read_study(name)


def test_names_that_no_table_can_show_are_refused(capsys):
    for name in ("x" * 300, REVERSED, "a\nb", "a\0b", "\u200b", ""):
        quoted = "".join(f"\\U{ord(text):08x}" for text in name)
        task = f"name = 'x'\n[tasks.\"{quoted}\"]\ntype = 'maze'\nmap = 'S.T'\n"
        for text in (task, f'{MAZE}\n[arms."{quoted}"]\nbudget = 5'):
            assert any("has a name that must" in sentence for sentence in complaints_of(text))
        (sentence,) = complaints_of(MAZE.replace('"maze"', f'"{quoted}"', 1))
        assert "name must" in sentence
        assert sentence.isprintable()
        assert len(sentence) < 200
        maze = cr.GridWorld("S.T")
        with pytest.raises(CurriculumError, match="the name of a task must"):
            cr.Curriculum({name: maze})
        with pytest.raises(CurriculumError, match="the name of an arm must"):
            cr.compare({name: cr.Curriculum({"maze": maze})})
    for name in ("5 × 5", "Łódź", "漢字", "x" * 100, r"$\frac{a$", "a, b", "<b>"):
        assert not unfit_name(name)
    for name in ("[red]b", "[/b]", ":bug:"):  # marks of the terminal's library
        print_table(("", "seeds"), [(name, "2")])
        assert name in capsys.readouterr().out


def test_pages_write_control_and_format_characters_out():
    title = f"{REVERSED}\a <\u2066x>\u00a0"
    page = render("paper.html", {"title": title, "counts": {}, "sections": [], "seeds": ""})
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


def test_a_preview_of_a_target_too_large_to_count(read):
    study = read("""
        name = "many"
        tasks.one = { type = "pursuit", size = 10, predators = 1, budget = 10 }
        tasks.all = { type = "pursuit", size = 10, predators = 5, budget = 10 }
        transfers = [{ source = "one", target = "all", project = { predator = "predator_1" } }]
    """)
    curriculum = study.curriculum("transfer")
    assert not any("pairs mapped" in line for line in graph(curriculum))
    with pytest.raises(MappingError, match="index array for up to 500,000,000 target pairs: got"):
        curriculum.transfers[0].mapping.coverage()


ENORMOUS = f"""
name = 'far'
tasks.far = {{ type = 'maze', map = 'S{300_000 * "."}T', discount = 0.99, budget = 9 }}
tasks.near = {{ type = 'maze', map = 'S..T', discount = 0.99, time_limit = 9, budget = 9 }}
transfers = [{{ source = 'far', target = 'near', mapping = 'same_position' }}]
"""


def test_a_forecast_that_would_take_too_long_is_not_begun(read, capsys, monkeypatch):
    monkeypatch.setattr("curricle.cli.output.LONGEST_EXAMINING", 5.0)
    study = read(ENORMOUS)
    arms = Arms.of(study)
    print_forecasts(study, arms, costs(arms, units_of(study, arms, {})), whole=False)
    out = capsys.readouterr().out
    assert "no forecast: to examine its sources and near could take" in out


def test_pythons_own_library_is_refused(tmp_path, monkeypatch):
    made = tmp_path / "made"
    task = f"type = 'factory', factory = 'os:system', arguments = {{ command = 'touch {made}' }}"
    Path("study.toml").write_text(f"name = 'x'\ntasks.t = {{ {task} }}\n")
    for allowed in ("", "os,subprocess,builtins,posix"):
        monkeypatch.setenv(ALLOW, allowed)
        for name in ("os:system", "subprocess:run", "builtins:exec", "posix:system"):
            with pytest.raises(ConfigError, match="which can run any command, is refused"):
                load(name, tmp_path)
        with pytest.raises(ConfigError, match="is refused"):
            _ = read_study("study.toml").curricula
    assert not made.exists()


def test_an_installed_package_is_named_where_it_is_allowed(tmp_path, monkeypatch):
    monkeypatch.setenv(ALLOW, "nump,numpy.linal")
    for name in ("numpy:save", "numpy.linalg:norm", "curricle.files:write_whole", "__main__:x"):
        with pytest.raises(ConfigError, match=rf"set {ALLOW}=\w+ if you trust the file with it"):
            load(name, tmp_path)
    monkeypatch.setenv(ALLOW, "mine, numpy.linalg")
    assert load("numpy.linalg:norm", tmp_path) is np.linalg.norm
    with pytest.raises(ConfigError, match="numpy is not beside it"):
        load("numpy:save", tmp_path)
    (tmp_path / "numpy.py").write_text("def save(): return 'mine'")
    assert load("numpy:save", tmp_path)() == "mine"


def test_a_lock_that_is_a_link_is_not_followed(tmp_path):
    precious = tmp_path / "precious.txt"
    precious.write_text("words")
    (tmp_path / "sent").mkdir()
    (tmp_path / "sent" / LOCK).symlink_to(precious)
    with pytest.raises(StoreError, match=r"its \.lock must be no link"), locked(tmp_path / "sent"):
        pass
    assert precious.read_text() == "words"


@pytest.mark.parametrize("place", [UNITS, f"{UNITS}/maze-1", TRIALS])
def test_a_folder_that_is_a_link_is_not_written_to(place, tmp_path):
    (tmp_path / "precious" / "mine").mkdir(parents=True)
    for name in ("a.npz", "mine/a.npz"):
        (tmp_path / "precious" / name).write_text("words")
    link = tmp_path / "sent" / place
    link.parent.mkdir(parents=True)
    link.symlink_to(tmp_path / "precious")
    (tmp_path / "sent" / STUDY).write_text("{}")
    opened = StudyStore.opened(tmp_path / "sent", {}, resume=True)
    with pytest.raises(StoreError, match=f"must be no links: delete {link}"), opened:
        pass
    assert len([*(tmp_path / "precious").rglob("*.npz")]) == 2


@pytest.mark.parametrize(
    ("stored", "why"), [(0, "No such file or directory"), (3, "holds a study.json: .* has none")]
)
def test_a_folder_that_is_moved_while_a_run_writes_ends_it(stored, why, tmp_path):
    maze, near = ({"type": "maze", "map": m, "budget": 200} for m in ("S.T", "ST"))
    edge = {"source": "near", "target": "maze", "project": {}}
    arms = {"transfer": {"tasks": {"maze": maze, "near": near}, "transfers": [edge]}}
    study = StudyConfig.from_data(
        {"name": "line", "seeds": [0, 1], "arms": arms, "opponents": []}, tmp_path
    )
    folder = tmp_path / "results"

    def move(_):
        if len([*folder.rglob("*.npz")]) == stored:
            folder.rename(tmp_path / "moved")

    with pytest.raises(LostStoreError, match=why):
        run_study(study, folder, progress=move, workers=1)
    assert not folder.exists()


def test_a_file_of_holes_is_not_read(tmp_path):
    path, size = tmp_path / "unit.npz", 2**28
    with zipfile.ZipFile(path, "w") as archive:
        array = io.BytesIO()
        np.save(array, np.zeros(2**10))
        archive.writestr("steps.npy", array.getvalue())
    with path.open("r+b") as file:
        os.truncate(file.fileno(), size)
    refused = pytest.raises(ValueError, match="most are not on the disk")
    with refused, opened_archive(path, whole=True):
        pass


def test_messages_are_one_sentence_that_ends_with_its_end():
    text = str(TaskError("a map must be text:\n got " + "x" * 10**6 + "; write it so"))
    assert "\n" not in text
    assert len(text) == LONGEST
    assert text.endswith("; write it so")
    lines = str(ConfigError("\n".join(["x" * 9000] * 300))).splitlines()
    assert len(lines) == 21
    assert max(map(len, lines)) == LONGEST
    assert lines[-1] == "and 280 more"
    assert "hidden" not in str(StoreError("cannot be written to https:/me:hidden@host/x.html"))
