"""Fresh: three machines that wear out, and a mechanic who renews one of them at a time."""

from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import by_value, task_of

BROKEN = 5
WEAR = (0.2, 0.3, 0.45)


def shop(wear: tuple[float, ...], *, value: float = 3.0, per_wear: float = -0.3) -> cr.FiniteMDP:
    """Return machines that get worse by a step with these probabilities; renewing costs 6.

    A machine earns `value` a step and `per_wear` for each step of wear; nothing when broken, and
    its repair costs 10 more.
    """

    def outcomes(point: Any, action: int) -> Any:
        found: list[Any] = [(1.0, (), 0.0)]
        for k, (worn, chance) in enumerate(zip(point, wear, strict=True)):
            if action == k + 1:
                ways = [(1.0, 0, -6.0 - 10.0 * (worn == BROKEN))]
            elif worn == BROKEN:
                ways = [(1.0, BROKEN, 0.0)]
            else:
                earned = value + per_wear * worn
                ways = [(chance, worn + 1, earned), (1 - chance, worn, earned)]
            found = [(p * q, (*to, new), r + more) for p, to, r in found for q, new, more in ways]
        return found

    return task_of(
        [tuple(point) for point in np.ndindex(*[BROKEN + 1] * len(wear))],
        tuple(f"wear_{k + 1}" for k in range(len(wear))),
        cr.Component("renew", len(wear) + 1), outcomes,
        starts=lambda point: not any(point), discount=0.95, time_limit=100,
    )  # fmt: skip


def machines() -> Family:
    """Return three machines, 40,000 steps."""
    family = Family("machines", "fresh")
    family.target("three machines", shop(WEAR), 40_000)

    def alone(k: int) -> Any:
        return lambda state, action: (
            {"wear_1": state[f"wear_{k}"]}, {"renew": 1 * (action["renew"] == k)}
        )  # fmt: skip

    slow, one = shop((0.1, 0.15, 0.22)), shop((0.3,))
    scrap = shop(WEAR, value=0.0, per_wear=1.0)
    family.add("near", "slower wear", slow, budget=8_000)
    family.add("far", "one machine, three times", one, alone(1), alone(2), alone(3),
               budget=2_000, aggregate=cr.total)  # fmt: skip
    family.add("wrong goal", "paid for wear", scrap, budget=8_000)
    family.add("mirrored", "worn for new", slow, by_value(lambda n: BROKEN - n), budget=8_000)
    family.spoil("slower wear")
    return family
