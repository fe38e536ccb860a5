"""The plate in the engine: its configuration and the numbers that are held in all fits."""

from __future__ import annotations

import dataclasses
import math

from bed_velocity import OPENINGS_GRIP, PERFORATED, ROLLING
from plate.simulations import (
    APERTURE,
    BAR,
    BULK_DENSITY,
    COARSEST,
    DECK_LENGTH,
    DENSITY,
    OPEN_AREA,
)
from vibroscreen import Feed, Motion, ScreenConfig
from vibroscreen.sections import (
    Bed,
    Deck,
    Displacement,
    Material,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import MM

LAYER = 4.0 * MM  # the mixing length above the contact layer, which is one coarsest grain
# How many spheres as large as an opening lie over each in a layer one aperture deep.
CROWDING = round(BULK_DENSITY / DENSITY / OPEN_AREA / (math.pi / 6.0), 2)
LEVELLING = 0.22  # by the 60 mm of bed L.d60 of our own DEM (`rides`), which allows 0.2 to 0.25
BOUNCING = 10.0  # by single spheres (`isolated`); the decks and batches hardly see it
NARROW = 0.05  # mm


def narrow(sizes_mm: tuple[float, ...]) -> SizeClasses:
    """A narrow class at each size and an empty one between two."""
    edges = [d + side for d in sizes_mm for side in (-NARROW, NARROW)]
    return SizeClasses(tuple(d * MM for d in edges), 1)


def plate(classes: SizeClasses, feed: Feed, motion: Motion, width: float = 0.066) -> ScreenConfig:
    """The plate of the simulations, horizontal."""
    panel = Panel(DECK_LENGTH, 0.0, APERTURE, OPEN_AREA, velocity_factor=PERFORATED, thickness=BAR)
    return ScreenConfig(
        classes,
        decks=(Deck(width, (panel,)),),
        material=Material(BULK_DENSITY, OPENINGS_GRIP, OPENINGS_GRIP, ROLLING),
        motion=motion,
        displacement=Displacement("bed"),
        passage=Passage(
            "bounce",
            0.25,
            crowding=CROWDING,
            drift=0.0,
            levelling=LEVELLING,
            bouncing=BOUNCING,
            closure="vibration",
        ),
        segregation=Segregation("exchange", dilation=0.0, closure="vibration"),
        bed=Bed(COARSEST, LAYER, layers=64),
        solver=Solver(1e-4),
        feed=feed,
        name="plate of the particle simulations",
    )


def with_panels(config: ScreenConfig, *panels: Panel) -> ScreenConfig:
    """The same with other panels."""
    return config.replace(decks=(dataclasses.replace(config.decks[0], panels=panels),))
