"""Verdicts: whether an arm gains more than its rivals, from one return for each arm and seed.

Each question has its own family of tests, so that no answer depends on other questions. The
questions: do curricula pay (gain more than their opponents), do they gain more than their controls,
more than their placebos and constants, more than a stated arm? All use sign-flip tests of paired
differences. The p-value of K seeds is at least 2^(1 - K), so that too few seeds give no verdict.

A placebo draws other values for each seed, while what a curriculum knows is nearly the same for all
seeds. If it knows nothing, its mean return is one draw among K, not the mean of K draws: it is
compared with the spread of single draws (:func:`_beside_draws`).

Sources: Holm 1979; Berger, "Multiparameter hypothesis testing and acceptance sampling",
Technometrics 24, 1982 (intersection-union tests); Hedges, Gurevitch and Curtis, "The meta-analysis
of response ratios in experimental ecology", Ecology 80, 1999; Guenther, "Sample size formulas for
normal theory t tests", American Statistician 35, 1981.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtr

from curricle.arrays import BoolArray, FloatArray
from curricle.checks import whole_number
from curricle.errors import SettingError
from curricle.statistics.curves import ROUNDING, Times
from curricle.statistics.hypothesis_tests import holm, sign_flip_tests, smallest_p
from curricle.statistics.intervals import Interval, check_each, mean_interval, vector
from curricle.text import brief_repr, printed
from curricle.transfer.transfer import FOUND

SIGNIFICANT = 0.05  # adjusted p-values below this count as a difference
DRAWS, DRAWS_A_TEST = 10_000, 100
"""Fewest sign vectors to draw where there are too many seeds to count all; and how many to draw for
each test of a family, so that the smallest p-value can stay significant when it is adjusted."""
POWER = 0.8  # of studies that show a gain, with as many seeds as are recommended
UNLIKELY = 1e-12  # probability of what is taken not to happen


@dataclass(frozen=True, eq=False)
class Verdict:
    """The answer to whether an arm gains more than all of its rivals.

    Attributes
    ----------
    gain : Interval
        Interval of the smallest true difference in return between the arm and a rival.
    rival : str
        The strongest rival: the rival with the highest mean return.
    rivals : int
        Number of rivals, n.
    p, adjusted_p : float
        Two-sided p-value of no difference (:func:`verdicts_of`); and the same corrected for the
        number of questions in the family (Holm) and of looks.
    seeds, needed : int
        Seeds K, and the fewest with which there can be a verdict.
    interim : str
        As in :func:`verdicts_of`.
    """

    gain: Interval
    rival: str
    rivals: int
    p: float
    adjusted_p: float
    seeds: int
    needed: int
    interim: str = ""

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def withheld(self) -> str:
        """Why there is no verdict: too few seeds, or seeds are missing; empty if there is one."""
        return self.interim or too_few_seeds(self.seeds, self.needed)

    @property
    def direction(self) -> int:
        """1 if the arm is shown to gain more than every rival, -1 if less than a rival, else 0."""
        shown = not self.withheld and self.adjusted_p < SIGNIFICANT
        return int(np.sign(self.gain.estimate)) if shown else 0

    @property
    def against_scratch(self) -> str:
        """The answer to whether a curriculum pays."""
        answers = ("no difference shown", "pays", "costs more than it brings")
        return self.withheld or answers[self.direction]

    @property
    def answer(self) -> str:
        """Whether the arm gains more than all rivals: "yes", "no, less" or "not shown"."""
        return self.withheld or ("not shown", "yes", "no, less")[self.direction]

    def __str__(self) -> str:
        """Return the answer with the gain, such as ``yes, +3.1 [1.2, 5.0] (p = 0.004)``."""
        gain, _, _ = str(self.gain).rpartition(", ")
        answer = f"{self.answer}, {'+' * (float(self.gain.estimate) > 0)}{gain}"
        return answer if self.withheld else f"{answer} (p = {self.adjusted_p:.2g})"


def verdicts_of(
    returns: Mapping[str, npt.ArrayLike],
    rivals: Mapping[str, Sequence[str]],
    *,
    interim: str = "",
    looks: Sequence[int] = (),
    placebos: Collection[str] = (),
) -> dict[str, Verdict]:
    """Return for each arm in `rivals` whether it gains more than all of its rivals.

    Let p_c be the p-values of an arm's n paired differences. If the arm is ahead of all rivals,
    p = max_c p_c (all n claims must hold: an intersection-union test, which needs no correction);
    else p = n min p_c over the rivals ahead of it. If p below 5 % decides, each wrong answer has a
    probability of at most 2.5 %. The interval is [min_c low_c, min_c high_c] of lower bounds at
    97.5 % and upper bounds at 1 - 0.025 / n: it covers the smallest true difference in 95 % of
    studies. Skewed differences can make p fall below 5 % although the interval, which is Student's,
    holds 0: then p is that of Student's tests too.

    Parameters
    ----------
    returns : dict of str to (K,) float64
        One return for each arm and seed; the k-th returns of all arms are paired.
    rivals : dict of str to sequence of str
        The questions: arms, each with at least one rival. Holm corrects for their number.
    interim : str
        Text that says that seeds are missing; then there is no verdict, and p-values are NaN.
    looks : sequence of int
        Numbers of seeds with which verdicts could be seen before seeds were added. Adjusted
        p-values are multiplied by the number of looks, this one included (Bonferroni).
    placebos : collection of str
        Rivals that have another draw of random values for each seed.

    Returns
    -------
    dict of str to Verdict
        In the order of the questions.

    Raises
    ------
    SettingError
        If an arm is unknown, has no rival or another number of seeds, or a return is not finite.

    Examples
    --------
    >>> scratch = np.array([1.0, 2.0, 3.0, 2.5, 1.5, 2.0, 3.5])
    >>> gain = np.array([1.0, 2.0, 1.5, 1.0, 2.5, 2.0, 1.0])
    >>> verdict = verdicts_of({"scratch": scratch, "a": scratch + gain}, {"a": ["scratch"]})["a"]
    >>> verdict.against_scratch, verdict.p
    ('pays', 0.015625)
    """
    if not rivals:
        return {}
    arrays = {name: vector(f"returns of {name!r}", values) for name, values in returns.items()}
    for name, of_name in rivals.items():
        if not of_name:
            raise SettingError(f"an arm to be compared needs a rival: {name!r} has none")
        for arm in (name, *of_name):
            if arm not in arrays:
                raise SettingError(f"an arm to be compared needs returns: {arm!r} has none")
            if (size := arrays[arm].size) != arrays[name].size:
                raise SettingError(
                    f"returns must be of the same seeds: {name!r} has {arrays[name].size}, {arm!r} "
                    f"{size}"
                )
    apart = {
        name: np.stack(
            [
                (_beside_draws if rival in placebos else difference)(arrays[name], arrays[rival])
                for rival in of_name
            ]
        )
        for name, of_name in rivals.items()
    }
    times = 1 + len(earlier_looks(looks, len(apart), arrays[next(iter(apart))].size))
    draws = _draws(times * sum(map(len, apart.values())))
    p = [math.nan] * len(apart) if interim else _p_values([*apart.values()], draws)
    adjusted_p = p if interim else np.minimum(times * holm(p), 1.0).tolist()
    needed, verdicts = seeds_needed(times * len(apart)), {}
    for (name, rows), p_value, adjusted in zip(apart.items(), p, adjusted_p, strict=True):
        n, seeds = rows.shape
        strongest = rivals[name][int(rows.mean(axis=1).argmin())]
        gain = _smallest_gain(rows)
        verdicts[name] = Verdict(gain, strongest, n, p_value, adjusted, seeds, needed, interim)
    return verdicts


def seeds_needed(questions: int = 1) -> int:
    """Return the fewest seeds K with which there can be a verdict.

    This is the smallest K whose smallest p-value, 2^(1 - K), is below 0.05 after multiplication by
    the number of questions (one for each arm), as in Holm's correction.

    Examples
    --------
    >>> [seeds_needed(arms) for arms in (1, 2, 3, 4, 6, 7)]
    [6, 7, 7, 8, 8, 9]
    """
    tests, seeds = whole_number("questions", questions, 1, SettingError), 2
    draws = _draws(tests)
    while tests * smallest_p(seeds, draws) >= SIGNIFICANT:
        seeds += 1
    return seeds


def seeds_to_show(differences: FloatArray, questions: int = 1) -> int:
    """Return the seeds with which 80 % of studies show that an arm gains more than n rivals.

    Their true differences are the means of `differences`, (n, K); errors are normal with the
    covariance of the K seeds. Student's test needs q^2 / 2 seeds more than the normal (Guenther
    1981), where q is the quantile that the rivals' statistics exceed. SettingError unless all means
    are above 0.

    Examples
    --------
    >>> noise = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    >>> [seeds_to_show(np.stack([gain + noise])) for gain in (3.0, 1.0, 0.5)]
    [8, 22, 79]
    """
    means, spread = differences.mean(axis=1), differences.std(axis=1, ddof=1)
    check_each("gains must be above 0", means > 0, means, "rival")
    seeds = differences.shape[1]
    apart = (differences - means[:, np.newaxis]) / np.where(spread > 0, spread, 1)[:, np.newaxis]
    errors = np.random.default_rng(0).normal(size=(DRAWS, seeds)) @ apart.T / math.sqrt(seeds - 1)
    q = float(ndtri(1 - SIGNIFICANT / 2 / questions))
    enough = (np.maximum(q - errors, 0) * spread / means).max(axis=1) ** 2
    fewest = seeds_needed(questions) + 2  # with fewer, nearly all differences must have one sign
    return max(fewest, math.ceil(float(np.quantile(enough, POWER)) + q**2 / 2))


def earlier_looks(looks: Sequence[int], questions: int, seeds: int) -> list[int]:
    """Return the numbers of seeds, below the present one, with which there was a verdict."""
    fewest = seeds_needed(questions)
    return [number for number in looks if fewest <= number < seeds]


def too_few_seeds(seeds: int, needed: int) -> str:
    """Return the text that there are too few seeds for a verdict; empty if there are enough."""
    return f"too few seeds for a verdict ({seeds}; {needed} or more)" if seeds < needed else ""


def difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return first - second (K,); 0 where they differ by no more than rounding, NaN with a NaN."""
    noise = ROUNDING * np.maximum(np.abs(first), np.abs(second))
    apart = np.subtract(first, second)
    return np.where(np.abs(apart) < noise, 0.0, apart)


