"""Opening the live page of a study in a browser."""

import os
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from threading import Thread
from time import sleep
from typing import TYPE_CHECKING

import typer

from curricle.files import Place
from curricle.study.progress import Pace

if TYPE_CHECKING:
    from curricle.report.live_server import LiveServer

NO_LONGER = "This command no longer follows the run, which goes on by itself."


@contextmanager
def opened_page(serving: "AbstractContextManager[LiveServer]") -> Iterator["LiveServer"]:
    """Serve a page, print its address, and open it where there is a browser with windows."""
    with serving as server:
        typer.echo(f"Live at {server.address} on this machine; closing the page stops nothing.")
        if has_windows():  # not waited for: some browsers end when they are closed
            Thread(target=webbrowser.open, args=(server.address,), daemon=True).start()
        yield server


def has_windows() -> bool:
    """Return whether a browser has a screen: one in the terminal would take it from the run."""
    if sys.platform in ("win32", "darwin"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def page_of_run(
    folder: str | Place, pace: Pace, port: int | None
) -> AbstractContextManager["LiveServer | None"]:
    """Show the report of the run in the block, which stores into a folder; not without a port."""
    if port is None:
        return nullcontext()
    from curricle.report.live_server import live_run

    return opened_page(live_run(folder, pace.line_in, port))


def watch_folder(folder: str, port: int) -> None:
    """Show the report of a folder, in which another process may store units, until Ctrl-C."""
    from curricle.report.live_server import live_page

    with opened_page(live_page(folder, Pace().line_of, port, elsewhere=True)) as server:
        try:
            while True:
                sleep(3600)
        finally:
            server.study.end(NO_LONGER, read=False)
