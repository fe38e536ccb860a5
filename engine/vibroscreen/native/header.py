"""engine.h: what the C layer knows of the engine, from the tables that Python has.

Offsets of the buffer are those of kernels/state.py, computed with names instead of numbers. What
a screen adds is data (vibroscreen_fmu/native/tables.py), in the order of the names that stand here.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from vibroscreen.fields import FAR
from vibroscreen.kernels import state
from vibroscreen.kernels.entry import ADVANCE, CHECK, INITIALISE, READ
from vibroscreen.kernels.physics.segregation import EXCHANGE
from vibroscreen.kernels.state import DIMENSION, FIELD, HEADER_SIZE, SECTIONS
from vibroscreen.layout import LINE, Layout

FOLDER = Path(__file__).parent
SHEET_MARK, STATE_MARK = b"vsheet01", b"vscreen2"
# Numbers of a screen. Sub-models of one's own: 1 where there is one, 0 where there is none.
FAMILIES = ("displacement", "passage", "segregation")
OWN = tuple(f"own_{family}" for family in FAMILIES)
FIGURE = (
    *("room", "own_layered", "shortest_step", "longest_step", "tolerance_least", "tolerance_most"),
    *OWN,
)
# Name in C of a user's own sub-model of a family.
SUB_MODEL = "screen_own_{}"
# What a variable may be read with, and how it may be set; bits of a byte.
KINDS = {"Real": 1, "Integer": 2, "Enumeration": 2, "Boolean": 4, "String": 8}
SETTABLE, FIXED = 16, 32


class _Symbol:
    """A whole number that only C will know: sums, products and quotients are written down."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __add__(self, other: Any) -> _Symbol:
        return _Symbol(f"({self} + {other})")

    def __sub__(self, other: Any) -> _Symbol:
        return _Symbol(f"({self} - {other})")

    def __mul__(self, other: Any) -> _Symbol:
        return self if other == 1 else _Symbol(f"{self} * {other}")

    def __floordiv__(self, other: Any) -> _Symbol:
        return _Symbol(f"({self} / {other})")

    def __radd__(self, other: Any) -> _Symbol:
        return self if other == 0 else self + other

    __rmul__ = __mul__

    def __str__(self) -> str:
        return self.text


def texts() -> list[str]:
    """Keys of errors.TEXT that the C source names, in their order in a sheet, before all others."""
    named = re.findall(r"\bTEXT_([A-Z_]+)\b", (FOLDER / "fmi2.c").read_text())
    return sorted({name.lower() for name in named})


def header(engine: str, suffix: str) -> str:
    """Text of engine.h: for the engine of these stamps, in libraries that end in `suffix`."""
    addresses = [f"{family}_address" for family in FAMILIES]
    place = DIMENSION.index(addresses[0])
    assert list(DIMENSION[place : place + len(addresses)]) == addresses
    numbers = {
        "N_DIMENSIONS": len(DIMENSION),
        "HEADER": HEADER_SIZE,
        "PARAMETERS": HEADER_SIZE,
        "LINE": LINE,
        "PANEL_SIZE": len(state.PANEL),
        "FIGURES": len(FIGURE),
        "F_OWN": f"F_{OWN[0].upper()}",
        "OWN_MODELS": len(OWN),
        "TEXTS": len(texts()),
        "EXCHANGE": EXCHANGE,
        "FAR_OUT": FAR,  # windef.h has a FAR of its own
        "COMMAND_INITIALISE": INITIALISE,
        "COMMAND_ADVANCE": ADVANCE,
        "COMMAND_READ": READ,
        "COMMAND_CHECK": CHECK,
        "ACCEPTED": state.ACCEPTED,
        "ALARMS": state.ALARM_COUNT,
        "FIRST_ALARM": state.FIRST_ALARM,
        "WHY_SIZE": len(state.ALARM),
        "SETTABLE": SETTABLE,
        "FIXED": FIXED,
        **{f"KIND_{kind.upper()}": bit for kind, bit in KINDS.items() if kind != "Enumeration"},
        "ENGINE": json.dumps(engine),
        "SUFFIX": json.dumps(suffix),
        "SHEET_MARK": json.dumps(SHEET_MARK.decode()),
        "STATE_MARK": json.dumps(STATE_MARK.decode()),
    }
    own = ", ".join(json.dumps(SUB_MODEL.format(family)) for family in FAMILIES)
    lines = [
        "/* Made by vibroscreen/native/header.py. */",
        *(f"#define {name} {value}" for name, value in numbers.items()),
        _enumeration("D", DIMENSION),
        f"enum {{ AT_FIRST = {len(DIMENSION) - 1}, {', '.join(map(_at, FIELD))} }};",
        f"#define AT_FIRST_OF_STATE {_at(next(iter(SECTIONS['state'])))}",
        _enumeration("P", state.PARAMETER),
        _enumeration("PANEL", state.PANEL),
        _enumeration("M", state.MEMORY),
        _enumeration("WHY", state.ALARM),
        _enumeration("F", FIGURE),
        _enumeration("TEXT", texts()),
        f"static const char *const OWN_MODEL[] = {{{own}}};",
        f"static const uint32_t CRC[] = {{{', '.join(map(str, map(_crc, range(256))))}}};",
        _layout_function(),
    ]
    return "\n".join(lines) + "\n"


def _crc(byte: int) -> int:
    """What a byte adds to a CRC-32."""
    for _ in range(8):
        byte = byte >> 1 ^ 0xEDB88320 * (byte & 1)
    return byte


def _enumeration(prefix: str, names: Iterable[str]) -> str:
    return f"enum {{ {', '.join(f'{prefix}_{name.upper()}' for name in names)} }};"


def _at(field: str) -> str:
    return f"AT_{field.upper()}"


def _layout_function() -> str:
    """Offsets of all fields into the header of a buffer, from the dimensions in it."""
    symbols: Any = {name: _Symbol(f"D(D_{name.upper()})") for name in DIMENSION}
    layout: Any = Layout(symbols)
    lines = [
        "typedef struct { int64_t inputs, outputs, constants, state, work, size; } Sections;",
        "static Sections lay_out(double *header) {",
        "#define D(k) ((int64_t) header[k])",
        "    Sections found;",
        "    int64_t at = HEADER;",
    ]
    for title, fields in SECTIONS.items():
        if title != "parameters":
            lines.append(f"    found.{title} = at;")
        for field in fields:
            size = _Symbol("1")
            for extent in layout.shape[field]:
                size = _Symbol(f"{size} * {extent}") if str(size) != "1" else _Symbol(str(extent))
            if title == "work":
                lines.append("    at = (at + LINE - 1) / LINE * LINE;")
            lines.append(f"    header[{_at(field)}] = (double) at; at += {size};")
    lines += ["    found.size = at;", "#undef D", "    return found;", "}"]
    return "\n".join(lines)
