"""A study of an environment: how it is learnt, what its numbers are called, and easier variants.

The environment is played a little, its states are searched for a few seconds, and easier variants
that its constructor's arguments make become sources.
"""

import json
import math
import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from inspect import signature
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary, MultiDiscrete, Space
from jinja2 import Environment, PackageLoader, StrictUndefined

from curricle.curriculum.curriculum import SOURCES_SHARE
from curricle.deep.learner import LEAST_SIDE, is_picture
from curricle.errors import ConfigError, TaskError
from curricle.interop.discrete import is_discrete, space_of
from curricle.interop.encoders import Bins, WholeNumbers
from curricle.interop.gymnasium import from_gymnasium, has_table, names_of, opened
from curricle.interop.play import EPISODES, PLAYED, Play
from curricle.interop.search import MORE_RESETS, time_limit_of
from curricle.interop.states import DeepCopy
from curricle.interop.tabulation import tabulate
from curricle.study.templates.variants import (
    BUDGETS,
    GRID,
    LIVE,
    MOST_PAIRS,
    QUICK,
    SECONDS,
    SMALL,
    TRIED,
    Easier,
    Fitting,
    Recipe,
    Variant,
    arguments_of,
    easier,
    in_rows,
    learnt,
    near_the_goal,
)
from curricle.study_file.file import toml_value
from curricle.study_file.own_code import users_code
from curricle.tasks.live import is_live
from curricle.tasks.minigrid_view import is_minigrid
from curricle.tasks.observation_task import EnvironmentMaker
from curricle.text import counted

DISCOUNT = 0.99
VAST = 100_000  # states of a live task, of which a trial meets few
MOST_STEPS, LEAST_STEPS = 30_000, 2_000  # of a network
MOST_EVALUATED = 20  # episodes of a checkpoint of a network
SECONDS_A_SEED = 16.0  # that a network may take
SECONDS_A_STEP = {False: 5e-4, True: 1e-2}  # of its learning, by whether it sees pictures
# Settings with which networks learn in so few steps; those of Stable-Baselines3 are for a million.
OF_DQN: dict[str, Any] = {"learning_rate": 1e-3, "batch_size": 64, "target_update_interval": 500}
OF_DQN |= {"exploration_fraction": 0.3}
OF_PPO: dict[str, Any] = {"n_envs": 4, "learning_rate": 1e-3, "normalize": True}
LIMIT = 500  # time limit of an environment that has none
# Options of `tabulate` for random steps.
SAMPLED: dict[str, Any] = {"samples": 30, "seeds": (0, 1, 2, 3, 4)}
JUDGED = {"samples": 8}  # the same to judge a variant
NEAR = "near_the_goal"  # the source whose episodes start near the goal
RESETS, MOST_RESETS = 1 + MORE_RESETS, 288  # where these differ: at first, and while new ones come
BY_NETWORK = "learnt by a network, as it is not tabulated: "
NONE_FOUND = "no easier relative was found"
DRAWN = "two environments of the class differ under one seed, as its constructor draws numbers: "
ITS_SEED = "all tasks have seed = 0"
IN_RESET = "each seed and evaluation has a task of its own; draw them in reset, from self.np_random"


# -- How an environment becomes a task -------------------------------------------------------------


def _made(way: partial[Any], recipe: object, arguments: dict[str, Any], seconds: float) -> Any:
    """Return the task of a constructor's arguments; TaskError if it takes longer."""
    timed = {"max_seconds": seconds} if way.func is tabulate else {}
    return way(EnvironmentMaker(recipe, arguments), discount=DISCOUNT, **timed)


def _ways(env: Env[Any, Any], play: Play) -> list["partial[Any]"]:
    """Return the ways to make a task of an environment, first that of the surest table."""
    if has_table(env):
        return [partial(from_gymnasium)]
    options: dict[str, Any] = _limit(env, play.limit)
    if play.masks and play.told:
        options["action_masks"] = True
    discrete, encoder, names = is_discrete(env.observation_space), play.encoder(), play.names()
    plain = isinstance(env.observation_space, Box | Discrete | MultiDiscrete | MultiBinary)
    alike = DeepCopy(observed=names if plain and len(env.observation_space.shape or ()) < 2 else ())
    ways = list["partial[Any]"]()
    if play.counters:
        ways.append(partial(tabulate, **options, state=DeepCopy(play.counters)))
    ways.append(partial(tabulate, **options))
    if not is_minigrid(env):  # which shows a part of its state alone
        ways.append(partial(tabulate, **options, state=alike))
        ways.append(partial(tabulate, **options, state=alike, **SAMPLED))
    if discrete:
        space = space_of(env.observation_space, "state")
        named = (
            isinstance(env.observation_space, Dict)  # whose keys are names
            or names_of(env)[0]
            or len(names) != len(space.names)
        )
        if not named and names != [*space.names]:
            options["names"] = names
        ways.append(partial(from_gymnasium, **options))
    elif encoder is not None:
        ways.append(partial(from_gymnasium, **options, encode=encoder))
    return ways


