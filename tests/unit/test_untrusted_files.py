"""Files that somebody sent: what they name is not run, links are left, sizes are bounded."""

import io
import os
import zipfile

import numpy as np
import pytest

from curricle.errors import LONGEST, ConfigError, LostStoreError, StoreError, TaskError
from curricle.files import RemotePath, opened_archive, read_npy
from curricle.study import StudyConfig, read_study, run_study
from curricle.study.store import (
    CHECKPOINTS,
    LOCK,
    STUDY,
    UNITS,
    StudyStore,
    in_use,
    locked,
)
from curricle.study.tuning import TRIALS
from curricle.study_file.file import parsed
from curricle.study_file.own_code import ALLOW, load


@pytest.mark.parametrize("name", ["os:system", "subprocess:run", "builtins:exec", "posix:system"])
@pytest.mark.parametrize("allowed", ["", "os,subprocess,builtins,posix"])
def test_pythons_own_library_is_refused(name, allowed, tmp_path, monkeypatch):
    monkeypatch.setenv(ALLOW, allowed)
    with pytest.raises(ConfigError, match="own library, which can run any command, is refused"):
        load(name, tmp_path)


def test_an_installed_package_is_named_where_it_is_allowed(tmp_path, monkeypatch):
    monkeypatch.setenv(ALLOW, "nump,numpy.linal")
    for name in ("numpy:save", "numpy.linalg:norm", "curricle.files:remove_folder", "__main__:x"):
        with pytest.raises(ConfigError, match=rf"set {ALLOW}=\w+ if you trust the file with it"):
            load(name, tmp_path)
    monkeypatch.setenv(ALLOW, "mine, numpy.linalg")
    assert load("numpy.linalg:norm", tmp_path) is np.linalg.norm
    with pytest.raises(ConfigError, match="numpy is not beside it"):
        load("numpy:save", tmp_path)
    (tmp_path / "numpy.py").write_text("def save(): return 'mine'")
    assert load("numpy:save", tmp_path)() == "mine"


def test_a_study_that_names_a_command_is_refused(tmp_path):
    path, made = tmp_path / "study.toml", tmp_path / "made"
    path.write_text(
        f'name = "x"\ntasks.t = {{ type = "factory", factory = "os:system", '
        f'arguments = {{ command = "touch {made}" }} }}\n'
    )
    with pytest.raises(ConfigError, match="is refused"):
        _ = read_study(path).curricula
    assert not made.exists()


def test_a_lock_that_is_a_link_is_not_followed(tmp_path):
    precious = tmp_path / "precious.txt"
    precious.write_text("words")
    (tmp_path / "sent").mkdir()
    (tmp_path / "sent" / LOCK).symlink_to(precious)
    assert in_use(tmp_path / "sent") is None
    with pytest.raises(StoreError, match=r"its \.lock must be no link"), locked(tmp_path / "sent"):
        pass
    assert precious.read_text() == "words"


@pytest.mark.parametrize("place", [UNITS, f"{UNITS}/maze-1", CHECKPOINTS, TRIALS])
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
    ("stored", "why"), [(0, "No such file or directory"), (2, "holds a study.json: .* has none")]
)
def test_a_folder_that_is_moved_while_a_run_writes_ends_it(stored, why, tmp_path):
    maze = {"type": "maze", "map": "S.T", "budget": 200}
    arms = {"transfer": {"tasks": {"maze": maze}}}
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


# -- sizes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["a" + ".a" * 20_000 + "=1", "[" + "'a' . " * 60 + "a]"])
def test_keys_that_many_dots_join_are_refused_before_they_are_parsed(text):
    with pytest.raises(ValueError, match="at most 50 deep"):
        parsed(text)


def test_many_joined_keys_are_refused_and_mazes_are_not():
    with pytest.raises(ValueError, match="at most 100,000 dots may join keys"):
        parsed("".join(f"x{n}.a.b=1\n" for n in range(60_000)))
    assert len(parsed(f"map = '''{'S.#.T.' * 40_000}'''")["map"]) == 240_000


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


@pytest.mark.parametrize(
    "header",
    ["{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", "(" * 3000, "{[]: 1}", "'\\N'",
     "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, -1)}", "9" * 5000,
     "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}"],
)  # fmt: skip
def test_headers_of_arrays_that_make_no_sense_are_refused(header):
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(8)
    with pytest.raises(ValueError, match=r"its arrays|must be valid|does not fill"):
        read_npy(io.BytesIO(content), len(content))


# -- messages --------------------------------------------------------------------------------------


def test_messages_are_one_sentence_that_ends_with_its_end():
    text = str(TaskError("a map must be text:\n got " + "x" * 10**6 + "; write it so"))
    assert "\n" not in text
    assert len(text) == LONGEST
    assert text.endswith("; write it so")
    lines = str(ConfigError("\n".join(["x" * 9000] * 300))).splitlines()
    assert len(lines) == 101
    assert max(map(len, lines)) == LONGEST
    assert lines[-1] == "and 200 more"


@pytest.mark.parametrize(
    "url",
    [
        "s3://bucket/a?endpoint_override=http%3A%2F%2Fme%3Ahidden%40host",
        "s3://bucket/a?endpoint_override=me:hidden@host",
        "s3://me:hidden@bucket/a",
    ],
)
def test_passwords_are_not_repeated(url):
    with pytest.raises(StoreError, match="must have no password") as caught:
        RemotePath.of(url)
    assert "hidden" not in str(caught.value)
    assert "hidden" not in str(StoreError("cannot be written to https:/me:hidden@host/x.html"))
