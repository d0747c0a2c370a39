"""The study of miniatures: ten targets, two drawn, eleven hard, four that settings are chosen on.

    python -m benchmarks.networks.miniatures [--targets ...] [--seeds N] [--workers 2] [--out DIR]

Each target's results are a study's: a stopped run goes on, and `curricle show` reads them. At the
end the tables of docs/networks.md are printed, of all targets in DIR. Areas are mean returns over
all steps, 60,000 and those of the miniatures' models, which come before the first return; gains are
over the best opponent, and p is corrected for all ten targets, or for both drawn (Holm). The steps
and seconds that miniatures take are printed by `--price`, of hard targets (hard.toml, chain.toml)
all checkpoints.

Brackets are 95 % intervals over seeds; returns are undiscounted. Actions of actor-critics are drawn
from their policy where observations hide a part of the state, DQN's are greedy.
"""

import argparse
import time
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from benchmarks.published.__main__ import markdown
from curricle import GreedyEvaluation, read_study, run_study
from curricle.comparison.measures import Contrast
from curricle.comparison.sentences import share_saved, short
from curricle.comparison.verdicts import SIGNIFICANT
from curricle.statistics import mean_interval
from curricle.statistics.curves import SCRATCH
from curricle.statistics.hypothesis_tests import holm
from curricle.study import StudyConfig, StudyResults, WorkerProcesses

FILE = Path(__file__).with_suffix(".toml")
TIMED = 4_096  # steps of PPO
ARM, NO_DIFFERENCE = "distilled", "no difference shown"
HEADS = ("target", "models' steps", "opponents' and placebo's areas", "distilled: start, area, end")
HEADS += ("gain over the best opponent", "verdict", "steps saved", "models free: gain")


def level(target: str, *members: str, seen: str) -> list[str]:
    """Return the changes of the study for a level of MiniGrid and smaller levels."""
    ids = [f"minigrid:MiniGrid-{name}" for name in (target, *members)]
    encoded = [f"{task}.encode=levels:{seen}" for task in ("tasks.small", "tasks.target")]
    return [f"tasks.target.id={ids[0]}", f"tasks.small.members={ids[1:]}", *encoded]


# What RL Baselines3 Zoo has for these, where it is not what it has for MiniGrid.
CAR = ["envs=16", *(f"settings.{x}" for x in ("n_steps=16", "n_epochs=4", "gae_lambda=0.98"))]
SWING = ["envs=4"]
SWING += [f"settings.{x}" for x in ("normalize=false", "n_steps=1_024", "learning_rate=1e-3")]
# QR-DQN plays classic control alone: in MiniGrid its area was .03 at most.
QR_DQN = ["learning_rate=5e-4", "batch_size=64", "buffer_size=60_000", "learning_starts=1_000"]
QR_DQN += ["train_freq=4", "gradient_steps=1", "target_update_interval=1_000"]
QR_DQN += ["exploration_fraction=0.3", "exploration_final_eps=0.05"]
QR_DQN += ["policy_kwargs={ net_arch = [128, 128], n_quantiles = 25 }"]
CAR_QR = ["learning_rate=4e-3", "batch_size=128", "buffer_size=10_000", "train_freq=16"]
CAR_QR += ["gradient_steps=8", "target_update_interval=600", "exploration_fraction=0.2"]
CAR_QR += ["exploration_final_eps=0.07", "policy_kwargs.net_arch=[256, 256]"]
# Zoo's QR-DQN knows no pendulum: it has a gradient step at every step, and the rate of Zoo's PPO.
SWING_QR = ["learning_rate=1e-3", "train_freq=1"]


def control(name: str, points: int, held: int, zoo: list[str], qr: list[str]) -> list[str]:
    """Return the changes for an environment of classic control, whose miniature is a grid.

    All PPO have these environments and settings of Zoo, QR-DQN has one environment and its own.
    Where Zoo standardises observations and rewards, scratch and the arm standardise observations
    alone, as values of the source are values of plain rewards.
    """
    arguments = f'{{ id = "{name}", points = {points}, held = {held} }}'
    return [
        f"tasks.target.id={name}",
        "tasks.target.encode=levels:numbered",
        "tasks.target.evaluation.sampled=false",  # nothing is hidden
        f'tasks.small.members=[{{ factory = "levels:Grid", arguments = {arguments} }}]',
        "tasks.small.encode=levels:numbered",
        f"tasks.small.charged={held}",
        f"tasks.small.discount={0.99**held}",
        "learner.settings.normalize={ norm_reward = false }",
        *(f"{learner}.{x}" for x in zoo for learner in ("learner", "scratch_learners.zoo")),
        "scratch_learners.QR-DQN.algorithm=QRDQN",
        "scratch_learners.QR-DQN.envs=1",
        *(f"scratch_learners.QR-DQN.settings.{x}" for x in (*QR_DQN, *qr)),
    ]


