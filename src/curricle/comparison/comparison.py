"""Comparing curricula with learning the target from scratch, and with each other.

Arms with different targets are refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from curricle.checks import fit_name, instance, number, one_of, whole_number
from curricle.comparison.controls import CONTROLS, Control
from curricle.comparison.cost import live_words
from curricle.comparison.measures import Arm, MeasuredArms, Reference
from curricle.comparison.opponents import (
    OPPONENTS,
    Learners,
    Opponent,
    check_opponents,
    from_scratch,
    scratch_curricula,
)
from curricle.comparison.plan import (
    Failures,
    Memory,
    Plan,
    PlannedArm,
    Trained,
)
from curricle.comparison.sentences import HEADS, lines_below, printed_rows, table_rows, title
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import CurriculumError, SettingError, in_words
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import UNLEARNT
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.text import UNBOUNDED, counted, folded, printed, shortened, text_table


@dataclass(frozen=True, eq=False)
class Comparison(MeasuredArms):
    """Arms of K seeds on one axis. Prints as a table.

    Attributes
    ----------
    target : str
    arms : dict of str to Arm
        The target's own learner from scratch first, named "scratch".
    budget, total : int
        Target steps, over which weak transfer is measured; and steps of every arm, sources
        included, over which strong transfer is measured.
    reference : Reference
        Returns that arms are measured by, such as the threshold.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold.
    failed : dict of str to Exception
        Error of each arm that could not be trained.
    interim : str
        Text that says that seeds of the plan are missing; then there are no verdicts and p-values.
    looks : tuple of int
        Numbers of seeds with which the study was finished before seeds were added.
    remarks : tuple of str
        Sentences on how runs of another program were read; none of a study.
    """

    def rows(self) -> list[dict[str, Any]]:
        """Return the table as data: a dict for each arm, intervals as name, name_low, name_high.

        All dicts have the same keys; a number that an arm does not have is NaN.
        """
        return table_rows(self)

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the table and the sentences below it, in lines of at most `width` characters."""
        failed = (f"{name} failed: {in_words(error)}" for name, error in self.failed.items())
        lines = [folded(line, width) for line in (title(self), *self.sentences, *failed)]
        lines[1:1] = text_table(HEADS, printed_rows(self), width, prose=True)
        return "\n".join(lines)

    @property
    def sentences(self) -> list[str]:
        """Sentences on what was not learnt, other opponents, controls and clusters of seeds."""
        return lines_below(self)

    def __repr__(self) -> str:
        verdicts = [f"{name}: {answer.against_scratch}" for name, answer in self.verdicts.items()]
        return shortened(
            f"Comparison({self.target!r}, {counted(len(self.arms), 'arm')}, "
            f"{counted(self.seeds, 'seed')}; {'; '.join(verdicts)})"
        )

    _repr_html_ = printed


# -- Comparing arms -------------------------------------------------------------------------------


def compare(
    arms: Curriculum | Mapping[str, Curriculum],
    *,
    seeds: int | Sequence[int] = 30,
    controls: Sequence[Control] = (),
    opponents: Sequence[Opponent] = OPPONENTS,
    scratch: Learners = (),
    threshold: float | None = None,
    window: int = 5,
    workers: int | None = None,
    progress: Progress = None,
) -> Comparison:
    """Train curricula and their opponents, and return their comparison.

    All arms have the same total budget: the target's budget, plus the steps that the most expensive
    arm spends on its sources (or can spend at most, if a source's budget is in episodes). Opponents
    spend the whole total in the target; every other arm spends there the steps that its sources
    leave, seed by seed. A curriculum pays if it gains more than each opponent. An arm without any
    source or potential is an opponent too; it is left out if it learns as scratch does.
    An arm that fails is listed in ``Comparison.failed``; an error of scratch, or of all arms,
    is raised.

    Parameters
    ----------
    arms : Curriculum or dict of str to Curriculum
        Curricula with the same target, none named "scratch". ``curricle.compare`` also takes a
        study or its path: then the arms are the study's, and so are settings that are not passed.
    seeds : int or sequence of int
    controls : sequence of str
        Any of ``random_start``, ``pretraining``, ``placebo``, ``negated`` and ``unrelated``, run
        for each curriculum (``curricle.comparison.controls`` explains them).
    opponents : sequence of str
        Any of ``constant``, ``bounds``, ``optimistic`` and, not by default, ``model-based``:
        learners from scratch besides the target's own (``curricle.comparison.opponents``).
    scratch : sequence of learners, or dict of str to learner
        Further learners that learn the target from scratch.
    threshold : float, optional
        Return that counts as learnt. By default nine tenths of the way from the random policy's
        return to the optimum; midway up the curve of scratch if no optimum above random is known.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold; fewer
        where the target's budget has fewer.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task of each arm; a function is called with each trained arm.

    Raises
    ------
    CurriculumError, SettingError
        If arms are not comparable, or a setting is out of range, before any training.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 5000})
    >>> comparison = compare(plan, seeds=5, opponents=["optimistic"])
    >>> list(comparison.arms), comparison.total
    (['scratch', 'scratch, OptimisticQLearning', 'transfer'], 5500)
    """
    check_progress(progress)
    memory = Memory()
    plan = comparison_plan(arms, memory, controls, opponents, scratch)
    window = whole_number("window", window, 1, SettingError)
    if threshold is not None:
        threshold = number("threshold", threshold, SettingError)
    reference = Reference.before(plan.target_node, threshold)  # solving the target may fail
    with shown(progress) as bars:
        if bars.screen is not None:
            bars.say(live_words(plan, seed_tuple(seeds)))
        return trained_comparison(plan, seed_tuple(seeds), reference, window, memory, workers, bars)


