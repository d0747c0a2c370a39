"""What ``curricle check`` prints: a study's tasks, its cost and a forecast, before it is run."""

from collections.abc import Iterator

from curricle.cli.forecast_preview import print_forecasts
from curricle.cli.terminal_tables import print_table, print_text, wrapped
from curricle.comparison.verdicts import seeds_needed, too_few_seeds
from curricle.curriculum.curriculum import Curriculum
from curricle.errors import SettingError
from curricle.files import Place, place_at
from curricle.statistics.curves import SCRATCH
from curricle.study.arms import Arms
from curricle.study.config.study_config import StudyConfig
from curricle.study.config.varied_settings import value_text
from curricle.study.cost import Cost, costs, duration, total_words
from curricle.study.folders import holds_study
from curricle.study.packing import bytes_a_seed, seeds_per_file
from curricle.study.resuming import Done, arms_in, tuned_before, usable_units
from curricle.study.store import StudyStore
from curricle.study.tuning import check_tuning, number_of_trials, tuning_of
from curricle.study.units import numbered_seeds, units_of
from curricle.text_tables import counted
from curricle.transfer.edges import countable, mapping_words, transfer_names


def print_preview(study: StudyConfig) -> None:
    """Print the graph of each arm, its cost, and forecasts, for which sources are trained."""
    arms = Arms.of(study)
    units = len(units_of(study, arms, {}))
    numbers = (len(arms.curricula), "arm"), (len(study.seeds), "seed"), (units, "unit")
    print_text(f"{study.name}: {', '.join(counted(*one) for one in numbers)}")
    for line in _swept(study):
        print_text(line, 2)
    if few := too_few(study, arms):
        print_text(few)
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, curriculum in arms.curricula.items():
        alike.setdefault(tuple(graph(curriculum)), []).append(name)
    for lines, names in alike.items():
        between = "; " if study.variants else ", "
        print(f"\narm{'s' * (len(names) > 1)} {between.join(names)}", *lines, sep="\n")
    print()
    each = costs(study, arms)
    _print_cost(each)
    if arms.budget is not None and arms.total not in (None, arms.budget):
        steps = arms.budget, arms.total, arms.eval_freq
        sources = any(one.transfers for one in arms.curricula.values())
        print_text(total_words(arms.target, *steps, sources=sources))
    print_text(traffic(study, arms, each))
    if study.tune is not None:
        print_text(_tuning(study, arms, each))
    try:
        study.check_networks()
    except SettingError as error:
        print_text(str(error))
    print_forecasts(study, arms, each)


def too_few(study: StudyConfig, arms: Arms) -> str:
    """Return that a study has too few seeds for any verdict, in words; empty if it has enough."""
    curricula = len(arms.curricula) - len(arms.scratches)
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
            sizes = (node.task.states.size, "state"), (node.task.actions.size, "action")
            task = " x ".join(counted(*one) for one in sizes)
            learner = type(node.learner).__name__
        steps = counted(node.budget, "step") if isinstance(node.budget, int) else node.budget
        steps = "no steps, by exact answers" if node.takes_no_steps else steps
        yield wrapped(f"{name}: {task}; {learner}; {steps}", 2)
        edges = curriculum.in_edges(name)
        for label, edge in zip(transfer_names(edges), edges, strict=True):
            cover = f"; {edge.mapping.coverage()}" if countable(edge.mapping) else ""
            yield wrapped(f"{label}: {mapping_words(edge)}{cover}", 4)


def _swept(study: StudyConfig) -> Iterator[str]:
    """Yield each setting that is swept, with its values."""
    values: dict[str, dict[str, None]] = {}
    for one in (study.variants or {}).values():
        for key, value in one.values.items():
            values.setdefault(key, {})[value_text(value)] = None
    yield from (f"swept: {key} = {', '.join(texts)}" for key, texts in values.items())


def _tuning(study: StudyConfig, arms: Arms, each: list[Cost]) -> str:
    """Return what tuning every arm takes at most, in words."""
    tune, total = tuning_of(study), check_tuning(study)
    number = number_of_trials(study)
    runs = number * len(tune.seeds)
    one = sum(one.seconds / one.seeds for one in each) / len(arms.curricula)
    return (
        f"before that, tuning: {counted(tune.trials, 'trial')} of each arm on "
        f"{numbered_seeds(tune.seeds)}, {counted(number, 'trial')} in all, {runs * total:,} steps, "
        f"about {duration(runs * one)}; the costs above are of the file's own settings, and with "
        f"the best of the search every arm spends at most {counted(total, 'step')}"
    )


def _print_cost(each: list[Cost]) -> None:
    rows = [
        (
            f"{one.arm}: {one.task}",
            f"{one.seeds}",
            f"{one.steps:,}",
            _megabytes(one.table_bytes),
            duration(one.seconds),
        )
        for one in each
    ]
    print_table(("cost at most", "seeds", "steps a seed", "tables", "time"), rows)
    seconds = sum(one.seconds for one in each)
    print_text(f"about {duration(seconds)} on one processor, without compilation")


def traffic(study: StudyConfig, arms: Arms, each: list[Cost]) -> str:
    """Return where the results of units on a cluster go, and how large they are, in words."""
    come_back, written, large = 0, 0, set[str]()
    for one in each:
        node = arms.curricula[one.arm].node(one.task)
        size = 0 if node.deep else one.seeds * bytes_a_seed(node)
        if seeds_per_file(node) <= study.seeds_per_unit:
            written += size
            large.add(one.task)
        else:
            come_back += size
    text = f"on a cluster, results come back here: {_megabytes(come_back + written)} at most"
    if any(arms.curricula[one.arm].node(one.task).deep for one in each):
        text += ", and networks"
    if large:
        text += (
            f"; with --out at a URL, workers write those of {', '.join(sorted(large))} there, and "
            f"{_megabytes(come_back)} come back"
        )
    return text


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.1f} MB"


def units_left(
    study: StudyConfig, path: str | Place, shard: tuple[int, int], *, keep_stale: bool
) -> Iterator[str]:
    """Yield what is damaged or stale in a folder, what a run would train, and how much is done."""
    arms = arms_in(study, path, keep_stale=keep_stale)
    remarks = list[str]()
    study, arms = tuned_before(study, arms, path, remarks.append, keep_stale=keep_stale)
    yield from remarks
    if study.tune is not None:
        check_tuning(study)
        yield (
            f"first of all {counted(study.tune.trials, 'trial')} of each arm; what follows is then "
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
