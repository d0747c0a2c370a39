"""What ``curricle show`` prints of a sweep or a tuning."""

from textwrap import fill

from curricle.cli.terminal_tables import print_table, table
from curricle.study.config.varied_settings import value_text
from curricle.study.effects import TUNING, Effects, Level, effects_of
from curricle.study.results import StudyResults
from curricle.study.tuning_record import TuningRecord, read_tuning
from curricle.study.units import seed_ranges

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
    print(
        "\n"
        + fill(
            f"tuned on seeds {seed_ranges(tuning.seeds)}, {tuning.total:,} steps a trial and seed, "
            "sources included; these steps are shown here and not charged to the curves",
            100,
        )
    )
    rows = table("best trial", "of", "tuning steps", "mean return", *tuning.space)
    for name, arm in tuning.arms.items():
        best = arm.best
        score = NONE if best.score is None else f"{best.score:.4g}"
        values = [_number(best.values.get(key)) for key in tuning.space]
        rows.add_row(name, f"{len(arm.trials)}", f"{tuning.steps(name):,}", score, *values)
    print_table(rows)


def _print_levels(found: Effects) -> None:
    """Print the main effect of each setting on each arm."""
    what = (
        "trials; lowest and highest" if found.kind == TUNING else "arms; 95 % intervals over seeds"
    )
    print(f"\nmain effects on the mean return, sources charged (means over {what})")
    rows = table("", *found.arms)
    for setting in found.settings:
        by_arm = {
            arm: {one.text: one for one in found.levels.get((arm, setting.key), ())}
            for arm in found.arms
        }
        for text in setting.levels:
            cells = [_level(by_arm[arm].get(text)) for arm in found.arms]
            if set(cells) != {NONE}:
                rows.add_row(f"{setting.key} = {text}", *cells)
    print_table(rows)


def _level(one: Level | None) -> str:
    if one is None:
        return NONE
    return f"{one.mean:.4g} [{one.low:.4g}, {one.high:.4g}] ({one.number})"


def _number(value: object) -> str:
    """Return a value that was tried, numbers in four significant digits."""
    if value is None:
        return NONE
    return f"{value:.4g}" if isinstance(value, float) else value_text(value)
