"""Does a learner from scratch overturn a verdict of README, the tutorial or the paper's page?

Plays every verdict that these pages print, and the paper's claims that rest on a baseline, with all
opponents and seeds that are not the page's. Prints for each the page's word, the word here, the
best opponent, and the gain over it in mean return, sources charged. `!` marks words that differ.

    python -m benchmarks.front_page [README tutorial paper claims] [--seeds 200]
"""

import argparse
import os
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import curricle as cr
from curricle.comparison import Comparison
from curricle.paper.figure4 import figure4
from curricle.paper.mazes import HERE, Studies, figure2, figure3
from curricle.paper.trust_figure import CHARGED
from curricle.progress import Bars
from tests.walk import walk

ROOT = Path(__file__).parents[1]
FIRST = 1000  # the pages have seeds from 0, and tuning has them from 1,000,000
PAYS, COSTS, NOT_SHOWN = "pays", "costs more than it brings", "no difference shown"
CLAIMS = ("f2.faster", "f3.", "f4.published", "f4.stated", "f4.initial", "f4.lower", "f4.scaling")


def study(file, seeds, folder, changes=()):
    """Return the comparison of a study's arms."""
    read = cr.read_study(file, set=[*changes, f"seeds={FIRST}-{FIRST + seeds - 1}"])
    place = Path(folder) / f"{len(os.listdir(folder))}-results"
    return cr.run_study(read, place, progress=False).comparison


def plan(curriculum, seeds):
    """Return the comparison of a curriculum."""
    return cr.compare(curriculum, seeds=range(FIRST, FIRST + seeds))


def lake():
    """Return README's curriculum for FrozenLake."""
    name = "FrozenLake8x8-v1"
    wet = cr.from_gymnasium(name, discount=0.99)
    dry = cr.from_gymnasium(name, discount=0.99, is_slippery=False)
    return cr.Curriculum(
        {"dry": dry, "lake": wet},
        [cr.Transfer("dry", "lake", cr.project(wet, dry), scale=0.5)],
        budget={"lake": 200_000},
        learner={"dry": cr.QLearning(initial_value=1.0)},
    )


def hunt():
    """Return README's curriculum for two predators, without tuning."""
    two, chase = (cr.Pursuit(size=4, predators=predators) for predators in (2, 1))
    return cr.Curriculum(
        {"chase": chase, "hunt": two},
        [
            cr.Transfer("chase", "hunt", cr.project(two, chase, predator=name), scale=2)
            for name in two.predator_names
        ],
        aggregate=cr.minimum,
        budget={"chase": 50_000, "hunt": 100_000},
    )


def played(page, seeds, folder):
    """Yield what is played of a page: title, comparison, and the page's word for each arm."""
    run = partial(study, seeds=seeds, folder=folder)
    if page == "README":
        yield "hunt, tuned", run(ROOT / "examples/tune.toml"), [PAYS]
        yield "FrozenLake 8x8", plan(lake(), seeds), [COSTS]
        yield "hunt, scale 2", plan(hunt(), seeds), [PAYS]
    elif page == "tutorial":
        programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        files = Path(folder) / "files"
        files.mkdir()
        how = {"timed": False, "taken": lambda line: line.startswith("curricle new")}
        walk(ROOT / "docs/tutorial.md", files, {**os.environ, "PATH": programs}, **how)
        maze, vault, without = files / "maze.toml", files / "vault.toml", "shaping=QInitialisation"
        usual, longer = "learner.type=QLearning", "tasks.corner.budget={ max_steps = 10_000 }"
        yield "maze", run(maze, changes=[usual]), [COSTS]
        yield "maze, longer", run(maze, changes=[usual, longer]), [COSTS]
        yield "maze, optimistic", run(maze, changes=[without]), [PAYS]
        yield "vault", run(vault), [COSTS, COSTS]
        yield "vault, unguarded", run(vault, changes=[without]), [COSTS, COSTS]
    elif page == "paper":
        charged = cr.read_study(HERE / "trust.toml", set=CHARGED)
        yield "pursuit 5x5, calibrated", plan(charged.curriculum("mean, calibrated"), seeds), [PAYS]
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
    parser.add_argument("pages", nargs="*", default=["README", "tutorial", "paper", "claims"])
    parser.add_argument("--seeds", type=int, default=200)
    given = parser.parse_args()
    for page in given.pages:
        print(f"\n{page}, {given.seeds} seeds from {FIRST:,}", flush=True)
        with TemporaryDirectory() as folder:
            if page == "claims":
                for claim in claims(given.seeds, folder):
                    print(f"  {claim.verdict:16}{claim.id}", flush=True)
                continue
            for title, comparison, words in played(page, given.seeds, folder):
                for (arm, contrast), word in zip(comparison.contrasts.items(), words, strict=True):
                    mark, best = " !"[contrast.verdict != word], comparison.best_opponent(arm)
                    row = f"{mark} {title + ': ' + arm:44}{word:28}{contrast.verdict:28}"
                    print(f"{row}{contrast.strong_gain!s:40}{best}", flush=True)


if __name__ == "__main__":
    main()
