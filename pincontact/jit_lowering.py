"""Lowering of kernels: LLVM's instructions for the part of Python that kernels are written in.

Numba's own lowering serves all of Python: an array is passed around as a record of seven fields, each element is
reached through copies of it on the stack, each index may be negative, each call may raise. Of the instructions it
writes for kernels one in two hundred is arithmetic, and writing, parsing and optimising away the others is most of what
a user would wait for at the first run. Kernels do without: here

    an array is its address and its extents
    an index is not negative, unless it is a constant; a slice has no step and lies inside
    range has a constant step
    nothing raises, and a part returns its result as it is

What is not written out below, such as mathematical functions, is lowered by numba, and its arithmetic is numba's,
operation by operation. The classes of numba that this uses are not documented: `jit_parts` does without where they are
missing.
"""

from __future__ import annotations

import copy
import operator
from collections import defaultdict
from typing import Any, NamedTuple

from llvmlite import ir as ll
from numba.core import cgutils, ir
from numba.core import types as numba_types
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.callconv import CPUCallConv
from numba.core.cpu import CPUContext
from numba.core.datamodel.models import StructModel
from numba.core.errors import UnsupportedError
from numba.core.lowering import Lower

types: Any = numba_types
_INTEGER, _REAL, _BIT = ll.IntType(64), ll.DoubleType(), ll.IntType(1)
# What an entry kernel's code is called; its own name belongs to the way in from Python.
_BARE = ".bare"

_REAL_ARITHMETIC = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}
_INTEGER_ARITHMETIC = {
    operator.add: "add", operator.sub: "sub", operator.mul: "mul", operator.and_: "and_", operator.or_: "or_",
}  # fmt: skip
_COMPARISONS = {
    operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">=", operator.eq: "==", operator.ne: "!=",
}  # fmt: skip


class View(StructModel):
    """An array: the address of its first element and its extents; strides, in elements, where it has gaps."""

    def __init__(self, manager: Any, array: Any):
        extents = types.UniTuple(types.intp, array.ndim)
        members = [("data", types.CPointer(array.dtype)), ("shape", extents)]
        if array.layout != "C":
            members.append(("strides", extents))
        super().__init__(manager, array, members)


def make_view(context: Any, builder: Any, array: Any, data: Any, shape: list[Any], strides: list[Any] | None) -> Any:
    """A `View` of the array type: data, extents and strides in elements (of no account without gaps)."""
    view = ll.Constant(context.get_value_type(array), ll.Undefined)
    view = builder.insert_value(view, data, 0)
    for i, extent in enumerate(shape):
        view = builder.insert_value(view, extent, (1, i))
    if array.layout != "C":
        for i, stride in enumerate(strides or _strides(builder, shape)):
            view = builder.insert_value(view, stride, (2, i))
    return view


def _strides(builder: Any, shape: list[Any]) -> list[Any]:
    """Strides of an array without gaps."""
    strides = [ll.Constant(_INTEGER, 1)]
    for extent in reversed(shape[1:]):
        strides.insert(0, _times(builder, strides[0], extent))
    return strides


def _times(builder: Any, a: Any, b: Any) -> Any:
    if isinstance(a, ll.Constant) and isinstance(b, ll.Constant):
        return ll.Constant(_INTEGER, a.constant * b.constant)
    for one, other in ((a, b), (b, a)):
        if isinstance(one, ll.Constant) and one.constant in (0, 1):
            return other if one.constant else one
    return builder.mul(a, b, flags=("nsw",))


def _plus(builder: Any, a: Any, b: Any) -> Any:
    if isinstance(a, ll.Constant) and isinstance(b, ll.Constant):
        return ll.Constant(_INTEGER, a.constant + b.constant)
    for one, other in ((a, b), (b, a)):
        if isinstance(one, ll.Constant) and one.constant == 0:
            return other
    return builder.add(a, b, flags=("nsw",))


def _of_reals(builder: Any, function: Any, a: Any, b: Any) -> Any:
    """function(a, b), or None where it is none of these."""
    if function in _REAL_ARITHMETIC:
        return getattr(builder, _REAL_ARITHMETIC[function])(a, b)
    if function is operator.ne:
        return builder.fcmp_unordered("!=", a, b)
    return builder.fcmp_ordered(_COMPARISONS[function], a, b) if function in _COMPARISONS else None


