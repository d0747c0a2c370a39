"""What benchmarks of transfer share: arms x seeds in processes, resumed; a table and a picture.

An arm is a curriculum; all steps are charged, the sources' included. Each (arm, seed) is trained in
a process of its own and its curve written to a file, so that a stopped benchmark can be resumed.
Returns are those of the greedy policy, undiscounted, over episodes that are not learnt from.
"""

import argparse
import importlib
import json
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np

import curricle as cr
from curricle.files import write_whole
from curricle.show import COLOURS, STYLE, draw_curve, new_figure


@dataclass(frozen=True)
class Benchmark:
    """What is compared, and when the target counts as learnt."""

    title: str
    arms: Mapping[str, Callable[[], cr.Curriculum]]
    threshold: float  # return of the target's greedy policy

    def main(self, module: str, description: str) -> None:
        given = argparse.ArgumentParser(description=description)
        given.add_argument("--seeds", type=int, default=5)
        given.add_argument("--workers", type=int, default=2)
        given.add_argument("--arms", nargs="*", default=list(self.arms), choices=list(self.arms))
        given.add_argument("--out", type=Path, default=folder(module))
        options = given.parse_args()
        options.out.mkdir(parents=True, exist_ok=True)
        jobs = [(arm, seed) for seed in range(options.seeds) for arm in options.arms]
        # Torch does not survive a fork.
        with cr.study.WorkerProcesses(options.workers) as pool:
            running = {pool.submit(train, module, *job, options.out): job for job in jobs}
            for done in as_completed(running):
                print(
                    "done:", *running[done], f"final {done.result()['greedy'][-1]:.1f}", flush=True
                )
        curves = {arm: curve_of(arm, options.seeds, options.out) for arm in options.arms}
        self.tell(curves)
        self.draw(curves, options.out / "curves.png")

    def tell(self, curves: Mapping[str, cr.statistics.Curve]) -> None:
        """Print each arm: what it spent, where it began and ended, when it had learnt."""
        seeds = len(next(iter(curves.values())).values)
        print(f"\n{self.title}; {seeds} seeds, mean [95 % interval]")
        print(f"learnt: a return of {self.threshold:g}; median steps, the sources' included\n")
        print(f"{'arm':<34}{'sources':>9}{'target':>9}{'start':>9}{'end':>24}{'learnt':>34}")
        for arm, curve in curves.items():
            end = cr.statistics.mean_interval(cr.statistics.asymptotic_performance(curve))
            times = cr.statistics.time_to_threshold(curve, self.threshold, strong=True)
            time = times.median()
            learnt = f"{time.estimate:,.0f} [{time.low:,.0f}, {time.high:,.0f}]"
            learnt += f" {int(times.reached.sum())}/{seeds}"
            print(
                f"{arm:<34}{curve.source_steps.mean():>9,.0f}{curve.steps[-1]:>9,}"
                f"{curve.values[:, 0].mean():>9.1f}"
                f"{f'{end.estimate:.1f} [{end.low:.1f}, {end.high:.1f}]':>24}{learnt:>34}"
            )

    @matplotlib.rc_context(STYLE)
    def draw(self, curves: Mapping[str, cr.statistics.Curve], path: Path) -> None:
        """Draw each arm beside the first, from where its sources had been paid for."""
        (base, first), *others = curves.items()
        columns = max(len(others) if len(others) < 5 else -(-len(others) // 2), 1)
        rows = max(-(-len(others) // columns), 1)
        figure, panels = new_figure(rows, columns, width=0.8 + 2.4 * columns, height=0.9 + 2 * rows)
        for axes, arm in zip(panels.flat, others or [(base, first)], strict=False):
            draw_curve(axes, first, label=base, colour=COLOURS["grey"], strong=True)
            draw_curve(axes, arm[1], label=arm[0], colour=COLOURS["blue"], strong=True)
            axes.axhline(self.threshold, color=COLOURS["black"], lw=0.8, ls=":")
            axes.sharey(panels[0, 0])
            axes.set_title(arm[0], color=COLOURS["blue"])
            if first.steps[-1] > 5 * arm[1].steps[-1]:
                axes.set_xscale("log")
        for axes in panels.flat[len(others) :]:
            axes.remove()
        figure.supxlabel("steps, those of the sources included", fontsize=9)
        figure.supylabel("return of the greedy policy", fontsize=9)
        figure.suptitle(
            f"{self.title}\nmean of {len(first.values)} seeds, 95 % bands; "
            f"grey: {base}; dotted: counts as learnt",
            fontsize=9.5,
        )
        figure.savefig(path, dpi=130)
        print(f"\n{path}")


def folder(module: str) -> Path:
    """Return where the curves of a benchmark are by default."""
    return Path("evidence") / module.rpartition(".")[2]


def train(module: str, arm: str, seed: int, out: Path) -> dict:
    """Return one arm's curve for one seed, from its file if it is there."""
    return trained(importlib.import_module(module).BENCHMARK.arms[arm], arm, seed, out)


def trained(make: Callable[[], cr.Curriculum], arm: str, seed: int, out: Path) -> dict:
    """Return the curve of a curriculum for one seed, from its file if it is there."""
    path = place(arm, seed, out)
    if path.exists():
        return json.loads(path.read_text())
    plan = make()
    result = plan.train([seed], saves=out / "checkpoints" / path.stem)
    learnt, target = result[plan.target], plan.target
    found = {
        "steps": learnt.steps.tolist(),
        "greedy": learnt.greedy_return[0].tolist(),
        "source_steps": int(result.source_steps(target)[0]),
    }
    write_whole(path, json.dumps(found).encode())
    return found


def place(arm: str, seed: int, out: Path) -> Path:
    return out / f"{arm.replace(' ', '_').replace(',', '')}-{seed}.json"


def curve_of(arm: str, seeds: int, out: Path) -> cr.statistics.Curve:
    """Return an arm's curves; a seed that ended early keeps its last return."""
    found = [json.loads(place(arm, seed, out).read_text()) for seed in range(seeds)]
    longest = max((one["steps"] for one in found), key=len)
    rows = [np.pad(one["greedy"], (0, len(longest) - len(one["greedy"])), "edge") for one in found]
    return cr.statistics.Curve(
        np.array(longest), np.array(rows), np.array([one["source_steps"] for one in found])
    )
