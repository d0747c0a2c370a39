"""Training the sources further where the return of their target drops below its start."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.array_types import FloatArray, IntArray
from curricle.checks import number, whole_number
from curricle.curriculum.node import Node
from curricle.curriculum.sources import Progress, SourceValues
from curricle.errors import CurriculumError, SettingError
from curricle.frozen_arrays import frozen
from curricle.learning.potential import StateActionPotential
from curricle.learning.potential_rollouts import PairPotential
from curricle.learning.record import Snapshots, WarmUp
from curricle.learning.result import LearningResult, joined_results, one_seed
from curricle.learning.shaping import QInitialisation
from curricle.learning.stopping import Decision, StoppingRule
from curricle.planning.policy_evaluation import GreedyEvaluation

Potentials = Callable[[Mapping[str, FloatArray]], Sequence[PairPotential]]
"""The values of K seeds of the sources, (K, S', A') each -> the target's K potentials."""


@dataclass(frozen=True)
class RetrainSources:
    """When the sources of a target are trained further, and for how long.

    A potential that is too high, or was not learnt well enough, can leave a target worse off than
    it started: its greedy return falls below that of the potential itself. Then the sources are
    trained further and their new potential phi' replaces phi: Q becomes Q - phi + phi', so that
    what the target itself has learnt, Q - phi, is kept. This is Q-learning from other initial
    values, so the optimum is kept too. Schedules and counts of updates go on where training
    stopped, in the sources and in the target; :class:`DoubleQLearning` goes on from the mean of its
    tables.

    Parameters
    ----------
    drop : float
        Sources are retrained when each of the last evaluations lies more than this return below
        the one at which the target started (or started again).
    steps : int
        Further steps of each source; they are source steps like those before. The evaluations that
        decide are free (:class:`GreedyEvaluation`).
    times : int
        How often at most.
    patience : int
        How many "the last" are; that of the stopping rule, where the budget is one.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> RetrainSources(drop=5.0, steps=20_000)
    RetrainSources(drop=5.0, steps=20000, times=3, patience=5)
    """

    drop: float
    steps: int
    times: int = 3
    patience: int = 5

    def __post_init__(self) -> None:
        number("drop of RetrainSources", self.drop, SettingError, 0.0)
        for name in ("steps", "times", "patience"):
            whole = whole_number(f"{name} of RetrainSources", getattr(self, name), 1, SettingError)
            object.__setattr__(self, name, whole)

    def watched(self, node: Node) -> Node:
        """Return a node whose training stops where its sources have to be retrained.

        Raises
        ------
        SettingError
            Where Q - phi + phi' makes no sense: a shaping that does not start Q at the potential, a
            guard, or a budget in episodes.
        """
        shaping = node.shaping
        if not shaping.starts_at_potential or shaping.guard is not None:
            raise SettingError(
                "RetrainSources needs the shaping QInitialisation or LookAheadAdvice without a "
                f"guard: {node.name!r} has {shaping}"
            )
        budget = node.budget
        if isinstance(budget, int):
            budget = StoppingRule(budget, patience=self.patience)
        if not isinstance(budget, StoppingRule):
            raise SettingError(
                f"RetrainSources needs a budget in steps or a StoppingRule: {node.name!r} has "
                f"{budget}"
            )
        return node.replace(budget=replace(budget, drop=self.drop))


class RetrainedResult(NamedTuple):
    """A target's training with that of its sources in between, for K seeds."""

    result: LearningResult
    extra: IntArray
    """(K,) steps of retraining the sources."""
    decisions: list[list[Decision]]
    """At each checkpoint of each seed."""


class _Source(NamedTuple):
    """A source of one seed: what it learnt, and where its training stopped."""

    node: Node
    values: FloatArray  # (1, S', A')
    done: WarmUp

    @classmethod
    def of(cls, name: str, node: Node, learnt: SourceValues, k: int) -> "_Source":
        """Return the source of the k-th seed; CurriculumError if it cannot be trained further."""
        progress = learnt.progress
        if progress is None or (node.learner.counts and progress.visits is None):
            raise CurriculumError(
                "RetrainSources goes on from the step and the counts of updates at which the "
                f"training of a source stopped: those of {name!r} are not known"
            )
        return cls(node, learnt.values[k : k + 1], progress.of_seed(k))

    def trained_on(self, seeds: tuple[int, ...], steps: int, turn: int) -> "_Source":
        """Return the source after further training, with a random stream of its own."""
        budget = self.done.steps + steps
        on = self.node.replace(
            name=f"{self.node.name}/return {turn}",
            budget=budget,
            eval_freq=budget,
            evaluation=GreedyEvaluation(method="off"),
            shaping=QInitialisation(),
        )
        start = [_initial(on, self.values[0])]
        found = on.train(seeds, start, warm_ups=[self.done], workers=1)
        return _Source(self.node, found.values, _progress(found))


