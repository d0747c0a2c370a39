"""A study of an environment: how it is learnt, what its numbers are called, and easier variants.

The environment is played a little, its states are searched for a few seconds, and variants that its
constructor's arguments make are learnt: those are easier that take fewer steps. Tables of both
score the mappings from the target to a variant; a variant that no mapping fits is left out.
"""

import json
import math
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from functools import partial
from inspect import signature
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Dict, Discrete
from jinja2 import Environment, PackageLoader, StrictUndefined
from scipy.ndimage import uniform_filter1d

from curricle.candidates.candidates import Judged, judged, same_up_to_homomorphism
from curricle.comparison.opponents import visited_states
from curricle.curriculum.curriculum import SOURCES_SHARE
from curricle.errors import ConfigError, MappingError, TaskError
from curricle.interop.gymnasium import (
    actions_of,
    from_gymnasium,
    has_table,
    is_discrete,
    names_of,
    opened,
    space_of,
    with_names,
)
from curricle.interop.minigrid import is_minigrid
from curricle.interop.states import (
    MORE_RESETS,
    DeepCopy,
    Words,
    counters_of,
    time_limit_of,
    words_of_state,
)
from curricle.interop.tabulated_task import TabulatedTask, parts_of, same_observation
from curricle.interop.tabulation import tabulate
from curricle.learning.learners import QLearning
from curricle.learning.run import learn
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.study_file.own_code import users_code
from curricle.tasks.live import action_mask, checked_parts, is_live, seeded_reset
from curricle.tasks.mdp import tables
from curricle.tasks.observation_task import EnvironmentMaker, check_observation
from curricle.tasks.start_states import GoalDistance, goal_distance, with_start
from curricle.text import counted
from curricle.transfer.by_components import at_goal, by_alignment, by_name, project
from curricle.transfer.search import FoundMapping, clears_bar, find_mappings

DISCOUNT = 0.99
LIMIT = 500  # time limit of an environment that has none
SECONDS = 10.0  # to find the states of the environment, and again to try its variants
SMALL = 4.0  # to find the states of a variant by which it is judged, where the target is live
PLAYED, EPISODES, LONGEST = 2.0, 6, 1_000  # play: seconds, episodes, and steps of an episode
SAMPLED = {"samples": 30, "seeds": (0, 1, 2, 3, 4)}  # options of `tabulate` for random steps
JUDGED = {"samples": 8}  # the same to judge a variant
BUDGETS: tuple[int, ...] = 10_000, 100_000, 1_000_000  # steps, tried until a task is learnt
LIVE = (20_000,)  # the same for a live task
SCORED = 200_000  # pairs of the target up to which the mappings of its variants are scored
GRID = ("row", "column")  # names of a state that is one number, row * columns + column
NEAR = "near_the_goal"  # the source whose episodes start near the goal
TRIED, CHECKS = 3, 20  # seeds and checkpoints of such a trial
QUICK = 5_000  # steps a second from which on a live task is tried
SMOOTH, NOISE = 5, 2.0  # its checkpoints in a mean; standard deviations that its return must gain
LEARNT = 0.9  # of the way from the random policy's return to the optimum
SOONER, MOST = 0.8, 3  # share of the target's steps that an easier variant may take; variants
KEYS = {"state": "ignore", "seeds": "reset_seeds"}  # of a study file, for options of functions
RESETS = tuple(range(1 + MORE_RESETS))  # seeds of the resets where these differ
LIMITS = "steps|limit|horizon|length"  # in names of attributes that say how long episodes are
NOT_SCORED = "a guess: components of the same name correspond, which is not scored"
NONE_FOUND = "no easier relative was found"
NO_TASK = "seed|step|limit|fps|render|time|horizon|pixel|debug|path"
"""In names of arguments that change no task."""


Recipe = str | Callable[..., Env[Any, Any]]
"""What makes an environment: an id of the registry, or a function."""


