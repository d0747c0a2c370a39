"""Mappings that are found, beside those made by hand: what they gain, and which search finds them.

    python -m benchmarks.found_mappings auto [--seeds 20] [--only maze]
    python -m benchmarks.found_mappings families --split verification --seeds 10
    python -m benchmarks.found_mappings searches

`auto`: gains over scratch of a mapping that is found and of those by hand, all steps charged.
`families`: pairs of the benchmark, or made after it, beside their own mappings.
`searches`: which search makes the first mapping of each two tasks that the benchmark's pairs have.
Potentials start Q, without a portfolio, most of whose gain would be its optimistic learner's.
"""

import argparse
import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import groupby
from typing import Any, NamedTuple, cast

import numpy as np

import curricle as cr
from benchmarks.pairs import Pair, Split, pairs
from benchmarks.pairs.pair import Family, levels
from benchmarks.pairs.worlds import cropped, grid, redrawn
from curricle.errors import MappingError
from curricle.paper.mazes import maze
from curricle.statistics import mean_return
from curricle.statistics.curves import SCRATCH
from curricle.tasks.mdp import same_task
from curricle.transfer import StateActionMapping, TaskPair, auto_mapping, find_mappings
from curricle.transfer.search import SEARCHES, clears_bar
from examples import cliff_walking, taxi

SIDE = 5
"""Of the paper's maze's corner."""


# -- gains ---------------------------------------------------------------------------------------


