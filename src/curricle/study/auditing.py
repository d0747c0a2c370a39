"""Audits: the gains of a study as configured, and what of them survives fair opponents.

Both are studies in subfolders, which can be resumed as any study. The module states the protocol.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from curricle.checks import listed, whole_number
from curricle.comparison.comparison import short
from curricle.comparison.opponents import OPPONENTS, starts_anywhere
from curricle.errors import ConfigError, SettingError
from curricle.planning.solution import evaluate, solve
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import scratch_data
from curricle.study.config import Study, StudyConfig, study_of
from curricle.study.results import StudyResults
from curricle.study.running import run_study
from curricle.study_file.vary import all_tuned
from curricle.tasks.mdp import has_tables, tables
from curricle.text import UNBOUNDED, counted, folded, text_table

CONFIGURED, FAIR = "configured", "fair"  # the subfolders of an audit
RATES = {"low": 0.02, "high": 1.0, "log": True}  # learning rates that are tried
TRIALS = 20  # of every arm, besides its own settings
Row = tuple[str, str, str]  # a measure, as configured, fair


@dataclass(frozen=True, eq=False)
class Audit:
    """A study as configured, and the same study against fair opponents.

    Attributes
    ----------
    configured, fair : StudyResults
    """

    configured: StudyResults
    fair: StudyResults

    @property
    def sentence(self) -> str:
        """What survives, in one sentence."""
        before, after = self.configured.comparison, self.fair.comparison
        if withheld := before.withheld or after.withheld:
            return f"Nothing can be said of what survives: {withheld}."
        pay, still = (
            [name for name, verdict in side.verdicts.items() if verdict.direction > 0]
            for side in (before, after)
        )
        kept = [name for name in pay if name in still]
        number = f"{len(pay)} of {counted(len(before.verdicts), 'arm')}"
        first = f"As configured {number} {'pays' if len(pay) == 1 else 'pay'}"
        if not pay:
            verb = "pays" if len(still) == 1 else "pay"
            rest = f"against fair opponents {listed(still) or 'none'} {verb if still else 'does'}"
            return f"{first}; {rest}."
        if not kept:
            return f"{first}; nothing of it survives fair opponents."
        knows = [name for name in kept if after.reasons[name].why in ("knowledge", "mapping")]
        why = f", by what {'they know' if len(knows) > 1 else 'it knows'}: {listed(knows)}"
        return f"{first}; {len(kept)} of {len(pay)} survives fair opponents{why * bool(knows)}."

    def rows(self, arm: str) -> list[Row]:
        """Return the table of an arm: each measure as configured, and fair."""
        return [
            *zip(
                MEASURES,
                *(_column(side, arm) for side in (self.configured, self.fair)),
                strict=True,
            )
        ]

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the sentence, and a table for each arm, in lines of at most `width` characters."""
        lines = [folded(self.sentence, width)]
        for arm in self.fair.comparison.verdicts:
            heads = (arm, "as configured", "fair")
            lines += ["", *text_table(heads, self.rows(arm), width, prose=True)]
        return "\n".join(lines)

    __str__ = text


PROTOCOL = (
    "As configured: the study as its file has it, against learning from scratch and the learners "
    "that the file names.",
    "Fair: the learning rate of every arm, learning from scratch too, and the level at which Q "
    "starts in the target are the best of equally many trials, on seeds of their own; a trial of "
    "each arm has the file's settings. An optimistic learner, Q from the bounds of the values and "
    "Q from a constant of each arm's potential are opponents, free of charge. Arms have placebos.",
    "In both every arm spends one total of steps, the steps of its sources included. Brackets are "
    "95 % intervals over seeds.",
)
MEASURES = (
    "gain over scratch, sources free",
    "gain over scratch, sources charged",
    "best opponent",
    "gain over the best opponent, sources charged",
    "steps to threshold (scratch, best opponent)",
    "gains more than its placebos and constants",
    "verdict",
)


