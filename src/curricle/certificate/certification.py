"""Whether a shaping is safe: proven in every state, refuted in one, or looked into by sample."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from curricle.certificate import shaped
from curricle.certificate.bonus import moves_of
from curricle.certificate.diagnosis import (
    open_ends_named,
    origin,
    second_discount_named,
    two_ways_in,
)
from curricle.certificate.given import Given, ShapingReward, checked
from curricle.certificate.sampled import in_time, sampled
from curricle.certificate.shaped import ActedOn, Comparison, Reached
from curricle.certificate.verdict import Certificate, Counterexample
from curricle.checks import number, one_of, whole_number
from curricle.errors import SettingError
from curricle.learning.shaping import Shaping
from curricle.planning.solution import Solution
from curricle.tasks.labels import action_name, state_name, values_of
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.reachability import improper_states
from curricle.tasks.task import Task, generative_model, has_tables, tables

FloatArray = npt.NDArray[np.float64]

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

    Both problems are solved and the actions optimal in one or the other compared in every state
    that can be reached, allowing for the proven error of both solutions: what is *acted on*,

    - :class:`StateShaping`: Q* for rewards r + F, F = gamma Phi(s') - Phi(s), which is Q* - Phi
      (Ng, Harada, Russell 1999);
    - :class:`QInitialisation`, :class:`LookAheadAdvice`: Q + phi, the fixed point of Q-learning's
      expected update with F = gamma phi(s', a*) - phi(s, a), a* = argmax Q + phi, which is Q*
      (Wiewiora 2003; Wiewiora, Cottrell, Elkan 2003);
    - :class:`LookBackAdvice`: Q* for r + phi(s, a) - phi(before) / gamma, where each state is
      entered with one phi; elsewhere this is not proven, and such a state is named;
    - :class:`DecayingAdvice`: Q* + xi phi with the weight xi of the long run (Behboudian et al.
      2020);
    - :class:`RewardBonus`: Q* for r + phi(s, a), which need not be safe;
    - :class:`ShapingReward`: Q* for r + F(s, a, s').

    F of the last two is taken apart: a potential is behind it, a potential with a second discount
    or with ends that are not 0 (Grzes 2017), or none, and then a place says so.

    Parameters
    ----------
    task : Task
    shaping : Shaping or ShapingReward
        One of the above. A state potential that changes is compared as it ends up, and its F
        checked step by step in time (Devlin, Kudenko 2012). A potential of another tool is given
        as an array: (S,) for :class:`StateShaping`, (S, A) for the rest. Unlike in :func:`learn`
        it is *not* set to 0 at the ends: what it says there is paid as that tool would pay it.
    shaping_discount : float, optional
        The discount of that tool's F = ``shaping_discount`` Phi(s') - Phi(s); the task's by
        default. For ``"state"``.
    tolerance : float, optional
        Actions that fall short of the best by no more count as optimal, in return units; 1e-6 of
        the largest value by default.
    method : {"auto", "exact", "sampled"}
        Every state, or steps of the uniform policy, which may contradict a potential but prove
        nothing. "auto" compares states where tables of up to 20 million outcomes (states x
        actions x outcomes of a pair) can be solved.
    steps : int
        About how many to sample.
    seed : int
        Of the sample.

    Returns
    -------
    Certificate

    Raises
    ------
    PotentialError
        When a potential has the wrong shape or a value that is not finite, a NaN for example.
    SettingError
        When a shaping does not take such a potential, the potential is another task's, or the
        tolerance is below what can be proven.
    TaskError
        When ``method="exact"`` asks for tables that there are not.

    Notes
    -----
    An action is an exception only where it falls short in one problem by more than the tolerance
    and both error bounds, and in the other by less than its error bound. So no rounding makes a
    shaping unsafe, and one that is called safe loses at most the tolerance, and what the bounds
    leave, with each action.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards, StateShaping
    >>> maze = GridWorld("S..T", rewards=Rewards(treasure=20), discount=0.9)
    >>> print(certify(maze, StateShaping([0.0, 1.0, 2.0, 3.0])))
    Safe: in all 3 reachable states the optimal actions of the shaped task are those of the task
    (values proven to ...). Terminal state 3 (row 0, column 3) has Phi = 3, must be 0.

    Pay for walking into a wall, and the treasure waits for ever:

    >>> certificate = certify(maze, ShapingReward(lambda s, a, after: 5.0 * (after == s)))
    >>> bool(certificate), certificate.counterexample.place
    (False, 'state 2 (row 0, column 2)')
    """
    given = checked(task, shaping, shaping_discount)
    one_of("method", method, ("auto", "exact", "sampled"), SettingError)
    if tolerance is not None and not number("tolerance", tolerance, SettingError) > 0:
        raise SettingError(f"tolerance must be positive: got {tolerance:g}")
    steps = whole_number("steps to sample", steps, 1, SettingError)
    seed = whole_number("seed", seed, 0, SettingError)
    reason = "as asked for" if method == "sampled" else None
    if method == "auto":
        reason = _out_of_reach(task)
    if reason is None:
        return _compared(given, tolerance, seed)
    return _sampled(given, steps, seed, reason)


