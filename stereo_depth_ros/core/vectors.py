# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Vectors for kernels: operations on 64 bytes or 32 words at once, in LLVM's generic form for any processor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

__all__ = [
    "BYTES",
    "WORDS",
    "add",
    "add_saturated",
    "at_most",
    "bit_count",
    "equal",
    "even_words",
    "first_lane",
    "join_words",
    "last_lane",
    "least_lane",
    "load",
    "maximum",
    "mean",
    "minimum",
    "multiply",
    "multiply_high",
    "next_lanes",
    "odd_words",
    "ones",
    "previous_lanes",
    "quarter",
    "ramp",
    "repeat",
    "signed",
    "store",
    "subtract",
    "subtract_saturated",
    "sum_of_lanes",
    "union",
    "where_less",
    "xor",
]

ir = cgutils.ir  # llvmlite's, which comes with numba

BYTES, WORDS = 64, 32  # lanes of a vector of 512 bits; processors with shorter registers use several
_COUNTS = {8: BYTES, 16: WORDS}


class Lanes(types.Type):  # type: ignore[misc]
    """The type of a vector in kernels: integers of 8 or 16 bits."""

    def __init__(self, bits: int, signed: bool = False) -> None:
        self.bits, self.count, self.signed = bits, _COUNTS[bits], signed
        super().__init__(name=f"{'' if signed else 'u'}int{bits}x{self.count}")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, _vector(lanes.bits))


_OF = {types.uint8: Lanes(8), types.uint16: Lanes(16), types.int16: Lanes(16, signed=True)}
_U8, _U16, _I16 = _OF.values()
_ELEMENTS = {lanes: element for element, lanes in _OF.items()}


def _vector(bits: int, count: int = 0) -> Any:
    return ir.VectorType(ir.IntType(bits), count or _COUNTS[bits])


def _constant(vector: Any, values: Any) -> Any:
    """A vector of the values, or of one value."""
    values = [values] * vector.count if isinstance(values, int) else list(values)
    return ir.Constant(vector, [ir.Constant(vector.element, value) for value in values])


def _call(builder: Any, name: str, result: Any, *arguments: Any) -> Any:
    """Call of an LLVM intrinsic that is overloaded for the vector type of its first argument."""
    vector = arguments[0].type
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    full_name = f"llvm.{name}.v{vector.count}i{vector.element.width}"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, full_name), arguments)


def _elementwise(operation: Callable[..., Any], only: Lanes | None = None) -> Any:
    """An intrinsic of two vectors of one type, whose result has that type."""

    def typing(_context: Any, a: Any, b: Any) -> Any:
        if not isinstance(a, Lanes) or a != b or (only and a != only):
            return None

        def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return operation(builder, *arguments)

        return a(a, b), generate

    return intrinsic(typing)


def _by_sign(name: str) -> Any:
    """As :func:`_elementwise`, by the LLVM intrinsic with ``s`` or ``u`` before its name."""

    def typing(_context: Any, a: Any, b: Any) -> Any:
        if not isinstance(a, Lanes) or a != b:
            return None

        def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return _call(builder, f"{'s' if a.signed else 'u'}{name}", arguments[0].type, *arguments)

        return a(a, b), generate

    return intrinsic(typing)


def _multiply_high(builder: Any, a: Any, b: Any) -> Any:
    # As a product of fixed-point numbers. LLVM would take one of words of 32 bits, shifted, apart.
    return _call(builder, "umul.fix", a.type, a, b, ir.Constant(ir.IntType(32), 16))


def _mean(builder: Any, a: Any, b: Any) -> Any:
    wide = _vector(16, BYTES)
    total = builder.add(builder.add(builder.zext(a, wide), builder.zext(b, wide)), _constant(wide, 1))
    return builder.trunc(builder.lshr(total, _constant(wide, 1)), a.type)


def _shuffle(builder: Any, a: Any, b: Any, lanes: range) -> Any:
    return builder.shuffle_vector(a, b, _constant(_vector(32, a.type.count), lanes))


