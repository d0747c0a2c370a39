"""Vector instructions and prefetching in LLVM, which numba does not offer.

A row is read in vectors of :data:`LANES` values; a processor with narrower vectors takes several
instructions for one.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, imputils
from numba.extending import intrinsic

LANES = 8
LINE = 64
"""Bytes of a cache line."""
WORD, FLAG = ir.IntType(32), ir.IntType(1)
WORDS = ir.VectorType(WORD, LANES)


@intrinsic
def highest_of_lanes(_, table, row, first):
    """Return the highest of up to 8 values of a row, from entry `first` on.

    `table` is C-ordered, (n, m), without NaN.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values, _, inside = _vector(context, builder, table, args)
        low = ir.Constant(values.type, [float("-inf")] * LANES)
        values = builder.select(inside, values, low)
        return _reduced(builder, "fmax", values, fastmath=("nnan",))

    return table.dtype(table, row, first), build


@intrinsic
def ties_in_lanes(_, table, row, first, value):
    """Return which of 8 values of a row from entry `first` on equal `value`, one bit each."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values, _, inside = _vector(context, builder, table, args)
        tied = builder.fcmp_ordered("==", values, _spread(builder, args[3]))
        bits = builder.bitcast(builder.and_(inside, tied), ir.IntType(LANES))
        return builder.zext(bits, ir.IntType(64))

    return types.uint64(table, row, first, table.dtype), build


@intrinsic
def ones(_, bits):
    """Return how many bits of a 64-bit number are set."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), build


@intrinsic
def nth_one(_, bits, n):
    """Return the position of the n-th bit, counted from 0, of those set in a 64-bit number.

    One instruction on processors that have it (x86 with BMI2), else a loop over the bits below.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(64)
        if "+bmi2" in context.codegen().magic_tuple()[2]:
            kind = ir.FunctionType(word, [word, word])
            deposit = builder.module.declare_intrinsic("llvm.x86.bmi.pdep.64", (), kind)
            one = builder.call(deposit, [builder.shl(ir.Constant(word, 1), args[1]), args[0]])
        else:
            one = context.compile_internal(builder, _without_lowest, signature, args)
        return builder.cttz(one, ir.Constant(FLAG, 1))

    return types.uint64(types.uint64, types.uint64), build


def _without_lowest(bits: Any, n: Any) -> Any:
    """Return a number with its n lowest set bits cleared."""
    while n > 0:
        bits &= bits - np.uint64(1)
        n -= np.uint64(1)
    return bits


def _vector(context: Any, builder: Any, table: Any, args: Any) -> tuple[Any, Any, Any]:
    """Return 8 values of a row from an entry on, their indices, and which lie in the row."""
    array = context.make_array(table)(context, builder, args[0])
    width, first = builder.extract_value(array.shape, 1), args[2]
    start = builder.gep(array.data, [builder.add(builder.mul(args[1], width), first)])
    lanes = ir.Constant(WORDS, list(range(LANES)))
    numbers = builder.add(lanes, _spread(builder, builder.trunc(first, WORD)))
    inside = builder.icmp_unsigned("<", numbers, _spread(builder, builder.trunc(width, WORD)))
    kind = ir.VectorType(context.get_data_type(table.dtype), LANES)
    return _masked_load(builder, start, kind, inside), numbers, inside


def _masked_load(builder: Any, start: Any, kind: Any, inside: Any) -> Any:
    """Return the values that lie inside; nothing after the end of the row is read."""
    size = 4 if kind.element == ir.FloatType() else 8
    name = f"llvm.masked.load.v{LANES}f{8 * size}.p0"
    parts = [kind.as_pointer(), WORD, inside.type, kind]
    load = builder.module.declare_intrinsic(name, (), ir.FunctionType(kind, parts))
    start = builder.bitcast(start, kind.as_pointer())
    return builder.call(load, [start, ir.Constant(WORD, size), inside, ir.Constant(kind, None)])


def _reduced(builder: Any, how: str, values: Any, **options: Any) -> Any:
    """Return the highest entry of a vector."""
    kind = values.type.element
    name = {"float": "f32", "double": "f64"}.get(str(kind), str(kind))
    signature = ir.FunctionType(kind, [values.type])
    name = f"llvm.vector.reduce.{how}.v{LANES}{name}"
    reduce = builder.module.declare_intrinsic(name, (), signature)
    return builder.call(reduce, [values], **options)


def _spread(builder: Any, value: Any) -> Any:
    """Return a vector of one value."""
    kind = ir.VectorType(value.type, LANES)
    one = builder.insert_element(ir.Constant(kind, None), value, ir.Constant(WORD, 0))
    return builder.shuffle_vector(one, one, ir.Constant(WORDS, [0] * LANES))


@intrinsic
def of_width(_, array, width):
    """Return a C-ordered (n, m) array with m known to the compiler: len(width), unless that is 0.

    Loops along a row are then unrolled, and products with m become shifts and sums.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        table = context.make_array(array)(context, builder, args[0])
        if width.count > 0:
            m = ir.Constant(context.get_value_type(types.intp), width.count)
            size = context.get_abi_sizeof(context.get_data_type(array.dtype))
            table.shape = builder.insert_value(table.shape, m, 1)
            stride = ir.Constant(m.type, width.count * size)
            table.strides = builder.insert_value(table.strides, stride, 0)
        return imputils.impl_ret_borrowed(context, builder, array, table._getvalue())

    return array(array, width), build


