"""Vector environments of Stable-Baselines3: with shaped rewards, and of PettingZoo's agents."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector.utils import batch_space

from curricle.array_types import BoolArray, FloatArray
from curricle.checks import instance
from curricle.errors import SettingError
from curricle.interop.potential_shaping import (
    Episodes,
    Potential,
    check_unshaped,
    shaping_potential,
)
from curricle.learning.schedules import Schedule
from curricle.tasks.observation_task import stack
from curricle.transfer.aggregation import Aggregate

try:
    from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, unwrap_vec_normalize
except ModuleNotFoundError:  # the extra is not installed: the constructor raises ImportError
    VecEnv = VecEnvWrapper = object

Indices = int | Iterable[int] | None


def _need_stable_baselines3() -> None:
    if VecEnv is object:
        raise ImportError('Stable-Baselines3 is not installed: pip install "curricle[deep]"')


class ShapedVecEnv(VecEnvWrapper):
    """Adds F = gamma Phi(s', t + 1) - Phi(s, t) to the rewards of each of n sub-environments.

    It is :class:`VectorPotentialShaping` for the vector environments of Stable-Baselines3. Phi(s')
    is 0 where an episode terminated; where it was cut off (``info["TimeLimit.truncated"]``) s' is
    ``info["terminal_observation"]``, from which the algorithms bootstrap.

    Each sub-environment's ``info`` holds what :class:`PotentialShaping` puts there;
    ``shaping_terms`` only where there are several sources.

    Wrappers inside see the task's own rewards, wrappers outside the shaped ones. `Monitor`,
    `VecMonitor` and wrappers that clip rewards belong inside: then ``rollout/ep_rew_mean`` is that
    of the task. `VecNormalize` belongs outside. An environment for evaluation needs no shaping.

    Parameters
    ----------
    venv : stable_baselines3.common.vec_env.VecEnv
    potential, discount, weight, aggregate, encode, tolerance, batched
        As in :class:`VectorPotentialShaping`; the discount must be the algorithm's ``gamma``.

    Raises
    ------
    PotentialError, SettingError
        As :class:`VectorPotentialShaping`; when a `VecNormalize` is inside, as off-policy
        algorithms would store its unshaped rewards; and when an algorithm calls
        ``compute_reward``, as hindsight replay does, which would be unshaped too.

    Examples
    --------
    >>> import gymnasium
    >>> from stable_baselines3.common.vec_env import DummyVecEnv
    >>> lakes = DummyVecEnv([lambda: gymnasium.make("FrozenLake-v1", is_slippery=False)] * 2)
    >>> venv = ShapedVecEnv(lakes, lambda square: square / 15, discount=0.9)
    >>> venv.reset(), venv.step(np.array([1, 2]))[1]  # to the squares 4 and 1
    (array([0, 0]), array([0.24, 0.06]))
    """

    def __init__(
        self,
        venv: VecEnv,
        potential: Potential | Mapping[str, Potential],
        *,
        discount: float | None = None,
        weight: float | Schedule = 1.0,
        aggregate: Aggregate | None = None,
        encode: Callable[[Any], Any] | None = None,
        tolerance: float | None = 1e-6,
        batched: bool = False,
    ):
        _need_stable_baselines3()
        super().__init__(venv)
        if unwrap_vec_normalize(venv) is not None:
            raise SettingError(
                "VecNormalize must be outside of the shaping: off-policy algorithms store the "
                "rewards that go into it"
            )
        space = venv.observation_space
        self._potential = shaping_potential(
            potential,
            space,
            discount=discount,
            weight=weight,
            aggregate=aggregate,
            encode=encode,
            tolerance=tolerance,
            batched=batched,
        )
        stacked = batch_space(space, venv.num_envs)
        finals_in = "info['terminal_observation']"
        self._episodes = Episodes(self._potential, stacked, venv.num_envs, finals_in)

    @property
    def discount(self) -> float:
        """The discount gamma."""
        return self._potential.discount

    def reset(self) -> Any:
        """Reset all sub-environments and return what they return."""
        observations = self.venv.reset()
        self._episodes.begin(observations)
        return observations

    def step_wait(self) -> tuple[Any, FloatArray, BoolArray, list[dict[str, Any]]]:
        """Return what the environments return, with shaped rewards and their parts in the infos."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for info in infos:
            check_unshaped(info)
        truncated = np.array([info.get("TimeLimit.truncated", False) for info in infos]) & dones
        done = self._episodes.step(
            observations, rewards, dones & ~truncated, truncated,
            lambda i: infos[i].get("terminal_observation"),
        )  # fmt: skip
        sources, infos = self._potential.sources, [*infos]
        shaped = np.array([shaping[0] for shaping in done.shaping]) + rewards
        steps = zip(rewards.tolist(), done.shaping, done.potential, strict=True)
        for i, (reward, shaping, phi) in enumerate(steps):
            infos[i] = {
                **infos[i],
                "original_reward": reward,
                "shaping": shaping[0],
                "potential": phi,
                **done.ended.get(i, {}),
            }
            if len(sources) > 1:
                infos[i]["shaping_terms"] = dict(zip(sources, shaping[1:], strict=True))
        return observations, shaped, dones, infos

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **named: Any) -> Any:
        """Call a method of the environments; SettingError where it recomputes rewards."""
        if method_name == "compute_reward":
            raise SettingError(
                "rewards that are computed anew, as in hindsight replay, would lack the shaping: "
                "an algorithm that does so must learn from the unshaped environment"
            )
        return self.venv.env_method(method_name, *args, indices=indices, **named)

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        del state["class_attributes"]  # the class's members, of which some cannot be pickled
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))


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
        _need_stable_baselines3()
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

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], BoolArray, list[Any]]:
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
