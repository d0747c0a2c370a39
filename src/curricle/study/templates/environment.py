"""A study of an environment: how it is learnt, what its numbers are called, and easier variants.

The environment is played a little, its states are searched for a few seconds, and the variants that
its constructor's arguments make are tabulated and learnt: those are easier that take fewer steps.
"""

import json
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from inspect import signature
from textwrap import fill, indent
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box, Dict, Discrete
from scipy.ndimage import uniform_filter1d

from curricle.design.candidates import Judged, judged, same_up_to_homomorphism
from curricle.errors import ConfigError, TaskError
from curricle.interop.gymnasium import (
    actions_of,
    from_gymnasium,
    has_table,
    is_discrete,
    names_of,
    opened,
    space_of,
)
from curricle.interop.minigrid import is_minigrid
from curricle.interop.states import DeepCopy, time_limit_of, words_of_state
from curricle.interop.tabulated_task import parts_of, same_observation
from curricle.interop.tabulation import tabulate
from curricle.learning.learners import QLearning
from curricle.learning.run import learn
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.study_file.own_code import users_code
from curricle.tasks.live import action_mask, checked_parts, is_live, seeded_reset
from curricle.tasks.mdp import tables
from curricle.tasks.observation_task import EnvironmentMaker
from curricle.transfer.by_components import project

DISCOUNT = 0.99
SECONDS = 10.0  # in which an environment's states must be found; as long for all variants
PLAYED = 2.0  # seconds of play, at most
EPISODES, LONGEST = 6, 1_000  # of play, the first twice; and their steps
LIMIT = 500  # time limit of environments without a limit
QUICK = 5_000  # steps a second of a live environment whose variants are tried
TRIED, CHECKS, SMOOTH = 3, 20, 5  # seeds and checkpoints of a trial; over how many it is smoothed
NOISE = 2.0  # standard deviations between checkpoints: what a live task's return must gain
SAMPLES, STARTS = 30, 5  # steps a pair and resets by which a random environment is estimated
MOST = 3  # variants in a study
BUDGETS = 10_000, 100_000, 1_000_000  # steps in which a task is tried to be learnt
LIVE_BUDGET = 20_000  # the same of a live task
MOST_LIVE, LEAST_BUDGET = 50_000, 5_000  # steps of a live target at most, of any at least
LEARNT = 0.9  # of the way from the random policy's return to the optimum
SOONER = 0.8  # of the target's steps: what an easier variant takes at most
LIMITS = ("steps", "limit", "horizon", "length")
"""Words in the names of attributes that are time limits, where another counts steps."""
NO_TASK = ("seed", "step", "limit", "fps", "render", "time", "horizon", "pixel", "debug", "path")
"""Words in the names of arguments that make no other task."""


# -- Playing ---------------------------------------------------------------------------------------


