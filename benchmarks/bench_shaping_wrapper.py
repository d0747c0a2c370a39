"""What shaping costs a step of Gymnasium's FrozenLake-v1, compared with the plain environment.

Contestants take turns and are measured in processor time; what is printed is the median over the
turns: microseconds a step, how many of them are more than the plain environment's in the same
turn, and the ratio of the two. Resets and the checks at the end of an episode are part of it
(one in eight steps under random actions). Gymnasium's own RecordEpisodeStatistics is there to
compare with. A vector of 16 sub-environments is counted per sub-environment.

    python benchmarks/bench_shaping_wrapper.py [--quick] [--turns N]
"""

from functools import partial
from statistics import median

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import RecordEpisodeStatistics
from timing import arguments, in_turns, on_one_thread

import curricle as cr
from curricle.interop.potential_shaping import PotentialShaping

BAR = 15.0  # microseconds a step, one environment and a tabular potential
MANY = 16


def lake():
    return gym.make("FrozenLake-v1")


def lakes(wrappers):
    return gym.make_vec("FrozenLake-v1", MANY, vectorization_mode="sync", wrappers=wrappers)


def potential():
    """Return how near the goal a square is, as a table over the lake's states."""
    mdp = cr.FiniteMDP.from_outcomes(lake().unwrapped.P, start=0, discount=0.99, time_limit=100)
    row, column = np.divmod(np.arange(16), 4)
    return cr.StatePotential(mdp, (row + column) / 6)


def stepping(env, steps):
    """Return the rate, steps a second, at which an environment is stepped at random."""
    actions = np.random.default_rng(0).integers(env.action_space.n, size=steps).tolist()

    def run():
        env.reset(seed=0)
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return on_one_thread(run, steps)


def stepping_many(envs, steps):
    actions = np.random.default_rng(0).integers(4, size=(steps // MANY, MANY))

    def run():
        envs.reset(seed=0)
        for row in actions:
            envs.step(row)

    return on_one_thread(run, actions.size)


def report(contestants, turns):
    """Print a line for each contestant, the first without shaping. Return the overheads."""
    rates = in_turns(contestants, turns)
    base, overheads = next(iter(rates)), {}
    for name, measured in rates.items():
        pairs = [
            (1e6 / rate, 1e6 / plain) for rate, plain in zip(measured, rates[base], strict=True)
        ]
        overheads[name] = median(mine - plain for mine, plain in pairs)
        ratio = median(mine / plain for mine, plain in pairs)
        cost = median(mine for mine, _ in pairs)
        print(f"{name:<44}{cost:>9.1f} us{overheads[name]:>9.1f} us{ratio:>8.2f}x", flush=True)
    return overheads


def main():
    given = arguments(__doc__).parse_args()
    turns = given.turns or (5 if given.quick else 15)
    steps = 3_000 if given.quick else 10_000
    phi = potential()
    function = phi.values[0].__getitem__
    print(f"{'a step of FrozenLake-v1':<44}{'all':>12}{'more':>12}{'ratio':>9}\n{'-' * 77}")
    single = {
        "plain": lake(),
        "RecordEpisodeStatistics": RecordEpisodeStatistics(lake()),
        "PotentialShaping, table": PotentialShaping(lake(), phi),
        "... function": PotentialShaping(lake(), function, discount=0.99),
        "... mean of two tables": PotentialShaping(lake(), {"one": phi, "two": phi}),
    }
    more = report({name: partial(stepping, env, steps) for name, env in single.items()}, turns)
    print(f"\n{MANY} at once")
    shapes = {
        "plain": [],
        "RecordEpisodeStatistics": [RecordEpisodeStatistics],
        "PotentialShaping, table": [partial(PotentialShaping, potential=phi)],
        "... function": [partial(PotentialShaping, potential=function, discount=0.99)],
    }
    vectors = {name: partial(stepping_many, lakes(wrap), steps) for name, wrap in shapes.items()}
    report(vectors, turns)
    spent = more["PotentialShaping, table"]
    print(f"\nbar: {BAR:g} us more a step, one table: {'ok' if spent <= BAR else 'MISSED'}")


if __name__ == "__main__":
    main()
