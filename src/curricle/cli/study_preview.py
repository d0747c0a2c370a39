"""The output of ``curricle check`` and ``run --dry-run``: tasks, cost, forecast, units left."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any

from curricle.cli.tables import line_width, print_table, print_text, wrapped
from curricle.comparison.forecasting import Forecast, JudgedPotentials, forecast
from curricle.comparison.plan import numbered_seeds
from curricle.comparison.trial import affordable, candidates_of, hindrance
from curricle.comparison.verdicts import seeds_needed, too_few_seeds
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import SourceValues
from curricle.errors import CurricleError, SettingError
from curricle.files import Place, place_at
from curricle.planning.target import LARGEST_EVALUATED, LARGEST_SOLVED, ROLLOUTS
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms, units_of
from curricle.study.config import StudyConfig
from curricle.study.cost import Cost, costs, duration, sweeping_seconds, total_words
from curricle.study.running import Done, usable_units
from curricle.study.store import StudyStore, bytes_a_seed, holds_study, seeds_per_file
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
            _megabytes(cost.table_bytes),
            duration(cost.seconds),
        )
        for cost in costing
    ]
    print_table(("cost at most", "seeds", "steps a seed", "tables", "time"), rows)
    seconds = sum(cost.seconds for cost in costing)
    print_text(f"about {duration(seconds)} on one processor, without compilation")
    if arms.budget is not None and arms.total not in (None, arms.budget):
        steps = arms.budget, arms.total, arms.eval_freq
        sources = any(curriculum.transfers for curriculum in arms.curricula.values())
        print_text(total_words(arms.target, *steps, sources=sources))
    print_text(traffic(study, arms, costing))
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
    try:
        study.check_networks()
    except SettingError as error:
        print_text(str(error))
    print_forecasts(study, arms, costing)


def too_few(study: StudyConfig, arms: Arms) -> str:
    """Return the text that a study has too few seeds for any verdict; empty if it has enough."""
    curricula = sum(not (arm.scratch or arm.control) for arm in arms.arms.values())
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


def traffic(study: StudyConfig, arms: Arms, costing: Sequence[Cost]) -> str:
    """Return a sentence on where a cluster's results go, and how large they are."""
    come_back, written, large, networks = 0, 0, set[str](), ""
    for cost in costing:
        node = arms.curricula[cost.arm].node(cost.task)
        size = 0 if node.deep else cost.seeds * bytes_a_seed(node)
        networks = ", and networks" if node.deep else networks
        if seeds_per_file(node) <= study.seeds_per_unit:
            written += size
            large.add(cost.task)
        else:
            come_back += size
    size = come_back + written
    text = f"on a cluster, results come back here: {_megabytes(size)} at most{networks}"
    if large:
        text += (
            f"; with --out at a URL, workers write those of {', '.join(sorted(large))} there, and "
            f"{_megabytes(come_back)} come back"
        )
    return text


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.1f} MB"


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
# at their budgets for the study's first seeds, which takes seconds and is said beforehand; and, in
# a line or where training would take too long, from sources that are solved, as if learnt
# perfectly.

LONGEST = 5.0  # estimated seconds, on one processor, up to which sources are trained for a forecast
LONGEST_DISTILLED = 60.0  # the same where networks are distilled: there is no forecast without them
LONGEST_COMPARING = 300.0
"""Seconds that comparing potentials in the target may take: nearly all episodes end long before the
limit by which they are estimated."""
PAIR_SECONDS = 2e-6  # of comparing phi with a pair's optimal value: 0.8 s for 390,625 pairs
ACTION_SECONDS = 4e-9  # of reading phi for an action at a step of a rollout, from two sources
LONGEST_TRIAL = 60.0  # seconds that the trials may take by the machine's own pace
SEEDS = 3  # of the sources, as ``curricle.forecast`` takes by default; one if that is slow


