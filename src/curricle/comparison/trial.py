"""A trial: the comparison with learning from scratch, played in the tasks' models beforehand.

A trial costs milliseconds and no step of the experiment. It has the experiment's budgets and
accounting. Random streams are named after tasks, and a trial renames its tasks: so no seed of a
trial draws the numbers of a seed of the experiment. A trial never counts as the experiment.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from curricle.comparison.comparison import Comparison, comparison_plan, trained_comparison
from curricle.comparison.cost import NOMINAL, node_seconds
from curricle.comparison.measures import Reference
from curricle.comparison.opponents import CONSTANTS, OPPONENTS, Learners, Opponent
from curricle.comparison.plan import Memory, most_source_steps
from curricle.curriculum.curriculum import SETTINGS, Curriculum
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import Episodes, StoppingRule, limits
from curricle.progress import Progress, shown
from curricle.statistics.intervals import Interval
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr
from curricle.transfer.aggregate import BUILT_IN, Aggregate
from curricle.transfer.transfer import Transfer, numbered, transfer_names

# -- The rows of a forecast: an aggregate of all transfers into a target, or a transfer alone ------


@dataclass(frozen=True, eq=False)
class ForecastRow:
    """A way of using the sources of a target."""

    # The aggregate's, the transfer's as "source -> target [n]", or "potential" of one by hand.
    name: str
    # Only the target, its transfers as this row uses them, and the tasks that these need.
    curriculum: Curriculum = field(repr=False)
    aggregate: bool  # whether it combines all transfers
    used: bool  # whether the curriculum itself uses its sources in this way
    gain: Interval | None = None  # strong gain in mean return in the trial; None without a trial

    __repr__ = brief_repr


def rows_of(
    curriculum: Curriculum, target: str, aggregates: Sequence[Aggregate] = ()
) -> list[ForecastRow]:
    """Return the rows for a target: aggregates first, then each transfer alone."""
    edges = curriculum.in_edges(target)
    if not edges:
        return [ForecastRow("potential", part_of(curriculum, target, ()), False, True)]
    usual = curriculum.setting("aggregate", target)
    # All aggregates of a single potential are that potential.
    several = [entry.function for entry in BUILT_IN.values() if len(edges) > 1]
    functions = list[Aggregate]()
    for function in (*several, usual, *aggregates):
        if not any(function is other for other in functions):
            functions.append(function)
    rows = []
    names = numbered([getattr(function, "__name__", str(function)) for function in functions])
    for label, function in zip(names, functions, strict=True):
        plan = part_of(curriculum, target, edges).replace(target, aggregate=function)
        rows.append(ForecastRow(label, plan, aggregate=True, used=function is usual))
    for label, edge in zip(transfer_names(edges), edges, strict=True) if len(edges) > 1 else ():
        rows.append(ForecastRow(label, part_of(curriculum, target, [edge]), False, False))
    return rows


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
WINDOW = 5  # checkpoints over which curves are smoothed, as in a comparison


def run_trial(
    rows: Sequence[ForecastRow],
    *,
    opponents: Sequence[Opponent] = OPPONENTS,
    scratch: Learners = (),
    seeds: int = SEEDS,
    reference: Reference | None = None,
    memory: Memory | None = None,
    workers: int | None = None,
    progress: Progress = None,
) -> Comparison:
    """Return a trial of rows: an arm for each, under its name, and the opponents.

    Give it the reference of the target if that is known.
    """
    memory = Memory() if memory is None else memory
    arms = {row.name: apart(row.curriculum) for row in rows}
    plan = comparison_plan(arms, memory, opponents=opponents, scratch=scratch)
    reference = reference or Reference.before(plan.target_node, None)
    with shown(progress) as bars:
        numbers = seed_tuple(seeds)
        return trained_comparison(plan, numbers, reference, WINDOW, memory, workers, bars)


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


def trial_seconds(rows: Sequence[ForecastRow]) -> float:
    """Return an estimated upper bound on the seconds of a seed of a trial on one processor."""
    plans = [row.curriculum for row in rows]
    node = plans[0].node(plans[0].target)
    total = limits(node.budget)[0] + max(map(most_source_steps, plans))
    alone, constants = 1 + 3, len(CONSTANTS)  # scratch, bounds and the optimistic learner
    seconds = node_seconds(node, NOMINAL, total) * (alone + len(plans) * (1 + constants))
    for plan in plans:
        sources = [plan.node(name) for name in plan.ancestors(plan.target)]
        seconds += sum(node_seconds(source, NOMINAL, source.most_steps) for source in sources)
    return seconds


def affordable(rows: Sequence[ForecastRow]) -> tuple[list[ForecastRow], int]:
    """Return the rows and the number of seeds of the default trial; none if it takes long."""
    for some in (list(rows), [row for row in rows if row.used]):
        seeds = min(SEEDS, int(QUICK / trial_seconds(some)))
        if seeds >= FEWEST:
            return some, seeds
    return [], 0
