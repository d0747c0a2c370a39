"""Trials before a study runs, which choose the settings of its arms, or its arm.

Trials are a separate study in a separate folder, which can be resumed, fail and be stale as any
study. A study with ``choose = true`` runs the trials of :func:`curricle.choose`: every round has
fewer arms and further seeds.
"""

import math
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from curricle.candidates.candidates import source_candidates
from curricle.comparison.choice import (
    FIRST_SEED,
    MOST,
    Choice,
    choose as choose_curriculum,
    chosen,
    options_of,
)
from curricle.comparison.opponents import OPPONENTS, from_scratch
from curricle.comparison.sentences import short as short_interval
from curricle.files import Place
from curricle.statistics.intervals import Interval
from curricle.study.analysis import study_record
from curricle.study.arms import Arms, units_of
from curricle.study.config import RunTable, StudyConfig, configured, of_studies
from curricle.study.record import TunedArm, TunedRecord
from curricle.study.results import StudyResults
from curricle.study.store import CHOICE, TRIALS, StudyStore, holds_study
from curricle.study_file.file import Positions, parsed, toml_text
from curricle.study_file.vary import target_alone, value_text
from curricle.text import counted

# -- The trials of a study, and the study with the best of them ------------------------------------
#
# All arms, learning from scratch too, have equally many trials on the same seeds, which are none of
# the study's seeds. The score of a trial is the measure by which arms are compared: the mean return
# over all steps, sources charged. With final seeds the best trials of each arm are played on these,
# too, and judged by all: a setting that fails in one seed of twenty shines in three.

FINALISTS = 5  # of each arm
NONE = "–"  # in tables, where there is nothing

Tried = Callable[[Arms, Sequence[int], str], StudyResults]
"""Trains some arms of trials on further seeds, under a title, and returns their results."""


def trials_of(study: StudyConfig) -> StudyConfig | None:
    """Return the study of the trials that run before a study; None if it has none."""
    return trial_study(study) if study.choose else study.trials if study.tune else None


def settled(study: StudyConfig, trials: StudyConfig, tried: Tried) -> StudyConfig:
    """Return a study with the arm, or the settings of its arms, that its trials choose."""
    arms = Arms.of(trials)
    if study.choose:
        choice = chosen(arms, lambda *part: tried(*part).comparison)
        return chosen_study(study, trials, choice.name, str(choice))
    # If they are all stored, this only completes their folder.
    results = tried(arms, trials.seeds, f"tuning: {counted(len(arms.curricula), 'trial')}")
    if study.tune and study.tune.final_seeds:
        part, seeds = finalists(study, arms, results), (*trials.seeds, *study.tune.final_seeds)
        results = tried(part, seeds, f"tuning: {counted(len(part.curricula), 'trial')} again")
    return study if study.tuned else tuned_study(study, results)


def scores_of(tune: Any, trials: StudyResults) -> dict[str, dict[str, float]]:
    """Return arm -> trial -> mean return, -inf if it is not finite; an arm's first trial first."""
    scores = dict[str, dict[str, float]]()
    for trial, returns in trials.comparison.returns.items():
        mean = float(returns.mean())
        of_arm = scores.setdefault(tune["variants"][trial]["arm"], {})
        of_arm[trial] = mean if math.isfinite(mean) else -math.inf
    return scores


def finalists(study: StudyConfig, arms: Arms, trials: StudyResults) -> Arms:
    """Return the trials of a tuning that are played again: the best of each arm, and its first."""
    tune, kept = study.data["tune"], set[str]()
    for scores in scores_of(tune, trials).values():
        kept |= {next(iter(scores)), *sorted(scores, key=lambda trial: -scores[trial])[:FINALISTS]}
    return arms.without(tune["variants"].keys() - kept)


def tuned_study(study: StudyConfig, trials: StudyResults) -> StudyConfig:
    """Return a study with the best settings of each arm, the first ones if several are best."""
    plain, arms, best = study.to_data(), dict[str, TunedArm](), dict[str, str]()
    tune = plain["tune"]
    for arm, scores in scores_of(tune, trials).items():
        best[arm] = max(scores, key=lambda trial: scores[trial])
        values, score = tune["variants"][best[arm]]["values"], scores[best[arm]]
        plain["variants"][arm]["values"] |= values
        tried = [of["values"] for of in tune["variants"].values() if of["arm"] == arm]
        arms[arm] = TunedArm(
            trials=len(tried),
            finalists=len(scores) if tune["final_seeds"] else 0,
            score=score if math.isfinite(score) else None,
            values=values,
            settings=tuple(dict.fromkeys(key for values in tried for key in values)),
        )
    fields: dict[str, Any] = {
        which: {arm: tune[which][best[arm]] for arm in plain[which]}
        for which in ("arms", "scratches")
    }
    seeds = {key: tune[key] for key in ("seeds", "final_seeds")}
    tuned = TunedRecord(**seeds, total=trials.record.total or 0, arms=arms)
    fields |= {"variants": plain["variants"], "tuned": tuned.model_dump(mode="json")}
    return study.varied(**fields, own_learners=True, tune=None)