def _beside_draws(returns: FloatArray, placebo: FloatArray) -> FloatArray:
    """Return differences (K,) with the mean of ``returns - placebo`` and a single draw's spread.

    Their standard error is ``std(placebo) sqrt(1 + 1 / K)``, that of a new draw about the mean of K
    draws, so that their Student interval is the prediction interval.
    """
    spread = difference(placebo, np.full_like(placebo, placebo.mean()))
    judged: FloatArray = difference(returns, placebo).mean() + math.sqrt(len(placebo) + 1) * spread
    return judged


def _draws(tests: int) -> int:
    """Return how many sign vectors a test draws, in a family of so many tests."""
    return max(DRAWS, DRAWS_A_TEST * tests)


def _p_values(apart: Sequence[FloatArray], draws: int) -> list[float]:
    """Return the p of each arm's differences from n rivals (n, K), as in :func:`verdicts_of`."""
    p_values = [math.nan] * len(apart)
    for seeds in {rows.shape[1] for rows in apart}:  # arms with as many seeds share their signs
        alike = [k for k, rows in enumerate(apart) if rows.shape[1] == seeds]
        z = [_standardised(apart[k]) for k in alike]
        likeliest = [apart[k][of_arm.argmin()] for k, of_arm in zip(alike, z, strict=True)]
        first = sign_flip_tests(np.stack(likeliest), resamples=draws)
        others = [_may_decide(*pair, seeds, draws) for pair in zip(z, first, strict=True)]
        rows = np.concatenate([apart[k][which] for k, which in zip(alike, others, strict=True)])
        later = iter(sign_flip_tests(rows, resamples=draws))
        for k, p, which in zip(alike, first, others, strict=True):
            # The p of rivals that are not tested decides nothing.
            of_rivals = np.array([next(later) if tested else p for tested in which])
            p_values[k] = _p_value(apart[k], of_rivals)
    return p_values


