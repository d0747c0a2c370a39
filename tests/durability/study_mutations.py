"""Study files with a few things wrong: a seeded stream of mutations of valid ones."""

import copy
import json
import math
import random
import re
import tomllib
from pathlib import Path

import curricle

ROOT = Path(__file__).parents[2]
TEMPLATES = Path(curricle.__file__).parent / "study/templates"
STUDIES = sorted(
    path
    for folder in (TEMPLATES, ROOT / "examples")
    for path in folder.rglob("*.toml")
    if path.stem != "acrobot"
)
"""Every template and every example, but for the example whose miniature takes minutes to solve."""

NUMBERS = [0, -1, 1, 2, 3, 7, 100, 10**6, 10**9, 2**31, 2**63, -(2**63), 2**64, 10**40, 10**5000]
FLOATS = [0.0, -0.0, 0.5, -1.5, 1e-320, 1e300, 1e308, -1e308, math.inf, -math.inf, math.nan]
WORDS = [
    "", " ", "x" * 300, "é" * 300, r"$\frac{a$", "$x$", "_" * 3, "%s%n", "../../up", "/etc/passwd",
    "/dev/zero", "a/b", ".", "nul\0", "bell\a", "\u202egnp.exe", "\u2066x\u2069", "\u200b",
    "\ufeff", "\U0001f996", "<script>alert(1)</script>", "{}", "a\nb", "none", "auto",
    "FrozenLake-v99", "Nowhere-v0", "FrozenLake-v1", "CartPole-v1", "Taxi-v3", "module:Env-v0",
    "os:nowhere", "nowhere:nothing", "math:hypot", "builtins:int", "builtins:dict", "cart:",
    ":corridor", "a:b:c", "S..T", "S\nT", "#", "ST" * 5000, "16x16", "QLearning", "linear",
    "exponential", "harmonic", "identity", "same_position", "relative_objects", "StateShaping",
    "PolicyReuse", "gymnasium", "pursuit", "maze", "crop", "factory",
    "observation_task", "deep", "0-10,3", "0-" + "9" * 18,
]  # fmt: skip
KEYS = [
    "epsilon", "inverse_temperature", "learning_rate", "budget", "seeds", "time_limit", "discount",
    "size", "predators", "capture", "torus", "arguments", "id", "factory", "encode", "map",
    "file", "rows", "columns", "start", "ends", "rewards", "scale", "shift", "weight",
    "unmapped_value", "project", "mapping", "function", "observations", "actions", "status",
    "episodes", "method", "discounted", "storage", "save_values", "memory_limit", "precision",
    "snapshots", "threshold", "window", "scratch", "seeds_per_unit", "eval_freq", "aggregate",
    "shaping", "portfolio", "evaluation", "max_steps", "patience", "settled", "of", "type",
]  # fmt: skip
"""Keys that mean something somewhere."""
N = "a number"
ADDED = {
    "top": [
        {"seeds": N}, {"window": N}, {"snapshots": N}, {"threshold": N}, {"seeds_per_unit": N},
        {"budget": N}, {"eval_freq": N}, {"scratch": False},
    ],
    "task": [
        {"size": N}, {"predators": N}, {"capture": N}, {"time_limit": N}, {"discount": N},
        {"step_reward": N}, {"capture_reward": N}, {"torus": True},
        {"torus": "yes"}, {"moves": N}, {"rows": [N, N]}, {"columns": [0, N]}, {"budget": N},
        {"budget": {"episodes": N}}, {"budget": {"max_steps": N, "threshold": N}},
        {"budget": {"max_steps": N, "settled": N, "patience": N}}, {"eval_freq": N},
        {"evaluation": {"method": "rollouts", "episodes": N}}, {"evaluation": {"episodes": N}},
        {"storage": {"memory_limit": N}}, {"storage": {"precision": N}}, {"start": [[N, N]]},
        {"shaping": {"type": "RewardBonus", "weight": N}}, {"shaping": "StateShaping"},
        {"shaping": {"type": "QInitialisation", "portfolio": {"margin": N, "optimist": N}}},
        {"learner": {"learning_rate": {"type": "harmonic", "first": N, "last": N, "half": N}}},
        {"learner": {"epsilon": {"type": "exponential", "first": N, "last": N, "half": N}}},
        {"learner": {"inverse_temperature": N}}, {"learner": {"type": "SARSA", "epsilon": N}},
        {"rewards": {"pit": N, "treasure": N, "step": N}}, {"ends": ["pit"]}, {"id": "Taxi-v3"},
        {"arguments": {"map_name": "9x9"}}, {"arguments": {"nonsense": N}}, {"arguments": {}},
        {"arguments": {"desc": ["SF", "FG"]}}, {"arguments": {"desc": ["SFF", "FG"]}},
        {"arguments": {"max_episode_steps": N}}, {"arguments": {"render_mode": "human"}},
        {"arguments": {"places": N, "full": N}}, {"id": "CliffWalking-v1"}, {"acting": "first"},
        {"encode": "builtins:int"}, {"file": "/dev/zero"}, {"map": "S" + "." * 60 + "T"},
    ],
    "transfer": [
        {"scale": N}, {"shift": True}, {"shift": N}, {"unmapped_value": N}, {"project": {}},
        {"mapping": "same_position"}, {"mapping": "identity"}, {"mapping": "relative_objects"},
        {"function": "builtins:print"}, {"factory": "builtins:print"}, {"actions": [0, N]},
    ],
}  # fmt: skip
"""Whole settings that a table may have, each N to be drawn."""


