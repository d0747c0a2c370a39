"""Curricle's tasks as environments of Gymnasium."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Literal

import gymnasium
import numpy as np

from curricle.checks import one_of, whole_number
from curricle.errors import SettingError, TaskError
from curricle.interop.spaces import Coding, Form
from curricle.show.scenes import Scene, scene_of
from curricle.tasks.computed import check_answers
from curricle.tasks.draws import draw
from curricle.tasks.generative_models import Functions, first_state, transition
from curricle.tasks.gridworld import GridWorld, Rewards
from curricle.tasks.live import is_live
from curricle.tasks.overloads import compiled
from curricle.tasks.pursuit import LARGEST_SPACE, Pursuit
from curricle.tasks.spaces import MISSING, Component
from curricle.tasks.task import generative_model

RenderMode = Literal["rgb_array", "ansi"]
FIRST_MAZE = """
    .....P.T
    .#P#....
    ..F#.#P.
    S.......
"""
"""The map of ``Curricle/Maze-v0``: the short way passes a fire, a safe way takes two moves more."""


def _begun(model: Any, stream: Any) -> Any:
    return first_state(model, draw(stream))  # type: ignore[no-untyped-call]


def _moved(model: Any, state: Any, action: Any, stream: Any) -> Any:
    bits = draw(stream)
    return transition(model, np.uint64(state), np.uint64(action), bits)  # type: ignore[no-untyped-call]


class TaskEnvironment(gymnasium.Env[Any, Any]):
    """A task as a Gymnasium environment, with its own rewards, ends and time limit.

    An episode is `terminated` when it enters a terminal state and `truncated` when it reaches the
    task's time limit first; never both. Rewards are the task's own, unshaped. ``info`` has the
    number of the task's state, ``state``, and its label, ``label``. The task is ``task``.

    ``reset(options={"state": ...})`` starts in a given state: its number, or the value or label of
    each of its components by name.

    Parameters
    ----------
    task : Task
        Of any kind but :class:`LiveMDP`, which is an environment already.
    observation : {"index", "components"}
        The state's number, ``Discrete(S)``; or one number for each component, ``MultiDiscrete``,
        each counted from the component's lowest value. Not every combination need be a state.
    action : {"index", "components"}
        The action's number, ``Discrete(A)``; or one number for each component.
    render_mode : {"rgb_array", "ansi"}, optional
        What :meth:`render` returns: a picture, (height, width, 3) uint8, or text. Mazes and
        pursuits are drawn; for other tasks the state's label is written.

    Raises
    ------
    TaskError
        When `task` is not a task, or a live one.
    SettingError
        When a form is unknown or not every combination of action components is an action; from
        :meth:`step`, when the action is outside the space or no episode is under way; from
        :meth:`reset`, when the options are unknown, or the state does not exist or is known to be
        terminal.

    Notes
    -----
    One draw of ``np_random`` an episode starts the random stream of the task's transitions.

    Examples
    --------
    >>> environment = TaskEnvironment(GridWorld("S.T"), render_mode="ansi")
    >>> environment.reset(seed=1)
    (0, {'state': 0, 'label': 'row=0 column=0'})
    >>> environment.step(1)
    (1, -1.0, False, False, {'state': 1, 'label': 'row=0 column=1'})
    >>> print(environment.render())
    S@T
    >>> environment.step(1)[:4]
    (2, 199.0, True, False)
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium declares it
        "render_modes": ["rgb_array", "ansi"],
        "render_fps": 4,
    }

    def __init__(
        self,
        task: Any,
        *,
        observation: Form = "index",
        action: Form = "index",
        render_mode: RenderMode | None = None,
    ):
        self.task, self.render_mode = task, render_mode
        rules = generative_model(task)
        if is_live(task):
            raise TaskError(f"a live task is an environment already: got {task!r}")
        one_of("observation", observation, ("index", "components"), SettingError)
        one_of("action", action, ("index", "components"), SettingError)
        if render_mode is not None:
            one_of("render_mode", render_mode, self.metadata["render_modes"], SettingError)
        if action == "components" and not rules.actions.is_box:
            raise SettingError(
                f"actions by component need every combination to be an action: got {rules.actions}"
            )
        self._states = Coding(rules.states, observation)
        self._actions = Coding(rules.actions, action)
        self.observation_space, self.action_space = self._states.gym_space, self._actions.gym_space
        self._rules, self._model = rules, rules.model
        self._users_code = isinstance(self._model, Functions)
        self._begun = compiled(_begun, self._users_code)
        self._moved = compiled(_moved, self._users_code)
        self._stream = np.zeros(1, np.uint64)
        self._state, self._steps, self._under_way = MISSING, 0, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, in ``options["state"]`` if given; return observation and info."""
        super().reset(seed=seed)
        self._stream[0] = self.np_random.integers(2**64, dtype=np.uint64)
        if options:
            self._state = self._named_start(options)
        else:
            self._state = self._begun(self._model, self._stream)
            self._check()
        self._steps, self._under_way = 0, True
        return self._states.coded(self._state), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act; return observation, reward, terminated, truncated and info."""
        if not self._under_way:
            raise SettingError("step() needs an episode under way: call reset() first")
        move = self._actions.number(action)
        self._state, reward, terminated = self._moved(self._model, self._state, move, self._stream)
        self._check()
        self._steps += 1
        truncated = not terminated and self._steps == self._rules.time_limit
        self._under_way = not (terminated or truncated)
        return self._states.coded(self._state), reward, terminated, truncated, self._info()

    def render(self) -> Any:
        """Return a picture of the state, (height, width, 3) uint8, or text, by `render_mode`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() draws nothing without a render_mode: rgb_array or ansi")
            return None
        draws = self._scene.image if self.render_mode == "rgb_array" else self._scene.text
        return draws(self.state)

    @property
    def state(self) -> int:
        """The number of the state the task is in."""
        if self._state == MISSING:
            raise SettingError("there is no state before the first reset()")
        return self._state

    @cached_property
    def _scene(self) -> Scene:
        return scene_of(self.task)

    def _check(self) -> None:
        """Raise TaskError if a function of the task returned what makes no sense."""
        if self._users_code and self._model.failure["by"][0]:
            self._under_way, model, self._model = False, self._model, self._rules.model
            check_answers(self.task, model)

    def _info(self) -> dict[str, Any]:
        return {"state": self._state, "label": self._states.label(self._state)}

    def _named_start(self, options: dict[str, Any]) -> int:
        if set(options) != {"state"}:
            raise SettingError(f"options may hold only 'state', to start in: got {options!r}")
        given, space = options["state"], self._rules.states
        if isinstance(given, Mapping):
            named = {name: _value(space.component(name), given[name]) for name in given}
            state = int(space.encode(**named))
        else:
            state = whole_number("the state to start in", given, 0, SettingError)
        # Of too many states the terminal ones are not listed.
        terminal = self._rules.terminal if space.size <= LARGEST_SPACE else None
        if not 0 <= state < space.size or (terminal is not None and terminal[state]):
            raise SettingError(
                f"an episode must start in a state that is not terminal: got {given!r}"
            )
        return state


def _value(component: Component, given: Any) -> int:
    """Return a component's value from a number or a label."""
    if isinstance(given, str) and component.labels and given in component.labels:
        return component.low + component.labels.index(given)
    return whole_number(f"the value of {component.name}", given, component.low, SettingError)


