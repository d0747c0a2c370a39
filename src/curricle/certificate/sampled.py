"""A reward of your own, or look-back advice, refuted (never proven) on sampled steps of a task."""

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.certificate.diagnosis import (
    RELATIVE_RESIDUAL,
    different_by_action,
    several_entries,
    widest,
)
from curricle.certificate.shaped_task import ShapedTask, shaping_rewards
from curricle.certificate.verdict import SampledCertificate
from curricle.planning.rollouts import RandomRollouts, random_rollouts
from curricle.tasks.live import is_live
from curricle.tasks.mdp import generative_model
from curricle.tasks.spaces import state_name

Checked = tuple[int, float, tuple[str, ...]]
"""Steps taken, the largest distance of a sum of F from that of a potential, and sentences."""
LONGEST = 200  # steps of a rollout at most
BRANCHES, DEPTH = 40, 3  # rollouts from one state, and their steps, among which two paths may meet


def sampled(
    shaped: ShapedTask, steps: int, seed: int, reason: str, findings: tuple[str, ...] = ()
) -> SampledCertificate:
    """Return the result of a check on about so many steps of the uniform policy."""
    check = _check_reward if shaped.shaping.any_reward else _check_entries
    taken, residual, contradictions = check(shaped, steps, seed)
    return SampledCertificate(
        shaped.shaping.name, taken, reason, contradictions, residual, findings
    )


def _length(shaped: ShapedTask, steps: int) -> int:
    """Return the length of rollouts that are to take at most `steps` each."""
    return min(steps, LONGEST, generative_model(shaped.task).time_limit or LONGEST)


