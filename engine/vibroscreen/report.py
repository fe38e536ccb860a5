"""Pictures for people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from vibroscreen.calibrate import Calibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_calibration"]


def draw_calibration(calibration: Calibration, path: str | Path) -> None:
    """Measured recoveries against those of the fit, and of the fits that left their run out.

    The suffix of `path` says the format. Raises ImportError without matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError(
            "pictures need matplotlib, which is not installed: pip install 'vibroscreen[calibrate]'"
        ) from None
    found = calibration.fit
    panels = [("modelled", f"fitted, RMSE {found.rmse:.3f}")]
    if found.held_out:
        panels.append(("held_out", f"left out of the fit, RMSE {found.held_out_rmse:.3f}"))
    figure = Figure(figsize=(4.4 * len(panels), 4.6), layout="constrained")
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
