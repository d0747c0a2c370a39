"""A study's arms as they are trained: with one total of steps, learning from scratch first."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from curricle.comparison.comparing import check_comparable, most_source_steps
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import ConfigError, SettingError
from curricle.statistics.curves import SCRATCH
from curricle.study.config import StudyConfig
from curricle.study.dependencies import Dependencies, dependencies_of, key_of
from curricle.study.vary import target_alone
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task


@dataclass(frozen=True, eq=False)
class Arms:
    """What a study trains."""

    curricula: Mapping[str, Curriculum]
    """The budget of their target is the total, if there is one."""
    target: str
    """The task that all arms end with."""
    budget: int | None
    """Steps of the target, without those of sources; None where arms are not compared."""
    total: int | None
    """Steps that every arm spends, sources included."""
    eval_freq: int
    """Steps between checkpoints of the target."""
    keys: Mapping[tuple[str, str], str]
    """For each arm and task a short hash of all that its result depends on, except the seed: arms
    that share a source train it once."""
    dependencies: Mapping[tuple[str, str], Dependencies]
    """All that: settings, sources, Curricle's version, and digests of the user's own modules and of
    the mappings that were found."""
    scratches: tuple[str, ...]
    """The arms that learn the target from scratch."""

    @property
    def live(self) -> bool:
        """Whether a task runs in Python, one thread at a time.

        This includes tasks seen through observations: their learners draw from random generators of
        the process.
        """
        tasks = [task for one in self.curricula.values() for task in one.tasks.values()]
        return any(is_live(task) or is_observation_task(task) for task in tasks)

    @property
    def code(self) -> dict[str, str]:
        """The digest of each own module, by file, and found mapping, that any arm uses."""
        each = [depends["code"] for depends in self.dependencies.values()]
        return {file: code[file] for code in each for file in code}

    @classmethod
    def of(cls, study: StudyConfig, choose: Callable[[Dependencies], str] = key_of) -> "Arms":
        """Return a study's arms; SettingError or CurriculumError if they are not comparable.

        `choose` gives what depends on something its key.
        """
        given = study.curricula
        scratches = study.scratch_curricula() if study.scratch else {}
        learners = [one.setting("learner", one.target) for one in scratches.values()]
        check_comparable(given, None if study.own_learners else learners)
        first = next(iter(given.values()))
        target = first.target
        node = first.node(target)
        budget, total = None, None
        if isinstance(node.budget, int):
            budget = node.budget
            most = max(most_source_steps(arm) for arm in given.values())
            total = max(-(-(budget + most) // node.eval_freq) * node.eval_freq, study.total or 0)
        elif len(given) + study.scratch > 1:
            raise SettingError(
                f"arms are compared at one total of steps: the budget of {target!r} is "
                f"{node.budget}; give it in steps, or run one arm with scratch = false"
            )
        given = {**scratches, **given}
        if total is not None:
            given = {
                name: arm.replace(target, budget=total, eval_freq=node.eval_freq)
                for name, arm in given.items()
            }
        plain = study.to_data()
        data = {**_scratch_data(plain, target), **plain["arms"]}
        keys: dict[tuple[str, str], str] = {}
        dependencies: dict[tuple[str, str], Dependencies] = {}
        for arm, curriculum in given.items():
            found = dependencies_of(data[arm], curriculum, total, study.folder, choose)
            for name, key, depends in found:
                keys[arm, name], dependencies[arm, name] = key, depends
        named = tuple(scratches)
        return cls(given, target, budget, total, node.eval_freq, keys, dependencies, named)


def _scratch_data(study: dict[str, Any], target: str) -> dict[str, Any]:
    """Return the arms that learn the target from scratch, as data.

    They are those of the study, or else follow from its first arm.
    """
    given = study.get("scratches")
    if given is None:
        own = target_alone(next(iter(study["arms"].values())))
        task = own["tasks"][target]
        given = {SCRATCH: own}
        for name, learner in study["scratch_learners"].items():
            tasks = {**own["tasks"], target: {**task, "learner": learner}}
            given[f"{SCRATCH}, {name}"] = {**own, "tasks": tasks}
    return {name: target_alone(one) for name, one in given.items()}


@lru_cache(maxsize=4)
def arms_from_json(config: str, folder: str, code: str) -> Arms:
    """Return the arms of the study that a JSON text describes; cached, as many units ask.

    ConfigError when the user's own modules, or the mappings that are found, are not or no longer
    those of `code`, the JSON of ``Arms.code``.
    """
    # Who began the run has printed what is found.
    study = StudyConfig.from_data(json.loads(config), Path(folder), say=lambda _: None)
    arms = Arms.of(study)
    here, there = arms.code, json.loads(code)
    for file in sorted({*here, *there}):
        if here.get(file) != there.get(file):
            raise ConfigError(
                f"{file} is not as it was when the run began: run it again with --resume"
            )
    return arms
