"""Mappings by bisimulation: to pairs with the same Q*, and to the nearest pairs.

Two states are bisimilar if their actions pay alike and lead alike to bisimilar states. Aggregating
such states leaves all values as they are (Givan, Dean, Greig 2003; Ravindran, Barto 2004, for which
actions may be relabelled too), so that pairs of two tasks in one block have the same Q*. Lax
bisimulation needs no exact correspondence: it gives distances between the states of two tasks that
bound how far their values are apart (Taylor, Precup, Panangaden 2009; Castro, Precup 2010, who
transfer policies along it). Neither needs names.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import FloatArray, Frozen, IntArray, frozen
from curricle.errors import MappingError
from curricle.progress import SILENT, Bars, Progress, shown
from curricle.tasks.loop_cache import compiled_once
from curricle.tasks.task import Task, tables
from curricle.text import brief_repr
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.partition_refinement import Blocks, Model, merged_outcomes, refined
from curricle.transfer.task_pair import Proposal, TaskPair, apart

LARGEST = 20_000_000
"""State-action pairs of both tasks up to which they are refined."""


def by_homomorphism(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of each target pair to an equivalent source pair, if any pair has one.

    Equivalent pairs have the same Q*. Refinement takes numbers that nearly agree as equal, so that
    only pairs whose Q* agree as closely as both are known are mapped. A pair of the target in a
    state that has an equivalent source state reads that state; others may still read a pair from
    which both tasks go on alike. Where several source pairs are equivalent, such as images under a
    symmetry, the first state's is taken.

    Raises
    ------
    MappingError
        When no pair has an equivalent one, or the tasks have more than 20 million pairs.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld(["S.P", "..T"])
    >>> tasks = TaskPair(maze, GridWorld(["T..", "P.S"]))  # turned by 180 degrees
    >>> next(by_homomorphism(tasks)).how
    'exact homomorphism: 100% of pairs have a source pair of the same Q*'
    """
    sizes = [mdp.outcome_row.size for mdp in (tasks.target_mdp, tasks.source_mdp)]
    if sum(sizes) > LARGEST:
        raise MappingError(
            f"tasks are refined together up to {LARGEST:,} pairs: these have {sum(sizes):,}"
        )
    own, other = refined(tasks.models)
    index = equivalent_pairs(own, other)
    solutions = tasks.target_solution, tasks.source_solution
    error = 2 * sum(solution.error_bound for solution in solutions)
    index = np.where(apart(index, *solutions) <= error, index, UNMAPPED)
    live = ~tasks.target_mdp.terminal
    share = float((index[live] >= 0).mean())
    if share == 0:
        raise MappingError("no pair of the target is equivalent to one of the source")
    how = f"exact homomorphism: {share:.0%} of pairs have a source pair of the same Q*"
    yield tasks.proposal(index, how)


def equivalent_pairs(own: Blocks, other: Blocks) -> IntArray:
    """Return for each target pair an equivalent source pair, or `UNMAPPED`, (S, A) int64."""
    most = int(max(own.pairs.max(), other.pairs.max())) + 2

    def keys(blocks: Blocks) -> IntArray:
        key = blocks.states[:, None] * most + blocks.pairs
        return np.where(blocks.pairs < 0, -1, key).ravel()

    index = _first_of(keys(other), keys(own))
    elsewhere = _first_of(other.pairs.ravel(), own.pairs.ravel())
    index = np.where(index == UNMAPPED, elsewhere, index)
    return np.where(own.pairs.ravel() < 0, UNMAPPED, index).reshape(own.pairs.shape)


def _first_of(keys: IntArray, wanted: IntArray) -> IntArray:
    """Return where each wanted key is found first, `UNMAPPED` where it is not or is negative."""
    known, first = np.unique(keys, return_index=True)
    place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    found = (known[place] == wanted) & (wanted >= 0)
    return np.where(found, first[place], UNMAPPED).astype(np.int64)


# -- the Kantorovich distance ----------------------------------------------------------------------


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


# -- the fixed point -------------------------------------------------------------------------------


SWEEPS = 40
"""Sweeps with the choices of a backup."""
MOST_ROUNDS = 5_000
MOST_WORK = 20_000_000_000
"""Pairs of outcomes that are coupled at most, in all rounds: some minutes of one core."""

