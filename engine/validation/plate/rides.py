"""Beds that ride on a periodic patch of the plate, a DEM of our own: nothing is fitted to them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bed_velocity import deck_velocities
from evidence import DATA
from plate.decks import DECK_EDGES
from plate.model import plate, with_panels
from plate.simulations import APERTURE, BULK_DENSITY, DENSITY
from vibroscreen import Feed, Motion, Screen
from vibroscreen.sections import Displacement
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, MM

Array = NDArray[np.float64]
SIZES = np.array([3.0, 4.0, 5.0, 6.0, 7.0, 7.5, 9.0, 12.0]) * MM
PASSES = SIZES < APERTURE
STARTING = 0.3  # s, that a bed needs to ride as it will: the first interval does not count
STILL = 0.01  # m/s, for beds that ride slower
HARDLY = 1.7  # throw number up to which a bed counts as hardly thrown


def rides() -> dict[str, pd.DataFrame]:
    """Rows over time of each bed; v_m_s: its velocity, passed_*: part of a size that has passed."""
    rows = pd.read_csv(DATA / "ride_dem.csv", comment="#")
    return {str(name): part for name, part in rows.groupby("case", sort=False)}


def kind_of(case: pd.Series, throw: float) -> str:
    """Motion and slope of a bed."""
    if throw < HARDLY:
        return f"throw number below {HARDLY:g}"
    if case.ellipticity == 0.0 and case.beta_deg == 90.0:
        return "vertical, level"
    slope = "level" if case.alpha_deg == 0.0 else "down a slope"
    sense = {0.0: "linear", 1.0: "with the flow", -1.0: "against it"}
    return f"{sense[float(np.sign(case.ellipticity))]}, {slope}"


def ridden(part: pd.DataFrame, values: dict[str, float]) -> tuple[float, Array, Array]:
    """Throw number, what has passed in the engine [time, size], and how many spheres a size has."""
    case = part.iloc[0]
    share = np.array([case[f"feed_{d / MM:g}"] for d in SIZES], float)
    load = BULK_DENSITY * case.depth_mm * MM * share / share.sum()
    velocity = max(STILL, abs(float(part.v_m_s.mean())))
    width = case.width_mm * MM
    config = plate(
        SizeClasses(DECK_EDGES, 1),
        Feed(float(load.sum() * width * velocity), tuple(share / share.sum())),
        Motion.elliptical(case.A_mm * MM, case.f_Hz, case.beta_deg * DEG, case.ellipticity),
        width,
    )
    (panel,) = config.decks[0].panels
    length = velocity * float(part.time_s.max())
    panel = dataclasses.replace(
        panel, length=length, inclination=case.alpha_deg * DEG, velocity_factor=1.0
    )
    config = with_panels(config, panel).replace(displacement=Displacement("prescribed", velocity))
    steady = Screen(config.with_values(values)).solve_steady()
    profile = steady.profile
    modelled = [
        np.interp(part.time_s, profile.position / velocity, profile.passed[:, i]) / load[i]
        for i in np.flatnonzero(PASSES)
    ]
    area = case.length_mm * width * MM * case.seeds
    number = load * area / (math.pi / 6.0 * DENSITY * SIZES**3)
    return steady.throw_number, np.transpose(modelled), number


def ride_errors(values: dict[str, float]) -> pd.DataFrame:
    """A row a bed: its kind, error of passage and its noise, velocities in DEM and model [m/s].

    Errors are RMSE over times and sizes, each size by its number of spheres; noise: what counting
    so few spheres makes of it.
    """
    found = []
    for name, part in rides().items():
        throw, modelled, number = ridden(part, values)
        simulated = part[[f"passed_{d / MM:g}" for d in SIZES[PASSES]]].to_numpy()
        weight = number[PASSES] / number[PASSES].sum()
        chance = np.clip(modelled, 0.02, 0.98)
        found.append(
            {
                "case": name,
                "kind": kind_of(part.iloc[0], throw),
                "rmse": math.sqrt(((simulated - modelled) ** 2 @ weight).mean()),
                "noise": math.sqrt((chance * (1.0 - chance) / number[PASSES] @ weight).mean()),
                "v": part.v_m_s[part.time_s > STARTING].mean(),
                "v of bed": deck_velocities(part.head(1))[0],
            }
        )
    return pd.DataFrame(found).set_index("case")