def tuned_before(study: StudyConfig, path: Place) -> StudyConfig:
    """Return a study with its best settings if a folder has all its trials; else unchanged."""
    if study.tune is None or not holds_study(path / TRIALS):
        return study
    trials, store = study.trials, StudyStore(path / TRIALS)
    arms, done = Arms.of(trials), store.finished(without=store.damaged_units())
    if units_of(trials, arms, done):
        return study
    results = StudyResults(store, study_record(trials, arms))
    if further := study.tune.final_seeds:
        arms = finalists(study, arms, results)
        trials = trials.varied(seeds=[*trials.seeds, *further])
        if units_of(trials, arms, done):
            return study
        results = StudyResults(store, study_record(trials, arms))
    return tuned_study(study, results)


def settled_before(study: StudyConfig, path: Place) -> StudyConfig:
    """Return a study with the arm, or the settings, that the trials of a finished folder chose."""
    if not study.choose:
        return tuned_before(study, path)
    record = StudyResults(path).record
    if not record.chosen:
        return study
    curricula = (name for name, arm in record.arms.items() if not (arm.scratch or arm.control_of))
    name = next(curricula, NO_CURRICULUM)  # which is scratch under another name
    return chosen_study(study, trial_study(study), name, record.chosen)


def tuning_words(store: StudyStore) -> str:
    """Return a sentence on the progress of a folder's trials; empty if there are none to run."""
    configuration = store.description.get("configuration")
    if not isinstance(configuration, dict) or not {"tune", "choose"} & configuration.keys():
        return ""
    if "choose" in configuration:
        return f"its arm is chosen first: its trials are in {store.path / CHOICE}"
    if not holds_study(store.path / TRIALS):
        return "it is tuned first: no trial has begun"
    trials = StudyResults(store.path / TRIALS)
    seeds, target = {*trials.record.seeds}, trials.record.target
    keys = [trials.record.keys[arm, target] for arm in trials.record.arms]
    done = sum(seeds <= trials.stored.get(key, {}).keys() for key in keys)
    number = counted(len(keys), "trial")
    return f"it is tuned first: {done} of {number} are stored; its seeds come after them"


# -- The result of a sweep: the mean return with each value of a setting ---------------------------


class Level(NamedTuple):
    """The mean return of an arm with a value of a setting, averaged over all other settings."""

    arm: str
    key: str  # the setting's key in the study's file
    text: str  # the value as text
    number: int  # the number of arms
    mean: Interval


def effects_of(results: StudyResults) -> list[Level]:
    """Return the main effects of a sweep: for each setting, arm and value the mean over arms."""
    comparison, tuned = results.comparison, results.record.tuned
    returns = dict[tuple[str, str, str], list[Any]]()
    for name, variant in results.record.variants.items():
        if name in comparison.arms:
            chosen = tuned.arms[name].values if tuned else {}
            for key in [key for key in variant.values if key not in chosen]:
                place = key, variant.arm, value_text(variant.values[key])
                returns.setdefault(place, []).append(comparison.returns[name])
    ranks = [{place[part]: None for place in returns} for part in range(3)]
    places = [place for place in product(*ranks) if place in returns]
    levels = list[Level]()
    for place in places:
        (key, of, text), all_arms = place, returns[place]
        mean = comparison.interval(np.mean(all_arms, axis=0))
        levels.append(Level(of, key, text, len(all_arms), mean))
    return levels


EFFECT_HEADS = ("arm", "setting", "value", "arms", "mean return", "")


def effects_rows(effects: Sequence[Level]) -> list[tuple[str, ...]]:
    """Return the rows of the table of a sweep; without an interval for a single seed."""
    return [
        (arm, key, text, f"{number}", *mean_and_bounds.partition(" ")[::2])
        for arm, key, text, number, mean in effects
        for mean_and_bounds in [short_interval(mean)]
    ]


