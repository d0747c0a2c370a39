"""Does a learner from scratch overturn a verdict of README, the docs or the paper's page?

Plays every verdict that these pages print, and the paper's claims that rest on a baseline, with all
opponents and seeds that are not the page's. Prints the page's word, the word here,
the gain in mean return, sources charged, and the best opponent. `!` marks words that differ.

    python -m benchmarks.front_page [README tutorial bring_a_task paper claims] [--seeds 200]
"""

import argparse
import doctest
import os
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import curricle as cr
from curricle.paper.figure4 import figure4
from curricle.paper.mazes import HERE, Studies, figure2, figure3
from curricle.paper.trust_figure import CHARGED
from curricle.progress import Bars
from tests.walk import walk

ROOT = Path(__file__).parents[1]
FIRST = 1000  # the pages have seeds from 0, and tuning has them from 1,000,000
PAGES = ["README", "tutorial", "bring_a_task", "paper", "claims"]
PAYS, COSTS, NOT_SHOWN = "pays", "costs more than it brings", "no difference shown"
CLAIMS = ("f2.faster", "f3.", "f4.published", "f4.stated", "f4.initial", "f4.scaling", "f4.why")


def study(file, seeds, folder, changes=()):
    """Return the comparison of a study's arms."""
    read = cr.read_study(file, set=[*changes, f"seeds={FIRST}-{FIRST + seeds - 1}"])
    place = Path(folder) / f"{len(os.listdir(folder))}-results"
    return cr.run_study(read, place, progress=False).comparison


def printed(page, seeds):
    """Yield what a page's Python compares: target, comparison with these seeds, printed word."""
    known = {}
    for example in doctest.DocTestParser().get_examples((ROOT / page).read_text("utf-8")):
        if "cr.compare(plan" not in example.source:
            exec(example.source, known)
            continue
        comparison = cr.compare(known["plan"], seeds=range(FIRST, FIRST + seeds))
        word = next(word for word in (PAYS, COSTS, NOT_SHOWN) if word in example.want)
        yield comparison.target, comparison, [word]


def files(page, folder):
    """Return a folder with the files that a page has its reader write."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    (place := Path(folder) / "files").mkdir()
    how = {"timed": False, "taken": lambda line: line.startswith("curricle new")}
    walk(ROOT / f"docs/{page}.md", place, {**os.environ, "PATH": programs}, **how)
    return place


def played(page, seeds, folder):
    """Yield what is played of a page: title, comparison, and the page's word for each arm."""
    run = partial(study, seeds=seeds, folder=folder)
    if page == "README":
        yield "hunt, tuned", run(ROOT / "examples/tune.toml"), [PAYS]
        yield from printed("README.md", seeds)
    elif page == "tutorial":
        maze, without = files(page, folder) / "maze.toml", "shaping=QInitialisation"
        shorter, longer = (f"tasks.corner.budget={{ max_steps = {n} }}" for n in (800, 10_000))
        yield "maze, usual learner", run(maze, changes=["learner.type=QLearning"]), [COSTS]
        yield "maze", run(maze, changes=[without, shorter]), [PAYS]
        yield "maze, longer", run(maze, changes=[without, longer]), [COSTS]
        yield from printed("docs/tutorial.md", seeds)
    elif page == "bring_a_task":
        yield "vault", run(files("howto/bring_a_task", folder) / "vault.toml"), [COSTS, COSTS]
    elif page == "paper":
        charged = cr.read_study(HERE / "trust.toml", set=CHARGED).curriculum("mean, calibrated")
        yield "pursuit 5x5", cr.compare(charged, seeds=range(FIRST, FIRST + seeds)), [PAYS]
        yield "maze, tuned", run(HERE / "tuned.toml"), [COSTS, NOT_SHOWN, COSTS, COSTS]


class OtherSeeds(Studies):
    """The paper's studies with the seeds of this script."""

    def read(self, file, *changes):
        """Return a study of the paper with its changes, and these seeds."""
        return super().read(file, *changes, f"seeds={FIRST}-{FIRST + self.seeds - 1}")


def claims(seeds, folder):
    """Yield the paper's claims in which transfer and a baseline meet, with the verdict here."""
    studies = OtherSeeds(Path(folder), seeds, None, Bars(), print)
    for figure in (figure2, figure3, figure4):
        yield from (claim for claim in figure(studies).claims if claim.id.startswith(CLAIMS))


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("pages", nargs="*", default=PAGES)
    parser.add_argument("--seeds", type=int, default=200)
    options = parser.parse_args()
    for page in options.pages:
        print(f"\n{page}, {options.seeds} seeds from {FIRST:,}", flush=True)
        with TemporaryDirectory() as folder:
            if page == "claims":
                for claim in claims(options.seeds, folder):
                    print(f"  {claim.verdict:16}{claim.id}", flush=True)
                continue
            for title, comparison, words in played(page, options.seeds, folder):
                for arm, word in zip(comparison.verdicts, words, strict=True):
                    contrast, best = comparison.contrasts[arm], comparison.best_opponent(arm)
                    row = f"{title + ': ' + arm:44}{word:28}{contrast.verdict:28}"
                    mark = " " if word == contrast.verdict else "!"
                    print(f"{mark} {row}{contrast.strong_gain!s:40}{best}", flush=True)


if __name__ == "__main__":
    main()
