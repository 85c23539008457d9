"""A SIMD vector type for numba kernels, so that a block of pixels is one value that lives in registers.

The compiler vectorises a plain loop over an array only if it can prove that nothing overlaps, and then loads and stores
every number in every iteration. A value of this type is a vector by construction. Arithmetic works lane by lane,
between lanes and with scalars, which are converted to the lanes' type, so that a literal never widens anything. `fma`
rounds once wherever the processor can, so that two kernels that repeat a formula get the same bits.

Written by hand because plain loops are slower; benchmarks/by_hand.py measures both, figures in
docs/charts/by_hand.json.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

__all__ = [
    "Lanes", "absolute", "any_of", "exp2", "floor", "fma", "load8", "load16", "maximum", "minimum", "root", "row_sums",
    "store", "where", "widen",
]  # fmt: skip


def _device(build: Callable[..., Any]) -> Any:
    """An intrinsic, typed Any: as numba declares it, a caller would have to pass the typing context too."""
    return intrinsic(build)


class Lanes(types.Type):
    """`count` numbers of one type."""

    def __init__(self, kind: types.Type, count: int) -> None:
        self.kind, self.count = kind, count
        super().__init__(name=f"Lanes({kind} x {count})")


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        bit = lanes.kind is types.boolean
        element = ir.IntType(1) if bit else manager.lookup(lanes.kind).get_value_type()
        super().__init__(manager, lanes, ir.VectorType(element, lanes.count))


def _filled(builder: Any, scalar: Any, count: int) -> Any:
    """A vector with this scalar in every lane."""
    undefined = ir.Constant(ir.VectorType(scalar.type, count), ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count))


def _lanes_of(given: Any) -> Lanes | None:
    """The first of these types that is lanes, but not a mask."""
    return next((t for t in given if isinstance(t, Lanes) and t.kind is not types.boolean), None)


def _aligned(context: Any, builder: Any, lanes: Lanes, given: Any, values: Any) -> list[Any]:
    """The values as vectors of this type."""
    return [
        v if isinstance(t, Lanes) else _filled(builder, context.cast(builder, v, t, lanes.kind), lanes.count)
        for t, v in zip(given, values, strict=True)
    ]


def _fits(given: Any) -> Lanes | None:
    """The type that these operands share: lanes of one type, and scalars."""
    lanes = _lanes_of(given)
    if lanes is None or any(t != lanes for t in given if isinstance(t, Lanes)):
        return None
    return lanes if all(isinstance(t, (Lanes, types.Number)) for t in given) else None


def _operator(symbol: Any, emit: Callable[[Any, Lanes, Any, Any], Any], compares: bool = False) -> None:
    """Defines a binary operator of lanes with lanes or scalars."""

    class Template(AbstractTemplate):
        def generic(self, given: Any, keywords: Any) -> Any:
            lanes = _fits(given) if len(given) == 2 else None
            if lanes is None:
                return None
            return signature(Lanes(types.boolean, lanes.count) if compares else lanes, *given)

    infer_global(symbol)(Template)

    def lower(context: Any, builder: Any, sig: Any, values: Any) -> Any:
        lanes = _fits(sig.args)
        assert lanes is not None, sig
        return emit(builder, lanes, *_aligned(context, builder, lanes, sig.args, values))

    for pair in ((Lanes, Lanes), (Lanes, types.Number), (types.Number, Lanes)):
        lower_builtin(symbol, *pair)(lower)


def _arithmetic(name: str) -> Callable[[Any, Lanes, Any, Any], Any]:
    def emit(builder: Any, lanes: Lanes, a: Any, b: Any) -> Any:
        return getattr(builder, f"f{name}" if isinstance(lanes.kind, types.Float) else name)(a, b)

    return emit


def _comparison(symbol: str) -> Callable[[Any, Lanes, Any, Any], Any]:
    def emit(builder: Any, lanes: Lanes, a: Any, b: Any) -> Any:
        compare = builder.fcmp_ordered if isinstance(lanes.kind, types.Float) else builder.icmp_signed
        return compare(symbol, a, b)

    return emit


_operator(operator.add, _arithmetic("add"))
_operator(operator.sub, _arithmetic("sub"))
_operator(operator.mul, _arithmetic("mul"))
_operator(operator.truediv, _arithmetic("div"))
_operator(operator.lt, _comparison("<"), compares=True)
_operator(operator.le, _comparison("<="), compares=True)
_operator(operator.gt, _comparison(">"), compares=True)
_operator(operator.ge, _comparison(">="), compares=True)
_operator(operator.eq, _comparison("=="), compares=True)


@infer_global(operator.and_)
class _And(AbstractTemplate):
    def generic(self, given: Any, keywords: Any) -> Any:
        masks = all(isinstance(t, Lanes) and t.kind is types.boolean for t in given) and given[0] == given[1]
        return signature(given[0], *given) if masks else None


@lower_builtin(operator.and_, Lanes, Lanes)
def _lower_and(context: Any, builder: Any, sig: Any, values: Any) -> Any:
    return builder.and_(*values)


@infer_global(operator.neg)
class _Negative(AbstractTemplate):
    def generic(self, given: Any, keywords: Any) -> Any:
        return signature(given[0], given[0]) if isinstance(given[0], Lanes) else None


@lower_builtin(operator.neg, Lanes)
def _lower_negative(context: Any, builder: Any, sig: Any, values: Any) -> Any:
    return builder.fneg(values[0])


def _call(builder: Any, name: str, *values: Any) -> Any:
    """Calls an LLVM intrinsic whose arguments and result have one type."""
    kind = values[0].type
    suffix = f"v{kind.count}{_code(kind.element)}" if isinstance(kind, ir.VectorType) else _code(kind)
    function_type = ir.FunctionType(kind, [kind] * len(values))
    name = f"llvm.{name}.{suffix}"
    return builder.call(builder.module.globals.get(name) or ir.Function(builder.module, function_type, name), values)


def _code(kind: Any) -> str:
    return "f32" if isinstance(kind, ir.FloatType) else "f64"


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, at: Any, kind: Any) -> Any:
    """Pointer to element `at` of a contiguous array, as a vector. Checks no bounds."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), kind.as_pointer())


