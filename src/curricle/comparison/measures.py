"""Compared arms: their curves in a common target, and what is measured on them.

All arms spend the same total of steps, source steps included. Seed k of every arm draws from the
same random stream in the target.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import one_of
from curricle.comparison.controls import ALONE, PLACEBO, UNRELATED
from curricle.comparison.verdicts import (
    Reason,
    Verdict,
    difference,
    earlier_looks,
    steps_saved_share,
    verdicts_of,
)
from curricle.curriculum.curriculum import Node
from curricle.errors import CurriculumError
from curricle.learning.result import LearningResult
from curricle.planning.policy_evaluation import RolloutEvaluation
from curricle.planning.target import STANDARD_ERRORS, Target, possible_returns
from curricle.statistics.curves import (
    ROUNDING,
    SCRATCH,
    Curve,
    Times,
    asymptotic_performance,
    charge_source,
    fraction_of_optimum,
    jumpstart,
    mean_return,
    midpoint,
    time_to_threshold,
)
from curricle.statistics.hypothesis_tests import probability_of_improvement
from curricle.statistics.intervals import Interval, extremes, mean_interval
from curricle.text import brief_repr
from curricle.transfer.rollouts import ObservationTarget, random_play, target_of

FRACTION = 0.9  # of the way from the random policy's return to the optimum: the default threshold
# The sources of a threshold:
STATED, OF_OPTIMUM = "stated", "nine tenths of the way to the optimum"
MIDPOINT = "midpoint of scratch's curve: no optimum above random play is known"


@dataclass(frozen=True)
class Reference:
    """The returns in a target that arms are measured by.

    Attributes
    ----------
    threshold : float or None
        Return that counts as learnt; None before training if scratch's curve will give it.
    threshold_from : str
        The source of the threshold, as text.
    random_return, optimum : float or None
        Returns of the uniformly random and of an optimal policy. The optimum is None where the
        target cannot be solved, or is not solved because the threshold was stated.
    optimum_bounds : bool
        Whether it is proven that no policy returns more than the optimum.
    random_error, random_noise : float
        Standard error of the random policy's return, 0 where it is exact; and the standard
        deviation of one evaluation of it, 0 where evaluations are exact.
    possible : (float, float) or None
        Lowest and highest return of an episode, within which intervals of mean returns end; None
        where the tables do not tell, and then the extremes of the curves stand in.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> from curricle.planning import Target
    >>> reference = Reference.of(Target.of(GridWorld("S.T", discount=0.5)))
    >>> reference.optimum, reference.threshold_from
    (98.5, 'nine tenths of the way to the optimum')
    """

    threshold: float | None
    threshold_from: str = ""
    random_return: float | None = None
    optimum: float | None = None
    possible: tuple[float, float] | None = None
    random_error: float = 0.0
    random_noise: float = 0.0
    optimum_bounds: bool = False

    @classmethod
    def of(cls, target: Target | ObservationTarget, stated: float | None = None) -> Self:
        """Return the reference before training, with a stated threshold or the default."""
        reference = cls(stated, MIDPOINT if stated is None else STATED)
        if isinstance(target, ObservationTarget) or target.solution is None:
            return reference
        best, worst, bounds = target.optimum, target.random_return, target.optimum_bounds
        reference = replace(reference, random_return=worst, optimum=best, optimum_bounds=bounds)
        # Undiscounted, the policy that is optimal with the discount need not beat a random one.
        if stated is not None or best <= worst or reference.nothing_to_learn:
            return reference
        threshold = fraction_of_optimum(best, worst, FRACTION)
        return replace(reference, threshold=threshold, threshold_from=OF_OPTIMUM)

    @classmethod
    def before(
        cls, node: Node, stated: float | None, target: Target | ObservationTarget | None = None
    ) -> Self:
        """Return :meth:`of` the task of a node, with what is known of its random policy.

        The task is solved unless the threshold is stated; `target` is the task solved before.
        """
        possible = possible_returns(node.task, node.evaluation.discount(node.task))
        if stated is None and target is None:
            target = target_of(node.task, node.evaluation)
        reference = cls(stated, STATED) if target is None else cls.of(target, stated)
        reference = replace(reference, possible=possible)
        sampled = node.deep or isinstance(node.evaluation.kernel(node.task), RolloutEvaluation)
        if reference.random_return is not None and not sampled:
            return reference
        random, one_evaluation = random_play(node.task, node.evaluation)
        reference = replace(reference, random_noise=one_evaluation if sampled else 0.0)
        if reference.random_return is not None:
            return reference
        return replace(reference, random_return=random.value, random_error=random.noise)

    @property
    def nothing_to_learn(self) -> bool:
        """Whether the random policy is optimal, up to rounding."""
        best, worst = self.optimum, self.random_return
        if best is None or worst is None:
            return False
        return math.isclose(best, worst, rel_tol=ROUNDING)

    def after(self, scratch: Curve) -> Self:
        """Return the reference after training: midway up scratch's curve without a threshold."""
        return replace(self, threshold=midpoint(scratch)) if self.threshold is None else self


