"""The output of commands: tables as wide as the terminal, explained words, results, previews."""

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import asdict
from io import StringIO
from os.path import exists
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import Any

import numpy as np

from curricle.arrays import FloatArray
from curricle.checks import listed, one_of
from curricle.comparison.comparison import Comparison
from curricle.comparison.cost import Cost, costs, examining_seconds
from curricle.comparison.forecasting import Forecast, forecast
from curricle.comparison.plan import Memory, numbered_seeds, seed_ranges
from curricle.comparison.sentences import EXPLAINED, seeds_sentence
from curricle.comparison.trial import hindrance
from curricle.comparison.verdicts import seeds_needed, too_few_seeds
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.result import SourceValues
from curricle.errors import CurricleError, SettingError, StoreError, in_words
from curricle.files import Place, as_json, place_at
from curricle.statistics.curves import ROUNDING, SCRATCH
from curricle.study.arms import Arms, units_of
from curricle.study.config import FORECAST_SEEDS, StudyConfig, rivals
from curricle.study.results import StudyResults
from curricle.study.running import check_runnable, usable_units
from curricle.study.store import (
    CHOICE,
    STUDY,
    TRIALS,
    UNITS,
    Finished,
    StudyStore,
    check_ours,
    holds_study,
)
from curricle.study.tuning import (
    EFFECT_HEADS,
    NONE,
    effects_of,
    effects_rows,
    tuned_before,
    tuning_rows,
    tuning_words,
)
from curricle.study_file.vary import value_text
from curricle.tasks.live import is_live
from curricle.text import UNBOUNDED, counted, duration, text_table
from curricle.transfer.search import mapping_fault
from curricle.transfer.transfer import transfer_names

# -- Tables and texts on the terminal, as wide as it is; where there is none, nothing is folded ----

LINE = 80  # characters of a line of text where there is no terminal, and at most where there is one


def table_width() -> int:
    """Return the columns that a table may have."""
    return get_terminal_size().columns if sys.stdout.isatty() else UNBOUNDED


def line_width() -> int:
    """Return the characters that a line of text may have."""
    return min(LINE, table_width())


def print_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table of names and numbers to standard output."""
    for line in text_table(heads, rows, table_width()):
        print(line)


def print_text(text: str, indent: int = 0) -> None:
    """Print a paragraph, its lines after the first indented by two more."""
    print(wrapped(text, indent))


def wrapped(text: str, indent: int = 0) -> str:
    """Return a paragraph as lines that fit."""
    first, later = " " * indent, " " * (indent + 2)
    return fill(
        text, line_width(), initial_indent=first, subsequent_indent=later, break_on_hyphens=False
    )


# -- Answers as data -------------------------------------------------------------------------------

Data = dict[str, Any]


@contextmanager
def json_alone(wanted: bool) -> Iterator[Data]:
    """Yield a dict for what a command also prints; if `wanted` it alone is printed, as JSON."""
    answer = Data()
    with redirect_stdout(StringIO()) if wanted else nullcontext():  # what modules print, too
        yield answer
    if wanted:
        # JSON has null for numbers that are not finite.
        finite = json.loads(json.dumps(answer), parse_constant=lambda _: None)
        print(as_json(finite).decode(), end="")


def comparison_data(comparison: Comparison) -> Data:
    """Return a comparison as data: its rows with each curriculum's headroom, and its sentences."""
    names = ("target", "budget", "total", "seeds", "threshold", "threshold_from", "interim")
    reference = {name: getattr(comparison.reference, name) for name in ("random_return", "optimum")}
    rooms = {name: comparison.headroom(name) for name in comparison.controls}
    return {
        **{name: getattr(comparison, name) for name in names},
        **reference,
        "arms": [row | {"headroom": rooms.get(row["arm"])} for row in comparison.rows()],
        "failed": {name: in_words(error) for name, error in comparison.failed.items()},
        "sentences": comparison.sentences,
    }


# -- What the words under ``curricle check``, ``show`` and ``compare`` mean; the one place of it ---

EXPLANATIONS = {
    "arm": "one of the ways to learn the target that the study compares",
    "scratch": "the arm that learns the target without any source",
    "aggregate": "how the values of several sources become one potential",
    "greedy return": "the mean return of an episode in which the best known action is always taken",
    "charged": "steps in sources count as steps of the arm, which starts that much later",
    "evaluations are free": "steps of episodes that only measure the policy are not counted",
    **EXPLAINED,
    "whole checkpoints": "budgets are rounded up to a multiple of the steps between evaluations",
    "phi": "the potential: the sources' value of each state and action of the target",
    "gain": "strong gain in a trial, the comparison played in the model beforehand",
    "own policy": "what the greedy policy of phi returns before the first step of learning",
    "mapped": "pairs of the target that have a counterpart in the source",
    "unmapped": "pairs of which the source knows nothing",
    "learnt": "how far a source came from the random policy's return to its optimum",
}
"""Words, and what each means."""


