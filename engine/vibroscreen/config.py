"""What a screen is: frozen dataclasses in SI, checked once, read from and written to TOML.

Every field names its TOML key, unit and limits in its metadata (`fields.py`); `ScreenConfig.load`
reads a file, `to_toml` writes one that gives the same configuration back. Messages name the
variable as the FMU does, its value, the limit and the cure.
"""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vibroscreen import registry
from vibroscreen.errors import ConfigError, InputError, given, told
from vibroscreen.fields import (
    Choice,
    Entry,
    Number,
    Section,
    Sections,
    Text,
    as_tuple,
    check_fields,
    entries,
    from_si,
    number,
    of,
    paths,
    read_table,
    to_si,
    write_table,
)
from vibroscreen.kernels.physics.bed_of_grains import BED_CONSTANTS, bed_friction
from vibroscreen.kernels.plan import between
from vibroscreen.motion import SENSES, Harmonic, Motion
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed, checked_fractions
from vibroscreen.units import DEG, MM

__all__ = [
    "Bed",
    "Deck",
    "Displacement",
    "Drive",
    "Material",
    "Panel",
    "Passage",
    "ScreenConfig",
    "Segregation",
    "Solver",
    "legal_keys",
    "typical_fractions",
]

HALF_STROKE = 0.5 * MM  # m, the amplitude from the stroke in mm
DEFAULT_TABLE = Path(__file__).with_name("passage_velocity.csv")
TABLE_COLUMNS = ("aperture_mm", "velocity_m_s")

# Default screen: limits of the classes on the sieves of ISO 565, R 20/3 series and its neighbours.
QUARRY_EDGES = tuple(d * MM for d in (0, 1, 2, 4, 5.6, 8, 11.2, 16, 22.4, 31.5, 45, 63, 75))
# Passing of a typical crusher product against size over top size: an assumption, made for a
# screen that is given no feed. It follows Rosin-Rammler, size constant 0.30 and modulus 0.87 of
# the top size, within 3 per cent; 60 per cent is finer than a quarter of the top size.
TYPICAL_SIZE = (0.0, 2.0 / 63.0, 4.0 / 63.0, 8.0 / 63.0, 16.0 / 63.0, 31.5 / 63.0, 1.0)
TYPICAL_PASSING = (0.0, 0.15, 0.25, 0.40, 0.60, 0.85, 1.0)
ROSIN_RAMMLER = (0.30, 0.87)


class _VelocityTable(Entry):
    """Velocity through the openings [m/s] over the aperture [m]; None for a constant velocity."""

    key = "velocity_table"

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if isinstance(raw, str):
            raw = _table_of_file(name, DEFAULT_TABLE if raw == "default" else folder / raw)
        if not isinstance(raw, list):
            return raw
        rows = [as_tuple(row) for row in raw]
        return tuple((to_si(row[0], MM), *row[1:]) if row else row for row in rows)

    def check(self, name: str, value: Any) -> tuple[tuple[float, float], ...] | None:
        if value is None:
            return None
        rows = [as_tuple(row) for row in as_tuple(value) or ()]
        pairs = [row for row in rows if row is not None and len(row) == 2]
        if len(rows) < 2 or len(pairs) < len(rows):
            raise ConfigError(
                f"{name} = {value!r} is not a table of two or more rows (aperture, velocity): "
                'give a CSV file with the columns aperture_mm, velocity_m_s, or "default"'
            )
        size = Number("aperture_mm", "m", MM, above=0.0)
        speed = Number("velocity_m_s", "m/s", at_least=0.0, at_most=100.0)
        table = tuple(
            (size.check(f"{name}[{i}].aperture", a), speed.check(f"{name}[{i}].velocity", u))
            for i, (a, u) in enumerate(pairs, start=1)
        )
        for i in range(1, len(table)):
            if table[i][0] <= table[i - 1][0]:
                raise ConfigError(
                    f"{name}[{i + 1}].aperture = {size.text(table[i][0])} is not larger than the "
                    f"one before, {size.text(table[i - 1][0])}: sort the rows by aperture"
                )
        return table

    def write(self, value: Any) -> Any:
        return None if value is None else [[from_si(a, MM), u] for a, u in value]


