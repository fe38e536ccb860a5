"""What a field of a configuration is: its TOML key, unit, limits and cure, said once in a table.

An entry sits in the metadata of a dataclass field. From the entries come the reader of a TOML
tree, the checks of every value, the writer and the list of legal keys; no key is named twice.

    length: float = number(6.0, "length_m", "m", above=0.0, at_most=100.0)

Messages speak as the user does: while a file is read (`keys.reading`) they name its keys and give
values and limits in their units (`deck[1].panel[1].aperture_mm = 16000`), else fields in SI.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import reprlib
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Self, TypeVar

from vibroscreen.errors import ConfigError, Faults, InputError, given, told, with_unit
from vibroscreen.keys import WORDS, Unit, meant_units, of_file, reading, split
from vibroscreen.toml_text import text_of, toml_tree

T = TypeVar("T")
Metadata = Mapping[str, "Entry"]

# Kinds of which a screen has one number only: their units alone say which is meant.
_ALONE = ("Hz", "kg/s", "kg/m3")
# What is further out of range than this was meant in another unit.
FAR = 1.5
# Reaches every double: 17 digits tell any two of them apart.
_DIGITS = range(1, 18)


class Entry(ABC):
    """How one field of a configuration is read, checked and written."""

    key: str

    @property
    def keys(self) -> tuple[str, ...]:
        """TOML keys that give this field; at most one of them may be used."""
        return (self.key,)

    def leaves(self) -> Iterable[tuple[str, Entry]]:
        """Full names of the legal keys below this entry, each with its own entry."""
        return ((key, self) for key in self.keys)

    def meant(self, path: str, key: str, raw: Any) -> str | None:
        """What to write for the value of an unknown key; None if it means something else."""
        del path, key, raw
        return None

    def called(self, field: str) -> str:
        """Name in messages of the field of that name."""
        return self.key if of_file() else field

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

    `factor` converts the unit of the TOML key to SI. also: other words for it, as people begin its
    key. tells: what a reader is told of it; cure: what to do about a value out of range.
    variability: "tunable" while the screen runs, "fixed" before, "constant" since it was built,
    "continuous" for an input; "" for what is no number of the engine. slack: how far beyond its
    limits a value is taken for round-off while it runs.
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
    also: str = ""
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
            raise self.error(f"{name} = {value!r} is not {kind}{self.range}: {self.plain_cure}")
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
        return self.error(self.told(text, name, number))

    def told(self, text: str, name: str, value: float, bound: float = 0.0, **more: float) -> str:
        """The text of that key about a value and its bound in SI, in the user's unit."""
        factor, unit = self.spoken
        shown = from_si(value, factor)
        about: dict[str, Any] = {
            "name": name,
            "given": given(name, shown, "" if of_file() else unit),
            "value": shown,
            "limit": from_si(bound, factor),
            "unit": unit,
            "range": self.range,
            "cure": self.cure_of(text, value),
        }
        return told(text, **{**about, **more})

    @cached_property
    def written(self) -> Unit:
        """The unit of the TOML key."""
        unit = split(self.key)[1]
        return unit if unit and unit.si == self.unit else Unit(self.unit, self.unit)

    @property
    def spoken(self) -> tuple[float, str]:
        """Factor to SI and unit of what the user is told."""
        return (self.factor, self.written.text) if of_file() else (1.0, self.unit)

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
        least, most = self.bounds
        if least is None and most is None:
            return ""
        factor, unit = self.spoken
        unit = "" if unit == "1" else f" {unit}"
        low = "" if least is None else f"{from_si(least, factor):.6g}"
        high = "" if most is None else f"{from_si(most, factor):.6g}"
        if self.above is None and self.below is None and low and high:
            return f" ({low} to {high}{unit})"
        low = low and f"{'from' if self.above is None else 'above'} {low}"
        high = high and f"{'to' if self.below is None else 'below'} {high}"
        return f" ({' '.join(filter(None, (low, high)))}{unit})"

    def write(self, value: Any) -> Any:
        return value if self.whole or value is None else from_si(value, self.factor)

    def text(self, value: float) -> str:
        """A value with its unit."""
        factor, unit = self.spoken
        return with_unit(from_si(value, factor), unit)

    def cure_of(self, text: str, value: float) -> str:
        """What to do about a value of which `text` (errors.TEXT) is told."""
        factor, _ = self.spoken
        said = from_si(value, factor)
        if text in ("too_small", "too_large") and self._far(value):
            for unit in self.other_units:
                meant = said * unit.factor * (factor / self.written.factor if of_file() else 1.0)
                if self._takes(meant):
                    return self.question(unit).format(value=said, meant=from_si(meant, factor))
        return self.plain_cure

    @property
    def plain_cure(self) -> str:
        """What to do about a value that is just out of range."""
        kind = "a whole number" if self.whole else "a number"
        where = "" if of_file() else f" ({self.key} in a TOML file)"
        return self.cure or f"give {kind} in this range{where}"

    @property
    def other_units(self) -> list[Unit]:
        """Units that a value may have been meant in: in SI the likeliest one, for a file all."""
        if self.unit == "1" and (self.whole or self.limits[0] < 0.0 or self.limits[1] > 1.0):
            return []
        others = [unit for unit in meant_units(self.unit) if unit.text != self.spoken[1]]
        return others if of_file() else others[:1]

    def question(self, unit: Unit) -> str:
        """Whether a value was meant in another unit; in braces the value, and what it would be."""
        own = "" if self.unit == "1" else f" {self.spoken[1]}"
        return f"were {unit.name} meant? {{value:.6g}} {unit.text} is {{meant:.6g}}{own}"

    def _far(self, number: float) -> bool:
        """Whether a number is so far out of range that its unit must be another."""
        least, most = self.limits
        return abs(number) > FAR * max(abs(least), abs(most)) or number < least / FAR

    def _takes(self, number: float) -> bool:
        """Whether a number is within the limits."""
        return self.limits[0] <= number <= self.limits[1]

    def meant(self, path: str, key: str, raw: Any) -> str | None:
        found = self.converted(key, as_float(raw)) if _is_number(raw) else None
        return found and f"{path} = {found[0]:.6g}{found[1]}"

    def converted(self, key: str, raw: float) -> tuple[float, str] | None:
        """A number under a key that is unknown, in the unit of the right key, and how it came."""
        words, unit = split(key)
        stem, own = split(self.key)[0], self.written
        alone = not words and unit is not None and unit.si in _ALONE
        if not alone and words not in (stem, *self.also.split()):
            return None
        if unit is not None and unit.si != self.unit:
            return None
        # A key may count in twice what the field does (stroke, amplitude).
        same = words == stem or self.factor == own.factor
        scale = self.factor / own.factor if words == stem else 1.0
        likely = [unit] if unit else [own, *meant_units(self.unit)]
        fits = (one for one in likely if self._takes(raw * one.factor * scale))
        unit = next(fits, likely[0])
        why = "" if unit.text == own.text else f"{raw:.6g} {unit.text}"
        if not same:
            why = f"the {stem} is {own.factor / self.factor:g} times the {words}"
        shown = from_si(raw * unit.factor * scale, self.factor)
        return shown, why and f" ({why})"


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

    def meant(self, path: str, key: str, raw: Any) -> str | None:
        if not isinstance(raw, list) or not all(map(_is_number, raw)):
            return None
        found = [self.item.converted(key, as_float(value)) for value in raw]
        return listed(path, [one[0] for one in found if one]) if all(found) and found else None


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

    also, tells and variability: as of a Number; meanings: what a reader is told of each name.
    optional: whether it may be left out, as None.
    """

    key: str
    names: Callable[[], tuple[str, ...]]
    tells: str = ""
    meanings: tuple[str, ...] = ()
    variability: str = "fixed"
    optional: bool = False
    also: str = ""

    def meant(self, path: str, key: str, raw: Any) -> str | None:
        return f'{path} = "{raw}"' if key in self.also.split() and raw in self.names() else None

    def check(self, name: str, value: Any) -> Any:
        if value is None and self.optional:
            return None
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

    def leaves(self) -> Iterable[tuple[str, Entry]]:
        return ((f"{self.key}.{path}", entry) for path, entry in leaves(self.kind))

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
    """A list of tables of the TOML file, at least one unless `optional`, each a dataclass."""

    optional: bool = False

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, list):
            raise ConfigError(f"{name} = {raw!r} is not a list of tables: write [[{name}]]")
        tables, faults = [], Faults()
        for place, tree in enumerate(raw, start=1):
            with faults:
                tables.append(super().read(f"{name}[{place}]", tree, folder))
        faults.tell()
        return tuple(tables)

    def check(self, name: str, value: Any) -> Any:
        values = as_tuple(value)
        if self.optional and values == ():
            return ()
        if not values:
            raise ConfigError(
                f"{name} = {value!r} is not a list of {self.kind.__name__}: give one or more"
            )
        check_one = super().check
        return tuple(check_one(f"{name}[{i}]", v) for i, v in enumerate(values, start=1))

    def write(self, value: Any) -> Any:
        return [write_table(v) for v in value]


@dataclass(frozen=True)
class FileOf(Entry):
    """What a file of its own describes: that, or the name of its file, relative to this one.

    kinds: by key, what reads the file under that key (`load`); it is what such a field holds.
    noun: what that is called; this: what the file is called that names it.
    """

    key: str
    kinds: Mapping[str, Any]
    noun: str
    this: str

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(self.kinds)

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, str):
            raise ConfigError(
                f"{name} = {raw!r} is not a text: give the name of {self.noun}'s file"
            )
        try:
            return self.kinds[name.rpartition(".")[2]].load(folder / raw)
        except OSError as error:
            raise ConfigError(
                f"{name} = {raw!r} cannot be read ({error.strerror}): give the file of "
                f"{self.noun}, relative to that of {self.this}"
            ) from None

    def check(self, name: str, value: Any) -> Any:
        if not isinstance(value, tuple(self.kinds.values())):
            wanted = " or a ".join(kind.__name__ for kind in self.kinds.values())
            raise ConfigError(f"{name} = {value!r} is not a {wanted}: give one")
        return value


class OfFile:
    """A dataclass that a TOML file describes."""

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """What a TOML file describes. Raises ConfigError, OSError if it cannot be read."""
        path = Path(path)
        try:
            return cls.loads(text_of(path), path.parent)
        except ConfigError as error:
            error.add_note(f"in {path}")
            raise

    @classmethod
    def loads(cls, text: str, folder: str | Path = "") -> Self:
        """What the text of a TOML file describes; file names in it are relative to `folder`."""
        return cls.from_dict(toml_tree(text), folder)

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any], folder: str | Path = "") -> Self:
        """What the tree of a TOML file describes; file names are relative to `folder`."""
        with reading(cls, tree):
            return read_table(cls, tree, "", Path(folder))


def of(entry: Entry) -> Metadata:
    """Metadata of a dataclass field that holds its entry."""
    return {"entry": entry}


def number(default: Any, key: str, unit: str = "1", factor: float = 1.0, **about: Any) -> Any:
    """A dataclass field that is a number; `about` is the rest of `Number`."""
    return said(default, Number(key, unit, factor, **about))


def said(default: Any, entry: Entry) -> Any:
    """A dataclass field with its entry."""
    return dataclasses.field(default=default, metadata=of(entry))


def fields_alone(one: Any) -> dict[str, Any]:
    """What is pickled of a dataclass: its fields; what was found of them is found again."""
    return {field.name: getattr(one, field.name) for field in dataclasses.fields(one)}


def entries(kind: Any) -> dict[str, Entry]:
    """Entry of every field of a configuration dataclass that has one, by the name of the field."""
    fields = dataclasses.fields(kind)
    return {field.name: field.metadata["entry"] for field in fields if "entry" in field.metadata}


def leaves(kind: Any) -> Iterator[tuple[str, Entry]]:
    """Every legal key below a table with its entry, lists of tables without their place."""
    for entry in entries(kind).values():
        yield from entry.leaves()


def check_fields(instance: Any, name: str) -> None:
    """Check every field of a frozen dataclass against its entry and store it as checked.

    `name` is what the dataclass is called in messages, "" at the top. Raises the error of the
    first bad field.
    """
    prefix = f"{name}." if name else ""
    for field_name, entry in entries(type(instance)).items():
        checked = entry.check(prefix + field_name, getattr(instance, field_name))
        object.__setattr__(instance, field_name, checked)


def in_engine(section: Any, field: str) -> float:
    """A number of a configuration dataclass as the engine holds it: a choice by its place from 1.

    The property `effective`, if it has one, says what stands for a field that is not given.
    """
    entry, value = entries(type(section))[field], getattr(section, field)
    value = getattr(section, "effective", {}).get(field, value)
    return float(entry.names().index(value) + 1 if isinstance(entry, Choice) else value)


def told_of(
    kind: Any, field: str, table: str, text: str, value: float, bound: float = 0.0, **more: float
) -> str:
    """The text of that key (errors.TEXT) about a number of a dataclass, of the table so called."""
    entry = entries(kind)[field]
    assert isinstance(entry, Number)
    return entry.told(text, f"{table}.{entry.called(field)}", value, bound, **more)


def read_table(kind: Callable[..., T], tree: Any, name: str, folder: Path) -> T:
    """A configuration dataclass from a table of a TOML file.

    `name` is the table's ("" at the top of the file), `folder` the one that file names in the
    table are relative to. Raises ConfigError of all keys that are unknown, missing, given twice or
    have a bad value.
    """
    if not isinstance(tree, Mapping):
        raise ConfigError(f"{name} = {tree!r} is not a table: write [{name}]")
    prefix = f"{name}." if name else ""
    faults = Faults(_unknown(kind, tree, prefix))
    values = {}
    for field_name, entry in entries(kind).items():
        given = [key for key in entry.keys if key in tree]
        key = prefix + (given[0] if given else entry.key)
        if len(given) > 1:
            both = " and ".join(prefix + key for key in given)
            faults.append(f"{both} say the same twice: give one of them")
        elif given:
            with faults:
                values[field_name] = entry.check(key, entry.read(key, tree[given[0]], folder))
        elif field_name in _required(kind):
            faults.append(f"{key} is missing, it has no default: give it")
    faults.tell()
    return kind(**values)


def write_table(instance: Any) -> dict[str, Any]:
    """Table of a TOML file from a configuration dataclass; `read_table` gives the same back."""
    written = {
        entry.key: entry.write(getattr(instance, name))
        for name, entry in entries(type(instance)).items()
    }
    return {key: value for key, value in written.items() if value is not None}


def _unknown(kind: Any, tree: Mapping[str, Any], prefix: str) -> Iterator[str]:
    """What is said of every key that a table does not have: what was likely meant by it."""
    legal = [key for entry in entries(kind).values() for key in entry.keys]
    below = [(prefix + path, entry) for path, entry in leaves(kind)]
    # Keys of earlier versions that mean nothing here, and why, as the table says.
    aside = kind.left_aside(tree) if hasattr(kind, "left_aside") else {}
    for key, raw in tree.items():
        if key in legal:
            continue
        if key in aside:
            warnings.warn(f"{prefix}{key} {aside[key]}: leave it out", stacklevel=2)
            continue
        name = f"{prefix}{key} = {reprlib.repr(raw)} is unknown"
        everywhere = [*below, *leaves(of_file() or kind)]
        found = (entry.meant(path, key, raw) for path, entry in everywhere)
        meant = next(filter(None, found), None)
        if meant:
            yield f"{name}: write {meant}"
        elif key in WORDS:
            yield f"{name}: {WORDS[key]}"
        else:
            # A key one table too high is more likely than a misspelt one.
            deeper = [path for path, _ in below if path.rpartition(".")[2] == key]
            near = deeper[0] if deeper else prefix + nearest(key, legal)
            yield f"{prefix}{key} is unknown: did you mean {near}?"


def _required(kind: Any) -> list[str]:
    missing = dataclasses.MISSING
    return [field.name for field in dataclasses.fields(kind) if field.default is missing]


def _is_number(raw: Any) -> bool:
    return isinstance(raw, Real) and not isinstance(raw, bool)


def listed(path: str, values: Iterable[float]) -> str:
    """A list as a TOML file has it."""
    return f"{path} = [{', '.join(f'{value:.6g}' for value in values)}]"


def to_si(raw: Any, factor: float) -> Any:
    """A number times the factor of its unit; anything else as it is."""
    if not _is_number(raw) or factor == 1.0:
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


def ascending_pairs(
    name: str, value: Any, first: tuple[str, Number], second: tuple[str, Number], wrong: str
) -> tuple[tuple[float, float], ...]:
    """Two or more rows of two numbers, ascending in the first.

    first, second: what a number of a row is called, and what is said of it; wrong: what is said of
    a value that is no such table. Raises ConfigError.
    """
    rows = [as_tuple(row) for row in as_tuple(value) or ()]
    pairs = [row for row in rows if row is not None and len(row) == 2]
    if len(rows) < 2 or len(pairs) < len(rows):
        raise ConfigError(f"{name} = {value!r} {wrong}")
    (one, low), (other, high) = first, second
    table = tuple(
        (low.check(f"{name}[{i}].{one}", a), high.check(f"{name}[{i}].{other}", b))
        for i, (a, b) in enumerate(pairs, start=1)
    )
    for i in range(1, len(table)):
        if table[i][0] <= table[i - 1][0]:
            raise ConfigError(
                f"{name}[{i + 1}].{one} = {low.text(table[i][0])} is not larger than the one "
                f"before, {low.text(table[i - 1][0])}: sort the rows by {one}"
            )
    return table


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name most like `name`."""
    return difflib.get_close_matches(name, list(known), n=1, cutoff=0.0)[0]