class Play:
    """What a few episodes of random actions show of an environment."""

    def __init__(self, env: Env[Any, Any]):
        self.env, self.masks = env, False
        self.points, self.attributes = list[list[Any]](), list[Words]()  # points: of observations
        self.times, self.cuts = list[int](), list[int]()  # steps since the reset; at a truncation
        self.act, self.actions = actions_of(env.action_space, None, None)
        began = time.perf_counter()
        first, *_, again = [self._episode(seed, began + PLAYED) for seed in (*range(EPISODES), 0)]
        self.follows_seed = all(map(same_observation, first, again))
        self.speed = len(self.times) / (time.perf_counter() - began)  # steps a second

    def _episode(self, seed: int, ends: float) -> list[Any]:
        """Play an episode; TaskError where its steps or reset are not Gymnasium's."""
        env, rng, states = self.env, np.random.default_rng(seed), list[Any]()
        over = cut = False
        observed, info = checked_parts("reset", seeded_reset(env, seed))
        check_observation(env.observation_space, observed)
        self.masks = "action_mask" in info or env.has_wrapper_attr("action_masks")
        while True:
            leaves = [np.ravel(leaf).tolist() for leaf in parts_of(observed).values()]
            self.points.append([x for leaf in leaves for x in leaf])
            self.attributes.append(words_of_state(vars(env.unwrapped)))
            self.times.append(len(states))
            states.append(deepcopy(observed))
            if over or cut or len(states) > LONGEST or time.perf_counter() > ends:
                self.cuts += [len(states) - 1] * bool(cut)
                return states
            n = self.actions.size
            allowed = np.flatnonzero(action_mask(env, info, n)) if self.masks else n
            action = self.act(int(rng.choice(allowed)))
            observed, _, over, cut, info = checked_parts("step", env.step(action))
            if len(states) == 1:
                check_observation(env.observation_space, observed)

    @property
    def whole(self) -> bool:
        """Whether the numbers in observations are whole, as far as was seen."""
        return all(x % 1 == 0 for point in self.points for x in point if isinstance(x, float))

    @property
    def counters(self) -> list[str]:
        """Attributes that grow by one with every step."""
        later = np.flatnonzero(self.times)
        if is_minigrid(self.env):
            return []
        return counters_of(self.attributes, later - 1, later, self.env)

    @property
    def limit(self) -> int | None:
        """Steps after which episodes end whatever is done, None if unknown."""
        counters, first = self.counters, self.attributes[0]
        named = {name for name in first if counters and re.search(LIMITS, name.lower())}
        stated = [first[name] for name in named - {*counters}]
        cut = min(self.cuts, default=None)
        if counters and not (self.cuts or self.masks):
            cut = self._cut_ahead(counters)
        return cut or min((x for x in stated if type(x) is int and x > 1), default=None)

    def _cut_ahead(self, counters: list[str]) -> int | None:
        """Return at which step it truncates, seen by setting its counters ahead; None if unseen."""
        ends = time.perf_counter() + PLAYED
        with suppress(Exception):  # so late a step may be outside of what the class foresees
            for n in range(1, LONGEST + 1):
                seeded_reset(self.env, 0)
                for name in counters:
                    setattr(self.env.unwrapped, name, int(self.attributes[0][name]) + n - 1)
                cut = self.env.step(self.act(0))[3]
                if cut or time.perf_counter() > ends:
                    return n if cut else None
        return None

    def names(self) -> list[str]:
        """Return the attributes that the numbers in observations show, ``state_1`` if unknown."""
        names = list[str]()
        for i, column in enumerate(zip(*self.points, strict=False), start=1):
            shown = [
                name
                for name in self.attributes[0]
                if [values.get(name) for values in self.attributes] == [*column]
            ]
            sure = [name.lstrip("_") for name in shown if len(set(column)) > 1 or len(shown) == 1]
            names.append(next((name for name in sure if name not in names), f"state_{i}"))
        return names


# -- How an environment becomes a task, and how soon it is learnt ----------------------------------


def _made(way: partial[Any], recipe: object, arguments: dict[str, Any], seconds: float) -> Any:
    """Return the task of a constructor's arguments; TaskError if it takes longer."""
    timed = {"max_seconds": seconds} if way.func is tabulate else {}
    return way(EnvironmentMaker(recipe, arguments), discount=DISCOUNT, **timed)


