"""Fields of a flat buffer by their names: from its shape a kernel that finds each.

A header says the dimensions, and behind them where each field begins. What a kernel gets at once is
a record, a vector or a matrix: the last extent of a field, or the last two. Those before are rows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from typing import Any, TypeAlias

from vibroscreen.compiler.language import Places, Record, kernel, record, view1, view2

__all__ = ["Symbol", "fields_of", "record_at", "record_in"]

Symbol: TypeAlias = str | int | Record
"""An extent: a dimension by name, a number, or a record's."""


def _named(made: Any, *said: object) -> Any:
    """A kernel that the compiler tells from others of its kind: no two may say the same."""
    made.__qualname__ = " ".join(map(str, (made.__name__, *said)))
    return kernel(made)


@cache
def record_at(place: int, kind: Record) -> Any:
    """The kernel that finds the record at a place of a row of numbers."""

    def one(row):
        return record(row, place, kind)

    return _named(one, place, kind)


@cache
def record_in(place: int, kind: Record, size: int) -> Any:
    """The kernel that finds a record by number: one every `size` numbers from a place on."""

    def one_of(row, number):
        return record(row, place + size * number, kind)

    return _named(one_of, place, kind)


def fields_of(
    dimension: Record,
    at: Places,
    shapes: Mapping[str, tuple[Symbol, ...]],
    matrices: Collection[str],
    further: Mapping[str, Any],
) -> dict[str, Any]:
    """`field(buffer, *rows)` for all whose last extents are known, by name.

    dimension: those that the header begins with; at: where it says the places of the fields;
    matrices: names of fields that end in one; further: kernels that give other extents.
    """
    extents = {name: _dimension(k) for k, name in enumerate(dimension)} | dict(further)
    extents |= {
        symbol: _constant(len(symbol) if isinstance(symbol, Record) else symbol)
        for symbols in shapes.values()
        for symbol in symbols
        if not isinstance(symbol, str)
    }
    forms: dict[tuple[Symbol, ...], tuple[Any, Any]] = {}
    found = {}
    for name, symbols in shapes.items():
        inner = symbols[-2:] if name in matrices else symbols[-1:]
        if all(symbol in extents for symbol in inner):
            if inner not in forms:
                forms[inner] = _form(inner, [extents[symbol] for symbol in inner])
            rows = symbols[: -len(inner)]
            count = extents[rows[-1]] if len(rows) > 1 else None
            found[name] = _field(name, getattr(at, name), len(rows), count, *forms[inner])
    return found


@cache
def _dimension(place: int) -> Any:
    def dimension(buffer):
        return int(buffer[place])

    return _named(dimension, place)


@cache
def _constant(value: int) -> Any:
    def constant(buffer):
        return value

    return _named(constant, value)


def _form(inner: tuple[Symbol, ...], extents: list[Any]) -> tuple[Any, Any]:
    """Kernels that view what has these extents at a place, and say how many numbers it holds."""
    kind, high, wide = inner[-1], extents[0], extents[-1]

    def as_record(buffer, place):
        return record(buffer, place, kind)

    def as_vector(buffer, place):
        return view1(buffer, place, wide(buffer))

    def as_matrix(buffer, place):
        return view2(buffer, place, high(buffer), wide(buffer))

    def size(buffer):
        return high(buffer) * wide(buffer)

    if len(inner) == 2:
        return _named(as_matrix, inner), _named(size, inner)
    return _named(as_record if isinstance(kind, Record) else as_vector, inner), wide


def _field(name: str, at: int, rows: int, count: Any, form: Any, size: Any) -> Any:
    def field(buffer):
        return form(buffer, int(buffer[at]))

    def field_of(buffer, row):
        return form(buffer, int(buffer[at]) + int(row) * size(buffer))

    def field_of_two(buffer, row, column):
        place = int(row) * count(buffer) + int(column)
        return form(buffer, int(buffer[at]) + place * size(buffer))

    return _named((field, field_of, field_of_two)[rows], name)
