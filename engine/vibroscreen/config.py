"""What a screen is: frozen dataclasses in SI, checked once, read from and written to TOML.

Every field names its TOML key, unit and limits in its metadata (`fields.py`); `ScreenConfig.load`
reads a file, `to_toml` writes one that gives the same configuration back. Messages name the key of
the file, else the variable as the FMU does, its value, the limit and the cure.
"""

from __future__ import annotations

import dataclasses
import math
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vibroscreen import fields, number_sets
from vibroscreen.edits import edited
from vibroscreen.errors import ConfigError, Faults
from vibroscreen.fields import Choice, Entry, Section, Sections, Text, entries, of, said, told_of
from vibroscreen.kernels.physics.bed_of_grains import BED_CONSTANTS, bed_friction
from vibroscreen.keys import file_value, reading
from vibroscreen.motion import SENSES, Harmonic, Motion
from vibroscreen.number_sets import NumberSet
from vibroscreen.sections import (
    CLOSURES,
    SLOTS,
    Bed,
    Deck,
    Displacement,
    Drive,
    Material,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses, coarse_first
from vibroscreen.stream import Feed, checked_fractions
from vibroscreen.toml_text import text_of, toml_text, toml_tree
from vibroscreen.units import DEG, MM

__all__ = ["ScreenConfig", "legal_keys", "typical_fractions"]

# Default screen: limits of the classes on the sieves of ISO 565, R 20/3 series and its neighbours.
QUARRY_EDGES = tuple(d * MM for d in (0, 1, 2, 4, 5.6, 8, 11.2, 16, 22.4, 31.5, 45, 63, 75))
# Passing of a typical crusher product against size over top size: an assumption, made for a
# screen that is given no feed. It follows Rosin-Rammler, size constant 0.30 and modulus 0.87 of
# the top size, within 3 per cent; 60 per cent is finer than a quarter of the top size.
TYPICAL_SIZE = (0.0, 2.0 / 63.0, 4.0 / 63.0, 8.0 / 63.0, 16.0 / 63.0, 31.5 / 63.0, 1.0)
TYPICAL_PASSING = (0.0, 0.15, 0.25, 0.40, 0.60, 0.85, 1.0)
ROSIN_RAMMLER = (0.30, 0.87)


# --- [motion]: one table for every kind ----------------------------------------------------------
class _MotionTable(Protocol):
    def motion(self) -> Motion: ...


_AMPLITUDE, _FREQUENCY, _THROW_ANGLE, _ELLIPTICITY = (
    entries(Motion)[name] for name in ("amplitude", "frequency", "throw_angle", "ellipticity")
)


@dataclass(frozen=True)
class _Linear:
    amplitude: float = said(5.0 * MM, _AMPLITUDE)
    frequency: float = said(15.5, _FREQUENCY)
    throw_angle: float = said(45.0 * DEG, _THROW_ANGLE)

    def motion(self) -> Motion:
        return Motion.linear(self.amplitude, self.frequency, self.throw_angle)


@dataclass(frozen=True)
class _Circular:
    amplitude: float = said(5.0 * MM, _AMPLITUDE)
    frequency: float = said(15.5, _FREQUENCY)
    sense: str = said("with_flow", Choice("sense", lambda: tuple(SENSES)))

    def motion(self) -> Motion:
        return Motion.circular(self.amplitude, self.frequency, self.sense)


@dataclass(frozen=True)
class _Elliptical(_Linear):
    ellipticity: float = said(0.5, _ELLIPTICITY)

    def motion(self) -> Motion:
        return Motion.elliptical(self.amplitude, self.frequency, self.throw_angle, self.ellipticity)


@dataclass(frozen=True)
class _Harmonics:
    frequency: float = said(15.5, _FREQUENCY)
    amplitude: float = said(0.0, _AMPLITUDE)
    throw_angle: float = said(0.0, _THROW_ANGLE)
    ellipticity: float = said(0.0, _ELLIPTICITY)
    harmonic: tuple[Harmonic, ...] = said((), Sections("harmonic", Harmonic))

    def motion(self) -> Motion:
        if not self.harmonic:
            raise ConfigError(
                'motion.harmonic is missing, motion.kind = "harmonics" has no other movement: '
                "give at least one [[motion.harmonic]]"
            )
        fundamental = (self.frequency, self.amplitude, self.throw_angle, self.ellipticity)
        return Motion(*fundamental, harmonic=self.harmonic)


_KINDS: dict[str, Callable[..., _MotionTable]] = {
    "linear": _Linear,
    "circular": _Circular,
    "elliptical": _Elliptical,
    "harmonics": _Harmonics,
}


_KIND = Choice("kind", lambda: tuple(_KINDS))


def _kind_of(motion: Motion) -> str:
    """The plainest kind of table that says this motion."""
    if motion.harmonic:
        return "harmonics"
    if motion.ellipticity == 0.0:
        return "linear"
    round_and_upright = abs(motion.ellipticity) == 1.0 and motion.throw_angle == 90.0 * DEG
    return "circular" if round_and_upright else "elliptical"


class _MotionSection(Section):
    """[motion]: the key `kind` says which other keys there are."""

    def leaves(self) -> Iterator[tuple[str, Entry]]:
        yield f"{self.key}.kind", _KIND
        for path, entry in dict(leaf for k in _KINDS.values() for leaf in fields.leaves(k)).items():
            yield f"{self.key}.{path}", entry

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, Mapping):
            return super().read(name, raw, folder)
        kind = _KIND.check(f"{name}.kind", raw.get("kind", "linear"))
        table = {key: value for key, value in raw.items() if key != "kind"}
        known = {other: {e.key for e in entries(k).values()} for other, k in _KINDS.items()}
        faults = Faults()
        for key in [key for key in table if key not in known[kind]]:
            owner = next((other for other in known if key in known[other]), None)
            if owner:
                del table[key]
                faults.append(
                    f'{name}.{key} is unknown for kind = "{kind}": it belongs to kind = "{owner}"'
                )
        with faults:
            motion = fields.read_table(_KINDS[kind], table, name, folder).motion()
        faults.tell()
        return motion

    def write(self, value: Motion) -> Any:
        kind = _kind_of(value)
        given: dict[str, Any] = {
            name: getattr(value, name)
            for name in entries(_KINDS[kind])
            if name not in ("sense", "harmonic")
        }
        if kind == "circular":
            given["sense"] = next(name for name, e in SENSES.items() if e == value.ellipticity)
        if kind == "harmonics":
            given["harmonic"] = value.harmonic
        return {"kind": kind, **fields.write_table(_KINDS[kind](**given))}


