"""A small study that several tests read: a chain of three mazes, learnt in three ways."""

import os
import shutil
import sys

import pytest

from curricle.cli.app import main
from curricle.study import read_study, run_study
from tests.support.comparisons import calls  # noqa: F401  a fixture
from tests.support.sent_folders import sent, sent_folder  # noqa: F401  fixtures
from tests.support.studies import CHAIN, complaints_of, contents_of, reader


@pytest.fixture
def url_of(tmp_path):
    """A function: name -> the URL of a folder that the memory of this process holds."""
    return lambda name: f"memory://{tmp_path.name}/{name}"


@pytest.fixture
def curricle(monkeypatch, capfd, tmp_path):
    """A function: arguments -> the exit code, what was printed and what was complained of."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["curricle", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        told = capfd.readouterr()
        return ended.value.code or 0, told.out, told.err

    return run


@pytest.fixture
def read(tmp_path):
    """A function: text, what is set, name -> the study that a file of it describes."""
    return reader(tmp_path)


@pytest.fixture
def complaints(tmp_path, monkeypatch):
    """A function: text, changes, what is set -> the sentences about it, at reading or building."""
    monkeypatch.chdir(tmp_path)
    return complaints_of


@pytest.fixture(scope="session")
def study_file(tmp_path_factory):
    """The study as a file."""
    path = tmp_path_factory.mktemp("study") / "chain.toml"
    path.write_text(CHAIN)
    return path


@pytest.fixture(scope="session")
def finished(study_file, tmp_path_factory):
    """The folder of the study, run in one go; to be read only."""
    folder = tmp_path_factory.mktemp("finished") / "chain"
    run_study(read_study(study_file), folder, workers=2)
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    """A copy of that folder, to do harm to."""
    return shutil.copytree(finished, tmp_path / "copied")


@pytest.fixture
def quick_disk(monkeypatch):
    """Files are not waited for until they are on disk, which takes most of a small run's time."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture(scope="session")
def contents():
    """A function: folder -> what its files hold, by name, and its folders."""
    return contents_of
