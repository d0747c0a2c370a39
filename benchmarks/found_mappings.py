"""Mappings that are found, beside those made by hand: how often right, how fast, what they gain.

    python -m benchmarks.found_mappings renumbered nameless refusals lax
    python -m benchmarks.found_mappings auto approximate [--seeds 20] [--only maze]
    python -m benchmarks.found_mappings families --split verification --seeds 10
    python -m benchmarks.found_mappings searches

`renumbered`: states and actions numbered anew at random, no components. `nameless`: components
shuffled, their values and moves numbered anew in both tasks. `refusals`: sources that have nothing
to do with the target. `lax`: how long lax bisimulation of random tasks takes. `auto`: gains over
scratch of a mapping that is found, as a share of those by hand, all steps charged. `approximate`:
the same for tasks that do not correspond exactly: a maze and its crop, renumbered, and tasks whose
components have unequal numbers of values, nameless. `families`: pairs of the benchmark, or made
after it, beside their own mappings. `searches`: which search makes the first mapping of each two
tasks that the benchmark's pairs or the other parts have. DoorKey needs MiniGrid.
"""

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

import curricle as cr
from benchmarks.family_mappings import families
from benchmarks.pairs import pairs
from benchmarks.unseen_pairs import unseen
from curricle.errors import MappingError
from curricle.paper.mazes import maze
from curricle.tasks.mdp import same_task, tables
from curricle.transfer import (
    StateActionMapping,
    TaskPair,
    auto_mapping,
    family_mappings,
    find_mappings,
)
from curricle.transfer.bisimulation import by_lax_bisimulation, model_for_refinement, refined
from curricle.transfer.search import SEARCHES, clears_bar
from examples import cliff_walking, taxi
from tests.renumbering import nameless, renumbered
from tests.tasks import random_mdp

SIDE = 5
"""Of the paper's maze's corner."""
NAMELESS_PAIRS = (
    "mazes/2, treasure",
    "chain/30 from 8",
    "chain/30 from 15",
    "deep-sea/10 from 5, one for four",
    "frozen-lake/fewer slips, a dry crop",
    "keys/the last room",
)
"""Of `benchmarks.pairs`: components of unequal numbers of values, and a mapping that gains."""


# -- exact correspondences -----------------------------------------------------------------------


def rotated_and_mirrored(task: cr.GridWorld) -> cr.GridWorld:
    """Return the paper's maze turned by a quarter and mirrored."""
    lines = ["".join(column) for column in zip(*task.map, strict=True)]
    return cr.GridWorld([line[::-1] for line in lines], rewards=task.rewards)


def originals() -> Iterator[tuple[str, Any]]:
    """Yield the tasks that are renumbered."""
    yield "the paper's maze", maze(-5).mdp
    yield "the maze rotated and mirrored", rotated_and_mirrored(maze(-5)).mdp
    yield "pursuit 3x3", cr.Pursuit(3, 2).mdp
    yield "key-lock-pit 8x8", cr.tasks.KeyLockPit().mdp
    if find_spec("minigrid") is None:
        print("  DoorKey-6x6 is left out: MiniGrid is not installed")
        return
    import_module("minigrid")  # which registers its levels
    yield "DoorKey-6x6", cr.tabulate("MiniGrid-DoorKey-6x6-v0", discount=0.99).mdp


def renumbered_tasks(seeds: int) -> None:
    """Print how many pairs of renumbered tasks are found again."""
    print("\nrenumbered: pairs found again, up to symmetries")
    for name, task in originals():
        shares, seconds, how = [], [], ""
        (own,) = refined([model_for_refinement(task)])
        for seed in range(seeds):
            copy, new, actions = renumbered(task, np.random.default_rng(seed))
            began = time.perf_counter()
            best = find_mappings(copy, task)[0]
            seconds.append(time.perf_counter() - began)
            truth = np.argsort(new)[:, None] * task.actions.size + actions
            live, index = ~copy.terminal, best.mapping.index
            right = own.pairs.ravel()[truth[live]] == own.pairs.ravel()[index[live]]
            shares.append(float((right & (index[live] >= 0)).mean()))
            how = best.how
        n_blocks = len(np.unique(own.states[~task.terminal]))
        print(
            f"  {name}: {task.states.size:,} states, {n_blocks:,} not alike: {min(shares):.1%} at "
            f"least, {max(seconds):.1f} s at most; {how.split(':')[0]}",
            flush=True,
        )