# --- the whole -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class ScreenConfig:
    """A vibrating screen and its duty; everything but the size classes has a default.

    decks: top deck first, of equal length. displacement, passage, segregation, bed: those of the
    set that `material.calibration` names unless given. feed: start values, and what a steady
    solution uses; without fractions it gets a typical composition. Raises ConfigError with name,
    value, limit and cure.
    """

    size_classes: SizeClasses = field(metadata=of(Section("size_classes", SizeClasses)))
    decks: tuple[Deck, ...] = said((Deck(),), Sections("deck", Deck))
    material: Material = said(Material(), Section("material", Material))
    motion: Motion = said(_Linear().motion(), _MotionSection("motion", Motion))
    displacement: Displacement = said(None, Section("displacement", Displacement))
    passage: Passage = said(None, Section("passage", Passage))
    segregation: Segregation = said(None, Section("segregation", Segregation))
    bed: Bed = said(None, Section("bed", Bed))
    drive: Drive = said(Drive(), Section("drive", Drive))
    solver: Solver = said(Solver(), Section("solver", Solver))
    feed: Feed = said(Feed(), Section("feed", Feed))
    name: str = said("quarry screen", Text("name"))

    def __post_init__(self) -> None:
        if isinstance(self.material, Material):
            for name, usual in _sections_of(self.calibration).items():
                object.__setattr__(self, name, _filled(getattr(self, name), usual))
        fields.check_fields(self, "")
        faults = Faults(self._faults())
        with faults:
            self._complete_feed()
        faults.tell()

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> ScreenConfig:
        """Configuration from a TOML file, with other values by key: {"feed.rate_t_h": 350}.

        Raises ConfigError, OSError if it cannot be read.
        """
        path = Path(path)
        try:
            tree = toml_tree(text_of(path))
            return cls.from_dict(edited(cls, tree, changes) if changes else tree, path.parent)
        except ConfigError as error:
            error.add_note(f"in {path}{' with what was set' if changes else ''}")
            raise

    @classmethod
    def loads(cls, text: str) -> ScreenConfig:
        """Configuration from the text of a TOML file; file names in it are relative to here."""
        return cls.from_dict(toml_tree(text))

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any], folder: str | Path = "") -> ScreenConfig:
        """Configuration from the tree of a TOML file; file names are relative to `folder`."""
        with reading(cls, tree):
            try:
                full = number_sets.completed(tree, Path(folder))
                return fields.read_table(cls, full, "", Path(folder))
            except ConfigError as error:
                if coarse_first(file_value("size_classes", "edges_mm")):
                    error.add_note("sizes stand coarsest first: places in lists count from the end")
                raise

    @classmethod
    def default(cls) -> ScreenConfig:
        """A typical quarry screen: one deck 6.0 x 2.4 m at 16 mm, 300 t/h of crusher product."""
        return cls(SizeClasses(QUARRY_EDGES))

    def replace(self, **sections: Any) -> ScreenConfig:
        """The same screen with other sections, checked again."""
        return dataclasses.replace(self, **sections)

    def value_of(self, name: str) -> float:
        """Number of the FMU's variable of that name, SI; raises ConfigError if there is none."""
        part: Any = self
        if name == "passage.velocity":
            return self.passage.velocity_at(self.decks[0].panels[0].aperture)
        for attribute, place in _steps_to(self, name):
            told = getattr(part, "effective", {}).get(attribute)
            part = getattr(part, attribute) if told is None else told
            part = part if place is None else part[place]
        return float(part)

    def explicit(self) -> ScreenConfig:
        """The same screen with every number written that goes with the aperture or follows."""
        told: dict[str, Any] = {}
        for name in ("passage", "segregation", "bed"):
            section = getattr(self, name)
            numbers: dict[str, Any] = dict(section.effective)
            if name == "passage" and self.passage.velocity_table is not None:
                del numbers["velocity"]
            if name != "bed":
                numbers["closure"] = CLOSURES[section.follows_vibration]
            told[name] = dataclasses.replace(section, **numbers)
        told["decks"] = tuple(
            dataclasses.replace(deck, panels=tuple(panel.explicit() for panel in deck.panels))
            for deck in self.decks
        )
        return self.replace(**told)

    @property
    def calibration(self) -> NumberSet:
        """The named set of numbers that the screen rests on, and what that was fitted to."""
        return number_sets.found(self.material.calibration)

    def number_set(self, name: str, **about: Any) -> NumberSet:
        """The numbers of this screen as a set that others can name.

        about: fitted_to, source, rmse and range, as of a `NumberSet`.
        """
        for table in number_sets.TABLES:
            about[table] = fields.write_table(getattr(self, table))
        for key in ("initial", "layers", "reconstruction"):  # of this screen alone
            del about["bed"][key]
        return NumberSet(name, **about)

    def beyond_calibration(self) -> list[str]:
        """What of the screen lies outside of what its numbers were fitted to; empty if nothing.

        A sentence each, with name, value, range and unit: numbers of displacement, passage,
        segregation and bed that are not those of the named set (its errors do not hold for them);
        apertures, inclinations, throw numbers, kind of motion, load (feed over what VSMA finds to
        be screened at 95 %) and feed of each deck outside of the set's range.
        """
        from vibroscreen.beyond import beyond  # its rules are told of configurations

        return list(beyond(self, self.calibration, _sections_of(self.calibration)))

    def with_values(self, values: Mapping[str, float]) -> ScreenConfig:
        """The same screen with other numbers by name of the FMU's variables, SI, checked again.

        A passage velocity takes the place of a table. Raises ConfigError.
        """
        changes: list[_Change] = []
        for name, value in values.items():
            if name == "passage.velocity":
                changes.append(([("passage", None), ("velocity_table", None)], None))
            changes.append((list(_steps_to(self, name)), value))
        changed: ScreenConfig = _changed(self, changes)
        return changed

    def to_toml(self) -> str:
        """TOML text that `loads` takes back to this configuration.

        Exact where a number in the key's unit exists that converts to the value, as it does for
        all that was read from TOML; else within one unit in the last place.
        """
        return toml_text(fields.write_table(self))

    @property
    def apertures(self) -> tuple[float, ...]:
        """Apertures of all panels [m], top deck and feed end first."""
        return tuple(panel.aperture for deck in self.decks for panel in deck.panels)

    @cached_property
    def largest_apertures(self) -> tuple[float, ...]:
        """Largest aperture of every deck [m], top deck first."""
        return tuple(max(panel.aperture for panel in deck.panels) for deck in self.decks)

    def _complete_feed(self) -> None:
        """Put a typical composition where none is given; the duty must be complete in any case."""
        feed = self.feed
        fractions = feed.mass_fraction or typical_fractions(self.size_classes.edges)
        feed = dataclasses.replace(feed, mass_fraction=fractions)
        feed.check_classes(self.size_classes.count)
        # They are the start values even of a screen that starts without feed.
        fractions = checked_fractions(fractions)
        object.__setattr__(self, "feed", dataclasses.replace(feed, mass_fraction=fractions))

    def _faults(self) -> Iterator[str]:
        """What is wrong with the decks, one by one and together."""
        first, above = self.decks[0].length, math.inf
        for place, deck in enumerate(self.decks, start=1):
            if not math.isclose(deck.length, first, rel_tol=1e-9):
                name = f"deck[{place}].panel[1]"
                yield told_of(Panel, "length", name, "unequal_decks", deck.length, first)
            for number, panel in enumerate(deck.panels, start=1):
                name = f"deck[{place}].panel[{number}]"
                yield from self._opening_faults(name, panel, deck.length)
                if panel.aperture > above and panel.open_area > 0.0:
                    yield told_of(Panel, "aperture", name, "coarser_below", panel.aperture, above)
                yield from self._slope_faults(name, panel.inclination)
            above = max(panel.aperture for panel in deck.panels)

    def _opening_faults(self, name: str, panel: Panel, length: float) -> Iterator[str]:
        aperture, slot = panel.aperture, panel.slot_length
        if aperture > length:
            yield told_of(Panel, "aperture", name, "short_deck", aperture, length)
        if (end := self.passage.off_table(aperture)) is not None:
            yield told_of(Panel, "aperture", name, "off_table", aperture, end)
        if panel.opening in SLOTS and slot < aperture:
            yield told_of(Panel, "slot_length", name, "short_slot", slot, aperture)
        elif panel.opening not in SLOTS and slot > 0.0:
            yield told_of(Panel, "slot_length", name, "no_slot", slot)

    def _slope_faults(self, name: str, inclination: float) -> Iterator[str]:
        """What is wrong with a slope; a bed that is steeper than was checked is a warning."""
        slope, friction = math.tan(inclination), self.material.friction_base
        degrees = inclination / DEG
        steep = partial(told_of, Panel, "inclination", name, value=inclination)
        steep = partial(steep, degrees=degrees, slope=slope, number=friction)
        if self.displacement.model == "rigid_body" and abs(slope) >= friction:
            yield steep(text="too_steep", limit=friction)
        steepest = bed_friction(friction, BED_CONSTANTS[2])
        if self.displacement.model == "bed" and slope > steepest:
            warnings.warn(steep(text="steep_bed", limit=steepest), stacklevel=2)