def tuning_rows(tuned: TunedRecord) -> list[tuple[str, ...]]:
    """Return the heads and the rows of the table of the best trials."""
    keys = dict.fromkeys(key for arm in tuned.arms.values() for key in arm.values)
    rows = [("best of", "trials", "tuning steps", "mean return", *keys)]
    for name, arm in tuned.arms.items():
        spent = f"{arm.trials}", f"{tuned.steps(name):,}"
        rows.append((name, *spent, *map(short, (arm.score, *map(arm.values.get, keys)))))
    return rows


def short(value: object) -> str:
    """Return a value that was tried: numbers in three significant digits, or as whole ones."""
    if value is None:
        return NONE
    if isinstance(value, int | float) and not isinstance(value, bool):
        whole = isinstance(value, int) or abs(value) >= 1000
        return f"{value:,.0f}" if whole else f"{value:.3g}"
    return value_text(value)


# -- the choice of an arm --------------------------------------------------------------------------

NO_CURRICULUM = "no curriculum"  # the arm of a study in which no curriculum pays
OF_BOTH = ("learner", "evaluation", "storage")  # settings that sources take from the target


def trial_study(study: StudyConfig) -> StudyConfig:
    """Return the study of the arms to choose from: the study's arms, and arms of candidates."""
    arms = study.to_data()["arms"]
    first = next(iter(arms))
    curriculum, alone = study.curricula[first], target_alone(arms[first])
    target, (*_, data) = curriculum.target, alone["tasks"].values()
    candidates = source_candidates(study.address(first, target), most=MOST)
    informed = (name for name, arm in study.curricula.items() if arm.has_potential(target))
    trials = {name: arms[name] for name in informed}
    shared: dict[str, Any] = {key: data[key] for key in OF_BOTH if key in data}
    if "storage" in shared:  # a source must save its values, even if the target does not
        shared["storage"] = {**shared["storage"], "kind": "auto", "save_values": True}
    default = from_scratch(curriculum).setting("shaping", target)
    for option in options_of(candidates.candidates, curriculum.node(target).most_steps):
        if option.portfolio and default.portfolio is None:
            continue
        name = option.candidate.name
        source = {"type": "candidate", "of": target, "kind": option.candidate.kind, **shared}
        source |= {"candidate": name, "budget": {"max_steps": option.steps}}
        way = {"portfolio": True} if option.portfolio else {}
        into = {**data, "aggregate": "minimum", "shaping": {"type": "QInitialisation", **way}}
        edge = {"source": name, "target": target, "mapping": "candidate", "scale": option.scale}
        tasks = {**alone["tasks"], target: into, name: source}
        trials[option.name] = {"tasks": tasks, "transfers": [edge]}
    plain: dict[str, Any] = {"choose": None, "controls": None, "scratch_learners": {}}
    first = [FIRST_SEED]  # each round of trials adds its seeds
    return study.varied(arms=trials, opponents=OPPONENTS, snapshots=0, seeds=first, **plain)


def chosen_study(study: StudyConfig, trials: StudyConfig, name: str, words: str) -> StudyConfig:
    """Return a study whose only arm is the chosen curriculum; without sources if none pays."""
    if name not in ("", NO_CURRICULUM):
        arms = {name: trials.to_data()["arms"][name]}
        return study.varied(arms=arms, choose=None, chosen=words)
    alone = target_alone(next(iter(study.to_data()["arms"].values())))
    return study.varied(arms={NO_CURRICULUM: alone}, choose=None, controls=None, chosen=words)


def chosen_file(study: StudyConfig, choice: Choice, folder: Path) -> str:
    """Return the text of a study file with the chosen arm, for a file in `folder`."""
    data = chosen_study(study, trial_study(study), choice.name, str(choice)).to_data()
    (arm,) = data["arms"].values()
    defaults = RunTable.model_validate({"name": study.name}).model_dump(mode="json")
    run = {key: data[key] for key in defaults if key in data and data[key] != defaults[key]}
    remark = "".join(f"# {line}\n" for line in str(choice).splitlines())
    text = remark + toml_text({**run, "name": f"{study.name}, chosen", **arm})
    configured(parsed(text), folder, Positions("the chosen study", text))
    return text


def _choosable(study: StudyConfig) -> tuple[Any, dict[str, Any]]:
    curricula = trial_study(study).curricula
    first = next(iter(curricula.values()))
    return first.tasks[first.target], {"candidates": curricula, "kinds": ()}


choose: Callable[..., Choice] = of_studies(cast(Any, choose_curriculum), _choosable)
