"""A curriculum: tasks as nodes, transfers as edges, trained from the sources to the targets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple

import numpy as np

from curricle.arrays import IntArray
from curricle.checks import brief, fit_name, instance, number, one_of
from curricle.curriculum.result import CurriculumResult, Learnt, SourceValues
from curricle.deep.learner import DeepLearner, WeightTransfer, check_spaces
from curricle.deep.learning import check_evaluation, learn_deep
from curricle.deep.miniature import Miniatures
from curricle.errors import CurriculumError, SettingError
from curricle.learning.learners import Learner, OptimisticQLearning, QLearning
from curricle.learning.portfolio import Portfolio
from curricle.learning.potential import MOST_SHARED
from curricle.learning.result import LearningResult
from curricle.learning.run import learn
from curricle.learning.seeds import seed_tuple
from curricle.learning.shaping import QInitialisation, Shaping, StateShaping
from curricle.learning.stopping import (
    AGREED,
    SETTLED,
    Budget,
    Decision,
    Decisions,
    Episodes,
    StoppingRule,
    limits,
    longest_run,
    spacing,
)
from curricle.learning.storage import Storage
from curricle.planning.policy_evaluation import GreedyEvaluation
from curricle.progress import Progress, check_progress, shown
from curricle.tasks.live import masks_actions
from curricle.tasks.mdp import NO_LIMIT, Task, generative_model, has_tables, same_task
from curricle.tasks.observation_task import is_observation_task
from curricle.text import brief_repr, counted, shortened
from curricle.transfer.aggregate import Aggregate, mean
from curricle.transfer.mapping import TableValues, ValueSource
from curricle.transfer.potential import (
    AnyPotential,
    ObservationPotential,
    combined_potential,
    written_potential,
)
from curricle.transfer.search import with_mapping
from curricle.transfer.transfer import Transfer

SETTINGS: dict[str, Any] = {
    "aggregate": mean,
    "unknown_value": None,  # means 0, and that it was not given
    "potential": None,
    "learner": None,
    "budget": None,
    "shaping": None,
    "eval_freq": None,
    "evaluation": GreedyEvaluation(),
    "storage": Storage(),
}
"""Setting -> its default; a setting is a value for all tasks, or a dict from task to value."""
OF_TARGETS = ("aggregate", "unknown_value", "potential", "shaping")
"""Settings of tasks with a potential, from sources or by hand."""
DEFAULT_STEPS = 100_000  # the budget of a task on which no other task builds
SOURCES_SHARE = 0.1
"""Share of the target's steps for all sources without a stated budget. Fitted on the development
families of benchmarks/pairs: a larger share gains more on average, but losses of more than a tenth
are more frequent."""
OPTIMISTS_SHARE = 0.03
"""The same of sources that an optimistic learner learns. Fitted so too: .1, .05, .02 and .01 gain
less, by .004 of the way at most."""
STEPS_A_PAIR, FEWEST_STEPS = 10, 500
"""Most steps of a source that an optimistic learner learns: for each of its pairs, at least in all.
Half and twice as many change the development families' mean return by less than .003 of the way."""
PULL = 0.1
"""Weight of the pull that keeps an actor-critic near a network distilled from miniatures. The
strongest of 0, .1, .3 and 1 that costs less than .03 of the area under the curve on the grid worlds
among the development targets of benchmarks/networks/miniatures.py."""
ACTOR_CRITICS = ("PPO", "A2C")  # algorithms for which the pull was tested


class TrainingOptions(NamedTuple):
    """What training takes beside a node's settings: the result depends on `charged` alone."""

    charged: Sequence[int] | IntArray | None = None  # (K,) steps taken from each seed's budget
    snapshots: int = 0  # tables of the first seed to keep
    workers: int | None = None
    progress: Progress = None


