"""Development: random MDPs that never end; the source is a perturbed model of the target."""

import numpy as np

import curricle as cr

from ..pair import Family

N_STATES, N_ACTIONS, BRANCHES = 80, 4, 3


def model(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return P (S, A, S) and r (S,) of a garnet: each pair leads to a few states."""
    rng = np.random.default_rng(seed)
    transition = np.zeros((N_STATES, N_ACTIONS, N_STATES))
    for s in range(N_STATES):
        # Neighbours on a ring, so that some states are far from others.
        near = (s + np.arange(-6, 7)) % N_STATES
        for a in range(N_ACTIONS):
            to = rng.choice(near, BRANCHES, replace=False)
            transition[s, a, to] = rng.dirichlet(np.ones(BRANCHES))
    reward = np.where(rng.random(N_STATES) < 0.08, rng.uniform(1.0, 10.0, N_STATES), 0.0)
    return transition, reward


def task(transition: np.ndarray, reward: np.ndarray) -> cr.FiniteMDP:
    """Return the continuing task; a time limit truncates it, from a start in state 0."""
    return cr.FiniteMDP.from_dense(
        transition, reward, terminal=np.zeros(N_STATES, bool), start=0, discount=0.95,
        time_limit=100,
    )  # fmt: skip


def mixed(seed: int, other: int, share: float) -> cr.FiniteMDP:
    """Return the garnet with a share of another's transitions and rewards."""
    (p, r), (q, t) = model(seed), model(other)
    return task((1 - share) * p + share * q, (1 - share) * r + share * t)


def garnets() -> Family:
    """Return the family: rewards to gain (30,000 steps), and costs to avoid (20,000)."""
    family = Family("garnets", "development")
    p, r = model(11)
    family.target("gains", task(p, r), 30_000)
    near, far, other = mixed(11, 12, 0.15), mixed(11, 12, 0.5), task(*model(13))
    moved = task(p, np.roll(r, N_STATES // 2))
    family.add("near", "a model 15 % off", near, budget=8_000)
    family.add("far", "a model half off", far, budget=8_000)
    family.add("wrong goal", "rewards elsewhere", moved, budget=8_000)
    family.add("useless", "another garnet", other, budget=8_000)
    family.add("mirrored", "actions reversed", near, budget=8_000, turned=True)
    family.spoil("a model 15 % off")

    rng = np.random.default_rng(21)
    cost = -rng.uniform(0.0, 2.0, N_STATES) * (rng.random(N_STATES) < 0.6)
    p, _ = model(22)
    family.target("costs", task(p, cost), 20_000)
    blurred, _ = model(23)
    near = task(0.85 * p + 0.15 * blurred, cost)
    halves = task(p, np.where(np.arange(N_STATES) < N_STATES // 2, cost, 0.0))
    paid = task(p, -cost)
    family.add("near", "costs, a model 15 % off", near, budget=6_000)
    family.add("far", "half the costs", halves, budget=6_000)
    family.add("wrong goal", "costs paid out", paid, budget=6_000)
    return family
