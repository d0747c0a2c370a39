"""What ``curricle show`` prints of a sweep or a tuning."""

from curricle.cli.terminal_tables import print_table, print_text
from curricle.study.config.varied_settings import value_text
from curricle.study.effects import TUNING, Effects, effects_of
from curricle.study.results import StudyResults
from curricle.study.tuning_record import TuningRecord, read_tuning
from curricle.study.units import numbered_seeds

NONE = "–"


def print_effects(results: StudyResults) -> None:
    """Print the best trial of each arm and the main effects, of a study that has finished seeds."""
    tuning = read_tuning(results.store)
    if tuning is not None:
        print_tuning(tuning)
    for found in effects_of(results.comparison, results.record, tuning):
        _print_levels(found)


def print_tuning(tuning: TuningRecord) -> None:
    """Print how every arm was tuned, what that took, and its best trial."""
    print()
    print_text(
        f"tuned on {numbered_seeds(tuning.seeds)}, {tuning.total:,} steps a trial and seed, "
        "sources included; these steps are shown here and not charged to the curves"
    )
    rows = list[tuple[str, ...]]()
    for name, arm in tuning.arms.items():
        best = arm.best
        words = ", ".join(f"{key} = {_number(value)}" for key, value in best.values.items())
        score = NONE if best.score is None else f"{best.score:.4g}"
        number, steps = f"{len(arm.trials)}", f"{tuning.steps(name):,}"
        rows.append((f"{name}: {words or 'nothing to tune'}", number, steps, score))
    print_table(("best trial", "of", "tuning steps", "mean return"), rows)


def _print_levels(found: Effects) -> None:
    """Print the main effect of each setting on each arm."""
    tuned = found.kind == TUNING
    over = "trials, from the lowest to the highest" if tuned else "arms, 95 % intervals over seeds"
    print()
    print_text(f"main effects: mean return, sources charged, over all {over}")
    rows = [
        (
            f"{arm}: {key} = {level.text}",
            f"{level.number}",
            f"{level.mean:.4g}",
            f"[{level.low:.4g}, {level.high:.4g}]",
        )
        for arm, key, level in found.rows
    ]
    print_table(("", "trials" if tuned else "arms", "mean return", ""), rows)


def _number(value: object) -> str:
    """Return a value that was tried, numbers in four significant digits."""
    if value is None:
        return NONE
    return f"{value:.4g}" if isinstance(value, float) else value_text(value)
