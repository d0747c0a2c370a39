"""Print the tables of docs/trust.md from folders of the studies here.

    for study in benchmarks/pairs/*.toml; do
        name=$(basename $study .toml)
        curricle run $study --out pairs/$name
        curricle run $study --out raw/$name --set shaping=QInitialisation \\
            --set controls=[] --set opponents=[]
    done
    python -m benchmarks.pairs forecasts benchmarks/pairs/*.toml > forecasts.json
    python -m benchmarks.pairs again pairs/* | sh       # what pays, on 40 fresh seeds, into again/
    python -m benchmarks.pairs gains pairs/* --beside raw --again again --forecasts forecasts.json

`raw` is phi alone, without the portfolio of the default; other ways in are played like it and stand
beside it. Gains are shares of the way from the random policy's return to the optimum, of the mean
over all steps, sources charged, with Student intervals at 95 %. A sensible source is near or far.
"""

import argparse
import json
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

import curricle as cr
from benchmarks.pairs.families import pairs_of
from benchmarks.pairs.pair import SENSIBLE, levels
from curricle.comparison.opponents import CONSTANTS
from curricle.statistics import mean_interval
from curricle.statistics.curves import SCRATCH
from curricle.study import StudyResults

OPTIMISTIC = "scratch, OptimisticQLearning"
FRESH_SEEDS = "1000-1039"
MUCH, SLIGHT = 0.1, 0.01
"""Shares of the way: that no default should lose, and that make a difference."""


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

    def gains(self, arm: str, rival: str = SCRATCH, of: "Played | None" = None) -> np.ndarray:
        """Return by how much an arm, here or of another study, gains more than one here, (K,)."""
        returns = self.comparison.returns
        mine: np.ndarray = (of or self).comparison.returns[arm]
        return (mine - returns[rival]) / self.way

    def gain(self, arm: str) -> tuple[float, float, float]:
        """Return the gain over the best opponent: estimate, low and high."""
        gain = self.comparison.contrasts[arm].strong_gain
        return gain.estimate / self.way, gain.low / self.way, gain.high / self.way

    def pays(self, arm: str) -> bool:
        """Return whether the verdict is that an arm pays."""
        return self.comparison.contrasts[arm].verdict == "pays"


Beside = Mapping[str, Mapping[str, Played]]  # ways in: by name, each study by its own


def stored(home: str, folders: Sequence[str]) -> dict[str, Played]:
    """Return the studies in a folder whose names some folders have, those that are there."""
    there = [Path(home) / Path(folder).name for folder in folders]
    played = [Played(str(path)) for path in there if path.exists()]
    return {study.name: study for study in played}


def sensible(arm: str) -> bool:
    """Return whether a person would call the source of an arm sensible."""
    return arm.partition(":")[0] in SENSIBLE


# -- The forecasts, and whether they came true -----------------------------------------------------


Foreseen = dict[str, dict[str, tuple[float, float, float]]]
"""By study and arm: gain, its low and high end."""


def forecasts(files: Sequence[str], changes: Sequence[str] = ()) -> Foreseen:
    """Return what is forecast for each arm of each study."""
    foreseen: Foreseen = {}
    for file in files:
        study = cr.read_study(file, set=changes)
        foreseen[study.name] = {}
        for arm in study.arms:
            part = cr.read_study(file, set=changes, arms=[arm])
            used = cr.forecast(part, trial=True).used
            assert used.gain is not None, "a trial was asked for"
            foreseen[study.name][arm] = used.gain.estimate, used.gain.low, used.gain.high
    return foreseen


def pooled_rank(score: np.ndarray, gain: np.ndarray, target: np.ndarray) -> float:
    """Return the correlation of the ranks within targets, scaled to [-1, 1], over all arms."""
    ranks: list[list[float]] = [[], []]
    for name in np.unique(target):
        rows = target == name
        if rows.sum() > 1:
            for held, values in zip(ranks, (score[rows], gain[rows]), strict=True):
                held += (2 * (rankdata(values) - 1) / (rows.sum() - 1) - 1).tolist()
    return float(np.corrcoef(*ranks)[0, 1])


def judged(studies: Sequence[Played], foreseen: Foreseen) -> Iterator[str]:
    """Yield how good the forecasts are, against the gains over the best opponents."""
    rows = [
        (study.name, *foreseen[study.name][arm], study.gain(arm)[0])
        for study in studies
        for arm in study.arms
    ]
    target, score, low, high, gain = map(np.array, zip(*rows, strict=True))
    commits, right = (low > 0) | (high < 0), (score > 0) == (gain > 0)
    said = f"{(low > 0).sum()} likely pay, {(high < 0).sum()} likely cost"
    yield f"forecasts of {len(rows)} curricula: {said}"
    yield f"  sign right where it commits itself: {right[commits].sum()} of {commits.sum()}"
    yield f"  rank correlation within targets: {pooled_rank(score, gain, target):.2f}"


# -- The tables ------------------------------------------------------------------------------------


def short(values: Any) -> str:
    """Return a mean and half its interval's width, such as +.53±.04."""
    interval = mean_interval(values)
    half = (interval.high - interval.low) / 2
    return f"{interval.estimate:+.2f}" + (f"±{half:.2f}" if np.isfinite(half) else "")


