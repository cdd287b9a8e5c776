"""Compilation of kernels that only other kernels call.

Numba optimises and emits machine code for every function of its own accord, also for those that are only ever inlined
into others; here that is a third of the time a user waits for the first run. A part is therefore typed and lowered
only, and optimised where it is linked into an entry kernel. This uses classes of numba that are not documented: where
they are missing or have changed, `PartCompiler` is None and parts are compiled in the ordinary way.
"""

from __future__ import annotations

import weakref
from typing import Any

PartCompiler: Any = None

try:
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import CompilerBase, DefaultPassBuilder
    from numba.core.compiler_machinery import register_pass
    from numba.core.typed_passes import NativeLowering

    class _PartLibrary(JITCodeLibrary):
        """Code that waits to be linked into another library."""

        def _optimize_functions(self, module: Any) -> None:
            module.data_layout = self._codegen._data_layout

        def _optimize_final_module(self) -> None:
            pass

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._final_module.__library = weakref.proxy(self)
            self._finalized = True

    @register_pass(mutates_CFG=True, analysis_only=False)
    class _PartLowering(NativeLowering):
        _name = "part_lowering"

        def run_pass(self, state: Any) -> bool:
            state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()

            def no_executable(library: Any, descriptor: Any, environment: Any) -> Any:
                library._ensure_finalized()
                # numba wants a builtin as entry point, and looks the function up by its identity
                return [].append

            state.targetctx.get_executable = no_executable
            try:
                return super().run_pass(state)
            finally:
                del state.targetctx.get_executable

    class _PartCompiler(CompilerBase):
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.add_pass_after(_PartLowering, NativeLowering)
            passes.passes = [entry for entry in passes.passes if entry[0] is not NativeLowering]
            passes.finalize()
            return [passes]

    PartCompiler = _PartCompiler
except (ImportError, AttributeError):
    pass