@dataclass(frozen=True, eq=False)
class Node:
    """A task of a curriculum and how it is trained; made by :meth:`Curriculum.node`."""

    name: str  # it also names the random stream, so that results do not depend on other tasks
    task: Any
    aggregate: Aggregate
    unknown_value: float
    potential: AnyPotential | None  # written by hand
    learner: Any
    budget: Budget
    shaping: Shaping
    eval_freq: int  # a hundredth of the budget by default
    evaluation: GreedyEvaluation
    storage: Storage

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        kinds = {"learner": DeepLearner if self.deep else Learner, "shaping": Shaping}
        for which, kind in (kinds | {"evaluation": GreedyEvaluation, "storage": Storage}).items():
            instance(f"{which} of {self.name}", getattr(self, which), kind, SettingError)
        if self.deep:
            check_spaces(self.task, self.learner)
            check_evaluation(self.evaluation)
            if self.evaluation.method != "off" and not self.distilled:
                try:
                    self.evaluation.horizon(self.task)
                except SettingError as error:
                    raise SettingError(
                        f"the evaluation of {self.name!r} cannot end: {error}"
                    ) from None
        if self.shaping.potential is not None:
            raise CurriculumError(
                "the shaping of a curriculum's task must have no potential of its own, because "
                f"sources or potential= give it: that of {self.name} has a potential"
            )
        if self.distilled and self.potential is not None:
            raise CurriculumError(
                f"miniatures are solved and need no potential: {self.name!r} has one by hand"
            )
        if not callable(self.aggregate):
            raise CurriculumError(
                f"an aggregate must be a function (N, S, A) -> (S, A): {self.name} has "
                f"{self.aggregate!r}"
            )
        number(f"unknown_value of {self.name}", self.unknown_value, CurriculumError)

    @property
    def most_steps(self) -> int:
        """The most steps that training takes."""
        if self.distilled:
            return self.task.cost  # type: ignore[no-any-return]
        limit = self.task.longest if self.deep else generative_model(self.task).time_limit
        envs = self.learner.envs if self.deep else 1
        return longest_run(limit, self.budget, self.eval_freq, envs)

    @property
    def sizes(self) -> tuple[str, str]:
        """The numbers of states and actions of the task, as text."""
        model = generative_model(self.task)
        return counted(model.states.size, "state"), counted(model.actions.size, "action")

    @property
    def deep(self) -> bool:
        """Whether the task is seen through observations and learnt by a network."""
        return is_observation_task(self.task)

    @property
    def distilled(self) -> bool:
        """Whether a network learns the task from exact answers instead of steps."""
        return isinstance(self.task, Miniatures)

    def train(
        self,
        seeds: Sequence[int],
        potentials: Sequence[AnyPotential],
        options: TrainingOptions,
    ) -> LearningResult:
        """Return the result of K seeds in the task, with K potentials or none."""
        if self.distilled:
            self.learner.algorithm_class()  # ImportError without Stable-Baselines3
            from curricle.deep.distillation import learn_miniatures

            return learn_miniatures(self.task, self.learner, seeds, progress=options.progress)
        common: dict[str, Any] = {
            "shaping": [self.shaping.with_potential(phi) for phi in potentials] or None,
            "seeds": seeds,
            "eval_freq": self.eval_freq,
            "evaluation": self.evaluation,
            "stream": self.name,
            "charged": options.charged,
            "progress": options.progress,
        }
        if self.deep:
            result = learn_deep(self.task, self.learner, self.budget, **common)
            return result if self.storage.save_values else replace(result, values=None)
        of_tables = {"snapshots": options.snapshots, "workers": options.workers}
        common |= {"storage": self.storage, **of_tables}
        return learn(self.task, self.learner, self.budget, **common)

    def decisions(self, result: LearningResult) -> Decisions:
        """Return the stopping rule's decisions at each seed's checkpoints, as recorded."""
        if not isinstance(self.budget, StoppingRule) or self.distilled:
            return Decisions([] for _ in result.seeds)
        names = ("level", "floor", "steps_used", "evaluation_steps", "ended_by")
        recorded = [getattr(result, name).tolist() for name in names]
        of_seeds, judge = list[list[Decision]](), self.budget.decisions
        for greedy, agreement, level, floor, used, spent, ending in zip(
            result.greedy_return, result.agreement, *recorded, strict=True
        ):
            measured = {"agreement": agreement, "level": level, "floor": floor, "used": used}
            *earlier, last = judge(result.steps, greedy, **measured)
            of_seeds.append([*earlier, replace(last, evaluation_steps=spent, ended_by=ending)])
        return Decisions(of_seeds)


def capped(budget: Budget, learner: object) -> Budget:
    """Return the budget of a source: steps become the cap of a rule, other budgets stay."""
    if isinstance(budget, Episodes | StoppingRule):
        return budget
    agreed = AGREED if isinstance(learner, OptimisticQLearning) else None
    return StoppingRule(limits(budget)[0], settled=SETTLED, agreed=agreed)


