"""What of a screen lies outside of that to which its numbers were fitted, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from vibroscreen.errors import given, with_unit
from vibroscreen.fields import Entry, Number, entries, from_si
from vibroscreen.motion import Motion
from vibroscreen.number_sets import TABLES, NumberSet, Range
from vibroscreen.sections import BESIDE, BOUNCE, CLOSURES
from vibroscreen.sizing_rules import Rules, rules_of
from vibroscreen.units import DEG, MM

if TYPE_CHECKING:
    from vibroscreen.config import ScreenConfig

# Fields of the sections that are no physics, and `closure`, which is told as it acts.
_NO_PHYSICS = ("initial", "layers", "reconstruction", "closure")
# What a range of a set is called, its unit, and the factor of that.
_UNITS = {"aperture": ("mm", MM), "inclination": ("deg", DEG)}


def beyond(config: ScreenConfig, named: NumberSet, sections: Mapping[str, Any]) -> Iterator[str]:
    """Sentences: numbers that are not those of the set, then what lies outside of its range.

    sections: those of the set, by name.
    """
    for table in TABLES:
        yield from _others(table, getattr(config, table), sections[table], named.name)
    if named.range == Range():
        yield f'"{named.name}" does not say where it holds: give it a [range]'
    for limit, name, value in _places(config):
        span = getattr(named.range, limit)
        if span is not None and not span[0] <= value <= span[1]:
            unit, factor = _UNITS.get(limit, ("", 1.0))
            value, least, most = (float(f"{one / factor:.4g}") for one in (value, *span))
            yield (
                f"{name} = {with_unit(value, unit)} lies outside of "
                f'{least:g} to {with_unit(most, unit)}, where "{named.name}" was fitted'
            )
    kind = kind_of(config.motion)
    if named.range.motion and kind not in named.range.motion:
        fitted = ", ".join(named.range.motion)
        yield f'motion.kind = {kind} is none of those of "{named.name}" ({fitted})'


def _others(table: str, section: Any, usual: Any, name: str) -> Iterator[str]:
    """Numbers of a section that are not those of the set."""
    own, theirs = _numbers(table, section), _numbers(table, usual)
    for what, said in own.items():
        if said != theirs.get(what, said):
            yield f'{said} is not that of "{name}" ({theirs[what]})'


def _numbers(table: str, section: Any) -> dict[str, str]:
    """What a section says, in words; a number and its part of the aperture in one."""
    kinds, full = entries(type(section)), getattr(section, "effective", {})
    said: dict[str, str] = {}
    for field, entry in kinds.items():
        if field in _NO_PHYSICS or f"{table}.{field}" in BESIDE.values():
            continue
        value = getattr(section, field)
        if isinstance(entry, Number):
            if _idle(section, entry):
                continue
            parts = [field, BESIDE[f"{table}.{field}"].split(".")[1]] if field in full else [field]
            shown = [
                _shown(f"{table}.{part}", kinds[part], full.get(part, value)) for part in parts
            ]
            said[field] = " and ".join(filter(None, shown)) or f"{table}.{field} = 0"
        elif value is not None:
            said[field] = f"{table}.{field} = {value!r}"
    if hasattr(section, "follows_vibration"):
        said["closure"] = f"{table}.closure = {CLOSURES[section.follows_vibration]!r}"
    return said


def _idle(section: Any, entry: Number) -> bool:
    """Whether a number is of a model or law that the section has not chosen."""
    if entry.tells.endswith(BOUNCE):
        return bool(section.law != "bounce")
    return "used by" in entry.tells and not entry.tells.endswith(section.model)


def _shown(name: str, entry: Entry, value: float) -> str:
    """A number with the unit of its key; nothing where it is 0."""
    assert isinstance(entry, Number)
    return given(name, from_si(value, entry.factor), entry.written.text) if value else ""


def _places(config: ScreenConfig) -> Iterator[tuple[str, str, float]]:
    """What ranges tell of, where it is, and how much it is in SI."""
    first = config.decks[0].panels[0].inclination
    for d, deck in enumerate(config.decks, start=1):
        for p, panel in enumerate(deck.panels, start=1):
            name = f"deck[{d}].panel[{p}]"
            if panel.open_area > 0.0:
                yield "aperture", f"{name}.aperture", panel.aperture
            yield "inclination", f"{name}.inclination", panel.inclination
        slope = deck.panels[0].inclination
        throw = config.motion.throw_number(slope, slope - first)
        yield "throw_number", f"throw number of deck[{d}]", throw
    yield "acceleration", "K", config.motion.peak_acceleration
    for number, rules in enumerate(rules_of(config), start=1):
        yield from _of_feed(f"of deck[{number}]", rules)


def _of_feed(deck: str, rules: Rules) -> Iterator[tuple[str, str, float]]:
    """What ranges tell of the feed of a deck."""
    half, whole = (rules.passing(part * rules.aperture) for part in (0.5, 1.0))
    if rules.rate > 0.0:
        yield "load", f"load {deck} (feed over VSMA's at 95 %)", rules.load
    yield "oversize", f"part of the feed {deck} above the aperture", max(0.0, 1.0 - whole)
    if whole > 0.0:
        what = f"part of the undersize in the feed {deck} finer than half the aperture"
        yield "half_size", what, half / whole
    edges, fraction = rules.config.size_classes.edges, rules.config.feed.mass_fraction
    top = max(edge for edge, share in zip(edges[1:], fraction, strict=True) if share > 0.0)
    largest = min(top, rules.above)
    yield "top_size", f"largest size in the feed {deck} over the aperture", largest / rules.aperture


def kind_of(motion: Motion) -> str:
    """Kind of a motion, one of MOTIONS of a set."""
    if motion.harmonic:
        return "harmonics"
    if abs(motion.ellipticity) == 1.0:
        return "circular with_flow" if motion.ellipticity > 0.0 else "circular against_flow"
    return "linear" if motion.ellipticity == 0.0 else "elliptical"
