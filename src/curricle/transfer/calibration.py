"""Calibration: scale and shift of a potential, fitted to the returns of its own greedy policy.

A source's values are those of another task: carried over unchanged they are too high or too low,
and learning corrects them one pair after the other. c phi + b has the same optimum and, for c > 0,
the same greedy policy as phi, so c and b can be fitted to rollouts of that policy in the target.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from curricle.display import brief_repr, printed
from curricle.errors import CalibrationError, PotentialError
from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.potential_rollouts import GreedyRollouts, greedy_rollouts
from curricle.learning.record import NO_WARM_UP, WarmUp
from curricle.tasks.task import generative_model
from curricle.text_tables import counted
from curricle.transfer.calibration_refusals import (
    LEAST_EPISODES,
    gains,
    highest_met,
    is_known,
    mostly_zero,
    nothing_reached,
    nothing_whole,
    poor_fit,
    too_little,
    too_long,
    unsuited,
)
from curricle.transfer.edges import CALIBRATION_EPISODES, Calibrate
from curricle.transfer.observation_rollouts import greedy_observation_rollouts
from curricle.transfer.potentials import ObservationPotential
from curricle.transfer.scale_fit import ScaleEvidence, fit, scale_evidence

AnyPotential = Any
"""The potential of a task: a StateActionPotential, MappedPotential or ObservationPotential."""
RollOut = Callable[..., GreedyRollouts]
"""Greedy rollouts of a potential, given the number of episodes."""
LATE = 10
"""A cautious calibration that has spent one part in so many of its steps goes on only where the
scale is worth them so far."""
FIRST_EPISODES = 20
"""Episodes after which a calibration stops if they reached nothing."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated potential, and the rollouts that it was fitted to.

    Attributes
    ----------
    potential : StateActionPotential, MappedPotential or ObservationPotential
        scale phi + shift; phi itself where nothing could be fitted.
    scale, shift : float
    predicted, return_to_go : float
        Means over all steps: of phi(s_t, a_t), and of the discounted return from t on (with the
        calibrated potential as the value of states in which an episode was truncated).
    explained : float
        The share of the returns to go that the fit explains: of the sum of squares for a scale, of
        the variance with a shift. NaN where nothing was fitted.
    episodes, ended : int
        Greedy episodes, and how many of them terminated.
    warm_up : WarmUp
        Their lengths and returns, to be charged to the target.
    refusal : str
        Why nothing could be fitted; empty if it could.
    stopped : bool
        Whether its cap of steps ended it.
    evidence : ScaleEvidence or None
        What a cautious calibration rests on.

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, 0.5 * solve(maze).action_values)
    >>> print(calibrate(phi, episodes=10, cautious=False))
    scale 2 fitted on 10 greedy episodes (20 steps, 10 ended): mean phi 98.8, mean return to go 198
    """

    potential: AnyPotential
    scale: float
    shift: float
    predicted: float
    return_to_go: float
    explained: float
    episodes: int
    ended: int
    warm_up: WarmUp = field(repr=False)
    refusal: str = ""
    stopped: bool = False
    evidence: ScaleEvidence | None = None

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def steps(self) -> int:
        """Steps taken in the target."""
        return self.warm_up.steps

    def __str__(self) -> str:
        if self.refusal:
            return self.refusal
        shift = f" and shift {self.shift:.3g}" if self.shift else ""
        how = "fitted"
        if self.evidence is not None:
            fitted, error, *_ = self.evidence
            how = f"(fitted {fitted:.3g}, standard error {error:.2g})"
        return (
            f"scale {self.scale:.3g}{shift} {how} on "
            f"{counted(self.episodes, 'greedy episode')} "
            f"({counted(self.steps, 'step')}{', the most allowed' * self.stopped}, "
            f"{self.ended} ended): mean phi {self.predicted:.3g}, "
            f"mean return to go {self.return_to_go:.3g}"
        )


def calibrate(
    potential: AnyPotential,
    *,
    episodes: int = CALIBRATION_EPISODES,
    shift: bool = False,
    quantile: float | None = None,
    max_steps: int | None = None,
    cautious: bool = True,
    seed: int = 0,
    stream: str = "calibrate",
) -> Calibration:
    """Return a potential scaled (and shifted) towards the returns of its own greedy policy.

    With G_t the discounted return from step t, c minimises sum_t (G_t - c phi(s_t, a_t))^2. Where
    an episode is truncated, G_t goes on with c max_a phi(s, a) of the last state: truncation is
    not termination, and the fit stays linear in c.

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or ObservationPotential
    episodes, shift, quantile, max_steps, cautious
        As in :class:`Calibrate`.
    seed, stream : int, str
        Of the random stream of the episodes, as in :func:`learn`.

    Raises
    ------
    CalibrationError
        When the episodes carry no information (phi was 0 in most of their steps, or they reached
        nothing, or `max_steps` ended the first, or a fit would be 0 / 0), when no positive scale
        explains the returns, or when the scale would raise values of phi well above those of the
        steps it was fitted to. The last is common where rewards have both signs: a factor above 1
        lowers low values, as wanted, and raises high ones. It is not judged for observations.

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, solve(maze).action_values - 30)
    >>> found = calibrate(phi, shift=True, cautious=False)
    >>> round(found.scale, 3), round(found.shift, 3), found.steps
    (1.0, 30.0, 400)
    """
    settings = Calibrate(episodes, shift, quantile, max_steps, cautious)
    found = fit_calibration(potential, settings, seed=seed, stream=stream)
    if found.refusal:
        raise CalibrationError(found.refusal)
    return found


def fit_calibration(
    potential: AnyPotential, settings: Calibrate, *, seed: int = 0, stream: str = "calibrate"
) -> Calibration:
    """Return a calibration; where nothing can be fitted, one with a refusal and phi unchanged."""
    if not isinstance(potential, StateActionPotential | MappedPotential | ObservationPotential):
        raise PotentialError(
            "a potential to be calibrated must be a StateActionPotential, a MappedPotential or an "
            f"ObservationPotential: got {type(potential).__name__}"
        )
    roll_out: Any = (
        greedy_observation_rollouts
        if isinstance(potential, ObservationPotential)
        else greedy_rollouts
    )
    roll = partial(roll_out, potential, seed=seed, stream=stream, max_steps=settings.max_steps)
    return (_cautious_fit if settings.cautious else _plain_fit)(potential, settings, roll)


def _plain_fit(potential: AnyPotential, settings: Calibrate, roll: RollOut) -> Calibration:
    """Return the fit to all episodes, as it is."""
    # A few episodes show whether anything is reached, and if not the rest would be wasted. They
    # are the first of the rest.
    few, cap = min(FIRST_EPISODES, settings.episodes), settings.max_steps
    rollouts = roll(episodes=few)
    stopped = rollouts.predicted.size == cap
    if few < settings.episodes and not stopped and not nothing_reached(rollouts):
        rollouts = roll(episodes=settings.episodes)
        stopped = rollouts.predicted.size == cap
    scale, shift, explained = 1.0, 0.0, math.nan
    refusal = nothing_whole(rollouts, cap) if stopped else ""
    refusal = refusal or nothing_reached(rollouts) or mostly_zero(rollouts)
    if not refusal:
        scale, shift, explained = fit(
            rollouts, with_shift=settings.shift, quantile=settings.quantile
        )
        refusal = poor_fit(potential, rollouts, settings, scale, explained)
    return _calibration(
        potential, rollouts, scale, shift, explained=explained, refusal=refusal, stopped=stopped
    )


def _cautious_fit(potential: AnyPotential, settings: Calibrate, roll: RollOut) -> Calibration:
    """Return a scale above 1 where the first few episodes bear it out."""
    if refusal := unsuited(potential):
        return _refused_at_once(potential, refusal)
    for episodes in _looks(settings.episodes):
        rollouts = roll(episodes=episodes)
        evidence = scale_evidence(rollouts, _discount(potential))
        stopped = rollouts.predicted.size == settings.max_steps
        refusal = gains(highest_met(rollouts)) or mostly_zero(rollouts)
        refusal = refusal or too_long(rollouts, settings.max_steps)
        steps, cap = rollouts.predicted.size, settings.max_steps
        late = cap is not None and steps * LATE >= cap
        if refusal or stopped or is_known(evidence, late=late):
            break
    refusal = refusal or too_little(evidence)
    scale = 1.0 if refusal else evidence.cautious_scale
    return _calibration(
        potential, rollouts, scale, evidence=evidence, refusal=refusal, stopped=stopped
    )


def _looks(most: int) -> Iterator[int]:
    """Yield 1, 2, 5, 10, 20, ..., `most`: episodes after which a cautious calibration looks."""
    yield from (few for few in (1, 2) if few < most)
    episodes = LEAST_EPISODES
    while episodes < most:
        yield episodes
        episodes *= 2
    yield most


def _discount(potential: AnyPotential) -> float:
    task = potential.task
    observed = isinstance(potential, ObservationPotential)
    return float(task.discount if observed else generative_model(task).discount)


def _refused_at_once(potential: AnyPotential, refusal: str) -> Calibration:
    """Return a refusal that cost no steps."""
    nan = math.nan
    return Calibration(potential, 1.0, 0.0, nan, nan, nan, 0, 0, NO_WARM_UP, refusal)


def _calibration(
    potential: AnyPotential,
    rollouts: GreedyRollouts,
    scale: float,
    shift: float = 0.0,
    *,
    explained: float = math.nan,
    evidence: ScaleEvidence | None = None,
    refusal: str,
    stopped: bool,
) -> Calibration:
    if refusal:
        scale, shift = 1.0, 0.0
    return_to_go = rollouts.return_to_go + rollouts.bootstrap_discount * (
        scale * rollouts.bootstrapped_value + shift
    )
    return Calibration(
        potential=potential if refusal else potential.rescaled(scale, shift),
        scale=scale,
        shift=shift,
        predicted=float(rollouts.predicted.mean()),
        return_to_go=float(return_to_go.mean()),
        explained=explained,
        episodes=len(rollouts.lengths),
        ended=int(rollouts.ended.sum()),
        warm_up=WarmUp(rollouts.lengths, rollouts.returns),
        refusal=refusal,
        stopped=stopped,
        evidence=evidence,
    )
