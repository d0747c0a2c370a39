"""Fits of a scale to greedy rollouts, and how well the rollouts determine it.

Every sum is rounded once (:func:`math.fsum`), and nothing else but square roots is taken. BLAS
rounds differently on different processors, and a scale that differs in its last bit leads to other
trajectories.
"""

import math
from typing import NamedTuple

import numpy as np

from curricle.array_types import FloatArray
from curricle.learning.potential_rollouts import GreedyRollouts

LARGEST_CAUTIOUS = 1.5
"""No cautious scale is larger. On the development families 2 gained no more where 1.5 gained, and
lost more where it lost."""
PRIOR_ERROR = 0.5
"""Relative standard error at which a fit is believed by half."""


class ScaleEvidence(NamedTuple):
    """What E greedy episodes say of a potential's scale; standard errors are over episodes."""

    scale: float
    """The c for which c phi is nearest to the returns to go."""
    scale_error: float
    slope: float
    """Of r + gamma max phi(s') on phi(s, a): 1 for optimal values, 0 where phi says nothing."""
    slope_error: float
    episodes: int
    stuck: bool
    """Whether no episode terminated and every step had the same reward."""

    @property
    def cautious_scale(self) -> float:
        """The scale that is used: between 1 and the fitted one.

        The fit is shrunk towards 1 by its standard error. Then its square root is taken, half way
        between phi and the returns of phi's own policy on a scale of factors, as those returns are
        below the optimum.
        """
        if self.stuck:
            return LARGEST_CAUTIOUS
        relative = self.scale_error / self.scale / PRIOR_ERROR
        shrunk = 1.0 + (self.scale - 1.0) / (1.0 + relative * relative)
        return min(math.sqrt(shrunk), LARGEST_CAUTIOUS)


def scale_evidence(rollouts: GreedyRollouts, discount: float) -> ScaleEvidence:
    """Return the fitted scale, the slope, and their standard errors over episodes.

    The errors are those of least squares with episodes as the independent units (Liang, Zeger
    1986). NaN where phi is 0 or the same in all steps, or where there is one episode.
    """
    phi, returns = rollouts.predicted, rollouts.return_to_go
    axis = phi - rollouts.bootstrap_discount * rollouts.bootstrapped_value
    last = np.cumsum(rollouts.lengths) - 1
    after = np.append(phi[1:], 0.0)
    after[last] = rollouts.bootstrapped_value[last]
    returns_after = np.append(returns[1:], 0.0)
    returns_after[last] = 0.0
    one_step = returns - discount * returns_after + discount * after
    n = len(phi)
    centred = phi - math.fsum(phi) / n
    scale, scale_error = _slope(axis, returns, rollouts)
    slope, slope_error = _slope(centred, one_step - math.fsum(one_step) / n, rollouts)
    stuck = rollouts.one_reward and not rollouts.ended.any()
    return ScaleEvidence(scale, scale_error, slope, slope_error, len(rollouts.lengths), stuck)


def _slope(axis: FloatArray, vector: FloatArray, rollouts: GreedyRollouts) -> tuple[float, float]:
    """Return the c for which c axis is nearest to a vector, and its standard error."""
    length, episodes = inner(axis, axis), len(rollouts.lengths)
    # Of a constant the rounding of its mean is left.
    if length <= 1e-18 * inner(rollouts.predicted, rollouts.predicted):
        return math.nan, math.nan
    c = inner(axis, vector) / length
    if episodes < 2:
        return c, math.nan
    ends = np.cumsum(rollouts.lengths)
    scores = [math.fsum(part) for part in np.split(axis * (vector - c * axis), ends[:-1])]
    spread = math.fsum(score * score for score in scores) * episodes / (episodes - 1)
    return c, math.sqrt(spread) / length


def fit(
    rollouts: GreedyRollouts, *, with_shift: bool, quantile: float | None
) -> tuple[float, float, float]:
    """Return the scale, the shift and the share of the returns that they explain."""
    # The bootstrapped value is scaled and shifted like phi, so it moves to the other side.
    phi = rollouts.predicted - rollouts.bootstrap_discount * rollouts.bootstrapped_value
    # Steps with phi 0, in unmapped states, carry no information on the scale.
    used = phi != 0
    phi, returns = phi[used], rollouts.return_to_go[used]
    ones = 1.0 - rollouts.bootstrap_discount[used]
    if not (ones.any() if with_shift else used.any()):
        return math.nan, math.nan, math.nan
    if not with_shift:
        product = inner(phi, returns)
        squares = inner(phi, phi) * inner(returns, returns)
        explained = product**2 / squares if squares > 0 else 0.0
        if quantile is None:
            return _coefficient(phi, returns), 0.0, explained
        return _quantile_scale(quantile, phi, returns), 0.0, explained
    about_mean = _residual(ones, returns)
    scale = _coefficient(_residual(ones, phi), returns)
    shift = _coefficient(ones, returns - scale * phi)
    residual = returns - scale * phi - shift * ones
    left, spread = inner(residual, residual), inner(about_mean, about_mean)
    explained = 1.0 - left / spread if spread > 0 else 0.0
    if quantile is not None:
        # One of the residuals, not a number between two of them, so that the share holds exactly.
        each = residual[ones > 0] / ones[ones > 0]
        shift += float(np.quantile(each, quantile, method="inverted_cdf"))
    return float(scale), float(shift), float(explained)


def inner(one: FloatArray, other: FloatArray) -> float:
    """Return the inner product, its sum rounded once."""
    return math.fsum(one * other)


def _coefficient(axis: FloatArray, vector: FloatArray) -> float:
    """Return the c for which c axis is nearest to a vector; 0 for an axis of zeros."""
    length = inner(axis, axis)
    return inner(axis, vector) / length if length > 0 else 0.0


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
