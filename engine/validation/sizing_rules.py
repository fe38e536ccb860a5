"""Sizing rules of the trade: VSMA area factors and Karra's cut size.

Independent of the engine: functions of feed rate, feed curve, aperture and area only. Vibration,
inclination beyond its projection, bed depth and deck shape do not enter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from evidence import DATA
from vibroscreen.units import HOUR, MM, PERCENT, TONNE

__all__ = ["KARRA_EXPONENT", "karra_cut_size", "karra_partition", "vsma_area", "vsma_recovery"]

Array = NDArray[np.float64]
Passing = Callable[[float], float]

FACTORS = DATA / "vsma_tables.csv"
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


@cache
def _factor(name: str) -> tuple[Array, Array, Array]:
    """Abscissa, value and open area [%] of a table of factors, ascending."""
    frame = pd.read_csv(FACTORS, comment="#")
    part = frame[frame["table"] == name].sort_values("x")
    x, value, area = (part[column].to_numpy(float) for column in ("x", "value", "open_area_pct"))
    return x, value, area


def _look_up(name: str, x: float) -> float:
    """Factor, linear between the rows of its table, at its ends beyond them."""
    places, values, _ = _factor(name)
    return float(np.interp(x, places, values))


def usual_open_area(aperture: float) -> float:
    """Open area [1] of the cloth that the table of basic capacities stands for; aperture in m."""
    places, _, areas = _factor("A_in_openpct_STPHft2")
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
    G): basic capacity, oversize, half-size, deck, weight, open area (tables in
    `data/vsma_tables.csv`; wet screening and slots left out).
    """
    rate = undersize_rate / SHORT_TON * HOUR
    per_area = (
        _look_up("A_in_openpct_STPHft2", aperture / INCH)
        * _look_up("B_oversize_pct", (1.0 - passing(aperture)) / PERCENT)
        * _look_up("C_halfsize_pct", passing(0.5 * aperture) / PERCENT)
        * _look_up("D_deck", deck)
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
    """Cut size d50 [m] of a vibrating screen, dry, woven wire (Karra, CIM Bulletin, April 1979).

    As restated in King, Modeling and Simulation of Mineral Processing Systems (2001), and Gupta and
    Yan, Mineral Processing Design and Operations. Arguments as of `vsma_area`; area [m2];
    inclination [rad]. Throughfall aperture h, its basic capacity A [t/h m2], factors B, C, D and F;
    near-size (0.75 to 1.25 h) through G: d50 = h G K^-0.148 with K = U/(area A B C D F). The wire
    follows from aperture and open area; open areas other than those of VSMA's table scale A.
    """
    wire = aperture * (1.0 / math.sqrt(open_area) - 1.0)
    fall = (aperture + wire) * math.cos(inclination) - wire
    h = fall / MM
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
    return float(fall * g * loading**-0.148)


def karra_partition(size: Array, cut_size: float) -> Array:
    """Part of each size [m] that reports to the oversize [1]: 1 - exp(-0.693 (d/d50)^5.846)."""
    return -np.expm1(-math.log(2.0) * (size / cut_size) ** KARRA_EXPONENT)
