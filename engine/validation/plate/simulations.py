"""What was simulated of the plate: spheres, openings, cases, and the files of results."""

from __future__ import annotations

import pandas as pd

from evidence import DATA
from vibroscreen.units import MM

APERTURE, BAR = 8.0 * MM, 3.0 * MM  # bars as thick as they are wide
OPEN_AREA = (APERTURE / (APERTURE + BAR)) ** 2
DENSITY = 2650.0  # kg/m3, of the spheres
BULK_DENSITY = 0.58 * DENSITY
COARSEST = 12.0 * MM
DECK_LENGTH = 0.66  # m
SEGMENT = DECK_LENGTH / 12  # m, of the records of what passes and lies along a deck
BATCHES = ("S1", "S2", "S3", "S4", "S6")
DECKS = ("B0", "Bh", "B15", "I10", "NEAR", "CP", "A3", "FINE", "CM")
DRIFTING = ("B15",)  # its hold-up still grows by 5 per cent of the feed: half the weight
JUDGED = tuple(name for name in DECKS if name not in DRIFTING)
# Cases that are alike in what they vary: a fit without them has to say it by its law.
KINDS = {
    "2 mm": ("S2",),
    "small strokes of decks and batches": ("A3", "S2"),
    "3 mm": ("S1", "S4", "S6", "A3"),
    "4 mm batch": ("S3",),
    "circular with the flow": ("CM",),
    "circular against the flow": ("CP",),
    "circular": ("CM", "CP"),
    "slope, linear": ("I10",),
    "all slopes": ("I10", "CM", "CP"),
    "fine feeds": ("FINE", "S6"),
    "near-size": ("NEAR",),
    "composition": ("FINE", "NEAR", "S6"),
    "thin": ("Bh", "S4"),
    "deep": ("B15",),
    "depth": ("Bh", "B15", "S4"),
    "all batches": BATCHES,
}


def read(name: str) -> pd.DataFrame:
    """A file of the particle simulations."""
    return pd.read_csv(DATA / f"dem_{name}.csv", comment="#")


def bed_profile() -> pd.DataFrame:
    """Hold-up, velocity and heights of the bed, all sizes, by case and segment of the deck."""
    return read("deck_profile").query("size_mm == 'all' and segment > 0")
