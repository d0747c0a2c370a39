"""What a study is, costs and promises, in lines of text, before it is run."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from curricle.comparison.forecasting import Forecast, forecast
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import CurricleError, SettingError
from curricle.learning.result import LearningResult, without_curves
from curricle.planning.target import Target
from curricle.report.graph import mapping_words
from curricle.study.config.study_file import StudyFile
from curricle.study.runner.arms import Arms
from curricle.study.runner.cost import Cost, costs
from curricle.study.runner.folder import STUDY
from curricle.study.runner.run import left_to_do
from curricle.study.runner.stored_sources import finished
from curricle.study.runner.study import Study
from curricle.transfer.edges import transfer_names


def preview(study: StudyFile) -> Iterator[str]:
    """Yield the graph of each arm, what it costs, and a forecast from sources that are solved."""
    arms = Arms.of(study)
    seeds = study.document.seeds
    yield f"{study.document.name}: {len(arms.curricula)} arms, {len(seeds)} seeds"
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, curriculum in arms.curricula.items():
        alike.setdefault(tuple(graph(curriculum)), []).append(name)
    for lines, names in alike.items():
        yield ""
        yield f"arm{'s' * (len(names) > 1)} {', '.join(names)}"
        yield from lines
    yield ""
    yield from _bill(costs(arms, seeds, study.document.seeds_per_unit))
    try:
        study.check_networks()
    except ImportError as error:
        yield f"a network is to learn: {error}"
    for name, curriculum in arms.curricula.items():
        if curriculum.in_edges(curriculum.target):
            yield ""
            yield f"arm {name}: {_foreseen(curriculum)}"


def graph(curriculum: Curriculum) -> Iterator[str]:
    """Yield a line for each task, sources first, and for each transfer into it."""
    for name in curriculum.order:
        node = curriculum.node(name)
        if node.deep:
            task, learner = node.task.shapes, node.learner.algorithm
        else:
            task = f"{node.task.states.size:,} states x {node.task.actions.size:,} actions"
            learner = type(node.learner).__name__
        yield f"  {name}: {task}; {learner}; {_budget(node.budget)}"
        edges = curriculum.in_edges(name)
        for label, edge in zip(transfer_names(edges), edges, strict=True):
            cover = "" if node.deep else f"; {edge.mapping.coverage()}"
            yield f"    {label}: {mapping_words(edge)}{cover}"


def _budget(budget: object) -> str:
    return f"{budget:,} steps" if isinstance(budget, int) else str(budget)


def _bill(each: list[Cost]) -> Iterator[str]:
    names = [f"{one.arm}: {one.node}" for one in each]
    wide = max([24, *map(len, names)])
    yield f"{'cost at most':<{wide}}{'seeds':>7}{'steps a seed':>14}{'tables':>10}{'time':>12}"
    for words, one in zip(names, each, strict=True):
        size, spent = f"{one.table_bytes / 1e6:,.1f} MB", duration(one.seconds)
        yield f"{words:<{wide}}{one.seeds:>7}{one.steps:>14,}{size:>10}{spent:>12}"
    seconds = sum(one.seconds for one in each)
    yield f"about {duration(seconds)} on one processor, compilation aside"


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


def _foreseen(curriculum: Curriculum) -> str | Forecast:
    """Return the forecast with sources taken as solved, or why there is none."""
    try:
        return forecast(curriculum, seeds=1, trained=_solved(curriculum))
    except CurricleError as error:
        return f"no forecast without training: {error}"


def _solved(curriculum: Curriculum) -> dict[str, LearningResult]:
    """Return the sources as if one seed had learnt them perfectly."""
    found = {}
    for name in curriculum.ancestors(curriculum.target):
        node = curriculum.node(name)
        if node.deep:
            raise SettingError(f"{name!r} is learnt by a network, which cannot be solved instead")
        solution = Target.of(node.task, node.evaluation).solution
        if solution is not None:
            values, none = solution.action_values[None], np.zeros(1, np.int64)
            found[name] = without_curves(node.task, node.learner, (0,), values, none)
    return found


def to_do(study: StudyFile, path: Path, shard: tuple[int, int]) -> Iterator[str]:
    """Yield the units that a run would do, of those that a folder does not hold yet."""
    arms = Arms.of(study)
    stored = Study(path).folder.units() if (path / STUDY).exists() else []
    left = left_to_do(study, arms, finished(stored), shard)
    for unit in left:
        yield f"{unit.words}: {arms.curricula[unit.arm].node(unit.node).most_steps:,} steps at most"
    yield f"{len(left)} units to do, {len(stored)} done, in {path}"
