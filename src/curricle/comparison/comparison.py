"""Comparing curricula with learning the target from scratch, and with each other.

All arms spend the same total of steps, source steps included. Seed k of every arm draws from the
same random stream in the target. Arms with different targets are refused.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np

from curricle.arrays import BoolArray, FloatArray, IntArray
from curricle.checks import fit_name, instance, number, one_of, whole_number
from curricle.comparison.controls import ALONE, CONTROLS, PLACEBO, UNRELATED, Control, check_fit
from curricle.comparison.opponents import (
    OPPONENTS,
    Learners,
    Opponent,
    check_opponents,
    from_scratch,
    scratch_curricula,
)
from curricle.comparison.plan import (
    Failures,
    Memory,
    Plan,
    PlannedArm,
    Trained,
    check_comparable,
    check_evaluated,
)
from curricle.comparison.verdicts import Reason, Verdict, difference, not_known, verdicts_of
from curricle.curriculum.curriculum import Curriculum, Node
from curricle.display import COLOURS, OWN_COLOURS, block, curves, table
from curricle.errors import CurriculumError, SettingError, in_words
from curricle.learning.result import GREEDY_RETURN, LearningResult
from curricle.learning.seeds import seed_tuple
from curricle.learning.stopping import Episodes, StoppingRule
from curricle.planning.policy_evaluation import Target, possible_returns
from curricle.progress import Bars, Progress, check_progress, shown
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
    steps_saved,
    time_to_threshold,
)
from curricle.statistics.hypothesis_tests import probability_of_improvement
from curricle.statistics.intervals import (
    Interval,
    clusters,
    extremes,
    interquartile_interval,
    mean_interval,
    seed_line,
)
from curricle.text import UNBOUNDED, brief_repr, counted, folded, or_dash, shortened, text_table
from curricle.transfer.rollouts import ObservationTarget, target_of

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
        Returns of the uniformly random and of an optimal policy. None where the target cannot be
        solved, or is not solved because the threshold was stated.
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

    @classmethod
    def of(cls, target: Target | ObservationTarget, stated: float | None = None) -> Self:
        """Return the reference before training, with a stated threshold or the default."""
        known = target.solution is not None
        best, worst = (target.optimum, target.random_return) if known else (None, None)
        if stated is not None:
            return cls(stated, STATED, worst, best)
        # Undiscounted, the policy that is optimal with the discount need not beat a random one.
        reference = cls(None, MIDPOINT, worst, best)
        if best is None or worst is None or best <= worst or reference.nothing_to_learn:
            return reference
        return cls(fraction_of_optimum(best, worst, FRACTION), OF_OPTIMUM, worst, best)

    @classmethod
    def before(cls, node: Node, stated: float | None) -> Self:
        """Return :meth:`of` a task, which is not solved where the threshold is stated."""
        possible = possible_returns(node.task, node.evaluation.discount(node.task))
        if stated is not None:
            return cls(stated, STATED, possible=possible)
        return replace(cls.of(target_of(node.task, node.evaluation)), possible=possible)

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

    Examples
    --------
    >>> flat, steps = np.zeros((2, 3)), np.array([0, 10, 20])
    >>> arm = Arm(Curve(steps, flat + 4, np.array([10, 10])))
    >>> arm.strong_gain(Arm(Curve(steps, flat)))
    array([3., 3.])
    """

    curve: Curve
    scratch: bool = False
    curriculum: str = ""
    initial_values: FloatArray | None = field(default=None, repr=False)
    unlearnt: Mapping[str, BoolArray] = field(default_factory=dict, repr=False)
    knows_target: bool = False

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
        **kind: Any,
    ) -> Self:
        """Return the arm of some of a learning result's seeds; `kind` holds its other fields.

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
            **kind,
        )

    @property
    def control(self) -> bool:
        """Whether the arm is a control, which is charged as many steps as its curriculum."""
        return bool(self.curriculum) and not self.scratch

    def charged(self, scratch: "Arm") -> Curve:
        """Return the curve over total steps, source steps included (``charge_source``)."""
        return charge_source(scratch.curve, self.curve)

    def strong_gain(self, scratch: "Arm") -> FloatArray:
        """Return the area under the charged curve minus that of scratch, (K,), in return.

        Both are normalised (:func:`mean_return`); a difference within their rounding is 0.
        """
        return difference(mean_return(self.charged(scratch)), mean_return(scratch.curve))


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
    weak_steps_saved, strong_steps_saved : Interval
        Steps to the threshold saved; a seed that never reaches it counts with the whole budget.
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
    strong_steps_saved: Interval
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
class Comparison:
    """Arms of K seeds on one axis. Prints as a table.

    Attributes
    ----------
    target : str
    arms : dict of str to Arm
        The target's own learner from scratch first, named "scratch".
    budget, total : int
        Target steps, over which weak transfer is measured; and steps of every arm, sources
        included, over which strong transfer is measured.
    reference : Reference
        Returns that arms are measured by, such as the threshold.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold.
    failed : dict of str to Exception
        Error of each arm that could not be trained.
    interim : str
        Text that says that seeds of the plan are missing; then there are no verdicts and p-values.
    """

    target: str
    arms: Mapping[str, Arm]
    budget: int
    total: int
    reference: Reference
    window: int
    failed: Mapping[str, Exception] = field(default_factory=dict)
    interim: str = ""

    def __getitem__(self, name: str) -> Arm:
        one_of("an arm", name, self.arms, CurriculumError)
        return self.arms[name]

    @property
    def threshold(self) -> float:
        """The return that counts as learnt."""
        assert self.reference.threshold is not None, "scratch is trained before it is compared"
        return self.reference.threshold

    @property
    def threshold_from(self) -> str:
        """The source of the threshold, as text."""
        return self.reference.threshold_from

    @property
    def scratch(self) -> Arm:
        """The arm in which the target's own learner learns it from scratch."""
        return self.arms[SCRATCH]

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

    @cached_property
    def best_opponents(self) -> tuple[str, ...]:
        """The opponents that are the best opponent of at least one curriculum."""
        best = {self.best_opponent(name) for name in self.controls}
        return tuple(name for name in self.scratches if name in best)

    @cached_property
    def drawn(self) -> tuple[str, ...]:
        """The arms in figures: all but opponents that are neither scratch nor any arm's best."""
        kept = {SCRATCH, *self.best_opponents}
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

    @cached_property
    def know_nothing(self) -> dict[str, tuple[str, ...]]:
        """The placebos and constants of each curriculum; none if either kind is missing."""
        # Both kinds are needed: random values are learnt from more slowly than a single value.
        know_nothing: dict[str, tuple[str, ...]] = {}
        for name, controls in self.controls.items():
            labels = (f"{name}, {label}" for label in (PLACEBO, ALONE))
            placebos = [label for label in labels if label in controls]
            constants = [rival for rival in self.scratches if self.arms[rival].curriculum == name]
            asked = placebos and constants
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
        return verdicts_of(self.returns, asked, interim=self.interim)

    @cached_property
    def verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum pays: gains more than each of its opponents."""
        return self._verdicts({name: self.opponents(name) for name in self.controls})

    @property
    def withheld(self) -> str:
        """Why there are no verdicts, as text; empty if there are verdicts."""
        return next((verdict.withheld for verdict in self.verdicts.values()), self.interim)

    @cached_property
    def control_verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum that has controls gains more than all of them."""
        return self._verdicts(self.controls)

    @cached_property
    def knowledge_verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum gains more than all of its placebos and constants."""
        return self._verdicts(self.know_nothing)

    @cached_property
    def unrelated_verdicts(self) -> dict[str, Verdict]:
        """Whether each curriculum with a found mapping gains more than its unrelated control."""
        # This control reads the target's model, so a mapping made by hand need not beat it.
        known = (name for name in self.controls if self[name].knows_target)
        asked = {name: (f"{name}, {UNRELATED}",) for name in known}
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
        curve = self[name].charged(self.scratch) if strong else self._weak(name)
        return time_to_threshold(curve, self._level, window=self.window)

    @property
    def _level(self) -> float:
        """The threshold, or a value just above the threshold if scratch starts there."""
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
        """Each arm against its best opponent."""
        return {name: self._contrast(name) for name in self.arms if name not in self.scratches}

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
        arm, scratch = self[name], self[rival]
        ours, theirs = self.returns[name], self.returns[rival]
        alone = self._verdicts({name: self.opponents(name)})[name]
        verdict, reason = self.verdicts.get(name), self.reasons.get(name)
        weak, base = self._weak(name), self._weak(rival)
        strong, whole = arm.charged(self.scratch), scratch.curve
        saved = partial(steps_saved, threshold=self._level, window=self.window)
        return Contrast(
            jumpstart=mean_interval(jumpstart(base, weak)),
            weak_steps_saved=mean_interval(saved(base, weak)),
            strong_steps_saved=mean_interval(saved(whole, strong)),
            weak_gain=self.weak_gain(name, rival),
            strong_gain=alone.gain if alone.rivals > 1 else mean_interval(arm.strong_gain(scratch)),
            asymptotic_gain=mean_interval(
                difference(asymptotic_performance(strong), asymptotic_performance(whole))
            ),
            # Returns within rounding are equal, as in gains.
            probability_of_improvement=probability_of_improvement(
                np.where(difference(ours, theirs), ours, theirs), theirs
            ),
            p=alone.p,
            adjusted_p=NAN if verdict is None else verdict.adjusted_p,
            verdict="" if verdict is None else verdict.against_scratch,
            reason="" if reason is None else reason.words,
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return the table as data: a dict for each arm, intervals as name, name_low, name_high.

        All dicts have the same keys; a number that an arm does not have is NaN.
        """
        rows = list[dict[str, Any]]()
        for name, arm in self.arms.items():
            times, contrast = self.times(name), self.contrasts.get(name, NO_CONTRAST)
            over, knows = self.control_verdicts.get(name), self.knowledge_verdicts.get(name)
            intervals = {
                "steps_to_threshold": times.restricted_mean(),
                **{key: measure.of(self, name) for key, measure in ARM_MEASURES.items()},
                **{measure: getattr(contrast, measure) for measure in MEASURES},
                "gain_over_controls": UNKNOWN if over is None else over.gain,
                "gain_by_knowledge": UNKNOWN if knows is None else knows.gain,
            }
            row: dict[str, Any] = {
                "arm": name,
                "control": arm.control,
                "seeds": self.seeds,
                "source_steps": float(arm.curve.source_steps.mean()),
                "reached": int(times.reached.sum()),
            }
            for measure, interval in intervals.items():
                row[measure] = interval.estimate
                row[f"{measure}_low"], row[f"{measure}_high"] = interval.low, interval.high
            for part in ("p", "adjusted_p", "verdict", "reason"):
                row[part] = getattr(contrast, part)
            row["unlearnt"] = self.unlearnt(name)
            row["against"] = self.best_opponent(name) if name in self.contrasts else ""
            row["strongest_control"] = "" if over is None else over.rival
            row["beats_controls"] = "" if over is None else over.answer
            row["beats_controls_p"] = NAN if over is None else over.adjusted_p
            row["initial_value"] = NAN
            if arm.initial_values is not None:
                row["initial_value"] = float(arm.initial_values.mean())
            rows.append(row)
        return rows

    def __str__(self) -> str:
        return self.text()

    def text(self, width: int = UNBOUNDED) -> str:
        """Return the table and the sentences below it, in lines of at most `width` characters."""
        return "\n".join(
            [
                folded(self._title, width),
                *text_table(HEADS, [self._cells(name) for name in self.shown], width, prose=True),
                *(folded(line, width) for line in self._below),
            ]
        )

    def __repr__(self) -> str:
        verdicts = [f"{name}: {answer.against_scratch}" for name, answer in self.verdicts.items()]
        return shortened(
            f"Comparison({self.target!r}, {counted(len(self.arms), 'arm')}, "
            f"{counted(self.seeds, 'seed')}; {'; '.join(verdicts)})"
        )

    def _repr_html_(self) -> str:
        """Return the charged curves, the table, and sentences below it."""
        return block(
            self._title,
            curves(_lines(self), "target and source steps", GREEDY_RETURN),
            table(HEADS, [self._cells(name) for name in self.shown], wide=[HEADS[-1]]),
            *self._below,
        )

    @property
    def _below(self) -> list[str]:
        """The sentences below the table."""
        failed = (f"{name} failed: {in_words(error)}" for name, error in self.failed.items())
        return [*self.sentences, *failed]

    @property
    def _title(self) -> str:
        """The title: the target, the total of steps, the seeds and the threshold."""
        return (
            f"{self.target!r} in {self.total:,} steps, sources charged, evaluations free; "
            f"{counted(self.seeds, 'seed')}"
            f"; threshold {or_dash(self.threshold, '.4g')}"
            f"{self.threshold_from and f' ({self.threshold_from})'}"
        )

    def _cells(self, name: str) -> tuple[str, ...]:
        """Return an arm's row of the printed table: as many texts as `HEADS` has."""
        times, contrast = self.times(name), self.contrasts.get(name, NO_CONTRAST)
        missed = int((~times.reached).sum())
        steps = f"{times.steps.mean():,.0f}" + (f" ({missed} never)" if missed else "")
        steps = "> " * (missed > 0) + steps
        strong, weak, verdict = "", "", contrast.verdict
        if name in self.contrasts:
            strong, weak = short(contrast.strong_gain), short(contrast.weak_gain)
            if name in self.verdicts and not self.withheld:
                verdict += f" (p = {contrast.adjusted_p:.2g})"
            verdict += f", {contrast.reason}" if contrast.reason else ""
        elif name in self.best_opponents and len(self.scratches) > 1:
            over = [arm for arm in self.controls if self.best_opponent(arm) == name]
            of = "" if len(over) == len(self.controls) else f" of {', '.join(over)}"
            verdict = f"the best opponent{of}: gains are over it"
        measured = (short(measure.of(self, name)) for measure in ARM_MEASURES.values())
        return f"{name}{self._started(name)}", steps, *measured, strong, weak, verdict

    @property
    def sentences(self) -> list[str]:
        """Sentences on what was not learnt, other opponents, controls and clusters of seeds."""
        lines = [self.nothing_learnt, self.other_opponents]
        lines += [self.cluster_sentence(name) for name in self.shown]
        lines += [self.control_sentence(name) for name in self.control_verdicts]
        lines += [
            _sentence(name, verdict, "placebos and constants")
            for name, verdict in self.knowledge_verdicts.items()
            if self.verdicts[name].direction > 0
        ]
        lines += [self.unlearnt(name) or self.level_sentence(name) for name in self.controls]
        return [line for line in (*lines, not_known(list(self.reasons.values()))) if line]

    @property
    def nothing_learnt(self) -> str:
        """A sentence on a threshold that no arm reaches in any seed; empty if an arm does."""
        reached = any(self.times(name).reached.any() for name in self.arms)
        if np.isnan(self.threshold) or reached or self.reference.nothing_to_learn:
            return ""
        return (
            f"no arm reaches the threshold of {self.threshold:.4g} in any seed, so that the gains "
            "are between arms that did not learn: all may need a larger budget"
            + ", or a lower threshold"
            * (self.threshold_from == STATED)
        )

    @property
    def other_opponents(self) -> str:
        """A sentence on the constants that are not shown; empty if there are none."""
        others = [
            f"{name}{self._started(name)} {self.returns[name].mean():.4g}"
            for name in self.scratches
            if name not in self.shown
        ]
        return f"mean return of other constants: {'; '.join(others)}" if others else ""

    def level_sentence(self, name: str) -> str:
        """A sentence on a potential that is constant where learning goes; empty if it varies."""
        arms = (arm for arm in self.arms.values() if arm.curriculum == name)
        levels = [arm.initial_values for arm in arms if arm.initial_values is not None]
        if len(levels) < 2 or not np.allclose(levels, levels[0], rtol=1e-12, atol=0):
            return ""
        return f"{name} has one value in all pairs that learning can visit: check its mapping"

    def _started(self, name: str) -> str:
        """Return the initial value of an opponent that starts at a constant, as text."""
        values = self[name].initial_values
        return "" if values is None else f" (initial_value={values.mean():.4g})"

    def cluster_sentence(self, name: str) -> str:
        """Return a sentence on two clusters of an arm's seeds; empty if there are none."""
        values = self.returns[name]
        if (groups := clusters(values)) is None:
            return ""
        high, low = (f"{some.mean():.4g}" for some in reversed(groups))
        if high == low:  # apart by less than is printed
            return ""
        sentence = (
            f"the seeds of {name} are in two clusters, mean return of {len(groups[1])} near {high} "
            f"and of {len(groups[0])} near {low}"
        )
        if min(map(len, groups)) > self.seeds // 4:
            return sentence
        middle = interquartile_interval(values)
        return f"{sentence}; interquartile mean, without the few: {short(middle)}"

    def unlearnt(self, name: str) -> str:
        """Return a sentence on sources that did not learn their tasks; empty if all did."""
        shares = {source: seeds for source, seeds in self[name].unlearnt.items() if seeds.any()}
        parts = [
            f"{source} in {n.sum()} of {counted(n.size, 'seed')}" for source, n in shares.items()
        ]
        return f"sources of {name} that did NOT learn: {', '.join(parts)}" if parts else ""

    def control_sentence(self, name: str) -> str:
        """Return a sentence on whether a curriculum gains more than its controls."""
        return _sentence(name, self.control_verdicts[name], "controls")