def member(id: str, side: int = 0, **arguments: int) -> str:
    """Return a smaller level of MiniGrid as a file has it, maybe with rooms of another side."""
    id = f'id = "minigrid:MiniGrid-{id}"'
    if side:
        return f'{{ factory = "levels:rooms", arguments = {{ {id}, side = {side} }} }}'
    stated = ", ".join(f"{name} = {value}" for name, value in arguments.items())
    return f"{{ {id}, arguments = {{ {stated} }} }}"


def smaller_rooms(target: str, *sides: int) -> list[str]:
    """Return the changes for a level of MiniGrid and the same level with smaller rooms."""
    members = ", ".join(member(target, side=side) for side in sides)
    return [*level(target, seen="carry"), f"tasks.small.members=[{members}]"]


TWO_ROOMS = "MultiRoom-N2-S4-v0"
UP_TO_5 = ", ".join(member(TWO_ROOMS, maxRoomSize=side) for side in (4, 5))
ROOMS = f"tasks.small.members=[{UP_TO_5}]"
TARGETS = {
    "crossing 9": level("SimpleCrossingS9N3-v0", "SimpleCrossingS9N1-v0", seen="walk"),
    "crossing 11": level("SimpleCrossingS11N5-v0", "SimpleCrossingS9N1-v0", seen="walk"),
    "lava": level("LavaCrossingS9N3-v0", "LavaCrossingS9N1-v0", seen="walk"),
    "rooms": [*level("MultiRoom-N4-S5-v1", "MultiRoom-N2-S4-v0", seen="opens"), ROOMS],
    "door": level("DoorKey-8x8-v0", "DoorKey-5x5-v0", "DoorKey-6x6-v0", seen="fetch"),
    "corridor": level("KeyCorridorS3R2-v0", "KeyCorridorS3R1-v0", seen="carry"),
    "car": control("MountainCar-v0", 60, 2, CAR, CAR_QR),
    "go to door": level("GoToDoor-8x8-v0", "GoToDoor-5x5-v0", "GoToDoor-6x6-v0", seen="go_to"),
    "things": level("Fetch-8x8-N3-v0", "Fetch-5x5-N2-v0", "Fetch-6x6-N2-v0", seen="pick_up"),
    "swing": control("Pendulum-v1", 31, 4, SWING, SWING_QR),
}
"""What is reported."""
LOCKED = ", ".join(member("LockedRoom-v0", size=side) for side in (8, 10))
DRAWN = {
    "locked room": [
        *level("LockedRoom-v0", seen="fetch"),
        f"tasks.small.members=[{LOCKED}]",
        "tasks.small.resets=3",
    ],
    "memory": level("MemoryS13Random-v0", "MemoryS7-v0", "MemoryS9-v0", seen="walk"),
}
"""Drawn by lot from MiniGrid's ids that no file here named, and played once."""


def hard(changes: list[str], resets: int, steps: int, eval_freq: int, of_models: int) -> list[str]:
    """Return the changes for a hard level; PPO alone has the steps of the models as well."""
    return [
        *changes,
        f"tasks.small.resets={resets}",
        f"tasks.target.budget={steps}",
        f"tasks.target.eval_freq={eval_freq}",
        f"arms.alone.tasks.target.budget={steps + of_models}",
    ]


LAVA = level("LavaCrossingS11N5-v0", "LavaCrossingS9N1-v0", "LavaCrossingS9N3-v0", seen="walk")
DOOR = level("DoorKey-16x16-v0", "DoorKey-6x6-v0", "DoorKey-8x8-v0", seen="fetch")
CORRIDOR = level("KeyCorridorS3R3-v0", "KeyCorridorS3R1-v0", "KeyCorridorS3R2-v0", seen="carry")
MAZE, BLOCKED = "ObstructedMaze-1Dlh-v0", "BlockedUnlockPickup-v0"
HARD = {
    "lava 11": hard(LAVA, 200, 100_000, 20_000, 68_856),
    "door 16": hard(DOOR, 50, 100_000, 20_000, 100_100),
    "corridor 3": hard(CORRIDOR, 10, 300_000, 50_000, 387_120),
    "unlock": hard(smaller_rooms("UnlockPickup-v0", 4, 5), 15, 300_000, 50_000, 558_624),
    "maze": hard(smaller_rooms(MAZE, 4), 40, 300_000, 50_000, 396_000),
    "blocked": hard(smaller_rooms(BLOCKED, 4), 18, 300_000, 50_000, 656_160),
}


