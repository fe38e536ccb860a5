"""What a field of a configuration is: its TOML key, unit, limits and cure, said once in a table.

An entry sits in the metadata of a dataclass field. From the entries come the reader of a TOML
tree, the checks of every value, the writer and the list of legal keys; no key is named twice.

    length: float = number(6.0, "length_m", "m", above=0.0, at_most=100.0)

Names in messages are relative to the dataclass (`panel.aperture`); where a list of tables is read
they get their place in it (`deck[1].panel[1].aperture`).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

from vibroscreen.errors import ConfigError, InputError, given, told, with_unit

T = TypeVar("T")
Metadata = Mapping[str, "Entry"]

# What a value far too large usually is: unit -> (unit meant, unit asked for).
_CONFUSED = {"m": ("millimetres", "metres"), "rad": ("degrees", "radians")}
# Reaches every double: 17 digits tell any two of them apart.
_DIGITS = range(1, 18)


class Entry(ABC):
    """How one field of a configuration is read, checked and written."""

    key: str

    @property
    def keys(self) -> tuple[str, ...]:
        """TOML keys that give this field; at most one of them may be used."""
        return (self.key,)

    def paths(self) -> Iterable[str]:
        """Full names of the legal keys below this entry."""
        return self.keys

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        """Value in SI from the TOML value of the key `name`; its type is left to `check`."""
        del name, folder
        return raw

    @abstractmethod
    def check(self, name: str, value: Any) -> Any:
        """The value as it is stored; raises ConfigError that starts with `name`."""

    def write(self, value: Any) -> Any:
        """TOML value from the stored value; None leaves the key out."""
        return value


@dataclass(frozen=True)
class Number(Entry):
    """A number in SI, said once: reader, checks, messages, buffer and FMU variable follow.

    `factor` converts the unit of the TOML key to SI. tells: what a reader is told of it; cure: what
    to do about a value out of range. variability: "tunable" while the screen runs, "fixed" before,
    "constant" since it was built, "continuous" for an input; "" for what is no number of the
    engine. slack: how far beyond its limits a value is taken for round-off while it runs.
    """

    key: str
    unit: str = "1"
    factor: float = 1.0
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    whole: bool = False
    optional: bool = False
    tells: str = ""
    cure: str = ""
    variability: str = "fixed"
    slack: float = 0.0
    error: type[ConfigError | InputError] = ConfigError

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        del name, folder
        return to_si(raw, self.factor)

    def check(self, name: str, value: Any) -> Any:
        if value is None and self.optional:
            return None
        wanted = Integral if self.whole else Real
        # Asking an abstract class takes longer than all the rest.
        plain = type(value) is float and not self.whole
        if not plain and (isinstance(value, bool) or not isinstance(value, wanted)):
            kind = "a whole number" if self.whole else "a number"
            cure = self.cure_of("not_finite")
            raise self.error(f"{name} = {value!r} is not {kind}{self.range}: {cure}")
        number = as_float(value)
        least, most = self.limits
        if not math.isfinite(number):
            raise self.refusal(name, number, "not_finite")
        if number < least:
            raise self.refusal(name, number, "too_small")
        if number > most:
            raise self.refusal(name, number, "too_large")
        return int(number) if self.whole else number

    def refusal(self, name: str, number: float, text: str) -> Exception:
        """The error of a number of which `text` (errors.TEXT) is told."""
        about = {"given": given(name, number, self.unit), "range": self.range}
        return self.error(told(text, **about, cure=self.cure_of(text)))

    @cached_property
    def limits(self) -> tuple[float, float]:
        """Least and largest value that are allowed."""
        least = self.at_least if self.at_least is not None else -math.inf
        most = self.at_most if self.at_most is not None else math.inf
        if self.above is not None:
            least = math.nextafter(self.above, math.inf)
        if self.below is not None:
            most = math.nextafter(self.below, -math.inf)
        return least, most

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Limits as people write them, None where there is none."""
        least = self.at_least if self.above is None else self.above
        return least, self.at_most if self.below is None else self.below

    @property
    def range(self) -> str:
        """The limits in words, in brackets; nothing where there are none."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        least, most = self.bounds
        if least is None and most is None:
            return ""
        low = "" if least is None else f"{'from ' if self.above is None else 'above '}{least:.6g}"
        high = "" if most is None else f"{'to ' if self.below is None else 'below '}{most:.6g}"
        if self.above is None and self.below is None and low and high:
            low = low.removeprefix("from ")
        return f" ({low}{' ' if low and high else ''}{high}{unit})"

    def write(self, value: Any) -> Any:
        return value if self.whole or value is None else from_si(value, self.factor)

    def text(self, value: float) -> str:
        """A value with its unit."""
        return with_unit(value, self.unit)

    def cure_of(self, text: str) -> str:
        """What to do about a value of which `text` (errors.TEXT) is told."""
        if self.cure:
            return self.cure
        if text == "too_large" and self.unit in _CONFUSED:
            return confused_units(self.unit, self.key)
        kind = "a whole number" if self.whole else "a number"
        return f"give {kind} in this range ({self.key} in a TOML file)"


@dataclass(frozen=True)
class Numbers(Entry):
    """A list of numbers in SI; `item` says what each of them is, `least` how many there must be."""

    key: str
    item: Number
    least: int = 1

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, list):
            return raw
        return tuple(self.item.read(name, value, folder) for value in raw)

    def check(self, name: str, value: Any) -> tuple[float, ...]:
        cure = f"give {self.least} or more numbers ({self.key} in a TOML file)"
        values = as_tuple(value)
        if values is None:
            raise self.item.error(f"{name} = {value!r} is not a list of numbers: {cure}")
        if len(values) < self.least:
            raise self.item.error(f"{name} has {len(values)} values, too few: {cure}")
        return tuple(self.item.check(f"{name}[{i}]", v) for i, v in enumerate(values, start=1))

    def write(self, value: Any) -> Any:
        return [self.item.write(v) for v in value]


@dataclass(frozen=True)
class Text(Entry):
    """A string."""

    key: str

    def check(self, name: str, value: Any) -> str:
        if not isinstance(value, str):
            raise ConfigError(f"{name} = {value!r} is not a text: put it in quotes")
        return value


@dataclass(frozen=True)
class Choice(Entry):
    """One of the names that `names()` lists; in the engine its place there, from 1 on.

    tells and variability: as of a Number; meanings: what a reader is told of each name.
    """

    key: str
    names: Callable[[], tuple[str, ...]]
    tells: str = ""
    meanings: tuple[str, ...] = ()
    variability: str = "fixed"

    def check(self, name: str, value: Any) -> str:
        known = self.names()
        if value in known:
            return str(value)
        close = difflib.get_close_matches(str(value), known, n=1)
        meant = f" (did you mean {close[0]!r}?)" if close else ""
        raise ConfigError(f"{name} = {value!r} is unknown: give one of {', '.join(known)}{meant}")


@dataclass(frozen=True)
class Section(Entry):
    """A table of the TOML file that is a dataclass of its own."""

    key: str
    kind: type

    def paths(self) -> Iterable[str]:
        return (f"{self.key}.{path}" for path in paths(self.kind))

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        return read_table(self.kind, raw, name, folder)

    def check(self, name: str, value: Any) -> Any:
        if not isinstance(value, self.kind):
            raise ConfigError(
                f"{name} = {value!r} is not a {self.kind.__name__}: give {self.kind.__name__}(...)"
            )
        return value

    def write(self, value: Any) -> Any:
        return write_table(value)


@dataclass(frozen=True)
class Sections(Section):
    """A list of tables of the TOML file, at least one, each a dataclass."""

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, list):
            raise ConfigError(f"{name} = {raw!r} is not a list of tables: write [[{name}]]")
        read_one = super().read
        tables = []
        for place, tree in enumerate(raw, start=1):
            with in_place(name, place):
                tables.append(read_one(name, tree, folder))
        return tuple(tables)

    def check(self, name: str, value: Any) -> Any:
        values = as_tuple(value)
        if not values:
            raise ConfigError(
                f"{name} = {value!r} is not a list of {self.kind.__name__}: give one or more"
            )
        check_one = super().check
        return tuple(check_one(f"{name}[{i}]", v) for i, v in enumerate(values, start=1))

    def write(self, value: Any) -> Any:
        return [write_table(v) for v in value]


def of(entry: Entry) -> Metadata:
    """Metadata of a dataclass field that holds its entry."""
    return {"entry": entry}


def number(default: Any, key: str, unit: str = "1", factor: float = 1.0, **about: Any) -> Any:
    """A dataclass field that is a number; `about` is the rest of `Number`."""
    return said(default, Number(key, unit, factor, **about))


def said(default: Any, entry: Entry) -> Any:
    """A dataclass field with its entry."""
    return dataclasses.field(default=default, metadata=of(entry))


def entries(kind: Any) -> dict[str, Entry]:
    """Entry of every field of a configuration dataclass that has one, by the name of the field."""
    fields = dataclasses.fields(kind)
    return {field.name: field.metadata["entry"] for field in fields if "entry" in field.metadata}


def paths(kind: Any) -> tuple[str, ...]:
    """Every legal key below a table, lists of tables without their place."""
    return tuple(path for entry in entries(kind).values() for path in entry.paths())


def check_fields(instance: Any, name: str) -> None:
    """Check every field of a frozen dataclass against its entry and store it as checked.

    `name` is what the dataclass is called in messages, "" at the top. Raises the error of the
    first bad field.
    """
    prefix = f"{name}." if name else ""
    for field_name, entry in entries(type(instance)).items():
        checked = entry.check(prefix + field_name, getattr(instance, field_name))
        object.__setattr__(instance, field_name, checked)


def read_table(kind: Callable[..., T], tree: Any, name: str, folder: Path) -> T:
    """A configuration dataclass from a table of a TOML file.

    `name` is the table's ("" at the top of the file), `folder` the one that file names in the
    table are relative to. Raises ConfigError for a key that is unknown, missing or given twice.
    """
    if not isinstance(tree, Mapping):
        raise ConfigError(f"{name} = {tree!r} is not a table: write [{name}]")
    prefix = f"{name}." if name else ""
    table = entries(kind)
    _check_known(kind, tree, prefix)
    values = {}
    for field_name, entry in table.items():
        given = [key for key in entry.keys if key in tree]
        if len(given) > 1:
            both = " and ".join(prefix + key for key in given)
            raise ConfigError(f"{both} say the same twice: give one of them")
        if given:
            values[field_name] = entry.read(prefix + given[0], tree[given[0]], folder)
    for field_name in _required(kind):
        if field_name not in values:
            missing = prefix + table[field_name].key
            raise ConfigError(f"{missing} is missing, it has no default: give it")
    return kind(**values)


def write_table(instance: Any) -> dict[str, Any]:
    """Table of a TOML file from a configuration dataclass; `read_table` gives the same back."""
    written = {
        entry.key: entry.write(getattr(instance, name))
        for name, entry in entries(type(instance)).items()
    }
    return {key: value for key, value in written.items() if value is not None}


@contextmanager
def in_place(name: str, place: int) -> Iterator[None]:
    """An error about the table `name` is told about `name[place]`."""
    try:
        yield
    except (ConfigError, InputError) as error:
        pattern = rf"(?<![\w.]){re.escape(name)}(?=\.| = )"
        raise ConfigError(re.sub(pattern, f"{name}[{place}]", str(error))) from None


def _check_known(kind: Any, tree: Mapping[str, Any], prefix: str) -> None:
    legal = [key for entry in entries(kind).values() for key in entry.keys]
    for key in tree:
        if key not in legal:
            # A key one table too high is more likely than a misspelt one.
            deeper = [path for path in paths(kind) if path.rpartition(".")[2] == key]
            meant = deeper[0] if deeper else nearest(key, legal)
            raise ConfigError(f"{prefix}{key} is unknown: did you mean {prefix}{meant}?")


def _required(kind: Any) -> list[str]:
    missing = dataclasses.MISSING
    return [field.name for field in dataclasses.fields(kind) if field.default is missing]


def to_si(raw: Any, factor: float) -> Any:
    """A number times the factor of its unit; anything else as it is."""
    if isinstance(raw, bool) or not isinstance(raw, Real) or factor == 1.0:
        return raw
    return as_float(raw) * factor


def from_si(value: float, factor: float) -> float:
    """The shortest decimal that `to_si` takes back to the value.

    Not every double is a double times the factor. Where none is, the nearest: it comes back within
    one unit in the last place, and from then on exactly.
    """
    quotient = value / factor
    shortest = (float(f"{quotient:.{digits}g}") for digits in _DIGITS)
    beside = (math.nextafter(quotient, -math.inf), math.nextafter(quotient, math.inf))
    for candidate in (*shortest, *beside):
        if candidate * factor == value:
            return candidate
    return quotient


def as_float(value: Any) -> float:
    """A real number as a float, whole numbers beyond its range as infinity."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def as_tuple(value: Any) -> tuple[Any, ...] | None:
    """A list, tuple or array as a tuple; None for anything else."""
    if type(value) is tuple:
        return value
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return tuple(value)
    return None


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name most like `name`."""
    return difflib.get_close_matches(name, list(known), n=1, cutoff=0.0)[0]


def confused_units(unit: str, key: str) -> str:
    """Cure of a value that is far too large in its SI unit, the key's unit being another."""
    meant, asked = _CONFUSED[unit]
    give = asked if key.endswith(f"_{unit}") else f"{key} or {asked}"
    return f"were {meant} meant? give {give}"
