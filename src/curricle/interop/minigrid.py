"""MiniGrid's states, saved and restored a thousand times as fast as by copies."""

import sys
from collections import UserDict
from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from operator import is_, itemgetter
from typing import Any

import numpy as np

from curricle.checks import instance
from curricle.errors import SettingError, TaskError
from curricle.interop.states import (
    Copies,
    Environment,
    Restored,
    StateAccess,
    Uncounted,
    Words,
    fingerprint,
    left_out,
    time_before,
)
from curricle.interop.tabulated_task import Unseen
from curricle.tasks.minigrid_view import CompiledView, MiniGrid, is_minigrid, observes_itself
from curricle.tasks.spaces import Component, Space

MOVED = frozenset({"agent_pos", "agent_dir", "carrying", "step_count"})
"""Attributes that every step of MiniGrid may change, beside the grid."""
# Attributes that are no part of a state, and methods that are replaced during a tabulation.
SHOWN = frozenset({"window", "clock", "render_size", "_np_random", "_np_random_seed"})
REPLACED = frozenset({"gen_obs", "_reward"})
PLAIN = (type(None), bool, int, float, str, np.generic)
DIRECTIONS = "right", "down", "left", "up"
DOOR_STATES = "open", "closed", "locked"
CARRIED, AWAY = -1, -2  # coordinates of an object that the agent carries; of one in a box, or gone
STILL = {"wall", "floor", "goal", "lava"}  # types of objects without a state


class Level:
    """A level as a reset made it: constant attributes, objects with a state, plain attributes."""

    def __init__(self, number: int, env: MiniGrid):
        self.number = number
        self.constants = {
            name: value for name, value in vars(env).items() if name not in MOVED | SHOWN | REPLACED
        }
        self.plain = [name for name, value in self.constants.items() if _is_plain(value)]
        self.values_of_plain = itemgetter(*self.plain, "mission")
        other = self.constants.keys() - {*self.plain, "grid"}
        self.referred = {name: self.constants[name] for name in other}
        # The different objects in cells and in boxes, in the order of the cells.
        things = dict[int, Any]()
        for thing in env.grid.grid:
            while thing is not None and id(thing) not in things:
                things[id(thing)] = thing
                thing = thing.contains
        objects = [thing for thing in things.values() if thing.type not in STILL]
        # What steps change of MiniGrid's own objects is known; of others all is saved.
        standard = {id(t) for t in objects if type(t).__module__ == "minigrid.core.world_object"}
        plain = [thing for thing in objects if id(thing) in standard]
        self.others = [thing for thing in objects if id(thing) not in standard]
        self.doors = [thing for thing in objects if thing.type == "door"]
        self.movable = [thing for thing in objects if thing.type != "door"]
        self.standard_doors = [thing for thing in plain if thing.type == "door"]
        self.standard_movable = [thing for thing in plain if thing.type != "door"]
        self.names = dict[int, str]()
        for kind in {thing.type for thing in objects}:
            alike = [thing for thing in objects if thing.type == kind]
            for i, thing in enumerate(alike, start=1):
                self.names[id(thing)] = kind if len(alike) == 1 else f"{kind}_{i}"
        self.content: Any = None  # its first state
        self.first_digests = self.digests()

    def digests(self) -> dict[str, bytes]:
        """Return a digest of each attribute that is not plain, to see whether it has changed."""
        return {
            name: fingerprint(value)
            for name, value in self.constants.items()
            if name not in self.plain
        }

    def rebound(self, attributes: dict[str, Any]) -> str:
        """Return the name of an attribute, not plain, that steps have given another value."""
        if all(map(is_, map(attributes.get, self.referred), self.referred.values())):
            return ""
        for name, first in self.referred.items():
            value = attributes.get(name)
            if value is not first and fingerprint(value) != self.first_digests[name]:
                return name
        return ""

    def components(self, env: MiniGrid) -> Words:
        """Return the components of the state that an environment of this level is in."""
        x, y = map(int, env.agent_pos)
        components: dict[str, int | str] = {"level": self.number, "x": x, "y": y}
        components["direction"] = DIRECTIONS[env.agent_dir]
        for door in self.doors:
            state = 0 if door.is_open else 2 if door.is_locked else 1
            components[self.names[id(door)]] = DOOR_STATES[state]
        places = {id(thing): i for i, thing in enumerate(env.grid.grid) if thing is not None}
        for thing in self.movable:
            x = y = CARRIED if thing is env.carrying else AWAY
            if id(thing) in places:
                y, x = divmod(places[id(thing)], env.width)
            components |= {f"{self.names[id(thing)]}_x": x, f"{self.names[id(thing)]}_y": y}
        for name in self.plain:
            value = vars(env)[name]
            if isinstance(value, str | bool | int) and value != "":
                components.setdefault(name, value)
        return components


