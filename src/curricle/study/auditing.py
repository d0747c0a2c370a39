"""Audits: the gains of a study as configured, and what of them survives fair opponents.

As configured the opponents are learning from scratch and the learners that the file names. Fair is:
every arm, scratch and the optimistic learner too, has its best of equally many trials, one with its
own settings; all opponents play, free of charge; arms have placebos; and beside an arm plays the
informed optimist, which explores by the arm's potential. Both charge sources, and are studies in
subfolders, which go on if they were stopped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from curricle.checks import listed, whole_number
from curricle.comparison.opponents import OPPONENTS, Opponent, unasked_learners
from curricle.comparison.sentences import share_saved, short
from curricle.errors import ConfigError, SettingError
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms, scratch_data
from curricle.study.config import Study, StudyConfig, study_of
from curricle.study.results import StudyResults
from curricle.study.running import check_runnable, run_study
from curricle.study.store import remove_parts
from curricle.study.tried import tried
from curricle.study_file.vary import with_settings
from curricle.text import UNBOUNDED, folded, text_table

CONFIGURED, FAIR = "configured", "fair"  # the subfolders of an audit
HEADS = ("as configured", "fair, the same learner", "fair, the best opponent")
INFORMED = "informed optimist"
OPTIMIST: tuple[Opponent, ...] = ("optimistic",)  # which is tuned, too
TRIALS = 10  # for each setting of the arm that has most


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

    def same_learner(self, arm: str) -> str:
        """Return the arm from scratch whose learner is of an arm's class, by default scratch."""
        target, arms = self.fair.record.target, self.fair.record.arms
        kinds = {name: of.nodes[target].settings["learner"] for name, of in arms.items()}
        kinds = {name: learner.partition("(")[0] for name, learner in kinds.items()}
        tuned = (name for name in self.fair.comparison.scratches if not arms[name].control_of)
        return next((name for name in tuned if kinds[name] == kinds[arm]), SCRATCH)

    def rows(self, arm: str) -> list[tuple[str, ...]]:
        """Return the table of an arm: each measure in the three columns of ``HEADS``."""
        before, comparison = self.configured.comparison, self.fair.comparison
        played = arm in before.verdicts  # an informed optimist is not
        own = _measures(self.configured, arm, before.best_opponent(arm)) if played else {}
        rivals = self.same_learner(arm), comparison.best_opponent(arm)
        columns = [own, *(_measures(self.fair, arm, rival) for rival in rivals)]
        knows = comparison.knowledge_verdicts.get(arm)
        if knows is not None and not comparison.nobody:
            columns[2]["gains more than placebos and constants"] = str(knows)
        measures = dict.fromkeys(measure for column in columns[::-1] for measure in column)
        return [(of, *(column.get(of, "-") for column in columns)) for of in measures]

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the sentence, and a table for each arm, in lines of at most `width` characters."""
        lines = [folded(self.sentence, width)]
        for arm in self.fair.comparison.verdicts:
            lines += ["", *text_table((arm, *HEADS), self.rows(arm), width, prose=True)]
        return "\n".join(lines)

    __str__ = text


def _measures(results: StudyResults, arm: str, rival: str) -> dict[str, str]:
    """Return the measures of an arm against an opponent in one of the studies, as text."""
    comparison, tuned = results.comparison, results.record.tuned
    best = rival == comparison.best_opponent(arm)
    contrast, verdict = comparison.contrasts[arm], comparison.against(rival)[arm]
    measures = {"verdict": contrast.answer if best else verdict.against_scratch}
    if not comparison.nobody:
        times = [comparison.times(name) for name in (arm, rival)]
        steps = ["> " * (not of.reached.all()) + f"{of.steps.mean():,.0f}" for of in times]
        gain = contrast.strong_gain if best else verdict.gain
        measures |= {"opponent": rival, "gain over it": short(gain)}
        measures["gain over it, sources free"] = short(comparison.weak_gain(arm, rival))
        measures["steps until learnt: the arm; it"] = "; ".join(steps)
        measures["share of its steps saved"] = share_saved(comparison, arm, rival)
    for owner, name in (("the arm", arm), ("it", rival)):
        if tuned is not None and name in tuned.arms:
            measures[f"trials of {owner}"] = tuned.arms[name].words
    return measures


def as_configured(study: StudyConfig) -> StudyConfig:
    """Return the study whose opponents are those of its file; arms may have any learners."""
    if study.tune or study.choose or not (study.scratch and study.compared):
        raise ConfigError(
            f"{study.file}: an audit tunes every arm itself and compares it with scratch: leave "
            "out [tune], choose, scratch = false and compared = false"
        )
    return study.varied(opponents=study.opponents or (), own_learners=True)


def as_fair(study: StudyConfig, trials: int = TRIALS) -> StudyConfig:
    """Return the study against fair opponents, to be tuned first.

    Every arm has `trials` for each setting of the arm that has most, and one with its own settings.
    """
    number = whole_number("trials of an audit", trials, 1, SettingError)
    curricula = study.scratch_curricula()
    data, target = study.to_data(), curricula[SCRATCH].target
    alone, arms = scratch_data(data, target), data["arms"]
    for name, optimist in unasked_learners(OPTIMIST, {**curricula}):
        label, kind = f"{SCRATCH}, {name}", type(optimist.setting("learner", target)).__name__
        alone[label] = with_settings(alone[SCRATCH], target, learner={"type": kind})
        curricula[label] = optimist
    curricula |= study.curricula
    shaping = {"type": "QInitialisation", "portfolio": {}}
    informs: dict[str, Any] = {"learner": {"type": "QLearning"}, "shaping": shaping}
    for arm, curriculum in study.curricula.items():
        node, label = curriculum.node(target), f"{arm}, {INFORMED}"
        if node.deep or node.shaping.portfolio or not curriculum.has_potential(target):
            continue
        informed = curriculum.replace(target, learner=None, shaping=None)
        plan = with_settings(data["arms"][arm], target, **informs)
        # Not once more for an arm that differs in its target's learner alone.
        if informed.setting("shaping", target).portfolio and plan not in arms.values():
            arms, curricula = {**arms, label: plan}, {**curricula, label: informed}
    fields = tried({**alone, **arms}, curricula, number, len(study.seeds), [*alone])
    played = [name for name in OPPONENTS if name not in OPTIMIST]
    controls = [*dict.fromkeys((*(study.controls or ()), "placebo"))]
    return study.varied(**fields, opponents=played, controls=controls, own_learners=True)


def audit(
    study: Study,
    path: str | Path,
    *,
    trials: int = TRIALS,
    run: Callable[..., StudyResults] = run_study,
    **settings: Any,
) -> Audit:
    """Run a study as configured and against fair opponents into a folder; return both.

    `trials` are for each setting of the arm that has most; `run` is called with each study, its
    folder and `settings`, such as ``workers``. ConfigError if the study is tuned or chosen, or is
    not compared with scratch; other errors of either study, too, before anything is run.
    """
    read = study_of(study)
    sides = {CONFIGURED: as_configured(read), FAIR: as_fair(read, trials)}
    for side in sides.values():
        check_runnable(side)
        Arms.of(side)  # its names and controls, which its trials do not have
    folder = Path(path)
    remove_parts(folder)  # of its page
    return Audit(*(run(of, str(folder / at), resume=True, **settings) for at, of in sides.items()))
