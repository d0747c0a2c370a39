"""How deep is worth it? The audits of curricula of one to five sources, as tables and a figure.

    python -m benchmarks.published play published-results depth_keys depth_pursuit depth_maze
    python -m benchmarks.published.depth table published-results
    python -m benchmarks.published.depth figure published-results how_deep.png
    python -m benchmarks.published.depth singles published-results   # a single source of each size

Gains are shares of the way from the random policy's return to the optimum. Single sources have
fewer trials and seeds.
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.published.__main__ import CLAIMS, markdown, played, share, way_to_optimum
from curricle.statistics.curves import SCRATCH
from curricle.study import Audit, StudyResults, read_study, run_study
from curricle.study.auditing import CONFIGURED, FAIR, as_fair

DEPTHS = ("one source", "two sources", "three sources", "four sources", "five sources")
FAMILIES = {"depth_keys": "key, lock, pits", "depth_pursuit": "hunt", "depth_maze": "random maze"}
FEW = "200-229"
TRIALS = 5  # for each setting
LABELS = {CONFIGURED: "as configured, over scratch", FAIR: "fair, over the best opponent"}


def rows(audits: Mapping[str, Audit]) -> Iterator[tuple[str, ...]]:
    """Yield the gains of a depth in each family: as configured; over scratch, over the best."""
    ways = {name: way_to_optimum(name, audits[name].fair) for name in FAMILIES}
    for depth in DEPTHS:
        for name, family in FAMILIES.items():
            before, after, way = audits[name].configured, audits[name].fair, ways[name]
            at = before.comparison.against(SCRATCH)[depth].gain
            over = after.comparison.against(SCRATCH)[depth].gain
            best = after.comparison.contrasts[depth].strong_gain
            gains = share(at, way), share(over, way), share(best, way)
            yield depth, family, *gains, after.comparison.contrasts[depth].answer


def beside(name: str, results: StudyResults) -> Iterator[tuple[str, ...]]:
    """Yield the gain of each depth over the others, from the same seeds."""
    way = way_to_optimum(name, results)
    for rival in DEPTHS:
        against = results.comparison.against(rival)
        of = (share(against[arm].gain, way) if arm in against else "" for arm in DEPTHS)
        yield f"over {rival}", *of


def figure(folder: Path, path: Path) -> None:
    """Draw the gain over the best opponent, and over scratch as configured, by depth."""
    drawn = Figure(figsize=(9, 3), layout="constrained")
    all_axes = drawn.subplots(1, len(FAMILIES), sharex=True)
    audits = played(folder)
    for axes, (name, family) in zip(all_axes, FAMILIES.items(), strict=True):
        for side, label in LABELS.items():
            results = getattr(audits[name], side)
            comparison, way = results.comparison, way_to_optimum(name, results)
            scratch = comparison.against(SCRATCH)
            gains = [
                scratch[arm].gain if side == CONFIGURED else comparison.contrasts[arm].strong_gain
                for arm in DEPTHS
            ]
            low, middle, high = (
                np.array([getattr(gain, end) / way for gain in gains])
                for end in ("low", "estimate", "high")
            )
            ends = middle - low, high - middle
            axes.errorbar(range(1, 6), middle, ends, marker="o", capsize=3, label=label)
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.set(title=family, xlabel="sources before the target")
    all_axes[0].set_ylabel("gain, share of the way")
    drawn.legend(*all_axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    drawn.savefig(path, dpi=110)


def single(name: str) -> str:
    """Return the study file with an arm for each source alone."""
    study, arms = read_study(CLAIMS[name]), dict[str, str]()
    mapping = "same_position" if name == "depth_maze" else "family"
    for plan in study.curricula.values():
        for source in plan.ancestors(plan.target):
            edge = f'source = "{source}", target = "target", mapping = "{mapping}"'
            arms[source] = f"[arms.{source}]\ntransfers = [{{ {edge} }}]\n"
    del arms[next(iter(study.curricula["one source"].ancestors("target")))]  # is an arm already
    return "\n".join([CLAIMS[name].read_text(), *arms.values()])


def singles(folder: Path) -> Iterator[tuple[str, ...]]:
    """Yield the gain of a single source of each size, and of each depth."""
    for name, family in FAMILIES.items():
        file = folder / f"{name}_singles.toml"
        file.write_text(single(name))
        fair = as_fair(read_study(file, set=[f"seeds={FEW}"]), TRIALS)
        fair = fair.varied(opponents=(), controls=())
        results = run_study(fair, str(file.with_suffix("")), resume=True, workers=1)
        way = way_to_optimum(name, results)
        for arm, contrast in results.comparison.contrasts.items():
            if arm in results.comparison.verdicts:
                unlearnt = results.comparison[arm].unlearnt.values()
                missed = f"{max(seeds.mean() for seeds in unlearnt):.0%}"
                yield family, arm, share(contrast.strong_gain, way), missed


def main() -> None:
    """Print the tables, draw the figure, or play single sources."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=["table", "figure", "singles"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("path", type=Path, nargs="?", default=Path("how_deep.png"))
    given = parser.parse_args()
    if given.what == "figure":
        figure(given.folder, given.path)
    elif given.what == "singles":
        print(markdown(("family", "arm", "gain", "a source not learnt"), singles(given.folder)))
    else:
        heads = ("", "family", "as configured", "fair, over scratch", "over the best", "verdict")
        audits = played(given.folder)
        print(markdown(heads, rows(audits)))
        for name in FAMILIES:
            print(f"\n{name}\n\n{markdown(('', *DEPTHS), beside(name, audits[name].fair))}")


if __name__ == "__main__":
    main()
