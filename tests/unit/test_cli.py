"""The command: help, exit codes, and errors as one sentence on standard error."""

import os
import subprocess
import sys
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from curricle.cli.app import app


def curricle(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "curricle", *arguments], cwd=cwd, capture_output=True, text=True
    )


@pytest.mark.parametrize("command", [one.callback.__name__ for one in app.registered_commands])
def test_nothing_is_cut_in_the_help_at_80_columns(command):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "80"}).stdout
    assert f" {command} [OPTIONS]" in shown
    assert "…" not in shown


def test_help_imports_neither_numba_nor_matplotlib(tmp_path):
    code = (
        "import sys; sys.argv = ['curricle', '--help']\n"
        "from curricle.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "assert not {'numba', 'matplotlib', 'pyarrow'} & set(sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_the_version_is_the_packages(tmp_path):
    done = curricle("--version", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, f"curricle {version('curricle')}\n")


def test_a_shell_completes_commands_and_kinds(tmp_path):
    def completed(*words):
        asked = {
            "_CURRICLE_COMPLETE": "complete_bash",
            "COMP_WORDS": " ".join(("curricle", *words)),
            "COMP_CWORD": str(len(words)),
        }
        code = (
            "import sys; sys.argv = ['curricle']\n"
            "from curricle.cli import main\n"
            "try: main()\n"
            "finally: assert not {'numba', 'matplotlib', 'pyarrow'} & set(sys.modules)"
        )
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=tmp_path,
            env={**os.environ, **asked},
            capture_output=True,
            text=True,
        )
        return done.stdout.split()

    assert completed("che") == ["check"]
    assert completed("new", "ma") == ["maze"]


def test_what_compiles_says_so_once(tmp_path):
    code = (
        "import sys\n"
        "from curricle.cli.progress_bars import announce_compilation\n"
        "found = announce_compilation()\n"
        "from tests_loops import one, other\n"
        "one(1); other(1)\n"
        "print(found.loops)"
    )
    (tmp_path / "tests_loops.py").write_text(
        "from numba import njit\n"
        "@njit\ndef part(n): return n + 1\n"
        "@njit(cache=True)\ndef one(n): return part(n)\n"
        "@njit(cache=True)\ndef other(n): return part(n) + 1\n"
    )
    cache = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    told = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=cache, capture_output=True, text=True
        )
        told.append((done.stdout, done.stderr.count("curricle: compiling, once")))
    assert told == [("2\n", 1), ("0\n", 0)]
