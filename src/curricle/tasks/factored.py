"""Tasks in which everybody moves on one map of cells: the rules alone, no tables.

A step of such a task is a move of each agent and one of the *drifter*, which nobody steers. They
move at once and do not look at each other, so an expectation over the drifter's moves and a
maximum over the agents' take turns, one mover at a time: exact planning (``learning/planning.py``)
needs no table of joint moves.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.tasks.spaces import frozen

FloatArray = npt.NDArray[np.float64]
CellArray = npt.NDArray[np.int32]


class FactoredModel(NamedTuple):
    """One drifter and k agents that move at the same time, independently of each other.

    State ((d C + c_1) C + c_2) ... has the drifter on cell d and agent i on cell c_i, of C; action
    (a_1 M + a_2) ... has agent i make move a_i, of M. What a step pays, and whether it ends the
    episode, depend on how many agents are then on the drifter's cell. Episodes start in any state
    that is not an end, uniformly.

    Attributes
    ----------
    landing : (C, M) int32
        The cell that each move leads to from each cell.
    drift : (C, M) float64
        The probability of each move of the drifter, by its own cell.
    agents : int
        k, at least 1.
    pays : (k + 1,) float64
        The reward of a step after which 0, 1, ..., k agents are on the drifter's cell.
    ends : (k + 1,) bool
        Whether such a state is terminal.
    discount : float

    Examples
    --------
    >>> from curricle import Pursuit
    >>> movers = Pursuit(size=2, predators=1).factored_model
    >>> movers.landing[0], movers.ends, movers.pays
    (array([0, 0, 1, 2, 0], dtype=int32), array([False,  True]), array([-1.,  0.]))
    """

    landing: CellArray
    drift: FloatArray
    agents: int
    pays: FloatArray
    ends: npt.NDArray[np.bool_]
    discount: float

    @property
    def size(self) -> int:
        """The number of states, C^(1 + k)."""
        return int(len(self.landing) ** (1 + self.agents))

    def terminal(self) -> npt.NDArray[np.bool_]:
        """Return which states end an episode, (S,) bool."""
        return frozen(self.ends[self.touching()])

    def start(self) -> FloatArray:
        """Return the start distribution, (S,) float64: uniform where it is not over."""
        free = ~self.terminal()
        return frozen(np.asarray(free / np.count_nonzero(free)))

    def touching(self) -> npt.NDArray[np.int8]:
        """Return how many agents are on the drifter's cell, (S,) int8."""
        return agents_touching(len(self.landing), self.agents)

    def landed(self) -> CellArray:
        """Return where each joint move leads the agents from each of their positions.

        (C^k, M^k) int32, positions and moves numbered as in states and actions.

        Examples
        --------
        >>> from curricle import Pursuit
        >>> Pursuit(size=2, predators=2, moves=4).factored_model.landed().shape
        (16, 16)
        """
        return joint_landing(self.landing, self.agents)


def joint_landing(landing: CellArray, agents: int) -> CellArray:
    """Return where the joint moves of some agents lead them, (C^k, M^k) int32.

    Parameters
    ----------
    landing : (C, M) int32
    agents : int

    Examples
    --------
    >>> joint_landing(np.array([[0, 1], [1, 1]], dtype=np.int32), 2)[0]  # both on cell 0
    array([0, 1, 2, 3], dtype=int32)
    """
    n_cells, n_moves = landing.shape
    joint = np.zeros((1, 1), dtype=np.int32)
    for _ in range(agents):
        both = joint[:, None, :, None] * np.int32(n_cells) + landing[None, :, None, :]
        joint = both.reshape(joint.shape[0] * n_cells, joint.shape[1] * n_moves)
    return frozen(joint)


def agents_touching(n_cells: int, agents: int) -> npt.NDArray[np.int8]:
    """Return how many agents are on the drifter's cell in each state, (C^(1 + k),) int8.

    Examples
    --------
    >>> agents_touching(2, 2)
    array([2, 1, 1, 0, 0, 1, 1, 2], dtype=int8)
    """
    there = np.eye(n_cells, dtype=np.int8)
    count = np.zeros((n_cells, 1), dtype=np.int8)
    for _ in range(agents):
        count = (count[:, :, None] + there[:, None, :]).reshape(n_cells, -1)
    return frozen(count.ravel())
