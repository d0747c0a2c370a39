"""What becomes of public environments: live tasks, tables, or a refusal whose way out is followed.

pip install minigrid gym-classics gym-simplegrid edugrid box2d
pip install git+https://github.com/sparisi/gym_gridworlds
python -m benchmarks.public_ids [ID ...] > docs/public_environments.md
"""

import importlib
import re
import sys
import time
from collections import Counter
from contextlib import suppress
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import registry
from gymnasium.wrappers import Autoreset, DiscretizeAction

import curricle as cr
from curricle.interop import Bins, DeepCopy
from curricle.interop.gymnasium import observation_task

PACKAGES = "minigrid", "gym_classics", "gym_gridworlds", "gym_simplegrid", "edugrid"
WANTED = r"^gymnasium.envs.(toy|classic|box2d)|^minigrid(?!.*(babyai|wfc))|^gym_|^edugrid"
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

{} environments, each as `from_gymnasium(id)`, which is learnt for 200 steps, and as
`tabulate(id, max_seconds=20)`. Where neither takes it, or a count of steps is in the way, the way
out that the refusal names was followed; the last column has the result. Of MiniGrid it is one of
each class. `python -m benchmarks.public_ids` makes this page.

| ids | `from_gymnasium` | `tabulate` | states | way out |
|---|---|---|---|---|"""


def binned(make: Any) -> Bins:
    """Return four bins for each number that random play shows."""
    env = Autoreset(make())
    env.reset(seed=0)
    seen = [env.step(env.action_space.sample())[0] for _ in range(STEPS)]
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
    if "required positional argument" in said:  # SimpleGrid's
        return f"`obstacle_map=[...]`: {played(name, obstacle_map=['000', '010', '000'])[0]}"
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
        way_out = followed(name, said)
    return (*cells, way_out), size


def page_of(results: dict[str, tuple[tuple[str, ...], int]]) -> str:
    """Return the page, on which ids of equal results share a row."""
    lines = [PAGE.format(len(results))]
    for cells, count in Counter(cells for cells, _ in results.values()).most_common():
        alike = {name: size for name, (of_name, size) in results.items() if of_name == cells}
        ends = dict.fromkeys(
            f"{end(alike.values()):,}" for end in (min, max) if any(alike.values())
        )
        row = [
            f"{count}: {', '.join(f'`{name}`' for name in alike)}",
            *cells[:2],
            " to ".join(ends),
        ]
        lines.append(f"| {' | '.join([*row, *cells[2:]])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    gym.logger.min_level = 50
    for package in PACKAGES:
        importlib.import_module(package)
    importlib.import_module("gym_classics").register("gymnasium")
    entries = {name: str(spec.entry_point) for name, spec in registry.items()}
    first = {at: name for name, at in reversed(entries.items())}  # of MiniGrid one of each class
    wanted = {n: at for n, at in entries.items() if re.search(WANTED, at)}
    ids = [n for n, at in wanted.items() if at[:8] != "minigrid" or n == first[at]]
    print(page_of({name: row_of(name) for name in sys.argv[1:] or ids}))
