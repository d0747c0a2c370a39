"""A trial: the comparison with learning from scratch, played in the tasks' models beforehand.

A trial costs milliseconds and no step of the experiment. It has the experiment's budgets and
accounting. Random streams are named after tasks, and a trial renames its tasks: so no seed of a
trial draws the numbers of a seed of the experiment. A trial never counts as the experiment.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from curricle.comparison.comparison import (
    Comparison,
    Reference,
    checkpoints,
    comparison_plan,
    trained_comparison,
)
from curricle.comparison.opponents import CONSTANTS, OPPONENTS, Learners, Opponent
from curricle.comparison.plan import Memory, most_source_steps
from curricle.curriculum.curriculum import SETTINGS, Curriculum, Node
from curricle.errors import in_words
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import Episodes, StoppingRule, limits
from curricle.planning.policy_evaluation import ExactEvaluation, RolloutEvaluation
from curricle.progress import Progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.statistics.intervals import Interval
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr, counted
from curricle.transfer.aggregate import COMPARED, Aggregate
from curricle.transfer.transfer import Transfer, numbered, transfer_names

# -- Candidates: the curricula that use a curriculum's sources in different ways -------------------
#
# A forecast compares an aggregate of all transfers into the target, and each transfer alone.


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way of using the sources of a target."""

    name: str  # the aggregate's, or the transfer's as "source -> target [n]"
    # Only the target, its transfers as this candidate uses them, and the tasks that these need.
    curriculum: Curriculum
    aggregate: bool  # whether it combines all transfers
    used: bool  # whether the curriculum itself uses its sources in this way


def candidates_of(
    curriculum: Curriculum, target: str, aggregates: Sequence[Aggregate] = ()
) -> list[Candidate]:
    """Return the candidates for a target: aggregates first, then each transfer alone."""
    edges = curriculum.in_edges(target)
    raw = [replace(edge, calibrate=False) for edge in edges]
    usual, calibrated = curriculum.setting("aggregate", target), curriculum.calibration(target)
    # All aggregates of a single potential are that potential.
    several = COMPARED if len(edges) > 1 else ()
    functions = list[Aggregate]()
    for function in (*several, usual, *aggregates):
        if not any(function is known for known in functions):
            functions.append(function)
    candidates = []
    names = numbered([getattr(function, "__name__", str(function)) for function in functions])
    for label, function in zip(names, functions, strict=True):
        plan = part_of(curriculum, target, raw).replace(target, aggregate=function)
        used = function is usual and calibrated is None
        candidates.append(Candidate(label, plan, aggregate=True, used=used))
        if function is usual and calibrated is not None:
            plan = part_of(curriculum, target, edges)
            candidates.append(Candidate(f"{label}, calibrated", plan, aggregate=True, used=True))
    for label, edge in zip(transfer_names(edges), raw, strict=True) if len(edges) > 1 else ():
        candidates.append(Candidate(label, part_of(curriculum, target, [edge]), False, False))
    return candidates


def part_of(
    curriculum: Curriculum,
    target: str,
    transfers: Sequence[Transfer],
    rename: Callable[[str], str] = str,
) -> Curriculum:
    """Return the part of a curriculum from which a target is learnt, with its tasks renamed."""
    # `transfers` replace the curriculum's transfers into the target. Random streams are named after
    # tasks, so that a renamed curriculum draws other numbers for the same seeds.
    before = {edge.source for edge in transfers}
    kept = before.union(*(curriculum.ancestors(name) for name in before), {target})
    edges = [edge for edge in curriculum.transfers if edge.target in kept - {target}]
    settings = dict[str, Any]()
    for which in SETTINGS:
        setting = getattr(curriculum, which)
        if isinstance(setting, Mapping):
            setting = {rename(name): value for name, value in setting.items() if name in kept}
        settings[which] = setting
    # The default budget of a source depends on the number of sources in the whole curriculum.
    settings["budget"] = {rename(name): curriculum.setting("budget", name) for name in kept}
    return Curriculum(
        tasks={rename(name): task for name, task in curriculum.tasks.items() if name in kept},
        transfers=[
            replace(edge, source=rename(edge.source), target=rename(edge.target))
            for edge in (*edges, *transfers)
        ],
        **settings,
    )