@dataclass
class Play:
    """What a few episodes of random actions show of an environment."""

    follows_seed: bool = True
    masks: bool = False  # whether it says which actions are available
    lengths: list[tuple[int, bool, bool]] = field(default_factory=list)  # terminated, truncated
    seen: list[tuple[list[Any], Mapping[str, Any]]] = field(default_factory=list)
    """The numbers of an observation, and the environment's attributes, after resets and steps."""
    stepped: list[bool] = field(default_factory=list)  # whether by a step
    speed: float = 0.0  # steps a second

    @classmethod
    def of(cls, env: Any) -> "Play":
        """Return a few episodes of an environment; TaskError where it is no Gymnasium's."""
        act, space = actions_of(env.action_space, None, None)
        play, first, began = cls(), list[Any](), time.perf_counter()
        for episode in (0, *range(EPISODES)):
            rng = np.random.default_rng(episode)
            again = len(play.lengths) == 1 and list[Any]()
            observed, info = checked_parts("reset", seeded_reset(env, episode))
            play.masks = play.masks or "action_mask" in info
            play.masks = play.masks or env.has_wrapper_attr("action_masks")
            observations, over, cut = [play._noted(env, observed, stepped=False)], False, False
            while not (over or cut) and len(observations) <= LONGEST:
                allowed = np.arange(space.size)
                if play.masks:
                    allowed = np.flatnonzero(action_mask(env, info, space.size))
                returned = env.step(act(int(rng.choice(allowed))))
                observed, _, over, cut, info = checked_parts("step", returned)
                observations.append(play._noted(env, observed, stepped=True))
                if time.perf_counter() - began > PLAYED:
                    break
            if again is not False:
                pairs = zip(first, observations, strict=False)
                play.follows_seed = all(same_observation(a, b) for a, b in pairs)
            first = first or observations
            play.lengths.append((len(observations) - 1, bool(over), bool(cut)))
            if len(play.lengths) > 1 and time.perf_counter() - began > PLAYED:
                break
        play.speed = len(play.seen) / (time.perf_counter() - began)
        return play

    def _noted(self, env: Any, observed: Any, *, stepped: bool) -> Any:
        leaves = [np.ravel(leaf).tolist() for leaf in parts_of(observed).values()]
        self.seen.append(
            ([x for leaf in leaves for x in leaf], words_of_state(vars(env.unwrapped)))
        )
        self.stepped.append(stepped)
        return {name: np.copy(leaf) for name, leaf in parts_of(observed).items()}

    @property
    def whole(self) -> bool:
        """Whether observations are whole numbers or words, as far as was seen."""
        numbers = (x for point, _ in self.seen for x in point if isinstance(x, float))
        return all(x == int(x) for x in numbers if np.isfinite(x))

    @property
    def counters(self) -> list[str]:
        """Attributes that grow by 1 with every step."""
        pairs = [
            (before, after)
            for (_, before), (_, after), stepped in zip(
                self.seen, self.seen[1:], self.stepped[1:], strict=False
            )
            if stepped
        ]
        names = set.intersection(*(set(after) for _, after in self.seen)) if pairs else set()
        whole = [name for name in names if isinstance(pairs[0][0][name], int)]
        return sorted(n for n in whole if all(b[n] == a[n] + 1 for a, b in pairs))

    @property
    def limit(self) -> int | None:
        """Steps after which episodes end whatever is done, None if unknown."""
        cut = [steps for steps, _, truncated in self.lengths if truncated]
        about, counters = self.seen[0][1], self.counters
        stated = [
            about[n] for n in about if any(w in n.lower() for w in LIMITS) and n not in counters
        ]
        known = [x for x in (*cut, *(stated if counters else [])) if isinstance(x, int) and x > 1]
        return min(known, default=None)

    def names(self) -> list[str] | None:
        """Return the attributes that observations show, by name; None if none is recognised."""
        names, matched = list[str](), False
        for i in range(len(self.seen[0][0])):
            column = [point[i] for point, _ in self.seen if len(point) > i]
            shown = [
                name.lstrip("_")
                for name in self.seen[0][1]
                if all(
                    about.get(name) == x for (_, about), x in zip(self.seen, column, strict=False)
                )
            ]
            known = shown if len(set(column)) > 1 else shown * (len(shown) == 1)
            new = next((name for name in known if name not in names), None)
            matched = matched or new is not None
            names.append(new or f"state_{i + 1}")
        return names if matched else None


# -- Tasks that an environment makes, and how hard they are ----------------------------------------


Maker = Callable[[dict[str, Any], float], Any]  # from arguments and seconds to a task


def _tables(recipe: Any, **options: Any) -> Maker:
    """Return what makes tables; TaskError where they cannot be made in time."""
    return lambda arguments, seconds: tabulate(
        EnvironmentMaker(recipe, arguments), discount=DISCOUNT, max_seconds=seconds, **options
    )


def _played(recipe: Any, **options: Any) -> Maker:
    """Return what makes a task of an environment's own table, or a live task."""
    return lambda arguments, _: from_gymnasium(
        EnvironmentMaker(recipe, arguments), discount=DISCOUNT, **options
    )


class Variant(NamedTuple):
    """An environment with some arguments, and the steps in which it is learnt."""

    arguments: dict[str, Any]
    task: Any
    judgement: Judged | None  # of tables
    steps: float  # infinite where it is not learnt
    has_goal: bool  # False where an optimal policy need not end episodes


def _variant(
    arguments: dict[str, Any], task: Any, budgets: Sequence[int], *, has_goal: bool = True
) -> Variant:
    judgement, steps = None, math.inf
    if not is_live(task):
        mdp = tables(task)
        judgement = judged(mdp, None if has_goal else np.ones(len(mdp.terminal), bool))
    if judgement is None or not judgement.refusal:
        steps = _steps_to_learn(task, judgement, budgets)
    return Variant(arguments, task, judgement, steps, has_goal)


