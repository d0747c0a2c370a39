"""The certificate of a shaping, and the state that refutes it."""

from dataclasses import dataclass, field
from typing import Literal

from curricle.array_types import FloatArray

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
        Value in the task that the shaped task's action loses; 0 if both are optimal there and
        only the second is in the shaped task.
    values, shaped_values : (float, float)
        Values of both in the task, and those that a policy acts on in the shaped task.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.certificate import ShapingReward, certify
    >>> maze = GridWorld("S.T")
    >>> stay = ShapingReward(lambda state, action, after: 300 * (after == state))
    >>> found = certify(maze, stay).counterexample
    >>> found.components, found.actions
    ({'row': 0, 'column': 1}, ('east', 'north'))
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

    def __str__(self) -> str:
        best, other = self.actions
        values = (
            f"{best} is worth {self.values[0]:.4g} and {other} {self.values[1]:.4g}, under shaping "
            f"{self.shaped_values[0]:.4g} and {self.shaped_values[1]:.4g}"
        )
        if self.lost > 0:
            return f"in {self.place} shaping prefers {other}, which loses {self.lost:.4g}: {values}"
        return f"in {self.place} shaping gives up {best}, which is as good as any: {values}"


@dataclass(frozen=True, eq=False)
class Certificate:
    """The result of :func:`certify`; true as a condition only if the shaping is proven safe.

    Attributes
    ----------
    holds : bool or None
        True: the optimal actions are proven to be the same in every reachable state. False: a
        counterexample is known. None: neither.
    shaping : str
        Name of its class.
    method : {"exact", "sampled"}
    states : int
        Reachable states that were compared, without ends.
    steps : int
        Steps sampled.
    loss : float
        The most that one action, optimal in the shaped task, loses in one of the states. NaN if
        states were not compared, like the next four.
    total_loss : float
        The most that a policy, optimal in the shaped task, loses from one of them on.
    tolerance : float
        Actions that fall short of the best by no more count as optimal.
    error_bound : float
        Largest possible error of the values compared.
    residual : float
        Largest distance from theory: of the values acted on, or for a bonus or reward of F from
        gamma Phi(s') - Phi(s), or of sampled sums of F.
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
    >>> bool(certificate), certificate.states, certificate.loss
    (True, 2, 0.0)
    """

    holds: bool | None
    shaping: str
    method: Literal["exact", "sampled"]
    states: int = 0
    steps: int = 0
    loss: float = UNKNOWN
    total_loss: float = UNKNOWN
    tolerance: float = UNKNOWN
    error_bound: float = UNKNOWN
    residual: float = UNKNOWN
    findings: tuple[str, ...] = ()
    counterexample: Counterexample | None = None
    potential: FloatArray | None = field(default=None, repr=False)

    def __bool__(self) -> bool:
        return self.holds is True

    def __str__(self) -> str:
        sentences = [self._verdict(), *self.findings]
        if sentences[0].endswith(":"):  # the findings are all there is
            sentences[:2] = [" ".join(sentences[:2])]
        return ". ".join(one[0].upper() + one[1:] for one in sentences) + "."

    def _verdict(self) -> str:
        if self.holds and not self.states:
            return "Safe:"
        if self.holds:
            return (
                f"Safe: in all {self.states:,} reachable states the optimal actions of the shaped "
                f"task are those of the task (values proven to {self.error_bound:.0e})"
            )
        if self.holds is None:
            return "Not proven:"
        loss = f"a policy optimal in the shaped task can lose {self.total_loss:.4g} in all"
        if self.counterexample is not None and self.counterexample.lost > 0:
            return f"NOT safe: {self.counterexample}; {loss}"
        return f"NOT the same, though no return is lost: {self.counterexample}"