def _column(results: StudyResults, arm: str) -> list[str]:
    """Return the measures of an arm in one of the studies, as text."""
    comparison = results.comparison
    rows = {row["arm"]: row for row in comparison.rows()}
    rival = comparison.best_opponent(arm)
    contrast, knows = comparison.contrasts[arm], comparison.knowledge_verdicts.get(arm)

    def steps(name: str) -> str:
        missed = rows[name]["reached"] < comparison.seeds
        text = f"{rows[name]['steps_to_threshold']:,.0f}"
        return f"> {text}" if missed else text

    return [
        short(comparison.weak_gain(arm, SCRATCH)),
        short(comparison.against(SCRATCH)[arm].gain),
        rival,
        short(contrast.strong_gain),
        f"{steps(arm)} ({steps(SCRATCH)}, {steps(rival)})",
        "not asked" if knows is None else str(knows),
        contrast.answer,
    ]


def levels(task: Any, own: Sequence[float] = ()) -> dict[str, float] | None:
    """Return the range of the levels of Q that are tried; None for a task that is not solved.

    It runs from the random policy's value, or the lowest optimal value, to the highest optimal
    value, and has 0 and the levels of the file, `own`, in it.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> levels(GridWorld("S.T", discount=0.5))
    {'low': 0.0, 'high': 199.0}
    """
    if not has_tables(task):
        return None
    mdp = tables(task)
    try:
        best, start = solve(mdp), evaluate(mdp, mdp.random_policy).start_value
    except SettingError:  # without a discount values can be too large for an error bound
        return None
    values = best.action_values[~mdp.terminal]
    low, high = min(0.0, start, values.min(), *own), max(0.0, values.max(), *own)
    return {"low": float(low), "high": float(high)} if low < high else None


def as_configured(study: StudyConfig) -> StudyConfig:
    """Return the study whose opponents are those that its file names.

    Arms may learn the target with different learners here, as published comparisons do.
    """
    if study.tune or study.choose or not (study.scratch and study.compared):
        raise ConfigError(
            f"{study.file}: an audit tunes every arm itself and compares it with scratch: leave "
            "out [tune], choose, scratch = false and compared = false"
        )
    return study.varied(opponents=study.opponents or (), own_learners=True)


def as_fair(study: StudyConfig, trials: int = TRIALS) -> StudyConfig:
    """Return the study against fair opponents, to be tuned first."""
    data, first = study.to_data(), next(iter(study.curricula.values()))
    space: dict[str, Any] = {"learner": {"learning_rate": RATES}}
    learners = [arm.setting("learner", first.target) for arm in study.curricula.values()]
    own = [learner.initial_value for learner in learners if starts_anywhere(learner)]
    if range_ := levels(first.tasks[first.target], own):
        space["tasks"] = {first.target: {"learner": {"initial_value": range_}}}
    number = whole_number("trials of an audit", trials, 1, SettingError)
    tuning = {"trials": number, "space": space}
    fields = all_tuned(data["arms"], scratch_data(data, first.target), tuning)
    controls = [*dict.fromkeys((*(study.controls or ()), "placebo"))]
    fields |= {"opponents": OPPONENTS, "controls": controls, "own_learners": True}
    return study.varied(**fields)


def audit(
    study: Study,
    path: str | Path,
    *,
    trials: int = TRIALS,
    run: Callable[..., StudyResults] = run_study,
    **how: Any,
) -> Audit:
    """Run a study as configured and against fair opponents, and return both.

    Parameters
    ----------
    study : StudyConfig or path of its file
    path : path
        Folder of both studies; a run that was stopped goes on.
    trials : int
        Trials of every arm besides its own settings.
    run : callable
        Runs a study into a folder; :func:`run_study` by default.
    **how
        Further arguments of `run`, such as ``workers``.

    Raises
    ------
    ConfigError
        If the study is tuned or chosen, or not compared with scratch.
    """
    read = study_of(study)
    both = {CONFIGURED: as_configured(read), FAIR: as_fair(read, trials)}
    return Audit(
        *(run(of, str(Path(path) / name), resume=True, **how) for name, of in both.items())
    )
