"""Published ways to make a curriculum of candidates, and what they are compared with.

A designer is ``designer(problem, candidates, budget, seed=...) -> Curriculum``. Sources take 60
steps a state at most, all of them together half of a training, and end before where their return
has settled. They are read at scale 1, by their mean, as the start of Q.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, permutations
from typing import Any

import numpy as np

from benchmarks.referee.problem import TARGET, BudgetSpent, Problem, SearchBudget
from benchmarks.referee.recipes import AGGREGATES, SHAPINGS, transfers_of
from curricle.curriculum.curriculum import Curriculum
from curricle.design import SourceCandidate, SourceCandidates, mappings_between
from curricle.errors import CurricleError
from curricle.learning.shaping import QInitialisation
from curricle.learning.stopping import SETTLED, StoppingRule

STEPS_PER_STATE, SHARE = 60.0, 0.5
"""Of a source at most; and of a training, for all sources."""
SEEDS, WIDTH, LONGEST_RANDOM = 3, 3, 3
"""Seeds of each training of a search; chains that a beam grows; sources of a random chain."""
SVETLIK_THRESHOLD = 0.8
"""Of Silva and Costa's program for mazes. It counts states otherwise, and domains differ in it."""
REPETITIONS, OBJECT_THRESHOLD = 10, 2.0
"""Of Silva and Costa's program, where source tasks are generated."""
NO_OBJECTS = frozenset("#S ")
"""Characters of a map that are walls, the start or nothing."""
NUMBERED = re.compile(r"_?\d+$")

Chain = tuple[str, ...]
"""Names of sources, the first one first; each builds on the one before, the target on the last."""
Edge = tuple[str, str]
"""Names of a source and of what reads it: another source, or the target."""
Objects = frozenset[tuple[str, Hashable]]
"""Of a task: the class of each, and what tells it from others of its class."""


def curriculum_of(
    problem: Problem,
    sources: Sequence[SourceCandidate],
    edges: Iterable[Edge],
    aggregate: str = "mean",
    shaping: str = "initialise",
) -> Curriculum:
    """Return the curriculum with these edges; CurricleError where a source cannot read another.

    A total is over sources: one that is read by m mappings enters by 1/m of each.
    """
    if not sources:
        return problem.scratch
    transfers = []
    for edge in edges:
        of_edge = list(transfers_of(problem.task, sources, [edge]))
        scale = 1 / len(of_edge) if aggregate == "total" else 1.0
        transfers += [replace(transfer, scale=scale) for transfer in of_edge]
    reading = {transfer.target for transfer in transfers} - {TARGET}
    share = SHARE * problem.steps / len(sources)
    budgets = {
        source.name: StoppingRule(
            max(1, int(min(STEPS_PER_STATE * source.task.states.size, share))), settled=SETTLED
        )
        for source in sources
    }
    shapings = {name: QInitialisation() for name in reading}
    return problem.curriculum(
        {source.name: source.task for source in sources},
        transfers,
        budgets,
        aggregate=AGGREGATES[aggregate],
        shaping={TARGET: SHAPINGS[shaping](), **shapings},
    )


def chain_curriculum(problem: Problem, candidates: SourceCandidates, chain: Chain) -> Curriculum:
    """Return the curriculum of a chain; CurricleError where a source cannot read the one before."""
    sources = [candidates[name] for name in chain]
    return curriculum_of(problem, sources, pairwise([*chain, TARGET]))


# -- without a search ----------------------------------------------------------------------------


