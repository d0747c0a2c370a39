"""Settings of papers on how a potential is stated: on actions, with a shift, or as Q itself.

python -m benchmarks.published.potentials     # iterations of Adamczyk et al. 2025
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

import curricle as cr
from curricle.arrays import FloatArray, IntArray
from curricle.statistics import mean_interval, paired_difference
from curricle.study.tuning import FINALISTS

from . import worlds

# -- Wiewiora, Cottrell, Elkan 2003: advice on states and on actions -------------------------------
#
# The mountain car of Sutton and Barto 1998, as a table: a cell of positions and velocities is a
# state, and its outcomes are those of POINTS x POINTS points in it.

POSITIONS, VELOCITIES, POINTS = 32, 32, 6
LOW, HIGH, FASTEST = -1.2, 0.5, 0.07
SCALE = 100.0  # of advice: about the fewest steps to the top; the best of 1, 5, 20 and 100


def cells(position: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the numbers of the cells of positions and velocities."""
    row = np.clip((position - LOW) / (HIGH - LOW) * POSITIONS, 0, POSITIONS - 1).astype(int)
    column = np.clip((velocity / FASTEST + 1) / 2 * VELOCITIES, 0, VELOCITIES - 1).astype(int)
    return np.asarray(row * VELOCITIES + column)


def points(a_side: int) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of `a_side` x `a_side` points in each cell, (S, n)."""
    row, column = np.divmod(np.arange(POSITIONS * VELOCITIES), VELOCITIES)
    right, up = (of.ravel() for of in np.meshgrid(*[(np.arange(a_side) + 0.5) / a_side] * 2))
    position = LOW + (row[:, None] + right) * (HIGH - LOW) / POSITIONS
    return position, ((column[:, None] + up) * 2 / VELOCITIES - 1) * FASTEST


def mountain_car() -> cr.FiniteMDP:
    """Return the car: -1 a step, three forces, from the valley at rest to the top on the right."""
    n = POSITIONS * VELOCITIES
    chance = np.zeros((n + 1, 3, n + 1))
    position, velocity = points(POINTS)
    for action in range(3):
        faster = velocity + 0.001 * (action - 1) - 0.0025 * np.cos(3 * position)
        faster = np.clip(faster, -FASTEST, FASTEST)
        after = position + faster
        faster = np.where(after < LOW, 0.0, faster)  # the left end stops the car
        to = np.where(after >= HIGH, n, cells(np.maximum(after, LOW), faster))
        for state in range(n):
            chance[state, action] = np.bincount(to[state], minlength=n + 1) / POINTS**2
    chance[n, :, n] = 1.0
    start = np.bincount(cells(np.linspace(-0.6, -0.4, 200), np.full(200, 1e-9)), minlength=n + 1)
    return cr.FiniteMDP.from_dense(
        chance,
        np.full(chance.shape, -1.0),
        terminal=np.arange(n + 1) == n,
        start=start / 200,
        discount=0.999,
        time_limit=1_000,
    )


def with_the_motion(task: Any) -> FloatArray:
    """Return advice on actions: 1 for the force in the direction in which the car moves."""
    _, velocity = points(1)
    forces = np.sign(velocity) == np.array([-1.0, 0.0, 1.0])
    return SCALE * np.vstack([forces, np.zeros((1, 3))])


def energy(task: Any) -> FloatArray:
    """Return advice on states: the car's energy, from 0 in the valley to 1 at the top."""
    position, velocity = points(1)
    height = np.sin(3 * np.vstack([position, [[HIGH]]])) * 0.0025 / 3
    energies = height + np.vstack([velocity, [[0.0]]]) ** 2 / 2
    low, high = -0.0025 / 3, np.sin(3 * HIGH) * 0.0025 / 3
    return SCALE * (energies[:, 0] - low) / (high - low)


# -- Müller and Kudenko 2025: a shift of the potential ---------------------------------------------
#
# Phi + b / (discount - 1) adds b to every step: b = (1 - discount) Q0 - r, with r the reward of a
# step that reaches nothing, makes what a step is worth the difference of the potentials alone.

