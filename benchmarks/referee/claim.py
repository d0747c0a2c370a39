"""Print the steps that Silva and Costa's own trials (AAMAS 2018) take, and ours at their rates.

    git clone https://github.com/f-leno/Curriculum_HFO
    curricle run benchmarks/referee/claim.toml
    python -m benchmarks.referee.claim Curriculum_HFO claim-results

A trial has learnt at the first of three evaluations in a row that return 18; the optimum is 18.37.
Steps of sources are counted, as they wrote them down. Their code has the learning rates.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from curricle.arrays import FloatArray
from curricle.study import StudyResults

LASTING, PATIENCE, TRIALS = 18.0, 3, "_0_*_AGENT_1_RESULTS_eval"
FOLDERS = {
    "no curriculum, .5": "QLearning-NoneCurriculum",
    "object-oriented, given sources, .9": "PITAMQLearning-PrunedCurriculum",
    "object-oriented, made sources, .95": "PITAMQLearning-PrunedGeneratedCurriculum",
    "Svetlik's graph, .5": "VFReuseQLearning-SvetlikCurriculum",
    "Svetlik's graph, .9 by its course": "VFReuseQLearning-SvetlikCurriculum_0.5alpha",
}


def arrival(steps: FloatArray, returns: FloatArray) -> float:
    """Return the steps at the first of three evaluations in a row that reach 18.

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


def published(folder: Path) -> list[float]:
    """Return the arrivals of their trials; those of fewer than three evaluations are none."""
    arrivals = list[float]()
    for path in folder.glob(TRIALS):
        rows = [line.split(",") for line in path.read_text().splitlines()[1:] if line]
        if len(rows) >= PATIENCE:
            numbers = np.array([row[:3] for row in rows], float)
            arrivals.append(arrival(numbers[:, 0], numbers[:, 2]))
    return arrivals


def arms(clone: str, folder: str) -> Iterator[tuple[str, list[float]]]:
    """Yield the arms, theirs first, each with the steps of its trials."""
    for name, of_arm in FOLDERS.items():
        yield name, published(Path(clone, "results", "GridWorld", of_arm))
    for name, nodes in StudyResults(folder).results.items():
        result = nodes["maze"]
        yield name, [arrival(result.steps, returns) for returns in result.greedy_return]


if __name__ == "__main__":
    for name, steps in arms(*sys.argv[1:3]):
        low, middle, high = np.quantile(steps, [0.25, 0.5, 0.75], method="nearest")
        quartiles = f"[{low:,.0f}, {high:,.0f}], {np.isinf(steps).sum()} never"
        print(f"{name:36}{len(steps):6,} trials {middle:6,.0f} {quartiles}")