def _limit(env: Env[Any, Any], limit: int | None) -> dict[str, int]:
    """Return the time limit that a study must state: none where the environment has one."""
    return {} if time_limit_of(env) or is_minigrid(env) else {"time_limit": limit or LIMIT}


def _by_observation(way: "partial[Any]") -> bool:
    """Return whether a way to a table takes states that look alike for one."""
    return getattr(way.keywords.get("state"), "observed", None) is not None


class Found(NamedTuple):
    """A task of an environment, None if no way makes one, the way, and the first refusal."""

    task: Any
    way: "partial[Any]"
    refusal: str

    @property
    def large(self) -> bool:
        """Whether its states were not found in time."""
        return "max_seconds" in self.refusal


def _searched(
    ways: Sequence["partial[Any]"], recipe: Recipe, play: Play, say: Callable[[str], object]
) -> Found:
    """Return the task of the first way that makes one."""
    refusal, seconds = "", SECONDS if play.whole else SMALL  # fractions seldom have few values
    alike = next((way for way in ways if _by_observation(way)), None)
    large = set[bool]()  # whether tables by all that the class keeps, or by observation, are so
    for way in ways:
        if way.func is tabulate:
            if _by_observation(way) in large:
                continue
            sampled = ", sampling steps" * ("samples" in way.keywords)
            observed = " by observation" * _by_observation(way)
            say(f"searching for its states{observed}{sampled} (at most {seconds:.0f} s)")
        try:
            task = _made(way, recipe, {}, seconds)
            ambiguous = way.func is tabulate and task.observations.ambiguous.any()
            if alike and way is not alike and ambiguous:
                with suppress(TaskError):  # what is not seen makes a difference
                    return Found(_made(alike, recipe, {}, seconds), alike, refusal)
            return Found(task, way, refusal)
        except TaskError as error:
            refusal = refusal if large else str(error)
            large |= {_by_observation(way)} if "max_seconds" in str(error) else set()
    return Found(None, ways[0], refusal)


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
        _check_actions(name, env.action_space)
    say(f"playing {EPISODES} episodes of random actions (at most {PLAYED:.0f} s)")
    play = Play(env)
    recipe, fixed, notes = _repeatable(recipe, play)

    def by_network(why: str) -> tuple[str, list[str]]:
        notes.append(BY_NETWORK + why)
        if play.masks and play.told:
            notes.append("the network is not told which actions are available, and tries all")
        keys = _limit(env, play.limit) | fixed
        return _of_network(name, recipe, env, notes, keys, play)

    if not is_discrete(env.action_space):
        return by_network("its actions are no whole numbers")
    ways = _ways(env, play)
    searched = _searched(ways, recipe, play, say)
    if searched.task is None:
        return by_network(_refused(searched, play))
    if not (is_live(searched.task) or has_table(env)):
        if searched.task.record.several:
            say(f"searching from more resets, which differ (at most {2 * SECONDS:.0f} s)")
        searched, more = _of_tables(searched, recipe, play)
        notes += more
    task, way, _ = searched
    live = is_live(task)
    budgets = LIVE * (play.speed >= QUICK) if live else BUDGETS
    if budgets:
        say(f"learning it with {TRIED} seeds (at most {budgets[-1]:,} steps each)")
    for has_goal in (True, False):  # a task without an end has none
        trial = partial(learnt, budgets=budgets, has_goal=has_goal)
        target = trial({}, task)
        if target.judgement is None or not target.judgement.refusal:
            break
    if live and target.steps == math.inf and task.states.size > VAST:
        few = f"few of its {task.states.size:,} states are met in {LIVE[0]:,} steps"
        return by_network(few + ", in which a table learnt nothing" * bool(budgets))
    if live:
        notes += _of_live(searched, play)
    if target.judgement is not None and target.judgement.refusal:
        notes.append(f"there is nothing to learn: {target.judgement.refusal}")
    arguments = list(arguments_of(recipe, env))
    say(f"trying {counted(len(arguments), 'variant')} (the last begins within {SECONDS:.0f} s)")

    def of_variant(arguments: dict[str, Any], variant: Any) -> Variant:
        """Return a variant learnt: a live one by its tables, where it is small enough for some."""
        if live and play.whole:
            way_to_tables = partial(ways[0], **({} if searched.large else JUDGED))
            with suppress(TaskError):
                tabulated = _made(way_to_tables, recipe, arguments, SMALL)
                judged = learnt(arguments, tabulated, BUDGETS, has_goal=True)
                return judged._replace(task=variant)
        return trial(arguments, variant)

    easy = easier(target, partial(_made, way, recipe), iter(arguments), of_variant)
    near = None if easy.variants else near_the_goal(target, trial)
    keys = _keys(way) | fixed
    most = max(budgets, default=LIVE[0])
    budget = _rounded_up(min(max(3 * target.steps, BUDGETS[0]), 2 * most))
    notes += _of_sources(target, easy, near, f"over {most:,}")
    filled: dict[str, Any] = {"live": live, "budget": budget, "checkpoints": 20}
    filled["sources"] = _sources(easy, near, budget, keys)
    vast = task.states.size * task.actions.size > MOST_PAIRS
    filled["sparse"] = live and vast and "action_masks" not in keys  # masks need dense tables
    filled["kind"] = "tabulated" if way.func is tabulate else "gymnasium"
    filled["keys"] = keys | _in_rows_keys(task, easy.rows)
    return _text(name, recipe, notes, filled), notes


