"""How the compiler makes what kernels are written in: views, bits, fours, calls by address.

Each function of language.py and fours.py stands here beside the few instructions that it becomes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from llvmlite import ir
from numba import types
from numba.core.imputils import lower_constant
from numba.core.registry import cpu_target
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    ConcreteTemplate,
    infer_getattr,
    infer_global,
    signature,
)
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
    typeof_impl,
)

from vibroscreen.compiler import fours, language

VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")
TYPES: dict[str, types.Type] = {"vector": VECTOR, "matrix": MATRIX, "void": types.void}
TYPES |= {"int64": types.int64, "float64": types.float64}

made: list[tuple[Callable[..., Any], Any]] = []


def becomes(plain: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """The intrinsic that the compiler takes for a plain function."""

    def take(typing: Callable[..., Any]) -> Any:
        made.append((plain, intrinsic(typing)))
        return made[-1][1]

    return take


def use_them() -> None:
    """Let numba find the intrinsics under the names of the plain functions."""
    context = cpu_target.typing_context
    for plain, kinds in language.OWN_MODELS.values():
        _calling(plain, tuple(type_of(kind) for kind in kinds))
    context.refresh()
    cpu_target.target_context.refresh()
    for plain, own in made:
        context.insert_global(plain, context.resolve_value_type(own))


# --- arrays --------------------------------------------------------------------------------------
# Fields of an array as numba lays it out: owner, parent, count, size of one, data, shape, strides.
_COUNT, _SIZE, _DATA, _SHAPE, _STRIDES = range(2, 7)
_I64 = ir.IntType(64)


def array_fields(builder: Any, shape: Sequence[Any]) -> tuple[Any, list[Any]]:
    """Count and strides of an array of doubles one after the other."""
    count, strides = _I64(1), []
    for extent in reversed(shape):
        strides.insert(0, builder.mul(count, _I64(8)))
        count = builder.mul(count, extent)
    return count, strides


def _view(context: Any, builder: Any, form: Any, arguments: Any) -> Any:
    """View of a buffer from a place on: it owns nothing."""
    buffer, offset, *shape = arguments
    data = builder.gep(builder.extract_value(buffer, _DATA), [offset])
    count, strides = array_fields(builder, shape)
    made = ir.Constant(context.get_value_type(form.return_type), None)
    for field, value in ((_COUNT, count), (_SIZE, _I64(8)), (_DATA, data)):
        made = builder.insert_value(made, value, field)
    for k, pair in enumerate(zip(shape, strides, strict=True)):
        for field, value in zip((_SHAPE, _STRIDES), pair, strict=True):
            made = builder.insert_value(made, value, (field, k))
    return made


def _element(builder: Any, array: Any, index: Sequence[Any]) -> Any:
    """Pointer to an element; a negative index counts from the end."""
    place = None
    for k, at in enumerate(index):
        extent = builder.extract_value(array, (_SHAPE, k))
        if not (isinstance(at, ir.Constant) and at.constant >= 0):
            below = builder.icmp_signed("<", at, _I64(0))
            at = builder.select(below, builder.add(at, extent), at)
        place = at if place is None else builder.add(builder.mul(place, extent), at)
    return builder.gep(builder.extract_value(array, _DATA), [place])


def _places(builder: Any, kind: Any, index: Any) -> list[Any]:
    """An index, or a tuple of them, as words."""
    if not isinstance(kind, types.BaseTuple):
        return [index]
    return [builder.extract_value(index, k) for k in range(len(kind))]


# The same as numba's own for arrays of any kind, in a quarter of the instructions.
def _get(_context: Any, builder: Any, form: Any, arguments: Any) -> Any:
    array, index = arguments
    return builder.load(_element(builder, array, _places(builder, form.args[1], index)))


def _set(context: Any, builder: Any, form: Any, arguments: Any) -> Any:
    array, index, value = arguments
    value = context.cast(builder, value, form.args[2], types.float64)
    builder.store(value, _element(builder, array, _places(builder, form.args[1], index)))
    return context.get_dummy_value()


for _kind, _index in ((VECTOR, types.int64), (MATRIX, types.UniTuple(types.int64, 2))):
    lower_builtin(operator.getitem, _kind, _index)(_get)
    for _value in (types.float64, types.int64):
        lower_builtin(operator.setitem, _kind, _index, _value)(_set)
    lower_getattr(_kind, "size")(
        lambda _context, builder, _kind, array: builder.extract_value(array, _COUNT)
    )
    lower_getattr(_kind, "shape")(
        lambda _context, builder, _kind, array: builder.extract_value(array, _SHAPE)
    )


# --- records -------------------------------------------------------------------------------------
class KindType(types.Type):
    """Type of a record's names, which hold no value."""

    def __init__(self, record: language.Record) -> None:
        self.record = record
        super().__init__(name=f"kind {record!r}")


