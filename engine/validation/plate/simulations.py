"""What was simulated of the plate: spheres, openings, cases, and the files of results."""

from __future__ import annotations

import pandas as pd

from evidence import DATA
from vibroscreen.units import MM

APERTURE, OPEN_AREA = 8.0 * MM, (8.0 / 11.0) ** 2
DENSITY = 2650.0  # kg/m3, of the spheres
BULK_DENSITY = 0.58 * DENSITY
COARSEST = 12.0 * MM
DECK_LENGTH = 0.66  # m
SEGMENT = DECK_LENGTH / 12  # m, of the records of what passes and lies along a deck
JUDGED = ("B0", "Bh", "I10", "NEAR", "CP")
DRIFTING = ("B15",)  # its hold-up still grows by 5 per cent of the feed: half the weight


def read(name: str) -> pd.DataFrame:
    """A file of the particle simulations."""
    return pd.read_csv(DATA / f"dem_{name}.csv", comment="#")


def bed_profile() -> pd.DataFrame:
    """Hold-up, velocity and heights of the bed, all sizes, by case and segment of the deck."""
    return read("deck_profile").query("size_mm == 'all' and segment > 0")
