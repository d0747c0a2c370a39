"""Run the Python examples of pages and print how long each took, with the standard library alone.

    python tests/support/page_examples.py README.md [--untimed]

An example may take as long as its comment states (pages.py); --untimed lets it take longer.
"""

import argparse
import doctest
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from tests.support.pages import stated_seconds

OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
SHOWN = 1.0
"""Seconds from which on an example's time is printed."""


class Timed(doctest.DocTestRunner):
    """Runs examples, and counts as a failure what takes longer than its page states."""

    def __init__(self, timed: bool):
        super().__init__(optionflags=OPTIONS)
        self.timed, self.late = timed, 0

    def report_start(self, out, test, example):
        self.began = time.perf_counter()

    def report_success(self, out, test, example, got):
        took, most = time.perf_counter() - self.began, stated_seconds(example.source)
        late = self.timed and took > most
        self.late += late
        if late or took > SHOWN:
            first = example.source.splitlines()[0]
            out(f"{took:7.1f} s of {most:5.0f} s  >>> {first}{'  TOO LATE' * late}\n")


def main() -> int:
    """Return 1 if an example fails or takes too long, else 0."""
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    given.add_argument("pages", nargs="+", type=Path)
    given.add_argument("--untimed", action="store_true")
    options = given.parse_args()
    wrong = 0
    for page in options.pages:
        runner = Timed(not options.untimed)
        text, name = page.read_text("utf-8"), page.name
        test = doctest.DocTestParser().get_doctest(text, {}, name, str(page), 0)
        wrong += runner.run(test).failed + runner.late
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
