"""The families that come with the library, by name."""

from curricle.tasks.families.family import TaskFamily
from curricle.tasks.families.mazes import maze_family
from curricle.tasks.families.pursuits import pursuit_family

BUILT_IN: dict[str, TaskFamily] = {one.name: one for one in (maze_family, pursuit_family)}
"""Name -> family."""
