"""Keys of study files and flags of the command that have another name since 0.2.0.

An old name is refused, and the error says the new one. This is the only list of them.
"""

from collections.abc import Iterator
from typing import Any

from curricle.study.config.tables import KeyPath

STUDY, SETTING, TASK, FLAG = "study", "setting", "task", "flag"
"""Where a name stands: at the top level; wherever settings do; in a task's table; as a flag."""

RENAMED: dict[tuple[str, str], str] = {
    (STUDY, "block"): "seeds_per_unit",
    (STUDY, "frames"): "snapshots",
    (STUDY, "direct"): "scratch",
    (SETTING, "how"): "shaping",
    (SETTING, "how = initialise"): 'shaping = "QInitialisation"',
    (SETTING, "how = look_ahead"): 'shaping = "LookAheadAdvice"',
    (SETTING, "how = look_back"): 'shaping = "LookBackAdvice"',
    (SETTING, "how = state"): 'shaping = "StateShaping"',
    (SETTING, "how = advice"): 'shaping = "DecayingAdvice"',
    (SETTING, "how = bonus"): 'shaping = "RewardBonus"',
    (SETTING, "how = weights"): 'shaping = "WeightTransfer"',
    (SETTING, "how = policy"): 'shaping = "PolicyReuse"',
    (SETTING, "guard"): 'guard inside shaping, such as { type = "QInitialisation", guard = true }',
    (SETTING, "shaping.guard.least"): "min_share",
    (SETTING, "shaping.guard.sure"): "standard_errors",
    (SETTING, "back"): "retrain",
    (SETTING, "retrain.lost"): "drop",
    (SETTING, "retrain.again"): "steps",
    (SETTING, "retrain.most"): "times",
    (SETTING, "retrain.evaluations"): "patience",
    (SETTING, "every"): "eval_freq",
    (SETTING, "budget.most"): "max_steps",
    (SETTING, "budget.least"): "min_steps",
    (SETTING, "budget.value"): "threshold",
    (SETTING, "budget.lost"): "drop",
    (SETTING, "budget.evaluations"): "patience",
    (SETTING, "storage.keep"): "save_values",
    (SETTING, "storage.memory"): "memory_limit",
    (TASK, "type = observed"): 'type = "observation_task"',
    (FLAG, "--node"): "--task",
}
"""Where a name stood, and the name -> what to write now. A name is a key, a dotted key inside a
table, or a key with a value."""


def renamed_keys(study: dict[str, Any]) -> Iterator[tuple[KeyPath, str]]:
    """Yield the path of each old key in a study as read, and what is to be said of it."""
    tasks, arms = _tables(study, "tasks"), _tables(study, "arms")
    tables: list[tuple[KeyPath, dict[str, Any], tuple[str, ...]]] = [((), study, (STUDY, SETTING))]
    tables += [(("tasks", name), one, (TASK, SETTING)) for name, one in tasks.items()]
    for arm, patch in arms.items():
        tables.append((("arms", arm), patch, (SETTING,)))
        for name, one in _tables(patch, "tasks").items():
            tables.append((("arms", arm, "tasks", name), one, (TASK, SETTING)))
    for place, table, kinds in tables:
        found: dict[KeyPath, str] = {}
        for (kind, old), new in RENAMED.items():
            key, _, value = old.partition(" = ")
            path = tuple(key.split("."))
            node = _at(table, path) if kind in kinds else None
            if node is not None and value in ("", node):
                found[path] = new  # a row with a value comes after that of its key
        for at, new in found.items():
            yield (*place, *at), f"was renamed: write {new}"


def renamed_flag(flag: str) -> str | None:
    """Return the name that a flag of the command has now; None if it never had another.

    Examples
    --------
    >>> renamed_flag("--node")
    '--task'
    """
    return RENAMED.get((FLAG, flag))


def _tables(node: dict[str, Any], key: str) -> dict[str, dict[str, Any]]:
    tables = node.get(key)
    each = tables.items() if isinstance(tables, dict) else ()
    return {name: one for name, one in each if isinstance(one, dict)}


def _at(node: Any, path: tuple[str, ...]) -> Any:
    """Return what is at a path; None where there is nothing."""
    for key in path:
        node = node.get(key) if isinstance(node, dict) else None
    return node
