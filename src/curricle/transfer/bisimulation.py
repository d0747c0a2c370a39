"""Bisimulation of finite MDPs: exact, by partition refinement, and lax, by distances.

A partition of the states is refined until all states of a block have the same rewards and the same
chance of each block (Givan, Dean, Greig 2003). As in MDP homomorphisms (Ravindran, Barto 2004), the
actions of a state may be relabelled: every action of a state has a counterpart in each equivalent
state, with the same expected reward and chance of each block. Equivalent pairs then have the same
Q*, even in different tasks that are refined jointly.

Lax bisimulation needs no exact correspondence: each pair reads the nearest pair, by distances that
bound differences of values (Taylor, Precup, Panangaden 2009; Castro, Precup 2010).
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.errors import MappingError
from curricle.tasks.kernel import compiled_once
from curricle.transfer.mapping import ENDED, UNMAPPED
from curricle.transfer.pair import Proposal, TaskPair, apart

# -- partition refinement --------------------------------------------------------------------------

PRECISION = 1e-9  # largest difference of equal numbers, in units of the largest


class Model(NamedTuple):
    """The tables of a task that refinement reads."""

    outcome_row: npt.NDArray[np.integer[Any]]  # (S, A)
    probability: FloatArray  # (Y, O)
    next_state: npt.NDArray[np.integer[Any]]  # (Y, O)
    mean_reward: FloatArray  # (Y,)
    terminal: BoolArray  # (S,)


class Blocks(NamedTuple):
    """The blocks of a task; in tasks refined jointly, equal numbers mean equivalence."""

    states: IntArray  # (S,) the block of each state; all terminal states have one block
    pairs: IntArray  # (S, A) the block of each pair, -1 in terminal states; its pairs have one Q*


def model_for_refinement(mdp: Any, mean_reward: FloatArray | None = None) -> Model:
    """Return the Model of a FiniteMDP; `mean_reward`, (Y,), may replace the MDP's."""
    rewards = (mdp.probability * mdp.reward).sum(axis=1) if mean_reward is None else mean_reward
    return Model(mdp.outcome_row, mdp.probability, mdp.next_state, rewards, mdp.terminal)


def joint_models(tasks: TaskPair) -> tuple[Model, Model]:
    """Return the models of a target and a source, both with the target's discount."""
    # The source's V* also solves V = max_a r' + gamma_t P V with r' = r + (gamma_s - gamma_t) P V.
    target, source = tasks.target_mdp, tasks.source_mdp
    rewards = (source.probability * source.reward).sum(axis=1)
    if target.discount != source.discount:
        values = tasks.source_solution.values[source.next_state]
        after = (source.probability * values).sum(axis=1)
        rewards = rewards + (source.discount - target.discount) * after
    return model_for_refinement(target), model_for_refinement(source, rewards)


def refined(models: Sequence[Model]) -> list[Blocks]:
    """Return the coarsest blocks, equal in rewards and next blocks, of tasks with one discount."""
    joint = _joined(models)
    states = np.where(joint.terminal, 0, 1)
    largest = float(abs(joint.mean_reward).max(initial=0.0))
    rewards, before = levels(joint.mean_reward, largest), len(np.unique(states))
    while True:
        # Rows are alike if their rewards and the chances of each block are equal; states if their
        # sets of rows are equal.
        entered, chances = merged_outcomes(states[joint.next_state], joint.probability)
        rows = numbered_rows(np.column_stack([rewards, entered, levels(chances, 1.0)]))
        pairs = np.where(joint.terminal[:, None], -1, rows[joint.outcome_row])
        ordered = np.sort(pairs, axis=1)
        ordered[:, 1:][ordered[:, 1:] == ordered[:, :-1]] = -1
        states = numbered_rows(np.column_stack([states, np.sort(ordered, axis=1)]))
        blocks = int(states.max()) + 1
        if blocks == before:
            break
        before = blocks
    ends = np.cumsum([len(model.terminal) for model in models])
    return [
        Blocks(states[end - len(model.terminal) : end],
               pairs[end - len(model.terminal) : end, : model.outcome_row.shape[1]])
        for model, end in zip(models, ends, strict=True)
    ]  # fmt: skip


