"""Development: pursuit; the target has one predator more than the source, or more cells."""

from dataclasses import replace
from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family


def pursuit(size: int, predators: int, **rules: Any) -> cr.FiniteMDP:
    """Return a pursuit as tables, which are evaluated exactly."""
    return cr.Pursuit(size, predators, moves=4, time_limit=50, discount=0.95, **rules).mdp


def shifted(large: int, small: int) -> Any:
    """Return how a grid reads a smaller one, both players moved so that the prey is well inside."""

    def read(state: Any, action: Any) -> Any:
        at = {name: np.divmod(cell, large) for name, cell in state.items()}
        corner = [np.clip(axis - small // 2, 0, large - small) for axis in at["prey"]]
        cells = {}
        for name, place in at.items():
            row, column = (axis - first for axis, first in zip(place, corner, strict=True))
            inside = (row >= 0) & (row < small) & (column >= 0) & (column < small)
            cells[name] = np.where(inside, row * small + column, -1)
        return cells, action

    return read


def roles_swapped(state: Any, action: Any) -> Any:
    """Take the prey for the predator."""
    return {"prey": state["predator"], "predator": state["prey"]}, action


def hunts() -> Family:
    """Return the family: two predators on 3x3 (80,000 steps), one on 5x5 (60,000)."""
    family = Family("hunts", "development")
    hunt = family.target("two predators", pursuit(3, 2), 80_000)
    chase, either = pursuit(3, 1), pursuit(3, 2, capture="any")
    going_north = np.tile([1.0, 0.0, 0.0, 0.0], (len(chase.probability), 1))
    north = replace(chase, probability=going_north)
    fleeing = pursuit(3, 1, step_reward=1.0)
    both, idle, away = (
        [cr.project(hunt, source, predator=f"predator_{i}") for i in (1, 2)]
        for source in (chase, north, fleeing)
    )
    least: dict[str, Any] = {"aggregate": cr.minimum}
    family.add("near", "one chases", chase, *both, budget=12_000, **least)
    family.add("near", "one of the two", chase, both[0], budget=12_000)
    family.add("far", "the prey goes north", north, *idle, budget=12_000, **least)
    family.add("far", "either may catch", either, cr.project(hunt, either), budget=30_000)
    family.add("wrong goal", "paid while it is free", fleeing, *away, budget=12_000, **least)
    family.spoil("one chases")

    family.target("5x5", pursuit(5, 1), 60_000)
    small = pursuit(3, 1)
    family.add("near", "3x3 around the prey", small, shifted(5, 3), budget=12_000)
    family.add("mirrored", "3x3, moves reversed", small, shifted(5, 3), budget=12_000, turned=True)
    family.add("useless", "roles swapped", pursuit(5, 1), roles_swapped, budget=30_000)
    return family
