"""An environment whose steps can be taken from any state, as often as one likes."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.wrappers import FrameStackObservation, TimeLimit

from curricle.errors import TaskError
from curricle.interop.tabulation.observation_table import same_observation
from curricle.interop.tabulation.random_states import RandomStates, state_of
from curricle.interop.tabulation.state_access import (
    Environment,
    SavedState,
    StateAccess,
    Words,
    layers_of,
)
from curricle.interop.toy_text import HARMLESS
from curricle.tasks.live import RETURNED

REPETITIONS = 8
"""Times that a step is taken in all if it draws random numbers; one that draws none, twice."""
RESET, STEP = RETURNED["reset"], RETURNED["step"]
"""What Gymnasium's resets and steps return."""
LONG_AGO = -(2**62)
"""Steps that the clock of a wrapper shows, so that no time limit is met."""


class Arrival(NamedTuple):
    """What a step or a reset leads to."""

    state: SavedState
    reward: float
    terminated: bool
    truncated: bool
    observed: Any  # as the step returned it


class CoreAndViews(NamedTuple):
    """What is stepped of an environment, and the wrappers that are apart from it."""

    core: Environment
    views: Sequence[gym.ObservationWrapper[Any, Any, Any]]  # from the innermost
    acts: Sequence[gym.ActionWrapper[Any, Any, Any]]  # from the outermost


class World:
    """An environment, and how its states are saved and restored.

    Parameters
    ----------
    env : gymnasium.Env
        Nobody else's: it is stepped and reset.
    act : callable
        From an action's number to the environment's action.
    access : StateAccess
    name : str
        For messages.
    """

    def __init__(self, env: Environment, act: Callable[[int], Any], access: StateAccess, name: str):
        self.env, self.act, self.access, self.name = env, act, access, name
        self.core, self.views, self.acts = core_and_views(env, views_apart=not access.copies)
        self.now = self.core
        access.prepare(env)
        self.random_states = RandomStates()
        self.drawing = 0  # pairs whose steps draw random numbers
        self._known: list[Any] | None = None  # the generators' states, where nobody has drawn since

    def start(self, seed: int) -> Arrival:
        """Return where an episode begins that is reset with a seed."""
        self._known = None
        if self.access.copies:
            self.now, _ = self.access.restore(self.core, (self.core, []))
        observed, _ = self._returned(self.now.reset(seed=seed), RESET)
        _rewind_clocks(self.now)
        self.access.begin(self.now)
        return Arrival(self.access.save(self.now), 0.0, False, False, observed)

    def step(self, content: Any, action: int) -> Arrival:
        """Return where the one outcome of an action leads from a saved state.

        Raises
        ------
        TaskError
            When the step, repeated with other random numbers, leads elsewhere.
        """
        env, generators = self.access.restore(self.core, content)
        before = self._known if self._known is not None else [*map(state_of, generators)]
        first = self._arrival(env, action)
        after = [*map(state_of, generators)]
        if after == before:
            again, _ = self.access.restore(self.core, content)
            self._check_repeated(first, self._arrival(again, action), action)
            # Where all is one environment its generators are now as they were.
            self._known = None if self.access.copies else after
        else:
            self.drawing += 1
            self._known = None
            for repetition in range(1, REPETITIONS):
                again, generators = self.access.restore(self.core, content)
                self.random_states.restart(generators, repetition)
                self._check_repeated(first, self._arrival(again, action), action)
        # Where all is one environment it is in the same state now; else `env` is kept as the state.
        self.now = env
        return first

    def sample(self, content: Any, action: int) -> Arrival:
        """Return where one step leads from a saved state, with random numbers not used before."""
        env, generators = self.access.restore(self.core, content)
        self.random_states.resume(generators)
        self.now = env
        arrival = self._arrival(env, action)
        self.random_states.leave(generators)
        return arrival

    def _arrival(self, env: Environment, action: int) -> Arrival:
        returned = self._returned(env.step(self._core_action(action)), STEP)
        observed, reward, terminated, truncated, _ = returned
        _rewind_clocks(env)
        try:
            earned = float(reward)
        except (TypeError, ValueError):
            earned = math.nan
        if not math.isfinite(earned):
            raise TaskError(f"a reward must be a finite number: got {reward!r} from {self.name}")
        state = self.access.save(env)
        return Arrival(state, earned, bool(terminated), bool(truncated), observed)

    def _core_action(self, action: int) -> Any:
        """Return what the core is told to do for an action's number."""
        told = self.act(action)
        for wrapper in self.acts:
            told = wrapper.action(told)
        return told

    def _returned(self, found: Any, names: tuple[str, ...]) -> tuple[Any, ...]:
        """Return what a reset or a step returned, if it has so many parts."""
        if not isinstance(found, tuple) or len(found) != len(names):
            what = "reset" if names is RESET else "step"
            raise TaskError(
                f"a {what} must return ({', '.join(names)}): got {found!r} from {self.name}"
            )
        return found

    def _check_repeated(self, first: Arrival, again: Arrival, action: int) -> None:
        same = first.state.key == again.state.key
        if same and first[1:4] == again[1:4]:
            if same_observation(first.observed, again.observed):
                return
            differing = "observation"
        else:
            differing = "state" if not same else "reward or end"
        raise TaskError(
            "steps must be deterministic to be tabulated, unless outcomes are listed (outcomes=) "
            f"or estimated (samples=): action {action}, repeated from one state of {self.name}, "
            f"led to another {differing}"
        )

    def observation(self, arrival: Arrival) -> Any:
        """Return what is observed at the arrival that came last."""
        seen = self.access.observation(self.now, arrival.observed)
        for view in self.views:
            seen = view.observation(seen)
        return seen

    def describe(self) -> Words:
        """Return the state of the arrival that came last, in words."""
        return self.access.describe(self.now)


def refuse_stacked_frames(env: Environment) -> None:
    """Raise TaskError where a wrapper stacks frames: each history would be a state."""
    if any(isinstance(layer, FrameStackObservation) for layer in layers_of(env)):
        raise TaskError(
            "an environment with stacked frames cannot be tabulated, as each history of frames "
            f"would be a state: tabulate it without them, got {env}"
        )


def time_limit_of(env: Environment) -> int | None:
    """Return the steps after which an environment truncates: the least limit of its wrappers."""
    limits = [layer._max_episode_steps for layer in layers_of(env) if isinstance(layer, TimeLimit)]
    return min(limits, default=None)


def _rewind_clocks(env: Environment) -> None:
    """Set back the clocks of time limits: time is no part of a state."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, TimeLimit):
            clock: Any = env
            clock._elapsed_steps = LONG_AGO
        env = env.env


def core_and_views(env: Environment, *, views_apart: bool) -> CoreAndViews:
    """Return the part of an environment that is stepped, and the wrappers that are apart from it.

    Wrappers that change nothing are left out, the outer ones. Those that change observations or
    actions alone are apart if told so: observations are looked through once a state, not once a
    step, and actions are changed before the step.
    """
    views, acts = list[Any](), list[Any]()
    while isinstance(env, gym.Wrapper):
        if views_apart and _plain(env, gym.ObservationWrapper):
            views.insert(0, env)
        elif views_apart and _plain(env, gym.ActionWrapper):
            acts.append(env)
        elif not isinstance(env, HARMLESS):
            break
        env = env.env
    return CoreAndViews(env, views, acts)


def _plain(env: Any, kind: Any) -> bool:
    """Return whether a wrapper of a kind steps and resets as all of that kind do."""
    ours = type(env)
    return isinstance(env, kind) and ours.step is kind.step and ours.reset is kind.reset
