"""What the policy that a network hands on returns in its target, before anything is learnt."""

from contextlib import closing
from typing import Any

import numpy as np

from curricle.tasks.draws import splitmix64, stream_start
from curricle.transfer.observation_rollouts import (
    Environments,
    ObservationTarget,
    mean_episode_return,
)


def policy_return(potential: Any, target: ObservationTarget, *, seed: int = 0) -> float:
    """Return the mean return of a potential's one source, a network with an actor, in a target.

    Actions are sampled, and rewards summed or discounted, as the target's evaluation has it. NaN
    where there are several sources, a mapping changes what they read, or the source has no actor.
    """
    (edge, *others), source = potential.edges, potential.values[0]
    if others or not edge.mapping.is_identity or getattr(source, "kind", "") != "value_net":
        return float("nan")
    from curricle.deep.checkpoint import drawing  # needs torch

    def policy(observations: Any) -> tuple[Any, Any]:
        actions = source.act(observations, sampled=target.evaluation.sampled)
        return actions, np.zeros(len(actions))

    start = splitmix64(stream_start(seed, "policy_return"))
    horizon = target.evaluation.horizon(target.task)
    environments = Environments(target.task, target.episodes, horizon)
    with closing(environments), drawing(start):
        episodes = environments.rollouts(policy, start)
    return mean_episode_return(episodes, target.evaluation.discount(target.task))
