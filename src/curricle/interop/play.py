"""Play: what a few episodes of random actions show of an environment."""

import re
import time
from contextlib import suppress
from copy import deepcopy
from functools import cached_property
from math import ceil, floor, prod
from typing import Any

import numpy as np
from gymnasium import Env
from gymnasium.spaces import Box

from curricle.interop.discrete import is_discrete
from curricle.interop.encoders import Bins, WholeNumbers
from curricle.interop.gymnasium import actions_of, has_table
from curricle.interop.states import Uncounted, Words, counters_of, words_of_state
from curricle.interop.tabulated_task import parts_of, same_observation
from curricle.tasks.live import action_mask, checked_parts, seeded_reset
from curricle.tasks.minigrid_view import is_minigrid
from curricle.tasks.observation_task import check_observation, shared_restored
from curricle.tasks.spaces import Component, Space

PLAYED, EPISODES, LONGEST = 2.0, 6, 1_000  # seconds, episodes, and steps of an episode
LIMITS = "steps|limit|horizon|length"  # in names of attributes that say how long episodes are
BINS, FEWEST_BINS, CELLS = 20, 10, 10_000  # bins of a number, most and fewest; of all together
MOST_WHOLE = 1_000_000  # states of observations whose numbers are whole
BEYOND = 0.5  # of the range that was seen, to either side
SCALED = 1e-6  # that the correlation of an attribute and a number that shows it lacks
VAST = 20.0  # times the range that was seen: so far apart, bounds say nothing


