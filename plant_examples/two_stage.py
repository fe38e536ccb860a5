"""How far must the gate open to sell 40 t/h of coarse stone, and what do other products lose by it?

Two stages of crushing around a double-deck screen, as circuits/two_stage.toml says. A gate sends a
share of what leaves over the top deck to the stockpile of 32/90 mm; the rest is crushed again:

    rock -> jaw -> screen -> 0/8 and 8/32
                   ^    |
                   |    +-> gate -> 32/90
                   |          |
                   +-- belt <- cone

From 20 to 30 %: 0/8 loses 4 t/h, 8/32 9 t/h, and a tonne takes 1.70 kWh, it took 1.73. From empty
the plant settles in 3 min; fmpy finds the same products within 1e-6 of the feed.

The steady circuit tells the share. A start from empty in steps of 10 s tells how long it takes. The
FMUs run as `two_stage.ssp` with fmpy: every tool for SSP must find these products. There only the
settled state counts, so steps are long.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
import typer
from scipy.optimize import brentq

from components.coupling import at_end_of_ssp
from vibroscreen.circuit import CircuitTable, Flowsheet, RunningCircuit, solve_circuit
from vibroscreen.units import HOUR, KWH_T, MINUTE, PERCENT, T_H
from vibroscreen_fmu.circuit.ssp import write_ssp

HERE = Path(__file__).resolve()
TODAY = Flowsheet.load(HERE.with_name("circuits") / "two_stage.toml")
SHARE, STONE, ORDER = "gate.share", "32/90", 40.0 * T_H
# The SSP: elements and variables that tell the products, in the order of `leaving`.
ASKED = tuple((unit, f"{outlet}.mass_flow_rate") for unit, outlet in TODAY.leaving)
SSP, DURATION, STEP = "two_stage.ssp", 10 * HOUR, 10 * MINUTE
START, SHORT_STEP = 10 * MINUTE, 10.0  # s, from empty
SETTLED = 0.01  # share of its end that a product stays within once it has settled


class Plant(NamedTuple):
    """Steady today and with the order; the start from empty, kg/s by time in s; what fmpy finds."""

    today: CircuitTable
    ordered: CircuitTable
    start: pd.DataFrame
    found: list[float]


def rates(table: CircuitTable) -> dict[str, float]:
    """Products of a steady circuit, kg/s."""
    return {name: float(table.product(name)[0].sum()) for name in TODAY.leaving.values()}


def with_order(order: float) -> Flowsheet:
    """The circuit with the gate opened so far that `order` kg/s of coarse stone leave."""

    def more(share: float) -> float:
        return rates(solve_circuit(TODAY.with_values({SHARE: share})))[STONE] - order

    return TODAY.with_values({SHARE: float(brentq(more, 0.05, 0.95, xtol=1e-7))})


def start_up(circuit: Flowsheet) -> pd.DataFrame:
    """Products of a plant that starts empty, kg/s, a row a step."""
    plant, rows = RunningCircuit(circuit), []
    times = np.arange(SHORT_STEP, START + SHORT_STEP, SHORT_STEP)
    for _ in times:
        streams = plant.step(SHORT_STEP)
        rows.append({product: streams[key].sum() for key, product in circuit.leaving.items()})
    return pd.DataFrame(rows, index=times)


def answer(plant: Plant) -> str:
    """The answer to the question at the top."""
    tables = plant.today, plant.ordered
    before, after = map(rates, tables)
    today, ordered = (float(table.energy[0]) / KWH_T for table in tables)
    was, share = (float(t.product(STONE)[0].sum() / t.feed("gate")[0].sum()) for t in tables)
    unsettled = (plant.start / plant.start.iloc[-1] - 1.0).abs().max(axis=1) > SETTLED
    off = np.abs(np.subtract(plant.found, list(after.values()))).max() / plant.ordered.fresh[0]
    minutes = unsettled.index[unsettled].max() / MINUTE
    lost = {name: (before[name] - after[name]) / T_H for name in after}
    return (
        f"From {was / PERCENT:.0f} to {share / PERCENT:.0f} %: 0/8 loses {lost['0/8']:.0f} t/h, "
        f"8/32 {lost['8/32']:.0f} t/h, and a tonne takes {ordered:.2f} kWh, it took {today:.2f}. "
        f"From empty the plant settles in {minutes:.0f} min; fmpy finds "
        f"the same products {'within 1e-6' if off < 1e-6 else f'BUT FOR {off:.0e}'} of the "
        "feed."
    )


def draw(plant: Plant, path: Path) -> None:
    """Products from empty; dashed as steady."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for place, (name, rate) in enumerate(rates(plant.ordered).items()):
        axes.plot(plant.start.index / MINUTE, plant.start[name] / T_H, f"C{place}", label=name)
        axes.axhline(rate / T_H, color=f"C{place}", ls="--", lw=1.0)
    axes.set(xlabel="plant time from empty, min", ylabel="t/h", ylim=(0.0, None))
    axes.set_title("Two-stage crushing with the gate opened; dashed: steady")
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=110)


def main(
    output: Annotated[Path, typer.Option(help="Folder of FMUs and SSP.")] = HERE.parents[1]
    / "dist"
    / "two_stage",
    picture: Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the picture.")] = True,
) -> Plant:
    """Open the gate for the order; solve, start and couple the circuit; print the answer."""
    circuit = with_order(ORDER)
    write_ssp(circuit, output / SSP, DURATION)
    found = at_end_of_ssp(output / SSP, ASKED, DURATION, STEP)
    plant = Plant(solve_circuit(TODAY), solve_circuit(circuit), start_up(circuit), found)
    if picture:
        draw(plant, HERE.with_suffix(".png"))
    shown = {"today, t/h": rates(plant.today), "with the order, t/h": rates(plant.ordered)}
    print((pd.DataFrame(shown) / T_H).round(1).to_string())
    print(answer(plant))
    return plant


if __name__ == "__main__":
    typer.run(main)
