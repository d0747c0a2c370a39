"""Certificates of a shaping, proven or sampled, and the state that refutes one."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from curricle.arrays import FloatArray, Frozen
from curricle.display import block, printed, table
from curricle.text import brief_repr, counted

UNKNOWN = float("nan")


@dataclass(frozen=True)
class Counterexample:
    """A state in which an action is optimal in the task or in the shaped task, and not in both.

    Attributes
    ----------
    state : int
    components : dict of str to int
        Its components by name.
    place : str
        Its name.
    action, shaped_action : int
        The best action of the task, and of the shaped task.
    actions : (str, str)
        Their names.
    lost : float
        Value in the task that the shaped task's action loses; 0 if both are optimal there.
    values, shaped_values : (float, float)
        Values of both in the task, and those that a policy acts on in the shaped task.
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
        in_task, shaped = _told_apart(self.values), _told_apart(self.shaped_values)
        values = (
            f"{best} is worth {in_task[0]} and {other} {in_task[1]}, under shaping {shaped[0]} and "
            f"{shaped[1]}"
        )
        if self.lost > 0:
            return f"in {self.place} shaping prefers {other}, which loses {self.lost:.4g}: {values}"
        return f"in {self.place} shaping gives up {best}, which is as good as any: {values}"


def _told_apart(values: tuple[float, float]) -> tuple[str, str]:
    """Return two numbers in as many digits as tell them apart, from 4 to all 17."""
    for digits in range(4, 18):
        first, second = (f"{value:.{digits}g}" for value in values)
        if first != second:
            return first, second
    return f"{values[0]:.4g}", f"{values[1]:.4g}"


@dataclass(frozen=True, eq=False)
class Certificate(Frozen):
    """A proof, a refutation, or neither; true as a condition only if the shaping is proven safe.

    Attributes
    ----------
    holds : bool or None
        True: the optimal actions are proven to be the same in every reachable state. False: a
        counterexample is proven. None: neither.
    shaping : str
        Name of its class.
    states : int
        Reachable states that were compared, without ends.
    theorem : str or None
        The source of the theorem that proves the shaping safe whatever the values are.
    tolerance : float
        The loss that is allowed for, in return units; 0 if none is.
    loss : float
        The largest possible loss of one action that may be optimal in the shaped task, errors of
        values included; NaN if states were not compared, like the next three.
    total_loss : float
        The largest possible loss of a policy that may be optimal in the shaped task.
    error_bound : float
        Largest possible error of the values compared.
    residual : float
        Largest distance from theory: of the values acted on, or for a bonus or reward of F from
        gamma Phi(s') - Phi(s).
    findings : tuple of str
        Other findings, a sentence each.
    counterexample : Counterexample or None
        The worst state, where `holds` is False.
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
        return _as_text([f"{self._verdict()} ({self._limits()})", *self.findings])

    def _repr_html_(self) -> str:
        answer = {True: "Safe", False: "Not the same", None: "Not decided"}[self.holds]
        worst = self.counterexample
        return block(
            f"Certificate of {self.shaping}: {answer}",
            self._verdict(),
            worst is not None
            and table(
                [worst.place, "value in the task", "value under shaping"],
                zip(worst.actions, worst.values, worst.shaped_values, strict=True),
            ),
            *self.findings,
            self._limits(),
        )

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


@dataclass(frozen=True, eq=False)
class SampledCertificate:
    """What sampled steps showed of a shaping; it proves nothing, so that it is never true.

    Attributes
    ----------
    shaping : str
        Name of its class.
    steps : int
        Steps sampled.
    reason : str
        Why states were not compared.
    contradictions : tuple of str
        Where F is not that of a potential, a sentence each.
    residual : float
        Largest distance of sampled sums of F from those of a potential.
    findings : tuple of str
        Other findings, a sentence each.

    Examples
    --------
    >>> from curricle import GridWorld, certify
    >>> from curricle.certificate import ShapingReward
    >>> nothing = ShapingReward(lambda state, action, after: 0.0 * state)
    >>> sample = certify(GridWorld("S.T"), nothing, method="sampled")
    >>> bool(sample), sample.contradictions
    (False, ())
    """

    shaping: str
    steps: int
    reason: str
    contradictions: tuple[str, ...]
    residual: float
    findings: tuple[str, ...] = ()

    holds: ClassVar[None] = None

    __repr__ = brief_repr
    _repr_html_ = printed

    def __bool__(self) -> bool:
        return False

    def __str__(self) -> str:
        steps = f"{counted(self.steps, 'sampled step')} ({self.reason})"
        seen = [*self.contradictions, f"found in {steps}"]
        if not self.contradictions:
            seen = [f"no contradiction in {steps}"]
        return _as_text([f"Not proven: {seen[0]}", *seen[1:], *self.findings])


def _as_text(sentences: Sequence[str]) -> str:
    return ". ".join(sentence[0].upper() + sentence[1:] for sentence in sentences) + "."
