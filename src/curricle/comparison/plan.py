"""The plan of a comparison or a study: arms with one total of steps, and the units that train them.

All arms have one target and spend one total of steps, sources included. Each task of each arm has a
key: what is learnt under one key is equal, so that arms share it. A unit is one such task for some
seeds; it is trained after its sources.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

from curricle.checks import fit_name, instance
from curricle.comparison.controls import Control, control_arms
from curricle.comparison.task_differences import differences
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.node import OF_TARGETS, SETTINGS
from curricle.errors import CurriculumError, SettingError
from curricle.statistics.curves import SCRATCH
from curricle.tasks.live import is_live
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr

Dependencies = Mapping[str, Any]
"""Plain data: all that the result of one task of one arm depends on, but the seed."""


@dataclass(frozen=True)
class Unit:
    """One task of one arm, trained for some seeds at once.

    Attributes
    ----------
    key : str or int
        Equal for units whose seeds learn the same: in a study a hash of all that the result depends
        on, except the seeds.
    arm, task : str
        The first arm that needs it, and its task.
    seeds : tuple of int
        Ascending.
    sources : dict of str to key
        The tasks that must have been trained for these seeds before, with their keys.
    dependencies : dict
        What the key is a hash of, as plain data.
    snapshots : int
        Value tables of the first seed that are kept during training.

    Examples
    --------
    >>> Unit("0f", "scratch", "maze", (0, 1, 4), {}, {}, 0).label
    'scratch: maze, seeds 0-1+4'
    """

    key: Any
    arm: str
    task: str
    seeds: tuple[int, ...]
    sources: Mapping[str, Any] = field(hash=False)
    dependencies: Dependencies = field(hash=False, repr=False)
    snapshots: int

    __repr__ = brief_repr

    @property
    def label(self) -> str:
        """Arm, task and seeds, for messages."""
        return f"{self.arm}: {self.task}, {numbered_seeds(self.seeds)}"


def numbered_seeds(seeds: Collection[int]) -> str:
    """Return seeds with their numbers, in the singular for one."""
    return f"seed{'s' * (len(seeds) != 1)} {seed_ranges(seeds)}"


def seed_ranges(seeds: Iterable[int]) -> str:
    """Return seeds as ranges of numbers, such as ``0-2+7``."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1] + 1:
            runs[-1][1] = seed
        else:
            runs.append([seed, seed])
    return "+".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs)


@dataclass(frozen=True, eq=False)
class PlannedArm:
    """An arm as it is trained."""

    curriculum: Curriculum  # the budget of its target is the total, if there is one
    keys: Mapping[str, Any]  # of each task
    dependencies: Mapping[str, Dependencies] = field(default_factory=dict)  # what keys are made of
    scratch: bool = False  # whether it learns the target from scratch
    control: str = ""  # what it changes in the arm that it is a control of; empty for other arms
    of: str = ""  # that arm


