"""Choosing the arm of a study: trials in its folder, their record, and the study that they choose.

A study with ``choose = true`` is played as :func:`curricle.choose` plays its target, with units
that are stored; so it is resumed, and its choice does not depend on workers. What a tuning and a
choice have in common is called a search here: it comes before a study's own seeds.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from curricle.comparison.comparison import Arm
from curricle.comparison.opponents import Opponent
from curricle.comparison.plan import Plan
from curricle.design.candidates import source_candidates
from curricle.design.choice import (
    FIRST_SEED,
    MOST,
    Choice,
    affordable,
    choose as choose_curriculum,
    chosen,
    left_out,
    options_of,
)
from curricle.errors import SettingError
from curricle.study.arms import Arms
from curricle.study.config import RunTable, StudyConfig, configured, of_studies
from curricle.study.dependencies import key_of, settings_key_of
from curricle.study.record import Plain
from curricle.study.store import StudyStore
from curricle.study.tuning import (
    TUNING,
    Choose,
    Train,
    TuningRecord,
    digest_of,
    read_tuning,
    trained_arm,
    tuned_study,
)
from curricle.study_file.file import Positions, line_numbers, parsed, toml_text
from curricle.study_file.vary import target_alone

NO_CURRICULUM = "no curriculum"  # the arm of a study in which none pays
OF_BOTH = ("learner", "evaluation", "storage")  # settings that sources have as the target has them


class ChoiceRecord(Plain):
    """A choice that is complete."""

    of: str  # a digest of its dependencies; empty if stale trials were kept
    of_settings: str  # a digest of that but for code and Curricle's version
    name: str  # of the chosen curriculum; empty if none pays
    text: str  # what the choice prints


def trial_arms(study: StudyConfig) -> dict[str, Any]:
    """Return the arms to choose from by name, as plain data: the study's, and of candidates."""
    arms = study.to_data()["arms"]
    first = next(iter(arms))
    curriculum, alone = study.curricula[first], target_alone(arms[first])
    target, (*_, data) = curriculum.target, alone["tasks"].values()
    budget = curriculum.setting("budget", target)
    if not isinstance(budget, int):
        raise SettingError(f"an arm is chosen at a budget in steps: {target!r} has {budget}")
    found = source_candidates(study.address(first, target), most=MOST)
    trials = {name: arm for name, arm in arms.items() if arm["transfers"]}
    shared: dict[str, Any] = {key: data[key] for key in OF_BOTH if key in data}
    for option in options_of(found.candidates, budget):
        name = option.candidate.name
        source = {"type": "candidate", "of": target, "kind": option.candidate.kind, **shared}
        source |= {"candidate": name, "budget": {"max_steps": option.steps}}
        into = {**data, "aggregate": "minimum", "shaping": {"type": "QInitialisation"}}
        edge = {"source": name, "target": target, "mapping": "candidate", "scale": option.scale}
        tasks = {**alone["tasks"], target: into, name: source}
        trials[option.name] = {"tasks": tasks, "transfers": [edge]}
    return trials


def trial_study(study: StudyConfig, arms: Mapping[str, Any], **fields: Any) -> StudyConfig:
    """Return the study of some of the arms to choose from."""
    plain: dict[str, Any] = {"choose": None, "controls": None, "scratch_learners": {}}
    return study.varied(arms=dict(arms), snapshots=0, **plain, **fields)


def choose_arm(study: StudyConfig, train: Train, choose: Choose = key_of) -> ChoiceRecord:
    """Choose the arm of a study and return the record, which depends on the study alone."""
    if max(study.seeds) >= FIRST_SEED:
        raise SettingError(f"a study that chooses must have seeds below {FIRST_SEED:,}")
    arms = trial_arms(study)
    whole = trial_study(study, arms)
    names = affordable(whole.curricula)
    total = Arms.of(trial_study(study, {name: arms[name] for name in names})).total
    stale = False

    def play(
        names: Sequence[str], seeds: tuple[int, ...], opponents: Sequence[Opponent], title: str
    ) -> tuple[Plan, dict[str, Arm]]:
        nonlocal stale
        some = {name: arms[name] for name in names}
        fields: Any = {"seeds": list(seeds), "opponents": list(opponents), "total": total}
        config = trial_study(study, some, **fields)
        plan = Arms.of(config, choose)
        stale |= any(key != key_of(plan.dependencies[place]) for place, key in plan.keys.items())
        store = train(config, plan, f"choosing: {title}")
        stored = store.finished()
        return plan, {name: trained_arm(plan, name, store, stored, seeds) for name in plan.arms}

    choice = chosen({name: whole.curricula[name] for name in names}, play)
    choice = replace(choice, remarks=tuple(left_out(names, whole.curricula)))
    digests = {"of": "" if stale else digest_of(study)}
    digests["of_settings"] = digest_of(study, settings_key_of)
    return ChoiceRecord(name=choice.name, text=str(choice), **digests)


def chosen_study(study: StudyConfig, name: str) -> StudyConfig:
    """Return a study with the chosen curriculum as its only arm; without sources if none pays."""
    if name:
        return study.varied(arms={name: trial_arms(study)[name]}, choose=None)
    alone = target_alone(next(iter(study.to_data()["arms"].values())))
    return study.varied(arms={NO_CURRICULUM: alone}, choose=None, controls=None)


# -- A search: a tuning or a choice, before a study's own seeds ------------------------------------

CHOICE = "choice.json"
RECORDS = {TuningRecord: TUNING, ChoiceRecord: CHOICE}  # kind -> its file
Search = TuningRecord | ChoiceRecord


def read_choice(store: StudyStore) -> ChoiceRecord | None:
    """Return the choice of a study's folder; None if there is none or it has not ended."""
    return store.record(CHOICE, ChoiceRecord) if store.has(CHOICE) else None


def read_search(study: StudyConfig, store: StudyStore) -> Search | None:
    """Return the ended search of a study in its folder, if there is one."""
    return read_choice(store) if study.choose else read_tuning(store)


def searched_study(study: StudyConfig, record: Search) -> StudyConfig:
    """Return a study with its best settings, or its chosen arm."""
    if isinstance(record, TuningRecord):
        return tuned_study(study, record)
    return chosen_study(study, record.name)


# -- Choosing in memory, and the chosen study as a file --------------------------------------------


def chosen_file(study: StudyConfig, choice: Choice, folder: Any) -> str:
    """Return a study with its chosen arm as the text of a file in a folder."""
    data = chosen_study(study, choice.name).to_data()
    (arm,) = data["arms"].values()
    defaults = RunTable.model_validate({"name": study.name}).model_dump(mode="json")
    run = {key: data[key] for key in defaults if key in data and data[key] != defaults[key]}
    remark = "".join(f"# {line}\n" for line in str(choice).splitlines())
    text = remark + toml_text({**run, "name": f"{study.name}, chosen", **arm})
    configured(parsed(text), folder, Positions("the chosen study", line_numbers(text)))
    return text


def _choosable(study: StudyConfig) -> tuple[Any, dict[str, Any]]:
    curricula = trial_study(study, trial_arms(study)).curricula
    first = next(iter(curricula.values()))
    return first.tasks[first.target], {"candidates": curricula, "kinds": ()}


_of_task: Any = choose_curriculum  # its first parameter may be passed by name, too
choose: Callable[..., Choice] = of_studies(_of_task, _choosable)
