"""The live page of a study's folder, served to browsers of this machine alone."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from secrets import token_urlsafe
from socketserver import TCPServer
from sys import exception
from threading import Thread
from time import monotonic, sleep
from typing import Any

from markupsafe import Markup

from curricle.errors import SettingError, StudyError, reason
from curricle.files import Place
from curricle.report.live_study import LiveStudy, one_line
from curricle.report.templates import asset, render

HERE = "127.0.0.1"
HOSTS = {HERE, "localhost"}
"""Names under which a browser may ask: another site's name, led here, may not."""
TICK = 0.5
"""Seconds between two messages to a page."""
LINGER, NOTICED = 10.0, 0.2
"""Seconds that pages have to take the last report, and between two looks whether they have."""
INTERRUPTED = "The run was interrupted. What was stored is whole, and --resume goes on from there."
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class LiveServer(ThreadingHTTPServer):
    """Serves the page of a study on 127.0.0.1.

    Parameters
    ----------
    study : LiveStudy
    port : int
        0 takes a free one.

    Raises
    ------
    SettingError
        When the port cannot be used.

    Attributes
    ----------
    address : str
        Of the page.
    pages : set of LiveRequest
        The streams of the pages that are open.
    """

    def __init__(self, study: LiveStudy, port: int = 0):
        self.study, self.pages = study, set[LiveRequest]()
        try:
            super().__init__((HERE, port), LiveRequest)
        except OSError as error:
            raise SettingError(
                f"a live page needs a port of its own on {HERE}: {port} cannot be used, "
                f"{reason(error)}"
            ) from None
        self.address = f"http://{HERE}:{self.server_port}/"

    def server_bind(self) -> None:
        """Bind without asking a name server what the machine is called."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = HERE, self.socket.getsockname()[1]

    def wait_for_pages(self) -> None:
        """Wait until open pages have the last state; they close their streams then."""
        until = monotonic() + LINGER
        while self.pages and self.study.ended and monotonic() < until:
            sleep(NOTICED)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report errors, but for pages that were closed."""
        if not isinstance(exception(), ConnectionError):
            super().handle_error(request, client_address)


class LiveRequest(BaseHTTPRequestHandler):
    """One request of a browser."""

    server: LiveServer

    def do_GET(self) -> None:
        """Answer with the page, its rows, the report so far, or a stream of the state."""
        if self.headers.get("Host", "").partition(":")[0] not in HOSTS:
            self.send_error(HTTPStatus.FORBIDDEN, "this address is for browsers of this machine")
            return
        study = self.server.study
        answers: dict[str, tuple[str, Callable[[], str]]] = {
            "/": ("text/html", lambda: live_html(study.name)),
            "/rows": ("application/json", lambda: json.dumps([one.data() for one in study.rows])),
            "/report": ("text/html", lambda: study.page),
        }
        if self.path == "/events":
            self._stream()
        elif self.path in answers:
            kind, content = answers[self.path]
            self._send(kind, content().encode())
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _send(self, kind: str, content: bytes | None) -> None:
        self.send_response(HTTPStatus.OK)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        if content is not None:
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content or b"")

    def _stream(self) -> None:
        """Send the state again and again until the page is closed; it closes this at the end."""
        self.server.pages.add(self)
        try:
            self._send("text/event-stream", None)
            while True:
                state = json.dumps(self.server.study.state())
                self.wfile.write(f"data: {state}\n\n".encode())
                sleep(NOTICED if self.server.study.ended else TICK)
        finally:
            self.server.pages.discard(self)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing: the terminal is the run's."""


def live_html(name: str) -> str:
    """Return the page that follows a study of a name.

    Examples
    --------
    >>> page = live_html("A <small> maze")
    >>> "A &lt;small&gt; maze" in page, "connect-src 'self'" in page
    (True, True)
    """
    return render(
        "live.html",
        name=name,
        script=Markup(asset("live.js")),
        nonce=token_urlsafe(16),
    )


@contextmanager
def live_page(
    folder: str | Place,
    line: Callable[[int, int], str],
    port: int = 0,
    *,
    elsewhere: bool = False,
) -> Iterator[LiveServer]:
    """Serve the live page of a folder as long as the block runs, and until pages have its end.

    Parameters
    ----------
    folder, line, elsewhere
        As of :class:`LiveStudy`.
    port : int
        0 takes a free one.

    Raises
    ------
    SettingError
        When the port cannot be used.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from urllib.request import urlopen
    >>> with live_page(mkdtemp(), lambda stored, units: "") as server:
    ...     b"<title>" in urlopen(server.address).read()
    True
    """
    study = LiveStudy(folder, line, elsewhere=elsewhere)
    server = LiveServer(study, port)
    Thread(target=server.serve_forever, args=(NOTICED,), daemon=True).start()
    study.start()
    try:
        yield server
    finally:
        server.wait_for_pages()
        server.shutdown()
        server.server_close()
        if not isinstance(exception(), KeyboardInterrupt):  # which waits for nothing
            study.stop()


@contextmanager
def live_run(
    folder: str | Place, line: Callable[[int, int], str], port: int = 0
) -> Iterator[LiveServer]:
    """Serve the live page of the run in the block, and say on it how the run ended.

    Parameters and errors are those of :func:`live_page`. What the block raises is raised.
    """
    with live_page(folder, line, port) as server:
        try:
            yield server
        except KeyboardInterrupt:
            server.study.end(INTERRUPTED, read=False)
            raise
        except BaseException as error:
            words = f"The run ended with an error. {one_line(error)}"
            server.study.end(words, read=isinstance(error, StudyError))
            raise
        server.study.end("The run has ended.")
