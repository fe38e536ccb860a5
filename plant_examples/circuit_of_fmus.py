"""Does a co-simulation tool run the closed circuit as it should? FMUs, an SSP, and what to expect.

The units of closed_circuit.py as FMUs, wired as there:

    fresh feed -> Mixer -> ConeCrusher -> VibratingScreen -> product
                    ^                            |
                    +-------- Conveyor <---------+ oversize

`python plant_examples/circuit_of_fmus.py` writes four FMUs and `closed_circuit.ssp` to
dist/circuit and runs them with fmpy. The steady circulating load does not depend on how a tool
couples them, only on the units: it is computed apart, from the steady state of the screen and the
matrix of the crusher. A tool that couples right finds it to the accuracy of the engine.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from closed_circuit import CLOSED_SIDE_SETTING, CONVEYOR_DELAY, FMU, SCHEDULE, fresh_sizes
from components.coupling import step_along, wires, write_archive
from components.crusher import ConeCrusher
from components.fmus import conveyor_model, crusher_model, mixer_model
from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen.stream import Feed
from vibroscreen.units import MINUTE, PERCENT
from vibroscreen_fmu.native.fmu import write_native_fmu
from vibroscreen_fmu.package import write_model

CONFIG = ScreenConfig.default()
EDGES = np.array(CONFIG.size_classes.edges)
FRESH_SIZES, FRESH_FEED = fresh_sizes(EDGES), SCHEDULE[0].fresh_feed
STEP = 2.0  # s, communication step
DURATION = 40 * MINUTE  # about thirty turns
SSP = "closed_circuit.ssp"
# Element of the circuit -> model; a stream from an element to another.
ELEMENTS = {
    "mixer": "Mixer",
    "crusher": "ConeCrusher",
    "screen": "VibratingScreen",
    "conveyor": "Conveyor",
}
STREAMS = (
    ("mixer", "outlet", "crusher", "feed"),
    ("crusher", "product", "screen", "feed"),
    ("screen", "oversize", "conveyor", "feed"),
    ("conveyor", "discharge", "mixer", "inlet[2]"),
)
WIRES = wires(STREAMS, classes=EDGES.size - 1)
# What a run is judged by, at its end.
OVERSIZE = ("screen", "oversize.mass_flow_rate")
PRODUCT = ("screen", "undersize.mass_flow_rate")


def write_circuit(folder: Path, screen: Path | None = None) -> dict[str, Path]:
    """Write the FMU of each element and the SSP; a copy of the FMU `screen` if it is given."""
    folder.mkdir(parents=True, exist_ok=True)
    copy = folder / "VibratingScreen.fmu"
    fmus = {
        "mixer": write_model(mixer_model(EDGES, FRESH_SIZES, FRESH_FEED), folder),
        "crusher": write_model(crusher_model(EDGES, FRESH_SIZES, CLOSED_SIDE_SETTING), folder),
        "screen": shutil.copyfile(screen, copy) if screen else write_native_fmu(CONFIG, folder),
        "conveyor": write_model(conveyor_model(EDGES, FRESH_SIZES, CONVEYOR_DELAY), folder),
    }
    write_archive(folder / SSP, fmus, WIRES, (OVERSIZE, PRODUCT), DURATION)
    return fmus


def run(fmus: Mapping[str, Path]) -> float:
    """Circulating load at the end, 1: element by element along the streams."""
    return step_along(fmus, WIRES, OVERSIZE, round(DURATION / STEP), STEP) / FRESH_FEED


def expected_load() -> float:
    """Steady oversize over fresh feed, 1, without any coupling: o = oversize of S(C (f + o))."""
    screen, crusher = Screen(CONFIG), ConeCrusher(EDGES, CLOSED_SIDE_SETTING)
    fresh = FRESH_FEED * FRESH_SIZES
    oversize, before = np.zeros_like(fresh), -1.0
    while abs(oversize.sum() - before) > 1e-12 * FRESH_FEED:
        before = oversize.sum()
        rates = crusher.crush(fresh + oversize)
        feed = Feed(float(rates.sum()), tuple((rates / rates.sum()).tolist()))
        oversize = screen.solve_steady(feed).oversize.class_rates
    return float(oversize.sum() / FRESH_FEED)


def main(
    output: Annotated[Path, typer.Option(help="Folder of FMUs and SSP.")] = FMU.parent / "circuit",
    screen: Annotated[Path | None, typer.Option(help="Another FMU of the default screen.")] = None,
) -> tuple[float, float]:
    """Write the circuit, run it with fmpy; return the load it found and the one to expect, 1."""
    fmus = write_circuit(output, screen)
    found, expected = run(fmus), expected_load()
    print(f"{', '.join(fmu.name for fmu in fmus.values())} and {SSP} are in {output}")
    print(
        f"After {DURATION / MINUTE:g} min in steps of {STEP:g} s the circulating load is "
        f"{found / PERCENT:.4f} %, expected {expected / PERCENT:.4f} %: "
        f"{'it couples right' if abs(found - expected) < 1e-3 else 'SOMETHING IS WRONG'}."
    )
    return found, expected


if __name__ == "__main__":
    typer.run(main)
