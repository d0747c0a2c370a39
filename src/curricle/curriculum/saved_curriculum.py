"""What training a curriculum gave, as the arrays and words of a file, and back again.

Potentials are not stored: they follow from the sources' values, as they did in training.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from curricle.archives.saved_file import SavedFile
from curricle.curriculum.retraining import RetrainedResult
from curricle.curriculum.sources import Progress, SourceValues
from curricle.curriculum.stored_sources import StoredValues, source_values
from curricle.deep.result import DeepResult
from curricle.errors import CurriculumError, SettingError
from curricle.frozen_arrays import frozen
from curricle.learning.record import WarmUp
from curricle.learning.result import LearningResult
from curricle.learning.saved_result import (
    all_values_of,
    arrays_of_values,
    as_saved,
    check_value_arrays,
    pairs_of,
    task_record,
)
from curricle.learning.stopping import Decision, StoppingKernel, StoppingRule
from curricle.transfer.calibration import AnyPotential, Calibration
from curricle.transfer.scale_fit import ScaleEvidence

Arrays = dict[str, npt.NDArray[Any]]
Read = TypeVar("Read")
KINDS: dict[str, type[LearningResult]] = {
    kind.__name__: kind for kind in (LearningResult, DeepResult)
}
SCALARS = tuple(
    one.name for one in fields(Calibration) if one.name not in ("potential", "warm_up", "evidence")
)


class Parts(NamedTuple):
    """The fields of a :class:`CurriculumResult`, besides its curriculum."""

    nodes: Mapping[str, LearningResult]
    potentials: Mapping[str, list[AnyPotential]]
    calibrations: Mapping[str, list[Calibration]]
    retrained: Mapping[str, RetrainedResult]
    given: Mapping[str, SourceValues]


def to_file(curriculum: Any, parts: Parts) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays and the words of a file; arrays are named ``part/number/name``."""
    arrays = Arrays()

    def put(part: str, names: Mapping[str, Any], of: Callable[[Any], Arrays]) -> None:
        for i, one in enumerate(names.values()):
            arrays.update({f"{part}/{i}/{name}": array for name, array in of(one).items()})

    nodes = {name: one.parts_of_file() for name, one in parts.nodes.items()}
    put("nodes", nodes, lambda one: one[0])
    put("given", parts.given, _arrays_given)
    put("retrained", parts.retrained, lambda one: {"extra": one.extra})
    put("calibrations", parts.calibrations, _arrays_calibrated)
    words = {
        "tasks": {name: task_record(task) for name, task in curriculum.tasks.items()},
        "nodes": {name: {"kind": type(parts.nodes[name]).__name__, **about}
                  for name, (_, about) in nodes.items()},
        "trained": list(parts.potentials),
        "given": {name: one.own_rewards for name, one in parts.given.items()},
        "retrained": {
            name: [[_plain(one) for one in each] for each in retrained.decisions]
            for name, retrained in parts.retrained.items()
        },
        "calibrations": {
            name: [_words_calibrated(one) for one in each]
            for name, each in parts.calibrations.items()
        },
    }  # fmt: skip
    return arrays, words


def from_file(saved: SavedFile, curriculum: Any) -> Parts:
    """Return what :func:`to_file` was called on; its potentials are computed again.

    Raises
    ------
    CurriculumError
        When the curriculum is none or has other tasks.
    SettingError
        When a task has other states or actions, or a network other parameters.
    StoreError
        When the file is not as :func:`to_file` writes it.
    """
    if not (hasattr(curriculum, "tasks") and hasattr(curriculum, "in_edges")):
        raise CurriculumError(
            f"a result is loaded with the Curriculum that was trained: got {curriculum!r}"
        )
    with as_saved(saved):
        return _from_words(saved, saved.about, curriculum)


