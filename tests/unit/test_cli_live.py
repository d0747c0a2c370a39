"""`curricle run --open` and `curricle watch`: what they print, open, refuse and leave."""

import re
import signal
import socket
import subprocess
import sys
import webbrowser
from threading import Event
from urllib.request import urlopen

import pytest

from curricle.cli import live_page
from curricle.study import StudyResults

pytestmark = pytest.mark.usefixtures("quick_disk")


@pytest.fixture
def opened(monkeypatch):
    """The addresses that a browser was told to open; there is one."""
    found, told = [], Event()

    def note(address):
        found.append(address)
        told.set()

    monkeypatch.setattr(webbrowser, "open", note)
    monkeypatch.setattr(live_page, "has_windows", lambda: True)
    return found, told


def test_a_run_is_shown_and_ends_by_itself(curricle, opened, study_file, contents, finished):
    code, out, _ = curricle("run", study_file, "--out", "out", "--open", "--workers", "2")
    address = re.search(r"Live at (http://127\.0\.0\.1:\d+/) on this machine", out)[1]
    found, told = opened
    assert told.wait(60)
    assert (code, found) == (0, [address])
    assert out.splitlines()[-1].startswith("Stored in out: ")
    assert contents(StudyResults("out").store.path) == contents(finished)  # it leaves no trace


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
    assert live_page.has_windows() is windows


def test_a_port_in_use_is_refused_before_anything_is_trained(
    curricle, study_file, finished, tmp_path
):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for command in (["run", study_file, "--out", "out", "--open"], ["watch", finished]):
            code, out, complaint = curricle(*command, "--port", port)
            assert (code, out) == (1, "")
            assert complaint.splitlines()[-1] == (
                f"curricle: a live page needs a port of its own on 127.0.0.1: {port} cannot be "
                "used, Address already in use"
            )
    assert not (tmp_path / "out").exists()


def test_a_port_without_a_page_is_refused(curricle, study_file):
    code, _, complaint = curricle("run", study_file, "--port", "8000")
    assert code == 2
    assert "--port 8000 alone" in " ".join(complaint.split())


@pytest.mark.parametrize("port", ["0", "65536", "http"])
def test_what_is_no_port_is_refused(curricle, finished, port):
    assert curricle("watch", finished, "--port", port)[0] == 2


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
def test_watching_ends_when_interrupted_and_leaves_the_folder(copied, contents, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    before = contents(copied)
    command = [sys.executable, "-m", "curricle", "watch", copied]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=interruptible,
    ) as watching:
        address = re.search(r"http://127\.0\.0\.1:\d+/", watching.stdout.readline())[0]
        with urlopen(address, timeout=60) as page:
            assert b"<h1" in page.read()
        watching.send_signal(signal.SIGINT)
        _, complaint = watching.communicate()
    assert watching.returncode == 130
    assert complaint == "curricle: interrupted; what was stored before is whole\n"
    assert contents(copied) == before