def levels(values: FloatArray, largest: float) -> IntArray:
    """Return a number for each value, equal where values differ only by rounding of the largest."""
    order = np.argsort(values, axis=None)
    ordered = values.ravel()[order]
    apart = np.diff(ordered) > PRECISION * largest
    numbers = np.empty(values.size, np.int64)
    numbers[order] = np.concatenate([[0], np.cumsum(apart)]) if values.size else []
    return numbers.reshape(values.shape)


def numbered_rows(rows: npt.NDArray[np.integer[Any]]) -> IntArray:
    """Return a number for each row of a table, (n,) int64, equal for equal rows."""
    table = np.ascontiguousarray(rows, dtype=np.int64)
    records = table.view(np.dtype((np.void, table.shape[1] * 8))).ravel()
    return np.unique(records, return_inverse=True)[1].reshape(-1).astype(np.int64)


def merged_outcomes(
    blocks: npt.NDArray[np.integer[Any]], probability: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the different next blocks of each row in order, and their chances, both (Y, O)."""
    blocks = np.where(probability > 0, blocks, -1)
    order = np.argsort(blocks, axis=1, kind="stable")
    blocks = np.take_along_axis(blocks, order, axis=1).astype(np.int64)
    chances = np.take_along_axis(np.where(probability > 0, probability, 0.0), order, axis=1)
    first = np.ones(blocks.shape, bool)
    first[:, 1:] = blocks[:, 1:] != blocks[:, :-1]
    sums = np.add.reduceat(chances.ravel(), np.flatnonzero(first))
    totals = np.zeros(blocks.shape)
    totals[first] = sums
    kept = first & (blocks >= 0)
    order = np.argsort(~kept, axis=1, kind="stable")
    return (
        np.take_along_axis(np.where(kept, blocks, -1), order, axis=1),
        np.take_along_axis(np.where(kept, totals, 0.0), order, axis=1),
    )


def _joined(models: Sequence[Model]) -> Model:
    """Return one model of all tasks; actions that a task lacks are copies of its first action."""
    width = max(model.probability.shape[1] for model in models)
    actions = max(model.outcome_row.shape[1] for model in models)
    first_row = np.cumsum([0, *(len(model.probability) for model in models)])
    first_state = np.cumsum([0, *(len(model.terminal) for model in models)])
    parts = []
    for model, row, state in zip(models, first_row[:-1], first_state[:-1], strict=True):
        spare = ((0, 0), (0, width - model.probability.shape[1]))
        more = np.repeat(model.outcome_row[:, :1], actions - model.outcome_row.shape[1], axis=1)
        parts.append(
            Model(
                np.concatenate([model.outcome_row, more], axis=1).astype(np.int64) + row,
                np.pad(model.probability, spare),
                np.pad(model.next_state, spare).astype(np.int64) + state,
                model.mean_reward,
                model.terminal,
            )
        )
    return Model(*(np.concatenate(column) for column in zip(*parts, strict=True)))


LARGEST_REFINED = 20_000_000  # state-action pairs of both tasks up to which they are refined


def by_homomorphism(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of target pairs to equivalent source pairs, if there are any.

    Equivalent pairs have the same Q*, up to rounding. A target state reads the first equivalent
    source state. If no source state is equivalent, its pairs read the first source pair with the
    same reward and equivalent next states.

    Raises
    ------
    MappingError
        When no pair has an equivalent, or the tasks have more than 20 million pairs.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = GridWorld(["S.P", "..T"])
    >>> tasks = TaskPair(maze, GridWorld(["T..", "P.S"]))  # turned by 180 degrees
    >>> next(by_homomorphism(tasks)).how
    'exact homomorphism: 100% of pairs have a source pair of the same Q*'
    """
    sizes = [mdp.outcome_row.size for mdp in (tasks.target_mdp, tasks.source_mdp)]
    if sum(sizes) > LARGEST_REFINED:
        raise MappingError(
            f"tasks are refined together up to {LARGEST_REFINED:,} pairs: these have {sum(sizes):,}"
        )
    target, source = refined(joint_models(tasks))
    index = equivalent_pairs(target, source)
    solutions = tasks.own_solutions or (tasks.target_solution, tasks.source_solution)
    error = 2 * sum(solution.error_bound for solution in solutions)
    index = np.where(apart(index, *solutions) <= error, index, UNMAPPED)
    live = ~tasks.target_mdp.terminal
    share = float((index[live] >= 0).mean())
    if share == 0:
        raise MappingError("no pair of the target is equivalent to a pair of the source")
    how = f"exact homomorphism: {int(100 * share)}% of pairs have a source pair of the same Q*"
    yield tasks.proposal(index, how)


def equivalent_pairs(target: Blocks, source: Blocks) -> IntArray:
    """Return for each target pair an equivalent source pair, or `UNMAPPED`, (S, A) int64."""
    most = int(max(target.pairs.max(), source.pairs.max())) + 2

    def keys(blocks: Blocks) -> IntArray:
        key = blocks.states[:, None] * most + blocks.pairs
        return np.where(blocks.pairs < 0, -1, key).ravel()

    index = _first_of(keys(source), keys(target))
    elsewhere = _first_of(source.pairs.ravel(), target.pairs.ravel())
    index = np.where(index == UNMAPPED, elsewhere, index)
    return np.where(target.pairs.ravel() < 0, UNMAPPED, index).reshape(target.pairs.shape)


def _first_of(keys: IntArray, wanted: IntArray) -> IntArray:
    """Return the first index of each wanted key; `UNMAPPED` if it is missing or negative."""
    known, first = np.unique(keys, return_index=True)
    place = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    there = (known[place] == wanted) & (wanted >= 0)
    return np.where(there, first[place], UNMAPPED).astype(np.int64)


# -- the Kantorovich distance ----------------------------------------------------------------------

UNSET = 255  # first entry of a tree that has not been made
WIDEST = 120  # most outcomes of a distribution: nodes of two are numbered in 8 bits
PERTURBATION = 1e-10
MOST_PIVOTS = 10_000


class Scratch(NamedTuple):
    """Work space for distributions of up to O and O' outcomes."""

    cost: FloatArray  # (O, O')
    dual: FloatArray  # (O + O',)
    flow: FloatArray  # (O + O',) from each node along the edge to its parent
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

    The search starts at the tree, `parent` and `order` (n + m,) uint8, and leaves the optimal tree.
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
    """Write the tree of the north-west corner rule."""
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
    """Write the flow along the edge from each node, except the root, to its parent."""
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
    """Add the edge of a row and a column to the tree; remove the first edge that loses all flow."""
    nodes = len(p) + len(q)
    flow, depth = space.flow, space.depth
    flows_of(p, q, parent, order, PERTURBATION, flow)
    depth[0] = 0
    for k in range(1, nodes):
        depth[order[k]] = depth[parent[order[k]]] + 1
    # The path between row and column has an odd number of edges: the 1st, 3rd, ... last lose flow.
    left, right = row, column
    from_left, from_right = 0, 0
    least, leaving, on_left = np.inf, -1, True
    while left != right:
        if depth[left] >= depth[right]:
            if from_left % 2 == 0 and flow[left] < least:
                least, leaving, on_left = flow[left], left, True
            left, from_left = parent[left], from_left + 1
        else:
            if from_right % 2 == 0 and flow[right] < least:
                least, leaving, on_left = flow[right], right, False
            right, from_right = parent[right], from_right + 1
    current, above = (row, column) if on_left else (column, row)
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

SWEEPS = 40  # sweeps after a backup, with the choices of that backup
MOST_ROUNDS = 5_000
MOST_WORK = 20_000_000_000
"""Most pairs of outcomes to couple in all rounds: some minutes of one core."""

Numbers = npt.NDArray[np.int32]


class Couplings(NamedTuple):
    """The couplings of outcomes of all pairs that determine d of states, one after the other."""

    first: IntArray  # (B B' + 1,)
    cell: IntArray  # (n,) s * B' + u of two outcomes
    mass: FloatArray  # (n,) mass of the coupling at this cell


class Quotient(NamedTuple):
    """A task with equivalent states and pairs merged: B blocks of states, Y kinds of pairs."""

    pairs: Numbers  # (B, A) the kinds of a block's pairs, then -1
    reward: FloatArray  # (Y,)
    chance: FloatArray  # (Y, O)
    after: Numbers  # (Y, O) next blocks
    width: Numbers  # (Y,) number of outcomes
    best: FloatArray  # (B,) V*
    blocks: Blocks  # the block of each state, and the kind of each pair


def quotient(model: Model, values: FloatArray) -> Quotient:
    """Return a task up to bisimulation."""
    (blocks,) = refined([model])
    live = np.flatnonzero(blocks.pairs.ravel() >= 0)
    of_live = blocks.pairs.ravel()[live]
    kinds, first, kind = np.unique(of_live, return_index=True, return_inverse=True)
    row = model.outcome_row.ravel()[live[first]]
    after, chance = merged_outcomes(blocks.states[model.next_state[row]], model.probability[row])
    reward = model.mean_reward[row]
    pairs = np.full(blocks.pairs.shape, -1)
    pairs.ravel()[live] = kind.ravel()
    _, state = np.unique(blocks.states, return_index=True)
    of_block = [np.unique(pairs[s]) for s in state]
    if model.terminal.any():
        end = int(blocks.states[model.terminal][0])
        after = np.concatenate([after, np.full((1, after.shape[1]), -1)])
        chance = np.concatenate([chance, np.zeros((1, chance.shape[1]))])
        after[-1, 0], chance[-1, 0] = end, 1.0
        reward = np.append(reward, 0.0)
        of_block[end] = np.array([len(kinds)])
    listed = np.full((len(state), max(map(len, of_block))), -1, np.int32)
    for block, kinds_of_block in enumerate(of_block):
        listed[block, : len(kinds_of_block)] = kinds_of_block
    width = (after >= 0).sum(axis=1).astype(np.int32)
    kept = max(1, int(width.max()))
    reached = np.ascontiguousarray(after[:, :kept], np.int32)
    chance = np.ascontiguousarray(chance[:, :kept])
    kinds_of = Blocks(blocks.states, pairs)
    return Quotient(listed, reward, chance, reached, width, values[state], kinds_of)


def fixed_point(
    target: Quotient, source: Quotient, discount: float, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Return d of blocks of states, (B, B'), and of kinds of pairs, (Y, Y')."""
    # Iteration ends when the error is at most `tolerance` times the largest distance, or after the
    # most rounds.
    nodes = target.chance.shape[1] + source.chance.shape[1]
    random = target.chance.shape[1] > 1 and source.chance.shape[1] > 1
    pairs = np.empty((len(target.reward), len(source.reward)))
    # The trees of the transports; a tiny array if no transport needs a tree.
    tree = np.full((*pairs.shape, 2, nodes) if random else (1, 1, 2, 1), UNSET, np.uint8)
    states = abs(target.best[:, None] - source.best)
    rests_on = np.empty((states.size, 2), np.int64)
    most = float(max(states.max(), 1e-300))
    last, helps = np.inf, True
    rounds = max(1, min(MOST_ROUNDS, MOST_WORK // (target.chance.size * source.chance.size)))
    for left in reversed(range(rounds)):
        back_up_pairs(target, source, states, pairs, tree, discount)
        change = back_up_states(target.pairs, source.pairs, pairs, states, rests_on)
        error = discount / (1 - discount) * change
        most = max(most, float(states.max()))
        if error <= tolerance * most or left == 0:
            break
        helps, last = helps and change < last, change
        if helps:
            y, z = rests_on.T
            counts = np.maximum(target.width[y], source.width[z])
            both = (target.width[y] > 1) & (source.width[z] > 1)
            counts = np.where(both, target.width[y] + source.width[z] - 1, counts)
            first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
            couplings = Couplings(first, np.empty(first[-1], np.int64), np.empty(first[-1]))
            fill_couplings(target, source, tree, rests_on, states.shape[1], couplings)
            difference = abs(target.reward[y] - source.reward[z])
            follow(couplings, difference, states.reshape(-1), discount, SWEEPS)
    return states, pairs


@compiled_once
def back_up_pairs(target, source, states, pairs, tree, discount):
    """Compute d of all pairs from d of states."""
    space = scratch(target.chance.shape[1], source.chance.shape[1])
    for y in range(len(target.reward)):
        n = target.width[y]
        for z in range(len(source.reward)):
            m = source.width[z]
            total = 0.0
            if n == 1 or m == 1:
                for i in range(n):
                    for j in range(m):
                        mass = target.chance[y, i] * source.chance[z, j]
                        total += mass * states[target.after[y, i], source.after[z, j]]
            else:
                for i in range(n):
                    for j in range(m):
                        space.cost[i, j] = states[target.after[y, i], source.after[z, j]]
                total = transport_cost(
                    target.chance[y, :n], source.chance[z, :m], tree[y, z, 0], tree[y, z, 1], space
                )
            pairs[y, z] = abs(target.reward[y] - source.reward[z]) + discount * total


@compiled_once
def back_up_states(target_pairs, source_pairs, pairs, states, rests_on):
    """Compute d of states from d of pairs, and the pair that determines it; return the change."""
    least = np.empty(source_pairs.shape[1])
    change = 0.0
    for s in range(len(target_pairs)):
        for u in range(len(source_pairs)):
            value, y, z = hausdorff(target_pairs[s], source_pairs[u], pairs, least)
            change = max(change, abs(value - states[s, u]))
            states[s, u] = value
            cell = s * len(source_pairs) + u
            rests_on[cell, 0], rests_on[cell, 1] = y, z
    return change


@compiled_once
def hausdorff(rows, columns, pairs, nearest):
    """Return the Hausdorff distance of two states' pairs `rows` and `columns`, and its pair."""
    largest, row, column = -1.0, 0, 0
    nearest[:] = np.inf
    for y in rows:
        if y < 0:
            break
        smallest, at = np.inf, 0
        for b in range(len(columns)):
            z = columns[b]
            if z < 0:
                break
            value = pairs[y, z]
            if value < smallest:
                smallest, at = value, z
            nearest[b] = min(nearest[b], value)
        if smallest > largest:
            largest, row, column = smallest, y, at
    for b in range(len(columns)):
        if columns[b] >= 0 and nearest[b] > largest:
            largest, column = nearest[b], columns[b]
            for y in rows:
                if y >= 0 and pairs[y, column] == largest:
                    row = y
                    break
    return largest, row, column


@compiled_once
def fill_couplings(target, source, tree, rests_on, n_source, couplings):
    """Write the couplings of all pairs that determine a distance of states."""
    first, cell, mass = couplings
    space = scratch(target.chance.shape[1], source.chance.shape[1])
    for k in range(len(rests_on)):
        y, z = rests_on[k, 0], rests_on[k, 1]
        n, m = target.width[y], source.width[z]
        at = first[k]
        if n == 1 or m == 1:
            for i in range(n):
                for j in range(m):
                    cell[at] = target.after[y, i] * n_source + source.after[z, j]
                    mass[at] = target.chance[y, i] * source.chance[z, j]
                    at += 1
            continue
        parent, order = tree[y, z, 0], tree[y, z, 1]
        flows_of(target.chance[y, :n], source.chance[z, :m], parent, order, 0.0, space.flow)
        for k_node in range(1, n + m):
            node = order[k_node]
            up = parent[node]
            i, j = (node, up - n) if node < n else (up, node - n)
            cell[at] = target.after[y, i] * n_source + source.after[z, j]
            mass[at] = max(space.flow[node], 0.0)
            at += 1


@compiled_once
def follow(couplings, difference, states, discount, times):
    """Back up d of states, a flat array, with fixed choices and couplings, in alternating order."""
    first, cell, mass = couplings
    for time in range(times):
        for k in range(len(states)):
            at = k if time % 2 == 0 else len(states) - 1 - k
            total = 0.0
            for entry in range(first[at], first[at + 1]):
                total += mass[entry] * states[cell[entry]]
            states[at] = difference[at] + discount * total


# -- nearest pairs ---------------------------------------------------------------------------------

TOLERANCE = 1e-3  # largest error of distances, in units of the largest distance
LARGEST_PAIRS = 8_000_000
"""Most combinations of a kind of target pair and a kind of source pair."""

LARGEST_ROUND = MOST_WORK // 10
"""Most combinations of their outcomes in a round, so that there is time for ten rounds."""


def by_lax_bisimulation(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield two mappings: to the nearest pair, and to the nearest pair of the nearest state.

    Distances are the fixed point of d((s, a), (u, b)) = abs(r - r') + gamma W(P, P'; d), where W is
    the Kantorovich distance, and d(s, u) = max(max_a min_b d, max_b min_a d). Terminal states pay
    nothing for ever. Where discounts differ, the source's rewards are rewritten so that its V*
    solves the equation of the target's discount.

    Raises
    ------
    MappingError
        When the tasks are too large, or a pair has more than 120 outcomes.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> tasks = TaskPair(GridWorld("S...T"), GridWorld("S.T"))
    >>> [proposal.how for proposal in by_lax_bisimulation(tasks)]
    ['lax bisimulation: nearest pair', 'lax bisimulation: nearest pair of the nearest state']
    """
    target, source, of_states, of_pairs = distances(tasks)
    known, at = np.unique(source.blocks.pairs.ravel(), return_index=True)
    first = np.full(len(source.reward), ENDED)  # a pair of each kind; ENDED for the kind of the end
    first[known[known >= 0]] = at[known >= 0]
    live, pairs = target.blocks.pairs >= 0, np.maximum(target.blocks.pairs, 0)
    index = np.where(live, first[of_pairs.argmin(axis=1)[pairs]], ENDED)
    yield tasks.proposal(index, "lax bisimulation: nearest pair")
    choices = source.pairs[of_states.argmin(axis=1)[target.blocks.states]]  # (S, A'')
    far = of_pairs[pairs[:, :, None], np.maximum(choices, 0)[:, None, :]]
    far = np.where(choices[:, None, :] >= 0, far, np.inf)
    index = first[np.take_along_axis(choices, far.argmin(axis=2), axis=1)]
    index = np.where(live, index, ENDED)
    yield tasks.proposal(index, "lax bisimulation: nearest pair of the nearest state")


def distances(
    tasks: TaskPair, tolerance: float = TOLERANCE
) -> tuple[Quotient, Quotient, FloatArray, FloatArray]:
    """Return both quotients, d of their blocks, and d of their kinds of pairs."""
    target, source = (
        quotient(model, solution.values)
        for model, solution in zip(
            joint_models(tasks), (tasks.target_solution, tasks.source_solution), strict=True
        )
    )
    if (size := len(target.reward) * len(source.reward)) > LARGEST_PAIRS:
        raise MappingError(
            f"lax bisimulation compares up to {LARGEST_PAIRS:,} pairs with pairs: these tasks have "
            f"{size:,}"
        )
    if (work := target.chance.size * source.chance.size) > LARGEST_ROUND:
        raise MappingError(
            f"lax bisimulation couples up to {LARGEST_ROUND:,} pairs of outcomes in a round: "
            f"these tasks have {work:,}"
        )
    if (widest := max(target.chance.shape[1], source.chance.shape[1])) > WIDEST:
        raise MappingError(
            f"lax bisimulation takes up to {WIDEST} outcomes of a pair: got {widest}"
        )
    return target, source, *fixed_point(target, source, tasks.target_mdp.discount, tolerance)