def no_curriculum(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the curriculum without sources: the target is learnt alone."""
    return problem.scratch


def random_chain(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return a random chain of one to three candidates.

    A candidate that cannot read the one before it is passed over.
    """
    rng = np.random.default_rng(seed)
    length = int(rng.integers(1, LONGEST_RANDOM + 1))
    names = [source.name for source in candidates]
    chain: Chain = ()
    plan = problem.scratch
    for drawn in rng.permutation(len(names)):
        if len(chain) == length:
            break
        try:
            longer = (*chain, names[drawn])
            plan = chain_curriculum(problem, candidates, longer)
        except CurricleError:
            continue
        chain = longer
    return plan


def relative_size(problem: Problem, candidate: SourceCandidate) -> float:
    """Return the size of a candidate over that of the target.

    Its share of the target, such as that of a crop's side or of the way to the goal; of a candidate
    without a share below 1, its states over those of the target.
    """
    if candidate.share is not None and candidate.share < 1:
        return candidate.share
    return float(candidate.task.states.size / problem.task.states.size)


def fixed_recipe(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the same recipe for every problem: the one source that is the nearest to half."""
    nearest = min(candidates, key=lambda source: abs(relative_size(problem, source) - 0.5))
    return chain_curriculum(problem, candidates, (nearest.name,))


def growing_chain(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return a chain of one kind, in which each source is twice the size of the one before.

    From the target down, a half, a quarter and so on each get the candidate of the nearest ratio,
    if that is nearer to this size than to the next, and if the source after it can read it. The
    kind is that of which there are the most different sizes.
    """
    kinds = dict.fromkeys(source.kind for source in candidates)
    by_kind = [
        {one.name: relative_size(problem, one) for one in candidates if one.kind == kind}
        for kind in kinds
    ]
    sizes = max(by_kind, key=lambda sizes: len(set(sizes.values())))
    chain: Chain = ()
    plan, stage = problem.scratch, 1
    # Half a stage below the smallest source nothing is near any more.
    while stage <= 0.5 - math.log(min(sizes.values()), 2.0):
        distance = {name: abs(math.log(size, 2.0) + stage) for name, size in sizes.items()}
        for name in sorted(distance, key=lambda name: distance[name]):
            if distance[name] > 0.5:
                break
            longer = (name, *chain)
            try:
                plan = chain_curriculum(problem, candidates, longer)
            except CurricleError:
                continue
            chain = longer
            break
        stage += 1
    return plan


# -- searches by measured costs ------------------------------------------------------------------


class ChainCosts:
    """Mean costs of chains in a problem, each trained once, all over the same seeds."""

    def __init__(
        self, problem: Problem, candidates: SourceCandidates, budget: SearchBudget, seed: int
    ) -> None:
        self.problem, self.candidates, self.budget = problem, candidates, budget
        first = int(np.random.default_rng(seed).integers(2**31))
        self.seeds = range(first, first + SEEDS)
        self._known = dict[Chain, float]()
        self.best: Chain = ()  # that with the lowest cost so far; none before the first training
        self.lowest = float("inf")

    def of(self, chain: Chain) -> float:
        """Return the mean steps of a chain, its sources included; BudgetSpent before.

        A chain whose sources cannot read each other counts with all steps of a training.
        """
        if chain not in self._known:
            try:
                plan = chain_curriculum(self.problem, self.candidates, chain)
            except CurricleError:
                self._known[chain] = float(self.problem.steps)
                return self._known[chain]
            self._known[chain] = float(
                self.budget.train(self.problem, plan, self.seeds).steps.mean()
            )
            if self._known[chain] < self.lowest:
                self.best, self.lowest = chain, self._known[chain]
        return self._known[chain]

    @property
    def plan(self) -> Curriculum:
        """The curriculum of the best chain."""
        return chain_curriculum(self.problem, self.candidates, self.best)


def greedy_forward(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the chain to which no single source can be added at a lower measured cost.

    It begins with the target alone. Each step trains every chain that has one source more, at any
    place, and goes on with the cheapest; it stops where none is cheaper than before.
    """
    return beam(problem, candidates, budget, seed=seed, width=1)


def beam(
    problem: Problem,
    candidates: SourceCandidates,
    budget: SearchBudget,
    *,
    seed: int = 0,
    width: int = WIDTH,
) -> Curriculum:
    """Return the cheapest chain of a beam search: as greedy, from the cheapest chains of a step."""
    costs = ChainCosts(problem, candidates, budget, seed)
    names = [source.name for source in candidates]
    kept: list[Chain] = [()]
    try:
        before = costs.of(())
        while grown := list(
            dict.fromkeys(longer for chain in kept for longer in _longer(chain, names))
        ):
            kept = sorted(grown, key=costs.of)[:width]  # stable: of equal costs the first
            if costs.of(kept[0]) >= before:
                break
            before = costs.of(kept[0])
    except BudgetSpent:
        pass
    return costs.plan


def _longer(chain: Chain, names: Sequence[str]) -> Iterator[Chain]:
    """Yield the chains with one source more, at any place, the first place first."""
    for name in names:
        if name not in chain:
            for place in range(len(chain) + 1):
                yield (*chain[:place], name, *chain[place:])


def hts_cr(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the best chain of Heuristic Task Sequencing for Cumulative Return (HTS-CR).

    Foglino, Coletto Christakou, Luna Gutierrez, Leonetti 2019: Curriculum learning for cumulative
    return maximization (IJCAI). First all ordered pairs of sources are evaluated and ranked. A
    source is a good head, or tail, if the ranks of the pairs that begin, or end, with it have a low
    sum. Then the best heads and tails are admitted in turns, one more at a time; with each, all
    chains of three sources and more are evaluated that begin with an admitted head, end with an
    admitted tail, and have others of them between.

    The order is that of the authors' program (github.com/francescofoglino/Curriculum-Learning). Two
    things differ: the paper maximises the return while the agent learns, here a chain is better if
    its target is learnt in fewer steps; and the paper's values are linear in features.
    """
    costs = ChainCosts(problem, candidates, budget, seed)
    names = [source.name for source in candidates]
    try:
        pairs = sorted(permutations(names, 2), key=costs.of)  # evaluated in this order; stable
        heads, tails = (_ranked(names, [pair[end] for pair in pairs]) for end in (0, 1))
        for chain in _extended(names, heads, tails):
            costs.of(chain)
    except BudgetSpent:
        pass
    return costs.plan


def _ranked(names: Sequence[str], ends: Sequence[str]) -> list[str]:
    """Return names by the sum of their ranks among the ends of pairs, the best pair first."""
    scores = dict.fromkeys(names, 0)
    for rank, name in enumerate(ends, 1):
        scores[name] += rank
    return sorted(names, key=lambda name: scores[name])


def _extended(names: Sequence[str], heads: Sequence[str], tails: Sequence[str]) -> Iterator[Chain]:
    """Yield chains of three sources and more, head and tail admitted in turns; some repeatedly."""
    for turn in range(1, 2 * len(names) - 1):
        first, last = heads[: 1 + (turn + 1) // 2], tails[: 1 + turn // 2]
        for length in range(3, len(names) + 1):
            for head in first:
                for tail in last:
                    if head != tail:
                        admitted = {*first, *last} - {head, tail}
                        between = [name for name in names if name in admitted]
                        for body in permutations(between, length - 2):
                            yield (head, *body, tail)


# -- graphs by transfer potential ----------------------------------------------------------------


TransferPotential = Callable[
    [SourceCandidate, SourceCandidate | None, Sequence[SourceCandidate]], float
]
"""Of a source for another one (or for the target: None), given those that lead there already."""


def svetlik(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the curriculum graph of Svetlik et al.

    Svetlik, Leonetti, Sinapov, Shah, Walker, Stone 2017: Automatic curriculum graph generation for
    reinforcement learning agents (AAAI). The graph is that of :func:`source_graph`, by the classes
    of objects and the transfer potential ``applicable / (1 + |S_t| - |S_s|)``: applicable are the
    states of the task in which values of the source can be read. Sources enter as in the paper: by
    potential-based advice, the sum over them of the mean of their values.

    What differs: a source's values apply where its mappings say so, instead of where its objects
    lie in the same places around the agent. Where sources read each other, their values start Q.
    """

    def potential(
        source: SourceCandidate, task: SourceCandidate | None, _: Sequence[SourceCandidate]
    ) -> float:
        states = int((problem.task if task is None else task.task).states.size)
        larger = states - int(source.task.states.size)
        return 0.0 if larger < 0 else applicable_states(problem.task, source, task) / (1 + larger)

    def classes(source: SourceCandidate) -> frozenset[Any]:
        return frozenset(kind for kind, _ in objects_of(source.task, problem.task))

    kept, edges = source_graph(candidates.candidates, potential, classes, SVETLIK_THRESHOLD)
    return curriculum_of(problem, kept, edges, "total", "look-ahead")


def object_oriented(
    problem: Problem, candidates: SourceCandidates, budget: SearchBudget, *, seed: int = 0
) -> Curriculum:
    """Return the object-oriented curriculum of Silva and Costa.

    Silva, Costa 2018: Object-oriented curriculum generation for reinforcement learning (AAMAS).
    Source tasks are drawn at random: a number of objects of each class, up to that of the target,
    and a size. Of those drawn a graph is made by the number of objects of each class and the
    transfer potential ``sim(s, t) / (sim_max |S_s| (n_s + 1) / (|S_t| (n_t + 1)))``, n the number
    of objects. sim is the sum over classes of the share of objects that both have, and the share of
    the states of t that s has; sim_max is the largest similarity of s to a task that was taken
    before, for the same task.

    This follows the authors' program (github.com/f-leno/Curriculum_HFO). What differs: the program
    places the objects that it draws in a new task; here the candidate with the nearest number of
    objects, then of states, is taken. Every object counts, where the program leaves out agent and
    treasure. States in common are those that the mapping of the source maps; and values pass
    through it, their mean as the start of Q, where the paper averages over all mappings between
    objects of the same class.
    """
    tasks: dict[str | None, Any] = {source.name: source.task for source in candidates}
    tasks[None] = problem.task
    has = {name: objects_of(task, problem.task) for name, task in tasks.items()}
    drawn = _drawn(candidates.candidates, has, np.random.default_rng(seed))

    def similarity(source: SourceCandidate, task: SourceCandidate | None) -> float:
        objects, others = has[source.name], has[None if task is None else task.name]
        count, other, both = (
            Counter(kind for kind, _ in some) for some in (objects, others, objects & others)
        )
        states = int((problem.task if task is None else task.task).states.size)
        # In an order that no hash decides, as sums depend on it.
        alike = sum(both[kind] / max(count[kind], other[kind]) for kind in sorted(count))
        return alike + applicable_states(problem.task, source, task) / states

    def potential(
        source: SourceCandidate, task: SourceCandidate | None, others: Sequence[SourceCandidate]
    ) -> float:
        name = None if task is None else task.name
        closest = max((similarity(source, other) for other in others), default=0.0)
        small = source.task.states.size * (len(has[source.name]) + 1)
        large = tasks[name].states.size * (len(has[name]) + 1)
        return similarity(source, task) * float(large / ((closest or 1.0) * small))

    def counts(source: SourceCandidate) -> frozenset[Any]:
        numbers = Counter(kind for kind, _ in has[source.name])
        return frozenset((kind, i) for kind, n in numbers.items() for i in range(n))

    return curriculum_of(problem, *source_graph(drawn, potential, counts, OBJECT_THRESHOLD))


def _drawn(
    candidates: Sequence[SourceCandidate], has: dict[str | None, Objects], rng: np.random.Generator
) -> list[SourceCandidate]:
    """Return the candidates nearest to random numbers of objects and of states, each once."""
    counts = {name: Counter(kind for kind, _ in objects) for name, objects in has.items()}
    target = counts[None]
    classes = [kind for kind in sorted(target) if len({n[kind] for n in counts.values()}) > 1]
    rarest = min(classes, key=lambda kind: target[kind], default=None)
    sizes = sorted({source.task.states.size for source in candidates})
    drawn: dict[str, SourceCandidate] = {}
    for _ in range(REPETITIONS):
        for least in range(1 + (0 if rarest is None else target[rarest])):
            wanted = {
                kind: int(rng.integers(least if kind == rarest else 0, target[kind] + 1))
                for kind in classes
            }
            size = int(rng.choice(sizes))

            def distance(
                source: SourceCandidate, wanted: dict[str, int] = wanted, size: int = size
            ) -> tuple[int, int]:
                apart = sum(abs(counts[source.name][kind] - n) for kind, n in wanted.items())
                return apart, abs(source.task.states.size - size)

            nearest = min(candidates, key=distance)
            drawn[nearest.name] = nearest
    return list(drawn.values())


def source_graph(
    candidates: Sequence[SourceCandidate],
    potential: TransferPotential,
    descriptor: Callable[[SourceCandidate], frozenset[Any]],
    threshold: float,
) -> tuple[list[SourceCandidate], list[Edge]]:
    """Return the sources and edges of a curriculum graph.

    Candidates whose transfer potential for the target is above the threshold are grouped by their
    descriptors, and sorted by it within a group. Each is led to by the best one after it in its
    group, and by the best one of each group whose descriptor is a proper subset, where their
    potential is above the threshold. What leads to no other source leads to the target.
    """
    kept, values = list[SourceCandidate](), dict[str, float]()
    for source in candidates:
        value = potential(source, None, kept)
        if value > threshold:
            kept.append(source)
            values[source.name] = value
    groups: dict[frozenset[Any], list[SourceCandidate]] = {}
    for source in sorted(kept, key=lambda source: -values[source.name]):  # stable
        groups.setdefault(descriptor(source), []).append(source)
    leading: dict[str, list[SourceCandidate]] = {source.name: [] for source in kept}

    def link(after: SourceCandidate, among: Sequence[SourceCandidate]) -> None:
        ranked = [(potential(before, after, leading[after.name]), before) for before in among]
        best = max(ranked, key=lambda pair: pair[0], default=None)
        if best is not None and best[0] > threshold:
            leading[after.name].append(best[1])

    for group in groups.values():
        for place, source in enumerate(group):
            link(source, group[place + 1 :])
    for has, group in groups.items():
        for simpler, others in groups.items():
            if simpler < has:
                for source in group:
                    link(source, others)
    edges = [(before.name, after) for after, sources in leading.items() for before in sources]
    leads = {before for before, _ in edges}
    return kept, [*edges, *((one.name, TARGET) for one in kept if one.name not in leads)]


def applicable_states(target: Any, before: SourceCandidate, after: SourceCandidate | None) -> int:
    """Return how many states of a task read a source's values: some pair of theirs is mapped.

    Those of another source, or of the target itself; 0 where it cannot read the source.
    """
    try:
        mappings = before.mappings if after is None else mappings_between(target, after, before)
    except CurricleError:
        return 0
    return int(np.any([(mapping.index >= 0).any(axis=1) for mapping in mappings], axis=0).sum())


def objects_of(task: Any, target: Any) -> Objects:
    """Return the objects of a task, each its class and what tells it from others of the class.

    Every character of a map is a class of objects in its cells, but for walls, the start and the
    most frequent of the others on the target's map, which is the ground. Components of the states
    are objects too: the second predator of a pursuit is the second object of the class
    ``predator``.

    Examples
    --------
    >>> from curricle import GridWorld, Pursuit
    >>> maze, hunt = GridWorld(["S.P", "..T"]), Pursuit(size=3, predators=2)
    >>> sorted(objects_of(maze, maze))
    [('P', (0, 2)), ('T', (1, 2)), ('column', 1), ('row', 1)]
    >>> sorted(objects_of(hunt, hunt))
    [('predator', 1), ('predator', 2), ('prey', 1)]
    """
    counts = Counter(cell for line in _map(target) for cell in line if cell not in NO_OBJECTS)
    ground = counts.most_common(1)[0][0] if counts else ""
    row, column = getattr(task, "origin", (0, 0))
    objects: set[tuple[str, Hashable]] = {
        (character, (row + i, column + j))
        for i, line in enumerate(_map(task))
        for j, character in enumerate(line)
        if character not in NO_OBJECTS and character != ground
    }
    kinds = Counter[str]()
    for component in task.states.components:
        kind = NUMBERED.sub("", component.name) or component.name
        kinds[kind] += 1
        objects.add((kind, kinds[kind]))
    return frozenset(objects)


def _map(task: Any) -> tuple[str, ...]:
    lines = getattr(task, "map", ())
    return (
        lines if isinstance(lines, tuple) and all(isinstance(line, str) for line in lines) else ()
    )


DESIGNERS: dict[str, Callable[..., Curriculum]] = {
    "none": no_curriculum,
    "random": random_chain,
    "fixed_recipe": fixed_recipe,
    "growing_chain": growing_chain,
    "svetlik": svetlik,
    "object_oriented": object_oriented,
    "greedy_forward": greedy_forward,
    "beam": beam,
    "hts_cr": hts_cr,
}
"""By name, in the order of the tables."""
