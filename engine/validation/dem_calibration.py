"""Does one calibration serve other strokes, depths, feeds and slopes, as simulated by particles?

The particle simulations (DEM) in `data/dem_*.csv` are of one plate, square holes of 8 mm between
bars of 3 mm: batches that shake vertically, and continuous decks. The engine runs them with the
passage law `bounce` and with u and w that follow from the vibration. Fitted:

- to the five batches alone, four numbers; segregation and decks are then predicted with them;
- to batches and decks together, five numbers, the bed at the velocities of the simulation. They go
  to the named set "dem plate", so that another case of the plate needs only another feed, motion
  and inclination.

Each case, and each kind of cases, is left out in turn and predicted. Run `python
engine/validation/dem_calibration.py`; it takes a few minutes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evidence import PICTURES, SCREENS, Section
from plate.batch_section import write_batches
from plate.deck_section import write_decks
from plate.errors import rmse
from plate.fit import by_run, common_fit, write_set
from plate.segregation_section import write_segregation
from vibroscreen.calibrate import Calibration
from vibroscreen.number_sets import FOLDER

PLATE = SCREENS / "dem_plate.toml"
NUMBERS = FOLDER / "dem_plate.toml"
COMMAND = "python engine/validation/dem_calibration.py"
SECTIONS = (
    Section("DEM batch", COMMAND, write_batches),
    Section("DEM segregation", COMMAND, write_segregation),
    Section("DEM decks", COMMAND, write_decks),
)


def main(
    output: Annotated[Path, typer.Option(help="Where the set of numbers goes.")] = NUMBERS,
    pictures: Annotated[Path, typer.Option(help="Folder of the pictures.")] = PICTURES,
) -> Calibration:
    """Fit, predict what was not fitted, print the sections, write the set."""
    pictures.mkdir(parents=True, exist_ok=True)
    for section in SECTIONS:
        print(f"## {section.title}\n\n{section.write(pictures)}")
    output.write_text(write_set(common_fit()), encoding="utf-8")
    errors = by_run(common_fit())
    print(
        f"One calibration: RMSE {rmse(errors['fitted'].to_numpy()):.3f} on batches and decks, "
        f"{rmse(errors['left out'].to_numpy()):.3f} on each when left out. {output}"
    )
    return common_fit()


if __name__ == "__main__":
    typer.run(main)