SHIFT = -100.0  # b = 1


def costly_grid(size: int, discount: float = 0.99, **limit: Any) -> Any:
    """Return a grid whose rewards say nothing: -1 a step, from corner to corner."""
    return worlds.open_grid(size, slip=0.0, discount=discount, **limit)


def linear(task: Any) -> FloatArray:
    """Return a potential that grows by 1 a step towards the goal, from 0."""
    steps = -0.8 * worlds.distance(task)
    return steps.max() - steps


def exponential(task: Any) -> FloatArray:
    """Return a potential that grows by a factor, from 1 at the start to 32."""
    return 32.0 ** (linear(task) / linear(task).max())


def linear_shifted(task: Any) -> FloatArray:
    """Return the linear potential with their shift."""
    return linear(task) + SHIFT


def exponential_shifted(task: Any) -> FloatArray:
    """Return the exponential potential with their shift."""
    return exponential(task) + SHIFT


# -- Adamczyk et al. 2025: the values that are learnt, as the potential ----------------------------
#
# With eta V(s) as the potential a step aims at r + (1 + eta) gamma V(s') - eta V(s). For the greedy
# action, Q(s, a) = V(s), it is plain Q-learning of (1 + eta) Q at (1 + eta) times the rate. Such a
# potential changes with every step, which no shaping of the library does: hence loops of its own.

ZIGZAG = ["FFFFFFF", "FSFFFFF", "WWWWWFF", "FFFFFFF", "FFWWWWW", "FFFFFCF", "FFFFFFF"]
OPEN = ["F" * 10] * 10  # from a corner to the opposite, as in their later programs
ETAS = np.linspace(-0.6, 0.6, 300)[100:250]  # of their 300, around the best


class Settings(NamedTuple):
    """The settings of a learner."""

    eta: float
    rate: float
    level: float  # at which the values that it acts on start
    epsilon: float
    optimist: bool  # whether it acts on values beside those that are evaluated


PLAIN = Settings(0.0, 0.1, 0.0, 0.1, False)
CONFIGURED = PLAIN._replace(eta=10.0)  # the best of 8, on seeds 0 to 9
OPTIMIST = Settings(0.0, 1.0, 0.0, 0.0, True)
ARMS = {"plain": PLAIN, "eta": CONFIGURED, "optimist": OPTIMIST}
ARMS["optimist, eta"] = OPTIMIST._replace(eta=0.3, rate=0.7)  # no step beyond its aim


def moves(lines: list[str]) -> IntArray:
    """Return the state after each of four moves from each cell, (S, 4); ``W`` is a wall."""
    cells = np.array([[*line] for line in lines])
    after = np.empty((*cells.shape, 4), np.int64)
    for (row, column), _ in np.ndenumerate(cells):
        for n, (down, right) in enumerate(worlds.MOVES.values()):
            at = np.clip((row + down, column + right), 0, np.array(cells.shape) - 1)
            to = (row, column) if cells[tuple(at)] == "W" else at
            after[row, column, n] = to[0] * cells.shape[1] + to[1]
    return after.reshape(-1, 4)


def iterations(eta: float, seed: int, *, relaxed: float | None = None) -> int:
    """Return the iterations until Q changes by at most 1e-8, in their zigzag, discount .8.

    The potential is `eta` times the values. `relaxed`: plain iteration of V by so large steps.
    """
    after, change, count = moves(ZIGZAG), np.inf, 0
    reward = np.where(np.array([*"".join(ZIGZAG)]) == "C", -0.5, -1.0)[:, None]
    q = np.random.default_rng(seed).random(after.shape)
    while change > 1e-8 and count < 3_000:
        values = q.max(axis=1, keepdims=True)
        new = reward + (1 + eta) * 0.8 * values[after][:, :, 0] - eta * values
        if relaxed is not None:
            new = values + relaxed * (new.max(axis=1, keepdims=True) - values) + 0 * q
        q, change, count = new, np.abs(new - q).max(), count + 1
    return count


