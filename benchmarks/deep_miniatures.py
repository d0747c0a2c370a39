"""Networks distilled from solved miniatures, on seven targets that no setting was chosen on.

Every arm has 60,000 steps in all. Miniatures take none: they have models, whose steps and whose
seconds, with those of the distillation, are printed apart. Returns are the targets' own,
undiscounted; actions of actor-critics are drawn from their policy where observations hide a part of
the state, DQN's are greedy. All arms of a target have the actions that have an effect there, and
one set of settings for all targets.

- area: the mean return over the 60,000 steps, source steps charged; end: the last return.
- gain: over the best learner from scratch, by area. Brackets are 95 % intervals over seeds.

    pip install "curricle[deep]" "minigrid>=3,<4"
    python -m benchmarks.deep_miniatures [--targets ...] [--arms ...] [--seeds 5] [--workers 2]
                                         [--out DIR] [--table]
"""

import argparse
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import minigrid  # noqa: F401  # registers its environments
import numpy as np

import curricle as cr
from benchmarks.evidence import curve_of, folder, place, trained
from curricle.deep import DeepLearner, PolicyReuse, WeightTransfer, miniatures
from curricle.deep.distillation import distil

BUDGET, EVAL_FREQ, EPISODES = 60_000, 6_000, 20
SOURCE = 20_000
"""Steps of the source whose weights are carried over."""
NETWORK = {"net_arch": [128, 128]}
PPO = DeepLearner(
    "PPO", envs=8,
    settings={
        "n_steps": 128, "batch_size": 256, "n_epochs": 4, "learning_rate": 2.5e-4, "ent_coef": 0.01,
        "gae_lambda": 0.95, "policy_kwargs": NETWORK,
    },
)  # fmt: skip
DQN = DeepLearner(
    "DQN", envs=8,
    settings={
        "learning_rate": 5e-4, "batch_size": 128, "buffer_size": 60_000, "learning_starts": 1_000,
        "train_freq": 1, "gradient_steps": 2, "target_update_interval": 1_000,
        "exploration_fraction": 0.3, "exploration_final_eps": 0.05, "policy_kwargs": NETWORK,
    },
)  # fmt: skip


def level(name: str, actions: tuple[int, ...], **settings) -> cr.tasks.ObservationTask:
    """Return a level of MiniGrid, seen in part as zeros and ones, with some of its actions."""
    seen = Seen(actions)
    return cr.observation_task(f"MiniGrid-{name}", encode=seen, discount=0.99, **settings)


@dataclass(frozen=True)
class Seen:
    """Makes an environment of MiniGrid one of zeros and ones, and of some actions."""

    actions: tuple[int, ...]

    def __call__(self, env: gym.Env) -> gym.Env:
        few = gym.spaces.Discrete(len(self.actions))
        seen = cr.interop.MiniGridView()(env)
        return gym.wrappers.TransformAction(seen, self.actions.__getitem__, few)


class Coarse(gym.Wrapper):
    """An environment of classic control on a grid of states; each action is held for some steps."""

    def __init__(self, name: str, ends: Sequence[tuple[float, float]], points: int, held: int):
        super().__init__(gym.make(name).unwrapped)
        self.axes = [np.linspace(*each, points) for each in ends]
        self.held = held

    def reset(self, **given):
        _, info = self.env.reset(**given)
        return self._rounded(), info

    def step(self, action):
        for _ in range(self.held):
            _, reward, terminated, truncated, info = self.env.step(action)
            if terminated:
                break
        return self._rounded(), reward, terminated, truncated, info

    def _rounded(self):
        env = self.unwrapped
        pairs = zip(self.axes, env.state, strict=True)
        env.state = np.array([axis[np.abs(axis - x).argmin()] for axis, x in pairs])
        return env._get_ob() if hasattr(env, "_get_ob") else env.state.astype(np.float32)


def coarse(name: str, ends, *, points: int, held: int) -> cr.tasks.ObservationTask:
    """Return an environment of classic control on a grid, as a miniature of the one it is of."""
    return cr.observation_task(partial(Coarse, name, ends, points, held), discount=0.99)


class Target(NamedTuple):
    """A target, and its small relatives."""

    task: Callable[[], cr.tasks.ObservationTask]
    members: Callable[[], list[cr.tasks.ObservationTask]]
    sampled: bool = True
    """Whether actions are drawn where it is evaluated; not where nothing is hidden."""


def levels(target: str, *members: str, actions: tuple[int, ...]) -> Target:
    return Target(
        partial(level, target, actions), lambda: [level(name, actions) for name in members]
    )