def with_retraining(
    retrain: RetrainSources,
    node: Node,
    sources: Mapping[str, tuple[Node, SourceValues]],
    potentials_of: Potentials,
    first: LearningResult,
    charged: Sequence[int] | IntArray | None,
    snapshots: int = 0,
) -> RetrainedResult:
    """Return the training of a target, continued after each retraining of its direct sources.

    `first` is the training of the watched target: until the return of each of K seeds dropped, or
    to its end. Each source comes with what K seeds learnt; `charged` are the steps that each seed
    was charged before, `snapshots` how many `first` was asked for.

    Raises
    ------
    CurriculumError
        When it is not known where the training of a source stopped, or the target's values were
        not kept in a dense table.
    """
    if not isinstance(first.values, np.ndarray):
        raise CurriculumError(
            "RetrainSources changes the values of a target, which must be kept, in a dense table: "
            f"those of {node.name!r} are not; see Storage"
        )
    each = []
    for k in range(len(first.seeds)):
        own = {name: _Source.of(name, *source, k) for name, source in sources.items()}
        spent = None if charged is None else int(charged[k])
        result = one_seed(first, k)
        asked = 0 if result.snapshots is None else snapshots
        each.append(_one_retrained(retrain, node, own, potentials_of, result, spent, asked))
    return RetrainedResult(
        joined_results([one.result for one in each], first.seeds),
        np.concatenate([one.extra for one in each]),
        [decisions for one in each for decisions in one.decisions],
    )


def _one_retrained(
    retrain: RetrainSources,
    node: Node,
    sources: Mapping[str, _Source],
    potentials_of: Potentials,
    result: LearningResult,
    charged: int | None,
    snapshots: int,
) -> RetrainedResult:
    """Return the training of one seed, given its sources."""

    def potential() -> PairPotential:
        (found,) = potentials_of({name: source.values for name, source in sources.items()})
        return found

    watched, phi = retrain.watched(node), potential()
    unwatched = node
    if not isinstance(node.budget, StoppingRule):
        unwatched = node.replace(budget=StoppingRule(node.most_steps))
    decisions, cost = _decisions(watched, result, charged), retrain.steps * len(sources)
    extra, turn = 0, 0
    while decisions[-1].dropped:
        step, start, turn = int(result.steps_used[0]), result.values[0], turn + 1
        spent = 0 if charged is None else charged + extra
        left = node.most_steps - spent - step
        if left == 0:
            break
        after, then = unwatched, "goes on without retraining"
        if turn <= retrain.times and (charged is None or left > cost):
            sources = {
                name: source.trained_on(result.seeds, retrain.steps, turn)
                for name, source in sources.items()
            }
            better = potential()
            start, phi, extra = start - phi.values + better.values, better, extra + cost
            spent += 0 if charged is None else cost
            after, then = watched, f"retrains {', '.join(sources)}"
        decisions[-1] = replace(decisions[-1], then=then)
        after = _deferred(after, step)
        part = _continued(after, result, start, spent, turn, snapshots)
        decisions += [later for later in _decisions(after, part, spent) if later.step > step]
        result = _spliced(result, part)
    return RetrainedResult(result, np.array([extra]), [decisions])


def _decisions(node: Node, result: LearningResult, charged: int | None) -> list[Decision]:
    """Return the decisions of one seed, whose budget was charged so many steps before."""
    rule = node.budget
    assert isinstance(rule, StoppingRule)
    most = rule.max_steps - (charged or 0)
    left = replace(rule, max_steps=most, min_steps=min(rule.min_steps, most))
    return node.replace(budget=left).decisions(result)[0]


def _deferred(node: Node, step: int) -> Node:
    """Return a target whose stopping rule applies only to evaluations after a step."""
    rule = node.budget
    assert isinstance(rule, StoppingRule)
    least = min(step + rule.patience * node.eval_freq, rule.max_steps)
    return node.replace(budget=replace(rule, min_steps=max(rule.min_steps, least)))


def _continued(
    node: Node,
    so_far: LearningResult,
    start: FloatArray,
    charged: int,
    turn: int,
    snapshots: int,
) -> LearningResult:
    """Return a target's training from its present step on, started at other values."""
    on = node.replace(name=f"{node.name}/return {turn}")
    return on.train(
        so_far.seeds,
        [_initial(on, start)],
        warm_ups=[_progress(so_far)],
        charged=[charged],
        snapshots=snapshots,
        workers=1,
    )


def _progress(result: LearningResult) -> WarmUp:
    """Return where the training of one seed stopped, for it to go on."""
    return Progress(result.steps_used, result.visits).of_seed(0)


def _initial(node: Node, values: FloatArray) -> StateActionPotential:
    """Return the potential from which a node's table starts at these values."""
    initial = node.learner.for_task(node.task).initial_value
    return StateActionPotential(node.task, values - float(initial))


def _spliced(first: LearningResult, second: LearningResult) -> LearningResult:
    """Return one seed's training and its continuation, on the axis of the latter."""
    n = int(np.searchsorted(second.steps, first.steps_used[0], side="right"))

    def curve(before: npt.NDArray[Any], after: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return frozen(np.concatenate([before[:, :n], after[:, n:]], axis=1))

    earlier = first.episodes_used - 1  # the continuation counts what came before as one episode
    snapshots = first.snapshots
    if snapshots is not None and second.snapshots is not None:
        new = second.snapshots.steps > snapshots.steps[-1]
        snapshots = Snapshots(
            snapshots.seed,
            frozen(np.concatenate([snapshots.steps, second.snapshots.steps[new]])),
            frozen(np.concatenate([snapshots.values, second.snapshots.values[new]])),
        )
    return replace(
        second,
        training_return=curve(first.training_return, second.training_return),
        greedy_return=curve(first.greedy_return, second.greedy_return),
        guard_share=curve(first.guard_share, second.guard_share),
        episodes=curve(first.episodes, second.episodes + earlier),
        episodes_used=second.episodes_used + earlier,
        evaluation_steps=first.evaluation_steps + second.evaluation_steps,
        snapshots=snapshots,
    )
