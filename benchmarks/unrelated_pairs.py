"""Pairs of tasks that have nothing to do with each other, and what a mapping found there gains.

    python -m benchmarks.unrelated_pairs fit --pairs 700
    python -m benchmarks.unrelated_pairs play --first 10000 --pairs 50 --seeds 20
    python -m benchmarks.unrelated_pairs hunt --seeds 20

A pair is drawn from its number: a target and a source of two kinds, two random MDPs, or two road
maps. `fit` prints how many of the sensible pairs of the development families and how many unrelated
pairs are taken, by the largest dynamics error that is allowed; and the same of the verification
families, without a choice. `play` takes the best mapping of each pair whatever the bar says, as a
user does who accepts it, and prints the verdict beside all controls that know nothing. Pairs from
number 10,000 on are kept for that: no constant was fitted on them. `hunt` plays the hunt, with a
mapping by hand too.
"""

import argparse
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any, cast

import numpy as np

import curricle as cr
from benchmarks.found_mappings import pair_cases
from benchmarks.pairs import Split, pairs
from curricle.tasks.mdp import live_pairs
from curricle.transfer import Proposal, TaskPair, find_mappings
from curricle.transfer.search import LEAST_REGAINED, MOST_UNEXPLAINED, SEARCHES, clears_bar

