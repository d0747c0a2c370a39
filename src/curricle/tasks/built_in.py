"""The families that come with the library, by name: those in the list of public names."""

from curricle import tasks
from curricle.tasks.family import TaskFamily

BUILT_IN: dict[str, TaskFamily] = {
    family.name: family
    for family in (getattr(tasks, name) for name in dir(tasks))
    if isinstance(family, TaskFamily)
}
"""Name -> family."""
