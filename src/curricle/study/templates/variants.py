"""Easier variants of an environment: the arguments that make them, and how its states read theirs.

Variants that other arguments of the constructor make are learnt: those are easier that take fewer
steps. Mappings from the target to a variant are scored, by tables of both, or by what a live target
returns that starts at their potential; a variant that no mapping fits is left out.
"""

import math
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from inspect import signature
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Env
from scipy.ndimage import uniform_filter1d

from curricle.arrays import FloatArray
from curricle.candidates.candidates import Judged, judged, same_up_to_homomorphism
from curricle.errors import MappingError, TaskError
from curricle.interop.gymnasium import with_names
from curricle.interop.tabulated_task import TabulatedTask
from curricle.learning.learners import QLearning
from curricle.learning.run import learn
from curricle.learning.shaping import QInitialisation
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.tasks.live import is_live
from curricle.tasks.mdp import tables
from curricle.tasks.start_states import GoalDistance, goal_distance, with_start
from curricle.transfer.aggregate import mean
from curricle.transfer.by_components import at_goal, by_alignment, by_name
from curricle.transfer.potential import combined_potential
from curricle.transfer.search import clears_bar, find_mappings
from curricle.transfer.transfer import Transfer

SECONDS = 10.0  # to find the states of the environment, and again to try its variants
BUDGETS: tuple[int, ...] = 10_000, 100_000, 1_000_000  # steps, tried until a task is learnt
LIVE = (20_000,)  # the same for a live task
FIRST, LOOKS = 2_000, 4  # steps and checkpoints by which a mapping is tried without tables
ROLLOUTS = GreedyEvaluation(episodes=2)  # of a live task
SCORED = 200_000  # pairs of the target up to which tables score the mappings of its variants
MOST_PAIRS = 10_000_000  # pairs up to which tables are dense, and what they learn scores mappings
SMALL = 4.0  # seconds to find the states of a variant that judge it where the target is live
GRID = ("row", "column")  # names of a state that is one number, row * columns + column
TRIED, CHECKS = 3, 20  # seeds and checkpoints of such a trial
QUICK = 3_000  # steps a second from which on a live task is tried
SMOOTH, NOISE = 5, 2.0  # its checkpoints in a mean; standard deviations that its return must gain
LEARNT = 0.9  # of the way from the random policy's return to the optimum
SOONER, MOST = 0.8, 3  # share of the target's steps that an easier variant may take; variants
NO_TASK = "seed|step|limit|fps|render|time|horizon|pixel|debug|path"
"""In names of arguments that change no task."""

Recipe = str | Callable[..., Env[Any, Any]]
"""What makes an environment: an id of the registry, or a function."""


class Fitting(NamedTuple):
    """The best mapping from the target to a variant, and its score in words."""

    mapping: Any
    how: str  # it was found
    regains: str
    worth: float = 0.0
    unmapped_value: float | None = None


class Variant(NamedTuple):
    """An environment with some arguments, and the steps in which it is learnt."""

    arguments: dict[str, Any]
    task: Any
    judgement: Judged | None  # of tables
    steps: float  # infinite where it is not learnt
    values: FloatArray | None  # (S, A) that a seed learnt
    mappings: dict[bool, Fitting]  # from the target, by whether states are read in rows


def learnt(
    arguments: dict[str, Any], task: Any, budgets: Sequence[int], *, has_goal: bool
) -> Variant:
    """Return a task with the steps after which Q-learning is nearly as good as it gets."""
    judgement, values, rollouts = None, None, ROLLOUTS if is_live(task) else None
    if not is_live(task):
        mdp = tables(task)
        judgement = judged(mdp, None if has_goal else np.ones(len(mdp.terminal), bool))
        budgets = () if judgement.refusal else budgets
    for budget in budgets:
        learning = learn(
            task, QLearning(), budget, seeds=TRIED, eval_freq=budget // CHECKS, evaluation=rollouts
        )
        values = None if learning.values is None else learning.values[0]
        curve = learning.greedy_return.mean(axis=0)
        if judgement is not None:
            low, high = judgement.random_return, judgement.optimum
        else:  # the best return that a few episodes show, if it is more than their noise
            low, curve = curve[0], uniform_filter1d(curve, SMOOTH)  # at first it acts at random
            high = curve.max()
            if high - low <= NOISE * float(np.diff(learning.greedy_return, axis=1).std()):
                continue
        near = curve >= low + LEARNT * (high - low)
        if near[-1] or (judgement is None and near.any()):  # in tables chance finds do not count
            steps = float(learning.steps[near.argmax()])
            return Variant(arguments, task, judgement, steps, values, {})
    return Variant(arguments, task, judgement, math.inf, values, {})


