"""The fits: four numbers by the batches, five by batches and decks; cases and kinds left out."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import Progress

from plate.batches import batch_runs
from plate.decks import deck_errors, deck_runs
from plate.errors import rmse
from plate.simulations import APERTURE, KINDS
from vibroscreen import Screen
from vibroscreen.beyond import kind_of
from vibroscreen.calibrate import Calibration, Parameter, Run, calibrate
from vibroscreen.number_sets import Range
from vibroscreen.sizing_rules import rules_of
from vibroscreen.units import DEG, MM

BATCH_NUMBERS = (
    Parameter("passage.velocity", 0.01, 20.0, 0.25),
    Parameter("passage.rim", 0.0, 0.9, 0.3, scale="linear"),
    Parameter("segregation.velocity", 0.005, 1.0, 0.06),
    Parameter("segregation.relative_dilation", 0.01, 2.0, 0.4),
)
COMMON_NUMBERS = (*BATCH_NUMBERS, Parameter("passage.drift", 0.0, 1.0, 0.2, scale="linear"))
# What the common fit holds.
HELD = (
    Parameter("passage.crowding", 0.1, 20.0, 1.0),
    Parameter("passage.levelling", 0.01, 2.0, 0.1),
)


def fitted(runs: list[Run], numbers: tuple[Parameter, ...], what: str) -> Calibration:
    """Fit with each case left out in turn, progress shown."""
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what)

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        return calibrate(runs, numbers, starts=3, progress=show)


def all_runs() -> list[Run]:
    """Batches, and decks at the velocities of the simulation."""
    return batch_runs() + deck_runs(measured_velocity=True)


@cache
def batch_fit() -> Calibration:
    """Four numbers from the five batches."""
    return fitted(batch_runs(), BATCH_NUMBERS, "batches")


@cache
def common_fit() -> Calibration:
    """Five numbers from batches and decks together."""
    return fitted(all_runs(), COMMON_NUMBERS, "batches and decks")


@cache
def free_fit() -> Calibration:
    """What the common fit holds, fitted too."""
    return calibrate(all_runs(), (*COMMON_NUMBERS, *HELD), starts=3, leave_out=False)


def run_errors(runs: Iterable[Run], values: dict[str, float]) -> dict[str, float]:
    """RMSE of the recoveries below the aperture of each run with the given numbers."""
    runs = list(runs)
    decks = deck_errors([run for run in runs if run.areal_mass is None], values)["rmse"]
    errors = {str(name): float(error) for name, error in decks.items()}
    for run in runs:
        if run.areal_mass is not None:
            screen = Screen(run.config.with_values(values))
            found = screen.sieve_batch(
                run.areal_mass, run.config.feed.mass_fraction, times=run.times
            )
            errors[run.name] = rmse((found - run.recovery)[np.isfinite(run.recovery)])
    return errors


@cache
def by_kind(free: bool = False) -> pd.DataFrame:
    """RMSE on each kind of cases by a fit without them, and on each of its cases.

    free: what the common fit holds is fitted too, from starts that do not know it.
    """
    runs, rows = all_runs(), {}
    numbers = (*COMMON_NUMBERS, *HELD) if free else COMMON_NUMBERS
    for kind, names in KINDS.items():
        kept = [run for run in runs if run.name not in names]
        left = [run for run in runs if run.name in names]
        found = calibrate(kept, numbers, starts=3, leave_out=False)
        errors = run_errors(left, numbers_of(found))
        said = ", ".join(f"{name} {errors[name]:.3f}" for name in names)
        rows[kind] = (rmse(np.array(list(errors.values()))), said)
    return pd.DataFrame.from_dict(rows, orient="index", columns=["rmse", "cases"])


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


def write_set(calibration: Calibration) -> str:
    """The common calibration as a set of numbers, those fitted to three digits, with its range."""
    rounded = {name: float(f"{value:.3g}") for name, value in numbers_of(calibration).items()}
    configs = {run.name: run.config.with_values(rounded) for run in batch_runs() + deck_runs()}
    panels = [config.decks[0].panels[0] for config in configs.values()]
    thrown = [
        config.motion.throw_number(panel.inclination)
        for config, panel in zip(configs.values(), panels, strict=True)
    ]
    accelerations = [config.motion.peak_acceleration for config in configs.values()]
    rules = [rules_of(config)[0] for config in configs.values()]
    found = configs["B0"].number_set(
        "dem plate",
        fitted_to=f"{len(configs)} particle simulations of a plate with square holes of "
        f"{APERTURE / MM:g} mm: {', '.join(configs)}",
        source="engine/validation/dem_calibration.py",
        rmse=round(rmse(by_run(calibration)["fitted"].to_numpy()), 3),
        range=Range(
            aperture=(APERTURE, APERTURE),
            inclination=_span([panel.inclination / DEG for panel in panels], DEG),
            throw_number=_span(thrown),
            acceleration=_span(accelerations),
            oversize=_span([1.0 - rule.passing(rule.aperture) for rule in rules]),
            motion=tuple(dict.fromkeys(kind_of(config.motion) for config in configs.values())),
        ),
    )
    return f"""\
# Plate of the particle simulations in engine/validation/data, one calibration for its batches and
# decks. Written by engine/validation/dem_calibration.py.

{found.to_toml()}"""


def _span(values: list[float], unit: float = 1.0) -> tuple[float, float]:
    """Least and largest of some values times a unit, outwards to two decimals."""
    return (
        math.floor(100.0 * min(values)) / 100.0 * unit,
        math.ceil(100.0 * max(values)) / 100.0 * unit,
    )
