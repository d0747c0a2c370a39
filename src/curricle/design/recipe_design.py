"""Designing a recipe on miniatures: races, numbers by size, and a judgement on new seeds."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, islice
from typing import Any

from curricle.checks import brief, instance, number, whole_number
from curricle.design.arms import first_arms, variations
from curricle.design.assembly import TARGET
from curricle.design.break_even import BreakEven
from curricle.design.judgement import RECIPE, Judgement, judge, judgement_cost
from curricle.design.judging import ROUNDING
from curricle.design.ledger import Ledger
from curricle.design.problem import Problem
from curricle.design.racing import PLACEBO, Race, fewest_runs, race, race_cost
from curricle.design.recipe import Recipe, Stage
from curricle.design.relations import Relation
from curricle.design.search_budget import SearchBudget
from curricle.design.standing import STANDING
from curricle.design.step_trend import with_step_trend
from curricle.design.timed_problems import timed
from curricle.display import brief_repr, printed
from curricle.errors import CurricleError, CurriculumError
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.statistics.curves import SCRATCH
from curricle.tasks.task import has_tables
from curricle.text_tables import counted

SHARES = {"first": 0.5, "variation": 0.3, "numbers": 0.6}
"""Of what is left of the budget, for the first race, each race of variations, and the numbers; the
judgement's least is set aside before."""
VARIATIONS = 2
"""Races of variations at most."""
ERRORS = 2.0
"""Standard errors by which a variation must be better than the leader to take its place."""
FIXED, LEADER = "half the size", "leader"
BEST = "best in the race"
"""What the winner of the race is called beside a standing recipe that is recommended."""
SEEDS_APART = 1_000_000
"""Between the seeds of the parts of a design, so that the judgement's were never seen."""


@dataclass(frozen=True, eq=False)
class RecipeDesign:
    """A recipe, and how it was found.

    Attributes
    ----------
    recipe : Recipe
        What the design recommends: without stages where no curriculum was shown to pay.
    best : Recipe
        The best that was found, whether it pays or not.
    races : tuple of Race
        The first one is over sources, the others over variations of its leader.
    judgement : Judgement
        Of the best on seeds that no choice rests on.
    ledger : Ledger
    fixed : Recipe or None
        The fixed recipe that always stayed in the race.
    standing : str
        The name of the standing recipe that is recommended, as the best was not shown to be better;
        empty where the best is.
    """

    recipe: Recipe
    best: Recipe
    races: tuple[Race, ...]
    judgement: Judgement
    ledger: Ledger = field(repr=False)
    fixed: Recipe | None = None
    standing: str = ""

    __repr__ = brief_repr
    _repr_html_ = printed

    @property
    def recommended(self) -> str:
        """The arm of the judgement that has the recommended recipe, or the best where none is."""
        return self.standing or RECIPE

    def break_even(self, scratch_steps: float) -> BreakEven:
        """Return after how many trainings of a target the search has paid.

        Parameters
        ----------
        scratch_steps : float
            What learning that target from scratch takes; the recipe is expected to save the same
            share of it as in the judgement.
        """
        steps = number("the steps of scratch", scratch_steps, CurriculumError, 0)
        saving = self.judgement.saving(self.recommended)
        scaled = replace(
            saving,
            estimate=saving.estimate * steps,
            low=saving.low * steps,
            high=saving.high * steps,
        )
        return self.ledger.break_even(scaled)

    @property
    def why(self) -> str:
        """Why the design recommends what it does, in a sentence."""
        paid, problems = self.judgement.problems_paid()
        saves = f"saves {_percent(self.judgement.saving())} of the steps from scratch"
        if self.standing:
            own = _percent(self.judgement.saving(self.standing))
            best = "Scratch won the race."
            if self.best.stages:
                best = f"The best in the race {saves}, which is not shown to be more."
            return (
                f"The standing recipe of {self.standing} saves {own} of the steps from scratch on "
                f"new seeds. {best}"
            )
        if not self.best.stages:
            return "No curriculum: nothing in the race was better than learning the target alone."
        if not self.recipe.stages:
            return f"No curriculum: on new seeds the best in the race {saves}, which may be none."
        text = f"On new seeds the recipe {saves}, in {paid} of {problems} problems."
        if PLACEBO in self.judgement.steps:
            over = self.judgement.saving(than=PLACEBO)
            knows = (
                "It pays by what it knows" if over.low > 0 else "It may pay by its optimism alone"
            )
            text += f" {knows}: its placebo costs {self.judgement.cost(PLACEBO):.2f} of scratch."
        return text

    def __str__(self) -> str:
        trainings = sum(len(one) for row in self.races for one in row.steps.values())
        arms = sum(len(one.arms) for one in self.races)
        lines = [str(self.recipe), self.why]
        lines += [
            f"{name} costs {self.judgement.cost(name):.2f} of scratch."
            for name in self.judgement.steps
            if name not in (SCRATCH, RECIPE, PLACEBO)
        ]
        raced = f"{counted(arms, 'recipe')} raced, {counted(trainings, 'training')} in all"
        lines.append(f"{raced}. The search cost:")
        return "\n".join([*lines, str(self.ledger)])