def _sentence(name: str, verdict: Verdict, controls: str) -> str:
    """Return a sentence on whether an arm gains more than its rivals, called `controls`."""
    strongest = verdict.rival.removeprefix(f"{name}, ")
    if verdict.rivals == 1:
        return f"{name} gains more than its {strongest}: {verdict}"
    several = f"each of its {verdict.rivals} {controls}"
    return f"{name} gains more than {several}: {verdict}; the strongest is {strongest}"


class ArmMeasure(NamedTuple):
    """A measure of every arm; all tables loop over `ARM_MEASURES`, where a new measure is a row."""

    head: str
    meaning: str
    of: Callable[[Comparison, str], Interval]  # its value for the arm with this name


ARM_MEASURES = {
    "mean_return": ArmMeasure(
        "mean return",
        "the mean height of the learning curve: its area, divided by all steps",
        Comparison.mean_return,
    )
}
"""Key in :meth:`Comparison.rows` -> a column of printed tables and of the report's."""
HEADS = (
    *("", "steps to threshold"),
    *(measure.head for measure in ARM_MEASURES.values()),
    *("strong gain", "weak gain", "verdict"),
)


def short(interval: Interval) -> str:
    """Return an interval without its number of seeds; a dash if there is none."""
    return "-" if np.isnan(interval.estimate) else str(interval).rsplit(",", 1)[0]


