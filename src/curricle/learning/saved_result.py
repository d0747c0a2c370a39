"""What the file of a saved result says of its task and its learner, in plain JSON."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
from curricle.learning.optimistic_learning import OptimisticQLearning
from curricle.learning.result_arrays import Arrays, check_result_arrays, check_value_arrays
from curricle.learning.schedules import Schedule
from curricle.tasks.observation_task import is_observation_task
from curricle.tasks.task import generative_model

LEARNERS: dict[str, type[Learner]] = {
    kind.__name__: kind
    for kind in (QLearning, SARSA, ExpectedSARSA, DoubleQLearning, OptimisticQLearning)
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


def pairs_of(saved: SavedFile, record: Any, task: Any) -> tuple[int, int] | None:
    """Return the states and actions of values that were saved, those of the task if it is given.

    None where they are not known, or are observations. SettingError where the task has other spaces
    than `record`, which :func:`task_record` returned for the one that was learnt.
    """
    given, recorded = task_record(task), record if isinstance(record, Mapping) else {}
    if given and recorded and given["spaces"] != recorded.get("spaces"):
        raise SettingError(
            f"a result must be loaded with its own task: {saved.path} has "
            f"{recorded.get('spaces')}, the task has {given['spaces']}"
        )
    pairs = (given or recorded).get("pairs")
    return None if pairs is None else (int(pairs[0]), int(pairs[1]))


def check_saved_arrays(arrays: Arrays, pairs: tuple[int, int] | None) -> None:
    """Raise ValueError unless arrays are those of a result with so many states and actions."""
    if not (seeds := arrays["seeds"].tolist() if "seeds" in arrays else []):
        raise ValueError("it has no seeds")
    if pairs is None and "snapshot_values" in arrays:
        shown: Any = arrays["snapshot_values"].shape[1:]
        check_result_arrays(arrays, seeds, shown)
    else:
        check_result_arrays(arrays, seeds, pairs or (0, 0))
    check_value_arrays(arrays, len(seeds), pairs)


@contextmanager
def as_saved(saved: SavedFile) -> Iterator[None]:
    """Turn what reading a file's arrays and words may raise into a StoreError in one line."""
    try:
        yield
    except CurricleError:
        raise
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
        why = " ".join(f"{kind}{error}".split())
        raise StoreError(f"{saved.path} is not as save() writes it: {why}") from None


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