def print_words() -> None:
    """Print what the words mean."""
    print()
    for word, meaning in EXPLANATIONS.items():
        print_text(f"{word}: {meaning}")


# -- What ``curricle show`` prints of a sweep or a tuning ------------------------------------------


def print_effects(results: StudyResults) -> None:
    """Print the best trial of each arm and the main effects, of a study that has finished seeds."""
    tuned, effects = results.record.tuned, effects_of(results)
    if tuned is not None:
        print()
        print_text(
            f"tuned on {tuned.on_seeds}, {tuned.total:,} steps a trial and seed, "
            "sources included; these steps are shown here and not charged to the curves"
        )
        heads, *best = tuning_rows(tuned)
        print_table(heads, best)
    if effects:
        print()
        print_text(
            "main effects: mean return, sources charged, over all arms, 95 % intervals over seeds"
        )
        print_table(EFFECT_HEADS, effects_rows(effects))


# -- The tables and sentences of ``curricle show`` -------------------------------------------------


def print_results(results: StudyResults, arm: str | None, task: str | None) -> Data:
    """Print a study's progress, what each task learnt, and the comparison if there is one."""
    _check(results, arm, task)
    record = results.record
    arms = "every arm" + " that has not failed" * bool(results.failed)
    total = counted(len(record.seeds), "seed")
    done = f"{len(results.seeds)} of {total} finished in {arms}"
    yet_to_tune = tuning_words(results.store)
    print_text(f"{record.name}: {done}{'' if yet_to_tune else seeds_left(results)}")
    if yet_to_tune:
        print_text(yet_to_tune)
    if record.chosen:
        print(record.chosen)
    learnt_tasks = [
        (name, node, learnt)
        for name, nodes in results.results.items()
        for node, learnt in nodes.items()
        if arm in (None, name) and task in (None, node)
        if node == record.target or not record.arms[name].control_of  # else it is another's source
    ]
    rows = [
        (
            f"{name}: {node}",
            f"{len(learnt.seeds)}",
            f"{learnt.steps_used.mean():,.0f}",
            f"{learnt.episodes_used.mean():,.0f}",
            _mean_and_deviation(learnt.greedy_return[:, -1]),
        )
        for name, node, learnt in learnt_tasks
    ]
    if rows:
        print_table(("", "seeds", "steps", "episodes", "greedy return"), rows)
        print_text(
            "(means over seeds; evaluations are free; the greedy return with its standard "
            "deviation)"
        )
    else:
        print_text("no unit is stored yet")
    # Of a study that is yet to be tuned the total is not known: budgets may be searched for.
    budget = None if yet_to_tune else record.budget
    if budget is not None and record.total not in (None, budget):
        steps = budget, record.total, record.eval_freq
        sources = any(recorded.transfers for recorded in record.arms.values())
        print_text(total_words(record.target, *steps, sources=sources))
    compared = record.total is not None and SCRATCH in {*record.arms} - {*results.failed}
    answer: Data = {"study": record.name, "planned": record.seeds, "seeds": results.seeds}
    answer |= {"failed": results.failed, "comparison": None}
    answer["tasks"] = [
        {"arm": name, "task": node, "greedy_return": learnt.greedy_return[:, -1].mean()}
        for name, node, learnt in learnt_tasks
    ]
    if compared and results.seeds:
        print(f"\n{results.comparison.text(table_width())}")
        answer["comparison"] = comparison_data(results.comparison)
        print_effects(results)
    else:
        for name, error in results.failed.items():
            print_text(f"{name} failed: {error}")
    return answer


def seeds_left(results: StudyResults) -> str:
    """Return how to finish seeds that the last run did not plan; empty if there are none."""
    seeds, store = results.record.seeds, results.store
    planned = {*results.runs[-1].seeds} if results.runs else {*seeds}
    if store.path.name in (TRIALS, CHOICE) or planned >= {*seeds} - {*results.seeds}:
        return ""
    whole = seed_ranges(seeds).replace("+", ",")
    return f"; run with --resume --seeds {whole} for the rest, or fewer seeds into another folder"


