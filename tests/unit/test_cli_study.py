"""The command: its help and exit codes; studies that it makes, runs and reads, and their pages."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import webbrowser
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from threading import Event
from urllib.parse import urlparse

import pytest
from typer.testing import CliRunner

from curricle.cli import progress_bars
from curricle.cli.app import app
from curricle.show.report import page_of
from curricle.study import StudyResults, StudyStore, read_study
from curricle.study.templates import KINDS
from tests.support.studies import CORNER
from tests.unit.test_config_sweeps import MAZES

pytestmark = pytest.mark.usefixtures("quick_disk")
RUNS = Path(__file__).parents[2] / "examples" / "other_runs" / "runs.csv"


@pytest.fixture
def refused(curricle):
    """A function: code, words, arguments -> the command ends so, with one sentence, unprinted."""

    def run(code, fragment, *arguments):
        ended, out, complaint = curricle(*arguments)
        assert ended == code, complaint
        assert fragment in " ".join(complaint.split())
        assert "Traceback" not in complaint
        assert not out

    return run


@pytest.fixture
def printed(curricle):
    """A function: arguments -> what the command, which succeeds, prints."""

    def run(*arguments):
        code, out, complaint = curricle(*arguments)
        assert code == 0, complaint
        return out

    return run


@pytest.fixture
def answer(printed):
    """A function: arguments -> the object that the command prints with --json, and no NaN."""
    return lambda *arguments: json.loads(printed(*arguments, "--json"), parse_constant=pytest.fail)


# -- new, check, schema ------------------------------------------------------------------------


def test_a_new_study_runs_as_it_is_and_its_commands_can_be_pasted(printed, refused, tmp_path):
    listed = printed("new").splitlines()[1 : 1 + len(KINDS)]
    assert [line.split()[0] for line in listed] == list(KINDS)
    check, run = "curricle check 'my maze.toml'", "curricle run 'my maze.toml'"
    assert printed("new", "maze", "my maze.toml") == f"Wrote my maze.toml: {check}, then {run}\n"
    study = read_study(tmp_path / "my maze.toml")
    names = {name for plan in study.arms.values() for name in plan.tasks}
    quick = [f"--set=tasks.{name}.budget=400" for name in names]
    out = printed("run", "my maze.toml", "--seeds", "1", *quick)
    show, report = "curricle show 'my maze-results'", "curricle report 'my maze-results'"
    assert out == f"Stored in my maze-results: {show}, {report}\n"
    done = StudyResults(tmp_path / "my maze-results")
    assert (done.seeds, done.record.name) == ((0,), study.name)
    out = printed("show", "my maze-results")  # one seed, which deviates from nothing
    assert "1 of 1 seed finished" in out
    assert "±" not in out
    # A report that would be refused is not offered.
    alone = ("--seeds=1", *quick, "--set", "scratch=false", "--out", "alone")
    assert printed("run", "my maze.toml", *alone) == "Stored in alone: curricle show alone\n"
    refused(1, "a comparison needs the target learnt from scratch", "report", "alone")


def test_a_new_study_takes_nobodys_place(printed, refused, tmp_path):
    (tmp_path / "maze.toml").write_text("years of work")
    refused(1, "a new study needs a new file: maze.toml is there already", "new", "maze")
    assert (tmp_path / "maze.toml").read_text() == "years of work"
    (tmp_path / "Absent.toml").write_text("")  # nothing is imported or searched before it is seen
    refused(1, "needs a new file: Absent.toml is there already", "new", "absent:Absent")
    refused(1, "cannot be written to nowhere/maze.toml", "new", "maze", "nowhere/maze.toml")
    refused(1, "called 'labyrinth'; curricle new without a name lists", "new", "labyrinth")
    refused(1, "no study 'mase' to start from, did you mean 'maze'?", "new", "mase")
    refused(1, "did you mean FrozenLake-v1", "new", "FrozenLakes-v1")
    printed("new", "maze", "other.toml")


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("Blackjack-v1", "tabulated"),
        ("MiniGrid-Empty-5x5-v0", "tabulated"),
        ("MiniGrid-Dynamic-Obstacles-5x5-v0", "observation_task"),
        ("CartPole-v1", "gymnasium"),
        ("Acrobot-v1", "observation_task"),
    ],
)
def test_a_new_study_of_an_environment_is_one(printed, tmp_path, name, form):
    printed("new", name)
    assert f'type = "{form}"' in (tmp_path / f"{name}.toml").read_text()
    assert read_study(tmp_path / f"{name}.toml").curricula


def test_check_tells_all_and_trains_sources_only(printed, study_file, calls, tmp_path):
    out = printed("check", study_file)
    lines = out.splitlines()
    assert lines[0] == "chain: 4 arms, 4 seeds, 16 units"
    cost_at = next(n for n, line in enumerate(lines) if line.startswith("cost at most"))
    heads = [line for line in lines[:cost_at] if line.startswith("arm")]
    assert heads == ["arm scratch", "arms chain, state", "arm scaled"]  # a graph is drawn once
    assert "  maze: 14 states x 4 actions; QLearning; 1,500 steps" in lines
    assert any(line.startswith("    easy -> maze: ") for line in lines)
    bill = [line.split() for line in lines if ": " in line and line.endswith(" s")]
    assert [row[:4] for row in bill][:2] == [
        ["scratch:", "maze", "4", "1,500"],
        ["chain:", "corner", "4", "300"],
    ]
    assert not any(row[:2] == ["state:", "corner"] for row in bill)  # shared with the arm before
    assert "about" in out
    assert "one processor" in out
    assert re.search("arm chain\ntraining .*\nForecast for 'maze': ", out)
    said = re.findall(r"about [\d,]+ seeds show a gain of .*? this study has 4", " ".join(lines))
    assert len(said) == 3  # of each arm
    # Of "state" and "scaled" too. Trials train tasks of other names, the target's among them.
    trained = [call["stream"] for call in calls]
    once = [name for name in trained if not name.endswith("/trial")]
    assert once == ["corner", "easy", "easy", "easy"]
    assert "maze/trial" in trained
    assert max(map(len, lines)) <= 80
    assert not list(tmp_path.iterdir())


# -- run ---------------------------------------------------------------------------------------


def test_run_seeds_settings_workers_and_resume(curricle, printed, study_file, tmp_path):
    run = partial(curricle, "run", study_file, "--set", "tasks.maze.budget=300")
    code, out, progress = run("--seeds", "0-2", "--workers", "1")
    assert code == 0
    assert out == (
        "Stored in chain-results: curricle show chain-results, curricle report chain-results\n"
    )
    assert "\n16 of 16 units, 1 worker\n" in progress
    done = StudyResults(tmp_path / "chain-results")
    assert (done.seeds, done.record.budget) == ((0, 1, 2), 300)
    code, _, complaint = run("--seeds", "0-3")
    assert code == 1
    assert "curricle: chain-results already holds results, 16 files of units: go on" in complaint
    code, _, progress = run("--seeds", "0-3", "--resume")
    assert code == 0
    assert "\n8 of 8 units, " in progress
    out = printed("run", study_file, "--resume", "--dry-run")
    assert out.startswith("scratch: maze, seeds 0-3, is stale and trained again: budget was 300")


def test_run_in_processes_is_the_same(printed, study_file, finished, tmp_path, contents):
    printed("run", study_file, "--out", "out", "--processes", "--workers", "1")
    assert contents(tmp_path / "out") == contents(finished)


def test_a_dry_run_says_what_is_left_and_does_nothing(
    printed, refused, study_file, finished, copied, tmp_path, contents
):
    refused(1, "results need a folder", "run", study_file, "--dry-run", "--out", study_file)
    dry = partial(printed, "run", study_file, "--dry-run", "--out")
    lines = dry("out").splitlines()
    assert lines[0] == "scratch: maze, seeds 0-1: 1,500 steps at most"
    assert lines[-1] == "16 units to do, 0 done, in out"
    assert len(lines) == 17
    assert not (tmp_path / "out").exists()
    assert dry("out", "--shard", "2/2").splitlines()[-1] == "8 units to do, 0 done, in out"
    lines = dry("out", "--arm", "chain").splitlines()[:-1]
    assert {line.partition(":")[0] for line in lines} == {"scratch", "chain"}
    StudyStore(copied).units()[0].path.unlink()
    before = contents(copied)
    assert dry(copied).splitlines() == [
        "chain: corner, seeds 0-1: 300 steps at most",
        f"1 unit to do, 15 done, in {copied}",
    ]
    assert contents(copied) == before


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["--shard", "3/2"], "a shard must be i/n"),
        (["--shard", "half"], "a shard must be i/n"),
        (["--shard", "9" * 5000 + "/1"], "a shard must be i/n"),
        (["--workers", "0"], "--workers"),
        (["--workers", "two"], "--workers"),
        (["--fast"], "No such option: --fast"),
    ],
)
def test_a_command_line_that_makes_no_sense(refused, study_file, tmp_path, arguments, fragment):
    refused(2, fragment, "run", study_file, *arguments, "--dry-run")
    assert not list(tmp_path.iterdir())


def interruptible():
    """Make SIGINT interrupt a child, even where the suite itself ignores it (``nohup ... &``)."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