def _is_plain(value: object) -> bool:
    return all(map(_is_plain, value)) if isinstance(value, tuple) else isinstance(value, PLAIN)


def _place(value: Any) -> Any:
    """Return the coordinates of an object as MiniGrid first has them, a tuple; others as is."""
    return tuple(value.tolist()) if isinstance(value, np.ndarray) else value


def _items(thing: object) -> tuple[tuple[str, Any], ...]:
    return tuple((name, _place(value)) for name, value in vars(thing).items())


PROBED = 300  # random steps that show whether a level has a state beside MiniGrid's own


@dataclass(frozen=True)
class MiniGridState:
    """States of MiniGrid: the agent, the grid, the objects in it, and plain attributes.

    MiniGrid pays 1 - 0.9 t / max_steps at step t of an episode. States of a table hold no time, so
    the goal pays 1 there. If it is the only reward, a policy that is optimal at a discount below 1
    takes as few steps as possible, and is best by MiniGrid's own reward as well.

    Components are the agent's `x`, `y` and `direction`; the state of each `door`; and the place of
    each `key`, `ball` and `box`, such as `key_x`: -1 while it is carried, -2 while it is in a box
    or gone. Several of a kind are numbered, as in `door_1`.

    Parameters
    ----------
    own_reward : bool
        Pay MiniGrid's own reward; then the time is a component of the state, `step`.
    copies : bool
        Whether to save states by copies; by default only where a level (BabyAI's instructions) or a
        wrapper keeps part of the state elsewhere.

    Examples
    --------
    >>> MiniGridState(own_reward=True)
    MiniGridState(own_reward=True, copies=False)
    """

    own_reward: bool = False
    copies: bool = False

    def __post_init__(self) -> None:
        instance("own_reward", self.own_reward, bool, SettingError)
        instance("copies", self.copies, bool, SettingError)

    def open(self) -> StateAccess:
        """Return the `StateAccess` that saves and restores the states."""
        if self.copies:
            return Copies(frozenset()) if self.own_reward else _TimelessCopies()
        return MiniGridAccess(own_reward=self.own_reward)


def fitting_state(env: Environment, core: Environment, seed: int) -> MiniGridState:
    """Return how to save a MiniGrid environment's states: fast if it keeps none elsewhere."""
    if core is not env.unwrapped or not observes_itself(core):
        return MiniGridState(copies=True)
    access = MiniGridAccess(own_reward=False)
    core.reset(seed=seed)
    access.begin(core)
    rng = np.random.default_rng(seed)
    for _ in range(PROBED):
        _, _, over, _, _ = core.step(int(rng.integers(core.action_space.n)))  # type: ignore[attr-defined]
        if over:
            break
    access.release()
    return MiniGridState(copies=bool(access.missed(core)))


def named_actions(env: Environment) -> Space | None:
    """Return MiniGrid's actions by name: left, right, forward, pickup, drop, toggle, done."""
    if not is_minigrid(env):
        return None
    base: Any = env.unwrapped
    labels = tuple(action.name for action in base.actions)[: int(base.action_space.n)]
    return Space([Component("action", len(labels), labels=labels)])


def _unit() -> float:
    return 1.0


def _pay_one(env: Environment) -> str:
    """Let the goal pay 1 and return a note of it; keep a subclass's reward and return nothing."""
    base: Any = env.unwrapped
    usual = sys.modules["minigrid.minigrid_env"].MiniGridEnv._reward
    if type(base)._reward is not usual or vars(base).get("_reward", _unit) is not _unit:
        return ""
    base._reward = _unit
    return "goal reward 1"


TIME_HINT = ", and may depend on the time only with state=MiniGridState(own_reward=True)"


class _TimelessCopies(Uncounted):
    """Copies without MiniGrid's counter, whose goal pays 1."""

    def __init__(self) -> None:
        super().__init__({"step_count": 0}, 0)
        self.hint = TIME_HINT

    def prepare(self, env: Environment) -> None:
        self.note = _pay_one(env)

    def restore(self, env: Environment, content: Any) -> Restored:
        self.longest = content.unwrapped.max_steps  # which a reset may set
        return super().restore(env, content)


class _View(Unseen, UserDict[str, Any]):
    """An observation that is computed when it is read."""

    def __init__(self, view: CompiledView):
        self.view = view

    @cached_property
    def data(self) -> dict[str, Any]:  # type: ignore[override]
        return self.view()


