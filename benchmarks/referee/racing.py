"""Races of recipes: successive halving with paired seeds, steps a state by size, a judgement.

Maron and Moore 1993, "Hoeffding races"; Birattari et al. 2002, "a racing algorithm for configuring
metaheuristics"; Jamieson and Talwalkar 2016, "non-stochastic best arm identification" for halving.
Each round trains what is left in runs that are new, a seed of one problem after the other, twice as
many as in the round before, and keeps the better half by all runs so far.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count, islice, product
from typing import Any

import numpy as np

from benchmarks.referee.problem import CAP, TARGET, BudgetSpent, Problem, SearchBudget, timed
from benchmarks.referee.recipes import (
    AGGREGATES,
    SHAPINGS,
    Recipe,
    Relation,
    Stage,
    Trend,
    half_the_size,
    which_of,
)
from curricle.arrays import FloatArray, IntArray
from curricle.curriculum.curriculum import Curriculum
from curricle.design.candidates import MAKERS
from curricle.design.kinds import aims, design_target, spread
from curricle.errors import CurricleError, CurriculumError
from curricle.statistics import mean_interval
from curricle.tasks.family import FamilyMember, Parameter
from curricle.tasks.mdp import tables
from curricle.tasks.start_states import goal_distance

FIRST_SHARE, VARIATION_SHARE, STEPS_SHARE = 0.5, 0.3, 0.6
"""Of what is left of the budget, for the first race, each race of variations, and the steps a
state; the judgement's least is set aside before."""
VARIATIONS, ERRORS = 2, 2.0
"""Races of variations at most, and the standard errors by which one must beat the leader."""
SEEDS_APART = 1_000_000
"""Between the seeds of the parts of a design, so that the judgement's were never seen."""
FIRST_RUNS, MOST_RUNS = 4, 16
"""Runs of each arm in the first round, and in any; a run is one seed of one problem."""
JUDGED_SEEDS, FEWEST_SEEDS, MANY_PROBLEMS = 16, 3, 5
"""Seeds of a judgement at most and at least; of so many problems one seed is enough, and the
interval is over problems."""
SCRATCH, PLACEBO, FIXED, LEADER = "scratch", "placebo", "half the size", "leader"


def design_recipe(problems: Sequence[Problem], budget: SearchBudget, *, seed: int) -> Recipe:
    """Return the recipe that races on some problems find; none where it is not shown to pay.

    A first race is over sources and chains of them, further ones over variations of the leader: its
    steps, scale, aggregate, shaping, stopping rule. Then the steps a state are fitted by size, and
    new seeds judge whether the recipe pays. Scratch, the leader's placebo and a fixed recipe always
    stay in the race. CurriculumError where the budget does not pay for a race and its judgement.
    """
    fixed = half_the_size(problems)
    stays = {} if fixed is None else {FIXED: fixed}
    seeds = count(seed * SEEDS_APART * 10, SEEDS_APART)
    arms = {**stays, **first_arms(problems)}
    short = timed(problems, budget, next(seeds))
    aside = _fewest(short) * sum(problem.steps for problem in short) * (4 + len(stays))
    least = _run_cost(short) * _runs(len(stays) + 1, len(stays)) / FIRST_SHARE
    if aside + least > budget.left:
        raise CurriculumError(
            f"a design for these problems needs a budget of {budget.spent + aside + least:,.0f} "
            f"steps at least: got {budget.steps:,.0f}"
        )
    best = _raced(short, arms, stays, budget, aside, seeds)
    if best.stages:
        with budget.share(STEPS_SHARE, aside=aside):
            best = with_step_trend(short, best, budget, next(seeds))
    pays = _pays(short, best, stays, budget, next(seeds))
    return best if best.stages and pays else Recipe()


