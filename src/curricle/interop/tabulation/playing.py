"""Whether tables say what an environment does: episodes in it, step by step."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from curricle.array_types import IntArray
from curricle.errors import TaskError
from curricle.interop.tabulation.assembling import Tables
from curricle.interop.tabulation.observation_table import parts_of, same_observation
from curricle.interop.tabulation.world import World

STEPS = 1000
"""Steps that are compared with the tables."""
WALKS = 20
"""Times that an episode goes to a state drawn at random, before it goes on at random."""
CLOSE = 1e-9
"""Relative difference of rewards that is rounding."""


class Checker:
    """Plays episodes and follows them in the tables.

    What saves and restores a state may miss a part of it; then the tables and the environment
    differ sooner or later.

    Parameters
    ----------
    world : World
        Its environment is played, with all wrappers.
    tables : Tables
    n_actions : int
    """

    def __init__(self, world: World, tables: Tables, n_actions: int):
        self.env, self.act, self.name = world.env, world.act, world.name
        self.tables, self.n_actions = tables, n_actions
        self.rng = np.random.default_rng(0)
        self.steps = 0

    def check(self, seeds: Sequence[int]) -> int:
        """Return how many steps were compared; TaskError where one is not in the tables."""
        for walk in range(WALKS):
            k = walk % len(seeds)
            first = int(self.tables.first[k])
            self._play(seeds[k], first, self._way(first))
            if self.steps >= STEPS:
                break
        return self.steps

    def _play(self, seed: int, first: int, way: Sequence[int]) -> None:
        """Play one episode: along a way, then at random."""
        observed, _ = self.env.reset(seed=seed)
        possible, truncated, taken = {first}, False, 0
        self._compare(possible, observed, f"a reset with seed {seed}")
        most = len(way) + STEPS // WALKS
        while not truncated and taken < most and not self.tables.terminal[list(possible)].any():
            action = way[taken] if taken < len(way) else int(self.rng.integers(self.n_actions))
            observed, reward, ended, truncated, _ = self.env.step(self.act(action))
            taken += 1
            self.steps += 1
            possible = {
                after
                for state in possible
                for after in self._successors(state, action, float(reward), bool(ended))
            }
            where = f"step {taken} after a reset with seed {seed}, action {action}"
            possible = self._compare(possible, observed, where)

    def _successors(self, state: int, action: int, reward: float, ended: bool) -> list[int]:
        """Return the states that the tables give for what a step returned."""
        tables, pair = self.tables, state * self.n_actions + action
        fits = (
            (tables.probability[pair] > 0)
            & np.isclose(tables.reward[pair], reward, rtol=CLOSE, atol=CLOSE)
            & (tables.terminal[tables.next_state[pair]] == ended)
        )
        return tables.next_state[pair][fits].tolist()  # type: ignore[no-any-return]

    def _compare(self, possible: set[int], observed: Any, where: str) -> set[int]:
        """Return the possible states that look like what was observed, at least one."""
        seen = self.tables.observations
        if seen is not None:
            parts = parts_of(observed)
            possible = {
                state
                for state in possible
                if same_observation({n: a[state] for n, a in seen.parts.items()}, parts)
            }
        if not possible:
            raise TaskError(
                "tables must say what the environment does, so that all that matters of a state "
                f"must be saved and compared: {where} led elsewhere in {self.name}"
            )
        return possible

    def _way(self, first: int) -> list[int]:
        """Return actions that lead to a state drawn at random if their most likely outcomes do."""
        tables = self.tables
        likely = tables.next_state[np.arange(len(tables.next_state)), tables.probability.argmax(1)]
        after = likely.reshape(-1, self.n_actions)
        parent = _breadth_first(after, tables.terminal, first)
        met = np.flatnonzero(parent[:, 0] >= 0)
        state, way = int(self.rng.choice(met)), list[int]()
        while state != first:
            before, action = parent[state].tolist()
            way.append(action)
            state = before
        return way[::-1]


def _breadth_first(after: IntArray, terminal: Any, first: int) -> IntArray:
    """Return the state and action from which each state is first reached, (S, 2); -1 where not."""
    parent = np.full((len(after), 2), -1)
    parent[first] = first, 0
    front = np.array([first])
    while front.size:
        front = front[~terminal[front]]
        new = after[front]
        state, action = np.nonzero(parent[new, 0] < 0)
        found, which = np.unique(new[state, action], return_index=True)
        parent[found, 0], parent[found, 1] = front[state[which]], action[which]
        front = found
    return parent
