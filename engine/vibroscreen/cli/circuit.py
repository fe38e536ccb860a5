"""`vibroscreen circuit`: the steady state of a flowsheet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from vibroscreen.circuit import CircuitTable, Flowsheet, solve_circuit
from vibroscreen.circuit.results import CLOSED
from vibroscreen.cli.options import Json, Strict, end
from vibroscreen.cli.terminal import finite, say, say_json, table
from vibroscreen.units import KW, KWH_T, PERCENT, T_H

EXAMPLES = """vibroscreen circuit circuit.toml
vibroscreen circuit circuit.toml --json > circuit.json"""


def command(
    circuit: Annotated[
        Path, typer.Argument(metavar="CIRCUIT", help="Feeds, units and products (TOML).")
    ],
    as_json: Json = False,
    strict: Strict = False,
) -> None:
    """Print the steady state of a circuit of crushers and screens."""
    sheet = Flowsheet.load(circuit)
    found = solve_circuit(sheet)
    reason = found.reason.get(0, "")
    if as_json:
        say_json({"name": sheet.name, **_told(found)})
    else:
        say(f"{sheet.name}: {found.status[0]}", "bold")
        if reason:
            say(reason, "yellow")
        if np.isfinite(found.circulating_load[0]):
            _print(found)
    end([reason] if found.status[0] != CLOSED else [], strict=strict)


def _rate(stream: Any) -> float:
    return float(stream[0].sum() / T_H)


def _print(found: CircuitTable) -> None:
    """Streams of every unit, products with their passing, power and energy."""
    sheet = found.flowsheet
    rows = []
    for unit in sheet.units:
        power = f"{found.power[unit.name][0] / KW:.1f}" if unit.name in found.power else ""
        rows.append((unit.name, f"{_rate(found.feed(unit.name)):.1f}", "", power))
        for outlet, target in unit.targets.items():
            rate = _rate(found.stream(unit.name, outlet))
            rows.append((f"  {outlet} to {target}", "", f"{rate:.1f}", ""))
    say()
    table("Units", ("", "fed\nt/h", "leaves\nt/h", "drive\nkW"), rows)
    say()
    products = [found.product(product.name)[0] for product in sheet.products]
    passing = [np.cumsum(rates) / rates.sum() / PERCENT for rates in products]
    lines = [
        (f"{edge * 1000:g}", *(f"{column[k]:.1f}" for column in passing))
        for k, edge in enumerate(sheet.edges[1:])
    ]
    lines.append(("t/h", *(f"{rates.sum() / T_H:.1f}" for rates in products)))
    names = [product.name for product in sheet.products]
    table("Products, % passing", ("mm", *names), lines)
    say()
    say(f"Circulating load {found.circulating_load[0] / PERCENT:.1f} % of the fresh feed")
    if np.isfinite(found.energy[0]):
        say(f"Energy {found.energy[0] / KWH_T:.4g} kWh/t of product in specification")


def _told(found: CircuitTable) -> dict[str, Any]:
    """The result for machines; None for what there is nothing of."""

    def stream(rates: Any) -> list[float | None]:
        return [finite(rate / T_H) for rate in rates[0]]

    sheet = found.flowsheet
    return {
        "status": str(found.status[0]),
        "reason": found.reason.get(0, ""),
        "edges_mm": [edge * 1000 for edge in sheet.size_classes.edges],
        "circulating_load_percent": finite(found.circulating_load[0] / PERCENT),
        "energy_kwh_t": finite(found.energy[0] / KWH_T),
        "feeds_t_h": {name: stream(found.feed(name)) for name in sheet.unit},
        "outlets_t_h": {
            f"{unit.name}.{outlet}": stream(found.stream(unit.name, outlet))
            for unit in sheet.units
            for outlet in unit.targets
        },
        "products_t_h": {p.name: stream(found.product(p.name)) for p in sheet.products},
        "power_kw": {name: finite(power[0] / KW) for name, power in found.power.items()},
    }