def _out_of_reach(task: Task) -> str | None:
    """Return why not every state of a task is compared; None if all are."""
    generative = generative_model(task)
    if not isinstance(generative, FiniteMDP) and not has_tables(task):
        return "the task has no tables"
    pairs = generative.states.size * generative.actions.size
    if pairs > LARGEST_EXACT or pairs * tables(task).probability.shape[1] > LARGEST_EXACT:
        return f"states x actions x outcomes of the task exceed {LARGEST_EXACT:,}"
    mdp = tables(task)
    if mdp.discount == 1:
        rows = mdp.terminal, mdp.outcome_row, mdp.probability, mdp.next_state
        endless = improper_states(*rows)
        if endless.size:
            place = state_name(mdp.states, int(endless[0]))
            return f"from {place} an episode can go on for ever at discount 1"
    return None


# -- every state ---------------------------------------------------------------------------------


def _compared(given: Given, tolerance: float | None, seed: int) -> Certificate:
    """Return the certificate of a comparison of all states."""
    mdp = tables(given.task)
    met = shaped.reached(mdp)
    findings = _flags(given, met.ends)
    if given.claim == "one_way_in" and (two := _two_ways(given, met)) is not None:
        return Certificate(None, given.name, "exact", findings=(*findings, two))
    own = shaped.solved(given.task, shaped.closeness(mdp))
    phi = None
    if given.claim == "added_rewards":
        acted, phi, said = _with_bonus(given, own, met)
        findings += said
    else:
        acted = _with_potential(given, own, met)
    found = shaped.compare(own.action_values[met.states], own.error_bound, acted, tolerance)
    holds: bool | None = found.agrees
    if given.changing:
        findings += ("it changes while learning and was compared as it ends up",)
        contradictions = in_time(given, seed).contradictions
        findings, holds = findings + contradictions, holds and (None if contradictions else True)
    return Certificate(
        holds,
        given.name,
        "exact",
        states=len(met.states),
        loss=found.loss,
        total_loss=shaped.total_loss(own, met, found.chosen),
        tolerance=found.tolerance,
        error_bound=max(own.error_bound, acted.bound),
        residual=acted.residual,
        findings=findings,
        counterexample=None if found.agrees else _counterexample(met, own, acted, found),
        potential=phi,
    )


def _with_potential(given: Given, own: Solution, met: Reached) -> ActedOn:
    """Return what a policy acts on under a potential."""
    phi = given.final()
    if given.claim == "telescoping":
        f = met.paid(lambda s, a, after: given.discount * phi[after] - phi[s])
        return shaped.with_reward(own, met, f, phi[met.states])
    if given.claim == "added_values":
        return shaped.with_advice(own, met, phi)
    if given.claim == "one_way_in":
        return shaped.with_look_back(own, met, phi)
    return shaped.with_look_ahead(own, met, phi)


