"""Section "DEM batch" of VALIDATION.md and its picture."""

from __future__ import annotations

from pathlib import Path

from evidence import table
from plate.batches import BATCH_SIZES
from plate.fit import FREED, batch_fit, by_run, freed_fit
from plate.fit_tables import numbers_table, said
from plate.isolated import isolated
from plate.model import (
    CALMING,
    DAMPING,
    DEPLETION,
    DILATION,
    LAYER,
    LEVELLING,
    LIFT,
    MIXING,
    PASSING_TIME,
)
from vibroscreen.calibrate import Calibration
from vibroscreen.units import MM


def draw_batches(calibration: Calibration, picture: Path) -> None:
    """Recovery over time of the batches, simulated, fitted and left out."""
    from matplotlib.figure import Figure

    frame = calibration.frame().query("time_s == time_s")
    figure = Figure(figsize=(10, 7), layout="constrained")
    for axes, (name, part) in zip(
        figure.subplots(2, 2, sharex=True, sharey=True).flat,
        frame.groupby("run", sort=False),
        strict=True,
    ):
        for number, k in enumerate(part["size_class"].unique()):
            line, size = part.query("size_class == @k"), BATCH_SIZES[(k - 1) // 2]
            colour = f"C{number}"
            axes.plot(line["time_s"], line["measured"], ".", color=colour, label=f"{size:g} mm")
            axes.plot(line["time_s"], line["modelled"], color=colour)
            axes.plot(line["time_s"], line["held_out"], "--", color=colour, linewidth=1)
        axes.set_title(str(name))
        axes.legend(loc="lower right")
    figure.supxlabel("time, s")
    figure.supylabel("recovery to undersize (points: DEM, lines: fitted, dashed: left out)")
    figure.savefig(picture, dpi=110)


def write_batches(pictures: Path) -> str:
    """Section "DEM batch"."""
    calibration = batch_fit()
    draw_batches(calibration, pictures / "dem_batch.png")
    errors = by_run(calibration)
    rim, of_law, of_free = isolated()
    freed, freed_rmse = freed_fit(calibration, FREED)
    rows = [
        (name, f"{row['fitted']:.4f}", f"{row['left out']:.4f}") for name, row in errors.iterrows()
    ]
    rows.append(("all", f"{calibration.fit.rmse:.4f}", f"{calibration.fit.held_out_rmse:.4f}"))
    return f"""\
Data: `data/dem_batch_sieving.csv`: particle simulations of batches on a vertically vibrating plate,
holes of 8 mm; 4, 6 and 7 mm pass, 10 and 12 mm stay. Two seeds differ by an RMSE of 0.03. S1 3 mm
at 15 Hz, 35 mm deep; S3 4 mm; S4 half as deep; S6 a finer feed.

**Fitted with {len(calibration.fit.parameters)} numbers, RMSE {calibration.fit.rmse:.4f}** (target
0.04, with at most six). **Each case left out in turn: {calibration.fit.held_out_rmse:.4f}.** Law
`bounce`, model `exchange`, both velocities by the closure in the vibration. Drift plays no part:
nothing conveys. Not fitted, though these data have been looked at for it: the contact layer, 12 mm,
one coarsest grain, and the layers above, {LAYER / MM:g} mm; passing_time {PASSING_TIME:g}; lift
{LIFT:g} and calming {CALMING:g}, by the heights of the grains on the decks below; damping
{DAMPING:g}, levelling {LEVELLING:g} and depletion {DEPLETION:g}; of the dilation what does not go
with the grains, {DILATION / MM:g} mm; and mixing, {MIXING:g} m/s. Fitted too, passing_time and
damping (up to 30) are {freed["passage.passing_time"]:.2f} and {freed["passage.damping"]:.2g} at an
RMSE of {freed_rmse:.4f}, but only S6 has another composition and only S4 another depth: each left
out, they are lost.

{table(("case", "RMSE fitted", "RMSE left out"), rows)}
![Recovery over time of the batches](dem_batch.png)

{numbers_table(calibration)}
What the fit says of itself:

{said(calibration)}
All batches vibrate at 15 Hz, so how the numbers go with frequency is that of the closure, not of
these data.

Isolated spheres (`data/dem_isolated_passage.csv`, six sizes): the law's shape in size with a rim of
{rim:.2f} meets the part still on the deck to an RMSE of {of_law:.3f}; six free rates to
{of_free:.3f}. In a bed the rim is larger, as neighbours push.
"""
