"""How people write a number: the unit that ends its key, and the units that it is mistaken for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

from vibroscreen.units import (
    CM,
    DEG,
    G_CM3,
    INCH,
    KG_H,
    MICROMETRE,
    MM,
    PERCENT,
    RPM,
    T_H,
    T_M3,
    TONNE,
)

__all__ = ["UNITS", "WORDS", "Unit", "file_value", "meant_units", "of_file", "reading", "split"]


class Unit(NamedTuple):
    """A unit as messages write it, the SI unit it is converted to, the factor, its name.

    Without a name it may end a key, but nobody is asked whether it was meant.
    """

    text: str
    si: str
    factor: float = 1.0
    name: str = ""


# What a key may end in. Those with a name are asked for in this order.
UNITS = {
    "mm": Unit("mm", "m", MM, "millimetres"),
    "um": Unit("um", "m", MICROMETRE, "micrometres"),
    "m": Unit("m", "m", 1.0, "metres"),
    "cm": Unit("cm", "m", CM),
    "in": Unit("in", "m", INCH),
    "inch": Unit("in", "m", INCH),
    "deg": Unit("deg", "rad", DEG, "degrees"),
    "rad": Unit("rad", "rad"),
    "rpm": Unit("1/min", "Hz", RPM, "1/min"),
    "hz": Unit("Hz", "Hz"),
    "t_h": Unit("t/h", "kg/s", T_H, "t/h"),
    "kg_h": Unit("kg/h", "kg/s", KG_H, "kg/h"),
    "tph": Unit("t/h", "kg/s", T_H),
    "kg_s": Unit("kg/s", "kg/s"),
    "t_m3": Unit("t/m3", "kg/m3", T_M3, "t/m3"),
    "g_cm3": Unit("g/cm3", "kg/m3", G_CM3),
    "kg_m3": Unit("kg/m3", "kg/m3"),
    "percent": Unit("per cent", "1", PERCENT, "per cent"),
    "pct": Unit("per cent", "1", PERCENT),
    "t": Unit("t", "kg", TONNE, "tonnes"),
    "kg": Unit("kg", "kg"),
    "mm_s": Unit("mm/s", "m/s", MM, "mm/s"),
    "m_s": Unit("m/s", "m/s"),
}
# Keys that no number of a screen answers.
WORDS = {
    "mesh": "a mesh number does not say how wide an opening is, give the clear opening: aperture_mm"
}
_ENDINGS = sorted(UNITS, key=len, reverse=True)
# The dataclass and the tree of the file that is being read: messages speak its keys and units.
_FILE: ContextVar[tuple[Any, Mapping[str, Any]] | None] = ContextVar("file", default=None)


def split(key: str) -> tuple[str, Unit | None]:
    """The words of a key and the unit that it ends in: `bulk_density` and kg/m3; None without."""
    for ending in _ENDINGS:
        if key == ending or key.endswith(f"_{ending}"):
            return key.removesuffix(ending).removesuffix("_"), UNITS[ending]
    return key, None


def meant_units(si: str) -> list[Unit]:
    """Units of that kind that a number may have been meant in."""
    return [unit for unit in UNITS.values() if unit.si == si and unit.name]


@contextmanager
def reading(kind: Any, tree: Mapping[str, Any]) -> Iterator[None]:
    """While a file is read, values are told under its keys, in its units."""
    token = _FILE.set((kind, tree))
    try:
        yield
    finally:
        _FILE.reset(token)


def of_file() -> Any:
    """The dataclass that is being read from a file, None where none is."""
    found = _FILE.get()
    return found and found[0]


def file_value(table: str, key: str) -> Any:
    """What the file that is being read says in a table; None if it does not."""
    found = _FILE.get()
    section = found and found[1].get(table)
    return section.get(key) if isinstance(section, Mapping) else None