@intrinsic
def prefetch(_, array, row):
    """Prefetch all cache lines of a row of a C-ordered (n, m) array.

    The processor continues meanwhile; a row of a table larger than its caches has then arrived when
    the next step reads it.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        table = context.make_array(array)(context, builder, args[0])
        width = builder.extract_value(table.shape, 1)
        size = context.get_abi_sizeof(context.get_data_type(array.dtype))
        byte, count = ir.IntType(8).as_pointer(), width.type
        start = builder.gep(table.data, [builder.mul(args[1], width)])
        start = builder.ptrtoint(start, count)
        last = builder.mul(builder.sub(width, ir.Constant(count, 1)), ir.Constant(count, size))
        fetch = builder.module.declare_intrinsic(
            "llvm.prefetch", [byte], ir.FunctionType(ir.VoidType(), [byte, WORD, WORD, WORD])
        )
        how = [ir.Constant(WORD, n) for n in (0, 3, 1)]  # to read, keep, data
        with cgutils.for_range_slice(
            builder, ir.Constant(count, 0), last, ir.Constant(count, LINE), count
        ) as (offset, _):
            builder.call(fetch, [builder.inttoptr(builder.add(start, offset), byte), *how])
        builder.call(fetch, [builder.inttoptr(builder.add(start, last), byte), *how])
        return context.get_dummy_value()

    return types.void(array, row), build


def inverse_of(divisor: int, numbers: int) -> np.uint64:
    """Return the multiplier with which :func:`quotient` divides numbers below `numbers`, or 0."""
    exact = divisor >= 2 and numbers * divisor <= 2**64
    return np.uint64(2**64 // divisor + 1 if exact else 0)


@intrinsic
def quotient(_, number, inverse):
    """Return number // divisor as the upper 64 bits of number * inverse.

    Several times faster than division, and exact while number * divisor < 2^64: the inverse
    exceeds 2^64 / divisor by at most 1, so that the product exceeds 2^64 number / divisor by less
    than 2^64 / divisor, which is too little to reach the next whole number.
    """

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        wide = ir.IntType(128)
        product = builder.mul(*(builder.zext(factor, wide) for factor in args))
        return builder.trunc(builder.lshr(product, ir.Constant(wide, 64)), ir.IntType(64))

    return types.uint64(types.uint64, types.uint64), build
