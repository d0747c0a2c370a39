"""The plan of a comparison or a study: arms with the same total of steps, and their units.

All arms have one target and spend the same total of steps, sources included. Each task of each arm
has a key. Equal keys mean equal results, which arms then share. A unit is a task of an arm for some
seeds; it is trained after its sources. If a unit fails, the arms that need it are given up. One
function runs all units (`trained_units`): a comparison keeps their results in memory (`Memory`), a
study sends units to workers and keeps them in its folder (`study.running`).
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from dataclasses import dataclass, field, replace
from functools import cached_property
from graphlib import TopologicalSorter
from heapq import heappop, heappush
from itertools import groupby, product
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np

from curricle.arrays import FloatArray, IntArray
from curricle.comparison.controls import Control, check_fit, control_arms, train_control
from curricle.comparison.opponents import (
    CONSTANTS,
    Opponent,
    constants_of,
    train_constant,
    unasked_learners,
)
from curricle.comparison.task_differences import differences
from curricle.curriculum.curriculum import (
    OF_TARGETS,
    SETTINGS,
    Curriculum,
    Node,
    TrainingOptions,
)
from curricle.curriculum.result import SourceValues
from curricle.errors import CurriculumError, EngineError, LostStoreError, SettingError
from curricle.learning.result import LearningResult
from curricle.progress import Bars, Progress
from curricle.statistics.curves import SCRATCH
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr
from curricle.transfer.potential import AnyPotential
from curricle.transfer.transfer import Transfer, same_transfer

Item = TypeVar("Item")
Dependencies = Mapping[str, Any]  # all on which a task's result depends, except the seed


@dataclass(frozen=True)
class Unit:
    """One task of one arm, trained for some seeds at once."""

    # Units with equal keys have equal results for equal seeds. In a study the key is a hash of
    # `dependencies`.
    key: str
    arm: str  # the first arm that needs the unit
    task: str
    seeds: tuple[int, ...]  # ascending
    sources: Mapping[str, str] = field(hash=False)  # task trained for these seeds before -> its key
    dependencies: Dependencies = field(hash=False, repr=False)  # what the key hashes
    snapshots: int  # number of value tables of the first seed to keep during training

    __repr__ = brief_repr

    @property
    def label(self) -> str:
        """Arm, task and seeds for messages, such as ``scratch: maze, seeds 0-1+4``."""
        return f"{self.arm}: {self.task}, {numbered_seeds(self.seeds)}"


def numbered_seeds(seeds: Collection[int]) -> str:
    """Return the text ``seed 3`` or ``seeds 0-2+7``."""
    return f"seed{'s' * (len(seeds) != 1)} {seed_ranges(seeds)}"


def seed_ranges(seeds: Iterable[int]) -> str:
    """Return ascending seeds as ranges of numbers, such as ``0-2+7``."""
    # In a run of consecutive numbers, number minus place is constant.
    runs = groupby(enumerate(seeds), lambda pair: pair[1] - pair[0])
    ends = [(run[0], run[-1]) for run in ([seed for _, seed in pairs] for _, pairs in runs)]
    return "+".join(f"{first}" if first == last else f"{first}-{last}" for first, last in ends)


@dataclass(frozen=True, eq=False)
class PlannedArm:
    """An arm that is to be trained."""

    curriculum: Curriculum  # its target's budget is the plan's total, if the plan has a total
    keys: Mapping[str, str]  # of each task
    dependencies: Mapping[str, Dependencies] = field(default_factory=dict)  # of each task
    scratch: bool = False  # whether it learns the target without sources, for all steps
    # The label of a control or constant, which changes another arm; empty for other arms.
    change: str = ""
    of: str = ""  # the arm that it changes


KeysOf = Callable[[str, Curriculum, str], tuple[Mapping[str, str], Mapping[str, Dependencies]]]
"""(arm without its change, curriculum, change) -> the keys and the dependencies of its tasks."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The arms that are to be trained, and their keys."""

    arms: Mapping[str, PlannedArm]  # scratch arms first; controls and constants follow their arm
    target: str  # the task that all arms end with
    budget: int | None  # the target's budget; None if arms are not compared
    total: int | None  # steps that every arm spends, sources included; None likewise
    eval_freq: int  # steps between checkpoints of the target

    @classmethod
    def made(
        cls,
        curricula: Mapping[str, Curriculum],
        scratches: Mapping[str, Curriculum],
        keys_of: KeysOf,
        *,
        controls: Sequence[Control] = (),
        opponents: Sequence[Opponent] = (),
        compared: bool = True,
        own_learners: bool = False,
    ) -> Self:
        """Return the plan of curricula and learners from scratch, at one total if `compared`.

        Arms that are compared learn their target with a learner from scratch's, or `own_learners`.
        """
        first = next(iter(curricula.values()))
        for name, curriculum in curricula.items():
            check_fit(controls, name, curriculum)
        if compared:
            learners = [arm.setting("learner", arm.target) for arm in scratches.values()]
            check_comparable(curricula, None if own_learners else learners)
        target, node = first.target, first.node(first.target)
        if compared and scratches and node.evaluation.method == "off":
            raise SettingError(f"a comparison needs greedy evaluation: that of {target!r} is off")
        budget, total = None, None
        if compared and isinstance(node.budget, int):
            budget = node.budget
            most = max(most_source_steps(arm) for arm in curricula.values())
            total = -(-(budget + most) // node.eval_freq) * node.eval_freq
        elif compared and len(curricula) + bool(scratches) > 1:
            raise SettingError(
                f"arms must have one total of steps to be compared: the budget of {target!r} is "
                f"{node.budget}; give it in steps, or let each arm of a study have its own budget "
                "with compared = false"
            )
        if "constant" in controls:
            opponents = ("constant", *opponents)

        def as_long(curriculum: Curriculum) -> Curriculum:
            if total is None:
                return curriculum
            return curriculum.replace(target, budget=total, eval_freq=node.eval_freq)

        arms = list[tuple[str, PlannedArm]]()
        scratches = {name: as_long(curriculum) for name, curriculum in scratches.items()}
        for name, curriculum in scratches.items():
            arm = PlannedArm(curriculum, *keys_of(name, curriculum, ""), scratch=True)
            arms.append((name, arm))
        unasked = dict(unasked_learners(opponents, scratches) if scratches else ())
        for label, curriculum in unasked.items():
            keys = keys_of(SCRATCH, curriculum, label)
            arms.append((f"{SCRATCH}, {label}", PlannedArm(curriculum, *keys, scratch=True)))
        for name, curriculum in curricula.items():
            whole = as_long(curriculum)
            # Without a source or a potential an arm is a learner from scratch: an opponent.
            alone = bool(scratches) and compared and not whole.has_potential(target)
            learner = whole.setting("learner", target)
            if alone and learner in (
                arm.curriculum.setting("learner", target) for _, arm in arms if arm.scratch
            ):
                continue  # an opponent learns as it does
            arms.append((name, PlannedArm(whole, *keys_of(name, whole, ""), scratch=alone)))
            kinds = {False: control_arms(controls, whole), True: constants_of(opponents, whole)}
            for free, changes in kinds.items():
                for label, changed in changes:
                    keys = keys_of(name, changed, label)
                    arm = PlannedArm(changed, *keys, free, label, name)
                    arms.append((f"{name}, {label}", arm))
        names = [name for name, _ in arms]
        if twice := next((name for name in names if names.count(name) > 1), ""):
            raise CurriculumError(
                f"arms must have other names than controls and opponents: {twice!r} names two; "
                "rename the arm or learner"
            )
        return cls(dict(arms), target, budget, total, node.eval_freq)

    @property
    def steps(self) -> tuple[int, int]:
        """The target's budget and the total, where arms are compared."""
        assert self.budget is not None, "arms are compared at a number of steps"
        assert self.total is not None, "arms are compared at a number of steps"
        return self.budget, self.total

    @cached_property
    def curricula(self) -> dict[str, Curriculum]:
        """The curriculum of each arm."""
        return {name: arm.curriculum for name, arm in self.arms.items()}

    @cached_property
    def keys(self) -> dict[tuple[str, str], str]:
        """The key of each task of each arm."""
        return self._by_task("keys")

    @property
    def dependencies(self) -> dict[tuple[str, str], Dependencies]:
        """The data of which the key of each task of each arm is a hash."""
        return self._by_task("dependencies")

    def _by_task(self, mapping: str) -> dict[tuple[str, str], Any]:
        arms = self.arms.items()
        return {(name, task): x for name, arm in arms for task, x in getattr(arm, mapping).items()}

    @cached_property
    def needs(self) -> dict[tuple[str, str], str]:
        """The keys that each arm needs: its keys, and the target's key of the arm it changes."""
        controls = {name: arm.of for name, arm in self.arms.items() if arm.of}
        beside = {(name, f"/{of}"): self.keys[of, self.target] for name, of in controls.items()}
        return self.keys | beside

    @property
    def target_node(self) -> Node:
        """The target with the settings that all arms share."""
        return next(iter(self.curricula.values())).node(self.target)

    @property
    def serial(self) -> bool:
        """Whether a process must train one unit at a time."""
        # Its tasks run in Python, or are seen through observations: learners of observation tasks
        # draw from random generators of the process.
        return any(
            is_live(task) or is_observation_task(task)
            for curriculum in self.curricula.values()
            for task in curriculum.tasks.values()
        )

    def changed(self, unit: Unit) -> str:
        """Return the target's key of the arm that a unit changes; empty if it changes no arm."""
        of = self.arms[unit.arm].of
        return self.arms[of].keys[unit.task] if of and unit.task == self.target else ""

    def read_by(self, unit: Unit) -> set[str]:
        """Return the keys whose results a unit reads: its sources', and that of the changed arm."""
        return {*unit.sources.values(), self.changed(unit)} - {""}

    def without(self, arms: Collection[str]) -> Self:
        """Return the plan without some arms, their controls and constants."""
        kept = {name: arm for name, arm in self.arms.items() if not {name, arm.of} & set(arms)}
        return replace(self, arms=kept)

    def units(
        self,
        seeds: Collection[int],
        done: Mapping[str, Collection[int]],
        *,
        seeds_per_unit: int | None = None,
        snapshots: int = 0,
        first: int | None = None,
    ) -> list[Unit]:
        """Return the units that are still to be trained, sources first."""
        # `done` maps keys to trained seeds; only units whose first seed is `first` keep snapshots.
        units: dict[tuple[str, tuple[int, ...]], Unit] = {}
        for name, arm in self.arms.items():
            for task in arm.curriculum.order:
                key = arm.keys[task]
                groups: dict[int, list[int]] = {}
                for seed in sorted(set(seeds).difference(done.get(key, ()))):
                    group = seed // seeds_per_unit if seeds_per_unit else 0
                    groups.setdefault(group, []).append(seed)
                sources = {source: arm.keys[source] for source in arm.curriculum.ancestors(task)}
                depends = arm.dependencies.get(task, {})
                for members in groups.values():
                    kept = snapshots if members[0] == first else 0
                    unit = Unit(key, name, task, tuple(members), sources, depends, kept)
                    units.setdefault((key, unit.seeds), unit)
        return list(units.values())


# -- Which arms can be compared --------------------------------------------------------------------


def most_source_steps(curriculum: Curriculum) -> int:
    """Return an upper bound on the steps that a curriculum's sources take."""
    return sum(curriculum.node(name).most_steps for name in curriculum.ancestors(curriculum.target))


def check_comparable(arms: Mapping[str, Curriculum], learners: Collection[Any] | None) -> None:
    """Raise CurriculumError unless all arms have one target with the same settings."""
    # Arms may learn the target with different `learners`, each of which learns it from scratch too;
    # with any learners if `learners` is None.
    (name, first), *later = arms.items()
    target = first.target
    for other_name, other in later:
        pair = f"{name!r} and {other_name!r}"
        if other.target != target:
            raise CurriculumError(
                f"arms must share their target: {pair} have {target!r} and {other.target!r}"
            )
        apart = differences(first.tasks[target], other.tasks[target])
        if apart:
            raise CurriculumError(
                f"arms must share their target: those of {pair} differ in {'; '.join(apart)}"
            )
        for which in ("evaluation", "budget", "learner", "eval_freq"):
            value, other_value = first.setting(which, target), other.setting(which, target)
            fair = which == "learner" and (learners is None or other_value in learners)
            if value != other_value and not fair:
                raise CurriculumError(
                    f"arms must share their target's {which}: {pair} have {value} and {other_value}"
                )


# -- Training a unit -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trained:
    """The results of the seeds of a unit."""

    result: LearningResult
    source_steps: IntArray  # (K,): the steps of each seed in its sources
    potentials: Sequence[AnyPotential] = ()  # of each seed, as it entered; empty if unknown
    initial_values: FloatArray | None = None  # (K,) of a constant opponent's Q


def train(
    arm: PlannedArm,
    unit: Unit,
    sources: Mapping[str, SourceValues],
    *,
    charge: bool = True,
    unchanged: Trained | None = None,
    workers: int | None = None,
    progress: Progress = None,
) -> Trained:
    """Train a unit of an arm with the results of its sources, and return the unit's results."""
    # With `charge` the target's budget also pays for the sources. An arm that changes another arm
    # reads the other arm's potentials from `unchanged`, or computes them again.
    curriculum, task, seeds = arm.curriculum, unit.task, unit.seeds
    spent, is_target = curriculum.spent(task, sources, len(seeds)), task == curriculum.target
    options = TrainingOptions(None, unit.snapshots, workers, progress)
    if not (arm.change and is_target):
        options = options._replace(charged=spent if charge and is_target else None)
        result, potentials = curriculum.train_task(task, sources, seeds, options)
        return Trained(result, spent, potentials)
    phi = () if unchanged is None else unchanged.potentials
    options = options._replace(snapshots=0)
    if arm.change not in CONSTANTS:
        options = options._replace(charged=spent)
        control = train_control(arm.change, curriculum, seeds, sources, phi, options)
        return Trained(control, spent)
    phi = phi or curriculum.potentials(task, sources, seeds=len(seeds))
    result, values = train_constant(arm.change, curriculum, seeds, phi, options)
    return Trained(result, np.zeros_like(spent), initial_values=values)


# -- Units that failed ----------------------------------------------------------------------------


@dataclass
class Failures:
    """The failed units of a run; arms that need a failed unit are given up, others are trained."""

    needs: Mapping[tuple[str, str], str]  # the keys that each arm needs (`Plan.needs`)
    errors: list[tuple[Unit, BaseException]] = field(default_factory=list)  # in this order
    executor_failed: bool = False  # whether a unit was never trained because the executor failed
    _kept: set[str] = field(default_factory=set, init=False)  # keys of arms without a failure

    def __bool__(self) -> bool:
        return bool(self.errors)

    def add(self, unit: Unit, error: Exception) -> None:
        """Record that a unit failed, with the cause of a BrokenExecutor."""
        self.executor_failed |= isinstance(error, BrokenExecutor)
        cause = error.__cause__ if isinstance(error, BrokenExecutor) else None
        self.errors.append((unit, cause or error))
        lost = arms_of(self.needs, {unit.key for unit, _ in self.errors})
        none = self.executor_failed or SCRATCH in lost
        self._kept = {key for (arm, _), key in self.needs.items() if not none and arm not in lost}

    def keeps(self, unit: Unit) -> bool:
        """Return whether an arm without a failure needs a unit; no unit if scratch failed."""
        return not self.errors or unit.key in self._kept


def arms_of(keys: Mapping[tuple[str, str], str], some: Collection[str]) -> set[str]:
    """Return the arms that need a key among `some`."""
    return {arm for (arm, _), key in keys.items() if key in some}


# -- Running units, each after its sources ---------------------------------------------------------

LOST = "its executor was lost or cancelled it: go on with --resume"  # compare has no executor
ASKED_AGAIN = 2.0
"""Seconds between requests for the number of workers: it may grow, but a cluster's answer takes
about as long as a small unit."""


class Queue:
    """Units to send: in order, but each after its sources are trained."""

    def __init__(self, units: Iterable[Unit]):
        self.units = list(units)
        numbers = enumerate(self.units)
        self._numbers = {(unit.key, seed): n for n, unit in numbers for seed in unit.seeds}
        self._order = TopologicalSorter[int]()
        for number, unit in enumerate(self.units):
            read = self._numbers.keys() & product(unit.sources.values(), unit.seeds)
            self._order.add(number, *{self._numbers[pair] for pair in read})
        self._order.prepare()
        self.ready = sorted(self._order.get_ready())  # heap of the units whose sources are trained

    def pop(self) -> Unit:
        """Return the next unit to send."""
        return self.units[heappop(self.ready)]

    def trained(self, unit: Unit) -> None:
        """Release the units that waited for a unit; call it when its result is kept."""
        self._order.done(self._numbers[unit.key, unit.seeds[0]])
        for number in self._order.get_ready():
            heappush(self.ready, number)


def trained_units(
    units: Iterable[Unit],
    send: Callable[[Unit], "Future[Any]"],
    keep: Callable[[Unit, Any], object],
    failures: Failures,
    *,
    at_once: Callable[[], int] = lambda: 1,
) -> Iterator[tuple[Unit, Any]]:
    """Yield each unit with its result when that is kept.

    `send` starts a unit whose sources are kept, at most ``at_once()`` together. After a failure no
    unit is started that only arms with a failure need. A result that is an exception is the error
    of a unit in another process.
    """
    queue, running = Queue(units), dict[Future[Any], Unit]()
    try:
        while queue.ready or running:
            most = at_once()
            while queue.ready and len(running) < most:
                unit = queue.pop()
                if failures.keeps(unit):
                    running[send(unit)] = unit
            ended, _ = wait(running, ASKED_AGAIN, FIRST_COMPLETED)
            for future in [future for future in running if future in ended]:
                if future not in running:  # the failure of another unit has cancelled it
                    continue
                unit = running.pop(future)
                error = EngineError(LOST) if future.cancelled() else future.exception()
                result = None if error else future.result()
                error = result if isinstance(result, Exception) else error
                if isinstance(error, LostStoreError) or not isinstance(error, Exception | None):
                    raise error  # the store is lost, or this is an interrupt
                if error is None:
                    keep(unit, result)
                    queue.trained(unit)
                    yield unit, result
                    continue
                failures.add(unit, error)
                for other, waiting in [*running.items()]:
                    if not failures.keeps(waiting) and other.cancel():
                        del running[other]
    finally:
        for future in running:
            future.cancel()


# -- A run in memory -------------------------------------------------------------------------------

LARGEST_KEPT = 50_000_000  # bytes; smaller source tables are kept for later plans


class _Learning(NamedTuple):
    """Everything on which the result of a task depends, except the seed."""

    node: Node
    transfers: tuple[Transfer, ...]
    sources: tuple[str, ...]  # the keys of all tasks trained before the task
    change: str

    def equals(self, other: "_Learning") -> bool:
        """Return whether both learnings give equal results."""
        if self.node.task is not other.node.task or self[2:] != other[2:]:
            return False
        by_hand = self.node.potential
        if len(self.transfers) != len(other.transfers) or by_hand is not other.node.potential:
            return False
        informed = self.transfers or by_hand is not None
        settings = [setting for setting in SETTINGS if informed or setting not in OF_TARGETS]
        names = ("name", *settings)
        same = (getattr(self.node, name) == getattr(other.node, name) for name in names)
        return all(same) and all(map(same_transfer, self.transfers, other.transfers))


def number_among(values: list[Item], value: Item, same: Callable[[Item, Item], bool]) -> int:
    """Return the index of a value in a list of different values; append a new value."""
    place = next((n for n, other in enumerate(values) if same(value, other)), len(values))
    if place == len(values):
        values.append(value)
    return place


class Memory:
    """The results of this process by key; tasks with equal results have one key."""

    def __init__(self) -> None:
        self._learnings = list[_Learning]()
        self.trained = dict[tuple[str, tuple[int, ...]], Trained]()  # without the values of targets

    def keys_of(
        self, name: str, curriculum: Curriculum, change: str
    ) -> tuple[dict[str, str], dict[str, Any]]:
        """Return the keys of an arm's tasks, and no dependencies, as :meth:`Plan.made` needs."""
        keys = dict[str, str]()
        for task in curriculum.order:
            before = tuple(keys[source] for source in curriculum.ancestors(task))
            changed = change if task == curriculum.target else ""
            new = _Learning(curriculum.node(task), curriculum.in_edges(task), before, changed)
            keys[task] = f"{number_among(self._learnings, new, _Learning.equals)}"
        return keys, {}

    def train(
        self,
        plan: Plan,
        seeds: tuple[int, ...],
        failures: Failures,
        workers: int | None,
        bars: Bars,
    ) -> Iterator[None]:
        """Train the units of a plan that have no result yet; yield after each unit."""
        # Units of a plan are in an order in which sources come first.
        units, missing = plan.units(seeds, {}), list[Unit]()
        readers = Counter[str]()  # key -> number of units that will still read its results
        for unit in reversed(units):  # units that read a source come before it in this order
            trained = self.trained.get((unit.key, seeds))
            if trained is None or (trained.result.values is None and readers[unit.key]):
                missing.append(unit)
                readers.update(plan.read_by(unit))

        def send(unit: Unit) -> Future[Any]:
            future = Future[Any]()
            try:
                read = unit.sources.items()
                results = {name: self.trained[key, seeds].result for name, key in read}
                sources = {name: SourceValues.of(result) for name, result in results.items()}
                trained = train(
                    plan.arms[unit.arm],
                    unit,
                    sources,
                    unchanged=self.trained.get((plan.changed(unit), seeds)),
                    workers=workers,
                    progress=bars.within(unit.arm),
                )
                future.set_result(trained)
            except Exception as error:  # of any kind: a task may be the user's own code
                future.set_exception(error)
            return future

        def keep(unit: Unit, trained: Trained) -> None:
            self.trained[unit.key, seeds] = trained
            readers.subtract(plan.read_by(unit))
            for key in plan.read_by(unit) | {unit.key}:
                if not readers[key]:
                    self._forget(plan, key, seeds)

        try:
            for _ in trained_units(reversed(missing), send, keep, failures):
                yield
        finally:
            for unit in units:
                self._forget(plan, unit.key, seeds)

    def _forget(self, plan: Plan, key: str, seeds: tuple[int, ...]) -> None:
        """Drop results that no unit will read, except small tables, which later plans may read."""
        if (trained := self.trained.get((key, seeds))) is None:
            return
        values = trained.result.values
        small = isinstance(values, np.ndarray) and values.nbytes <= LARGEST_KEPT
        if not small or key in (arm.keys[plan.target] for arm in plan.arms.values()):
            bare = replace(trained.result, values=None, snapshots=None)
            self.trained[key, seeds] = replace(trained, result=bare, potentials=())