def decision_lines(
    results: StudyResults, arm: str | None, task: str | None, seed: int | None
) -> list[str]:
    """Return why tasks went on or stopped: all decisions of a seed, or each seed's last."""
    _check(results, arm, task)
    lines = [
        f"{name}: {node}, seed {number}: {reason}"
        for name, node in results.record.keys
        if arm in (None, name) and task in (None, node)
        for number, reasons in results.decisions(name, node).items()
        if seed in (None, number)
        for reason in (reasons[-1:] if seed is None else reasons)
    ]
    if not lines:
        raise StoreError(
            f"{results.store.path} holds no decision of arm {arm or 'any'}, task {task or 'any'}, "
            f"seed {'any' if seed is None else seed}"
        )
    return lines


def _check(results: StudyResults, arm: str | None, task: str | None) -> None:
    """Raise StoreError unless the study has the arm and the task."""
    if arm is not None:
        one_of("an arm", arm, results.record.arms, StoreError)
    if task is not None:
        tasks = dict.fromkeys(name for of, name in results.record.keys if arm in (None, of))
        one_of("a task" if arm is None else f"a task of {arm!r}", task, tasks, StoreError)


def _mean_and_deviation(returns: FloatArray) -> str:
    """Return mean and deviation, 0 if seeds differ only by rounding; a dash for no number."""
    mean, deviation = float(np.mean(returns)), float(np.std(returns))
    if np.isnan(mean):
        return "-"
    if len(returns) == 1:  # which has no deviation
        return f"{mean:.4g}"
    return f"{mean:.4g} ± {deviation if deviation > ROUNDING * abs(mean) else 0.0:.2g}"


# -- The results folders that ``curricle list`` prints ---------------------------------------------


def print_folders(folder: Path) -> None:
    """Print a line on each results folder: this one, or those in it and one level below."""
    with_results = list[Path]()
    for path in (folder, *sorted([*folder.glob("*/"), *folder.glob("*/*/")])):
        if path.parent not in with_results and any(exists(path / part) for part in (STUDY, UNITS)):
            with_results.append(path)  # but not the trials within a study
    if not with_results:
        print_text(f"no results in {folder} or one level below")
        return
    rows = [(f"{path}", *_brief(path)) for path in with_results]
    heads = "folder", "study", "arms", "seeds", "verdict"
    print(*text_table(heads, rows, table_width(), prose=True), sep="\n")


def _brief(path: Path) -> tuple[str, ...]:
    """Return a study's name, arms, seeds and verdicts as texts; or what a damaged folder lacks."""
    facts = NONE, NONE, NONE
    try:
        results = StudyResults(path)
        record, done = results.record, f"{len(results.seeds)} of {len(results.record.seeds)}"
        facts = record.name, f"{sum(not arm.control_of for arm in record.arms.values())}", done
        if not results.has_baseline:
            return *facts, "not compared with scratch"
        if not results.seeds:
            return *facts, tuning_words(results.store) or "no seed is finished in every arm yet"
        comparison, arms_by_answer = results.comparison, dict[str, list[str]]()
        for name, verdict in comparison.verdicts.items():
            arms_by_answer.setdefault(verdict.against_scratch, []).append(name)
        answers = [f"{listed(names)}: {answer}" for answer, names in arms_by_answer.items()]
        failed = [f"{name} failed" for name in comparison.failed]
        return *facts, "; ".join([comparison.withheld] if comparison.withheld else answers + failed)
    except (CurricleError, OSError) as error:
        return *facts, in_words(error)


# -- Before a study is run: its tasks, its cost, and what is left to do ----------------------------


def print_preview(study: StudyConfig, *, forecast: bool = False) -> Data:
    """Print each arm's graph, cost and forecast, the whole of it with `forecast`."""
    arms = Arms.of(study)
    units = units_of(study, arms, {})
    numbers = (len(arms.curricula), "arm"), (len(study.seeds), "seed"), (len(units), "unit")
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
    costing = costs(arms, units)
    rows = [
        (f"{cost.arm}: {cost.task}", f"{cost.seeds}", f"{cost.steps:,}", duration(cost.seconds))
        for cost in costing
    ]
    print_table(("cost at most", "seeds", "steps a seed", "time"), rows)
    seconds = sum(cost.seconds for cost in costing)
    answer: Data = {"study": study.name, "arms": [*arms.curricula], "seeds": study.seeds}
    answer |= {"units": len(units), "seconds": seconds, "budget": arms.budget, "total": arms.total}
    answer["costs"] = [asdict(cost) for cost in costing]
    print_text(
        f"at most about {duration(seconds)} on one processor, without compilation and forecasts"
    )
    if arms.budget is not None and arms.total not in (None, arms.budget):
        steps = arms.budget, arms.total, arms.eval_freq
        sources = any(curriculum.transfers for curriculum in arms.curricula.values())
        print_text(total_words(arms.target, *steps, sources=sources))
    if study.tune is not None:
        number, tried = len(study.tune.variants), Arms.of(study.trials)
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
        check_runnable(study)
    except SettingError as error:
        print_text(str(error))
    return answer | {"forecasts": print_forecasts(study, arms, costing, forecast)}


