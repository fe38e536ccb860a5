"""How the height of coarse spheres over fine ones grows on a plate without holes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from plate.model import narrow, plate
from plate.simulations import APERTURE, BULK_DENSITY, read
from vibroscreen import Feed, Motion, Screen
from vibroscreen.sections import Deck, Displacement, Panel
from vibroscreen.units import DEG, MM

Array = NDArray[np.float64]
BED_DEPTH = 0.035  # m; the file does not say it: that of the batches, twice the mean height
SMOOTHED = 9  # cycles


def height_gap(case: pd.DataFrame, values: dict[str, float]) -> tuple[Array, Array]:
    """Height of the coarse grains over the fine ones on a blank plate [m], over the time [s].

    The bed starts mixed. It rides on a blank deck, at 1 m/s, so that places are times.
    """
    first = case.iloc[0]
    classes = narrow((first["d_fine"], first["d_coarse"]))
    motion = Motion.linear(first["A_mm"] * MM, 15.625, 90.0 * DEG)
    config = plate(classes, Feed(BED_DEPTH * BULK_DENSITY, (0.3, 0.0, 0.7)), motion, 1.0)
    config = config.with_values(values).replace(
        decks=(Deck(1.0, (Panel(12.0, 0.0, APERTURE, 0.0),)),),
        displacement=Displacement("prescribed", 1.0),
    )
    profile = Screen(config).solve_steady().profile
    thickness = profile.load.sum(axis=2) / BULK_DENSITY
    middle = np.cumsum(thickness, axis=1) - 0.5 * thickness
    height = (profile.load * middle[:, :, None]).sum(axis=1) / profile.load.sum(axis=1).clip(1e-12)
    return profile.position, height[:, 2] - height[:, 0]


@cache
def growth(values: tuple[tuple[str, float], ...]) -> pd.DataFrame:
    """Growth of the height gap over each simulation [mm], and that of the model from there on."""
    rows = {}
    for name, case in read("segregation").groupby("case"):
        weight = np.full(SMOOTHED, 1.0 / SMOOTHED)
        gap = np.convolve(case["z_coarse"] - case["z_fine"], weight, "valid")
        time = np.convolve(case["time_s"], weight, "valid")
        at, modelled = height_gap(case, dict(values))
        # The simulated bed starts with a gap, so the model is met where it has the same one.
        start = np.interp(gap[0], modelled / MM, at)
        end = np.interp(start + time[-1] - time[0], at, modelled / MM)
        rows[name] = (gap[0], gap[-1] - gap[0], end - gap[0])
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=["start", "measured", "modelled"])
    frame["error"] = frame["modelled"] / frame["measured"] - 1.0
    return frame
