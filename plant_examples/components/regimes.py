"""What the operator of a circuit sets for a while, and what the circuit makes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
from rich.console import Console
from rich.table import Table

from components.screen_fmu import ScreenStep
from components.stream import Rates
from vibroscreen.units import KW, KWH_T, MINUTE, PERCENT, T_H, TONNE

__all__ = ["SETTLED", "Circuit", "Regime", "by_step", "circuit_of", "row_of", "show"]

AVERAGED = MINUTE  # the end of a regime that its numbers are means of, about one turn
SETTLED = 0.01  # the product has settled when it stays within this share of its mean at the end


@dataclass(frozen=True)
class Regime:
    """What the operator sets for a while: fresh feed kg/s, frequency of the screen Hz, time s."""

    name: str
    fresh_feed: float
    frequency: float
    duration: float = 15 * MINUTE


@dataclass(frozen=True)
class Circuit:
    """What a run gave."""

    history: pd.DataFrame  # a row per step, SI units
    regimes: pd.DataFrame  # a row per regime, plant units
    fed: float  # kg
    balance_error: float  # fed - product - gain of what is held, kg
    alarms: dict[str, float]  # of the screen, how long each was set, s


def by_step(schedule: Sequence[Regime], step: float) -> list[Regime]:
    """The regime of each step of `step` seconds; ValueError if two have one name."""
    if len({regime.name for regime in schedule}) < len(schedule):
        raise ValueError("schedule names two regimes alike: give each its own name")
    return [regime for regime in schedule for _ in range(round(regime.duration / step))]


def row_of(
    regime: Regime,
    fresh: Rates,
    crusher_feed: Rates,
    screened: ScreenStep,
    held: float,
) -> dict[str, object]:
    """What happened in a step, in SI units: totals of the streams, power, mass held at its end."""
    return {
        "regime": regime.name,
        "fresh feed": fresh.sum(),
        "crusher feed": crusher_feed.sum(),
        "product": screened.undersize.sum(),
        "oversize": screened.oversize.sum(),
        "screen power": screened.power,
        "held": held,
        "alarms": screened.alarms,
    }


def circuit_of(
    rows: Sequence[Mapping[str, object]], crusher_power: Rates, step: float, held: float
) -> Circuit:
    """What a run gave, from a row for every step of `step` seconds, and the power of the crusher.

    held: at its start, kg.
    """
    history = pd.DataFrame(rows)
    history.insert(1, "time", step * (history.index + 1))
    history["crusher power"] = crusher_power
    fed, product = step * history["fresh feed"].sum(), step * history["product"].sum()
    balance_error = fed - product - (history["held"].iloc[-1] - held)
    counted = history.pop("alarms").explode().value_counts()
    alarms = {str(name): count * step for name, count in counted.items()}
    return Circuit(history, summary(history), fed, balance_error, alarms)


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
            "fresh feed, t/h": means["fresh feed"] / T_H,
            "crusher feed, t/h": means["crusher feed"] / T_H,
            "product, t/h": means["product"] / T_H,
            "oversize, t/h": means["oversize"] / T_H,
            "circulating load, %": means["oversize"] / means["fresh feed"] / PERCENT,
            "crusher, kW": means["crusher power"] / KW,
            "screen, kW": means["screen power"] / KW,
            "energy, kWh/t of product": power / means["product"] / KWH_T,
            "settled after, min": settled / MINUTE,
        }
    )


def show(circuit: Circuit) -> None:
    """Print the regimes side by side, the balance and the alarms."""
    console, regimes = Console(), circuit.regimes
    table = Table("mean of the last minute", title="Closed crushing circuit")
    for name in regimes.index:
        table.add_column(str(name), justify="right")
    for quantity in regimes.columns:
        table.add_row(quantity, *(f"{value:.4g}" for value in regimes[quantity]))
    console.print(table)
    console.print(f"fed {circuit.fed / TONNE:.1f} t, balance error {circuit.balance_error:.1e} kg")
    for alarm, time in circuit.alarms.items():
        console.print(f"{alarm} was set for {time / MINUTE:.1f} min")
