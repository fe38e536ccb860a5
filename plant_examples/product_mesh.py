"""Which mesh on the lower deck makes the most 0/8 mm stone that still meets its standard?

A tutorial for notebooks: every `# %%` begins a cell (Jupyter by jupytext, VS Code, Spyder). The
double-deck screen of `screens/two_deck.toml` sells three products. Below the 8 mm mesh falls 0/8 mm
stone, all of it finer than 8 mm; but the standard allows 1 to 10 % that is coarser, up to 11.2 mm
(EN 12620, all-in, category GA90). A coarser mesh passes more of the 8 mm grains that stay on the
deck today, and some that are too coarse: how far can we go?

The script tries meshes from 8 to 12 mm, takes the coarsest that keeps to the standard, and
`python plant_examples/product_mesh.py --report mesh.html` writes a report to hand on, with the
screen of today beside it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
import typer

from vibroscreen import Screen, ScreenConfig, SteadyTable, Stream, report, solve_steady_many
from vibroscreen.units import MM, PERCENT, T_H

# %% The screen of today, and what its product has to be
HERE = Path(__file__).resolve().parent
TODAY = ScreenConfig.load(HERE / "screens" / "two_deck.toml")
STANDARD = report.Specification(
    "undersize", size=[8.0 * MM, 11.2 * MM], least=[0.90, 0.98], most=[0.99, 1.0]
)
MESH = "deck[2].panel[1].aperture"  # the name of a number, as the FMU has it
MESHES = np.arange(8.0, 12.01, 0.5) * MM


# %% Many screens at once: one number varies, the rest is that of the file
class Trial(NamedTuple):
    """Steady states over the mesh, what the product is then, and the best mesh [m]."""

    table: SteadyTable
    product: pd.DataFrame
    mesh: float


def try_meshes(config: ScreenConfig, meshes: np.ndarray) -> Trial:
    """Solve the screen with every mesh on its lower deck [m]; the best meets the standard."""
    table = solve_steady_many(config, {MESH: meshes})
    products = [Stream.of_class_rates(rates, rates) for rates in table.undersize]
    readings = [STANDARD.readings(config.size_classes.edges, product) for product in products]
    meets = np.array([all(reading.met for reading in row) for row in readings])
    rates = np.array([product.mass_flow_rate for product in products])
    if not meets.any():
        raise SystemExit(f"no mesh from {meshes[0] / MM:g} to {meshes[-1] / MM:g} mm meets it")
    frame = pd.DataFrame(
        {
            "mesh, mm": meshes / MM,
            "0/8, t/h": rates / T_H,
            "finer than 8 mm, %": [row[0].passing / PERCENT for row in readings],
            "meets it": meets,
        }
    )
    return Trial(table, frame, float(meshes[meets][rates[meets].argmax()]))


# %% The answer, and a report that says what it rests on
def main(
    report_file: Annotated[
        Path | None, typer.Option("--report", help="A report of it, .html or .pdf.")
    ] = None,
    draw: Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the picture.")] = True,
) -> Trial:
    """Try the meshes; print the table and the answer, draw the picture, write the report."""
    trial = try_meshes(TODAY, MESHES)
    best = Screen(TODAY.with_values({MESH: trial.mesh})).solve_steady()  # in a notebook: best
    today = Screen(TODAY).solve_steady()
    if draw:  # in a notebook: best.plot(), trial.table.plot(MESH)
        figure = report.picture(report.draw_gradation, best, [STANDARD], width=6.4, height=4.2)
        figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)
    if report_file is not None:
        print("written:", report.write(best, report_file, today, [STANDARD]))
    print(trial.product.round(1).to_string(index=False))
    more = (best.undersize.mass_flow_rate - today.undersize.mass_flow_rate) / T_H
    fine = STANDARD.readings(TODAY.size_classes.edges, best.undersize)[0].passing
    print(
        f"The coarsest mesh that keeps to the standard is {trial.mesh / MM:g} mm: "
        f"{best.undersize.mass_flow_rate / T_H:.0f} t/h of 0/8 mm stone, {more:.0f} t/h more than "
        f"today, {fine / PERCENT:.0f} % of it finer than 8 mm."
    )
    return trial


if __name__ == "__main__":
    typer.run(main)
