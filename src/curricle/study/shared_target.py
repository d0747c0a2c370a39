"""Whether studies that are compared have one target."""

from collections.abc import Iterable

from curricle.comparison.task_differences import summary_differences
from curricle.errors import CurriculumError
from curricle.statistics.curves import SCRATCH
from curricle.study.record import StudyRecord


def check_shared_target(records: Iterable[StudyRecord]) -> None:
    """Raise CurriculumError unless the targets are one task, learnt and evaluated alike."""
    first, *others = records
    names = [first.name, *(other.name for other in others)]
    if len(set(names)) < len(names):
        raise CurriculumError(f"studies that are compared need different names: got {names}")
    for other in others:
        pair = f"{first.name!r} and {other.name!r}"
        if first.target != other.target:
            raise CurriculumError(
                f"studies must share their target: {pair} have {first.target!r} and "
                f"{other.target!r}"
            )
        if apart := summary_differences(first.problem, other.problem):
            raise CurriculumError(
                f"studies must share their target: those of {pair} differ in {'; '.join(apart)}"
            )
        mine, yours = (one.arms[SCRATCH].nodes[one.target].settings for one in (first, other))
        for which in ("evaluation", "learner", "eval_freq"):
            if mine.get(which) != yours.get(which):
                raise CurriculumError(
                    f"studies must share their target's {which}: {pair} have {mine.get(which)} "
                    f"and {yours.get(which)}"
                )
