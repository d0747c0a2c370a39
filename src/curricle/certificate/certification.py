"""Whether a shaping is safe: proven in every state, refuted in one, or checked on a sample."""

from typing import Literal

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.certificate import shaped_task
from curricle.certificate.checked_shaping import CheckedShaping, ShapingReward, check_shaping
from curricle.certificate.diagnosis import nonzero_ends, origin, other_discount, several_entries
from curricle.certificate.sampled import in_time, sampled
from curricle.certificate.shaped_task import ActionComparison, Reachable, ShapedValues
from curricle.certificate.verdict import Certificate, Counterexample
from curricle.checks import number, one_of, whole_number
from curricle.errors import SettingError
from curricle.learning.shaping import Shaping
from curricle.planning.solution import Solution
from curricle.tasks.labels import action_name, state_name, values_of
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.reachability import improper_states
from curricle.tasks.task import Task, generative_model, has_tables, tables

LARGEST_EXACT = 20_000_000
"""Outcomes (S x A x O) up to which ``method="auto"`` compares every state (2 GB, seconds)."""


def certify(
    task: Task,
    shaping: Shaping | ShapingReward,
    *,
    shaping_discount: float | None = None,
    tolerance: float | None = None,
    method: Literal["auto", "exact", "sampled"] = "auto",
    steps: int = 100_000,
    seed: int = 0,
) -> Certificate:
    """Return whether a shaping leaves the optimal actions of a task as they are.

    Both problems are solved, and the actions optimal in one or the other compared in every
    reachable state, allowing for the proven error of both solutions. The values that a policy acts
    on under shaping are

    - :class:`StateShaping`: Q* for rewards r + F, F = gamma Phi(s') - Phi(s); by theory Q* - Phi
      (Ng, Harada, Russell 1999);
    - :class:`QInitialisation`, :class:`LookAheadAdvice`: Q + phi, the fixed point of Q-learning's
      expected update with F = gamma phi(s', a*) - phi(s, a), a* = argmax Q + phi; by theory Q*
      (Wiewiora 2003; Wiewiora, Cottrell, Elkan 2003);
    - :class:`LookBackAdvice`: Q* for r + phi(s, a) - phi(before) / gamma, if all ways into a state
      have one phi; otherwise nothing is proven, and such a state is named;
    - :class:`DecayingAdvice`: Q* + xi phi with the last weight xi (Behboudian et al. 2020);
    - :class:`RewardBonus`: Q* for r + phi(s, a), which need not be safe;
    - :class:`ShapingReward`: Q* for r + F(s, a, s').

    For the last two the findings tell whether F comes from a potential, from one with a second
    discount or with ends that are not 0 (Grzes 2017), or from none, and then where.

    Parameters
    ----------
    task : Task
    shaping : Shaping or ShapingReward
        One of the above. Of a state potential that changes, the last values are compared, and its F
        is checked over time (Devlin, Kudenko 2012). A potential of another tool is given as an
        array: (S,) for :class:`StateShaping`, (S, A) for the rest. Unlike in :func:`learn` it is
        *not* set to 0 at the ends: F contains its values there, as in that tool.
    shaping_discount : float, optional
        The discount of that tool's F = ``shaping_discount`` Phi(s') - Phi(s); the task's by
        default. For :class:`StateShaping`.
    tolerance : float, optional
        Actions that fall short of the best by no more count as optimal, in return units; 1e-6 of
        the largest value by default.
    method : {"auto", "exact", "sampled"}
        Every state, or steps of the uniform policy, which may refute a potential but prove
        nothing. "auto" compares states where tables of up to 20 million outcomes (states x
        actions x outcomes of a pair) can be solved.
    steps : int
        Steps to sample, about.
    seed : int
        Of the sample.

    Returns
    -------
    Certificate

    Raises
    ------
    PotentialError
        If a potential has the wrong shape or a value that is not finite.
    SettingError
        If a shaping does not take such a potential, the potential is another task's, or the
        tolerance is below what can be proven.
    TaskError
        If ``method="exact"`` is given for a task without tables.

    Notes
    -----
    An action is an exception only if it falls short in one problem by more than the tolerance and
    both error bounds, and in the other by less than its error bound. So no rounding makes a shaping
    unsafe, and each action under a safe one loses at most the tolerance and the bounds.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards, StateShaping
    >>> maze = GridWorld("S..T", rewards=Rewards(treasure=20), discount=0.9)
    >>> print(certify(maze, StateShaping([0.0, 1.0, 2.0, 3.0])))
    Safe: in all 3 reachable states the optimal actions of the shaped task are those of the task
    (values proven to ...). Terminal state 3 (row 0, column 3) has Phi = 3, must be 0.

    With a reward for walking into a wall, the optimal policy does so for ever:

    >>> certificate = certify(maze, ShapingReward(lambda s, a, after: 5.0 * (after == s)))
    >>> bool(certificate), certificate.counterexample.place
    (False, 'state 2 (row 0, column 2)')
    """
    checked = check_shaping(task, shaping, shaping_discount)
    one_of("method", method, ("auto", "exact", "sampled"), SettingError)
    if tolerance is not None and not number("tolerance", tolerance, SettingError) > 0:
        raise SettingError(f"tolerance must be positive: got {tolerance:g}")
    steps = whole_number("steps to sample", steps, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    reason = "as asked for" if method == "sampled" else None
    if method == "auto":
        reason = _reason_to_sample(task)
    if reason is None:
        return _exact_certificate(checked, tolerance, seed)
    return _sampled_certificate(checked, steps, seed, reason)


def _reason_to_sample(task: Task) -> str | None:
    """Return why not every state of a task can be compared; None if all can."""
    generative = generative_model(task)
    if not isinstance(generative, FiniteMDP) and not has_tables(task):
        return "the task has no tables"
    pairs = generative.states.size * generative.actions.size
    if pairs > LARGEST_EXACT or pairs * tables(task).probability.shape[1] > LARGEST_EXACT:
        return f"states x actions x outcomes of the task exceed {LARGEST_EXACT:,}"
    mdp = tables(task)
    if mdp.discount == 1:
        improper = improper_states(mdp)
        if improper.size:
            place = state_name(mdp.states, int(improper[0]))
            return f"from {place} an episode can go on for ever at discount 1"
    return None


def _findings(shaping: CheckedShaping, ends: IntArray) -> tuple[str, ...]:
    """Return findings that need no solution: a second discount, nonzero ends, the last weight."""
    sentences = list[str]()
    claim, own = shaping.shaping.claim, shaping.task_discount
    if shaping.discount != own:
        sentences.append(other_discount(shaping.discount, own))
    if shaping.is_array and claim in ("telescoping", "fixed_point"):
        phi = shaping.end_values()[ends]
        if phi.any():
            sentences.append(nonzero_ends(shaping.task, ends[phi != 0], phi[phi != 0]))
    if claim == "added_values":
        weight = shaping.last_weight
        acted_on = f"Q + {'' if weight == 1 else f'{weight:g} '}phi" if weight else "Q alone"
        sentences.append(f"in the long run the policy acts on {acted_on}")
    return tuple(sentences)


# -- every state ---------------------------------------------------------------------------------


def _exact_certificate(shaping: CheckedShaping, tolerance: float | None, seed: int) -> Certificate:
    mdp, claim, name = tables(shaping.task), shaping.shaping.claim, shaping.shaping.name
    met = Reachable.of(mdp)
    findings = _findings(shaping, met.ends)
    if claim == "one_way_in" and (several := _several_entries(shaping, met)) is not None:
        return Certificate(None, name, "exact", findings=(*findings, several))
    own = shaped_task.solve_closely(shaping.task, shaped_task.default_tolerance(mdp))
    potential = None
    if claim == "added_rewards":
        f = met.reward(shaping.reward())
        behind = origin(shaping.task, met, f)
        shaped = shaped_task.with_reward(own, met, f, np.zeros(len(met.states)))
        shaped = ShapedValues(shaped.values, shaped.bound, behind.plain.worst)
        potential = None if behind.found is None else behind.found.potential
        findings += behind.sentences
    else:
        shaped = _with_potential(shaping, own, met)
    found = shaped_task.compare_actions(
        own.action_values[met.states], own.error_bound, shaped, tolerance
    )
    holds: bool | None = found.agrees
    if shaping.changing:
        findings += ("the potential changes while learning; its last values were compared",)
        contradictions = in_time(shaping, seed).contradictions
        findings, holds = findings + contradictions, holds and (None if contradictions else True)
    return Certificate(
        holds,
        name,
        "exact",
        states=len(met.states),
        loss=found.loss,
        total_loss=shaped_task.total_loss(own, met, found.chosen),
        tolerance=found.tolerance,
        error_bound=max(own.error_bound, shaped.bound),
        residual=shaped.residual,
        findings=findings,
        counterexample=None if found.agrees else _counterexample(met, own, shaped, found),
        potential=potential,
    )


def _with_potential(shaping: CheckedShaping, own: Solution, met: Reachable) -> ShapedValues:
    """Return the values that a policy acts on under a potential."""
    phi, discount = shaping.last_values(), shaping.discount
    match shaping.shaping.claim:
        case "telescoping":
            f = met.reward(lambda s, a, after: discount * phi[after] - phi[s])
            return shaped_task.with_reward(own, met, f, phi[met.states])
        case "added_values":
            return shaped_task.with_advice(own, met, phi)
        case "one_way_in":
            return shaped_task.with_look_back(own, met, phi)
        case _:
            return shaped_task.with_look_ahead(own, met, phi)


def _several_entries(shaping: CheckedShaping, met: Reachable) -> str | None:
    """Return a sentence about a state whose ways in have several phi; None without one."""
    on = ~met.mdp.terminal[met.target]
    pairs = met.source[on], met.action[on], met.target[on]
    phi = shaping.last_values()[pairs[:2]]
    return several_entries(shaping.task, pairs, phi, np.flatnonzero(met.mdp.start > 0))[1]


def _counterexample(
    met: Reachable, own: Solution, shaped: ShapedValues, found: ActionComparison
) -> Counterexample:
    """Return the state and actions in which most is lost, or else an optimal action given up."""
    mdp, q = met.mdp, own.action_values[met.states]
    if found.worse.any():
        row, other = _largest_at(found.short, found.worse)
        best, lost = int(q[row].argmax()), float(found.short[row, other])
    else:
        row, best = _largest_at(found.shaped_short, found.given_up)
        other, lost = int(shaped.values[row].argmax()), 0.0
    state = int(met.states[row])
    return Counterexample(
        state=state,
        components=values_of(mdp.states, state),
        place=state_name(mdp.states, state),
        action=best,
        shaped_action=other,
        actions=(action_name(mdp.actions, best), action_name(mdp.actions, other)),
        lost=lost,
        values=(float(q[row, best]), float(q[row, other])),
        shaped_values=(float(shaped.values[row, best]), float(shaped.values[row, other])),
    )


def _largest_at(values: FloatArray, among: BoolArray) -> tuple[int, int]:
    place = np.unravel_index(np.where(among, values, -np.inf).argmax(), values.shape)
    return int(place[0]), int(place[1])


# -- a sample of steps ---------------------------------------------------------------------------


def _sampled_certificate(
    shaping: CheckedShaping, steps: int, seed: int, reason: str
) -> Certificate:
    terminal = generative_model(shaping.task).terminal
    ends = np.zeros(0, np.int64) if terminal is None else np.flatnonzero(terminal)
    name, findings = shaping.shaping.name, _findings(shaping, ends)
    if shaping.shaping.claim == "added_values":
        holds = True if shaping.last_weight == 0 else None
        return Certificate(holds, name, "sampled", findings=findings)
    found = sampled(shaping, steps, seed)
    sample = f"{found.steps:,} sampled steps ({reason})"
    results = (*found.contradictions, f"found in {sample}")
    if not found.contradictions:
        results = (f"no contradiction in {sample}",)
    return Certificate(
        None,
        name,
        "sampled",
        steps=found.steps,
        residual=found.residual,
        findings=(*results, *findings),
    )