def chain(target: str, middle: str, small: list[str], seen: str, resets: int) -> list[str]:
    """Return the changes for a hard level after a level between."""
    ids = {"target": target, "middle": middle}
    return [
        *(f"tasks.{task}.id=minigrid:MiniGrid-{id}" for task, id in ids.items()),
        f"tasks.small.members=[{', '.join(small)}]",
        f"tasks.small.resets={resets}",
        *(f"tasks.{task}.encode=levels:{seen}" for task in ("small", *ids)),
    ]


BETWEEN_ROOMS = {"minNumRooms": 3, "maxNumRooms": 3, "maxRoomSize": 6}
SMALL_ROOMS = [member(TWO_ROOMS, maxRoomSize=6), member(TWO_ROOMS, **BETWEEN_ROOMS)]
ONE_ROW = member("KeyCorridorS4R3-v0", num_rows=1)
CORRIDORS = [member("KeyCorridorS3R1-v0"), member("KeyCorridorS3R2-v0"), ONE_ROW]
TWO_ROWS = "tasks.middle.arguments.num_rows=2"
CHAINS = {
    "rooms 6": [
        *chain("MultiRoom-N6-v0", "MultiRoom-N4-S5-v1", SMALL_ROOMS, "opens", 30),
        "tasks.middle.arguments.maxRoomSize=8",
    ],
    "blocked, by a chain": chain(BLOCKED, "UnlockPickup-v0", [member(BLOCKED, 4)], "carry", 9),
    "maze 2": chain("ObstructedMaze-2Dlh-v0", MAZE, [member(MAZE, 4)], "carry", 20),
    "corridor 4": [
        *chain("KeyCorridorS4R3-v0", "KeyCorridorS4R3-v0", CORRIDORS, "carry", 8),
        TWO_ROWS,
        "seeds=5",
        "tasks.middle.budget=250_000",
        "tasks.target.budget=300_000",
    ],
    "corridor 5": [
        *chain("KeyCorridorS5R3-v0", "KeyCorridorS4R3-v0", CORRIDORS, "carry", 4),
        TWO_ROWS,
    ],
}
"""Hard levels after a level between, a million steps in all at most."""
DEVELOPMENT = {
    "crossing 2": level("SimpleCrossingS9N2-v0", "SimpleCrossingS9N1-v0", seen="walk"),
    "gap": level("LavaGapS7-v0", "LavaGapS5-v0", "LavaGapS6-v0", seen="walk"),
    "small door": level("DoorKey-6x6-v0", "DoorKey-5x5-v0", seen="fetch"),
    "acrobot": control("Acrobot-v1", 15, 5, [], []),
}
"""What settings are chosen on."""
ALL = {**TARGETS, **DRAWN, **HARD, **CHAINS, **DEVELOPMENT}
FILES = dict.fromkeys(HARD, FILE.with_name("hard.toml"))
FILES |= dict.fromkeys(CHAINS, FILE.with_name("chain.toml"))
"""The files of hard targets."""


def study_of(target: str, seeds: int | None = None) -> StudyConfig:
    """Return the study of a target, with its file's seeds unless a number is given."""
    stated = [] if seeds is None else [f"seeds={seeds}"]
    return read_study(FILES.get(target, FILE), set=[f"name={target}", *stated, *ALL[target]])


def learned(results: StudyResults) -> None:
    """Print the returns of a hard target at its checkpoints, and the steps of the models."""
    for arm in results.record.arms:
        result = results.result(arm, "target")
        print(f"{arm}, after {int(results.source_steps(arm)[0]):,} steps of models")
        for steps, returns in zip(result.steps, result.greedy_return.T, strict=True):
            print(f"{steps:>8,}{shown(returns):>24}")


