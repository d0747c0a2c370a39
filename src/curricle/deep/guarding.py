"""A guard for networks: two models that learn side by side, one with the source and one without it.

``turns.py`` says which of them acts, and what that bounds. Off-policy models learn from every step
of both; each on-policy model has sub-environments of its own, and learns from its own steps alone.
The model without the source is the one that Stable-Baselines3 trains; it has the other one act and
learn in its place, so that callbacks, logs and checkpoints are those of one model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from stable_baselines3.common.buffers import DictReplayBuffer, ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback

from curricle.deep.learner import DeepLearner
from curricle.deep.models import environments, model_for, subtracted
from curricle.deep.networks import NetworkValues
from curricle.deep.turns import Turns
from curricle.errors import SettingError
from curricle.learning.guard import SCRATCH
from curricle.learning.shaping import Shaping
from curricle.tasks.draws import splitmix64
from curricle.tasks.observation_task import ObservationTask
from curricle.transfer.potentials import ObservationPotential


class _Watch(BaseCallback):
    """Notes what the acting model earns, and passes its steps on to the callbacks of the first."""

    def __init__(self, first: Any, acting: Any, callback: BaseCallback):
        super().__init__()
        self.first, self.model, self.callback = first, acting, callback

    def _on_rollout_start(self) -> None:
        self.callback.on_rollout_start()

    def _on_step(self) -> bool:
        self.first.num_timesteps = self.model.num_timesteps
        self.first.turns.step(self.locals["infos"])
        self.callback.update_locals(self.locals)
        return bool(self.callback.on_step())

    def _on_rollout_end(self) -> None:
        self.callback.update_locals(self.locals)
        self.callback.on_rollout_end()


class _Guarded:
    """Makes the model without the source one that trains another one, ``shaped``, beside it."""

    shaped: Any
    turns: Turns

    def _setup_learn(
        self,
        total_timesteps: int,
        callback: Any = None,
        reset_num_timesteps: bool = True,
        *others: Any,
        **named: Any,
    ) -> Any:
        self.shaped.num_timesteps = self.num_timesteps  # type: ignore[attr-defined]
        found = super()._setup_learn(  # type: ignore[misc]
            total_timesteps, callback, reset_num_timesteps, *others, **named
        )
        self.shaped.set_logger(self.logger)  # type: ignore[attr-defined]
        self.shaped._setup_learn(total_timesteps, None, reset_num_timesteps)
        for name in ("ep_info_buffer", "ep_success_buffer"):  # what is logged is of both
            setattr(self.shaped, name, getattr(self, name))
        return found

    def _turn(self, callback: BaseCallback) -> tuple[Any, _Watch]:
        """Return the model that acts now, and its callback."""
        self.turns.begin()
        acting = self if self.turns.acting == SCRATCH else self.shaped
        keep_time(self, self.shaped)
        return acting, _Watch(self, acting, callback)


class _OnPolicy(_Guarded):
    """The model that acts learns from its own rollout."""

    def collect_rollouts(
        self, env: Any, callback: BaseCallback, rollout_buffer: Any, *others: Any, **named: Any
    ) -> bool:
        acting, watch = self._turn(callback)
        if acting is self:
            return bool(
                super().collect_rollouts(env, watch, rollout_buffer, *others, **named)  # type: ignore[misc]
            )
        found = acting.collect_rollouts(acting.env, watch, acting.rollout_buffer, *others, **named)
        keep_time(acting, self)
        return bool(found)

    def train(self) -> None:
        if self.turns.acting == SCRATCH:
            super().train()  # type: ignore[misc]
        else:
            keep_time(self, self.shaped)
            self.shaped.train()


class _OffPolicy(_Guarded):
    """Both models learn from the steps of the one that acts."""

    fed: "_Buffers"

    def collect_rollouts(self, env: Any, callback: BaseCallback, **named: Any) -> Any:
        acting, watch = self._turn(callback)
        named = {**named, "replay_buffer": self.fed, "action_noise": acting.action_noise}
        collect = super().collect_rollouts if acting is self else acting.collect_rollouts  # type: ignore[misc]
        found = collect(acting.env, watch, **named)
        waiting: Any = self.shaped if acting is self else self
        keep_time(acting, waiting)
        for _ in range(found.episode_timesteps // acting.n_envs):
            waiting._on_step()  # where DQN updates its target network
        return found

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        for update in (super().train, self.shaped.train):  # type: ignore[misc]
            update(gradient_steps=gradient_steps, batch_size=batch_size)


def keep_time(of: Any, to: Any) -> None:
    """Have a model's schedules go on from where another one's are."""
    for name in ("num_timesteps", "_current_progress_remaining", "_episode_num"):
        setattr(to, name, getattr(of, name))


@dataclass
class _Buffers:
    """The replay buffers of both models, which may be one."""

    plain: Any
    shaped: Any
    phi: ObservationPotential | None
    """What shapes the rewards in the second."""
    discount: float

    def add(self, seen: Any, then: Any, actions: Any, rewards: Any, dones: Any, infos: Any) -> None:
        """Add a step of each sub-environment, with the task's own rewards."""
        self.plain.add(seen, then, actions, rewards, dones, infos)
        if self.shaped is self.plain:
            return
        if self.phi is not None:
            cut_off = np.array([info.get("TimeLimit.truncated", False) for info in infos])
            after = np.where(dones & ~cut_off, 0.0, self.phi.v(then))
            rewards = rewards + self.discount * after - self.phi.v(seen)
        self.shaped.add(seen, then, actions, rewards, dones, infos)


