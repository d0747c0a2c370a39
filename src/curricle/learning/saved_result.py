"""What the file of a saved result says of its task and its learner, in plain JSON."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from curricle.archives.saved_file import SavedFile
from curricle.errors import CurricleError, SettingError, StoreError
from curricle.learning.learners import (
    SARSA,
    DoubleQLearning,
    ExpectedSARSA,
    Learner,
    QLearning,
)
from curricle.learning.optimistic_learners import OPIQ, UCBQLearning
from curricle.learning.result_arrays import Arrays, check_result_arrays, check_value_arrays
from curricle.learning.schedules import Schedule
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model

LEARNERS: dict[str, type[Learner]] = {
    kind.__name__: kind
    for kind in (QLearning, SARSA, ExpectedSARSA, DoubleQLearning, UCBQLearning, OPIQ)
}
"""Those that a file may name; nothing else is made of what it says."""


def task_record(task: Any) -> dict[str, Any]:
    """Return what tells whether a task fits values: its spaces in words, and their sizes.

    Examples
    --------
    >>> from curricle import GridWorld
    >>> task_record(GridWorld("S.T"))["pairs"]
    [3, 4]
    """
    if task is None:
        return {}
    if is_observation_task(task):
        return {"spaces": f"observations {task.observations}, actions {task.actions}"}
    rules = generative_model(task)
    spaces = f"states {rules.states}, actions {rules.actions}"
    return {"spaces": spaces, "pairs": [rules.states.size, rules.actions.size]}


def check_task(saved: SavedFile, record: Any, task: Any) -> None:
    """Raise SettingError unless a task has the spaces of the one that a file was saved for."""
    if task is None or not isinstance(record, Mapping) or "spaces" not in record:
        return
    if (given := task_record(task)["spaces"]) != record["spaces"]:
        raise SettingError(
            f"a result must be loaded with its own task: {saved.path} has {record['spaces']}, the "
            f"task has {given}"
        )


def check_saved_arrays(saved: SavedFile, arrays: Arrays, record: Any) -> None:
    """Raise StoreError unless arrays are those of a result of the task that was recorded."""
    try:
        given = record.get("pairs") if isinstance(record, Mapping) else None
        pairs = None if given is None else (int(given[0]), int(given[1]))
        seeds = arrays["seeds"].tolist() if "seeds" in arrays else []
        if not seeds:
            raise ValueError("it has no seeds")
        shown = arrays["snapshot_values"].shape[1:] if "snapshot_values" in arrays else (0, 0)
        check_result_arrays(arrays, seeds, (shown[0], shown[1]) if pairs is None else pairs)
        check_value_arrays(arrays, len(seeds), pairs)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise StoreError(f"{saved.path} is not as save() writes it: {error}") from None


def learner_record(learner: Any) -> dict[str, Any]:
    """Return a learner as JSON holds it: its class, and the settings of Curricle's own.

    Examples
    --------
    >>> learner_of(learner_record(QLearning(epsilon=0.2)))
    QLearning(learning_rate=0.1, epsilon=0.2, inverse_temperature=None, initial_value=0.0)
    """
    kind = type(learner)
    if LEARNERS.get(kind.__name__) is not kind:
        return {"type": kind.__name__}
    settings = {one.name: getattr(learner, one.name) for one in fields(learner)}
    return {
        "type": kind.__name__,
        "settings": {
            name: {"schedule": list(value)} if isinstance(value, Schedule) else value
            for name, value in settings.items()
        },
    }


def learner_of(record: Any) -> Learner | None:
    """Return the learner of a record; None where it is none of Curricle's. ValueError if wrong."""
    if not isinstance(record, Mapping) or "settings" not in record:
        return None
    kind = LEARNERS.get(record.get("type", ""))
    if kind is None or not isinstance(record["settings"], Mapping):
        raise ValueError(f"a learner must be one of {', '.join(LEARNERS)}: got {record}")
    try:
        return kind(**{name: _setting(value) for name, value in record["settings"].items()})
    except (TypeError, CurricleError) as error:
        raise ValueError(f"a learner must have its own settings: {error}") from None


def _setting(value: Any) -> Any:
    if isinstance(value, Mapping):
        shape, *numbers = value.get("schedule", ())
        return Schedule(int(shape), *map(float, numbers))
    return tuple(value) if isinstance(value, list) else value
