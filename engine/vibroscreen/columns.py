"""What the columns of a table through time say: time, feed, gradation, motion, products.

Keys are those of a screen's file and may have another unit that is known, as frequency_rpm:

    time_s, time_min, time_h    time since any moment; or
    time                        date and time, as 2024-05-01 06:00:00
    rate_t_h                    feed of dry solids
    passing_16_mm               of the feed, finer than 16 mm, one for every limit of the classes
                                but 0 and the largest; in per cent or parts of one
    frequency_hz, stroke_mm, throw_angle_deg, ellipticity       motion
    undersize_t_h, oversize_t_h, intermediate[1]_t_h            products as they were measured
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.fields import Number, entries, from_si, nearest
from vibroscreen.keys import UNITS, reading
from vibroscreen.motion import Motion
from vibroscreen.stream import Feed, product_names
from vibroscreen.units import HOUR, MINUTE, MM

__all__ = ["MOST", "STAMP", "TIMES", "Column", "input_column", "passing_columns", "product_column"]

TIMES = {"time_s": 1.0, "time_min": MINUTE, "time_h": HOUR}
STAMP = "time"
PASSING = re.compile(r"passing_(\d+(?:\.\d+)?)_mm")
PRODUCT = re.compile(r"(undersize|oversize|intermediate(?:\[\d+\])?)(?:_rate)?_(\w+)")
# Shares of a passing that are larger are per cent.
MOST = 1.5


@dataclass(frozen=True)
class Column:
    """A column of a table: the key that it gives, and the field of a Feed or a Motion (`kind`)."""

    name: str
    key: str
    kind: type
    field: str
    entry: Number

    def read(self, value: float) -> float:
        """A cell in SI. Raises InputError for a value out of range."""
        other = None if self.key == self.entry.key else self.entry.converted(self.key, value)
        si = self.entry.read(self.name, value if other is None else other[0], Path())
        with reading(ScreenConfig, {}):
            return float(self.entry.check(self.name, si))

    @cached_property
    def factor(self) -> float:
        """What a cell is times to be in SI. Raises InputError for a key that tells no unit."""
        if self.key == self.entry.key:
            return self.entry.factor
        if not any(self.key == unit or self.key.endswith(f"_{unit}") for unit in UNITS):
            raise InputError(
                f"{self.key} tells no unit: give one, as in {self.entry.key}", self.key
            )
        found = self.entry.converted(self.key, 1.0)
        assert found is not None
        return self.entry.factor * found[0]


INPUTS: dict[str, tuple[type, str, Number]] = {
    entry.key: (kind, name, entry)
    for kind in (Feed, Motion)
    for name, entry in entries(kind).items()
    if isinstance(entry, Number)
}


def input_column(name: str) -> Column:
    """The column of that name. Raises InputError for one that says nothing of feed or motion."""
    key = name.removeprefix("feed.").removeprefix("motion.")
    for kind, field, entry in INPUTS.values():
        if key == entry.key or entry.converted(key, 1.0) is not None:
            return Column(name, key, kind, field, entry)
    near = nearest(key, [*TIMES, STAMP, *INPUTS, "passing_16_mm"])
    raise InputError(f"series: the column {name!r} is unknown: did you mean {near!r}?")


def product_column(name: str, decks: int) -> tuple[str, float] | None:
    """The product whose measured rate a column gives, and what a cell is times to be in kg/s.

    None for a column that is none. Raises InputError for a product that the screen has not.
    """
    match = PRODUCT.fullmatch(name)
    unit = UNITS.get(match[2]) if match else None
    if match is None or unit is None or unit.si != "kg/s":
        return None
    stream = "intermediate[1]" if match[1] == "intermediate" else match[1]
    if stream not in product_names(decks):
        raise InputError(
            f"{name}: the screen has no product {stream}: it has {', '.join(product_names(decks))}"
        )
    return stream, unit.factor


def passing_columns(names: Iterable[str], edges: Sequence[float]) -> Mapping[int, str]:
    """Columns of gradations among names, by the place of their limit among the edges [m].

    Empty if there are none; else all inner limits are there. Raises InputError.
    """
    limits = [from_si(edge, MM) for edge in edges]
    found: dict[int, str] = {}
    for name in names:
        if (match := PASSING.fullmatch(name)) is None:
            continue
        size = float(match[1])
        if size not in limits:
            raise InputError(
                f"{name}: the screen has no limit of classes at {size:g} mm: it has "
                f"{', '.join(f'{limit:g}' for limit in limits)} mm"
            )
        found[limits.index(size)] = name
    inner = range(1, len(limits) - 1)
    missing = [f"passing_{limits[k]:g}_mm" for k in inner if k not in found]
    if found and missing:
        raise InputError(f"series: the column {missing[0]} is missing: give all inner limits")
    return {k: found[k] for k in inner} if found else {}
