"""Parts of compiled loops: inlined functions, overloads by type, whole loops."""

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from numba import njit
from numba.extending import overload

from curricle.tasks.loop_cache import compiled_once, entered_from_python
from curricle.tasks.loop_parts import PartCompiler

Function = TypeVar("Function", bound=Callable[..., Any])

INLINED: Any = {
    "nogil": True,
    "forceinline": True,  # a call with arrays costs more than most of these functions do
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": PartCompiler,  # no machine code of their own either
    "_nrt": False,  # inlined functions make no arrays; counting references takes 80 ns a step
}
"""How a function is compiled into its callers, without an entry from Python."""
inlined = njit(**INLINED)
"""Compiles a function for loops. Python must not call it, as that would end the process."""


def compiled_as(body: Callable[..., Any]) -> Callable[[Function], Function]:
    """Return a decorator of a Python function that compiled code calls too, as `body`, inlined."""

    def register(function: Function) -> Function:
        overload(function, jit_options=INLINED, strict=False)(lambda *_: body)
        return function

    return register


class Overloaded:
    """A function for compiled code with one body for each type of NamedTuple it may be given.

    The body is chosen by the type of the first argument while the caller is compiled, so the
    choice costs nothing at run time. Loops call the ``function``; :meth:`body` is a decorator that
    registers the body for a type.

    Parameters
    ----------
    function : callable
        Declares the signature and the docstring of all bodies; it is never run.
    outlined : bool
        Whether bodies are called instead of inlined, for those that seldom run.
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


@cache
def compiled(loop: Callable[..., Any], users_code: bool) -> Any:
    """Return a loop compiled; cached on disk unless a user's functions are compiled into it."""
    return entered_from_python(loop) if users_code else compiled_once(loop)