class Variant(NamedTuple):
    """An environment with some arguments, and the steps in which it is learnt."""

    arguments: dict[str, Any]
    task: Any
    judgement: Judged | None  # of tables
    steps: float  # infinite where it is not learnt
    # The best mapping from the target, by whether states are read in rows; None where unscored.
    mappings: dict[bool, FoundMapping | None]


def _variant(
    arguments: dict[str, Any], task: Any, budgets: Sequence[int], *, has_goal: bool
) -> Variant:
    """Return a task with the steps after which Q-learning is nearly as good as it gets."""
    judgement, rollouts = None, GreedyEvaluation(episodes=2) if is_live(task) else None
    if not is_live(task):
        mdp = tables(task)
        judgement = judged(mdp, None if has_goal else np.ones(len(mdp.terminal), bool))
        budgets = () if judgement.refusal else budgets
    for budget in budgets:
        learning = learn(
            task, QLearning(), budget, seeds=TRIED, eval_freq=budget // CHECKS, evaluation=rollouts
        )
        curve = learning.greedy_return.mean(axis=0)
        if judgement is not None:
            low, high = judgement.random_return, judgement.optimum
        else:  # the best return that a few episodes show, if it is more than their noise
            curve = uniform_filter1d(curve, SMOOTH)
            low, high = curve[0], curve.max()
            if high - low <= NOISE * float(np.diff(learning.greedy_return, axis=1).std()):
                continue
        near = curve >= low + LEARNT * (high - low)
        if near[-1] or (judgement is None and near.any()):  # in tables chance finds do not count
            return Variant(arguments, task, judgement, float(learning.steps[near.argmax()]), {})
    return Variant(arguments, task, judgement, math.inf, {})


def _judged_in_tables(
    tabulated: Callable[[dict[str, Any], float], Any],
    in_tables: Callable[[dict[str, Any], Any], Variant],
    live: Callable[[dict[str, Any], Any], Variant],
    arguments: dict[str, Any],
    task: Any,
) -> Variant:
    """Return a live variant, judged by its tables where it is small enough to have some."""
    with suppress(TaskError):
        return in_tables(arguments, tabulated(arguments, SMALL))._replace(task=task)
    return live(arguments, task)


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


def easier(
    target: Variant,
    make: Callable[[dict[str, Any], float], Any],
    others: Iterator[dict[str, Any]],
    trial: Callable[[dict[str, Any], Any], Variant],
) -> tuple[list[Variant], bool, list[Variant]]:
    """Return variants that are learnt sooner and that the target can read.

    Also whether all states are read in rows and columns, and the variants that no mapping fits.
    """
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
                        variant.mappings[rows] = mapped(task, source)
        except Exception:  # a constructor may refuse arguments in any way
            continue
        (kept if variant.mappings else unread).append(variant)
    rows = max(views, key=lambda rows: (len(readable(rows)), _worth(readable(rows), rows)))
    return readable(rows), rows, unread


def _worth(variants: Sequence[Variant], rows: bool) -> float:
    """Return the summed worth of the mappings of variants; 0 where they are unscored."""
    mappings = (variant.mappings[rows] for variant in variants)
    return sum(mapping.scores.worth for mapping in mappings if mapping)


def mapped(target: Any, source: Any) -> FoundMapping | None:
    """Return the best mapping by components, None for that by name of tasks without tables.

    MappingError if no mapping fits.
    """
    scored = not (is_live(target) or is_live(source))
    if scored and target.states.size * target.actions.size <= SCORED:
        searches = by_name, by_alignment, at_goal
        candidates = find_mappings(target, source, searches=searches, keep=1)
        if not len(candidates) or not clears_bar(candidates[0].scores):
            raise MappingError("no mapping by components clears the bar")
        return candidates[0]
    if not project(target, source).mapped_states()[visited_states(target, dense=True)].any():
        raise MappingError("no state that is visited is mapped")
    return None


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


def _arguments(recipe: Recipe, env: Env[Any, Any]) -> Iterator[dict[str, Any]]:
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
    return [0.0, 1.0] if isinstance(value, float) and 0 < value < 1 else []


# -- The file --------------------------------------------------------------------------------------