# -- A trial -----------------------------------------------------------------------------------

STREAM = "/trial"  # the end of the names of a trial's tasks and random streams
SEEDS, FEWEST = 20, 8  # seeds of a trial; fewest seeds for which a trial is made by default
QUICK = 10.0  # estimated seconds on one processor up to which a forecast makes a trial by default
STEP, OUTCOME = 25e-9, 8e-9
"""About the seconds of a step in a model, and of one outcome in one step of an exact evaluation.
They are constants, so that it does not depend on the machine whether there is a trial."""
SETTLED = 1000  # steps of an exact evaluation after which most values no longer change
WINDOW = 5  # checkpoints over which curves are smoothed, as in a comparison


@dataclass(frozen=True, eq=False)
class Trial:
    """The result of a trial.

    Attributes
    ----------
    comparison : Comparison
        An arm for each candidate, under the candidate's name, and the opponents.
    assumes : str
        The assumptions of its verdict, as text.
    """

    comparison: Comparison = field(repr=False)
    assumes: str

    __repr__ = brief_repr

    def gain(self, name: str) -> Interval | None:
        """Return the strong gain of a candidate in mean return; None if it could not be trained."""
        contrast = self.comparison.contrasts.get(name)
        return None if contrast is None else contrast.strong_gain

    def verdict(self, name: str) -> str:
        """Return in a few words whether a candidate pays, by the interval of its gain."""
        gain = self.gain(name)
        return "it failed in the trial" if gain is None else verdict_words(gain)

    def numbers(self, name: str) -> str:
        """Return a sentence on a candidate's gain, its steps and its best opponent's steps."""
        comparison, gain = self.comparison, self.gain(name)
        if gain is None:
            return in_words(comparison.failed[name])
        gained = f"gain in mean return {in_brief(gain)}"
        if comparison.reference.nothing_to_learn:
            return f"nothing to learn, as the random policy is optimal; {gained}"
        best = comparison.best_opponent(name)
        by = f"by {best}" if best != SCRATCH else "from scratch"
        times, alone = comparison.times(name), comparison.times(best)
        if not (times.reached.any() or alone.reached.any()):
            return (
                f"the threshold {comparison.threshold:.4g} is never reached within "
                f"{comparison.total:,} steps, with sources or {by}; {gained}"
            )
        # If only the slower side misses the threshold, the true difference in steps is larger.
        saved = comparison.contrasts[name].strong_steps_saved
        slower, faster = (alone, times) if saved.estimate >= 0 else (times, alone)
        bound = "at least " * bool(not slower.reached.all() and faster.reached.all())
        if saved.estimate >= 0:
            change = f"saves {bound}{in_brief(saved)}"
        else:
            n, low, high = (-float(value) for value in (saved.estimate, saved.high, saved.low))
            more = in_brief(replace(saved, estimate=n, low=low, high=high))
            change = f"takes {bound}{more} more"
        spent = comparison[name].curve.source_steps.mean()
        return (
            f"expected steps to the threshold {comparison.threshold:.4g}: {self._steps(name)} with "
            f"sources (their {spent:,.0f} steps included), {self._steps(best)} {by}; "
            f"{change}; {gained}"
        )

    def _steps(self, name: str) -> str:
        times = self.comparison.times(name)
        missed = int((~times.reached).sum())
        if missed == len(times.reached):
            return f"never within {self.comparison.total:,} steps"
        text = in_brief(times.restricted_mean(float(self.comparison.scratch.curve.steps[-1])))
        seeds = counted(len(times.reached), "seed")
        return f"at least {text} ({missed} of {seeds} never)" if missed else text


def verdict_words(gain: Interval) -> str:
    """Return in a few words whether a gain with this interval pays."""
    if gain.low > 0:
        return "likely pays"
    return "likely costs more than it brings" if gain.high < 0 else "whether it pays is open"


def in_brief(interval: Interval) -> str:
    """Return an interval as text without its number of seeds, with commas in thousands."""
    bounds = (float(x) for x in (interval.estimate, interval.low, interval.high))
    rounded = [float(f"{bound:.3g}") for bound in bounds]
    estimate, low, high = (f"{x:,.0f}" if abs(x) >= 1000 else f"{x:g}" for x in rounded)
    return estimate if low == "nan" else f"{estimate} [{low}, {high}]"


