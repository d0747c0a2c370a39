"""Play published gains again by one protocol, and print the tables of docs/what_survives.md.

    python -m benchmarks.published play published-results             # goes on after a kill
    python -m benchmarks.published play published-results office --seeds 20
    python -m benchmarks.published play published-results rooms_x2 graph_x4   # larger tasks
    python -m benchmarks.published table published-results
    python -m benchmarks.published rewards                            # of the office, as published

Every study file here is a claim, and its audit is a folder of that name. Gains are of the mean
return over all steps, as shares of the way from the random policy's return to the optimum.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import curricle as cr
from benchmarks.published.grids import maze
from curricle.comparison.measures import Reference
from curricle.comparison.sentences import share_saved
from curricle.planning import Target
from curricle.show.report import write_audit
from curricle.statistics import Interval, mean_interval
from curricle.statistics.curves import SCRATCH
from curricle.study import Audit, StudyConfig, StudyResults, audit, read_study
from curricle.study.auditing import CONFIGURED, FAIR, INFORMED

CLAIMS = {file.stem: file for file in sorted(Path(__file__).parent.glob("*.toml"))}
MAZES = {"graph": ("maze", "line", "small", "near", "far fire", "pit")}
MAZES["objects"] = ("maze", "line", "near", "fire")
LARGER = [f"{name}_x{times}" for name in ("rooms", *MAZES) for times in (2, 4)]
"""Claims with sides two and four times as long, in the steps of the paper."""
TRIALS = 20  # for each setting of the arm that has most
OPTIMIST = f"{SCRATCH}, OptimisticQLearning"
HEADS = ("claim", "arm", "as configured", "over the same learner, tuned")
HEADS += ("over the best opponent, tuned", "verdict", "steps saved", "exploring from its phi")


def play(folder: Path, names: list[str], seeds: str | None, workers: int | None) -> None:
    """Run the audits of some claims, all by default, into subfolders, and write their pages."""
    for name in names or CLAIMS:
        study = claim(name, [f"seeds={seeds}"] if seeds else [])
        made = audit(study, folder / name, trials=TRIALS, workers=workers)
        print(f"{made}\n{write_audit(made, folder / name / 'audit.html')}\n", flush=True)


def claim(name: str, changes: list[str] | None = None) -> StudyConfig:
    """Return the study of a claim, with these changes."""
    name, _, times = name.partition("_x")
    changes = [*(changes or []), *(larger(name, int(times)) if times else [])]
    return read_study(CLAIMS[name], set=changes)


def larger(name: str, times: int) -> Iterator[str]:
    """Yield the changes that make the sides of a claim's tasks `times` as long."""
    yield f"name={read_study(CLAIMS[name]).name}, x{times}"
    if name == "rooms":
        yield f"tasks.cells.arguments.times={times}"
        reads = f"worlds:room_at_{times}"
        yield f'transfers=[{{ source = "rooms", target = "cells", function = "{reads}" }}]'
        if times > 2:  # exact evaluations of so many cells take longer than learning
            yield "tasks.cells.eval_freq=15_000"
        return
    yield from (f'tasks."{task}".arguments.times={times}' for task in MAZES[name])
    yield f"threshold={0.98 * cr.solve(maze('maze', times=times)).start_value}"  # as theirs is


def played(folder: Path) -> dict[str, Audit]:
    """Return the audits in a folder by claim."""
    there = [
        name for name in (*CLAIMS, *LARGER) if (folder / name / FAIR / "results.parquet").exists()
    ]
    sides = {
        name: [StudyResults(folder / name / side) for side in (CONFIGURED, FAIR)] for name in there
    }
    return {name: Audit(*both) for name, both in sides.items()}


def way_to_optimum(name: str, results: StudyResults) -> float:
    """Return how far the optimum of a claim's target is above the random policy's return."""
    reference, study = results.comparison.reference, claim(name)
    if study.threshold is not None:  # then the target was not solved
        plan = next(iter(study.curricula.values()))
        reference = Reference.of(Target.of(plan.tasks[plan.target]))
    low, high = reference.random_return, reference.optimum
    return 1.0 if low is None or high is None else high - low


