"""PettingZoo's agents as a vector environment of Stable-Baselines3: one model for all."""

from collections.abc import Iterable, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.checks import instance
from curricle.errors import SettingError
from curricle.tasks.observation_task import stack

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    VecEnv = object

Indices = int | Iterable[int] | None


class AgentsVecEnv(VecEnv):
    """A PettingZoo environment in which one model of Stable-Baselines3 learns for every agent.

    Each agent is one sub-environment, in the order of ``possible_agents``: independent learners
    that share their weights. Episodes end for all at once; the next begins as in ``DummyVecEnv``.
    A model counts the steps of each agent: its ``num_timesteps``, and the steps given to ``learn``,
    are `num_envs` times ``joint_steps``.

    Attributes and methods are those of the one environment, the same for all indices; a method is
    called once. The first agent's seed and options are used. ``VecMonitor`` records an episode once
    for each agent.

    Parameters
    ----------
    parallel_env : pettingzoo.ParallelEnv
        All agents have the same spaces, and their episodes begin and end together.

    Attributes
    ----------
    environment : pettingzoo.ParallelEnv
    agents : tuple of str
    joint_steps : int
        Steps of the environment, without resets.

    Raises
    ------
    SettingError
        When its agents' spaces differ; from :meth:`reset` and :meth:`step_wait`, when an agent is
        missing or ends alone.

    Examples
    --------
    >>> from curricle import Pursuit
    >>> from curricle.interop import to_pettingzoo
    >>> hunt = AgentsVecEnv(to_pettingzoo(Pursuit(size=5, predators=3), observation="vector"))
    >>> hunt.num_envs, hunt.action_space, hunt.reset().shape
    (3, Discrete(5), (3, 14))
    >>> seen, rewards, ended, infos = hunt.step(np.array([0, 1, 2]))
    >>> rewards, hunt.joint_steps
    (array([-1., -1., -1.], dtype=float32), 1)
    """

    def __init__(self, parallel_env: Any):
        if VecEnv is object:
            raise ImportError("Stable-Baselines3 is not installed: pip install curricle[deep]")
        from pettingzoo import ParallelEnv

        instance("parallel_env", parallel_env, ParallelEnv, SettingError)
        self.environment, self.agents = parallel_env, tuple(parallel_env.possible_agents)
        self.joint_steps = 0
        first = self.agents[0]
        for role in ("observation", "action"):
            spaces = getattr(parallel_env, f"{role}_space")
            for agent in self.agents:
                if spaces(agent) != spaces(first):
                    raise SettingError(
                        f"agents that share a model must have one {role} space: {first} has "
                        f"{spaces(first)}, {agent} has {spaces(agent)}"
                    )
        super().__init__(
            len(self.agents),
            parallel_env.observation_space(first),
            parallel_env.action_space(first),
        )

    def reset(self) -> Any:
        """Begin an episode, with the seed and options given before; return n observations."""
        observations = self._begin(seed=self._seeds[0], options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Take the agents' actions, one each."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[Any]]:
        """Act; return observations, rewards (n,), whether the episode is over (n,) and infos."""
        chosen = dict(zip(self.agents, self._actions, strict=True))
        observed, reward, terminated, truncated, info = self.environment.step(chosen)
        self.joint_steps += 1
        observations = self._stacked(observed)
        over = np.array([terminated[agent] or truncated[agent] for agent in self.agents], np.bool_)
        if over.any() and not over.all():
            ended = ", ".join(np.array(self.agents)[over])
            raise SettingError(
                f"agents must begin and end together: the episode ended for {ended} alone"
            )
        rewards = np.array([reward[agent] for agent in self.agents], np.float32)
        infos = [
            {**info[agent], "TimeLimit.truncated": bool(truncated[agent] and not terminated[agent])}
            for agent in self.agents
        ]
        if over[0]:
            for agent, last in zip(self.agents, infos, strict=True):
                last["terminal_observation"] = deepcopy(observed[agent])
            observations = self._begin()
        return observations, rewards, over, infos

    def close(self) -> None:
        """Close the environment."""
        self.environment.close()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8]]:
        """Return one picture, in which all agents are."""
        return [self.environment.render()]

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return the environment's attribute, once for each index."""
        return [getattr(self.environment, attr_name)] * self._many(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set the environment's attribute."""
        if self._many(indices):
            setattr(self.environment, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call the environment's method once; return what it returns, once for each index."""
        if not (many := self._many(indices)):
            return []
        return [getattr(self.environment, method_name)(*method_args, **method_kwargs)] * many

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Return False for each index: Gymnasium's wrappers do not wrap agents."""
        return [False] * self._many(indices)

    def _begin(self, **settings: Any) -> Any:
        """Reset the environment and keep the infos; return the agents' observations, stacked."""
        observed, infos = self.environment.reset(**settings)
        observations = self._stacked(observed)
        self.reset_infos = [infos[agent] for agent in self.agents]
        return observations

    def _stacked(self, observed: dict[str, Any]) -> Any:
        """Return the agents' observations, stacked; SettingError when one is missing."""
        missing = [agent for agent in self.agents if agent not in observed]
        if missing:
            raise SettingError(
                f"agents must begin and end together: {', '.join(missing)} observed nothing"
            )
        return stack(self.observation_space, [observed[agent] for agent in self.agents])

    def _many(self, indices: Indices) -> int:
        """Return how many indices are meant."""
        return len(list(self._get_indices(indices)))