def total_words(target: str, budget: int, total: int, eval_freq: int, *, sources: bool) -> str:
    """Return a sentence on the steps of every arm, and why they exceed the target's budget."""
    spent = f"every arm spends {counted(total, 'step')}"
    why = f"{total - budget:,} for sources, in" if sources else "rounded up to"
    sentence = f"{spent}: {budget:,} of {target}, {why} whole checkpoints of {eval_freq:,}"
    if not sources_are_dear(budget, total):
        return sentence
    less = "smaller budgets of sources, or fewer resets of miniatures, are cheaper"
    return f"{sentence}; sources may take more than {target}: {less}"


def sources_are_dear(budget: int, total: int) -> bool:
    """Return whether sources take more steps than their target."""
    return total > 2 * budget


def too_few(study: StudyConfig, arms: Arms) -> str:
    """Return the text that a study has too few seeds for any verdict; empty if it has enough."""
    asked = questions(study, arms)
    return too_few_seeds(len(study.seeds), seeds_needed(asked)) if asked else ""


def questions(study: StudyConfig, arms: Arms) -> int:
    """Return the number of curricula that a study has verdicts on; 0 where nothing is compared."""
    compared = study.compared and SCRATCH in arms.curricula
    return sum(not (arm.scratch or arm.of) for arm in arms.arms.values()) if compared else 0


def graph(curriculum: Curriculum) -> Iterator[str]:
    """Yield a text for each task, sources first, and for each transfer into it."""
    for name in curriculum.order:
        node = curriculum.node(name)
        if node.deep:
            task, learner = node.task.shapes, node.learner.algorithm
        else:
            task, learner = " x ".join(node.sizes), type(node.learner).__name__
        steps = counted(node.budget, "step") if isinstance(node.budget, int) else str(node.budget)
        if node.distilled:
            steps = f"exact answers, {counted(node.most_steps, 'step')} charged"
        edges = curriculum.in_edges(name)
        # What a network takes over from its sources is a setting of its own, with a default.
        shaping = f"; {node.shaping.name}" if node.deep and edges else ""
        yield wrapped(f"{name}: {task}; {learner}; {steps}{shaping}", 2)
        if node.potential is not None:
            yield wrapped(f"a potential by hand for {name}", 4)
        for label, edge in zip(transfer_names(edges), edges, strict=True):
            cover = f"; {edge.mapping.coverage()}" if edge.mapping.countable else ""
            yield wrapped(f"{label}: {edge.mapping.description}{cover}", 4)


def units_left(study: StudyConfig, path: str | Place, shard: tuple[int, int]) -> Iterator[str]:
    """Yield lines on a folder's damaged and stale units, the units to train, and those done."""
    check_ours(place_at(path), resume=True)
    study = tuned_before(study, place_at(path))
    if study.choose:
        yield "first of all its arm is chosen by trials; which units follow is known after that"
        return
    arms = Arms.of(study)
    if study.tune is not None:
        yield (
            f"first of all {counted(len(study.tune.variants), 'trial')}; what follows is then "
            "trained with the best settings, not with those of the file"
        )
    done: Finished = {}
    if holds_study(place_at(path)):
        done, remarks = usable_units(StudyStore(path), arms, study.seeds, remove_damaged=False)
        yield from remarks
    missing = units_of(study, arms, done, shard)
    for unit in missing:
        most = arms.curricula[unit.arm].node(unit.task).most_steps
        yield f"{unit.label}: {counted(most, 'step')} at most"
    done_before = len(units_of(study, arms, {}, shard)) - len(missing)
    yield f"{counted(len(missing), 'unit')} to do, {done_before} done, in {path}"


# -- The forecasts that ``curricle check`` prints --------------------------------------------------
#
# They are those of ``curricle.forecast``: a trial in the model, and sources trained at their
# budgets for the study's first seeds, which takes seconds and is said beforehand.

LONGEST = 5.0  # estimated seconds, on one processor, up to which sources are trained for a forecast
LONGEST_DISTILLED = 60.0  # the same where networks are distilled: there is no forecast without them
LONGEST_EXAMINING = 300.0
"""Seconds that examining sources and a live target may take: nearly all episodes end long before
the limit by which they are estimated."""