def rooms() -> list[cr.tasks.ObservationTask]:
    """Return two rooms, of sides up to 4 and up to 5."""
    return [level("MultiRoom-N2-S4-v0", OPEN, maxRoomSize=side) for side in (4, 5)]


WALK, OPEN, FETCH, CARRY = (0, 1, 2), (0, 1, 2, 5), (0, 1, 2, 3, 5), (0, 1, 2, 3, 4, 5)
CAR = ((-1.2, 0.6), (-0.07, 0.07))
ACROBOT = ((-np.pi, np.pi),) * 2 + ((-2 * np.pi, 2 * np.pi), (-4.5 * np.pi, 4.5 * np.pi))
"""Ends of position and velocity, or of two angles and their velocities."""
TARGETS = {
    "crossing 9": levels("SimpleCrossingS9N3-v0", "SimpleCrossingS9N1-v0", actions=WALK),
    "crossing 11": levels("SimpleCrossingS11N5-v0", "SimpleCrossingS9N1-v0", actions=WALK),
    "lava": levels("LavaCrossingS9N3-v0", "LavaCrossingS9N1-v0", actions=WALK),
    "rooms": Target(partial(level, "MultiRoom-N4-S5-v1", OPEN), rooms),
    "door": levels("DoorKey-8x8-v0", "DoorKey-5x5-v0", "DoorKey-6x6-v0", actions=FETCH),
    "corridor": levels("KeyCorridorS3R2-v0", "KeyCorridorS3R1-v0", actions=CARRY),
    "car": Target(
        lambda: cr.observation_task("MountainCar-v0", discount=0.99),
        lambda: [
            cr.observation_task(partial(Coarse, "MountainCar-v0", CAR, 150, 2), discount=0.99)
        ],
        sampled=False,
    ),
}
"""What is reported."""
DEVELOPMENT = {
    "crossing 2": levels("SimpleCrossingS9N2-v0", "SimpleCrossingS9N1-v0", actions=WALK),
    "gap": levels("LavaGapS7-v0", "LavaGapS5-v0", "LavaGapS6-v0", actions=WALK),
    "small door": levels("DoorKey-6x6-v0", "DoorKey-5x5-v0", actions=FETCH),
    "acrobot": Target(
        lambda: cr.observation_task("Acrobot-v1", discount=0.99),
        lambda: [coarse("Acrobot-v1", ACROBOT, points=15, held=5)],
        sampled=False,
    ),
}
"""What settings are chosen on."""
ALL = {**TARGETS, **DEVELOPMENT}


def from_scratch(learner, target: Target) -> cr.Curriculum:
    return plan(target, {}, [], {"target": learner})


def distilled(shaping, target: Target, *, learner=PPO, shuffled=False) -> cr.Curriculum:
    small = replace(miniatures(*target.members()), shuffled=shuffled)
    learners = {"small": learner, "target": learner}
    return plan(target, {"small": small}, [cr.Transfer("small", "target")], learners, shaping)


def weights_of_steps(target: Target) -> cr.Curriculum:
    """Return the plan of a network that learns the last of the small relatives by steps first."""
    tasks = {"small": target.members()[-1]}
    learners = {"small": PPO, "target": PPO}
    source = {"small": cr.StoppingRule(SOURCE)}
    edges = [cr.Transfer("small", "target")]
    return plan(target, tasks, edges, learners, WeightTransfer(), source, BUDGET - SOURCE)


def plan(
    target: Target, tasks, edges, learners, shaping=None, source=None, budget=BUDGET
) -> cr.Curriculum:
    off = dict.fromkeys(tasks, cr.GreedyEvaluation("off"))
    evaluation = cr.GreedyEvaluation(episodes=EPISODES, sampled=target.sampled)
    return cr.Curriculum(
        {**tasks, "target": target.task()}, edges, learner=learners,
        shaping={"target": shaping} if shaping else None,
        budget={**(source or {}), "target": budget}, eval_freq={"target": EVAL_FREQ},
        evaluation={**off, "target": evaluation},
    )  # fmt: skip


SCRATCH = {"PPO": partial(from_scratch, PPO), "DQN": partial(from_scratch, DQN)}
ARMS = {
    **SCRATCH,
    "distilled": partial(distilled, None),  # the default: the whole network, kl 0.1
    "distilled, placebo": partial(distilled, None, shuffled=True),
    "kl 0": partial(distilled, WeightTransfer()),
    "kl 1": partial(distilled, WeightTransfer(kl=1.0)),
    "actor": partial(distilled, PolicyReuse()),
    "actor, kl 1": partial(distilled, PolicyReuse(kl=1.0)),
    "shaped": partial(distilled, cr.StateShaping()),
    "weights of steps": weights_of_steps,
    "DQN, residual": partial(distilled, cr.QInitialisation(), learner=DQN),
}


