"""How Numba compiles the parts of loops: to code that loops take in, and no further.

Numba optimises every function and makes machine code of it, also where it is only ever inlined.
Loops are made of dozens of such parts, and this would take a quarter of the time of compiling them.
Parts are kept as intermediate code instead, which is optimised with the loop that takes it in.
"""

from typing import Any

from numba import _dynfunc  # type: ignore[attr-defined]  # compiled, no stub
from numba.core import codegen, compiler, typed_passes
from numba.core.compiler_machinery import register_pass


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