def environment_study(
    name: str, recipe: Recipe, say: Callable[[str], object] = lambda _: None
) -> tuple[str, list[str]]:
    """Return a study of an environment, and sentences on what was seen of it.

    `say` is called with each step before it begins, and the longest that it may take.
    """
    try:
        with users_code(name), opened(recipe, EnvironmentMaker(recipe)) as env:
            return _study(name, recipe, env, say)
    except ConfigError as error:
        hint = "; give its arguments defaults, or name a function without arguments that makes it"
        raise ConfigError(f"{error}{hint * ('required positional' in str(error))}") from None


def _study(
    name: str, recipe: Recipe, env: Env[Any, Any], say: Callable[[str], object]
) -> tuple[str, list[str]]:
    if not is_discrete(env.action_space):
        return _of_network(name, recipe, env, [], "its actions are no whole numbers")
    say(f"playing {EPISODES} episodes of random actions (at most {PLAYED:.0f} s)")
    play, notes = Play(env), list[str]()
    if not play.follows_seed:
        notes.append(
            "two resets with one seed and the same actions differ, so that results cannot be "
            "repeated: let reset call super().reset(seed=seed), and draw from self.np_random alone"
        )
    ways, began = _ways(env, play), time.time()
    task, way, refusal = _searched(ways, recipe, say)
    refusal = refusal if play.whole else "its observations are no whole numbers"
    large = "max_seconds" in refusal
    if large:
        ignored = f" and ignore = {json.dumps(play.counters)}" * bool(play.counters)
        refusal += f'; type = "tabulated"{ignored} in a study searches for an hour'
    if task is None:
        return _of_network(name, recipe, env, notes, refusal)
    live, budgets = is_live(task), BUDGETS
    if live:
        budgets = LIVE * (play.speed >= QUICK)
        notes.append(f"learnt live, by calling step, as it is not tabulated: {refusal}")
        if way.keywords.get("time_limit") == LIMIT != play.limit:
            notes.append(f"no limit of its episodes was seen: time_limit = {LIMIT} is a guess")
    elif not has_table(env):
        took = time.time() - began
        notes.append(f"tabulated: {task.states.size:,} states, in {took:.1f} s")
        if "state" in way.keywords:
            named = " and ".join(map(repr, play.counters))
            notes.append(
                f"{named} counts steps and is no part of a state; time_limit ends episodes"
            )
        if task.record.several:
            say(f"searching from {len(RESETS)} resets, which differ (at most {SECONDS:.0f} s)")
            way, task, note = _of_several_resets(way, task, recipe)
            notes.append(note)
    if budgets:
        say(f"learning it with {TRIED} seeds (at most {budgets[-1]:,} steps each)")
    for has_goal in (True, False):  # a task without an end has none
        trial = partial(_variant, budgets=budgets, has_goal=has_goal)
        target = trial({}, task)
        if target.judgement is None or not target.judgement.refusal:
            break
    if target.judgement is not None and target.judgement.refusal:
        notes.append(f"there is nothing to learn: {target.judgement.refusal}")
    make, all_arguments = partial(_made, way, recipe), list(_arguments(recipe, env))
    say(f"trying {counted(len(all_arguments), 'variant')} (the last begins within {SECONDS:.0f} s)")
    of_variant = trial
    if live:
        in_tables = partial(_variant, budgets=BUDGETS, has_goal=True)
        tabulated = partial(_made, partial(ways[0], **({} if large else JUDGED)), recipe)
        of_variant = partial(_judged_in_tables, tabulated, in_tables, trial)
    variants, rows, unread = easier(target, make, iter(all_arguments), of_variant)
    near = None if variants else near_the_goal(target, trial)
    keys = {KEYS.get(key, key): getattr(x, "ignore", x) for key, x in way.keywords.items()}
    most = max(budgets, default=LIVE[0])
    budget = _rounded_up(min(max(3 * target.steps, BUDGETS[0]), 2 * most))
    before = f"{target.steps:,.0f}" if target.steps < math.inf else f"over {most:,}"
    sources = dict[str, dict[str, Any]]()
    for variant in variants:
        label = "_".join(f"{argument}_{value}" for argument, value in variant.arguments.items())
        written = keys | _in_rows_keys(variant.task, rows) | {"arguments": variant.arguments}
        mapping, arguments = variant.mappings[rows], _toml(variant.arguments)[2:-2]
        why = NOT_SCORED if mapping is None else f"{mapping.how}: {_regains(mapping)}"
        sources[re.sub(r"[^\w-]", "_", label)] = _source(variant, budget, written, mapping, why)
        from_states = f" instead of {task.states.size:,}" * (
            variant.task.states.size < task.states.size
        )
        steps = f"learnt in {variant.steps:,.0f} steps instead of {before}"
        size = f"{variant.task.states.size:,} states{from_states}"
        regains = "" if mapping is None else f"; its mapping {_regains(mapping)}"
        notes.append(f"easier with {arguments}: {size}, {steps}{regains}")
    if unread:
        arguments = " or ".join(_toml(variant.arguments)[2:-2] for variant in unread)
        notes.append(f"also easier, but no mapping by components fits: {arguments}")
    if near is not None:
        high, variant = near
        written, why = keys | {"start_states": {"distance": [1, high]}}, "the same states"
        sources[NEAR] = _source(variant, budget, written, None, why)
        sources[NEAR]["transfer"] = {"mapping": "identity"}
        steps = f"learnt in {variant.steps:,.0f} steps instead of {before}"
        notes.append(f"easier with starts at most {counted(high, 'step')} from the goal: {steps}")
    if not sources:
        notes.append(f"{NONE_FOUND}: the study compares learners without one")
    kind = "tabulated" if way.func is tabulate else "gymnasium"
    filled = {"kind": kind, "live": live, "budget": budget, "sources": sources}
    filled |= {"keys": keys | _in_rows_keys(task, rows), "counters": play.counters}
    return _text(name, recipe, notes, filled), notes