def comparison_plan(
    arms: Curriculum | Mapping[str, Curriculum],
    memory: Memory,
    controls: Sequence[Control] = (),
    opponents: Sequence[Opponent] = (),
    scratch: Learners = (),
) -> Plan:
    """Return the plan of :func:`compare`; CurriculumError if arms cannot be compared."""
    if isinstance(arms, Curriculum):
        arms = {"transfer": arms}
    instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
    if not arms:
        raise CurriculumError("a comparison needs at least one curriculum: got none")
    for name, arm in arms.items():
        fit_name("an arm", name, CurriculumError)
        instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
        arm.check_networks()
    if isinstance(controls, str):
        raise SettingError(f"controls must be a list of names: got {controls!r}")
    for control in controls:
        one_of("a control", control, CONTROLS, SettingError)
    opponents = check_opponents(opponents)
    first = next(iter(arms.values()))
    scratches = {SCRATCH: from_scratch(first), **scratch_curricula(scratch, first)}
    return Plan.made(arms, scratches, memory.keys_of, controls=controls, opponents=opponents)


def trained_comparison(
    plan: Plan,
    seeds: tuple[int, ...],
    reference: Reference,
    window: int,
    memory: Memory,
    workers: int | None,
    bars: Bars,
) -> Comparison:
    """Train the arms of a plan, and return their comparison with the reference before training."""
    # An arm that raises an error is added to `failed`, and left out with its controls.
    failures, in_order = Failures(plan.needs), tuple(sorted(seeds))
    failed, arms = dict[str, Exception](), dict[str, Arm]()
    for _ in chain(memory.train(plan, in_order, failures, workers, bars), [None]):
        for unit, error in failures.errors:
            for name, arm in plan.arms.items():
                if unit.key in arm.keys.values() and not failed.keys() & {name, arm.of}:
                    assert isinstance(error, Exception)
                    failed[name] = error
        if SCRATCH in failed:
            raise failed[SCRATCH]
        for name, arm in plan.arms.items():
            if failed.keys() & {name, arm.of} or name in arms:
                continue
            keys = {task: (key, in_order) for task, key in arm.keys.items()}
            if not {*keys.values()} <= memory.trained.keys():
                break  # `bars` takes the arms in the plan's order
            try:
                results = {task: memory.trained[key] for task, key in keys.items()}
                arms[name] = _arm(arm, results, plan, seeds)
            except Exception as error:  # training an arm may raise any error
                failed[name] = error
            else:
                bars.tell(name)
    if failed and all(arm.scratch for arm in arms.values()):
        raise next(iter(failed.values()))
    arms = {name: arms[name] for name in plan.arms if name in arms}
    reference = reference.after(arms[SCRATCH].curve)
    window = min(window, plan.steps[0] // plan.eval_freq + 1)  # checkpoints of the target's budget
    return Comparison(plan.target, arms, *plan.steps, reference, window, failed)


def _arm(
    planned: PlannedArm, results: Mapping[str, Trained], plan: Plan, seeds: Sequence[int]
) -> Arm:
    """Return the arm that the results of its tasks make, with its seeds in the caller's order."""
    last, curriculum = results[plan.target], planned.curriculum
    return Arm.of(
        last.result,
        last.source_steps,
        (plan.steps[1], plan.eval_freq),
        seeds,
        initial_values=last.initial_values,
        unlearnt={
            source: results[source].result.ended_by == UNLEARNT
            for source in (curriculum.ancestors(plan.target) if not planned.of else ())
        },
        scratch=planned.scratch,
        curriculum=planned.of,
        knows_target=curriculum.knows_target(plan.target),
        network=curriculum.node(plan.target).deep,
    )
