"""Demonstrations: optimal episodes of miniatures in a replay buffer."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from curricle.deep.miniature_task import Miniatures
from curricle.deep.solved_member import SolvedMember
from curricle.errors import SettingError
from curricle.transfer.potentials import ObservationPotential


class Step(NamedTuple):
    """A step in a table: places in it, and what it pays."""

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
    members = [member for one in small for member in one.solved]
    rng = np.random.default_rng(model.seed)
    buffer, width = model.replay_buffer, model.n_envs
    for _ in range(-(-n // (width * len(members)))):
        for member in members:
            episodes = _steps(member, rng)
            rows = [next(episodes) for _ in range(width)]
            _add(buffer, member, rows)


def _add(buffer: Any, member: SolvedMember, rows: list[Step]) -> None:
    """Add one step of each sub-environment."""
    table = member.table.observations
    assert table is not None
    states, actions, rewards, after, ended = (np.array(each) for each in zip(*rows, strict=True))
    buffer.add(
        table.batch(states), table.batch(after), actions[:, None], rewards, ended,
        [{} for _ in rows],
    )  # fmt: skip


def _steps(member: SolvedMember, rng: np.random.Generator) -> Iterator[Step]:
    """Yield the steps of episodes that follow the optimal policy, one after the other."""
    mdp, policy = member.table.mdp, member.solution.policy
    while True:
        state = int(rng.choice(len(mdp.start), p=mdp.start))
        while not mdp.terminal[state]:
            action = int(rng.choice(policy.shape[1], p=policy[state]))
            row = mdp.outcome_row[state, action]
            k = int(rng.choice(mdp.probability.shape[1], p=mdp.probability[row]))
            after = int(mdp.next_state[row, k])
            yield Step(state, action, float(mdp.reward[row, k]), after, bool(mdp.terminal[after]))
            state = after
