"""Domains: maps on which designs are made and tuned, and others on which they are judged.

A training is about three times as long as learning the target alone takes at its best learning
rate: `python -m benchmarks.referee lengths` shows it. In pursuit, learning alone arrives at no
length that could be played here.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from itertools import count, islice
from typing import Any

import numpy as np

import curricle as cr
from benchmarks.referee.problem import Problem
from curricle.paper.mazes import maze
from curricle.tasks import (
    block_dude_family,
    four_rooms_family,
    key_lock_pit_family,
    maze_family,
    pursuit_family,
)
from curricle.tasks.family import FamilyMember

DEVELOPMENT_SEEDS, PAPER_SEEDS = 10_000, 20_000
"""The first seed of the random mazes that designs are made on, for each of two domains."""
MAZE_FRACTION = 0.975
LONGEST, LENGTH_RATE, LENGTH_SEEDS = 500_000, 0.9, range(3_000_000, 3_000_005)
"""The steps, the learning rate and the seeds by which the length of a maze is measured."""
LEAST_OPTIMUM, LEAST_WAY = -300.0, 2
"""Of a random maze that is kept: its optimal return, and its way in units of the side."""
MAPS = 30
"""Random mazes that are judged."""


@dataclass(frozen=True)
class Case:
    """A target, and the steps of a training on it."""

    name: str
    target: Any  # a task or a member of a family
    steps: int


@dataclass(frozen=True)
class Domain:
    """Targets of one kind.

    Attributes
    ----------
    name : str
    development : tuple of Case
        On which recipes are searched and learning rates tuned.
    held_out : tuple of Case
        On which designs are judged.
    fraction : float
        Of the way from the random policy's return to the optimum that counts as learnt.
    evaluation : GreedyEvaluation or None
        Of greedy policies; exact by default.
    checkpoints : int
        Evaluations in a training.
    """

    name: str
    development: tuple[Case, ...]
    held_out: tuple[Case, ...]
    fraction: float = 0.9
    evaluation: cr.GreedyEvaluation | None = None
    checkpoints: int = 200

    def problem(self, case: Case, learning_rate: float) -> Problem:
        """Return a case as the problem of a designer."""
        return Problem(
            case.target,
            steps=case.steps,
            learner=cr.QLearning(learning_rate=learning_rate),
            fraction=self.fraction,
            evaluation=self.evaluation or cr.GreedyEvaluation(method="exact"),
            eval_freq=max(1, case.steps // self.checkpoints),
            name=case.name,
        )

    def part(self, development: int, held_out: int) -> "Domain":
        """Return the domain with so many of its cases, for a quick trial."""
        own, judged = self.development[:development], self.held_out[:held_out]
        return Domain(self.name, own, judged, self.fraction, self.evaluation, self.checkpoints)


# -- the domains ---------------------------------------------------------------------------------


def random_mazes(size: int, first: int) -> Iterator[FamilyMember]:
    """Yield random mazes of a size by seed, those that are worth walking and not too short.

    The way is that of an optimal policy: the fewest moves, through fires, are hardly ever twice
    the side.

    Examples
    --------
    >>> next(random_mazes(10, 0))["size"]
    10
    """
    for seed in count(first):
        member = maze_family(
            size=size, walls=0.0, pits=0.22, fires=0.05, step=-5.0, time_limit=20 * size, seed=seed
        )
        solution = cr.solve(member.task)
        if solution.start_value > LEAST_OPTIMUM and _way(member.task, solution) >= (
            LEAST_WAY * size
        ):
            yield member


def _way(task: Any, solution: Any) -> int:
    """Return the moves of an optimal policy from the start of a maze to an end."""
    mdp, state, moves = task.mdp, int(task.mdp.start_states[0]), 0
    while not mdp.terminal[state] and moves < mdp.time_limit:
        row = mdp.outcome_row[state, int(np.argmax(solution.policy[state]))]
        state, moves = int(mdp.next_state[row].ravel()[0]), moves + 1
    return moves


def _mazes(size: int, first: int, maps: int) -> tuple[Case, ...]:
    """Return random mazes, each with a length of its own: they differ by a factor of ten."""
    return tuple(
        Case(f"{size}x{size}, seed {one['seed']}", one, maze_length(one.task))
        for one in islice(random_mazes(size, first), maps)
    )


def maze_length(task: Any) -> int:
    """Return three times what learning a maze alone takes, in whole thousands.

    At the largest learning rate, with seeds that are used for nothing else.
    """
    problem = Problem(
        task,
        steps=LONGEST,
        learner=cr.QLearning(learning_rate=LENGTH_RATE),
        fraction=MAZE_FRACTION,
        eval_freq=LONGEST // 1000,
    )
    found, _ = problem.train(problem.scratch, LENGTH_SEEDS)
    return int(1000 * np.ceil(3 * found.steps.mean() / 1000))


def _members(family: Any, name: str, lengths: dict[Any, int], **given: Any) -> tuple[Case, ...]:
    return tuple(
        Case(f"{name} {value}", family(**{name: value}, **given), steps)
        for value, steps in lengths.items()
    )


def paper_maze() -> Domain:
    """Return the paper's maze; designs are made on random mazes of its size."""
    own = (Case("the paper's maze", maze(-5.0), maze_length(maze(-5.0))),)
    return Domain("paper maze", _mazes(10, PAPER_SEEDS, 6), own, MAZE_FRACTION)


