"""A unit of the match: one designer in one domain, tuned and then judged.

The order of play is the same for every designer:

1. tuning: at each learning rate it designs for each map of development, and what it designed is
   trained with seeds of tuning. The rate with the fewest steps, as a share of a training's length,
   is its own from here on. Every designer gets as many trials as learning alone.
2. judging: for each held-out target it designs at that rate, within its budget, and what it
   designed is trained with seeds that neither tuning nor search has seen.

Every step of a search is booked. A study (`curricle.study`) does not fit, as its curricula are
given in a file, while here they are designed while it runs and what that costs is the point; so a
unit is a file of lines. It depends on its settings, not on code: after a change of code, begin
another folder.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.referee.domains import Case, Domain, domain
from benchmarks.referee.lines import Lines, Record, held
from benchmarks.referee.players import PLAYERS, Player
from benchmarks.referee.problem import Problem, SearchBudget
from benchmarks.referee.recipes import Recipe
from curricle.curriculum.curriculum import Curriculum
from curricle.design import SourceCandidates, source_candidates
from curricle.errors import CurricleError

RATES = (0.1, 0.2, 0.5, 0.9)
FIRST_TUNING_SEED, DESIGN_SEED = 1_000_000, 2_000_000
"""Judging begins at seed 0: the three never meet."""


@dataclass(frozen=True)
class Settings:
    """How much is played.

    Attributes
    ----------
    seeds, tuning_seeds : int
        Of each judged training, and of each trial of a learning rate.
    search : int
        The budget of a design for one target, in full trainings of it.
    recipe_search : int
        That of a recipe for a domain, in full trainings of its maps of development. It is larger,
        as it is spent once for all targets.
    candidates : int
        Sources that a designer may choose from, at most.
    development, held_out : int
        Targets of a domain, at most.
    """

    seeds: int = 30
    tuning_seeds: int = 10
    search: int = 100
    recipe_search: int = 1500
    candidates: int = 12
    development: int = 6
    held_out: int = 30


FULL = Settings()
QUICK = Settings(
    seeds=3, tuning_seeds=2, search=6, recipe_search=60, candidates=4, development=1, held_out=1
)


def path_of(folder: Path, player: str, name: str) -> Path:
    """Return the file of a unit."""
    return folder / f"{player}--{name.replace(' ', '-')}.jsonl"


def play(player: str, name: str, settings: Settings, folder: Path) -> bool:
    """Play what is missing of a unit; False where another process is at it."""
    path = path_of(folder, player, name)
    with held(path) as alone:
        if alone:
            for _ in records(PLAYERS[player], name, settings, Lines(path)):
                pass
        return alone


def records(
    player: Player, name: str, settings: Settings, lines: Lines
) -> Iterator[tuple[str, Record]]:
    """Yield each record of a unit with "tuning" or "judged", played where it is not known."""
    place = domain(name).part(settings.development, settings.held_out)
    recipe = cache(lambda rate: _search(player, place, settings, rate))
    tuning = dict[float, list[Record]]()
    for rate in RATES:
        tuning[rate] = []
        for case in place.development:
            key = [asdict(settings), "tuning", rate, case.name, case.steps]
            seeds = range(FIRST_TUNING_SEED, FIRST_TUNING_SEED + settings.tuning_seeds)
            trial = _trial(player, place, case, rate, settings, seeds, recipe)
            tuning[rate].append(lines.once(key, trial))
            yield "tuning", tuning[rate][-1]
    rate = best_rate(tuning)
    for case in place.held_out:
        key = [asdict(settings), "judged", rate, case.name, case.steps]
        trial = _trial(player, place, case, rate, settings, range(settings.seeds), recipe)
        yield "judged", lines.once(key, trial)


def best_rate(tuning: dict[float, list[Record]]) -> float:
    """Return the learning rate with the fewest steps, each map's as a share of its length.

    Examples
    --------
    >>> best_rate({0.1: [{"steps": [40, 60], "length": 100}],
    ...            0.5: [{"steps": [30, 50], "length": 100}]})
    0.5
    """

    def share(rate: float) -> float:
        return float(np.mean([np.mean(one["steps"]) / one["length"] for one in tuning[rate]]))

    return min(tuning, key=share)


Recipes = Callable[[float], tuple[Recipe, float]]


def _trial(
    player: Player,
    place: Domain,
    case: Case,
    rate: float,
    settings: Settings,
    seeds: range,
    recipe: Recipes,
) -> Callable[[], Record]:
    """Return what designs for a case and trains what was designed."""

    def made() -> Record:
        problem = place.problem(case, rate)
        facts: Record = {"case": case.name, "length": case.steps, "rate": rate}
        try:
            if player.on_target:
                plan, cost = _design(player, problem, settings)
            else:
                shared, cost = recipe(rate)
                plan = shared.curriculum(problem)
        except CurricleError as error:  # it has no design for this target: learning alone is left
            plan, cost, facts["refused"] = problem.scratch, 0.0, str(error)
        trained, _ = problem.train(plan, seeds)
        return {
            **facts,
            "steps": trained.steps.tolist(),
            "learnt": trained.learnt.tolist(),
            "source_steps": trained.source_steps.tolist(),
            "search": cost,
            "shared": not player.on_target,
            "sources": list(plan.order[:-1]),
        }

    return made


def _design(player: Player, problem: Problem, settings: Settings) -> tuple[Curriculum, float]:
    """Return what a designer made of a problem, and the steps of its search."""
    budget = SearchBudget(settings.search * problem.steps)
    candidates = _candidates(problem.target, settings.candidates)
    plan = player.design(problem, candidates, budget, seed=DESIGN_SEED)
    return plan, float(budget.spent)


def _search(player: Player, place: Domain, settings: Settings, rate: float) -> tuple[Recipe, float]:
    """Return the recipe that a designer found on the maps of development, and its steps."""
    problems = [place.problem(case, rate) for case in place.development]
    most = settings.recipe_search * float(np.mean([problem.steps for problem in problems]))
    budget = SearchBudget(most)
    shared = player.design(problems, budget, seed=DESIGN_SEED)
    return shared, float(budget.spent)


@cache
def _candidates(target: Any, most: int) -> SourceCandidates:
    """Return the candidates of a target, which all designers share."""
    return source_candidates(target, most=most)
