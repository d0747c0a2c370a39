"""Comparing curricula with learning the target from scratch, and with each other.

All arms spend the same total of steps, source steps included. Seed k of every arm draws from the
same random stream in the target. Arms with different targets are refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from curricle.checks import number, whole_number
from curricle.comparison.arms import Arm
from curricle.comparison.comparison import Comparison
from curricle.comparison.comparison_plan import ComparisonPlan
from curricle.comparison.controls import (
    Control,
)
from curricle.comparison.scratch import GivenScratch
from curricle.comparison.verdicts import ONE_LOOK
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import SettingError
from curricle.learning.seeds import seed_tuple
from curricle.planning.target import Target
from curricle.progress import Progress, check_progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.statistics.sequential import Looks
from curricle.statistics.thresholds import fraction_of_optimum, midpoint
from curricle.transfer.observation_rollouts import ObservationTarget

FRACTION = 0.9
"""Of the way from the random policy's return to the optimum: the default threshold."""


def compare(
    arms: Curriculum | Mapping[str, Curriculum],
    *,
    seeds: int | Sequence[int] = 30,
    controls: Sequence[Control] = (),
    scratch: GivenScratch = (),
    threshold: float | None = None,
    window: int = 5,
    precision: float | None = None,
    difference: bool = False,
    most_seeds: int = 100,
    workers: int | None = None,
    progress: Progress = None,
) -> Comparison:
    """Return a comparison of curricula with learning their target from scratch.

    All have one total budget: the target's plus the steps that the most expensive arm spends on its
    sources (or can spend at most, if a source's budget is in episodes). The learner from scratch
    spends all of it in the target, every other arm the rest after its sources, seed by seed.

    Whether a curriculum pays is asked against learning from scratch, against the best of them where
    there are several. Why it pays, by what it knows or by its optimism alone, is asked against the
    controls that know nothing: ``placebo`` and ``constant``.

    An arm that raises an error is listed in :attr:`Comparison.failed`, and the others stand. An
    error of scratch, or of all arms, is raised.

    Parameters
    ----------
    arms : Curriculum or dict of str to Curriculum
        All with the same target; the name "scratch" is reserved. ``curricle.compare`` also takes a
        study or the path of its file: its arms, seeds, threshold, window and learners from scratch,
        where others are not given.
    seeds : int or sequence of int
        With `precision` or `difference`, the number of seeds to begin with.
    controls : sequence of str
        Of ``random_start``, ``pretraining``, ``placebo``, ``constant``, ``scaled`` and ``negated``,
        run for each curriculum (``curricle.comparison.controls`` explains them).
    scratch : sequence of learners, or dict of str to learner
        Learners that learn the target from scratch too, beside its own, each an arm with the same
        total. A dict names them, else their settings do.
    threshold : float, optional
        Return that counts as learnt. By default nine tenths of the way from the random policy's
        return to the optimum; midway up the curve of scratch if there is no such optimum.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold.
    precision : float, optional
        Add seeds until the half-width of the first arm's strong gain is at most this return.
    difference : bool
        Add seeds until the first arm's strong gain differs from 0.
    most_seeds : int
        Seeds at which to stop adding.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task of each arm; a function is called with the name of each arm
        when it is done.

    Raises
    ------
    CurriculumError
        If arms are not comparable; the message names the differences of their targets.
    SettingError
        If a setting is out of range, before any training.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 5000})
    >>> found = compare(plan, seeds=5, controls=["placebo"])
    >>> list(found.arms), found.total
    (['scratch', 'transfer', 'transfer, placebo'], 5500)
    """
    check_progress(progress)
    plan = ComparisonPlan.of(arms, controls, scratch, workers)
    window = whole_number("window", window, 1, SettingError)
    if window > plan.checkpoints:
        raise SettingError(
            f"window must be at most {plan.checkpoints}, the checkpoints within the target's "
            f"budget: got {window}"
        )
    if threshold is None:  # the target is solved before any training, as that may fail
        target = plan.solved_target()
    else:
        threshold = number("threshold", threshold, SettingError)
    failed: dict[str, Exception] = {}
    looks, stopped = ONE_LOOK, ""
    with shown(progress) as bars:
        plan = replace(plan, bars=bars)
        if precision is None and not difference:
            found = plan.run(seed_tuple(seeds), failed)
        else:
            first = whole_number("seeds to begin adding with", seeds, 2, SettingError)
            found, stopped = plan.run_until(first, precision, difference, most_seeds, failed)
            looks = Looks.doubling(first, most_seeds)
    check_any_left(found, failed)
    if threshold is None:
        threshold = default_threshold(target, found[SCRATCH])
    return Comparison(
        plan.target, found, plan.budget, plan.total, threshold, window, failed, looks, stopped
    )


def check_any_left(found: Mapping[str, Arm], failed: Mapping[str, Exception]) -> None:
    """Raise the first error where all curricula failed."""
    if all(name == SCRATCH or arm.scratch for name, arm in found.items()):
        raise next(iter(failed.values()))


def default_threshold(target: Target | ObservationTarget, scratch: Arm) -> float:
    """Return nine tenths of the way from the random policy's return to the optimum.

    If the optimum is unknown or not above that return, return the midpoint of the curve of scratch.
    """
    of_optimum = threshold_of_optimum(target)
    return midpoint(scratch.curve) if of_optimum is None else of_optimum


def threshold_of_optimum(target: Target | ObservationTarget) -> float | None:
    """Return nine tenths of the way from the random policy's return to the optimum.

    None if the optimum is unknown or not above that return.
    """
    if target.solution is None:
        return None
    best, worst = target.optimum, target.random_return
    # Undiscounted, the policy that is optimal with the discount need not beat a random one.
    return None if best <= worst else fraction_of_optimum(best, worst, FRACTION)