def run_trial(
    candidates: Sequence[Candidate],
    *,
    opponents: Sequence[Opponent] = OPPONENTS,
    scratch: Learners = (),
    seeds: int = SEEDS,
    reference: Reference | None = None,
    memory: Memory | None = None,
    workers: int | None = None,
    progress: Progress = None,
) -> Trial:
    """Return a trial of candidates, with the reference of their target if that is known."""
    memory = Memory() if memory is None else memory
    arms = {candidate.name: apart(candidate.curriculum) for candidate in candidates}
    plan = comparison_plan(arms, memory, opponents=opponents, scratch=scratch)
    window = min(WINDOW, checkpoints(plan))  # there may be fewer checkpoints
    reference = reference or Reference.before(plan.target_node, None)
    with warnings.catch_warnings(), shown(progress) as bars:
        # No warning about a refused calibration: the experiment will warn.
        warnings.simplefilter("ignore", UserWarning)
        numbers = seed_tuple(seeds)
        comparison = trained_comparison(plan, numbers, reference, window, memory, workers, bars)
    assumes = (
        f"a trial in the model: {counted(seeds, 'seed')}, random streams apart from those of "
        "an experiment; assumes the tasks, budgets and settings of the curriculum, its sources "
        "trained anew"
    )
    return Trial(comparison, assumes)


def apart(curriculum: Curriculum) -> Curriculum:
    """Return the same curriculum with renamed tasks, and so with other random streams."""
    target = curriculum.target
    return part_of(curriculum, target, curriculum.in_edges(target), lambda name: name + STREAM)


def hindrance(curriculum: Curriculum) -> str:
    """Return why there can be no trial of a curriculum, as text; empty if there can be one."""
    for name, task in curriculum.tasks.items():
        if is_observation_task(task):
            return f"{name!r} is seen through observations and has no model"
        if is_live(task):
            return f"{name!r} is live and has no model (tabulate makes it if states are few)"
    node = curriculum.node(curriculum.target)
    if isinstance(node.budget, Episodes | StoppingRule):
        return f"the budget of {node.name!r} is {node.budget}"
    return f"the greedy evaluation of {node.name!r} is off" * (node.evaluation.method == "off")


def trial_seconds(candidates: Sequence[Candidate]) -> float:
    """Return an estimated upper bound on the seconds of a seed of a trial on one processor."""
    plans = [candidate.curriculum for candidate in candidates]
    node = plans[0].node(plans[0].target)
    total = limits(node.budget)[0] + max(map(most_source_steps, plans))
    alone, constants = 1 + 3, len(CONSTANTS)  # scratch, bounds and the optimistic learner
    seconds = _node_seconds(node, total) * (alone + len(plans) * (1 + constants))
    for plan in plans:
        sources = [plan.node(name) for name in plan.ancestors(plan.target)]
        seconds += sum(_node_seconds(source, source.most_steps) for source in sources)
    return seconds


def _node_seconds(node: Node, steps: int) -> float:
    """Return the seconds of learning a task for so many steps and of its greedy evaluations."""
    kernel, evaluation = node.evaluation.kernel(node.task), 0.0
    if isinstance(kernel, ExactEvaluation):
        # At most all states are evaluated, each with the outcomes of its greedy action.
        outcomes = len(kernel.tables.outcome_row) * kernel.tables.probability.shape[1]
        evaluation = outcomes * min(kernel.horizon, SETTLED) * OUTCOME
    elif isinstance(kernel, RolloutEvaluation):
        evaluation = kernel.episodes * min(kernel.horizon, steps) * STEP
    return steps * STEP + (steps // node.eval_freq + 1) * evaluation


def affordable(candidates: Sequence[Candidate]) -> tuple[list[Candidate], int]:
    """Return the candidates and the number of seeds of the default trial; none if it takes long."""
    for some in (list(candidates), [candidate for candidate in candidates if candidate.used]):
        seeds = min(SEEDS, int(QUICK / trial_seconds(some)))
        if seeds >= FEWEST:
            return some, seeds
    return [], 0
