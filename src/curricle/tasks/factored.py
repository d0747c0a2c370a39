"""Factored models: the rules of a prey and predators that move independently, without tables.

All move at the same time on one map of cells, and the moves of one do not depend on where the
others are. So the expectation over the prey's moves and the maximum over the predators' are taken
one after the other, and exact planning (``planning/backups.py``) needs no table of joint
moves.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.array_types import BoolArray, FloatArray
from curricle.frozen_arrays import frozen

CellArray = npt.NDArray[np.int32]


class FactoredModel(NamedTuple):
    """A prey and k predators that move at the same time, independently of each other.

    In state ((p C + c_1) C + c_2) ... the prey is on cell p and predator i on cell c_i, of C; with
    action (a_1 M + a_2) ... predator i makes move a_i, of M. Reward and termination depend on how
    many predators are on the prey's cell after the step. Episodes start uniformly in the states
    that are not terminal.
    """

    landing: CellArray  # (C, M): the cell that each move leads to from each cell
    prey_policy: FloatArray  # (C, M): the probability of each move of the prey, by its own cell
    predators: int  # k, at least 1
    rewards: FloatArray  # (k + 1,) of a step after which 0, 1, ..., k predators are on the prey
    ends: BoolArray  # (k + 1,): whether such a state is terminal
    discount: float


def joint_landing(landing: CellArray, predators: int) -> CellArray:
    """Return where joint moves lead k predators from each of their positions, (C^k, M^k) int32.

    Positions and moves are numbered as in states and actions; `landing` is (C, M) int32.
    """
    n_cells, n_moves = landing.shape
    joint = np.zeros((1, 1), dtype=np.int32)
    for _ in range(predators):
        both = joint[:, None, :, None] * np.int32(n_cells) + landing[None, :, None, :]
        joint = both.reshape(joint.shape[0] * n_cells, joint.shape[1] * n_moves)
    return frozen(joint)


def predators_on_prey(n_cells: int, predators: int) -> npt.NDArray[np.int8]:
    """Return how many predators are on the prey's cell in each state, (C^(1 + k),) int8."""
    there = np.eye(n_cells, dtype=np.int8)
    count = np.zeros((n_cells, 1), dtype=np.int8)
    for _ in range(predators):
        count = (count[:, :, None] + there[:, None, :]).reshape(n_cells, -1)
    return frozen(count.ravel())
