"""Named sets of numbers: what each was fitted to, how well, and in which range that holds.

A set is a TOML file. Its tables [displacement], [passage], [segregation] and [bed], with the keys
of a screen's file, are the numbers that a screen which names the set does not write itself;
`fitted_to`, `rmse`, `source` and [range] say what they rest on. The files in `calibrations` are
known by their names (`names()`); any other is named by its path. "typical dry stone" has no numbers
of its own: they are the defaults of `sections.py`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from vibroscreen.errors import ConfigError
from vibroscreen.fields import (
    Entry,
    Number,
    Section,
    Text,
    as_tuple,
    check_fields,
    number,
    read_table,
    said,
    write_table,
)
from vibroscreen.keys import split
from vibroscreen.toml_text import toml_text
from vibroscreen.units import DEG, MM

__all__ = [
    "TYPICAL",
    "CalibrationEntry",
    "NumberSet",
    "Range",
    "completed",
    "found",
    "missing",
    "names",
]

TYPICAL = "typical dry stone"
FOLDER = Path(__file__).with_name("calibrations")
# Tables of a screen that a set has numbers of.
TABLES = ("displacement", "passage", "segregation", "bed")
# What says the same in another way, keys without their unit: who gives one of them does not want
# the others of a set. Velocities in m/s follow from the vibration only if told to, so
# `closure` goes with them.
_VELOCITY = frozenset(("velocity", "relative_velocity", "velocity_table"))
_DILATION = frozenset(("dilation", "relative_dilation"))
_CONTACT = frozenset(("contact_depth", "relative_contact_depth"))
_LAYER = _CONTACT | {"layer_depth", "relative_layer_depth"}
_RIVALS = {
    **dict.fromkeys(_VELOCITY, _VELOCITY),
    "closure": _VELOCITY | {"closure"},
    **dict.fromkeys(_DILATION, _DILATION),
    **dict.fromkeys(_LAYER, _LAYER),
    **dict.fromkeys(_CONTACT, _CONTACT),
}


class _Span(Entry):
    """Least and largest value of something, in SI; None where nothing is said of it."""

    def __init__(self, key: str, unit: str = "1", factor: float = 1.0) -> None:
        self.key = key
        self.item = Number(key, unit, factor)

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, list):
            return raw
        return tuple(self.item.read(name, value, folder) for value in raw)

    def check(self, name: str, value: Any) -> tuple[float, float] | None:
        if value is None:
            return None
        pair = as_tuple(value) or ()
        if len(pair) != 2:
            raise ConfigError(f"{name} = {value!r} is not a range: give the least and the largest")
        least, most = (self.item.check(f"{name}[{k}]", v) for k, v in enumerate(pair, start=1))
        if least > most:
            raise ConfigError(f"{name} = {value!r} falls: give the least value first")
        return least, most

    def write(self, value: Any) -> Any:
        return None if value is None else [self.item.write(v) for v in value]


class _Kinds(Entry):
    """Names of kinds of motion, none for any."""

    def __init__(self, key: str) -> None:
        self.key = key

    def check(self, name: str, value: Any) -> tuple[str, ...]:
        kinds = as_tuple(value)
        if kinds is None or not all(kind in MOTIONS for kind in kinds):
            raise ConfigError(f"{name} = {value!r} is unknown: list some of {', '.join(MOTIONS)}")
        return kinds

    def write(self, value: Any) -> Any:
        return list(value) or None


# Kinds of motion that are told apart: a circle by its sense.
MOTIONS = ("linear", "elliptical", "circular with_flow", "circular against_flow", "harmonics")


def _span(key: str, unit: str = "1", factor: float = 1.0) -> Any:
    return said(None, _Span(key, unit, factor))


@dataclass(frozen=True)
class Range:
    """Where a set was fitted: pairs (least, largest), None where it says nothing.

    aperture [m] and inclination [rad] of every panel; throw_number of every deck [1]; acceleration:
    K = amplitude x angular frequency^2 / g [1]; load: feed of the top deck over what VSMA finds to
    be screened at 95 % [1]; oversize: part of the feed coarser than the top deck's aperture [1];
    half_size: part of what is finer than it that is finer than half of it [1]; top_size: of the
    feed, over that aperture [1]. motion: kinds of motion, of MOTIONS; empty: any.
    """

    aperture: tuple[float, float] | None = _span("aperture_mm", "m", MM)
    inclination: tuple[float, float] | None = _span("inclination_deg", "rad", DEG)
    throw_number: tuple[float, float] | None = _span("throw_number")
    acceleration: tuple[float, float] | None = _span("acceleration")
    load: tuple[float, float] | None = _span("load")
    oversize: tuple[float, float] | None = _span("oversize")
    half_size: tuple[float, float] | None = _span("half_size")
    top_size: tuple[float, float] | None = _span("top_size")
    motion: tuple[str, ...] = said((), _Kinds("motion"))

    def __post_init__(self) -> None:
        check_fields(self, "range")


class _Table(Entry):
    """Numbers of a set as its file has them, key by key."""

    def __init__(self, key: str) -> None:
        self.key = key

    def check(self, name: str, value: Any) -> Mapping[str, Any]:
        if value is not None and not isinstance(value, Mapping):
            raise ConfigError(f"{name} = {value!r} is not a table: write [{name}]")
        return dict(value or {})

    def write(self, value: Any) -> Any:
        return dict(value) or None


@dataclass(frozen=True)
class NumberSet:
    """Numbers that belong together, and what they rest on.

    fitted_to: what they were fitted to, in words; source: where the fit is; rmse: root mean square
    error of a recovery there [1], None if unknown; range: where it holds. displacement,
    passage, segregation, bed: keys of a screen's file with their values.
    """

    name: str = said("", Text("name"))
    fitted_to: str = said("", Text("fitted_to"))
    source: str = said("", Text("source"))
    rmse: float | None = number(None, "rmse", at_least=0.0, at_most=1.0, optional=True)
    range: Range = said(Range(), Section("range", Range))
    displacement: Mapping[str, Any] = said(None, _Table("displacement"))
    passage: Mapping[str, Any] = said(None, _Table("passage"))
    segregation: Mapping[str, Any] = said(None, _Table("segregation"))
    bed: Mapping[str, Any] = said(None, _Table("bed"))

    def __post_init__(self) -> None:
        check_fields(self, "material.calibration")
        table = self.passage.get("velocity_table")
        if isinstance(table, str) and table != "default":
            raise ConfigError(
                f"material.calibration.passage.velocity_table = {table!r} is a file: write its "
                "rows (aperture_mm, velocity_m_s) here, [[16, 0.1], [20, 0.11]]"
            )

    def __hash__(self) -> int:
        return hash((self.name, self.range))

    @property
    def shipped(self) -> bool:
        """Whether it is one of those that are not of a user's own."""
        return _shipped().get(self.name) == self

    @classmethod
    def load(cls, path: Path) -> NumberSet:
        """A set from its file. Raises ConfigError."""
        try:
            tree = tomllib.loads(path.read_text(encoding="utf-8"))
            return read_table(cls, tree, "", path.parent)
        except OSError as error:
            raise ConfigError(
                f"material.calibration = {path} cannot be read ({error.strerror}): give a file "
                f"relative to the TOML file, or one of {_listed()}"
            ) from None
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(
                f"material.calibration = {path} is not TOML ({error}): correct it there"
            ) from None
        except ConfigError as error:
            error.add_note(f"in {path}")
            raise

    def to_toml(self) -> str:
        """The file of this set."""
        return toml_text(write_table(self))


