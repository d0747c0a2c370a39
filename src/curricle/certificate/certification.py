"""Whether a shaping is safe: proven in every state, refuted in one, or open."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from curricle.arrays import BoolArray, FloatArray, Frozen, frozen
from curricle.certificate.shaped_task import (
    ActionValues,
    Ends,
    Origin,
    Reachable,
    ShapedTask,
    ShapedValues,
    ShapingReward,
    check_shaping,
    nonzero_ends,
    origin,
)
from curricle.checks import number, one_of
from curricle.errors import CurricleError, SettingError
from curricle.learning.potential import StatePotential
from curricle.learning.shaping import Shaping
from curricle.planning.solution import EPSILON, Solution, solve_without_limit
from curricle.progress import Progress, check_progress, shown
from curricle.tasks.graph import improper_states
from curricle.tasks.mdp import FiniteMDP, Task, closed, generative_model, has_tables, tables
from curricle.tasks.spaces import action_name, state_name, values_of
from curricle.text import brief_repr, printed
from curricle.transfer.bisimulation import levels, numbered_rows

LARGEST_EXACT = 20_000_000
"""Outcomes (S x A x O) up to which ``method="auto"`` compares every state (2 GB, seconds)."""

MOST_REFINEMENTS = 100  # rounds of refinement after which ties of actions stay unproven
UNKNOWN = float("nan")


@dataclass(frozen=True)
class Counterexample:
    """A state in which an action is optimal in the task or in the shaped task, but not in both.

    Attributes
    ----------
    state : int
    components : dict of str to int
        The state's components by name.
    place : str
        The state's name.
    action, shaped_action : int
        The best action of the task, and of the shaped task.
    actions : (str, str)
        The names of these actions.
    lost : float
        Value in the task that the action of the shaped task loses; 0 if both are optimal there.
    values, shaped_values : (float, float)
        Values of both actions in the task, and in the shaped task the values to act on.
    """

    state: int
    components: dict[str, int]
    place: str
    action: int
    shaped_action: int
    actions: tuple[str, str]
    lost: float
    values: tuple[float, float]
    shaped_values: tuple[float, float]

    __repr__ = brief_repr
    _repr_html_ = printed

    def __str__(self) -> str:
        best, other = self.actions
        in_task, shaped = _distinct_digits(self.values), _distinct_digits(self.shaped_values)
        worth = f"{best} is worth {in_task[0]} and {other} {in_task[1]}"
        values = f"{worth}, under shaping {shaped[0]} and {shaped[1]}"
        if self.lost > 0:
            return f"in {self.place} shaping prefers {other}, which loses {self.lost:.4g}: {values}"
        return f"in {self.place} shaping makes {best} worse, which is optimal: {values}"


def _distinct_digits(values: tuple[float, float]) -> tuple[str, str]:
    """Return two numbers in the fewest digits, 4 to 17, in which they differ."""
    for digits in range(4, 18):
        first, second = (f"{value:.{digits}g}" for value in values)
        if first != second:
            return first, second
    return f"{values[0]:.4g}", f"{values[1]:.4g}"


@dataclass(frozen=True, eq=False)
class Certificate(Frozen):
    """A proof, a refutation, or neither; its truth value is True only for a proof.

    Attributes
    ----------
    holds : bool or None
        True: the optimal actions are proven to be the same in every reachable state. False: a
        counterexample is proven. None: neither.
    shaping : str
        Name of its class.
    states : int
        Reachable states that were compared; terminal states are left out.
    theorem : str or None
        The publication of the theorem that proves the shaping safe for any values.
    tolerance : float
        The loss that is allowed, in return units.
    loss, total_loss : float
        The largest possible loss of an action, and of a policy, that may be optimal in the shaped
        task, with errors of values. If states were not compared, these and the next two are NaN.
    error_bound : float
        Largest possible error of the values compared.
    residual : float
        Largest difference between the values acted on and the values by theory; for a bonus or
        reward between F and gamma Phi(s') - Phi(s).
    findings : tuple of str
        Other findings, as sentences.
    counterexample : Counterexample or None
        The state of the largest loss, if `holds` is False.
    potential : (S,) float64 or None
        The Phi behind a bonus or reward.

    Examples
    --------
    >>> from curricle import GridWorld, StateShaping, certify
    >>> maze = GridWorld("S.T")
    >>> certificate = certify(maze, StateShaping([0.0, 1.0, 0.0]))
    >>> bool(certificate), certificate.states, certificate.tolerance, certificate.loss
    (True, 2, 0.0, 0.0)
    """

    holds: bool | None
    shaping: str
    states: int = 0
    theorem: str | None = None
    tolerance: float = 0.0
    loss: float = UNKNOWN
    total_loss: float = UNKNOWN
    error_bound: float = UNKNOWN
    residual: float = UNKNOWN
    findings: tuple[str, ...] = ()
    counterexample: Counterexample | None = None
    potential: FloatArray | None = field(default=None, repr=False)

    __repr__ = brief_repr

    def __bool__(self) -> bool:
        return self.holds is True

    def __str__(self) -> str:
        sentences = f"{self._verdict()} ({self._limits()})", *self.findings
        return ". ".join(sentence[0].upper() + sentence[1:] for sentence in sentences) + "."

    _repr_html_ = printed

    def _verdict(self) -> str:
        if self.holds:
            where = f"in all {self.states:,} reachable states " if self.states else ""
            if self.tolerance > 0 and self.theorem is None:
                return (
                    f"Safe within {self.tolerance:g}: {where}no action that is optimal in the task "
                    "or in the shaped task falls short in the other by more"
                )
            safe = f"Safe: {where}the optimal actions of the shaped task are those of the task"
            return safe if self.theorem is None else f"{safe}, by theory ({self.theorem})"
        if self.holds is False:
            loss = f"a policy optimal in the shaped task can lose {self.total_loss:.4g} in all"
            if self.counterexample is not None and self.counterexample.lost > 0:
                return f"NOT safe: {self.counterexample}; {loss}"
            return f"NOT the same, though no return is lost: {self.counterexample}"
        if self.states:
            return f"Undecided within {2 * self.error_bound:.0e}"
        return "Not proven"

    def _limits(self) -> str:
        loss = "unknown" if self.loss != self.loss else f"{self.loss:.2g}"
        limits = f"tolerance {self.tolerance:g}, largest possible loss {loss}"
        return f"values proven to {self.error_bound:.0e}, {limits}" if self.states else limits


def certify(
    task: Task,
    shaping: Shaping | ShapingReward,
    *,
    shaping_discount: float | None = None,
    ends: Ends = "zero",
    tolerance: float = 0.0,
    method: Literal["auto", "exact"] = "auto",
    progress: Progress = None,
) -> Certificate:
    """Return whether a shaping keeps the optimal actions of a task.

    The task and the shaped task are solved, and their optimal actions compared in every reachable
    state, within the proven errors of both solutions. A shaped policy acts on these values:

    - :class:`StateShaping`: Q* for rewards r + F, F = gamma Phi(s') - Phi(s); by theory Q* - Phi
      (Ng, Harada, Russell 1999);
    - :class:`QInitialisation`, :class:`LookAheadAdvice`: Q + phi, the fixed point of Q-learning's
      expected update with F = gamma phi(s', a*) - phi(s, a), a* = argmax Q + phi; by theory Q*
      (Wiewiora 2003; Wiewiora, Cottrell, Elkan 2003);
    - :class:`RewardBonus`, :class:`ShapingReward`: Q* for r + F, F any reward. The findings tell
      whether F comes from a potential, and whether that is 0 at the ends (Grzes 2017).

    Parameters
    ----------
    task : Task
    shaping : Shaping or ShapingReward
        A shaping of a class above. Of a state potential that changes, the last values are compared
        (Devlin, Kudenko 2012).
    shaping_discount : float, optional
        The discount of another tool's F = ``shaping_discount`` Phi(s') - Phi(s); the task's by
        default. For :class:`StateShaping`.
    ends : {"zero", "given"}
        How an array, (S,) for :class:`StateShaping` and (S, A) for the rest, is read at the ends:
        "zero" as 0, like :func:`learn`; "given" unchanged, like a tool that adds gamma Phi(end).
    tolerance : float
        A loss that does not matter, in return units: optimal actions may fall short by as much.
    method : {"auto", "exact"}
        "exact" compares every state; "auto" does so if the tables have at most 20 million outcomes
        and, at discount 1, every policy ends. Otherwise a shaping is decided by its theorem alone,
        and one without a theorem for any values, such as a bonus, stays open.
    progress : bool or callable, optional
        True shows a bar that moves until the answer is there; a function is called with the answer.

    Raises
    ------
    PotentialError
        If a potential has the wrong shape, or it or a reward has a value that is not finite or
        larger than 1e15 in size.
    SettingError
        If a shaping does not take such a potential, or the potential belongs to another task.
    TaskError
        If the task has no numbered states, or for ``method="exact"`` no tables.

    Notes
    -----
    Two actions whose values differ by less than twice the proven error may both be optimal. The
    certificate holds if in every state a single action can be optimal, the same in both tasks; with
    a tolerance, if all actions that can be optimal in one task fall short in the other by no more
    than it. It fails if in some state all actions that can be optimal in one task fall short in
    the other by more. Else a theorem can prove the shaping safe: F comes from a potential that is 0
    at the ends, with the task's discount; or the last weight of advice is 0, or advice is the same
    for all actions. Without a theorem the answer is open, and also if a difference of two actions
    vanishes in double precision beside a large potential. A bonus or reward is rounded, so it is
    never exactly the F of a potential: nearly equal actions leave the answer open unless their
    consequences are equal.

    Examples
    --------
    >>> from curricle import GridWorld, Rewards, StateShaping
    >>> maze = GridWorld("S..T", rewards=Rewards(treasure=20), discount=0.9)
    >>> print(certify(maze, StateShaping([0.0, 1.0, 2.0, 3.0])))
    Safe: in all 3 reachable states the optimal actions of the shaped task are those of the task,
    by theory (Ng, Harada, Russell 1999) (values proven to ..., tolerance 0, largest possible loss
    0). Terminal state 3 (row 0, column 3) has Phi = 3, which learn() reads as 0; ends='given'
    judges a tool that does not.

    With a reward for walking into a wall, the optimal policy does so for ever:

    >>> certificate = certify(maze, ShapingReward(lambda s, a, after: 5.0 * (after == s)))
    >>> bool(certificate), certificate.counterexample.place
    (False, 'state 2 (row 0, column 2)')
    """
    check_progress(progress)
    checked = check_shaping(task, shaping, shaping_discount, ends)
    one_of("method", method, ("auto", "exact"), SettingError)
    tolerance = number("tolerance", tolerance, SettingError, low=0)
    reason = _why_not_compared(checked) if method == "auto" else None
    with shown(progress) as bars:
        bars.bar("certifying")
        if reason is None:
            answer = _exact_certificate(replace(checked, compared=True), tolerance)
        else:
            answer = _by_theorem(checked, tolerance, reason)
        bars.tell(answer)
    return answer


def _why_not_compared(shaped: ShapedTask) -> str | None:
    """Return why the states of a task cannot all be compared; None if they can."""
    task = shaped.task
    generative = generative_model(task)
    if not isinstance(generative, FiniteMDP) and not has_tables(task):
        return "that needs tables, which the task does not have"
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


def _findings(shaped: ShapedTask) -> tuple[str, ...]:
    """Return findings that need no solution: a second discount, nonzero ends, the last weight."""
    sentences, discount = list[str](), shaped.task_discount
    if shaped.discount != discount:
        sentences.append(
            f"shaped with a second discount: F = {shaped.discount:.6g} Phi(s') - Phi(s), the "
            f"task's discount is {discount:.6g}"
        )
    if shaped.ignored.any():
        nonzero = np.flatnonzero(shaped.ignored)
        named = nonzero_ends(shaped.task, nonzero, shaped.ignored[nonzero], "")
        sentences.append(
            f"{named}, which learn() reads as 0; ends='given' judges a tool that does not"
        )
    if shaped.shaping.at_ends and not shaped.zero_at_ends:
        phi = shaped.phi_at_ends
        sentences.append(nonzero_ends(shaped.task, shaped.ends[phi != 0], phi[phi != 0]))
        sentences.append(shaped.shaping.at_ends)
    return tuple(sentences)


# -- the optimal actions of the task and the shaped task, compared in every state ------------------


@dataclass(frozen=True, eq=False)
class ActionComparison:
    """The optimal actions of a task and of its shaped version, in N reachable states."""

    reachable: Reachable
    unshaped: Solution
    shaped: ShapedValues
    tolerance: float  # a loss that is allowed

    @cached_property
    def task(self) -> ActionValues:
        """The action values of the task without shaping."""
        return ActionValues(
            self.unshaped.action_values[self.reachable.states], self.unshaped.error_bound
        )

    @property
    def loss(self) -> float:
        """The largest possible loss of one action that may be optimal in the shaped task."""
        optimal = self.task.optimal
        certain = optimal & (optimal.sum(axis=1, keepdims=True) == 1)
        lost = np.where(certain, 0.0, self.task.short + self.task.error)
        return float(lost[self.shaped.optimal].max(initial=0.0))

    @cached_property
    def lost(self) -> FloatArray:
        """The proven loss of actions optimal when shaped, (N,); 0 within the tolerance."""
        return self.task.lost(self.shaped.optimal, self.tolerance)

    @cached_property
    def given_up(self) -> FloatArray:
        """The proven loss in the shaped task of actions optimal in the task, (N,), likewise."""
        return self.shaped.lost(self.task.optimal, self.tolerance)

    @cached_property
    def undecided(self) -> BoolArray:
        """States in which the optimal actions are proven neither equal nor different, (N,)."""
        optimal, chosen = self.task.optimal, self.shaped.optimal
        same = (optimal == chosen).all(axis=1) & (optimal.sum(axis=1) == 1)
        if self.tolerance > 0:
            sides = self.task, self.shaped
            fine, shaped_fine = (side.short + side.error <= self.tolerance for side in sides)
            same |= ((fine | ~chosen) & (shaped_fine | ~optimal)).all(axis=1)
        return np.asarray(~same & (self.lost == 0) & (self.given_up == 0))

    def total_loss(self) -> float:
        """Return max_s V*(s) - V(s), V of the worst policy that may be optimal when shaped."""
        mdp, states, chosen = self.reachable.mdp, self.reachable.states, self.shaped.optimal
        row = mdp.outcome_row.copy()
        first = np.take_along_axis(row[states], chosen.argmax(axis=1)[:, None], axis=1)
        row[states] = np.where(chosen, row[states], first)
        try:
            worst = solve_without_limit(
                replace(mdp, outcome_row=frozen(row), reward=frozen(-mdp.reward))
            )
        except CurricleError:  # at discount 1 the worst policy may pay for ever
            return np.inf
        lost = (self.unshaped.values + worst.values)[states].max(initial=0.0)
        return float(lost) + self.unshaped.error_bound + worst.error_bound

    def counterexample(self) -> Counterexample:
        """Return the state of the largest `lost`, or else of the largest `given_up`."""
        q, acted, mdp = self.task.values, self.shaped.values, self.reachable.mdp
        if self.lost.any():
            row = int(self.lost.argmax())
            best = int(q[row].argmax())
            other = int(np.where(self.shaped.optimal[row], self.task.short[row], np.inf).argmin())
            lost = float(self.task.short[row, other])
        else:
            row = int(self.given_up.argmax())
            other, lost = int(acted[row].argmax()), 0.0
            best = int(np.where(self.task.optimal[row], self.shaped.short[row], np.inf).argmin())
        state = int(self.reachable.states[row])
        return Counterexample(
            state=state,
            components=values_of(mdp.states, state),
            place=state_name(mdp.states, state),
            action=best,
            shaped_action=other,
            actions=(action_name(mdp.actions, best), action_name(mdp.actions, other)),
            lost=lost,
            values=(float(q[row, best]), float(q[row, other])),
            shaped_values=(float(acted[row, best]), float(acted[row, other])),
        )

    def too_close(self) -> str:
        """Return the sentence about the undecided states."""
        rows, mdp = np.flatnonzero(self.undecided), self.reachable.mdp
        row = rows[0]
        q, acted = self.task.values[row], self.shaped.values[row]
        close = np.flatnonzero(self.task.optimal[row] | self.shaped.optimal[row])
        values = " and ".join(
            f"{action_name(mdp.actions, int(a))} is worth {q[a]:.6g}, under shaping {acted[a]:.6g}"
            for a in close[np.argsort(-q[close], kind="stable")[:2]]
        )
        states = self.reachable.states
        return (
            f"in {len(rows):,} of {len(states):,} reachable states the values are too close to "
            f"tell, first in {state_name(mdp.states, int(states[row]))}: {values}"
        )

    def decided(
        self, theorem: str | None, behind: Origin | None
    ) -> tuple[bool | None, tuple[str, ...]]:
        """Return whether the optimal actions are the same, and a sentence if that is open."""
        # A theorem proves it for any values; `behind` is the potential behind given rewards.
        if self.lost.any() or self.given_up.any():
            return False, ()
        by_values = theorem is None or behind is not None  # decided by the rewards as rounded
        if by_values and not self.undecided.any():
            return True, ()
        if theorem is None:
            return None, (self.too_close(),)
        # A theorem holds in exact arithmetic. In doubles each F has three roundings, and a given F
        # is off by its residual, both twice in a difference of two actions, in every step.
        largest = self.shaped.largest
        off = 3 * EPSILON * largest + (0.0 if behind is None else behind.plain.worst)
        reach = 2 * off * longest_episode(self.reachable.mdp)
        short, error = self.task.short, self.task.error
        vanishing = (short > error) & (short <= reach + error)
        if by_values:
            vanishing &= self.undecided[:, None]
        hidden = float(short[vanishing].max(initial=0.0))
        if behind is not None and behind.plain.potential.any():
            # Ties stay where F is that of the potential, up to rounding, in every step.
            fits = behind.plain.worst <= 8 * EPSILON * largest
            if not (fits and tied_exactly(self.reachable, self.unshaped, self.task.optimal)):
                hidden = max(hidden, error)
        if hidden <= self.tolerance:
            return True, ()
        return None, (
            f"by theory ({theorem}) the shaping is safe, but beside numbers of {largest:.2g} "
            f"differences of {hidden:.2g} between actions vanish in double precision",
        )


def longest_episode(mdp: FiniteMDP) -> float:
    """Return an upper bound on the expected (discounted) steps of an episode."""
    if mdp.discount < 1:
        return 1 / (1 - mdp.discount)
    steps = solve_without_limit(replace(mdp, reward=frozen(np.ones_like(mdp.reward))))
    return float(steps.values.max()) + steps.error_bound


def tied_exactly(reachable: Reachable, unshaped: Solution, optimal: BoolArray) -> bool:
    """Return whether the actions that may be optimal, (N, A), are proven equal in each state."""
    mdp, block = reachable.mdp, levels(unshaped.values, 2 * unshaped.error_bound)
    block[mdp.terminal] = -1
    # Blocks are split until, in each block, these actions have the same chances of the same
    # rewards and next blocks (bisimulation: Givan, Dean, Greig 2003).
    kinds, paid = np.unique(mdp.reward + 1j * mdp.probability, return_inverse=True)
    blocks = 0
    for _ in range(MOST_REFINEMENTS):
        after = (block[mdp.next_state] + 1) * len(kinds) + paid.reshape(mdp.reward.shape)
        after = np.sort(np.where(mdp.probability > 0, after, -1), axis=1)
        alike = np.where(optimal, numbered_rows(after)[mdp.outcome_row[reachable.states]], -1)
        most = alike.max(axis=1)
        if (optimal & (alike != most[:, None])).any():
            return False  # smaller blocks cannot make them equal
        finer = numbered_rows(np.column_stack([block[reachable.states], most]))
        if (refined := int(finer.max(initial=-1)) + 1) == blocks:
            return True
        block[reachable.states], blocks = finer, refined
    return False


def _exact_certificate(shaped: ShapedTask, tolerance: float) -> Certificate:
    reachable, shaping = shaped.reachable, shaped.shaping
    findings, name = _findings(shaped), shaping.name
    behind: Origin | None = None
    if shaping.any_reward:
        f = reachable.reward(shaping.reward(shaped))
        behind = origin(shaped.task, reachable, f)
        values = shaped.with_rewards(f, np.zeros(len(reachable.states)))
        largest = max(values.largest, float(abs(behind.plain.potential).max()))
        values = replace(values, residual=behind.plain.worst, largest=largest)
        findings += behind.sentences
    else:
        values = shaping.acted_on(shaped)
    allowed = None if reachable.mdp.available is None else reachable.mdp.available[reachable.states]
    values = replace(values, values=closed(values.values, allowed))
    compared = ActionComparison(reachable, shaped.unshaped, values, tolerance)
    # At discount 1 the sum of F need not be -Phi(s) in an episode that never ends.
    endless = reachable.mdp.discount == 1 and improper_states(reachable.mdp).size > 0
    from_potential = behind is None or behind.fitting is behind.plain
    applies = not endless and from_potential and shaping.meets_conditions(shaped)
    theorem = shaping.theorem if applies else None
    holds, undecided = compared.decided(theorem, behind)
    if isinstance(shaped.potential, StatePotential) and shaped.potential.changes:
        findings += ("the potential changes while learning; its last values were compared",)
    loss = 0.0 if holds and theorem is not None and behind is None else compared.loss
    return Certificate(
        holds,
        name,
        states=len(reachable.states),
        theorem=theorem if holds else None,
        tolerance=tolerance,
        loss=loss,
        total_loss=compared.total_loss() if loss > 0 else 0.0,
        error_bound=max(shaped.unshaped.error_bound, values.bound),
        residual=values.residual,
        findings=undecided + findings,
        counterexample=compared.counterexample() if holds is False else None,
        potential=None if behind is None or behind.fitting is None else behind.fitting.potential,
    )


# -- without a comparison of states ----------------------------------------------------------------


def _by_theorem(shaped: ShapedTask, tolerance: float, reason: str) -> Certificate:
    """Return the certificate of a theorem for any values; open if none applies."""
    shaping, findings = shaped.shaping, _findings(shaped)
    if shaping.any_reward:
        why = f"{shaping.name} is judged by comparing every state, which was not done: {reason}"
        return Certificate(None, shaping.name, tolerance=tolerance, findings=(why, *findings))
    applies = shaping.meets_conditions(shaped)
    if shaped.is_array and generative_model(shaped.task).terminal is None:
        applies = False
        findings += ("its ends are not known, where Phi must be 0",)
    if shaped.task_discount == 1:  # the sum of F need not be -Phi(s) if an episode never ends
        applies = False
        findings += (f"at discount 1 every policy must end, which is not known: {reason}",)
    if not applies:
        return Certificate(None, shaping.name, tolerance=tolerance, findings=findings)
    findings += (
        "differences between actions that are less than the rounding of F, in every step of an "
        "episode, vanish in double precision",
    )
    proven: dict[str, Any] = {"theorem": shaping.theorem, "loss": 0.0, "total_loss": 0.0}
    return Certificate(True, shaping.name, tolerance=tolerance, findings=findings, **proven)