def rows_of(study: Played, beside: Beside, again: Mapping[str, Played]) -> Iterator[str]:
    """Yield a line for each curriculum: gains, the best opponent and the verdict."""
    played = study.comparison
    there = OPTIMISTIC in played.arms
    yield study.name + (f"; {OPTIMISTIC} {short(study.gains(OPTIMISTIC))}" if there else "")
    for arm in study.arms:
        others = (study.gains(arm, of=way.get(study.name)) for way in beside.values())
        gains = "".join(f"{short(gain):>11}" for gain in (study.gains(arm), *others))
        estimate, low, high = study.gain(arm)
        over = f"{estimate:+.2f} [{low:+.2f}, {high:+.2f}]"
        contrast = played.contrasts[arm]
        rival = played.best_opponent(arm).removeprefix(f"{arm}, ").removeprefix("scratch, ")
        words = ", ".join(filter(None, (contrast.verdict, contrast.reason)))
        if study.name in again and arm in again[study.name].arms:
            words += f"; fresh seeds: {again[study.name].comparison.contrasts[arm].verdict}"
        yield f"  {arm[:42]:<43}{gains}{over:>22}  {rival:<22} {words}"


def summary(studies: Sequence[Played], beside: Beside) -> Iterator[str]:
    """Yield mean gains over scratch by family, verdicts, and who loses much against scratch."""
    yield "mean gain over scratch, families weighing the same: sensible sources, other sources"
    arms = [(study, arm) for study in studies for arm in study.arms]
    columns: dict[str, Callable[[Played, str], np.ndarray]] = {
        "as played": lambda study, arm: study.gains(arm),
        **{
            name: lambda study, arm, way=way: study.gains(arm, of=way.get(study.name))
            for name, way in beside.items()
        },
        "placebo": lambda study, arm: study.gains(f"{arm}, placebo"),
        "its best constant": lambda study, arm: max(
            (study.gains(f"{arm}, {constant}") for constant in CONSTANTS), key=np.mean
        ),
        "optimistic learner": lambda study, arm: study.gains(OPTIMISTIC),
        "best opponent": lambda study, arm: study.gains(study.comparison.best_opponent(arm)),
    }
    study, arm = arms[0]
    for label, known in {
        "placebo": f"{arm}, placebo",
        "its best constant": f"{arm}, constant mean",
        "optimistic learner": OPTIMISTIC,
    }.items():
        if known not in study.comparison.arms:  # of studies with fewer controls or opponents
            del columns[label]
    for label, gains in columns.items():
        cells = []
        for wanted in (True, False):
            by_family: dict[str, list[float]] = {}
            for study, arm in arms:
                if sensible(arm) is wanted:
                    values = by_family.setdefault(study.pair.family, [])
                    values.append(float(gains(study, arm).mean()))
            cells.append(np.mean([np.mean(values) for values in by_family.values()]))
        yield f"  {label:<20}" + "".join(f"{cell:>8.2f}" for cell in cells)
    for name in beside:
        paired = [mean_interval(columns[name](s, arm) - s.gains(arm)) for s, arm in arms]
        more = sum(difference.low > SLIGHT for difference in paired)
        less = sum(difference.high < -SLIGHT for difference in paired)
        yield f"{name} is shown to gain {SLIGHT:.0%} of the way more in {more}, less in {less}"
    for wanted, named in ((True, "sensible"), (False, "other")):
        kept = [(study, arm) for study, arm in arms if sensible(arm) is wanted]
        verdicts = [study.comparison.contrasts[arm].verdict for study, arm in kept]
        counts = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
        knows = sum(s.comparison.contrasts[arm].reason == "by what it knows" for s, arm in kept)
        yield f"{len(kept)} {named} sources: {counts}; {knows} by what it knows"
        over = {
            word: [getattr(s.comparison.contrasts[arm], part).estimate / s.way for s, arm in kept]
            for word, part in (("charged", "strong_gain"), ("its source free", "weak_gain"))
        }
        for word, shares in over.items():
            lost = sum(share < -MUCH for share in shares)
            yield (
                f"  over the best opponent, {word}: {np.mean(shares):+.2f} on average; {lost} lose "
                f"more than {MUCH:.0%} of the way"
            )
        ways = {name: columns[name] for name in ("as played", *beside)}
        loses = {
            name: sum(float(gains(study, arm).mean()) < -MUCH for study, arm in kept)
            for name, gains in ways.items()
        }
        listed = ", ".join(f"{name} {n}" for name, n in loses.items())
        yield f"  lose more than {MUCH:.0%} of the way against scratch: {listed}"


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
    parser.add_argument("--beside", nargs="*", default=[], help="folders of such folders, by name")
    parser.add_argument("--again", help="the folder of the folders of fresh seeds")
    parser.add_argument("--forecasts", type=Path)
    parser.add_argument("--set", action="append", default=[], help="of forecasts: KEY=VALUE")
    options = parser.parse_args(arguments)
    if options.what == "forecasts":
        print(json.dumps(forecasts(options.paths, options.set), indent=1))
        return
    if options.what == "again":
        print("\n".join(commands(options.paths)))
        return
    studies = [Played(folder) for folder in options.paths]
    beside = {Path(home).name: stored(home, options.paths) for home in options.beside}
    again = stored(options.again, options.paths) if options.again else {}
    heads = "".join(f"{head:>11}" for head in ("gain", *beside))
    print(f"{'':<45}{heads}{'over the best':>22}  opponent")
    for study in studies:
        print("\n".join(rows_of(study, beside, again)))
    for split in dict.fromkeys(study.pair.split for study in studies):
        part = [study for study in studies if study.pair.split == split]
        print(f"\n{split}: {len(part)} targets")
        print("\n".join([*summary(part, beside), *confirmed(part, again)]))
        if options.forecasts:
            print("\n".join(judged(part, json.loads(options.forecasts.read_text()))))


if __name__ == "__main__":
    main()