def _lines(comparison: Comparison) -> list[Any]:
    """Return the charged curve of each arm; a control has the colour of its curriculum, dashed."""
    curricula = list(comparison.controls)
    lines = []
    for name in comparison.drawn:
        arm, colour = comparison[name], "currentColor"
        if not arm.scratch and name != SCRATCH:
            number = curricula.index(arm.curriculum or name)
            colour = COLOURS[OWN_COLOURS[number % len(OWN_COLOURS)]]
        curve = arm.charged(comparison.scratch)
        lines.append(
            seed_line(
                name,
                curve.steps,
                curve.filled(),
                colour,
                dashed=arm.control or (arm.scratch and name != SCRATCH),
                within=comparison.within,
            )
        )
    return lines


# -- Comparing arms -------------------------------------------------------------------------------


def compare(
    arms: Curriculum | Mapping[str, Curriculum],
    *,
    seeds: int | Sequence[int] = 30,
    controls: Sequence[Control] = (),
    opponents: Sequence[Opponent] = OPPONENTS,
    scratch: Learners = (),
    threshold: float | None = None,
    window: int = 5,
    workers: int | None = None,
    progress: Progress = None,
) -> Comparison:
    """Train curricula and their opponents, and return their comparison.

    All arms have the same total budget: the target's budget, plus the steps that the most expensive
    arm spends on its sources (or can spend at most, if a source's budget is in episodes). Opponents
    spend the whole total in the target; every other arm spends there the steps that its sources
    leave, seed by seed. A curriculum pays if it gains more than each opponent.
    An arm that fails is listed in :attr:`Comparison.failed`; an error of scratch, or of all arms,
    is raised.

    Parameters
    ----------
    arms : Curriculum or dict of str to Curriculum
        Curricula with the same target, none named "scratch". ``curricle.compare`` also takes a
        study or its path: then the arms are the study's, and so are settings that are not passed.
    seeds : int or sequence of int
    controls : sequence of str
        Any of ``random_start``, ``pretraining``, ``placebo``, ``scaled`` and ``negated``, run
        for each curriculum (``curricle.comparison.controls`` explains them).
    opponents : sequence of str
        Any of ``constant``, ``bounds`` and ``optimistic``: learners from scratch besides the
        target's own, by default all (``curricle.comparison.opponents`` explains them).
    scratch : sequence of learners, or dict of str to learner
        Further learners that learn the target from scratch.
    threshold : float, optional
        Return that counts as learnt. By default nine tenths of the way from the random policy's
        return to the optimum; midway up the curve of scratch if no optimum above random is known.
    window : int
        Checkpoints over which curves are smoothed to find when they reach the threshold.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task of each arm; a function is called with each trained arm.

    Raises
    ------
    CurriculumError, SettingError
        If arms are not comparable, or a setting is out of range, before any training.

    Examples
    --------
    >>> from curricle import GridWorld, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     budget={"corner": 500, "maze": 5000})
    >>> comparison = compare(plan, seeds=5, opponents=["optimistic"])
    >>> list(comparison.arms), comparison.total
    (['scratch', 'scratch, OptimisticQLearning', 'transfer'], 5500)
    """
    check_progress(progress)
    memory = Memory()
    plan = comparison_plan(arms, memory, controls, opponents, scratch)
    window = whole_number("window", window, 1, SettingError)
    if window > checkpoints(plan):
        raise SettingError(
            f"window must be at most {checkpoints(plan)}, the checkpoints within the target's "
            f"budget: got {window}"
        )
    if threshold is not None:
        threshold = number("threshold", threshold, SettingError)
    reference = Reference.before(plan.target_node, threshold)  # solving the target may fail
    with shown(progress) as bars:
        if bars.screen is not None:
            bars.say(plan.live_words(seed_tuple(seeds)))
        return trained_comparison(plan, seed_tuple(seeds), reference, window, memory, workers, bars)