def _from_words(saved: SavedFile, words: Mapping[str, Any], curriculum: Any) -> Parts:
    if (stored := {*words["tasks"]}) != {*curriculum.tasks}:
        raise CurriculumError(
            f"a result must be loaded with its own curriculum: {saved.path} has the tasks "
            f"{', '.join(sorted(stored))}, the curriculum {', '.join(sorted(curriculum.tasks))}"
        )

    def read(part: str, of: Callable[[str, Arrays, Any], Read]) -> dict[str, Read]:
        found = {}
        for i, (name, about) in enumerate(words[part].items()):
            own, arrays = f"{part}/{i}/", saved.arrays
            mine = {key.removeprefix(own): one for key, one in arrays.items() if
                    key.startswith(own)}  # fmt: skip
            found[name] = of(name, mine, about)
        return found

    def node(name: str, arrays: Arrays, about: Any) -> LearningResult:
        kind, task = KINDS[about["kind"]], curriculum.tasks[name]
        found = kind.of_file(saved, arrays, about, task)
        learner = found.learner or curriculum.setting("learner", name)
        return replace(found, learner=learner)

    def source(name: str, arrays: Arrays, own_rewards: bool) -> SourceValues:
        task, seeds = curriculum.tasks[name], tuple(arrays["seeds"].tolist())
        check_value_arrays(arrays, len(seeds), pairs_of(saved, words["tasks"][name], task))
        values, progress = all_values_of(arrays, len(seeds)), None
        if "progress_steps" in arrays:
            progress = Progress(frozen(arrays["progress_steps"]), _visits(arrays))
        return SourceValues(
            task, seeds, values, frozen(arrays["steps_used"]), bool(own_rewards), progress
        )

    nodes, given = read("nodes", node), read("given", source)
    retrained = read(
        "retrained",
        lambda name, arrays, about: RetrainedResult(
            nodes[name],
            frozen(arrays["extra"]),
            [[_decision(one) for one in each] for each in about],
        ),
    )
    fitted = read("calibrations", _calibrations)
    nodes, given = _with_networks(curriculum, nodes, given, fitted)
    extra = {name: one.extra for name, one in retrained.items()}
    sources = {name: SourceValues.of(one, extra.get(name, 0)) for name, one in nodes.items()}
    sources |= given
    potentials = {name: curriculum.potentials(name, sources) for name in words["trained"]}
    calibrations = {}
    for name, each in fitted.items():
        pairs = zip(each, potentials[name], strict=True)
        calibrations[name] = [_calibrated(one, phi) for one, phi in pairs]
        potentials[name] = [one.potential for one in calibrations[name]]
    return Parts(nodes, potentials, calibrations, retrained, given)


# -- sources trained before ----------------------------------------------------------------------


def _arrays_given(one: SourceValues) -> Arrays:
    found = {"seeds": np.array(one.seeds, dtype=np.int64), "steps_used": one.steps_used}
    found |= arrays_of_values(one.values)
    if one.progress is not None:
        found["progress_steps"] = one.progress.steps
        if one.progress.visits is not None:
            found["visits"] = one.progress.visits
    return found


def _visits(arrays: Arrays) -> Any:
    return frozen(arrays["visits"]) if "visits" in arrays else None


def _with_networks(
    curriculum: Any,
    nodes: dict[str, LearningResult],
    given: dict[str, SourceValues],
    fitted: Mapping[str, list[Calibration]],
) -> tuple[dict[str, LearningResult], dict[str, SourceValues]]:
    """Return the same with networks built from their parameters, sources first."""
    learnt: dict[str, Any] = {**given, **nodes}
    if not any(curriculum.node(name).deep for name in learnt):
        return nodes, given
    stored = {
        name: StoredValues(
            one.values, one.steps_used, [(c.scale, c.shift) for c in fitted.get(name, ())]
        )
        for name, one in learnt.items()
    }
    seeds = next(iter(learnt.values())).seeds
    try:
        built = source_values(curriculum, seeds, stored)
    except RuntimeError as error:  # of PyTorch
        raise SettingError(
            "networks must be loaded with the learners they were trained with: "
            f"{' '.join(str(error).split())}"
        ) from None
    for name, one in built.items():
        if name in nodes:
            nodes[name] = replace(nodes[name], values=one.values)
        if name in given:
            given[name] = replace(given[name], values=one.values)
    return nodes, given


# -- calibrations and decisions ------------------------------------------------------------------


def _arrays_calibrated(each: list[Calibration]) -> Arrays:
    found = Arrays()
    for k, one in enumerate(each):
        found |= {f"lengths_{k}": one.warm_up.lengths, f"returns_{k}": one.warm_up.returns}
    return found


def _words_calibrated(one: Calibration) -> dict[str, Any]:
    evidence = None if one.evidence is None else list(one.evidence)
    return {**{name: getattr(one, name) for name in SCALARS}, "evidence": evidence}


def _calibrations(_: str, arrays: Arrays, about: Any) -> list[Calibration]:
    """Return calibrations whose potentials are not there yet."""
    found = []
    for k, one in enumerate(about):
        warm_up = WarmUp(frozen(arrays[f"lengths_{k}"]), frozen(arrays[f"returns_{k}"]))
        evidence = None if one["evidence"] is None else ScaleEvidence(*one["evidence"])
        scalars = {name: one[name] for name in SCALARS}
        found.append(Calibration(None, warm_up=warm_up, evidence=evidence, **scalars))
    return found


def _calibrated(one: Calibration, potential: AnyPotential) -> Calibration:
    phi = potential if one.refusal else potential.rescaled(one.scale, one.shift)
    return replace(one, potential=phi)


def _plain(one: Decision) -> dict[str, Any]:
    return {**asdict(one), "kernel": list(one.kernel)}


def _decision(about: Mapping[str, Any]) -> Decision:
    rule, kernel = StoppingRule(**about["rule"]), StoppingKernel(*about["kernel"])
    return Decision(**{**about, "rule": rule, "kernel": kernel})
