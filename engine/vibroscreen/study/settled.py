"""The best design of a study, run through time until it has settled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vibroscreen.circuit import Flowsheet, RunningCircuit
from vibroscreen.units import HOUR, KWH_T, MINUTE

__all__ = ["Settled", "settle"]

LAST = 10 * MINUTE  # what is averaged at the end


@dataclass(frozen=True)
class Settled:
    """A run from empty: time [s], energy over the product of the last minutes [kWh/t], balance.

    balance_error: of all that was fed, over it. history: a row a step, power of every unit [W].
    """

    time: float
    energy: float
    balance_error: float
    history: pd.DataFrame


def settle(circuit: Flowsheet, time: float = HOUR, step: float = 10.0) -> Settled:
    """Run a circuit for a time [s] in steps [s] from empty."""
    running, rows = RunningCircuit(circuit), []
    for _ in range(round(time / step)):
        streams = running.step(step)
        product = float(np.sum([streams[key].sum() for key in circuit.leaving]))
        rows.append({"product": product, **running.power})
    history = pd.DataFrame(rows, index=step * (1 + np.arange(len(rows))))
    end = history.iloc[-round(LAST / step) :]
    power = end.drop(columns="product").sum(axis=1).sum()
    energy = power / end["product"].sum() / KWH_T
    return Settled(time, float(energy), running.balance_error / running.fed, history)