def test_an_interrupted_run_ends_at_once_and_goes_on(printed, study_file, tmp_path):
    file = tmp_path / "long.toml"
    # Units of ten minutes each, after a quick one of each source.
    text = study_file.read_text().partition("[arms.chain]")[0]
    file.write_text(f"scratch = false\n{text}")
    command = [sys.executable, "-m", "curricle", "run", file, "--out", "out", "--workers", "1"]
    long = ["--set", "tasks.maze.budget=2_000_000_000", "--set", "tasks.maze.eval_freq=1_000_000"]
    with subprocess.Popen(
        [*command, *long], cwd=tmp_path, stderr=subprocess.PIPE, text=True, preexec_fn=interruptible
    ) as running:
        done = (line for line in running.stderr if " of 6 units" in line)
        lines = [*islice(done, 4)]  # both sources of both units
        running.send_signal(signal.SIGINT)
        lines += running.stderr.readlines()
    assert running.returncode == 130
    assert lines[-1] == "curricle: interrupted; what was stored before is whole\n"
    assert "Traceback" not in "".join(lines)
    assert {unit.about.task for unit in StudyStore(tmp_path / "out").units()} == {"corner", "easy"}
    out = printed("run", file, "--out", "out", "--dry-run", *long)
    assert out.splitlines()[-1] == "2 units to do, 4 done, in out"


