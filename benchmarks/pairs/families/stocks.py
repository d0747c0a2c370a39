"""Verification: inventories that never end: sales are paid, orders and stock cost."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import by_value, task_of

DEMAND = (0.15, 0.25, 0.25, 0.2, 0.15)
SLACK = (0.45, 0.3, 0.15, 0.1, 0.0)
BATCH = 3


def stock(
    room: int, demand: tuple[float, ...], *, price: float = 5.0, holding: float = 0.2,
    order: float = 4.0,
) -> cr.FiniteMDP:  # fmt: skip
    """Return one good: order 0 to 3 batches at a fixed and a unit cost, then sell what is asked."""

    def outcomes(point: Any, action: int) -> Any:
        (held,) = point
        full = min(held + BATCH * action, room)
        cost = (order if action else 0.0) + 2.0 * BATCH * action
        return [
            (p, (full - min(full, d),), price * min(full, d) - holding * full - cost)
            for d, p in enumerate(demand) if p
        ]  # fmt: skip

    return task_of(
        [(n,) for n in range(room + 1)],
        ("stock",), cr.Component("order", 4), outcomes,
        starts=lambda point: point[0] == 0, discount=0.95, time_limit=100,
    )  # fmt: skip


def two_stocks(room: int) -> cr.FiniteMDP:
    """Return two goods; a step orders for none, the first, the second or both, cheaper at once."""
    demands = ((0.4, 0.4, 0.2), (0.7, 0.2, 0.1))
    prices = (5.0, 9.0)

    def outcomes(point: Any, action: int) -> Any:
        asked = action & 1, action >> 1
        cost = (3.0 if action else 0.0) + 2.0 * BATCH * sum(asked)
        full = [min(n + BATCH * more, room) for n, more in zip(point, asked, strict=True)]
        found: list[Any] = []
        for i, p in enumerate(demands[0]):
            for j, q in enumerate(demands[1]):
                sold = min(full[0], i), min(full[1], j)
                paid = prices[0] * sold[0] + prices[1] * sold[1]
                left = full[0] - sold[0], full[1] - sold[1]
                found.append((p * q, left, paid - 0.2 * sum(full) - cost))
        return found

    return task_of(
        [tuple(point) for point in np.ndindex(room + 1, room + 1)],
        ("stock", "other"), cr.Component("order", 4), outcomes,
        starts=lambda point: point == (0, 0), discount=0.95, time_limit=100,
    )  # fmt: skip


def one_of_two(good: str) -> Any:
    """Return how one good of two reads a single one."""

    def read(state: Any, action: Any) -> Any:
        asked = action["order"] & 1 if good == "stock" else action["order"] >> 1
        return {"stock": state[good]}, {"order": asked}

    return read


def stocks() -> Family:
    """Return one good (10,000 steps) and two (20,000)."""
    family = Family("stocks", "verification")
    family.target("one good", stock(30, DEMAND), 10_000)
    small, slack = stock(12, DEMAND), stock(30, SLACK)
    dear = stock(30, DEMAND, price=2.5)
    hoard = stock(30, DEMAND, price=0.0, holding=-1.0)
    family.add("near", "less room", small, budget=2_000)
    family.add("near", "less demand", slack, budget=3_000)
    family.add("far", "half the price", dear, budget=3_000)
    family.add("wrong goal", "paid for stock", hoard, budget=6_000)
    family.add("mirrored", "full for empty", slack, by_value(lambda n: 30 - n), budget=3_000)
    family.add("useless", "orders reversed", small, budget=2_000, turned=True)
    family.spoil("less demand")
    family.target("two goods", two_stocks(9), 20_000)
    alone = stock(9, (0.4, 0.4, 0.2), order=2.0)
    first, second = one_of_two("stock"), one_of_two("other")
    family.add("near", "two alone", alone, first, second, budget=2_000, aggregate=cr.total)
    family.add("far", "one alone", alone, first, budget=2_000)
    return family
