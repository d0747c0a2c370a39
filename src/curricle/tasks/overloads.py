"""Compiled functions whose body is chosen by the type of their first argument."""

from collections.abc import Callable
from typing import Any

from numba.extending import overload

from curricle.tasks.draws import INLINED


class Overloaded:
    """A function for compiled code with one body for each type of NamedTuple it may be given.

    The choice is made while the caller is compiled and costs nothing when it runs. Loops name the
    ``function``; a type gets its body with :meth:`body`, a decorator.

    Parameters
    ----------
    function : callable
        Its signature and docstring are what the bodies keep to; it is never run.
    outlined : bool
        Whether bodies are called, not compiled into their callers: those that run seldom.
    otherwise : callable, optional
        The body for types that have none of their own.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        outlined: bool = False,
        otherwise: Callable[..., Any] | None = None,
    ):
        self.function = function
        self._bodies: dict[type, Callable[..., Any]] = {}

        def choose(first: Any, *_: Any) -> Callable[..., Any] | None:
            return self._bodies.get(getattr(first, "instance_class", type(None)), otherwise)

        options: Any = {**INLINED, "forceinline": not outlined}
        overload(function, jit_options=options, strict=False)(choose)

    def body(self, kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """Return the decorator that makes a plain function the body for one type."""

        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            self._bodies[kind] = function
            return function

        return register
