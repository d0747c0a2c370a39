"""Mistakes that the fast tests must catch: each is made in a copy of the library, and tests run.

Usage: python tests/mutations.py [WORDS] [--jobs 2]. WORDS select the mutations whose names contain
them. Prints a line for each, `caught` or `survived`, and fails if one survived. It stops with an
error if a text to be changed is not in the library exactly once, or if tests fail without a change.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
COPIED = ("src", "tests", "examples", "docs", "pyproject.toml", "conftest.py", "README.md")
PACKAGE = Path("src/curricle")
COMPILED = ("tasks/", "planning/", "learning/")
"""Where loops are compiled. Numba's disk cache would not notice a change in what they call."""
HANGS = 300
"""Seconds after which tests of a changed library are stopped; an endless loop is caught too."""


class Mutation(NamedTuple):
    """One mistake: in `file` of the package, `old` becomes `new`; `tests` should then fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str:
        """Return the file's text with the mistake in it."""
        if (found := text.count(self.old)) != 1:
            raise ValueError(f"{self.name}: {self.file} has {self.old!r} {found} times, not once")
        return text.replace(self.old, self.new)


MUTATIONS: list[Mutation] = []


# -- one after another, each job in a copy of its own ---------------------------------------------


class Job:
    """A copy of the repository in which libraries are changed and tests are run."""

    def __init__(self, folder: Path):
        self.folder = folder
        hidden = shutil.ignore_patterns("__pycache__", "_build", "generated")
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, folder / name, ignore=hidden)
            else:
                shutil.copy(ROOT / name, folder / name)

    def run(self, tests: tuple[str, ...], cache: str) -> subprocess.CompletedProcess[str]:
        """Run tests up to the first that fails, with compiled loops kept in the cache named."""
        environment = {
            **os.environ,
            "PYTHONPATH": str(self.folder / "src"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(self.folder / cache),
            "MPLBACKEND": "Agg",
            "CI": "1",  # Hypothesis draws the same examples every time
        }
        options = ["-x", "-n", "0", "-p", "no:cacheprovider"]
        command = [sys.executable, "-m", "pytest", *options, *tests]
        try:
            return subprocess.run(
                command,
                cwd=self.folder,
                env=environment,
                capture_output=True,
                text=True,
                timeout=HANGS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return subprocess.CompletedProcess(command, 1, "FAILED (no end)\n", "")

    def check(self, mutations: list[Mutation]) -> Iterator[tuple[Mutation, str]]:
        """Yield which test caught each mutation, or nothing for one that survived."""
        tests = dict.fromkeys(test for mutation in mutations for test in mutation.tests)
        if tests and (done := self.run(tuple(tests), "cache")).returncode != 0:
            output = done.stdout + done.stderr
            raise RuntimeError(f"without a change these tests must pass:\n{output}")
        for number, mutation in enumerate(mutations):
            path = self.folder / PACKAGE / mutation.file
            text = path.read_text("utf-8")
            path.write_text(mutation.applied(text), "utf-8")
            compiled = mutation.file.startswith(COMPILED)
            done = self.run(mutation.tests, f"cache{number}" if compiled else "cache")
            path.write_text(text, "utf-8")
            if done.returncode not in (0, 1):
                raise RuntimeError(f"{mutation.name}: no test ran:\n{done.stdout}{done.stderr}")
            failed = re.search(r"^FAILED (.*?)( - |$)", done.stdout, re.MULTILINE)
            yield mutation, failed[1] if failed else "an error" if done.returncode else ""


def main(arguments: list[str]) -> int:
    """Run the mutations asked for and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("words", nargs="*", help="only mutations whose names contain these words")
    parser.add_argument("--jobs", type=int, default=2, help="how many run side by side")
    asked = parser.parse_args(arguments)
    chosen = [m for m in MUTATIONS if all(word in m.name for word in asked.words)]
    for mutation in chosen:
        mutation.applied((ROOT / PACKAGE / mutation.file).read_text("utf-8"))
    caught = []

    def work(number: int) -> None:
        with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
            for mutation, by in Job(Path(folder)).check(chosen[number :: asked.jobs]):
                print(f"{'caught' if by else 'SURVIVED':9} {mutation.name:50} {by}", flush=True)
                caught.append(bool(by))

    with ThreadPoolExecutor(asked.jobs) as pool:
        list(pool.map(work, range(asked.jobs)))
    print(f"{sum(caught)} of {len(caught)} mutations caught")
    return 0 if all(caught) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
