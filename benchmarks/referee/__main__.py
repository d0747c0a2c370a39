"""The command: play the match, print its tables, draw it, and check the published claim."""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from benchmarks.referee import claim
from benchmarks.referee.domains import domain, domain_names
from benchmarks.referee.pictures import draw_claim, draw_match
from benchmarks.referee.players import PLAYERS
from benchmarks.referee.playing import FULL, QUICK, RATES, Settings, play
from benchmarks.referee.tables import markdown, match, tables

CLAIM_SEEDS = 1000
QUICK_DOMAINS = ("paper maze", "key-lock-pit")


def played(
    folder: Path, players: Sequence[str], names: Sequence[str], settings: Settings, workers: int
) -> Iterator[tuple[str, str, bool]]:
    """Play units side by side; yield each when it is played, and whether it was played here."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:
        running = {
            pool.submit(play, player, name, settings, folder): (player, name)
            for player in players
            for name in names
        }
        try:
            for future in as_completed(running):
                yield *running[future], future.result()
        finally:
            for future in running:
                future.cancel()


def lengths() -> Iterator[str]:
    """Yield what learning alone takes on each map, at each learning rate."""
    rows = [("map", "length", *(f"at {rate:g}" for rate in RATES))]
    for name in domain_names():
        place = domain(name)
        for case in (*place.development, *place.held_out):
            medians = []
            for rate in RATES:
                problem = place.problem(case, rate)
                found, _ = problem.train(problem.scratch, range(10))
                medians.append(f"{np.median(found.steps):,.0f}")
            rows.append((f"{name}, {case.name}", f"{case.steps:,}", *medians))
    yield "Median steps of learning alone; a full training is one that never arrives"
    yield ""
    yield from markdown(rows)


def checked(clone: Path, seeds: int) -> Iterator[str]:
    """Yield the table and the verdict on the published claim."""
    arms = claim.check(clone, seeds)
    yield from claim.table(arms)
    yield ""
    yield from claim.verdicts(arms)


def parsed(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command's arguments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.referee", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("play", "table", "pictures"):
        one = commands.add_parser(name)
        one.add_argument("--out", type=Path, default=Path("referee-results"))
        one.add_argument("--quick", action="store_true", help="few seeds, maps and domains")
    one = commands.choices["play"]
    one.add_argument("--designer", action="append", choices=list(PLAYERS))
    one.add_argument("--domain", action="append", choices=domain_names())
    one.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    one = commands.choices["pictures"]
    one.add_argument("--docs", type=Path, default=Path("docs"), help="the folder for them")
    one.add_argument("--clone", type=Path, help="as of claim, for its picture")
    commands.add_parser("lengths")
    one = commands.add_parser("claim")
    one.add_argument("clone", type=Path, help="of github.com/f-leno/Curriculum_HFO")
    one.add_argument("--seeds", type=int, default=CLAIM_SEEDS, help="of our own learner")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = print) -> None:
    """Run the command."""
    given = parsed(arguments)
    if given.command == "claim":
        for line in checked(given.clone, given.seeds):
            write(line)
        return
    if given.command == "lengths":
        for line in lengths():
            write(line)
        return
    settings = QUICK if given.quick else FULL
    if given.command == "play":
        begun = time.perf_counter()
        names = given.domain or [
            name for name in domain_names() if not given.quick or name in QUICK_DOMAINS
        ]
        designers = given.designer or list(PLAYERS)
        for player, name, here in played(given.out, designers, names, settings, given.workers):
            said = "played" if here else "another process is at it"
            seconds = time.perf_counter() - begun
            print(f"{seconds:6.0f} s  {player} in {name}: {said}", file=sys.stderr, flush=True)
    found = match(given.out, settings)
    if given.command == "pictures":
        draw_match(found, given.docs / "referee.png")
        if given.clone is not None:
            draw_claim(claim.check(given.clone, CLAIM_SEEDS), given.docs / "referee_claim.png")
        return
    for line in tables(found):
        write(line)


if __name__ == "__main__":
    main()