# -- show, compare, merge ----------------------------------------------------------------------


def test_show_prints_how_far_it_is_and_what_paid(printed, refused, finished, copied):
    plain = out = printed("show", finished)
    assert out.startswith("chain: 4 of 4 seeds finished in every arm\n")
    study = StudyResults(finished)
    for arm, result in study.results.items():
        for node in result:
            (line,) = [text for text in out.splitlines() if text.startswith(f"{arm}: {node} ")]
            assert line.split()[2] == "4"
    assert out.endswith(f"\n{study.comparison}\n")
    out = printed("show", finished, "--arm", "chain", "--task", "easy")
    assert "chain: easy" in out
    assert "chain: maze" not in out
    assert "state: easy" not in out
    elsewhere = ["--arm", "scratch", "--task", "easy"]
    refused(1, "a task of 'scratch' must be one of maze", "show", finished, *elsewhere)
    out = printed("show", finished, "--explain")
    assert "strong gain: mean return above" not in plain
    assert out.startswith(plain)
    assert "\nstrong gain: mean return over" in out
    for unit in StudyStore(copied).units():
        unit.path.unlink()
    out = printed("show", copied)
    assert ("no unit is stored yet" in out, "greedy return" in out) == (True, False)


def test_answers_as_data_have_what_is_printed_and_nothing_else(
    answer, curricle, finished, copied, study_file
):
    shown, comparison = answer("show", finished), StudyResults(finished).comparison
    assert (shown["study"], shown["planned"], shown["seeds"]) == ("chain", [*range(4)], [*range(4)])
    assert {(row["arm"], row["task"]) for row in shown["tasks"]} >= {("chain", "easy")}
    rows = shown["comparison"]["arms"]
    for row, stated in zip(rows, comparison.rows(), strict=True):
        numbers = {key: None if value != value else value for key, value in stated.items()}
        assert row.items() >= numbers.items()
        curriculum = row["arm"] in comparison.controls
        assert row["headroom"] == (comparison.headroom(row["arm"]) if curriculum else None)
    assert shown["comparison"]["threshold"] == comparison.threshold
    assert len(answer("show", finished, "--decisions")["decisions"]) == 4 * 9
    compared = answer("compare", finished, "--against", "chain", "--explain")
    assert compared["arms"] == rows
    assert compared["against"]["scaled"]["rival"] == "chain"
    judged = answer("verdict", RUNS, "--charge", "pretrained=4096", "--out", "runs.html")
    assert judged["arms"][0]["arm"] == "scratch"
    checked = answer("check", study_file, "--quiet")
    assert checked["forecasts"].keys() == {"chain", "state", "scaled"}
    assert checked["forecasts"]["chain"]["trial"]["arms"]
    assert checked["units"] == 16
    for unit in StudyStore(copied).units():
        unit.path.unlink()
    assert answer("show", copied)["comparison"] is None
    code, out, complaint = curricle("show", "nowhere", "--json")
    assert (code, out, complaint[:10]) == (1, "", "curricle: ")


