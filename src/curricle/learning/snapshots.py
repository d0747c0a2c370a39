"""A snapshots of learning: one seed's table at some of its checkpoints."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

LARGEST = 128_000_000
"""Bytes that the frames of a snapshots may take; a larger task has fewer, or no snapshots."""


@dataclass(frozen=True, eq=False)
class Snapshots:
    """What one seed's policy acted on at M moments of its learning, from before the first step.

    Attributes
    ----------
    seed : int
    steps : (M,) int64
        Steps done at each frame; closer together early, when most is learnt.
    values : (M, S, A) float32
        In the task's own rewards, as ``LearningResult.values``.

    Examples
    --------
    >>> from curricle import GridWorld, learn
    >>> snapshots = learn(GridWorld("S.T"), budget=1000, frames=4).snapshots
    >>> snapshots.steps, snapshots.values.shape
    (array([   0,  110,  440, 1000]), (4, 3, 4))
    """

    seed: int
    steps: npt.NDArray[np.int64]
    values: npt.NDArray[np.float32]


def frame_checkpoints(frames: int, checkpoints: int, pairs: int) -> npt.NDArray[np.int64]:
    """Return the checkpoints to snapshots, (M,) int64: none where fewer than two frames are allowed.

    They lie quadratically, so that as many fall into the first quarter as into the rest.

    Parameters
    ----------
    frames : int
        At most so many.
    checkpoints : int
        T.
    pairs : int
        S x A of the task.

    Examples
    --------
    >>> frame_checkpoints(5, 101, 12)
    array([  0,   6,  25,  56, 100])
    """
    allowed = min(frames, LARGEST // (4 * pairs))
    if allowed < 2:
        return np.zeros(0, np.int64)
    place = np.linspace(0.0, 1.0, allowed) ** 2 * (checkpoints - 1)
    return np.unique(place.astype(np.int64))
