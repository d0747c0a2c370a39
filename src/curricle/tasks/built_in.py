"""The families and domains that come with the library, by name: those among the public names."""

from curricle import tasks
from curricle.tasks.domain import Domain, name_of
from curricle.tasks.family import TaskFamily

_PUBLIC = [getattr(tasks, name) for name in dir(tasks)]
BUILT_IN: dict[str, TaskFamily] = {
    family.name: family for family in _PUBLIC if isinstance(family, TaskFamily)
}
"""Name -> family."""
DOMAINS: dict[str, type[Domain]] = {
    name_of(kind): kind for kind in _PUBLIC if isinstance(kind, type) and issubclass(kind, Domain)
}
"""Name -> domain."""