class RowType(types.Type):
    """Type of the numbers of a record: where the first one lies."""

    def __init__(self, record: language.Record) -> None:
        self.record = record
        super().__init__(name=f"row {record!r}")


class PlacesType(types.Type):
    """Type of names of places, which hold no value."""

    def __init__(self, places: language.Places) -> None:
        self.places = places
        super().__init__(name=repr(places))


register_model(KindType)(models.OpaqueModel)
register_model(PlacesType)(models.OpaqueModel)


@register_model(RowType)
class _RowModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.DoubleType().as_pointer())


@typeof_impl.register(language.Record)
def _kind_of(record: language.Record, _context: Any) -> KindType:
    return KindType(record)


@typeof_impl.register(language.Places)
def _places_of(places: language.Places, _context: Any) -> PlacesType:
    return PlacesType(places)


@infer_getattr
class _NamesOfPlaces(AttributeTemplate):
    key = PlacesType

    def generic_resolve(self, kind: PlacesType, name: str) -> Any:
        return types.int64 if name in kind.places else None


@lower_getattr_generic(PlacesType)
def _get_place(_context: Any, _builder: Any, kind: PlacesType, _value: Any, name: str) -> Any:
    return _I64(getattr(kind.places, name))


@lower_constant(KindType)
@lower_constant(PlacesType)
def _no_value(context: Any, _builder: Any, _kind: Any, _value: Any) -> Any:
    return context.get_dummy_value()


@infer_getattr
class _NamesOfRow(AttributeTemplate):
    key = RowType

    def generic_resolve(self, row: RowType, name: str) -> Any:
        if name not in row.record.place:
            return None
        return types.int64 if name in row.record.whole else types.float64


def _number_of_row(builder: Any, kind: RowType, row: Any, name: str) -> Any:
    return builder.gep(row, [_I64(kind.record.place[name])])


@lower_getattr_generic(RowType)
def _get_number(_context: Any, builder: Any, kind: RowType, row: Any, name: str) -> Any:
    number = builder.load(_number_of_row(builder, kind, row, name))
    return builder.fptosi(number, _I64) if name in kind.record.whole else number


@lower_setattr_generic(RowType)
def _set_number(context: Any, builder: Any, form: Any, arguments: Any, name: str) -> None:
    row, value = arguments
    number = context.cast(builder, value, form.args[1], types.float64)
    builder.store(number, _number_of_row(builder, form.args[0], row, name))


@becomes(language.record)
def _record(_context, buffer, place, kind):
    def generate(_context, builder, _form, arguments):
        return builder.gep(builder.extract_value(arguments[0], _DATA), [arguments[1]])

    return RowType(kind.record)(buffer, types.intp, kind), generate


@becomes(language.numbers)
def _numbers(_context, row):
    def generate(context, builder, form, arguments):
        buffer = ir.Constant(context.get_value_type(VECTOR), None)
        buffer = builder.insert_value(buffer, arguments[0], _DATA)
        size = _I64(len(row.record))
        return _view(context, builder, form, (buffer, _I64(0), size))

    return VECTOR(row), generate


@infer_global(len)
class _LengthOfKind(AbstractTemplate):
    def generic(self, arguments: Any, _named: Any) -> Any:
        is_kind = len(arguments) == 1 and isinstance(arguments[0], KindType)
        return signature(types.intp, *arguments) if is_kind else None


@lower_builtin(len, KindType)
def _length(_context: Any, _builder: Any, form: Any, _arguments: Any) -> Any:
    return _I64(len(form.args[0].record))


def type_of(kind: str | language.Record) -> types.Type:
    """numba's type of a kind of numbers, or of a record's."""
    return TYPES[kind] if isinstance(kind, str) else RowType(kind)


# --- views and bits ------------------------------------------------------------------------------
@becomes(language.view1)
def _view1(_context, buffer, offset, size):
    return VECTOR(buffer, types.intp, types.intp), _view


