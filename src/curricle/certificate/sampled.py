"""A shaping checked on sampled steps, where a task is too large to be compared state by state.

Random rollouts can refute that F comes of a potential, never prove that it does.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from curricle.certificate.bonus import RECOGNISED
from curricle.certificate.diagnosis import different_by_action, two_ways_in
from curricle.certificate.given import Given
from curricle.certificate.shaped import bonus_values
from curricle.learning.potential import StateActionPotential, StatePotential
from curricle.planning.rollouts import RandomRollouts, random_rollouts
from curricle.tasks.labels import state_name
from curricle.tasks.task import generative_model

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LONGEST = 200
"""Steps at which a walk is cut off."""
BRANCHES, DEPTH = 40, 3
"""RandomRollouts from one state, and their steps, that look for two ways to the same place."""
MOMENTS, SHORT = 50, 20
"""RandomRollouts that follow a changing potential in time, and their steps."""
ROUNDING = 1e-9
"""Relative size of what sums of differences may leave."""


@dataclass(frozen=True)
class Sampled:
    """What was found.

    Attributes
    ----------
    steps : int
        That were taken.
    residual : float
        Largest distance of a sum of F from what a potential would make it.
    contradictions : tuple of str
        Sentences that say where; empty where all agrees.
    """

    steps: int
    residual: float
    contradictions: tuple[str, ...]


def sampled(given: Given, steps: int, seed: int) -> Sampled:
    """Return what walks through the task say of a shaping.

    Parameters
    ----------
    given : Given
    steps : int
        How many to take, about.
    seed : int

    Examples
    --------
    >>> from curricle import Pursuit
    >>> from curricle.certificate.given import ShapingReward, checked
    >>> pay = ShapingReward(lambda state, action, after: action % 5 == 0)
    >>> found = sampled(checked(Pursuit(size=10, predators=3), pay), 10_000, seed=0)
    >>> print(found.contradictions[0])
    not potential-based: from ...; a potential is blind to actions
    """
    if given.claim == "added_rewards":
        return _reward(given, steps, seed)
    if given.changing:
        return in_time(given, seed)
    limit = generative_model(given.task).time_limit
    length = max(2, min(steps, LONGEST, LONGEST if limit is None else limit))
    walks = random_rollouts(given.task, episodes=max(1, steps // length), length=length, seed=seed)
    if given.claim == "one_way_in":
        return _look_back(given, walks)
    here, paid, taken = (_of_states if given.claim == "telescoping" else _of_pairs)(given, walks)
    return _telescoping(given, walks, here, paid, taken)


# -- F of a potential telescopes -----------------------------------------------------------------


def _of_states(given: Given, walks: RandomRollouts) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return Phi(s_t), F of each step, and the steps taken."""
    phi, states = given.potential, walks.states
    if given.raw or given.discount != generative_model(given.task).discount:
        here = given.final()[states]
        return here, given.discount * here[:, 1:] - here[:, :-1], walks.length
    here = phi.at()[states]
    paid = phi.shaping_reward(states[:, :-1], states[:, 1:])
    if (
        generative_model(given.task).terminal is None
    ):  # learning takes them for 0 when it comes there
        paid = np.where(walks.ending, -here[:, :-1], paid)
    return here, paid, walks.length


