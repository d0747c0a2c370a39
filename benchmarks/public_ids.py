"""What becomes of public environments: live tasks, tables, or a refusal whose way out is followed.

Prints docs/public_environments.md. Packages that are missing are left out:

    pip install minigrid gym-classics gym-simplegrid edugrid box2d
    pip install git+https://github.com/sparisi/gym_gridworlds
    python -m benchmarks.public_ids > docs/public_environments.md
"""

import importlib
import re
import sys
import time
import warnings
from contextlib import suppress
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import registry
from gymnasium.wrappers import DiscretizeAction

import curricle as cr
from curricle.interop import Bins, DeepCopy
from curricle.interop.gymnasium import observation_task

PACKAGES = "minigrid", "gym_classics", "gym_gridworlds", "gym_simplegrid", "edugrid"
WANTED = r"toy_text|classic_control|box2d|^minigrid(?!.*(babyai|wfc))|^gym_|^edugrid"
SECONDS, STEPS, SHORT = 20, 200, 100  # of a table; of learning; limit where there is none
WHY = {
    "must be deterministic": "steps are random",
    "max_seconds": "its states are not found in time",
    "cannot be read|cannot be copied": "a part cannot be copied",
    "observations must be discrete": "observations are no whole numbers",
    "actions must be discrete": "actions are no whole numbers",
    "required positional argument": "an argument is missing",
}
PAGE = """# Which public environments work?

{n} environments of {packages} (of MiniGrid one of each class), each as `from_gymnasium(id)` (learnt
for {steps} steps) and as `tabulate(id, max_seconds={seconds})`. Where neither takes it, or a
count of steps is in the way, the way out that the refusal names was followed: the last column has
the result. `python -m benchmarks.public_ids` makes this page.

| ids | `from_gymnasium` | `tabulate` | states | way out |
|---|---|---|---|---|"""


def binned(make: Any) -> Bins:
    """Return four bins for each number that random play shows."""
    env, seen, over = make(), list[Any](), True
    for step in range(STEPS):
        if over:
            env.reset(seed=step)
        observed, _, ended, cut, _ = env.step(env.action_space.sample())
        seen, over = [*seen, observed], ended or cut
    ends = zip(np.min(seen, axis=0) - 1e-3, np.max(seen, axis=0) + 1e-3, strict=True)
    return Bins({f"number_{i}": np.linspace(*pair, 5) for i, pair in enumerate(ends)})


def played(environment: Any, **options: Any) -> tuple[str, int]:
    """Return what `from_gymnasium` makes of an environment, which is learnt, and its size."""
    task = cr.from_gymnasium(environment, discount=0.99, **options)
    if task.time_limit is None:
        task = cr.from_gymnasium(environment, discount=0.99, time_limit=SHORT, **options)
    cr.learn(task, budget=STEPS)
    return "its own table" if isinstance(task, cr.FiniteMDP) else "live", task.states.size


def tabulated(name: str, **options: Any) -> tuple[str, int]:
    """Return in how much time of a processor the states are found, and their number."""
    began = time.process_time()
    task = cr.tabulate(name, discount=0.99, max_seconds=SECONDS, **options)
    return f"under {1 if time.process_time() - began < 1 else 10} s", task.states.size


def followed(name: str, said: str) -> str:
    """Return the way out of refusals that works, followed as they say it."""
    if ignored := re.search(r"DeepCopy\(ignore=\[(.*?)\]\)", said):
        names = re.findall(r"'(.*?)'", ignored[1])
        seconds, states = tabulated(name, state=DeepCopy(ignore=names))
        return f"`ignore={names}`: {states} states, {seconds}"
    if "required positional argument" in said:
        return f"`obstacle_map='4x4'`: {played(name, obstacle_map='4x4')[0]}"
    actions = "`DiscretizeAction`, " * ("DiscretizeAction" in said)
    make = lambda: DiscretizeAction(gym.make(name), 3) if actions else gym.make(name)  # noqa: E731
    if len(make().observation_space.shape or ()) == 1:
        return f"{actions}`encode=Bins(...)`: {played(make, encode=binned(make))[0]}"
    with suppress(cr.CurricleError):
        if "samples=" in said:
            return f"`samples=8`: {tabulated(name, samples=8)[0]}"
    observation_task(name).environment().reset(seed=0)
    return "`observation_task`: for a network"


def row_of(name: str) -> tuple[tuple[str, ...], int]:
    """Return what an id is played as, tabulated as and helped by; and its number of states."""
    cells, said, size, way_out = list[str](), "", 0, ""
    for way in (played, tabulated):
        try:
            cell, size = way(name)
        except cr.CurricleError as error:
            reasons = (reason for part, reason in WHY.items() if re.search(part, str(error)))
            cell, said = f"refused: {next(reasons, str(error))}", f"{said} {error}"
        cells.append(cell)
    if "ignore=" in said or all(cell.startswith("refused") for cell in cells):
        try:
            way_out = followed(name, said)
        except Exception as error:  # the page says it
            way_out = f"NONE: {type(error).__name__}: {error}"
    return (*cells, way_out), size


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    gym.logger.min_level = 50
    for package in PACKAGES:
        with suppress(ImportError):
            importlib.import_module(package)
    importlib.import_module("gym_classics").register("gymnasium")
    entries = {name: str(spec.entry_point) for name, spec in registry.items()}
    ids = [n for n, at in entries.items() if re.search(WANTED, at.replace("gymnasium.envs.", ""))]
    classes = {entries[n]: n for n in reversed(ids)}  # of MiniGrid's levels the first of a class
    ids = [n for n in ids if not entries[n].startswith("minigrid") or n in classes.values()]
    rows = dict[tuple[str, ...], list[tuple[str, int]]]()
    for name in ids:
        cells, size = row_of(name)
        print(name, size, *cells, sep=" | ", file=sys.stderr, flush=True)
        rows.setdefault(cells, []).append((name, size))
    packages = ", ".join(["Gymnasium", *PACKAGES])
    print(PAGE.format(packages=packages, n=len(ids), steps=STEPS, seconds=SECONDS))
    for cells, members in sorted(rows.items(), key=lambda row: -len(row[1])):
        sizes = sorted({size for _, size in members})
        states = f"{sizes[0]:,} to {sizes[-1]:,}" if len(sizes) > 1 else f"{sizes[0] or '':,}"
        print("|", ", ".join(f"`{n}`" for n, _ in members), *cells[:2], states, cells[2], sep=" | ")
