"""The command: help, exit codes, errors as a sentence; and what ``run --open`` opens."""

import os
import re
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
from tests.support.studies import CORNER

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


SHORT = "budget=400"


def test_the_page_of_a_run_is_opened_while_it_runs_and_becomes_its_report(
    curricle, opened, tmp_path
):
    Path("line.toml").write_text(CORNER, "utf-8")
    code, out, _ = curricle("run", "line.toml", "--open", "--seeds", "2", "--set", SHORT)
    (address,) = opened()
    page = Path(urlparse(address).path)
    assert (code, page) == (0, tmp_path / "line-results" / "report.html")
    assert out.startswith("Open line-results/report.html: it is written anew")
    assert page.read_text("utf-8") == page_of(StudyResults("line-results"))


def test_the_page_of_a_study_that_compares_nothing_is_no_report(
    curricle, opened, study_file, tmp_path
):
    alone = ["--seeds", "1", "--set", "compared=false", "--arm", "chain", "--open"]
    assert curricle("run", study_file, "--out", tmp_path / "out", *alone)[0] == 0
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
