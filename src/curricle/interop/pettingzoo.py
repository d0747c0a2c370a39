"""Pursuit as a PettingZoo environment: each predator is an agent, and all move at once."""

from copy import copy
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Discrete

from curricle.array_types import IntArray
from curricle.checks import instance, one_of
from curricle.errors import SettingError
from curricle.interop.environment import RenderMode, TaskEnvironment
from curricle.interop.spaces import Coding
from curricle.interop.vector_pursuit import PursuitVectors
from curricle.tasks.pursuit import Pursuit
from curricle.transfer.component_mapping import ComponentMapping, project

try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    ParallelEnv = object

ByAgent = dict[str, Any]
View = Literal["index", "components", "vector"]


class PursuitParallelEnv(ParallelEnv):  # type: ignore[misc]  # PettingZoo has no types
    """A pursuit as a PettingZoo environment in which each predator is an agent.

    Agents have the names of the task's components, ``predator_1``, ``predator_2``, ..., or
    ``predator`` if there is one. They move at once, all get the task's reward, and their episodes
    end together: `terminated` by a capture, or `truncated` at the task's time limit. An agent's
    ``info`` has the number of the task's state, ``state``, and its label, ``label``.

    ``reset(options={"state": ...})`` starts in a given state, as in :class:`TaskEnvironment`; other
    options are ignored.

    Parameters
    ----------
    pursuit : Pursuit
    observation : {"index", "components", "vector"}
        How every agent observes the state. Its number, ``Discrete(S)``, by which tables and
        potentials of the task are read. Or cells, ``MultiDiscrete``: the agent's own, the prey's,
        then those of the other predators in the order of their names, so that one policy can serve
        all agents. Or the vector of :class:`PursuitVectors` with the agent as the first predator.
    render_mode : {"rgb_array", "ansi"}, optional
        As in :class:`TaskEnvironment`.

    Raises
    ------
    ImportError
        When PettingZoo is not installed.
    SettingError
        When the task is no pursuit or a setting is unknown; from :meth:`step`, when an agent's
        action is missing or outside the space, or no episode is under way.

    Examples
    --------
    >>> hunt = PursuitParallelEnv(Pursuit(4, 2), observation="components")
    >>> cells, infos = hunt.reset(seed=0, options={"state": {"prey": 5, "predator_1": 1,
    ...                                                      "predator_2": 7}})
    >>> cells["predator_1"], cells["predator_2"], infos["predator_1"]["label"]
    (array([1, 5, 7]), array([7, 5, 1]), 'prey=(1,1) predator_1=(0,1) predator_2=(1,3)')
    >>> stay, west = 0, 4
    >>> cells, rewards, *_ = hunt.step({"predator_1": stay, "predator_2": west})
    >>> cells["predator_2"], rewards["predator_1"]
    (array([6, ..., 1]), -1.0)
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as PettingZoo declares it
        **TaskEnvironment.metadata,
        "name": "curricle_pursuit_v0",
        "is_parallelizable": True,
    }

    def __init__(
        self,
        pursuit: Pursuit,
        *,
        observation: View = "index",
        render_mode: RenderMode | None = None,
    ):
        if ParallelEnv is object:
            raise ImportError('PettingZoo is not installed: pip install "curricle[agents]"')
        instance("pursuit", pursuit, Pursuit, SettingError)
        one_of("observation", observation, ("index", "components", "vector"), SettingError)
        self.task, self.render_mode = pursuit, render_mode
        self._joint = TaskEnvironment(pursuit, action="components", render_mode=render_mode)
        self._observation, self._cells = observation, Coding(pursuit.states, "components")
        self._vectors = PursuitVectors(pursuit)
        self.possible_agents, self.agents = list(pursuit.predator_names), list[str]()
        # The order in which an agent sees the cells of a state; the prey's is number 0.
        predators = range(1, pursuit.predators + 1)
        own_first = [[own, *(each for each in predators if each != own)] for own in predators]
        prey_at = 0 if observation == "vector" else 1
        self._views = np.insert(own_first, prey_at, 0, axis=1)
        self.state_space = self._cells.gym_space
        self.observation_spaces = {agent: self._space() for agent in self.possible_agents}
        self.action_spaces = {agent: Discrete(pursuit.moves) for agent in self.possible_agents}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, ByAgent]:
        """Begin an episode; return each agent's observation and info."""
        named = {name: value for name, value in (options or {}).items() if name == "state"}
        _, info = self._joint.reset(seed=seed, options=named)
        self.agents = list(self.possible_agents)
        return self._observed(), self._each(info)

    def step(self, actions: ByAgent) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, ByAgent]:
        """Act; return each agent's observation, reward, terminated, truncated and info."""
        if set(actions) != set(self.agents):
            raise SettingError(
                f"a step needs an action for each of {', '.join(self.agents) or 'no agents'}: got "
                f"{actions!r}"
            )
        moves = [actions[agent] for agent in self.agents]
        _, reward, terminated, truncated, info = self._joint.step(moves)
        observed, infos = self._observed(), self._each(info)
        rewards, ends, cuts = map(self._each, (reward, terminated, truncated))
        if terminated or truncated:
            self.agents = []
        return observed, rewards, ends, cuts, infos

    def state(self) -> IntArray:
        """Return the cells of the prey and of each predator, (1 + predators,) int64."""
        return np.array(self._cells.offsets(self._joint.state))

    def render(self) -> Any:
        """Return a picture, (height, width, 3) uint8, or text, by `render_mode`."""
        return self._joint.render()

    def observation_space(self, agent: str) -> Any:
        """Return an agent's observation space."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return an agent's moves, ``Discrete``, in the order of the task's."""
        return self.action_spaces[agent]

    def _space(self) -> Any:
        if self._observation == "vector":
            return self._vectors.space
        return Coding(self.task.states, self._observation).gym_space

    def _observed(self) -> ByAgent:
        if self._observation == "index":
            return self._each(np.int64(self._joint.state))  # PettingZoo reads its dtype
        seen: Any = self.state()[self._views]
        if self._observation == "vector":
            seen = self._vectors.of(seen)
        return dict(zip(self.agents, seen, strict=True))

    def _each(self, value: Any) -> ByAgent:
        return {agent: copy(value) for agent in self.agents}


