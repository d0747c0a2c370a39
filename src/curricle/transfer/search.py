"""Searches for mappings between two tasks; scores and ranks of the mappings; the best mapping.

Unmapped pairs have the value 0 by default. If steps cost, 0 is too high: a learner leaves the
mapped states to try the unmapped ones. A fitted constant avoids this. It minimises a weighted
square of the Bellman residuals (Schweitzer, Seidmann 1985; Baird 1995) of states instead of pairs,
because the cost of one bad action does not determine the value of a state.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, cast, overload
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import brief, whole_number
from curricle.errors import CurriculumError, MappingError, SettingError
from curricle.planning.solution import evaluate, greedy_policy
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.tasks.graph import steps_to
from curricle.tasks.mdp import FiniteMDP, Task, closed, has_tables, same_task
from curricle.tasks.observation_task import ObservationTask
from curricle.text import brief_repr, counted, printed, shortened
from curricle.transfer.bisimulation import by_homomorphism, model_for_refinement, refined
from curricle.transfer.by_components import by_alignment, by_name
from curricle.transfer.mapping import (
    ENDED,
    UNMAPPED,
    ObservationMapping,
    PairMapping,
    check_unmapped_value,
    terminal_states,
)
from curricle.transfer.pair import NOT_PROVEN, Proposal, TaskPair
from curricle.transfer.transfer import Transfer

NAN = float("nan")
TIED = 1e-9  # largest difference of ties for a greedy policy, in units of the largest value
_BLOCKS = WeakKeyDictionary[TaskPair, IntArray]()  # blocks of equivalent source states
LARGEST_SAMPLE = 20_000  # most pairs on which next states are compared; a sample if more


@dataclass(frozen=True)
class MappingScores:
    """Scores of a mapping; phi are the source's exact values Q* read through the mapping."""

    # Means are over the pairs (s, a) of the target's reachable nonterminal states.

    # Mean total variation distance, in [0, 1], between the next states that the source predicts
    # and the target's next states, over mapped pairs; NaN if none is mapped. A target state stands
    # for the source state that its best pair reads; equivalent source states count as one state.
    dynamics_error: float
    # Mean of abs(r + gamma sum_s' P(s') max_a' phi(s', a') - phi(s, a)), in return units, over the
    # pairs that have a phi and whose next states all have a phi. 0 if phi is Q* there.
    bellman_inconsistency: float
    # `bellman_inconsistency`, divided by its value if a constant replaces phi(s, a): the median of
    # r + gamma sum_s' P(s') max_a' phi(s', a'). 0 if phi is Q*; from 1 on phi tells no more about
    # pairs than a constant; NaN if these numbers do not vary.
    unexplained: float
    coverage: float  # share of pairs with a phi: mapped, ended, or with an unmapped value
    optimistic: float  # share of these with phi > Q*
    start_value: float  # value, at the start, of the policy greedy on phi (0 where unmapped)
    # (V^phi - V^without) / (V* - V^without), all summed over the states: the share of the way to
    # the optimum that this policy goes. The way starts at the better of the random policy and the
    # myopic policy, which sees only the next reward. V^phi is V^without in states without a phi.
    # At most 1; negative if phi misleads; NaN if V^without is optimal.
    regained: float
    regained_where_known: float  # the same over the states with a phi

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def worth(self) -> float:
        """`regained`, times the explained share if `regained` is positive; NaN if unknown."""
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
    mapping: PairMapping, *, seed: int = 0, tasks: TaskPair | None = None
) -> MappingScores:
    """Return the scores of a mapping, from the tables of its tasks.

    Next states are compared on at most 20,000 pairs, a sample drawn with `seed`. `tasks` are the
    mapping's tasks, if they have been solved before.

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
    has_phi = ~np.isnan(phi[tasks.pairs])
    excess = phi[tasks.pairs] - tasks.target_solution.finite_action_values[tasks.pairs]
    error = tasks.target_solution.error_bound + tasks.source_solution.error_bound
    return MappingScores(
        dynamics_error=_dynamics_error(mapping, phi, tasks, seed),
        bellman_inconsistency=inconsistency,
        unexplained=unexplained,
        coverage=float(has_phi.mean()),
        optimistic=float((excess[has_phi] > error).mean()) if has_phi.any() else NAN,
        start_value=start_value,
        regained=regained,
        regained_where_known=regained_where_known,
    )


def _bellman_inconsistency(phi: FloatArray, tasks: TaskPair) -> tuple[float, float]:
    """Return the mean of abs(T phi - phi), also as a share of the mean of abs(T phi - median)."""
    mdp = tasks.target_mdp
    best = np.where(np.isnan(phi), -np.inf, phi).max(axis=1)
    best[np.isneginf(best)] = np.nan
    best[mdp.terminal] = 0.0
    after = np.where(mdp.probability > 0, mdp.probability * best[mdp.next_state], 0.0)
    expected = (mdp.probability * mdp.reward).sum(axis=1) + mdp.discount * after.sum(axis=1)
    expected, stated = expected[mdp.outcome_row][tasks.pairs], phi[tasks.pairs]
    has_phi = ~np.isnan(expected - stated)
    if not has_phi.any():
        return NAN, NAN
    expected, stated = expected[has_phi], stated[has_phi]
    inconsistency = float(abs(expected - stated).mean())
    by_constant = float(abs(expected - np.median(expected)).mean())
    return inconsistency, inconsistency / by_constant if by_constant > 0 else NAN


def _greedy_values(phi: FloatArray, tasks: TaskPair) -> tuple[float, float, float]:
    """Return the start value of phi's greedy policy, its regained share, in all and with phi."""
    filled = np.where(np.isnan(phi), 0.0, phi)
    tolerance = TIED * float(abs(filled[tasks.judged]).max(initial=0.0))
    policy = greedy_policy(closed(filled, tasks.target_mdp.available), tolerance=tolerance)
    of_policy = evaluate(tasks.target_mdp, policy)
    with_phi = ~np.isnan(phi).all(axis=1) & tasks.judged
    best = tasks.target_solution.values
    most, gained = (values - tasks.values_without for values in (best, of_policy.values))

    def share(states: BoolArray) -> float:
        whole = float(most[states].sum())
        nothing = whole <= TIED * float(abs(best[states]).sum())
        return NAN if nothing else float(gained[with_phi].sum()) / whole

    return of_policy.start_value, share(tasks.judged), share(with_phi)