def _of_integers(builder: Any, function: Any, a: Any, b: Any) -> Any:
    """function(a, b), or None where it is none of these."""
    if function in _INTEGER_ARITHMETIC:
        return getattr(builder, _INTEGER_ARITHMETIC[function])(a, b)
    return builder.icmp_signed(_COMPARISONS[function], a, b) if function in _COMPARISONS else None


def _is_passed(kind: Any) -> bool:
    """Whether an argument is given, and not a default, which the function called knows."""
    return not isinstance(kind, types.Omitted)


class _NoErrors(CPUCallConv):
    """Numba's calling convention, for calls of its own functions, where nothing is expected to fail."""

    def return_status_propagate(self, builder: Any, status: Any) -> None:
        self._end(builder)

    def return_user_exc(self, builder: Any, *arguments: Any, **keywords: Any) -> None:
        self._end(builder)

    @staticmethod
    def _end(builder: Any) -> None:
        trap = cgutils.get_or_insert_function(builder.module, ll.FunctionType(ll.VoidType(), []), "llvm.trap")
        builder.call(trap, [])
        builder.unreachable()


class _BareContext(CPUContext):
    """Numba's target with arrays as `View`."""

    def make_view(self, builder: Any, array: Any, data: Any, shape: list[Any]) -> Any:
        """An array without gaps, for intrinsics that make some."""
        return make_view(self, builder, array, data, shape, None)

    @property
    def call_conv(self) -> Any:
        return _NoErrors(self)

    def cast(self, builder: Any, value: Any, given: Any, wanted: Any) -> Any:
        if given == wanted:
            return value
        if isinstance(given, types.Array) and isinstance(wanted, types.Array):
            shape = [builder.extract_value(value, (1, i)) for i in range(given.ndim)]
            strides = None
            if given.layout != "C":
                strides = [builder.extract_value(value, (2, i)) for i in range(given.ndim)]
            return make_view(self, builder, wanted, builder.extract_value(value, 0), shape, strides)
        return super().cast(builder, value, given, wanted)


_managers: dict[int, Any] = {}


def bare_context(context: Any) -> Any:
    """The context that kernels are lowered in, from numba's."""
    bare = copy.copy(context)
    bare.__class__ = _BareContext
    manager = _managers.get(id(context))
    if manager is None:
        manager = _managers[id(context)] = context.data_model_manager.copy()
        manager.register(types.Array, View)
    bare.data_model_manager = manager
    return bare


def _as_view(ordinary: Any, bare: Any, builder: Any, kind: Any, value: Any) -> Any:
    """A value of numba's as one of kernels."""
    if isinstance(kind, types.Array):
        array = ordinary.make_array(kind)(ordinary, builder, value=value)
        shape, strides = cgutils.unpack_tuple(builder, array.shape), None
        if kind.layout != "C":
            steps = cgutils.unpack_tuple(builder, array.strides)
            strides = [builder.sdiv(step, array.itemsize) for step in steps]
        return make_view(bare, builder, kind, array.data, shape, strides)
    if isinstance(kind, types.BaseTuple):
        items = [_as_view(ordinary, bare, builder, k, builder.extract_value(value, i)) for i, k in enumerate(kind)]
        return bare.make_tuple(builder, kind, items)
    return value


# Values that most code takes apart again are kept in their parts until someone wants the whole.
class _Parts(tuple):
    """A tuple's, or those of a pair."""


class _Slice(NamedTuple):
    start: Any
    stop: Any


class _Range(NamedTuple):
    start: Any
    stop: Any
    step: int


class _Iterator(NamedTuple):
    place: Any
    stop: Any
    step: int


