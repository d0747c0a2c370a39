"""Files are whole or absent, whatever moment the machine stops at."""

import os
from pathlib import Path
from unittest.mock import Mock

import pytest

from curricle.files import file_name, read_bounded, write_whole


def test_content_is_on_disk_before_it_has_its_name(tmp_path, monkeypatch):
    calls = Mock()  # of the system, which decide what is on disk
    for name in ("fsync", "replace"):
        monkeypatch.setattr(os, name, Mock(side_effect=getattr(os, name)))
        calls.attach_mock(getattr(os, name), name)
    write_whole(tmp_path / "a", b"whole")
    assert (tmp_path / "a").read_bytes() == b"whole"
    assert [name for name, *_ in calls.mock_calls] == ["fsync", "replace"]


def test_until_the_last_moment_the_old_content_stays(tmp_path, monkeypatch):
    write_whole(tmp_path / "a", b"old")
    seen = []

    def stop(part, place):
        seen.append((tmp_path / "a").read_bytes())
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "a", b"new")
    assert seen == [b"old"]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o002, 0o664)])
def test_files_have_the_permissions_that_the_user_gives_new_files(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        write_whole(tmp_path / "a", b"whole")
    finally:
        os.umask(before)
    assert (tmp_path / "a").stat().st_mode & 0o777 == mode


def test_what_is_no_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(OSError, match="it exists and is no regular file"):
            write_whole(tmp_path / name, b"page")
    assert (tmp_path / "pipe").is_fifo()
    assert len(list(tmp_path.iterdir())) == 2


def test_file_names_are_short_and_different():
    long = ["x" * 300, "x" * 301, "\u6f22" * 100, "\u6f22" * 99 + "\u5b57"]
    names = [file_name(text) for text in long]
    assert len(set(names)) == len(names)
    assert max(len(name.encode()) for name in names) < 200
    assert file_name("hunt") == "hunt"


def test_only_whole_files_of_bounded_size_are_read(tmp_path):
    file = tmp_path / "a"
    file.write_bytes(b"12345")
    assert read_bounded(file, 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_bounded(file, 4)
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(OSError, match="no regular file"):
            read_bounded(place, 5)