@njit(cache=True)
def bootstrapped(after: Any, settings: Any, rng: Any) -> Any:
    """Return 100 greedy returns in 10,000 steps of Q-learning, -1 a step, discount .98.

    From the first state to the last, in episodes of at most 500 steps. An optimist acts on a table
    of its own; the other, which is evaluated, starts at the lowest value.
    """
    eta, rate, level, epsilon, optimist = settings
    ends, discount, limit, state, moved = len(after) - 1, 0.98, 500, 0, 0
    lowest = -1 / (1 - discount)
    tables = np.full((2 if optimist else 1, *after.shape), lowest)
    tables[0] = level
    tables[:, ends] = 0.0
    acts, learnt = tables[0], tables[-1]
    greedy = np.full(100, (1 - discount**limit) * lowest)
    for step in range(10_000):
        best = np.flatnonzero(acts[state] == acts[state].max())
        action = best[rng.integers(0, len(best))]
        if rng.random() < epsilon:
            action = rng.integers(0, 4)
        there = after[state, action]
        for q in tables:
            aim = -1.0 + (1 + eta) * discount * q[there].max() - eta * q[state].max()
            if not abs(aim) < 1e100:  # it has diverged
                return greedy
            q[state, action] += rate * (aim - q[state, action])
        state, moved = there, moved + 1
        if state == ends or moved == limit:
            state, moved = 0, 0
        if step % 100 == 99:
            at, length = 0, 0
            while at != ends and length < limit:
                at, length = after[at, np.argmax(learnt[at])], length + 1
            greedy[step // 100] = (1 - discount**length) * lowest
    return greedy


def mean_returns(settings: Settings, seeds: range) -> FloatArray:
    """Return the mean greedy return of each seed."""
    after, rngs = moves(OPEN), map(np.random.default_rng, seeds)
    return np.array([bootstrapped(after, settings, rng).mean() for rng in rngs])


def best_settings(own: Settings, trials: int) -> Settings:
    """Return the best of its own and other settings; eta stays 0 if it is 0.

    As in an audit, the best on three seeds are played on thirty more.
    """
    tried = [own]
    for a, b, c, d in np.random.default_rng(0).random((trials, 4)).tolist():
        eta = (own.eta > 0) * 0.1 * 100**a
        tried.append(Settings(eta, 0.02 * 50**b, -50 * c, 0.01 * 100**d, own.optimist))
    tried.sort(key=lambda settings: -mean_returns(settings, range(3)).mean())
    again = [own, *tried[:FINALISTS]]
    return max(again, key=lambda settings: float(mean_returns(settings, range(33)).mean()))


def main() -> None:
    """Print the iterations until convergence, and the returns of learning."""
    of_eta = {eta: np.mean([iterations(eta, seed) for seed in range(20)]) for eta in ETAS.tolist()}
    best = min(of_eta, key=lambda eta: of_eta[eta])
    larger = [iterations(0.0, seed, relaxed=1 + best) for seed in range(20)]
    plain = [iterations(0.0, seed) for seed in range(20)]
    print(f"iterations: plain {np.mean(plain)}, eta {best:.3f} {of_eta[best]}", end=", ")
    print(f"plain by steps of {1 + best:.3f} {np.mean(larger)}")
    for side in "as configured", "fair":  # 20 trials for each of four settings
        settings = {arm: best_settings(own, 80 * (side == "fair")) for arm, own in ARMS.items()}
        returns = {arm: mean_returns(of, range(100, 200)) for arm, of in settings.items()}
        for arm, of in settings.items():
            print(f"{side}: {arm} {tuple(of)} {mean_interval(returns[arm])}")
        for arm, rival in ("eta", "plain"), ("eta", "optimist"), ("optimist, eta", "optimist"):
            print(
                f"    gain of {arm} over {rival} {paired_difference(returns[arm], returns[rival])}"
            )


if __name__ == "__main__":
    main()