def _loader(count: int) -> Any:
    @_device
    def load(typingctx, array, at):
        lanes = Lanes(array.dtype, count)

        def codegen(context, builder, sig, values):
            kind = context.get_value_type(lanes)
            pointer = _pointer(context, builder, sig.args[0], values[0], values[1], kind)
            return builder.load(pointer, align=context.get_abi_sizeof(kind.element))

        return lanes(array, types.intp), codegen

    return load


load8, load16 = _loader(8), _loader(16)
"""Reads 8 or 16 numbers of a contiguous array, from a flat index on."""


@_device
def store(typingctx, array, at, value):
    """Writes lanes to a contiguous array from a flat index on; float64 is rounded for a float32 array."""

    def codegen(context, builder, sig, values):
        kind = context.get_value_type(Lanes(sig.args[0].dtype, sig.args[2].count))
        pointer = _pointer(context, builder, sig.args[0], values[0], values[1], kind)
        vector = values[2] if values[2].type == kind else builder.fptrunc(values[2], kind)
        builder.store(vector, pointer, align=context.get_abi_sizeof(kind.element))
        return context.get_dummy_value()

    return types.none(array, types.intp, value), codegen


@_device
def widen(typingctx, value):
    """The lanes converted to float64."""
    wide = Lanes(types.float64, value.count)

    def codegen(context, builder, sig, values):
        kind = context.get_value_type(wide)
        return values[0] if values[0].type == kind else builder.fpext(values[0], kind)

    return wide(value), codegen


@_device
def where(typingctx, condition, yes, no):
    """`yes` where the condition holds, else `no`: lane by lane for a mask, one of two scalars for a bool."""
    lanes = _fits((yes, no)) or typingctx.unify_types(yes, no)
    if isinstance(condition, Lanes) and not isinstance(lanes, Lanes):
        lanes = Lanes(lanes, condition.count)

    def codegen(context, builder, sig, values):
        if isinstance(lanes, Lanes):
            pair = _aligned(context, builder, lanes, sig.args[1:], values[1:])
        else:
            pair = [context.cast(builder, v, t, lanes) for t, v in zip(sig.args[1:], values[1:], strict=True)]
        return builder.select(values[0], *pair)

    return lanes(condition, yes, no), codegen


@_device
def fma(typingctx, a, b, c):
    """a b + c, rounded once if the processor can do that as fast as a product."""
    lanes = _fits((a, b, c)) or typingctx.unify_types(a, b, c)

    def codegen(context, builder, sig, values):
        if isinstance(lanes, Lanes):
            given = _aligned(context, builder, lanes, sig.args, values)
        else:
            given = [context.cast(builder, v, t, lanes) for t, v in zip(sig.args, values, strict=True)]
        return _call(builder, "fmuladd", *given)

    return lanes(a, b, c), codegen


