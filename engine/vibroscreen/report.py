"""Pictures for people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vibroscreen.units import MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from vibroscreen.calibrate import Calibration
    from vibroscreen.steady import SteadyResult
    from vibroscreen.sweep import SteadyTable

__all__ = ["draw_calibration", "draw_steady", "draw_table"]


def _figure(width: float, height: float) -> Figure:
    """An empty picture. Raises ImportError without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError(
            "pictures need matplotlib, which is not installed: pip install 'vibroscreen[calibrate]'"
        ) from None
    return Figure(figsize=(width, height), layout="constrained")


def draw_steady(steady: SteadyResult) -> Figure:
    """Partition of every deck and the bed along it in a steady state."""
    figure = _figure(9.0, 3.6)
    curves, bed = figure.subplots(1, 2)
    for deck, profile in zip(steady.decks, steady.profiles, strict=True):
        name = f"deck {deck.deck}, {deck.aperture / MM:g} mm"
        if deck.feed_rate > 0.0:
            curve = deck.partition
            curves.plot(curve.size / MM, curve.to_oversize, ".-", label=name)
        bed.plot(profile.position, profile.depth / MM, label=name)
    curves.set(xlabel="size [mm]", ylabel="part to the oversize of the deck", ylim=(-0.02, 1.02))
    bed.set(xlabel="place along the deck [m]", ylabel="depth of the bed [mm]", ylim=(0.0, None))
    curves.legend(fontsize="small")
    bed.legend(fontsize="small")
    return figure


def draw_table(table: SteadyTable, name: str | None = None) -> Figure:
    """Efficiency of every deck over the designs, or over what was varied under `name`."""
    figure = _figure(5.4, 3.6)
    axes = figure.subplots()
    there = [k for k in range(len(table.recovery)) if k not in table.refused]
    x = there if name is None else table.values[name][there]
    for deck in table.decks:
        values = np.asarray(deck.efficiency)[there]
        axes.plot(x, values, ".", label=f"deck {deck.deck}")
    axes.set(xlabel=name or "design", ylabel="efficiency of the deck", ylim=(-0.02, 1.02))
    axes.legend(fontsize="small")
    return figure


def draw_calibration(calibration: Calibration, path: str | Path) -> None:
    """Measured recoveries against those of the fit, and of the fits that left their run out.

    The suffix of `path` says the format. Raises ImportError without matplotlib.
    """
    found = calibration.fit
    panels = [("modelled", f"fitted, RMSE {found.rmse:.3f}")]
    if found.held_out:
        panels.append(("held_out", f"left out of the fit, RMSE {found.held_out_rmse:.3f}"))
    figure = _figure(4.4 * len(panels), 4.6)
    table = calibration.frame()
    for axes, (column, title) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        _draw_parity(axes)
        for run, part in table.groupby("run", sort=False):
            axes.plot(part["measured"], part[column], "o", ms=4, alpha=0.8, label=str(run))
        axes.set(title=title, xlabel="measured recovery", ylabel="modelled recovery")
    if len(calibration.runs) <= 12:
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=110)


def _draw_parity(axes: Axes) -> None:
    axes.plot([0.0, 1.0], [0.0, 1.0], color="0.7", linewidth=1.0, zorder=0)
    axes.set(xlim=(-0.05, 1.1), ylim=(-0.05, 1.1))
    axes.set_box_aspect(1.0)
