"""Offsets and shapes of the buffer in Python: views and records by name (kernels/state.py)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.compiler.fours import in_fours
from vibroscreen.compiler.language import Record, Row
from vibroscreen.kernels import state

__all__ = ["LINE", "Layout"]

# Numbers in a line of a processor's cache: fields of the work begin at one, and so does a buffer.
LINE = 8

Array = NDArray[np.float64]


def _extent(known: Mapping[str, int], symbol: str | int | Record) -> int:
    if isinstance(symbol, Record):
        return len(symbol)
    return known[symbol] if isinstance(symbol, str) else symbol


@dataclass(frozen=True)
class Layout:
    """Offsets and shapes of all fields for given dimensions.

    `dimension` maps every name of state.DIMENSION to a whole number.
    """

    dimension: dict[str, int]
    offset: dict[str, int] = field(init=False)
    shape: dict[str, tuple[int, ...]] = field(init=False)
    span: dict[str, slice] = field(init=False)
    section: dict[str, slice] = field(init=False)
    size: int = field(init=False)

    def __post_init__(self) -> None:
        known = dict(self.dimension)
        known["edges"] = known["classes"] + 1
        known["seen"] = (
            len(state.PARAMETER)
            + len(state.INPUT)
            + known["classes"]
            + known["decks"] * known["panels"] * len(state.PANEL)
            + 5 * state.MAX_HARMONICS
        )
        known["all_panels"] = known["decks"] * known["panels"]
        known["setting"] = sum(
            prod(_extent(known, symbol) for symbol in symbols)
            for title in ("parameters", "inputs")
            for symbols in state.SECTIONS[title].values()
        )
        known["lower_decks"] = known["decks"] - 1
        known["result"] = sum(state.result_widths(known["decks"], known["classes"]))
        known["streams"] = state.OVER + known["decks"]
        known["sizes"] = in_fours(known["nodes"])  # that take part, with what pads them
        known["block"] = (known["layers"] + 2) * known["sizes"]
        offset: dict[str, int] = {}
        shape: dict[str, tuple[int, ...]] = {}
        span: dict[str, slice] = {}
        section: dict[str, slice] = {}
        position = state.HEADER_SIZE
        for title, fields in state.SECTIONS.items():
            start = position
            for name, symbols in fields.items():
                if title == "work":
                    position = (position + LINE - 1) // LINE * LINE
                shape[name] = tuple(_extent(known, symbol) for symbol in symbols)
                offset[name] = position
                position += prod(shape[name])
                span[name] = slice(offset[name], position)
            section[title] = slice(start, position)
        for name, value in (
            ("offset", offset),
            ("shape", shape),
            ("span", span),
            ("section", section),
            ("size", position),
        ):
            object.__setattr__(self, name, value)

    @property
    def persistent(self) -> slice:
        """All that an instance must remember: parameters to state."""
        return slice(self.section["parameters"].start, self.section["state"].stop)

    def buffer(self) -> Array:
        """A zeroed buffer with its header written."""
        room = np.zeros(self.size + LINE)
        start = -room.ctypes.data // 8 % LINE
        buffer = room[start : start + self.size]
        buffer[: len(state.DIMENSION)] = [self.dimension[name] for name in state.DIMENSION]
        buffer[len(state.DIMENSION) : state.HEADER_SIZE] = [
            self.offset[name] for name in state.FIELD
        ]
        return buffer

    def view(self, buffer: Array, name: str) -> Array:
        """The field `name` of `buffer`, shaped; writing to it writes the buffer."""
        return buffer[self.span[name]].reshape(self.shape[name])

    def record(self, buffer: Array, name: str) -> Any:
        """The record `name` of `buffer`, or an array of them: `.aperture` reads and writes it."""
        kind = state.KINDS[name]
        *extents, _ = self.shape[name]
        if not extents:
            return Row(buffer, self.offset[name], kind)
        rows = buffer[self.span[name]].view(np.dtype((np.record, kind.dtype)))
        return rows.reshape(extents).view(np.recarray)
