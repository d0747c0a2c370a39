"""A published claim, checked on its authors' own trials: does an object-oriented curriculum pay?

Silva and Costa (AAMAS 2018) report that curricula made from objects learn a 10 x 10 maze in fewer
steps than no curriculum. Their repository, f-leno/Curriculum_HFO on GitHub, has the raw trials, and
its code the learning rates: .5 without a curriculum, .9 and .95 with one. Here their trials are
read, the steps of the sources counted as they wrote them down, and plain Q-learning is played on
the same maze at each of these rates.

    python -m benchmarks.referee claim PATH_OF_A_CLONE [--seeds 1000]

A trial has arrived where a mean return of 18 has lasted for three evaluations, 50 steps apart; the
optimum is 18.37. Nothing of the repository is kept here.
"""

import io
import re
import subprocess
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import curricle as cr
from curricle.arrays import FloatArray

LASTING, PATIENCE = 18.0, 3
"""Mean discounted return, and the evaluations in a row that must reach it."""
STEPS, EVAL_FREQ, RATES = 8_000, 50, (0.5, 0.9, 0.95)
"""Of their trials, and of ours."""
RESAMPLES = 1000
TRIAL = re.compile(r"_0_\d+_AGENT_1_RESULTS_eval")

MAP = """
    ......P..T
    ..........
    .....P.PFF
    ..........
    .....F....
    .F..P.P..F
    ..........
    FFFFP.PPFF
    ..........
    S.........
"""


class Published(NamedTuple):
    """An arm of theirs."""

    name: str
    folder: str  # below results/GridWorld
    rate: float | None  # its learning rate; None where the repository does not say


PUBLISHED = (
    Published("no curriculum", "QLearning-NoneCurriculum", 0.5),
    Published("object-oriented, given sources", "PITAMQLearning-PrunedCurriculum", 0.9),
    Published("object-oriented, made sources", "PITAMQLearning-PrunedGeneratedCurriculum", 0.95),
    Published("Svetlik's graph", "VFReuseQLearning-SvetlikCurriculum_0.5alpha", 0.5),
    Published("Svetlik's graph, as plotted", "VFReuseQLearning-SvetlikCurriculum", None),
    Published("Svetlik's graph, shaping", "RewardShapingQLearning-SvetlikCurriculum", 0.9),
)
"""The repository's code has the rates of the first three; folders and code that of the others."""


class Arm(NamedTuple):
    """Steps until a lasting return, of the trials of one arm."""

    name: str
    rate: float | None
    steps: FloatArray  # (trials,) infinite where it never came
    distinct: int  # trials that differ from one another
    ours: bool = False

    @property
    def never(self) -> int:
        """Trials that never arrive."""
        return int(np.isinf(self.steps).sum())

    @property
    def quartiles(self) -> tuple[float, float, float]:
        """The lower quartile, the median and the upper quartile."""
        low, middle, high = np.quantile(self.steps, [0.25, 0.5, 0.75], method="nearest")
        return float(low), float(middle), float(high)


def target() -> cr.GridWorld:
    """Return their 10 x 10 maze, in which a step costs 1 only where nothing else is paid.

    Next to two fires they pay twice, and we once: no optimal way leads there.
    """
    return cr.GridWorld(
        MAP.split(), rewards=cr.Rewards(step=-1.0), combine="worst", discount=0.9, time_limit=200
    )


def arrival(steps: FloatArray, returns: FloatArray) -> float:
    """Return the steps at the first of three evaluations in a row that reach the return.

    Examples
    --------
    >>> arrival(np.array([0.0, 50, 100, 150, 200]), np.array([18.3, 9, 18, 18, 18.3]))
    100.0
    >>> arrival(np.array([0.0, 50, 100]), np.array([18.3, 9, 18]))
    inf
    """
    reached = np.convolve(returns >= LASTING, np.ones(PATIENCE), "valid") == PATIENCE
    first = np.flatnonzero(reached)
    return float(steps[first[0]]) if len(first) else np.inf


def published(clone: Path, arm: Published) -> Arm:
    """Return the trials of an arm of theirs; of fewer than three evaluations there is none."""
    contents, found = set[bytes](), list[float]()
    for content in trials(clone, f"results/GridWorld/{arm.folder}"):
        rows = [line.split(",") for line in content.decode().splitlines()[1:] if line]
        if len(rows) >= PATIENCE:
            steps, returns = (np.array([float(row[k]) for row in rows]) for k in (0, 2))
            found.append(arrival(steps, returns))
            contents.add(content)
    if not found:
        raise ValueError(f"a clone must hold trials in results/GridWorld/{arm.folder}: {clone}")
    return Arm(arm.name, arm.rate, np.array(found), len(contents))


