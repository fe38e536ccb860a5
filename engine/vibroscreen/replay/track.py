"""How open the decks are, along the data: a number of the screen that follows measured products.

The engine goes through the data at some factors of the number. What a window of time should have
given at any factor lies between; a Kalman filter forwards and back (Rauch, Tung and Striebel, AIAA
Journal 3 (1965) 1445) finds the factor that drifts as a random walk and meets what was measured.
How uncertain the products of a window are is found by maximum likelihood; how far the factor drifts
is not known well, so all drifts count, each by its likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.replay.plant import PlantData
from vibroscreen.replay.run import moments
from vibroscreen.screen import Screen
from vibroscreen.units import HOUR

__all__ = ["TRACKED", "Track", "track"]

Array = NDArray[np.float64]

# What can be followed, and what people call it.
TRACKED = {"open_area": "open area", "passage": "passage velocity"}
# Factors at which the engine goes through the data.
FACTORS = (0.4, 0.6, 0.8, 1.0, 1.25)
# What is known of the factor before the first window: standard error of its logarithm.
BEFORE = 0.5
# Windows in which less than this part of the usual is fed say too little.
LEAST_FED = 0.1
FEWEST = 8  # windows
# Where the search for the drift in an hour and the error of a window starts, in logarithms.
START = (math.log(0.01), math.log(0.02))
LEAST, MOST = math.log(1e-5), math.log(1.0)
# Drifts that count, as likely as each other before the data say more.
DRIFTS: Array = np.log(np.geomspace(1e-4, 0.3, 15))


@dataclass(frozen=True, eq=False)
class Track:
    """A factor on a number of the screen along the data, with the limits of its interval.

    seconds: middles of the windows [s]; number: what the factor is on; level: of the interval;
    drift: standard error of the factor's logarithm that an hour adds, as likely; noise: relative
    standard error of a product of a window, as found.
    """

    number: str
    seconds: Array
    factor: Array
    lower: Array
    upper: Array
    level: float
    drift: float
    noise: float

    @property
    def falls(self) -> bool:
        """Whether the factor is surely less at the end than it was: intervals that do not meet."""
        return bool(self.upper[-1] < self.lower.max())

    def beside(self, part: pd.DataFrame) -> pd.DataFrame:
        """A part of a replay with the factor and its limits at the middle of each row."""
        middles = part["time_s"] + 0.5 * part["lasts_s"]
        columns = {"factor": self.factor, "lower": self.lower, "upper": self.upper}
        return part.assign(
            **{
                f"{self.number}_{name}": np.interp(middles, self.seconds, row)
                for name, row in columns.items()
            }
        )


class _Windows(NamedTuple):
    """Middles [s]; logarithms of measured products [window, product], nan for none; polynomials of
    the modelled ones in the logarithm of the factor [window, product, power], highest first."""

    seconds: Array
    measured: Array
    modelled: Array


def track(
    config: ScreenConfig,
    plant: PlantData,
    number: str = "open_area",
    window: float = 600.0,
    level: float = 0.9,
    progress: Callable[[float, float], None] | None = None,
) -> Track:
    """Follow the open area of all panels, or the passage velocity, by the measured products.

    window: time over which products are summed [s]; level: of the interval. Rows in which an input
    was filled in do not count. A scale that reads wrong all the time looks like another factor; a
    feed whose gradation is not measured does as well. progress: called with what is done and of how
    much. Raises InputError for data without products, or with too few windows.
    """
    from scipy.optimize import minimize
    from scipy.stats import norm

    if number not in TRACKED:
        raise InputError(f"track = {number!r} is unknown: give {' or '.join(TRACKED)}", "track")
    if not window > 0.0 or not 0.0 < level < 1.0:
        raise InputError(f"window = {window:g} s, level = {level:g}: give a time, a part of one")
    if not plant.products:
        raise InputError("track needs a product as measured: name its column, undersize_t_h")
    windows = _summed(config, plant, number, window, progress)
    found = minimize(
        lambda x: _filtered(windows, *x)[0], START, method="Nelder-Mead", bounds=[(LEAST, MOST)] * 2
    )
    noise = float(found.x[1])
    lost, means, variances = (
        np.array(row) for row in zip(*(_through(windows, d, noise) for d in DRIFTS), strict=True)
    )
    weight = np.exp(lost.min() - lost)[:, None] / np.exp(lost.min() - lost).sum()
    mean = (weight * means).sum(axis=0)
    variance = (weight * (variances + (means - mean) ** 2)).sum(axis=0)
    half = norm.ppf(0.5 + 0.5 * level) * np.sqrt(variance)
    return Track(
        number,
        windows.seconds,
        factor=np.exp(mean),
        lower=np.exp(mean - half),
        upper=np.exp(mean + half),
        level=level,
        drift=float(np.exp(weight[:, 0] @ DRIFTS)),
        noise=math.exp(noise),
    )


def scaled(config: ScreenConfig, number: str, factor: float) -> ScreenConfig:
    """The screen with a factor on what is followed. Raises InputError, ConfigError."""
    if number == "open_area":
        panels = [
            f"deck[{d}].panel[{p}].open_area"
            for d, deck in enumerate(config.decks, start=1)
            for p in range(1, len(deck.panels) + 1)
        ]
        return config.with_values({name: config.value_of(name) * factor for name in panels})
    if config.passage.velocity_table is not None:
        raise InputError("passage velocities of a table are not followed: track open_area")
    given = config.passage.effective
    names = {f"passage.{name}": value for name, value in given.items() if value > 0.0}
    return config.with_values({name: value * factor for name, value in names.items()})


# --- windows -------------------------------------------------------------------------------------
def _summed(
    config: ScreenConfig, plant: PlantData, number: str, window: float, progress: Any
) -> _Windows:
    """What every window gave as measured, and what it gives by the engine at all factors."""
    widest = max(panel.open_area for deck in config.decks for panel in deck.panels)
    most = 1.0 / widest if number == "open_area" else math.inf
    factors = [
        *(factor for factor in FACTORS if factor < most),
        *([most] if most < FACTORS[-1] else []),
    ]
    place = (plant.seconds / window).astype(int)
    measured = np.column_stack(list(plant.products.values()))
    good = np.isfinite(measured) & ~plant.filled[:, None]
    weight = good * plant.lasts[:, None]
    names = tuple(plant.products)
    sums = [_window_sums(place, weight * np.nan_to_num(measured))]
    for k, factor in enumerate(factors):
        rows = np.array([*_products(scaled(config, number, factor), plant, names)])
        sums.append(_window_sums(place, weight * rows))
        if progress is not None:
            progress(k + 1.0, float(len(factors)))
    fed = _window_sums(
        place, (weight > 0.0) * (plant.inputs["mass_flow_rate"] * plant.lasts)[:, None]
    )
    usual = float(np.median(fed[fed > 0.0])) if (fed > 0.0).any() else math.inf
    usable = (fed > LEAST_FED * usual) & np.all([one > 0.0 for one in sums], axis=0)
    kept = usable.any(axis=1)
    if kept.sum() < FEWEST:
        raise InputError(
            f"track has {kept.sum()} windows of {window:g} s with a measured product, fewer than "
            f"{FEWEST}: give more data, or shorter windows"
        )
    logs = np.log(np.where(usable, sums, 1.0))
    x = np.log(factors)
    flat = logs[1:].reshape(len(factors), -1)
    powers = np.polyfit(x, flat, len(factors) - 1).T.reshape(*usable.shape, -1)
    moved = np.where(usable, logs[0], np.nan)
    middles = window * (np.flatnonzero(kept) + 0.5).astype(np.float64)
    return _Windows(middles, moved[kept], powers[kept])


def _window_sums(place: NDArray[np.int_], rows: Array) -> Array:
    return np.column_stack([np.bincount(place, column) for column in rows.T])


def _products(
    config: ScreenConfig, plant: PlantData, names: tuple[str, ...]
) -> Iterator[list[float]]:
    """Rates of products [kg/s], row by row."""
    through = moments(config, plant)
    feed, motion = next(through)
    screen = Screen(config.replace(feed=feed, motion=motion))
    for k, lasts in enumerate(plant.lasts.tolist()):
        if k > 0:
            feed, motion = next(through)
        products = screen.step(lasts, feed, motion).products
        yield [products[name].mass_flow_rate for name in names]


# --- the filter ----------------------------------------------------------------------------------
def _filtered(windows: _Windows, drift: float, noise: float) -> tuple[float, Array, Array]:
    """Forwards: minus the logarithm of the likelihood, means and variances after every window.

    drift, noise: logarithms, see `Track`.
    """
    walk, error = math.exp(2.0 * drift) / HOUR, math.exp(2.0 * noise)
    mean, variance, before, lost = 0.0, BEFORE**2, windows.seconds[0], 0.0
    means, variances = np.empty(windows.seconds.size), np.empty(windows.seconds.size)
    low, high = math.log(FACTORS[0]), math.log(FACTORS[-1])
    rows = zip(
        windows.seconds.tolist(), windows.measured.tolist(), windows.modelled.tolist(), strict=True
    )
    for k, (now, measured, modelled) in enumerate(rows):
        variance += walk * (now - before)
        before = now
        for seen, powers in zip(measured, modelled, strict=True):
            if seen != seen:
                continue
            expected, slope = _value_and_slope(powers, min(max(mean, low), high))
            expected += slope * (mean - min(max(mean, low), high))
            spread = slope * slope * variance + error
            gain, apart = variance * slope / spread, seen - expected
            mean += gain * apart
            variance -= gain * slope * variance
            lost += 0.5 * (apart * apart / spread + math.log(spread))
        means[k], variances[k] = mean, variance
    return lost, means, variances


def _through(windows: _Windows, drift: float, noise: float) -> tuple[float, Array, Array]:
    """Forwards and back: minus the logarithm of the likelihood, means and variances."""
    lost, means, variances = _filtered(windows, drift, noise)
    walked = math.exp(2.0 * drift) * np.diff(windows.seconds) / HOUR
    return lost, *_smoothed(means, variances, walked)


def _value_and_slope(powers: list[float], x: float) -> tuple[float, float]:
    """A polynomial and its derivative, highest power first."""
    value, slope = powers[0], 0.0
    for coefficient in powers[1:]:
        slope = slope * x + value
        value = value * x + coefficient
    return value, slope


def _smoothed(means: Array, variances: Array, walked: Array) -> tuple[Array, Array]:
    """Backwards: each window knows the later ones too."""
    means, variances = means.copy(), variances.copy()
    for k in range(means.size - 2, -1, -1):
        ahead = variances[k] + walked[k]
        share = variances[k] / ahead
        means[k] += share * (means[k + 1] - means[k])
        variances[k] += share * share * (variances[k + 1] - ahead)
    return means, variances