@cache
def _shipped() -> dict[str, NumberSet]:
    """The sets of FOLDER by name, the typical one first."""
    found = [NumberSet.load(path) for path in sorted(FOLDER.glob("*.toml"))]
    return {one.name: one for one in sorted(found, key=lambda one: one.name != TYPICAL)}


def names() -> tuple[str, ...]:
    """Names of the sets that are shipped."""
    return tuple(_shipped())


def _listed() -> str:
    return ", ".join(f'"{name}"' for name in names())


def found(value: str | Path | NumberSet, folder: Path = Path()) -> NumberSet:
    """The set of a name, or of a path relative to a folder. Raises ConfigError."""
    if isinstance(value, NumberSet):
        return value
    shipped = _shipped().get(str(value))
    if shipped is not None:
        return shipped
    if isinstance(value, str) and not value.endswith(".toml"):
        raise ConfigError(
            f"material.calibration = {value!r} is unknown: give one of {_listed()}, or the path of "
            "a set of your own that ends in .toml"
        )
    return NumberSet.load(folder / value)


class CalibrationEntry(Entry):
    """A named set: its name where it is shipped, else the set itself."""

    key = "calibration"
    tells = "Named set of the numbers that are not written here, or the path of one of your own"

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if isinstance(raw, Mapping):
            return read_table(NumberSet, raw, name, folder)
        return found(raw, folder) if isinstance(raw, str) else raw

    def check(self, name: str, value: Any) -> str | NumberSet:
        if not isinstance(value, str | Path | NumberSet):
            raise ConfigError(
                f"{name} = {value!r} is not a set of numbers: give one of {_listed()}, or a path"
            )
        one = found(value)
        return one.name if one.shipped else one

    def write(self, value: Any) -> Any:
        return value if isinstance(value, str) else write_table(value)


def completed(tree: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """The tree of a screen's file with the numbers of the set that it names, where it has none."""
    material = tree.get("material")
    raw = material.get("calibration") if isinstance(material, Mapping) else None
    if not isinstance(raw, str | Mapping):
        return tree
    named = CalibrationEntry().read("material.calibration", raw, folder)
    full = dict(tree)
    for table in TABLES:
        written = tree.get(table, {})
        if isinstance(written, Mapping):
            full[table] = {**missing(written, getattr(named, table)), **written}
    return full


def missing(written: Iterable[str], numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Those numbers that are not written, nor what says the same; both by key or by field."""
    said = {split(key)[0] for key in written}
    return {
        key: value
        for key, value in numbers.items()
        if not _RIVALS.get(split(key)[0], {split(key)[0]}) & said
    }