def trials(clone: Path, folder: str) -> Iterator[bytes]:
    """Yield the content of each trial in a folder of a clone, with a work tree or without."""
    if (clone / folder).is_dir():
        for path in sorted((clone / folder).iterdir()):
            if TRIAL.fullmatch(path.name):
                yield path.read_bytes()
        return
    archive = subprocess.run(
        ["git", "-C", str(clone), "archive", "HEAD", folder], capture_output=True, check=True
    ).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as files:
        for member in files:
            content = files.extractfile(member)
            if content is not None and TRIAL.fullmatch(Path(member.name).name):
                yield content.read()


def plain(rate: float, seeds: int) -> Arm:
    """Return Q-learning from scratch on their maze."""
    result = cr.learn(
        target(),
        cr.QLearning(learning_rate=rate, epsilon=0.1),
        STEPS,
        seeds=seeds,
        eval_freq=EVAL_FREQ,
        workers=1,
    )
    at = np.arange(result.greedy_return.shape[1]) * float(EVAL_FREQ)
    found = np.array([arrival(at, one) for one in result.greedy_return])
    return Arm("Q-learning, ours", rate, found, seeds, ours=True)


def gain(base: Arm, arm: Arm) -> tuple[float, float, float]:
    """Return by how many steps the median of an arm is lower, with a bootstrap's 95 % bounds."""
    rng = np.random.default_rng(0)

    def medians(of: Arm) -> FloatArray:
        drawn = rng.choice(of.steps, (RESAMPLES, len(of.steps)))
        return np.asarray(np.quantile(drawn, 0.5, axis=1, method="nearest"))

    with np.errstate(invalid="ignore"):  # infinite where neither arrives
        low, high = np.quantile(medians(base) - medians(arm), [0.025, 0.975], method="nearest")
    return base.quartiles[1] - arm.quartiles[1], float(low), float(high)


def verdicts(arms: list[Arm]) -> Iterator[str]:
    """Yield what is left of each curriculum's gain at equal learning rates, and the verdict."""
    none, own = arms[0], {arm.rate: arm for arm in arms if arm.ours}
    yield f"our Q-learning at {none.rate} against theirs: {_gain(gain(none, own[none.rate]))}"
    gone = []
    for arm in arms[1:]:
        if arm.ours or arm.rate is None:
            continue
        if np.isinf(arm.quartiles[1]):
            yield f"{arm.name}: {arm.never:,} of {len(arm.steps):,} trials never arrive"
            continue
        before, after = gain(none, arm), gain(own[arm.rate], arm)
        yield (
            f"{arm.name}, at {arm.rate}: against theirs at {none.rate} {_gain(before)}; "
            f"against ours at {arm.rate} {_gain(after)}"
        )
        if arm.name.startswith("object-oriented"):
            gone.append(after[2] <= 0)
    yield f"verdict on the object-oriented curricula: {verdict(gone)}"
    best = min(own.values(), key=lambda arm: arm.quartiles[1])
    curricula = [arm for arm in arms[1:] if not arm.ours]
    fastest = min(curricula, key=lambda arm: arm.quartiles[1])
    yield (
        f"the fastest of their curricula, {fastest.name}, has a median of "
        f"{fastest.quartiles[1]:,.0f}; Q-learning alone at {best.rate} has "
        f"{best.quartiles[1]:,.0f}"
    )


def verdict(gone: list[bool]) -> str:
    """Return the verdict in words.

    Examples
    --------
    >>> verdict([True, True]), verdict([False, True])
    ('at equal learning rates the gain is gone', 'at equal learning rates 1 of 2 gains is gone')
    """
    if all(gone):
        return "at equal learning rates the gain is gone"
    count = f"{sum(gone)} of {len(gone)} gains {'is' if sum(gone) == 1 else 'are'} gone"
    return f"at equal learning rates {count}"


def table(arms: list[Arm]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield (
        f"{'arm':<34}{'learning rate':>14}{'trials':>8}{'distinct':>10}{'median':>8}"
        f"{'quartiles':>16}{'never':>7}"
    )
    for arm in arms:
        low, middle, high = (_shown(value) for value in arm.quartiles)
        yield (
            f"{arm.name:<34}{_rate(arm.rate):>14}{len(arm.steps):>8,}{arm.distinct:>10,}"
            f"{middle:>8}{f'{low} to {high}':>16}{arm.never:>7,}"
        )


def check(clone: Path, seeds: int) -> list[Arm]:
    """Return their arms and ours."""
    theirs = [published(clone, arm) for arm in PUBLISHED]
    return [*theirs, *(plain(rate, seeds) for rate in RATES)]


def _rate(rate: float | None) -> str:
    return "not stated" if rate is None else f"{rate:g}"


def _shown(steps: float) -> str:
    return "never" if np.isinf(steps) else f"{steps:,.0f}"


def _gain(found: tuple[float, float, float]) -> str:
    middle, low, high = found
    return f"{middle:+,.0f} steps [{low:+,.0f}, {high:+,.0f}]"