def _table_of_file(name: str, path: Path) -> list[list[float]]:
    """Rows (aperture mm, velocity m/s) of a CSV file with a header; lines from # on are comment."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigError(
            f"{name} = {path} cannot be read ({error.strerror}): give a file relative to the "
            'TOML file, or "default"'
        ) from None
    rows = csv.DictReader(line for line in lines if line and not line.startswith("#"))
    if tuple(rows.fieldnames or ()) != TABLE_COLUMNS:
        raise ConfigError(
            f"{name} = {path} has the columns {', '.join(rows.fieldnames or ())}: "
            f"name them {', '.join(TABLE_COLUMNS)}"
        )
    try:
        return [[float(row[column]) for column in TABLE_COLUMNS] for row in rows]
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"{name} = {path}, line {rows.line_num} after the comments: {error}: "
            "give a number in every column"
        ) from None


# --- [motion]: one table for every kind ----------------------------------------------------------
class _MotionTable(Protocol):
    def motion(self) -> Motion: ...


@dataclass(frozen=True)
class _Part:
    order: int = field(default=1, metadata=number("order", whole=True))
    along: float = field(default=0.0, metadata=number("along_mm", "m", MM))
    along_phase: float = field(default=0.0, metadata=number("along_phase_deg", "rad", DEG))
    normal: float = field(default=0.0, metadata=number("normal_mm", "m", MM))
    normal_phase: float = field(default=0.0, metadata=number("normal_phase_deg", "rad", DEG))


_FREQUENCY = number("frequency_hz", "Hz")
_AMPLITUDE = number("stroke_mm", "m", HALF_STROKE)
_THROW_ANGLE = number("throw_angle_deg", "rad", DEG)


@dataclass(frozen=True)
class _Linear:
    amplitude: float = field(default=10.0 * HALF_STROKE, metadata=_AMPLITUDE)
    frequency: float = field(default=15.5, metadata=_FREQUENCY)
    throw_angle: float = field(default=45.0 * DEG, metadata=_THROW_ANGLE)

    def motion(self) -> Motion:
        return Motion.linear(self.amplitude, self.frequency, self.throw_angle)


@dataclass(frozen=True)
class _Circular:
    amplitude: float = field(default=10.0 * HALF_STROKE, metadata=_AMPLITUDE)
    frequency: float = field(default=15.5, metadata=_FREQUENCY)
    sense: str = field(default="with_flow", metadata=of(Choice("sense", lambda: tuple(SENSES))))

    def motion(self) -> Motion:
        return Motion.circular(self.amplitude, self.frequency, self.sense)


@dataclass(frozen=True)
class _Elliptical(_Linear):
    ellipticity: float = field(default=0.5, metadata=number("ellipticity"))

    def motion(self) -> Motion:
        return Motion.elliptical(self.amplitude, self.frequency, self.throw_angle, self.ellipticity)


@dataclass(frozen=True)
class _Harmonics:
    frequency: float = field(default=15.5, metadata=_FREQUENCY)
    amplitude: float = field(default=0.0, metadata=_AMPLITUDE)
    throw_angle: float = field(default=0.0, metadata=_THROW_ANGLE)
    ellipticity: float = field(default=0.0, metadata=number("ellipticity"))
    harmonic: tuple[_Part, ...] = field(default=(), metadata=of(Sections("harmonic", _Part)))

    def motion(self) -> Motion:
        if not self.harmonic:
            raise ConfigError(
                'motion.harmonic is missing, motion.kind = "harmonics" has no other movement: '
                "give at least one [[motion.harmonic]]"
            )
        parts = tuple(Harmonic(**vars(part)) for part in self.harmonic)
        fundamental = (self.frequency, self.amplitude, self.throw_angle, self.ellipticity)
        return Motion(*fundamental, harmonic=parts)


_KINDS: dict[str, Callable[..., _MotionTable]] = {
    "linear": _Linear,
    "circular": _Circular,
    "elliptical": _Elliptical,
    "harmonics": _Harmonics,
}


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

    def paths(self) -> Iterator[str]:
        yield f"{self.key}.kind"
        yield from dict.fromkeys(f"{self.key}.{p}" for kind in _KINDS.values() for p in paths(kind))

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, Mapping):
            return super().read(name, raw, folder)
        kind = Choice("kind", lambda: tuple(_KINDS)).check(
            f"{name}.kind", raw.get("kind", "linear")
        )
        table = {key: value for key, value in raw.items() if key != "kind"}
        known = {entry.key for entry in entries(_KINDS[kind]).values()}
        for key in table.keys() - known:
            for other, table_kind in _KINDS.items():
                if key in {entry.key for entry in entries(table_kind).values()}:
                    raise ConfigError(
                        f'{name}.{key} is unknown for kind = "{kind}": it belongs to '
                        f'kind = "{other}"'
                    )
        return read_table(_KINDS[kind], table, name, folder).motion()

    def write(self, value: Motion) -> Any:
        kind = _kind_of(value)
        fields: dict[str, Any] = {
            name: getattr(value, name)
            for name in entries(_KINDS[kind])
            if name not in ("sense", "harmonic")
        }
        if kind == "circular":
            fields["sense"] = next(name for name, e in SENSES.items() if e == value.ellipticity)
        if kind == "harmonics":
            fields["harmonic"] = tuple(_Part(**vars(part)) for part in value.harmonic)
        return {"kind": kind, **write_table(_KINDS[kind](**fields))}


# --- the parts of a screen -----------------------------------------------------------------------
@dataclass(frozen=True)
class Panel:
    """One stretch of a deck with one screening medium.

    length [m]; inclination [rad], down-slope positive; aperture: clear opening [m]; open_area:
    useful open area fraction [1], 0 for a blank plate; velocity_factor: on the velocity of
    the bed that the displacement model gives [1].
    """

    length: float = field(default=6.0, metadata=number("length_m", "m", above=0.0, at_most=100.0))
    inclination: float = field(
        default=5.0 * DEG,
        metadata=number("inclination_deg", "rad", DEG, above=-0.5 * math.pi, below=0.5 * math.pi),
    )
    aperture: float = field(default=16.0 * MM, metadata=number("aperture_mm", "m", MM, above=0.0))
    open_area: float = field(default=0.55, metadata=number("open_area", at_least=0.0, at_most=1.0))
    velocity_factor: float = field(
        default=1.0, metadata=number("velocity_factor", at_least=0.0, at_most=10.0)
    )

    def __post_init__(self) -> None:
        check_fields(self, "deck.panel")


@dataclass(frozen=True)
class Deck:
    """A row of panels, feed end first, of one width [m]."""

    width: float = field(default=2.4, metadata=number("width_m", "m", above=0.0, at_most=100.0))
    panels: tuple[Panel, ...] = field(default=(Panel(),), metadata=of(Sections("panel", Panel)))

    def __post_init__(self) -> None:
        check_fields(self, "deck")
        for place, panel in enumerate(self.panels, start=1):
            if panel.aperture > self.length:
                name = f"deck.panel[{place}].aperture"
                raise ConfigError(
                    told("short_deck", name=name, value=panel.aperture, limit=self.length)
                )

    @property
    def length(self) -> float:
        """Total length of the panels [m]."""
        return math.fsum(panel.length for panel in self.panels)


@dataclass(frozen=True)
class Material:
    """Bulk density [kg/m3] and friction coefficients [1] on the deck and inside the bed."""

    bulk_density: float = field(
        default=1600.0,
        metadata=number(
            "bulk_density_kg_m3",
            "kg/m3",
            at_least=10.0,
            at_most=25000.0,
            cure="were t/m3 meant? give bulk_density_kg_m3 in kg/m3, 10 to 25000",
        ),
    )
    friction_deck: float = field(
        default=0.5, metadata=number("friction_deck", at_least=0.0, at_most=100.0)
    )
    friction_internal: float = field(
        default=0.6, metadata=number("friction_internal", at_least=0.0, at_most=100.0)
    )
    rolling: float = field(default=0.0, metadata=number("rolling", at_least=0.0, at_most=0.95))

    def __post_init__(self) -> None:
        check_fields(self, "material")

    @property
    def friction_base(self) -> float:
        """Friction where the bed slips, the weakest: the smaller of the two [1]."""
        return min(self.friction_deck, self.friction_internal)


@dataclass(frozen=True)
class Displacement:
    """Model of the transport along the deck; velocity [m/s] is what `prescribed` takes."""

    model: str = field(
        default="rigid_body",
        metadata=of(Choice("model", lambda: registry.names("displacement"))),
    )
    velocity: float = field(
        default=0.0, metadata=number("velocity_m_s", "m/s", at_least=0.0, at_most=20.0)
    )

    def __post_init__(self) -> None:
        check_fields(self, "displacement")


# Whether u and w follow from the vibration; their place here is what the buffer holds.
CLOSURES = ("none", "vibration")


@dataclass(frozen=True)
class Passage:
    """Law of passage and velocity of grains through the openings [m/s].

    velocity: a constant; velocity_table: rows (aperture m, velocity m/s) instead of it,
    interpolated linearly. Give one of them. closure: "none", or "vibration" for a velocity that
    follows from the vibration; `velocity` is then that of a loose bed (MODEL.md, "Closures in the
    vibration"). Of the law `bounce` [1]: rim, 0 where only grains clear of the rim pass (Gaudin), 1
    where the rim guides all grains in whose centre is over the opening; passing_time for which a
    grain takes up an opening, over sqrt(aperture/g); drift, how much of its size a grain must sink
    to be held by the opening while the bed rides on, at sqrt(g aperture); damping of the tries by a
    bed as deep as the aperture; lift, how high the bed is thrown over V^2/(2 g); stirring, by which
    a bed that rides on at sqrt(g aperture) holds and crowds its grains less; calming, by how much
    less a bed as deep as the contact layer is thrown; depletion, how short a bed as deep as the
    aperture runs of passing grains at the deck where they pass as fast as it is thrown; levelling,
    by how much less a bed as deep as the contact layer damps.
    """

    law: str = field(
        default="pelevin", metadata=of(Choice("law", lambda: registry.names("passage")))
    )
    velocity: float = field(
        default=0.1, metadata=number("velocity_m_s", "m/s", at_least=0.0, at_most=100.0)
    )
    velocity_table: tuple[tuple[float, float], ...] | None = field(
        default=None, metadata=of(_VelocityTable())
    )
    rim: float = field(default=0.3, metadata=number("rim", at_least=0.0, at_most=1.0))
    passing_time: float = field(
        default=2.0, metadata=number("passing_time", at_least=0.0, at_most=100.0)
    )
    drift: float = field(default=1.5, metadata=number("drift", at_least=0.0, at_most=10.0))
    damping: float = field(default=1.0, metadata=number("damping", at_least=0.0, at_most=100.0))
    lift: float = field(default=1.0, metadata=number("lift", at_least=0.0, at_most=100.0))
    stirring: float = field(default=0.7, metadata=number("stirring", at_least=0.0, at_most=100.0))
    calming: float = field(default=0.0, metadata=number("calming", at_least=0.0, at_most=100.0))
    depletion: float = field(default=0.0, metadata=number("depletion", at_least=0.0, at_most=100.0))
    levelling: float = field(default=0.0, metadata=number("levelling", at_least=0.0, at_most=100.0))
    closure: str = field(default="none", metadata=of(Choice("closure", lambda: CLOSURES)))

    def __post_init__(self) -> None:
        check_fields(self, "passage")
        if self.velocity_table is not None and self.velocity != Passage.velocity:
            raise ConfigError(
                f"passage.velocity = {self.velocity:.6g} m/s is given beside "
                "passage.velocity_table: give one of them"
            )

    def velocity_at(self, aperture: float) -> float:
        """Velocity of grains through openings of that aperture [m], in m/s.

        Raises ConfigError for an aperture that the table does not reach.
        """
        if self.velocity_table is None:
            return self.velocity
        apertures, velocities = zip(*self.velocity_table, strict=True)
        if not apertures[0] <= aperture <= apertures[-1]:
            least, most = apertures[0], apertures[-1]
            raise ConfigError(
                told("off_table", name="aperture", value=aperture, limit=least, other_limit=most)
            )
        return float(between(np.array(apertures), np.array(velocities), aperture))


@dataclass(frozen=True)
class Segregation:
    """Model of the mixing and sorting in the bed.

    velocity: of percolation [m/s]; dilation: extra distance between grains by shaking [m];
    proportion: share of the sorted composition, used by `proportional` [1]. closure: "none", or
    "vibration" for velocities that follow from the vibration; `velocity` and `mixing` are then
    those of a loose bed (MODEL.md, "Closures in the vibration"). Of `exchange` too:
    relative_dilation: extra distance over the mean grain size of a layer, adds to the dilation [1];
    mixing: velocity at which layers exchange grains whatever their size [m/s].
    """

    model: str = field(
        default="exchange", metadata=of(Choice("model", lambda: registry.names("segregation")))
    )
    velocity: float = field(
        default=0.1, metadata=number("velocity_m_s", "m/s", at_least=0.0, at_most=100.0)
    )
    dilation: float = field(
        default=1.0 * MM, metadata=number("dilation_mm", "m", MM, at_least=0.0, at_most=1.0)
    )
    proportion: float = field(default=0.5, metadata=number("proportion", at_least=0.0, at_most=1.0))
    closure: str = field(default="none", metadata=of(Choice("closure", lambda: CLOSURES)))
    relative_dilation: float = field(
        default=0.0, metadata=number("relative_dilation", at_least=0.0, at_most=10.0)
    )
    mixing: float = field(
        default=0.0, metadata=number("mixing_m_s", "m/s", at_least=0.0, at_most=100.0)
    )

    def __post_init__(self) -> None:
        check_fields(self, "segregation")


# Put in the place of a layer depth that is not given; no Bed keeps it.
_AS_CONTACT_DEPTH: Any = None
# Composition inside a layer; their place here is what the buffer holds.
RECONSTRUCTIONS = ("none", "linear")


@dataclass(frozen=True)
class Bed:
    """Layers of the bed and what lies on the deck at the start.

    contact_depth and layer_depth [m]: of the contact layer and of those above; a Bed without
    layer_depth takes the contact depth (and keeps it: `dataclasses.replace` of the one leaves the
    other). initial: "empty", or "steady" for full of the duty. layers: room in the state, the
    contact layer among them, at least 2. reconstruction: "none", every layer is mixed evenly, as in
    the paper; "linear" where the layers are a grid to be refined (MODEL.md, "Segregation").
    """

    contact_depth: float = field(
        default=20.0 * MM, metadata=number("contact_depth_mm", "m", MM, at_least=1e-9, at_most=5.0)
    )
    layer_depth: float = field(
        default=_AS_CONTACT_DEPTH,
        metadata=number("layer_depth_mm", "m", MM, at_least=1e-9, at_most=5.0, optional=True),
    )
    initial: str = field(
        default="empty", metadata=of(Choice("initial", lambda: ("empty", "steady")))
    )
    layers: int = field(
        default=16, metadata=number("layers", whole=True, at_least=2, at_most=10_000)
    )
    reconstruction: str = field(
        default="none", metadata=of(Choice("reconstruction", lambda: RECONSTRUCTIONS))
    )

    def __post_init__(self) -> None:
        check_fields(self, "bed")
        if self.layer_depth is None:
            object.__setattr__(self, "layer_depth", self.contact_depth)


@dataclass(frozen=True)
class Drive:
    """Vibrating mass [kg], bearing friction [1] and diameter [m], efficiency of the drive [1]."""

    vibrating_mass: float = field(
        default=6000.0, metadata=number("vibrating_mass_kg", "kg", at_least=0.0, at_most=1e6)
    )
    bearing_friction: float = field(
        default=0.005, metadata=number("bearing_friction", at_least=0.0, at_most=1.0)
    )
    bearing_diameter: float = field(
        default=120.0 * MM,
        metadata=number("bearing_diameter_mm", "m", MM, at_least=0.0, at_most=5.0),
    )
    efficiency: float = field(
        default=0.9, metadata=number("efficiency", at_least=0.01, at_most=1.0)
    )

    def __post_init__(self) -> None:
        check_fields(self, "drive")


@dataclass(frozen=True)
class Solver:
    """Bound on the error of a recovery [1]; packages: room in the state, 0 chosen by the engine.

    The bound holds from 1e-6 up; below, the error still falls, but may exceed it by up to 20 times
    where layers or sizes run out.
    """

    tolerance: float = field(
        default=1e-4, metadata=number("tolerance", at_least=1e-9, at_most=1e-1)
    )
    packages: int = field(
        default=0, metadata=number("packages", whole=True, at_least=0, at_most=100_000)
    )

    def __post_init__(self) -> None:
        check_fields(self, "solver")


@dataclass(frozen=True)
class ScreenConfig:
    """A vibrating screen and its duty; everything but the size classes has a default.

    decks: top deck first, of equal length. feed: start values, and what a steady solution uses;
    without fractions it gets a typical composition. Raises ConfigError with name, value, limit
    and cure.
    """

    size_classes: SizeClasses = field(metadata=of(Section("size_classes", SizeClasses)))
    decks: tuple[Deck, ...] = field(default=(Deck(),), metadata=of(Sections("deck", Deck)))
    material: Material = field(default=Material(), metadata=of(Section("material", Material)))
    motion: Motion = field(
        default=_Linear().motion(), metadata=of(_MotionSection("motion", Motion))
    )
    displacement: Displacement = field(
        default=Displacement(), metadata=of(Section("displacement", Displacement))
    )
    passage: Passage = field(default=Passage(), metadata=of(Section("passage", Passage)))
    segregation: Segregation = field(
        default=Segregation(), metadata=of(Section("segregation", Segregation))
    )
    bed: Bed = field(default=Bed(), metadata=of(Section("bed", Bed)))
    drive: Drive = field(default=Drive(), metadata=of(Section("drive", Drive)))
    solver: Solver = field(default=Solver(), metadata=of(Section("solver", Solver)))
    feed: Feed = field(default=Feed(), metadata=of(Section("feed", Feed)))
    name: str = field(default="quarry screen", metadata=of(Text("name")))

    def __post_init__(self) -> None:
        check_fields(self, "")
        self._complete_feed()
        for deck_place, deck in enumerate(self.decks, start=1):
            if not math.isclose(deck.length, self.decks[0].length, rel_tol=1e-9):
                name, first = f"deck[{deck_place}]", self.decks[0].length
                raise ConfigError(told("unequal_decks", name=name, value=deck.length, limit=first))
            for place, panel in enumerate(deck.panels, start=1):
                self._check_panel(f"deck[{deck_place}].panel[{place}]", panel)

    @classmethod
    def load(cls, path: str | Path) -> ScreenConfig:
        """Configuration from a TOML file. Raises ConfigError, OSError if it cannot be read."""
        path = Path(path)
        try:
            return cls.from_dict(_toml_tree(path.read_text(encoding="utf-8")), path.parent)
        except ConfigError as error:
            error.add_note(f"in {path}")
            raise

    @classmethod
    def loads(cls, text: str) -> ScreenConfig:
        """Configuration from the text of a TOML file; file names in it are relative to here."""
        return cls.from_dict(_toml_tree(text))

    @classmethod
    def from_dict(cls, tree: Mapping[str, Any], folder: str | Path = "") -> ScreenConfig:
        """Configuration from the tree of a TOML file; file names are relative to `folder`."""
        try:
            return read_table(cls, tree, "", Path(folder))
        except InputError as error:
            raise ConfigError(str(error)) from None

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
            part = getattr(part, attribute)
            part = part if place is None else part[place]
        return float(part)

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
        return "\n".join(_toml_lines(write_table(self), "")).lstrip("\n") + "\n"

    @property
    def apertures(self) -> tuple[float, ...]:
        """Apertures of all panels [m], top deck and feed end first."""
        return tuple(panel.aperture for deck in self.decks for panel in deck.panels)

    def _complete_feed(self) -> None:
        """Put a typical composition where none is given; the duty must be complete in any case."""
        feed = self.feed
        fractions = feed.mass_fraction or typical_fractions(self.size_classes.edges)
        feed = dataclasses.replace(feed, mass_fraction=fractions)
        try:
            feed.check_classes(self.size_classes.count)
            # They are the start values even of a screen that starts without feed.
            fractions = checked_fractions(fractions)
        except InputError as error:
            raise ConfigError(str(error)) from None
        object.__setattr__(self, "feed", dataclasses.replace(feed, mass_fraction=fractions))

    def _check_panel(self, name: str, panel: Panel) -> None:
        try:
            self.passage.velocity_at(panel.aperture)
        except ConfigError as error:
            raise ConfigError(f"{name}.{error}") from None
        slope, friction = abs(math.tan(panel.inclination)), self.material.friction_base
        if self.displacement.model == "rigid_body" and slope >= friction:
            raise ConfigError(
                told(
                    "too_steep",
                    given=given(f"{name}.inclination", panel.inclination, "rad"),
                    degrees=panel.inclination / DEG,
                    slope=slope,
                    limit=friction,
                )
            )
        if self.displacement.model == "bed":
            steepest = bed_friction(friction, BED_CONSTANTS[2])
            if math.tan(panel.inclination) > steepest:
                warnings.warn(
                    f"{name}.inclination = {panel.inclination:.6g} rad "
                    f"({panel.inclination / DEG:.6g} deg, slope {slope:.4g}) is above "
                    f"{steepest:.4g}, the friction of a bed on a base of friction {friction:.4g}, "
                    "up to which the displacement model bed was checked: take its velocity as a "
                    "guess, or make the panel flatter",
                    stacklevel=2,
                )


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
        part = getattr(part, attribute, None)
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
    return paths(ScreenConfig)


def _toml_tree(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"the text is not TOML ({error}): correct it there") from None


def _toml_lines(table: Mapping[str, Any], name: str) -> Iterator[str]:
    """Lines of a TOML table: values first, then the tables inside it."""
    for key, value in table.items():
        if not _is_table(value):
            yield f"{key} = {_toml_value(value)}"
    for key, value in table.items():
        full = f"{name}.{key}" if name else key
        if isinstance(value, dict):
            yield from ("", f"[{full}]", *_toml_lines(value, full))
        elif _is_table(value):
            for one in value:
                yield from ("", f"[[{full}]]", *_toml_lines(one, full))


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and isinstance(value[0], dict))


def _toml_value(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    return repr(value)