minimum = _by_sign("min")
maximum = _by_sign("max")
add = _elementwise(lambda builder, a, b: builder.add(a, b))  # modulo 256 or 65536
multiply = _elementwise(lambda builder, a, b: builder.mul(a, b))
subtract = _elementwise(lambda builder, a, b: builder.sub(a, b))
add_saturated = _by_sign("add.sat")
subtract_saturated = _by_sign("sub.sat")
xor = _elementwise(lambda builder, a, b: builder.xor(a, b))
union = _elementwise(lambda builder, a, b: builder.or_(a, b))  # of bits
multiply_high = _elementwise(_multiply_high, only=_U16)  # (a b) >> 16
mean = _elementwise(_mean, only=_U8)  # (a + b + 1) >> 1

# Of a vector that follows another one in memory: lanes i - 1, with the last one of the vector before, given second,
previous_lanes = _elementwise(
    lambda builder, a, before: _shuffle(builder, before, a, range(a.type.count - 1, 2 * a.type.count - 1))
)
# and lanes i + 1, with the first one of the vector after.
next_lanes = _elementwise(lambda builder, a, after: _shuffle(builder, a, after, range(1, a.type.count + 1)))


def _address(target: Any, builder: Any, signature: Any, arguments: Any, vector: Any) -> Any:
    array = target.make_array(signature.args[0])(target, builder, arguments[0])
    return builder.bitcast(builder.gep(array.data, [arguments[1]]), vector.as_pointer())


def _lanes_of(array: Any) -> Lanes | None:
    plain = isinstance(array, types.Array) and array.layout == "C"
    return _OF.get(array.dtype) if plain else None