def share(gain: Interval, way: float) -> str:
    """Return a gain as a share of the way from the random policy's return to the optimum."""
    estimate, *ends = (f"{number / way:+.2f}" for number in (gain.estimate, gain.low, gain.high))
    return f"{estimate} [{', '.join(ends)}]"


def rows(audits: dict[str, Audit]) -> Iterator[tuple[str, ...]]:
    """Yield the row of each arm, with what the best opponent gains that explores from its phi."""
    for name, made in audits.items():
        before, after = made.configured.comparison, made.fair.comparison
        way, scratch = way_to_optimum(name, made.fair), before.against(SCRATCH)
        for arm in before.verdicts:
            contrast, same = after.contrasts[arm], after.against(made.same_learner(arm))[arm]
            rival = after.best_opponent(arm).removeprefix(f"{arm}, ")
            informed = after.contrasts.get(f"{arm}, {INFORMED}")
            yield (
                f"{made.fair.record.name}, {len(made.fair.seeds)} seeds",
                arm,
                share(scratch[arm].gain, way),
                share(same.gain, way),
                share(contrast.strong_gain, way) + f" ({rival})" * (rival != OPTIMIST),
                contrast.answer,
                share_saved(after, arm),
                f"{share(informed.strong_gain, way)}, {informed.answer}" if informed else "-",
            )


def made_of(made: Audit) -> Iterator[tuple[str, ...]]:
    """Yield each arm of an audit with its settings, its steps until learnt, and its mean return."""
    for side, results in (("as configured", made.configured), ("fair", made.fair)):
        comparison, tuned = results.comparison, results.record.tuned
        for arm in comparison.shown:
            values = tuned.arms[arm].values if tuned and arm in tuned.arms else {}
            chosen = [f"{key} {value:.3g}" for key, value in values.items()]
            times, mean = comparison.times(arm), comparison.mean_return(arm)
            missed = int((~times.reached).sum())
            steps = f"{np.median(times.steps):,.0f}" + f", {missed} never" * bool(missed)
            yield side, arm, ", ".join(chosen), steps, f"{mean.estimate:.4g}"


def markdown(heads: tuple[str, ...], lines: Iterator[tuple[str, ...]]) -> str:
    """Return a table in Markdown."""
    ruled = ("--",) * len(heads)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, ruled, *lines))


def rewards() -> Iterator[tuple[str, ...]]:
    """Yield the rewards of the office in 100,000 steps of training, as the published logs count."""
    changes = ["tasks.office.evaluation.discounted=false", "seeds=60"]
    study = claim("office", changes)
    arms = {**study.scratch_curricula(), **study.curricula}
    for arm in (SCRATCH, *study.arms):
        result = arms[arm].train(study.seeds)["office"]
        ended = np.diff(result.episodes, axis=1, prepend=0)
        paid = (np.nan_to_num(result.training_return) * ended).sum(axis=1)
        yield arm, f"{mean_interval(paid)}"


def main() -> None:
    """Play, or print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=["play", "table", "rewards"])
    parser.add_argument("folder", type=Path, nargs="?", default=Path("published-results"))
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--seeds")
    parser.add_argument("--workers", type=int)
    given = parser.parse_args()
    if given.what == "play":
        play(given.folder, given.names, given.seeds, given.workers)
        return
    if given.what == "rewards":
        print(markdown(("arm", "rewards"), rewards()))
        return
    # The table of depths is that of depth.py.
    audits = {name: of for name, of in played(given.folder).items() if not name.startswith("depth")}
    print(markdown(HEADS, rows(audits)))
    heads = ("", "arm", "best of the trials", "steps until learnt, median", "mean return")
    for name, made in audits.items():
        print(f"\n{name}: {made.sentence}\n\n{markdown(heads, made_of(made))}")


if __name__ == "__main__":
    main()
