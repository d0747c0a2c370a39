"""Going back to the sources where a target has lost what they gave it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from curricle.checks import number, whole_number
from curricle.curriculum.node import Node
from curricle.errors import SettingError
from curricle.learning.potential import StateActionPotential
from curricle.learning.potential_rollouts import PairPotential
from curricle.learning.result import LearningResult, joined_results, one_seed
from curricle.learning.run import AS_VALUES, WarmUp
from curricle.learning.snapshots import Snapshots
from curricle.learning.stopping import Decision, StoppingRule
from curricle.tasks.spaces import frozen

Potential = Callable[[Mapping[str, LearningResult]], PairPotential]
"""One seed's sources -> the potential they give the target."""


@dataclass(frozen=True)
class Return:
    """When a target goes back to its sources, and for how long.

    Knowledge that was too hopeful, or not learnt well enough, can leave a target worse off than it
    started: its greedy return falls below that of the very potential. Then the sources are trained
    on, and what they know now takes the place of what they knew: Q becomes Q - phi + phi', so that
    what the target learnt beyond phi is kept. As Q(s, a) = phi(s, a) is Q-learning from other
    initial values, the optimum is kept too.

    Parameters
    ----------
    lost : float
        Return: it goes back when each of its last evaluations lies more than this below where it
        started (or started again).
    again : int
        Steps that each source is trained on for; they are source steps like those before.
    most : int
        How often at most.
    evaluations : int
        How many "the last" are; a gate's own number, where the budget is a gate.

    Raises
    ------
    SettingError
        When a number is out of range.

    Examples
    --------
    >>> Return(lost=5.0, again=20_000)
    Return(lost=5.0, again=20000, most=3, evaluations=5)
    """

    lost: float
    again: int
    most: int = 3
    evaluations: int = 5

    def __post_init__(self) -> None:
        number("lost of a return", self.lost, SettingError, 0.0)
        for name in ("again", "most", "evaluations"):
            whole = whole_number(f"{name} of a return", getattr(self, name), 1, SettingError)
            object.__setattr__(self, name, whole)

    def watched(self, node: Node) -> Node:
        """Return a node whose training stops where it has to go back.

        Raises
        ------
        SettingError
            Where Q - phi + phi' makes no sense: other ways than initialise and look_ahead, a
            guard, or a budget in episodes.
        """
        if node.how not in AS_VALUES or node.guard is not None:
            raise SettingError(
                "a return to the sources needs how 'initialise' or 'look_ahead' and no guard: "
                f"{node.name!r} has how {node.how!r} and {'a' if node.guard else 'no'} guard"
            )
        budget = node.budget
        if isinstance(budget, int):
            budget = StoppingRule(budget, evaluations=self.evaluations)
        if not isinstance(budget, StoppingRule):
            raise SettingError(
                f"a return to the sources needs a budget in steps or a gate: {node.name!r} has "
                f"{budget}"
            )
        return node.replace(budget=replace(budget, lost=self.lost))


class RetrainedResult(NamedTuple):
    """A target's training with its returns, for K seeds."""

    result: LearningResult
    extra: npt.NDArray[np.int64]
    """(K,) source steps spent on returns."""
    decisions: list[list[Decision]]
    """At each checkpoint of each seed."""


def with_retraining(
    back: Return,
    node: Node,
    sources: Mapping[str, tuple[Node, LearningResult]],
    potential_of: Potential,
    first: LearningResult,
    charged: Sequence[int] | npt.NDArray[np.int64] | None,
) -> RetrainedResult:
    """Return a target's training, gone on with after each time it went back to its sources.

    Parameters
    ----------
    back : Return
    node : Node
        The target.
    sources : dict of str to (Node, LearningResult)
        Of its direct sources, K seeds.
    potential_of : callable
    first : LearningResult
        The training of the watched target: until each seed first lost what it had, or ended.
    charged : sequence of K int, optional
        Steps that each seed was charged before.
    """
    retrained = []
    for k in range(len(first.seeds)):
        known = {name: (own, one_seed(result, k)) for name, (own, result) in sources.items()}
        spent = None if charged is None else int(charged[k])
        retrained.append(_course(back, node, known, potential_of, one_seed(first, k), spent))
    return RetrainedResult(
        joined_results([course.result for course in retrained]),
        np.concatenate([course.extra for course in retrained]),
        [decisions for course in retrained for decisions in course.decisions],
    )