def near_the_goal(
    target: Variant, trial: Callable[[dict[str, Any], Any], Variant]
) -> tuple[int, Variant] | None:
    """Return the task with starts near its goal, and how near, if it is learnt sooner so."""
    if target.judgement is None or target.judgement.refusal:
        return None
    with suppress(TaskError):  # a task may have no goal
        start = target.judgement.mdp.start > 0
        far = int(goal_distance(target.task)[start].max())
        near = trial({}, with_start(target.task, GoalDistance(1, max(1, far // 3))))
        if far > 1 and 0 < near.steps <= SOONER * target.steps and near.steps < math.inf:
            return max(1, far // 3), near
    return None


class Easier(NamedTuple):
    """Variants that are learnt sooner and that the target can read."""

    variants: list[Variant]
    rows: bool  # whether all states are read in rows and columns
    unread: list[Variant]  # that no mapping fits


def easier(
    target: Variant,
    make: Callable[[dict[str, Any], float], Any],
    others: Iterator[dict[str, Any]],
    trial: Callable[[dict[str, Any], Any], Variant],
) -> Easier:
    """Return the variants that are learnt sooner."""
    kept, unread, ends = list[Variant](), list[Variant](), time.perf_counter() + SECONDS
    views = {False: target.task, True: in_rows(target.task)}
    views = {rows: task for rows, task in views.items() if task is not None}

    def readable(rows: bool) -> list[Variant]:
        return [variant for variant in kept if rows in variant.mappings]

    for arguments in others:
        seconds = ends - time.perf_counter()
        if seconds <= 0 or max(len(readable(rows)) for rows in views) == MOST:
            break
        try:
            variant = trial(arguments, make(arguments, seconds))
            sooner = 0 < variant.steps < math.inf and variant.steps <= SOONER * target.steps
            if not sooner or any(_same(variant, other) for other in (target, *kept, *unread)):
                continue
            for rows, task in views.items():
                source = in_rows(variant.task) if rows else variant.task
                if source is not None:
                    with suppress(MappingError):
                        variant.mappings[rows] = mapped(task, source, variant)
        except Exception:  # a constructor may refuse arguments in any way
            continue
        (kept if variant.mappings else unread).append(variant)
    rows = max(views, key=lambda rows: (len(readable(rows)), _worth(readable(rows), rows)))
    return Easier(readable(rows), rows, unread)


def _worth(variants: Sequence[Variant], rows: bool) -> float:
    """Return the summed worth of the mappings of variants."""
    return sum(variant.mappings[rows].worth for variant in variants)


def mapped(target: Any, source: Any, variant: Variant) -> Fitting:
    """Return the best mapping by components from a target to a variant as `source` shows it.

    MappingError if no mapping fits.
    """
    live = is_live(target) or is_live(source)
    if live or target.states.size * target.actions.size > SCORED:
        return _by_returns(target, source, variant)
    searches = by_name, by_alignment, at_goal
    candidates = find_mappings(target, source, searches=searches, keep=1)
    if not len(candidates) or not clears_bar(candidates[0].scores):
        raise MappingError("no mapping by components clears the bar")
    found = candidates[0]
    everywhere, where_mapped = (
        f"{round(100 * share)} %"
        for share in (found.scores.regained, found.scores.regained_where_known)
    )
    part = f" ({where_mapped} where it maps)" * (where_mapped != everywhere)
    regains = f"regains {everywhere} of the way to the optimum{part}"
    return Fitting(found.mapping, found.how, regains, found.scores.worth, found.unmapped_value)


def _by_returns(target: Any, source: Any, variant: Variant) -> Fitting:
    """Return the mapping whose potential gains most in a target's first steps, in all seeds."""
    if target.states.size * target.actions.size > MOST_PAIRS:
        raise MappingError("its table would not be dense")
    ends, values = time.perf_counter() + SECONDS, variant.values
    if values is None or values.shape != (source.states.size, source.actions.size):
        values = learn(source, QLearning(), LIVE[0], evaluation=ROLLOUTS).values[0]

    pair: Any = SimpleNamespace(target=target, source=source)  # searches read components alone
    proposals = [*by_name(pair)]
    with suppress(MappingError):
        proposals += by_alignment(pair)
    different = {of.mapping.index.tobytes(): of for of in proposals[::-1]}  # the plainest of equals
    best: Fitting | None = None
    for mapping, how in different.values():
        if (mapping.index < 0).all() or (best and time.perf_counter() > ends):
            continue
        edges = [Transfer("source", "target", mapping)]
        phi = combined_potential(target, edges, [values], mean)
        gains = _first_returns(target, QInitialisation(phi)) - _unshaped_returns(target)
        gain = float(gains.mean())
        if (gains > 0).all() and (best is None or gain > best.worth):
            regains = f"adds {gain:.3g} to the mean return of its first {FIRST:,} steps"
            best = Fitting(mapping, how, f"{regains}, in each of {TRIED} seeds", gain)
    if best is None:
        raise MappingError("no mapping by components adds to the return of every seed")
    return best


def _first_returns(target: Any, shaping: QInitialisation | None) -> FloatArray:
    """Return the mean return of each seed in a target's first steps."""
    how: Any = {"evaluation": ROLLOUTS, "shaping": shaping, "eval_freq": FIRST // LOOKS}
    learning = learn(target, QLearning(), FIRST, seeds=TRIED, **how)
    return np.asarray(learning.greedy_return.mean(axis=1))


@lru_cache(maxsize=1)  # all variants of a target are compared with it
def _unshaped_returns(target: Any) -> FloatArray:
    return _first_returns(target, None)


def in_rows(task: Any) -> Any:
    """Return a tabulated task whose states, one number each, are rows and columns; or None.

    The width is the commonest change of the number by more than 1 in a step.
    """
    number, *more = task.states.components
    if not isinstance(task, TabulatedTask) or more or number.low < 0:
        return None
    if number.labels is not None or number.arbitrary:
        return None
    mdp, (values,) = task.mdp, task.states.decode().values()
    rows = mdp.outcome_row[~mdp.terminal]
    moves = abs(values[mdp.next_state[rows]] - values[~mdp.terminal][:, None, None])
    counts = Counter(moves[mdp.probability[rows] > 0].tolist())
    width = max((move for move in counts if move > 1), key=lambda move: counts[move], default=0)
    if not counts[1] or not 1 < width <= number.high:
        return None
    states = with_names(task.states, GRID, (number.high // width + 1, width))
    return replace(task, mdp=replace(mdp, states=states))


def _same(variant: Variant, other: Variant) -> bool:
    if variant.judgement is None or other.judgement is None:
        return variant.steps == other.steps  # with equal seeds
    return same_up_to_homomorphism(variant.judgement, other.judgement)


def arguments_of(recipe: Recipe, env: Env[Any, Any]) -> Iterator[dict[str, Any]]:
    """Yield other arguments of a constructor: flipped, halved, fewer by one, without chance."""
    stated = {} if callable(recipe) or env.spec is None else env.spec.kwargs
    parameters = signature(recipe if callable(recipe) else type(env.unwrapped)).parameters
    values = {name: stated.get(name, parameter.default) for name, parameter in parameters.items()}
    values = {name: x for name, x in values.items() if not re.search(NO_TASK, name.lower())}
    others = {name: _others(value) for name, value in values.items()}
    for turn in range(max(map(len, others.values()), default=0)):
        yield from ({name: some[turn]} for name, some in others.items() if turn < len(some))
    halved = {name: x // 2 for name, x in values.items() if type(x) is int and x >= 4}
    if len(halved) > 1:  # else it was yielded above
        yield halved


def _others(value: object) -> list[Any]:
    """Return the values in place of an argument's that may make an easier task."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int) and value > 0:
        return [*dict.fromkeys((value // 2, value - max(1, value // 4), value - 1))]
    if isinstance(value, float) and value > 0:
        return [0.0, 1.0] if value < 1 else [value / 2]
    if isinstance(value, tuple | list) and all(type(x) is int and x > 1 for x in value):
        return [[x // 2 for x in value]] * bool(value)
    return []
