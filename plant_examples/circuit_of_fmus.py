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
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from closed_circuit import (
    CLOSED_SIDE_SETTING,
    CONVEYOR_DELAY,
    FEED_EXPONENT,
    FEED_SIZE,
    ROOT,
    SCHEDULE,
)
from components.coupling import Wire, step_along, write_archive
from components.crusher import ConeCrusher
from components.feed import rosin_rammler
from components.fmus import conveyor_model, crusher_model, mixer_model
from components.mixer import Rates
from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen.stream import Feed
from vibroscreen.units import MINUTE, PERCENT
from vibroscreen_fmu.native.fmu import write_native_fmu
from vibroscreen_fmu.package import write_model

FRESH_FEED = SCHEDULE[0].fresh_feed
STEP = 2.0  # s, communication step
DURATION = 40 * MINUTE  # about thirty turns
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
# What a run is judged by, at its end.
OVERSIZE = ("screen", "oversize.mass_flow_rate")
PRODUCT = ("screen", "undersize.mass_flow_rate")


def write_circuit(folder: Path, screen: Path | None = None) -> dict[str, Path]:
    """Write the FMUs of the circuit's elements into a folder; `screen` is taken if it is given."""
    config = ScreenConfig.default()
    edges = np.array(config.size_classes.edges)
    fresh = rosin_rammler(edges, FEED_SIZE, FEED_EXPONENT)
    folder.mkdir(parents=True, exist_ok=True)
    if screen is None:
        made = write_native_fmu(config, folder)
    else:
        made = Path(shutil.copyfile(screen, folder / "VibratingScreen.fmu"))
    return {
        "mixer": write_model(mixer_model(edges, fresh, FRESH_FEED), folder),
        "crusher": write_model(crusher_model(edges, fresh, CLOSED_SIDE_SETTING), folder),
        "screen": made,
        "conveyor": write_model(conveyor_model(edges, fresh, CONVEYOR_DELAY), folder),
    }


def connections(classes: int) -> Iterator[Wire]:
    """Every connected variable of the streams."""
    variables = ("mass_flow_rate", *(f"mass_fraction[{i}]" for i in range(1, classes + 1)))
    for source, output, target, given in STREAMS:
        for variable in variables:
            yield source, f"{output}.{variable}", target, f"{given}.{variable}"


def write_ssp(path: Path, fmus: Mapping[str, Path]) -> Path:
    """Write the circuit as an SSP archive."""
    wires = tuple(connections(ScreenConfig.default().size_classes.count))
    return write_archive(path, fmus, wires, (OVERSIZE, PRODUCT), DURATION)


def run(fmus: Mapping[str, Path], step: float = STEP, duration: float = DURATION) -> float:
    """Circulating load at the end, 1: element by element along the streams."""
    wires = tuple(connections(ScreenConfig.default().size_classes.count))
    return step_along(fmus, wires, OVERSIZE, round(duration / step), step) / FRESH_FEED


def expected_load() -> float:
    """Steady oversize over fresh feed, 1, without any coupling: o = oversize of S(C (f + o))."""
    config = ScreenConfig.default()
    screen = Screen(config)
    edges = np.array(config.size_classes.edges)
    crusher = ConeCrusher(edges, CLOSED_SIDE_SETTING)
    fresh = FRESH_FEED * rosin_rammler(edges, FEED_SIZE, FEED_EXPONENT)
    oversize: Rates = np.zeros_like(fresh)
    before = -1.0
    while abs(oversize.sum() - before) > 1e-12 * FRESH_FEED:
        before = oversize.sum()
        rates = crusher.crush(fresh + oversize)
        feed = Feed(float(rates.sum()), tuple((rates / rates.sum()).tolist()))
        oversize = screen.solve_steady(feed).oversize.class_rates
    return float(oversize.sum() / FRESH_FEED)


def main(
    output: Annotated[Path, typer.Option(help="Where the FMUs and the SSP go.")] = (
        ROOT / "dist" / "circuit"
    ),
    screen: Annotated[
        Path | None, typer.Option(help="Another FMU of the default screen, such as a python one.")
    ] = None,
) -> tuple[float, float]:
    """Write the circuit, run it with fmpy; return the load it found and the one to expect, 1."""
    fmus = write_circuit(output, screen)
    ssp = write_ssp(output / "closed_circuit.ssp", fmus)
    found, expected = run(fmus), expected_load()
    print(f"{', '.join(fmu.name for fmu in fmus.values())} and {ssp.name} are in {output}")
    print(
        f"After {DURATION / MINUTE:g} min in steps of {STEP:g} s the circulating load is "
        f"{found / PERCENT:.4f} %, expected {expected / PERCENT:.4f} %: "
        f"{'it couples right' if abs(found - expected) < 1e-3 else 'SOMETHING IS WRONG'}."
    )
    return found, expected


if __name__ == "__main__":
    typer.run(main)
