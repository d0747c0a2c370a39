"""Gymnasium's toy-text environments: their transition tables, and names for their states."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.toy_text.blackjack import BlackjackEnv
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.wrappers import (
    OrderEnforcing,
    PassiveEnvChecker,
    RecordEpisodeStatistics,
    TimeLimit,
)

from curricle.interop.spaces import counts_from_0
from curricle.tasks.spaces import Component, Space

TOY_TEXT = BlackjackEnv, CliffWalkingEnv, FrozenLakeEnv, TaxiEnv
HARMLESS = OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit
"""Wrappers that change no transition; the time limit is read from the specification."""
STANDS = ("red", "green", "yellow", "blue")
Outcomes = list[list[list[tuple[float, int, float, bool]]]]


def acts_as(env: Any, *kinds: type, methods: Sequence[str] = ("step", "reset")) -> bool:
    """Return whether an environment is of one of these classes, with the class's own methods."""
    kind = next((kind for kind in kinds if isinstance(env, kind)), None)
    return kind is not None and all(
        getattr(type(env), name) is getattr(kind, name) and name not in vars(env)
        for name in methods
    )


def has_table(env: gym.Env[Any, Any]) -> bool:
    """Return whether an environment has a transition table that describes it completely.

    Its `step` and `reset` are Gymnasium's, which follow ``P`` and the start distribution. It has no
    wrapper that changes what it does, and no time limit beside the specification's. The moves of a
    taxi with fickle passengers are not in its table.
    """
    while isinstance(env, gym.Wrapper):
        if not acts_as(env, *HARMLESS) or (isinstance(env, TimeLimit) and env.spec is None):
            return False
        env = env.env
    states, actions = env.observation_space, env.action_space
    if not (acts_as(env, *TOY_TEXT) and counts_from_0(states) and counts_from_0(actions)):
        return False
    if getattr(env, "fickle_passenger", False):
        return False
    return _lists_outcomes(getattr(env, "P", None), int(states.n), int(actions.n))


def _lists_outcomes(table: Any, n_states: int, n_actions: int) -> bool:
    """Return whether ``table[s][a]`` are lists of (probability, next state, reward, terminated)."""
    try:
        pairs = [table[s][a] for s in range(n_states) for a in range(n_actions)]
        return len(table) == n_states and all(
            len(outcome) == 4 for pair in pairs for outcome in pair
        )
    except (TypeError, KeyError, IndexError):
        return False


def outcomes_of(world: Any) -> Outcomes:
    """Return a table's outcome lists, in which entering a state ends the episode always or never.

    If the table has states that end an episode only sometimes, those ends go to one more state,
    the last.
    """
    n_states, n_actions = int(world.observation_space.n), int(world.action_space.n)
    outcomes: Outcomes = [
        [[(p, int(after), r, bool(ended)) for p, after, r, ended in world.P[s][a]]
         for a in range(n_actions)]
        for s in range(n_states)
    ]  # fmt: skip
    both = _entered_both_ways(outcomes, world.initial_state_distrib)
    if not both:
        return outcomes
    apart: Outcomes = [
        [[(p, n_states if ended and after in both else after, r, ended)
          for p, after, r, ended in pair]
         for pair in pairs]
        for pairs in outcomes
    ]  # fmt: skip
    return [*apart, [[] for _ in range(n_actions)]]


def _entered_both_ways(outcomes: Outcomes, start: npt.ArrayLike) -> set[int]:
    """Return the states, entered or started in, where an episode may end or go on."""
    continuing = set(np.flatnonzero(start).tolist())
    queue, ends = list(continuing), set[int]()
    while queue:
        for pair in outcomes[queue.pop()]:
            for probability, after, _, ended in pair:
                if ended and probability > 0:
                    ends.add(after)
                elif probability > 0 and after not in continuing:
                    continuing.add(after)
                    queue.append(after)
    return continuing & ends


def names_of(world: Any) -> tuple[Space | None, Space | None]:
    """Return named state and action spaces of a known environment, None for others.

    Directions and coordinates have the names of :class:`GridWorld`, so that mappings by name work
    between the two. Actions have no labels where a subclass overrides `step`: they may go anywhere.
    """
    if isinstance(world, FrozenLakeEnv):
        moves = _moves(world, "west", "south", "east", "north")
        return _cells(*np.asarray(world.desc).shape), moves
    if isinstance(world, CliffWalkingEnv):
        return _cells(*world.shape), _moves(world, "north", "east", "south", "west")
    if isinstance(world, TaxiEnv):
        passenger = Component("passenger", 5, labels=(*STANDS, "taxi"))
        destination = Component("destination", 4, labels=STANDS)
        states = Space([*_cells(5, 5).components, passenger, destination])
        return states, _moves(world, "south", "north", "east", "west", "pick up", "drop off")
    if isinstance(world, BlackjackEnv):
        ace = Component("ace", 2, labels=("none", "usable"))
        states = Space([Component("player", 32), Component("dealer", 11), ace])
        return states, _moves(world, "stick", "hit")
    return None, None


def _cells(rows: int, columns: int) -> Space:
    return Space([Component("row", int(rows)), Component("column", int(columns))])


def _moves(world: Any, *labels: str) -> Space:
    known = acts_as(world, *TOY_TEXT, methods=["step"])
    return Space([Component("move", len(labels), labels=labels if known else None)])