def nameless_tasks() -> None:
    """Print what is found between tasks whose components have no names."""
    print("\nnameless")
    room, rng = cr.tasks.KeyLockPit(), np.random.default_rng(0)
    for name, other in (("8x8", room), ("6x6", cr.tasks.KeyLockPit.room(6))):
        (target, _, _), (source, _, _) = nameless(room.mdp, rng), nameless(other.mdp, rng)
        began = time.perf_counter()
        candidates = find_mappings(target, source)
        seconds = time.perf_counter() - began
        print(f"  key-lock-pit 8x8 from {name}: {seconds:.1f} s; {candidates[0]}", flush=True)


def lax() -> None:
    """Print how long the nearest pairs of two random tasks take, at two sizes, beside the bound."""
    print("\nlax: random tasks with 5 actions of 3 outcomes each")
    for sizes in ((140, 70), (670, 335)):  # a quarter of them ends
        pair = TaskPair(*(random_mdp(n, n_states=n, n_actions=5) for n in sizes))
        live = [int((~mdp.terminal).sum()) for mdp in (pair.target_mdp, pair.source_mdp)]
        began = time.perf_counter()
        found = next(iter(by_lax_bisimulation(pair)))
        seconds = time.perf_counter() - began
        words = f"Q* proven within {found.bound:.3g}"
        print(f"  {live[0]} x {live[1]} states: {seconds:.1f} s; {words}", flush=True)


# -- gains ---------------------------------------------------------------------------------------