def print_forecasts(study: StudyConfig, arms: Arms, costing: Sequence[Cost], whole: bool) -> Data:
    """Print a forecast for each arm with a potential of the target, the first settings of each."""
    first = dict[str, str]()
    for name in study.arms:
        variant = (study.variants or {}).get(name)
        first.setdefault(name if variant is None else variant.arm, name)
    if len(first) < len(study.arms):
        print("\nforecasts are for the first settings of each arm")
    if not any(curriculum.has_potential(arms.target) for curriculum in study.curricula.values()):
        print_text("no forecast: no arm has a source; the study compares learners without one")
    answer, memory = Data(), Memory()
    trained = dict[tuple[str, tuple[int, ...]], SourceValues]()  # by several arms, trained once
    for name in first.values():
        if not study.curricula[name].has_potential(arms.target):
            continue
        print(f"\narm {name}")
        try:
            made = forecast_of(name, study, arms, costing, memory, trained, whole=whole)
        except (CurricleError, ImportError) as error:
            print_text(f"no forecast: {error}")
            answer[name] = {"no_forecast": str(error)}
            continue
        answer[name] = {"answer": made.answer, "headroom": made.headroom}
        answer[name]["start"] = made.start and asdict(made.start)
        answer[name]["sources"] = {of: f"{learning}" for of, learning in made.sources.items()}
        answer[name]["trial"] = made.trial and comparison_data(made.trial)
        print(made.text(line_width()))
        edges = study.curricula[name].in_edges(arms.target)
        for fault in filter(None, map(mapping_fault, edges)):
            print_text(fault)
        if made.trial is not None and (asked := questions(study, arms)):
            of_trial = made.trial, made.used.name
            if sentence := seeds_sentence(*of_trial, asked, len(study.seeds)):
                print_text(sentence)
    return answer


def forecast_of(
    arm: str,
    study: StudyConfig,
    arms: Arms,
    costing: Sequence[Cost],
    memory: Memory,
    trained: dict[tuple[str, tuple[int, ...]], SourceValues],
    *,
    whole: bool,
) -> Forecast:
    """Return the forecast of an arm; SettingError where it takes too long, unless it is `whole`.

    Sources that `trained` has, by their keys and seeds, are not trained again; others are added.
    """
    # Not the curriculum in `arms`, whose target has the total: a trial adds sources' steps.
    curriculum = study.curricula[arm]
    most = min(FORECAST_SEEDS, len(study.seeds))  # of the sources; one if that is slow
    a_step = next(cost.step_seconds for cost in costing if cost.task == arms.target)
    examining = most * examining_seconds(curriculum, a_step)
    if examining > LONGEST_EXAMINING and not whole:
        raise SettingError(
            f"to examine its sources and {arms.target} could take {duration(examining)}; curricle "
            "check --forecast does it, and curricle.forecast also with fewer episodes"
        )
    keys = {source: arms.keys[arm, source] for source in curriculum.ancestors(arms.target)}
    by_key = {arms.keys[cost.arm, cost.task]: cost.seconds / cost.seeds for cost in costing}
    a_seed = sum(by_key[key] for key in {*keys.values()})
    distilled = any(curriculum.node(source).distilled for source in keys)
    longest = np.inf if whole else LONGEST_DISTILLED if distilled else LONGEST
    seeds = next((study.seeds[:n] for n in (most, 1) if n * a_seed <= longest), ())
    if not seeds:
        raise SettingError(
            f"training {', '.join(keys)} for one seed could take {duration(a_seed)}; curricle "
            "check --forecast makes it"
        )
    shared = {
        source: trained[key, seeds] for source, key in keys.items() if (key, seeds) in trained
    }
    if untrained := [source for source in keys if source not in shared]:
        live = examining * is_live(curriculum.tasks[arms.target])
        took = duration(len(seeds) * sum(by_key[keys[source]] for source in untrained) + live)
        took += " after tabulating what is distilled" * distilled
        work = f"{', '.join(untrained)} for {counted(len(seeds), 'seed')}"
        print_text(f"training {work}, for the forecast: about {took}")
    sys.stdout.flush()
    trial = True if whole and not hindrance(curriculum) else None
    how: Any = {"threshold": study.threshold, "trial": trial, "memory": memory, **rivals(study)}
    made = forecast(curriculum, seeds=seeds, trained=shared, **how)
    trained |= {(keys[source], seeds): values for source, values in made.trained.items()}
    return made
