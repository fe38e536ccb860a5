"""Section "DEM batch" of VALIDATION.md and its picture."""

from __future__ import annotations

from pathlib import Path

from evidence import table
from plate.batches import BATCH_SIZES
from plate.errors import at
from plate.fit import batch_fit, by_run, common_fit, numbers_of
from plate.fit_tables import numbers_table, said
from plate.isolated import isolated
from plate.model import BOUNCING, CROWDING, LAYER, LEVELLING
from vibroscreen.calibrate import Calibration
from vibroscreen.units import MM


def draw_batches(calibration: Calibration, picture: Path) -> None:
    """Recovery over time of the batches, simulated, fitted and left out."""
    from matplotlib.figure import Figure

    frame = calibration.frame().query("time_s == time_s")
    figure = Figure(figsize=(12, 7), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True).flat
    for axes, (name, part) in zip(panels, frame.groupby("run", sort=False), strict=False):
        for number, k in enumerate(part["size_class"].unique()):
            line, size = part.query("size_class == @k"), BATCH_SIZES[(k - 1) // 2]
            colour = f"C{number}"
            axes.plot(line["time_s"], line["measured"], ".", color=colour, label=f"{size:g} mm")
            axes.plot(line["time_s"], line["modelled"], color=colour)
            axes.plot(line["time_s"], line["held_out"], "--", color=colour, linewidth=1)
        axes.set_title(str(name))
        axes.legend(loc="lower right")
    figure.axes[-1].set_axis_off()
    figure.supxlabel("time, s")
    figure.supylabel("recovery to undersize (points: DEM, lines: fitted, dashed: left out)")
    figure.savefig(picture, dpi=110)


def write_batches(pictures: Path) -> str:
    """Section "DEM batch"."""
    calibration, common = batch_fit(), numbers_of(common_fit())
    draw_batches(calibration, pictures / "dem_batch.png")
    errors, together = by_run(calibration), by_run(common_fit())
    alone = isolated(common["passage.velocity"], common["passage.rim"])
    rows = [
        (
            name,
            f"{row['fitted']:.4f}",
            f"{row['left out']:.4f}",
            f"{at(together, str(name), 'fitted'):.4f}",
        )
        for name, row in errors.iterrows()
    ]
    rows.append(("all", f"{calibration.fit.rmse:.4f}", f"{calibration.fit.held_out_rmse:.4f}", ""))
    head = ("case", "RMSE fitted", "left out", "with the decks")
    return f"""\
Data: `data/dem_batch_sieving.csv`: particle simulations of batches on a vertically vibrating plate,
holes of 8 mm; 4, 6 and 7 mm pass, 10 and 12 mm stay. Two seeds differ by an RMSE of 0.03. S1 3 mm
at 15 Hz, 35 mm deep; S2 2 mm; S3 4 mm; S4 half as deep; S6 a finer feed.

**Fitted with {len(calibration.fit.parameters)} numbers, RMSE {calibration.fit.rmse:.4f}** (target
0.04, with at most six). **Each case left out in turn: {calibration.fit.held_out_rmse:.4f}.** Law
`bounce`, model `exchange`, both velocities by the closure in the vibration. Drift plays no part:
nothing conveys. Held by what is not among these data ([DEM decks](#dem-decks)): crowding
{CROWDING:g}, levelling {LEVELLING:g}, bouncing {BOUNCING:g}; the contact layer, 12 mm, one coarsest
grain, and the layers above, {LAYER / MM:g} mm. Gaps go with the grains alone.

{table(head, rows)}
![Recovery over time of the batches](dem_batch.png)

{numbers_table(calibration)}
What the fit says of itself:

{said(calibration)}
All batches vibrate at 15 Hz, so how the numbers go with frequency is that of the closure, not of
these data.

Isolated spheres (`data/dem_isolated_passage.csv`, six sizes): with velocity and rim of the common
fit below, the law meets the part still on the deck to an RMSE of {alone.error:.3f} where bouncing
is {alone.bouncing:.1f}, to {alone.held:.3f} with the {BOUNCING:g} that is held; six free rates meet
it to {alone.free:.3f}.
"""