def _standardised(rows: FloatArray) -> FloatArray:
    """Return ``z = sum_k d_k / sqrt(sum_k d_k^2)`` of each row of differences; 0 if all are 0."""
    with np.errstate(invalid="ignore"):  # of infinite differences, which the tests refuse
        scaled = rows / (np.abs(rows).max() or 1.0)
    norms = np.sqrt((scaled**2).sum(axis=1))
    z: FloatArray = scaled.sum(axis=1) / np.where(norms > 0, norms, 1.0)
    return z


def _may_decide(z: FloatArray, p: float, seeds: int, draws: int) -> BoolArray:
    """Return the rivals that may decide an arm's p, besides that of the lowest z, whose p is `p`.

    Random signs make a sum as far from 0 with a probability of at most b = 2 exp(-z^2 / 2)
    (Hoeffding 1963). So at least c of N random vectors do with one of at most (e N b / c)^c
    (Chernoff), and where that is below 1e-12 the rival's p is not the largest.
    """
    may: BoolArray
    if (z > 0).all():
        may = draws * p * (math.log(p / 2) + z**2 / 2 - 1) < -math.log(UNLIKELY)
    else:  # the smallest p decides
        may = (z < 0) & (p > smallest_p(seeds, draws))
    may[z.argmin()] = False
    return may


