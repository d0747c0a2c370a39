"""Attribution: which source made which greedy choices in the target better or worse.

Each transfer is left out in turn, all other settings and random numbers being the same. The
difference in each state is the effect of that transfer.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from curricle.array_types import BoolArray, FloatArray, IntArray
from curricle.checks import one_of, whole_number
from curricle.comparison.targets import transfers_into
from curricle.curriculum.curriculum import Curriculum
from curricle.curriculum.sources import Learnt
from curricle.display import block, brief_repr, printed, table
from curricle.errors import CurriculumError, SettingError
from curricle.learning.result import LearningResult
from curricle.learning.seeds import seed_tuple
from curricle.planning.solution import Solution, right_choices, solve
from curricle.progress import Bars, Progress, check_progress, shown
from curricle.statistics.intervals import Interval, paired_difference
from curricle.tasks.mdp import FiniteMDP
from curricle.tasks.task import Task, tables
from curricle.text_tables import counted
from curricle.transfer.edges import Transfer, transfer_names

STANDARD_ERRORS = 3.0
"""Standard errors that a change must exceed."""
LEAST = 0.5
"""Share of seeds in which the choice in a state must have changed."""
SHOWN = 3
"""Regions that are printed."""


@dataclass(frozen=True, eq=False)
class Region:
    """Connected states whose greedy choices a source made worse, or better.

    Attributes
    ----------
    states : (n,) int64
    share : float
        Mean over the states of the additional share of seeds with a wrong choice; negative if
        choices became right.
    loss : float
        Mean over the states of the additional loss by the greedy choice, in return.
    where : str
        The values of their components.
    """

    states: IntArray
    share: float
    loss: float
    where: str

    __repr__ = brief_repr
    _repr_html_ = printed

    def __str__(self) -> str:
        n = len(self.states)
        return f"{counted(n, 'state')} ({self.where}), in {abs(self.share):.0%} of seeds"


@dataclass(frozen=True, eq=False)
class Attribution:
    """The effect of each transfer into a target after some steps of learning.

    Attributes
    ----------
    task : Task
    steps : int
    names : tuple of N str
    wrong : (N, S) float64
        Share of seeds whose greedy choice in a state is not optimal, with the transfer minus
        without it; negative if the transfer helps.
    error : (N, S) float64
        Its standard error, over paired seeds.
    loss : (N, S) float64
        The same difference of the loss V*(s) - Q*(s, greedy a), in return. Rare large losses make
        it noisier than `wrong`.
    gain : tuple of N Interval
        Greedy return from the start with the transfer minus without it.
    """

    task: Task
    steps: int
    names: tuple[str, ...]
    wrong: FloatArray = field(repr=False)
    error: FloatArray = field(repr=False)
    loss: FloatArray = field(repr=False)
    gain: tuple[Interval, ...]

    __repr__ = brief_repr

    def _repr_html_(self) -> str:
        rows = [
            (name, str(gain), *(self._places(name, harmed=harmed) for harmed in (True, False)))
            for name, gain in zip(self.names, self.gain, strict=True)
        ]
        head = ["transfer", "change of the greedy return", "worse in", "better in"]
        title = f"Attribution after {self.steps:,} steps"
        return block(title, table(head, rows, wide=head[2:]))

    def _places(self, name: str, *, harmed: bool) -> str:
        """Return the largest regions in which choices became worse, or better, in words."""
        regions = self.regions(name, harmed=harmed)
        shown, left = "; ".join(map(str, regions[:SHOWN])), len(regions) - SHOWN
        more = f"; and {counted(left, 'more region')}" if left > 0 else ""
        return f"{shown}{more}" if regions else "nowhere"

    def changed_states(self, name: str, *, harmed: bool = True, least: float = LEAST) -> BoolArray:
        """Return the states whose choice a transfer made worse (or better), (S,) bool.

        A state counts if its change exceeds three standard errors.

        Parameters
        ----------
        name : str
            The transfer.
        harmed : bool
            Worse, or better.
        least : float
            Share of seeds in which the choice must have changed, at least.
        """
        one_of("a transfer", name, self.names, CurriculumError)
        n = self.names.index(name)
        worse = self.wrong[n] if harmed else -self.wrong[n]
        return np.asarray((worse > STANDARD_ERRORS * self.error[n]) & (worse >= least))

    def regions(
        self, name: str, *, harmed: bool = True, least: float = LEAST
    ) -> tuple[Region, ...]:
        """Return the changed states in regions connected by transitions, largest effect first."""
        chosen = self.changed_states(name, harmed=harmed, least=least)
        n = self.names.index(name)
        found = [
            Region(
                states,
                float(self.wrong[n, states].mean()),
                float(self.loss[n, states].mean()),
                _where(self.task, states),
            )
            for states in _connected(tables(self.task), chosen)
        ]
        return tuple(sorted(found, key=lambda one: -abs(one.share) * len(one.states)))

    def __str__(self) -> str:
        lines = []
        for name, gain in zip(self.names, self.gain, strict=True):
            lines.append(f"{name} after {self.steps:,} steps: greedy return changed by {gain}")
            for harmed, word in ((True, "worse"), (False, "better")):
                where = self._places(name, harmed=harmed)
                lines.append(f"  {word} {where if where == 'nowhere' else f'in {where}'}")
        return "\n".join(lines)


def attribute(
    curriculum: Curriculum,
    target: str | None = None,
    *,
    steps: int,
    seeds: int | Sequence[int] = 20,
    trained: Mapping[str, Learnt] | None = None,
    workers: int | None = None,
    progress: Progress = None,
) -> Attribution:
    """Return which transfers helped or did harm, and in which states.

    Parameters
    ----------
    curriculum : Curriculum
    target : str, optional
        By default the task that all others lead to. It must be small enough to solve.
    steps : int
        Of learning in the target, after which choices are compared; 1 compares the potentials.
    seeds : int or sequence of int
        At least 2.
    trained : dict of str to SourceValues or LearningResult, optional
        Sources trained before, for the same seeds.
    workers : int, optional
        Threads over seeds.
    progress : bool or callable, optional
        True shows a bar for each task that is learnt, and for the target without each transfer; a
        function is called with the name of each transfer that has been left out.

    Raises
    ------
    CurriculumError
        If the target is unknown, not unique or has no transfer into it.
    SettingError
        If a number is out of range, before any training.

    Examples
    --------
    >>> from curricle import GridWorld, QInitialisation, Transfer, same_position
    >>> maze = GridWorld(["....T", ".PPP.", "S...."])
    >>> corner = maze.crop(rows=(0, 2), columns=(2, 5))
    >>> plan = Curriculum(
    ...     tasks={"corner": corner, "maze": maze},
    ...     transfers=[Transfer("corner", "maze", same_position(maze, corner))],
    ...     shaping=QInitialisation(), budget=2000)
    >>> found = attribute(plan, steps=200, seeds=10)
    >>> [region.where for region in found.regions("corner -> maze", harmed=False)]
    ['row 0, column 0', 'row 0, column 2']
    """
    check_progress(progress)
    name, edges = transfers_into(curriculum, target, "an attribution")
    numbers = seed_tuple(seeds)
    if len(numbers) < 2:
        raise SettingError(f"an attribution needs at least 2 seeds: got {len(numbers)}")
    steps = whole_number("steps of an attribution", steps, 1, SettingError)
    solution = solve(curriculum.tasks[name])  # before any training, as it may refuse the task
    short = curriculum.replace(name, budget=steps, eval_freq=steps)
    elsewhere = [edge for edge in curriculum.transfers if edge.target != name]

    def learn_with(into: Sequence[Transfer], bars: Bars) -> LearningResult:
        fewer = replace(short, transfers=[*elsewhere, *into])
        how: Any = {"trained": sources, "workers": workers, "progress": bars}
        return fewer.train(numbers, only=[name], **how)[name]

    without = []
    with shown(progress) as bars:
        before: Any = {"trained": trained, "workers": workers, "progress": bars.within()}
        sources = curriculum.train(numbers, only=curriculum.ancestors(name), **before).sources
        with_all = learn_with(edges, bars.within())
        for left_out, label in zip(edges, transfer_names(edges), strict=True):
            others = [edge for edge in edges if edge is not left_out]
            without.append(learn_with(others, bars.within(f"without {label}")))
            bars.tell(label)
    loss, wrong = _choices(with_all.values, solution)
    alone = [_choices(result.values, solution) for result in without]
    more_wrong = np.stack([wrong.astype(float) - other for _, other in alone])
    returns = with_all.greedy_return[:, -1]
    return Attribution(
        task=curriculum.tasks[name],
        steps=steps,
        names=tuple(transfer_names(edges)),
        wrong=more_wrong.mean(axis=1),
        error=more_wrong.std(axis=1, ddof=1) / np.sqrt(len(numbers)),
        loss=np.stack([(loss - other).mean(axis=0) for other, _ in alone]),
        gain=tuple(paired_difference(returns, r.greedy_return[:, -1]) for r in without),
    )


def _choices(values: FloatArray, solution: Solution) -> tuple[FloatArray, BoolArray]:
    """Return the loss of the greedy choices on values (K, S, A), and which are wrong: (K, S) each.

    The loss is V*(s) - Q*(s, a), averaged over the greedy actions.
    """
    greedy = values == values.max(axis=-1, keepdims=True)
    kept = (greedy * solution.action_values).sum(axis=-1) / greedy.sum(axis=-1)
    return solution.values - kept, ~right_choices(values, solution.optimal)


def _connected(mdp: FiniteMDP, chosen: BoolArray) -> Iterator[IntArray]:
    """Yield the chosen states in regions connected by one transition, in either direction."""
    from scipy.sparse import coo_array  # takes time, and few need it
    from scipy.sparse.csgraph import connected_components

    states = np.flatnonzero(chosen)
    rows = mdp.outcome_row[states]
    after = mdp.next_state[rows]
    here = np.broadcast_to(states[:, None, None], after.shape)
    possible = (mdp.probability[rows] > 0) & chosen[after]
    edges = here[possible], after[possible]
    graph = coo_array((np.ones(len(edges[0])), edges), shape=(len(chosen), len(chosen)))
    labels = connected_components(graph, directed=False)[1][states]
    for label in np.unique(labels):
        yield states[labels == label]


def _where(task: Task, states: IntArray) -> str:
    """Return the values of each component over some states, as a span if there are many."""
    space = tables(task).states
    parts = []
    for component, values in zip(space.components, space.decode(states).values(), strict=True):
        labels = [component.label(int(value)) for value in np.unique(values)]
        if len(labels) == component.size > 1:
            continue  # all of them
        shown = ", ".join(labels) if len(labels) <= 3 else f"{labels[0]} to {labels[-1]}"
        parts.append(f"{component.name} {shown}")
    return ", ".join(parts) or "everywhere"
