"""The ``curricle`` command; the library is imported only when a command needs it."""

from curricle.cli.app import main

__all__ = ["main"]
