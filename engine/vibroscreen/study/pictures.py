"""Pictures of a study: a map over two axes, or every design beside its energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from vibroscreen.circuit.results import CLOSED
from vibroscreen.report.pictures import COLOURS, styled
from vibroscreen.study.plan import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["best_of", "draw_study", "front_of"]

ENERGY = "energy, kWh/t"
LOAD = "circulating load, %"
# How a design that cannot be run is drawn, by status.
LOOKS = {
    "over capacity": ("#e69f00", "x"),
    "does not close": ("#d55e00", "+"),
    "refused": ("0.55", "."),
}


def best_of(found: pd.DataFrame) -> int | None:
    """The design of least energy per tonne in specification; None if none can be run."""
    usable = found[ENERGY].where((found["status"] == CLOSED) & np.isfinite(found[ENERGY]))
    return None if usable.isna().all() else int(np.nanargmin(usable))


def front_of(found: pd.DataFrame) -> pd.Index:
    """Designs that none beats in both energy and circulating load, by energy."""
    usable = found[(found["status"] == CLOSED) & np.isfinite(found[ENERGY])]
    ordered = usable.sort_values([ENERGY, LOAD])
    least: pd.Series[float] = ordered[LOAD].cummin().shift(fill_value=np.inf)
    front: pd.Index = ordered.index[ordered[LOAD] < least]
    return front


def draw_study(study: Study, found: pd.DataFrame) -> Figure:
    """Energy over the axes; what cannot be run is drawn as such. The best design has a star.

    A map for a grid of two axes. Else a panel an axis, and one of energy over the circulating load
    with the front of designs that none beats in both.
    """
    from matplotlib.figure import Figure

    with styled():
        if study.plan == "grid" and len(study.axes) == 2 and min(_shape(study)) > 1:
            figure = Figure(figsize=(7.4, 5.2), layout="constrained")
            _map(figure, study, found)
            return figure
        keys = [axis.key for axis in study.axes]
        figure = Figure(figsize=(7.4, 2.6 * (1 + (len(keys) + 1) // 2)), layout="constrained")
        panels = figure.subplots(1 + len(keys) // 2, 2, squeeze=False).ravel()
        for axes, key in zip(panels, [*keys, LOAD], strict=False):
            _cloud(axes, found, key)
        front = found.loc[front_of(found)]
        panels[len(keys)].plot(front[LOAD], front[ENERGY], color=COLOURS[0], label="none is better")
        panels[len(keys)].legend()
        for axes in panels[len(keys) + 1 :]:
            axes.set_axis_off()
        figure.suptitle(study.name[:80])
        return figure


def _shape(study: Study) -> tuple[int, ...]:
    return tuple(axis.grid.size for axis in study.axes)


def _map(figure: Figure, study: Study, found: pd.DataFrame) -> None:
    """Energy over two axes."""
    axes = figure.subplots()
    across, up = (axis.key for axis in study.axes)
    energy = found[ENERGY].where(np.isfinite(found[ENERGY])).to_numpy().reshape(_shape(study)).T
    shown = axes.pcolormesh(study.axes[0].grid, study.axes[1].grid, energy, shading="nearest")
    figure.colorbar(shown, ax=axes, label="energy [kWh/t in specification]")
    _infeasible(axes, found, across, up)
    best = best_of(found)
    if best is not None:
        axes.plot(found[across][best], found[up][best], "*", color="white", ms=14, mec="black")
    axes.set(xlabel=across, ylabel=up, title=study.name[:80])


def _cloud(axes: Axes, found: pd.DataFrame, key: str) -> None:
    """Energy of every design over a column."""
    good = found[found["status"] == CLOSED]
    axes.plot(good[key], good[ENERGY], ".", ms=3, color=COLOURS[0], alpha=0.5)
    best = best_of(found)
    if best is not None:
        axes.plot(found[key][best], found[ENERGY][best], "*", color="white", ms=12, mec="black")
    axes.set(xlabel=key, ylabel="energy [kWh/t]")


def _infeasible(axes: Axes, found: pd.DataFrame, across: str, up: str) -> None:
    """Marks of the designs that cannot be run, or make nothing in specification."""
    for status, (colour, marker) in LOOKS.items():
        these = found[found["status"] == status]
        if len(these):
            axes.plot(these[across], these[up], marker, color=colour, ms=5, label=status)
    outside = found[(found["status"] == CLOSED) & ~np.isfinite(found[ENERGY])]
    if len(outside):
        axes.plot(outside[across], outside[up], "s", color="0.8", ms=4, label="out of its band")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=4)
