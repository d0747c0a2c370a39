"""How well a mapping fits: whether the source's model and values predict the target.

Unmapped pairs are worth 0 by default. Where steps cost, 0 is too high: a learner leaves the mapped
part to try the unmapped one. A constant that fits does not lead away from it. It minimises a
weighted square of the Bellman residuals (Schweitzer, Seidmann 1985; Baird 1995) of states, not of
pairs: the cost of one bad action does not say what a state is worth.
"""

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.display import printed
from curricle.planning.solution import evaluate, greedy_policy
from curricle.tasks.mdp import FiniteMDP, steps_to
from curricle.text import brief_repr
from curricle.transfer.bisimulation import model_for_refinement, refined
from curricle.transfer.mapping import ENDED, UNMAPPED, StateActionMapping, terminal_states
from curricle.transfer.pair import TaskPair

NAN = float("nan")
TIED = 1e-9  # values this close, in units of the largest, are tied for a greedy policy
_BLOCKS = WeakKeyDictionary[TaskPair, IntArray]()  # of source states: those that behave alike
LARGEST_SAMPLE = 20_000  # pairs on which next states are compared at most; a sample of more


@dataclass(frozen=True)
class MappingScores:
    """How a mapping fits its tasks; phi are the source's exact values Q* read through it."""

    # Means are over pairs (s, a) of the target in states that can be reached and do not end it.

    # Mean total variation distance, in [0, 1], between the next states that the source predicts
    # and those of the target, over the mapped pairs; NaN if nothing maps. A target state stands for
    # the source state that its best pair reads; source states that behave alike count as one.
    dynamics_error: float
    # Mean of abs(r + gamma sum_s' P(s') max_a' phi(s', a') - phi(s, a)), in return units, over the
    # pairs that have a phi and whose next states all have one. 0 if phi is Q* there.
    bellman_inconsistency: float
    # The same, divided by what is left if a constant takes the place of phi(s, a): the median of
    # r + gamma sum_s' P(s') max_a' phi(s', a'). 0 if phi is Q*; from 1 on phi says no more of pairs
    # than a constant; NaN where nothing varies.
    unexplained: float
    coverage: float  # of pairs with a phi: mapped, at the source's end, or by an unmapped value
    optimistic: float  # share of these with phi > Q*
    start_value: float  # of the policy that is greedy on phi, 0 where unmapped, at the start
    # (V^phi - V^without) / (V* - V^without), each summed over the states: the share of the way that
    # this policy goes from what needs no source, the better of the random policy and of the myopic
    # one, which looks at the next reward alone. V^phi is V^without where nothing is known. At most
    # 1; negative if phi misleads; NaN if there is no way to go.
    regained: float
    regained_where_known: float  # the same over the states of which something is known

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def worth(self) -> float:
        """`regained`, times the share explained if that is a gain; NaN where unknown."""
        return self.regained * (max(0.0, 1 - self.unexplained) if self.regained > 0 else 1.0)

    def __str__(self) -> str:
        return (
            f"regains {self.regained:.0%} ({self.regained_where_known:.0%} where known), dynamics "
            f"error {self.dynamics_error:.3f}, Bellman inconsistency "
            f"{self.bellman_inconsistency:.3g} ({self.unexplained:.0%} unexplained), coverage "
            f"{self.coverage:.0%}, optimistic {self.optimistic:.0%}, start value "
            f"{self.start_value:.4g}"
        )


def score_mapping(
    mapping: StateActionMapping, *, seed: int = 0, tasks: TaskPair | None = None
) -> MappingScores:
    """Return how a mapping fits its tasks, from their tables.

    Next states are compared on at most 20,000 pairs, a sample drawn with `seed`. `tasks` are the
    mapping's, where they have been solved already.

    Examples
    --------
    >>> from curricle import Pursuit, project
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> scores = score_mapping(project(hunt, chase, predator="predator_1"))
    >>> scores.dynamics_error < 1e-9, round(scores.bellman_inconsistency, 3), scores.coverage
    (True, 0.259, 1.0)
    """
    tasks = TaskPair(mapping.target, mapping.source) if tasks is None else tasks
    phi = mapping.read(tasks.source_solution.action_values)
    inconsistency, unexplained = _bellman_inconsistency(phi, tasks)
    start_value, regained, regained_where_known = _greedy_values(phi, tasks)
    known = ~np.isnan(phi[tasks.judged])
    excess = phi[tasks.judged] - tasks.target_solution.action_values[tasks.judged]
    error = tasks.target_solution.error_bound + tasks.source_solution.error_bound
    return MappingScores(
        dynamics_error=_dynamics_error(mapping, phi, tasks, seed),
        bellman_inconsistency=inconsistency,
        unexplained=unexplained,
        coverage=float(known.mean()),
        optimistic=float((excess[known] > error).mean()) if known.any() else NAN,
        start_value=start_value,
        regained=regained,
        regained_where_known=regained_where_known,
    )


