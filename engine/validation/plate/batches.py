"""The batches that shake vertically, as runs of the engine."""

from __future__ import annotations

import math

import numpy as np

from plate.model import narrow, plate
from plate.simulations import APERTURE, DENSITY, read
from vibroscreen import Feed, Motion
from vibroscreen.calibrate import Run
from vibroscreen.units import DEG, MM

BATCH_AREA = 0.11**2  # m2
BATCH_SIZES = (4.0, 6.0, 7.0, 10.0, 12.0)


def batch_runs() -> list[Run]:
    """The batches; recoveries of the classes that can pass, each case with the same weight."""
    runs = []
    for name, part in read("batch_sieving").groupby("case", sort=False):
        passed = part.pivot_table(index="time_s", columns="d_mm", values="passed")
        number = part.groupby("d_mm")["N0"].first()
        size = number.index.to_numpy() * MM
        mass = number.to_numpy() * math.pi / 6.0 * DENSITY * size**3  # kg
        classes = narrow(BATCH_SIZES)
        fraction, recovery = np.zeros(classes.count), np.full((len(passed), classes.count), np.nan)
        fraction[::2] = mass / mass.sum()
        recovery[:, ::2] = np.where(size < APERTURE, passed, np.nan)
        first = part.iloc[0]
        motion = Motion.linear(first["A_mm"] * MM, first["f_Hz"], 90.0 * DEG)
        runs.append(
            Run(
                str(name),
                plate(classes, Feed(1.0, tuple(fraction)), motion),
                recovery,
                sigma=math.sqrt(np.isfinite(recovery).sum()),
                areal_mass=float(mass.sum() / BATCH_AREA),
                times=tuple(passed.index),
            )
        )
    return runs