Numbers = npt.NDArray[np.int32]
Flags = npt.NDArray[np.uint8]


class Quotient(NamedTuple):
    """A task whose equivalent states and pairs are one: B blocks, Y kinds of pairs."""

    pairs: Numbers  # (B, A) the kinds of a block's pairs, -1 where there are no more
    reward: FloatArray  # (Y,)
    value: FloatArray  # (Y,) Q*
    chance: FloatArray  # (Y, O)
    after: Numbers  # (Y, O) blocks
    width: Numbers  # (Y,) outcomes
    best: FloatArray  # (B,) V*


def quotient(model: Model, discount: float, values: FloatArray) -> tuple[Quotient, Blocks]:
    """Return a task up to bisimulation, and the block and kind of each of its states and pairs.

    The block of the terminal states has one pair, which pays nothing and leads to itself.
    """
    (blocks,) = refined([model])
    live = np.flatnonzero(blocks.pairs.ravel() >= 0)
    kinds, first, kind = np.unique(
        blocks.pairs.ravel()[live], return_index=True, return_inverse=True
    )
    row = model.outcome_row.ravel()[live[first]]
    after, chance = merged_outcomes(blocks.states[model.next_state[row]], model.probability[row])
    reward = model.mean_reward[row]
    pairs = np.full(blocks.pairs.size, -1)
    pairs[live] = kind.ravel()
    found = Blocks(blocks.states, pairs.reshape(blocks.pairs.shape))
    n_blocks = int(blocks.states.max()) + 1
    _, state = np.unique(blocks.states, return_index=True)
    of_block = [np.unique(found.pairs[s]) for s in state]
    best = values[state]
    if model.terminal.any():
        end = int(blocks.states[model.terminal][0])
        after = np.concatenate([after, np.full((1, after.shape[1]), -1)])
        chance = np.concatenate([chance, np.zeros((1, chance.shape[1]))])
        after[-1, 0], chance[-1, 0] = end, 1.0
        reward = np.append(reward, 0.0)
        of_block[end] = np.array([len(kinds)])
    listed = np.full((n_blocks, max(map(len, of_block))), -1, np.int32)
    for block, some in enumerate(of_block):
        listed[block, : len(some)] = some
    kept = max(1, int((after >= 0).sum(axis=1).max()))
    after, chance = after[:, :kept], chance[:, :kept]
    value = reward + discount * (chance * np.where(after >= 0, best[after], 0.0)).sum(axis=1)
    width = (after >= 0).sum(axis=1)
    small = np.ascontiguousarray(after, np.int32), width.astype(np.int32)
    return Quotient(listed, reward, value, np.ascontiguousarray(chance), *small, best), found


class Distances(NamedTuple):
    """What iteration works on."""

    states: FloatArray  # (B, B')
    pairs: FloatArray  # (Y, Y')
    tree: Flags  # (Y, Y', 2, O + O') bases of the transports; (1, 1, 2, 1) where none is needed


class Choices(NamedTuple):
    """The pair that each d of states rests on, and how its outcomes are coupled, in a list."""

    first: IntArray  # (B B' + 1,)
    cell: IntArray  # (n,) s * B' + u of two outcomes
    mass: FloatArray  # (n,) of the coupling there
    difference: FloatArray  # (B B',) of the rewards


def work_of_a_round(own: Quotient, other: Quotient) -> int:
    """Return how many pairs of outcomes a backup of all pairs couples, at most."""
    return own.chance.size * other.chance.size