def design_recipe(
    problems: Sequence[Problem],
    budget: SearchBudget,
    *,
    arms: Mapping[str, Recipe] | None = None,
    fixed: Recipe | None = None,
    standing: Mapping[str, Recipe] | None = None,
    seed: int = 0,
    progress: Progress = None,
) -> RecipeDesign:
    """Return a recipe designed on some problems, such as miniatures of a large task.

    A first race is over sources and chains of them, further ones over variations of the leader:
    its steps, scale, aggregate, shaping, stopping rule. Then the steps a state are fitted by size,
    and new seeds judge whether the recipe pays. Scratch, the leader's placebo and a fixed recipe
    always stay in the race, and "no curriculum" is an answer.

    Parameters
    ----------
    problems : sequence of Problem
        The smaller ones first; those of several sizes allow trends.
    budget : SearchBudget
    arms : dict of str to Recipe, optional
        Of the first race; by default :func:`first_arms` of the problems.
    fixed : Recipe, optional
        By default half the size: a crop, a member or starts, whichever all problems have first.
    standing : dict of str to Recipe, optional
        Recipes that earlier designs found on other tasks, which race too. One of them is
        recommended where the best is not shown to be better: it was not chosen on these problems.
        By default :data:`STANDING`, and none where `arms` are given.
    seed : int
        The same seed gives the same design, bit for bit.
    progress : bool or callable, optional
        True shows bars of the trainings, a function is called with each :class:`Race`, then with
        the :class:`Judgement`.

    Raises
    ------
    CurriculumError
        When there is no problem, no recipe has sources in all of them, or the budget does not pay
        for a race and its judgement.
    SettingError
        When `progress` is none of these.

    Examples
    --------
    >>> from curricle.tasks import maze_family
    >>> small = [Problem(maze_family(size=n, pits=0.2, seed=3), steps=20_000) for n in (4, 5)]
    >>> found = design_recipe(small, SearchBudget(3_000_000))
    >>> found.ledger.cost <= 3_000_000, found.judgement.problems_paid()[1]
    (True, 2)
    """
    problems = _checked(problems)
    instance("the budget of a design", budget, SearchBudget, CurriculumError)
    for given in (arms, standing):
        _check_recipes(given)
    if fixed is not None:
        instance("the fixed recipe of a design", fixed, Recipe, CurriculumError)
    seed = whole_number("the seed of a design", seed, 0, CurriculumError)
    known = dict((STANDING if arms is None else {}) if standing is None else standing)
    own = {**known, **(first_arms(problems) if arms is None else arms)}
    check_progress(progress)
    fixed = half_the_size(problems) if fixed is None else fixed
    stays = {} if fixed is None else {FIXED: fixed}
    seeds = count(seed * SEEDS_APART * 10, SEEDS_APART)
    with shown(progress) as bars:
        short = timed(problems, budget, next(seeds), bars.within())
        aside = _set_aside(short, budget, len(stays), len(known))
        races, best = _raced(short, own, stays, budget, aside, seeds, bars)
        if best.stages:
            with budget.share(SHARES["numbers"], aside=aside):
                first = next(seeds)
                best = with_step_trend(short, best, budget, first_seed=first, bars=bars)
        ran = [name for name in known if name in races[0].arms]
        stands = {name: known[name] for name in sorted(ran, key=races[0].score)[:1]}
        others, first = {**stays, **stands}, next(seeds)
        within = bars.within()
        judged = judge(short, best, budget, others=others, first_seed=first, progress=within)
        bars.tell(judged)
    pays = bool(best.stages) and judged.saving().low > 0
    recipe, stood = (best if pays else Recipe()), ""
    for name, other in stands.items():
        beaten = pays and judged.saving(than=name).low > 0
        if judged.saving(name).low > 0 and not beaten:
            recipe, stood = other, name
    return RecipeDesign(recipe, best, races, judged, budget.ledger, fixed, stood)


