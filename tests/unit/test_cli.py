"""The command: help, exit codes, and errors as one sentence on standard error."""

import subprocess
import sys

import pytest


def curricle(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "curricle", *arguments], cwd=cwd, capture_output=True, text=True
    )


def test_help_names_the_commands(tmp_path):
    done = curricle("--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "paper" in done.stdout


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


@pytest.mark.parametrize(
    ("arguments", "code"), [(["--figure", "9"], 1), (["--seeds", "0"], 1), (["--seeds", "few"], 2)]
)
def test_a_mistake_is_one_sentence_and_writes_nothing(tmp_path, arguments, code):
    done = curricle("paper", *arguments, cwd=tmp_path)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert done.stderr.strip()
    assert not list(tmp_path.iterdir())


def test_figure_one_runs_from_the_shell(tmp_path):
    done = curricle("paper", "--figure", "1", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "reproduced  f1.coverage" in done.stdout
    assert (tmp_path / "out" / "index.html").exists()