def fixed_point(
    own: Quotient, other: Quotient, discount: float, tolerance: float, bars: Bars = SILENT
) -> tuple[Distances, float]:
    """Return the distances, and how far from the fixed point they may be.

    Iteration ends where that is at most `tolerance` times the largest distance, or after the most
    rounds: the distances are then further from the fixed point, by no more than is said.
    """
    nodes = own.chance.shape[1] + other.chance.shape[1]
    random = own.chance.shape[1] > 1 and other.chance.shape[1] > 1
    pairs = np.empty((len(own.reward), len(other.reward)))
    shape = (*pairs.shape, 2, nodes) if random else (1, 1, 2, 1)
    states = abs(own.best[:, None] - other.best)
    found = Distances(states, pairs, np.full(shape, UNSET, np.uint8))
    rests_on = np.empty((states.size, 2), np.int64)
    most = float(max(states.max(), 1e-300))
    last, helps = np.inf, True
    rounds = max(1, min(MOST_ROUNDS, MOST_WORK // work_of_a_round(own, other)))
    for left in reversed(range(rounds)):
        back_up_pairs(own, other, found, discount)
        change = back_up_states(own.pairs, other.pairs, found.pairs, states, rests_on)
        error = discount / (1 - discount) * change
        most = max(most, float(states.max()))
        bars.at("rounds", rounds - left)
        bars.tell(error)
        if error <= tolerance * most or left == 0:
            break
        helps, last = helps and change < last, change
        if helps:
            follow(coupled(own, other, found, rests_on), states.reshape(-1), discount, SWEEPS)
    return found, error


@compiled_once
def back_up_pairs(own, other, found, discount):
    """Compute d of all pairs from d of states."""
    states, pairs, tree = found
    space = scratch(own.chance.shape[1], other.chance.shape[1])
    for y in range(len(own.reward)):
        n = own.width[y]
        for z in range(len(other.reward)):
            m = other.width[z]
            total = 0.0
            if n == 1 or m == 1:
                for i in range(n):
                    for j in range(m):
                        mass = own.chance[y, i] * other.chance[z, j]
                        total += mass * states[own.after[y, i], other.after[z, j]]
            else:
                for i in range(n):
                    for j in range(m):
                        space.cost[i, j] = states[own.after[y, i], other.after[z, j]]
                total = transport_cost(
                    own.chance[y, :n], other.chance[z, :m], tree[y, z, 0], tree[y, z, 1], space
                )
            pairs[y, z] = abs(own.reward[y] - other.reward[z]) + discount * total


@compiled_once
def back_up_states(own_pairs, other_pairs, pairs, states, rests_on):
    """Compute d of states from d of pairs, and which pair it rests on; return the change."""
    least = np.empty(other_pairs.shape[1])
    change = 0.0
    for s in range(len(own_pairs)):
        for u in range(len(other_pairs)):
            value, y, z = hausdorff(own_pairs[s], other_pairs[u], pairs, least)
            change = max(change, abs(value - states[s, u]))
            states[s, u] = value
            cell = s * len(other_pairs) + u
            rests_on[cell, 0], rests_on[cell, 1] = y, z
    return change


@compiled_once
def hausdorff(some, others, pairs, least):
    """Return the largest of all min_b and min_a over the pairs of two states, and where it is.

    `least`, (A',), is work space.
    """
    largest, row, column = -1.0, 0, 0
    least[:] = np.inf
    for y in some:
        if y < 0:
            break
        smallest, at = np.inf, 0
        for b in range(len(others)):
            z = others[b]
            if z < 0:
                break
            value = pairs[y, z]
            if value < smallest:
                smallest, at = value, z
            least[b] = min(least[b], value)
        if smallest > largest:
            largest, row, column = smallest, y, at
    for b in range(len(others)):
        if others[b] >= 0 and least[b] > largest:
            largest, column = least[b], others[b]
            for y in some:
                if y >= 0 and pairs[y, column] == largest:
                    row = y
                    break
    return largest, row, column


def coupled(own: Quotient, other: Quotient, found: Distances, rests_on: IntArray) -> Choices:
    """Return the pairs that distances rest on, with their optimal couplings."""
    y, z = rests_on.T
    counts = np.maximum(own.width[y], other.width[z])
    both = (own.width[y] > 1) & (other.width[z] > 1)
    counts = np.where(both, own.width[y] + other.width[z] - 1, counts)
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    cell, mass = np.empty(first[-1], np.int64), np.empty(first[-1])
    fill_couplings(own, other, found.tree, rests_on, found.states.shape[1], first, cell, mass)
    return Choices(first, cell, mass, abs(own.reward[y] - other.reward[z]))


@compiled_once
def fill_couplings(own, other, tree, rests_on, n_other, first, cell, mass):
    """Write the coupling of each pair that a distance rests on."""
    space = scratch(own.chance.shape[1], other.chance.shape[1])
    for k in range(len(rests_on)):
        y, z = rests_on[k, 0], rests_on[k, 1]
        n, m = own.width[y], other.width[z]
        at = first[k]
        if n == 1 or m == 1:
            for i in range(n):
                for j in range(m):
                    cell[at] = own.after[y, i] * n_other + other.after[z, j]
                    mass[at] = own.chance[y, i] * other.chance[z, j]
                    at += 1
            continue
        parent, order = tree[y, z, 0], tree[y, z, 1]
        flows_of(own.chance[y, :n], other.chance[z, :m], parent, order, 0.0, space.flow)
        for k_node in range(1, n + m):
            node = order[k_node]
            up = parent[node]
            i, j = (node, up - n) if node < n else (up, node - n)
            cell[at] = own.after[y, i] * n_other + other.after[z, j]
            mass[at] = max(space.flow[node], 0.0)
            at += 1


@compiled_once
def follow(choices, states, discount, times):
    """Back up d of states, flat, with fixed choices and couplings, upwards and downwards."""
    first, cell, mass, difference = choices
    for time in range(times):
        for k in range(len(states)):
            at = k if time % 2 == 0 else len(states) - 1 - k
            total = 0.0
            for entry in range(first[at], first[at + 1]):
                total += mass[entry] * states[cell[entry]]
            states[at] = difference[at] + discount * total


# -- nearest pairs ---------------------------------------------------------------------------------


TOLERANCE = 1e-3
"""How far below the fixed point distances may be, in units of the largest."""
LARGEST_PAIRS = 8_000_000
"""Pairs of a target's and a source's kinds of pairs up to which distances are computed."""

LARGEST_ROUND = MOST_WORK // 10
"""Pairs of their outcomes, so that there is time for ten rounds at least."""


@dataclass(frozen=True, eq=False)
class LaxBisimulation(Frozen):
    """Distances between two tasks that bound the difference of their values, in return units."""

    states: FloatArray  # (S, S') abs(V*(s) - V*(u)) is at most this
    nearest: IntArray  # (S, A) source pair s' * A' + a', `ENDED` at its end and in terminal states
    pairs: FloatArray  # (S, A) abs(Q*(s, a) - Q*(nearest pair)) is at most this, 0 in terminal ones
    error: float  # how far the distances may be above those of the fixed point: a part of them

    __repr__ = brief_repr


def lax_bisimulation(
    target: Task, source: Task, *, tolerance: float = TOLERANCE, progress: Progress = None
) -> LaxBisimulation:
    """Return the distances of lax bisimulation between two tasks with tables.

    The fixed point of d((s, a), (u, b)) = abs(r - r') + gamma W(P, P'; d), where W is the
    Kantorovich distance, and d(s, u) = max(max_a min_b d, max_b min_a d). Terminal states pay
    nothing for ever. Where discounts differ, the source's rewards are rewritten so that its V*
    solves the equation of the target's discount, which keeps the bound. Transport problems are
    solved exactly; the work grows with the number of states that are not bisimilar to others. It
    ends after some minutes of one core at most; `error` is larger then. States count as bisimilar
    where numbers agree to 1e-9 of the largest, and no distance is below the known difference of
    two values, so that the bound holds all the same.

    Parameters
    ----------
    target, source : Task
    tolerance : float
        How far below the fixed point iteration may end, in units of the largest distance. What is
        missing is added, so that the bound holds.
    progress : bool or callable, optional
        True counts the rounds, as nobody knows how many there will be; a function is called after
        each with how far from the fixed point the distances may be, a float.

    Raises
    ------
    TaskError
        When a task has no tables.
    MappingError
        When a discount is 1, the tasks are too large, or a pair has more than 120 outcomes.
    SettingError
        When `progress` is none of what it may be.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> found = lax_bisimulation(GridWorld("S.T"), GridWorld("T.S"))
    >>> float(found.pairs.max()) < 1e-6
    True
    """
    tasks = TaskPair(target, source)
    if 1 in (tables(target).discount, tables(source).discount):
        raise MappingError(
            "distances need a discount below 1 in both tasks, at which they have a bound: got 1; "
            "FoundMapping.bound of find_mappings holds at 1 too"
        )
    with shown(progress) as bars:
        return _Fixed(tasks, tolerance, bars).bisimulation


def by_lax_bisimulation(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping to the nearest pair, and that to the nearest state and its nearest pair.

    Raises
    ------
    MappingError
        As :func:`lax_bisimulation`.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S...T"), GridWorld("S.T"))
    >>> [one.how for one in by_lax_bisimulation(tasks)]
    ['lax bisimulation: nearest pair', 'lax bisimulation: nearest pair of the nearest state']
    """
    fixed = _Fixed(tasks, TOLERANCE)
    yield tasks.proposal(fixed.bisimulation.nearest, "lax bisimulation: nearest pair")
    yield tasks.proposal(fixed.by_state, "lax bisimulation: nearest pair of the nearest state")


@dataclass(frozen=True, eq=False)
class _Fixed:
    """The fixed point on the quotients of two tasks, and what it says of the tasks."""

    tasks: TaskPair
    tolerance: float
    bars: Bars = SILENT

    @cached_property
    def quotients(self) -> tuple[tuple[Quotient, Blocks], tuple[Quotient, Blocks]]:
        """Both tasks up to bisimulation."""
        tasks, discount = self.tasks, self.tasks.target_mdp.discount
        own = quotient(tasks.models[0], discount, tasks.target_solution.values)
        other = quotient(tasks.models[1], discount, tasks.source_solution.values)
        size = len(own[0].reward) * len(other[0].reward)
        if size > LARGEST_PAIRS:
            raise MappingError(
                f"lax bisimulation compares up to {LARGEST_PAIRS:,} pairs with pairs: these "
                f"tasks have {size:,}"
            )
        work = work_of_a_round(own[0], other[0])
        if work > LARGEST_ROUND:
            raise MappingError(
                f"lax bisimulation couples up to {LARGEST_ROUND:,} pairs of outcomes in a round: "
                f"these tasks have {work:,}"
            )
        widest = max(own[0].chance.shape[1], other[0].chance.shape[1])
        if widest > WIDEST:
            raise MappingError(
                f"lax bisimulation takes up to {WIDEST} outcomes of a pair: got {widest}"
            )
        return own, other

    @cached_property
    def solved(self) -> tuple[Distances, float]:
        """The distances, and how far off they may be; so may a source rewritten by its V*."""
        (own, _), (other, _) = self.quotients
        discount = self.tasks.target_mdp.discount
        found, error = fixed_point(own, other, discount, self.tolerance, self.bars)
        slack = self.tasks.target_solution.error_bound + self.tasks.source_solution.error_bound
        return found, error + slack

    @cached_property
    def bisimulation(self) -> LaxBisimulation:
        """The distances between the tasks' own states and pairs."""
        (_, blocks), (other, source_blocks) = self.quotients
        found, error = self.solved
        kind, distance = found.pairs.argmin(axis=1), found.pairs.min(axis=1)
        live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)
        index = np.where(live, _first_pairs(source_blocks, len(other.reward))[kind[pairs]], ENDED)
        bound = np.where(live, distance[pairs] + error, 0.0)
        solutions = self.tasks.target_solution, self.tasks.source_solution
        bound = np.maximum(bound, np.where(live, apart(index, *solutions) + error, 0.0))
        states = found.states[blocks.states][:, source_blocks.states]
        between = np.subtract.outer(*(solution.values for solution in solutions))
        states = np.maximum(states, abs(between)) + error
        return LaxBisimulation(frozen(states), frozen(index), frozen(bound), error)

    @property
    def by_state(self) -> IntArray:
        """The nearest pair of the nearest state, (S, A)."""
        (_, blocks), (other, source_blocks) = self.quotients
        found, _ = self.solved
        state = found.states.argmin(axis=1)
        live, pairs = blocks.pairs >= 0, np.maximum(blocks.pairs, 0)
        choices = other.pairs[state[blocks.states]]  # (S, A'')
        distance = found.pairs[pairs[:, :, None], np.maximum(choices, 0)[:, None, :]]
        distance = np.where(choices[:, None, :] >= 0, distance, np.inf)
        kind = np.take_along_axis(choices, distance.argmin(axis=2), axis=1)
        return np.where(live, _first_pairs(source_blocks, len(other.reward))[kind], ENDED)


def _first_pairs(blocks: Blocks, kinds: int) -> IntArray:
    """Return the first pair of each kind, `ENDED` for the kind that has none: the end."""
    found, first = np.unique(blocks.pairs.ravel(), return_index=True)
    pairs = np.full(kinds, ENDED)
    pairs[found[found >= 0]] = first[found >= 0]
    return pairs