def job(target: str, arm: str, seed: int, out: Path) -> dict:
    """Return the curve of one run, from its file if it is there."""
    return trained(partial(ARMS[arm], ALL[target]), f"{target} {arm}", seed, out)


def curves(target: str, arm: str, options) -> cr.statistics.Curve | None:
    """Return the curves of an arm over total steps; None if a seed is missing."""
    name = f"{target} {arm}"
    if not all(place(name, seed, options.out).exists() for seed in range(options.seeds)):
        return None
    return curve_of(name, options.seeds, options.out)


def areas(curve: cr.statistics.Curve) -> np.ndarray:
    """Return the mean return of each seed over all steps, (K,): its first return while charged."""
    charged = curve.source_steps[0] // EVAL_FREQ
    values = np.pad(curve.values, ((0, 0), (charged, 0)), "edge")
    values = values[:, : BUDGET // EVAL_FREQ + 1]
    return np.trapezoid(values, axis=1) / (values.shape[1] - 1)


def tell(options) -> None:
    """Print the table of each target."""
    for target in options.targets:
        found = {arm: curves(target, arm, options) for arm in options.arms}
        found = {arm: curve for arm, curve in found.items() if curve is not None}
        scratch = [arm for arm in SCRATCH if arm in found]
        if not scratch:
            continue
        best = max(scratch, key=lambda arm: areas(found[arm]).mean())
        print(f"\n{target}: best from scratch {best}; {options.seeds} seeds")
        print(f"{'arm':<28}{'start':>8}{'area':>24}{'end':>24}{'gain':>24}")
        for arm, curve in found.items():
            area = areas(curve)
            gain = shown(area - areas(found[best])) if arm != best else ""
            print(
                f"{arm:<28}{curve.values[:, 0].mean():>8.2f}{shown(area):>24}"
                f"{shown(curve.values[:, -1]):>24}{gain:>24}"
            )


def shown(values: np.ndarray) -> str:
    if len(values) < 2:
        return f"{values.mean():.2f}"
    interval = cr.statistics.mean_interval(values)
    return f"{interval.estimate:.2f} [{interval.low:.2f}, {interval.high:.2f}]"


def price(target: str) -> str:
    """Return what the miniatures of a target cost."""
    began = time.process_time()
    small = miniatures(*ALL[target].members())
    known = small.knowledge()
    solved = time.process_time() - began
    begun_fit = time.process_time()
    values = distil(known, ALL[target].task(), PPO)
    fitted = time.process_time() - begun_fit
    each = small.examined(values)
    told = ", ".join(f"{one.regained:.0%} of {one.levels} levels" for one in each)
    return (
        f"{target}: {known.states.sum():,} states, {known.alike:.0%} look alike; "
        f"{small.transitions:,} steps of models, {solved:.0f} s; distilled in {fitted:.0f} s; "
        f"regains on held-out levels {told}"
    )


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    given.add_argument("--targets", nargs="*", default=list(TARGETS), choices=list(ALL))
    given.add_argument("--arms", nargs="*", default=list(ARMS), choices=list(ARMS))
    given.add_argument("--seeds", type=int, default=5)
    given.add_argument("--workers", type=int, default=2)
    given.add_argument("--out", type=Path, default=folder("deep_miniatures"))
    given.add_argument("--table", action="store_true", help="print what is there, train nothing")
    given.add_argument("--price", action="store_true", help="print what the miniatures cost")
    options = given.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.price:
        for target in options.targets:
            print(price(target), flush=True)
    elif not options.table:
        run(options)
    if not options.price:
        tell(options)


def run(options) -> None:
    """Train what is not there yet; arms that fail are told at the end."""
    jobs = [
        (target, arm, seed)
        for seed in range(options.seeds)
        for arm in options.arms
        for target in options.targets
    ]
    # Torch does not survive a fork.
    with cr.study.WorkerProcesses(options.workers) as pool:
        running = {pool.submit(job, *one, options.out): one for one in jobs}
        for done in as_completed(running):
            error = done.exception()
            what = f"failed, {error}" if error else f"final {done.result()['greedy'][-1]:.2f}"
            print(*running[done], what, flush=True)


if __name__ == "__main__":
    main()