# -- the graph of nodes ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Curriculum:
    """A directed acyclic graph of tasks whose edges carry potentials.

    A setting is a value for all tasks, or a dict from task name to value, else the default.

    Parameters
    ----------
    tasks : dict of str to Task
    transfers : sequence of Transfer
        Several transfers may share source and target, with different mappings.
    aggregate : callable or dict
        (N, S, A) -> (S, A), combines the potentials of all transfers into a task; default
        :func:`mean`. A pair that a transfer leaves unmapped is NaN, which :func:`mean` skips.
    unknown_value : float or dict
        The potential of pairs that all transfers leave unmapped; default 0.
    potential : array, potential, callable or dict, optional
        A potential written by hand, for tasks without sources, which is charged no step: phi(s, a)
        as an (S, A) array, :class:`StateActionPotential` or :class:`MappedPotential`; Phi(s) as an
        (S,) array or :class:`StatePotential`, which is read as phi(s, a) = Phi(s) for all a; or a
        function of the task that returns one of these. For an observation task it is an
        ``ObservationPotential`` or ``ValueSource``.
    learner : Learner or dict
        Default ``QLearning()``. For a task on which others build, without sources of its own,
        ``OptimisticQLearning()`` if the task has tables, and a discount below 1 or a time limit.
    budget : int, Episodes, StoppingRule or dict
        Steps, episodes, or a rule; default 100,000 steps. Training of a source ends when its return
        has converged, or its optimistic values agree with the learnt ones: its number of steps is a
        cap. All sources without a budget together take at most a tenth of the target's steps; an
        optimistic learner 3 % of these, and 10 steps for each state-action pair, or 500 steps if
        that is more.
        ``StoppingRule(5_000)`` is exactly 5,000 steps.
    shaping : Shaping or dict
        How the potentials of sources enter learning. Default :class:`QInitialisation`, with a
        :class:`Portfolio` for :class:`QLearning`; beyond 10 million pairs in sparse tables alone.
        Networks other than DQN's cannot start at a potential: their default is
        :class:`StateShaping`, or ``WeightTransfer(kl=0.1)`` for an actor-critic whose only source
        is distilled from :func:`miniatures` and read unchanged.
    eval_freq : int or dict, optional
        Steps between checkpoints.
    evaluation : GreedyEvaluation or dict, optional
    storage : Storage or dict, optional

    Raises
    ------
    CurriculumError
        When transfers make a cycle (which is named), a task is unknown, a mapping is not made for
        the tasks of its transfer, a potential is unfit or its task has sources, or the shaping of a
        source leaves values that no target can read.

    Examples
    --------
    >>> from curricle import Pursuit, minimum, project
    >>> hunt, chase = Pursuit(size=3, predators=2), Pursuit(size=3, predators=1)
    >>> curriculum = Curriculum(
    ...     tasks={"hunt": hunt, "chase": chase},
    ...     transfers=[Transfer("chase", "hunt", project(hunt, chase, predator=name))
    ...                for name in ("predator_1", "predator_2")],
    ...     aggregate=minimum, budget={"chase": 10_000, "hunt": 20_000})
    >>> curriculum.order
    ('chase', 'hunt')
    >>> result = curriculum.train(seeds=2)
    >>> result.source_steps("hunt")
    array([3600, 3600])
    """

    tasks: Mapping[str, Task]
    transfers: Sequence[Transfer] = ()
    aggregate: Aggregate | Mapping[str, Aggregate] = SETTINGS["aggregate"]
    unknown_value: float | Mapping[str, float | None] | None = SETTINGS["unknown_value"]
    potential: Any = SETTINGS["potential"]
    learner: Learner | Mapping[str, Learner | None] | None = SETTINGS["learner"]
    budget: Budget | Mapping[str, Budget | None] | None = SETTINGS["budget"]
    shaping: Shaping | Mapping[str, Shaping | None] | None = SETTINGS["shaping"]
    eval_freq: int | Mapping[str, int | None] | None = SETTINGS["eval_freq"]
    evaluation: GreedyEvaluation | Mapping[str, GreedyEvaluation] = SETTINGS["evaluation"]
    storage: Storage | Mapping[str, Storage] = SETTINGS["storage"]

    def __post_init__(self) -> None:
        self._check_graph()
        for setting in SETTINGS:
            value = getattr(self, setting)
            for name in value if isinstance(value, Mapping) else ():
                one_of(f"a task that {setting} names", name, self.tasks, CurriculumError)
        written = {
            name: written_potential(name, task, phi, [edge.source for edge in self.in_edges(name)])
            for name, task in self.tasks.items()
            if (phi := self._stated("potential", name)) is not None
        }
        object.__setattr__(self, "potential", written)
        for name in self.tasks:
            node = self.node(name)
            if self.has_potential(name):
                node.shaping.check(node.learner)
                targets = [edge.target for edge in self.transfers if edge.source == name]
                if targets and not node.shaping.own_rewards:
                    raise CurriculumError(
                        "values that a target reads must be in their task's own rewards: "
                        f"{node.shaping.name} changes those of {name!r}, which {targets[0]!r} reads"
                    )

    def _check_graph(self) -> None:
        """Search missing mappings; CurriculumError unless tasks and transfers are a graph."""
        instance("tasks", self.tasks, Mapping, CurriculumError)
        instance("transfers", self.transfers, Sequence, CurriculumError)
        object.__setattr__(self, "tasks", dict(self.tasks))
        object.__setattr__(self, "transfers", tuple(self.transfers))
        if not self.tasks:
            raise CurriculumError("a curriculum needs at least one task: got none")
        for name, task in self.tasks.items():
            fit_name("a task", name, CurriculumError)
            if not is_observation_task(task):
                generative_model(task)
        for transfer in self.transfers:
            instance("each of transfers", transfer, Transfer, CurriculumError)
            for role in ("source", "target"):
                one_of(f"a transfer's {role}", getattr(transfer, role), self.tasks, CurriculumError)
            if isinstance(self.tasks[transfer.target], Miniatures):
                raise CurriculumError(
                    "miniatures are solved and need no source: a transfer must lead from "
                    f"{transfer.source!r} into another task than {transfer.target!r}"
                )
        mapped = (
            with_mapping(
                transfer,
                self.tasks[transfer.target],
                self.tasks[transfer.source],
                # An aggregate of several transfers skips those that leave a pair unmapped.
                fit_unmapped=len(self.in_edges(transfer.target)) == 1
                and self._stated("unknown_value", transfer.target) is None,
            )
            for transfer in self.transfers
        )
        object.__setattr__(self, "transfers", tuple(mapped))
        for transfer in self.transfers:
            for role in ("source", "target"):
                name = getattr(transfer, role)
                if not same_task(self.tasks[name], getattr(transfer.mapping, role)):
                    raise CurriculumError(
                        f"a transfer's mapping must be made for its tasks: the mapping's {role} is "
                        f"not the task {name!r} in {transfer.source} -> {transfer.target}"
                    )
            if why := transfer.mapping.why_empty:
                raise CurriculumError(
                    f"a transfer must map some pair, or it transfers nothing: in {transfer.source} "
                    f"-> {transfer.target} {why}"
                )
        _ = self.order

    @property
    def target(self) -> str:
        """The task to which all other tasks lead; CurriculumError unless there is only one."""
        last = self.last_tasks
        if len(last) != 1:
            raise CurriculumError(
                f"a curriculum must have one task that no other builds on: got {', '.join(last)}"
            )
        return last[0]

    def knows_target(self, name: str) -> bool:
        """Return whether a search for a mapping read the model of a task.

        A mapping that a search found for an earlier task counts too, if that task is not smaller:
        it may be a copy.
        """
        whole, into = self.tasks[name], (name, *self.ancestors(name))
        return any(
            edge.target == name
            or is_observation_task(whole)
            or self.tasks[edge.target].states.size >= whole.states.size
            for edge in self.transfers
            if edge.target in into and edge.mapping.knows_target
        )

    @property
    def last_tasks(self) -> tuple[str, ...]:
        """The tasks on which no other task builds."""
        sources = {transfer.source for transfer in self.transfers}
        return tuple(name for name in self.tasks if name not in sources)

    def __repr__(self) -> str:
        edges = [f"{edge.source} -> {edge.target}" for edge in self.transfers]
        parts = [", ".join(self.order), *([", ".join(edges)] if edges else [])]
        return shortened(f"{type(self).__name__}({'; '.join(parts)})")

    @cached_property
    def order(self) -> tuple[str, ...]:
        """The tasks' names, every source before its targets."""
        graph = {name: [edge.source for edge in self.in_edges(name)] for name in self.tasks}
        try:
            return tuple(TopologicalSorter(graph).static_order())
        except CycleError as error:
            cycle = " -> ".join(error.args[1])
            raise CurriculumError(f"a curriculum must have no cycle: {cycle}") from None

    def in_edges(self, name: str) -> tuple[Transfer, ...]:
        """Return the transfers into a task."""
        one_of("a task", name, self.tasks, CurriculumError)
        return tuple(t for t in self.transfers if t.target == name)

    def has_potential(self, name: str) -> bool:
        """Return whether a task has a potential, from its sources or written by hand."""
        return bool(self.in_edges(name)) or name in self.potential

    def ancestors(self, name: str) -> tuple[str, ...]:
        """Return the tasks that are trained before `name`, in training order."""
        one_of("a task", name, self.tasks, CurriculumError)
        needed = {name}
        for task in reversed(self.order):
            if task in needed:
                needed.update(edge.source for edge in self.in_edges(task))
        return tuple(task for task in self.order if task in needed and task != name)

    def setting(self, which: str, name: str) -> Any:
        """Return the value of a setting, such as ``"learner"``, for a task."""
        value = self._stated(which, name)
        if which == "budget":
            return self._budget(name, value)
        if value is not None:
            return value
        if which == "learner":
            return self._default_learner(name)
        if which == "shaping":
            return self._default_shaping(name)
        return 0.0 if which == "unknown_value" else None

    def check_networks(self, names: Sequence[str] | None = None) -> None:
        """Check the networks of tasks, by default all; SettingError names an unfit one's task."""
        for name in self.order if names is None else names:
            try:
                self.check_network(name)
            except SettingError as error:
                raise SettingError(f"the learner of {name!r} cannot be used: {error}") from None

    def check_network(self, name: str) -> None:
        """Check the learner of a task, if it is a network, with Stable-Baselines3.

        ImportError if that is not installed; SettingError if it does not take a setting or the
        shaping.
        """
        node, edges = self.node(name), self.in_edges(name)
        if not node.deep:
            return
        node.learner.algorithm_class()
        from curricle.deep.models import check_learner  # with torch, an extra

        in_tables = [edge.source for edge in edges if not self.node(edge.source).deep]
        check_learner(node.learner, node.shaping if self.has_potential(name) else None, in_tables)
        if edges and isinstance(node.shaping, WeightTransfer):
            self._check_weights(name)

    def _check_weights(self, name: str) -> None:
        """Raise SettingError unless a task's network can begin as the network of its source."""
        sources = [edge.source for edge in self.in_edges(name)]
        if len(sources) > 1:
            raise SettingError(
                "WeightTransfer takes over the network of one source, of several in a chain, each "
                f"the source of the next: {name!r} has {', '.join(sources)}"
            )
        source: Any = self.tasks[sources[0]]
        target: Any = self.tasks[name]
        of_source, of_target = source.actions, target.actions
        if (source.n_actions, of_source.shape) != (target.n_actions, of_target.shape):
            raise SettingError(
                "WeightTransfer needs equal numbers of actions in source and target: "
                f"{sources[0]!r} has {of_source}, {name!r} has {of_target}"
            )

    def _default_learner(self, name: str) -> Any:
        """Return the default learner of a task: OptimisticQLearning for a first one, if possible.

        Miniatures have that of their target.
        """
        task: Any = self.tasks[name]
        targets = [edge.target for edge in self.transfers if edge.source == name]
        if targets and isinstance(task, Miniatures):
            return self.setting("learner", targets[0])
        if targets and not self.in_edges(name) and has_tables(task) and self._suits_optimists(name):
            return OptimisticQLearning()
        return QLearning()

    def _default_shaping(self, name: str) -> Shaping:
        """Return the default shaping of a task: QInitialisation, in a portfolio if possible."""
        learner, edges = self.setting("learner", name), self.in_edges(name)
        if len(edges) == 1 and isinstance(self.tasks[edges[0].source], Miniatures):
            alike = learner == self.setting("learner", edges[0].source)
            critic = isinstance(learner, DeepLearner) and learner.algorithm in ACTOR_CRITICS
            if critic and alike and edges[0].mapping.is_identity:
                return WeightTransfer(kl=PULL)
        if isinstance(learner, DeepLearner) and not learner.may_start_at_potential:
            return StateShaping()
        plain = isinstance(learner, QLearning) and not masks_actions(self.tasks[name])
        # Sparse values cannot be transferred.
        if plain and self._suits_optimists(name, sparse=name in self.last_tasks):
            return QInitialisation(portfolio=Portfolio())
        return QInitialisation()

    def _suits_optimists(self, name: str, *, sparse: bool = False) -> bool:
        """Return whether a task has a horizon, and dense tables of few pairs or `sparse` ones."""
        model, kind = generative_model(self.tasks[name]), self.setting("storage", name).kind
        # The limit does not depend on the machine's memory.
        few = kind != "sparse" and model.states.size * model.actions.size <= MOST_SHARED
        bounded = model.discount < 1 or model.time_limit is not None
        return bounded and (few or (sparse and kind != "dense"))

    def _stated(self, which: str, name: str) -> Any:
        """Return a setting of a task as stated, else as in `SETTINGS`."""
        stated = getattr(self, which)
        return stated.get(name, SETTINGS[which]) if isinstance(stated, Mapping) else stated

    def _budget(self, name: str, stated: Budget | None) -> Budget:
        """Return the budget of a task; a rule ends a source when its return has converged."""
        if name in self.last_tasks:
            return DEFAULT_STEPS if stated is None else stated
        learner = self.setting("learner", name)
        if stated is not None:
            return capped(stated, learner)
        most, share = int(NO_LIMIT), SOURCES_SHARE
        if isinstance(learner, OptimisticQLearning):
            share = OPTIMISTS_SHARE
            model = generative_model(self.tasks[name])
            live = model.states.size if model.terminal is None else int((~model.terminal).sum())
            most = max(FEWEST_STEPS, STEPS_A_PAIR * live * model.actions.size)
        budgets = self.budget if isinstance(self.budget, Mapping) else {}
        shares = []
        for target in self.last_tasks:
            sources = self.ancestors(target)
            if name in sources:
                stepping = [s for s in sources if not isinstance(self.tasks[s], Miniatures)]
                unstated = max(1, sum(budgets.get(source) is None for source in stepping))
                steps = int(share * self.node(target).most_steps)
                shares.append(capped(max(1, min(steps // unstated, most)), learner))
        return max(shares, key=limits)

    def node(self, name: str) -> Node:
        """Return a task with all its settings; SettingError if any is invalid."""
        one_of("a task", name, self.tasks, CurriculumError)
        settings = {which: self.setting(which, name) for which in SETTINGS}
        distilled, freq = isinstance(self.tasks[name], Miniatures), settings["eval_freq"]
        settings["eval_freq"] = 1 if distilled else spacing(freq, settings["budget"])
        return Node(name, self.tasks[name], **settings)

    def replace(self, name: str, **settings: Any) -> "Curriculum":
        """Return the curriculum with other settings, such as ``budget=``, for one task.

        Every other task keeps its own, the budget of a source that states none included.
        CurriculumError if a setting or the task is unknown.
        """
        one_of("the task", name, self.tasks, CurriculumError)
        for which in settings:
            one_of("a setting", which, SETTINGS, CurriculumError)
        changes: dict[str, Any] = {
            which: {**{n: self.setting(which, n) for n in self.tasks}, name: value}
            for which, value in settings.items()
        }
        return replace(self, **changes)

    def train(
        self,
        seeds: int | Sequence[int] = 1,
        *,
        only: str | Sequence[str] | None = None,
        trained: Mapping[str, Learnt] | None = None,
        charge: bool = False,
        snapshots: int = 0,
        workers: int | None = None,
        progress: Progress = None,
    ) -> CurriculumResult:
        """Train all tasks, sources first, and return their results; the K seeds are independent.

        Parameters
        ----------
        seeds : int or sequence of int
            As in :func:`learn`. The k-th seed of a target reads the k-th seed of its sources.
        only : str or sequence of str, optional
            Tasks to train, with all their sources; every task by default.
        trained : dict of str to LearningResult or SourceValues, optional
            Results of tasks that were learnt before; CurriculumError if they have other seeds.
        charge : bool
            Whether the budget of :attr:`target` includes the steps of its sources, seed by seed;
            CurriculumError if it is a number of episodes.
        snapshots : int
            Number of tables of the first seed to keep during training of each task
            (:class:`Snapshots`).
        workers : int, optional
            Threads over seeds.
        progress : bool or callable, optional
            True shows a bar for each task; a function is called with the name of each learnt task.
        """
        check_progress(progress)
        numbers = seed_tuple(seeds)
        trained = {} if trained is None else trained
        instance("trained", trained, Mapping, CurriculumError)
        for name, result in trained.items():
            belongs = name in self.tasks and isinstance(result, Learnt)
            if not belongs or not same_task(result.task, self.tasks[name]):
                raise CurriculumError(
                    "trained must hold results of tasks of the curriculum: "
                    f"{name!r} is {brief(result)}"
                )
            if result.seeds != numbers:
                raise CurriculumError(
                    f"a trained result must have the seeds asked for, {numbers}: {name!r} has "
                    f"{result.seeds}"
                )
        earlier = {name: SourceValues.of(result) for name, result in trained.items()}
        sources = dict(earlier)
        results = {k: v for k, v in trained.items() if isinstance(v, LearningResult)}
        potentials: dict[str, list[AnyPotential]] = {}
        if charge and isinstance(self.setting("budget", self.target), Episodes):
            raise CurriculumError(
                "source steps are charged to a budget in steps: that of target "
                f"{self.target!r} is {self.setting('budget', self.target)}; give it steps"
            )
        paying = self.target if charge else None
        wanted = set(self.order if only is None else [only] if isinstance(only, str) else only)
        wanted |= {source for name in wanted for source in self.ancestors(name)}
        names = [name for name in self.order if name in wanted and name not in earlier]
        self.check_networks(names)
        with shown(progress) as bars:
            for name in names:
                spent = self.spent(name, sources, len(numbers)) if name == paying else None
                options = TrainingOptions(spent, snapshots, workers, bars.within())
                results[name], potentials[name] = self.train_task(name, sources, numbers, options)
                sources[name] = SourceValues.of(results[name])
                bars.tell(name)
        return CurriculumResult(self, results, potentials, earlier)

    def train_task(
        self,
        name: str,
        sources: Mapping[str, Learnt],
        seeds: tuple[int, ...],
        options: TrainingOptions,
    ) -> tuple[LearningResult, list[AnyPotential]]:
        """Return a task's result, and its potentials as they entered.

        `sources` have the same `seeds`.
        """
        potentials = self.potentials(name, sources, seeds=len(seeds))
        return self.node(name).train(seeds, potentials, options), potentials

    def spent(self, name: str, sources: Mapping[str, Learnt], seeds: int) -> IntArray:
        """Return the steps of each of K seeds in all tasks on which a task builds, (K,) int64."""
        steps = [sources[source].steps_used for source in self.ancestors(name)]
        total: IntArray = np.sum([np.zeros(seeds, np.int64), *steps], axis=0)
        return total

    def potentials(
        self,
        name: str,
        sources: Mapping[str, Learnt],
        *,
        transfers: Sequence[Transfer] | None = None,
        seeds: int = 1,
    ) -> list[AnyPotential]:
        """Return a task's potential for each seed, from its sources' values; [] if it has none.

        `transfers` are by default all transfers into the task. A potential written by hand is the
        same for all `seeds`. CurriculumError when a source's values were not kept, are not in a
        dense table, or include shaping rewards.
        """
        edges = self.in_edges(name) if transfers is None else tuple(transfers)
        if not edges and name in self.potential:
            return [self.potential[name]] * seeds
        how: dict[str, Any] = {"function": self.setting("aggregate", name)}
        how["unknown_value"] = self.setting("unknown_value", name)
        for edge in edges:
            if not np.all(sources[edge.source].own_rewards):
                raise CurriculumError(
                    "values that a target reads must be in their task's own rewards: those of "
                    f"{edge.source!r}, which {edge.target!r} reads, contain shaping rewards"
                )
        task, read = self.tasks[name], list[list[Any]]()
        observed = is_observation_task(task)
        for edge in edges:
            kept = sources[edge.source].values
            if isinstance(kept, np.ndarray):
                read.append([TableValues(rows) for rows in kept] if observed else [*kept])
            elif observed and kept is not None and all(isinstance(x, ValueSource) for x in kept):
                read.append([*kept])
            else:
                raise CurriculumError(
                    f"a source's values must be kept, in dense tables{' or networks' * observed}: "
                    f"those of {edge.source!r}, which {edge.target!r} reads, are not; see Storage"
                )
        make: Any = ObservationPotential if observed else combined_potential
        return [make(task, edges, of_seed, **how) for of_seed in zip(*read, strict=True)]
