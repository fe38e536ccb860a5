"""Does a co-simulation tool run the closed circuit as it should? FMUs, an SSP, and what to expect.

The units of circuits/closed.toml as FMUs:

    fresh feed -> mixer -> crusher -> screen -> product
                    ^                   |
                    +----- belt <-------+ oversize

`python plant_examples/circuit_of_fmus.py` writes four FMUs and `closed_circuit.ssp` to
dist/circuit and runs them with fmpy. The steady circulating load does not depend on how a tool
couples them, only on the units: `solve_circuit` finds it without any coupling. A tool that couples
right finds it to the accuracy of the engine.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from closed_circuit import CIRCUIT, FMU
from components.coupling import step_along
from vibroscreen.circuit import solve_circuit
from vibroscreen.units import MINUTE, PERCENT
from vibroscreen_fmu.circuit.ssp import Circuit, write_ssp

FRESH_FEED = CIRCUIT.feeds[0].mass_flow_rate
STEP = 2.0  # s, communication step
DURATION = 40 * MINUTE  # about thirty turns
SSP = "closed_circuit.ssp"
# What a run is judged by, at its end.
OVERSIZE = ("screen", "oversize.mass_flow_rate")


def write_circuit(folder: Path, screen: Path | None = None) -> Circuit:
    """Write the FMU of each unit and the SSP; a copy of the FMU `screen` if it is given."""
    return write_ssp(CIRCUIT, folder / SSP, DURATION, {"screen": screen} if screen else None)


def run(circuit: Circuit) -> float:
    """Circulating load at the end, 1: element by element along the streams."""
    return step_along(circuit, OVERSIZE, round(DURATION / STEP), STEP) / FRESH_FEED


def expected_load() -> float:
    """Steady oversize over fresh feed, 1, without any coupling."""
    return float(solve_circuit(CIRCUIT, tolerance=1e-9).circulating_load[0])


def main(
    output: Annotated[Path, typer.Option(help="Folder of FMUs and SSP.")] = FMU.parent / "circuit",
    screen: Annotated[
        Path | None, typer.Option(help="Another FMU of the default screen, such as a python one.")
    ] = None,
) -> tuple[float, float]:
    """Write the circuit, run it with fmpy; return the load it found and the one to expect, 1."""
    circuit = write_circuit(output, screen)
    found, expected = run(circuit), expected_load()
    print(f"{', '.join(fmu.name for fmu in circuit.fmus.values())} and {SSP} are in {output}")
    print(
        f"After {DURATION / MINUTE:g} min in steps of {STEP:g} s the circulating load is "
        f"{found / PERCENT:.4f} %, expected {expected / PERCENT:.4f} %: "
        f"{'it couples right' if abs(found - expected) < 1e-3 else 'SOMETHING IS WRONG'}."
    )
    return found, expected


if __name__ == "__main__":
    typer.run(main)
