"""Demonstrations: optimal episodes of miniatures in a replay buffer."""

from collections.abc import Iterator, Mapping
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.buffers import DictReplayBuffer, ReplayBuffer
from stable_baselines3.common.preprocessing import maybe_transpose

from curricle.deep.miniature_task import Miniatures
from curricle.deep.solved_member import SolvedMember
from curricle.errors import SettingError
from curricle.transfer.potentials import ObservationPotential


class Step(NamedTuple):
    """A step in a table: the numbers of its states, and the reward."""

    state: int
    action: int
    reward: float
    after: int
    terminated: bool


def fill_replay_buffer(model: Any, potential: ObservationPotential, n: int) -> None:
    """Add n steps of optimal episodes of a potential's miniatures to a model's replay buffer.

    SettingError unless its sources are miniatures.
    """
    sources = [edge.mapping.source for edge in potential.edges]
    small = [one for one in sources if isinstance(one, Miniatures)]
    if len(small) < len(sources):
        raise SettingError(
            "demonstrations are played in the tables of miniatures: got "
            f"{', '.join(type(one).__name__ for one in sources)}"
        )
    buffer, width = model.replay_buffer, model.n_envs
    if type(buffer) not in (ReplayBuffer, DictReplayBuffer) or buffer.optimize_memory_usage:
        raise SettingError(
            "demonstrations need a replay buffer that keeps each step by itself: got "
            f"{type(buffer).__name__} with optimize_memory_usage="
            f"{getattr(buffer, 'optimize_memory_usage', False)}"
        )
    members = [member for one in small for member in one.solved]
    rng = np.random.default_rng(model.seed)
    each = [(member, _steps(member, rng)) for member in members]
    for _ in range(-(-n // (width * len(members)))):
        for member, episodes in each:
            rows = [next(episodes) for _ in range(width)]
            _add(model, member, rows)


def _add(model: Any, member: SolvedMember, rows: list[Step]) -> None:
    """Add one step of each sub-environment."""
    table = member.table.observations
    assert table is not None
    states, actions, rewards, after, ended = (np.array(each) for each in zip(*rows, strict=True))
    seen, then = (_as_stored(model, table.batch(each)) for each in (states, after))
    model.replay_buffer.add(seen, then, actions[:, None], rewards, ended, [{} for _ in rows])


def _as_stored(model: Any, observations: Any) -> Any:
    """Return observations as a model's environments give them, pictures with channels first."""
    if isinstance(observations, Mapping):
        spaces = model.observation_space.spaces
        return {name: maybe_transpose(one, spaces[name]) for name, one in observations.items()}
    return maybe_transpose(observations, model.observation_space)


def _steps(member: SolvedMember, rng: np.random.Generator) -> Iterator[Step]:
    """Yield the steps of episodes that follow the optimal policy, one after the other.

    Episodes that are cut off at the time limit are not terminated there.
    """
    mdp, policy = member.table.mdp, member.solution.policy
    while True:
        state = int(rng.choice(len(mdp.start), p=mdp.start))
        for taken in count():
            if mdp.terminal[state] or taken == mdp.time_limit:
                break
            action = int(rng.choice(policy.shape[1], p=policy[state]))
            row = mdp.outcome_row[state, action]
            k = int(rng.choice(mdp.probability.shape[1], p=mdp.probability[row]))
            after = int(mdp.next_state[row, k])
            yield Step(state, action, float(mdp.reward[row, k]), after, bool(mdp.terminal[after]))
            state = after