def _extreme(symbol: str) -> Any:
    @_device
    def pick(typingctx, a, b):
        lanes = _fits((a, b)) or typingctx.unify_types(a, b)

        def codegen(context, builder, sig, values):
            if isinstance(lanes, Lanes):
                first, second = _aligned(context, builder, lanes, sig.args, values)
            else:
                first, second = (context.cast(builder, v, t, lanes) for t, v in zip(sig.args, values, strict=True))
            return builder.select(builder.fcmp_ordered(symbol, second, first), second, first)

        return lanes(a, b), codegen

    return pick


minimum, maximum = _extreme("<"), _extreme(">")
"""The lesser and the greater of two, lanes or scalars; the first if they are equal or one is NaN."""


def _unary(name: str) -> Any:
    @_device
    def of(typingctx, value):
        def codegen(context, builder, sig, values):
            return _call(builder, name, values[0])

        return value(value), codegen

    return of


floor, root, absolute = _unary("floor"), _unary("sqrt"), _unary("fabs")
"""Functions of lanes or a scalar; `root` is the square root, `absolute` the absolute value."""


@_device
def any_of(typingctx, mask):
    """Whether the mask is true in any lane."""

    def codegen(context, builder, sig, values):
        bits = ir.IntType(sig.args[0].count)
        return builder.icmp_unsigned("!=", builder.bitcast(values[0], bits), ir.Constant(bits, 0))

    return types.boolean(mask), codegen


# Polynomial of 2^r for r in [-0.5, 0.5], highest power first; relative error 1e-8 before rounding.
POWERS = (1.5353362e-4, 1.3398874e-3, 9.6184373e-3, 5.5503324e-2, 2.4022648e-1, 6.9314720e-1, 1.0)

ROUND = 12582912.0  # 1.5 * 2^23: adding it to a float32 leaves the nearest whole number in the lowest bits


@_device
def exp2(typingctx, value):
    """2^x for -100 < x < 100. A polynomial in float32; in float64, for checks only, the library's, lane by lane."""

    def codegen(context, builder, sig, values):
        x, kind = values[0], values[0].type
        if isinstance(kind.element, ir.DoubleType):
            exponential = context.get_function(math.exp, types.float64(types.float64))
            for k in range(kind.count):
                place = ir.Constant(ir.IntType(32), k)
                scaled = builder.fmul(builder.extract_element(values[0], place), kind.element(math.log(2.0)))
                x = builder.insert_element(x, exponential(builder, [scaled]), place)
            return x

        def number(c: float) -> Any:
            return ir.Constant(kind, [c] * kind.count)

        whole = ir.VectorType(ir.IntType(32), kind.count)
        shifted = builder.fadd(x, number(ROUND))
        r = builder.fsub(x, builder.fsub(shifted, number(ROUND)))
        y = number(POWERS[0])
        for power in POWERS[1:]:
            y = _call(builder, "fmuladd", y, r, number(power))
        exponent = builder.shl(builder.bitcast(shifted, whole), ir.Constant(whole, [23] * kind.count))
        return builder.bitcast(builder.add(builder.bitcast(y, whole), exponent), kind)

    return value(value), codegen


@_device
def row_sums(typingctx, vectors):
    """Lane k of the result is the sum over the lanes of vector k of a tuple; 0 beyond its end.

    Half vectors are added pairwise, for all sums at once, until one vector holds all of them.
    """
    lanes = vectors[0]

    def codegen(context, builder, sig, values):
        kind, count = context.get_value_type(lanes), lanes.count
        parts = [builder.extract_value(values[0], k) for k in range(len(vectors))]
        parts += [ir.Constant(kind, [0.0] * count)] * (count - len(parts))
        half = count // 2
        while half:
            low = [k for k in range(2 * count) if k % (2 * half) < half]
            first, second = (
                ir.Constant(ir.VectorType(ir.IntType(32), count), [k + shift for k in low]) for shift in (0, half)
            )
            parts = [
                builder.fadd(builder.shuffle_vector(a, b, first), builder.shuffle_vector(a, b, second))
                for a, b in zip(parts[::2], parts[1::2], strict=True)
            ]
            half //= 2
        return parts[0]

    return lanes(vectors), codegen