def mutated(path: Path, seed: int) -> str:
    """Return the text of a study with one to three mutations that a seed draws."""
    rng = random.Random(f"{path.name} {seed}")
    text = path.read_text("utf-8")
    if rng.random() < 0.12:
        return _scrambled(text, rng)
    study = _quick(tomllib.loads(text))
    for _ in range(rng.choice([1, 1, 1, 1, 2])):
        rng.choice([_mutate, _mutate_number, _add])(study, rng)
    return toml(study)


def _quick(study):
    """Return a study with pursuits on small grids: a preview of the larger ones takes seconds."""
    for task in study["tasks"].values():
        if "size" in task:
            task["size"] = min(task["size"], 3)
    return study


def _scrambled(text: str, rng: random.Random) -> str:
    """Return a text with lines or characters lost, doubled, swapped or put in."""
    lines = text.splitlines()
    for _ in range(rng.randint(1, 3)):
        at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(5):
            case 0:
                del lines[at : at + rng.randint(1, 4)]
                lines = lines or [""]
            case 1:
                lines.insert(other, lines[at])
            case 2:
                lines[at], lines[other] = lines[other], lines[at]
            case 3:
                cut = rng.randint(0, len(lines[at]))
                lines[at] = (
                    lines[at][:cut] + rng.choice("\0\a\u202e\ufeff'\"[]{}=.#\\") + lines[at][cut:]
                )
            case _:
                lines[at] = re.sub(r"\d+", lambda _: _inline(rng.choice(NUMBERS)), lines[at])
    return "\n".join(lines)


def _mutate(study, rng):
    """Change one place of a study: a value, a key, or what is around it."""
    places = list(holders_and_keys(study))
    if not places:
        study["name"] = "x"
        return
    holder, key = rng.choice(places)
    match rng.randrange(12):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            holder[rng.choice([*WORDS, *KEYS])] = holder.pop(key)
        case 2 if isinstance(holder, dict):
            holder[rng.choice([*KEYS, *WORDS])] = _value(rng, study)
        case 3:
            holder[key] = _wrapped(holder[key], rng)
        case 4 if isinstance(holder[key], dict | list) and holder[key]:
            inner = holder[key]
            if isinstance(inner, list):
                inner.append(copy.deepcopy(rng.choice(inner)))
            else:
                inner[rng.choice(WORDS)] = copy.deepcopy(rng.choice(list(inner.values())))
        case 5 | 6 | 7 | 8 | 9 | 10 if not isinstance(holder[key], dict | list):
            holder[key] = _alike(holder[key], rng)
        case _:
            holder[key] = _value(rng, study)


def _mutate_number(study, rng):
    """Change one number of a study."""
    places = [
        place for place in holders_and_keys(study) if isinstance(place[0][place[1]], int | float)
    ]
    if places:
        holder, key = rng.choice(places)
        holder[key] = _alike(holder[key], rng)