def thirty_mazes() -> Domain:
    """Return random mazes; designs are made on smaller ones."""
    small = _mazes(10, DEVELOPMENT_SEEDS, 6)
    return Domain("random mazes", small, _mazes(15, 0, MAPS), MAZE_FRACTION)


def pursuit() -> Domain:
    """Return hunts of two predators, both of which must touch the prey.

    Greedy policies are followed, as exact evaluations of 25 joint actions take too long. Their
    steps have no price, as those of exact evaluations have none.
    """
    rollouts = cr.GreedyEvaluation(method="rollouts", episodes=50)
    small = _members(pursuit_family, "size", {3: 60_000}, predators=2)
    large = _members(pursuit_family, "size", {4: 150_000, 5: 400_000}, predators=2)
    return Domain("pursuit", small, large, evaluation=rollouts, checkpoints=100)


def key_lock_pit() -> Domain:
    """Return rooms with a key, a lock and pits."""
    small = _members(key_lock_pit_family, "size", {6: 6_000, 7: 9_000})
    large = _members(key_lock_pit_family, "size", {8: 15_000, 10: 27_000, 12: 48_000})
    return Domain("key-lock-pit", small, large)


def block_dude() -> Domain:
    """Return Block Dude's first level, and parts of it."""
    small = _members(block_dude_family, "columns", {10: 20_000, 12: 24_000})
    large = _members(block_dude_family, "columns", {16: 42_000, 20: 78_000, None: 140_000})
    return Domain("Block Dude", small, large)


def four_rooms() -> Domain:
    """Return four rooms, in which moves slip.

    The larger of the two maps of development cannot be learnt at learning rates that chance makes
    too large for larger ones.
    """
    small = _members(four_rooms_family, "size", {11: 75_000, 13: 100_000})
    large = _members(four_rooms_family, "size", {14: 150_000, 15: 220_000})
    return Domain("four rooms", small, large, checkpoints=60)


def door_key() -> Domain:
    """Return MiniGrid's DoorKey, as tables; greedy policies are followed, as in pursuit."""
    import minigrid  # noqa: F401  # registers its environments

    def cases(size: int, seeds: range, steps: int) -> tuple[Case, ...]:
        level = f"MiniGrid-DoorKey-{size}x{size}-v0"
        return tuple(
            Case(f"{size}x{size}, seed {k}", cr.tabulate(level, discount=0.95, seeds=[k]), steps)
            for k in seeds
        )

    rollouts = cr.GreedyEvaluation(method="rollouts", episodes=10)
    small, large = cases(5, range(1, 3), 75_000), cases(6, range(3), 500_000)
    return Domain("DoorKey", small, large, evaluation=rollouts)


MAKERS: dict[str, Callable[[], Domain]] = {
    "paper maze": paper_maze,
    "random mazes": thirty_mazes,
    "pursuit": pursuit,
    "key-lock-pit": key_lock_pit,
    "Block Dude": block_dude,
    "four rooms": four_rooms,
    "DoorKey": door_key,
}
"""Name -> what makes the domain."""


def domain_names() -> list[str]:
    """Return the names of the domains that can be played here."""
    return [name for name in MAKERS if not left_out(name)]


def left_out(name: str) -> str:
    """Return why a domain cannot be played here, as a sentence; empty if it can."""
    if name == "DoorKey" and find_spec("minigrid") is None:
        return "DoorKey is left out: it needs MiniGrid, the extra `minigrid`"
    return ""


@cache
def domain(name: str) -> Domain:
    """Return a domain by name; the same object at every call."""
    return MAKERS[name]()