def comparison_plan(
    arms: Curriculum | Mapping[str, Curriculum],
    memory: Memory,
    controls: Sequence[Control] = (),
    opponents: Sequence[Opponent] = (),
    scratch: Learners = (),
) -> Plan:
    """Return the plan of :func:`compare`; CurriculumError if arms cannot be compared."""
    if isinstance(arms, Curriculum):
        arms = {"transfer": arms}
    instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
    if not arms:
        raise CurriculumError("a comparison needs at least one curriculum: got none")
    for name, arm in arms.items():
        fit_name("an arm", name, CurriculumError)
        instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
    if isinstance(controls, str):
        raise SettingError(f"controls must be a list of names: got {controls!r}")
    for control in controls:
        one_of("a control", control, CONTROLS, SettingError)
    opponents = check_opponents(opponents)
    check_comparable(arms)
    first = next(iter(arms.values()))
    target, node = first.target, first.node(first.target)
    if isinstance(node.budget, Episodes | StoppingRule):
        raise SettingError(
            "a comparison at one total budget needs the target's in steps: "
            f"{target!r} has {node.budget}"
        )
    check_evaluated(first)
    for name, arm in arms.items():
        check_fit(controls, name, arm)
    scratches = {SCRATCH: from_scratch(first), **scratch_curricula(scratch, first)}
    how: Any = {"controls": controls, "opponents": opponents}
    return Plan.made(arms, scratches, memory.keys_of, **how)