def _sections_of(named: NumberSet) -> dict[str, Any]:
    """Sections of a screen with the numbers of a named set, by the name of their table."""
    kinds = (Displacement, Passage, Segregation, Bed)
    try:
        return {
            name: fields.read_table(kind, getattr(named, name), name, Path())
            for name, kind in zip(number_sets.TABLES, kinds, strict=True)
        }
    except ConfigError as error:
        error.add_note(f'in the set "{named.name}"')
        raise


def _filled(section: Any, usual: Any) -> Any:
    """A section with what it does not give from that of a set; the latter where there is none."""
    if section is None or type(section) is not type(usual):
        return usual if section is None else section
    given, numbers = (
        {name: value for name in entries(type(one)) if (value := getattr(one, name)) is not None}
        for one in (section, usual)
    )
    more = number_sets.missing(given, numbers)
    return dataclasses.replace(section, **more) if more else section


# An attribute that leads to a number, with the place in it where it is a list; steps and a value.
_Step = tuple[str, int | None]
_Change = tuple[list[_Step], Any]


def _steps_to(config: ScreenConfig, name: str) -> Iterator[_Step]:
    """Attributes, with a place in a list, that lead to the number of a variable's name."""
    part: Any = config
    for word in name.split("."):
        match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", word)
        attribute, place = (match[1], match[2]) if match else (word, None)
        attribute = {"deck": "decks", "panel": "panels"}.get(attribute, attribute)
        part = getattr(part, "effective", {}).get(attribute, getattr(part, attribute, None))
        if place is not None:
            part = (
                part[int(place) - 1]
                if isinstance(part, tuple) and 0 < int(place) <= len(part)
                else None
            )
        if part is None:
            break
        yield attribute, None if place is None else int(place) - 1
    if isinstance(part, bool) or not isinstance(part, int | float):
        raise ConfigError(
            f"{name} is not a number of this screen: give the name of a variable such as "
            "passage.velocity or deck[1].panel[1].aperture"
        )