def _repeatable(recipe: Recipe, play: Play) -> tuple[Recipe, dict[str, Any], list[str]]:
    """Return a recipe whose environments are alike, the keys that make them so, and notes."""
    fixed, notes = dict[str, Any](), list[str]()
    if not play.follows_seed:
        notes.append(
            "two resets with one seed and the same actions differ, so that results cannot be "
            "repeated: let reset call super().reset(seed=seed), and draw from self.np_random alone"
        )
    with opened(recipe, EnvironmentMaker(recipe)) as other:
        if play.follows_seed and not play.is_repeated_in(other):
            if callable(recipe) and "seed" in signature(recipe).parameters:
                fixed = {"arguments": {"seed": 0}}
                recipe = partial(recipe, seed=0)
            notes.append(DRAWN + (ITS_SEED if fixed else IN_RESET))
    if play.masks and not play.told:
        notes.append(
            "observations do not tell which actions are available: all count as available, and "
            "what the class makes of the others is learnt"
        )
    return recipe, fixed, notes


def _refused(searched: Found, play: Play) -> str:
    """Return why an environment has no tables."""
    if not play.whole:
        return "its observations are no whole numbers, nor few"
    ignored = f" and ignore = {json.dumps(play.counters)}" * bool(play.counters)
    longer = f'; type = "tabulated"{ignored} in a study searches for an hour'
    return searched.refusal + longer * searched.large


def _of_live(searched: Found, play: Play) -> list[str]:
    """Return sentences on a task that is live."""
    notes = [f"learnt live, by calling step, as it is not tabulated: {_refused(searched, play)}"]
    if "encode" in searched.way.keywords:
        ends = "ranges" if play.whole else "edges"
        notes.append(
            f"its numbers are sorted into {searched.task.states.size:,} states by the {ends} "
            "below, which are a guess; a network reads them as they are, but takes longer"
        )
    if searched.way.keywords.get("time_limit") == LIMIT != play.limit:
        notes.append(f"no limit of its episodes was seen: time_limit = {LIMIT} is a guess")
    return notes


def _of_tables(searched: Found, recipe: Recipe, play: Play) -> tuple[Found, list[str]]:
    """Return tables, from several resets if these differ and fit, and sentences on them."""
    task, way, _ = searched
    notes = [f"tabulated: {task.states.size:,} states, in {task.record.seconds:.1f} s"]
    if _by_observation(way):
        notes.append(
            "states that look alike are taken for one, whatever else the class keeps"
            + (": estimated" if "samples" in way.keywords else ", as each led alike in two tries")
        )
    elif "state" in way.keywords:
        named = " and ".join(map(repr, play.counters))
        notes.append(f"{named} counts steps and is no part of a state; time_limit ends episodes")
    if not task.record.several:
        return searched, notes
    resets, ends, more = RESETS, time.perf_counter() + SECONDS, True
    resets_seen = len(task.record.seeds)
    while more and resets <= MOST_RESETS and time.perf_counter() < ends:
        wider = partial(way, seeds=tuple(range(resets)))
        try:
            searched = Found(_made(wider, recipe, {}, SECONDS), wider, "")
        except TaskError:
            break
        more, resets_seen = searched.task.states.size > task.states.size, resets
        task, resets = searched.task, 2 * resets
    starts = counted(int(np.count_nonzero(task.mdp.start)), "start")
    others = "there may be others" if more else "the last half of them brought no new state"
    notes.append(
        f"resets start in different states: {task.states.size:,} states from the {starts} of "
        f"{counted(resets_seen, 'reset')}; {others}; reset_seeds in a task names more"
    )
    return searched, notes


