"""What a replay comes to: sums, how products compare with measured ones, alarms."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from vibroscreen.replay.run import measured_name
from vibroscreen.units import HOUR

__all__ = ["Compared", "Summary"]


class Compared(NamedTuple):
    """A product over all rows in which it was measured: mean rates, and how far rows lie apart.

    In t/h; hours: how long it was measured.
    """

    product: str
    hours: float
    modelled: float
    measured: float
    rms: float


@dataclass
class Summary:
    """Sums over the parts of a replay; `add` them one by one.

    masses: by stream [t]; alarms: by name, time of the first [s] and how long it was set [s].
    """

    products: tuple[str, ...]
    rows: int = 0
    filled: int = 0
    energy: float = 0.0
    masses: dict[str, float] = field(default_factory=dict)
    alarms: dict[str, tuple[float, float]] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    _compared: dict[str, list[float]] = field(default_factory=dict)

    def add(self, part: pd.DataFrame) -> None:
        """Count a part."""
        hours = part["lasts_s"] / HOUR
        self.rows += len(part)
        self.filled += int(part["filled"].sum())
        self.energy += float((part["drive_power_kw"] * hours).sum())
        for name in map(str, part.columns):
            if name.endswith("_t_h") and "_measured" not in name:
                stream = name.removesuffix("_t_h")
                mass = float((part[name] * hours).sum())
                self.masses[stream] = self.masses.get(stream, 0.0) + mass
        for product in self.products:
            model, measured = part[f"{product}_t_h"], part[measured_name(product)]
            sums = self._compared.setdefault(product, [0.0] * 4)
            spent = hours.where(measured.notna(), 0.0)
            for k, values in enumerate(
                (spent, spent * model, spent * measured, spent * (model - measured) ** 2)
            ):
                sums[k] += float(values.sum())
        self._count_alarms(part)
        self.last = {"hold_up_kg": float(part["hold_up_kg"].iloc[-1])}

    def _count_alarms(self, part: pd.DataFrame) -> None:
        for names, rows in part[part["alarms"] != ""].groupby("alarms"):
            for name in str(names).split():
                first, lasted = self.alarms.get(name, (np.inf, 0.0))
                first = min(first, float(rows["time_s"].iloc[0]))
                self.alarms[name] = (first, lasted + float(rows["lasts_s"].sum()))

    @property
    def compared(self) -> tuple[Compared, ...]:
        """Modelled and measured products."""
        return tuple(
            Compared(product, hours, one / hours, other / hours, float(np.sqrt(squares / hours)))
            for product, (hours, one, other, squares) in self._compared.items()
            if hours > 0.0
        )
