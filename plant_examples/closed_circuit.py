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

import numpy as np
import pandas as pd
import typer
from rich.progress import track

from components.figures import draw_circuit
from components.regimes import SETTLED, Circuit, Regime, by_step, circuit_of, row_of, show
from components.screen_fmu import RunningScreen, ScreenFmu, build_if_missing
from vibroscreen.circuit import Belt, Crusher, Flowsheet
from vibroscreen.units import T_H

HERE = Path(__file__).resolve()
FMU = HERE.parents[1] / "dist" / "VibratingScreen.fmu"
PICTURE = HERE.with_suffix(".png")
CIRCUIT = Flowsheet.load(HERE.with_name("circuits") / "closed.toml")
SCHEDULE = (
    Regime("300 t/h, 15.5 Hz", 300 * T_H, 15.5),
    Regime("360 t/h, 15.5 Hz", 360 * T_H, 15.5),
    Regime("360 t/h, 13.0 Hz", 360 * T_H, 13.0),
)
STEP = 1.0  # s, communication step


def run(
    screen: RunningScreen, schedule: tuple[Regime, ...] = SCHEDULE, step: float = STEP
) -> Circuit:
    """Start empty and go through the regimes in steps (s) no longer than the conveyor's delay."""
    edges, (fresh_feed,) = screen.edges, CIRCUIT.feeds
    crusher, belt = CIRCUIT.unit["crusher"], CIRCUIT.unit["belt"].start(edges)
    assert isinstance(crusher, Crusher)
    assert isinstance(belt, Belt)
    crushing, held_at_start = crusher.start(edges), screen.hold_up
    rows, crusher_feeds, products = [], [], []
    for regime in track(by_step(schedule, step), "closed circuit", transient=True):
        fresh = regime.fresh_feed * np.array(fresh_feed.mass_fraction)
        crusher_feed = fresh + belt.unload(step)
        crushed = crushing.step(crusher_feed, step)["product"]
        screened = screen.step(crushed, regime.frequency, step)
        belt.load(screened.oversize, step)
        held = screen.hold_up + belt.held.sum()
        rows.append(row_of(regime, fresh, crusher_feed, screened, held))
        crusher_feeds.append(crusher_feed)
        products.append(crushed)
    power = crusher.power(edges, np.array(crusher_feeds), np.array(products))
    return circuit_of(rows, power, step, held_at_start)


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