def test_quiet_commands_print_errors_alone(curricle, study_file):
    run = partial(curricle, "run", study_file, "--seeds", "1", "--quiet")
    assert run()[::2] == (0, "")  # also of too few seeds
    code, _, complaint = run()
    assert (code, complaint.count("\n")) == (1, 1)
    assert complaint.startswith("curricle: chain-results already holds results")


def test_the_list_of_folders_has_verdicts_and_what_is_lacking(curricle, finished, tmp_path):
    assert curricle("list") == (0, "no results in . or one level below\n", "")
    for name in ("damaged", "headless", "part", "whole/tuning"):
        shutil.copytree(finished, tmp_path / "all" / name)
    shutil.copytree(finished, tmp_path / "all/whole", dirs_exist_ok=True)
    next((tmp_path / "all/damaged").glob("units/*/*")).write_bytes(b"PK")
    (tmp_path / "all/headless/study.json").unlink()
    next((tmp_path / "all/part").glob("units/maze-*/seeds-2-3.npz")).unlink()
    code, out, complaint = curricle("list")
    assert (code, complaint) == (0, "")
    rows = {line.split()[0].partition("/")[2]: line for line in out.splitlines()[1:]}
    assert [*rows] == ["damaged", "headless", "part", "whole"]  # no trials of a study
    assert "is damaged" in rows["damaged"]
    assert "study.json" in rows["headless"]
    assert " chain     4  2 of 4  interim, 2 of 4 seeds: no verdict" in rows["part"]
    assert " 4 of 4  too few seeds" in rows["whole"]
    assert curricle("list", "all/whole")[1].splitlines()[1].startswith("all/whole ")


def test_a_mistake_in_a_file_and_folders_to_be_merged(
    printed, refused, study_file, finished, copied, tmp_path
):
    file = tmp_path / "wrong.toml"
    file.write_text(study_file.read_text().replace("shaping = ", "shapping = ", 1))
    line = 1 + file.read_text().partition("shapping")[0].count("\n")
    refused(1, f"curricle: {file}, line {line}: ", "check", file)
    refused(1, "shapping is unknown, did you mean 'shaping'?", "run", file)
    assert printed("merge", "whole", finished, copied) == "4 seeds of 2 folders in whole\n"
    for name in ("results.parquet", "decisions.parquet"):
        assert (tmp_path / "whole" / name).read_bytes() == (finished / name).read_bytes()
    refused(2, "Missing argument", "merge", "whole")
    refused(1, "has none", "merge", "whole", "nowhere")


