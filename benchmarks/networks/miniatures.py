"""The study of miniatures on seven targets that no setting was chosen on, and four for choosing.

    python -m benchmarks.networks.miniatures [--targets ...] [--seeds 5] [--workers 2] [--out DIR]

Each target's results are a study's: a stopped run goes on, and `curricle show` reads them. Printed
here are the steps and seconds that the miniatures take (`--price`), or for every arm

- start: the target's return before its first step there;
- area: the mean return over the 60,000 steps, source steps charged; end: the last return.

Brackets are 95 % intervals over seeds; returns are undiscounted. Actions of actor-critics are drawn
from their policy where observations hide a part of the state, DQN's are greedy.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from curricle import read_study, run_study
from curricle.statistics import mean_interval, mean_return
from curricle.study import StudyConfig, StudyResults, WorkerProcesses

FILE = Path(__file__).with_suffix(".toml")
STEPS = 'arms."weights of steps".tasks.small'


def level(target: str, *members: str, seen: str) -> list[str]:
    """Return the changes of the study for a level of MiniGrid and smaller levels."""
    ids = [f"minigrid:MiniGrid-{name}" for name in (target, *members)]
    encoded = [f"{task}.encode=levels:{seen}" for task in ("tasks.small", "tasks.target", STEPS)]
    small = [f"tasks.small.members={ids[1:]}", f"{STEPS}.arguments.id={ids[-1]}"]
    return [f"tasks.target.id={ids[0]}", *small, *encoded]


def control(name: str, points: int, held: int) -> list[str]:
    """Return the changes for an environment of classic control, whose miniature is a grid."""
    arguments = f'{{ id = "{name}", points = {points}, held = {held} }}'
    encoded = [f"{task}.encode=levels:as_it_is" for task in ("tasks.small", "tasks.target", STEPS)]
    return [
        f"tasks.target.id={name}",
        "tasks.target.evaluation.sampled=false",  # nothing is hidden
        f'tasks.small.members=[{{ factory = "levels:Grid", arguments = {arguments} }}]',
        f"{STEPS}.factory=levels:Grid",
        f"{STEPS}.arguments.id={name}",
        f"{STEPS}.arguments.points={points}",
        f"{STEPS}.arguments.held={held}",
        *encoded,
    ]


ROOM = '{{ id = "minigrid:MiniGrid-MultiRoom-N2-S4-v0", arguments = {{ maxRoomSize = {} }} }}'
ROOMS = f"tasks.small.members=[{ROOM.format(4)}, {ROOM.format(5)}]"  # of sides up to 4 and up to 5
TARGETS = {
    "crossing 9": level("SimpleCrossingS9N3-v0", "SimpleCrossingS9N1-v0", seen="walk"),
    "crossing 11": level("SimpleCrossingS11N5-v0", "SimpleCrossingS9N1-v0", seen="walk"),
    "lava": level("LavaCrossingS9N3-v0", "LavaCrossingS9N1-v0", seen="walk"),
    "rooms": [
        *level("MultiRoom-N4-S5-v1", "MultiRoom-N2-S4-v0", seen="opens"),
        *(ROOMS, f"{STEPS}.arguments.maxRoomSize=5"),
    ],
    "door": level("DoorKey-8x8-v0", "DoorKey-5x5-v0", "DoorKey-6x6-v0", seen="fetch"),
    "corridor": level("KeyCorridorS3R2-v0", "KeyCorridorS3R1-v0", seen="carry"),
    "car": control("MountainCar-v0", 150, 2),
}
"""What is reported."""
DEVELOPMENT = {
    "crossing 2": level("SimpleCrossingS9N2-v0", "SimpleCrossingS9N1-v0", seen="walk"),
    "gap": level("LavaGapS7-v0", "LavaGapS5-v0", "LavaGapS6-v0", seen="walk"),
    "small door": level("DoorKey-6x6-v0", "DoorKey-5x5-v0", seen="fetch"),
    "acrobot": control("Acrobot-v1", 15, 5),
}
"""What settings are chosen on."""
ALL = {**TARGETS, **DEVELOPMENT}


def table(results: StudyResults) -> None:
    """Print the start, the area and the end of each arm over the seeds that all have finished."""
    comparison = results.comparison
    print(f"{'arm':<28}{'start':>8}{'area':>24}{'end':>24}")
    for name, arm in comparison.arms.items():
        charged = arm.charged(comparison.scratch)
        area, end = mean_return(charged), charged.values[:, -1]
        print(f"{name:<28}{arm.curve.values[:, 0].mean():>8.2f}{shown(area):>24}{shown(end):>24}")


def shown(values: np.ndarray) -> str:
    if len(values) < 2:
        return f"{values.mean():.2f}"
    interval = mean_interval(values)
    return f"{interval.estimate:.2f} [{interval.low:.2f}, {interval.high:.2f}]"


def price(study: StudyConfig) -> str:
    """Return what the miniatures of a target cost."""
    from curricle.deep.distillation import distil  # torch, which the study alone does not need

    curriculum, began = study.curriculum("distilled"), time.process_time()
    small = curriculum.tasks["small"]
    known = small.knowledge()
    solved = time.process_time() - began
    values = distil(known, curriculum.tasks["target"], curriculum.setting("learner", "target"))
    fitted = time.process_time() - began - solved
    held_out = [f"{part.regained:.0%} of {part.levels} levels" for part in small.examined(values)]
    return (
        f"{known.states.sum():,} states, {known.alike:.0%} look alike; {small.transitions:,} steps "
        f"of models, {solved:.0f} s; distilled in {fitted:.0f} s; regains on held-out levels "
        f"{', '.join(held_out)}"
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--targets", nargs="*", default=list(TARGETS), choices=list(ALL))
    options.add_argument("--seeds", type=int, default=5)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--out", type=Path, default=Path("miniatures-results"))
    options.add_argument("--price", action="store_true", help="print what the miniatures cost")
    chosen = options.parse_args()
    for target in chosen.targets:
        print(f"\n{target}", flush=True)
        study = read_study(FILE, set=[f"name={target}", f"seeds={chosen.seeds}", *ALL[target]])
        if chosen.price:
            print(price(study), flush=True)
            continue
        with WorkerProcesses(chosen.workers) as executor:
            table(run_study(study, chosen.out / target, executor=executor, resume=True))


if __name__ == "__main__":
    main()
