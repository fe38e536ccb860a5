"""screen.bin: what a screen adds to the engine library, from the tables that Python has.

Variables with their limits, texts, start values and constants. Nothing here is said twice: the
order of what is listed is that of vibroscreen/native/header.py, the texts are those of errors.py.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from vibroscreen import registry
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import TEXT
from vibroscreen.fields import Number
from vibroscreen.kernels import library
from vibroscreen.kernels.state import DIMENSION, HEADER_SIZE, REASONS, REFUSED
from vibroscreen.native import header
from vibroscreen.native.header import FAMILIES, FIXED, KINDS, SETTABLE
from vibroscreen.screen import LONGEST_STEP, SHORTEST_STEP, fill, settings_of, slice_layout
from vibroscreen_fmu.port import Port
from vibroscreen_fmu.saved_state import owner_of

__all__ = ["SHEET_FILE", "own_models", "sheet"]

SHEET_FILE = "screen.bin"  # in the resources of the FMU
HEAD = struct.Struct("<8s40sQQ")


class _Words:
    """Texts one after the other, each once, by the place where it begins."""

    def __init__(self) -> None:
        self.text = b""
        self._places: dict[str, int] = {}

    def at(self, word: str) -> int:
        """Where a text begins."""
        if word not in self._places:
            self._places[word] = len(self.text)
            self.text += word.encode() + b"\0"
        return self._places[word]


def sheet(config: ScreenConfig, ports: Sequence[Port], name: str, guid: str, build: str) -> bytes:
    """Content of screen.bin for a screen: a model of that name, guid and build."""
    layout = slice_layout(config)
    buffer = layout.buffer()
    fill(layout, buffer, config)
    dimension = layout.dimension
    table = config.passage.velocity_table or ()
    words = _Words()
    for word in (guid, name):
        words.at(word)
    assert not any("%" in text for text in TEXT.values()), "a host takes a message for a format"
    keys = header.texts()
    keys += [key for key in TEXT if key not in keys]
    # A steady solution alone is refused by those that have no text here.
    codes = [key if key in TEXT else "failed" for key in ("", *REFUSED)]
    limits = layout.view(buffer, "limit")
    flags, factors, variables = _variables(config, limits, ports, words)
    body = b"".join(
        [
            _part("d", _figures(config, ports)),
            _part("d", (dimension[symbol] for symbol in DIMENSION)),
            _part("d", buffer[HEADER_SIZE : layout.section["constants"].stop]),
            _part("d", (row[0] for row in table)),
            _part("d", (row[1] for row in table)),
            _part("B", flags),
            _part("d", factors),
            _rows("6i", variables),
            _part("i", (p.reference for p in ports if p.path and p.variability == "fixed")),
            _part("i", (p.reference for p in ports if p.variability == "tunable")),
            _part("B", map(keys.index, codes)),
            # no reason has the number 0
            _part("B", map(keys.index, (REASONS[0], *REASONS))),
            _part("i", [words.at(TEXT[key]) for key in keys]),
            _part("B", owner_of(build)),
            _part("B", words.text),
        ]
    )
    engine = "-".join(library.stamps()).encode()
    return HEAD.pack(header.SHEET_MARK, engine, len(body), zlib.crc32(body)) + body


def own_models(config: ScreenConfig) -> Mapping[str, registry.SubModel]:
    """The chosen sub-models that are a user's own, by family."""
    return {family: model for family, model in _chosen(config).items() if model.address}


def _chosen(config: ScreenConfig) -> dict[str, registry.SubModel]:
    names = (config.displacement.model, config.passage.law, config.segregation.model)
    return {f: registry.model(f, name) for f, name in zip(FAMILIES, names, strict=True)}


def _part(kind: str, values: Iterable[float]) -> bytes:
    return _rows(kind, ((value,) for value in values))


def _rows(kind: str, rows: Iterable[Sequence[float]]) -> bytes:
    """A count and so many rows of numbers, in whole eights of bytes."""
    packed = [struct.pack(f"<{kind}", *row) for row in rows]
    body = b"".join(packed)
    return struct.pack("<Q", len(packed)) + body + b"\0" * (-len(body) % 8)


def _figures(config: ScreenConfig, ports: Sequence[Port]) -> list[float]:
    tolerance = next(port for port in ports if port.name == "solver.tolerance")
    assert tolerance.least is not None
    assert tolerance.most is not None
    own = own_models(config)
    figures = {
        "room": config.solver.packages,
        "own_layered": _chosen(config)["segregation"].layered,
        "shortest_step": SHORTEST_STEP,
        "longest_step": LONGEST_STEP,
        "tolerance_least": tolerance.least,
        "tolerance_most": tolerance.most,
        **{f"own_{family}": family in own for family in FAMILIES},
    }
    return [float(figures[name]) for name in header.FIGURE]


def _variables(
    config: ScreenConfig, limits: NDArray[np.float64], ports: Sequence[Port], words: _Words
) -> tuple[list[int], list[float], list[tuple[int, ...]]]:
    """All variables by value reference: what may be done with them, and what people call them.

    Between them the factor of the unit that a value is mistaken for, NaN where there is none.
    """
    size = max(port.reference for port in ports) + 1
    flags, factors = [0] * size, [math.nan] * size
    names: list[tuple[int, ...]] = [(words.at(""),) * 6] * size
    given = settings_of(config)
    for port in ports:
        settable = port.causality in ("input", "parameter")
        flags[port.reference] = (
            KINDS[port.kind] + SETTABLE * settable + FIXED * (port.variability == "fixed")
        )
        number = given[port.reference] if port.reference < len(given) else None
        about: tuple[str, ...] = ("", "", "", "")
        if number:
            most = limits[port.reference, 1]
            about = (number.unit, number.range(most), number.plain_cure(most), "")
            entry = number.entry
            if isinstance(entry, Number) and entry.other_units:
                (unit,) = entry.other_units
                factors[port.reference] = unit.factor
                about = (*about[:3], entry.question(unit))
        names[port.reference] = tuple(map(words.at, (port.name, *about, port.kind)))
    return flags, factors, names
