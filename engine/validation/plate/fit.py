"""The fits: four numbers from the batches, five from batches and decks, each case left out."""

from __future__ import annotations

from functools import cache

import pandas as pd
from rich.console import Console
from rich.progress import Progress

from plate.batches import batch_runs
from plate.decks import deck_runs
from plate.errors import rmse
from vibroscreen.calibrate import Calibration, Parameter, Run, calibrate

BATCH_NUMBERS = (
    Parameter("passage.velocity", 0.05, 90.0, 1.0),
    Parameter("passage.rim", 0.0, 0.9, 0.3, scale="linear"),
    Parameter("segregation.velocity", 0.005, 1.0, 0.06),
    Parameter("segregation.relative_dilation", 0.01, 2.0, 0.2),
)
FREED = (
    Parameter("passage.passing_time", 0.3, 10.0),
    Parameter("passage.damping", 0.01, 30.0),
)
FREED_DECKS = (*FREED, Parameter("passage.depletion", 0.01, 10.0))
COMMON_NUMBERS = (*BATCH_NUMBERS, Parameter("passage.drift", 0.0, 5.0, 0.5, scale="linear"))


def fitted(runs: list[Run], numbers: tuple[Parameter, ...], what: str) -> Calibration:
    """Fit with each case left out in turn, progress shown."""
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what)

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        return calibrate(runs, numbers, starts=3, progress=show)


@cache
def batch_fit() -> Calibration:
    """Four numbers from the four batches."""
    return fitted(batch_runs(), BATCH_NUMBERS, "batches")


@cache
def common_fit() -> Calibration:
    """Five numbers from batches and decks together."""
    return fitted(batch_runs() + deck_runs(), COMMON_NUMBERS, "batches and decks")


def freed_fit(
    calibration: Calibration, numbers: tuple[Parameter, ...]
) -> tuple[dict[str, float], float]:
    """Numbers and RMSE where others are fitted too."""
    parameters = (*calibration.fit.parameters, *numbers)
    freed = calibrate(calibration.runs, parameters, starts=1, leave_out=False)
    return numbers_of(freed), rmse(by_run(freed)["fitted"].to_numpy())


def numbers_of(calibration: Calibration) -> dict[str, float]:
    """Fitted numbers by the name of the variable."""
    return calibration.settings(calibration.runs[0])


def by_run(calibration: Calibration) -> pd.DataFrame:
    """RMSE of the recoveries below the aperture by run: fitted, and with the run left out."""
    frame = calibration.frame()
    errors = pd.DataFrame(
        {
            "run": frame["run"],
            "fitted": frame["modelled"] - frame["measured"],
            "left out": frame["held_out"] - frame["measured"],
        }
    )
    return errors.groupby("run", sort=False).agg(rmse)


def write_plate(calibration: Calibration) -> str:
    """The common calibration as a configuration: the base case B0 with the fitted numbers."""
    base = next(run.config for run in calibration.runs if run.name == "B0")
    text = calibration.configure(base).to_toml()
    return f"""\
# Plate of the particle simulations in engine/validation/data, one calibration for its batches and
# decks. Written by engine/validation/dem_calibration.py. Another case needs another feed, motion
# and inclination. Classes: spheres of 3, 4, 5, 6, 7, 7.5, 9 and 12 mm, the means of the limits.

{text}"""