def _p_value(differences: FloatArray, p_values: FloatArray) -> float:
    """Return the p of an arm's differences from its rivals, by flips and by Student's tests."""
    p, gain = _of_all(differences, p_values), _smallest_gain(differences)
    if p >= SIGNIFICANT or not gain.low <= 0 <= gain.high:
        return p
    k = differences.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):  # without a spread
        t = differences.mean(axis=1) / differences.std(axis=1, ddof=1) * math.sqrt(k)
    return max(SIGNIFICANT, _of_all(differences, 2 * stdtr(k - 1, -abs(t))))


def _of_all(differences: FloatArray, p_values: npt.ArrayLike) -> float:
    """Return the p-value against all n rivals from the p-values against single rivals."""
    p, means = np.asarray(p_values), differences.mean(axis=1)
    if (means > 0).all():
        return float(p.max())
    return min(1.0, len(p) * float(p[means < 0].min(initial=1.0)))


def _smallest_gain(differences: FloatArray) -> Interval:
    """Return the interval of the smallest of n true differences, from the differences (n, K)."""
    means, levels = differences.mean(axis=1), [1 - SIGNIFICANT / n for n in (1, len(differences))]
    below, above = (mean_interval(differences.T, confidence=level) for level in levels)
    bounds = np.array([below.low, above.high])
    if not np.isnan(bounds).all():  # a difference without a spread, beside others, is its mean
        bounds = np.where(np.isnan(bounds), means, bounds)
    low, high = bounds.min(axis=1).tolist()
    return Interval(float(means.min()), low, high, 1 - SIGNIFICANT, n=differences.shape[1])


