"""Compilation of kernels that only other kernels call, and of those that call them.

Numba optimises and emits machine code for every function of its own accord, also for those that are only ever inlined
into others, and links each function's callees into it, theirs included, time and again. A part is therefore typed and
lowered only. An entry kernel links all parts that it reaches, each once, and optimises them together. Typing asks numba
but once what an operator gives for its arguments, passes that kernels have no use for are left out, and `jit_lowering`
writes an eighth of the instructions that numba would. Without all this a user would wait six times as long for the
first run. It uses classes of numba that are not documented: where they are missing or have changed, `PartCompiler` and
`EntryCompiler` are None and everything is compiled in the ordinary way.
"""

from __future__ import annotations

import copy
import operator
import weakref
from typing import Any

PartCompiler: Any = None
EntryCompiler: Any = None

try:
    from numba.core import types as numba_types
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import CompilerBase, _LowerResult
    from numba.core.compiler_machinery import LoweringPass, PassManager, register_pass
    from numba.core.funcdesc import PythonFunctionDescriptor
    from numba.core.typed_passes import NoPythonBackend, NopythonTypeInference, PreLowerStripPhis
    from numba.core.typing.context import Context as TypingContext
    from numba.core.untyped_passes import FixupArgs, GenericRewrites, IRProcessing, ReconstructSSA, TranslateByteCode

    from .jit_lowering import KernelLower, bare_context

    types: Any = numba_types
    _PLAIN = types.Number, types.Boolean, types.Array, types.SliceType, types.UniTuple, types.NoneType

    class _Typing(TypingContext):
        """Numba's typing context, which asks for a function's types of result but once.

        Numba tries all that an operator might mean, with strings and lists and sets, each time anew.
        """

        known: dict[Any, Any]

        def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
            if kws or not (isinstance(func, types.Function) or func is operator.getitem):
                return super().resolve_function_type(func, args, kws)
            args = tuple(args)
            plain = tuple([types.unliteral(argument) for argument in args])
            if all(isinstance(argument, _PLAIN) for argument in plain):
                # numba tries these first
                args = plain
            # functions live as long as numba
            key = id(func), args
            if key not in self.known:
                self.known[key] = super().resolve_function_type(func, args, kws)
            return self.known[key]

        def resolve_setitem(self, target: Any, index: Any, value: Any) -> Any:
            return self.resolve_function_type(self.resolve_value_type(operator.setitem), (target, index, value), {})

    _typing: dict[int, Any] = {}

    def _quick_typing(context: Any) -> Any:
        if id(context) not in _typing:
            quick = _typing[id(context)] = copy.copy(context)
            quick.__class__, quick.known = _Typing, {}
        return _typing[id(context)]

    class _PartLibrary(JITCodeLibrary):
        """Code that waits to be linked into an entry kernel's."""

        is_part = True

        _shared_module: Any

        def _optimize_functions(self, module: Any) -> None:
            module.data_layout = self._codegen._data_layout

        def finalize(self) -> None:
            self._raise_if_finalized()
            self._finalize_dynamic_globals()
            self._final_module.__library = weakref.proxy(self)
            self._finalized = True

        def _get_module_for_linking(self) -> Any:
            # numba's would be a copy, for code that is used as it is, too
            if self._shared_module is None:
                self._ensure_finalized()
                for function in self._final_module.functions:
                    if not function.is_declaration:
                        function.linkage = "linkonce_odr"
                self._shared_module = self._final_module
            return self._shared_module

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
            passes = self._codegen._module_pass_manager()
            if isinstance(passes, tuple):
                passes[0].run(self._final_module, passes[1])
            else:
                # LLVM's older pass manager, with numba before 0.62
                passes.run(self._final_module)

    class _Lowering(LoweringPass):
        """From typed code to LLVM's instructions, by `KernelLower`."""

        library: Any

        def __init__(self) -> None:
            LoweringPass.__init__(self)

        def run_pass(self, state: Any) -> bool:
            context, flags = state.targetctx, state.flags
            library = state.library = self.library(context.codegen(), state.func_id.func_qualname)
            library.enable_object_caching()
            descriptor = PythonFunctionDescriptor.from_specialized_function(
                state.func_ir, state.typemap, state.return_type, state.calltypes, mangler=context.mangler,
                inline=flags.forceinline, noalias=flags.noalias, abi_tags=[flags.get_mangle_string()],
            )  # fmt: skip
            entry = self.library is _EntryLibrary
            with context.push_code_library(library):
                lower = KernelLower(bare_context(context), library, descriptor, state.func_ir, state.metadata)
                lower.ordinary = context if entry else None
                lower.lower()
                if entry:
                    context.create_cpython_wrapper(library, descriptor, lower.env, lower.call_helper, False)
            if entry:
                called = context.get_executable(library, descriptor, lower.env)
                context.insert_user_function(called, descriptor, [library])
                # numba before 0.62 has none
                state.reload_init.extend(getattr(library, "_reload_init", ()))
            else:
                library._ensure_finalized()
                # numba wants a builtin as entry point, and looks the function up by its identity
                called = [].append
            state["cr"] = _LowerResult(descriptor, lower.call_helper, cfunc=called, env=lower.env)
            return True

    @register_pass(mutates_CFG=True, analysis_only=False)
    class _PartLowering(_Lowering):
        _name = "part_lowering"
        library = _PartLibrary

    @register_pass(mutates_CFG=True, analysis_only=False)
    class _EntryLowering(_Lowering):
        _name = "entry_lowering"
        library = _EntryLibrary

    def _with_lowering(lowering: Any) -> Any:
        """Numba's pipeline, of which kernels need few passes, with another lowering."""
        passes = (
            TranslateByteCode, FixupArgs, IRProcessing, GenericRewrites, ReconstructSSA, NopythonTypeInference,
            PreLowerStripPhis, lowering, NoPythonBackend,
        )  # fmt: skip

        class Compiler(CompilerBase):
            def define_pipelines(self) -> list[Any]:
                self.state.typingctx = _quick_typing(self.state.typingctx)
                manager = PassManager("kernel")
                for entry in passes:
                    manager.add_pass(entry, entry.__name__)
                manager.finalize()
                return [manager]

        return Compiler

    PartCompiler, EntryCompiler = _with_lowering(_PartLowering), _with_lowering(_EntryLowering)
except (ImportError, AttributeError):
    pass