def _source(
    variant: Variant, budget: int, keys: dict[str, Any], found: FoundMapping | None, why: str
) -> dict[str, Any]:
    """Return what the file says of a source: its keys, its budget if stated, and its transfer."""
    needs_more = variant.steps > SOURCES_SHARE * budget
    of_budget = _rounded_up(variant.steps) if needs_more else None
    return {"keys": keys, "budget": of_budget, "transfer": _transfer(found), "why": why}


def _searched(
    ways: Sequence["partial[Any]"], recipe: Recipe, say: Callable[[str], object]
) -> tuple[Any, Any, str]:
    """Return the task of the first way that makes one, or None, the way, and the first refusal."""
    refusal = ""
    for way in ways:
        if way.func is tabulate:
            sampled = ", sampling steps" * ("samples" in way.keywords)
            say(f"searching for its states{sampled} (at most {SECONDS:.0f} s)")
        try:
            return _made(way, recipe, {}, SECONDS), way, refusal
        except TaskError as error:
            refusal = refusal or str(error)
    return None, None, refusal


def _of_several_resets(way: "partial[Any]", task: Any, recipe: Recipe) -> tuple[Any, Any, str]:
    """Return the tables from several resets, if these fit, and what they hold of the starts."""
    several = f"{len(task.record.seeds)} of {len(RESETS)} starts seen, as resets start elsewhere"
    if "seeds" not in way.keywords:
        wider = partial(way, seeds=RESETS)
        with suppress(TaskError):
            task = _made(wider, recipe, {}, SECONDS)
            starts = counted(int(np.count_nonzero(task.mdp.start)), "start")
            note = f"{task.states.size:,} states from the {starts} of {len(RESETS)} resets"
            return wider, task, f"resets start in different states: {note}; there may be others"
    return way, task, f"{several}: the tables hold no other; reset_seeds in a task names more"


def _in_rows_keys(task: Any, rows: bool) -> dict[str, Any]:
    """Return the keys that split a state which is one number, if states are read in rows."""
    return {"names": GRID, "sizes": in_rows(task).states.shape} if rows else {}


def _regains(found: FoundMapping) -> str:
    """Return how good a mapping is, as text."""
    scores = found.scores
    everywhere, where_mapped = (
        f"{round(100 * share)} %" for share in (scores.regained, scores.regained_where_known)
    )
    part = f" ({where_mapped} where it maps)" * (where_mapped != everywhere)
    return f"regains {everywhere} of the way to the optimum{part}"