class MazeEnvironment(TaskEnvironment):
    """What ``Curricle/Maze-v0`` makes: a :class:`GridWorld` as an environment.

    `map` and the rules are those of :class:`GridWorld`, the other settings those of
    :class:`TaskEnvironment`. Rewards may be a dict, such as ``{"step": -5}``.
    """

    def __init__(
        self,
        map: Any = FIRST_MAZE,
        *,
        observation: Form = "index",
        action: Form = "index",
        render_mode: RenderMode | None = None,
        **rules: Any,
    ):
        if isinstance(rules.get("rewards"), Mapping):
            rules["rewards"] = Rewards(**rules["rewards"])
        maze = GridWorld(map, **rules)
        super().__init__(maze, observation=observation, action=action, render_mode=render_mode)


class PursuitEnvironment(TaskEnvironment):
    """What ``Curricle/Pursuit-v0`` makes: a :class:`Pursuit`, its predators acting as one.

    The rules are those of :class:`Pursuit`, the other settings those of :class:`TaskEnvironment`.
    """

    def __init__(
        self,
        *,
        observation: Form = "index",
        action: Form = "index",
        render_mode: RenderMode | None = None,
        **rules: Any,
    ):
        hunt = Pursuit(**rules)
        super().__init__(hunt, observation=observation, action=action, render_mode=render_mode)


def to_gymnasium(
    task: Any,
    *,
    observation: Form = "index",
    action: Form = "index",
    render_mode: RenderMode | None = None,
) -> TaskEnvironment:
    """Return a task as a Gymnasium environment.

    Parameters
    ----------
    task, observation, action, render_mode
        As in :class:`TaskEnvironment`.

    Examples
    --------
    >>> hunt = to_gymnasium(Pursuit(4, 2), observation="components", action="components")
    >>> hunt.observation_space, hunt.action_space
    (MultiDiscrete([16 16 16]), MultiDiscrete([5 5]))
    """
    return TaskEnvironment(task, observation=observation, action=action, render_mode=render_mode)
