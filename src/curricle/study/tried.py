"""The settings of arms that an audit tries, and its trials.

All arms have equally many trials, so that no side is tuned more than another: as many as the arm
with most settings needs. A trial changes every setting of an arm at once, at evenly spread points
that are equal for all arms.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import FloatArray
from curricle.comparison.opponents import starts_anywhere
from curricle.curriculum.curriculum import Curriculum, Node
from curricle.curriculum.result import SourceValues
from curricle.errors import CurriculumError, SettingError, TaskError
from curricle.learning.learners import Learner, RMax, value_bounds
from curricle.learning.portfolio import MOST_OPTIMIST
from curricle.learning.potential import StatePotential
from curricle.learning.schedules import Schedule
from curricle.learning.stopping import Episodes, limits
from curricle.planning.solution import evaluate, solve
from curricle.study_file.file import merged
from curricle.study_file.vary import FIRST_SEED, Raw, Variant, fields_of
from curricle.tasks.mdp import has_tables, tables

SEEDS = tuple(range(FIRST_SEED, FIRST_SEED + 3))  # of each trial
FEWEST_FINAL = 30  # further seeds of the best of each arm: as many as the study has, at least these
COLUMNS = ("rate", "level", "exploration", "scale", "source steps")
"""The settings of arms: in a trial all arms are equally far along the range of a column."""
OF_SOURCES = "scale", "source steps"  # the first half of the trials keeps those of the arm
KEPT = 0.25
"""Share of the trials that keep a schedule, or what an optimistic learner takes from its task."""


class Setting(NamedTuple):
    """A setting of an arm that its trials change."""

    key: str
    at: Callable[[float], float]  # a share of the way, in [0, 1) -> value
    change: Callable[[float], Raw]  # value -> what changes in the arm's data
    kept: bool = False  # whether some trials keep the arm's own, which is no number


def tried(
    plans: Mapping[str, Raw],
    curricula: Mapping[str, Curriculum],
    trials: int,
    seeds: int,
    alone: Collection[str],
) -> dict[str, Any]:
    """Return a configuration's fields in which all arms are tuned; those in `alone` have no source.

    `plans` are the arms as data, of a study with so many `seeds`. The first trial of every arm has
    its own settings; there are `trials` more for each setting of the arm that has most. Half of
    them keep the arm's own sources, so that it has the settings of scratch's trials with these.
    """
    from scipy.stats.qmc import Halton  # it takes half a second to import

    learners = [arm.setting("learner", arm.target) for arm in curricula.values()]
    stated = [float(of.initial_value) for of in learners if starts_anywhere(of)]
    settings = {name: settings_of(curricula[name], plans[name], stated) for name in plans}
    # Of a network nothing is tried, and so nothing of the arms that are compared with it.
    number = trials * max(map(len, settings.values())) * all(settings.values())
    points = Halton(len(COLUMNS), rng=0).random(number).tolist()
    variants = dict[str, Variant]()
    for name, plan in plans.items():
        variants[name] = Variant(name, dict, plan, {})
        for n, point in enumerate(points, 1):
            changed, values = plan, dict[str, float]()
            for column, share in zip(COLUMNS, point, strict=True):
                setting = settings[name].get(column)
                own_sources = column in OF_SOURCES and n <= number // 2
                if setting is None or own_sources or (setting.kept and share < KEPT):
                    continue
                value = setting.at((share - KEPT) / (1 - KEPT) if setting.kept else share)
                changed, values[setting.key] = merged(changed, setting.change(value)), value
            variants[f"{name}, trial {n + 1}"] = Variant(name, dict, changed, values)
    of_alone = [label for label, trial in variants.items() if trial.arm in alone]
    own = {name: variants[name] for name in plans}
    further = range(SEEDS[-1] + 1, SEEDS[-1] + 1 + max(FEWEST_FINAL, seeds))
    return {
        **fields_of(own, alone),
        "tune": {"seeds": SEEDS, "final_seeds": [*further], **fields_of(variants, of_alone)},
    }


def settings_of(curriculum: Curriculum, plan: Raw, stated: Sequence[float]) -> dict[str, Setting]:
    """Return the settings of an arm that are tried, by column; none where a network learns.

    `plan` is the arm as data; `stated` are levels of Q that lie within the range that is tried.
    """
    node = curriculum.node(curriculum.target)
    if node.deep:
        return {}
    sources = [curriculum.node(name) for name in curriculum.ancestors(node.name)]
    rated = [of for of in sources if isinstance(of.learner, Learner) and not of.learner.asks_task]
    if curriculum.has_potential(node.name) and node.shaping.portfolio:
        rest = "optimist", lambda share: MOST_OPTIMIST * share
        found = {
            "level": _of([node], "margin", _ratios(0.01, 1.0), _portfolio("margin")),
            "exploration": _of([node], *rest, _portfolio("optimist")),
        }
    else:
        found = {**_level(curriculum, stated), "exploration": _exploration(node)}
        rated += [node] * (not isinstance(node.learner, RMax))
    if rated:
        kept = any(not isinstance(of.learner.learning_rate, int | float) for of in rated)
        rates = "learning_rate", _ratios(0.02, 1.0), _learner("learning_rate")
        found["rate"] = _of(rated, *rates, kept)
    if stepping := [of for of in sources if not of.distilled]:
        into = {n: of for n, of in enumerate(plan["transfers"]) if of["target"] == node.name}
        most, part = sum(of.most_steps for of in stepping), _ratios(0.05, 1.0)
        found["scale"] = Setting(
            "scale",
            _ratios(0.25, 2.0),
            lambda by: {
                "transfers": {f"{n}": {"scale": by * of["scale"]} for n, of in into.items()}
            },
        )
        found["source steps"] = _of(
            stepping,
            "source_steps",
            lambda share: round(most * part(share)),
            lambda of, steps: _shorter(of, plan["tasks"][of.name], steps / most),
        )
    return found


At = Callable[[float], float]  # a share of the way, in [0, 1) -> value
Change = Callable[[Node, float], Raw]  # value -> what changes in the data of a task


def _of(nodes: Sequence[Node], key: str, at: At, change: Change, kept: bool = False) -> Setting:
    return Setting(key, at, lambda x: {"tasks": {of.name: change(of, x) for of in nodes}}, kept)


def _learner(key: str, stated: Callable[[float], Any] = float) -> Change:
    return lambda of, x: {"learner": {"type": type(of.learner).__name__, key: stated(x)}}


def _portfolio(key: str) -> Change:
    return lambda of, x: {"shaping": {"type": type(of.shaping).__name__, "portfolio": {key: x}}}


def _ratios(low: float, high: float) -> At:
    return lambda share: float(low * (high / low) ** share)


def _level(curriculum: Curriculum, stated: Sequence[float]) -> dict[str, Setting]:
    """Return the level at which Q starts; none for a task that is not solved."""
    node = curriculum.node(curriculum.target)
    learner: Any = node.learner
    anywhere = starts_anywhere(learner)  # others start at the upper end of a range of values
    ends = levels(node.task, potential_of(curriculum) if anywhere else 0.0, stated)
    if not ends:
        return {}
    at = partial(np.interp, xp=np.linspace(0.0, 1.0, len(ends)), fp=ends)
    if anywhere:
        return {"level": _of([node], "initial_value", at, _learner("initial_value"))}
    lowest, kept = value_bounds(node.task)[0], learner.value_range is None
    change = _learner("value_range", lambda top: [min(lowest, top), top])
    return {"level": _of([node], "value_range", at, change, kept)}


def _exploration(node: Node) -> Setting:
    """Return the exploration of a learner: a constant epsilon, or the softmax that it has."""
    learner: Any = node.learner
    key, own, at = "epsilon", learner.epsilon, _ratios(0.01, 1.0)
    if learner.inverse_temperature is not None:
        key, own = "inverse_temperature", learner.inverse_temperature
        beta = max(1e-3, own.first, own.last) if isinstance(own, Schedule) else max(1e-3, own)
        at = _ratios(beta / 10, beta * 10)
    kept = isinstance(own, Schedule) or (own is None and learner.asks_task)
    return _of([node], key, at, _learner(key), kept)


def _shorter(source: Node, stated: Raw, share: float) -> Raw:
    """Return the settings of a source that takes a share of its steps at most."""
    if isinstance(source.budget, Episodes):
        return {"budget": {"episodes": max(1, round(share * source.budget.number))}}
    steps = max(1, round(share * limits(source.budget)[0]))
    budget, eval_freq = stated.get("budget"), stated.get("eval_freq")
    if isinstance(budget, dict):
        budget = {"max_steps": steps, "min_steps": min(steps, budget.get("min_steps", 0))}
    else:
        budget = steps
    return {"budget": budget, "eval_freq": eval_freq and min(steps, eval_freq)}


# -- The levels of Q that are tried ----------------------------------------------------------------


def levels(
    task: object, phi: FloatArray | float = 0.0, stated: Sequence[float] = ()
) -> tuple[float, ...]:
    """Return the ends of the ranges of the levels of Q that are tried, half of them in each.

    Q learns Q* - phi. The upper range is that of the optimal values of states less phi; the lower
    one goes down to the lowest optimal value of a pair, or the random policy's value, less phi. 0
    and the levels that are stated lie within. Empty for a task that is not solved.
    """
    if not has_tables(task):
        return ()
    mdp: Any = tables(task)
    try:
        best, random = solve(mdp), evaluate(mdp, mdp.random_policy).start_value
    except SettingError:  # without a discount values can be too large for an error bound
        return ()
    live = ~mdp.terminal
    phi = np.broadcast_to(phi, best.action_values.shape)
    of_states, of_pairs = (best.values - phi.max(axis=1))[live], (best.action_values - phi)[live]
    random -= float(mdp.start @ phi.max(axis=1))
    low = min(0.0, random, of_pairs.min(), *stated)
    high = max(0.0, of_pairs.max(), *stated)
    ends = np.unique([low, min(max(low, of_states.min()), high), high])
    return tuple(ends.tolist()) if len(ends) > 1 else ()


def potential_of(curriculum: Curriculum) -> FloatArray | float:
    """Return phi(s, a) of a target, as its sources' optimal values give it; 0 where they do not."""
    name, values = curriculum.target, dict[str, Any]()
    node = curriculum.node(name)
    if not curriculum.has_potential(name) or not has_tables(node.task):
        return 0.0
    with suppress(CurriculumError, SettingError, TaskError):
        for edge in curriculum.in_edges(name):
            task = curriculum.tasks[edge.source]
            q = solve(task).action_values[None]
            values[edge.source] = SourceValues(task, (0,), q, np.zeros(1, np.int64))
        (phi,) = curriculum.potentials(name, values)
        shaping = node.shaping.with_potential(phi).for_task(node.task)
        if shaping.own_rewards:
            if isinstance(shaping.potential, StatePotential):
                return np.asarray(shaping.offset(0))
            return np.asarray(shaping.potential.pairs(np.arange(node.task.states.size)))
    return 0.0