def print_forecasts(study: StudyConfig, arms: Arms, costing: Sequence[Cost]) -> None:
    """Print a forecast for each arm with transfers into the target, the first settings of each."""
    first = dict[str, str]()
    for name in study.arms:
        variant = (study.variants or {}).get(name)
        first.setdefault(name if variant is None else variant.arm, name)
    # Not those of `arms`, whose target has the total: a trial adds the sources' steps by itself.
    curricula = {
        name: curriculum
        for name, curriculum in study.curricula.items()
        if name in first.values() and curriculum.in_edges(curriculum.target)
    }
    if len(first) < len(study.arms):
        print("\nforecasts are for the first settings of each arm")
    keys = {
        name: {source: arms.keys[name, source] for source in curriculum.ancestors(arms.target)}
        for name, curriculum in curricula.items()
    }
    sources = {key: source for of_arm in keys.values() for source, key in of_arm.items()}
    if not sources:
        return
    print()
    most_seeds = min(SEEDS, len(study.seeds))
    target = next(cost for cost in costing if cost.task == arms.target)
    comparing = sum(_comparing_seconds(c, target.step_seconds) for c in curricula.values())
    if comparing * most_seeds > LONGEST_COMPARING:
        print_text(
            f"no forecast: to compare the potentials in {arms.target} could take "
            f"{duration(comparing * most_seeds)}; curricle.forecast does it, also with fewer "
            "episodes"
        )
        return
    by_key = {arms.keys[cost.arm, cost.task]: cost.seconds / cost.seeds for cost in costing}
    a_seed, judged = sum(by_key[key] for key in sources), JudgedPotentials()
    names = ", ".join(dict.fromkeys(sources.values()))
    distilled = any(
        curricula[name].node(source).takes_no_steps for name in keys for source in keys[name]
    )
    longest = LONGEST_DISTILLED if distilled else LONGEST
    seeds = next((study.seeds[:n] for n in (most_seeds, 1) if n * a_seed <= longest), None)
    if seeds is None:
        print_text(
            f"training {names} for one seed would take about {duration(a_seed)}, so these "
            "forecasts are for sources learnt perfectly; curricle.forecast trains them"
        )
        for name, curriculum in curricula.items():
            _print_forecast(name, judged, curriculum, perfect=True)
        return
    tried, seconds = _trials(curricula.values(), a_seed, target)
    quick = seconds <= LONGEST_TRIAL
    work = f"training {names} for {counted(len(seeds), 'seed')}"
    work += f" and trials of {counted(tried, 'seed')}" * bool(tried and quick)
    took = duration(len(seeds) * a_seed + seconds * quick)
    took += " after tabulating what is distilled" * distilled
    print_text(f"{work}, for the forecast: about {took}")
    if not quick:
        print_text(f"trials would take about {duration(seconds)} and are left out")
    sys.stdout.flush()
    known = dict[str, SourceValues]()  # sources that several arms share are trained once
    settings: dict[str, Any] = {"trial": None if quick else False, "threshold": study.threshold}
    for name, curriculum in curricula.items():
        trained = {source: known[key] for source, key in keys[name].items() if key in known}
        printed = _print_forecast(
            name, judged, curriculum, seeds=seeds, trained=trained, **settings
        )
        if printed is None:
            continue
        known |= {keys[name][source]: values for source, values in printed.trained.items()}
        if not curriculum.setting("shaping", arms.target).reads_values:
            continue  # perfect values would change nothing
        with suppress(CurricleError, ImportError):
            perfect = forecast(curriculum, judged=judged, perfect=True, only_used=True)
            used = perfect.used  # in a line: the potential that is used
            print_text(f"{perfect.computed_from}: {used.name} {used.verdict}")


def _trials(curricula: Iterable[Curriculum], a_seed: float, target: Cost) -> tuple[int, float]:
    """Return the most seeds of any trial, and all trials' seconds; `a_seed` is that of sources."""
    most, seconds = 0, 0.0
    for curriculum in curricula:
        if not hindrance(curriculum):
            some, seeds = affordable(candidates_of(curriculum, curriculum.target))
            most = max(most, seeds)
            learning = (1 + len(some)) * target.seconds / target.seeds
            seconds += seeds * (learning + len(some) * a_seed)
    return most, seconds


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
    sources = [curriculum.tasks[edge.source] for edge in edges]
    solving = sum(  # twice: trained, and learnt perfectly
        2 * sweeping_seconds(source, generative_model(source).states.size)
        for source in sources
        if not is_observation_task(source) and has_tables(source)
    )
    rollouts = ROLLOUTS * horizon * (step_seconds + model.actions.size * ACTION_SECONDS)
    if not has_tables(node.task) or pairs > LARGEST_SOLVED:
        return solving + potentials * rollouts
    if pairs * horizon <= LARGEST_EVALUATED:
        rollouts = 0.0
    return solving + potentials * (pairs * PAIR_SECONDS + rollouts)


def _print_forecast(
    arm: str, judged: JudgedPotentials, curriculum: Curriculum, **settings: Any
) -> Forecast | None:
    """Print and return the forecast of an arm, or print why there is none."""
    print(f"\narm {arm}")
    try:
        made = forecast(curriculum, judged=judged, **settings)
    except (CurricleError, ImportError) as error:
        print_text(f"no forecast: {error}")
        return None
    print(made.text(line_width()))
    return made
