"""When does a curriculum pay? Its gain against what the best learner without a source leaves.

    python -m benchmarks.curve play curve.csv            # goes on where it stopped; hours
    python -m benchmarks.curve study curve.csv FOLDER... # adds the arms of studies that were run
    python -m benchmarks.curve fit curve.csv --picture docs/when_it_pays.png

`play` compares the sensible pairs of all families, with nothing set but budgets: those at which
the families were written, a quarter of them, half and twice as much; and the hunt of two predators
on 4x4 and 5x5 cells, from a single predator, at five budgets. Gains over the best opponent and what
it leaves below the optimum (the *headroom*) are shares of the way from random play to the optimum,
of mean greedy returns over all steps, sources charged. `fit` prints them by headroom and by steps
for each pair of a state and an action, apart for the families whose look the rule is fitted to
(development, verification, fresh), for the hunts, and for those that judge the rule: the blind
families, those written to judge portfolios, and the studies.
"""

import argparse
import csv
import warnings
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from matplotlib.figure import Figure

import curricle as cr
from benchmarks.pairs import Pair, pairs
from benchmarks.pairs.pair import Family
from benchmarks.portfolio import chosen
from curricle.arrays import BoolArray, FloatArray
from curricle.comparison import Comparison
from curricle.study import StudyResults

COLUMNS = (
    "pair", "split", "given", "steps", "steps_a_pair", "slips", "sparse", "cost", "headroom",
    "gain", "low", "high", "pays",
)  # fmt: skip
FACTORS = (1.0, 0.25, 0.5, 2.0)
HUNT_STEPS = (0.2, 0.5, 1.0, 2.0, 4.0)  # a pair of a state and an action of the hunt
SPLITS = ("blind", "unseen", "verification", "fresh", "development")
JUDGES = ("blind", "unseen", "study")
"""Splits that the line is not fitted to."""
HEADROOMS, STEPS = (0.0, 0.1, 0.2, 0.4), (0.0, 3.0, 11.0, 50.0)  # bounds of the rows printed
FEW_STEPS = 11.0  # for each pair of a state and an action: where curricula pay
SPARSE = 0.9  # share of the pairs with the commonest reward, from which on rewards are sparse


def hunts() -> Iterator[Pair]:
    """Yield the hunts of two predators, from a single predator, at all budgets."""
    for size in (4, 5):
        hunt, chase = cr.Pursuit(size=size, predators=2), cr.Pursuit(size=size, predators=1)
        maps = [cr.project(hunt, chase, predator=name) for name in hunt.predator_names]
        family, n_pairs = Family("hunt of two", "development"), len(hunt.states) * len(hunt.actions)
        for share in HUNT_STEPS:
            family.target(f"{size}x{size}", hunt, int(share * n_pairs))
            family.add("near", f"{size}x{size}, {share:g}", chase, *maps, budget=5_000)
        yield from family.pairs.values()


def planned() -> Iterator[tuple[str, Pair]]:
    """Yield what is played, by its split: all families by their own budgets first."""
    for factor in FACTORS:
        for split in SPLITS:
            for pair in chosen(split) if split != "fresh" else pairs("fresh"):
                if pair.sensible and pair.kind != "negated" and pair.family != "pursuit":
                    steps = round(factor * pair.target_budget)
                    yield split, replace(pair, target_budget=steps)
        if factor == 1.0:
            yield from (("hunt", pair) for pair in hunts())