def _checked(problems: Any) -> tuple[Problem, ...]:
    """Return the problems of a design; CurriculumError if one has nothing to learn."""
    if not isinstance(problems, Iterable):
        raise CurriculumError(f"the problems of a design must be a list: got {brief(problems)}")
    found = tuple(problems)
    if not found:
        raise CurriculumError("a design needs a problem, such as a miniature: got none")
    for one in found:
        instance("each problem of a design", one, Problem, CurriculumError)
        if has_tables(one.task) and one.level <= one.random_return + ROUNDING * abs(one.level):
            raise CurriculumError(
                f"a design needs problems with something to learn: in {one.name} the random "
                f"policy's return is {one.random_return:.4g}, and {one.level:.4g} counts as learnt"
            )
    return found


def _check_recipes(arms: Any) -> None:
    """Raise CurriculumError unless arms are recipes by name."""
    if arms is None:
        return
    if not isinstance(arms, Mapping):
        raise CurriculumError(f"the arms of a race must be a dict by name: got {brief(arms)}")
    for name, one in arms.items():
        instance(f"the arm {name!r} of a race", one, Recipe, CurriculumError)


def _set_aside(problems: Sequence[Problem], budget: SearchBudget, others: int, known: int) -> float:
    """Return what the judgement costs at least; CurriculumError if the rest pays for no race."""
    judgement = judgement_cost(problems, budget, others + min(1, known))
    least = race_cost(problems, budget) * fewest_runs(others) / SHARES["first"]
    if judgement + least > budget.left:
        spent = budget.ledger.cost
        raise CurriculumError(
            f"a design for these problems needs a budget of {spent + judgement + least:,.0f} "
            f"steps at least: got {budget.cost:,.0f}"
        )
    return judgement


def _raced(
    problems: Sequence[Problem],
    own: Mapping[str, Recipe],
    stays: dict[str, Recipe],
    budget: SearchBudget,
    aside: float,
    seeds: Iterator[int],
    bars: Bars,
) -> tuple[tuple[Race, ...], Recipe]:
    """Return a race of recipes, and of variations of its leader; and the best."""
    always: tuple[str, ...] = tuple(stays)
    races = list[Race]()

    def add(arms: Mapping[str, Recipe], first_seed: int) -> None:
        given: Any = {"always": always, "first_seed": first_seed}
        within = bars.within(f"race {len(races) + 1}")
        races.append(race(problems, arms, budget, **given, progress=within))
        bars.tell(races[-1])

    with budget.share(SHARES["first"], aside=aside):
        add({**stays, **own}, next(seeds))
    best = _leader(races[0])
    for first_seed in islice(seeds, VARIATIONS):
        if not best.stages:
            break
        several = len(problems[0].curriculum(best).in_edges(TARGET)) > 1
        arms = {**stays, LEADER: best, **variations(best, several=several)}
        try:
            with budget.share(SHARES["variation"], aside=aside):
                always = (*stays, LEADER)
                add(arms, first_seed)
        except CurriculumError:  # the budget does not pay for another race
            break
        if not _better(races[-1]):
            break
        best = _leader(races[-1])
    return tuple(races), best


def half_the_size(problems: Sequence[Problem]) -> Recipe | None:
    """Return the recipe with one source of half the size, with 50 steps a state.

    A crop where all problems have one, else the members of half the size, else starts half the way
    from the goal; None where they have none of these.
    """
    relations = [Relation("crop", 0.5), Relation("starts", 0.5)]
    relations.insert(1, Relation("member", changes={"size": "0.5 n"}))
    for one in relations:
        try:
            for problem in problems:
                one.source_of(problem.target)
        except CurricleError:
            continue
        return Recipe([Stage(one, 50)])
    return None


def _better(found: Race) -> bool:
    """Return whether a variation won by more than two standard errors over problems or runs.

    Of many variations one is always ahead by chance: the leader stays unless it was beaten.
    """
    if found.leader in (LEADER, FIXED, SCRATCH):
        return False
    less = found.differences(found.leader, LEADER)
    return (
        len(less) > 1 and float(less.mean()) < -ERRORS * float(less.std(ddof=1)) / len(less) ** 0.5
    )


def _leader(found: Race) -> Recipe:
    return Recipe() if found.leader == SCRATCH else found.arms[found.leader]


def _percent(interval: Any) -> str:
    return f"{interval.estimate:.0%} [{interval.low:.0%}, {interval.high:.0%}]"
