"""Pictures of tasks in a notebook: IPython finds them by the names of classes."""

import sys
from collections.abc import Callable
from typing import Any, Protocol

CLASSES = {
    "FiniteMDP": "curricle.tasks.mdp",
    "Domain": "curricle.tasks.domain",
    "LiveMDP": "curricle.tasks.live",
    "TaskWithStart": "curricle.tasks.start_states",
    "TabulatedTask": "curricle.interop.tabulated_task",
}
"""Class -> its module; subclasses are drawn, too."""


class Formatter(Protocol):
    """A formatter of IPython's."""

    def for_type_by_name(
        self, module: str, name: str, draw: Callable[[Any], str | None], /
    ) -> object:
        """Have instances of a class drawn by a function."""


def register() -> None:
    """Have IPython draw tasks whose states lie on a grid; without IPython do nothing."""
    ipython = sys.modules.get("IPython")
    if ipython is not None and (shell := ipython.get_ipython()) is not None:
        register_with(shell.display_formatter.formatters["text/html"])


def register_with(formatter: Formatter) -> None:
    """Have a formatter of IPython's draw them as HTML."""
    for name, module in CLASSES.items():
        formatter.for_type_by_name(module, name, _drawn)


def _drawn(task: object) -> str | None:
    from curricle.pictures.scenes import in_a_notebook  # when a task is shown, not with the library

    return in_a_notebook(task)  # type: ignore[arg-type]
