"""Development: combination locks, +1 behind the last digit and nothing before."""

from collections.abc import Sequence
from typing import Any

import curricle as cr

from ..pair import Family
from ..worlds import by_value, task_of

CODE = (2, 0, 3, 1, 1, 2, 0, 3)
OTHER = (0, 1, 2, 3, 0, 1, 2, 1)
SLIPPERY = (1, 3, 0, 2, 3, 1, 0, 2)


def lock(
    code: Sequence[int], *, first: int = 0, slip: float = 0.0, fine: float = 0.0, back: int = 1
) -> cr.FiniteMDP:
    """Return a lock: the right digit leads on, a wrong one `back` places, with a `fine`.

    The places are numbered from `first`.
    """
    last = first + len(code)

    def outcomes(point: Any, action: int) -> Any:
        (at,) = point
        on, reward = (at + 1,), 1.0 if at + 1 == last else 0.0
        fallen = (max(at - back, first),)
        if action != code[at - first]:
            return [(1.0, fallen, -fine)]
        return [(1 - slip, on, reward), (slip, fallen, 0.0)]

    return task_of(
        [(at,) for at in range(first, last + 1)],
        ("place",), cr.Component("digit", 4), outcomes,
        ends=lambda point: point[0] == last, starts=lambda point: point[0] == first,
        discount=0.95, time_limit=100,
    )  # fmt: skip


def locks() -> Family:
    """Return the family: eight digits (40,000 steps), eight that slip at a fine (10,000)."""
    family = Family("locks", "development")
    family.target("eight digits", lock(CODE), 40_000)
    tail, end = lock(CODE[3:], first=3), lock(CODE[6:], first=6)
    other, reverse = lock(OTHER), lock(CODE[::-1])
    start = lock(CODE[:3])
    family.add("near", "the last five", tail, budget=6_000)
    family.add("near", "the first three", start, budget=2_000)
    family.add("far", "the last two", end, budget=500)
    family.add("wrong goal", "another code", other, budget=10_000)
    family.add("mirrored", "the code reversed", reverse, budget=10_000)
    shifted = by_value(lambda at: at + 3)
    family.add("useless", "the last five at the start", tail, shifted, budget=6_000)
    family.spoil("the last five")

    fined: dict[str, Any] = {"slip": 0.1, "fine": 0.005, "back": 1}
    family.target("fined", lock(SLIPPERY, **fined), 10_000)
    tail = lock(SLIPPERY[4:8], first=4, **fined)
    dry = lock(SLIPPERY, fine=0.005)
    family.add("near", "fined, the last four", tail, budget=2_000)
    family.add("far", "fined, no slips", dry, budget=2_000)
    return family
