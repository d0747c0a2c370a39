"""Calibration: the scale of a potential, fitted to the returns of its own greedy policy.

A source's values are too high or too low in another task. For c > 0, c phi has the same optimum and
the same greedy policy as phi, so c can be fitted to rollouts of that policy in the target.
"""

import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from curricle.arrays import FloatArray
from curricle.display import printed
from curricle.errors import CalibrationError, PotentialError
from curricle.learning.potential import PairPotential
from curricle.learning.record import WarmUp
from curricle.tasks.mdp import generative_model
from curricle.text import brief_repr, counted
from curricle.transfer.potential import ObservationPotential
from curricle.transfer.rollouts import GreedyRollouts, greedy_rollouts
from curricle.transfer.transfer import CALIBRATION_EPISODES, Calibrate

AnyPotential = Any  # a StateActionPotential, MappedPotential or ObservationPotential
FIRST_EPISODES = 20  # a calibration stops after as many episodes that reach nothing
MIN_NONZERO = 0.5  # least share of the steps in which phi is not 0
MIN_EXPLAINED = 0.25  # least share of the squared returns that the fit explains
LARGEST_SEARCHED = 10_000_000
"""Most pairs (S x A) among which the highest phi is searched; a random sample of more pairs."""
CHUNK = 1_000_000  # pairs read at a time


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated potential, and the rollouts to which it was fitted.

    Attributes
    ----------
    potential : StateActionPotential, MappedPotential or ObservationPotential
        The potential scale phi, or phi itself where no scale could be fitted.
    scale : float
    predicted, return_to_go : float
        Means over all steps of phi(s_t, a_t), and of the discounted return from step t on.
    explained : float
        The share of the squared returns to go that the fit explains; NaN without a fit.
    episodes, ended : int
        Numbers of greedy episodes, and of those that terminated.
    warm_up : WarmUp
        The lengths and returns of the episodes, which are charged to the target.
    refusal : str
        Why no scale could be fitted; empty if one was fitted.
    stopped : bool
        Whether `max_steps` ended the calibration.

    Examples
    --------
    >>> from curricle import GridWorld, StateActionPotential, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, 0.5 * solve(maze).action_values)
    >>> print(calibrate(phi, episodes=10))
    scale 2 fitted on 10 greedy episodes (20 steps, 10 ended): mean phi 98.8, mean return to go 198
    """

    potential: AnyPotential
    scale: float
    predicted: float
    return_to_go: float
    explained: float
    episodes: int
    ended: int
    warm_up: WarmUp = field(repr=False)
    refusal: str = ""
    stopped: bool = False

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def steps(self) -> int:
        """Steps taken in the target."""
        return self.warm_up.steps

    def __str__(self) -> str:
        if self.refusal:
            return self.refusal
        return (
            f"scale {self.scale:.3g} fitted on {counted(self.episodes, 'greedy episode')} "
            f"({counted(self.steps, 'step')}{', the most allowed' * self.stopped}, "
            f"{self.ended} ended): mean phi {self.predicted:.3g}, "
            f"mean return to go {self.return_to_go:.3g}"
        )


def calibrate(
    potential: AnyPotential,
    *,
    episodes: int = CALIBRATION_EPISODES,
    max_steps: int | None = None,
    seed: int = 0,
    stream: str = "calibrate",
) -> Calibration:
    """Return a potential scaled to the returns of its own greedy policy.

    With G_t the discounted return from step t, c minimises sum_t (G_t - c phi(s_t, a_t))^2. Where
    an episode is truncated, G_t goes on with c max_a phi(s, a) of the last state: truncation is
    not termination, and the fit stays linear in c. `episodes` and `max_steps` are those of
    :class:`Calibrate`; `seed` and `stream` decide the random stream of the episodes.

    Raises
    ------
    CalibrationError
        When the episodes carry no information (phi was 0 in most of their steps, they reached
        nothing, or `max_steps` ended the first); when no positive scale explains the returns; or
        when the scale would raise some phi far above the values of phi in the episodes. The last is
        common if rewards have both signs, and is not checked for observations.

    Examples
    --------
    >>> from curricle import GridWorld, StateActionPotential, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, solve(maze).action_values / 3)
    >>> fitted = calibrate(phi)
    >>> round(fitted.scale, 3), fitted.steps
    (3.0, 400)
    """
    fitted = fit_calibration(potential, Calibrate(episodes, max_steps), seed=seed, stream=stream)
    if fitted.refusal:
        raise CalibrationError(fitted.refusal)
    return fitted


def fit_calibration(
    potential: AnyPotential, settings: Calibrate, *, seed: int = 0, stream: str = "calibrate"
) -> Calibration:
    """Return a calibration; if no scale fits, it has a refusal and the unchanged potential."""
    if not isinstance(potential, PairPotential | ObservationPotential):
        raise PotentialError(
            "a potential to be calibrated must be a StateActionPotential, a MappedPotential or an "
            f"ObservationPotential: got {type(potential).__name__}"
        )
    cap = settings.max_steps
    roll = partial(greedy_rollouts, potential, seed=seed, stream=stream, max_steps=cap)
    # If the first episodes reach nothing, the rest would be wasted. They are run again as the
    # first of all episodes.
    few = min(FIRST_EPISODES, settings.episodes)
    rollouts: GreedyRollouts = roll(episodes=few)
    if (
        few < settings.episodes
        and rollouts.predicted.size != cap
        and not _nothing_reached(rollouts)
    ):
        rollouts = roll(episodes=settings.episodes)
    stopped = rollouts.predicted.size == cap
    scale, explained = 1.0, math.nan
    refusal = _uninformative(rollouts, cap if stopped else None)
    if not refusal:
        scale, explained = fitted_scale(rollouts)
        refusal = _poor_fit(potential, rollouts, scale, explained)
        scale = 1.0 if refusal else scale
    bootstrapped = scale * rollouts.bootstrapped_value
    return_to_go = rollouts.return_to_go + rollouts.bootstrap_discount * bootstrapped
    return Calibration(
        potential=potential if refusal else potential.rescaled(scale),
        scale=scale,
        predicted=float(rollouts.predicted.mean()),
        return_to_go=float(return_to_go.mean()),
        explained=explained,
        episodes=len(rollouts.lengths),
        ended=int(rollouts.ended.sum()),
        warm_up=WarmUp(rollouts.lengths, rollouts.returns),
        refusal=refusal,
        stopped=stopped,
    )


def fitted_scale(rollouts: GreedyRollouts) -> tuple[float, float]:
    """Return the c for which c phi is nearest to the returns, and the share that c phi explains."""
    # The bootstrapped value is scaled like phi, so the fit subtracts it from phi.
    phi = rollouts.predicted - rollouts.bootstrap_discount * rollouts.bootstrapped_value
    # Steps with phi 0, in unmapped states, carry no information on the scale.
    used = phi != 0
    if not used.any():
        return math.nan, math.nan
    # Each in units of a power of 2, in which no square overflows and nothing is rounded.
    (phi, unit), (returns, other) = map(_in_units, (phi[used], rollouts.return_to_go[used]))
    product, length = _inner(phi, returns), _inner(phi, phi)
    squares = length * _inner(returns, returns)
    explained = product**2 / squares if squares > 0 else 0.0
    return product / length * (other / unit) if length > 0 else 0.0, explained


def _in_units(values: FloatArray) -> tuple[FloatArray, float]:
    """Return values below 2 and the power of 2 by which they are to be multiplied."""
    unit = 2.0 ** (math.frexp(float(abs(values).max()))[1] - 1)
    return values / unit, unit


def _inner(left: FloatArray, right: FloatArray) -> float:
    """Return the inner product with one rounding, since BLAS rounds differently by processor."""
    return math.fsum(left * right)


# -- refusals: each function returns the reason, or "" where there is none -------------------------


def _uninformative(rollouts: GreedyRollouts, cap: int | None) -> str:
    """Return a refusal if the episodes, `cap` steps at most, cannot determine the scale."""
    if cap is not None and len(rollouts.lengths) == 1 and not rollouts.ended.any():
        return (
            f"a calibration needs a whole episode: its most steps, {cap:,}, ended during the first"
        )
    zero = float((rollouts.predicted == 0).mean())
    if (refusal := _nothing_reached(rollouts)) or zero <= 1 - MIN_NONZERO:
        return refusal
    return (
        "a calibration needs a potential that is not 0 where its greedy policy leads: phi was 0 in "
        f"{zero:.0%} of {rollouts.predicted.size:,} steps, in {len(rollouts.lengths)} episodes"
    )


def _nothing_reached(rollouts: GreedyRollouts) -> str:
    """Return a refusal if no episode terminated and all rewards were equal, else ""."""
    if rollouts.ended.any() or not rollouts.one_reward:
        return ""
    return (
        "a calibration needs episodes that reach something: none of "
        f"{len(rollouts.lengths)} ended, and each of their {rollouts.predicted.size:,} steps had "
        f"the reward {rollouts.returns[0] / rollouts.lengths[0]:g}"
    )


def _poor_fit(
    potential: AnyPotential, rollouts: GreedyRollouts, scale: float, explained: float
) -> str:
    """Return a refusal if scale phi does not describe the returns, else ""."""
    if not (math.isfinite(scale) and math.isfinite(explained)):
        return (
            f"a calibration must be determined by its episodes: {len(rollouts.lengths)} of them, "
            f"{int(rollouts.ended.sum())} of which ended, leave the scale at 0 / 0"
        )
    highest = -math.inf if isinstance(potential, ObservationPotential) else _highest(potential)
    highest_seen = float(rollouts.predicted.max())
    if scale > 1 and highest > 0 and highest_seen < highest / 2:
        return (
            "a calibration must not raise values of phi that its episodes did not come near: a "
            f"factor of {scale:.3g}, fitted where phi was {highest_seen:.3g} at most, would raise "
            f"a phi of {highest:.3g}"
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
    if not explained >= MIN_EXPLAINED:
        return (
            f"a calibration by a factor must explain {MIN_EXPLAINED:.0%} of the returns to go: it "
            f"explains {explained:.1%}, as {means}"
        )
    return ""


def _highest(potential: PairPotential) -> float:
    """Return the highest phi(s, a) outside terminal states."""
    model = generative_model(potential.task)
    n_states, n_actions = model.states.size, model.actions.size
    states, searched = np.arange(n_states), max(1, LARGEST_SEARCHED // n_actions)
    if searched < n_states:
        states = np.random.default_rng(0).integers(n_states, size=searched)
    if model.terminal is not None:
        states = states[~model.terminal[states]]
    parts = np.array_split(states, max(1, len(states) * n_actions // CHUNK))
    return max(float(potential.pairs(part).max(initial=-math.inf)) for part in parts)
