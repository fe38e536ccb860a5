"""What a circuit gives: streams, power, energy, loads, and what became of each design."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.circuit.crusher import Crusher, passing_size
from vibroscreen.circuit.flowsheet import Flowsheet
from vibroscreen.circuit.handling import Bin
from vibroscreen.circuit.screening import ScreenUnit
from vibroscreen.circuit.steady import (
    CLOSED,
    DOES_NOT_CLOSE,
    REFUSED,
    Columns,
    Solution,
    columns_of,
    solve_streams,
)
from vibroscreen.circuit.unit import Array
from vibroscreen.sweep import SteadyTable
from vibroscreen.units import KW, KWH_T, MM, PERCENT, T_H

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "CLOSED",
    "DOES_NOT_CLOSE",
    "OVER_CAPACITY",
    "REFUSED",
    "CircuitTable",
    "solve_circuit",
    "solve_circuit_many",
]

OVER_CAPACITY = "over capacity"


@dataclass(frozen=True, eq=False)
class CircuitTable:
    """Steady states of a circuit, a row a design.

    status: "closed", "does not close", "over capacity" or "refused", with the cause in `reason`.
    residual: what the streams still changed by in the last turn, over the fresh feed [1]. Streams
    are nan where the circuit does not close or was refused.
    """

    flowsheet: Flowsheet
    values: Mapping[str, Array]
    status: NDArray[np.str_]
    reason: Mapping[int, str]
    turns: NDArray[np.int64]
    residual: Array
    fresh: Array  # rate of all fresh feeds [design], kg/s
    _columns: Columns
    _solution: Solution

    def feed(self, unit: str) -> Array:
        """Rates by class that come to a unit [design, class], kg/s."""
        return self._solution.feeds[unit]

    def stream(self, unit: str, outlet: str) -> Array:
        """Rates by class that leave a unit by an outlet [design, class], kg/s."""
        return self._solution.outlets[unit, outlet]

    def product(self, name: str) -> Array:
        """Rates by class of a product of the circuit [design, class], kg/s."""
        sheet = self.flowsheet
        parts = [self.stream(*outlet) for outlet, to in sheet.leaving.items() if to == name]
        parts += [self._columns.rate[feed.name] for feed in sheet.feeds if feed.to == name]
        return np.asarray(np.sum(parts, axis=0))

    @cached_property
    def closed(self) -> NDArray[np.bool_]:
        """Designs that can be run: closed, and no unit over its capacity [design]."""
        return np.asarray(self.status == CLOSED)

    @cached_property
    def power(self) -> dict[str, Array]:
        """Electric power of every unit that has a drive [design], W."""
        found = dict(self._solution.power)
        for unit in self.flowsheet.units:
            if unit.has_drive:
                feed, product = self.feed(unit.name), self.stream(unit.name, "product")
                given = self._columns.given[unit.name]
                found[unit.name] = unit.power(self.flowsheet.edges, feed, product, given)
        return found

    @cached_property
    def in_specification(self) -> Array:
        """Rate of the products that stay in their bands [design], kg/s."""
        rate = np.zeros(len(self.status))
        for product in self.flowsheet.products:
            streams = self.product(product.name)
            rate += np.where(product.meets(self.flowsheet.edges, streams), streams.sum(axis=1), 0.0)
        return rate

    @cached_property
    def energy(self) -> Array:
        """Energy over the mass of product that stays in its bands [design], J/kg.

        nan for a design that cannot be run, infinite where no product stays in its band.
        """
        total = (
            np.sum(list(self.power.values()), axis=0) if self.power else np.zeros_like(self.fresh)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.closed, total / self.in_specification, np.nan)

    @cached_property
    def circulating_load(self) -> Array:
        """What comes back to where the loops are cut, over the fresh feed [design], 1."""
        return self._solution.returned / self.fresh

    def screen(self, name: str) -> SteadyTable:
        """Everything of a screen: the steady states under the feeds of the designs that closed.

        Its rows are those of `np.flatnonzero(np.isfinite(table.circulating_load))`, in turn.
        """
        unit = self.flowsheet.unit[name]
        assert isinstance(unit, ScreenUnit)
        feed = self.feed(name)
        good = np.isfinite(feed).all(axis=1)
        given = {n: column[good] for n, column in self._columns.given[name].items()}
        return unit.solve(feed[good], given)

    def frame(self) -> pd.DataFrame:
        """Table by design in plant units: what was varied, status, loads, products, energy."""
        import pandas as pd

        columns: dict[str, object] = {n: v for n, v in self.values.items() if v.ndim == 1}
        columns["status"] = self.status
        columns["circulating load, %"] = self.circulating_load / PERCENT
        for unit in self.flowsheet.units:
            columns[f"{unit.name} feed, t/h"] = self.feed(unit.name).sum(axis=1) / T_H
        for product in self.flowsheet.products:
            streams = self.product(product.name)
            columns[f"{product.name}, t/h"] = streams.sum(axis=1) / T_H
            columns[f"{product.name} P80, mm"] = passing_size(self.flowsheet.edges, streams) / MM
        for name, power in self.power.items():
            columns[f"{name}, kW"] = power / KW
        columns["energy, kWh/t"] = self.energy / KWH_T
        columns["reason"] = [self.reason.get(design, "") for design in range(len(self.status))]
        return pd.DataFrame(columns, index=pd.RangeIndex(len(self.status), name="design"))

    def _repr_html_(self) -> str:
        return self.frame().to_html(max_rows=20, float_format="{:.5g}".format)


def solve_circuit_many(
    flowsheet: Flowsheet,
    values: Mapping[str, ArrayLike],
    *,
    tolerance: float = 1e-6,
    turns: int = 60,
    threads: int | None = None,
    mixing: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> CircuitTable:
    """Steady states of many designs of a circuit, all advanced together.

    values: by name, one number a design, such as {"crusher.closed_side_setting": settings,
    "screen.deck[1].panel[1].aperture": apertures, "fresh.mass_flow_rate": rates} in SI units;
    "fresh.mass_fraction" takes a row of fractions a design. tolerance: how much the streams of a
    closed circuit may still change, over its fresh feed. mixing: whether to speed up the turns.
    Raises InputError for what is no number of the circuit; designs that cannot be run are marked.
    """
    columns = columns_of(flowsheet, values)
    solution = solve_streams(
        flowsheet,
        columns,
        tolerance=tolerance,
        turns=turns,
        threads=threads,
        mixing=mixing,
        progress=progress,
    )
    status, reason = solution.status.copy(), dict(solution.reason)
    for unit in flowsheet.units:
        _limit(unit, columns, solution, status, reason)
    fresh = np.sum([rates.sum(axis=1) for rates in columns.rate.values()], axis=0)
    return CircuitTable(
        flowsheet,
        columns.values,
        status,
        reason,
        solution.turns,
        solution.residual,
        fresh,
        columns,
        solution,
    )


def solve_circuit(
    flowsheet: Flowsheet, *, tolerance: float = 1e-6, turns: int = 60
) -> CircuitTable:
    """The steady state of a circuit as it is written: a table of one row."""
    return solve_circuit_many(flowsheet, {}, tolerance=tolerance, turns=turns)


def _limit(
    unit: object,
    columns: Columns,
    solution: Solution,
    status: NDArray[np.str_],
    reason: dict[int, str],
) -> None:
    """Mark the designs in which a unit gets more than it takes."""
    if isinstance(unit, Crusher):
        most = unit.most(columns.given[unit.name].get("closed_side_setting"))
        what = OVER_CAPACITY
        cure = "open its setting, add machines, or feed less"
    elif isinstance(unit, Bin):
        most, what = unit.most(columns.given[unit.name]), DOES_NOT_CLOSE
        cure = "it fills without end: discharge more, or feed less"
    else:
        return
    fed = solution.feeds[unit.name].sum(axis=1)
    for design in np.flatnonzero((status == CLOSED) & (fed > most)).tolist():
        status[design] = what
        limit = float(np.broadcast_to(most, fed.shape)[design])
        reason[design] = (
            f"{unit.name} is fed {fed[design] / T_H:.4g} t/h and takes {limit / T_H:.4g} t/h at "
            f"the most: {cure}"
        )
