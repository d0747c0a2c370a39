"""The Kantorovich distance of two finite distributions, exactly, by the transportation simplex.

The basis of a problem is a spanning tree of its outcomes: rows 0 .. n-1, columns n .. n+m-1, kept
as each node's parent and the nodes in an order from the root. It can be handed in again when costs
have changed: as the masses have not, it is still feasible, and often still optimal. Masses are
perturbed so that no basis is degenerate and the method cannot cycle (Orden 1956); what is returned
is computed from the masses as they are.
"""

from typing import NamedTuple

import numpy as np

from curricle.array_types import FloatArray, IntArray
from curricle.tasks.loop_cache import compiled_once

UNSET = 255
"""In the first place of a tree: there is none yet."""
WIDEST = 120
"""Outcomes of a distribution at most: nodes of both are numbered in 8 bits."""
PERTURBATION = 1e-10
MOST_PIVOTS = 10_000


class Scratch(NamedTuple):
    """Work space for distributions of up to so many outcomes."""

    cost: FloatArray  # (O, O')
    dual: FloatArray  # (O + O',)
    flow: FloatArray  # (O + O',) of each node on the edge to its parent
    depth: IntArray  # (O + O',)


@compiled_once
def scratch(n, m):
    """Return work space."""
    return Scratch(
        np.empty((n, m)), np.empty(n + m), np.empty(n + m), np.empty(n + m, dtype=np.int64)
    )


@compiled_once
def transport_cost(p, q, parent, order, space):
    """Return min sum_ij c_ij x_ij over x >= 0 with row sums p and column sums q.

    `space.cost` has c in its first n rows and m columns. The tree in `parent` and `order`, (n + m,)
    uint8, is where the search starts (`UNSET`: nowhere) and becomes that of the optimum.
    """
    n, m = len(p), len(q)
    cost, dual = space.cost, space.dual
    if parent[0] == UNSET:
        _north_west(p, q, parent, order)
    largest = 0.0
    for i in range(n):
        for j in range(m):
            largest = max(largest, abs(cost[i, j]))
    slack = -1e-13 * (1.0 + largest)
    for _ in range(MOST_PIVOTS):
        dual[0] = 0.0
        for k in range(1, n + m):
            node = order[k]
            up = parent[node]
            edge = cost[node, up - n] if node < n else cost[up, node - n]
            dual[node] = edge - dual[up]
        least, row, column = slack, -1, -1
        for i in range(n):
            for j in range(m):
                reduced = cost[i, j] - dual[i] - dual[n + j]
                if reduced < least:
                    least, row, column = reduced, i, j
        if row < 0:
            break
        _pivot(p, q, row, n + column, parent, order, space)
    total = 0.0
    for i in range(n):
        total += p[i] * dual[i]
    for j in range(m):
        total += q[j] * dual[n + j]
    return total


@compiled_once
def _north_west(p, q, parent, order):
    """Make the tree of the north-west corner rule."""
    n, m = len(p), len(q)
    parent[0], order[0] = 0, 0
    parent[n], order[1] = 0, n
    i, j = 0, 0
    supply, demand = p[0] + PERTURBATION, q[0]
    for k in range(2, n + m):
        if j == m - 1 or (i < n - 1 and supply <= demand):
            demand -= supply
            i += 1
            supply = p[i] + PERTURBATION
            parent[i], order[k] = n + j, i
        else:
            supply -= demand
            j += 1
            demand = q[j]
            parent[n + j], order[k] = i, n + j


@compiled_once
def flows_of(p, q, parent, order, perturbation, flow):
    """Write what each node but the root sends or gets along the edge to its parent."""
    n, nodes = len(p), len(p) + len(q)
    for i in range(n):
        flow[i] = p[i] + perturbation
    for j in range(n, nodes):
        flow[j] = -q[j - n]
    flow[nodes - 1] -= n * perturbation
    for k in range(nodes - 1, 0, -1):
        node = order[k]
        flow[parent[node]] += flow[node]
        if node >= n:
            flow[node] = -flow[node]


@compiled_once
def _pivot(p, q, row, column, parent, order, space):
    """Bring the edge of a row and a column into the tree, and take out the first that runs dry."""
    nodes = len(p) + len(q)
    flow, depth = space.flow, space.depth
    flows_of(p, q, parent, order, PERTURBATION, flow)
    depth[0] = 0
    for k in range(1, nodes):
        depth[order[k]] = depth[parent[order[k]]] + 1
    # The path between the two has an odd number of edges; every other one loses, first and last.
    one, other = row, column
    from_one, from_other = 0, 0
    least, leaving, on_one = np.inf, -1, True
    while one != other:
        if depth[one] >= depth[other]:
            if from_one % 2 == 0 and flow[one] < least:
                least, leaving, on_one = flow[one], one, True
            one, from_one = parent[one], from_one + 1
        else:
            if from_other % 2 == 0 and flow[other] < least:
                least, leaving, on_one = flow[other], other, False
            other, from_other = parent[other], from_other + 1
    current, above = (row, column) if on_one else (column, row)
    while True:
        following = parent[current]
        parent[current] = above
        if current == leaving:
            break
        above, current = current, following
    order[0] = 0
    first, last = 0, 1
    while first < last:
        node = order[first]
        first += 1
        for k in range(1, nodes):
            if parent[k] == node:
                order[last] = k
                last += 1