@intrinsic  # type: ignore[untyped-decorator]
def load(_context: Any, array: Any, at: Any) -> Any:
    """The vector of a contiguous array of uint8, uint16 or int16 from element ``at`` on, counted over all dimensions.

    The caller stays inside.
    """
    lanes = _lanes_of(array)
    if lanes is None:
        return None

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(target, builder, signature, arguments, _vector(lanes.bits)), align=1)

    return lanes(array, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def store(_context: Any, array: Any, at: Any, vector: Any) -> Any:
    """Write a vector to a contiguous array from element ``at`` on, counted over all dimensions."""
    lanes = _lanes_of(array)
    if lanes is None or vector != lanes:
        return None

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(arguments[2], _address(target, builder, signature, arguments, _vector(lanes.bits)), align=1)
        return target.get_dummy_value()

    return types.void(array, types.int64, vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def repeat(_context: Any, value: Any) -> Any:
    """The vector with a uint8, uint16 or int16 in all lanes."""
    lanes = _OF.get(value)
    if lanes is None:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        vector = _vector(lanes.bits)
        first = builder.insert_element(ir.Constant(vector, ir.Undefined), arguments[0], ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(first, first, _constant(_vector(32, lanes.count), 0))

    return lanes(value), generate


@intrinsic  # type: ignore[untyped-decorator]
def least_lane(_context: Any, vector: Any) -> Any:
    """The minimum of the lanes."""
    if not isinstance(vector, Lanes):
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        name = f"vector.reduce.{'s' if vector.signed else 'u'}min"
        return _call(builder, name, ir.IntType(vector.bits), *arguments)

    return _ELEMENTS[vector](vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def sum_of_lanes(_context: Any, vector: Any) -> Any:
    """The sum of the lanes of words."""
    if vector != _U16:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        wide = builder.zext(arguments[0], _vector(32, WORDS))
        return _call(builder, "vector.reduce.add", ir.IntType(32), wide)

    return types.uint32(vector), generate


def _mask(condition: str) -> Any:
    """An intrinsic of two vectors of one type: bit i of a uint64 is set where the condition holds for lanes i."""

    def typing(_context: Any, a: Any, b: Any) -> Any:
        if not isinstance(a, Lanes) or a != b:
            return None

        def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            compare = builder.icmp_signed if a.signed else builder.icmp_unsigned
            bits = builder.bitcast(compare(condition, *arguments), ir.IntType(a.count))
            return builder.zext(bits, ir.IntType(64))

        return types.uint64(a, b), generate

    return intrinsic(typing)


equal = _mask("==")
at_most = _mask("<=")


@intrinsic  # type: ignore[untyped-decorator]
def first_lane(_context: Any, bits: Any) -> Any:
    """The place of the lowest set bit of a uint64, 64 if there is none."""
    if bits != types.uint64:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(bits), generate


@intrinsic  # type: ignore[untyped-decorator]
def last_lane(_context: Any, bits: Any) -> Any:
    """The place of the highest set bit of a uint64, -1 if there is none."""
    if bits != types.uint64:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.sub(ir.Constant(ir.IntType(64), 63), builder.ctlz(arguments[0], ir.Constant(ir.IntType(1), 0)))

    return types.int64(bits), generate


@intrinsic  # type: ignore[untyped-decorator]
def bit_count(_context: Any, bits: Any) -> Any:
    """The number of set bits of a uint64."""
    if bits != types.uint64:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.int64(bits), generate


@intrinsic  # type: ignore[untyped-decorator]
def even_words(_context: Any, vector: Any) -> Any:
    """Bytes 0, 2, 4 ... as words; where the order does not matter, this is cheaper than words in order."""
    return _split(vector, lambda builder, words: builder.and_(words, _constant(words.type, 255)))


@intrinsic  # type: ignore[untyped-decorator]
def odd_words(_context: Any, vector: Any) -> Any:
    """Bytes 1, 3, 5 ... as words."""
    return _split(vector, lambda builder, words: builder.lshr(words, _constant(words.type, 8)))


def _split(vector: Any, operation: Callable[[Any, Any], Any]) -> Any:
    if vector != _U8:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return operation(builder, builder.bitcast(arguments[0], _vector(16)))

    return _U16(vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def quarter(_context: Any, vector: Any) -> Any:
    """Unsigned lanes divided by 4, rounded down."""
    if not isinstance(vector, Lanes) or vector.signed:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.lshr(arguments[0], _constant(arguments[0].type, 2))

    return vector(vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def signed(_context: Any, vector: Any) -> Any:
    """Words, unchanged, as int16."""
    if vector != _U16:
        return None

    def generate(_target: Any, _builder: Any, _signature: Any, arguments: Any) -> Any:
        return arguments[0]

    return _I16(vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def ramp(_context: Any) -> Any:
    """Words 0, 2, 4 ... 62: the indices of the even bytes."""

    def generate(_target: Any, _builder: Any, _signature: Any, _arguments: Any) -> Any:
        return _constant(_vector(16), range(0, 2 * WORDS, 2))

    return _U16(), generate


@intrinsic  # type: ignore[untyped-decorator]
def ones(_context: Any, vector: Any) -> Any:
    """The number of set bits of each lane."""
    if not isinstance(vector, Lanes):
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _call(builder, "ctpop", arguments[0].type, *arguments)

    return vector(vector), generate


@intrinsic  # type: ignore[untyped-decorator]
def where_less(_context: Any, a: Any, b: Any, then: Any, otherwise: Any) -> Any:
    """Lanes of ``then`` where a < b, and of ``otherwise`` elsewhere."""
    if not isinstance(a, Lanes) or not a == b == then == otherwise:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        compare = builder.icmp_signed if a.signed else builder.icmp_unsigned
        return builder.select(compare("<", *arguments[:2]), *arguments[2:])

    return a(a, b, then, otherwise), generate


@intrinsic  # type: ignore[untyped-decorator]
def join_words(_context: Any, even: Any, odd: Any) -> Any:
    """The bytes of words below 256: the inverse of :func:`even_words` and :func:`odd_words`."""
    if even != _U16 or odd != _U16:
        return None

    def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        high = builder.shl(arguments[1], _constant(_vector(16), 8))
        return builder.bitcast(builder.or_(arguments[0], high), _vector(8))

    return _U8(even, odd), generate
