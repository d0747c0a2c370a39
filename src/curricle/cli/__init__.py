"""The ``curricle`` command: thin, and quick to say what it can do."""

from curricle.cli.app import main

__all__ = ["main"]