TARGET_STEPS, SOURCE_STEPS = 20_000, 500
LIMITS = (0.2, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Largest dynamics errors that are tried."""


def road_map(
    rng: np.random.Generator, *, prize: float = 0.0, jams: int = 2, nodes: int = 20, roads: int = 4
) -> cr.FiniteMDP:
    """Return the way through a random road map whose jams come and go; each road costs its time."""
    place = rng.random((nodes, 2))
    away = np.linalg.norm(place[:, None] - place[None], axis=2)
    near = np.argsort(away, axis=1)[:, 1 : roads + 1]
    time = 1 + 5 * np.take_along_axis(away, near, axis=1)
    slower = np.ones((jams, nodes, roads))
    slower[1:] = rng.choice([1.0, 3.0], size=(jams - 1, nodes, roads))
    goal = nodes - 1

    def outcomes(node: int, jam: int, road: int) -> list[tuple[float, int, float]]:
        to, cost = int(near[node, road]), float(time[node, road] * slower[jam, node, road])
        stays = [1.0 if jams == 1 else 0.8 if j == jam else 0.2 / (jams - 1) for j in range(jams)]
        reward = prize * (to == goal) - cost
        return [(chance, to * jams + j, reward) for j, chance in enumerate(stays)]

    return cr.FiniteMDP.from_outcomes(
        [
            [outcomes(node, jam, road) if node != goal else [] for road in range(roads)]
            for node in range(nodes)
            for jam in range(jams)
        ],
        terminal=np.repeat(np.arange(nodes) == goal, jams), start=0, discount=0.99, time_limit=200,
    )  # fmt: skip


def garnet(rng: np.random.Generator) -> cr.FiniteMDP:
    """Return a random MDP in which some states pay, or most cost."""
    states, actions, branches = int(rng.integers(15, 50)), int(rng.integers(2, 5)), 3
    transition = np.zeros((states, actions, states))
    for s in range(states):
        for a in range(actions):
            to = rng.choice(states, branches, replace=False)
            transition[s, a, to] = rng.dirichlet(np.ones(branches))
    share, high = (0.1, 10.0) if rng.random() < 0.5 else (0.6, -2.0)
    reward = np.where(rng.random(states) < share, high * rng.random(states), 0.0)
    ends = np.zeros(states, bool)
    return cr.FiniteMDP.from_dense(
        transition, reward, terminal=ends, start=0, discount=0.95, time_limit=100
    )


def grid(rng: np.random.Generator) -> cr.GridWorld:
    """Return a room of 4 to 6 cells a side with its treasure in a corner, and some pits."""
    side, pits = int(rng.integers(4, 7)), int(rng.integers(0, 4))
    cells = np.full((side, side), ".")
    for row, column in rng.integers(0, side, (pits, 2)):
        cells[row, column] = "P"
    cells[0, 0], cells[-1, -1] = "S", "T"
    costs = cr.Rewards(step=-1, treasure=float(rng.choice([0.0, 20.0, 200.0])))
    return cr.GridWorld(["".join(row) for row in cells], rewards=costs, time_limit=200)


def maps(rng: np.random.Generator) -> cr.FiniteMDP:
    """Return a road map with or without a prize at the goal."""
    return road_map(rng, prize=float(rng.choice([0.0, 20.0, 100.0])))


def queue(rng: np.random.Generator) -> Any:
    """Return a line of places whose far end pays."""
    return cr.tasks.RiverSwim(size=int(rng.integers(5, 15)))


def chase(rng: np.random.Generator) -> Any:
    """Return a pursuit of one prey."""
    return cr.Pursuit(int(rng.integers(3, 5)), 1, time_limit=100)


KINDS: tuple[Callable[[np.random.Generator], Any], ...] = (garnet, grid, maps, queue, chase)
OF_ONE_KIND = (garnet, maps)
"""Kinds of which two draws have nothing to do with each other."""


def unrelated(number: int) -> tuple[str, Any, Any]:
    """Return the kinds of a pair in words, its target and its source."""
    rng = np.random.default_rng([46, number])
    while True:
        target, source = (KINDS[i] for i in rng.integers(len(KINDS), size=2))
        if target is not source or target in OF_ONE_KIND:
            return f"{target.__name__} <- {source.__name__}", target(rng), source(rng)


def by_nearest_value(tasks: TaskPair) -> Iterator[Proposal]:
    """Yield the mapping of each pair to the source pair of the nearest Q*, which any source has."""
    readable = np.flatnonzero(live_pairs(tasks.source_mdp))
    q = tasks.target_solution.finite_action_values[..., None]
    of_source = tasks.source_solution.finite_action_values.ravel()[readable]
    yield tasks.proposal(readable[abs(q - of_source).argmin(axis=2)], "nearest value")


SEARCHED = (*SEARCHES, by_nearest_value)


# -- the largest dynamics error --------------------------------------------------------------------


def least_error(target: Any, source: Any) -> float:
    """Return the least dynamics error of the mappings that clear the rest of the bar; else inf."""
    scores = [one.scores for one in find_mappings(target, source, searches=SEARCHED, keep=1000)]
    return min(
        (
            score.dynamics_error
            for score in scores
            if score.regained_where_known >= LEAST_REGAINED
            and score.unexplained <= MOST_UNEXPLAINED
        ),
        default=np.inf,
    )


def across(split: str) -> Iterator[tuple[Any, Any]]:
    """Yield the first target of each family of a split with the first source of each other."""
    first = {}
    for pair in pairs(split=cast(Split, split)):
        first.setdefault(pair.family, pair)
    for here in first.values():
        yield from ((here.target, there.source) for there in first.values() if here is not there)


def fit(first: int, n: int) -> None:
    """Print by the largest dynamics error how many sensible and unrelated pairs are taken."""
    split_of = {pair.name: pair.split for pair in pairs() if pair.sensible}
    kept: dict[str, list[float]] = {"development": [], "verification": []}
    for name, target, source in pair_cases():
        if name in split_of:
            kept[split_of[name]].append(least_error(target, source))
    others = {split: [least_error(*tasks) for tasks in across(split)] for split in kept}
    numbers = range(first, first + n)
    others["development"] += [least_error(*unrelated(number)[1:]) for number in numbers]
    for split in kept:
        print(f"{split}: largest error: sensible and unrelated pairs taken, their shares apart")
        whole = [np.array([x for x in of[split] if np.isfinite(x)]) for of in (kept, others)]
        for limit in LIMITS:
            taken = [int((errors <= limit).sum()) for errors in whole]
            apart = taken[0] / len(whole[0]) - taken[1] / len(whole[1])
            counts = (f"{k} of {len(errors)}" for k, errors in zip(taken, whole, strict=True))
            print(f"  {limit:g}: {', '.join(counts)}, {apart:.2f}", flush=True)


# -- what a mapping that is found from there gains -------------------------------------------------


Case = tuple[str, Any, Any, int, int]  # name, target, source, and the source's and target's steps


def drawn(first: int, n: int) -> Iterator[Case]:
    """Yield unrelated pairs."""
    for number in range(first, first + n):
        name, target, source = unrelated(number)
        yield f"{number} {name}", target, source, SOURCE_STEPS, TARGET_STEPS


def play(cases: Iterable[Case], seeds: int) -> None:
    """Print what the best mapping of each pair gains, all steps charged, and the verdict."""
    answers, taken = Counter[str](), 0
    for name, target, source, source_steps, target_steps in cases:
        best = find_mappings(target, source, searches=SEARCHED, keep=1)[0]
        plan = cr.Curriculum(
            {"source": source, "target": target},
            [cr.Transfer("source", "target", best.mapping)],
            budget={"source": cr.StoppingRule(source_steps), "target": target_steps},
            eval_freq={"target": target_steps // 40},
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            controls: Any = ("placebo", "unrelated")
            compared = cr.compare(plan, seeds=seeds, controls=controls)
        contrast = compared.contrasts["transfer"]
        answers[contrast.answer] += 1
        taken += clears_bar(best.scores)
        control = compared.contrasts["transfer, unrelated"].strong_gain
        print(
            f"{name}: error {best.scores.dynamics_error:.3f}, "
            f"{'taken' if clears_bar(best.scores) else 'refused'}; gain {contrast.strong_gain}, of "
            f"an unrelated task {control.estimate:.3g}: {contrast.answer}",
            flush=True,
        )
    print(f"{taken} of {answers.total()} would be taken unseen")
    for answer, count in answers.most_common():
        print(f"  {count}: {answer}")


def hunt(seeds: int) -> None:
    """Print the verdict of the right source: a hunt of two from that of one, by hand and found."""
    both, alone = cr.Pursuit(4, 2), cr.Pursuit(4, 1)
    by_hand = [cr.project(both, alone, predator=name) for name in both.predator_names]
    arms = {
        name: cr.Curriculum(
            {"source": alone, "target": both},
            [cr.Transfer("source", "target", mapping) for mapping in mappings],
            aggregate=cr.minimum,
            budget={"source": cr.StoppingRule(40_000), "target": 300_000},
        )
        for name, mappings in (
            ("by hand", by_hand),
            ("found", [find_mappings(both, alone, searches=SEARCHED, keep=1)[0].mapping]),
        )
    }
    controls: Any = ("placebo", "unrelated")
    print(cr.compare(arms, seeds=seeds, controls=controls))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("part", choices=("fit", "play", "hunt"))
    parser.add_argument("--first", type=int, default=0, help="number of the first pair")
    parser.add_argument("--pairs", type=int, default=50, help="how many unrelated pairs are drawn")
    parser.add_argument("--seeds", type=int, default=20, help="of learning")
    options = parser.parse_args()
    if options.part == "fit":
        fit(options.first, options.pairs)
    elif options.part == "hunt":
        hunt(options.seeds)
    else:
        play(drawn(options.first, options.pairs), options.seeds)


if __name__ == "__main__":
    main()