KeysOf = Callable[[str, Curriculum, str], tuple[Mapping[str, Any], Mapping[str, Dependencies]]]
"""The name of an arm, without its control, its curriculum and the control -> keys and dependencies
of its tasks."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What is trained."""

    arms: Mapping[str, PlannedArm]
    """Those from scratch first; controls follow the arm that they are of."""
    target: str  # the task that all arms end with
    budget: int | None
    """Steps of the target, without those of sources; None where arms are not compared."""
    total: int | None  # steps that every arm spends, sources included
    eval_freq: int  # steps between checkpoints of the target

    @classmethod
    def made(
        cls,
        curricula: Mapping[str, Curriculum],
        scratches: Mapping[str, Curriculum],
        keys_of: KeysOf,
        *,
        controls: Sequence[Control] = (),
        least_total: int = 0,
    ) -> Self:
        """Return the plan of comparable curricula and of learners from scratch."""
        # The total is the target's budget and the steps that the most expensive arm spends on its
        # sources at most, rounded up to whole checkpoints, and at least `least_total`.
        first = next(iter(curricula.values()))
        target = first.target
        node = first.node(target)
        budget, total = None, None
        if isinstance(node.budget, int):
            budget = node.budget
            most = max(most_source_steps(arm) for arm in curricula.values())
            total = max(-(-(budget + most) // node.eval_freq) * node.eval_freq, least_total)
        elif len(curricula) + bool(scratches) > 1:
            raise SettingError(
                f"arms are compared at one total of steps: the budget of {target!r} is "
                f"{node.budget}; give it in steps, or run one arm with scratch = false"
            )
        arms = dict[str, PlannedArm]()
        for name, curriculum in (*scratches.items(), *curricula.items()):
            if total is not None:
                curriculum = curriculum.replace(target, budget=total, eval_freq=node.eval_freq)
            arms[name] = PlannedArm(curriculum, *keys_of(name, curriculum, ""), name in scratches)
            for control, changed in control_arms(controls, curriculum) if name in curricula else ():
                keys = keys_of(name, changed, control)
                arms[f"{name}, {control}"] = PlannedArm(changed, *keys, control=control, of=name)
        return cls(arms, target, budget, total, node.eval_freq)

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
    def keys(self) -> dict[tuple[str, str], Any]:
        """The key of each task of each arm."""
        arms = self.arms.items()
        return {(name, task): key for name, arm in arms for task, key in arm.keys.items()}

    @cached_property
    def target_keys(self) -> frozenset[Any]:
        """The keys of the target in all arms."""
        return frozenset(arm.keys[self.target] for arm in self.arms.values())

    @cached_property
    def needs(self) -> dict[tuple[str, str], Any]:
        """The same, and the target of its curriculum for a control: it stands or falls with it."""
        # The second part of its place is no task's name.
        controls = {name: arm.of for name, arm in self.arms.items() if arm.control}
        beside = {(name, f"/{of}"): self.keys[of, self.target] for name, of in controls.items()}
        return self.keys | beside

    @property
    def dependencies(self) -> dict[tuple[str, str], Dependencies]:
        """What the key of each task of each arm is made of."""
        arms = self.arms.items()
        return {(name, task): one for name, arm in arms for task, one in arm.dependencies.items()}

    @property
    def scratches(self) -> tuple[str, ...]:
        """The arms that learn the target from scratch."""
        return tuple(name for name, arm in self.arms.items() if arm.scratch)

    @property
    def live(self) -> bool:
        """Whether a task runs in Python, one thread at a time."""
        # This includes tasks seen through observations: their learners draw from random generators
        # of the process.
        tasks = [
            task for curriculum in self.curricula.values() for task in curriculum.tasks.values()
        ]
        return any(is_live(task) or is_observation_task(task) for task in tasks)

    def without(self, arms: Collection[str]) -> Self:
        """Return the plan without some arms and their controls."""
        kept = {name: arm for name, arm in self.arms.items() if not {name, arm.of} & set(arms)}
        return replace(self, arms=kept)

    def units(
        self,
        seeds: Collection[int],
        done: Mapping[Any, Collection[int]],
        *,
        seeds_per_unit: int | None = None,
        snapshots: int = 0,
        first: int | None = None,
    ) -> list[Unit]:
        """Return the units that are still to be trained, sources first."""
        # Seed s belongs to group number s // `seeds_per_unit`, all to one without that number.
        # `done` has the seeds that are trained by key. Units whose first seed is `first` have
        # `snapshots`.
        units: dict[tuple[Any, tuple[int, ...]], Unit] = {}
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


def curricula_by_name(arms: Curriculum | Mapping[str, Curriculum]) -> Mapping[str, Curriculum]:
    """Return arms by name, or raise CurriculumError unless they are curricula."""
    if isinstance(arms, Curriculum):
        return {"transfer": arms}
    instance("arms, unless they are one curriculum,", arms, Mapping, CurriculumError)
    if not arms:
        raise CurriculumError("a comparison needs at least one curriculum: got none")
    for name, arm in arms.items():
        fit_name("an arm", name, CurriculumError)
        instance(f"arm {name!r}", arm, Curriculum, CurriculumError)
        if name == SCRATCH:
            raise CurriculumError(f"the name {SCRATCH!r} is taken by the baseline: rename this arm")
    return arms


def most_source_steps(curriculum: Curriculum) -> int:
    """Return an upper bound of the steps that a curriculum's sources take."""
    return sum(curriculum.node(name).most_steps for name in curriculum.ancestors(curriculum.target))


def check_comparable(arms: Mapping[str, Curriculum], learners: Collection[Any] | None = ()) -> None:
    """Raise CurriculumError unless all arms have one target with the same settings."""
    # An arm may learn the target with another of `learners` than the first arm does, which learn it
    # from scratch too; with any learner where that is None.
    (name, first), *others = arms.items()
    target = first.target
    for other_name, other in others:
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
            mine, yours = first.setting(which, target), other.setting(which, target)
            fair = which == "learner" and (learners is None or yours in learners)
            if mine != yours and not fair:
                raise CurriculumError(
                    f"arms must share their target's {which}: {pair} have {mine} and {yours}"
                )


# -- Arms that learn from scratch ------------------------------------------------------------------

Learners = Sequence[Any] | Mapping[str, Any]  # further learners from scratch, by name in a dict


def from_scratch(curriculum: Curriculum, learner: Any = None) -> Curriculum:
    """Return a curriculum's target without its sources, with another learner if one is given."""
    target = curriculum.target
    settings: dict[str, Any] = {
        which: {target: curriculum.setting(which, target)}
        for which in SETTINGS
        if which not in OF_TARGETS
    }
    if learner is not None:
        settings["learner"] = {target: learner}
    return Curriculum({target: curriculum.tasks[target]}, **settings)


def scratch_curricula(learners: Learners, first: Curriculum) -> dict[str, Curriculum]:
    """Return the arms of further learners from scratch by name, ``scratch, NAME``."""
    if not isinstance(learners, Mapping):
        instance("scratch, unless it names learners in a dict,", learners, Sequence, SettingError)
        named = [(_name(learner), learner) for learner in learners]
    else:
        named = list(learners.items())
    usual, arms = first.setting("learner", first.target), dict[str, Curriculum]()
    for name, learner in named:
        fit_name("a learner from scratch", name, SettingError)
        label = f"{SCRATCH}, {name}"
        if label in arms:
            raise SettingError(f"learners from scratch must differ: {name} is there twice")
        if learner == usual:
            raise SettingError(
                f"a further learner from scratch must differ from the target's own: {name} is "
                f"{usual}, which learns from scratch anyway"
            )
        try:
            arms[label] = from_scratch(first, learner)
        except (CurriculumError, SettingError) as error:
            raise SettingError(f"learner {name} from scratch: {error}") from None
    return arms


def _name(learner: Any) -> str:
    """Return a learner as text, with the settings that are not the defaults of its class."""
    parts = []
    for setting in fields(learner) if hasattr(learner, "__dataclass_fields__") else ():
        default = setting.default
        if setting.default_factory is not MISSING:
            default = setting.default_factory()
        value = getattr(learner, setting.name)
        if value != default:
            parts.append(f"{setting.name}={value}")
    return type(learner).__name__ + f"({', '.join(parts)})" * bool(parts)
