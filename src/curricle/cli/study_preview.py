"""The output of ``curricle check`` and ``run --dry-run``: tasks, cost, forecast, units left."""

import sys
from collections.abc import Iterator, Sequence
from typing import Any

from curricle.cli.tables import line_width, print_table, print_text, wrapped
from curricle.comparison.forecasting import JudgedPotentials, forecast
from curricle.comparison.plan import numbered_seeds
from curricle.comparison.verdicts import seeds_needed, too_few_seeds
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import SourceValues
from curricle.errors import CurricleError, SettingError
from curricle.files import Place, place_at
from curricle.planning.target import LARGEST_EVALUATED, LARGEST_SOLVED, ROLLOUTS
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms, units_of
from curricle.study.config import StudyConfig, rivals
from curricle.study.cost import Cost, costs, duration, sweeping_seconds, total_words
from curricle.study.running import Done, usable_units
from curricle.study.store import StudyStore, holds_study
from curricle.study.tuning import tuned_before
from curricle.study_file.vary import value_text
from curricle.tasks.mdp import generative_model, has_tables
from curricle.tasks.observation_task import is_observation_task
from curricle.text import counted
from curricle.transfer.aggregate import COMPARED
from curricle.transfer.rollouts import OBSERVATION_ROLLOUTS
from curricle.transfer.transfer import transfer_names

# -- Before a study is run: its tasks, its cost, and what is left to do ----------------------------


def print_preview(study: StudyConfig) -> None:
    """Print each arm's graph, cost and forecast; forecasts train the sources."""
    arms = Arms.of(study)
    units = len(units_of(study, arms, {}))
    numbers = (len(arms.curricula), "arm"), (len(study.seeds), "seed"), (units, "unit")
    print_text(f"{study.name}: {', '.join(counted(*number) for number in numbers)}")
    swept: dict[str, dict[str, None]] = {}
    for variant in (study.variants or {}).values():
        for key, value in variant.values.items():
            swept.setdefault(key, {})[value_text(value)] = None
    for key, texts in swept.items():
        print_text(f"swept: {key} = {', '.join(texts)}", 2)
    if few := too_few(study, arms):
        print_text(few)
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, curriculum in arms.curricula.items():
        alike.setdefault(tuple(graph(curriculum)), []).append(name)
    for lines, names in alike.items():
        between = "; " if study.variants else ", "
        print(f"\narm{'s' * (len(names) > 1)} {between.join(names)}", *lines, sep="\n")
    print()
    costing = costs(study, arms)
    rows = [
        (
            f"{cost.arm}: {cost.task}",
            f"{cost.seeds}",
            f"{cost.steps:,}",
            duration(cost.seconds),
        )
        for cost in costing
    ]
    print_table(("cost at most", "seeds", "steps a seed", "time"), rows)
    seconds = sum(cost.seconds for cost in costing)
    print_text(f"about {duration(seconds)} on one processor, without compilation")
    if arms.budget is not None and arms.total not in (None, arms.budget):
        steps = arms.budget, arms.total, arms.eval_freq
        sources = any(curriculum.transfers for curriculum in arms.curricula.values())
        print_text(total_words(arms.target, *steps, sources=sources))
    if study.tune is not None:
        number, tried = len(study.tune.variants), Arms.of(study.of_trials())
        runs = number * len(study.tune.seeds)
        seconds = runs * sum(cost.seconds / cost.seeds for cost in costing) / len(arms.curricula)
        print_text(
            f"before that, tuning: {counted(number, 'trial')} on "
            f"{numbered_seeds(study.tune.seeds)}, {runs * (tried.total or 0):,} steps, about "
            f"{duration(seconds)}; the costs above are of the file's own settings, and with the "
            f"best of the trials every arm spends at most {counted(tried.total or 0, 'step')}"
        )
    if study.choose:
        print_text("before that, its arm is chosen; the costs above are of the file's own arms")
    try:
        study.check_networks()
    except SettingError as error:
        print_text(str(error))
    print_forecasts(study, arms, costing)


def too_few(study: StudyConfig, arms: Arms) -> str:
    """Return the text that a study has too few seeds for any verdict; empty if it has enough."""
    curricula = sum(not (arm.scratch or arm.of) for arm in arms.arms.values())
    if SCRATCH not in arms.curricula or not curricula:
        return ""
    return too_few_seeds(len(study.seeds), seeds_needed(curricula))


def graph(curriculum: Curriculum) -> Iterator[str]:
    """Yield a text for each task, sources first, and for each transfer into it."""
    for name in curriculum.order:
        node = curriculum.node(name)
        if node.deep:
            task, learner = node.task.shapes, node.learner.algorithm
        else:
            task, learner = " x ".join(node.sizes), type(node.learner).__name__
        steps = "no steps, by exact answers" if node.takes_no_steps else node.budget_text
        yield wrapped(f"{name}: {task}; {learner}; {steps}", 2)
        edges = curriculum.in_edges(name)
        for label, edge in zip(transfer_names(edges), edges, strict=True):
            cover = f"; {edge.mapping.coverage()}" if edge.mapping.countable else ""
            yield wrapped(f"{label}: {edge.mapping.description}{cover}", 4)


