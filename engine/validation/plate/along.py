"""Undersize along the decks, beside what was counted, and where the bed runs out over the edge."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd

from plate.decks import predicted
from plate.errors import rmse
from plate.model import with_panels
from plate.simulations import JUDGED, SEGMENT, bed_profile, read
from vibroscreen.calibrate import Run


def block_errors() -> float:
    """Standard errors of the recoveries by blocks of a run over those by counts."""
    part = read("deck_streams").query("size_mm < 8 and recovery_se_binomial > 0.002")
    return rmse(part["recovery_se_blocks"].to_numpy()) / rmse(
        part["recovery_se_binomial"].to_numpy()
    )


def run_out() -> float:
    """Velocity of the bed over the last segment by that over the three before, mean of the decks.

    Measured: flow through the middle of a segment over what lies on it, all segments being alike.
    """
    hold_up = bed_profile().set_index("case")["holdup_kg"]
    fed = read("deck_streams").groupby("case")["feed_kg_s"].sum()
    undersize = read("deck").groupby(["case", "segment"])["undersize_kg_s"].sum()
    ratios = []
    for name in JUDGED:
        passed = undersize[name].to_numpy()
        flow = fed[name] - passed.cumsum() + 0.5 * passed
        velocity = flow / hold_up[name].to_numpy()
        ratios.append(velocity[-1] / velocity[-4:-1].mean())
    return float(np.mean(ratios))


def with_run_out(run: Run, factor: float) -> Run:
    """The same with a bed so much faster on the last segment, where it runs over the edge."""
    (panel,) = run.config.decks[0].panels
    before = dataclasses.replace(panel, length=panel.length - SEGMENT)
    faster = factor * panel.velocity_factor
    last = dataclasses.replace(panel, length=SEGMENT, velocity_factor=faster)
    return dataclasses.replace(run, config=with_panels(run.config, before, last))


def along(run: Run, values: dict[str, float]) -> pd.DataFrame:
    """Undersize by segment [kg/(m2 s)]: measured, its standard error by counts, and modelled."""
    part = read("deck").query("case == @run.name")
    result = predicted(run.config, values)
    width = run.config.decks[0].width
    segment = part.groupby("segment")
    start, stop = segment["x0_m"].first().to_numpy(), segment["x1_m"].first().to_numpy()
    area = width * (stop - start)
    grain = np.where(part["particles"] > 0, part["undersize_kg_s"] / part["particles"].clip(1), 0.0)
    variance = (grain**2 * part["particles"]).groupby(part["segment"]).sum()
    flow = result.profile.passed.sum(axis=1) * width * result.transport_velocity
    at = result.profile.position
    modelled = (np.interp(stop, at, flow) - np.interp(start, at, flow)) / area
    return pd.DataFrame(
        {
            "x_m": 0.5 * (start + stop),
            "measured": segment["undersize_kg_s"].sum().to_numpy() / area,
            "error": np.sqrt(variance.to_numpy()) / area,
            "modelled": modelled,
        }
    )


def within(profile: pd.DataFrame) -> int:
    """Segments whose undersize is modelled within two standard errors."""
    miss = (profile["modelled"] - profile["measured"]).abs()
    return int((miss < 2.0 * profile["error"]).sum())
