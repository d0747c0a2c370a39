"""Calibration: scale and shift of a potential, fitted to the returns of its own greedy policy.

A source's values are those of another task: carried over unchanged they are too high or too low,
and learning corrects them one pair after the other. c phi + b has the same optimum and, for c > 0,
the same greedy policy as phi, so c and b can be fitted to rollouts of that policy in the target.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from curricle.array_types import FloatArray
from curricle.errors import CalibrationError, PotentialError
from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.potential_rollouts import GreedyRollouts, greedy_rollouts
from curricle.learning.record import WarmUp
from curricle.tasks.task import generative_model
from curricle.transfer.edges import CALIBRATION_EPISODES, Calibrate
from curricle.transfer.observation_rollouts import greedy_observation_rollouts
from curricle.transfer.potentials import ObservationPotential

AnyPotential = Any
"""The potential of a task: a StateActionPotential, MappedPotential or ObservationPotential."""
FIRST_EPISODES = 20
"""Episodes after which a calibration stops if they reached nothing."""
LARGEST_SEARCHED = 10_000_000
"""Pairs (S x A) in which the highest value of phi is searched; of more, as many at random."""
CHUNK = 1_000_000
"""Pairs read at a time."""
MIN_NONZERO = 0.5
"""Least share of the steps in which phi is not 0."""
MIN_EXPLAINED = {"a factor": 0.25, "a factor and a shift": 0.02}
"""Least share of the returns that a fit explains: of their squares, or of their variance."""


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

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, 0.5 * solve(maze).action_values)
    >>> print(calibrate(phi, episodes=10))
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

    @property
    def steps(self) -> int:
        """Steps taken in the target."""
        return self.warm_up.steps

    def __str__(self) -> str:
        if self.refusal:
            return self.refusal
        shift = f" and shift {self.shift:.3g}" if self.shift else ""
        return (
            f"scale {self.scale:.3g}{shift} fitted on {self.episodes} greedy episodes "
            f"({self.steps:,} steps{', the most allowed' * self.stopped}, {self.ended} ended): "
            f"mean phi {self.predicted:.3g}, mean return to go {self.return_to_go:.3g}"
        )


def calibrate(
    potential: AnyPotential,
    *,
    episodes: int = CALIBRATION_EPISODES,
    shift: bool = False,
    quantile: float | None = None,
    max_steps: int | None = None,
    seed: int = 0,
    stream: str = "calibrate",
) -> Calibration:
    """Return a potential scaled (and shifted) to the returns of its own greedy policy.

    With G_t the discounted return from step t, c minimises sum_t (G_t - c phi(s_t, a_t))^2. Where
    an episode is truncated, G_t goes on with c max_a phi(s, a) of the last state: truncation is
    not termination, and the fit stays linear in c.

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or ObservationPotential
    episodes, shift, quantile, max_steps
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
    >>> found = calibrate(phi, shift=True)
    >>> round(found.scale, 3), round(found.shift, 3), found.steps
    (1.0, 30.0, 400)
    """
    settings = Calibrate(episodes, shift, quantile, max_steps)
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
            f"ObservationPotential: got a {type(potential).__name__}"
        )
    roll_out: Any = (
        greedy_observation_rollouts
        if isinstance(potential, ObservationPotential)
        else greedy_rollouts
    )
    # A few episodes show whether anything is reached, and if not the rest would be wasted. They
    # are the first of the rest.
    few, cap = min(FIRST_EPISODES, settings.episodes), settings.max_steps
    how: Any = {"seed": seed, "stream": stream, "max_steps": cap}
    rollouts = roll_out(potential, episodes=few, **how)
    stopped = rollouts.predicted.size == cap
    if few < settings.episodes and not stopped and not _nothing_reached(rollouts):
        rollouts = roll_out(potential, episodes=settings.episodes, **how)
        stopped = rollouts.predicted.size == cap
    scale, shift, explained = 1.0, 0.0, float("nan")
    refusal = _nothing_whole(rollouts, cap) if stopped else ""
    refusal = refusal or _nothing_reached(rollouts) or _mostly_zero(rollouts)
    if not refusal:
        scale, shift, explained = _fit(rollouts, settings)
        refusal = _poor_fit(potential, rollouts, settings, scale, explained)
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
    )


def _nothing_whole(rollouts: GreedyRollouts, cap: int | None) -> str:
    """Return a refusal if the cap of steps ended the first episode, else ""."""
    if len(rollouts.lengths) > 1 or rollouts.ended.any():
        return ""
    return f"a calibration needs a whole episode: its most steps, {cap:,}, ended during the first"


def _nothing_reached(rollouts: GreedyRollouts) -> str:
    """Return a refusal if no episode terminated and all steps had one reward, else ""."""
    if rollouts.ended.any() or not rollouts.one_reward:
        return ""
    return (
        "a calibration needs episodes that reach something: none of "
        f"{len(rollouts.lengths)} ended, and each of their {rollouts.predicted.size:,} steps had "
        f"the reward {rollouts.returns[0] / rollouts.lengths[0]:g}"
    )


def _mostly_zero(rollouts: GreedyRollouts) -> str:
    """Return a refusal if phi is 0 in most steps, else ""."""
    zero = float((rollouts.predicted == 0).mean())
    if zero <= 1 - MIN_NONZERO:
        return ""
    return (
        "a calibration needs a potential that is not 0 where its greedy policy leads: phi was 0 in "
        f"{zero:.0%} of {rollouts.predicted.size:,} steps, in {len(rollouts.lengths)} episodes"
    )


def _poor_fit(
    potential: AnyPotential,
    rollouts: GreedyRollouts,
    settings: Calibrate,
    scale: float,
    explained: float,
) -> str:
    """Return a refusal if scale phi + shift does not describe the returns, else ""."""
    if not (math.isfinite(scale) and math.isfinite(explained)):
        return (
            f"a calibration must be determined by its episodes: {len(rollouts.lengths)} of them, "
            f"{int(rollouts.ended.sum())} of which ended, leave "
            f"{'the shift' if settings.shift else 'the scale'} at 0 / 0"
        )
    highest, highest_seen = _highest(potential), float(rollouts.predicted.max())
    if scale > 1 and highest > 0 and highest_seen < highest / 2:
        return (
            "a calibration must not raise values of phi that its episodes did not come near: a "
            f"factor of {scale:.3g}, fitted where phi was {highest_seen:.3g} at most, would raise "
            f"one of {highest:.3g}"
        )
    means = (
        f"phi was {rollouts.predicted.mean():.3g} on average and the return to go "
        f"{rollouts.return_to_go.mean():.3g}"
    )
    if not scale > 0:
        return (
            "a calibration needs a positive scale, which keeps phi's order: "
            f"{scale:.3g} fits best, as {means}"
        )
    model = "a factor and a shift" if settings.shift else "a factor"
    if not explained >= MIN_EXPLAINED[model]:
        return (
            f"a calibration by {model} must explain {MIN_EXPLAINED[model]:.0%} of the returns to "
            f"go: it explains {explained:.1%}, as {means}"
        )
    return ""


def _highest(potential: AnyPotential) -> float:
    """Return the highest phi(s, a) of all states, or of a sample where there are very many.

    The same pairs are read of every kind of potential. Of observations it is not known: -inf.
    """
    if isinstance(potential, ObservationPotential):
        return -math.inf
    model = generative_model(potential.task)
    n_states, n_actions = model.states.size, model.actions.size
    searched = min(n_states, max(1, LARGEST_SEARCHED // n_actions))
    states = np.arange(searched)
    if searched < n_states:
        states = np.random.default_rng(0).integers(n_states, size=searched)
    if model.terminal is not None:
        states = states[~model.terminal[states]]
    parts = np.array_split(states, max(1, len(states) * n_actions // CHUNK))
    return max(float(potential.rows(part).max(initial=-math.inf)) for part in parts)


def _fit(rollouts: GreedyRollouts, settings: Calibrate) -> tuple[float, float, float]:
    """Return the scale, the shift and the share of the returns that they explain."""
    # The bootstrapped value is scaled and shifted like phi, so it moves to the other side.
    phi = rollouts.predicted - rollouts.bootstrap_discount * rollouts.bootstrapped_value
    # Steps with phi 0, in unmapped states, carry no information on the scale.
    used = phi != 0
    phi, returns = phi[used], rollouts.return_to_go[used]
    ones = 1.0 - rollouts.bootstrap_discount[used]
    if not (ones.any() if settings.shift else used.any()):
        return math.nan, math.nan, math.nan
    if not settings.shift:
        product = _inner(phi, returns)
        squares = _inner(phi, phi) * _inner(returns, returns)
        explained = product**2 / squares if squares > 0 else 0.0
        if settings.quantile is None:
            return _coefficient(phi, returns), 0.0, explained
        return _quantile_scale(settings.quantile, phi, returns), 0.0, explained
    about_mean = _residual(ones, returns)
    scale = _coefficient(_residual(ones, phi), returns)
    shift = _coefficient(ones, returns - scale * phi)
    residual = returns - scale * phi - shift * ones
    left, spread = _inner(residual, residual), _inner(about_mean, about_mean)
    explained = 1.0 - left / spread if spread > 0 else 0.0
    if settings.quantile is not None:
        shift += np.quantile(residual[ones > 0] / ones[ones > 0], settings.quantile)
    return float(scale), float(shift), float(explained)


def _inner(one: FloatArray, other: FloatArray) -> float:
    """Return the inner product, its sum rounded once.

    BLAS rounds differently on different processors, and a scale that differs in its last bit leads
    to other trajectories.
    """
    return math.fsum(one * other)


def _coefficient(axis: FloatArray, vector: FloatArray) -> float:
    """Return the c for which c axis is nearest to a vector; 0 for an axis of zeros."""
    length = _inner(axis, axis)
    return _inner(axis, vector) / length if length > 0 else 0.0


def _residual(axis: FloatArray, vector: FloatArray) -> FloatArray:
    """Return a vector less its projection on an axis."""
    return vector - axis * _coefficient(axis, vector)


def _quantile_scale(quantile: float, phi: FloatArray, returns: FloatArray) -> float:
    """Return the c for which c phi is this quantile of the returns (Koenker, Bassett 1978).

    It minimises sum_t rho(G_t - c phi_t), rho(x) = x (quantile - [x < 0]), which is piecewise
    linear in c with a bend at each G_t / phi_t: c is the bend where the slope turns positive, so a
    sort finds it exactly.
    """
    size, ratio = abs(phi), returns / phi
    # Below its bend a step with phi > 0 adds -quantile |phi| to the slope, another -(1 - quantile).
    upward = size * np.where(phi > 0, quantile, 1 - quantile)
    order = np.argsort(ratio)
    slope = np.cumsum(size[order]) - upward.sum()
    return float(ratio[order][np.argmax(slope >= 0)])
