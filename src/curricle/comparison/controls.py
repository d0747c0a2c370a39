"""Controls: arms that equal a curriculum except for the part that is supposed to help.

- ``random_start``: the source is the target with a uniform start, for as many steps. If it helps as
  much, visiting many states helped, not the easier task.
- ``pretraining``: the source is the target itself, for as many steps. If it helps as much, the
  longer training helped.
- ``placebo``: phi's values shuffled over the target's pairs, in the curriculum's portfolio and
  without it. If it helps as much, any values do.
- ``constant``: adds the opponent of this name (:mod:`curricle.comparison.opponents`) where the
  setting ``opponents`` leaves it out.
- ``negated``: -phi. It should do harm if phi helps.
- ``unrelated``: the source's task with the outcomes of its pairs exchanged at random, its exact
  values read by the best mapping that a search finds. If it helps as much, the search helped,
  because the search reads the target's model.

The values of a ``placebo`` say nothing about the task. An observation task has no numbered states:
it has no ``random_start``, and a ``placebo`` only of miniatures, which gives each observation the
answer of another observation. ``negated`` needs no dense tables. An arm whose
potential is written by hand has no source to change: it has only those that change the potential.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from curricle.curriculum.curriculum import Curriculum, TrainingOptions
from curricle.curriculum.result import SourceValues
from curricle.deep.miniature import Miniatures
from curricle.errors import CurriculumError
from curricle.learning.potential import PairPotential, StateActionPotential
from curricle.learning.result import LearningResult, joined_results
from curricle.learning.stopping import StoppingRule
from curricle.tasks.gridworld import GridWorld
from curricle.tasks.mdp import live_pairs, tables
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.start_states import with_start
from curricle.transfer.by_components import identity
from curricle.transfer.mapping import UNMAPPED, StateActionMapping
from curricle.transfer.pair import TaskPair
from curricle.transfer.potential import AnyPotential
from curricle.transfer.search import find_mappings
from curricle.transfer.transfer import Transfer

Control = Literal["random_start", "pretraining", "placebo", "constant", "negated", "unrelated"]
CONTROLS: tuple[Control, ...] = get_args(Control)
PLACEBO, ALONE = "placebo", "placebo, alone"
UNRELATED = "unrelated"
WITHOUT_TABLES = ("constant", "negated")  # controls that need no dense tables of the target
SOURCE = "control source"


def check_fit(controls: Sequence[str], arm: str, curriculum: Curriculum) -> None:
    """Raise CurriculumError unless a curriculum's target can be learnt with these controls."""
    name = curriculum.target
    if controls and not curriculum.has_potential(name):
        raise CurriculumError(
            f"controls need a potential of the target: arm {arm!r} has neither a transfer into "
            f"{name!r} nor a potential by hand"
        )
    if is_observation_task(curriculum.tasks[name]):
        _check_observed(controls, arm, curriculum)
    elif any(control not in WITHOUT_TABLES for control in controls):
        tables(curriculum.tasks[name])
        if curriculum.setting("storage", name).kind == "sparse":
            raise CurriculumError(
                "controls other than 'negated' need dense tables of the target: the "
                f"storage of {name!r} is sparse in arm {arm!r}"
            )
        for edge in curriculum.in_edges(name) if UNRELATED in controls else ():
            tables(curriculum.tasks[edge.source])


def _check_observed(controls: Sequence[str], arm: str, curriculum: Curriculum) -> None:
    name, shaping = curriculum.target, curriculum.setting("shaping", curriculum.target)
    sources = [curriculum.tasks[edge.source] for edge in curriculum.in_edges(name)]
    all_miniatures = sources and all(isinstance(source, Miniatures) for source in sources)
    for control in controls:
        if control == "placebo" and all_miniatures:
            continue
        if control in ("random_start", "placebo", "constant", UNRELATED):
            raise CurriculumError(
                f"a control {control!r} needs numbered states: {name!r}, the target of arm "
                f"{arm!r}, is seen through observations"
            )
        if control != "pretraining" and not shaping.reads_values:
            raise CurriculumError(
                f"a control {control!r} changes the values of a potential: the target of arm "
                f"{arm!r} has the shaping {shaping.name}, which does not read them"
            )


def shuffled_miniatures(curriculum: Curriculum) -> Curriculum:
    """Return a curriculum whose miniatures have their answers shuffled over observations."""
    tasks: dict[str, Any] = dict(curriculum.tasks)
    for name, task in tasks.items():
        if isinstance(task, Miniatures):
            tasks[name] = replace(task, shuffled=True)
    transfers = []
    for edge in curriculum.transfers:
        source, target = tasks[edge.source], tasks[edge.target]
        if isinstance(source, Miniatures) or isinstance(target, Miniatures):
            edge = replace(edge, mapping=replace(edge.mapping, source=source, target=target))
        transfers.append(edge)
    return replace(curriculum, tasks=tasks, transfers=transfers)


def source_control(curriculum: Curriculum, label: str, steps: int) -> Curriculum:
    """Return a curriculum whose only source is its target, trained for `steps`."""
    name, task = curriculum.target, curriculum.tasks[curriculum.target]
    source = task
    if label == "random start":
        source = with_start(task if isinstance(task, GridWorld) else tables(task), "uniform")
    storage = curriculum.setting("storage", name)
    return Curriculum(
        tasks={SOURCE: source, name: task},
        transfers=[Transfer(SOURCE, name, identity(task, source))],
        shaping={name: curriculum.setting("shaping", name)},
        budget={SOURCE: StoppingRule(steps), name: curriculum.setting("budget", name)},
        eval_freq={SOURCE: steps, name: curriculum.setting("eval_freq", name)},
        storage={SOURCE: replace(storage, save_values=True), name: storage},
        learner=curriculum.setting("learner", name),
        evaluation=curriculum.setting("evaluation", name),
    )


