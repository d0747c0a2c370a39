"""Whether arms can be compared: one target with the same settings, at one total of steps."""

from collections.abc import Collection, Mapping
from typing import Any

from curricle.checks import fit_name, instance
from curricle.comparison.task_differences import differences
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import CurriculumError
from curricle.statistics.curves import SCRATCH


def curricula_by_name(arms: Curriculum | Mapping[str, Curriculum]) -> Mapping[str, Curriculum]:
    """Return arms by name, or raise CurriculumError unless they are curricula."""
    if isinstance(arms, Curriculum):
        return {"transfer": arms}
    instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
    if not arms:
        raise CurriculumError("a comparison needs at least one curriculum: got none")
    for name, arm in arms.items():
        fit_name("an arm", name, CurriculumError)
        instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
        if name == SCRATCH:
            raise CurriculumError(f"the name {SCRATCH!r} is taken by the baseline: rename this arm")
    return arms


def most_source_steps(curriculum: Curriculum) -> int:
    """Return an upper bound of the steps that a curriculum's sources take."""
    return sum(curriculum.node(name).most_steps for name in curriculum.ancestors(curriculum.target))


def check_comparable(arms: Mapping[str, Curriculum], learners: Collection[Any] | None = ()) -> None:
    """Raise CurriculumError unless all arms have one target with the same settings.

    Instead of the first arm's learner of the target one may have another of `learners`, which learn
    it from scratch too; any where that is None.
    """
    (name, first), *others = arms.items()
    target = first.target
    for other_name, other in others:
        pair = f"{name!r} and {other_name!r}"
        if other.target != target:
            raise CurriculumError(
                f"arms must share their target: {pair} have {target!r} and {other.target!r}"
            )
        apart = differences(first.tasks[target], other.tasks[target])
        if apart:
            raise CurriculumError(
                f"arms must share their target: those of {pair} differ in {'; '.join(apart)}"
            )
        for which in ("evaluation", "budget", "learner", "eval_freq"):
            mine, yours = first.setting(which, target), other.setting(which, target)
            fair = which == "learner" and (learners is None or yours in learners)
            if mine != yours and not fair:
                raise CurriculumError(
                    f"arms must share their target's {which}: {pair} have {mine} and {yours}"
                )
