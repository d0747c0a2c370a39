"""Build the release and try it as a user gets it: the wheel alone, in an empty environment.

    python tests/release.py [--out dist] [--python PATH ...]

Source distribution and wheel are built and their metadata checked. Then, in a temporary folder
outside the checkout, for every Python from 3.11 on that the machine has: the wheel is installed
into a new environment, and the README's commands and examples and `curricle paper --seeds 2` are
run. A Python that cannot run is passed over with a word.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.append(str(ROOT))

from tests.support.pages import Command, steps  # noqa: E402 (found where the line above has Python look)

OLDEST, NEWEST = 11, 30
"""Minor versions of Python 3 that are looked for."""
WORKS = "import ensurepip, ssl, sys, venv; print('%d.%d.%d' % sys.version_info[:3])"
READS = [
    *("test_architecture.py", "test_docs.py", "test_examples.py", "test_packaging.py"),
    "test_study_files.py",
]
"""Tests that read other files than the package's."""


def run(*command: str | Path, folder: Path = ROOT, **variables: str) -> None:
    """Run a command; end with its output where it fails."""
    shown = [Path(one).name if Path(one).is_absolute() else one for one in command]
    print("  $", *shown, flush=True)
    ended = subprocess.run(
        [str(one) for one in command], cwd=folder, env=_clean(variables), text=True, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    if ended.returncode:
        sys.exit(f"{ended.stdout}\nfailed with {ended.returncode}: {' '.join(map(str, command))}")


def _clean(variables: dict[str, str]) -> dict[str, str]:
    """Return the environment without what would let the checkout be imported."""
    without = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return {**without, "PYTHONNOUSERSITE": "1", "MPLBACKEND": "Agg", **variables}


def build(out: Path) -> tuple[Path, Path]:
    """Build both distributions and check them; return the source distribution and the wheel."""
    shutil.rmtree(out, ignore_errors=True)
    run(sys.executable, "-m", "build", "--outdir", out, ROOT)
    (source,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    run(sys.executable, "-m", "twine", "check", "--strict", source, wheel)
    run(sys.executable, "-m", "check_wheel_contents", wheel)
    return source, wheel


def unpacked(source: Path, folder: Path) -> Path:
    """Unpack the source distribution; end where it holds what is not the repository's."""
    with tarfile.open(source) as archive:
        archive.extractall(folder, filter="data")
    (top,) = folder.iterdir()
    held = {str(path.relative_to(top)) for path in top.rglob("*") if path.is_file()}
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    tracked = set(listed.stdout.splitlines())
    if tracked and (junk := held - tracked - {"PKG-INFO"}):
        sys.exit(f"the source distribution holds what is not the repository's: {sorted(junk)}")
    return top


def pythons(given: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield the version and the path of each Python, and say which cannot run."""
    found: dict[str, str] = {}
    for path in given or _candidates():
        told = subprocess.run([path, "-c", WORKS], capture_output=True, text=True, check=False)
        if told.returncode:
            print(f"passed over: {path} cannot run: {told.stderr.strip().splitlines()[:1]}")
        else:
            found.setdefault(told.stdout.strip().rpartition(".")[0], path)
    if not found:
        sys.exit("no Python from 3.11 on can run")
    yield from sorted(found.items())


def _candidates() -> Iterator[str]:
    """Yield Pythons from 3.11 on: on the path, pyenv's and uv's."""
    homes = [Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"]
    homes.append(Path(os.environ.get("XDG_DATA_HOME", Path.home() / ".local/share")) / "uv/python")
    for minor in range(OLDEST, NEWEST):
        name = f"python3.{minor}"
        own = sorted(str(path) for home in homes for path in home.glob(f"*/bin/{name}"))
        yield from own
        if not own and (path := shutil.which(name)):
            yield path


def commands() -> list[str]:
    """Return the README's commands that are Curricle's own."""
    text = (ROOT / "README.md").read_text("utf-8")
    lines = [step.line for step in steps(text) if isinstance(step, Command)]
    return [line for line in lines if line.startswith("curricle ")]


def try_out(python: str, wheel: Path, folder: Path) -> None:
    """Install the wheel alone, and run what the README has and the paper's figures."""
    place = folder / "work"
    place.mkdir(parents=True)
    run(python, "-m", "venv", folder / "venv", folder=folder)
    programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    mine = programs / "python"
    run(mine, "-m", "pip", "install", "-q", "--disable-pip-version-check", wheel, folder=place)
    run(mine, "-m", "pip", "check", "--disable-pip-version-check", folder=place)
    where = "import curricle; print(curricle.__file__, curricle.__version__)"
    run(mine, "-c", f"{where}; assert 'venv' in curricle.__file__", folder=place)
    for line in commands():
        words = re.sub(r"\s+#.*", "", line).split()
        run(programs / words[0], *words[1:], folder=place)
    run(mine, HERE / "page_examples.py", ROOT / "README.md", "--untimed", folder=place)
    run(programs / "curricle", "paper", "--seeds", "2", "--out", place / "paper", folder=place)
    for name in ("claims.json", "index.html"):
        if not (place / "paper" / name).stat().st_size:
            sys.exit(f"curricle paper wrote an empty {name}")


def main() -> None:
    """Build, check and try the release."""
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    given.add_argument("--out", type=Path, default=ROOT / "dist")
    given.add_argument("--python", nargs="*", default=[], help="instead of all that are found")
    options = given.parse_args()
    print("building", flush=True)
    source, wheel = build(options.out)
    with tempfile.TemporaryDirectory() as place:
        print("the source distribution's own tests", flush=True)
        top = unpacked(source, Path(place) / "source")
        own = {"PYTHONPATH": str(top / "src")}
        run(sys.executable, "-m", "pytest", "--collect-only", "-q", folder=top, **own)
        tests = [f"tests/unit/{name}" for name in READS]
        run(sys.executable, "-m", "pytest", "-n0", *tests, folder=top, **own)
        for version, python in pythons(options.python):
            print(f"the wheel alone, Python {version}", flush=True)
            try_out(python, wheel, Path(place) / version)
    print(f"{source.name} and {wheel.name} in {options.out} can be released")


if __name__ == "__main__":
    main()