def played(planned_pair: tuple[str, Pair], seeds: int) -> dict[str, Any]:
    """Return the row of a pair."""
    split, pair = planned_pair
    given: dict[str, Any] = {"budget": {"target": pair.target_budget}, "shaping": None}
    given["eval_freq"] = {"target": pair.eval_freq}
    if split == "hunt":  # exact returns of 40 policies of 15,625 states take hours
        given["evaluation"] = cr.GreedyEvaluation(method="rollouts", episodes=20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cr.compare(pair.curriculum(**given), seeds=seeds, workers=1)
    (arm,) = found.contrasts
    return {
        "pair": pair.name, "split": split, "given": pair.target_budget, **row_of(found, arm),
        **kind_of(pair, found.total),
    }  # fmt: skip


def kind_of(pair: Pair, total: int) -> dict[str, Any]:
    """Return steps a pair, whether an action may slip, and whether rewards are sparse.

    They are sparse where nearly all pairs of a state and an action have the same expected reward.
    """
    mdp = pair.target.mdp
    live = ~mdp.terminal
    chances = mdp.probability.reshape(len(live), -1)[live]
    expected = (mdp.probability * mdp.reward).sum(axis=-1).reshape(len(live), -1)[live].round(9)
    return {
        "steps_a_pair": total / (len(mdp.states) * len(mdp.actions)),
        "slips": int(((chances > 0.0) & (chances < 1.0)).any()),
        "sparse": int(np.unique(expected, return_counts=True)[1].max() >= SPARSE * expected.size),
    }


def row_of(found: Comparison, arm: str) -> dict[str, Any]:
    """Return what is known of an arm from its comparison."""
    random, optimum = found.reference.random_return, found.reference.optimum
    contrast, gain = found.contrasts[arm], found.contrasts[arm].strong_gain
    source_steps, way = float(np.mean(found.arms[arm].curve.source_steps)), optimum - random
    return {
        "steps": found.total, "cost": source_steps / found.total,
        "headroom": found.headroom(arm), "gain": gain.estimate / way, "low": gain.low / way,
        "high": gain.high / way, "pays": int(contrast.answer.startswith("pays")),
    }  # fmt: skip


def play(table: Path, seeds: int, workers: int) -> None:
    """Append a row for each pair that is not in the table yet."""
    there = {(row["pair"], row["given"]) for row in rows_of(table)}
    left = [one for one in planned() if (one[1].name, str(one[1].target_budget)) not in there]
    with ProcessPoolExecutor(workers) as pool:
        append(table, pool.map(partial(played, seeds=seeds), left))


def of_study(folder: str) -> Iterator[dict[str, Any]]:
    """Yield a row for each curriculum of a study; its chances and rewards are not looked at."""
    results = StudyResults(folder)
    found, optimum = results.comparison, results.comparison.reference.optimum
    for arm in found.contrasts if optimum is not None else ():
        name = f"{results.record.name}/{arm}"
        yield {"pair": name, "split": "study", "given": found.total, **row_of(found, arm)}


def append(table: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Append rows to a table, each as soon as it is there."""
    with table.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if file.tell() == 0:
            writer.writeheader()
        for row in rows:
            writer.writerow(row)
            file.flush()


def rows_of(table: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    if not table.exists():
        return []
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


class Points(NamedTuple):
    """The columns of a table that are printed and drawn."""

    names: list[str]
    of_hunt: BoolArray
    judges: BoolArray
    headroom: FloatArray
    steps_a_pair: FloatArray
    gain: FloatArray
    pays: BoolArray
    sparse: BoolArray
    slips: BoolArray

    @classmethod
    def of(cls, rows: list[dict[str, str]]) -> Self:
        """Return the points of a table, without the gambler's, whose way is .03 wide."""
        kept = [row for row in rows if not row["pair"].startswith("gambler")]
        splits = np.array([row["split"] for row in kept])

        def column(name: str) -> FloatArray:
            return np.array([float(row[name] or "nan") for row in kept])

        names = [f"{row['pair']}, {int(row['given']):,} steps" for row in kept]
        measured = column("headroom"), column("steps_a_pair"), column("gain")
        kinds = column("pays") == 1, column("sparse") == 1, column("slips") == 1
        return cls(names, splits == "hunt", np.isin(splits, JUDGES), *measured, *kinds)


def fit(points: Points, picture: Path | None) -> None:
    """Print what pays, by headroom and by steps a pair; a line by headroom; draw all."""
    fitted = ~points.judges & ~points.of_hunt
    groups = {"fitted": fitted, "hunts": points.of_hunt, "judges": points.judges}
    bounds = ("leaves", points.headroom, HEADROOMS), ("steps a pair", points.steps_a_pair, STEPS)
    for (title, values, edges), (name, group) in product(bounds, groups.items()):
        for low, high in pairwise((*edges, np.inf)):
            print_row(points, f"{name}, {title} {low:g} to {high:g}", group, values, (low, high))
    for name, kind in (
        ("sparse", points.sparse), ("dense", ~points.sparse), ("with slips", points.slips),
        ("without slips", ~points.slips),
    ):  # fmt: skip
        print_row(points, f"{name}, few steps", kind, points.steps_a_pair, (0.0, FEW_STEPS))
    slope, level = np.polyfit(points.headroom[~points.judges], points.gain[~points.judges], 1)
    rest = points.gain - (level + slope * points.headroom)
    for name, group in (("fitted and hunts", ~points.judges), ("judges", points.judges)):
        explained = 1.0 - (rest[group] ** 2).mean() / points.gain[group].var()
        print(f"gain = {level:+.3f} {slope:+.3f} headroom; R2 of {name}: {explained:.2f}")
    for k in np.flatnonzero(points.pays & (points.steps_a_pair >= FEW_STEPS)):
        print(f"pays with {points.steps_a_pair[k]:.0f} steps a pair: {points.names[k]}")
    if picture is not None:
        draw(points, picture)


def print_row(
    points: Points, title: str, group: BoolArray, values: FloatArray, within: tuple[float, float]
) -> None:
    """Print how many of a group pay whose values lie within bounds, and what they gain."""
    inside = group & (values >= within[0]) & (values < within[1])
    if inside.any():
        gains, pays = points.gain[inside], points.pays[inside].sum()
        share = f"{pays:3} of {len(gains):3} pay"
        print(f"{title:32} {share}, gain {gains.mean():+.3f}, {gains.max():+.3f} at most")


def draw(points: Points, picture: Path) -> None:
    """Draw gains against headroom, which no gain exceeds, and against steps a pair."""
    figure = Figure((7.2, 3.6), facecolor="white", layout="constrained")
    by_headroom, by_steps = figure.subplots(1, 2, sharey=True)
    by_headroom.set(
        xlabel="left by the best learner without a source", ylabel="gain over that learner",
        xlim=(0, 1), ylim=(-0.3, 0.6),
    )  # fmt: skip
    by_steps.set(xlabel="steps for each state and action", xscale="log")
    by_headroom.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    by_headroom.text(
        0.14, 0.17, "no source can gain more", color="0.4", rotation=45, rotation_mode="anchor",
        transform_rotates_text=True, fontsize=8,
    )  # fmt: skip
    others = ~points.of_hunt
    for plot, values in ((by_headroom, points.headroom), (by_steps, points.steps_a_pair)):
        plot.spines[["top", "right"]].set_visible(False)
        plot.axhline(0, color="0.6", linewidth=0.8)
        for shown, colour, filled, label in (
            (others & ~points.pays, "0.55", "none", "does not pay"),
            (others & points.pays, "C0", "C0", "pays"),
            (points.of_hunt & ~points.pays, "C1", "none", None),
            (points.of_hunt & points.pays, "C1", "C1", "two predators from one, by budget"),
        ):
            plot.scatter(
                values[shown], points.gain[shown], 16, edgecolors=colour, facecolors=filled,
                label=label if plot is by_headroom else None,
            )  # fmt: skip
    figure.legend(frameon=False, loc="outside upper center", ncols=3, fontsize=9)
    figure.savefig(picture, dpi=110, metadata={"Software": None})


def main() -> None:
    """Play, or add studies, or fit and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=("play", "study", "fit"))
    parser.add_argument("table", type=Path)
    parser.add_argument("folders", nargs="*")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--picture", type=Path)
    settings = parser.parse_args()
    if settings.command == "play":
        play(settings.table, settings.seeds, settings.workers)
    elif settings.command == "study":
        append(settings.table, [row for folder in settings.folders for row in of_study(folder)])
    else:
        fit(Points.of(rows_of(settings.table)), settings.picture)


if __name__ == "__main__":
    main()