class MiniGridAccess(StateAccess):
    """Saves states as tuples, and restores them into the same environment."""

    def __init__(self, *, own_reward: bool):
        self.own_reward, self.hint = own_reward, "" if own_reward else TIME_HINT
        self.times = count()
        self.levels = list[Level]()
        self.by_digest = dict[bytes, Level]()
        self.grid_numbers = dict[tuple[Any, ...], int]()
        self.grids = list[list[Any]]()
        self.last_grid = -1  # the number of the grid that was restored last
        self.level: Any = None
        self.rebound = ""  # an attribute that steps give other objects, which are not saved
        self.env: Any = None
        self.gen_obs: Any = None  # what has replaced the environment's method, if anything

    def prepare(self, env: Environment) -> None:
        """Let the goal pay 1, unless the reward is MiniGrid's own."""
        if not self.own_reward:
            self.note = _pay_one(env)

    def begin(self, env: Environment) -> None:
        """Store the level that a reset made, unless it is known already."""
        base: Any = env.unwrapped
        replaced = vars(base).pop("gen_obs", None)
        if self.env is None:
            self.gen_obs = replaced
        self.env = base
        digest = fingerprint(base, left_out(base) | MOVED | SHOWN | REPLACED)
        level = self.by_digest.get(digest)
        if level is not None:
            agent = base.agent_pos, base.agent_dir, base.step_count
            self.level = None  # attributes that refer to the new objects are restored, too
            self.restore(base, level.content)
            base.agent_pos, base.agent_dir, base.step_count = agent
        else:
            self.level = self.by_digest[digest] = Level(len(self.levels), base)
            self.levels.append(self.level)
            _, self.level.content = self.save(base, None)
        view = CompiledView(base)
        base.gen_obs = lambda: _View(view)

    def save(self, env: Environment, returned: object) -> tuple[Hashable, Any]:
        """Return the state as a tuple, its key and its content alike."""
        base: Any = env
        x, y = base.agent_pos
        attributes, level, cells = vars(base), self.level, base.grid.grid
        doors = [(door.is_open, door.is_locked) for door in level.standard_doors]
        places = [(_place(t.cur_pos), _place(t.init_pos)) for t in level.standard_movable]
        grid = self.last_grid
        if grid < 0 or cells != self.grids[grid]:  # seldom after a step; quicker than a look-up
            grid = self.grid_numbers.setdefault(tuple(cells), len(self.grids))
            if grid == len(self.grids):
                self.grids.append(list(cells))
        objects = tuple(doors), tuple(places), tuple([_items(thing) for thing in level.others])
        step = base.step_count if self.own_reward else 0
        agent = level.number, int(x), int(y), int(base.agent_dir), base.carrying
        state = (*agent, grid, objects, level.values_of_plain(attributes), step)
        return state, state

    def restore(self, env: Environment, content: object) -> Restored:
        """Return the same environment, put into the state."""
        assert isinstance(content, tuple)
        base: Any = env
        number, x, y, direction, carrying, grid, objects, plain, step = content
        level = self.levels[number]
        if self.level is not None and not self.rebound:
            self.rebound = self.level.rebound(vars(base))
        if level is not self.level:
            vars(base).update(level.constants)
            self.level = level
        base.agent_pos, base.agent_dir, base.carrying = (x, y), direction, carrying
        base.grid.grid[:] = self.grids[grid]
        self.last_grid = grid
        doors, places, items = objects
        for door, state in zip(level.standard_doors, doors, strict=True):
            door.is_open, door.is_locked = state
        for thing, place in zip(level.standard_movable, places, strict=True):
            thing.cur_pos, thing.init_pos = place
        for thing, values in zip(level.others, items, strict=True):
            vars(thing).update(values)
        if level.values_of_plain(vars(base)) != plain:
            vars(base).update(zip([*level.plain, "mission"], plain, strict=True))
        # Without a time in the states a repeated step is at another time than the first.
        base.step_count = step if self.own_reward else time_before(next(self.times), base.max_steps)
        return Restored(env, (base.np_random,))

    def observation(self, env: Environment, returned: object) -> object:
        """Return the observation of the state that the environment is in."""
        return returned.data if isinstance(returned, _View) else returned

    def describe(self, env: Environment, observation: object) -> Words:
        """Return the components of the state."""
        components = self.level.components(self.env)
        return {**components, "step": self.env.step_count} if self.own_reward else components

    def missed(self, env: Environment) -> str:
        """Return the name of an attribute that steps have changed and that is not saved."""
        for level in self.levels:
            self.restore(env, level.content)
            if self.rebound:
                return self.rebound
            for name, digest in level.digests().items():
                if digest != level.first_digests[name]:
                    return name
        return ""

    def release(self) -> None:
        """Give the environment its own observations again."""
        vars(self.env).pop("gen_obs", None)
        if self.gen_obs is not None:
            self.env.gen_obs = self.gen_obs

    def end(self) -> None:
        """Release the environment; TaskError if a state was missed."""
        self.release()
        if missed := self.missed(self.env):
            raise TaskError(
                "a state outside the agent, the grid, its objects and plain attributes must be "
                f"saved by MiniGridState(copies=True): steps changed {missed!r} of {self.env}"
            )