def steps_saved_share(arm: Times, opponents: Sequence[Times]) -> Interval:
    """Return the share of the quickest opponent's steps to the threshold that an arm saves.

    ``1 - mean(A) / min_c mean(B_c)`` of the steps A of the arm and B_c of n opponents, (K,). The
    interval is that of the smallest of the n true log ratios ``ln(mean(B_c) / mean(A))``, as in
    :func:`verdicts_of`, by the linear part of their errors (Hedges et al. 1999).

    A seed that never reaches the threshold counts with a lower bound of its steps. If the quickest
    opponent has such seeds, the share is at least the estimate, and `high` is that of opponents
    without them, or 1; if the arm has, it is at most the estimate, and `low` is -inf. It is NaN if
    both have, or if the opponent takes no step.

    Examples
    --------
    >>> fast, slow = (Times(np.array(k), np.ones(4, bool)) for k in ([3, 4, 5, 4], [9, 8, 7, 8]))
    >>> print(steps_saved_share(fast, [slow]))
    0.500 [0.186, 0.693], 4 seeds
    """
    mean, means = arm.steps.mean(), np.array([times.steps.mean() for times in opponents])
    complete = np.array([times.reached.all() for times in opponents])
    share = Interval(math.nan, math.nan, math.nan, 1 - SIGNIFICANT, arm.steps.size)
    if means.min() == 0 or not (arm.reached.all() or complete[means.argmin()]):
        return share
    if mean == 0:
        return replace(share, estimate=1.0)
    rows = np.stack([times.steps for times in opponents]) / means[:, np.newaxis] - arm.steps / mean
    rows += np.log(means / mean)[:, np.newaxis]
    ratio = _smallest_gain(rows)
    if not np.isnan(ratio.low):
        low, high = ratio.low if arm.reached.all() else -math.inf, math.inf
        if complete.any():
            above = _smallest_gain(rows[complete])
            high = float(np.nanmax([above.high, above.estimate]))  # no bound without a spread
        share = replace(share, low=-math.expm1(-low), high=-math.expm1(-high))
    return replace(share, estimate=-math.expm1(-ratio.estimate))


NO_MORE = "not shown to gain more than from an unrelated task"
NOT_KNOWN = "by what it knows? Not known without"
ASKING = 'controls = ["placebo"] and constants (optimistic learners have none)'
"""How to ask why a curriculum pays, in a study file and, as an argument, of ``compare``."""

Why = Literal["", "not known", "knowledge", "mapping", "placebo", "not shown"]


@dataclass(frozen=True)
class Reason:
    """Whether a curriculum pays by what it knows."""

    pays: Verdict = field(repr=False)  # does it gain more than its opponents?
    # Does it gain more than its placebos and constants? None if it has no placebos or constants.
    over_nothing: Verdict | None
    knows_target: bool = False  # did a search find a mapping in the target's model?
    # Does it gain more than its unrelated control? None if this was not asked.
    over_unrelated: Verdict | None = None

    __repr__ = brief_repr

    @property
    def why(self) -> Why:
        """The reason; empty unless the curriculum is shown to pay."""
        over = self.over_nothing
        if self.pays.direction <= 0:
            return ""
        if over is None:
            return "not known"
        if over.direction > 0:
            # A gain may come from a search that read the target's model instead of from the source.
            return "mapping" if self.knows_target else "knowledge"
        return "placebo" if over.direction < 0 else "not shown"

    @property
    def words(self) -> str:
        """The reason as text, with a remark on a mapping found in the target's model."""
        reasons = {
            "knowledge": "by what it knows",
            "mapping": "by its source or by the search for its mapping",
            "placebo": "not by what it knows: a placebo gains more",
            "not shown": "not shown to be by what it knows",
        }
        unrelated = self.over_unrelated
        no_more = self.pays.direction > 0 and unrelated is not None and unrelated.direction <= 0
        return ", ".join(
            filter(None, (reasons.get(self.why), NO_MORE * no_more, FOUND * self.knows_target))
        )
