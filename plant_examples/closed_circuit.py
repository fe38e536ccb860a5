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
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np
import pandas as pd
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from components.conveyor import Conveyor
from components.crusher import ConeCrusher
from components.mixer import Rates, mix
from components.screen_fmu import ScreenFmu, ScreenStep
from vibroscreen.units import KW, KWH_T, MINUTE, MM, PERCENT, T_H, TONNE

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Regime:
    """What the operator sets for a while: fresh feed kg/s, frequency of the screen Hz, time s."""

    name: str
    fresh_feed: float
    frequency: float
    duration: float = 15 * MINUTE


SCHEDULE = (
    Regime("300 t/h, 15.5 Hz", 300 * T_H, 15.5),
    Regime("360 t/h, 15.5 Hz", 360 * T_H, 15.5),
    Regime("360 t/h, 13.0 Hz", 360 * T_H, 13.0),
)
STEP = 1.0  # s, communication step
CLOSED_SIDE_SETTING = 14 * MM
CONVEYOR_DELAY = 40.0  # s: 60 m of belt at 1.5 m/s
FEED_SIZE, FEED_EXPONENT = 40 * MM, 1.1  # Rosin-Rammler, an assumed jaw crusher product
AVERAGED = MINUTE  # the end of a regime that its numbers are means of, about one turn
SETTLED = 0.01  # the product has settled when it stays within this share of its mean at the end

FRESH, PRODUCT, LOAD = "fresh feed, t/h", "product, t/h", "circulating load, %"
CRUSHER, SCREEN, ENERGY = "crusher, kW", "screen, kW", "energy, kWh/t of product"


class Screen(Protocol):
    """What the circuit needs of a screen: limits of its size classes, m; mass on it, kg; a step."""

    edges: Rates
    hold_up: float

    def step(self, feed: Rates, frequency: float, step: float) -> ScreenStep:
        """Screen a feed (kg/s by class) for `step` seconds."""


@dataclass(frozen=True)
class Circuit:
    """What a run gave."""

    history: pd.DataFrame  # a row per step, SI units
    regimes: pd.DataFrame  # a row per regime, plant units
    fed: float  # kg
    balance_error: float  # fed - product - gain of what is held, kg
    alarms: dict[str, float]  # of the screen, how long each was set, s


def rosin_rammler(edges: Rates, size: float, exponent: float) -> Rates:
    """Mass fraction by class of a feed with 63.2 % finer than `size` m, cut off at the top."""
    passing = -np.expm1(-((edges / size) ** exponent))
    return np.diff(passing / passing[-1])


def run(screen: Screen, schedule: tuple[Regime, ...] = SCHEDULE, step: float = STEP) -> Circuit:
    """Start empty and go through the regimes in steps (s) no longer than the conveyor's delay."""
    crusher = ConeCrusher(screen.edges, CLOSED_SIDE_SETTING)
    conveyor = Conveyor(CONVEYOR_DELAY, classes=screen.edges.size - 1)
    if len({regime.name for regime in schedule}) < len(schedule):
        raise ValueError("schedule names two regimes alike: give each its own name")
    fresh_composition = rosin_rammler(screen.edges, FEED_SIZE, FEED_EXPONENT)
    plan = [regime for regime in schedule for _ in range(round(regime.duration / step))]
    rows, alarms, held_at_start = [], Counter[str](), screen.hold_up
    for number, regime in enumerate(track(plan, "closed circuit", transient=True), start=1):
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
    history = pd.DataFrame(rows)
    fed, product = step * history["fresh feed"].sum(), step * history["product"].sum()
    balance_error = fed - product - (history["held"].iloc[-1] - held_at_start)
    alarm_times = {name: count * step for name, count in alarms.items()}
    return Circuit(history, summary(history), fed, balance_error, alarm_times)


def summary(history: pd.DataFrame) -> pd.DataFrame:
    """The end of each regime in plant units, a row per regime."""
    regimes = history.groupby("regime", sort=False)["time"]
    elapsed = history["time"] - regimes.transform("min")
    left = regimes.transform("max") - history["time"]
    means = history[left < AVERAGED].groupby("regime", sort=False).mean()
    final = history["regime"].map(means["product"])
    away = (history["product"] - final).abs() > SETTLED * final
    settled = elapsed[away].groupby(history["regime"]).max().reindex(means.index, fill_value=0.0)
    power = means["crusher power"] + means["screen power"]
    return pd.DataFrame(
        {
            FRESH: means["fresh feed"] / T_H,
            "crusher feed, t/h": means["crusher feed"] / T_H,
            PRODUCT: means["product"] / T_H,
            "oversize, t/h": means["oversize"] / T_H,
            LOAD: means["oversize"] / means["fresh feed"] / PERCENT,
            CRUSHER: means["crusher power"] / KW,
            SCREEN: means["screen power"] / KW,
            ENERGY: power / means["product"] / KWH_T,
            "settled after, min": settled / MINUTE,
        }
    )


def report(circuit: Circuit) -> None:
    """Print the regimes side by side, the balance, and last the answer."""
    regimes = circuit.regimes
    table = Table("mean of the last minute", title="Closed crushing circuit")
    for name in regimes.index:
        table.add_column(str(name), justify="right")
    for quantity in regimes.columns:
        table.add_row(quantity, *(f"{value:.4g}" for value in regimes[quantity]))
    console = Console()
    console.print(table)
    console.print(f"fed {circuit.fed / TONNE:.1f} t, balance error {circuit.balance_error:.1e} kg")
    for alarm, time in circuit.alarms.items():
        console.print(f"{alarm} was set for {time / MINUTE:.1f} min")
    console.print(answer(regimes), soft_wrap=True, highlight=False)


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