class Play:
    """What a few episodes of random actions show of an environment."""

    def __init__(self, env: Env[Any, Any]):
        self.env, self.masks, self._mask_of = env, False, dict[str, bytes]()  # of an observation
        self.told = True  # whether observations tell which actions are available
        self.points, self.attributes = list[list[Any]](), list[Words]()  # points: of observations
        self.times, self.cuts = list[int](), list[int]()  # steps since the reset; at a truncation
        if is_discrete(env.action_space):
            self.act, self.actions = actions_of(env.action_space, None, None)
        else:  # all actions are one that the space draws
            self.act = lambda _: self.env.action_space.sample()
            self.actions = Space([Component("action", 1)])
        began, self._seconds = time.perf_counter(), 0.0  # of the environment alone
        self._until = began + PLAYED
        first, *_, again = [self._episode(env, seed) for seed in (*range(EPISODES), 0)]
        self.follows_seed, self._first = all(map(same_observation, first, again)), first
        self.speed = len(self.times) / (time.perf_counter() - began)  # steps a second

    @property
    def seconds_a_step(self) -> float:
        """The seconds that a step takes, with its share of a reset."""
        return self._seconds / self._steps

    @property
    def usual_steps(self) -> float:
        """The mean steps of an episode."""
        return self._steps / self.times.count(0)

    @property
    def _steps(self) -> int:
        """The steps of all episodes; 1 if resets are so slow that none was taken."""
        return max(1, int(np.count_nonzero(self.times)))

    def is_repeated_in(self, other: Env[Any, Any]) -> bool:
        """Return whether another environment of the class shows the same in the first episode."""
        return all(map(same_observation, self._first, self._episode(other, 0)))

    def _episode(self, env: Env[Any, Any], seed: int) -> list[Any]:
        """Return observations and rewards of an episode; TaskError where it is not Gymnasium's."""
        rng, states = np.random.default_rng(seed), list[Any]()
        self.env.action_space.seed(seed)
        over, cut, reward = False, False, 0.0
        began = time.perf_counter()
        observed, info = checked_parts("reset", seeded_reset(env, seed))
        self._seconds += time.perf_counter() - began
        check_observation(env.observation_space, observed)
        masks = "action_mask" in info or env.has_wrapper_attr("action_masks")
        self.masks = masks and is_discrete(env.action_space)
        while True:
            leaves = [np.ravel(leaf).tolist() for leaf in parts_of(observed).values()]
            self.points.append([x for leaf in leaves for x in leaf])
            self.attributes.append(words_of_state(vars(env.unwrapped)))
            self.times.append(len(states))
            states.append((deepcopy(observed), reward))
            if over or cut or len(states) > LONGEST or time.perf_counter() > self._until:
                self.cuts += [len(states) - 1] * bool(cut)
                return states
            n = self.actions.size
            allowed: Any = n
            if self.masks:
                mask = action_mask(env, info, n)
                first_mask = self._mask_of.setdefault(repr(self.points[-1]), mask.tobytes())
                self.told &= first_mask == mask.tobytes()
                allowed = np.flatnonzero(mask)
            action = self.act(int(rng.choice(allowed)))
            began = time.perf_counter()
            observed, reward, over, cut, info = checked_parts("step", env.step(action))
            self._seconds += time.perf_counter() - began
            check_observation(env.observation_space, observed)

    @property
    def whole(self) -> bool:
        """Whether the numbers in observations are whole, as far as was seen."""
        return all(x % 1 == 0 for point in self.points for x in point if isinstance(x, float))

    @cached_property
    def counters(self) -> list[str]:
        """Attributes that grow by one with every step, and that observations do not show."""
        later = np.flatnonzero(self.times)
        if is_minigrid(self.env):
            return []
        counting = counters_of(self.attributes, later - 1, later, self.env)
        return [name for name in counting if not self._is_shown(name)]

    def _is_shown(self, name: str) -> bool:
        """Return whether a number in observations is an attribute, maybe scaled."""
        try:
            points: Any = np.array(self.points, float)
        except ValueError:  # texts are no numbers, and observations may differ in length
            columns = zip(*self.points, strict=False)
            numbers = [
                column for column in columns if all(isinstance(x, int | float) for x in column)
            ]
            points = np.array(numbers, float).reshape(-1, len(self.points)).T
        values: Any = [attributes[name] for attributes in self.attributes]
        for column in points[:, np.ptp(points, axis=0) > 0].T:
            if abs(np.corrcoef(column, values)[0, 1]) > 1 - SCALED:
                others = self._named(column.tolist())  # a battery that falls with each step, too
                if name in others or not others:
                    return True
        return False

    def _named(self, column: list[Any]) -> list[str]:
        """Return the attributes with these values."""
        return [
            name
            for name in self.attributes[0]
            if [values.get(name) for values in self.attributes] == column
        ]

    @cached_property
    def limit(self) -> int | None:
        """Steps after which episodes end whatever is done, None if unknown."""
        counters, first = self.counters, self.attributes[0]
        named = {name for name in first if counters and re.search(LIMITS, name.lower())}
        stated = [first[name] for name in named - {*counters}]
        cut = min(self.cuts, default=None)
        if counters and not (cut or self.masks):
            cut = self._cut_ahead(counters)
        return cut or min((x for x in stated if type(x) is int and x > 1), default=None)

    def _cut_ahead(self, counters: list[str]) -> int | None:
        """Return at which step it ends, seen by setting its counters ahead; None if unseen."""
        ends = time.perf_counter() + PLAYED
        with suppress(Exception):  # so late a step may be outside of what the class foresees
            for n in range(1, LONGEST + 1):
                seeded_reset(self.env, 0)
                for name in counters:
                    setattr(self.env.unwrapped, name, int(self.attributes[0][name]) + n - 1)
                over, cut = self.env.step(self.act(0))[2:4]
                if cut or (over and n > 1) or time.perf_counter() > ends:
                    return n if over or cut else None
                if over:  # whatever its counters show
                    return None
        return None

    def names(self) -> list[str]:
        """Return the attributes that the numbers in observations show, ``state_1`` if unknown."""
        names = list[str]()
        for i, column in enumerate(zip(*self.points, strict=False), start=1):
            shown = self._named([*column])
            sure = [name.lstrip("_") for name in shown if len(set(column)) > 1 or len(shown) == 1]
            names.append(next((name for name in sure if name not in names), f"state_{i}"))
        return names

    def encoder(self) -> Bins | WholeNumbers | None:
        """Return what sorts a box's numbers into few states, None where these are too many."""
        space = self.env.observation_space
        if not (isinstance(space, Box) and len(space.shape) == 1 and space.shape[0]):
            return None
        points, ranges = np.array(self.points), dict[str, tuple[float, float]]()
        ends = zip(space.low, space.high, points.min(axis=0), points.max(axis=0), strict=True)
        for name, (*bounds, least, most) in zip(self.names(), ends, strict=True):
            low, high = map(float, bounds)  # of single precision their difference may overflow
            if high - low > VAST * (most - least):  # then bounds say nothing
                low = max(low, least - BEYOND * (most - least))
                high = min(high, most + BEYOND * (most - least))
            ranges[name] = low, high
        if self.whole:
            whole = {name: (floor(low), ceil(high)) for name, (low, high) in ranges.items()}
            cells = prod(high - low + 1 for low, high in whole.values())
            return WholeNumbers(whole) if cells <= MOST_WHOLE else None
        number = min(BINS, int(CELLS ** (1 / len(ranges))))
        if number < FEWEST_BINS:
            return None
        edges = dict[str, list[float]]()
        for name, (low, high) in ranges.items():
            high = high if high > low else low + 1  # a number that never changes
            edges[name] = [float(f"{x:.4g}") for x in np.linspace(low, high, number + 1)]
        return Bins(edges)


def without_counters(env: Env[Any, Any]) -> Uncounted | None:
    """Return how states are saved without counters of steps; None if it has none."""
    if is_minigrid(env) or has_table(env):  # whose states are not copies
        return None
    with shared_restored():
        play = Play(env)
        counters = {name: int(play.attributes[0][name]) for name in play.counters}
        return Uncounted(counters, play.limit or max(play.times)) if counters else None
