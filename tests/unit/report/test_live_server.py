"""The server of a live page: for this machine's browsers alone, and until they have the end."""

import json
from contextlib import suppress
from urllib.error import HTTPError, URLError
from urllib.request import Request, urlopen

import pytest

from curricle.errors import SettingError
from curricle.report import live_server
from curricle.report.live_server import live_page, live_run


def words(stored, units):
    return f"{stored} of {units}"


@pytest.fixture(scope="module")
def server(finished):
    with live_page(finished, words) as found:
        found.study.end("")  # all of the folder is read then
        yield found


def answer(server, path="", **headers):
    """Status, headers and text of an answer."""
    request = Request(server.address + path, headers=headers)
    try:
        with urlopen(request, timeout=30) as found:
            return found.status, found.headers, found.read().decode()
    except HTTPError as error:
        with error:
            return error.code, error.headers, error.read().decode()


def test_the_page_its_rows_and_the_report_are_served(server):
    status, headers, page = answer(server)
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert "connect-src 'self'" in page
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    rows = json.loads(answer(server, "rows")[2])
    assert rows[0]["name"] == "scratch: maze"
    assert rows[0]["stored"] == rows[0]["seeds"] == 4
    report = answer(server, "report")[2]
    assert report == server.study.page
    assert "connect-src" not in report  # the report itself requests nothing


def test_each_page_has_a_nonce_of_its_own(server):
    policies = {answer(server)[2].split("script-src ")[1].split(";")[0] for _ in range(2)}
    assert len(policies) == 2


def test_it_listens_on_one_address_of_this_machine(server):
    assert server.address == f"http://127.0.0.1:{server.server_port}/"
    with pytest.raises(URLError, match="refused"):
        urlopen(f"http://127.0.0.2:{server.server_port}/", timeout=30)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
@pytest.mark.parametrize("path", ["", "report", "rows", "events"])
def test_a_site_that_leads_its_name_here_reads_nothing(server, host, path):
    status, _, text = answer(server, path, Host=host)
    assert status == 403
    assert "hunt" not in text


def test_browsers_may_call_this_machine_localhost(server):
    assert answer(server, Host="localhost:8000")[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_but_reading_is_answered(server, method):
    with pytest.raises(HTTPError) as refused:
        urlopen(Request(server.address, method=method), timeout=30)
    with refused.value as error:
        assert error.code == 501


@pytest.mark.parametrize("path", ["study.json", "../study.json", "report/", "%2e%2e/study.json"])
def test_no_file_is_served(server, path):
    assert answer(server, path)[0] == 404


def test_a_port_in_use_is_refused(server, finished):
    with (
        pytest.raises(SettingError, match=f"{server.server_port} cannot be used, Address already"),
        live_page(finished, words, server.server_port),
    ):
        pass


def first_state(stream):
    return json.loads(stream.readline().removeprefix(b"data: "))


def test_the_state_is_streamed_and_open_pages_get_the_end(finished, monkeypatch):
    monkeypatch.setattr(live_server, "TICK", 0.01)
    with live_run(finished, words) as server:
        server.study.end("")
        stream = urlopen(f"{server.address}events", timeout=30)
        assert first_state(stream)["line"] == "16 of 16"
        stream.readline()
        assert len(server.pages) == 1
        server.study.end("Over.")
        while (state := first_state(stream))["ended"] != "Over.":
            stream.readline()
        assert state["page"] > 0
        stream.close()  # and so the server has nobody to wait for


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (None, "The run has ended."),
        (KeyError("phi"), "The run ended with an error. KeyError: 'phi'"),
        (KeyboardInterrupt(), live_server.INTERRUPTED),
    ],
)
def test_pages_are_told_how_the_run_ended(finished, error, said):
    with suppress(KeyError, KeyboardInterrupt), live_run(finished, words) as server:
        if error is not None:
            raise error
    assert server.study.ended == said


def test_pages_that_stay_open_are_not_waited_for_for_ever(finished, monkeypatch):
    monkeypatch.setattr(live_server, "LINGER", 0.3)
    with live_run(finished, words) as server:
        stream = urlopen(f"{server.address}events", timeout=30)
        stream.readline()
    stream.close()
    with pytest.raises(URLError):
        urlopen(server.address, timeout=30)