def _bellman_inconsistency(phi: FloatArray, tasks: TaskPair) -> tuple[float, float]:
    """Return the mean of abs(T phi - phi), and its share of that of abs(T phi - its median)."""
    mdp = tasks.target_mdp
    best = np.where(np.isnan(phi), -np.inf, phi).max(axis=1)
    best[np.isneginf(best)] = np.nan
    best[mdp.terminal] = 0.0
    after = np.where(mdp.probability > 0, mdp.probability * best[mdp.next_state], 0.0)
    expected = (mdp.probability * mdp.reward).sum(axis=1) + mdp.discount * after.sum(axis=1)
    expected, stated = expected[mdp.outcome_row][tasks.judged], phi[tasks.judged]
    known = ~np.isnan(expected - stated)
    if not known.any():
        return NAN, NAN
    expected, stated = expected[known], stated[known]
    inconsistency = float(abs(expected - stated).mean())
    by_constant = float(abs(expected - np.median(expected)).mean())
    return inconsistency, inconsistency / by_constant if by_constant > 0 else NAN


def _greedy_values(phi: FloatArray, tasks: TaskPair) -> tuple[float, float, float]:
    """Return the start value of phi's greedy policy, the share it regains, and that where known."""
    filled = np.where(np.isnan(phi), 0.0, phi)
    policy = greedy_policy(filled, tolerance=TIED * float(abs(filled).max()))
    of_policy = evaluate(tasks.target_mdp, policy)
    known = ~np.isnan(phi).all(axis=1) & tasks.judged
    best = tasks.target_solution.values
    most, gained = (values - tasks.values_without for values in (best, of_policy.values))

    def share(states: BoolArray) -> float:
        whole = float(most[states].sum())
        nothing = whole <= TIED * max(1.0, float(abs(best[states]).sum()))
        return NAN if nothing else float(gained[known].sum()) / whole

    return of_policy.start_value, share(tasks.judged), share(known)


