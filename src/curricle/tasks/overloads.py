"""Parts of compiled loops: inlined functions, overloads by type, whole loops."""

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

from numba import _dynfunc, config, njit  # type: ignore[attr-defined]  # compiled, no stub
from numba.core import codegen, compiler, typed_passes
from numba.core.compiler_machinery import register_pass
from numba.extending import overload

from curricle.errors import SettingError
from curricle.tasks.loop_cache import compiled_once, entered_from_python

if config.DISABLE_JIT:  # type: ignore[attr-defined]  # Numba sets it when it is imported
    raise SettingError(
        "loops must be compiled, as what Python would make of them gives no results: unset "
        "NUMBA_DISABLE_JIT"
    )

# Numba optimises every function and makes machine code of it, also where it is only ever inlined.
# Loops are made of dozens of such parts, and this would take a quarter of the time of compiling
# them. Parts are kept as intermediate code instead, which is optimised with the loop that takes it
# in.


class _Part(codegen.JITCodeLibrary):
    """The code of a part, for loops to link: not optimised as a whole, and no machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: there is no machine code."""
        self._ensure_finalized()
        return 0


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(typed_passes.NativeLowering):
    """Writes a function's intermediate code into a part."""

    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower the function; Python has no entry to it."""
        cpu = state.targetctx
        state.library = _Part(cpu.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        of, library = lowered.fndesc, state.library
        entry = _dynfunc.make_function(
            of.lookup_module(), of.unique_name, "", 0, lowered.env, (library,)
        )
        cpu.insert_user_function(entry, of, [library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


class PartCompiler(compiler.CompilerBase):
    """Numba's pipeline for functions that only compiled loops call."""

    def define_pipelines(self) -> list[Any]:
        """Return the pipeline."""
        builder = compiler.DefaultPassBuilder
        passes = builder.define_nopython_pipeline(self.state)
        passes.passes = [
            (_PartLowering, text) if one is typed_passes.NativeLowering else (one, text)
            for one, text in passes.passes
        ]
        passes._finalized = False
        passes.finalize()
        return [passes]


# -- functions with a body for each type -----------------------------------------------------------


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

    The function declares the signature and the docstring of all bodies; it is never run. Bodies
    are called instead of inlined where they are `outlined`, as those that seldom run. Types without
    a body of their own have that of `otherwise`.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        outlined: bool = False,
        otherwise: Callable[..., Any] | None = None,
    ):
        self.function = function
        self.bodies: dict[type, Callable[..., Any]] = {}

        def choose(first: Any, *_: Any) -> Callable[..., Any] | None:
            return self.bodies.get(getattr(first, "instance_class", type(None)), otherwise)

        options: Any = {**INLINED, "forceinline": not outlined}
        overload(function, jit_options=options, strict=False)(choose)

    def body(self, kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """Return the decorator that makes a plain function the body for one type."""

        def register(function: Callable[..., Any]) -> Callable[..., Any]:
            self.bodies[kind] = function
            return function

        return register


@cache
def compiled(loop: Callable[..., Any], users_code: bool) -> Any:
    """Return a loop compiled; cached on disk unless a user's functions are compiled into it."""
    return entered_from_python(loop) if users_code else compiled_once(loop)
