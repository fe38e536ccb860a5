"""Sizing rules of the trade: VSMA's area factors and Karra's cut size, for every deck of a screen.

Independent of the engine: functions of feed rate, feed curve, aperture, open area and area only.
Vibration, inclination beyond its projection, bed depth and deck shape do not enter. Both are for
dry screening on square openings. VSMA: area factors as published by its members (`vsma_tables.csv`
says where they were read), the efficiency factor J as commonly printed with them. Karra: CIM
Bulletin, April 1979, as restated in King, Modeling and Simulation of Mineral Processing Systems
(2001), and Gupta and Yan, Mineral Processing Design and Operations; two restatements were compared.
A table is held at its ends; `Rules.beyond` says which ends were reached.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.units import HOUR, MM, PERCENT, TONNE

__all__ = [
    "KARRA_EXPONENT",
    "Rules",
    "karra_cut_size",
    "karra_partition",
    "rules_of",
    "usual_open_area",
    "vsma_area",
    "vsma_recovery",
]

Array = NDArray[np.float64]
Passing = Callable[[float], float]

FACTORS = Path(__file__).with_name("vsma_tables.csv")
CAPACITY, OVERSIZE, HALF_SIZE, DECK = (
    "A_in_openpct_STPHft2",
    "B_oversize_pct",
    "C_halfsize_pct",
    "D_deck",
)
# VSMA's factor J by efficiency (undersize recovery), as commonly printed with the tables.
EFFICIENCY = (0.70, 0.75, 0.80, 0.85, 0.90, 0.95)
J = (1.90, 1.70, 1.50, 1.35, 1.15, 1.00)

INCH = 25.4 * MM
FOOT = 12.0 * INCH
SHORT_TON = 907.18474  # kg
POUND = SHORT_TON / 2000.0
WEIGHT = 100.0 * POUND / FOOT**3  # kg/m3, the material of the tables
KARRA_DENSITY = 1602.0  # kg/m3, the same in Karra's model
KARRA_EXPONENT = 5.846
KARRA_FINEST = (10.2991 / 12.1286) ** (1.0 / 0.3162)  # mm, where his basic capacity is zero
SIZES_IN_CLASS = 200  # over which Karra's curve is averaged


@cache
def _factors() -> dict[str, tuple[Array, Array, Array]]:
    """Abscissa, value and open area [%] of every table of factors, ascending."""
    lines = FACTORS.read_text(encoding="utf-8").splitlines()
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for row in csv.DictReader(line for line in lines if not line.startswith("#")):
        numbers = (float(row[name] or "nan") for name in ("x", "value", "open_area_pct"))
        rows.setdefault(row["table"], []).append(tuple(numbers))  # type: ignore[arg-type]
    return {name: tuple(np.array(sorted(table)).T) for name, table in rows.items()}


def _look_up(name: str, x: float) -> float:
    """Factor, linear between the rows of its table, at its ends beyond them."""
    places, values, _ = _factors()[name]
    return float(np.interp(x, places, values))


def usual_open_area(aperture: float) -> float:
    """Open area [1] of the cloth that the table of basic capacities stands for; aperture in m."""
    places, _, areas = _factors()[CAPACITY]
    return float(np.interp(aperture / INCH, places, areas)) * PERCENT


def vsma_area(
    undersize_rate: float,
    passing: Passing,
    aperture: float,
    open_area: float,
    bulk_density: float,
    deck: int = 1,
) -> float:
    """Screen area [m2] that VSMA asks for at an efficiency of 95 %, dry, square openings.

    undersize_rate: finer than the aperture in the feed [kg/s]; passing(size [m]): of the feed [1];
    aperture [m]; open_area [1]; bulk_density [kg/m3]; deck: 1 is the top one. Area = U/(A B C D F
    G): basic capacity, oversize, half-size, deck, weight, open area (wet screening and slots left
    out).
    """
    rate = undersize_rate / SHORT_TON * HOUR
    per_area = (
        _look_up(CAPACITY, aperture / INCH)
        * _look_up(OVERSIZE, (1.0 - passing(aperture)) / PERCENT)
        * _look_up(HALF_SIZE, passing(0.5 * aperture) / PERCENT)
        * _look_up(DECK, deck)
        * bulk_density
        / WEIGHT
        * open_area
        / usual_open_area(aperture)
    )
    return rate / per_area * FOOT**2


def vsma_recovery(area: float, area_at_95: float) -> float:
    """Undersize recovery [1] at which VSMA finds an area enough, from the one at 95 %, by J.

    Held at 0.95 where the area is larger and nan below 0.70, where the table ends.
    """
    needed = area_at_95 / area
    return math.nan if needed > J[0] else float(np.interp(needed, J[::-1], EFFICIENCY[::-1]))


def throughfall(aperture: float, open_area: float, inclination: float) -> float:
    """Opening that a falling grain sees of an inclined deck [m], below 0 for none.

    The wire follows from aperture [m] and open area [1]; inclination [rad].
    """
    wire = aperture * (1.0 / math.sqrt(open_area) - 1.0) if open_area > 0.0 else math.inf
    return (aperture + wire) * math.cos(inclination) - wire if wire < math.inf else -math.inf


def karra_cut_size(
    undersize_rate: float,
    passing: Passing,
    aperture: float,
    open_area: float,
    bulk_density: float,
    area: float,
    inclination: float = 0.0,
    deck: int = 1,
) -> float:
    """Cut size d50 [m] of a vibrating screen by Karra, dry, woven wire; nan where he has none.

    Arguments as of `vsma_area`; area [m2]; inclination [rad]. Throughfall aperture h, its basic
    capacity A [t/h m2], factors B, C, D and F; near-size (0.75 to 1.25 h) through G: d50 = h G
    K^-0.148 with K = U/(area A B C D F). Open areas other than those of VSMA's table scale A, which
    is negative below 0.6 mm.
    """
    fall = throughfall(aperture, open_area, inclination)
    h = fall / MM
    if h < KARRA_FINEST:
        return math.nan
    basic = 12.1286 * h**0.3162 - 10.2991 if h < 50.8 else 0.3388 * h + 14.4122
    basic *= open_area / usual_open_area(aperture)
    over, half = 1.0 - passing(fall), passing(0.5 * fall)
    b = 1.6 - 1.2 * over if over <= 0.87 else 4.275 - 4.25 * over
    if half <= 0.3:
        c = 1.2 * half + 0.7
    elif half <= 0.55:
        c = 2.053 * half**0.564
    elif half <= 0.8:
        c = 3.35 * half**1.37
    else:
        c = 5.0 * half - 1.5
    d = 1.1 - 0.1 * deck
    near = passing(1.25 * fall) - passing(0.75 * fall)
    g = 0.975 * (1.0 - near) ** 0.511
    loading = (
        undersize_rate * HOUR / TONNE / area / (basic * b * c * d * bulk_density / KARRA_DENSITY)
    )
    return float(fall * g * loading**-0.148) if loading > 0.0 else math.nan


def karra_partition(size: Array, cut_size: float) -> Array:
    """Part of each size [m] that reports to the oversize [1]: 1 - exp(-0.693 (d/d50)^5.846)."""
    return -np.expm1(-math.log(2.0) * (size / cut_size) ** KARRA_EXPONENT)


@dataclass(frozen=True)
class Rules:
    """What VSMA and Karra say of a deck at a feed rate to the screen [kg/s]; sizes in m.

    deck: from 1, the top one. As the rules are used, all that is finer than an opening of the deck
    above is the feed of a lower deck; a deck of several panels counts with its smallest aperture,
    the area of all and their mean open area and inclination. nan where a rule says nothing.
    """

    config: ScreenConfig
    rate: float
    deck: int = 1

    @property
    def area(self) -> float:
        """Area of the deck [m2]."""
        deck = self.config.decks[self.deck - 1]
        return deck.width * deck.length

    @property
    def aperture(self) -> float:
        """Smallest aperture of the deck [m]."""
        return min(panel.aperture for panel in self.config.decks[self.deck - 1].panels)

    @property
    def open_area(self) -> float:
        """Mean open area of the panels by their lengths [1]."""
        return self._mean("open_area")

    @property
    def inclination(self) -> float:
        """Mean inclination of the panels by their lengths [rad]."""
        return self._mean("inclination")

    def _mean(self, name: str) -> float:
        deck = self.config.decks[self.deck - 1]
        return math.fsum(p.length * getattr(p, name) for p in deck.panels) / deck.length

    @property
    def above(self) -> float:
        """Largest opening that the feed of the deck came through [m]."""
        return min(self.config.largest_apertures[: self.deck - 1], default=math.inf)

    def _passed(self, size: float) -> float:
        """Passing of the feed of the screen, linear between the limits of the classes."""
        return float(np.interp(size, self.config.size_classes.edges, self._cumulative))

    @cached_property
    def _cumulative(self) -> Array:
        return np.concatenate([[0.0], np.cumsum(self.config.feed.mass_fraction)])

    def passing(self, size: float) -> float:
        """Passing of the feed of the deck."""
        whole = self._passed(self.above)
        return min(self._passed(size) / whole, 1.0) if whole > 0.0 else 1.0

    @property
    def undersize_rate(self) -> float:
        """Finer than the aperture in the feed of the deck [kg/s]."""
        return self.rate * self._passed(min(self.aperture, self.above))

    @cached_property
    def area_at_95(self) -> float:
        """Area that VSMA asks for at 95 % [m2]."""
        if self.open_area == 0.0:
            return math.inf
        return vsma_area(
            self.undersize_rate,
            self.passing,
            self.aperture,
            self.open_area,
            self.config.material.bulk_density,
            self.deck,
        )

    @property
    def load(self) -> float:
        """Area that VSMA asks for at 95 % over the area that there is [1]."""
        return self.area_at_95 / self.area

    @property
    def vsma_recovery(self) -> float:
        """Undersize recovery by VSMA; 0.95 stands for 0.95 or more, nan for less than 0.70."""
        return vsma_recovery(self.area, self.area_at_95)

    @cached_property
    def cut_size(self) -> float:
        """Karra's d50."""
        return karra_cut_size(
            self.undersize_rate,
            self.passing,
            self.aperture,
            self.open_area,
            self.config.material.bulk_density,
            self.area,
            self.inclination,
            self.deck,
        )

    @cached_property
    def _sizes(self) -> Array:
        """Sizes that Karra's curve is averaged over, [class, size]."""
        classes = self.config.size_classes
        place = (np.arange(SIZES_IN_CLASS) + 0.5) / SIZES_IN_CLASS
        return classes.lower[:, None] + (classes.upper - classes.lower)[:, None] * place

    @property
    def class_recovery(self) -> Array:
        """Recovery of each class by Karra's partition curve."""
        recovery: Array = 1.0 - karra_partition(self._sizes, self.cut_size).mean(axis=1)
        return recovery

    @property
    def karra_recovery(self) -> float:
        """Undersize recovery by Karra's partition curve."""
        finer = self._sizes < min(self.aperture, self.above)
        mass = np.array(self.config.feed.mass_fraction)[:, None] * finer
        passed = mass * (1.0 - karra_partition(self._sizes, self.cut_size))
        return float(passed.sum() / mass.sum()) if mass.any() else math.nan

    @property
    def beyond(self) -> tuple[str, ...]:
        """What the rules were not made for, a sentence each."""
        return tuple(self._beyond())

    def _beyond(self) -> Iterator[str]:
        panels = self.config.decks[self.deck - 1].panels
        if len({(panel.aperture, panel.open_area) for panel in panels}) > 1:
            yield (
                f"the rules know one medium a deck: taken as {self.aperture / MM:.4g} mm with "
                f"{self.open_area / PERCENT:.3g} % open area all along"
            )
        for told, name, x, unit in (
            ("an aperture", CAPACITY, self.aperture / INCH, INCH / MM),
            ("oversize in the feed", OVERSIZE, (1.0 - self.passing(self.aperture)) / PERCENT, 1.0),
            ("half-size in the feed", HALF_SIZE, self.passing(0.5 * self.aperture) / PERCENT, 1.0),
            ("a deck number", DECK, float(self.deck), 1.0),
        ):
            least, most = _factors()[name][0][[0, -1]]
            sign = {CAPACITY: " mm", DECK: ""}.get(name, " %")
            if not least * (1.0 - 1e-9) <= x <= most * (1.0 + 1e-9):
                yield (
                    f"VSMA's table ends at {told} of {(least if x < least else most) * unit:.3g}"
                    f"{sign}, this is {x * unit:.3g}{sign}: its end is taken"
                )
        if math.isnan(self.vsma_recovery):
            yield (
                f"VSMA's efficiencies end at {EFFICIENCY[0]:.2f}: the area is less than 1/{J[0]:g} "
                "of that for 0.95"
            )
        fall = throughfall(self.aperture, self.open_area, self.inclination)
        if math.isnan(self.cut_size):
            yield (
                f"Karra has no cut size for a throughfall aperture below {KARRA_FINEST:.2g} mm, or "
                "without undersize or open area"
            )
        elif self.cut_size > fall:
            yield (
                f"Karra's cut size, {self.cut_size / MM:.3g} mm, is above the throughfall aperture "
                f"({fall / MM:.3g} mm): so low a load is beyond his data"
            )


def rules_of(config: ScreenConfig) -> tuple[Rules, ...]:
    """What the rules say of every deck of a screen under its duty, top deck first."""
    rate = config.feed.mass_flow_rate
    return tuple(Rules(config, rate, deck) for deck in range(1, len(config.decks) + 1))
