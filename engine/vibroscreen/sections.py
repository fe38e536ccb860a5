"""The parts of a screen, a section of the TOML file each: every number with all that is said of it.

A field gives default, TOML key, unit, limits, meaning and cure; buffer, checks, messages and FMU
variables follow from it (`variables.py`). Its place among the fields is that in the buffer.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vibroscreen import registry
from vibroscreen.errors import ConfigError
from vibroscreen.fields import (
    Choice,
    Entry,
    Number,
    Sections,
    as_tuple,
    ascending_pairs,
    check_fields,
    from_si,
    number,
    said,
    to_si,
    told_of,
)
from vibroscreen.number_sets import TYPICAL, CalibrationEntry, NumberSet
from vibroscreen.units import DEG, MM

__all__ = [
    "Bed",
    "Deck",
    "Displacement",
    "Drive",
    "Material",
    "Panel",
    "Passage",
    "Segregation",
    "Solver",
]

DEFAULT_TABLE = Path(__file__).with_name("passage_velocity.csv")
TABLE_COLUMNS = ("aperture_mm", "velocity_m_s")
# Whether u and w follow from the vibration; their place here is what the buffer holds.
CLOSURES = ("none", "vibration")
# Shapes of openings; their place here, from 1 on, is what the buffer holds.
OPENINGS = ("square", "slot", "round", "slot_across")
SLOTS = ("slot", "slot_across")
# Composition inside a layer; their place here is what the buffer holds.
RECONSTRUCTIONS = ("none", "linear")
# What screens are made like, with room. The largest in makers' lists are about 12 x 4.9 m; bars of
# grizzlies are up to .3 m apart, the finest woven media .045 mm; banana decks start at up to 40
# degrees; thin mats are open to .8 of their area. An assumption, from no single source.
LONGEST, WIDEST, NARROWEST = 30.0, 10.0, 1.0 * MM  # m; strips of simulations are centimetres wide
FINEST, COARSEST = 0.02 * MM, 0.5  # m
STEEPEST = 45.0 * DEG
MOST_OPEN = 0.95
# Numbers of which a part goes with the aperture, and that part.
BESIDE = {
    "passage.velocity": "passage.relative_velocity",
    "segregation.velocity": "segregation.relative_velocity",
    "segregation.dilation": "segregation.relative_dilation",
    "bed.contact_depth": "bed.relative_contact_depth",
    "bed.layer_depth": "bed.relative_layer_depth",
    "thickness": "relative_thickness",  # of every panel
}
# What is taken where neither a number nor its part of the aperture is given: the number, the part.
# The set "typical dry stone" (calibrations/typical_dry_stone.toml says what it was fitted to).
PASSAGE_VELOCITY = (0.0, 0.56)  # m/s, over sqrt(g aperture): a fully loose bed, hardly thrown
PERCOLATION_VELOCITY = (0.0, 0.034)  # m/s, over sqrt(g aperture), at a throw number of 3
DILATION = (0.0, 0.8)  # m, over the mean grain size: an opening in flight, not a static gap
CONTACT_DEPTH = (0.0, 1.0)  # m, over the aperture
THICKNESS = (0.0, 1.0)  # m, over the bar that open area and aperture imply
BOUNCE = ", used by the passage law bounce"


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
        return ascending_pairs(
            name,
            value,
            ("aperture", Number("aperture_mm", "m", MM, above=0.0)),
            ("velocity", Number("velocity_m_s", "m/s", at_least=0.0, at_most=100.0)),
            "is not a table of two or more rows (aperture, velocity): "
            'give a CSV file with the columns aperture_mm, velocity_m_s, or "default"',
        )

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


def _pair(
    fixed: float | None, relative: float | None, usual: tuple[float, float]
) -> tuple[float, float]:
    """A number and its part of the aperture; `usual` where neither of them is given."""
    if fixed is None and relative is None:
        return usual
    return fixed or 0.0, relative or 0.0


def _follows_vibration(closure: str | None, given: object) -> bool:
    """Whether velocities follow from the vibration: those `given` in m/s do only if told to."""
    return given is None if closure is None else closure == "vibration"


@dataclass(frozen=True)
class Panel:
    """One stretch of a deck with one screening medium.

    length [m]; inclination [rad], down-slope positive; aperture: clear opening [m]; open_area:
    useful open area fraction [1], 0 for a blank plate; velocity_factor: on the velocity of
    the bed that the displacement model gives [1]. opening: shape of the openings, aperture is the
    short side or the diameter; a "slot" lies along the flow, "slot_across" across it, its long side
    is slot_length [m]. thickness of the medium [m]: hides a part of the openings of an inclined
    panel; relative_thickness: over the bar that open area and aperture imply, adds to it [1].
    """

    length: float = number(
        6.0,
        "length_m",
        "m",
        above=0.0,
        at_most=LONGEST,
        tells="Length of the panel along the deck",
    )
    inclination: float = number(
        5.0 * DEG,
        "inclination_deg",
        "rad",
        DEG,
        at_least=-STEEPEST,
        at_most=STEEPEST,
        variability="tunable",
        also="slope angle pitch incline",
        tells="Inclination of the panel, positive down to the discharge",
    )
    aperture: float = number(
        16.0 * MM,
        "aperture_mm",
        "m",
        MM,
        at_least=FINEST,
        at_most=COARSEST,
        also="opening hole hole_size openings slot_width",
        tells="Clear opening of the screening medium, of a slot the short side",
    )
    open_area: float = number(
        0.55,
        "open_area",
        at_least=0.0,
        at_most=MOST_OPEN,
        variability="tunable",
        also="useful_open_area",
        tells="Useful openings over the area of the panel; less when they blind",
        cure="give the open part of the deck's area",
    )
    velocity_factor: float = number(
        1.0,
        "velocity_factor",
        at_least=0.0,
        at_most=10.0,
        variability="tunable",
        tells="Factor on the velocity of the bed that the displacement model gives",
        cure="give a factor that is not negative",
    )
    opening: str = said(
        "square",
        Choice(
            "opening",
            lambda: OPENINGS,
            also="shape hole_shape opening_shape aperture_shape",
            tells="Shape of the openings",
            meanings=(
                "square openings",
                "slots with the long side along the flow",
                "round openings",
                "slots with the long side across the flow",
            ),
        ),
    )
    slot_length: float = number(
        0.0,
        "slot_length_mm",
        "m",
        MM,
        at_least=0.0,
        at_most=LONGEST,
        also="slot length_of_slot opening_length hole_length",
        tells="Long side of a slot; 0 where the openings are no slots",
    )
    thickness: float | None = number(
        None,
        "thickness_mm",
        "m",
        MM,
        at_least=0.0,
        at_most=COARSEST,
        optional=True,
        also="wire bar wire_diameter bar_width bridge medium_thickness",
        tells="Thickness of the medium between its openings, beside what relative_thickness adds; "
        "hides a part of the openings of an inclined panel",
        cure="give the diameter of the wire, or the thickness of the bars",
    )
    relative_thickness: float | None = number(
        None,
        "relative_thickness",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        tells="Thickness of the medium over the bar that open area and aperture imply",
        cure="0 leaves what thickness says",
    )

    def __post_init__(self) -> None:
        check_fields(self, "deck.panel")

    @property
    def effective(self) -> dict[str, float]:
        """Thickness of the medium [m, over the implied bar], as the engine has it."""
        thickness, relative = _pair(self.thickness, self.relative_thickness, THICKNESS)
        return {"thickness": thickness, "relative_thickness": relative}

    def explicit(self) -> Panel:
        """The same panel with every number written."""
        numbers: dict[str, Any] = dict(self.effective)
        return replace(self, **numbers)


@dataclass(frozen=True)
class Deck:
    """A row of panels, feed end first, of one width [m]."""

    width: float = number(
        2.4, "width_m", "m", at_least=NARROWEST, at_most=WIDEST, tells="Width of the deck"
    )
    panels: tuple[Panel, ...] = said((Panel(),), Sections("panel", Panel))

    def __post_init__(self) -> None:
        check_fields(self, "deck")

    @property
    def length(self) -> float:
        """Total length of the panels [m]."""
        return math.fsum(panel.length for panel in self.panels)


@dataclass(frozen=True)
class Material:
    """Bulk density [kg/m3] and friction coefficients [1] on the deck and inside the bed.

    calibration: the named set that gives the numbers of displacement, passage, segregation and bed
    which a file does not write, or a ScreenConfig is not given (`vibroscreen.number_sets`): a
    name, a path of a set of one's own, or the set.
    """

    bulk_density: float = number(
        1600.0,
        "bulk_density_kg_m3",
        "kg/m3",
        at_least=10.0,
        at_most=25000.0,
        also="density bulk",
        tells="Mass of the bed over the volume it fills",
    )
    friction_deck: float = number(
        0.5,
        "friction_deck",
        at_least=0.0,
        at_most=100.0,
        variability="tunable",
        also="friction",
        tells="Friction coefficient between bed and deck",
        cure="give a friction coefficient",
    )
    friction_internal: float = number(
        0.6,
        "friction_internal",
        at_least=0.0,
        at_most=100.0,
        variability="tunable",
        tells="Friction coefficient inside the bed",
        cure="give a friction coefficient",
    )
    rolling: float = number(
        0.0,
        "rolling",
        at_least=0.0,
        at_most=0.95,
        variability="tunable",
        tells="Share of the deck's grip that rolling grains take, used by the displacement model "
        "bed",
        cure="0 is for grains that do not roll",
    )
    calibration: str | NumberSet = said(TYPICAL, CalibrationEntry())

    def __post_init__(self) -> None:
        check_fields(self, "material")

    @property
    def friction_base(self) -> float:
        """Friction where the bed slips, the weakest: the smaller of the two [1]."""
        return min(self.friction_deck, self.friction_internal)


@dataclass(frozen=True)
class Displacement:
    """Model of the transport along the deck; velocity [m/s] is what `prescribed` takes."""

    model: str = said(
        "bed",
        Choice(
            "model",
            lambda: registry.names("displacement"),
            tells="How the velocity of the bed along the deck is found",
            meanings=(
                "the bed moves at displacement.velocity",
                "the bed moves as a rigid body on the vibrating deck",
                "the bed moves as grains that land softly and slip by speed",
            ),
        ),
    )
    velocity: float = number(
        0.0,
        "velocity_m_s",
        "m/s",
        at_least=0.0,
        at_most=20.0,
        variability="continuous",
        also="speed transport_velocity",
        tells="Velocity of the bed along the deck, used by the displacement model prescribed",
        cure="give a velocity down the deck; it cannot convey upwards",
    )

    def __post_init__(self) -> None:
        check_fields(self, "displacement")


@dataclass(frozen=True)
class Passage:
    """Law of passage and velocity of grains through the openings [m/s].

    velocity: a constant; velocity_table: rows (aperture m, velocity m/s) instead of it,
    interpolated linearly. Give one of them. closure: "none", or "vibration" for a velocity that
    follows from the vibration; `velocity` is then that of a fully loose bed that is hardly thrown
    (MODEL.md, "Closures in the vibration"). With the law `bounce` it is that of a bed four
    apertures deep. Of the law `bounce` [1]: rim, 0 where only grains clear of the rim pass
    (Gaudin), 1 where the rim guides all grains in whose centre is over the opening; crowding, how
    much grains that try the same opening hinder each other, about how many lie over one; drift, by
    how much of an aperture the bed carries a sinking grain on, at sqrt(g aperture); levelling,
    aperture over the most that the deck shakes of a bed; bouncing, how much higher than the deck
    throws a lone grain bounces.
    """

    law: str = said(
        "pelevin",
        Choice(
            "law",
            lambda: registry.names("passage"),
            tells="How the chance of a grain to pass follows from its size",
            meanings=(
                "every grain tries an opening alone",
                "a fine grain may pass together with another one",
                "grains try at each landing, are guided by the rim and crowd in the openings",
            ),
        ),
    )
    velocity: float | None = number(
        None,
        "velocity_m_s",
        "m/s",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        variability="tunable",
        tells="Velocity at which grains fall through the openings, beside what relative_velocity "
        "adds; scales how fast the screen works",
        cure="0 closes the deck where relative_velocity is 0 too",
    )
    velocity_table: tuple[tuple[float, float], ...] | None = said(None, _VelocityTable())
    rim: float = number(
        0.34,
        "rim",
        at_least=0.0,
        at_most=1.0,
        variability="tunable",
        tells=f"How far the rim of an opening guides a grain in{BOUNCE}",
        cure="0 is Gaudin, 1 guides every grain in",
    )
    crowding: float = number(
        2.1,
        "crowding",
        at_least=0.0,
        at_most=100.0,
        variability="tunable",
        tells=f"How grains that try the same opening hinder each other{BOUNCE}",
        cure="0 lets any number pass at once",
    )
    drift: float = number(
        0.17,
        "drift",
        at_least=0.0,
        at_most=10.0,
        variability="tunable",
        tells=f"How the bed carries grains over the openings{BOUNCE}",
        cure="0 lets grains pass at any velocity",
    )
    levelling: float = number(
        0.22,
        "levelling",
        at_least=0.0,
        at_most=100.0,
        variability="tunable",
        tells=f"Aperture over the most that the deck shakes of a bed{BOUNCE}",
        cure="0 lets all of a bed come down",
    )
    bouncing: float = number(
        10.0,
        "bouncing",
        at_least=0.0,
        at_most=1000.0,
        variability="tunable",
        tells=f"How much higher than the deck throws a lone grain bounces{BOUNCE}",
        cure="0 is for grains that land softly",
    )
    closure: str | None = said(
        None, Choice("closure", lambda: CLOSURES, variability="", optional=True)
    )
    relative_velocity: float | None = number(
        None,
        "relative_velocity",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        variability="tunable",
        tells="Velocity at which grains fall through the openings over sqrt(g aperture), beside "
        "passage.velocity",
        cure="0 leaves what velocity says",
    )

    @staticmethod
    def left_aside(tree: Mapping[str, Any]) -> dict[str, str]:
        """Keys of version 0.4.0 that a file with another law than bounce may have, and why."""
        if tree.get("law") == "bounce":
            return {}
        gone = ("passing_time", "damping", "lift", "stirring", "calming", "depletion")
        return dict.fromkeys(gone, "is a constant of an earlier law bounce, not used here")

    def __post_init__(self) -> None:
        check_fields(self, "passage")
        if self.velocity_table is not None and self.velocity is not None:
            raise ConfigError(
                told_of(Passage, "velocity", "passage", "two_velocities", self.velocity)
            )

    @property
    def effective(self) -> dict[str, float]:
        """Velocity [m/s], and over sqrt(g aperture) [1], as the engine has them."""
        usual = PASSAGE_VELOCITY if self.velocity_table is None else (0.0, 0.0)
        velocity, relative = _pair(self.velocity, self.relative_velocity, usual)
        return {"velocity": velocity, "relative_velocity": relative}

    @property
    def follows_vibration(self) -> bool:
        """Whether the velocity follows from the vibration."""
        given = self.velocity if self.velocity_table is None else self.velocity_table
        return _follows_vibration(self.closure, given)

    def velocity_at(self, aperture: float) -> float:
        """Velocity of grains through openings of that aperture [m], in m/s.

        Raises ConfigError for an aperture that the table does not reach.
        """
        if (end := self.off_table(aperture)) is not None:
            raise ConfigError(told_of(Panel, "aperture", "panel", "off_table", aperture, end))
        if self.velocity_table is None:
            return self.effective["velocity"]
        apertures, velocities = zip(*self.velocity_table, strict=True)
        return float(np.interp(aperture, apertures, velocities))

    def off_table(self, aperture: float) -> float | None:
        """The end of the table that an aperture lies beyond [m]; None where it does not."""
        if self.velocity_table is None:
            return None
        least, most = self.velocity_table[0][0], self.velocity_table[-1][0]
        return None if least <= aperture <= most else least if aperture < least else most


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

    model: str = said(
        "exchange",
        Choice(
            "model",
            lambda: registry.names("segregation"),
            tells="How fine grains find their way down through the bed",
            meanings=(
                "the bed has the same composition at every height",
                "a given share of the bed is sorted, the rest is mixed",
                "layers exchange grains as fine ones percolate through the gaps between coarse "
                "ones",
                "the finest grains lie on the screen at once",
            ),
        ),
    )
    velocity: float | None = number(
        None,
        "velocity_m_s",
        "m/s",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        variability="tunable",
        tells="Velocity at which fine grains percolate down through the bed, beside what "
        "relative_velocity adds",
        cure="0 switches percolation off where relative_velocity is 0 too",
    )
    dilation: float | None = number(
        None,
        "dilation_mm",
        "m",
        MM,
        at_least=0.0,
        at_most=1.0,
        optional=True,
        variability="tunable",
        tells="Extra distance between grains by shaking, beside what relative_dilation adds; opens "
        "the gaps for fine grains",
    )
    proportion: float = number(
        0.5,
        "proportion",
        at_least=0.0,
        at_most=1.0,
        variability="tunable",
        tells="Sorted share of the bed, used by the segregation model proportional",
        cure="give a part of one",
    )
    relative_dilation: float | None = number(
        None,
        "relative_dilation",
        at_least=0.0,
        at_most=10.0,
        optional=True,
        variability="tunable",
        tells="Extra distance between grains by shaking, over their mean size",
        cure="give a part of the mean grain size",
    )
    mixing: float = number(
        0.0,
        "mixing_m_s",
        "m/s",
        at_least=0.0,
        at_most=100.0,
        variability="tunable",
        tells="Velocity at which layers exchange grains whatever their size",
        cure="0 only sorts",
    )
    closure: str | None = said(
        None, Choice("closure", lambda: CLOSURES, variability="", optional=True)
    )
    relative_velocity: float | None = number(
        None,
        "relative_velocity",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        variability="tunable",
        tells="Velocity at which fine grains percolate down through the bed over sqrt(g aperture), "
        "beside segregation.velocity",
        cure="0 leaves what velocity says",
    )

    def __post_init__(self) -> None:
        check_fields(self, "segregation")

    @property
    def follows_vibration(self) -> bool:
        """Whether the velocities follow from the vibration."""
        return _follows_vibration(self.closure, self.velocity)

    @property
    def effective(self) -> dict[str, float]:
        """Velocity [m/s, over sqrt(g aperture)], dilation [m, 1], as the engine has them."""
        velocity = _pair(self.velocity, self.relative_velocity, PERCOLATION_VELOCITY)
        dilation = _pair(self.dilation, self.relative_dilation, DILATION)
        names = ("velocity", "relative_velocity", "dilation", "relative_dilation")
        return dict(zip(names, (*velocity, *dilation), strict=True))


@dataclass(frozen=True)
class Bed:
    """Layers of the bed and what lies on the deck at the start.

    contact_depth and layer_depth [m]: of the contact layer and of those above, which are as deep
    unless something else is given. initial: "empty", or "steady" for full of the duty. layers: room
    in the state, the contact layer among them, at least 2. reconstruction: "none", every layer is
    mixed evenly, as in the paper; "linear" where the layers are a grid to be refined (MODEL.md,
    "Segregation").
    """

    contact_depth: float | None = number(
        None,
        "contact_depth_mm",
        "m",
        MM,
        at_least=0.0,
        at_most=5.0,
        optional=True,
        tells="Depth of the layer from which grains can reach the openings, beside what "
        "relative_contact_depth adds",
    )
    layer_depth: float | None = number(
        None,
        "layer_depth_mm",
        "m",
        MM,
        at_least=0.0,
        at_most=5.0,
        optional=True,
        tells="Depth of the layers above, the mixing length of the bed, beside what "
        "relative_layer_depth adds",
    )
    initial: str = said(
        "empty",
        Choice(
            "initial",
            lambda: ("empty", "steady"),
            tells="What lies on the decks at the start; 2: when initialisation ends the screen is "
            "in the steady state of the feed and the vibration given until then",
            meanings=(
                "the decks are empty at the start",
                "the decks are full of the feed given at the start",
            ),
        ),
    )
    layers: int = number(32, "layers", whole=True, at_least=2, at_most=10_000, variability="")
    reconstruction: str = said(
        "none", Choice("reconstruction", lambda: RECONSTRUCTIONS, variability="")
    )

    relative_contact_depth: float | None = number(
        None,
        "relative_contact_depth",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        tells="Depth of the layer from which grains can reach the openings, in apertures",
    )
    relative_layer_depth: float | None = number(
        None,
        "relative_layer_depth",
        at_least=0.0,
        at_most=100.0,
        optional=True,
        tells="Depth of the layers above, in apertures",
    )

    def __post_init__(self) -> None:
        check_fields(self, "bed")

    @property
    def effective(self) -> dict[str, float]:
        """Depths of the contact layer [m, apertures] and of those above, as the engine has them."""
        contact = _pair(self.contact_depth, self.relative_contact_depth, CONTACT_DEPTH)
        layer = _pair(self.layer_depth, self.relative_layer_depth, contact)
        names = ("contact_depth", "relative_contact_depth", "layer_depth", "relative_layer_depth")
        return dict(zip(names, (*contact, *layer), strict=True))


@dataclass(frozen=True)
class Drive:
    """Vibrating mass [kg], bearing friction [1] and diameter [m], efficiency of the drive [1]."""

    vibrating_mass: float = number(
        6000.0,
        "vibrating_mass_kg",
        "kg",
        at_least=0.0,
        at_most=1e6,
        also="mass",
        tells="Mass of the vibrating box",
    )
    bearing_friction: float = number(
        0.005,
        "bearing_friction",
        at_least=0.0,
        at_most=1.0,
        tells="Friction coefficient of the exciter's bearings",
    )
    bearing_diameter: float = number(
        120.0 * MM,
        "bearing_diameter_mm",
        "m",
        MM,
        at_least=0.0,
        at_most=5.0,
        tells="Diameter at which the bearings rub",
    )
    efficiency: float = number(
        0.9,
        "efficiency",
        at_least=0.01,
        at_most=1.0,
        tells="Mechanical over electric power of the drive",
    )

    def __post_init__(self) -> None:
        check_fields(self, "drive")


@dataclass(frozen=True)
class Solver:
    """Bound on the error of a recovery [1]; packages: room in the state, 0 chosen by the engine.

    The bound holds from 1e-6 up; below, the error still falls, but may exceed it by up to 20 times
    where layers or sizes run out.
    """

    tolerance: float = number(
        1e-4,
        "tolerance",
        at_least=1e-9,
        at_most=1e-1,
        tells="Bound on the numerical error of a recovery; also what a host gives as tolerance",
    )
    packages: int = number(0, "packages", whole=True, at_least=0, at_most=100_000, variability="")

    def __post_init__(self) -> None:
        check_fields(self, "solver")