def checkpoints(plan: Plan) -> int:
    """Return the checkpoints within the target's own budget."""
    return plan.steps[0] // plan.eval_freq + 1


def trained_comparison(
    plan: Plan,
    seeds: tuple[int, ...],
    reference: Reference,
    window: int,
    memory: Memory,
    workers: int | None,
    bars: Bars,
) -> Comparison:
    """Train the arms of a plan, and return their comparison with the reference before training."""
    # An arm that raises an error is added to `failed`, and left out with its controls.
    failures, in_order = Failures(plan.needs), tuple(sorted(seeds))
    failed, arms = dict[str, Exception](), dict[str, Arm]()
    for _ in chain(memory.train(plan, in_order, failures, workers, bars), [None]):
        for unit, error in failures.errors:
            for name, arm in plan.arms.items():
                if unit.key in arm.keys.values() and not failed.keys() & {name, arm.of}:
                    assert isinstance(error, Exception)
                    failed[name] = error
        if SCRATCH in failed:
            raise failed[SCRATCH]
        for name, arm in plan.arms.items():
            if failed.keys() & {name, arm.of} or name in arms:
                continue
            keys = {task: (key, in_order) for task, key in arm.keys.items()}
            if not {*keys.values()} <= memory.trained.keys():
                break  # `bars` takes the arms in the plan's order
            try:
                results = {task: memory.trained[key] for task, key in keys.items()}
                arms[name] = _arm(arm, results, plan, seeds)
            except Exception as error:  # training an arm may raise any error
                failed[name] = error
            else:
                bars.tell(name)
    if all(arm.scratch for arm in arms.values()):
        raise next(iter(failed.values()))
    arms = {name: arms[name] for name in plan.arms if name in arms}
    reference = reference.after(arms[SCRATCH].curve)
    return Comparison(plan.target, arms, *plan.steps, reference, window, failed)


def _arm(planned: PlannedArm, results: Mapping[str, Trained], plan: Plan, seeds: Any) -> Arm:
    """Return the arm that the results of its tasks make, with its seeds in the caller's order."""
    last, curriculum = results[plan.target], planned.curriculum
    return Arm.of(
        last.result,
        last.source_steps,
        (plan.steps[1], plan.eval_freq),
        seeds,
        scratch=planned.scratch,
        curriculum=planned.of,
        initial_values=last.initial_values,
        knows_target=curriculum.knows_target(plan.target),
        unlearnt={
            source: curriculum.node(source).unlearnt(results[source].result)
            for source in (curriculum.ancestors(plan.target) if not planned.of else ())
        },
    )
