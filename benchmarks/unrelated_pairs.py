"""Pairs of tasks that have nothing to do with each other, and what a mapping found there gains.

    python -m benchmarks.unrelated_pairs fit [--first 0] [--pairs 200]
    python -m benchmarks.unrelated_pairs play [--first 10000] [--pairs 50] [--seeds 20]

A pair is drawn from its number: a target and a source of two kinds, or two random MDPs, or two road
maps. `fit` prints the scores of the best mapping of each pair. `play` takes the mapping that agrees
best with the target's dynamics and values whatever the bar says, as a user who accepts it would,
compares it with scratch under all controls, and prints each answer. Numbers from 10,000 on judge:
no constant was fitted on them. `pairs` does the same for the pairs of `benchmarks.pairs`.
"""

import argparse
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import curricle as cr

TARGET_STEPS, SOURCE_STEPS = 20_000, 5_000


def road_map(
    rng: np.random.Generator, *, prize: float = 0.0, jams: int = 2, nodes: int = 20, roads: int = 4
) -> cr.FiniteMDP:
    """Return the way through a random road map whose jams come and go; each road costs its time."""
    place = rng.random((nodes, 2))
    away = np.linalg.norm(place[:, None] - place[None], axis=2)
    near = np.argsort(away, axis=1)[:, 1 : roads + 1]
    time = 1 + 5 * np.take_along_axis(away, near, axis=1)
    slower = np.ones((jams, nodes, roads))
    slower[1:] = rng.choice([1.0, 3.0], size=(jams - 1, nodes, roads))
    goal = nodes - 1

    def outcomes(node: int, jam: int, road: int) -> list[tuple[float, int, float]]:
        to, cost = int(near[node, road]), float(time[node, road] * slower[jam, node, road])
        stays = [1.0 if jams == 1 else 0.8 if j == jam else 0.2 / (jams - 1) for j in range(jams)]
        reward = prize * (to == goal) - cost
        return [(chance, to * jams + j, reward) for j, chance in enumerate(stays)]

    return cr.FiniteMDP.from_outcomes(
        [
            [outcomes(node, jam, road) if node != goal else [] for road in range(roads)]
            for node in range(nodes)
            for jam in range(jams)
        ],
        terminal=np.repeat(np.arange(nodes) == goal, jams),
        start=0,
        discount=0.99,
        time_limit=200,
    )


def garnet(rng: np.random.Generator) -> cr.FiniteMDP:
    """Return a random MDP in which some states pay, or most cost."""
    states, actions, branches = int(rng.integers(15, 50)), int(rng.integers(2, 5)), 3
    transition = np.zeros((states, actions, states))
    for s in range(states):
        for a in range(actions):
            to = rng.choice(states, branches, replace=False)
            transition[s, a, to] = rng.dirichlet(np.ones(branches))
    share, high = (0.1, 10.0) if rng.random() < 0.5 else (0.6, -2.0)
    reward = np.where(rng.random(states) < share, high * rng.random(states), 0.0)
    ends = np.zeros(states, bool)
    return cr.FiniteMDP.from_dense(
        transition, reward, terminal=ends, start=0, discount=0.95, time_limit=100
    )


def grid(rng: np.random.Generator) -> cr.GridWorld:
    """Return a room of 4 to 6 cells a side with its treasure in a corner, and some pits."""
    side, pits = int(rng.integers(4, 7)), int(rng.integers(0, 4))
    cells = np.full((side, side), ".")
    for row, column in rng.integers(0, side, (pits, 2)):
        cells[row, column] = "P"
    cells[0, 0], cells[-1, -1] = "S", "T"
    costs = cr.Rewards(step=-1, treasure=float(rng.choice([0.0, 20.0, 200.0])))
    return cr.GridWorld(["".join(row) for row in cells], rewards=costs, time_limit=200)


def maps(rng: np.random.Generator) -> cr.FiniteMDP:
    """Return a road map with or without a prize at the goal."""
    return road_map(rng, prize=float(rng.choice([0.0, 20.0, 100.0])))


def queue(rng: np.random.Generator) -> Any:
    """Return a line of places whose far end pays."""
    return cr.tasks.RiverSwim(size=int(rng.integers(5, 15)))


def chase(rng: np.random.Generator) -> Any:
    """Return a pursuit of one prey."""
    return cr.Pursuit(int(rng.integers(3, 5)), 1, time_limit=100)


KINDS: tuple[Callable[[np.random.Generator], Any], ...] = (garnet, grid, maps, queue, chase)
OF_ONE_KIND = (garnet, maps)
"""Kinds of which two draws have nothing to do with each other."""


def unrelated(number: int) -> tuple[str, Any, Any]:
    """Return the kinds of a pair in words, its target and its source."""
    rng = np.random.default_rng([46, number])
    while True:
        target, source = (KINDS[i] for i in rng.integers(len(KINDS), size=2))
        if target is not source or target in OF_ONE_KIND:
            return f"{target.__name__} <- {source.__name__}", target(rng), source(rng)
