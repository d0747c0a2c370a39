"""Backups of exact planning for a `FactoredModel`: no tables, first the prey, then each predator.

The values of all states with the prey on one cell are a *plane*, C^k numbers. A sweep backs up
plane by plane, in place: the mean over the prey's moves is a sum of planes, and the best joint move
is the best move of each predator in turn, since max over (a, b) is max over a of max over b. So a
state costs M + k M numbers instead of M^k; all loops but one run along memory.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray
from curricle.planning.backups import MixedPolicy, back_ups, largest_of, mixed_policy_backup
from curricle.tasks.loop_cache import compiled_once


class Planes(NamedTuple):
    """What backups read of a factored model."""

    mean: FloatArray  # (S,) reward of a step from the prey's cell to the predators' cells
    landing: npt.NDArray[np.int32]  # (C, M)
    prey_policy: FloatArray  # (C, M)
    terminal: BoolArray  # (S,)
    discount: float


class GreedyPlanes(NamedTuple):
    """Value iteration: one sweep goes through the planes upwards, the next downwards.

    The predators are interchangeable, so values that are symmetric in them stay symmetric, and the
    last transposition is left out.
    """

    planes: Planes
    predators: int
    space: FloatArray  # (3, C^k) work space: a plane, its best moves, the largest change of each


@back_ups.body(GreedyPlanes)
def _greedy_backup(backup, values, sweep):
    planes, n_cells = backup.planes, len(backup.planes.landing)
    plane, best, worst = backup.space[0], backup.space[1], backup.space[2]
    worst.fill(0.0)
    for index in range(n_cells):
        cell = n_cells - 1 - index if sweep % 2 else index
        expect(planes, values, cell, plane)
        best_of_moves(plane, planes.landing, best)
        for _ in range(1, backup.predators):
            next_predator_first(best, n_cells, plane)
            best_of_moves(plane, planes.landing, best)
        keep(best, planes.terminal, values, cell * len(plane), worst)
    return largest_of(worst)


class PolicyPlanes(NamedTuple):
    """Of a given policy, plane by plane; its outcome rows are numbered within a plane."""

    planes: Planes
    policy: MixedPolicy
    plane: FloatArray  # (C^k,) work space


@back_ups.body(PolicyPlanes)
def _policy_backup(backup, values, sweep):
    plane, n, change = backup.plane, len(backup.plane), 0.0
    for cell in range(len(backup.planes.landing)):
        expect(backup.planes, values, cell, plane)
        there, start = values[cell * n : (cell + 1) * n], cell * n
        change = max(
            change, mixed_policy_backup(backup.policy, backup.planes.terminal, plane, there, start)
        )
    return change


@compiled_once
def expect(planes, values, cell, plane):
    """Write r + gamma times the mean over the prey's moves from `cell` into `plane`."""
    mean, landing, prey_policy, _, discount = planes
    n, n_moves = len(plane), landing.shape[1]
    base = mean[cell * n : (cell + 1) * n]
    source = values[landing[cell, 0] * n : (landing[cell, 0] + 1) * n]
    chance = discount * prey_policy[cell, 0]
    for index in range(n):
        plane[index] = base[index] + chance * source[index]
    for move in range(1, n_moves):
        source = values[landing[cell, move] * n : (landing[cell, move] + 1) * n]
        chance = discount * prey_policy[cell, move]
        for index in range(n):
            plane[index] += chance * source[index]


@compiled_once
def best_of_moves(plane, landing, best):
    """Write the best over the moves of the first predator, the slowest axis, into `best`."""
    n_cells, n_moves = landing.shape
    n = len(plane) // n_cells
    second = min(1, n_moves - 1)
    for cell in range(n_cells):
        target = best[cell * n : (cell + 1) * n]
        source = plane[landing[cell, 0] * n : (landing[cell, 0] + 1) * n]
        other = plane[landing[cell, second] * n : (landing[cell, second] + 1) * n]
        for index in range(n):
            one, two = source[index], other[index]
            target[index] = one if one > two else two
        for move in range(2, n_moves):
            source = plane[landing[cell, move] * n : (landing[cell, move] + 1) * n]
            for index in range(n):
                one, two = source[index], target[index]
                target[index] = one if one > two else two


@compiled_once
def next_predator_first(plane, n_cells, turned):
    """Write the plane with its first axis moved to the end into `turned`."""
    n = len(plane) // n_cells
    source, target = plane.reshape(n_cells, n), turned.reshape(n, n_cells)
    for cell in range(n_cells):
        for index in range(n):
            target[index, cell] = source[cell, index]


@compiled_once
def keep(best, terminal, values, start, worst):
    """Store a plane, terminal states at 0; `worst` collects the largest change of each entry."""
    n = len(best)
    target, ended = values[start : start + n], terminal[start : start + n]
    for index in range(n):
        new = 0.0 if ended[index] else best[index]
        change = abs(new - target[index])
        worst[index] = change if change > worst[index] else worst[index]
        target[index] = new
