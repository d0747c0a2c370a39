"""Calibration: how large a potential has to be for the target to keep what it promises.

A source's values are those of another task. Carried over as they are, they promise too much (or
too little), and learning then falls from one broken promise to the next. c phi + b has the same
optimum and the same greedy policy as phi, so c and b are free to be fitted: by following that
policy through the target for a while and comparing what it earns with what phi promised.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from curricle.errors import CalibrationError, PotentialError
from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.potential_rollouts import GreedyRollouts, greedy_rollouts
from curricle.learning.run import WarmUp
from curricle.transfer.edges import EPISODES, Calibrate
from curricle.transfer.observation_potential import ObservationPotential
from curricle.transfer.observation_rollouts import greedy_observation_rollouts

FloatArray = npt.NDArray[np.float64]
AnyPotential = Any
"""What sources give a task: a StateActionPotential, MappedPotential or ObservationPotential."""
PROBE = 20
"""Episodes after which a calibration that has reached nothing gives up."""
TOLD = 0.5
"""Least share of the steps in which phi has to promise something."""
SCALED, SHIFTED = 0.25, 0.02
"""Least share of the returns that a fit has to account for: of their squares, of their variance."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What following a potential's greedy policy said about its size.

    Attributes
    ----------
    potential : StateActionPotential, MappedPotential or ObservationPotential
        scale phi + shift; phi itself where the rollouts could not tell.
    scale, shift : float
    predicted, return_to_go : float
        Means over the steps followed: of phi(s_t, a_t), and of the discounted return from t on
        (what lies beyond a cut counts as the calibrated potential has it).
    explained : float
        The share of what was earned that the fit accounts for: of the sum of squares for a scale,
        of the variance with a shift. NaN where nothing was fitted.
    episodes, ended : int
        Episodes followed, and how many of them reached an end.
    warm_up : WarmUp
        Their lengths and returns, to be charged to the target.
    refusal : str
        Why nothing could be fitted; empty if it could.

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, 0.5 * solve(maze).action_values)
    >>> print(calibrate(phi, episodes=10))
    scale 2 fitted on 10 greedy episodes (20 steps, 10 ended): promised 98.8 on average, earned 198
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
            f"({self.steps:,} steps, {self.ended} ended): promised {self.predicted:.3g} on average, "
            f"earned {self.return_to_go:.3g}"
        )


def calibrate(
    potential: AnyPotential,
    *,
    episodes: int = EPISODES,
    shift: bool = False,
    quantile: float | None = None,
    seed: int = 0,
    stream: str = "calibrate",
) -> Calibration:
    """Return a potential scaled (and shifted) to what its own greedy policy earns in the target.

    With G_t the discounted return from step t, c minimises sum_t (G_t - c phi(s_t, a_t))^2. Where
    an episode is cut off, G_t goes on with c max_a phi(s, a) of the state it was cut off in: a cut
    is no end, and c stays a linear fit.

    Parameters
    ----------
    potential : StateActionPotential, MappedPotential or ObservationPotential
    episodes, shift, quantile
        As :class:`Calibrate` says.
    seed, stream : int, str
        Of the random stream of the episodes, as in :func:`learn`.

    Raises
    ------
    CalibrationError
        When the episodes carry no information (phi was 0 in most places they went to, or nothing
        was reached), when no positive scale accounts for what was return_to_go, or when the scale would
        raise promises that no episode put to the test. Where rewards have both signs this is the
        rule: a factor above 1 lowers the low promises, as wanted, and raises the high ones.

    Examples
    --------
    >>> from curricle import GridWorld, solve
    >>> maze = GridWorld("S.T", time_limit=10)
    >>> phi = StateActionPotential(maze, solve(maze).action_values - 30)
    >>> found = calibrate(phi, shift=True)
    >>> round(found.scale, 3), round(found.shift, 3), found.steps
    (1.0, 30.0, 400)
    """
    found = attempt(potential, Calibrate(episodes, shift, quantile), seed=seed, stream=stream)
    if found.refusal:
        raise CalibrationError(found.refusal)
    return found


def attempt(
    potential: AnyPotential, settings: Calibrate, *, seed: int = 0, stream: str = "calibrate"
) -> Calibration:
    """Return a calibration, or one that says why there is none and leaves the potential alone."""
    if not isinstance(potential, StateActionPotential | MappedPotential | ObservationPotential):
        raise PotentialError(
            "a potential to be calibrated must be a StateActionPotential, a MappedPotential or an "
            f"ObservationPotential: got a {type(potential).__name__}"
        )
    play: Any = (
        greedy_observation_rollouts
        if isinstance(potential, ObservationPotential)
        else greedy_rollouts
    )
    # Few episodes tell whether anything is reached; the rest, which begins with the same ones,
    # would be spent in vain.
    met = play(potential, episodes=min(PROBE, settings.episodes), seed=seed, stream=stream)
    if not _nothing_reached(met):
        met = play(potential, episodes=settings.episodes, seed=seed, stream=stream)
    scale, shift, explained = 1.0, 0.0, float("nan")
    refusal = _nothing_reached(met) or _nothing_told(met)
    if not refusal:
        scale, shift, explained = _fit(met, settings)
        refusal = _wrong_model(potential, met, settings, scale, explained)
    if refusal:
        scale, shift = 1.0, 0.0
    return_to_go = met.return_to_go + met.bootstrap_discount * (
        scale * met.bootstrapped_value + shift
    )
    return Calibration(
        potential=potential if refusal else potential.rescaled(scale, shift),
        scale=scale,
        shift=shift,
        predicted=float(met.predicted.mean()),
        return_to_go=float(return_to_go.mean()),
        explained=explained,
        episodes=len(met.lengths),
        ended=int(met.ended.sum()),
        warm_up=WarmUp(met.lengths, met.returns),
        refusal=refusal,
    )