def to_pettingzoo(
    pursuit: Pursuit, *, observation: View = "index", render_mode: RenderMode | None = None
) -> PursuitParallelEnv:
    """Return a pursuit as a PettingZoo environment; needs ``pip install "curricle[agents]"``.

    Parameters
    ----------
    pursuit, observation, render_mode
        As in :class:`PursuitParallelEnv`.

    Examples
    --------
    >>> to_pettingzoo(Pursuit(4, predators=3)).possible_agents
    ['predator_1', 'predator_2', 'predator_3']
    """
    return PursuitParallelEnv(pursuit, observation=observation, render_mode=render_mode)


def agent_mappings(
    target: Pursuit, source: Pursuit, *, unmapped_value: float | None = None
) -> dict[str, ComponentMapping]:
    """Return for each agent the mapping by which it is the source's one predator.

    f_i(prey, c_1, ..., c_n; a_1, ..., a_n) = ((prey, c_i), a_i), paper E7: agent i reads the
    source's values as if it were alone with the prey.

    Parameters
    ----------
    target : Pursuit
    source : Pursuit
        With one predator.
    unmapped_value : float, optional
        As in :func:`project`; where the source's grid is smaller, pairs are unmapped.

    Returns
    -------
    dict of str to ComponentMapping
        By the agents' names.

    Examples
    --------
    What each agent would do alone, in a state in which the prey is between the two.

    >>> from curricle import solve
    >>> hunt, chase = Pursuit(3, 2), Pursuit(3, 1)
    >>> q = solve(chase).action_values
    >>> state = hunt.states.encode(prey=4, predator_1=1, predator_2=7)
    >>> for agent, mapping in agent_mappings(hunt, chase).items():
    ...     alone = mapping.read(q)[state].argmax()  # a joint action: read one's own part
    ...     print(agent, hunt.actions.component(agent).label(hunt.actions.decode(alone)[agent]))
    predator_1 south
    predator_2 north
    """
    return {
        agent: project(target, source, unmapped_value=unmapped_value, predator=agent)
        for agent in target.predator_names
    }
