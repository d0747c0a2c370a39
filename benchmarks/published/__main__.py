"""Play published gains again by one protocol, and print the tables of docs/what_survives.md.

    python -m benchmarks.published play published-results             # goes on after a kill
    python -m benchmarks.published play published-results office --seeds 20
    python -m benchmarks.published table published-results
    python -m benchmarks.published rewards                            # of the office, as published

Every study file here is a claim, and its audit is a folder of that name. Gains are of the mean
return over all steps, as shares of the way from the random policy's return to the optimum.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from curricle.comparison.measures import Reference
from curricle.planning import Target
from curricle.show.report import write_audit
from curricle.statistics import Interval, mean_interval
from curricle.statistics.curves import SCRATCH
from curricle.study import Audit, StudyResults, audit, read_study
from curricle.study.auditing import CONFIGURED, FAIR

CLAIMS = {file.stem: file for file in sorted(Path(__file__).parent.glob("*.toml"))}
TRIALS = 20  # for each setting of the arm that has most
HEADS = ("claim", "arm", "as configured", "verdict", "same learner, tuned", "verdict")
HEADS += ("best opponent, tuned", "which", "verdict")


def play(folder: Path, names: list[str], seeds: str | None, workers: int | None) -> None:
    """Run the audits of some claims, all by default, into subfolders, and write their pages."""
    for name in names or CLAIMS:
        study = read_study(CLAIMS[name], set=[f"seeds={seeds}"] if seeds else [])
        made = audit(study, folder / name, trials=TRIALS, workers=workers)
        print(f"{made}\n{write_audit(made, folder / name / 'audit.html')}\n", flush=True)


def played(folder: Path) -> dict[str, Audit]:
    """Return the audits in a folder by claim."""
    there = [name for name in CLAIMS if (folder / name / FAIR / "results.parquet").exists()]
    sides = {
        name: [StudyResults(folder / name / side) for side in (CONFIGURED, FAIR)] for name in there
    }
    return {name: Audit(*both) for name, both in sides.items()}


def way_to_optimum(name: str, results: StudyResults) -> float:
    """Return how far the optimum of a claim's target is above the random policy's return."""
    reference, study = results.comparison.reference, read_study(CLAIMS[name])
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
    """Yield the row of each arm: gain as configured, over the same learner, over the best."""
    for name, made in audits.items():
        before, after = made.configured.comparison, made.fair.comparison
        way = way_to_optimum(name, made.fair)
        for arm in after.verdicts:
            contrast, same = after.contrasts[arm], after.against(made.same_learner(arm))[arm]
            first = ("-", "-")  # of an informed optimist, which no paper has
            if arm in before.verdicts:
                over_scratch = before.against(SCRATCH)[arm].gain
                first = (share(over_scratch, way), before.contrasts[arm].answer)
            yield (
                f"{made.fair.record.name}, {len(made.fair.seeds)} seeds",
                arm,
                *first,
                share(same.gain, way),
                same.against_scratch,
                share(contrast.strong_gain, way),
                after.best_opponent(arm).removeprefix(f"{arm}, "),
                contrast.answer,
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
    study = read_study(CLAIMS["office"], set=changes)
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
