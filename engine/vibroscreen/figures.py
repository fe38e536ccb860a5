"""Every number that a screen gives, said once: as a field with its name in FMUs, unit and meaning.

From the fields follow the records of the buffer (kernels/state.py), the outputs of FMUs
(vibroscreen_fmu/ports.py), and what results hold (results.py). A field of a deck is named behind
`deck[k].`, that of what leaves over a lower deck behind `intermediate[k].`; in their texts {} is
the deck.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ALARMS",
    "BETWEEN",
    "BOX",
    "DECK",
    "BoxFigures",
    "DeckFigures",
    "Figure",
    "figures_of",
]

# A number of one state, or a row of them, one a design.
Value = TypeVar("Value", float, NDArray[np.float64])


@dataclass(frozen=True)
class Figure:
    """A number that a screen gives.

    scalar: what kernels and results call it; name: what FMUs call it; unit: "1" for none.
    """

    scalar: str
    name: str
    unit: str
    tells: str
    alarm: bool = False


def figure(name: str, unit: str, tells: str) -> Any:
    """A field of a result: its name in an FMU, unit and meaning."""
    return field(metadata={"figure": (name, unit, tells)})


def figures_of(kind: type) -> tuple[Figure, ...]:
    """The figures that the fields of a dataclass say."""
    return tuple(
        Figure(entry.name, *entry.metadata["figure"])
        for entry in dataclasses.fields(kind)
        if "figure" in entry.metadata
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class DeckFigures(Generic[Value]):
    """Figures of a deck in SI units; rows of them, one a design, in a table of many."""

    hold_up: Value = figure("bed.hold_up", "kg", "What lies on deck {}")
    depth_feed: Value = figure("bed.depth_feed", "m", "Depth of the bed on deck {} at the feed end")
    depth_discharge: Value = figure(
        "bed.depth_discharge", "m", "Depth of the bed on deck {} at the discharge"
    )
    depth_over_aperture_feed: Value = figure(
        "bed.depth_over_aperture_feed",
        "1",
        "Depth of the bed on deck {} at the feed end over the aperture of the first panel",
    )
    depth_over_aperture_discharge: Value = figure(
        "bed.depth_over_aperture_discharge",
        "1",
        "Depth of the bed on deck {} at the discharge over the aperture of the last panel",
    )
    transport_velocity: Value = figure(
        "bed.transport_velocity", "m/s", "Velocity of the bed along the first panel of deck {}"
    )
    throw_number: Value = figure(
        "motion.throw_number",
        "1",
        "Largest acceleration normal to the first panel of deck {} over that of gravity",
    )
    aperture: Value = figure(
        "performance.aperture", "m", "Smallest aperture of deck {}, which its efficiency is about"
    )
    feed_rate: Value = figure(
        "performance.feed_rate", "kg/s", "What comes to deck {}, mean over the last step"
    )
    undersize_rate: Value = figure(
        "performance.undersize_rate", "kg/s", "What passes deck {}, mean over the last step"
    )
    oversize_rate: Value = figure(
        "performance.oversize_rate", "kg/s", "What leaves over deck {}, mean over the last step"
    )
    efficiency: Value = figure(
        "performance.efficiency",
        "1",
        "Efficiency of deck {}: share of what comes to it finer than its smallest aperture that "
        "passed it in the last step; without such feed the last one stays",
    )
    misplaced_undersize: Value = figure(
        "performance.misplaced_undersize",
        "1",
        "Mass fraction finer than the smallest aperture of deck {} in what leaves over it",
    )
    misplaced_oversize: Value = figure(
        "performance.misplaced_oversize",
        "1",
        "Mass fraction not finer than the smallest aperture of deck {} in what passes it",
    )
    cut_size: Value = figure("performance.cut_size", "m", "Size of which half leaves over deck {}")
    ecart_probable: Value = figure(
        "performance.ecart_probable",
        "m",
        "Half the distance between the sizes of which 75 % and 25 % leave over deck {}",
    )
    imperfection: Value = figure(
        "performance.imperfection", "1", "Ecart probable over cut size of deck {}"
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxFigures(Generic[Value]):
    """Figures of the box in SI units; rows of them, one a design, in a table of many."""

    hold_up: Value = figure("bed.hold_up", "kg", "What lies on all decks")
    depth_feed: Value = figure("bed.depth_feed", "m", "Depth of the top deck's bed at the feed end")
    depth_discharge: Value = figure(
        "bed.depth_discharge", "m", "Depth of the top deck's bed at the discharge"
    )
    transport_velocity: Value = figure(
        "bed.transport_velocity",
        "m/s",
        "Velocity of the bed along the first panel of the top deck",
    )
    throw_number: Value = figure(
        "motion.throw_number",
        "1",
        "Largest acceleration normal to the deck over that of gravity; throws above 1",
    )
    acceleration_number: Value = figure(
        "motion.acceleration_number",
        "1",
        "K, amplitude x (angular frequency)^2 of the fundamental over the acceleration of gravity",
    )
    undersize_recovery: Value = figure(
        "performance.undersize_recovery",
        "1",
        "Share of what is fed finer than the top deck's smallest aperture that passed this deck in "
        "the last step: its efficiency",
    )
    efficiency: Value = figure(
        "performance.efficiency",
        "1",
        "Efficiency of the top deck: share of what is fed finer than its smallest aperture that "
        "passed this deck in the last step; without feed the last one stays",
    )
    cut_size: Value = figure(
        "performance.cut_size", "m", "Size of which half leaves over the top deck"
    )
    ecart_probable: Value = figure(
        "performance.ecart_probable",
        "m",
        "Half the distance between the sizes of which 75 % and 25 % leave over the top deck",
    )
    feed_p80: Value = figure("feed.p80", "m", "Size that 80 % of what is fed is finer than")
    feed_p50: Value = figure("feed.p50", "m", "Size that half of what is fed is finer than")
    undersize_p80: Value = figure(
        "undersize.p80", "m", "Size that 80 % of what falls through the lowest deck is finer than"
    )
    undersize_p50: Value = figure(
        "undersize.p50", "m", "Size that half of what falls through the lowest deck is finer than"
    )
    oversize_p80: Value = figure(
        "oversize.p80", "m", "Size that 80 % of what leaves over the top deck is finer than"
    )
    oversize_p50: Value = figure(
        "oversize.p50", "m", "Size that half of what leaves over the top deck is finer than"
    )
    drive_power: Value = figure(
        "drive.power", "W", "Electric power of the drive, under the load at the end of the step"
    )
    exciter_force: Value = figure(
        "drive.exciter_force",
        "N",
        "Force of the exciter, vibrating mass x amplitude x (angular frequency)^2",
    )
    balance_error: Value = figure(
        "balance.error", "kg", "Fed less discharged less held since the start: round-off only"
    )


_RATES = (
    Figure(
        "undersize_rate",
        "undersize.mass_flow_rate",
        "kg/s",
        "What falls through the lowest deck, mean over the last step",
    ),
    Figure(
        "oversize_rate",
        "oversize.mass_flow_rate",
        "kg/s",
        "What leaves over the top deck, mean over the last step",
    ),
    Figure("feed_mass", "feed.mass", "kg", "Fed since the start"),
    Figure("undersize_mass", "undersize.mass", "kg", "Undersize since the start"),
    Figure("oversize_mass", "oversize.mass", "kg", "Oversize since the start"),
)


def _alarm(name: str, tells: str) -> Figure:
    return Figure(f"alarm_{name}", f"alarm.{name}", "1", tells, alarm=True)


ALARMS = (
    _alarm(
        "bed_depth",
        "The bed of a deck is deeper at the discharge than 4 apertures at 0.8 t/m3, 5 at 1.6, "
        "linear between",
    ),
    _alarm("capacity", "The bed of a deck is deeper than the layers of the model can hold"),
    _alarm(
        "transport",
        "The vibration does not convey the bed down a deck, or the displacement model bed is used "
        "outside of what it was checked for",
    ),
    _alarm(
        "performance",
        "Cut size or ecart probable of a deck lie outside of the sizes that come to it, or nothing "
        "finer than its aperture comes to it",
    ),
    _alarm(
        "plausibility",
        "A bed deeper than 0.5 m or faster than 3 m/s, a K above 10, or openings that bars hide on "
        "a steep panel: such screens are not built",
    ),
)
BOX = (*_RATES, *figures_of(BoxFigures), *ALARMS)
BETWEEN = (
    Figure("rate", "mass_flow_rate", "kg/s", "What leaves over deck {}, mean over the last step"),
    Figure("mass", "mass", "kg", "Left over deck {} since the start"),
    Figure("p80", "p80", "m", "Size that 80 % of what leaves over deck {} is finer than"),
    Figure("p50", "p50", "m", "Size that half of what leaves over deck {} is finer than"),
)
DECK = figures_of(DeckFigures)
