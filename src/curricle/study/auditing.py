"""Audits: the gains of a study as configured, and what of them survives fair opponents.

As configured the opponents are learning from scratch and the learners that the file names. Fair is:
the learning rate of every arm, scratch too, and the level at which Q starts in the target are the
best of equally many trials, one with the file's settings; all opponents play, free of charge; arms
have placebos. Both charge sources, and are studies in subfolders, which go on if they were stopped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from curricle.checks import listed, whole_number
from curricle.comparison.opponents import OPPONENTS, starts_anywhere
from curricle.comparison.sentences import short
from curricle.errors import ConfigError, SettingError
from curricle.planning.solution import evaluate, solve
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import scratch_data
from curricle.study.config import Study, StudyConfig, study_of
from curricle.study.results import StudyResults
from curricle.study.running import check_runnable, run_study
from curricle.study.store import remove_parts
from curricle.study_file.vary import all_tuned
from curricle.tasks.mdp import has_tables, tables
from curricle.text import UNBOUNDED, folded, text_table

CONFIGURED, FAIR = "configured", "fair"  # the subfolders of an audit
RATES = {"low": 0.02, "high": 1.0, "log": True}  # learning rates that are tried
TRIALS = 20  # of every arm, besides its own settings


@dataclass(frozen=True, eq=False)
class Audit:
    """The results of a study as configured, and of the same study against fair opponents."""

    configured: StudyResults
    fair: StudyResults

    @property
    def sentence(self) -> str:
        """What survives, in one sentence."""
        sides = self.configured.comparison, self.fair.comparison
        for side in sides:
            if side.withheld and not side.nobody:
                return f"Nothing is shown: {side.withheld}."
        pay, still = (
            [name for name, verdict in side.verdicts.items() if verdict.direction > 0]
            for side in sides
        )
        knows = [name for name in still if sides[1].reasons[name].why in ("knowledge", "mapping")]
        said = "Shown to pay as configured: {}; against fair opponents: {}; by what it knows: {}."
        none = [side.nobody or "none" for side in (*sides, sides[1])]
        names = zip((pay, still, knows), none, strict=True)
        return said.format(*(listed(arms) or nothing for arms, nothing in names))

    def rows(self, arm: str) -> list[tuple[str, str, str]]:
        """Return the table of an arm: each measure as configured, and fair."""
        before, after = (_measures(side, arm) for side in (self.configured, self.fair))
        return [(measure, text, after[measure]) for measure, text in before.items()]

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the sentence, and a table for each arm, in lines of at most `width` characters."""
        lines = [folded(self.sentence, width)]
        for arm in self.fair.comparison.verdicts:
            lines += [
                "",
                *text_table((arm, "as configured", "fair"), self.rows(arm), width, prose=True),
            ]
        return "\n".join(lines)

    __str__ = text


def _measures(results: StudyResults, arm: str) -> dict[str, str]:
    """Return the measures of an arm in one of the studies, as text."""
    comparison = results.comparison
    rival, contrast = comparison.best_opponent(arm), comparison.contrasts[arm]
    knows = comparison.knowledge_verdicts.get(arm)
    times = [comparison.times(name) for name in (arm, SCRATCH, rival)]
    steps = ["> " * (not of.reached.all()) + f"{of.steps.mean():,.0f}" for of in times]
    measures = {
        "gain over scratch, sources free": short(comparison.weak_gain(arm, SCRATCH)),
        "gain over scratch": short(comparison.against(SCRATCH)[arm].gain),
        "best opponent": str(rival),
        "gain over the best opponent": short(contrast.strong_gain),
        "steps until learnt: it, scratch, the best opponent": "; ".join(steps),
        "gains more than placebos and constants": "not asked" if knows is None else str(knows),
    }
    shown = dict.fromkeys(measures, "-") if comparison.nobody else measures
    return {**shown, "verdict": contrast.answer}


def levels(task: object, stated: Sequence[float] = ()) -> dict[str, float] | None:
    """Return the range of the levels of Q that are tried; None for a task that is not solved."""
    # From the random policy's value, or the lowest optimal value, to the highest optimal value; 0
    # and the levels that the file states are in it.
    if not has_tables(task):
        return None
    mdp = tables(task)
    try:
        best, start = solve(mdp), evaluate(mdp, mdp.random_policy).start_value
    except SettingError:  # without a discount values can be too large for an error bound
        return None
    values = best.action_values[~mdp.terminal]
    low, high = min(0.0, start, values.min(), *stated), max(0.0, values.max(), *stated)
    return {"low": float(low), "high": float(high)} if low < high else None


def as_configured(study: StudyConfig) -> StudyConfig:
    """Return the study whose opponents are those of its file; arms may have any learners."""
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
    stated = [learner.initial_value for learner in learners if starts_anywhere(learner)]
    if range_ := levels(first.tasks[first.target], stated):
        space["tasks"] = {first.target: {"learner": {"initial_value": range_}}}
    number = whole_number("trials of an audit", trials, 1, SettingError)
    tuning = {"trials": number, "space": space}
    fields = all_tuned(data["arms"], scratch_data(data, first.target), tuning)
    controls = [*dict.fromkeys((*(study.controls or ()), "placebo"))]
    return study.varied(**fields, opponents=OPPONENTS, controls=controls, own_learners=True)


def audit(
    study: Study,
    path: str | Path,
    *,
    trials: int = TRIALS,
    run: Callable[..., StudyResults] = run_study,
    **settings: Any,
) -> Audit:
    """Run a study as configured and against fair opponents into a folder; return both.

    `trials` are of every arm, besides its own settings; `run` is called with each study, its
    folder and `settings`, such as ``workers``. ConfigError if the study is tuned or chosen, or is
    not compared with scratch.
    """
    read = study_of(study)
    sides = {CONFIGURED: as_configured(read), FAIR: as_fair(read, trials)}
    for side in sides.values():  # both, before the first runs
        check_runnable(side)
    folder = Path(path)
    remove_parts(folder)  # of its page
    return Audit(*(run(of, str(folder / at), resume=True, **settings) for at, of in sides.items()))
