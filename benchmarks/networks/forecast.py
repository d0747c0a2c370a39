"""How well forecasts of distilled policies rank choices of miniatures.

For each target several choices of miniatures are solved and distilled. The forecast is what their
network regains, of the way from the random policy to the optimum, on relatives that are in no
choice, larger than most choices and smaller than the target. The result is the share that it
regains on levels of the target itself. Both are exact, by tables; no step is taken.

    python -m benchmarks.networks.forecast [--targets ...] [--seeds 1]
"""

import argparse

import numpy as np
from scipy.stats import spearmanr

from benchmarks.networks.levels import fetch, walk
from benchmarks.networks.miniatures import FILE
from curricle import observation_task, read_study
from curricle.deep import miniatures
from curricle.deep.distillation import distil

CROSSINGS = {
    "empty 5x5": (["Empty-Random-5x5-v0"], 200),
    "empty 6x6": (["Empty-Random-6x6-v0"], 200),
    "gap of 5": (["LavaGapS5-v0"], 200),
    "gap of 7": (["LavaGapS7-v0"], 200),
    "one wall, 2 resets": (["SimpleCrossingS9N1-v0"], 2),
    "one wall, 5 resets": (["SimpleCrossingS9N1-v0"], 5),
    "one wall, 20 resets": (["SimpleCrossingS9N1-v0"], 20),
    "one wall": (["SimpleCrossingS9N1-v0"], 200),
    "one lava": (["LavaCrossingS9N1-v0"], 200),
    "one of each": (["SimpleCrossingS9N1-v0", "LavaCrossingS9N1-v0"], 200),
    "one wall and empty": (["SimpleCrossingS9N1-v0", "Empty-Random-6x6-v0"], 200),
}
DOORS = {
    "empty 5x5": (["Empty-Random-5x5-v0"], 200),
    "empty 6x6": (["Empty-Random-6x6-v0"], 200),
    "door 5x5, 1 reset": (["DoorKey-5x5-v0"], 1),
    "door 5x5, 3 resets": (["DoorKey-5x5-v0"], 3),
    "door 5x5, 10 resets": (["DoorKey-5x5-v0"], 10),
    "door 5x5": (["DoorKey-5x5-v0"], 200),
    "door 5x5 and empty": (["DoorKey-5x5-v0", "Empty-Random-6x6-v0"], 200),
    "unlock": (["Unlock-v0"], 10),
    "one wall": (["SimpleCrossingS9N1-v0"], 200),
    "door 5x5 and one wall": (["DoorKey-5x5-v0", "SimpleCrossingS9N1-v0"], 200),
}
TARGETS = {  # choices, what the forecast is tested on, the target, its encoder
    "crossing": (CROSSINGS, "SimpleCrossingS9N2-v0", "SimpleCrossingS9N3-v0", walk),
    "lava": (CROSSINGS, "LavaCrossingS9N2-v0", "LavaCrossingS9N3-v0", walk),
    "door": (DOORS, "DoorKey-6x6-v0", "DoorKey-8x8-v0", fetch),
}
PPO = read_study(FILE).curriculum("distilled").setting("learner", "target")
RESETS = 40
"""Of the relatives and of the target, by which a network is examined."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", nargs="*", default=list(TARGETS), choices=list(TARGETS))
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    for name in options.targets:
        choices, between, target, encode = TARGETS[name]
        examined = miniatures(
            level(between, encode),
            tested_on=[level(between, encode), level(target, encode)],
            resets=RESETS,
        )
        print(f"\n{name}: {'choice':<26}{'own levels':>12}{'forecast':>10}{'result':>11}")
        rows = [
            row(label, *choice, examined, encode, seed)
            for label, choice in choices.items()
            for seed in range(options.seeds)
        ]
        own, forecast, result = np.array(rows).T
        for which, values in (("forecast", forecast), ("own held-out levels", own)):
            rank = spearmanr(values, result).statistic
            print(f"rank correlation with the result, {which}: {rank:.2f}")


def level(name, encode):
    """Return a level of MiniGrid as a network sees it."""
    return observation_task(f"minigrid:MiniGrid-{name}", encode=encode, discount=0.99)


def row(label, names, resets, examined, encode, seed) -> tuple[float, float, float]:
    """Return what a choice regains on its own levels, on those between, and on the target."""
    small = miniatures(*[level(name, encode) for name in names], resets=resets)
    values = distil(small.knowledge(), small, PPO, seed=seed)
    own = float(np.mean([member.regained for member in small.examined(values)]))
    forecast, result = (test.examined(values).regained for test in examined.solved_tests)
    print(f"  {label:<32}{own:>12.2f}{forecast:>10.2f}{result:>11.2f}", flush=True)
    return own, forecast, result


if __name__ == "__main__":
    main()