def _check_entries(shaped: ShapedTask, steps: int, seed: int) -> Checked:
    """Check that all transitions into a state have one phi."""
    length = max(2, _length(shaped, steps))
    rollouts = random_rollouts(
        shaped.task, episodes=max(1, steps // length), length=length, seed=seed
    )
    taken = rollouts.taken & ~rollouts.ending
    s, a, after = _transitions(rollouts, taken)
    starts = np.unique(rollouts.states[:, 0])
    phi = shaped.phi_of(s, a)
    apart, sentence = several_entries(shaped.task, (s, a, after), phi, starts)
    return int(rollouts.length.sum()), apart, () if sentence is None else (sentence,)


def _transitions(rollouts: RandomRollouts, taken: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    states = rollouts.states
    return states[:, :-1][taken], rollouts.actions[taken], states[:, 1:][taken]


# -- a reward of your own --------------------------------------------------------------------------


def _check_reward(shaped: ShapedTask, steps: int, seed: int) -> Checked:
    """Check that F may be that of a potential: along rollouts, and around states on them."""
    task, rng = shaped.task, np.random.default_rng(seed)
    live = is_live(task)
    half = steps if live else max(1, steps // 2)
    length = _length(shaped, half)
    rollouts = random_rollouts(task, episodes=max(1, half // length), length=length, seed=seed)
    f = _rewards(shaped, rollouts)
    if live:
        near, f_near = rollouts, f
    else:
        begun = np.unique(rollouts.states[:, :-1][rollouts.taken])
        number = min(len(begun), max(1, half // (BRANCHES * DEPTH)))
        starts = np.repeat(rng.choice(begun, number, replace=False), BRANCHES)
        near = random_rollouts(
            task, episodes=len(starts), length=DEPTH, seed=seed + 1, starts=starts
        )
        f_near = _rewards(shaped, near)
    enough = RELATIVE_RESIDUAL * max(abs(f).max(), abs(f_near).max())
    checks = _meeting(shaped, near, f_near, enough), _returning(shaped, rollouts, f)
    return (
        int(rollouts.length.sum() + (0 if live else near.length.sum())),
        max(apart for apart, _ in checks),
        tuple(sentence for apart, sentence in checks if apart > enough),
    )


def _rewards(shaped: ShapedTask, rollouts: RandomRollouts) -> FloatArray:
    """Return F of each step, (E, L), 0 where none was taken."""
    taken, f = rollouts.taken, np.zeros(rollouts.actions.shape)
    f[taken] = shaping_rewards(shaped.task, shaped.reward(), *_transitions(rollouts, taken))
    return f


def _meeting(
    shaped: ShapedTask, rollouts: RandomRollouts, f: FloatArray, enough: float
) -> tuple[float, str]:
    """Return how far sums of F over paths of equal length between two states differ, and where."""
    worst, sentence = 0.0, ""
    for n in range(1, DEPTH + 1):
        among = np.flatnonzero(rollouts.length >= n)
        if not among.size or worst > enough:
            break
        sums = f[among, :n] @ shaped.task_discount ** np.arange(n)
        apart, *pair = widest(rollouts.states[among][:, [0, n]], sums)
        if apart <= worst:
            continue
        worst = apart
        here, there = rollouts.states[among[pair[0]], [0, n]].tolist()
        if n == 1:
            actions = rollouts.actions[among[pair], 0]
            sentence = different_by_action(shaped.task, here, there, sums[pair], actions)
            continue
        space = shaped.task.states
        sentence = (
            f"not potential-based: two paths of {n} steps from {state_name(space, here)} to "
            f"{state_name(space, there)} have discounted sums of F of {sums[pair[0]]:.4g} and "
            f"{sums[pair[1]]:.4g}; with a potential they are equal"
        )
    return worst, sentence


def discounted_sums(f: FloatArray, counted: BoolArray, discount: float) -> FloatArray:
    """Return sum_i gamma^i F_(t+i) over the counted steps from each step on, (E, L)."""
    sums, total = np.zeros(f.shape), np.zeros(len(f))
    for t in reversed(range(f.shape[1])):
        total = np.where(counted[:, t], f[:, t] + discount * total, 0.0)
        sums[:, t] = total
    return sums


def _returning(shaped: ShapedTask, rollouts: RandomRollouts, f: FloatArray) -> tuple[float, str]:
    """Return how far the Phi differ that loops through a state, or paths to an end, require."""
    # F adds up to (gamma^n - 1) Phi(s) over a loop of n steps, to -Phi(s) over a path to an end.
    gamma = shaped.task_discount
    sums = np.pad(discounted_sums(f, rollouts.taken, gamma), ((0, 0), (0, 1)))
    last = np.arange(rollouts.states.shape[1]) == rollouts.length[:, None]
    truncated = last & ~rollouts.terminated[:, None]  # whose last states count too
    rollout, time = np.nonzero(np.pad(rollouts.taken, ((0, 0), (0, 1))) | truncated)
    state = rollouts.states[rollout, time]
    order = np.lexsort((time, state, rollout))
    rollout, time, state = rollout[order], time[order], state[order]
    again = np.flatnonzero((rollout[1:] == rollout[:-1]) & (state[1:] == state[:-1]))
    weight = gamma ** (time[again + 1] - time[again])
    loops = sums[rollout[again], time[again]] - weight * sums[rollout[again + 1], time[again + 1]]
    ended = rollouts.terminated[rollout]
    total = np.concatenate([loops, sums[rollout[ended], time[ended]]])
    factor = np.concatenate([weight - 1.0, np.full(ended.sum(), -1.0)])
    where = np.concatenate([state[again], state[ended]])
    if not where.size:
        return 0.0, ""
    # total = factor Phi(s). The path with the largest factor gives Phi; the others must agree.
    order = np.lexsort((-abs(factor), where))
    first = np.flatnonzero(np.diff(where[order], prepend=-1))
    lead = np.repeat(order[first], np.diff(first, append=len(order)))
    apart = abs(total[order] * factor[lead] - total[lead] * factor[order])
    apart = np.where(factor[lead] == 0, abs(total[order]), apart)
    worst = int(apart.argmax())
    path, other = order[worst], lead[worst]
    place = state_name(shaped.task.states, int(where[path]))
    if factor[path] == 0:
        reason = f"F adds up to {total[path]:.4g} over a loop through {place}, not to 0"
    else:
        reason = (
            f"one path from {place} requires Phi = {total[path] / factor[path]:.4g}, another "
            f"{total[other] / factor[other]:.4g}"
        )
    return float(apart[worst]), f"not potential-based: {reason}"
