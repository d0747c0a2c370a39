"""Play the match of docs/referee.md by studies, and print its table.

    python -m benchmarks.referee play referee-results [--only pursuit]
    python -m benchmarks.referee play referee-results --again    # judged on 40 fresh seeds
    python -m benchmarks.referee table referee-results

A domain is a study file with cases: settings that make it a target of development or a judged one.
Every arm is tuned on the cases of development, at the same points of the file's ``[tune]``. A point
is a share of each range, so steps of sources are in relation to a case's budget. The best settings
are then played on the judged cases, with the curriculum that ``curricle choose`` chooses there, and
all opponents. What was played already is not played again.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

import curricle as cr
from benchmarks.pairs.pair import levels
from curricle.comparison import Comparison
from curricle.paper.mazes import MAP
from curricle.statistics import mean_interval
from curricle.statistics.curves import SCRATCH
from curricle.study import StudyConfig, StudyResults
from curricle.study.tuning import choose, trial_study, tuned_study

HERE = Path(__file__).parent
CHOSEN = "chosen"
RATE = "learner.learning_rate"
FRESH = [*range(1000, 1040)]
MANY = 10  # targets from which on intervals are over targets, not over seeds


class Case(NamedTuple):
    """A target of a domain: the settings of its study file."""

    name: str
    budget: int
    settings: dict[str, Any]

    def study(self, file: str) -> StudyConfig:
        """Return the study of this target."""
        ends = f"low = {self.budget // 100}, high = {3 * self.budget // 10}, log = true"
        changes = [f"{key}={json.dumps(value)}" for key, value in self.settings.items()]
        changes.append(f"tune.space.budget.max_steps={{ {ends} }}")
        changes += [f"budget.max_steps={self.budget // 10}", f"tasks.target.budget={self.budget}"]
        changes.append(f"name={file}, {self.name}")
        return cr.read_study(HERE / f"{file}.toml", set=changes)


def sized(key: str, size: Any, budget: int, half: int, most: int, half_way: int) -> Case:
    """Return a case of a family with a size, that of the target and of its sources."""
    sizes = {"target": size, "half": half, "most": most, "half_way": size}
    settings = {f"tasks.{task}.{key}": value for task, value in sizes.items()}
    return Case(f"{key} {size}", budget, {**settings, **started(half_way)})


def started(half_way: int) -> dict[str, Any]:
    """Return the settings of the source that starts so far from the goal at most."""
    return {"tasks.half_way.start_states.distance": [1, half_way]}


def hunt(size: int, budget: int, half: int) -> Case:
    """Return a hunt of two predators; half of the way is 1 or 2 steps."""
    case = sized("size", size, budget, half, size - 1, size // 2)
    return case._replace(settings={**case.settings, "tasks.alone.size": size})


def maze(size: int, seed: int, budget: int, half_way: int) -> Case:
    """Return a random maze, whose treasure is in the north-east."""
    settings = {**corners(size, 1), **started(half_way)}
    for task in ("target", "half_way"):
        drawn = {"size": size, "seed": seed, "time_limit": 20 * size}
        settings |= {f"tasks.{task}.{key}": value for key, value in drawn.items()}
    return Case(f"{size}x{size}, seed {seed}", budget, settings)


def corners(size: int, end: int) -> dict[str, Any]:
    """Return the settings of the parts at the treasure; columns end before `end`."""
    shares = {"quarter": 0.25, "third": 0.35, "half": 0.5, "most": 0.7}
    sides = {task: int(share * size + 0.5) for task, share in shares.items()}
    return {
        f"tasks.{task}.{key}": value
        for task, side in sides.items()
        for key, value in (("rows", [0, side]), ("columns", [end - side, end]))
    }


def paper() -> Case:
    """Return the paper's maze."""
    settings: dict[str, Any] = {**corners(10, 10), **started(9)}
    for task in ("target", "half_way"):
        said = {"type": "maze", "map": MAP, "rewards.step": -5.0, "time_limit": 200}
        settings |= {f"tasks.{task}.{key}": value for key, value in said.items()}
    return Case("the paper's", 20_000, settings)