def _with_bonus(
    given: Given, own: Solution, met: Reached
) -> tuple[ActedOn, FloatArray | None, tuple[str, ...]]:
    """Return what a policy acts on under a bonus, Phi behind it if any, and what is to be said."""
    f = met.paid(given.bonus())
    made = origin(given.task, moves_of(met, f))
    acted = shaped.with_reward(own, met, f, np.zeros(len(met.states)))
    acted = ActedOn(acted.values, acted.bound, made.plain.worst)
    return acted, None if made.found is None else made.found.potential, made.sentences


def _counterexample(
    met: Reached, own: Solution, acted: ActedOn, found: Comparison
) -> Counterexample:
    """Return the state and actions in which most is lost, or else an optimal action given up."""
    mdp, q = met.mdp, own.action_values[met.states]
    if found.worse.any():
        row, other = _largest_at(found.short, found.worse)
        best, lost = int(q[row].argmax()), float(found.short[row, other])
    else:
        row, best = _largest_at(found.shaped_short, found.given_up)
        other, lost = int(acted.values[row].argmax()), 0.0
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
        shaped_values=(float(acted.values[row, best]), float(acted.values[row, other])),
    )


def _largest_at(values: FloatArray, among: npt.NDArray[np.bool_]) -> tuple[int, int]:
    place = np.unravel_index(np.where(among, values, -np.inf).argmax(), values.shape)
    return int(place[0]), int(place[1])


def _two_ways(given: Given, met: Reached) -> str | None:
    """Return the sentence about a state with two pasts under look-back advice, None if none has."""
    phi = given.final()
    least, most = shaped.ways_in(met, phi)
    apart = most[met.states] - least[met.states]
    worst = int(apart.argmax())
    if apart[worst] <= 1e-12 * abs(phi).max():
        return None
    state = int(met.states[worst])
    ways: list[tuple[float, int, int] | None] = []
    for value in (float(most[state]), float(least[state])):
        pair = shaped.entered(met, state, phi, value)
        ways.append(None if pair is None else (value, *pair))
    return two_ways_in(given.task, state, ways)


def _flags(given: Given, ends: npt.NDArray[np.int64]) -> tuple[str, ...]:
    """Return what an array's ends, a second discount or a weight give rise to say."""
    said = list[str]()
    own = generative_model(given.task).discount
    if given.discount != own:
        said.append(second_discount_named(given.discount, own))
    if given.raw and given.claim in ("telescoping", "fixed_point"):
        phi = given.ending()[ends]
        if phi.any():
            said.append(open_ends_named(given.task, ends[phi != 0], phi[phi != 0]))
    if given.claim == "added_values":
        share = "" if given.share == 1 else f"{given.share:g} "
        acts = f"Q + {share}phi" if given.share else "Q alone"
        said.append(f"in the long run the policy acts on {acts}")
    return tuple(said)


# -- a sample of steps ---------------------------------------------------------------------------


def _sampled(given: Given, steps: int, seed: int, reason: str) -> Certificate:
    """Return the certificate of a task that is not compared state by state."""
    terminal = generative_model(given.task).terminal
    ends = np.zeros(0, np.int64) if terminal is None else np.flatnonzero(terminal)
    findings = _flags(given, ends)
    if given.claim == "added_values":
        holds = True if given.share == 0 else None
        return Certificate(holds, given.name, "sampled", findings=findings)
    found = sampled(given, steps, seed)
    sample = f"{found.steps:,} sampled steps ({reason})"
    said = (*found.contradictions, f"this is by {sample}")
    findings = (*(said if found.contradictions else (f"no contradiction in {sample}",)), *findings)
    return Certificate(
        None, given.name, "sampled", steps=found.steps, residual=found.residual, findings=findings
    )
