"""A screen under what a plant did: a table of what it gave, part by part."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
import pandas as pd

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.motion import Motion
from vibroscreen.replay.channels import RATE
from vibroscreen.replay.plant import PlantData
from vibroscreen.screen import Screen
from vibroscreen.series import figures_of_step
from vibroscreen.stream import Feed
from vibroscreen.units import T_H

__all__ = ["Engine", "Stepper", "measured_name", "moments", "replay"]

# Rows of a part.
PART = 4096


class Stepper(Protocol):
    """What goes through time: the engine, or an FMU."""

    def step(self, duration: float, feed: Feed, motion: Motion) -> dict[str, float | str]:
        """Advance by so many seconds; figures in the units of their keys, and alarms."""
        ...


class Engine:
    """The dynamic engine."""

    def __init__(self, config: ScreenConfig) -> None:
        self.screen = Screen(config)

    def step(self, duration: float, feed: Feed, motion: Motion) -> dict[str, float | str]:
        """Advance the screen. Raises InputError for a step that is refused."""
        result = self.screen.step(duration, feed, motion)
        return {**figures_of_step(result), "alarms": " ".join(result.alarms)}


def measured_name(product: str) -> str:
    """The column in which a measured product stands."""
    return f"{product}_measured_t_h"


def replay(
    config: ScreenConfig,
    plant: PlantData,
    stepper: Callable[[ScreenConfig], Stepper] = Engine,
    progress: Callable[[float, float], None] | None = None,
) -> Iterator[pd.DataFrame]:
    """Tables of at most 4096 rows: every row of the data as one step of the screen.

    Columns: time (if there are dates), time_s at the beginning of the row and lasts_s; what the
    screen gave, as means over the row and state at its end, with alarms; products as measured, nan
    where there is none; filled and marks. stepper: makes what goes through time from the screen as
    it is under the first row. progress: called with what is done and of how much [s]. Raises
    InputError with the time of a step that is refused.
    """
    through = moments(config, plant)
    first = next(through)
    runner = stepper(config.replace(feed=first[0], motion=first[1]))
    feed, motion = first
    count = plant.seconds.size
    for begin in range(0, count, PART):
        rows, stop = [], min(count, begin + PART)
        for k in range(begin, stop):
            if k > 0:
                feed, motion = next(through)
            try:
                rows.append(runner.step(float(plant.lasts[k]), feed, motion))
            except (InputError, ConfigError) as error:
                error.add_note(f"at {plant.moment(plant.seconds[k])} of the data")
                raise
        if progress is not None:
            progress(float(plant.seconds[stop - 1] + plant.lasts[stop - 1]), plant.end)
        yield _table(plant, begin, stop, rows)


def moments(config: ScreenConfig, plant: PlantData) -> Iterator[tuple[Feed, Motion]]:
    """Feed and motion of every row; the same object where nothing changed."""
    feed, motion = config.feed, config.motion
    passing = plant.inputs.get("passing")
    fraction = feed.mass_fraction
    moved = [name for name in plant.inputs if name not in (RATE, "passing")]
    for k in range(plant.seconds.size):
        if passing is not None and (k == 0 or (passing[k] != passing[k - 1]).any()):
            shares = np.diff(passing[k], prepend=0.0, append=1.0).clip(0.0)
            fraction = tuple((shares / shares.sum()).tolist())
        rate = float(plant.inputs[RATE][k])
        if rate != feed.mass_flow_rate or fraction is not feed.mass_fraction:
            feed = Feed(rate, fraction)
            fraction = feed.mass_fraction
        changes: dict[str, Any] = {name: float(plant.inputs[name][k]) for name in moved}
        if any(getattr(motion, name) != value for name, value in changes.items()):
            motion = dataclasses.replace(motion, **changes)
        yield feed, motion


def _table(
    plant: PlantData, begin: int, stop: int, rows: list[dict[str, float | str]]
) -> pd.DataFrame:
    part = slice(begin, stop)
    found: dict[str, object] = {"time_s": plant.seconds[part], "lasts_s": plant.lasts[part]}
    if plant.start is not None:
        since = pd.to_timedelta((plant.seconds[part] * 1e6).round(), unit="us")
        found = {"time": plant.start.as_unit("us") + since, **found}
    names = rows[0]
    found.update({name: [row[name] for row in rows] for name in names})
    for product, rates in plant.products.items():
        found[measured_name(product)] = rates[part] / T_H
    found["filled"] = plant.filled[part]
    found["marks"] = plant.marks[part]
    return pd.DataFrame(found)
