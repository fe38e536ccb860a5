"""Undersize along the decks, beside what was counted."""

from __future__ import annotations

import numpy as np
import pandas as pd

from plate.decks import predicted
from plate.errors import rmse
from plate.simulations import read
from vibroscreen.calibrate import Run


def block_errors() -> float:
    """Standard errors of the recoveries by blocks of a run over those by counts."""
    part = read("deck_streams").query("size_mm < 8 and recovery_se_binomial > 0.002")
    return rmse(part["recovery_se_blocks"].to_numpy()) / rmse(
        part["recovery_se_binomial"].to_numpy()
    )


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