Change = Callable[[Any, int], AnyPotential]  # phi, seed -> the changed phi
CHANGES: dict[str, Change] = {
    PLACEBO: lambda phi, seed: _shuffled(phi, seed),
    ALONE: lambda phi, seed: _shuffled(phi, seed),
    "negated": lambda phi, _: phi.rescaled(-1.0),
}
"""Label of a control -> the function by which it changes a potential."""
LABELS: dict[Control, tuple[str, ...]] = {
    "placebo": (PLACEBO, ALONE),
    "negated": ("negated",),
    "unrelated": (UNRELATED,),
    "random_start": ("random start",),
    "pretraining": ("pretraining",),
}
"""Control -> the labels of its arms, in the order in which they follow their curriculum."""


def control_arms(
    controls: Sequence[Control], curriculum: Curriculum
) -> Iterator[tuple[str, Curriculum]]:
    """Yield the label of each control arm of a curriculum, and the curriculum it trains."""
    target = curriculum.target
    shaping = curriculum.setting("shaping", target)
    for control, labels in LABELS.items():
        for label in labels if control in controls else ():
            if label not in CHANGES and not curriculum.in_edges(target):
                continue
            if is_shuffled(label, curriculum):
                yield label, shuffled_miniatures(curriculum)
            elif label != ALONE:
                yield label, curriculum
            elif shaping.portfolio is not None:
                yield label, curriculum.replace(target, shaping=replace(shaping, portfolio=None))


def is_shuffled(label: str, curriculum: Curriculum) -> bool:
    """Return whether a control arm learns from miniatures with shuffled answers."""
    return label == PLACEBO and is_observation_task(curriculum.tasks[curriculum.target])


def train_control(
    label: str,
    curriculum: Curriculum,
    seeds: tuple[int, ...],
    sources: Mapping[str, SourceValues],
    potentials: Sequence[AnyPotential],
    options: TrainingOptions,
) -> LearningResult:
    """Return the results of seeds in a control arm's target, each charged what its sources took."""
    name, spent = curriculum.target, np.asarray(options.charged)
    if is_shuffled(label, curriculum):
        return curriculum.train_task(name, sources, seeds, options)[0]
    if label == UNRELATED:
        numbers, parts = np.array(seeds), []
        for draw in np.unique(numbers % DRAWS).tolist():
            some, node = numbers % DRAWS == draw, curriculum.node(name)
            taken, edges = unrelated_transfers(curriculum, numbers[some].tolist(), draw)
            some_seeds = taken[edges[0].source].seeds
            phi = curriculum.potentials(name, taken, transfers=edges)
            parts.append(node.train(some_seeds, phi, options._replace(charged=spent[some])))
        return joined_results(parts)
    if label not in CHANGES:
        parts = []
        for steps in np.unique(spent):
            some = [seeds[k] for k in np.flatnonzero(spent == steps).tolist()]
            changed_source = source_control(curriculum, label, int(steps))
            workers, progress = options.workers, options.progress
            trained = changed_source.train(some, charge=True, workers=workers, progress=progress)
            parts.append(trained[name])
        return joined_results(parts)
    if not potentials:
        potentials = curriculum.potentials(name, sources, seeds=len(seeds))
    changed = [CHANGES[label](phi, k) for phi, k in zip(potentials, seeds, strict=True)]
    return curriculum.node(name).train(seeds, changed, options)


DRAWS = 3  # unrelated tasks, which seeds take in turn, since some may be easier to map


def unrelated_transfers(
    curriculum: Curriculum, seeds: Sequence[int], draw: int
) -> tuple[dict[str, SourceValues], list[Transfer]]:
    """Return unrelated sources with their exact values, and transfers by the mappings found."""
    target, sources, edges = curriculum.tasks[curriculum.target], dict[str, SourceValues](), []
    for edge in curriculum.in_edges(curriculum.target):
        mdp = tables(curriculum.tasks[edge.source])
        rows, live = mdp.outcome_row.copy(), live_pairs(mdp)
        rng = np.random.default_rng([draw, 2])
        rows[live] = rng.permutation(rows[live])
        task = replace(mdp, outcome_row=rows)
        best = find_mappings(target, task, keep=1)
        if len(best):
            mapping, fits = best[0].mapping, best[0].unmapped_value
            if fits is not None and edge.mapping.unmapped_value is not None:
                mapping = mapping.with_unmapped_value(fits)
        else:  # no search finds any, so that an unrelated task tells nothing
            mapping = StateActionMapping(target, task, np.full_like(edge.mapping.index, UNMAPPED))
        edges.append(replace(edge, mapping=mapping))
        values = TaskPair(target, task).source_solution.action_values
        copies = np.broadcast_to(values, (len(seeds), *values.shape))
        no_steps = np.zeros(len(seeds), np.int64)
        sources[edge.source] = SourceValues(task, tuple(seeds), copies, no_steps)
    return sources, edges


def _shuffled(phi: PairPotential, seed: int) -> AnyPotential:
    """Return phi with its values permuted over all pairs that are not terminal."""
    values, unknown, live = phi.values.copy(), np.isnan(phi.known), live_pairs(phi.task)
    order = np.random.default_rng([seed, 1]).permutation(int(live.sum()))
    values[live], unknown[live] = values[live][order], unknown[live][order]
    return StateActionPotential(phi.task, values, unknown)
