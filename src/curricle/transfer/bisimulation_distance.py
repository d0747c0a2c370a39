"""The fixed point of lax bisimulation between the states of two tasks, compiled.

    d((s, a), (u, b)) = |r(s, a) - r(u, b)| + gamma W(P(s, a), P(u, b); d)
    d(s, u) = max(max_a min_b d((s, a), (u, b)), max_b min_a d((s, a), (u, b)))

with W the Kantorovich distance (Taylor, Precup, Panangaden 2009). d bounds |V*(s) - V*(u)|, and
d((s, a), (u, b)) bounds |Q*(s, a) - Q*(u, b)|, so these differences are where iteration starts.
It is modified policy iteration: one exact backup of all pairs, with all transport problems, then
sweeps with the choices and the couplings of that backup, which cost a hundredth. Backups are a
contraction, so that the change of an exact one bounds the distance to the fixed point, however it
was come by; where the sweeps do not help they are left out.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray, IntArray
from curricle.progress import SILENT, Bars
from curricle.tasks.loop_cache import compiled_once
from curricle.transfer.partition_refinement import Blocks, Model, merged_outcomes, refined
from curricle.transfer.transport import UNSET, flows_of, scratch, transport_cost

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

    Parameters
    ----------
    model : Model
    discount : float
    values : (S,) float64
        V*.
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
