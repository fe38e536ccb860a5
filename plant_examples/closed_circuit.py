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

import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.console import Console
from rich.progress import track

from components.conveyor import Conveyor
from components.crusher import ConeCrusher
from components.feed import rosin_rammler
from components.mixer import Rates, mix
from components.regimes import (
    CRUSHER,
    ENERGY,
    FRESH,
    LOAD,
    PRODUCT,
    SCREEN,
    SETTLED,
    Circuit,
    Regime,
    by_step,
    circuit_of,
    show,
)
from components.screen_fmu import RunningScreen, ScreenFmu
from vibroscreen.units import MM, T_H

ROOT = Path(__file__).resolve().parents[1]

SCHEDULE = (
    Regime("300 t/h, 15.5 Hz", 300 * T_H, 15.5),
    Regime("360 t/h, 15.5 Hz", 360 * T_H, 15.5),
    Regime("360 t/h, 13.0 Hz", 360 * T_H, 13.0),
)
STEP = 1.0  # s, communication step
CLOSED_SIDE_SETTING = 14 * MM
CONVEYOR_DELAY = 40.0  # s: 60 m of belt at 1.5 m/s
FEED_SIZE, FEED_EXPONENT = 40 * MM, 1.1  # Rosin-Rammler, an assumed jaw crusher product


def run(
    screen: RunningScreen, schedule: tuple[Regime, ...] = SCHEDULE, step: float = STEP
) -> Circuit:
    """Start empty and go through the regimes in steps (s) no longer than the conveyor's delay."""
    crusher = ConeCrusher(screen.edges, CLOSED_SIDE_SETTING)
    conveyor = Conveyor(CONVEYOR_DELAY, classes=screen.edges.size - 1)
    fresh_composition = rosin_rammler(screen.edges, FEED_SIZE, FEED_EXPONENT)
    rows, alarms, held = [], Counter[str](), screen.hold_up
    plan = track(by_step(schedule, step), "closed circuit", transient=True)
    for number, regime in enumerate(plan, start=1):
        fresh = regime.fresh_feed * fresh_composition
        returned = conveyor.unload(step)
        crusher_feed = mix(fresh, returned)
        screened = screen.step(crusher.crush(crusher_feed), regime.frequency, step)
        conveyor.load(screened.oversize, step)
        alarms.update(screened.alarms)
        rows.append(
            {
                "regime": regime.name,
                "time": number * step,
                "fresh feed": fresh.sum(),
                "crusher feed": crusher_feed.sum(),
                "product": screened.undersize.sum(),
                "oversize": screened.oversize.sum(),
                "crusher power": crusher.power(crusher_feed),
                "screen power": screened.power,
                "held": screen.hold_up + conveyor.held.sum(),
            }
        )
    return circuit_of(rows, alarms, step, held)


def answer(regimes: pd.DataFrame) -> str:
    """The answer to the question at the top, from the three regimes of the schedule."""
    fresh, product, load, crusher, screen, energy = (
        regimes[quantity].to_numpy() for quantity in (FRESH, PRODUCT, LOAD, CRUSHER, SCREEN, ENERGY)
    )

    def change(power: Rates) -> str:
        return f"{abs(power[2] - power[1]):.1f} kW {'more' if power[2] > power[1] else 'less'}"

    taken = "Yes" if abs(product[1] / fresh[1] - 1.0) < SETTLED else "No"
    saved = "saves" if energy[2] < energy[1] else "saves no"
    return (
        f"{taken}: fed {fresh[1]:.0f} t/h it makes {product[1]:.0f} t/h, the circulating load goes "
        f"from {load[0]:.0f} to {load[1]:.0f} %. The slower screen {saved} energy: it draws "
        f"{change(screen)}, the crusher {change(crusher)} at a load of {load[2]:.0f} %, from "
        f"{energy[1]:.3f} to {energy[2]:.3f} kWh/t."
    )


def report(circuit: Circuit) -> None:
    """Print the regimes side by side, the balance, and last the answer."""
    console = Console()
    show(circuit, console)
    console.print(answer(circuit.regimes), soft_wrap=True, highlight=False)


def main(
    fmu: Annotated[Path, typer.Option(help="The screen; built if missing.")] = (
        ROOT / "dist" / "VibratingScreen.fmu"
    ),
    output: Annotated[Path, typer.Option(help="Where the picture goes.")] = (
        ROOT / "plant_examples" / "closed_circuit.png"
    ),
    draw: Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the picture.")] = True,
) -> Circuit:
    """Run the closed circuit with the screen FMU, print the table and draw the picture."""
    if not fmu.exists():
        build = [sys.executable, str(ROOT / "build_fmu.py"), "--output", str(fmu.parent)]
        subprocess.run(build, check=True)
    with ScreenFmu(fmu) as screen:
        circuit = run(screen)
    if draw:
        from components.figures import draw_circuit  # matplotlib takes half a second to import

        draw_circuit(circuit.history, output)
    report(circuit)
    return circuit


if __name__ == "__main__":
    typer.run(main)
