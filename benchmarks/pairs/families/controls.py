"""Blind: a thermostat in drifting weather, a pole on a cart, and a patient's doses."""

from itertools import product
from typing import Any

import numpy as np

import curricle as cr

from ..pair import Family
from ..worlds import at_first, explored

WARM, HOURS = 8, 6
"""Degrees above the coldest room that are comfortable, and hours of a day."""


def house(
    *, drift: float = 0.2, hours: int = HOURS, price: float = 0.4, coldest: int = 0
) -> cr.FiniteMDP:
    """Return a house that is heated by 0 to 3 degrees an hour, and is empty in the last hours.

    It loses a degree for each seven that it is warmer than outside, on average. The weather gets
    warmer, or colder, with probability `drift`.
    """

    def outcomes(point: Any, action: int) -> Any:
        inside, outside, hour = point
        empty = hours > 1 and hour >= hours - 2
        reward = -price * action - (0.0 if empty else abs(inside - WARM) ** 1.5 / 3)
        lost = (inside + 4 - outside) / 7
        whole = int(np.floor(lost))
        found = []
        for p, degrees in (1 - (lost - whole), whole), (lost - whole, whole + 1):
            after = min(max(inside + action - degrees, 0), 14)
            for q, change in (1 - 2 * drift, 0), (drift, 1), (drift, -1):
                weather = min(max(outside + change, coldest), 7)
                found.append((p * q, (after, weather, (hour + 1) % hours), reward))
        return found

    return explored(
        [(inside, outside, 0) for inside in range(15) for outside in range(coldest, 8)],
        ("inside", "outside", "hour"), cr.Component("heat", 4), outcomes,
        discount=0.995, time_limit=240,
    )  # fmt: skip


def thermostats() -> Family:
    """Return the house, 40,000 steps."""
    family = Family("thermostats", "blind")
    family.target("house", house(), 40_000)

    def mild(state: Any, action: Any) -> Any:
        return {**state, "outside": np.maximum(state["outside"], 4)}, action

    family.add("near", "steady weather", house(drift=0.0), budget=10_000)
    family.add("far", "always at home", house(hours=1), at_first("hour"), budget=4_000)
    family.add("far", "mild weather alone", house(coldest=4), mild, budget=6_000)
    return family


HELD, TICK, GRAVITY, FORCE = 3, 0.02, 9.8, 10.0
"""Ticks that a push is held for, seconds a tick, and what acts on the cart."""
CART = (np.linspace(-3.2, 3.2, 9), np.linspace(-3.0, 3.0, 5))
POLE = (np.linspace(-0.28, 0.28, 9), np.linspace(-2.4, 2.4, 9))
COARSE = (
    np.linspace(-3.2, 3.2, 5), np.linspace(-3.0, 3.0, 3),
    np.linspace(-0.28, 0.28, 5), np.linspace(-2.4, 2.4, 5),
)  # fmt: skip