def _transfer(found: FoundMapping | None) -> dict[str, Any]:
    """Return the keys of a transfer with a mapping, by name where none was found."""
    if found is None:
        return {"project": {}}
    mapping: Any = found.mapping
    names = mapping.source.states.names  # written out, as a file's reader may want to change them
    keys = {"project": dict(zip(names, names, strict=True)), "aligned": mapping.aligned or None}
    keys["unequal"] = None if mapping.unequal == "unmapped" else mapping.unequal
    keys["unmapped_value"] = found.unmapped_value and float(f"{found.unmapped_value:.3g}")
    return {key: value for key, value in keys.items() if value is not None}


def _toml(value: object) -> str:
    """Return a value as TOML, a dict in one line."""
    if not isinstance(value, dict):
        return json.dumps(value)
    pairs = (
        f"{key if re.fullmatch(r'[A-Za-z0-9_-]+', key) else json.dumps(key)} = {_toml(part)}"
        for key, part in value.items()
    )
    return f"{{ {', '.join(pairs)} }}" if value else "{}"


def _ways(env: Env[Any, Any], play: Play) -> list["partial[Any]"]:
    """Return the ways to make a task of an environment, first that of the smallest table."""
    if has_table(env):
        return [partial(from_gymnasium)]
    options: dict[str, Any] = _limit(env, play.limit)
    if play.masks:
        options["action_masks"] = True
    ways, discrete = list["partial[Any]"](), is_discrete(env.observation_space)
    if play.whole:
        ways = [partial(tabulate, **options, state=DeepCopy(play.counters))] * bool(play.counters)
        ways.append(partial(tabulate, **options))
        ways += [partial(ways[0], **SAMPLED)] * (not discrete)
    if discrete:
        names, space = play.names(), space_of(env.observation_space, "state")
        named = (
            isinstance(env.observation_space, Dict)  # whose keys are names
            or names_of(env)[0]
            or len(names) != len(space.names)
        )
        if not named and names != [*space.names]:
            options["names"] = names
        ways.append(partial(from_gymnasium, **options))
    return ways


def _rounded_up(steps: float) -> int:
    """Return steps rounded up to one digit and zeros."""
    return math.ceil(steps / (unit := int(10.0 ** int(math.log10(steps))))) * unit


def _limit(env: Env[Any, Any], limit: int | None) -> dict[str, int]:
    """Return the time limit that a study must state: none where the environment has one."""
    return {} if time_limit_of(env) or is_minigrid(env) else {"time_limit": limit or LIMIT}


def _of_network(
    name: str, recipe: Recipe, env: Env[Any, Any], notes: list[str], why: str
) -> tuple[str, list[str]]:
    """Return a study that a network learns."""
    observed, acting = env.observation_space, env.action_space
    if not isinstance(acting, Box | Discrete):
        raise ConfigError(
            f"actions must be numbered, or boxes of numbers, to be learnt: those of {name} are "
            f"{acting}"
        )
    picture = isinstance(observed, Box) and len(observed.shape) == 3
    policy = "CnnPolicy" if picture else "MlpPolicy"
    policy = "MultiInputPolicy" if isinstance(observed, Dict) else policy
    algorithm = "PPO" if isinstance(acting, Box) else "DQN"
    notes = [*notes, f"learnt by a network, as it is not tabulated: {why}"]
    notes.append("no easier relative was tried, as networks take long")
    filled: dict[str, Any] = {"kind": "observation_task", "keys": _limit(env, None), "live": True}
    filled |= {"budget": 50_000, "sources": {}, "network": (algorithm, policy)}
    return _text(name, recipe, notes, filled), notes


def _text(name: str, recipe: object, notes: list[str], filled: dict[str, Any]) -> str:
    """Return the file of a study; the template has names for what is `filled` in."""
    environment = Environment(
        loader=PackageLoader("curricle.study", "templates"), undefined=StrictUndefined,
        trim_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    comment = partial(fill, width=98, initial_indent="# ", subsequent_indent="#   ")
    environment.filters |= {"json": _toml, "comment": comment}
    template = environment.get_template("environment.txt", globals={"discount": DISCOUNT})
    filled = {"name": name, "own": callable(recipe), "notes": notes, "network": None, **filled}
    return template.render(filled)
