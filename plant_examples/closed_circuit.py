"""Can a closed crushing circuit take 20 % more feed, and does a slower screen save energy?

Fresh feed is mixed with the return, crushed by a cone crusher and screened; the undersize is the
product, a conveyor brings the oversize back to the crusher:

    fresh feed -> mixer -> crusher -> screen (FMU) -> product
                    ^                      |
                    +------ conveyor <-----+ oversize

The circuit starts empty and settles, then takes a step in the feed, then the screen is slowed
down. The numbers of a regime are means over its last minute.
Run `python plant_examples/closed_circuit.py`; the FMU is built if it is missing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.progress import track

from components.conveyor import Conveyor
from components.crusher import ConeCrusher
from components.figures import draw_circuit
from components.mixer import mix
from components.regimes import SETTLED, Circuit, Regime, by_step, circuit_of, row_of, show
from components.screen_fmu import RunningScreen, ScreenFmu, build_if_missing
from components.stream import Array, rosin_rammler
from vibroscreen.units import MM, T_H

HERE = Path(__file__).resolve()
FMU = HERE.parents[1] / "dist" / "VibratingScreen.fmu"
PICTURE = HERE.with_suffix(".png")
SCHEDULE = (
    Regime("300 t/h, 15.5 Hz", 300 * T_H, 15.5),
    Regime("360 t/h, 15.5 Hz", 360 * T_H, 15.5),
    Regime("360 t/h, 13.0 Hz", 360 * T_H, 13.0),
)
STEP = 1.0  # s, communication step
CLOSED_SIDE_SETTING = 14 * MM
CONVEYOR_DELAY = 40.0  # s: 60 m of belt at 1.5 m/s


def fresh_sizes(edges: Array) -> Array:
    """Mass fraction by class of the fresh feed, an assumed jaw crusher product."""
    return rosin_rammler(edges, size=40 * MM, exponent=1.1)


def run(
    screen: RunningScreen, schedule: tuple[Regime, ...] = SCHEDULE, step: float = STEP
) -> Circuit:
    """Start empty and go through the regimes in steps (s) no longer than the conveyor's delay."""
    crusher = ConeCrusher(screen.edges, CLOSED_SIDE_SETTING)
    conveyor = Conveyor(CONVEYOR_DELAY, classes=screen.edges.size - 1)
    sizes = fresh_sizes(screen.edges)
    rows, held_at_start = [], screen.hold_up
    for regime in track(by_step(schedule, step), "closed circuit", transient=True):
        fresh = regime.fresh_feed * sizes
        crusher_feed = mix(fresh, conveyor.unload(step))
        screened = screen.step(crusher.crush(crusher_feed), regime.frequency, step)
        conveyor.load(screened.oversize, step)
        power, held = crusher.power(crusher_feed), screen.hold_up + conveyor.held.sum()
        rows.append(row_of(regime, fresh, crusher_feed, screened, power, held))
    return circuit_of(rows, step, held_at_start)


def answer(regimes: pd.DataFrame) -> str:
    """The answer to the question at the top, from the three regimes of the schedule."""
    before, more, slow = regimes.to_dict("records")
    fed, product, load = "fresh feed, t/h", "product, t/h", "circulating load, %"
    energy = "energy, kWh/t of product"

    def change(power: str) -> str:
        rise = slow[power] - more[power]
        return f"{abs(rise):.1f} kW {'more' if rise > 0.0 else 'less'}"

    taken = "Yes" if abs(more[product] / more[fed] - 1.0) < SETTLED else "No"
    saved = "saves" if slow[energy] < more[energy] else "saves no"
    return (
        f"{taken}: fed {more[fed]:.0f} t/h it makes {more[product]:.0f} t/h, the circulating load "
        f"goes from {before[load]:.0f} to {more[load]:.0f} %. The slower screen {saved} energy: it "
        f"draws {change('screen, kW')}, the crusher {change('crusher, kW')} at a load of "
        f"{slow[load]:.0f} %, from {more[energy]:.3f} to {slow[energy]:.3f} kWh/t."
    )


def main(
    fmu: Annotated[Path, typer.Option(help="The screen; built if missing.")] = FMU,
    output: Annotated[Path, typer.Option(help="Where the picture goes.")] = PICTURE,
    draw: Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the picture.")] = True,
) -> Circuit:
    """Run the closed circuit with the screen FMU, print the table and draw the picture."""
    with ScreenFmu(build_if_missing(fmu)) as screen:
        circuit = run(screen)
    if draw:
        draw_circuit(circuit.history, output)
    show(circuit)
    print(answer(circuit.regimes))
    return circuit


if __name__ == "__main__":
    typer.run(main)