def test_closed_streams_end_no_command(finished):
    command = f"{sys.executable} -m curricle show {finished}"
    for closed in (">&-", ">&- 2>&-"):
        shell = ["sh", "-c", f"{command} {closed}"]
        done = subprocess.run(shell, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")


def test_decisions_are_sentences(printed, refused, finished):
    decisions = partial(printed, "show", finished, "--decisions")
    assert len(decisions().splitlines()) == 4 * 9  # the last of each seed of each task of each arm
    of_one = decisions("--arm", "chain", "--task", "corner", "--seed", "1")
    assert of_one.splitlines() == [
        f"chain: corner, seed 1: {reason}"
        for reason in StudyResults(finished).decisions("chain", "corner")[1]
    ]
    refused(1, "arm any, task any, seed 9", "show", finished, "--decisions", "--seed", "9")
    refused(2, "--seed needs --decisions", "show", finished, "--seed", "1")


def test_studies_of_one_target_are_compared(printed, refused, study_file, finished, tmp_path):
    quick, easy = ["--seeds", "0-2", "--workers", "2"], "tasks.easy.budget"
    for folder, steps in (("a/of_600", 600), ("b/of_500", 500), ("c/of_600", 600)):
        printed("run", study_file, "--out", folder, *quick, "--set", f"{easy}={steps}")
    out = printed("compare", "a/of_600", "b/of_500")
    assert "the best learner without a source, the target's own learner, leaves 0.0" in out
    arms = [line.split("  ")[0] for line in out.splitlines()[2:] if "  " in line]
    names = ("chain", "state", "scaled")
    apart = [f"{folder}: {arm}" for folder in ("of_600", "of_500") for arm in names]
    assert arms == ["scratch", *apart]  # by folder, where the names of studies are equal
    assert "1,400 steps" in out.splitlines()[0]  # the smaller total
    assert "3 seeds" in out.splitlines()[0]
    assert "c/of_600: chain" in printed("compare", "a/of_600", "c/of_600")
    assert printed("compare", finished) == f"{StudyResults(finished).comparison}\n"
    refused(1, "need different folders", "compare", finished, finished)
    file = tmp_path / "stated.toml"
    file.write_text(f"threshold = 5.5\n{Path(study_file).read_text()}")
    printed("run", file, "--out", "c/of_600", "--resume", *quick, "--set", f"{easy}=600")
    differs = "threshold: 'chain' and 'chain' have none stated and 5.5; state one"
    refused(1, differs, "compare", "a/of_600", "c/of_600")


# -- sweeps and tunings ------------------------------------------------------------------------

SWEEP = "[sweep]\nlearner.learning_rate = [0.1, 0.3]\n"
TUNE = "[tune]\ntrials = 2\nseeds = 1\n[tune.space]\nlearner.epsilon = [0.1, 0.3]\n"


def test_check_says_what_a_sweep_and_a_tuning_cost(printed, tmp_path):
    (tmp_path / "mazes.toml").write_text(MAZES + SWEEP + TUNE)
    out = printed("check", "mazes.toml")
    assert "mazes: 4 arms, 2 seeds, 6 units" in out
    assert "swept: learner.learning_rate = 0.1, 0.3" in out
    text = " ".join(out.split())
    assert "before that, tuning: 8 trials on seed 1000000, 9,600 steps, about" in text
    assert "forecasts are for the first settings of each arm" in out


def test_a_tuned_sweep_is_run_shown_and_resumed(curricle, printed, tmp_path):
    (tmp_path / "mazes.toml").write_text(MAZES + SWEEP + TUNE)
    assert printed("run", "mazes.toml", "--dry-run").startswith("first of all 8 trials; ")
    code, _, complaint = curricle("run", "mazes.toml")
    assert code == 0
    assert "tuning: 8 trials" in complaint
    out = printed("show", "mazes-results")
    assert "tuned on seed 1000000, " in out
    assert "shown here and not charged to the curves" in " ".join(out.split())
    assert out.count("main effects: mean return") == 1
    assert re.search(r"scratch +learner.learning_rate +0.3 ", out)
    assert "nan" not in out
    assert printed("run", "mazes.toml", "--dry-run", "--resume").startswith("0 units to do")
    code, _, complaint = curricle("run", "mazes.toml")
    assert code == 1
    assert "go on with --resume" in complaint


# -- sentences -----------------------------------------------------------------------------------


def python(*arguments, **environment):
    """Return a finished process of Python; it does not import what is slow to import."""
    env = {**os.environ, **environment}
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=env)


