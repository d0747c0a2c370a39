"""Choosing the arm of a study: its trials as a study, the chosen study, and that as a file.

The trials of a study with ``choose = true`` are those of :func:`curricle.choose`, as a study in a
folder of its own: its rounds have fewer arms and further seeds.
"""

from collections.abc import Callable
from typing import Any, cast

from curricle.comparison.opponents import OPPONENTS
from curricle.design.candidates import source_candidates
from curricle.design.choice import MOST, Choice, choose as choose_curriculum, options_of
from curricle.study.config import RunTable, StudyConfig, configured, of_studies
from curricle.study_file.file import Positions, parsed, toml_text
from curricle.study_file.vary import target_alone

NO_CURRICULUM = "no curriculum"  # the arm of a study in which none pays
OF_BOTH = ("learner", "evaluation", "storage")  # settings that sources have as the target has them


def trial_study(study: StudyConfig) -> StudyConfig:
    """Return the study whose arms are those to choose from: the study's, and of candidates."""
    arms = study.to_data()["arms"]
    first = next(iter(arms))
    curriculum, alone = study.curricula[first], target_alone(arms[first])
    target, (*_, data) = curriculum.target, alone["tasks"].values()
    found = source_candidates(study.address(first, target), most=MOST)
    trials = {name: arm for name, arm in arms.items() if arm["transfers"]}
    shared: dict[str, Any] = {key: data[key] for key in OF_BOTH if key in data}
    if "storage" in shared:  # a source's values are read, whatever is kept of the target's
        shared["storage"] = {**shared["storage"], "kind": "auto", "save_values": True}
    for option in options_of(found.candidates, curriculum.node(target).most_steps):
        name = option.candidate.name
        source = {"type": "candidate", "of": target, "kind": option.candidate.kind, **shared}
        source |= {"candidate": name, "budget": {"max_steps": option.steps}}
        into = {**data, "aggregate": "minimum", "shaping": {"type": "QInitialisation"}}
        edge = {"source": name, "target": target, "mapping": "candidate", "scale": option.scale}
        tasks = {**alone["tasks"], target: into, name: source}
        trials[option.name] = {"tasks": tasks, "transfers": [edge]}
    plain: dict[str, Any] = {"choose": None, "controls": None, "scratch_learners": {}}
    return study.varied(arms=trials, opponents=OPPONENTS, snapshots=0, **plain)


def chosen_study(study: StudyConfig, trials: StudyConfig, choice: Choice) -> StudyConfig:
    """Return a study with the chosen curriculum as its only arm; without sources if none pays."""
    if choice.name:
        arms = {choice.name: trials.to_data()["arms"][choice.name]}
        return study.varied(arms=arms, choose=None, chosen=str(choice))
    alone = target_alone(next(iter(study.to_data()["arms"].values())))
    return study.varied(arms={NO_CURRICULUM: alone}, choose=None, controls=None, chosen=str(choice))


def chosen_file(study: StudyConfig, choice: Choice, folder: Any) -> str:
    """Return a study with its chosen arm as the text of a file in a folder."""
    data = chosen_study(study, trial_study(study), choice).to_data()
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