def _course(
    back: Return,
    node: Node,
    sources: Mapping[str, tuple[Node, LearningResult]],
    potential_of: Potential,
    result: LearningResult,
    charged: int | None,
) -> RetrainedResult:
    """Return the training of one seed."""
    nodes = {name: own for name, (own, _) in sources.items()}
    known = {name: learnt for name, (_, learnt) in sources.items()}
    watched, phi = back.watched(node), potential_of(known)
    on = (
        node
        if isinstance(node.budget, StoppingRule)
        else node.replace(budget=StoppingRule(node.most_steps))
    )
    decisions, cost, extra, turn = _told(watched, result, charged), back.again * len(known), 0, 0
    while decisions[-1].lost:
        step, turn = int(result.steps_used[0]), turn + 1
        spent = 0 if charged is None else charged + extra
        left, start = node.most_steps - spent - step, result.values[0]
        if left == 0:
            break
        goes_back = turn <= back.most and (charged is None or left > cost)
        if goes_back:
            known = {name: _longer(nodes[name], known[name], back.again, turn) for name in known}
            better = potential_of(known)
            start, phi, extra = start - phi.values + better.values, better, extra + cost
            spent += 0 if charged is None else cost
        then = f"goes back to {', '.join(known)}" if goes_back else "stays, with no return left"
        decisions[-1] = replace(decisions[-1], then=then)
        after = _later(watched if goes_back else on, step)
        part = _gone_on(after, result, start, spent, turn)
        decisions += [later for later in _told(after, part, spent) if later.step > step]
        result = _followed_by(result, part)
    return RetrainedResult(result, np.array([extra]), [decisions])


def _told(node: Node, result: LearningResult, charged: int | None) -> list[Decision]:
    """Return the decisions of one seed, of whose budget so many steps were spent elsewhere."""
    gate = node.budget
    assert isinstance(gate, StoppingRule)
    most = gate.most - (charged or 0)
    left = replace(gate, most=most, least=min(gate.least, most))
    return node.replace(budget=left).decisions(result)[0]


def _longer(node: Node, result: LearningResult, steps: int, turn: int) -> LearningResult:
    """Return a source trained on from what it knows, in its own name and at its own account."""
    on = node.replace(
        name=f"{node.name}/return {turn}",
        budget=steps,
        eval_freq=steps,
        how="initialise",
        guard=None,
    )
    return on.train(result.seeds, [_initial(on, result.values[0])], workers=1)


def _later(node: Node, step: int) -> Node:
    """Return a target that is judged by what it does from a step on."""
    gate = node.budget
    assert isinstance(gate, StoppingRule)
    least = min(step + gate.evaluations * node.eval_freq, gate.most)
    return node.replace(budget=replace(gate, least=max(gate.least, least)))


def _gone_on(
    node: Node, so_far: LearningResult, start: npt.NDArray[np.float64], charged: int, turn: int
) -> LearningResult:
    """Return a target's training from the step it is at, started at other values."""
    step = int(so_far.steps_used[0])
    on = node.replace(name=f"{node.name}/return {turn}")
    warm_up = WarmUp(np.array([step]), np.zeros(1))
    return on.train(
        so_far.seeds, [_initial(on, start)], warm_ups=[warm_up], charged=[charged], workers=1
    )


def _initial(node: Node, values: npt.NDArray[np.float64]) -> StateActionPotential:
    """Return the potential from which a node's table starts at these values."""
    return StateActionPotential(node.task, values - float(node.learner.initial_value))


def _followed_by(first: LearningResult, second: LearningResult) -> LearningResult:
    """Return one seed's training and what followed on it, which has the whole axis of steps."""
    n = int(np.searchsorted(second.steps, first.steps_used[0], side="right"))

    def curve(name: str) -> npt.NDArray[np.float64]:
        whole = getattr(second, name).copy()
        whole[:, :n] = getattr(first, name)[:, :n]
        return frozen(whole)

    episodes = second.episodes + first.episodes_used[0] - 1  # the warm_up counts as one
    episodes[:, :n] = first.episodes[:, :n]
    snapshots = first.snapshots
    if snapshots is not None and second.snapshots is not None:
        new = second.snapshots.steps > snapshots.steps[-1]
        snapshots = Snapshots(
            snapshots.seed,
            np.concatenate([snapshots.steps, second.snapshots.steps[new]]),
            np.concatenate([snapshots.values, second.snapshots.values[new]]),
        )
    return replace(
        second,
        training_return=curve("training_return"),
        greedy_return=curve("greedy_return"),
        guard_share=curve("trust"),
        episodes=frozen(episodes),
        episodes_used=first.episodes_used + second.episodes_used - 1,
        snapshots=snapshots,
    )
