"""Development: queues that never end; costs for waiting, a reward for nothing."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import by_value, task_of

FAST_COST = 4.0


def single(room: int, arrivals: float, *, holding: float = -0.5) -> cr.FiniteMDP:
    """Return one queue: serve slowly, or fast at a cost; `holding` for each one who waits."""

    def outcomes(point: Any, action: int) -> Any:
        (n,) = point
        served, cost = (0.35, 0.0) if action == 0 else (0.75, FAST_COST)
        reward = holding * n - cost
        lost = -10.0 if n == room else 0.0
        return [
            (arrivals * served, (n,), reward),
            (arrivals * (1 - served), (min(n + 1, room),), reward + lost),
            ((1 - arrivals) * served, (max(n - 1, 0),), reward),
            ((1 - arrivals) * (1 - served), (n,), reward),
        ]

    return task_of(
        [(n,) for n in range(room + 1)],
        ("waiting",), cr.Component("service", 2, labels=("slow", "fast")), outcomes,
        starts=lambda point: True, discount=0.92, time_limit=80,
    )  # fmt: skip


def served(room: int, arrivals: tuple[float, ...], costs: tuple[float, ...]) -> cr.FiniteMDP:
    """Return queues of which one is served at a time; with one queue, it or none."""
    n_queues = len(arrivals)

    def outcomes(point: Any, action: int) -> Any:
        found = [(1.0, (), -sum(c * n for c, n in zip(costs, point, strict=True)))]
        for i, n in enumerate(point):
            left = max(n - 1, 0) if action == i else n
            found = [
                (p * q, (*to, min(left + more, room)), r - 5.0 * (left + more > room))
                for p, to, r in found
                for q, more in ((arrivals[i], 1), (1 - arrivals[i], 0))
            ]
        return found

    return task_of(
        [tuple(point) for point in np.ndindex(*[room + 1] * n_queues)],
        tuple(f"queue_{i + 1}" for i in range(n_queues)),
        cr.Component("serve", 2, labels=("first", "second")), outcomes,
        starts=lambda point: True, discount=0.9, time_limit=60,
    )  # fmt: skip


def one_of_two(queue: int) -> Any:
    """Return how one of two queues reads a single one, which is served or not."""

    def read(state: Any, action: Any) -> Any:
        serve = action["serve"] if queue == 1 else 1 - action["serve"]
        return {"queue_1": state[f"queue_{queue}"]}, {"serve": serve}

    return read


def queues() -> Family:
    """Return the family: one queue (50,000 steps), and two with one server (60,000)."""
    family = Family("queues", "development")
    family.target("one queue", single(20, 0.45), 50_000)
    short, busy = single(10, 0.45), single(20, 0.55)
    idle, full = single(20, 0.1), single(20, 0.45, holding=0.5)
    family.add("near", "half the room", short, budget=15_000)
    family.add("near", "more arrivals", busy, budget=15_000)
    half, mirrored = by_value(lambda n: n // 2), by_value(lambda n: 20 - n)
    family.add("far", "half the room, two for one", short, half, budget=15_000)
    family.add("useless", "hardly any arrivals", idle, budget=15_000)
    family.add("wrong goal", "paid for who waits", full, budget=15_000)
    family.add("mirrored", "more arrivals, mirrored", busy, mirrored, budget=15_000)
    family.spoil("more arrivals")

    family.target("two queues", served(7, (0.5, 0.4), (1.0, 3.0)), 60_000)
    alone = served(7, (0.5,), (2.0,))
    first, second = one_of_two(1), one_of_two(2)
    family.add("near", "two alone", alone, first, second, budget=12_000, aggregate=cr.total)
    family.add("far", "the dear one alone", alone, second, budget=12_000)
    return family