def guarded_model(
    task: ObservationTask, learner: DeepLearner, shaping: Shaping, *, seed: int, steps: int
) -> Any:
    """Return a model without a shaping that trains one with it beside it.

    Alone, the first would be what :func:`model_for` returns for the same seed. SettingError when
    the algorithm has neither rollouts nor a plain replay buffer.

    Examples
    --------
    >>> from curricle import Guard, StateShaping, observation_task
    >>> from curricle.transfer import FunctionValues
    >>> pole = observation_task("CartPole-v1")
    >>> upright = FunctionValues(state_values=lambda poles: -abs(poles[:, 2]))
    >>> phi = ObservationPotential.of(pole, upright)
    >>> ppo = DeepLearner("PPO", settings={"n_steps": 64})
    >>> model = guarded_model(pole, ppo, StateShaping(phi, Guard()), seed=1, steps=128)
    >>> type(model).__name__, type(model.shaped).__name__, model.turns.share
    ('GuardedPPO', 'PPO', 0.5)
    """
    assert shaping.guard is not None
    shaped = model_for(task, learner, shaping, seed=splitmix64(seed) >> 33, steps=steps)
    replay = getattr(shaped, "replay_buffer", None)
    if replay is None and not hasattr(shaped, "rollout_buffer"):
        raise SettingError(
            f"a guard needs an algorithm with rollouts or a replay buffer: got {learner.algorithm}"
        )
    if replay is not None:
        _check_replay(learner, replay)
    way = _OnPolicy if replay is None else _OffPolicy
    model = model_for(
        task, learner, seed=seed, steps=steps,
        derived=lambda algorithm: type(f"Guarded{algorithm.__name__}", (way, algorithm), {}),
    )  # fmt: skip
    model.shaped = shaped
    model.turns = Turns(shaping.guard, learner.envs, shared=replay is not None)
    phi = subtracted(shaping)
    if replay is not None:
        if phi is None and not replay.size():
            shaped.replay_buffer = model.replay_buffer
        elif phi is not None:  # rewards are shaped on their way into its buffer
            shaped.env.close()
            shaped.set_env(environments(task, learner, None))
            shaped.env.seed(splitmix64(seed) >> 33)
        model.fed = _Buffers(model.replay_buffer, shaped.replay_buffer, phi, task.discount)
    return model


def _check_replay(learner: DeepLearner, replay: Any) -> None:
    """Raise SettingError unless a replay buffer keeps each step by itself."""
    if type(replay) not in (ReplayBuffer, DictReplayBuffer) or replay.optimize_memory_usage:
        raise SettingError(
            "a guard needs a replay buffer that keeps each step by itself, as two models take "
            f"turns to fill it: got {type(replay).__name__} of {learner}"
        )


def beside_each_other(model: Any, shaping: Shaping | None) -> list[tuple[Any, Shaping | None]]:
    """Return a model, and the one beside it, each with the shaping of its environments."""
    if not isinstance(model, _Guarded):
        return [(model, shaping)]
    return [(model, None), (model.shaped, None if model.turns.shared else shaping)]


def learnt_values(model: Any, shaping: Shaping | None) -> Callable[[], NetworkValues]:
    """Return what returns a model's values: of a guarded one those of the one that is ahead."""
    if not isinstance(model, _Guarded):
        values = NetworkValues(model.policy, subtracted(shaping))
        return lambda: values
    without: Any = model
    each = (
        NetworkValues(without.policy, without_source=True),
        NetworkValues(model.shaped.policy, subtracted(shaping)),
    )
    return lambda: each[without.turns.ahead]


def guard_share(model: Any) -> float:
    """Return the share of the steps for the model with the source; NaN without a guard."""
    return float(model.turns.share) if isinstance(model, _Guarded) else float("nan")