def _dynamics_error(
    mapping: StateActionMapping, phi: FloatArray, tasks: TaskPair, seed: int
) -> float:
    """Return the mean total variation distance between predicted and true next states."""
    mdp, source = tasks.target_mdp, tasks.source_mdp
    mapped = np.argwhere((mapping.index >= 0) & tasks.judged[:, None])
    if len(mapped) > LARGEST_SAMPLE:
        rng = np.random.default_rng(seed)
        mapped = mapped[rng.choice(len(mapped), LARGEST_SAMPLE, replace=False)]
    if not len(mapped):
        return NAN
    s, a = mapped.T
    # Blocks of the source; 0 is its end (where the target's is too), -1 has no counterpart.
    if tasks not in _BLOCKS:
        _BLOCKS[tasks] = refined([model_for_refinement(source)])[0].states
    block = np.where(terminal_states(source), 0, 1 + _BLOCKS[tasks])
    known = np.where((mapping.index == UNMAPPED) | np.isnan(phi), -np.inf, phi)
    pair = np.take_along_axis(mapping.index, known.argmax(axis=1)[:, None], axis=1)[:, 0]
    stands_for = np.where(pair >= 0, pair // mapping.source.actions.size, pair)  # (S,)
    after = np.where(stands_for >= 0, block[np.maximum(stands_for, 0)], -1)
    after[mdp.terminal | (stands_for == ENDED)] = 0
    row, source_row = mdp.outcome_row[s, a], source.outcome_row.ravel()[mapping.index[s, a]]
    return total_variation((mdp, row, after), (source, source_row, block))


def total_variation(*rows_of: tuple[FiniteMDP, npt.NDArray[Any], npt.NDArray[Any]]) -> float:
    """Return the mean total variation distance of the next states of n rows of two tasks.

    Next states that count as the same have the same number in the last array of both, (S,).
    """
    outcomes = [numbers[mdp.next_state[row]] for mdp, row, numbers in rows_of]
    (p, q), joined = (mdp.probability[row] for mdp, row, _ in rows_of), np.hstack(outcomes)
    masses = np.concatenate([p, -q], axis=1)
    # Equal outcomes add up before their difference counts, once.
    same: BoolArray = joined[:, :, None] == joined[:, None, :]
    totals = (same * masses[:, None, :]).sum(axis=2)
    return float(((abs(totals) / same.sum(axis=2)).sum(axis=1) / 2).mean())


# -- the value of unmapped pairs -------------------------------------------------------------------

EXPECTILE = 0.03
"""Expectile of the residuals that is 0; 0.5 is least squares. Values too low do less harm."""
SWEEPS = 100  # greedy policies that are fitted to at most
SETTLED = 1e-9  # two constants are one if they differ by less, in units of the larger


def fitted_constant(stated: FloatArray, factor: FloatArray) -> float:
    """Return the constant at which the expectile of ``stated - factor * constant``, (n,), is 0."""
    constant = 0.0
    for _ in range(SWEEPS):
        weight = np.where(stated > factor * constant, EXPECTILE, 1 - EXPECTILE)
        curvature = float((weight * factor**2).sum())
        if curvature == 0:
            return 0.0
        last, constant = constant, float((weight * factor * stated).sum()) / curvature
        if abs(constant - last) <= SETTLED * max(abs(constant), abs(last)):
            break
    return constant


def fitted_unmapped_value(
    mapping: StateActionMapping,
    *,
    scale: float = 1.0,
    shift: float = 0.0,
    tasks: TaskPair | None = None,
) -> float | None:
    """Return the value of unmapped pairs that fits the mapped ones best, or None.

    It is the constant u at which the expectile of max_a (T phi)(s, a) - max_a phi(s, a), over the
    target's reachable states, is 0. T is the target's Bellman operator, phi the source's exact
    values where the mapping has any and u elsewhere. It is at least the value of the worst reward
    for ever. It is None where all is mapped, where u would not be below 0, and where some state has
    no way to a mapped state.

    `scale` and `shift` are the transfer's; `tasks` as in :func:`score_mapping`.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards, same_position
    >>> costs = Rewards(step=-1, treasure=0)
    >>> line = GridWorld("S....T", rewards=costs)
    >>> end = same_position(line, line.crop(rows=(0, 1), columns=(3, 6)))
    >>> round(fitted_unmapped_value(end), 1)  # V* are -5, -4, -3 there, and -2 where it is mapped
    -3.6
    """
    tasks = TaskPair(mapping.target, mapping.source) if tasks is None else tasks
    phi = mapping.read(tasks.source_solution.action_values, scale, shift)
    unmapped = (mapping.index == UNMAPPED) & np.isnan(phi)
    away = steps_to(tasks.target_mdp, ~unmapped.all(axis=1), tasks.judged)[tasks.judged]
    if not unmapped[tasks.judged].any() or np.isinf(away).any():
        return None
    rewards = (tasks.target_mdp.probability * tasks.target_mdp.reward).sum(axis=1)
    lowest = min(0.0, float(rewards.min())) / (1 - tasks.target_mdp.discount)
    constant = 0.0
    for _ in range(SWEEPS):
        last = constant
        constant = fitted_constant(*_residuals(phi, unmapped, constant, rewards, tasks))
        constant = min(0.0, max(lowest, constant))
        if abs(constant - last) <= SETTLED * max(abs(constant), abs(last)):
            break
    return constant if constant < 0 else None


def _residuals(
    phi: FloatArray, unmapped: BoolArray, constant: float, rewards: FloatArray, tasks: TaskPair
) -> tuple[FloatArray, FloatArray]:
    """Return the residuals for what is greedy at this constant, before and after a step."""
    mdp, states = tasks.target_mdp, np.arange(len(phi))
    action = np.where(unmapped, constant, phi).argmax(axis=1)
    at_constant = unmapped[states, action] & ~mdp.terminal
    best = np.where(mdp.terminal | at_constant, 0.0, phi[states, action])
    after = rewards + mdp.discount * (mdp.probability * best[mdp.next_state]).sum(axis=1)
    share = mdp.discount * (mdp.probability * at_constant[mdp.next_state]).sum(axis=1)
    greedy = (after + constant * share)[mdp.outcome_row].argmax(axis=1)
    row, kept = mdp.outcome_row[states, greedy], tasks.judged
    return (after[row] - best)[kept], (at_constant - share[row])[kept]