def _nothing_reached(met: GreedyRollouts) -> str:
    """Return that these episodes reached nothing; empty if they did."""
    if met.ended.any() or not met.one_reward:
        return ""
    return (
        "a calibration needs episodes that reach something: none of "
        f"{len(met.lengths)} ended, and each of their {met.predicted.size:,} steps was paid "
        f"{met.returns[0] / met.lengths[0]:g}"
    )


def _nothing_told(met: GreedyRollouts) -> str:
    """Return that phi told nothing where these episodes went; empty if it did."""
    silent = float((met.predicted == 0).mean())
    if silent > 1 - TOLD:
        return (
            "a calibration needs a potential that promises something where its policy goes: phi "
            f"was 0 in {silent:.0%} of {met.predicted.size:,} steps, in {len(met.lengths)} episodes"
        )
    return ""


def _wrong_model(
    potential: AnyPotential,
    met: GreedyRollouts,
    settings: Calibrate,
    scale: float,
    explained: float,
) -> str:
    """Return why scale phi + shift does not describe what was earned; empty if it does."""
    highest, met_highest = potential.highest, float(met.predicted.max())
    if scale > 1 and highest > 0 and met_highest < highest / 2:
        return (
            "a calibration must not raise promises that were not put to the test: a factor of "
            f"{scale:.3g}, fitted where phi promised {met_highest:.3g} at most, would raise one of "
            f"{highest:.3g}"
        )
    seen = f"phi promised {met.predicted.mean():.3g} where {met.return_to_go.mean():.3g} was earned"
    if not scale > 0:
        return (
            "a calibration needs a positive scale, which keeps phi's order: "
            f"{scale:.3g} fits best, as {seen}"
        )
    model, least = ("a factor and a shift", SHIFTED) if settings.shift else ("a factor", SCALED)
    if explained < least:
        return (
            f"a calibration by {model} must account for {least:.0%} of what is return_to_go: it does "
            f"for {explained:.1%}, as {seen}"
        )
    return ""


def _fit(met: GreedyRollouts, settings: Calibrate) -> tuple[float, float, float]:
    """Return the scale, the shift and the share of the returns that they account for."""
    # What lies beyond a cut is worth c phi + b too, so it moves to the other side.
    predicted = met.predicted - met.bootstrap_discount * met.bootstrapped_value
    # A step without promise, in an unmapped state, says nothing about the size of promises.
    told = predicted != 0
    predicted, return_to_go, counted = (
        predicted[told],
        met.return_to_go[told],
        1.0 - met.bootstrap_discount[told],
    )
    if not settings.shift:
        products, size = (
            predicted @ return_to_go,
            (predicted @ predicted) * (return_to_go @ return_to_go),
        )
        explained = products**2 / size if size > 0 else 0.0
        if settings.quantile is None:
            return float(products / (predicted @ predicted)), 0.0, float(explained)
        return _scale_at(settings.quantile, predicted, return_to_go), 0.0, float(explained)
    columns = np.stack([predicted, counted], axis=1)
    (scale, shift), *_ = np.linalg.lstsq(columns, return_to_go)
    left = return_to_go - columns @ (scale, shift)
    constant = return_to_go - counted * (counted @ return_to_go) / (counted @ counted)
    explained = 1.0 - (left @ left) / (constant @ constant) if constant.any() else 0.0
    if settings.quantile is not None:
        shift += np.quantile(left / counted, settings.quantile)
    return float(scale), float(shift), float(explained)


def _scale_at(quantile: float, predicted: FloatArray, return_to_go: FloatArray) -> float:
    """Return the c for which c phi is this quantile of G (Koenker, Bassett 1978).

    It minimises sum_t rho(G_t - c phi_t), rho(x) = x (quantile - [x < 0]), which is piecewise
    linear in c with a bend at each G_t / phi_t: c is the bend where the slope turns positive.
    """
    size, ratio = abs(predicted), return_to_go / predicted
    # Left of its bend a step with phi > 0 pulls c up by `quantile`, one with phi < 0 by the rest.
    upward = size * np.where(predicted > 0, quantile, 1 - quantile)
    order = np.argsort(ratio)
    slope = np.cumsum(size[order]) - upward.sum()
    return float(ratio[order][np.argmax(slope >= 0)])