def units_left(study: StudyConfig, path: str | Place, shard: tuple[int, int]) -> Iterator[str]:
    """Yield lines on a folder's damaged and stale units, the units to train, and those done."""
    study = tuned_before(study, place_at(path))
    arms = Arms.of(study)
    if study.tune is not None:
        yield (
            f"first of all {counted(len(study.tune.variants), 'trial')}; what follows is then "
            "trained with the best settings, not with those of the file"
        )
    done: Done = {}
    if holds_study(place_at(path)):
        done, remarks = usable_units(StudyStore(path), arms, remove_damaged=False)
        yield from remarks
    left = units_of(study, arms, done, shard)
    for unit in left:
        most = arms.curricula[unit.arm].node(unit.task).most_steps
        yield f"{unit.label}: {counted(most, 'step')} at most"
    done_before = len(units_of(study, arms, {}, shard)) - len(left)
    yield f"{counted(len(left), 'unit')} to do, {done_before} done, in {path}"


# -- The forecasts that ``curricle check`` prints --------------------------------------------------
#
# They are those of ``curricle.forecast``: a trial in the model, and potentials from sources trained
# at their budgets for the study's first seeds, which takes seconds and is said beforehand; where it
# would take too long, from sources that are solved, as if learnt perfectly.

LONGEST = 5.0  # estimated seconds, on one processor, up to which sources are trained for a forecast
LONGEST_DISTILLED = 60.0  # the same where networks are distilled: there is no forecast without them
LONGEST_COMPARING = 300.0
"""Seconds that comparing potentials in the target may take: nearly all episodes end long before the
limit by which they are estimated."""
ACTION_SECONDS = 4e-9  # of reading phi for an action at a step of a rollout, from two sources
SEEDS = 3  # of the sources, as ``curricle.forecast`` takes by default; one if that is slow


def print_forecasts(study: StudyConfig, arms: Arms, costing: Sequence[Cost]) -> None:
    """Print a forecast for each arm with transfers into the target, the first settings of each."""
    first = dict[str, str]()
    for name in study.arms:
        variant = (study.variants or {}).get(name)
        first.setdefault(name if variant is None else variant.arm, name)
    if len(first) < len(study.arms):
        print("\nforecasts are for the first settings of each arm")
    by_key = {arms.keys[cost.arm, cost.task]: cost.seconds / cost.seeds for cost in costing}
    a_step = next(cost.step_seconds for cost in costing if cost.task == arms.target)
    # Sources that several arms share are trained once.
    judged, known = JudgedPotentials(), dict[tuple[str, tuple[int, ...]], SourceValues]()
    for name in first.values():
        # Not the curriculum in `arms`, whose target has the total: a trial adds sources' steps.
        curriculum = study.curricula[name]
        if not curriculum.in_edges(arms.target):
            continue
        print(f"\narm {name}")
        most = min(SEEDS, len(study.seeds))
        if (comparing := most * _comparing_seconds(curriculum, a_step)) > LONGEST_COMPARING:
            print_text(
                f"no forecast: to compare the potentials in {arms.target} could take "
                f"{duration(comparing)}; curricle.forecast does it, also with fewer episodes"
            )
            continue
        keys = {source: arms.keys[name, source] for source in curriculum.ancestors(arms.target)}
        distilled = any(curriculum.node(source).takes_no_steps for source in keys)
        a_seed = sum(by_key[key] for key in {*keys.values()})
        longest = LONGEST_DISTILLED if distilled else LONGEST
        seeds = next((study.seeds[:n] for n in (most, 1) if n * a_seed <= longest), ())
        there = {source: known[key, seeds] for source, key in keys.items() if (key, seeds) in known}
        how: Any = {"seeds": seeds, "trained": there, "threshold": study.threshold}
        how |= rivals(study)
        if not seeds:
            how = {"perfect": True}
            print_text(
                f"training {', '.join(keys)} for one seed would take about {duration(a_seed)}, so "
                "this forecast is for sources learnt perfectly; curricle.forecast trains them"
            )
        elif untrained := [source for source in keys if source not in there]:
            took = duration(len(seeds) * sum(by_key[keys[source]] for source in untrained))
            took += " after tabulating what is distilled" * distilled
            work = f"{', '.join(untrained)} for {counted(len(seeds), 'seed')}"
            print_text(f"training {work}, for the forecast: about {took}")
        sys.stdout.flush()
        try:
            made = forecast(curriculum, judged=judged, **how)
        except (CurricleError, ImportError) as error:
            print_text(f"no forecast: {error}")
            continue
        print(made.text(line_width()))
        if seeds:
            known |= {(keys[source], seeds): values for source, values in made.trained.items()}


def _comparing_seconds(curriculum: Curriculum, step_seconds: float) -> float:
    """Return the most seconds a seed that judging an arm's potentials and sources takes."""
    node, edges = curriculum.node(curriculum.target), curriculum.in_edges(curriculum.target)
    potentials = len(COMPARED) + 1 + len(edges) if len(edges) > 1 else 1
    try:
        horizon = node.evaluation.horizon(node.task)
    except SettingError:  # which the forecast will say
        return 0.0
    if node.deep:
        return potentials * OBSERVATION_ROLLOUTS * horizon * step_seconds
    model = generative_model(node.task)
    pairs = model.states.size * model.actions.size
    sources = [curriculum.tasks[name] for name in {edge.source for edge in edges}]
    solving = sum(
        sweeping_seconds(source, generative_model(source).states.size)
        for source in sources
        if not is_observation_task(source) and has_tables(source)
    )
    if has_tables(node.task) and pairs <= LARGEST_SOLVED and pairs * horizon <= LARGEST_EVALUATED:
        return solving
    rollouts = ROLLOUTS * horizon * (step_seconds + model.actions.size * ACTION_SECONDS)
    return solving + potentials * rollouts