def gains(
    name: str, target: Any, source: Any, by_hand: list[cr.Transfer], made: Callable, seeds: int
) -> None:
    """Print the gain of the mapping that is found as a share of that by hand, all steps charged."""
    began = time.perf_counter()
    arms = {"by hand": made(by_hand)}
    try:
        best = auto_mapping(target, source)
        arms["auto"] = made([cr.Transfer("source", "target", best.mapping)])
        words = str(best)
    except MappingError as error:
        words = f"refused: {error}"
    seconds = time.perf_counter() - began
    print(f"  {name}: searched {seconds:.1f} s; {words}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = cr.compare(arms, seeds=seeds, opponents=())
    each = {arm: found.arms[arm].strong_gain(found.scratch) for arm in arms}
    mean = {arm: float(gain.mean()) for arm, gain in each.items()}
    for arm in arms:
        time_to = found.times(arm).median().estimate
        error = each[arm].std(ddof=1) / np.sqrt(seeds)
        gain = f"{mean[arm]:.4g} +- {error:.2g}"
        print(f"    {arm}: gain {gain}, learnt after {time_to:,.0f} steps (median)")
    scratch = found.times("scratch").median().estimate
    share = mean.get("auto", np.nan) / mean["by hand"]
    print(f"    scratch: learnt after {scratch:,.0f}; auto / by hand: {share:.0%}", flush=True)


def of(target: Any, source: Any, *, budget: Any = None, **settings: Any) -> Callable:
    """Return what makes the curriculum of some transfers, its source's steps being exact."""
    if budget is not None and isinstance(budget.get("source"), int):
        budget = {**budget, "source": cr.StoppingRule(budget["source"])}
    settings["budget"] = budget
    return lambda transfers: cr.Curriculum(
        {"source": source, "target": target}, transfers, **settings
    )


def edge(mapping: Any, **settings: Any) -> cr.Transfer:
    return cr.Transfer("source", "target", mapping, **settings)


def maze_settings() -> dict[str, Any]:
    return {
        "learner": cr.QLearning(learning_rate=0.1, epsilon=0.1),
        "budget": {"source": cr.Episodes(250), "target": 60_000},
        "eval_freq": {"source": 1000, "target": 100},
        "evaluation": cr.GreedyEvaluation(discounted=False),
    }


def auto_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    """Yield pairs of tasks with mappings made by hand, and how they are learnt."""
    arena = maze(-5)
    corner = arena.crop(rows=(0, SIDE), columns=(10 - SIDE, 10), start="uniform")
    yield (
        "maze, corner of 5x5", arena, corner, [edge(cr.same_position(arena, corner))],
        of(arena, corner, **maze_settings()),
    )  # fmt: skip
    for size, budget in ((4, (40_000, 300_000)), (5, (80_000, 800_000))):
        hunt, chase = cr.Pursuit(size, 2), cr.Pursuit(size, 1)
        yield (
            f"pursuit {size}x{size}", hunt, chase,
            [edge(cr.project(hunt, chase, predator=name)) for name in hunt.predator_names],
            of(hunt, chase, aggregate=cr.minimum,
               budget=dict(zip(("source", "target"), budget, strict=True))),
        )  # fmt: skip
    yield from taxi_cases()
    yield from cliff_cases()


def taxi_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    import gymnasium

    whole = cr.from_gymnasium("Taxi-v4", discount=taxi.DISCOUNT)
    drive = taxi.errand(gymnasium.make("Taxi-v4").unwrapped.P)
    made = of(
        whole, drive, aggregate=cr.total, learner={"source": taxi.THOROUGH, "target": taxi.LEARNER},
        budget={"source": 8_000, "target": 120_000},
        evaluation=cr.GreedyEvaluation(discounted=False),
    )  # fmt: skip
    yield "taxi, errand", whole, drive, [edge(taxi.errand_mapping(whole, drive))], made
    parts = [
        edge(taxi.errand_mapping(whole, drive, riding=False), shift=-taxi.RIDE),
        edge(taxi.errand_mapping(whole, drive, waiting=False)),
    ]
    yield "taxi, errand in two parts, one shifted", whole, drive, parts, made


def cliff_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    for pair in pairs(family="cliffs"):
        if pair.name == "cliffs/half the cliff":
            settings = {
                "budget": {"source": 500, "target": pair.target_budget},
                "eval_freq": {"target": pair.eval_freq},
                "evaluation": cr.GreedyEvaluation(method="exact"),
            }
            by_hand = [edge(mapping) for mapping in pair.mappings]
            made = of(pair.target, pair.source, **settings)
            yield "cliff, half of it, 500 steps", pair.target, pair.source, by_hand, made
    wide = cr.from_gymnasium("CliffWalking-v1", discount=0.99, time_limit=cliff_walking.LIMIT)
    narrow = cliff_walking.cliff(cliff_walking.NARROW)

    def goals_end(state: Any, action: Any) -> Any:
        return {"row": state["row"], "column": state["column"] - 8}, action

    mapping = cr.from_function(wide, narrow, goals_end, unmapped_value=-8.0)
    made = of(
        wide, narrow, learner=cr.QLearning(learning_rate=0.1, epsilon=0.1),
        budget={"source": 600, "target": 20_000},
        evaluation=cr.GreedyEvaluation(discounted=False),
    )  # fmt: skip
    yield "cliff, a narrow one at the goal's end", wide, narrow, [edge(mapping)], made


def approximate_cases() -> Iterator[tuple[str, Any, Any, list[cr.Transfer], Callable]]:
    """Yield nameless tasks that do not correspond exactly."""
    for size, smaller, *budget in (
        (8, 6, 4_000, 60_000),
        (7, 5, 4_000, 60_000),
        (12, 7, 10_000, 200_000),
    ):
        member = cr.tasks.key_lock_pit_family
        target, source = member(size=size), member(size=smaller)
        yield nameless_case(
            f"key-lock-pit {size}x{size} from {smaller}x{smaller}",
            family_mappings(target, source)[0], eval_freq={"target": 200},
            budget=dict(zip(("source", "target"), budget, strict=True)),
        )  # fmt: skip
    target, source = (cr.tasks.four_rooms_family(size=size) for size in (13, 9))
    yield nameless_case(
        "four rooms 13x13 from 9x9", family_mappings(target, source)[0],
        budget={"source": 6_000, "target": 100_000},
    )  # fmt: skip
    for pair in pairs():
        if pair.name in NAMELESS_PAIRS:
            yield nameless_case(
                pair.name, pair.mappings[0], eval_freq={"target": pair.eval_freq},
                budget={"source": pair.source_budget, "target": pair.target_budget},
            )  # fmt: skip


def nameless_case(
    name: str, by_hand: StateActionMapping, **settings: Any
) -> tuple[str, Any, Any, list[cr.Transfer], Callable]:
    """Return nameless copies of a mapping's tasks, and the mapping between them."""
    rng, n_moves = np.random.default_rng(0), by_hand.source.actions.size
    (target, new, moved), (source, there, moves) = (
        nameless(tables(task), rng) for task in (by_hand.target, by_hand.source)
    )
    state, action = np.divmod(np.maximum(by_hand.index, 0), n_moves)
    image = np.where(by_hand.index >= 0, there[state] * n_moves + moves[action], by_hand.index)
    index = np.empty_like(image)
    index[np.ix_(new, moved)] = image
    mapping = StateActionMapping(target, source, index, by_hand.unmapped_value)
    return f"{name}, nameless", target, source, [edge(mapping)], of(target, source, **settings)


# -- which search is first ------------------------------------------------------------------------


def pair_cases() -> Iterator[tuple[str, Any, Any]]:
    """Yield two tasks of `benchmarks.pairs` once, whatever their mappings and budgets."""
    known: list[tuple[Any, Any]] = []
    for pair in pairs():
        tasks = pair.target, pair.source
        if not any(all(map(same_task, tasks, others)) for others in known):
            known.append(tasks)
            yield pair.name, *tasks


def further_cases() -> Iterator[tuple[str, Any, Any]]:
    """Yield the tasks of the other parts, and two of docs/howto/find_the_mapping.md."""
    yield "pursuit 3x3", cr.Pursuit(3, 2), cr.Pursuit(3, 1)
    yield "key-lock-pit 8 from 6", *map(cr.tasks.KeyLockPit.room, (8, 6))
    for name, task in originals():
        yield f"{name}, renumbered", renumbered(task, np.random.default_rng(0))[0], task
    for size in (3, 4):
        rng, tasks = np.random.default_rng(0), (cr.Pursuit(size, 2), cr.Pursuit(size, 1))
        yield f"pursuit {size}x{size}, nameless", *(nameless(task.mdp, rng)[0] for task in tasks)
    room, rng = cr.tasks.KeyLockPit(), np.random.default_rng(0)
    yield "key-lock-pit 8 from 8, nameless", *(nameless(room.mdp, rng)[0] for _ in range(2))
    for name, target, source, *_ in [*auto_cases(), *approximate_cases()]:
        yield name, target, source
    for pair in unseen():
        yield pair.name, pair.target, pair.source


def first_searches() -> None:
    """Print the search that makes the first mapping of each two tasks, and how often each does."""
    for words, cases in (("benchmarks.pairs", pair_cases()), ("further cases", further_cases())):
        print(f"\n{words}: candidates by search, first mapping, its indices' hash; if unseen")
        first, all_cases = Counter[str](), 0
        for name, target, source in cases:
            made = dict[str, str]()
            candidates = find_mappings(
                target, source, searches=[recorded(search, made) for search in SEARCHES], keep=1000
            )
            counts = Counter(made[candidate.how] for candidate in candidates)
            all_cases += 1
            print(f"  {name}: {dict(counts)}", flush=True)
            if candidates:
                best = candidates[0]
                first[made[best.how]] += clears_bar(best.scores)
                taken = "taken" if clears_bar(best.scores) else "refused"
                digest = sha256(best.mapping.index.tobytes()).hexdigest()[:12]
                print(f"    {made[best.how]}, {taken}, {digest}: {best}", flush=True)
        print(f"  first and taken, of {all_cases}: {dict(first)}", flush=True)


def recorded(search: Any, made: dict[str, str]) -> Callable:
    """Return a search that writes down which mappings it made."""

    def by(tasks: TaskPair) -> Iterator[Any]:
        for proposal in search(tasks):
            made[proposal.how] = search.__name__
            yield proposal

    by.__name__ = search.__name__
    return by


# -- refusals ------------------------------------------------------------------------------------


def refusals(seeds: int) -> None:
    """Print what is said of sources that have nothing to do with the target, and what they cost."""
    print("\nrefusals")
    arena = maze(-5)
    mirrored = [line[::-1].replace("T", ".") for line in arena.map]
    for row, column in ((9, 5), (5, 0), (9, 9), (3, 4)):
        lines = list(mirrored)
        lines[row] = lines[row][:column] + "T" + lines[row][column + 1 :]
        other = cr.GridWorld(lines, rewards=arena.rewards, start="uniform")
        settings = maze_settings() | {"budget": {"target": 60_000}, "eval_freq": {"target": 500}}
        guarded = cr.QInitialisation(portfolio=cr.Portfolio())
        made = of(arena, other, shaping=guarded, **settings)
        tell(f"mirrored maze, goal at {row}, {column}", arena, other, made, seeds)
    for target in (cr.Pursuit(3, 1), cr.Pursuit(4, 1), cr.Pursuit(3, 2), cr.Pursuit(4, 2)):
        tell(f"RiverSwim to {target.size}x{target.size}, {target.predators} predators", target,
             cr.tasks.RiverSwim(), of(target, cr.tasks.RiverSwim()), seeds)  # fmt: skip


def tell(name: str, target: Any, source: Any, made: Callable, seeds: int) -> None:
    """Print why a mapping is refused; of others, the steps that it loses in a portfolio."""
    try:
        best = auto_mapping(target, source)
    except MappingError as error:
        print(f"  {name}: {error}", flush=True)
        return
    found = cr.compare({"auto": made([edge(best.mapping)])}, seeds=seeds, opponents=())
    auto, scratch = (found.times(arm).median().estimate for arm in ("auto", "scratch"))
    lost, steps = (auto - scratch) / found.total, found.arms["auto"].curve.source_steps.mean()
    print(f"  {name}: taken, {best}")
    print(
        f"    learnt after {auto:,.0f} steps, from scratch {scratch:,.0f}: lost {lost:.1%} of "
        f"{found.total:,}; the source took {steps:,.0f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    known = (
        "renumbered",
        "nameless",
        "auto",
        "approximate",
        "refusals",
        "lax",
        "families",
        "searches",
    )
    parser.add_argument("parts", nargs="+", choices=known)
    parser.add_argument("--seeds", type=int, default=20, help="of learning")
    parser.add_argument("--copies", type=int, default=5, help="random renumberings of each task")
    parser.add_argument("--only", default="", help="cases whose name begins so")
    parser.add_argument(
        "--split", choices=("development", "verification", "unseen"), default="verification",
        help="of families",
    )  # fmt: skip
    options = parser.parse_args()
    if "renumbered" in options.parts:
        renumbered_tasks(options.copies)
    if "nameless" in options.parts:
        nameless_tasks()
    if "refusals" in options.parts:
        refusals(options.seeds)
    if "lax" in options.parts:
        lax()
    if "searches" in options.parts:
        first_searches()
    if "families" in options.parts:
        families(options.split, options.seeds, options.only)
    for part, cases in (("auto", auto_cases), ("approximate", approximate_cases)):
        if part in options.parts:
            print(f"\n{part}: gain over scratch, all steps charged, {options.seeds} seeds")
            for name, *case in cases():
                if name.startswith(options.only):
                    gains(name, *case, options.seeds)


if __name__ == "__main__":
    main()
