"""Keys of study files and flags of the command that have another name since 0.2.0.

An old name is refused, and the error says the new one. This is the only list of them.
"""

from collections.abc import Iterator
from functools import reduce
from typing import Any

from curricle.study.config.merging import SETTINGS
from curricle.study.config.tables import KeyPath, table
from curricle.study.config.tasks import TASKS

STUDY, SETTING, TASK, FLAG = "study", "setting", "task", "flag"
"""Where a name stands: at the top level; wherever settings do; in a task's table; as a flag."""

SHARES = "share_behind and share_ahead, which say how far a guard may go"
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
    (SETTING, "shaping.guard.least"): "share_behind",
    (SETTING, "shaping.guard.share"): SHARES,
    (SETTING, "shaping.guard.pace"): SHARES,
    (SETTING, "shaping.guard.sure"): SHARES,
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
    """Yield the path of each old key in a study as read, and the sentence about it.

    A parameter that happens to be called as a setting was, such as `back` of a river, is none.
    """
    tables: list[tuple[KeyPath, Any, tuple[str, ...]]] = [((), study, (STUDY, SETTING))]
    tables.append((("sweep",), study.get("sweep"), (SETTING,)))
    tables.append((("tune", "space"), table(study.get("tune")).get("space"), (SETTING,)))
    tasks = table(study.get("tasks"))
    for name, task in tasks.items():
        tables.append((("tasks", name), _without_parameters(task, task), (TASK, SETTING)))
    for arm, patch in table(study.get("arms")).items():
        tables.append((("arms", arm), patch, (SETTING,)))
        for name, task in table(table(patch).get("tasks")).items():
            own = _without_parameters(task, {**table(tasks.get(name)), **table(task)})
            tables.append((("arms", arm, "tasks", name), own, (TASK, SETTING)))
    for place, one, kinds in tables:
        found: dict[KeyPath, str] = {}
        for (kind, old), new in RENAMED.items():
            key, _, value = old.partition(" = ")
            path = tuple(key.split("."))
            node = reduce(lambda inner, part: table(inner).get(part), path, one)
            if kind in kinds and node is not None and value in ("", node):
                found[path] = new  # a row with a value comes after that of its key
        for at, new in found.items():
            yield (*place, *at), f"was renamed: write {new}"


def _without_parameters(task: Any, whole: Any) -> dict[str, Any]:
    """Return a task's table without keys that are parameters of its type, or of its family."""
    whole = table(whole)
    if "family" in whole:  # which is younger than all renamed keys
        return {key: value for key, value in table(task).items() if isinstance(value, dict)}
    kinds = (one for one in TASKS if one.model_fields["type"].default == whole.get("type"))
    parameters = {key for one in kinds for key in one.known()} - {"type", *SETTINGS}
    return {key: value for key, value in table(task).items() if key not in parameters}