def _steps_to_learn(task: Any, judgement: Judged | None, budgets: Sequence[int]) -> float:
    """Return the steps after which Q-learning is nearly as good as it gets, on average."""
    for budget in budgets:
        how: dict[str, Any] = {"seeds": TRIED, "eval_freq": budget // CHECKS}
        how |= {} if judgement else {"evaluation": GreedyEvaluation(episodes=2)}
        learning = learn(task, QLearning(), budget, **how)
        returns = learning.greedy_return
        curve, low, high = returns.mean(axis=0), 0.0, 0.0
        if judgement is not None:
            low, high = judgement.random_return, judgement.optimum
        else:  # the best return that a few episodes show, if it is more than their noise
            curve = uniform_filter1d(curve, SMOOTH)
            low, high = curve[0], curve.max()
            if high - low <= NOISE * float(np.diff(returns, axis=1).std()):
                continue
        near = curve >= low + LEARNT * (high - low)
        if near.any():
            return float(learning.steps[near.argmax()])
    return math.inf


def easier(
    target: Variant, make: Maker, recipe: Any, env: Any, budgets: Sequence[int]
) -> list[Variant]:
    """Return variants that are learnt sooner and can be read by name."""
    kept, ends = list[Variant](), time.perf_counter() + SECONDS
    for arguments in _arguments(recipe, env):
        if (left := ends - time.perf_counter()) <= 0 or len(kept) == MOST:
            break
        try:
            task = make(arguments, left)
            variant = _variant(arguments, task, budgets, has_goal=target.has_goal)
            mapped = project(target.task, variant.task).coverage().mapped
        except Exception:  # a constructor may refuse arguments in any way
            continue
        sooner = 0 < variant.steps < math.inf and variant.steps <= SOONER * target.steps
        if sooner and mapped and not any(_same(variant, other) for other in (target, *kept)):
            kept.append(variant)
    return kept


def _same(variant: Variant, other: Variant) -> bool:
    if variant.judgement is None or other.judgement is None:
        return variant.steps == other.steps  # with equal seeds
    return same_up_to_homomorphism(variant.judgement, other.judgement)


def _arguments(recipe: Any, env: Any) -> Iterator[dict[str, Any]]:
    """Yield other arguments of a constructor: flipped, halved, fewer by one, without chance."""
    stated = {} if callable(recipe) else dict(env.spec.kwargs)
    values = {
        name: stated.get(name, parameter.default)
        for name, parameter in signature(
            recipe if callable(recipe) else type(env.unwrapped)
        ).parameters.items()
        if not any(word in name.lower() for word in NO_TASK)
    }
    others = {name: _others(value) for name, value in values.items()}
    for turn in range(max(map(len, others.values()), default=0)):
        yield from ({name: some[turn]} for name, some in others.items() if turn < len(some))
    sizes = {name: v // 2 for name, v in values.items() if type(v) is int and v >= 4}
    if len(sizes) > 1:
        yield sizes


def _others(value: Any) -> list[Any]:
    """Return the values in place of an argument's that may make an easier task."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int) and value > 0:
        return [*dict.fromkeys((value // 2, value - max(1, value // 4), value - 1))]
    return [0.0, 1.0] if isinstance(value, float) and 0 < value < 1 else []


# -- The file --------------------------------------------------------------------------------------


def environment_study(name: str, recipe: Any) -> tuple[str, list[str]]:
    """Return a study of an environment, and sentences on what was seen of it."""
    try:
        with users_code(name), opened(recipe, EnvironmentMaker(recipe)) as env:
            return _study(name, recipe, env)
    except ConfigError as error:
        hint = (
            "; give its arguments defaults, or name a function without arguments that makes it"
            if "required positional argument" in str(error)
            else ""
        )
        raise ConfigError(f"{error}{hint}") from None


def _study(name: str, recipe: Any, env: Any) -> tuple[str, list[str]]:
    if not is_discrete(env.action_space):
        return _of_network(name, recipe, env, "its actions are no whole numbers")
    play, notes = Play.of(env), list[str]()
    if not play.follows_seed:
        notes.append(
            "two resets with one seed and the same actions differ, so that results cannot be "
            "repeated: let reset call super().reset(seed=seed), and draw from self.np_random alone"
        )
    table, minigrid = has_table(env), is_minigrid(env)
    counters = [] if minigrid else play.counters
    limited = time_limit_of(env) or minigrid
    limit = None if limited else play.limit or LIMIT
    options: dict[str, Any] = {"time_limit": limit} if limit else {}
    options |= {"action_masks": True} if play.masks and not table else {}
    lines = [f"{key} = {json.dumps(value)}" for key, value in options.items()]
    counted = [f"ignore = {json.dumps(counters)}"]
    sampled = [f"samples = {SAMPLES}", f"reset_seeds = {[*range(STARTS)]}"]
    few: dict[str, Any] = {"samples": SAMPLES, "seeds": STARTS}
    ignored = options | {"state": DeepCopy(counters)}
    whole, discrete = play.whole and not table, is_discrete(env.observation_space)
    ways: list[tuple[bool, Maker, list[str]]] = [
        (table, _played(recipe), []),
        (whole and bool(counters), _tables(recipe, **ignored), counted),
        (whole, _tables(recipe, **options), []),
        (whole and not discrete, _tables(recipe, **ignored, **few), counted + sampled),
    ]
    refusal, task = "" if play.whole else "its observations are no whole numbers", None
    kind, budgets = "gymnasium" if table else "tabulated", [*BUDGETS]
    began = time.perf_counter()
    for fits, make, keys in ways:
        try:
            task = make({}, SECONDS) if fits else None
        except TaskError as error:
            refusal = refusal or str(error)
        if task is not None:
            lines += keys
            break
    seconds = time.perf_counter() - began
    if task is None and not discrete:
        return _of_network(name, recipe, env, refusal)
    if task is None:
        names = None if names_of(env.unwrapped)[0] else play.names()
        if names and len(names) == len(space_of(env.observation_space, "state").names):
            options["names"] = names
            lines.append(f"names = {json.dumps(names)}")
        kind, make = "gymnasium", _played(recipe, **options)
        task, budgets = make({}, SECONDS), [LIVE_BUDGET] * (play.speed >= QUICK)
        notes.append(f"learnt live, by calling step, as it is not tabulated: {refusal}")
    elif not table:
        notes.append(f"tabulated: {task.states.size:,} states, in {seconds:.1f} s")
        if counters and keys:
            said = f"{' and '.join(map(repr, counters))} counts steps"
            notes.append(f"{said} and is left out of the states; time_limit ends episodes")
    target = _variant({}, task, budgets)
    if target.judgement is not None and target.judgement.refusal:  # it may be one without an end
        target = _variant({}, task, budgets, has_goal=False)
    if target.judgement is not None and target.judgement.refusal:
        notes.append(f"there is nothing to learn here: {target.judgement.refusal}")
    variants = easier(target, make, recipe, env, budgets)
    notes += [_described(variant, target) for variant in variants]
    live = is_live(task)
    numbers = _budget(target.steps, MOST_LIVE if live else BUDGETS[-1]), 8 if live else 20
    lines += [f"eval_freq = {numbers[0] // CHECKS}"] * live
    return _text(name, recipe, kind, lines, numbers, notes, variants), notes


def _budget(steps: float, most: int) -> int:
    """Return a round number of steps in which a task is surely learnt, if any is."""
    enough = min(max(3 * steps, LEAST_BUDGET), most)
    unit: int = 10 ** int(math.log10(enough))
    return math.ceil(enough / unit) * unit


def _described(variant: Variant, target: Variant) -> str:
    """Return why a variant is easier."""
    sizes = f"{variant.task.states.size:,} states instead of {target.task.states.size:,}"
    most = LIVE_BUDGET if is_live(target.task) else BUDGETS[-1]
    before = f"{target.steps:,.0f}" if target.steps < math.inf else f"over {most:,}"
    return (
        f"easier with {_inline(variant.arguments)}: {sizes}, learnt in {variant.steps:,.0f} steps "
        f"instead of {before}"
    )


def _inline(arguments: Mapping[str, Any]) -> str:
    """Return arguments as TOML writes them."""
    return ", ".join(f"{name} = {json.dumps(value)}" for name, value in arguments.items())


def _text(
    name: str,
    recipe: Any,
    kind: str,
    lines: Sequence[str],
    numbers: tuple[int, int],
    notes: Sequence[str],
    variants: Sequence[Variant],
) -> str:
    """Return the file of a study that a table learns; each variant is a source and an arm."""
    comments = "\n".join(
        fill(note, 98, initial_indent="# ", subsequent_indent="#   ") for note in notes
    )
    key = "factory" if callable(recipe) else "id"
    task = "\n".join([f'type = "{kind}"', f"{key} = {json.dumps(name)}", *lines])
    parts = [_file("table.txt").format(name=name, seeds=numbers[1], notes=comments)]
    parts.append(f"[tasks.target]\n{task}\nbudget = {numbers[0]:_}")
    sources = [
        re.sub(r"[^\w-]", "_", "_".join(f"{key}_{value}" for key, value in v.arguments.items()))
        for v in variants
    ]
    for source, variant in zip(sources, variants, strict=True):
        arguments = f"arguments = {{ {_inline(variant.arguments)} }}"
        parts.append(f"[tasks.{source}]\n{task}\n{arguments}")
    parts += [
        f'[[transfers]]\nsource = "{source}"\ntarget = "target"\n'
        "project = {}                # components of the same name correspond"
        for source in sources
    ]
    if len(sources) > 1:
        parts += [f"[arms.{source}]\ntransfers = [{i}]" for i, source in enumerate(sources)]
    if not sources:
        parts.append(_file("source.txt").format(task=indent(task, "# ")))
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _of_network(name: str, recipe: Any, env: Any, why: str) -> tuple[str, list[str]]:
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
    limit = (
        ""
        if time_limit_of(env) or hasattr(env.unwrapped, "max_steps")
        else f"time_limit = {LIMIT}\n"
    )
    text = _file("network.txt").format(
        name=name,
        key="factory" if callable(recipe) else "id",
        limit=limit,
        algorithm="PPO" if isinstance(acting, Box) else "DQN",
        policy=policy,
    )
    return text, [f"learnt by a network, as it is not tabulated: {why}"]


def _file(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