def _add(study, rng):
    """Add one setting to the study, to a task or to a transfer."""
    tables = {"top": [study], "task": [], "transfer": study.get("transfers")}
    if isinstance(study.get("tasks"), dict):
        tables["task"] = list(study["tasks"].values())
    kind = rng.choice(["top", "task", "task", "task", "transfer"])
    table = rng.choice(tables[kind]) if isinstance(tables[kind], list) and tables[kind] else study
    if isinstance(table, dict):
        table.update(_drawn(rng.choice(ADDED[kind]), rng))


def _drawn(value, rng):
    """Return a value with each N in it drawn."""
    if isinstance(value, dict):
        return {key: _drawn(one, rng) for key, one in value.items()}
    if isinstance(value, list):
        return [_drawn(one, rng) for one in value]
    return rng.choice([*NUMBERS, *FLOATS, 1, 2, 3, 5, 10, 50, 0.1]) if value == N else value


def holders_and_keys(node):
    """Yield each table or list within a node, with each of its keys or positions."""
    entries = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in list(entries):
        yield node, key
        if isinstance(value, dict | list):
            yield from holders_and_keys(value)


def _alike(value, rng):
    """Return another value of the same type."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        near = [value + 1, value - 1, value * 2, value // 2, -value, value * 1000]
        return rng.choice(NUMBERS if rng.random() < 0.5 else near)
    if isinstance(value, float):
        near = [-value, value / 2, value * 2, value * 1000, value * 1e9, value * 1e100]
        return rng.choice(FLOATS if rng.random() < 0.5 else near)
    return rng.choice([*WORDS, str(value) * 100, str(value)[:-1], str(value).upper()])


def _value(rng, study):
    """Return any value at all."""
    match rng.randrange(8):
        case 0:
            return rng.choice(NUMBERS)
        case 1:
            return rng.choice(FLOATS)
        case 2:
            return rng.choice([True, False])
        case 3:
            return [rng.choice([*NUMBERS, *FLOATS]) for _ in range(rng.randint(0, 4))]
        case 4:
            return {rng.choice([*KEYS, *WORDS]): rng.choice([*NUMBERS, *FLOATS, *WORDS])}
        case 5:
            return copy.deepcopy(
                rng.choice([one[key] for one, key in holders_and_keys(study)] or [0])
            )
        case _:
            return rng.choice(WORDS)


def _wrapped(value, rng):
    """Return a value inside lists or tables, some deep, as TOML that nobody looks into."""
    text = value[0] if isinstance(value, tuple) else _inline(value)
    for _ in range(rng.choice([1, 1, 2, 30, 500, 3000])):
        text = f"[{text}]" if rng.random() < 0.5 else f"{{{rng.choice(KEYS)} = {text}}}"
    return (text,)


def toml(study) -> str:
    """Return a study as TOML, each top-level key on its line; deep nesting is no obstacle."""
    return "".join(f"{_key(key)} = {_inline(value)}\n" for key, value in study.items())


def _key(key):
    return json.dumps(key, ensure_ascii=False) if not re.fullmatch(r"[\w-]+", key, re.A) else key


def _inline(value):
    """Return a value as TOML, without recursion."""
    parts, open_ = [], [value]
    while open_:
        one = open_.pop()
        match one:
            case tuple():  # what is already TOML
                parts.append(one[0])
            case dict():
                items = [x for k, v in one.items() for x in ((f"{_key(k)} = ",), v, (", ",))]
                open_ += [("}",), *reversed(items[:-1]), ("{",)]
            case list():
                items = [x for v in one for x in (v, (", ",))]
                open_ += [("]",), *reversed(items[:-1]), ("[",)]
            case bool():
                parts.append(str(one).lower())
            case str():
                escaped = json.dumps(one, ensure_ascii=False).replace("\x7f", "\\u007f")
                parts.append(escaped)
            case int():
                parts.append(f"0x{one:x}" if one > 10**100 else str(one))
            case _:
                parts.append(repr(one) if isinstance(one, float) else json.dumps(str(one)))
    return "".join(parts)