LIGHT = """
import sys
from curricle.cli import main
sys.argv = ['curricle', *sys.argv[1:]]
try: main()
except SystemExit: pass
finally: assert not {'numba', 'matplotlib', 'pyarrow'} & set(sys.modules)
"""
"""Runs a command, which must not import what takes long."""


@pytest.mark.parametrize(
    "command", [known.name or known.callback.__name__ for known in app.registered_commands]
)
def test_nothing_is_cut_in_the_help_at_80_columns(command):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "80"}).stdout
    assert f" {command} [OPTIONS]" in shown
    assert "…" not in shown
    assert not re.search("<bool>|--no-", shown)


def test_help_imports_neither_numba_nor_matplotlib():
    done = python("-c", LIGHT, "--help")
    assert done.returncode == 0, done.stderr
    assert "Exit codes" in done.stdout


def test_the_version_is_the_packages():
    done = python("-m", "curricle", "--version")
    assert (done.returncode, done.stdout) == (0, f"curricle {version('curricle')}\n")


@pytest.mark.parametrize(("typed", "expected"), [("che", "check"), ("new ma", "maze")])
def test_a_shell_completes_commands_and_kinds(typed, expected):
    asked = {"COMP_WORDS": f"curricle {typed}", "COMP_CWORD": str(len(typed.split()))}
    done = python("-c", LIGHT, _CURRICLE_COMPLETE="complete_bash", **asked)
    assert done.stdout.split() == [expected]
    assert "AssertionError" not in done.stderr


def test_what_compiles_says_so_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = (
        "from curricle.progress import compilation\n"
        "listener = compilation()\n"
        "listener.prints = True\n"
        "from tests_loops import first, second\n"
        "first(1); second(1)\n"
        "print(listener.loops)"
    )
    (tmp_path / "tests_loops.py").write_text(
        "from numba import njit\n"
        "@njit\ndef part(n): return n + 1\n"
        "@njit(cache=True)\ndef first(n): return part(n)\n"
        "@njit(cache=True)\ndef second(n): return part(n) + 1\n"
    )
    done = [python("-c", code, NUMBA_CACHE_DIR=str(tmp_path / "cache")) for _ in range(2)]
    said = [(run.stdout, run.stderr.count("curricle: compiling, once")) for run in done]
    assert said == [("2\n", 1), ("0\n", 0)]


# -- run --open --------------------------------------------------------


@pytest.fixture
def opened(monkeypatch):
    """The addresses that a browser was told to open, once there is one."""
    addresses, asked = [], Event()

    def note(address):
        addresses.append(address)
        asked.set()

    monkeypatch.setattr(webbrowser, "open", note)
    monkeypatch.setattr(progress_bars, "has_windows", lambda: True)
    return lambda: asked.wait(60) and addresses


def test_the_page_of_a_run_is_opened_while_it_runs_and_becomes_its_report(
    printed, opened, tmp_path
):
    Path("line.toml").write_text(CORNER, "utf-8")
    out = printed("run", "line.toml", "--open", "--seeds", "2", "--set", "budget=400")
    (address,) = opened()
    page = Path(urlparse(address).path)
    assert page == tmp_path / "line-results" / "report.html"
    assert out.startswith("Open line-results/report.html: it is written anew")
    assert page.read_text("utf-8") == page_of(StudyResults("line-results"))


def test_the_page_of_a_study_that_compares_nothing_is_no_report(
    printed, opened, study_file, tmp_path
):
    alone = ["--seeds", "1", "--set", "compared=false", "--arm", "chain", "--open"]
    printed("run", study_file, "--out", tmp_path / "out", *alone)
    assert "The run is over" in (tmp_path / "out" / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("variables", "windows"),
    [({}, False), ({"DISPLAY": ":0"}, True), ({"WAYLAND_DISPLAY": "wayland-0"}, True)],
)
def test_a_browser_in_the_terminal_is_not_opened(monkeypatch, variables, windows):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert progress_bars.has_windows() is windows
