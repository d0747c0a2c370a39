"""Compiled sweeps of exact planning for a `FactoredModel`: one mover after the other, no tables.

The values of all states with the prey on one cell are a *plane*, C^k numbers. A sweep backs up
plane by plane, in place: the mean over the prey's moves is a sum of planes, and the best joint move
is the best move of each predator in turn, since max over (a, b) is max over a of max over b. So a
state costs M + k M numbers instead of M^k; all loops but one run along memory.

``backups.py`` explains what the change of a sweep proves.
"""

import numpy as np
from numba import njit

from curricle.planning.backups import (
    CONVERGED,
    converged,
    copy,
    difference,
    extrapolate,
    largest_of,
    mixed_policy_backup,
)


@njit(cache=True, nogil=True)
def expect(values, mean, landing, prey_policy, discount, cell, plane):
    """Write r + gamma times the mean over the prey's moves from `cell` into `plane`."""
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def next_predator_first(plane, n_cells, turned):
    """Write the plane with its first axis moved to the end into `turned`."""
    n = len(plane) // n_cells
    source, target = plane.reshape(n_cells, n), turned.reshape(n, n_cells)
    for cell in range(n_cells):
        for index in range(n):
            target[index, cell] = source[cell, index]


@njit(cache=True, nogil=True)
def keep(best, terminal, values, start, worst):
    """Store a plane, terminal states at 0; `worst` collects the largest change of each entry."""
    n = len(best)
    target, ended = values[start : start + n], terminal[start : start + n]
    for index in range(n):
        new = 0.0 if ended[index] else best[index]
        change = abs(new - target[index])
        worst[index] = change if change > worst[index] else worst[index]
        target[index] = new


@njit(cache=True, nogil=True)
def optimal_values(landing, prey_policy, predators, mean, terminal, discount, values, precision):
    """Bring `values`, of which V <= TV, to the optimum by value iteration, plane by plane.

    One sweep goes through the planes upwards, the next downwards; it ends and returns as
    `optimal_values` of ``backups.py`` does. The predators are interchangeable, so values that are
    symmetric in them stay symmetric, and the last transposition is left out.
    """
    n_cells = len(landing)
    n = len(values) // n_cells
    plane, best, worst = np.empty(n), np.empty(n), np.empty(n)
    least, waited, reach, backwards = np.inf, np.int64(0), largest_of(values), False
    while True:
        worst.fill(0.0)
        for index in range(n_cells):
            cell = n_cells - 1 - index if backwards else index
            expect(values, mean, landing, prey_policy, discount, cell, plane)
            best_of_moves(plane, landing, best)
            for _ in range(1, predators):
                next_predator_first(best, n_cells, plane)
                best_of_moves(plane, landing, best)
            keep(best, terminal, values, cell * n, worst)
        backwards = not backwards
        change = largest_of(worst)
        reach += change
        waited = converged(change, least, waited, values, reach, discount, precision)
        if waited == CONVERGED:
            return change
        least = min(least, change)


@njit(cache=True, nogil=True)
def policy_values(
    first,
    row,
    weight,
    landing,
    prey_policy,
    predators,
    mean,
    terminal,
    discount,
    values,
    precision,
):
    """Bring `values` to those of a policy, plane by plane; rows are numbered within a plane."""
    n_cells = len(landing)
    n = len(values) // n_cells
    plane = np.empty(n)
    step, last = np.zeros(len(values)), np.zeros(len(values))
    least, waited, reach, pairs = np.inf, np.int64(0), 0.0, 0
    while True:
        last, step = step, last
        copy(values, step)
        change = 0.0
        for cell in range(n_cells):
            expect(values, mean, landing, prey_policy, discount, cell, plane)
            there = values[cell * n : (cell + 1) * n]
            change = max(
                change, mixed_policy_backup(first, row, weight, terminal, plane, there, cell * n)
            )
        difference(step, values)
        reach += change
        waited = converged(change, least, waited, values, reach, discount, precision)
        if waited == CONVERGED:
            return change
        least = min(least, change)
        pairs += 1
        if pairs >= 4 and waited == 0 and extrapolate(values, step, last):
            pairs, reach = 0, reach + largest_of(values)