def _raced(
    problems: Sequence[Problem],
    arms: dict[str, Recipe],
    stays: dict[str, Recipe],
    budget: SearchBudget,
    aside: float,
    seeds: Iterator[int],
) -> Recipe:
    """Return the best of a race of recipes, and of races of variations of its leader."""
    with budget.share(FIRST_SHARE, aside=aside):
        best = Race(problems, arms, budget, tuple(stays), next(seeds)).best
    for first_seed in islice(seeds, VARIATIONS):
        if not best.stages:
            break
        several = len(best.curriculum(problems[0]).in_edges(TARGET)) > 1
        varied = {**stays, LEADER: best, **variations(best, several=several)}
        try:
            with budget.share(VARIATION_SHARE, aside=aside):
                race = Race(problems, varied, budget, (*stays, LEADER), first_seed)
        except CurriculumError:  # the budget does not pay for another race
            break
        if not race.beaten:
            break
        best = race.best
    return best


def _pays(
    problems: Sequence[Problem],
    recipe: Recipe,
    others: dict[str, Recipe],
    budget: SearchBudget,
    first_seed: int,
) -> bool:
    """Return whether a recipe saves steps of scratch, shown by the interval, on new seeds."""
    fewest = _fewest(problems)
    # Scratch, the recipe, its placebo, whose sources are trained again, and the others.
    least = fewest * sum(problem.steps for problem in problems) * (4 + len(others))
    paid = int(min(JUDGED_SEEDS, budget.left / (least / fewest)))
    if paid < fewest:
        raise CurriculumError(
            f"a judgement here may cost {least:,.0f} steps: {budget.left:,.0f} are left"
        )
    numbers = range(first_seed, first_seed + paid)
    shares = []
    for problem in problems:
        plans = [one.curriculum(problem) for one in (recipe, *others.values())]
        scratch, judged, *_ = (
            budget.train(problem, plan, numbers).steps for plan in (problem.scratch, *plans)
        )
        if recipe.stages:
            budget.train(problem, plans[0], numbers, placebo=True)
        shares.append(scratch / scratch.mean() - judged / scratch.mean())
    axis = 1 if len(problems) >= MANY_PROBLEMS else 0
    return bool(mean_interval(np.array(shares).mean(axis=axis)).low > 0)


def _fewest(problems: Sequence[Problem]) -> int:
    return 1 if len(problems) >= MANY_PROBLEMS else FEWEST_SEEDS


# -- races ---------------------------------------------------------------------------------------