class KernelLower(Lower):
    """One kernel; with `ordinary`, numba's context, an entry kernel with its ways in."""

    ordinary: Any = None

    def lower(self) -> None:
        if self.ordinary is not None:
            self.emit_environment_object()
        self.lower_normal_function(self.fndesc)
        if self.ordinary is not None:
            self._make_ways_in()
            self.ordinary.post_lowering(self.module, self.library)
        self.library.add_ir_module(self.module)

    def init(self) -> None:
        self._values: dict[str, Any] = {}
        self._places: dict[str, Any] = {}

    def _bare_function(self, descriptor: Any, suffix: str = "") -> Any:
        """A kernel by its descriptor: its arguments, without defaults, and its result as they are."""
        context = self.context
        nothing = descriptor.restype == types.none
        returned = ll.VoidType() if nothing else context.get_value_type(descriptor.restype)
        kinds = [context.get_value_type(kind) for kind in descriptor.argtypes if _is_passed(kind)]
        name = descriptor.llvm_func_name + suffix
        return cgutils.get_or_insert_function(self.module, ll.FunctionType(returned, kinds), name)

    def _make_ways_in(self) -> None:
        """The functions that numba's wrapper for Python, and `callback.kernel_caller`, call."""
        context, descriptor = self.ordinary, self.fndesc
        nothing = descriptor.restype == types.none
        function = context.declare_function(self.module, descriptor)
        builder = ll.IRBuilder(function.append_basic_block("entry"))
        self.call_helper = context.call_conv.init_call_helper(builder)
        given = context.call_conv.decode_arguments(builder, descriptor.argtypes, function)
        arguments = [
            _as_view(context, self.context, builder, kind, value) for kind, value in zip(descriptor.argtypes, given)
        ]
        result = builder.call(self.function, arguments)
        result = context.get_dummy_value() if nothing else result
        context.call_conv.return_value(builder, context.get_return_value(builder, descriptor.restype, result))
        kinds = [self.context.get_value_type(kind) for kind in descriptor.argtypes]
        returned = self.context.get_value_type(descriptor.restype)
        function = ll.Function(self.module, ll.FunctionType(returned, kinds), descriptor.llvm_cfunc_wrapper_name)
        builder = ll.IRBuilder(function.append_basic_block("entry"))
        result = builder.call(self.function, function.args)
        builder.ret(context.get_dummy_value() if nothing else result)

    def _refusal(self, reason: str) -> UnsupportedError:
        """The error for what kernels do not understand, which names the line."""
        return UnsupportedError(reason, loc=self.loc)

    # the frame of a function

    def setup_function(self, fndesc: Any) -> None:
        self.function = self._bare_function(fndesc, "" if self.ordinary is None else _BARE)
        if self.ordinary is not None:
            # one body for all ways in
            self.function.linkage = "internal"
            self.function.attributes.add("noinline")
        self.entry_block = self.function.append_basic_block("entry")
        self.builder = ll.IRBuilder(self.entry_block)
        self.call_helper = self.call_conv.init_call_helper(self.builder)

    def extract_function_arguments(self) -> Any:
        given = iter(self.function.args)
        self.fnargs = [next(given) if _is_passed(kind) else None for kind in self.fndesc.argtypes]
        return self.fnargs

    def lower_function_body(self) -> Any:
        blocks = self.func_ir.blocks
        for offset in blocks:
            self.blkmap[offset] = self.function.append_basic_block(f"B{offset}")
        self.pre_lower()
        graph = compute_cfg_from_blocks(blocks)
        self._direct = self._direct_variables(graph)
        # what dominates a block comes before it
        order = graph.topo_order()
        for offset in order:
            self.builder.position_at_end(self.blkmap[offset])
            self.lower_block(blocks[offset])
        for offset in blocks.keys() - set(order):
            self.builder.position_at_end(self.blkmap[offset])
            self.builder.unreachable()
        self.post_lower()
        return self.entry_block

    def lower_block(self, block: Any) -> None:
        for instruction in block.body:
            self.loc = instruction.loc
            self.lower_inst(instruction)

    def _direct_variables(self, graph: Any) -> set[str]:
        """Variables that are assigned once, before all of their uses: LLVM's values, others have a place in memory."""
        assigned: dict[str, list[int]] = defaultdict(list)
        exposed: dict[str, set[int]] = defaultdict(set)
        for offset, block in self.func_ir.blocks.items():
            here = set()
            for statement in block.body:
                if isinstance(statement, ir.Assign):
                    value, target = statement.value, statement.target.name
                    used = [value] if isinstance(value, ir.Var) else []
                    if isinstance(value, ir.Expr):
                        used = value.list_vars()
                else:
                    used, target = statement.list_vars(), None
                for variable in used:
                    if variable.name not in here:
                        exposed[variable.name].add(offset)
                if target is not None:
                    here.add(target)
                    assigned[target].append(offset)
        above = graph.dominators()

        def is_above(place: int, uses: set[int]) -> bool:
            return all(use != place and place in above.get(use, ()) for use in uses)

        return {
            name
            for name, offsets in assigned.items()
            if len(offsets) == 1 and is_above(offsets[0], exposed.get(name, set()))
        }

    # variables

    def _constant(self, value: int) -> Any:
        return ll.Constant(_INTEGER, value)

    def _place(self, kind: Any) -> Any:
        with self.builder.goto_entry_block():
            return self.builder.alloca(kind)

    def storevar(self, value: Any, name: str, argidx: Any = None) -> None:
        if name in self._direct:
            self._values[name] = value
            return
        kind = self.typeof(name)
        if name not in self._places:
            self._places[name] = self._place(self.context.get_value_type(kind))
        self.builder.store(self._whole(value, kind), self._places[name])

    def _look(self, name: str) -> Any:
        """A variable's value, which may be in parts."""
        if name in self._direct:
            return self._values[name]
        if name not in self._places:
            self._places[name] = self._place(self.context.get_value_type(self.typeof(name)))
        return self.builder.load(self._places[name])

    def loadvar(self, name: str) -> Any:
        return self._whole(self._look(name), self.typeof(name))

    def _whole(self, value: Any, kind: Any) -> Any:
        if isinstance(value, _Parts):
            return self.context.make_tuple(self.builder, kind, [self._whole(v, k) for v, k in zip(value, kind)])
        if isinstance(value, (_Slice, _Range, _Iterator)):
            raise self._refusal(f"kernels cannot keep a {type(value).__name__[1:].lower()}")
        return value

    def _loaded(self, name: str, wanted: Any) -> Any:
        """A variable's value as another type."""
        return self._cast(self.loadvar(name), self.typeof(name), wanted)

    def _cast(self, value: Any, given: Any, wanted: Any) -> Any:
        given, plain = types.unliteral(given), types.unliteral(wanted)
        if given == plain:
            return value
        if given == types.int64 and plain == types.float64:
            if isinstance(value, ll.Constant):
                return ll.Constant(_REAL, float(value.constant))
            return self.builder.sitofp(value, _REAL)
        return self.context.cast(self.builder, value, given, wanted)

    # statements

    def lower_inst(self, inst: Any) -> None:
        builder = self.builder
        if isinstance(inst, ir.Assign):
            name = inst.target.name
            self.storevar(self._assigned(self.typeof(name), inst.value), name)
        elif isinstance(inst, ir.Jump):
            builder.branch(self.blkmap[inst.target])
        elif isinstance(inst, ir.Branch):
            condition = self._loaded(inst.cond.name, types.boolean)
            builder.cbranch(condition, self.blkmap[inst.truebr], self.blkmap[inst.falsebr])
        elif isinstance(inst, ir.Return):
            kind = self.fndesc.restype
            if kind == types.none:
                builder.ret_void()
            else:
                builder.ret(self._loaded(inst.value.name, kind))
        elif isinstance(inst, (ir.SetItem, ir.StaticSetItem)) and isinstance(
            self.typeof(inst.target.name), types.Array
        ):
            array = self.typeof(inst.target.name)
            view = self.loadvar(inst.target.name)
            index = self._static(inst.index) if isinstance(inst, ir.StaticSetItem) else self._index(inst.index)
            builder.store(self._loaded(inst.value.name, array.dtype), self._element(array, view, index))
        elif not isinstance(inst, (ir.Del, ir.PopBlock)):
            super().lower_inst(inst)

    def _assigned(self, kind: Any, value: Any) -> Any:
        if isinstance(value, ir.Expr):
            method = getattr(self, "_lower_" + value.op, None)
            return super().lower_expr(kind, value) if method is None else method(kind, value)
        if isinstance(value, ir.Var):
            given, found = self.typeof(value.name), self._look(value.name)
            return found if given == kind else self._cast(self._whole(found, given), given, kind)
        if isinstance(value, ir.Arg):
            given = self.typeof("arg." + value.name)
            if isinstance(given, types.Omitted):
                return self._constant_of(kind, given.value)
            return self._cast(self.fnargs[value.index], given, kind)
        return self._constant_of(kind, value.value)

    def _constant_of(self, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Integer):
            return ll.Constant(ll.IntType(kind.bitwidth), int(value))
        if kind == types.float64:
            return ll.Constant(_REAL, float(value))
        if isinstance(kind, types.Boolean):
            return ll.Constant(_BIT, int(value))
        if isinstance(kind, (types.Callable, types.Module)):
            return None
        return self.context.get_constant_generic(self.builder, kind, value)

    # expressions: `_lower_` and numba's name

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        return self._whole(self._assigned(resty, expr), resty)

    def _lower_cast(self, kind: Any, expr: Any) -> Any:
        return self._assigned(kind, expr.value)

    def _lower_binop(self, kind: Any, expr: Any) -> Any:
        return self._operation(kind, expr, expr.fn)

    def _lower_inplace_binop(self, kind: Any, expr: Any) -> Any:
        return self._operation(kind, expr, expr.immutable_fn)

    def _operation(self, kind: Any, expr: Any, function: Any) -> Any:
        builder, signature = self.builder, self.fndesc.calltypes[expr]
        left, right = (types.unliteral(given) for given in signature.args)
        result = None
        if left == right and left in (types.float64, types.int64):
            a, b = self._loaded(expr.lhs.name, left), self._loaded(expr.rhs.name, right)
            result = (_of_reals if left == types.float64 else _of_integers)(builder, function, a, b)
        elif (
            function is operator.contains
            and right == types.int64
            and isinstance(left, types.BaseTuple)
            and all(isinstance(item, types.Integer) for item in left)
        ):
            wanted = self._loaded(expr.rhs.name, right)
            result = ll.Constant(_BIT, 0)
            for item in self._parts(expr.lhs.name):
                result = builder.or_(result, builder.icmp_signed("==", item, wanted))
        if result is None:
            return self.lower_binop(kind, expr, function)
        return self._cast(result, signature.return_type, kind)

    def _lower_unary(self, kind: Any, expr: Any) -> Any:
        (given,) = self.fndesc.calltypes[expr].args
        if expr.fn is operator.neg and given == kind and kind in (types.float64, types.int64):
            value = self._loaded(expr.value.name, kind)
            return self.builder.fneg(value) if kind == types.float64 else self.builder.neg(value)
        return super().lower_expr(kind, expr)

    def _lower_build_tuple(self, kind: Any, expr: Any) -> Any:
        items = []
        for item, wanted in zip(expr.items, kind):
            value, given = self._look(item.name), self.typeof(item.name)
            items.append(value if given == wanted else self._cast(self._whole(value, given), given, wanted))
        return _Parts(items)

    def _parts(self, name: str) -> Any:
        """The items of a tuple."""
        value = self._look(name)
        if isinstance(value, _Parts):
            return value
        return [self.builder.extract_value(value, i) for i in range(len(self.typeof(name)))]

    def _lower_exhaust_iter(self, kind: Any, expr: Any) -> Any:
        return self._assigned(kind, expr.value)

    def _lower_getattr(self, kind: Any, expr: Any) -> Any:
        if expr.attr == "shape" and isinstance(self.typeof(expr.value.name), types.Array):
            return self.builder.extract_value(self.loadvar(expr.value.name), 1)
        if expr.attr == "reshape" and isinstance(self.typeof(expr.value.name), types.Array):
            return self.loadvar(expr.value.name)
        if isinstance(kind, (types.Callable, types.Module)) and isinstance(self.typeof(expr.value.name), types.Module):
            return None
        return super().lower_expr(kind, expr)

    # elements and rows

    def _static(self, index: Any) -> list[Any]:
        """Each of a constant index's integers and slices."""
        found = []
        for item in index if isinstance(index, tuple) else (index,):
            if isinstance(item, slice):
                ends = (None if end is None else self._constant(end) for end in (item.start, item.stop))
                if item.step not in (None, 1):
                    raise self._refusal(f"kernels cannot take slices with a step, got {item}")
                found.append(_Slice(*ends))
            else:
                found.append(self._constant(item))
        return found

    def _index(self, variable: Any) -> list[Any]:
        """Each of an index's integers and slices."""
        kind, value = self.typeof(variable.name), self._look(variable.name)
        if isinstance(kind, types.BaseTuple):
            items, kinds = self._parts(variable.name), list(kind)
        else:
            items, kinds = [value], [kind]
        return [item if isinstance(item, _Slice) else self._cast(item, k, types.intp) for item, k in zip(items, kinds)]

    def _element(self, array: Any, view: Any, index: list[Any]) -> Any:
        """Pointer to what the leading indices, or starts of slices, lead to."""
        builder = self.builder
        shape = [builder.extract_value(view, (1, i)) for i in range(array.ndim)]
        if array.layout == "C":
            strides = _strides(builder, shape)
        else:
            strides = [builder.extract_value(view, (2, i)) for i in range(array.ndim)]
        offset = self._constant(0)
        for item, extent, stride in zip(index, shape, strides):
            start = item
            if isinstance(item, _Slice):
                start = self._from_end(self._constant(0) if item.start is None else item.start, extent)
            else:
                start = self._from_end(item, extent)
            offset = _plus(builder, offset, _times(builder, start, stride))
        return builder.gep(builder.extract_value(view, 0), [offset], inbounds=True)

    def _from_end(self, value: Any, extent: Any) -> Any:
        if isinstance(value, ll.Constant) and value.constant < 0:
            return _plus(self.builder, extent, value)
        return value

    def _item(self, kind: Any, name: str, index: list[Any]) -> Any:
        """Element, row or slice of an array."""
        builder, array, view = self.builder, self.typeof(name), self.loadvar(name)
        pointer = self._element(array, view, index)
        if not isinstance(kind, types.Array):
            return self._cast(builder.load(pointer), array.dtype, kind)
        extents = [builder.extract_value(view, (1, i)) for i in range(array.ndim)]
        strides: list[Any] = []
        if kind.layout != "C":
            strides = _strides(builder, extents)
            if array.layout != "C":
                strides = [builder.extract_value(view, (2, i)) for i in range(array.ndim)]
        shape, kept = [], []
        for i, extent in enumerate(extents):
            item = index[i] if i < len(index) else _Slice(None, None)
            if not isinstance(item, _Slice):
                continue
            stop = extent if item.stop is None else self._from_end(item.stop, extent)
            if item.start is not None:
                stop = builder.sub(stop, self._from_end(item.start, extent), flags=("nsw",))
            shape.append(stop)
            kept += strides[i : i + 1]
        return make_view(self.context, builder, kind, pointer, shape, kept or None)

    def _lower_getitem(self, kind: Any, expr: Any) -> Any:
        if isinstance(self.typeof(expr.value.name), types.Array):
            return self._item(kind, expr.value.name, self._index(expr.index))
        return super().lower_expr(kind, expr)

    def _lower_static_getitem(self, kind: Any, expr: Any) -> Any:
        given = self.typeof(expr.value.name)
        if isinstance(given, types.Array):
            return self._item(kind, expr.value.name, self._static(expr.index))
        if isinstance(given, types.BaseTuple) and isinstance(expr.index, (int, slice)):
            items = self._parts(expr.value.name)
            if isinstance(expr.index, slice):
                return _Parts(items[expr.index])
            return self._cast(self._whole(items[expr.index], given[expr.index]), given[expr.index], kind)
        return super().lower_expr(kind, expr)

    # loops

    def _lower_getiter(self, kind: Any, expr: Any) -> Any:
        value = self._look(expr.value.name)
        if not isinstance(value, _Range):
            return super().lower_expr(kind, expr)
        place = self._place(_INTEGER)
        self.builder.store(value.start, place)
        return _Iterator(place, value.stop, value.step)

    def _lower_iternext(self, kind: Any, expr: Any) -> Any:
        iterator = self._look(expr.value.name)
        if not isinstance(iterator, _Iterator):
            return super().lower_expr(kind, expr)
        value = self.builder.load(iterator.place)
        going = self.builder.icmp_signed("<" if iterator.step > 0 else ">", value, iterator.stop)
        following = self.builder.add(value, self._constant(iterator.step), flags=("nsw",))
        self.builder.store(following, iterator.place)
        return _Parts((value, going))

    def _lower_pair_first(self, kind: Any, expr: Any) -> Any:
        pair = self._look(expr.value.name)
        return pair[0] if isinstance(pair, _Parts) else super().lower_expr(kind, expr)

    def _lower_pair_second(self, kind: Any, expr: Any) -> Any:
        pair = self._look(expr.value.name)
        return pair[1] if isinstance(pair, _Parts) else super().lower_expr(kind, expr)

    # calls

    def _lower_call(self, kind: Any, expr: Any) -> Any:
        called, signature = self.typeof(expr.func.name), self.fndesc.calltypes[expr]
        if isinstance(called, types.Dispatcher):
            result = self._part(called, expr, signature)
        elif isinstance(called, types.BoundFunction) and called.typing_key == "array.reshape":
            data = self.builder.extract_value(self.loadvar(expr.func.name), 0)
            shape = [self._loaded(variable.name, types.intp) for variable in expr.args]
            return make_view(self.context, self.builder, kind, data, shape, None)
        else:
            result = None
            if isinstance(called, types.Function) and not expr.kws and expr.vararg is None:
                result = self._builtin(called.typing_key, expr)
            if result is None:
                return self.lower_call(kind, expr)
        if isinstance(result, (_Slice, _Range)):
            return result
        return self._cast(result, signature.return_type, kind)

    def _part(self, called: Any, expr: Any, signature: Any) -> Any:
        """The result of another kernel."""
        compiled = called.dispatcher.overloads[tuple(signature.args)]
        if not getattr(compiled.library, "is_part", False):
            raise self._refusal(f"a kernel calls {compiled.fndesc.qualname}, which is none of its kind")
        self.library.add_linking_library(compiled.library)
        if expr.kws or expr.vararg is not None or len(expr.args) != len(signature.args):
            arguments = self.fold_call_args(called, signature, expr.args, expr.vararg, expr.kws)
        else:
            arguments = [self._loaded(v.name, wanted) for v, wanted in zip(expr.args, signature.args)]
        arguments = [v for v, wanted in zip(arguments, signature.args) if _is_passed(wanted)]
        result = self.builder.call(self._bare_function(compiled.fndesc), arguments)
        return self.context.get_dummy_value() if signature.return_type == types.none else result

    def _builtin(self, function: Any, expr: Any) -> Any:
        """The result of one of Python's functions; None where it is left to numba."""
        builder = self.builder
        names = [variable.name for variable in expr.args]
        kinds = [types.unliteral(self.typeof(name)) for name in names]
        if function is bool and kinds == [types.boolean]:
            return self.loadvar(names[0])
        if function is slice and len(names) == 2:
            return _Slice(*(None if k == types.none else self._loaded(n, types.intp) for n, k in zip(names, kinds)))
        if function is range and all(k == types.int64 for k in kinds):
            step = self.typeof(names[2]) if len(names) == 3 else types.literal(1)
            if not isinstance(step, types.IntegerLiteral):
                return None
            values = [self._loaded(name, types.int64) for name in names[:2]]
            start, stop = (self._constant(0), values[0]) if len(values) == 1 else values
            return _Range(start, stop, step.literal_value)
        same = len(kinds) > 1 and all(kind == kinds[0] for kind in kinds)
        if function in (min, max) and same and kinds[0] in (types.float64, types.int64):
            compare = builder.fcmp_ordered if kinds[0] == types.float64 else builder.icmp_signed
            result = self.loadvar(names[0])
            for name in names[1:]:
                # as in Python: the first of equal ones, and what is not a number only where it comes first
                value = self.loadvar(name)
                result = builder.select(compare("<" if function is min else ">", value, result), value, result)
            return result
        if function is float and kinds == [types.int64]:
            return self._loaded(names[0], types.float64)
        if function is int and kinds == [types.float64]:
            return builder.fptosi(self.loadvar(names[0]), _INTEGER)
        return None