def _dynamics_error(mapping: PairMapping, phi: FloatArray, tasks: TaskPair, seed: int) -> float:
    """Return the mean total variation distance between predicted and true next states."""
    mdp, source = tasks.target_mdp, tasks.source_mdp
    mapped = np.argwhere((mapping.index >= 0) & tasks.pairs)
    if len(mapped) > LARGEST_SAMPLE:
        rng = np.random.default_rng(seed)
        mapped = mapped[rng.choice(len(mapped), LARGEST_SAMPLE, replace=False)]
    if not len(mapped):
        return NAN
    s, a = mapped.T
    # Blocks of the source; 0 is its end, for which the target's end stands, -1 no counterpart.
    if tasks not in _BLOCKS:
        _BLOCKS[tasks] = refined([model_for_refinement(source)])[0].states
    block = np.where(terminal_states(source), 0, 1 + _BLOCKS[tasks])
    read = np.where((mapping.index == UNMAPPED) | np.isnan(phi), -np.inf, phi)
    pair = np.take_along_axis(mapping.index, read.argmax(axis=1)[:, None], axis=1)[:, 0]
    stands_for = np.where(pair >= 0, pair // mapping.source.actions.size, pair)  # (S,)
    after = np.where(stands_for >= 0, block[np.maximum(stands_for, 0)], -1)
    after[mdp.terminal | (stands_for == ENDED)] = 0
    row, source_row = mdp.outcome_row[s, a], source.outcome_row.ravel()[mapping.index[s, a]]
    return total_variation((mdp, row, after), (source, source_row, block))


def total_variation(*rows_of: tuple[FiniteMDP, npt.NDArray[Any], npt.NDArray[Any]]) -> float:
    """Return the mean total variation distance of the next states of n rows of two tasks.

    The last arrays, (S,), number states; next states with equal numbers count as equal.
    """
    outcomes = [numbers[mdp.next_state[row]] for mdp, row, numbers in rows_of]
    (p, q), joined = (mdp.probability[row] for mdp, row, _ in rows_of), np.hstack(outcomes)
    masses = np.concatenate([p, -q], axis=1)
    # Chances of equal outcomes are summed before the difference is taken.
    same: BoolArray = joined[:, :, None] == joined[:, None, :]
    totals = (same * masses[:, None, :]).sum(axis=2)
    return float(((abs(totals) / same.sum(axis=2)).sum(axis=1) / 2).mean())


# -- the value of unmapped pairs -------------------------------------------------------------------

EXPECTILE = 0.03
"""Expectile of the residuals that is 0; 0.5 is least squares. Too low values do less harm."""
SWEEPS = 100  # most rounds of fitting the constant to the greedy policy
SETTLED = 1e-9  # largest difference of equal constants, in units of the larger


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
    mapping: PairMapping,
    *,
    scale: float = 1.0,
    shift: float = 0.0,
    tasks: TaskPair | None = None,
) -> float | None:
    """Return the value of unmapped pairs that fits the mapped pairs best, or None.

    It is the constant u at which the expectile of max_a (T phi)(s, a) - max_a phi(s, a), over the
    target's reachable states, is 0. T is the target's Bellman operator, phi the source's exact
    values at mapped pairs and u elsewhere. u is at least the value of receiving the worst reward
    for ever. The result is None if all pairs are mapped, if u would not be below 0, or if a state
    has no path to a mapped state.

    `scale` and `shift` are the transfer's; `tasks` is as in :func:`score_mapping`.

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
    """Return (n,) terms of the residuals: without the constant, and its factor."""
    mdp, states = tasks.target_mdp, np.arange(len(phi))
    action = np.where(unmapped, constant, phi).argmax(axis=1)
    at_constant = unmapped[states, action] & ~mdp.terminal
    best = np.where(mdp.terminal | at_constant, 0.0, phi[states, action])
    after = rewards + mdp.discount * (mdp.probability * best[mdp.next_state]).sum(axis=1)
    share = mdp.discount * (mdp.probability * at_constant[mdp.next_state]).sum(axis=1)
    greedy = (after + constant * share)[mdp.outcome_row].argmax(axis=1)
    row, kept = mdp.outcome_row[states, greedy], tasks.judged
    return (after[row] - best)[kept], (at_constant - share[row])[kept]


# -- the mappings found by searches ----------------------------------------------------------------

Search = Callable[[TaskPair], Iterable[Proposal]]
"""A search for mappings; it raises MappingError where it does not apply."""

SEARCHES: tuple[Search, ...] = (by_name, by_alignment, by_homomorphism)
LEAST_REGAINED = 0.25
"""Share of the way to the optimum that a mapping must regain in mapped states to be used unseen."""
MOST_UNEXPLAINED = 0.75  # largest `unexplained` of a mapping to be used unseen
MOST_APART = 0.4
"""Dynamics error that such a mapping may have. Of the limits tried it sets the sensible pairs of
the development families furthest apart from unrelated ones (benchmarks/unrelated_pairs.py)."""
MOST_MISSED = 0.05
"""Share of the way to the optimum that a nearly exact mapping may miss in mapped states."""
LEFT_BY_EXACT = 0.01
"""Largest `unexplained` of a nearly exact mapping: flat values of many pairs are explained well."""
SAME = 1e-7  # largest difference of phi of equal mappings, in units of the largest


@dataclass(frozen=True, eq=False)
class FoundMapping:
    """A mapping that a search found, with its scores."""

    mapping: PairMapping
    how: str
    scores: MappingScores
    # A proven bound, in return units, on the difference between the Q* of a mapped pair, reachable
    # or not, and the Q* of the source pair that it reads, or 0 at the source's end; each task with
    # its own discount. NaN if nothing is mapped, or a task has no finite Q*.
    bound: float = NOT_PROVEN
    # The value that fits unmapped pairs, which a curriculum sets if it finds the mapping.
    unmapped_value: float | None = None

    __repr__ = brief_repr
    _repr_html_ = printed

    def __str__(self) -> str:
        proven = "" if np.isnan(self.bound) else f", Q* proven within {self.bound:.3g}"
        fits = "" if self.unmapped_value is None else f", {self.unmapped_value:.3g} fits elsewhere"
        return f"{self.how}: {self.scores}{proven}{fits}"


@dataclass(frozen=True, eq=False, repr=False)
class FoundMappings:
    """The mappings that were found, best first, and why the other searches found none."""

    candidates: tuple[FoundMapping, ...]
    refused: dict[str, str]  # search that found nothing -> reason

    _repr_html_ = printed

    @overload
    def __getitem__(self, place: int) -> FoundMapping: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[FoundMapping, ...]: ...
    def __getitem__(self, place: int | slice) -> FoundMapping | tuple[FoundMapping, ...]:
        return self.candidates[place]

    def __iter__(self) -> Iterator[FoundMapping]:
        return iter(self.candidates)

    def __len__(self) -> int:
        return len(self.candidates)

    def __str__(self) -> str:
        lines = [f"{i + 1}. {mapping}" for i, mapping in enumerate(self.candidates)]
        return "\n".join([*lines, *(f"{name}: {why}" for name, why in self.refused.items())])

    def __repr__(self) -> str:
        best = self.candidates[0].how if self.candidates else "none"
        return shortened(f"FoundMappings({counted(len(self), 'mapping')}, the best: {best})")


def find_mappings(
    target: Task,
    source: Task,
    *,
    searches: Sequence[Search] = SEARCHES,
    keep: int = 8,
    seed: int = 0,
    unmapped_value: float | None = None,
    progress: Progress = None,
) -> FoundMappings:
    """Return mappings between two tasks, best first.

    Candidates of all searches are scored by :func:`score_mapping` from the tables of both tasks.
    The order: candidates that clear the bar of :func:`auto_mapping`; candidates that are nearly
    exact in mapped states and have a value that fits elsewhere; larger ``scores.worth`` (the share
    of the way to the optimum that the source's greedy policy regains, times the share that its
    values explain); smaller dynamics error; smaller Bellman inconsistency. Of candidates with
    equal phi only the first is kept.

    Parameters
    ----------
    target, source : Task
    searches : sequence of callable
        A search takes a :class:`TaskPair` and yields a :class:`Proposal` for each mapping.
    keep : int
        Most candidates to return.
    seed : int
        Seed of the samples of pairs.
    unmapped_value : float, optional
        phi of unmapped pairs, in all mappings.
    progress : bool or callable, optional
        True shows a bar of the searches; a function is called with the name of each ended search.

    Raises
    ------
    SettingError
        When a number is out of range, or a search yields no :class:`Proposal` for these tasks.
    TaskError
        When a task has no tables.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> find_mappings(GridWorld("S....T"), GridWorld("S.T"))[0].how
    'components by name, last column aligned, clipped'
    """
    keep = whole_number("keep", keep, 1, SettingError)
    whole_number("seed", seed, 0, SettingError)
    check_unmapped_value(unmapped_value)
    if not isinstance(searches, Sequence) or not all(map(callable, searches)):
        raise SettingError(f"searches must be a list of functions: got {brief(searches)}")
    if not searches:
        raise SettingError("find_mappings needs at least one search: got none")
    check_progress(progress)
    tasks = TaskPair(target, source)
    q, refused = tasks.source_solution.action_values, dict[str, str]()
    slack = SAME * float(abs(tasks.source_solution.finite_action_values).max())
    read, candidates = list[FloatArray](), list[FoundMapping]()
    with shown(progress) as bars:
        for mapping, how in proposed(tasks, searches, unmapped_value, refused, bars):
            phi = mapping.read(q)
            if any(np.allclose(phi, other, rtol=0, atol=slack, equal_nan=True) for other in read):
                continue
            read.append(phi)
            scores = score_mapping(mapping, seed=seed, tasks=tasks)
            fits = fitted_unmapped_value(mapping, tasks=tasks)
            candidates.append(FoundMapping(mapping, how, scores, tasks.bound(mapping.index), fits))
    return FoundMappings(tuple(sorted(candidates, key=rank)[:keep]), refused)


def proposed(
    tasks: TaskPair,
    searches: Sequence[Search],
    unmapped_value: float | None,
    refused: dict[str, str],
    bars: Bars,
) -> Iterator[tuple[PairMapping, str]]:
    """Yield the mappings of searches; write into `refused` why a search does not apply."""
    grow = bars.bar("searches", len(searches))
    for search in searches:
        name = getattr(search, "__name__", repr(search))
        try:
            proposals = search(tasks)
            if not isinstance(proposals, Iterable):
                raise SettingError(f"a search must yield Proposals: {name} returned {proposals!r}")
            for proposal in proposals:
                if not isinstance(proposal, Proposal):
                    raise SettingError(
                        f"a search must yield a Proposal: {name} yielded {brief(proposal)}"
                    )
                mapping = proposal.mapping
                for role in ("target", "source"):
                    task = getattr(mapping, role)
                    if not same_task(task, getattr(tasks, role)):
                        raise SettingError(
                            "a search must propose mappings of the tasks that it is given: "
                            f"{name} proposed the {role} {brief(task)}"
                        )
                if unmapped_value is not None:
                    mapping = mapping.with_unmapped_value(unmapped_value)
                # All searches count: the target's values decide which mapping is first.
                yield mapping.knowing_target(), proposal.how
        except MappingError as error:
            refused[name] = str(error)
        grow()
        bars.tell(name)


def clears_bar(scores: MappingScores) -> bool:
    """Return whether a mapping fits well enough to be used unseen."""
    # No single score suffices. Tasks may be alike nearly everywhere and have goals in different
    # places. A policy on wrong values may gain by avoiding the worst states. A search that reads
    # the target's values finds similar values in any source, with unlike dynamics.
    return (
        scores.regained_where_known >= LEAST_REGAINED
        and scores.unexplained <= MOST_UNEXPLAINED
        and scores.dynamics_error <= MOST_APART
    )


def rank(candidate: FoundMapping) -> tuple[bool, bool, float, float, float]:
    """Return the sort key of a candidate, lowest for the best."""
    # Second criterion: nearly exact in mapped states, with a value that fits elsewhere. If steps
    # cost, values of tried pairs fall below that value, and a learner tries other pairs. Without
    # such a value a learner walks at random until it meets a mapped state: then a rough mapping of
    # many states is better than an exact mapping of few.
    scores = candidate.scores
    right = scores.regained_where_known >= 1 - MOST_MISSED and scores.unexplained <= LEFT_BY_EXACT
    exact = right and (candidate.unmapped_value is not None or scores.coverage == 1)
    measures = -scores.worth, scores.dynamics_error, scores.bellman_inconsistency
    worth, dynamics, bellman = (
        float(round(score, 9)) for score in np.nan_to_num(measures, nan=np.inf)
    )
    return not clears_bar(scores), not exact, worth, dynamics, bellman


# -- the best mapping, or the reason why no mapping is used ----------------------------------------

COMPARED = 5_000  # states of tasks up to which their mapping is compared with those found
FAR = 0.25  # share of the way to the optimum by which a mapping regains far less than another
REMEMBERED = 16  # results of searches to keep in memory; a search may take half a minute


def auto_mapping(
    target: Task,
    source: Task,
    *,
    unmapped_value: float | None = None,
    fit_unmapped: bool = True,
    scale: float = 1.0,
    shift: float = 0.0,
    progress: Progress = None,
) -> FoundMapping:
    """Return the best mapping of :func:`find_mappings`, if its scores suffice for use unseen.

    In mapped states its greedy policy must regain at least 25 % of the way to the optimum, its
    values may leave at most 75 % of the variation unexplained that a constant leaves unexplained,
    and its dynamics error may be at most 0.4 (:func:`score_mapping`). To use another mapping, pass
    that of a candidate of :func:`find_mappings` to the transfer. The scores do not use the value
    that fits unmapped pairs.

    Parameters
    ----------
    target, source : Task
    unmapped_value : float, optional
        phi of unmapped pairs.
    fit_unmapped : bool
        Whether unmapped pairs get their :func:`fitted_unmapped_value` if `unmapped_value` is None.
        With False an aggregate of several transfers skips unmapped pairs.
    scale, shift : float
        Scale and shift of the transfer, for that fit.
    progress : bool or callable, optional
        As in :func:`find_mappings`; earlier results for the same tasks are taken from memory.

    Raises
    ------
    MappingError
        When no mapping clears this bar.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> auto_mapping(GridWorld("S..T"), GridWorld("T..S")).how
    'exact homomorphism: 100% of pairs have a source pair of the same Q*'
    """
    check_progress(progress)
    candidates = _remembered(target, source, unmapped_value, progress)
    bar = (
        f"a mapping is used unseen if it regains at least {LEAST_REGAINED:.0%} where it is known, "
        f"leaves at most {MOST_UNEXPLAINED:.0%} unexplained and has a dynamics error of at most "
        f"{MOST_APART:g}"
    )
    if not len(candidates):
        raise MappingError(f"{bar}: none is found between these tasks")
    best = candidates[0]
    if not clears_bar(best.scores):
        raise MappingError(
            f"{bar}: the best that is found, {best.how}, regains "
            f"{best.scores.regained_where_known:.0%}, leaves {best.scores.unexplained:.0%} "
            f"unexplained and has an error of {best.scores.dynamics_error:.3g}; to accept it, pass "
            "find_mappings(target, source)[0].mapping to the transfer"
        )
    if not fit_unmapped or unmapped_value is not None:
        return best
    fits = best.unmapped_value
    if (scale, shift) != (1.0, 0.0):
        fits = fitted_unmapped_value(best.mapping, scale=scale, shift=shift)
    if fits is None:
        return best
    how = f"{best.how}, {fits:.3g} where unmapped"
    mapping = best.mapping.with_unmapped_value(fits)
    return replace(best, mapping=mapping, how=how, unmapped_value=None)


def mapping_fault(transfer: Transfer) -> str:
    """Return a sentence on a mapping that scores far below the best that is found; else empty."""
    mapping = transfer.mapping
    if not isinstance(mapping, PairMapping) or mapping.knows_target:
        return ""
    tasks = mapping.target, mapping.source
    if not all(has_tables(task) and task.states.size <= COMPARED for task in tasks):
        return ""
    candidates, regained = _remembered(*tasks, None), score_mapping(mapping).regained
    if not len(candidates) or not candidates[0].scores.regained - regained > FAR:
        return ""
    best = candidates[0]
    way_out = clears_bar(best.scores) * '; mapping = "auto" uses it'
    return (
        f"the mapping of {transfer.source} -> {transfer.target} is at fault: it regains "
        f"{round(100 * regained)} % of the way to the optimum, and the best that is found "
        f"{round(100 * best.scores.regained)} %, {best.how}{way_out}"
    )


def with_mapping(
    transfer: Transfer,
    target: Task | ObservationTask,
    source: Task | ObservationTask,
    *,
    fit_unmapped: bool = True,
) -> Transfer:
    """Return a transfer with its mapping, or else with a found mapping, which is printed."""
    if transfer.mapping is not None:
        return transfer
    edge = f"{transfer.source} -> {transfer.target}"
    if isinstance(target, ObservationTask) and isinstance(source, ObservationTask):
        if target.observations != source.observations:
            raise CurriculumError(
                f"a transfer between different observations needs a mapping: {edge} has none, and "
                f"the target has {target.observations}, the source {source.observations}"
            )
        return replace(transfer, mapping=ObservationMapping(target, source))
    try:
        tasks = cast(Task, target), cast(Task, source)  # or else `announced` says what they lack
        best = announced(transfer, *tasks, fit_unmapped=fit_unmapped)
    except MappingError as error:
        raise CurriculumError(f"no mapping for {edge}: {error}") from error
    return replace(transfer, mapping=best.mapping)


def announced(
    transfer: Transfer,
    target: Task,
    source: Task,
    unmapped_value: float | None = None,
    *,
    fit_unmapped: bool = True,
    say: Callable[[str], object] = print,
) -> FoundMapping:
    """Return the mapping found for a transfer; print it and the runner-up."""
    for role, task in (("target", target), ("source", source)):
        if not has_tables(task):
            raise MappingError(
                f"a mapping is found between tasks with tables: the {role} has none; find it "
                "between smaller members of their family and carry it over by name"
            )
    best = auto_mapping(
        target,
        source,
        unmapped_value=unmapped_value,
        fit_unmapped=fit_unmapped,
        scale=transfer.scale,
        shift=transfer.shift,
    )
    candidates = _remembered(target, source, unmapped_value)
    say(f"mapping found for {transfer.source} -> {transfer.target}: {best}")
    say(f"  runner-up: {candidates[1] if len(candidates) > 1 else 'none'}")
    return best


def _remembered(
    target: Task, source: Task, unmapped_value: float | None, progress: Progress = None
) -> FoundMappings:
    """Return the mappings found, from memory for tasks that were searched before."""
    try:
        memory = _memory(target, source, unmapped_value)  # type: ignore[arg-type]
    except TypeError:  # a user's task may have no hash
        memory = []
    if not memory:
        memory.append(
            find_mappings(target, source, unmapped_value=unmapped_value, progress=progress)
        )
    return memory[0]


@lru_cache(maxsize=REMEMBERED)
def _memory(target: Task, source: Task, unmapped_value: float | None) -> list[FoundMappings]:
    """Return the cached list of results for two tasks, which is empty at first."""
    return []