def _of_pairs(given: Given, walks: RandomRollouts) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return phi(s_t, a_t), F of each step with the action taken next, and the steps that have one.

    A walk that was cut off has none after its last step. At an end any action is as good: the
    best, of an array; 0 is what the library's potentials say.
    """
    s, a = walks.states, walks.actions
    here = np.zeros(s.shape)
    here[:, :-1] = given.at_pairs(s[:, :-1].ravel(), a.ravel()).reshape(a.shape)
    discount = generative_model(given.task).discount
    phi = given.potential
    if isinstance(phi, StateActionPotential):
        paid = np.zeros(a.shape)
        paid[:, :-1] = phi.look_ahead(s[:, :-2], a[:, :-1], s[:, 1:-1], a[:, 1:])
    else:
        paid = discount * here[:, 1:] - here[:, :-1]
    last = given.ending()[s[:, 1:]] if given.raw else np.zeros(a.shape)
    paid = np.where(walks.ending, discount * last - here[:, :-1], paid)
    return here, paid, walks.length - ~walks.terminated


def _telescoping(
    given: Given, walks: RandomRollouts, here: FloatArray, paid: FloatArray, taken: IntArray
) -> Sampled:
    """Compare the discounted sums of F from every step on with gamma^n Phi(s_n) - Phi(s_t)."""
    gamma = generative_model(given.task).discount
    left = taken[:, None] - np.arange(paid.shape[1])
    sums = discounted_sums(paid, left > 0, gamma)
    last = np.take_along_axis(here, taken[:, None], axis=1)
    last[walks.terminated] = 0.0  # an end is worth nothing, a cut is no end
    expected = gamma ** np.maximum(left, 0) * last - here[:, :-1]
    apart = np.where(left > 0, abs(sums - expected), 0.0)
    worst = float(apart.max())
    contradictions = []
    if worst > ROUNDING * max(abs(here).max(), abs(paid).max()):
        w, t = np.unravel_index(apart.argmax(), apart.shape)
        place = state_name(given.task.states, int(walks.states[w, t]))
        contradictions.append(
            f"F does not telescope: on one walk of {left[w, t]} steps from {place} it adds up to "
            f"{sums[w, t]:.4g} where Phi at both ends says {expected[w, t]:.4g}"
        )
    return Sampled(int(walks.length.sum()), worst, tuple(contradictions))


def discounted_sums(paid: FloatArray, counts: npt.NDArray[np.bool_], discount: float) -> FloatArray:
    """Return sum_i gamma^i F_(t+i) from each step of each walk on, (W, L).

    Examples
    --------
    >>> discounted_sums(np.array([[1.0, 2.0, 4.0]]), np.array([[True, True, False]]), 0.5)
    array([[2., 2., 0.]])
    """
    sums, total = np.zeros(paid.shape), np.zeros(len(paid))
    for t in reversed(range(paid.shape[1])):
        total = np.where(counts[:, t], paid[:, t] + discount * total, 0.0)
        sums[:, t] = total
    return sums


def in_time(given: Given, seed: int) -> Sampled:
    """Check that a changing potential telescopes in time: F = gamma Phi(s', t + 1) - Phi(s, t).

    RandomRollouts start at moments all over the time in which it changes (Devlin, Kudenko 2012).
    """
    phi: StatePotential = given.potential
    walks = random_rollouts(given.task, episodes=MOMENTS, length=SHORT, seed=seed)
    over = int(
        phi.frame_steps[-1] + (0 if phi.weight.first == phi.weight.last else phi.weight.span)
    )
    begin = np.linspace(0, over, MOMENTS).astype(np.int64)
    if len(phi.frame_steps) > 1:  # and just before every change
        begin[1 : len(phi.frame_steps)] = (phi.frame_steps - SHORT // 2)[1:MOMENTS]
        begin = np.maximum(begin, 0)
    here, paid = np.zeros(walks.states.shape), np.zeros(walks.actions.shape)
    for w, s in enumerate(walks.states):
        for t in range(walks.length[w] + 1):
            moment = int(begin[w] + t)
            here[w, t] = phi.at(moment)[s[t]]
            if t < walks.length[w]:
                paid[w, t] = phi.shaping_reward(s[t], s[t + 1], step=moment)
    if generative_model(given.task).terminal is None:
        paid = np.where(walks.ending, -here[:, :-1], paid)
    return _telescoping(given, walks, here, paid, walks.length)


def _look_back(given: Given, walks: RandomRollouts) -> Sampled:
    """Look for a state that is entered in more than one way, with different phi."""
    into = walks.taken & ~walks.ending
    s, a, after = walks.states[:, :-1][into], walks.actions[into], walks.states[:, 1:][into]
    starts = np.unique(walks.states[:, 0])
    phi = np.append(given.at_pairs(s, a), np.zeros(len(starts)))
    apart, high, low = widest(np.append(after, starts)[:, None], phi)
    contradictions = []
    if apart > ROUNDING * abs(phi).max():
        ways = [(float(phi[i]), int(s[i]), int(a[i])) if i < len(s) else None for i in (high, low)]
        entered = int(np.append(after, starts)[high])
        contradictions.append(two_ways_in(given.task, entered, ways))
    return Sampled(int(walks.length.sum()), apart, tuple(contradictions))


# -- a reward of one's own -----------------------------------------------------------------------


def _reward(given: Given, steps: int, seed: int) -> Sampled:
    """Look for what no potential would pay: along walks, and around states on them."""
    task, gamma = given.task, generative_model(given.task).discount
    limit = generative_model(task).time_limit
    length = min(max(1, steps // 2), LONGEST, LONGEST if limit is None else limit)
    walks = random_rollouts(task, episodes=max(1, steps // 2 // length), length=length, seed=seed)
    paid = _paid(given, walks)
    rng = np.random.default_rng(seed)
    begun = np.unique(walks.states[:, :-1][walks.taken])
    number = min(len(begun), max(1, steps // 2 // (BRANCHES * DEPTH)))
    bases = np.repeat(rng.choice(begun, number, replace=False), BRANCHES)
    near = random_rollouts(task, episodes=len(bases), length=DEPTH, seed=seed + 1, starts=bases)
    paid_near = _paid(given, near)
    enough = RECOGNISED * max(abs(paid).max(), abs(paid_near).max())
    found = [_meeting(given, near, paid_near, gamma, enough), _returning(given, walks, paid, gamma)]
    contradictions = tuple(said for apart, said in found if apart > enough)
    total = int(walks.length.sum() + near.length.sum())
    return Sampled(total, max(apart for apart, _ in found), contradictions)


def _paid(given: Given, walks: RandomRollouts) -> FloatArray:
    """Return F of each step, (W, L), 0 where none was taken."""
    taken, paid = walks.taken, np.zeros(walks.actions.shape)
    transition = walks.states[:, :-1][taken], walks.actions[taken], walks.states[:, 1:][taken]
    paid[taken] = bonus_values(given.task, given.bonus(), *transition)
    return paid


def _meeting(
    given: Given, walks: RandomRollouts, paid: FloatArray, gamma: float, enough: float
) -> tuple[float, str]:
    """Return how far apart ways of equal length between two states are paid, and where.

    A potential pays gamma^n Phi(s') - Phi(s) on all of them. The shortest that are further apart
    than `enough` will do.
    """
    worst, said = 0.0, ""
    for n in range(1, DEPTH + 1):
        among = np.flatnonzero(walks.length >= n)
        if not among.size or worst > enough:
            break
        sums = paid[among, :n] @ gamma ** np.arange(n)
        apart, high, low = widest(walks.states[among][:, [0, n]], sums)
        if apart > worst:
            first, after = (
                state_name(given.task.states, int(s)) for s in walks.states[among[high], [0, n]]
            )
            worst, said = (
                apart,
                (
                    f"not potential-based: two ways of {n} steps from {first} to {after} are paid "
                    f"{sums[high]:.4g} and {sums[low]:.4g} in all; a potential pays both alike"
                ),
            )
            if n == 1:
                by = [(float(sums[i]), int(walks.actions[among[i], 0])) for i in (high, low)]
                said = different_by_action(given.task, first, after, by)
    return worst, said


def _returning(
    given: Given, walks: RandomRollouts, paid: FloatArray, gamma: float
) -> tuple[float, str]:
    """Return how far apart the Phi are that loops through a state, or ways to an end, ask for.

    A loop of n steps is paid (gamma^n - 1) Phi(s), the way to an end -Phi(s).
    """
    sums = np.pad(discounted_sums(paid, walks.taken, gamma), ((0, 0), (0, 1)))
    walk, time = np.nonzero(np.pad(walks.taken, ((0, 0), (0, 1))) | _cut(walks))
    state = walks.states[walk, time]
    order = np.lexsort((time, state, walk))
    walk, time, state = walk[order], time[order], state[order]
    again = np.flatnonzero((walk[1:] == walk[:-1]) & (state[1:] == state[:-1]))
    weight = gamma ** (time[again + 1] - time[again])
    there = sums[walk[again + 1], time[again + 1]]
    loops = sums[walk[again], time[again]] - weight * there
    ended = walks.terminated[walk]
    earned = np.concatenate([loops, sums[walk[ended], time[ended]]])
    factor = np.concatenate([weight - 1.0, np.full(ended.sum(), -1.0)])
    where = np.concatenate([state[again], state[ended]])
    if not where.size:
        return 0.0, ""
    # The way with the largest factor says what Phi is; the others must agree.
    order = np.lexsort((-abs(factor), where))
    first = np.flatnonzero(np.diff(where[order], prepend=-1))
    sizes = np.diff(first, append=len(order))
    lead = np.repeat(order[first], sizes)
    apart = abs(earned[order] * factor[lead] - earned[lead] * factor[order])
    apart = np.where(factor[lead] == 0, abs(earned[order]), apart)
    worst = int(apart.argmax())
    one, other = order[worst], lead[worst]
    place = state_name(given.task.states, int(where[one]))
    if factor[one] == 0:
        said = f"a loop through {place} is paid {earned[one]:.4g}, where a potential pays nothing"
    else:
        said = (
            f"one way on from {place} asks for Phi = {earned[one] / factor[one]:.4g}, another for "
            f"{earned[other] / factor[other]:.4g}"
        )
    return float(apart[worst]), f"not potential-based: {said}"


def _cut(walks: RandomRollouts) -> npt.NDArray[np.bool_]:
    """Return the place of the last state of each walk that was cut off, (W, L + 1)."""
    last = np.arange(walks.states.shape[1]) == walks.length[:, None]
    return np.asarray(last & ~walks.terminated[:, None])


def widest(keys: IntArray, values: FloatArray) -> tuple[float, int, int]:
    """Return how far apart values of equal keys, (n, k), are at most, and which two.

    Examples
    --------
    >>> widest(np.array([[1], [2], [1]]), np.array([5.0, 0.0, 3.0]))
    (2.0, 0, 2)
    """
    order = np.lexsort((values, *keys.T))
    same = (keys[order][1:] == keys[order][:-1]).all(axis=1)
    first = np.flatnonzero(~np.concatenate([[False], same]))
    last = np.append(first[1:], len(order)) - 1
    apart = values[order[last]] - values[order[first]]
    group = int(apart.argmax())
    return float(apart[group]), int(order[last[group]]), int(order[first[group]])
