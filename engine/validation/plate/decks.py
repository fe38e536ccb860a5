"""The continuous decks, as runs of the engine, and what it predicts of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd

from plate.errors import rmse
from plate.model import plate, with_panels
from plate.simulations import APERTURE, DECK_LENGTH, DRIFTING, SEGMENT, bed_profile, read
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.calibrate import Run
from vibroscreen.sections import Displacement
from vibroscreen.size_classes import SizeClasses
from vibroscreen.steady import SteadyResult
from vibroscreen.units import DEG, MM

# Spheres of one size are classes whose arithmetic mean is that size. Those of the decks can lie
# side by side, those of the batches have empty classes between them.
DECK_EDGES = tuple(d * MM for d in (2.75, 3.25, 4.75, 5.25, 6.75, 7.25, 7.75, 10.25, 13.75))


def deck_config(case: pd.Series) -> ScreenConfig:
    """A deck as it was simulated, with the feed that was measured."""
    streams = read("deck_streams").query("case == @case.name")
    feed = streams["feed_kg_s"].to_numpy()
    if case["motion"] == "circular":
        sense = "with_flow" if str(case["rotation"]).startswith("coflow") else "against_flow"
        motion = Motion.circular(case["A_m"], case["f_Hz"], sense)
    else:
        motion = Motion.linear(case["A_m"], case["f_Hz"], case["beta_deg"] * DEG)
    config = plate(
        SizeClasses(DECK_EDGES, 1),
        Feed(float(feed.sum()), tuple(feed / feed.sum())),
        motion,
        case["W_m"],
    )
    (panel,) = config.decks[0].panels
    return with_panels(config, dataclasses.replace(panel, inclination=case["alpha_deg"] * DEG))


def with_measured_velocity(config: ScreenConfig, name: str) -> ScreenConfig:
    """The same with the velocity of the bed in each of the twelve segments of the simulation."""
    (panel,) = config.decks[0].panels
    panels = (
        dataclasses.replace(panel, length=SEGMENT, velocity_factor=velocity)
        for velocity in bed_profile().query("case == @name")["v_m_s"]
    )
    return with_panels(config, *panels).replace(displacement=Displacement("prescribed", 1.0))


def deck_runs(measured_velocity: bool = False) -> list[Run]:
    """The continuous decks; the velocity of the bed from the model, or as measured."""
    runs = []
    streams = read("deck_streams")
    for name, case in read("deck_cases").set_index("case").iterrows():
        config = deck_config(case)
        part = streams.query("case == @name")
        passes = part["size_mm"].to_numpy() * MM < APERTURE
        if measured_velocity:
            config = with_measured_velocity(config, str(name))
        sigma = math.sqrt(passes.sum()) * (2.0 if name in DRIFTING else 1.0)
        recovery = np.where(passes, part["recovery"], np.nan)
        runs.append(Run(str(name), config, recovery, sigma=sigma))
    return runs


def predicted(config: ScreenConfig, values: dict[str, float]) -> SteadyResult:
    """Steady state of a deck with fitted numbers."""
    return Screen(config.with_values(values)).solve_steady()


def deck_errors(runs: list[Run], values: dict[str, float]) -> pd.DataFrame:
    """RMSE of the recoveries below the aperture of each deck with the given numbers."""
    rows = {}
    for run in runs:
        result = predicted(run.config, values)
        below = np.isfinite(run.recovery)
        rows[run.name] = (rmse((result.recovery - run.recovery)[below]), result.transport_velocity)
    return pd.DataFrame.from_dict(rows, orient="index", columns=["rmse", "velocity"])


def twice_the_feed(values: dict[str, float]) -> float:
    """Mean undersize of the base deck with twice its feed [kg/(m2 s)]."""
    base = next(run.config for run in deck_runs() if run.name == "B0")
    double = dataclasses.replace(base.feed, mass_flow_rate=2.0 * base.feed.mass_flow_rate)
    result = predicted(base.replace(feed=double), values)
    return result.undersize.mass_flow_rate / (base.decks[0].width * DECK_LENGTH)
