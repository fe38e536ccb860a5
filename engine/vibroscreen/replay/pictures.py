"""A replay as a picture: streams beside measured ones, beds, alarms, and what the data lacked."""

from __future__ import annotations

import textwrap
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from vibroscreen.config import ScreenConfig
from vibroscreen.replay.plant import PlantData
from vibroscreen.replay.run import measured_name
from vibroscreen.replay.track import TRACKED, Track
from vibroscreen.report.pictures import BAND, COLOURS, DASHES, FEED, deck_name, product_name, styled
from vibroscreen.stream import product_names
from vibroscreen.units import DAY, HOUR

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Curves", "draw"]

# Points of a curve: rows are averaged where there are more.
POINTS = 1500


class Curves:
    """Means of a replay over equal times; `add` the parts one by one."""

    def __init__(self, plant: PlantData) -> None:
        self.bins = min(POINTS, plant.seconds.size)
        self.width = plant.end / self.bins
        self._sums: pd.DataFrame | None = None
        self._spent: pd.DataFrame | None = None

    def add(self, part: pd.DataFrame) -> None:
        """Take in a part."""
        values = part.select_dtypes("number").drop(columns=["time_s", "lasts_s"])
        values = values.assign(filled=part["filled"] * 1.0, alarm=(part["alarms"] != "") * 1.0)
        place = (part["time_s"] / self.width).astype(int).clip(upper=self.bins - 1)
        weighted = values.mul(part["lasts_s"], axis=0).groupby(place).sum()
        spent = values.notna().mul(part["lasts_s"], axis=0).groupby(place).sum()
        if self._sums is None or self._spent is None:
            self._sums, self._spent = weighted, spent
        else:
            self._sums = self._sums.add(weighted, fill_value=0.0)
            self._spent = self._spent.add(spent, fill_value=0.0)

    def table(self) -> pd.DataFrame:
        """Means by column, nan where there is nothing; the index is the time [s]."""
        assert self._sums is not None
        assert self._spent is not None
        spent = self._spent.where(self._spent > 0.0)
        means = self._sums / spent
        means.index = pd.Index((means.index + 0.5) * self.width, name="time_s")
        return means


def draw(
    config: ScreenConfig, plant: PlantData, curves: Curves, tracked: Track | None = None
) -> Figure:
    """Products beside measured ones, beds, and the findings; shaded: alarms, and what was filled.

    tracked: a factor that was followed, drawn with its interval.
    """
    table = curves.table()
    unit, factor = ("d", DAY) if plant.end > 3.0 * DAY else ("h", HOUR)
    times = table.index.to_numpy() / factor
    more = 0 if tracked is None else 1
    with styled():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.4, 6.6 + 1.5 * more), layout="constrained")
        heights = (2.4, 1.0, *[1.0] * more, 1.2)
        axes: Any = figure.subplots(len(heights), 1, height_ratios=heights)
        streams, beds, *others, told = axes
        streams.plot(times, table["feed_t_h"], color=FEED, linewidth=0.8, label="feed")
        _draw_products(streams, times, table, len(config.decks))
        for k, (deck, colour) in enumerate(
            zip(config.decks, cycle(COLOURS), strict=False), start=1
        ):
            depth = table[f"deck[{k}].depth_discharge_mm"]
            beds.plot(times, depth, color=colour, linewidth=0.8, label=deck_name(k, deck))
        if tracked is not None:
            _draw_track(others[0], tracked, factor)
        for axis in (streams, beds, *others):
            across = axis.get_xaxis_transform()
            for name, colour in (("filled", BAND), ("alarm", "#f6c9a8")):
                where = (table[name] > 0.0).to_numpy()
                axis.fill_between(
                    times, 0, 1, where, step="mid", transform=across, color=colour, lw=0
                )
            axis.set_xlim(0.0, plant.end / factor)
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        streams.set(title=config.name[:80], ylabel="t/h", ylim=(0.0, None))
        beds.set(ylabel="bed at the\ndischarge [mm]", ylim=(0.0, None))
        since = "" if plant.start is None else f" since {plant.moment(0.0)}"
        axes[-2].set_xlabel(f"time{since} [{unit}]; grey: filled in, orange: alarms")
        told.axis("off")
        told.text(0.0, 1.0, _findings(plant), va="top", fontsize=6.5, transform=told.transAxes)
        return figure


def _draw_products(axes: Any, times: Any, table: pd.DataFrame, decks: int) -> None:
    looks = zip(product_names(decks), cycle(COLOURS), cycle(DASHES), strict=False)
    for product, colour, dashes in looks:
        label = product_name(product)
        axes.plot(times, table[f"{product}_t_h"], color=colour, ls=dashes, lw=0.9, label=label)
        if measured_name(product) in table:
            measured = table[measured_name(product)]
            axes.plot(
                times, measured, ".", color=colour, ms=2.0, alpha=0.5, label=f"{label}, measured"
            )


def _draw_track(axes: Any, tracked: Track, factor: float) -> None:
    times, name = tracked.seconds / factor, TRACKED[tracked.number]
    axes.fill_between(times, tracked.lower, tracked.upper, color=COLOURS[2], alpha=0.25, lw=0)
    label = f"{name},\n{100 * tracked.level:g} % interval"
    axes.plot(times, tracked.factor, color=COLOURS[2], label=label)
    axes.axhline(1.0, color=FEED, linewidth=0.6)
    axes.set(ylabel="over that\nof the file", ylim=(0.0, None))


def _findings(plant: PlantData) -> str:
    """What the data lacked, in lines."""
    share = float(np.mean(plant.filled))
    head = f"Data: {plant.seconds.size} rows of {plant.interval:g} s, {100 * share:.3g} % filled in"
    lines = [
        f"{f.column}: {f.what}: {f.rows}{f.first and f', first {f.first}'}" for f in plant.findings
    ]
    shown = [textwrap.shorten(line, 110) for line in lines[:10]]
    return "\n".join([head, *shown, *(["..."] if len(lines) > 10 else [])])
