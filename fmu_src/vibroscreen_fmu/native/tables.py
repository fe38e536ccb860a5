"""screen.h: what the C layer knows of a screen, from the tables that Python has.

Offsets of the buffer, variables with their limits, texts, start values and constants. Nothing here
is said twice: the layout is that of kernels/layout.py computed with names instead of numbers, the
texts are those of errors.py.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import TEXT
from vibroscreen.fields import Number
from vibroscreen.kernels import layout as lay
from vibroscreen.kernels import registry
from vibroscreen.kernels.entry import ADVANCE, INITIALISE, READ
from vibroscreen.kernels.layout import DIMENSION, FIELD, HEADER_SIZE, SECTIONS, Layout
from vibroscreen.kernels.machine import prototypes
from vibroscreen.kernels.segregation import EXCHANGE
from vibroscreen.screen import (
    LONGEST_STEP,
    SHORTEST_STEP,
    TEXT_OF_CODE,
    fill,
    slice_layout,
    variable_name,
)
from vibroscreen_fmu.native.aot import SUB_MODEL
from vibroscreen_fmu.port import Port, Steps
from vibroscreen_fmu.ports import entry_at
from vibroscreen_fmu.row_slave import STATE_MARK, owner_of

__all__ = ["header"]

# What a variable may be read with, and how it may be set; bits of a byte.
KINDS = {"Real": 1, "Integer": 2, "Enumeration": 2, "Boolean": 4, "String": 8}
SETTABLE, FIXED = 16, 32
_NEVER_REFUSED = ("size_class[", "deck[")


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


def header(config: ScreenConfig, ports: Sequence[Port], name: str, guid: str, build: str) -> str:
    """Text of screen.h for a screen: a model of that name, guid and build."""
    layout = slice_layout(config)
    buffer = layout.buffer()
    fill(layout, buffer, config)
    first, last = layout.section["parameters"].start, layout.section["constants"].stop
    own = _chosen(config)
    table = config.passage.velocity_table or ()
    lines = [
        "/* Made by vibroscreen_fmu/native/tables.py. */",
        "#include <stdint.h>",
        prototypes(),
        *_define(
            MODEL=json.dumps(name),
            GUID=json.dumps(guid),
            STATE_MARK=json.dumps(STATE_MARK.decode()),
            N_DIMENSIONS=len(DIMENSION),
            HEADER=HEADER_SIZE,
            PARAMETERS=first,
            TABLE_ROWS=len(table),
            ROOM=config.solver.packages,
            EXCHANGE=EXCHANGE,
            OWN_SEGREGATION_LAYERED=int(own["segregation"].layered),
            COMMAND_INITIALISE=INITIALISE,
            COMMAND_ADVANCE=ADVANCE,
            COMMAND_READ=READ,
            ACCEPTED=lay.ACCEPTED,
            SHORTEST_STEP=SHORTEST_STEP,
            LONGEST_STEP=LONGEST_STEP,
            SETTABLE=SETTABLE,
            FIXED=FIXED,
            **{kind.upper(): bit for kind, bit in KINDS.items() if kind != "Enumeration"},
        ),
        f"enum {{ {', '.join(f'D_{symbol.upper()}' for symbol in DIMENSION)} }};",
        f"enum {{ AT_FIRST = {len(DIMENSION) - 1}, {', '.join(_at(field) for field in FIELD)} }};",
        f"#define AT_FIRST_OF_STATE {_at(next(iter(SECTIONS['state'])))}",
        *_enumeration("P", lay.PARAMETER),
        *_enumeration("PANEL", lay.PANEL),
        f"#define PANEL_SIZE {len(lay.PANEL)}",
        *_enumeration("M", lay.MEMORY),
        f"static const unsigned char OWNER[16] = {{{', '.join(map(str, owner_of(build)))}}};",
        _numbers("DIMENSIONS", (layout.dimension[symbol] for symbol in DIMENSION)),
        _numbers("START", buffer[first:last]),
        _numbers("TABLE_APERTURE", [row[0] for row in table] or [0.0]),
        _numbers("TABLE_VELOCITY", [row[1] for row in table] or [0.0]),
        _layout_function(),
        *_texts(),
        *_variables(layout, ports),
        *_limits(ports),
    ]
    for family, model in own.items():
        if model.address:
            lines.append(f"void {SUB_MODEL.format(family)}(void);")
            lines.append(f"#define OWN_{family.upper()} {SUB_MODEL.format(family)}")
    return "\n".join(lines) + "\n"


def _chosen(config: ScreenConfig) -> dict[str, registry.SubModel]:
    return {
        "displacement": registry.model("displacement", config.displacement.model),
        "passage": registry.model("passage", config.passage.law),
        "segregation": registry.model("segregation", config.segregation.model),
    }


def _define(**values: Any) -> Iterable[str]:
    return (f"#define {name} {value}" for name, value in values.items())


def _enumeration(prefix: str, names: Iterable[str]) -> Iterable[str]:
    yield f"enum {{ {', '.join(f'{prefix}_{name.upper()}' for name in names)} }};"


def _at(field: str) -> str:
    return f"AT_{field.upper()}"


def _numbers(name: str, values: Iterable[float]) -> str:
    texts = [repr(float(value)) for value in values]
    return f"static const double {name}[{len(texts)}] = {{{', '.join(texts)}}};"


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
            lines.append(f"    header[{_at(field)}] = (double) at; at += {size};")
    lines += ["    found.size = at;", "#undef D", "    return found;", "}"]
    return "\n".join(lines)


def _texts() -> Iterable[str]:
    """Texts, and what is told of the codes of kernels."""
    assert not any("%" in text for text in TEXT.values()), "a host takes a message for a format"
    yield f"enum {{ {', '.join(f'TEXT_{key.upper()}' for key in TEXT)} }};"
    yield f"static const char *const TEXT[] = {{{', '.join(map(json.dumps, TEXT.values()))}}};"
    codes = (f"[{code}] = TEXT_{key.upper()}" for code, key in TEXT_OF_CODE.items())
    yield f"static const unsigned char TEXT_OF_CODE[] = {{{', '.join(codes)}}};"
    yield f"#define LAST_CODE {max(TEXT_OF_CODE)}"


def _variables(layout: Layout, ports: Sequence[Port]) -> Iterable[str]:
    """All variables by value reference: what may be done with them, and what people call them."""
    size = max(port.reference for port in ports) + 1
    first = layout.section["parameters"].start
    flags, names = [0] * size, ["{0, 0, 0, 0}"] * size
    for port in ports:
        settable = port.causality in ("input", "parameter")
        flags[port.reference] = (
            KINDS[port.kind] + SETTABLE * settable + FIXED * (port.variability == "fixed")
        )
        unit = cure = ""
        # What a kernel may refuse; limits of fixed parameters are told by the table below.
        if settable and (".panel[" in port.name or not port.name.startswith(_NEVER_REFUSED)):
            _, unit, cure = variable_name(layout, first + port.reference)
        told = (port.name, unit, cure, port.kind)
        names[port.reference] = f"{{{', '.join(map(json.dumps, told))}}}"
    yield f"#define N_VALUES {size}"
    yield f"static const unsigned char FLAGS[] = {{{', '.join(map(str, flags))}}};"
    yield "typedef struct { const char *name, *unit, *cure, *kind; } Variable;"
    yield f"static const Variable VARIABLE[] = {{{', '.join(names)}}};"


def _limits(ports: Sequence[Port]) -> Iterable[str]:
    """Checks of fixed parameters, in the order of value references."""
    yield "typedef struct { int reference, text; double limit;"
    yield "    const char *name, *unit, *cure; } Limit;"
    rows, choices = [], []
    for port in ports:
        if port.causality != "parameter" or port.variability != "fixed":
            continue
        if port.enumeration:
            items = [item for item, _ in port.enumeration.items]
            text = ", ".join(f"{i} {item}" for i, item in enumerate(items, 1))
            family = port.name.partition(".")[0]
            most = len(registry.BUILT_IN.get(family, items))
            choices.append((port.reference, most, port.name, text))
            continue
        entry = entry_at(port.path)
        assert isinstance(entry, Number), f"{port.name} is no number"
        for text, limit in (("endless", 0.0), *entry.limits()):
            said = (_told_name(port.path), entry.unit, entry.cure_of(text))
            rows.append(
                f"{{{port.reference}, TEXT_{text.upper()}, {float(limit)!r}, "
                f"{', '.join(map(json.dumps, said))}}}"
            )
    yield f"static const Limit LIMIT[] = {{{', '.join(rows)}}};"
    yield "typedef struct { int reference, most; const char *name, *cure; } Choice;"
    texts = (f"{{{r}, {most}, {json.dumps(n)}, {json.dumps(t)}}}" for r, most, n, t in choices)
    yield f"static const Choice CHOICE[] = {{{', '.join(texts)}}};"
    fixed = [str(p.reference) for p in ports if p.path and p.variability == "fixed"]
    yield f"static const int FIXED_ONES[] = {{{', '.join(fixed)}}};"
    tunable = [str(p.reference) for p in ports if p.variability == "tunable"]
    yield f"static const int TUNABLE_ONES[] = {{{', '.join(tunable)}}};"


def _told_name(path: Steps) -> str:
    """What a configuration calls the value at a path in its messages."""
    singular = {"decks": "deck", "panels": "panel"}
    name = ""
    for step in path:
        if isinstance(step, int):
            name += f"[{step + 1}]"
        else:
            name += f".{singular.get(step, step)}" if name else singular.get(step, step)
    return name