@dataclass(frozen=True, eq=False)
class Arm:
    """The curves of an arm over target steps, up to the total budget of the comparison.

    Attributes
    ----------
    curve : Curve
        Greedy return (K, T), with the source steps of each seed.
    scratch : bool
        Whether the arm is an opponent: it learns the target without sources, for all steps.
    curriculum : str
        The arm that this arm changes in one thing, as a control or as a constant of it; empty for
        a curriculum, and for opponents that belong to none.
    initial_values : (K,) float64 or None
        The value at which the Q of a constant opponent starts in every state.
    unlearnt : dict of str to (K,) bool
        For each source, the seeds that did not learn its task by its stopping rule.
    knows_target : bool
        Whether a search found a mapping of its curriculum in the target's model.
    network : bool
        Whether a network learns the target, which has no constant to start at.

    Examples
    --------
    >>> flat, steps = np.zeros((2, 3)), np.array([0, 10, 20])
    >>> arm = Arm(Curve(steps, flat + 4, np.array([10, 10])))
    >>> arm.charged(Arm(Curve(steps, flat))).values
    array([[0., 4., 4.],
           [0., 4., 4.]])
    """

    curve: Curve
    scratch: bool = False
    curriculum: str = ""
    initial_values: FloatArray | None = field(default=None, repr=False)
    unlearnt: Mapping[str, BoolArray] = field(default_factory=dict, repr=False)
    knows_target: bool = False
    network: bool = False

    __repr__ = brief_repr

    @classmethod
    def of(
        cls,
        result: LearningResult,
        spent: IntArray,
        steps: tuple[int, int],
        seeds: Sequence[int],
        *,
        unlearnt: Mapping[str, BoolArray],
        initial_values: FloatArray | None,
        **about: Any,
    ) -> Self:
        """Return some of a learning result's seeds as an arm; `about` are its other fields.

        `steps` are the total and those between checkpoints. Seed k learns for total - spent_k
        steps, after which its last value is repeated.
        """
        total, eval_freq = steps
        if spent.max() > total:
            raise CurriculumError(
                f"sources must take at most the total of {total:,} steps: got {spent.max():,}"
            )
        rows, at = np.searchsorted(result.seeds, seeds), np.arange(0, total + 1, eval_freq)
        last = np.minimum((total - spent[rows]) // eval_freq, len(result.steps) - 1)
        place = np.minimum(np.arange(len(at)), last[:, None])
        greedy = np.take_along_axis(result.greedy_return[rows], place, axis=1)
        return cls(
            Curve(at, greedy, spent[rows]),
            initial_values=None if initial_values is None else initial_values[rows],
            unlearnt={source: of_seeds[rows] for source, of_seeds in unlearnt.items()},
            **about,
        )

    @property
    def control(self) -> bool:
        """Whether the arm is a control, which is charged as many steps as its curriculum."""
        return bool(self.curriculum) and not self.scratch

    def charged(self, scratch: "Arm") -> Curve:
        """Return the curve over total steps, source steps included (``charge_source``)."""
        return charge_source(scratch.curve, self.curve)


NAN = float("nan")
UNKNOWN = Interval(NAN, NAN, NAN, 0.95, 0)


@dataclass(frozen=True, eq=False)
class Contrast:
    """An arm against learning from scratch, over K seeds.

    Gains are returns, over the best opponent, which learns the target without sources. Where there
    are several opponents, the strong gain is an interval for the smallest of the true gains. Weak
    transfer ignores source steps and covers the target's budget. Strong transfer charges source
    steps and covers the total budget.

    Attributes
    ----------
    jumpstart : Interval
        Gain at the first target step (weak).
    weak_steps_saved : Interval
        Steps to the threshold saved; a seed that never reaches it counts with the whole budget.
    share_of_steps_saved : Interval
        As a share of those of the opponent that takes the fewest (strong).
    weak_gain, strong_gain : Interval
        Difference of the normalised areas under the curves.
    asymptotic_gain : Interval
        Gain at the end of the total budget (strong).
    probability_of_improvement : Interval
        Probability that a run of the arm has the larger area under its curve (strong).
    p, adjusted_p : float
        Two-sided p-value of no strong gain, by flipping the signs of the paired differences; and
        the same corrected for the number of curricula (Holm), NaN for a control.
    verdict, reason : str
        The verdict is "pays", "costs more than it brings", "no difference shown" or too few seeds;
        the reason is such as "by what it knows". Empty for a control, or where it was not asked.
    """

    jumpstart: Interval
    weak_steps_saved: Interval
    share_of_steps_saved: Interval
    weak_gain: Interval
    strong_gain: Interval
    asymptotic_gain: Interval
    probability_of_improvement: Interval
    p: float
    adjusted_p: float
    verdict: str
    reason: str = ""

    __repr__ = brief_repr

    @property
    def answer(self) -> str:
        """The verdict with its reason, such as "pays, by what it knows"."""
        return ", ".join(filter(None, (self.verdict, self.reason)))


MEASURES = tuple(part.name for part in fields(Contrast) if part.type is Interval)
NOTHING: Any = dict.fromkeys(MEASURES, UNKNOWN) | {"p": NAN, "adjusted_p": NAN, "verdict": ""}
NO_CONTRAST = Contrast(**NOTHING)


@dataclass(frozen=True, eq=False)
class MeasuredArms:
    """Arms of K seeds on one axis, and what is measured on them; a :class:`Comparison` prints."""

    target: str
    arms: Mapping[str, Arm]
    budget: int
    total: int
    reference: Reference
    window: int
    failed: Mapping[str, Exception] = field(default_factory=dict)
    interim: str = ""
    looks: tuple[int, ...] = ()
    remarks: tuple[str, ...] = ()
    # Steps to the threshold that were found before, by arm and whether transfer is strong.
    _times: dict[tuple[str, bool], Times] = field(default_factory=dict, init=False, repr=False)

    def __getitem__(self, name: str) -> Arm:
        one_of("an arm", name, self.arms, CurriculumError)
        return self.arms[name]

    @property
    def threshold(self) -> float:
        """The return that counts as learnt; NaN where nobody learnt."""
        assert self.reference.threshold is not None, "scratch is trained before it is compared"
        return NAN if self.nobody else self.reference.threshold

    @cached_property
    def nobody(self) -> str:
        """The text that nobody learnt; empty if an arm is above random play, or that is unknown.

        An arm is above it if its mean return, or its return in the end, is so by more than noise:
        of the mean over K seeds by two standard errors, or of a single seed by as many more as the
        largest of all seeds has by chance.
        """
        random, noise = self.reference.random_return, self.reference.random_noise
        error, best = self.reference.random_error, self.reference.optimum
        # Random play may be the best where returns are judged by another discount than learnt.
        if random is None or (best is not None and best <= random + ROUNDING * abs(random)):
            return ""
        ends = (asymptotic_performance(arm.charged(self.scratch)) for arm in self.arms.values())
        heights = np.stack([*self.returns.values(), *ends])
        largest = STANDARD_ERRORS + math.sqrt(2 * math.log(heights.size))
        of_mean = STANDARD_ERRORS * math.hypot(error, noise / math.sqrt(self.seeds))
        of_seed = largest * math.hypot(error, noise)
        level = random + ROUNDING * abs(random)
        means = heights.mean(axis=1)
        learnt = (means > level + of_mean).any() or (heights > level + of_seed).any()
        return "" if learnt or np.isnan(means).any() else "nobody learnt"

    @property
    def threshold_from(self) -> str:
        """The source of the threshold, as text; empty where nobody learnt."""
        return "" if self.nobody else self.reference.threshold_from

    @property
    def baseline(self) -> str:
        """The first opponent: scratch, unless runs of another program have other names."""
        return SCRATCH if SCRATCH in self.arms else next(iter(self.arms))

    @property
    def scratch(self) -> Arm:
        """The arm in which the target's own learner learns it from scratch."""
        return self.arms[self.baseline]

    @cached_property
    def scratches(self) -> tuple[str, ...]:
        """The opponents: the arms that learn the target without sources, scratch first."""
        return tuple(name for name, arm in self.arms.items() if name == SCRATCH or arm.scratch)

    def opponents(self, name: str) -> tuple[str, ...]:
        """Return the opponents of an arm: all but the constants of other curricula."""
        curriculum = self.arms[name].curriculum or name
        kept = {"", curriculum}
        return tuple(arm for arm in self.scratches if self.arms[arm].curriculum in kept)

    def best_opponent(self, name: str) -> str:
        """Return the opponent of an arm with the highest mean return."""
        return max(self.opponents(name), key=lambda rival: float(self.returns[rival].mean()))

    def quickest_opponent(self, name: str) -> str:
        """Return the opponent of an arm with the fewest steps to the threshold, seeds' mean."""
        rivals = [self.best_opponent(name), *self.opponents(name)]  # the best if several are
        return min(rivals, key=lambda rival: float(self.times(rival).steps.mean()))

    def headroom(self, name: str) -> float:
        """Return the most that a source can gain, as a share of the way from random to the optimum.

        It is what the mean return of the arm's best opponent leaves below the optimum, at least 0;
        NaN where the optimum is unknown or not above random play.
        """
        best, random = self.reference.optimum, self.reference.random_return
        if best is None or random is None or best <= random or self.reference.nothing_to_learn:
            return NAN
        missing = best - self.returns[self.best_opponent(name)].mean()
        return float(np.maximum(0.0, missing / (best - random)))

    @cached_property
    def best_opponents(self) -> tuple[str, ...]:
        """The best opponents of curricula; the best learner where no arm has a source."""
        best = {self.best_opponent(name) for name in self.controls or [self.baseline]}
        return tuple(name for name in self.scratches if name in best)

    @cached_property
    def drawn(self) -> tuple[str, ...]:
        """The arms in figures: all but opponents that are neither scratch nor any arm's best."""
        kept = {self.baseline, *self.best_opponents}
        return tuple(name for name in self.arms if name in kept or name not in self.scratches)

    @property
    def shown(self) -> tuple[str, ...]:
        """The arms in printed tables: all but the constants that are no arm's best opponent."""
        return tuple(
            name for name, arm in self.arms.items() if name in self.drawn or not arm.curriculum
        )

    @property
    def seeds(self) -> int:
        """Number of seeds, K."""
        return len(self.scratch.curve.values)

    @cached_property
    def controls(self) -> dict[str, tuple[str, ...]]:
        """The controls of each curriculum."""
        return {
            name: tuple(
                other for other, arm in self.arms.items() if arm.curriculum == name and arm.control
            )
            for name, arm in self.arms.items()
            if not (name in self.scratches or arm.curriculum)
        }

    @property
    def placebos(self) -> dict[str, list[str]]:
        """The placebos of each curriculum."""
        return {
            name: [of for of in (f"{name}, {PLACEBO}", f"{name}, {ALONE}") if of in controls]
            for name, controls in self.controls.items()
        }

    @cached_property
    def know_nothing(self) -> dict[str, tuple[str, ...]]:
        """The placebos and constants of each curriculum; none if either kind is missing.

        A network starts at no level of values, so that its placebo alone is asked.
        """
        # Both kinds are needed: random values are learnt from more slowly than a single value.
        know_nothing: dict[str, tuple[str, ...]] = {}
        for name, placebos in self.placebos.items():
            constants = [rival for rival in self.scratches if self.arms[rival].curriculum == name]
            asked = placebos and (constants or self.arms[name].network)
            know_nothing[name] = (*placebos, *constants) if asked else ()
        return know_nothing

    @cached_property
    def returns(self) -> dict[str, FloatArray]:
        """The returns by which arms are judged: normalised areas under strong curves, (K,)."""
        return {name: mean_return(arm.charged(self.scratch)) for name, arm in self.arms.items()}

    def against(self, rival: str) -> dict[str, Verdict]:
        """Return whether each curriculum gains more than the arm `rival` (Holm over curricula)."""
        one_of("an arm", rival, self.arms, CurriculumError)
        return self._verdicts({name: (rival,) for name in self.controls if name != rival})

    def _verdicts(self, questions: Mapping[str, tuple[str, ...]]) -> dict[str, Verdict]:
        asked = {name: rivals for name, rivals in questions.items() if rivals}
        withheld = self.interim or self.nobody
        placebos = {label for of_name in self.placebos.values() for label in of_name}
        return verdicts_of(
            self.returns, asked, interim=withheld, looks=self.looks, placebos=placebos
        )

    @property
    def earlier(self) -> list[int]:
        """The numbers of seeds of earlier verdicts, for which p-values are corrected."""
        return earlier_looks(self.looks, max(1, len(self.controls)), self.seeds)

    @cached_property
    def verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum pays: gains more than each of its opponents."""
        return self._verdicts({name: self.opponents(name) for name in self.controls})

    @property
    def withheld(self) -> str:
        """Why there are no verdicts, as text; empty if there are verdicts."""
        nothing = self.interim or self.nobody
        return next((verdict.withheld for verdict in self.verdicts.values()), nothing)

    @cached_property
    def control_verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum that has controls gains more than all of them."""
        return self._verdicts(self.controls)

    @cached_property
    def knowledge_verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum gains more than all of its placebos and constants."""
        return self._verdicts(self.know_nothing)

    @cached_property
    def best_learner(self) -> Verdict | None:
        """Whether the best learner gains more than all others, where no arm has a source."""
        # All are asked, so that Holm's rule corrects for the choice of the best.
        others = {name: tuple({*self.scratches} - {name}) for name in self.scratches}
        (best,) = self.best_opponents if not self.controls else ("",)
        return self._verdicts(others).get(best) if best and others[best] else None

    @cached_property
    def unrelated_verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum with a found mapping gains more than its unrelated control."""
        # This control reads the target's model, so a mapping made by hand need not beat it.
        searched = (name for name in self.controls if self[name].knows_target)
        asked = {name: (f"{name}, {UNRELATED}",) for name in searched}
        return self._verdicts({name: of for name, of in asked.items() if of[0] in self.arms})

    @cached_property
    def reasons(self) -> dict[str, Reason]:
        """Whether each curriculum pays by what it knows."""
        over, unrelated = self.knowledge_verdicts, self.unrelated_verdicts
        return {
            name: Reason(pays, over.get(name), self[name].knows_target, unrelated.get(name))
            for name, pays in self.verdicts.items()
        }

    def times(self, name: str, *, strong: bool = True) -> Times:
        """Return an arm's steps to the threshold; seeds that never reach it are censored."""
        if (name, strong) not in self._times:
            curve = self[name].charged(self.scratch) if strong else self._weak(name)
            self._times[name, strong] = time_to_threshold(curve, self._level, window=self.window)
        return self._times[name, strong]

    @property
    def _level(self) -> float:
        """The threshold, or a value just above the threshold if scratch starts there."""
        if self.nobody:
            return sys.float_info.max
        start = float(self.scratch.curve.filled()[:, 0].mean())
        margin = ROUNDING * max(abs(self.threshold), abs(start))
        if not abs(start - self.threshold) <= margin:
            return self.threshold
        return float(np.nextafter(max(start, self.threshold) + margin, np.inf))

    def mean_return(self, name: str) -> Interval:
        """Return the mean over seeds of the normalised area under an arm's strong curve."""
        return self.interval(self.returns[name])

    @cached_property
    def within(self) -> tuple[float, float]:
        """The lowest and the highest return that an interval of a mean return may have."""
        if self.reference.possible is not None:
            return self.reference.possible
        return extremes([arm.curve.values for arm in self.arms.values()])

    def interval(self, returns: FloatArray) -> Interval:
        """Return the mean over seeds of returns, (K,) or (K, T), with its interval."""
        return mean_interval(returns).within(self.within)

    @cached_property
    def contrasts(self) -> dict[str, Contrast]:
        """Each arm against its best opponent; without gains where nobody learnt."""
        arms = [name for name in self.arms if name not in self.scratches]
        if self.nobody:
            of_verdict = {name: verdict.against_scratch for name, verdict in self.verdicts.items()}
            return {name: replace(NO_CONTRAST, verdict=of_verdict.get(name, "")) for name in arms}
        return {name: self._contrast(name) for name in arms}

    def _weak(self, name: str) -> Curve:
        """Return an arm's curve over the target's budget, without its source steps."""
        curve = self[name].curve
        n = int(np.searchsorted(curve.steps, self.budget, side="right"))
        return Curve(curve.steps[:n], curve.values[:, :n])

    def weak_gain(self, name: str, rival: str) -> Interval:
        """Return an arm's gain over another in mean return over target steps, sources free."""
        areas = [mean_return(self._weak(arm)) for arm in (name, rival)]
        return mean_interval(difference(*areas))

    def _contrast(self, name: str) -> Contrast:
        rival = self.best_opponent(name)
        of_arm, of_rival = self.returns[name], self.returns[rival]
        verdict, reason = self.verdicts.get(name), self.reasons.get(name)
        alone = verdict or self._verdicts({name: self.opponents(name)})[name]
        ends = [asymptotic_performance(self[arm].charged(self.scratch)) for arm in (name, rival)]
        return Contrast(
            jumpstart=mean_interval(jumpstart(self._weak(rival), self._weak(name))),
            weak_steps_saved=mean_interval(
                self.times(rival, strong=False).steps - self.times(name, strong=False).steps
            ),
            share_of_steps_saved=steps_saved_share(
                self.times(name), [self.times(opponent) for opponent in self.opponents(name)]
            ),
            weak_gain=self.weak_gain(name, rival),
            strong_gain=alone.gain,
            asymptotic_gain=mean_interval(difference(*ends)),
            # Returns within rounding are equal, as in gains.
            probability_of_improvement=probability_of_improvement(
                np.where(difference(of_arm, of_rival), of_arm, of_rival), of_rival
            ),
            p=alone.p,
            adjusted_p=NAN if verdict is None else verdict.adjusted_p,
            verdict="" if verdict is None else verdict.against_scratch,
            reason="" if reason is None else reason.words,
        )