def door(size: int, seed: int, budget: int, half_way: int) -> Case:
    """Return a room of MiniGrid with a key and a door."""
    level = f"minigrid:MiniGrid-DoorKey-{size}x{size}-v0"
    settings: dict[str, Any] = started(half_way)
    settings["tasks.quarter_way.start_states.distance"] = [1, max(1, half_way // 2)]
    for task in ("target", "half_way", "quarter_way"):
        settings |= {f"tasks.{task}.id": level, f"tasks.{task}.reset_seeds": [seed]}
    return Case(f"{size}x{size}, seed {seed}", budget, settings)


SMALL_MAZES = [maze(10, seed, 30_000, 9) for seed in (10025, 10040, 10042)]
LARGE_MAZES = {1: 14, 14: 14, 18: 13, 19: 14, 22: 15, 27: 13, 37: 14, 43: 14, 44: 14, 49: 14}
"""By seed, half the fewest moves: the first random mazes whose optimum is above -300 and where the
optimal policy walks at least twice the side. So were the small ones drawn."""
DOMAINS: dict[str, tuple[str, list[Case], list[Case]]] = {
    "paper's maze": ("mazes", SMALL_MAZES, [paper()]),
    "random mazes": (
        "mazes",
        SMALL_MAZES,
        [maze(15, seed, 50_000, half_way) for seed, half_way in LARGE_MAZES.items()],
    ),
    "pursuit": ("pursuit", [hunt(3, 60_000, 2)], [hunt(4, 150_000, 2), hunt(5, 400_000, 3)]),
    "key-lock-pit": (
        "keys",
        [sized("size", 6, 6_000, 4, 5, 7), sized("size", 7, 9_000, 4, 5, 9)],
        [
            sized("size", 8, 15_000, 4, 6, 10),
            sized("size", 10, 27_000, 5, 8, 13),
            sized("size", 12, 48_000, 6, 9, 16),
        ],
    ),
    "Block Dude": (
        "block_dude",
        [sized("columns", 12, 24_000, 10, 11, 6), sized("columns", 15, 36_000, 10, 12, 9)],
        [
            sized("columns", 16, 42_000, 10, 12, 9),
            sized("columns", 20, 78_000, 10, 15, 9),
            sized("columns", "none", 140_000, 12, 18, 9),
        ],
    ),
    "four rooms": (
        "four_rooms",
        [sized("size", 11, 75_000, 7, 8, 5), sized("size", 13, 100_000, 7, 10, 7)],
        [sized("size", 14, 150_000, 7, 11, 8), sized("size", 15, 220_000, 8, 11, 8)],
    ),
    "DoorKey": (
        "door_key",
        [door(5, 1, 75_000, 3), door(5, 2, 75_000, 6)],
        [door(6, 0, 300_000, 7), door(6, 1, 300_000, 6), door(6, 2, 300_000, 7)],
    ),
}
"""By name: the study file, the targets of development, and those that are judged."""


def way(study: StudyConfig) -> float:
    """Return how far the optimum of a study's target is above the random policy's return."""
    curriculum = next(iter(study.curricula.values()))
    random_return, optimum = levels(curriculum.tasks[curriculum.target])
    return optimum - random_return


def trials(file: str, cases: Sequence[Case], out: Path) -> Any:
    """Return the trials of all cases as those of one, in shares of each case's way."""
    results, returns = [], list[dict[str, np.ndarray]]()
    for case in cases:
        study = case.study(file)
        played = cr.run_study(study.trials, out / f"{file}, {case.name}", resume=True, workers=1)
        results.append(played)
        returns.append({arm: r / way(study) for arm, r in played.comparison.returns.items()})
    record = results[0].record
    total = sum(played.record.total or 0 for played in results)
    return SimpleNamespace(
        comparison=SimpleNamespace(
            returns={arm: np.concatenate([of[arm] for of in returns]) for arm in returns[0]}
        ),
        record=record.model_copy(update={"total": total}),
    )


def with_choice(study: StudyConfig, plain: StudyConfig, out: Path) -> StudyConfig:
    """Return a tuned study with the curriculum that is chosen at the rate of scratch, if any."""
    assert study.tuned is not None, "it is tuned"
    rate = study.tuned.arms[SCRATCH].values[RATE]
    untuned: Any = {"tune": None, "variants": None, "scratches": None, "choose": True}
    data = plain.varied(**untuned).to_data()
    for arm in data["arms"].values():
        for task in arm["tasks"].values():
            task["learner"]["learning_rate"] = rate
    asked = plain.varied(**untuned, arms=data["arms"])
    file = out.with_suffix(".json")
    if not file.exists():
        choice = choose(asked, workers=1)
        spent = sum(row["seeds"] for row in choice.rows) * (choice.comparison.total or 0)
        said = {"name": choice.name, "alone": choice.alone, "steps": spent}
        said |= {"words": str(choice)}
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(said, indent=1))
    choice, data = json.loads(file.read_text()), study.to_data()
    if choice["name"]:
        arm = trial_study(asked).to_data()["arms"][choice["name"]]
        return study.varied(arms={**data["arms"], CHOSEN: arm})
    named = named_alone(choice)
    if "=" in named and named not in data["scratches"]:  # a constant for Q at the rate of scratch
        task = data["scratches"][SCRATCH]["tasks"]["target"]
        task["learner"] |= {"learning_rate": rate, "initial_value": float(named.split("=")[1])}
        alone = {"tasks": {**data["scratches"][SCRATCH]["tasks"], "target": task}}
        return study.varied(scratches={**study.to_data()["scratches"], named: alone})
    return study


def named_alone(choice: Mapping[str, Any]) -> str:
    """Return the arm of the learner without a source that a choice names."""
    plain = choice["alone"] == "learning from scratch"  # whose Q starts at 0, untuned
    return f"{SCRATCH}, {'initial_value=0' if plain else choice['alone']}"


def play(names: Sequence[str], out: Path, *, again: bool) -> None:
    """Play domains into a folder; or judge them again on fresh seeds."""
    for name in names:
        file, development, judged = DOMAINS[name]
        tried = trials(file, development, out / "tuning")
        for case in judged:
            plain, target = case.study(file), f"{file}, {case.name}"
            study = with_choice(tuned_study(plain, tried), plain, out / "choice" / target)
            study = study.varied(seeds=FRESH) if again else study
            folder = out / ("again" if again else "judged") / target
            cr.run_study(study, folder, resume=True, workers=1)


# -- The table -------------------------------------------------------------------------------------


class Judged(NamedTuple):
    """A judged target, played."""

    comparison: Comparison
    way: float
    alone: str  # the arm of the learner that the choice names where it chooses no curriculum
    searched: float  # steps of the choice's trials, in trainings of the target
    again: Comparison | None = None  # on fresh seeds, if it was played

    @classmethod
    def of(cls, file: str, case: Case, out: Path) -> "Judged":
        """Return a target from a folder of the match."""
        name = f"{file}, {case.name}"
        choice = json.loads((out / "choice" / f"{name}.json").read_text())
        comparison = StudyResults(out / "judged" / name).comparison
        spent = choice["steps"] / comparison.total
        fresh = out / "again" / name
        again = StudyResults(fresh).comparison if fresh.exists() else None
        return cls(comparison, way(case.study(file)), named_alone(choice), spent, again)

    def arm(self, name: str) -> str:
        """Return an arm, or what is learnt instead of a curriculum that was not chosen."""
        return name if name != CHOSEN or CHOSEN in self.comparison.arms else self.alone

    def best(self, name: str) -> str:
        """Return the best opponent of an arm; of no curriculum, of all arms from scratch."""
        arm = self.arm(name)
        if arm in self.comparison.scratches:
            known = [x for x in self.comparison.scratches if not self.comparison[x].curriculum]
            return max(known, key=lambda rival: float(self.comparison.returns[rival].mean()))
        return self.comparison.best_opponent(arm)

    def gain(self, name: str, rival: str) -> np.ndarray:
        """Return by how much an arm gains more than another, in shares of the way, (K,)."""
        returns = self.comparison.returns
        return np.asarray((returns[self.arm(name)] - returns[rival]) / self.way)

    def steps(self, name: str) -> float:
        """Return the median of the steps until it is learnt; infinite if half never learn it."""
        times = self.comparison.times(self.arm(name))
        return float(np.median(np.where(times.reached, times.steps, np.inf)))

    def pays(self, name: str, *, again: bool = False) -> bool:
        """Return whether the verdict is that an arm pays."""
        comparison = self.again if again else self.comparison
        contrast = comparison.contrasts.get(self.arm(name)) if comparison else None
        return contrast is not None and contrast.verdict == "pays"


def interval(gains: Sequence[np.ndarray]) -> str:
    """Return the mean of targets' gains as text, with 95 % over targets if many, else seeds."""
    of_each = np.array(gains).mean(axis=1 if len(gains) >= MANY else 0)
    mean = mean_interval(of_each)
    ends = f" [{mean.low:+.2f}, {mean.high:+.2f}]" if np.ptp(of_each) else ""
    return f"{mean.estimate:+.2f}{ends}"


def in_words(steps: Sequence[float]) -> str:
    """Return the steps of a few targets, or the median of many."""
    few = steps if len(steps) < MANY else [float(np.median(steps))]
    return ", ".join("never" if np.isinf(n) else f"{n:,.0f}" for n in few)


ARMS = (SCRATCH, "half size", "half way", "growing chain", "standing", CHOSEN)


def gains_of(played: Sequence[Judged], arm: str) -> str:
    """Return the gain of an arm over the best opponents, and in how many targets it pays."""
    rivals = [target.best(arm) for target in played]
    gain = interval([x.gain(arm, rival) for x, rival in zip(played, rivals, strict=True)])
    return gain if arm == SCRATCH else f"{gain}, {sum(target.pays(arm) for target in played)}"


def table(names: Sequence[str], out: Path) -> Iterator[str]:
    """Yield the rows of both tables of the page, and what the choices came to."""
    files, targets = {name: DOMAINS[name][0] for name in names}, dict[str, list[Judged]]()
    for name in names:
        targets[name] = [Judged.of(files[name], case, out) for case in DOMAINS[name][2]]
    yield "gain over the best opponent, targets in which it pays"
    yield f"| domain | {' | '.join(ARMS)} |\n|---|{'--:|' * len(ARMS)}"
    for name, played in targets.items():
        there = {*played[0].comparison.arms, CHOSEN}
        cells = [gains_of(played, arm) if arm in there else "" for arm in ARMS]
        yield f"| {name} | {' | '.join(cells)} |"
    yield f"\nsteps until learnt\n| domain | the best without a source | {' | '.join(ARMS)} |"
    yield f"|---|---|{'--:|' * len(ARMS)}"
    for name, played in targets.items():
        there = {*played[0].comparison.arms, CHOSEN}
        best = Counter(target.best(SCRATCH).removeprefix(f"{SCRATCH}, ") for target in played)
        alone = in_words([target.steps(target.best(SCRATCH)) for target in played])
        cells = [in_words([x.steps(arm) for x in played]) if arm in there else "" for arm in ARMS]
        yield f"| {name} | {alone} ({' or '.join(best)}) | {' | '.join(cells)} |"
    yield "\nover tuned scratch; where one is chosen; trials of the choice, in trainings"
    for name, played in targets.items():
        chose = sum(CHOSEN in target.comparison.arms for target in played)
        spent = [target.searched for target in played]
        arms = [arm for arm in ARMS[1:] if arm in {*played[0].comparison.arms, CHOSEN}]
        over = [f"{arm} {interval([x.gain(arm, SCRATCH) for x in played])}" for arm in arms]
        trials = f"{chose} of {len(played)}; {min(spent):,.0f} to {max(spent):,.0f}"
        paying = [(x, arm) for x in played for arm in arms if x.again and x.pays(arm)]
        still = sum(target.pays(arm, again=True) for target, arm in paying)
        yield f"{name}: {'; '.join(over)}; {trials}; {len(paying)} pay, {still} on fresh seeds"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.referee", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("what", choices=["play", "table"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--again", action="store_true", help="judge on 40 fresh seeds")
    parser.add_argument("--only", nargs="*", choices=DOMAINS, default=[*DOMAINS])
    options = parser.parse_args(arguments)
    if options.what == "play":
        play(options.only, options.folder, again=options.again)
        return
    print("\n".join(table(options.only, options.folder)))


if __name__ == "__main__":
    main()