def _of_sources(
    target: Variant, easy: Easier, near: tuple[int, Variant] | None, unlearnt: str
) -> list[str]:
    """Return a sentence on each easier variant, or one that none was found."""
    before = f"{target.steps:,.0f}" if target.steps < math.inf else unlearnt
    size, notes = target.task.states.size, list[str]()
    for variant in easy.variants:
        of_variant = variant.task.states.size
        states = f"{of_variant:,} states" + f" instead of {size:,}" * (of_variant < size)
        steps = f"learnt in {variant.steps:,.0f} steps instead of {before}"
        regains = variant.mappings[easy.rows].regains
        arguments = toml_value(variant.arguments)[2:-2]
        notes.append(f"easier with {arguments}: {states}, {steps}; its mapping {regains}")
    if easy.unread:
        arguments = " or ".join(toml_value(variant.arguments)[2:-2] for variant in easy.unread)
        notes.append(f"also easier, but no mapping by components fits: {arguments}")
    if near is not None:
        high, variant = near
        steps = f"learnt in {variant.steps:,.0f} steps instead of {before}"
        notes.append(f"easier with starts at most {counted(high, 'step')} from the goal: {steps}")
    if not easy.variants and near is None:
        notes.append(f"{NONE_FOUND}: the study compares learners without one")
    return notes


def _label(variant: Variant) -> str:
    """Return a variant's name in a file."""
    parts = (f"{argument}_{value}" for argument, value in variant.arguments.items())
    return re.sub(r"[^\w-]", "_", "_".join(parts))


