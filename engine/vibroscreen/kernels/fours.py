"""Four numbers side by side: what loops over sizes take at once.

A compiler's own vector loops check at run time that arrays lie apart, and pay for rows longer than
most beds have. These are one instruction each where the processor has it, with the bits of one
number after another. Sizes that take part are padded to a multiple of four (rates.gather).

    four(values, i), four_in(values, row, i)                 the numbers at i to i + 3
    put_four(values, i, x), put_four_in(values, row, i, x)   a four, or one number four times, there
    all_four(x)                                              one number four times
    x + y, x - y, x * y                                      of fours, or of a four and a number
    larger(x, y), apart(x)                                   the larger of each; without signs
    total(x), largest(x)                                     (x0 + x1) + (x2 + x3); of the four

With NUMBA_DISABLE_JIT=1 they are small arrays.
"""

from __future__ import annotations

import operator
from typing import Any, ClassVar

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from vibroscreen.kernels.jit import formula


@formula
def in_fours(count):
    """The next multiple of four."""
    return (count + 3) // 4 * 4


if config.DISABLE_JIT:

    def four(values, i):
        return values[i : i + 4].copy()

    def four_in(values, row, i):
        return values[row, i : i + 4].copy()

    def put_four(values, i, x):
        values[i : i + 4] = x

    def put_four_in(values, row, i, x):
        values[row, i : i + 4] = x

    def larger(x, y):
        return np.where(y > x, y, x)

    apart = abs

    def total(x):
        return (x[0] + x[1]) + (x[2] + x[3])

    def largest(x):
        return max(max(x[0], x[1]), max(x[2], x[3]))

    def all_four(x):
        return np.full(4, x)

else:

    class FourType(types.Type):
        """Type of four numbers side by side."""

        def __init__(self) -> None:
            super().__init__(name="four")

    FOUR = FourType()
    _WORDS = ir.VectorType(ir.DoubleType(), 4)
    _BITS = ir.VectorType(ir.IntType(64), 4)
    _NO_SIGN = ir.Constant(_BITS, [0x7FFFFFFFFFFFFFFF] * 4)
    _LANE = ir.IntType(32)

    @register_model(FourType)
    class _FourModel(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, _WORDS)

    def _spread(builder: Any, number: Any) -> Any:
        """One number four times."""
        lanes = ir.Constant(_WORDS, ir.Undefined)
        for k in range(4):
            lanes = builder.insert_element(lanes, number, _LANE(k))
        return lanes

    def _as_four(builder: Any, kind: Any, value: Any) -> Any:
        return value if kind == FOUR else _spread(builder, value)

    def _combine(name: str, *functions: Any) -> None:
        """Let an operator take fours, and fours and numbers."""
        pairs = ((FOUR, FOUR), (FOUR, types.float64), (types.float64, FOUR))

        def generate(_context, builder, form, arguments):
            x, y = (_as_four(builder, k, v) for k, v in zip(form.args, arguments, strict=True))
            return getattr(builder, name)(x, y)

        for function in functions:

            @infer_global(function)
            class _Typing(ConcreteTemplate):
                cases: ClassVar = [signature(FOUR, *pair) for pair in pairs]

            for pair in pairs:
                lower_builtin(function, *pair)(generate)

    _combine("fadd", operator.add, operator.iadd)
    _combine("fsub", operator.sub, operator.isub)
    _combine("fmul", operator.mul, operator.imul)

    def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
        """Pointer to four numbers of an array at an index, or a row and an index."""
        view = context.make_array(kind)(context, builder, array)
        if len(index) == 2:
            width = builder.extract_value(view.shape, 1)
            place = builder.add(builder.mul(index[0], width), index[1])
        else:
            place = index[0]
        return builder.bitcast(builder.gep(view.data, [place]), _WORDS.as_pointer())

    def _fits(kind: Any, rank: int) -> bool:
        """Whether an array holds doubles one after the other; others do not compile."""
        whole = isinstance(kind, types.Array) and kind.layout == "C"
        return whole and kind.ndim == rank and kind.dtype == types.float64

    def _reader(rank: int) -> Any:
        index = (types.intp,) * rank

        def generate(context, builder, form, arguments):
            place = _place(context, builder, form.args[0], arguments[0], arguments[1:])
            return builder.load(place, align=8)

        if rank == 1:

            @intrinsic
            def read(_context, values, i):
                return (FOUR(values, *index), generate) if _fits(values, rank) else None
        else:

            @intrinsic
            def read(_context, values, row, i):
                return (FOUR(values, *index), generate) if _fits(values, rank) else None

        return read

    def _writer(rank: int) -> Any:
        index = (types.intp,) * rank

        def generate(context, builder, form, arguments):
            place = _place(context, builder, form.args[0], arguments[0], arguments[1:-1])
            value = _as_four(builder, form.args[-1], arguments[-1])
            builder.store(value, place, align=8)
            return context.get_dummy_value()

        if rank == 1:

            @intrinsic
            def write(_context, values, i, x):
                return (types.void(values, *index, x), generate) if _fits(values, rank) else None
        else:

            @intrinsic
            def write(_context, values, row, i, x):
                return (types.void(values, *index, x), generate) if _fits(values, rank) else None

        return write

    four, four_in = _reader(1), _reader(2)
    put_four, put_four_in = _writer(1), _writer(2)

    @intrinsic
    def all_four(_context, x):
        """One number four times."""

        def generate(_context, builder, _form, arguments):
            return _spread(builder, arguments[0])

        return FOUR(types.float64), generate

    @intrinsic
    def larger(_context, x, y):
        """The larger of each, y where it is more than x."""

        def generate(_context, builder, form, arguments):
            x, y = (_as_four(builder, k, v) for k, v in zip(form.args, arguments, strict=True))
            return builder.select(builder.fcmp_ordered(">", y, x), y, x)

        return FOUR(x, y), generate

    @intrinsic
    def apart(_context, x):
        """Each without its sign."""

        def generate(_context, builder, _form, arguments):
            unsigned = builder.and_(builder.bitcast(arguments[0], _BITS), _NO_SIGN)
            return builder.bitcast(unsigned, _WORDS)

        return FOUR(FOUR), generate

    def _lanes(builder: Any, x: Any) -> list[Any]:
        return [builder.extract_element(x, _LANE(k)) for k in range(4)]

    @intrinsic
    def total(_context, x):
        """Sum of the four."""

        def generate(_context, builder, _form, arguments):
            a, b, c, d = _lanes(builder, arguments[0])
            return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))

        return types.float64(FOUR), generate

    @intrinsic
    def largest(_context, x):
        """Largest of the four."""

        def generate(_context, builder, _form, arguments):
            def most(one, two):
                return builder.select(builder.fcmp_ordered(">", two, one), two, one)

            a, b, c, d = _lanes(builder, arguments[0])
            return most(most(a, b), most(c, d))

        return types.float64(FOUR), generate