def _changed(part: Any, changes: list[_Change]) -> Any:
    """A dataclass with the values at the end of the steps, all at once so that checks see them."""
    inside: dict[str, dict[int | None, list[_Change]]] = {}
    for ((attribute, place), *rest), value in changes:
        inside.setdefault(attribute, {}).setdefault(place, []).append((rest, value))
    new: dict[str, Any] = {}
    for attribute, places in inside.items():
        whole = getattr(part, attribute)
        items: dict[int | None, Any] = {}
        items.update([(None, whole)] if None in places else enumerate(whole))
        for place, within in places.items():
            rest, value = within[-1]
            items[place] = _changed(items[place], within) if rest else value
        new[attribute] = items[None] if None in places else tuple(items.values())
    return dataclasses.replace(part, **new)


def typical_fractions(edges: tuple[float, ...]) -> tuple[float, ...]:
    """Mass fraction by class [1] of a typical crusher product between the limits [m].

    The assumed curve TYPICAL_PASSING over size / top size, along a Rosin-Rammler curve between its
    points; to six digits.
    """
    constant, modulus = ROSIN_RAMMLER

    def rosin_rammler(size: Any) -> Any:
        return -np.expm1(-((np.asarray(size) / constant) ** modulus))

    passing = np.interp(
        rosin_rammler(np.array(edges) / edges[-1]), rosin_rammler(TYPICAL_SIZE), TYPICAL_PASSING
    )
    if passing[-1] == passing[0]:  # limits so close that the curve does not tell them apart
        passing = np.array(edges)
    share = np.round((passing - passing[0]) / (passing[-1] - passing[0]), 6)
    return tuple(round(float(value), 6) for value in np.diff(share))


def legal_keys() -> tuple[str, ...]:
    """Every key of a configuration file, in full, such as `deck.panel.aperture_mm`."""
    return tuple(path for path, _ in fields.leaves(ScreenConfig))
