"""Print the tables of docs/trust.md from folders of the studies here.

    for study in benchmarks/pairs/*.toml; do
        curricle run $study --out pairs/$(basename $study .toml)
        curricle run $study --out raw/$(basename $study .toml) --set shaping=QInitialisation \\
            --set controls=[] --set opponents=[]
    done
    python -m benchmarks.pairs forecasts benchmarks/pairs/*.toml > forecasts.json
    python -m benchmarks.pairs again pairs/* | sh       # what pays, on 40 fresh seeds, into again/
    python -m benchmarks.pairs gains pairs/* --raw raw/* --again again/* --forecasts forecasts.json

Gains are shares of the way from the random policy's return to the optimum, of the mean over all
steps, sources charged, with Student intervals at 95 %. A sensible source is near or far.
"""

import argparse
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

import curricle as cr
from benchmarks.pairs.families import pairs_of
from benchmarks.pairs.pair import SENSIBLE, levels
from curricle.comparison.comparison import Comparison
from curricle.statistics import mean_interval
from curricle.statistics.curves import SCRATCH
from curricle.study import StudyResults

OPTIMISTIC = "scratch, OptimisticQLearning"
FRESH_SEEDS = "1000-1039"
MUCH = 0.1
"""Share of the way that no default should lose."""


class Played:
    """A study of one target: the comparison of its arms, and what else is known of them."""

    def __init__(self, folder: str) -> None:
        results = StudyResults(folder)
        self.name, self.comparison = results.record.name, results.comparison
        world, _, target = self.name.partition(", ")
        self.pair = next(pair for pair in pairs_of(world) if pair.target_name == target)
        random_return, optimum = levels(self.pair.target)
        self.way = optimum - random_return

    @property
    def arms(self) -> list[str]:
        """The curricula."""
        return [*self.comparison.controls]

    def gains(self, arm: str, rival: str = SCRATCH, of: Comparison | None = None) -> np.ndarray:
        """Return by how much an arm gains more than another, seed by seed, (K,)."""
        returns = self.comparison.returns
        mine: np.ndarray = (self.comparison if of is None else of).returns[arm]
        return (mine - returns[rival]) / self.way

    def gain(self, arm: str) -> tuple[float, float, float]:
        """Return the gain over the best opponent: estimate, low and high."""
        gain = self.comparison.contrasts[arm].strong_gain
        return tuple(float(x) / self.way for x in (gain.estimate, gain.low, gain.high))  # type: ignore[return-value]

    def pays(self, arm: str) -> bool:
        """Return whether the verdict is that an arm pays."""
        return self.comparison.contrasts[arm].verdict == "pays"


def sensible(arm: str) -> bool:
    """Return whether a person would call the source of an arm sensible."""
    return arm.partition(":")[0] in SENSIBLE


# -- The forecasts, and whether they came true -----------------------------------------------------


def forecasts(files: Sequence[str]) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Return the gain that is forecast for each arm of each study: estimate, low and high."""
    found: dict[str, dict[str, tuple[float, float, float]]] = {}
    for file in files:
        study = cr.read_study(file)
        found[study.name] = {}
        for arm, curriculum in study.curricula.items():
            gain = cr.forecast(curriculum, trial=True).used.gain
            assert gain is not None, "a trial was asked for"
            found[study.name][arm] = gain.estimate, gain.low, gain.high
    return found


def pooled_rank(score: np.ndarray, gain: np.ndarray, target: np.ndarray) -> float:
    """Return the correlation of the ranks within targets, scaled to [-1, 1], over all arms."""
    ranks: list[list[float]] = [[], []]
    for name in np.unique(target):
        rows = target == name
        if rows.sum() > 1:
            for held, values in zip(ranks, (score[rows], gain[rows]), strict=True):
                held += (2 * (rankdata(values) - 1) / (rows.sum() - 1) - 1).tolist()
    return float(np.corrcoef(*ranks)[0, 1])


def judged(studies: Sequence[Played], foreseen: Mapping[str, Any]) -> Iterator[str]:
    """Yield how good the forecasts are, against the gains over the best opponents."""
    rows = [
        (study.name, *np.divide(foreseen[study.name][arm], study.way), *study.gain(arm))
        for study in studies
        for arm in study.arms
        if arm in foreseen.get(study.name, {})
    ]
    target, score, low, high, gain, least, most = map(np.array, zip(*rows, strict=True))
    commits, differs = (low > 0) | (high < 0), (least > 0) | (most < 0)
    right, n_pays = (score > 0) == (gain > 0), int((low > 0).sum())
    yield f"forecasts of {len(rows)} curricula: {n_pays} likely pay, {(high < 0).sum()} likely cost"
    yield f"sign right where it commits itself: {right[commits].sum()} of {commits.sum()}"
    both = commits & differs
    yield f"  where the gain came out different from 0, too: {right[both].sum()} of {both.sum()}"
    yield f"rank correlation within targets: {pooled_rank(score, gain, target):.2f}"


# -- The tables ------------------------------------------------------------------------------------


def short(values: Any) -> str:
    """Return a mean and half its interval's width, such as +.53±.04."""
    interval = mean_interval(values)
    half = (interval.high - interval.low) / 2
    return f"{interval.estimate:+.2f}" + (f"±{half:.2f}" if np.isfinite(half) else "")