@becomes(language.view2)
def _view2(_context, buffer, offset, rows, columns):
    return MATRIX(buffer, types.intp, types.intp, types.intp), _view


def _cast(context: Any, builder: Any, form: Any, arguments: Any) -> Any:
    return builder.bitcast(arguments[0], context.get_value_type(form.return_type))


@becomes(language.bits_of)
def _bits_of(_context, number):
    return types.int64(types.float64), _cast


@becomes(language.number_of)
def _number_of(_context, bits):
    return types.float64(types.int64), _cast


def _calling(plain: Any, kinds: tuple[types.Type, ...]) -> None:
    """Intrinsic that calls a sub-model at an address."""

    def generate(context, builder, form, values):
        words = [context.get_value_type(kind) for kind in kinds]
        function = builder.inttoptr(
            values[0], ir.FunctionType(context.get_value_type(types.void), words).as_pointer()
        )
        packed = builder.extract_value
        builder.call(function, [packed(values[1], k) for k in range(len(kinds))])
        return context.get_dummy_value()

    @becomes(plain)
    def call(_context, address, *arguments):
        return types.void(types.intp, types.Tuple(kinds)), generate


# --- fours ---------------------------------------------------------------------------------------
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


def _place(builder: Any, array: Any, index: Any) -> Any:
    """Pointer to four numbers of an array at an index, or a row and an index."""
    place = index[0]
    if len(index) == 2:
        width = builder.extract_value(array, (_SHAPE, 1))
        place = builder.add(builder.mul(index[0], width), index[1])
    data = builder.extract_value(array, _DATA)
    return builder.bitcast(builder.gep(data, [place]), _WORDS.as_pointer())


def _fits(kind: Any, rank: int) -> bool:
    """Whether an array holds doubles one after the other; others do not compile."""
    whole = isinstance(kind, types.Array) and kind.layout == "C"
    return whole and kind.ndim == rank and kind.dtype == types.float64


def _read(_context: Any, builder: Any, form: Any, arguments: Any) -> Any:
    place = _place(builder, arguments[0], arguments[1:])
    return builder.load(place, align=8)


def _write(context: Any, builder: Any, form: Any, arguments: Any) -> Any:
    place = _place(builder, arguments[0], arguments[1:-1])
    builder.store(_as_four(builder, form.args[-1], arguments[-1]), place, align=8)
    return context.get_dummy_value()


@becomes(fours.four)
def _four(_context, values, i):
    return (FOUR(values, types.intp), _read) if _fits(values, 1) else None


@becomes(fours.four_in)
def _four_in(_context, values, row, i):
    return (FOUR(values, types.intp, types.intp), _read) if _fits(values, 2) else None


@becomes(fours.put_four)
def _put_four(_context, values, i, x):
    return (types.void(values, types.intp, x), _write) if _fits(values, 1) else None


@becomes(fours.put_four_in)
def _put_four_in(_context, values, row, i, x):
    return (types.void(values, types.intp, types.intp, x), _write) if _fits(values, 2) else None


@becomes(fours.all_four)
def _all_four(_context, x):
    def generate(_context, builder, _form, arguments):
        return _spread(builder, arguments[0])

    return FOUR(types.float64), generate


def _more(builder: Any, x: Any, y: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", y, x), y, x)


@becomes(fours.larger)
def _larger(_context, x, y):
    def generate(_context, builder, form, arguments):
        pair = (_as_four(builder, k, v) for k, v in zip(form.args, arguments, strict=True))
        return _more(builder, *pair)

    return FOUR(x, y), generate


@becomes(fours.apart)
def _apart(_context, x):
    def generate(_context, builder, _form, arguments):
        unsigned = builder.and_(builder.bitcast(arguments[0], _BITS), _NO_SIGN)
        return builder.bitcast(unsigned, _WORDS)

    return FOUR(FOUR), generate


def _lanes(builder: Any, x: Any) -> list[Any]:
    return [builder.extract_element(x, _LANE(k)) for k in range(4)]


@becomes(fours.total)
def _total(_context, x):
    def generate(_context, builder, _form, arguments):
        a, b, c, d = _lanes(builder, arguments[0])
        return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))

    return types.float64(FOUR), generate


@becomes(fours.largest)
def _largest(_context, x):
    def generate(_context, builder, _form, arguments):
        a, b, c, d = _lanes(builder, arguments[0])
        return _more(builder, _more(builder, a, b), _more(builder, c, d))

    return types.float64(FOUR), generate