def gains(
    name: str, target: Any, source: Any, by_hand: list[cr.Transfer], made: Callable, seeds: int
) -> None:
    """Print the gains of the mappings by hand and of the mapping that is found."""
    arms = {"by hand": made(by_hand)}
    try:
        best, words = auto_mapping(target, source), ""
    except MappingError:
        best = next(iter(find_mappings(target, source)), None)
        words = "refused, and accepted all the same: "
    print(f"  {name}: {'none found' if best is None else f'{words}{best}'}")
    if best is not None:
        arms["auto"] = made([cr.Transfer("source", "target", best.mapping)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cr.compare(arms, seeds=seeds, opponents=())
    for arm in arms:
        gain = found.returns[arm] - found.returns[SCRATCH]
        error = gain.std(ddof=1) / np.sqrt(seeds)
        print(f"    {arm}: gain {gain.mean():.4g} +- {error:.2g}", flush=True)


def of(target: Any, source: Any, *, budget: Any = None, **settings: Any) -> Callable:
    """Return what makes the curriculum of some transfers, its source's steps being exact."""
    if budget is not None and isinstance(budget.get("source"), int):
        budget = {**budget, "source": cr.StoppingRule(budget["source"])}
    settings |= {"budget": budget, "shaping": cr.QInitialisation()}
    return lambda transfers: cr.Curriculum(
        {"source": source, "target": target}, transfers, **settings
    )


def edge(mapping: Any, **settings: Any) -> cr.Transfer:
    return cr.Transfer("source", "target", mapping, **settings)


def maze_settings() -> dict[str, Any]:
    return {
        "learner": cr.QLearning(learning_rate=0.1, epsilon=0.1),
        "budget": {"source": cr.Episodes(250), "target": 60_000},
        "eval_freq": {"source": 1000, "target": 100},
        "evaluation": cr.GreedyEvaluation(discounted=False),
    }


def auto_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    """Yield pairs of tasks with mappings made by hand, and how they are learnt."""
    arena = maze(-5)
    corner = arena.crop(rows=(0, SIDE), columns=(10 - SIDE, 10), start="uniform")
    yield (
        "maze, corner of 5x5", arena, corner, [edge(cr.same_position(arena, corner))],
        of(arena, corner, **maze_settings()),
    )  # fmt: skip
    for size, budget in ((4, (40_000, 300_000)), (5, (80_000, 800_000))):
        hunt, chase = cr.Pursuit(size, 2), cr.Pursuit(size, 1)
        yield (
            f"pursuit {size}x{size}", hunt, chase,
            [edge(cr.project(hunt, chase, predator=name)) for name in hunt.predator_names],
            of(hunt, chase, aggregate=cr.minimum,
               budget=dict(zip(("source", "target"), budget, strict=True))),
        )  # fmt: skip
    yield from taxi_cases()
    yield from cliff_cases()


def taxi_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    import gymnasium

    whole = cr.from_gymnasium("Taxi-v4", discount=taxi.DISCOUNT)
    drive = taxi.errand(gymnasium.make("Taxi-v4").unwrapped.P)
    made = of(
        whole, drive, aggregate=cr.total, learner={"source": taxi.THOROUGH, "target": taxi.LEARNER},
        budget={"source": 8_000, "target": 120_000},
        evaluation=cr.GreedyEvaluation(discounted=False),
    )  # fmt: skip
    yield "taxi, errand", whole, drive, [edge(taxi.errand_mapping(whole, drive))], made
    parts = [
        edge(taxi.errand_mapping(whole, drive, riding=False), shift=-taxi.RIDE),
        edge(taxi.errand_mapping(whole, drive, waiting=False)),
    ]
    yield "taxi, errand in two parts, one shifted", whole, drive, parts, made


def cliff_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    for pair in pairs(family="cliffs"):
        if pair.name == "cliffs/half the cliff":
            settings = {
                "budget": {"source": 500, "target": pair.target_budget},
                "eval_freq": {"target": pair.eval_freq},
                "evaluation": cr.GreedyEvaluation(method="exact"),
            }
            by_hand = [edge(mapping) for mapping in pair.mappings]
            made = of(pair.target, pair.source, **settings)
            yield "cliff, half of it, 500 steps", pair.target, pair.source, by_hand, made
    wide = cr.from_gymnasium("CliffWalking-v1", discount=0.99, time_limit=cliff_walking.LIMIT)
    narrow = cliff_walking.cliff(cliff_walking.NARROW)

    def goals_end(state: Any, action: Any) -> Any:
        return {"row": state["row"], "column": state["column"] - 8}, action

    mapping = cr.from_function(wide, narrow, goals_end, unmapped_value=-8.0)
    made = of(
        wide, narrow, learner=cr.QLearning(learning_rate=0.1, epsilon=0.1),
        budget={"source": 600, "target": 20_000},
        evaluation=cr.GreedyEvaluation(discounted=False),
    )  # fmt: skip
    yield "cliff, a narrow one at the goal's end", wide, narrow, [edge(mapping)], made


# -- the pairs of the families, and some that came later -------------------------------------------
# Mazes with walls drawn at random and a cliff of 20 columns, -1 a step; each from the part at its
# goal. They came after the rules by which mappings are chosen, and changed nothing of them; the
# verification families had been seen when the last of the rules was made. A pair is harmful through
# its mapping, its source or its budget; a search may find another mapping of the same source.
# Negated pairs are left out: they have no mapping of their own. `source free` is the gain without
# the charge.

SIZE, WALLS = 10, 16
CLIFF = [*["." * 20] * 3, "S" + "C" * 18 + "G"]


def drawn(seed: int) -> list[str]:
    """Return a maze from the south-west to the north-east, with walls at random."""
    cells = np.random.default_rng(seed).choice(SIZE * SIZE, WALLS, replace=False)
    walls = {(int(k) // SIZE, int(k) % SIZE): "#" for k in cells}
    last = SIZE - 1
    free = dict.fromkeys([(last - 1, 0), (last, 1), (1, last), (0, last - 1)], ".")
    return redrawn(["." * SIZE] * SIZE, {**walls, **free, (last, 0): "S", (0, last): "G"})


def unseen() -> list[Pair]:
    """Return the pairs."""
    family = Family("unseen", "verification")
    for seed in (11, 12, 13):
        for slip in (0.0, 0.2):
            rules = {"rewards": {}, "step": -1.0, "slip": slip, "time_limit": 150}
            lines, name = drawn(seed), f"walls {seed}, slip {slip:g}"
            family.target(name, grid(lines, **rules), 30_000)
            part = cropped(lines, (0, 5), (5, 10), **{**rules, "starts": "."})
            family.add("near", name, part, budget=2_000)
    rules = {"rewards": {"C": -19.0}, "step": -1.0, "time_limit": 200}
    family.target("cliff", grid(CLIFF, back_to_start="C", **rules), 30_000)
    end = cropped(CLIFF, (0, 4), (13, 20), ends="GC", starts=".", **rules)
    family.add("near", "cliff of 20", end, budget=2_000)
    return list(family.pairs.values())


SHARE = 0.95
"""Of the gain by hand, which a mapping that is found is to reach."""
HARMLESS = -0.02
"""Gain without the charge down to which a mapping is called harmless."""


class Row(NamedTuple):
    """One pair, played."""

    pair: Pair
    how: str  # empty if refused
    by_hand: float
    auto: float  # 0 if refused: nothing is learnt and nothing charged
    free: float  # the same without the charge
    error: float  # standard error of auto - by_hand

    @property
    def reaches(self) -> bool:
        """Whether the share of the gain by hand is reached, where there is one."""
        return self.auto >= SHARE * self.by_hand if self.by_hand > 0 else self.auto >= self.by_hand


def played(pair: Pair, seeds: int) -> Row:
    """Return the gains of a pair's own mapping and of the one that is found."""
    own = pair.curriculum()
    arms, how = {"by hand": own}, ""
    try:
        best = auto_mapping(pair.target, pair.source)
    except MappingError:
        pass
    else:
        edge = cr.Transfer("source", "target", best.mapping)
        arms["auto"], how = replace(own, transfers=(edge,)), best.how
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cr.compare(arms, seeds=seeds, opponents=())
    random_return, optimum = levels(pair.target)
    gains = {
        arm: (found.returns[arm] - found.returns[SCRATCH]) / (optimum - random_return)
        for arm in arms
    }
    free = 0.0
    if how:
        each = (mean_return(found._weak(arm)) for arm in ("auto", SCRATCH))
        free = float(np.subtract(*each).mean()) / (optimum - random_return)
    auto = gains.get("auto", np.zeros(seeds))
    error = float((auto - gains["by hand"]).std(ddof=1)) / math.sqrt(seeds)
    return Row(pair, how, float(gains["by hand"].mean()), float(auto.mean()), free, error)


def families(split: str, seeds: int, only: str) -> None:
    """Print each pair of a split, or of those that are unseen, and what they come to by kind."""
    print(f"\nfamilies: gains of the {split} pairs, all steps charged, {seeds} seeds")
    print(f"  {'':46} by hand    auto    +-   source free")
    rows = []
    for pair in unseen() if split == "unseen" else pairs(split=cast(Split, split)):
        if pair.kind != "negated" and pair.name.startswith(only):
            row = played(pair, seeds)
            rows.append(row)
            gains = f"{row.by_hand:7.3f} {row.auto:7.3f} {row.error:5.3f} {row.free:7.3f}"
            print(
                f"  {pair.kind + ': ' + pair.name:46} {gains}  {row.how or 'refused'}", flush=True
            )
    summary(rows)


def summary(rows: Sequence[Row]) -> None:
    """Print the counts by kind; sensible pairs first."""
    print(
        f"\n  kind, pairs: refused; taken with at least {SHARE:.0%} of the gain by hand; taken and "
        f"harmless without the charge; mean gain by hand, and of auto"
    )
    ordered = sorted(rows, key=lambda row: (not row.pair.sensible, row.pair.kind))
    for kind, of_kind in groupby(ordered, key=lambda row: row.pair.kind):
        print(f"  {line(kind, list(of_kind))}")
    for words, sensible in (("sensible", True), ("others", False)):
        print(f"  {line(words, [row for row in rows if row.pair.sensible is sensible])}")


def line(words: str, rows: Iterable[Row]) -> str:
    """Return the counts of some pairs."""
    rows = list(rows)
    taken = [row for row in rows if row.how]
    if not rows:
        return f"{words}, 0"
    by_hand, auto = (float(np.mean([getattr(row, k) for row in rows])) for k in ("by_hand", "auto"))
    return (
        f"{words}, {len(rows)}: {len(rows) - len(taken)}; {sum(row.reaches for row in taken)}; "
        f"{sum(row.free >= HARMLESS for row in taken)} of {len(taken)}; {by_hand:.3f}, {auto:.3f}"
    )


# -- which search is first ------------------------------------------------------------------------


def pair_cases() -> Iterator[tuple[str, Any, Any]]:
    """Yield two tasks of `benchmarks.pairs` once, whatever their mappings and budgets."""
    known: list[tuple[Any, Any]] = []
    for pair in pairs():
        tasks = pair.target, pair.source
        if not any(all(map(same_task, tasks, others)) for others in known):
            known.append(tasks)
            yield pair.name, *tasks


def first_searches() -> None:
    """Print the search that makes the first mapping of each two tasks, and how often each does."""
    print("\ncandidates by search, first mapping, its indices' hash; if unseen")
    first, all_cases = Counter[str](), 0
    for name, target, source in pair_cases():
        made = dict[bytes, str]()
        searches = [recorded(search, made) for search in SEARCHES]
        candidates = find_mappings(target, source, searches=searches, keep=1000)
        counts = Counter(made[digest(candidate.mapping)] for candidate in candidates)
        all_cases += 1
        print(f"  {name}: {dict(counts)}", flush=True)
        if candidates:
            best = candidates[0]
            search = made[digest(best.mapping)]
            first[search] += clears_bar(best.scores)
            taken = "taken" if clears_bar(best.scores) else "refused"
            print(f"    {search}, {taken}, {digest(best.mapping).hex()}: {best}", flush=True)
    print(f"  first and taken, of {all_cases}: {dict(first)}", flush=True)


def recorded(search: Any, made: dict[bytes, str]) -> Callable:
    """Return a search that writes down which mappings it is the first to make."""

    def by(tasks: TaskPair) -> Iterator[Any]:
        for proposal in search(tasks):
            made.setdefault(digest(proposal.mapping), search.__name__)
            yield proposal

    by.__name__ = search.__name__
    return by


def digest(mapping: StateActionMapping) -> bytes:
    """Return a hash of the pairs that a mapping reads."""
    return sha256(mapping.index.tobytes()).digest()[:6]


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("parts", nargs="+", choices=("auto", "families", "searches"))
    parser.add_argument("--seeds", type=int, default=20, help="of learning")
    parser.add_argument("--only", default="", help="cases whose name begins so")
    parser.add_argument(
        "--split", choices=("development", "verification", "unseen"), default="verification",
        help="of families",
    )  # fmt: skip
    options = parser.parse_args()
    if "searches" in options.parts:
        first_searches()
    if "families" in options.parts:
        families(options.split, options.seeds, options.only)
    if "auto" in options.parts:
        print(f"\nauto: gain over scratch, all steps charged, {options.seeds} seeds")
        for name, *case in auto_cases():
            if name.startswith(options.only):
                gains(name, *case, options.seeds)


if __name__ == "__main__":
    main()
