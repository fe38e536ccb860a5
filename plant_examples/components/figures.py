"""Pictures of what a circuit did."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from vibroscreen.units import KW, MINUTE, PERCENT, T_H

__all__ = ["draw_circuit"]


def draw_circuit(history: pd.DataFrame, path: Path) -> None:
    """Draw streams, circulating load and power over time into a picture file.

    `history` has a row per step in SI units: time, regime, four streams, two powers.
    """
    from matplotlib.figure import Figure  # half a second, for who draws

    minutes = history["time"] / MINUTE
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    panels = figure.subplots(4, sharex=True, height_ratios=(3, 1, 1, 1))
    streams, load, crusher, screen = panels
    for name in ("fresh feed", "crusher feed", "product", "oversize"):
        streams.plot(minutes, history[name] / T_H, label=name)
    load.plot(minutes, history["oversize"] / history["fresh feed"] / PERCENT, color="C3")
    crusher.plot(minutes, history["crusher power"] / KW, color="C1")
    screen.plot(minutes, history["screen power"] / KW, color="C4")
    streams.set(ylabel="t/h", ylim=(0.0, None))
    streams.legend(loc="lower right", ncols=4)
    load.set(ylabel="circulating\nload, %", ylim=(0.0, None))
    crusher.set_ylabel("crusher, kW")
    screen.set(ylabel="screen, kW", xlabel="plant time, min", xlim=(0.0, minutes.iloc[-1]))
    starts = history.groupby("regime", sort=False)["time"].min() / MINUTE
    for label, start in starts.items():
        streams.text(start, 1.02, f" {label}", transform=streams.get_xaxis_transform())
        for axes in panels:
            axes.axvline(start, color="0.8", linewidth=1.0, zorder=0)
    figure.savefig(path, dpi=120)