def _sources(
    easy: Easier, near: tuple[int, Variant] | None, budget: int, keys: dict[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return what the file says of each source, by its name."""
    if near is not None:
        high, variant = near
        return {NEAR: _source(variant, budget, keys | {"start_states": {"distance": [1, high]}})}
    return {_label(of): _source(of, budget, keys, easy.rows) for of in easy.variants}


def _source(
    variant: Variant, budget: int, keys: dict[str, Any], rows: bool | None = None
) -> dict[str, Any]:
    """Return what the file says of a source: its keys, its budget if stated, and its transfer."""
    needs_more = variant.steps > SOURCES_SHARE * budget
    source: dict[str, Any] = {"budget": _rounded_up(variant.steps) if needs_more else None}
    if rows is None:  # other starts of the target
        return source | {
            "keys": keys,
            "transfer": {"mapping": "identity"},
            "why": "the same states",
        }
    fits = variant.mappings[rows]
    arguments = keys.get("arguments", {}) | variant.arguments
    written = keys | _in_rows_keys(variant.task, rows) | {"arguments": arguments}
    why = f"{fits.how}: {fits.regains}"
    return source | {"keys": written, "transfer": _transfer(fits), "why": why}


def _in_rows_keys(task: Any, rows: bool) -> dict[str, Any]:
    """Return the keys that split a state which is one number, if states are read in rows."""
    return {"names": GRID, "sizes": in_rows(task).states.shape} if rows else {}


def _keys(way: "partial[Any]") -> dict[str, Any]:
    """Return the options of a way as the keys of a study file."""
    keys = dict[str, Any]()
    for option, value in way.keywords.items():
        if isinstance(value, Bins | WholeNumbers):
            sorts = {"edges": value.edges} if isinstance(value, Bins) else {"ranges": value.ranges}
            keys[option] = {"type": type(value).__name__} | sorts
        elif isinstance(value, DeepCopy):
            observed = {} if value.observed is None else {"observed": value.observed}
            keys |= observed or {"ignore": value.ignore}
        elif option == "seeds":
            keys["reset_seeds"] = f"0-{len(value) - 1}"
        else:
            keys[option] = value
    return keys


def _transfer(fits: Fitting) -> dict[str, Any]:
    """Return the keys of a transfer with a mapping by components."""
    mapping = fits.mapping
    names = mapping.source.states.names  # written out, as a file's reader may want to change them
    keys = {"project": dict(zip(names, names, strict=True)), "aligned": mapping.aligned or None}
    keys["unequal"] = None if mapping.unequal == "unmapped" else mapping.unequal
    value = fits.unmapped_value
    keys["unmapped_value"] = None if value is None else float(f"{value:.3g}")
    return {key: value for key, value in keys.items() if value is not None}


def _rounded_up(steps: float) -> int:
    """Return steps rounded up to one digit and zeros."""
    return math.ceil(steps / (unit := _unit(steps))) * unit


def _unit(steps: float) -> int:
    """Return the largest power of ten that is at most `steps`."""
    return int(10.0 ** int(math.log10(steps)))


def _of_network(
    name: str,
    recipe: Recipe,
    env: Env[Any, Any],
    notes: list[str],
    keys: dict[str, Any],
    play: Play,
) -> tuple[str, list[str]]:
    """Return a study that a network learns."""
    observed, acting = env.observation_space, env.action_space
    _check_actions(name, acting)
    parts: Any = [*observed.spaces.values()] if isinstance(observed, Dict) else [observed]
    # The shorter side of each picture, as the least are its channels.
    sides = [sorted(part.shape)[1] for part in parts if is_picture(part)]
    view = {"encode": "MiniGridView"} if is_minigrid(env) else {}  # else its mission is a text
    if isinstance(observed, Dict) and not view and min(sides, default=LEAST_SIDE) < LEAST_SIDE:
        view = {"encode": "gymnasium.wrappers:FlattenObservation"}  # no convolution reads them
    pictures = not view and max(sides, default=0) >= LEAST_SIDE
    policy = "CnnPolicy" if pictures else "MlpPolicy"
    policy = "MultiInputPolicy" if isinstance(observed, Dict) and not view else policy
    world: Any = env.unwrapped
    stated = world.max_steps if is_minigrid(env) else None
    longest = time_limit_of(env, stated) or keys.get("time_limit") or LIMIT
    most = int(SECONDS_A_SEED / (SECONDS_A_STEP[pictures] + 2 * play.seconds_a_step))
    budget = min(max(most, LEAST_STEPS), MOST_STEPS)
    budget -= budget % _unit(budget)
    checkpoints = min(max(budget // longest, 2), 10)
    # Evaluation takes about as many steps as learning, or two episodes if these are longer. Where
    # random episodes are short it takes a quarter, and three times as many if learnt ones are long.
    lengths = longest, 4 * play.usual_steps
    long, short = (int(budget / (checkpoints * steps)) for steps in lengths)
    episodes = max(1, min(long, 5), min(short, 3 * long, MOST_EVALUATED))
    notes.append(
        f"no easier relative was tried, as networks take long; {budget:,} steps are what minutes "
        "allow, and may be too few to learn anything"
    )
    ppo = OF_PPO | {"n_steps": 128 if budget >= 5 * LEAST_STEPS else 32}
    ppo |= {"normalize": {"norm_obs": False}} if pictures else {}
    if isinstance(acting, Discrete):
        algorithm, settings = "DQN", OF_DQN | {"learning_starts": budget // 30}
        other = {"PPO": {"algorithm": "PPO", "settings": ppo}}
    elif isinstance(acting, Box):
        algorithm, settings = "PPO", ppo | {"use_sde": True}
        other = {"with plain noise": {"settings": {"use_sde": False}}}
    else:
        algorithm, settings = "PPO", ppo
        other = {"A2C": {"algorithm": "A2C", "settings": {"normalize": ppo["normalize"]}}}
    network = {"algorithm": algorithm, "policy": policy, "settings": settings, "other": other}
    filled = {"kind": "observation_task", "keys": keys | view, "live": True, "network": network}
    filled |= {"budget": budget, "checkpoints": checkpoints, "episodes": episodes}
    return _text(name, recipe, notes, filled | {"sources": {}, "sparse": False}), notes


def _check_actions(name: str, acting: Space[Any]) -> None:
    """Raise ConfigError unless networks can learn which actions to take."""
    if not isinstance(acting, Box | Discrete | MultiDiscrete | MultiBinary):
        raise ConfigError(
            f"actions must be numbered, or boxes of numbers, to be learnt: those of {name} are "
            f"{acting}; let step take a number that says which action is meant"
        )


def _text(name: str, recipe: object, notes: list[str], filled: dict[str, Any]) -> str:
    """Return the file of a study; the template has names for what is `filled` in."""
    environment = Environment(
        loader=PackageLoader("curricle.study", "templates"), undefined=StrictUndefined,
        trim_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    comment = partial(fill, width=98, initial_indent="# ", subsequent_indent="#   ")
    environment.filters |= {"json": toml_value, "comment": comment}
    template = environment.get_template("environment.txt", globals={"discount": DISCOUNT})
    filled = {"name": name, "own": callable(recipe), "notes": notes, "network": None, **filled}
    return template.render(filled)
