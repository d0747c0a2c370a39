"""Why a calibration is refused: what phi alone shows, and what its episodes show.

Each function that returns words returns the reason, or "" where there is none.
"""

import math
from typing import Any

import numpy as np

from curricle.learning.potential import MappedPotential, StateActionPotential
from curricle.learning.potential_rollouts import GreedyRollouts
from curricle.tasks.task import generative_model
from curricle.text_tables import counted
from curricle.transfer.edges import Calibrate
from curricle.transfer.potentials import ObservationPotential
from curricle.transfer.scale_fit import LARGEST_CAUTIOUS, ScaleEvidence

LEAST_EPISODES = 5
"""Fewest episodes of which a standard error is taken."""
PRECISE = 0.15
"""Relative standard error of a scale that more episodes need not make smaller."""
WORTH = 1.2
"""Least fitted scale that is used: its square root, 1.1, changes little."""
LARGEST_SEARCHED = 10_000_000
"""Pairs (S x A) in which the highest value of phi is searched; of more, as many at random."""
CHUNK = 1_000_000
"""Pairs read at a time."""
MIN_NONZERO = 0.5
"""Least share of the steps in which phi is not 0."""
MIN_EXPLAINED = {"a factor": 0.25, "a factor and a shift": 0.02}
"""Least share of the returns that a fit explains: of their squares, or of their variance."""


def nothing_whole(rollouts: GreedyRollouts, cap: int | None) -> str:
    """Return a refusal if the cap of steps ended the first episode, else ""."""
    if len(rollouts.lengths) > 1 or rollouts.ended.any():
        return ""
    return f"a calibration needs a whole episode: its most steps, {cap:,}, ended during the first"


def nothing_reached(rollouts: GreedyRollouts) -> str:
    """Return a refusal if no episode terminated and all steps had one reward, else ""."""
    if rollouts.ended.any() or not rollouts.one_reward:
        return ""
    return (
        "a calibration needs episodes that reach something: none of "
        f"{len(rollouts.lengths)} ended, and each of their {rollouts.predicted.size:,} steps had "
        f"the reward {rollouts.returns[0] / rollouts.lengths[0]:g}"
    )


def mostly_zero(rollouts: GreedyRollouts) -> str:
    """Return a refusal if phi is 0 in most steps, else ""."""
    zero = float((rollouts.predicted == 0).mean())
    if zero <= 1 - MIN_NONZERO:
        return ""
    return (
        "a calibration needs a potential that is not 0 where its greedy policy leads: phi was 0 in "
        f"{zero:.0%} of {rollouts.predicted.size:,} steps, in {len(rollouts.lengths)} episodes"
    )


def poor_fit(
    potential: Any,
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
    observed = isinstance(potential, ObservationPotential)
    highest = -math.inf if observed else _survey(potential)[0]
    highest_seen = float(rollouts.predicted.max())
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


# -- of a cautious calibration ---------------------------------------------------------------------


def unsuited(potential: Any) -> str:
    """Return a refusal that phi alone shows, before any episode, else ""."""
    if isinstance(potential, ObservationPotential):
        return ""
    highest, zero = _survey(potential)
    if zero > 1 - MIN_NONZERO:
        return (
            "a cautious calibration needs a potential that is not 0: this one is in "
            f"{zero:.0%} of all pairs"
        )
    return gains(highest)


def gains(highest: float) -> str:
    """Return a refusal if phi is above 0 somewhere, else ""."""
    if not highest > 0:
        return ""
    return (
        "a cautious calibration is for costs, potentials that are nowhere above 0: this one is "
        f"{highest:.3g} somewhere, and a factor would raise that"
    )


def highest_met(rollouts: GreedyRollouts) -> float:
    """Return the highest value of phi that the episodes met."""
    return float(max(rollouts.predicted.max(), rollouts.bootstrapped_value.max()))


def too_long(rollouts: GreedyRollouts, cap: int | None) -> str:
    """Return a refusal if the first episode shows that the steps are not enough, else ""."""
    if cap is None or len(rollouts.lengths) > 1 or rollouts.lengths[0] * LEAST_EPISODES <= cap:
        return ""
    return (
        f"a cautious calibration needs {LEAST_EPISODES} episodes, for which {cap:,} steps are too "
        f"few: the first took {rollouts.lengths[0]:,}"
    )


def is_stuck(evidence: ScaleEvidence) -> bool:
    """Return whether two episodes led nowhere, at more than phi says: five would tell no more."""
    return evidence.stuck and evidence.episodes > 1 and evidence.scale > LARGEST_CAUTIOUS**2


def is_known(evidence: ScaleEvidence, *, late: bool) -> bool:
    """Return whether further episodes would hardly change the answer, or are not worth it."""
    if is_stuck(evidence):
        return True
    if late and not evidence.scale >= WORTH:
        return True
    if evidence.episodes < LEAST_EPISODES:
        return False
    scale, scale_error = evidence.scale, evidence.scale_error
    # Returns have long tails, so a standard error of few episodes is too small, below the mean.
    enough = late or evidence.episodes >= 2 * LEAST_EPISODES
    hopeless = not scale + 2 * scale_error > 1 or not evidence.slope + 2 * evidence.slope_error > 0
    if enough and hopeless:
        return True
    largest = scale - 2 * scale_error > LARGEST_CAUTIOUS**2
    return not too_little(evidence) and (largest or scale_error < PRECISE * scale)


def too_little(evidence: ScaleEvidence) -> str:
    """Return a refusal unless the episodes bear out a scale above 1."""
    if is_stuck(evidence):
        return ""
    scale, scale_error, slope, slope_error, episodes, _ = evidence
    if not scale >= WORTH:
        return (
            "a cautious calibration makes a potential larger, where its policy costs more than it "
            f"predicts: a factor of {scale:.3g}, fitted to "
            f"{counted(episodes, 'episode')}, is not worth it"
        )
    if episodes < LEAST_EPISODES:
        return f"a cautious calibration needs {LEAST_EPISODES} episodes: it had {episodes}"
    if not math.isfinite(slope):
        return (
            f"a calibration needs a potential that differs: phi was the same in all {episodes} "
            "episodes"
        )
    if not scale - 2 * scale_error > 1:
        return (
            "a cautious calibration makes a potential larger, where its policy costs more than it "
            f"predicts: the factor {scale:.3g} is not above 1 by two standard errors of "
            f"{scale_error:.2g}"
        )
    if not slope - 2 * slope_error > 0:
        return (
            "a cautious calibration needs a potential that tells good steps from bad: with each 1 "
            f"of phi the value one step on rises by {slope:.3g}, standard error {slope_error:.2g}"
        )
    return ""


def _survey(potential: StateActionPotential | MappedPotential) -> tuple[float, float]:
    """Return the highest phi(s, a), and the share of pairs in which it is 0, terminal states aside.

    The same pairs are read of every kind of potential: all, or a sample where there are very many.
    """
    model = generative_model(potential.task)
    n_states, n_actions = model.states.size, model.actions.size
    searched = min(n_states, max(1, LARGEST_SEARCHED // n_actions))
    states = np.arange(searched)
    if searched < n_states:
        states = np.random.default_rng(0).integers(n_states, size=searched)
    if model.terminal is not None:
        states = states[~model.terminal[states]]
    highest, zeros = -math.inf, 0
    for part in np.array_split(states, max(1, len(states) * n_actions // CHUNK)):
        values = potential.rows(part)
        highest = max(highest, float(values.max(initial=-math.inf)))
        zeros += int((values == 0).sum())
    return highest, zeros / max(1, len(states) * n_actions)
