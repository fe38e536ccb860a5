"""screen.bin: what a screen adds to the engine library, from the tables that Python has.

Variables with their limits, texts, start values and constants. Nothing here is said twice: the
order of what is listed is that of vibroscreen/native/header.py, the texts are those of errors.py.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence

from vibroscreen import registry
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import TEXT
from vibroscreen.fields import Number
from vibroscreen.kernels import library
from vibroscreen.kernels.state import DIMENSION, HEADER_SIZE, Layout
from vibroscreen.native import header
from vibroscreen.native.header import FAMILIES, FIXED, KINDS, SETTABLE
from vibroscreen.screen import (
    LONGEST_STEP,
    SHORTEST_STEP,
    TEXT_OF_CODE,
    fill,
    slice_layout,
    variable_name,
)
from vibroscreen_fmu.port import Port, Steps
from vibroscreen_fmu.ports import entry_at
from vibroscreen_fmu.saved_state import owner_of

__all__ = ["SHEET_FILE", "own_models", "sheet"]

SHEET_FILE = "screen.bin"  # in the resources of the FMU
HEAD = struct.Struct("<8s40sQQ")
_NEVER_REFUSED = ("size_class[", "deck[")


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
    codes = [TEXT_OF_CODE.get(code, "failed") for code in range(max(TEXT_OF_CODE) + 1)]
    flags, variables = _variables(layout, ports, words)
    limits, choices = _limits(ports, keys, words)
    body = b"".join(
        [
            _part("d", _figures(config, ports)),
            _part("d", (dimension[symbol] for symbol in DIMENSION)),
            _part("d", buffer[HEADER_SIZE : layout.section["constants"].stop]),
            _part("d", (row[0] for row in table)),
            _part("d", (row[1] for row in table)),
            _part("B", flags),
            _rows("4i", variables),
            _rows("2id4i", limits),
            _rows("4i", choices),
            _part("i", (p.reference for p in ports if p.path and p.variability == "fixed")),
            _part("i", (p.reference for p in ports if p.variability == "tunable")),
            _part("B", map(keys.index, codes)),
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
    layout: Layout, ports: Sequence[Port], words: _Words
) -> tuple[list[int], list[tuple[int, ...]]]:
    """All variables by value reference: what may be done with them, and what people call them."""
    size = max(port.reference for port in ports) + 1
    flags = [0] * size
    names: list[tuple[int, ...]] = [(words.at(""),) * 4] * size
    for port in ports:
        settable = port.causality in ("input", "parameter")
        flags[port.reference] = (
            KINDS[port.kind] + SETTABLE * settable + FIXED * (port.variability == "fixed")
        )
        unit = cure = ""
        # What a kernel may refuse; limits of fixed parameters are told by the table below.
        if settable and (".panel[" in port.name or not port.name.startswith(_NEVER_REFUSED)):
            _, unit, cure = variable_name(layout, HEADER_SIZE + port.reference)
        names[port.reference] = tuple(map(words.at, (port.name, unit, cure, port.kind)))
    return flags, names


def _limits(
    ports: Sequence[Port], keys: Sequence[str], words: _Words
) -> tuple[list[tuple[float, ...]], list[tuple[int, ...]]]:
    """Checks of fixed parameters and of choices, in the order of value references."""
    rows: list[tuple[float, ...]] = []
    choices: list[tuple[int, ...]] = []
    for port in ports:
        if port.causality != "parameter" or port.variability != "fixed":
            continue
        if port.enumeration:
            items = [item for item, _ in port.enumeration.items]
            text = ", ".join(f"{i} {item}" for i, item in enumerate(items, 1))
            most = len(registry.BUILT_IN.get(port.name.partition(".")[0], items))
            choices.append((port.reference, most, words.at(port.name), words.at(text)))
            continue
        for text, limit, cure, unit in _checks(port):
            said = map(words.at, (_told_name(port.path), unit, cure))
            rows.append((port.reference, keys.index(text), limit, *said, 0))
    return rows, choices


def _checks(port: Port) -> Iterator[tuple[str, float, str, str]]:
    """What is told of a value that breaks a limit, the limit, the cure and the unit."""
    entry = entry_at(port.path)
    assert isinstance(entry, Number), f"{port.name} is no number"
    for text, limit in (("endless", 0.0), *entry.limits()):
        yield text, float(limit), entry.cure_of(text), entry.unit


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
