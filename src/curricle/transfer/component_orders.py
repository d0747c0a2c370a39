"""The order in which a task moves through the values of a component, read from its transitions.

A row of a grid, a place in a queue, a flag that is set: nearly every change leads from a value to
one beside it. The values then lie on a path, however they are numbered, and the paths of two tasks
can be laid side by side, also when one is longer.
"""

from typing import NamedTuple

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.spaces import Space

LARGEST = 200
"""Values of a component; all pairs of them are looked at."""


class Path(NamedTuple):
    """A component of states whose values lie on a path."""

    place: int  # of the component
    values: IntArray  # (n,) the value at each position, numbered from 0
    position: IntArray  # (S,) of the states' values
    up: FloatArray  # (S, A) chance that the position rises; 0 in states that end the episode
    down: FloatArray  # (S, A) that it falls

    def reversed(self) -> "Path":
        """Return the same path, counted from its other end."""
        position = len(self.values) - 1 - self.position
        return Path(self.place, self.values[::-1], position, self.down, self.up)


def paths(mdp: FiniteMDP) -> list[Path]:
    """Return the components of states whose values lie on a path.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> [path.values.tolist() for path in paths(GridWorld(["S..", "..T"]).mdp)]
    [[0, 1], [0, 1, 2]]
    """
    after = mdp.next_state[mdp.outcome_row]
    chance = np.where(mdp.terminal[:, None, None], 0.0, mdp.probability[mdp.outcome_row])
    found = []
    for place, given in enumerate(numbered(mdp.states)):
        used, values = np.unique(given, return_inverse=True)  # a wall's row has no states
        size = len(used)
        if size > LARGEST:
            continue
        moves = np.broadcast_to(values[:, None, None], after.shape) * size + values[after]
        weight = np.zeros((size, size))
        weight.ravel()[:] = np.bincount(moves.ravel(), chance.ravel(), minlength=size**2)
        order = path_order(weight + weight.T)
        if order is not None:
            position = order[values]
            step = position[after] - position[:, None, None]
            up, down = ((chance * moved).sum(axis=2) for moved in (step > 0, step < 0))
            found.append(Path(place, used[np.argsort(order)], position, up, down))
    return found


def numbered(space: Space) -> list[IntArray]:
    """Return for each component its values at the points of a space, numbered from 0, (n,) each.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> [values.tolist() for values in numbered(GridWorld(["S.", ".T"]).states)]
    [[0, 0, 1, 1], [0, 1, 0, 1]]
    """
    values = space.decode()
    return [np.asarray(values[one.name] - one.low) for one in space.components]


def path_order(weight: FloatArray) -> IntArray | None:
    """Return the position of each value on the path of the largest weights, (n,); None if none.

    Pairs of values are joined from the heaviest on, each value to two others at most, never in a
    ring. That is a path if it reaches all values and no pair left out weighs as much as one on it:
    falls that lead far back do not hide the order of a row, but the cells of a grid have none.

    Parameters
    ----------
    weight : (n, n) float64
        How often either of two values follows the other; symmetric. The diagonal does not count.

    Examples
    --------
    >>> path_order(np.array([[0, 5, 4], [5, 0, 1], [4, 1, 0]]))
    array([1, 0, 2])
    """
    one, other = np.triu_indices(len(weight), 1)
    part, beside = np.arange(len(weight)), [list[int]() for _ in weight]
    lightest, heaviest = np.inf, 0.0  # on the path; left out
    for pair in np.argsort(-weight[one, other], kind="stable"):
        a, b, weighs = int(one[pair]), int(other[pair]), float(weight[one[pair], other[pair]])
        if part[a] == part[b] or max(len(beside[a]), len(beside[b])) == 2:
            heaviest = max(heaviest, weighs)
        elif weighs > 0:
            lightest = weighs
            beside[a].append(b)
            beside[b].append(a)
            part[part == part[a]] = part[b]
    if (part != part[0]).any() or lightest <= heaviest:
        return None
    path = [min(range(len(weight)), key=lambda value: len(beside[value]))]
    while len(path) < len(weight):
        path.append(next(value for value in beside[path[-1]] if value not in path[-2:]))
    return np.argsort(path)
