"""What ``curricle check`` prints: a study's tasks, its cost and a forecast, before it is run."""

from collections.abc import Iterator
from pathlib import Path
from textwrap import fill

import numpy as np

from curricle.cli.terminal_tables import print_table, table
from curricle.comparison.forecasting import Forecast, forecast
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.sources import SourceValues
from curricle.errors import CurricleError, SettingError
from curricle.planning.target import Target
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.cost import Cost, costs
from curricle.study.folders import STUDY
from curricle.study.resuming import Done, arms_in, usable_units
from curricle.study.store import StudyStore
from curricle.study.units import units_of
from curricle.transfer.descriptions import countable, mapping_words
from curricle.transfer.edges import transfer_names


def print_preview(study: StudyConfig) -> None:
    """Print the graph of each arm, its cost, and a forecast for sources taken as solved."""
    arms = Arms.of(study)
    print(f"{study.name}: {len(arms.curricula)} arms, {len(study.seeds)} seeds")
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, curriculum in arms.curricula.items():
        alike.setdefault(tuple(graph(curriculum)), []).append(name)
    for lines, names in alike.items():
        print(f"\narm{'s' * (len(names) > 1)} {', '.join(names)}", *lines, sep="\n")
    print()
    _print_cost(costs(study, arms))
    try:
        study.check_networks()
    except ImportError as error:
        print(f"a task is learnt by a network: {error}")
    for name, curriculum in arms.curricula.items():
        if curriculum.in_edges(curriculum.target):
            print(f"\narm {name}", _forecast(curriculum), sep="\n")


def graph(curriculum: Curriculum) -> Iterator[str]:
    """Yield a text for each task, sources first, and for each transfer into it."""
    for name in curriculum.order:
        node = curriculum.node(name)
        if node.deep:
            task, learner = node.task.shapes, node.learner.algorithm
        else:
            task = f"{node.task.states.size:,} states x {node.task.actions.size:,} actions"
            learner = type(node.learner).__name__
        steps = f"{node.budget:,} steps" if isinstance(node.budget, int) else node.budget
        yield _wrapped(f"{name}: {task}; {learner}; {steps}", 2)
        edges = curriculum.in_edges(name)
        for label, edge in zip(transfer_names(edges), edges, strict=True):
            cover = f"; {edge.mapping.coverage()}" if countable(edge.mapping) else ""
            yield _wrapped(f"{label}: {mapping_words(edge)}{cover}", 4)


def _wrapped(line: str, indent: int) -> str:
    return fill(line, 80, initial_indent=" " * indent, subsequent_indent=" " * (indent + 2))


def _print_cost(each: list[Cost]) -> None:
    rows = table("cost at most", "seeds", "steps a seed", "tables", "time")
    for one in each:
        rows.add_row(
            f"{one.arm}: {one.task}",
            f"{one.seeds}",
            f"{one.steps:,}",
            f"{one.table_bytes / 1e6:,.1f} MB",
            duration(one.seconds),
        )
    print_table(rows)
    seconds = sum(one.seconds for one in each)
    print(f"about {duration(seconds)} on one processor, without compilation")


def duration(seconds: float) -> str:
    """Return a time in words.

    Examples
    --------
    >>> duration(0.2), duration(75), duration(5000)
    ('1 s', '75 s', '83 min')
    """
    if seconds < 120:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:,.0f} min" if seconds < 7200 else f"{seconds / 3600:,.1f} h"


def _forecast(curriculum: Curriculum) -> str | Forecast:
    """Return the forecast with sources taken as solved, or why there is none."""
    try:
        return forecast(curriculum, seeds=1, trained=_solved(curriculum))
    except CurricleError as error:
        return f"no forecast without training: {error}"


def _solved(curriculum: Curriculum) -> dict[str, SourceValues]:
    """Return the sources as if one seed had learnt their optimal values."""
    found = {}
    for name in curriculum.ancestors(curriculum.target):
        node = curriculum.node(name)
        if node.deep:
            raise SettingError(f"{name!r} is learnt by a network, which cannot be solved instead")
        solution = Target.of(node.task, node.evaluation).solution
        if solution is not None:
            values, none = solution.action_values[None], np.zeros(1, np.int64)
            found[name] = SourceValues(node.task, (0,), values, none)
    return found


def units_left(
    study: StudyConfig, path: Path, shard: tuple[int, int], *, keep_stale: bool
) -> Iterator[str]:
    """Yield what is damaged or stale in a folder, what a run would train, and how much is done."""
    arms = arms_in(study, path, keep_stale=keep_stale)
    done: Done = {}
    if (path / STUDY).exists():
        done, remarks = usable_units(StudyStore(path), arms, remove_damaged=False)
        yield from remarks
    left = units_of(study, arms, done, shard)
    for unit in left:
        most = arms.curricula[unit.arm].node(unit.task).most_steps
        yield f"{unit.label}: {most:,} steps at most"
    used = {unit for key in arms.keys.values() for unit in done.get(key, {}).values()}
    yield f"{len(left)} units to do, {len(used)} done, in {path}"