def rows_of(study: Played, raw: Played | None, again: Played | None) -> Iterator[str]:
    """Yield a line for each curriculum: gains, the best opponent and the verdict."""
    played = study.comparison
    optimistic = study.gains(OPTIMISTIC) if OPTIMISTIC in played.arms else None
    best = "" if optimistic is None else f"; {OPTIMISTIC} {short(optimistic)}"
    yield f"{study.name}{best}"
    for arm in study.arms:
        alone = "" if raw is None else short(study.gains(arm, of=raw.comparison))
        estimate, low, high = study.gain(arm)
        over = f"{estimate:+.2f} [{low:+.2f}, {high:+.2f}]"
        contrast = played.contrasts[arm]
        rival = played.best_opponent(arm).removeprefix(f"{arm}, ").removeprefix("scratch, ")
        words = ", ".join(filter(None, (contrast.verdict, contrast.reason)))
        if again is not None and arm in again.arms:
            words += f"; fresh seeds: {again.comparison.contrasts[arm].verdict}"
        gains = f"{alone:>11}{short(study.gains(arm)):>11}{over:>22}"
        yield f"  {arm[:42]:<43}{gains}  {rival:<22} {words}"


def summary(studies: Sequence[Played], raws: Mapping[str, Played]) -> Iterator[str]:
    """Yield mean gains over scratch by family, and what is lost against the best without phi."""
    yield "mean gain over scratch, families weighing the same: sensible sources, other sources"
    columns = {
        "default": lambda study, arm: study.gains(arm),
        "unguarded": lambda study, arm: study.gains(arm, of=raws[study.name].comparison),
        "placebo": lambda study, arm: study.gains(f"{arm}, placebo"),
        "its best constant": lambda study, arm: max(
            (study.gains(f"{arm}, constant {kind}") for kind in ("mean", "minimum", "maximum")),
            key=np.mean,
        ),
        "optimistic learner": lambda study, arm: study.gains(OPTIMISTIC),
        "best opponent": lambda study, arm: study.gains(study.comparison.best_opponent(arm)),
    }
    for label, gains in columns.items():
        cells = []
        for wanted in (True, False):
            by_family: dict[str, list[float]] = {}
            for study in studies:
                for arm in study.arms:
                    if sensible(arm) is wanted and (label != "unguarded" or study.name in raws):
                        values = by_family.setdefault(study.pair.family, [])
                        values.append(float(gains(study, arm).mean()))  # type: ignore[no-untyped-call]
            cells.append(np.mean([np.mean(values) for values in by_family.values()] or [np.nan]))
        yield f"  {label:<20}" + "".join(f"{cell:>8.2f}" for cell in cells)
    for wanted, named in ((True, "sensible"), (False, "other")):
        own = [(study, arm) for study in studies for arm in study.arms if sensible(arm) is wanted]
        verdicts = [study.comparison.contrasts[arm].verdict for study, arm in own]
        counts = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
        knows = sum(s.comparison.contrasts[arm].reason == "by what it knows" for s, arm in own)
        yield f"{len(own)} {named} sources: {counts}; {knows} by what it knows"
        loses = sum(float(study.gains(arm).mean()) < -MUCH for study, arm in own)
        raw = sum(
            float(study.gains(arm, of=raws[study.name].comparison).mean()) < -MUCH
            for study, arm in own
            if study.name in raws
        )
        yield f"  lose more than {MUCH:.0%} of the way against scratch: {loses}; unguarded: {raw}"


def confirmed(studies: Sequence[Played], again: Mapping[str, Played]) -> Iterator[str]:
    """Yield how many of the curricula that pay do so on fresh seeds."""
    paying = [(study, arm) for study in studies for arm in study.arms if study.pays(arm)]
    tried = [(s, arm) for s, arm in paying if s.name in again and arm in again[s.name].arms]
    still = [arm for study, arm in tried if again[study.name].pays(arm)]
    yield f"{len(paying)} pay; on fresh seeds {len(still)} of the {len(tried)} that were played"


def commands(folders: Sequence[str]) -> Iterator[str]:
    """Yield the commands that play what pays on fresh seeds, against all opponents."""
    for folder in folders:
        study, name = Played(folder), Path(folder).name
        arms = [f"--arm {shlex.quote(arm)}" for arm in study.arms if study.pays(arm)]
        if arms:
            file = f"benchmarks/pairs/{name}.toml --seeds {FRESH_SEEDS} --out again/{name}"
            yield f"curricle run {file} {' '.join(arms)}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.pairs", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("what", choices=["gains", "forecasts", "again"])
    parser.add_argument("paths", nargs="+", help="folders of results; of forecasts study files")
    parser.add_argument("--raw", nargs="*", default=[], help="folders of the unguarded sources")
    parser.add_argument("--again", nargs="*", default=[], help="folders of the fresh seeds")
    parser.add_argument("--forecasts", type=Path)
    options = parser.parse_args(arguments)
    if options.what == "forecasts":
        print(json.dumps(forecasts(options.paths), indent=1))
        return
    if options.what == "again":
        print("\n".join(commands(options.paths)))
        return
    studies = [Played(folder) for folder in options.paths]
    raws, again = (
        {study.name: study for study in map(Played, folders)}
        for folders in (options.raw, options.again)
    )
    print(f"{'':<45}{'unguarded':>11}{'default':>11}{'over the best':>22}  opponent")
    for study in studies:
        print("\n".join(rows_of(study, raws.get(study.name), again.get(study.name))))
    for split in dict.fromkeys(study.pair.split for study in studies):
        part = [study for study in studies if study.pair.split == split]
        print(f"\n{split}: {len(part)} targets")
        print("\n".join([*summary(part, raws), *confirmed(part, again)]))
        if options.forecasts:
            print("\n".join(judged(part, json.loads(options.forecasts.read_text()))))


if __name__ == "__main__":
    main()
