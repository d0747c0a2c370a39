"""The command: help, exit codes, errors as a sentence; and what ``watch`` opens."""

import os
import re
import signal
import subprocess
import sys
import webbrowser
from importlib.metadata import version
from pathlib import Path
from threading import Event
from urllib.parse import urlparse

import pytest
from typer.testing import CliRunner

from curricle.cli import progress_bars
from curricle.cli.app import app
from curricle.show.report import page_of
from curricle.study import StudyResults
from tests.studies import CORNER

pytestmark = pytest.mark.usefixtures("quick_disk")


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
    "command", [registered.callback.__name__ for registered in app.registered_commands]
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


# -- watch ------------------------------------------------------------


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


def test_a_finished_study_is_watched_to_its_end_outside_its_folder(
    curricle, opened, copied, contents
):
    before = contents(copied)
    code, out, _ = curricle("watch", copied)
    (address,) = opened()
    page = Path(urlparse(address).path)
    assert (code, page.name, page.parent == copied) == (0, "report.html", False)
    assert page.read_text("utf-8") == page_of(StudyResults(copied))
    assert out.splitlines()[-1] == f"The run is over: {page}"
    assert contents(copied) == before


def test_a_study_that_compares_nothing_is_watched_to_its_end(
    curricle, opened, study_file, tmp_path
):
    alone = ["--seeds", "1", "--set", "compared=false", "--arm", "chain"]
    assert curricle("run", study_file, "--out", tmp_path / "out", *alone)[0] == 0
    code, out, _ = curricle("watch", tmp_path / "out")
    assert (code, "The run is over: " in out, len(opened())) == (0, True, 1)


SHORT = "budget=400"


def test_the_page_of_a_run_is_watched_while_it_runs(tmp_path, monkeypatch):
    """In another process, which ends as the run does."""
    monkeypatch.chdir(tmp_path)
    Path("line.toml").write_text(CORNER, "utf-8")
    run = python("-m", "curricle", "run", "line.toml", "--open", "--seeds", "2", "--set", SHORT)
    assert run.returncode == 0, run.stderr
    page = Path("line-results/report.html")
    assert f"The run is over: {page}" in run.stdout
    assert page.read_text("utf-8") == page_of(StudyResults("line-results"))


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


@pytest.mark.parametrize("url", ["file:///nowhere/at-all", "http://nowhere/study"])
def test_a_url_without_a_study_is_refused(curricle, url):
    code, out, complaint = curricle("watch", url)
    assert (code, out) == (1, "")
    assert len(complaint.splitlines()) == 1
    assert "nowhere" in complaint


def interruptible():
    """Make SIGINT interrupt a child, even where the suite itself ignores it (``nohup ... &``)."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
def test_watching_ends_when_interrupted_and_leaves_the_folder(copied, contents, tmp_path):
    (copied / "analysis.json").unlink()  # the run has not ended
    before, page = contents(copied), tmp_path / "page.html"
    command = [sys.executable, "-m", "curricle", "watch", copied, "--out", page]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=interruptible
    ) as watching:
        assert watching.stdout.readline().startswith(f"Open {page}")
        assert 'data-seconds="0' not in page.read_text("utf-8")
        watching.send_signal(signal.SIGINT)
        _, complaint = watching.communicate()
    assert watching.returncode == 130
    assert complaint == "curricle: interrupted; what was stored before is whole\n"
    assert 'data-seconds="0"' in page.read_text("utf-8")
    assert contents(copied) == before