def rows(folder: Path, targets: Collection[str]) -> Iterator[tuple[str, ...]]:
    """Yield a row of each target that a folder has, with the verdict on its arm.

    p is corrected for all targets (Holm).
    """
    made = finished(folder, targets)
    tested = [results.comparison for results in made.values() if not results.comparison.nobody]
    p_values = [comparison.contrasts[ARM].p for comparison in tested]
    # 1 where nobody learnt, or where it has not been played yet
    corrected = iter(holm(p_values + [1.0] * (len(targets) - len(tested))))
    for target, results in made.items():
        comparison = results.comparison
        contrast, best = comparison.contrasts[ARM], comparison.best_opponent(ARM)
        areas = {short_name(arm): comparison.mean_return(arm) for arm in comparison.shown}
        area = areas.pop(ARM)
        returns = comparison.arms[ARM].curve.values.mean(axis=0)
        yield (
            target,
            f"{int(results.source_steps(ARM)[0]):,}",
            ", ".join(f"{name} {other.estimate:.3g}" for name, other in areas.items()),
            f"{returns[0]:.3g}, {short(area)}, {returns[-1]:.3g}",
            f"{short(contrast.strong_gain)} ({short_name(best)})",
            comparison.nobody or answered(contrast, next(corrected)),
            share_saved(comparison, ARM),
            short(contrast.weak_gain),
        )


def answered(contrast: Contrast, p: float) -> str:
    """Return the verdict on an arm by a corrected p."""
    return f"{contrast.answer if p < SIGNIFICANT else NO_DIFFERENCE}, p = {p:.2g}"


def short_name(arm: str) -> str:
    """Return an arm's name in the table: PPO is the learner from scratch."""
    return arm.removeprefix(f"{SCRATCH}, ").removeprefix(f"{ARM}, ").replace(SCRATCH, "PPO")


def finished(folder: Path, targets: Collection[str]) -> dict[str, StudyResults]:
    """Return the results of the targets of which a folder has all seeds."""
    stored = [name for name in targets if (folder / name / "results.parquet").exists()]
    made = {name: StudyResults(folder / name) for name in stored}
    return {name: results for name, results in made.items() if not results.comparison.interim}


def shown(values: np.ndarray) -> str:
    if np.ptp(values) == 0:  # no interval, as for a single seed
        return f"{values.mean():.2f}"
    interval = mean_interval(values)
    return f"{interval.estimate:.2f} [{interval.low:.2f}, {interval.high:.2f}]"


def price(study: StudyConfig) -> str:
    """Return what the miniatures of a target cost, in steps and in seconds of one processor."""
    from curricle.deep import learn_deep  # torch, which the study alone does not need
    from curricle.deep.distillation import distil

    curriculum, began = study.curriculum("distilled"), time.process_time()
    small, target = curriculum.tasks["small"], curriculum.tasks["target"]
    learner = curriculum.setting("learner", "target")
    known = small.knowledge()
    solved = time.process_time() - began
    values = distil(known, target, learner)
    fitted = time.process_time() - began - solved
    began = time.process_time()
    learn_deep(target, learner, TIMED, evaluation=GreedyEvaluation(method="off"))
    a_step = (time.process_time() - began) / TIMED
    held_out = [f"{part.regained:.0%} of {part.levels} levels" for part in small.examined(values)]
    return (
        f"{known.states.sum():,} states, {known.alike:.0%} look alike; {small.cost:,} steps "
        f"of models, {solved:.0f} s; distilled in {fitted:.0f} s; together as long as "
        f"{(solved + fitted) / a_step:,.0f} steps of PPO; regains on held-out levels "
        f"{', '.join(held_out)}"
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--targets", nargs="*", default=list(TARGETS), choices=list(ALL))
    options.add_argument("--seeds", type=int)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--out", type=Path, default=Path("miniatures-results"))
    options.add_argument("--price", action="store_true", help="print what the miniatures cost")
    chosen = options.parse_args()
    for target in chosen.targets:
        print(f"\n{target}", flush=True)
        study = study_of(target, chosen.seeds)
        if chosen.price:
            print(price(study), flush=True)
            continue
        with WorkerProcesses(chosen.workers) as executor:
            results = run_study(study, chosen.out / target, executor=executor, resume=True)
        if target in FILES:
            learned(results)
        print(price(study), flush=True)
    for targets in (TARGETS, DRAWN):
        print(markdown(HEADS, rows(chosen.out, targets)))


if __name__ == "__main__":
    main()