def pole(axes: Any = (*CART, *POLE), *, length: float = 0.5, force: float = FORCE) -> cr.FiniteMDP:
    """Return the pole on a cart (Barto, Sutton and Anderson 1983), drawn between grid points.

    A step is paid 1, until the pole or the cart is at an end of its axis. With two axes the track
    has no end and the cart is left out.
    """
    alone = len(axes) == 2

    def pushed(point: Any, action: int) -> list[float]:
        at = [float(axis[i]) for axis, i in zip(axes, point, strict=True)]
        place, speed, angle, turning = [0.0, 0.0, *at] if alone else at
        for _ in range(HELD):
            sine, cosine = np.sin(angle), np.cos(angle)
            thrust = (force * (2 * action - 1) + 0.1 * length * turning**2 * sine) / 1.1
            lever = length * (4 / 3 - 0.1 * cosine**2 / 1.1)
            turn = (GRAVITY * sine - cosine * thrust) / lever
            push = thrust - 0.1 * length * turn * cosine / 1.1
            place, speed = place + TICK * speed, speed + TICK * push
            angle, turning = angle + TICK * turning, turning + TICK * turn
        return [angle, turning] if alone else [place, speed, angle, turning]

    def beside(axis: Any, value: float) -> list[tuple[float, int]]:
        at = (float(np.clip(value, axis[0], axis[-1])) - axis[0]) / (axis[1] - axis[0])
        low = min(int(at), len(axis) - 2)
        return [(float(low + 1 - at), low), (float(at - low), low + 1)]

    def outcomes(point: Any, action: int) -> Any:
        near = map(beside, axes, pushed(point, action))
        return [
            (float(np.prod([p for p, _ in way])), tuple(i for _, i in way), 1.0)
            for way in product(*near)
        ]

    bounded = [0] if alone else [0, 2]
    middle = tuple(len(axis) // 2 for axis in axes)
    return explored(
        [middle], ("place", "speed", "angle", "turning")[-len(axes) :],
        cr.Component("push", 2, labels=("left", "right")), outcomes,
        ends=lambda point: any(point[k] in (0, len(axes[k]) - 1) for k in bounded),
        discount=0.99, time_limit=120,
    )  # fmt: skip


def poles() -> Family:
    """Return the pole on its cart, 60,000 steps."""
    family = Family("poles", "blind")
    cart = family.target("cart", pole(), 60_000)
    alone, coarse = pole(POLE), pole(COARSE)

    def rounded(state: Any, action: Any) -> Any:
        return {name: (i + 1) // 2 for name, i in state.items()}, action

    family.add("near", "the pole alone", alone, cr.project(cart, alone), budget=4_000)
    family.add("near", "a longer pole", pole(length=1.0), budget=15_000)
    family.add("far", "a coarse grid", coarse, rounded, budget=6_000)
    return family


WORST, POISONED = 9, 6


def treatment(
    *, growth: float = 0.35, kills: float = 0.25, poison: float = 0.015, onset: int = 5,
    doses: int = 4,
) -> cr.FiniteMDP:  # fmt: skip
    """Return a patient's weeks until the tumour is gone (+10) or the patient dead (-10).

    The tumour grows with probability `growth` and shrinks with `kills` for each unit of the dose. A
    week with toxicity costs, and may kill with probability `poison` times its square.
    """
    units = np.linspace(0, 3, doses)

    def outcomes(point: Any, action: int) -> Any:
        tumour, toxic = point
        dose = float(units[action])
        death = min(poison * toxic**2, 1.0)
        cost = -0.1 * tumour - 0.2 * toxic
        found = [(death, (WORST, toxic), cost - 10.0)]
        for p, shrunk in (kills * dose, 1), (1 - kills * dose, 0):
            for q, grown in (growth, 1), (1 - growth, 0):
                size = min(max(tumour + grown - 2 * shrunk, 0), WORST)
                for r, gone in (0.6, 1), (0.4, 0):
                    left = min(max(toxic - gone, 0) + round(0.7 * dose), POISONED)
                    end = 10.0 if size == 0 else -10.0 if size == WORST else 0.0
                    found.append(((1 - death) * p * q * r, (size, left), cost + end))
        return found

    return explored(
        [(onset, 0)],
        ("tumour", "toxicity"), cr.Component("dose", doses), outcomes,
        ends=lambda point: point[0] in (0, WORST), discount=1.0, time_limit=60,
    )  # fmt: skip


def treatments() -> Family:
    """Return a patient (6,000 steps), and a frail one (3,000), without discount."""
    family = Family("treatments", "blind")

    def all_or_none(state: Any, action: Any) -> Any:
        return state, {"dose": action["dose"] // 2}

    early, slow = treatment(onset=2), treatment(growth=0.2)
    family.target("patient", treatment(), 6_000)
    family.add("near", "an early start", early, budget=800)
    family.add("near", "a slow tumour", slow, budget=1_000)
    family.add("far", "all or none", treatment(doses=2), all_or_none, budget=600)
    family.target("frail", treatment(poison=0.04), 3_000)
    family.add("near", "frail, a sturdy patient", treatment(), budget=1_000)
    family.add("far", "frail, a strong drug", treatment(poison=0.04, kills=0.32), budget=600)
    return family