class Race:
    """A race of recipes on problems, all arms with the same seeds, which is run when it is made.

    Scratch is an arm, it always stays, and so does the placebo of the leader from the second round
    on. Where the budget does not pay for all arms, the first ones race.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> maze = Problem(GridWorld(["....T", ".PPP.", "S...."]), steps=20_000, eval_freq=200)
    >>> arms = {f"{n}": Recipe((Stage(Relation("crop", 0.6), Trend(n)),)) for n in (10, 1000)}
    >>> print(Race([maze], arms, SearchBudget(400_000), (), 0).best)
    crop 0.6: 10 steps a state; scale 1; initialise
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        arms: Mapping[str, Recipe],
        budget: SearchBudget,
        always: Sequence[str],
        first_seed: int,
    ) -> None:
        self.problems, self.arms, self.budget = problems, arms, budget
        self.always, self.next_seed = always, first_seed
        self.order = spread(range(len(problems)))
        self.steps: dict[str, list[IntArray]] = {}
        self.plans = dict[str, list[Curriculum]]()
        for name, recipe in arms.items():
            try:
                self.plans[name] = [recipe.curriculum(problem) for problem in problems]
            except CurricleError:  # it has no source of some problem
                continue
        self.ranked = self._halved(self._affordable())
        """Arms of the last round and scratch, the best first."""

    @property
    def best(self) -> Recipe:
        """The recipe of the leader; none where it is scratch."""
        return Recipe() if self.ranked[0] == SCRATCH else self.arms[self.ranked[0]]

    @property
    def beaten(self) -> bool:
        """Whether a variation beat the leader before by two standard errors over runs.

        Of many variations one is always ahead by chance.
        """
        if self.ranked[0] in (LEADER, FIXED, SCRATCH):
            return False
        less = []
        for own, others, scratch in zip(
            *(self.steps[name] for name in (self.ranked[0], LEADER, SCRATCH)), strict=True
        ):
            n = min(len(own), len(others))  # the last runs that both had
            if n:
                less.append((own[len(own) - n :] - others[len(others) - n :]) / scratch.mean())
        runs = np.concatenate(less)
        error = float(runs.std(ddof=1)) / len(runs) ** 0.5 if len(runs) > 1 else math.inf
        return float(runs.mean()) < -ERRORS * error

    def _affordable(self) -> list[str]:
        """Return the arms that the budget pays for: those that always stay, then the first ones."""
        stay = [name for name in self.always if name in self.plans]
        names = stay + [name for name in self.plans if name not in stay]
        if not names:
            raise CurriculumError("a race needs a recipe that has sources in every problem")
        each, left = _run_cost(self.problems), self.budget.left
        while len(names) > len(stay) + 1 and each * _runs(len(names), len(stay)) > left:
            names.pop()
        least = each * _runs(len(names), len(stay))
        if least > left:
            raise CurriculumError(f"a race here needs {least:,.0f} steps: {left:,.0f} are left")
        return names

    def _halved(self, names: list[str]) -> list[str]:
        """Run the rounds; return the arms that are left and scratch, the best first."""
        left, ranked = names, list[str]()
        for number in range(_rounds(len(names))):
            try:
                self._play(number, [SCRATCH, *left])
                if ranked:
                    self._play_placebo(number, left[0])
            except BudgetSpent:
                if not ranked:
                    raise
                return ranked
            scores = {name: self._score(name) for name in (SCRATCH, *left)}
            order = sorted(left, key=lambda name: (scores[name], names.index(name)))
            half = order[: max(1, len(order) // 2)]
            left = half + [name for name in order if name in self.always and name not in half]
            ranked = sorted([SCRATCH, *left], key=lambda name: (scores[name], name != SCRATCH))
        return ranked

    def _score(self, name: str) -> float:
        """Return the mean over problems of an arm's steps over those of scratch."""
        pairs = zip(self.steps[name], self.steps[SCRATCH], strict=True)
        return float(np.mean([own.mean() / other.mean() for own, other in pairs if len(own)]))

    def _play(self, number: int, names: Sequence[str]) -> None:
        """Train arms in the runs of a round.

        Where the budget ends within the round none of its runs is kept: arms would not be paired.
        """
        runs, played = _runs_of(number), list[tuple[str, int, IntArray]]()
        for p, seeds in self._seeds(runs):
            for name in names:
                problem = self.problems[p]
                plan = problem.scratch if name == SCRATCH else self.plans[name][p]
                played.append((name, p, self.budget.train(problem, plan, seeds).steps))
        for name, p, steps in played:
            of_arm = self.steps.setdefault(name, [np.empty(0, np.int64) for _ in self.problems])
            of_arm[p] = np.concatenate([of_arm[p], steps])
        self.next_seed += -(-runs // len(self.problems))

    def _play_placebo(self, number: int, name: str) -> None:
        """Train the placebo of an arm in a quarter of the runs of a round."""
        for p, seeds in self._seeds(_runs_of(number) // 4):
            self.budget.train(self.problems[p], self.plans[name][p], seeds, placebo=True)

    def _seeds(self, runs: int) -> Iterator[tuple[int, range]]:
        """Yield each problem of a round and its seeds; problems take turns."""
        n = len(self.problems)
        for turn, p in enumerate(self.order):
            seeds = runs // n + (turn < runs % n)
            if seeds:
                yield p, range(self.next_seed, self.next_seed + seeds)


def _run_cost(problems: Sequence[Problem]) -> float:
    """Return what one run of a race is expected to cost: as much as scratch, on average."""
    return float(np.mean([problem.steps for problem in problems])) / CAP


def _rounds(arms: int) -> int:
    """Return the rounds of a race: until one arm is left, and at least two."""
    return max(2, math.ceil(math.log2(arms)))


def _runs_of(number: int) -> int:
    return min(MOST_RUNS, FIRST_RUNS << number)


def _runs(arms: int, always: int) -> int:
    """Return the trainings that a race of so many arms takes.

    Examples
    --------
    >>> _runs(4, 0)  # 4 of 4 arms and scratch; 8 of 2 and scratch, 2 of the placebo, which is two
    48
    """
    trainings, left = 0, arms
    for number in range(_rounds(arms)):
        runs = _runs_of(number)
        trainings += runs * (left + 1) + (2 * (runs // 4) if number else 0)
        left = min(left, max(1, left // 2) + always)
    return trainings


# -- the recipes that race -----------------------------------------------------------------------


SHARES = (0.5, 0.7, 0.3)
"""Of a target, for one source."""
CHAINS = ((0.35, 0.7), (0.25, 0.5), (0.3, 0.5, 0.8), (0.2, 0.4, 0.6, 0.8))
"""The same for sources that build on each other."""
NUMBERS = (
    (30.0, 1.0, True),
    (100.0, 2.0, False),
    (100.0, 1.5, True),
    (30.0, 1.0, False),
    (300.0, 2.0, True),
    (100.0, 1.0, False),
    (10.0, 1.0, False),
    (30.0, 3.0, False),
)
"""Steps a state, scales, and whether sources are annealed, with which sources race first: the first
one stays where races cannot tell it from others, which is common on miniatures."""
OF_FAST_LEARNERS = (*NUMBERS[3::-1], *NUMBERS[4:])
"""The same where the learner has a learning rate above 0.2: it is as good a teacher in fewer
steps, and annealing pays later."""
SLOW = 0.2
FEW = 4
"""Below it a parameter of a target is a count, of which sources have one less, or one."""


def first_arms(problems: Sequence[Problem]) -> dict[str, Recipe]:
    """Return recipes by name for a first race, so that the first few differ the most.

    Every source and chain of sources with several steps a state, scales and learners, and with the
    minimum beside the mean where a target reads several potentials.
    """
    single = relations(problems)
    alone = [one for one in single if len(one.changes) < 2]
    plans: list[tuple[Relation, ...]] = [*((one,) for one in alone), *_chains(problems, alone)]
    plans += [(one,) for one in single if len(one.changes) > 1]
    several = {plan for plan in plans if _several(problems[0], plan)}
    rate: Any = problems[0].learner.learning_rate
    arms = dict[str, Recipe]()
    for steps, scale, annealed in NUMBERS if rate <= SLOW else OF_FAST_LEARNERS:
        for aggregate in ("minimum", "mean") if several else ("mean",):
            for plan in plans:
                if aggregate == "mean" or plan in several:
                    stages = tuple(Stage(relation, Trend(steps)) for relation in plan)
                    recipe = Recipe(stages, True, aggregate, scale, annealed=annealed)
                    arms[str(recipe)] = recipe
    return arms


def relations(problems: Sequence[Problem]) -> list[Relation]:
    """Return what sources some problems may have; those of kinds but members as the first has."""
    target, known = design_target(problems[0].target), list[Relation]()
    for kind, maker in MAKERS.items():
        drafts = [] if kind == "member" else list(maker(target))
        if kind in ("crop", "starts") and drafts:
            known += [Relation(kind, share) for share in SHARES]
        else:
            names = [which_of(draft) for draft in drafts]
            known += [Relation(kind, which=which) for which in names if which is not None]
    members = [one.target for one in problems if isinstance(one.target, FamilyMember)]
    if len(members) == len(problems):
        known += [Relation("member", changes=one) for one in _changes(members)]
    return known


def _changes(members: Sequence[FamilyMember]) -> Iterator[tuple[tuple[str, Any], ...]]:
    """Yield changes of parameters that make members easier: of each alone, and of two.

    Terms suit the hardest value that any of them has.
    """
    single = []
    for parameter in members[0].family.parameters:
        values = [member[parameter.name] for member in members]
        hardest = max(values, key=lambda value: parameter.difficulty(value) or 0.0)
        single += [(parameter.name, term) for term in _terms(parameter, hardest)]
    yield from ((change,) for change in single)
    for first, second in product(single, single):
        if first[0] < second[0]:
            yield first, second


def _terms(parameter: Parameter, value: Any) -> list[Any]:
    """Return terms for easier values of a parameter that is ordered."""
    easier = parameter.easier_than(value)
    if parameter.difficulty(value) is None or value is None:
        return []
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and parameter.harder == "larger" and parameter.values is None:
        if isinstance(value, float):
            return ["0.5 n", 0.0] if value > 0 else []
        if value >= FEW:
            return [f"{share} n" for share in SHARES]
        return [easier[0], *(["n - 1"] if value - 1 in easier else [])] if easier else []
    return list(easier[-1:])


def _chains(
    problems: Sequence[Problem], known: Sequence[Relation]
) -> Iterator[tuple[Relation, ...]]:
    """Yield chains of growing parts, and of members of growing size."""
    for kind in ("crop", "starts"):
        if any(relation.kind == kind for relation in known):
            yield from (tuple(Relation(kind, share) for share in chain) for chain in CHAINS)
    for relation in known:
        for name, term in relation.changes:
            whole = all(isinstance(problem.target[name], int) for problem in problems)
            if term == f"{SHARES[0]} n" and whole:
                for chain in CHAINS:
                    yield tuple(
                        Relation("member", changes=((name, f"{share} n"),)) for share in chain
                    )


def _several(problem: Problem, plan: Sequence[Relation]) -> bool:
    """Return whether the target reads several potentials of the last source."""
    try:
        return len(plan[-1].source_of(problem.target).mappings) > 1
    except CurricleError:
        return False


def variations(recipe: Recipe, *, several: bool) -> dict[str, Recipe]:
    """Return the recipes that differ from one in one setting, by name.

    The aggregate only where the target reads several potentials.
    """
    varied = [replace(recipe, annealed=not recipe.annealed)]
    varied += [with_steps(recipe, factor) for factor in (1 / 3, 3.0)]
    if not isinstance(recipe.scale, str):
        scales = [recipe.scale * factor for factor in (0.5, 1.5, 2.0, 1 / 3, 3.0)]
        varied += [replace(recipe, scale=scale) for scale in scales]
    varied.append(replace(recipe, scale="calibrated" if recipe.scale != "calibrated" else 1.0))
    varied += [replace(recipe, shaping=name) for name in SHAPINGS if name != recipe.shaping]
    settled = tuple(replace(stage, settled=True) for stage in recipe.stages)
    varied.append(replace(recipe, stages=settled))
    if several:
        varied += [replace(recipe, aggregate=one) for one in AGGREGATES if one != recipe.aggregate]
    if len(recipe.stages) > 1:
        varied.append(replace(recipe, chain=not recipe.chain))
        varied.append(replace(recipe, stages=recipe.stages[1:]))
    return {str(one): one for one in varied}


def with_steps(recipe: Recipe, factor: float) -> Recipe:
    """Return a recipe with its steps a state multiplied by a factor."""
    return replace(
        recipe,
        stages=tuple(
            replace(stage, steps=replace(stage.steps, level=stage.steps.level * factor))
            for stage in recipe.stages
        ),
    )


# -- steps a state by size -----------------------------------------------------------------------
#
# Box and Wilson 1951, "on the experimental attainment of optimum conditions": the lowest point of a
# polynomial in the logarithm of the steps, fitted to trials. Here tasks of all sizes share its
# shape, and it moves with the logarithm of the size.
#
# Miniatures differ little in size and much in all else, so the slope of that is uncertain, and a
# large task is far away: an error of 0.5 triples the steps for 8 times the states. So the slope is
# shrunk towards what is known before any trial. Values travel one step back a visit, hence the
# visits that a state needs grow as the way from the start to the goal does.

FACTORS = (1 / 8, 1 / 4, 1 / 2, 1.0, 2.0, 4.0, 8.0)
"""Of the recipe's steps a state, which are tried."""
MOST_STEP_SEEDS, FEWEST_STEP_RUNS = 16, 4
DEGREE, POINTS = 4, 401
"""Of the polynomial, and the points at which its lowest one is looked for."""
SLOPES = np.arange(-0.5, 1.51, 0.05)
"""Logarithms of steps a state by those of states that are tried."""
ROUNDING = 1e-12
RESAMPLES, AGREE = 200, 0.9
"""Resamples, and the share of them whose slopes must have one sign where nothing is known of the
ways to the goal; else the number is a constant."""
DOUBT = 0.5
"""Standard deviation, over families, of the power of the way with which steps a state grow; its
mean is 1. Measured: 1.5 for random mazes from 36 to 400 states, 0.8 for pursuits."""


def with_step_trend(
    problems: Sequence[Problem], recipe: Recipe, budget: SearchBudget, first_seed: int
) -> Recipe:
    """Return a recipe whose steps a state are those that cost the least, by size.

    Each problem is trained with several times the recipe's steps. The slope of the lowest cost over
    sizes is the mean of the fitted one and of :func:`way_slope`, weighted by their precisions.
    Where the ways are not known, it is the fitted one if nine of ten resamples agree on its sign,
    and else 0. The recipe stays where the budget does not pay for four runs of each.
    """
    each = (len(FACTORS) + 1) * sum(problem.steps for problem in problems)
    seeds = int(min(MOST_STEP_SEEDS, budget.left / each))
    if seeds * len(problems) < FEWEST_STEP_RUNS:
        return recipe
    numbers = range(first_seed, first_seed + seeds)
    costs = np.empty((len(problems), len(FACTORS), seeds))
    for p, problem in enumerate(problems):
        scratch = budget.train(problem, problem.scratch, numbers).steps.mean()
        for f, factor in enumerate(FACTORS):
            plan = with_steps(recipe, factor).curriculum(problem)
            costs[p, f] = budget.train(problem, plan, numbers).steps / scratch
    sizes = np.log([problem.task.states.size for problem in problems])
    rng = np.random.default_rng([first_seed, len(problems)])
    level, slope = fitted(sizes, costs, way_slope(problems), rng)
    around = math.exp(float(sizes.mean()))
    stages = tuple(
        replace(stage, steps=Trend(stage.steps.at(around) * math.exp(level), slope, around))
        for stage in recipe.stages
    )
    return replace(recipe, stages=stages)


def way_slope(problems: Sequence[Problem]) -> float | None:
    """Return the slope of the logarithm of the way to the goal over that of the states.

    The way is the fewest steps to the goal from the start that is the farthest away. None where no
    way has a step, or ways do not grow with the states.
    """
    models = [tables(problem.task) for problem in problems]
    ways = np.array([goal_distance(one, aims(one))[one.start_states].max() for one in models])
    sizes = np.log([problem.task.states.size for problem in problems])
    z = sizes - sizes.mean()
    if ways.min() < 1 or np.ptp(z) == 0:
        return None
    slope = float(z @ np.log(ways) / (z @ z))
    return slope if slope > 0 else None


def fitted(
    sizes: FloatArray, costs: FloatArray, way: float | None, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the log factor at the mean size, and its slope.

    `sizes` are logarithms of states, (P,); `costs` those of each problem, factor and seed over the
    mean of scratch, (P, F, K); `way` is that of :func:`way_slope`.

    Examples
    --------
    >>> sizes, x = np.array([3.5, 3.5, 4.5, 4.5]), np.log(FACTORS)
    >>> lows = np.array([0.9, -0.9, 0.6, -0.6])  # problems of one size differ, those of two do not
    >>> costs = 0.4 * np.exp(0.1 * (x - lows[:, None]) ** 2)[:, :, None]
    >>> level, slope = fitted(sizes, costs, 0.5, np.random.default_rng(0))
    >>> 0.3 < slope < 0.5, fitted(sizes, costs, None, np.random.default_rng(0))[1]
    (True, 0.0)
    """
    mean = sizes, costs.mean(axis=2)
    slope = lowest(*mean)[1]
    resampled = np.array([lowest(*_resampled(sizes, costs, rng))[1] for _ in range(RESAMPLES)])
    if way is not None:
        before = (DOUBT * way) ** 2
        weight = before / (before + float(resampled.var()))
        slope = weight * slope + (1 - weight) * way
    elif (np.sign(resampled) == np.sign(slope)).mean() < AGREE:
        slope = 0.0
    return lowest(*mean, slopes=np.array([slope]))[0], float(slope)


def lowest(
    sizes: FloatArray, costs: FloatArray, slopes: FloatArray = SLOPES
) -> tuple[float, float]:
    """Return where the cost is the lowest: the log factor at the mean size, and its slope.

    log cost of problem p at log factor x is a_p + g(x - slope z_p), where z_p is its size less the
    mean and g a polynomial of degree 4. The slope is that of `slopes` by which the curves
    agree the most. Costs above that of scratch, 1, are left out: what does not pay has no say in
    where it pays the most. Where fewer than six costs are below 1, the factor of the lowest mean
    and slope 0.

    Examples
    --------
    >>> x, sizes = np.log(FACTORS), np.array([1.0, 3.0])
    >>> costs = 0.4 * np.exp(0.2 * (x - 0.5 * (sizes[:, None] - 2.0)) ** 2)
    >>> tuple(round(value, 2) + 0.0 for value in lowest(sizes, costs))
    (0.0, 0.5)
    """
    x, z = np.log(FACTORS), sizes - sizes.mean()
    p, f = np.nonzero(costs < 1)
    if len(p) < DEGREE + 2:
        return float(x[costs.mean(axis=0).argmin()]), 0.0
    logs = _less_means(np.log(costs[p, f])[:, None], p)
    best, low = np.inf, (0.0, 0.0)
    for slope in slopes if np.ptp(z) > 0 else [0.0]:
        u = x[f] - slope * z[p]
        powers = u[:, None] ** np.arange(1, DEGREE + 1)
        design = _less_means(powers, p)
        weights = np.linalg.lstsq(design, logs, rcond=None)[0]
        error = float(((logs - design @ weights) ** 2).sum())
        if error < best - ROUNDING:
            at = np.linspace(max(u.min(), x[0]), min(u.max(), x[-1]), POINTS)
            curve = (at[:, None] ** np.arange(1, DEGREE + 1)) @ weights[:, 0]
            best, low = error, (float(at[curve.argmin()]), float(slope))
    return low


def _less_means(values: FloatArray, problem: IntArray) -> FloatArray:
    """Return rows less the mean row of their problem, so that each problem has its own constant."""
    counts = np.maximum(np.bincount(problem), 1)
    total = np.zeros((len(counts), values.shape[1]))
    np.add.at(total, problem, values)
    return np.asarray(values - (total / counts[:, None])[problem])


def _resampled(
    sizes: FloatArray, costs: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    problems = rng.integers(len(sizes), size=len(sizes))
    seeds = rng.integers(costs.shape[2], size=costs.shape[2])
    return sizes[problems], costs[problems][:, :, seeds].mean(axis=2)
