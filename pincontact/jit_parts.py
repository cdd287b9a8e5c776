"""Compilation of kernels that only other kernels call, and of those that call them.

Numba optimises and emits machine code for every function of its own accord, also for those that are only ever inlined
into others, and links each function's callees into it, theirs included, time and again; here that is half of the time a
user waits for the first run. A part is therefore typed and lowered only. An entry kernel links all parts that it
reaches, each once, and optimises them together. This uses classes of numba that are not documented: where they are
missing or have changed, `PartCompiler` and `EntryCompiler` are None and everything is compiled in the ordinary way.
"""

from __future__ import annotations

import weakref
from typing import Any

PartCompiler: Any = None
EntryCompiler: Any = None

try:
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import CompilerBase, DefaultPassBuilder
    from numba.core.compiler_machinery import register_pass
    from numba.core.typed_passes import NativeLowering

    class _PartLibrary(JITCodeLibrary):
        """Code that waits to be linked into an entry kernel's."""

        def _optimize_functions(self, module: Any) -> None:
            module.data_layout = self._codegen._data_layout

        def finalize(self) -> None:
            self._raise_if_finalized()
            self._finalize_dynamic_globals()
            self._final_module.__library = weakref.proxy(self)
            self._finalized = True

    class _EntryLibrary(JITCodeLibrary):
        """An entry kernel's code, into which every part that it reaches is linked."""

        _linking_libraries: list[Any]

        def finalize(self) -> None:
            reached: dict[Any, None] = dict.fromkeys(self._linking_libraries)
            waiting: list[Any] = list(reached)
            while waiting:
                library = waiting.pop()
                if isinstance(library, _PartLibrary):
                    fresh = [part for part in library._linking_libraries if part not in reached]
                    reached.update(dict.fromkeys(fresh))
                    waiting += fresh
            self._linking_libraries = list(reached)
            super().finalize()

        def _optimize_final_module(self) -> None:
            # numba's first, cheaper pass serves reference counting, of which there is none here
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)

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

    @register_pass(mutates_CFG=True, analysis_only=False)
    class _EntryLowering(NativeLowering):
        _name = "entry_lowering"

        def run_pass(self, state: Any) -> bool:
            state.library = _EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
            return super().run_pass(state)

    def _with_lowering(lowering: Any) -> Any:
        """Numba's pipeline with its lowering replaced."""

        class Compiler(CompilerBase):
            def define_pipelines(self) -> list[Any]:
                passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
                passes.add_pass_after(lowering, NativeLowering)
                passes.passes = [entry for entry in passes.passes if entry[0] is not NativeLowering]
                passes.finalize()
                return [passes]

        return Compiler

    PartCompiler, EntryCompiler = _with_lowering(_PartLowering), _with_lowering(_EntryLowering)
except (ImportError, AttributeError):
    pass
