"""The steady state of a circuit, solved directly: one flowsheet, many designs at once.

Under given shares of the screens (part of each class that each outlet gets) a circuit is linear:
crushers are matrices, the rest are shares. Where loops are cut, the feeds x of the cut units solve
x = A x + b exactly, recirculation and all. The shares depend on the feeds through the engine. So a
turn is: solve the linear circuit, give the screens their feeds, take their new shares; turns go on
until new and old shares give the same streams. They settle in a few turns, as a partition depends
little on the load; Anderson's mixing [1] speeds up those that do not.

[1] D. G. Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965) 547-560.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.circuit.flowsheet import Flowsheet
from vibroscreen.circuit.screening import ScreenUnit
from vibroscreen.circuit.unit import Array, Given, Unit, apply, numbers_of
from vibroscreen.errors import InputError
from vibroscreen.fields import entries, nearest
from vibroscreen.stream import MOST_FED, Feed, checked_fractions
from vibroscreen.sweep import places
from vibroscreen.units import MM

__all__ = ["CLOSED", "DOES_NOT_CLOSE", "REFUSED", "Solution", "columns_of", "solve_streams"]

CLOSED, DOES_NOT_CLOSE, REFUSED = "closed", "does not close", "refused"
# The feed of a unit over the fresh feed beyond which a circuit counts as growing without end.
MOST_LOAD = 100.0
# What is lost of what comes back where nothing else ends it: such grains grow beyond every load.
LOSS = 1e-9
# Earlier turns that Anderson's mixing looks back on.
DEPTH = 3
# Turns after which screens are solved sharply: within its tolerance the engine's answer has small
# steps, as the number of its own steps changes, and a circuit may swing about one.
PATIENCE = 12


@dataclass(frozen=True)
class Columns:
    """What differs between designs, by unit or feed and field, and what does not: [design, ...]."""

    count: int
    values: Mapping[str, Array]  # as they were given, by full name
    rate: Mapping[str, Array]  # of each feed, by class [design, class]
    given: Mapping[str, Given]  # of each unit
    refused: dict[int, str]  # reason, by design


@dataclass(frozen=True)
class Solution:
    """Streams of all designs, and what became of each design."""

    feeds: Mapping[str, Array]  # of each unit [design, class], kg/s
    outlets: Mapping[tuple[str, str], Array]  # unit and outlet [design, class], kg/s
    returned: Array  # what comes back to where loops are cut [design], kg/s
    power: Mapping[str, Array]  # of each screen [design], W
    status: NDArray[np.str_]
    reason: dict[int, str]
    turns: NDArray[np.int64]
    residual: Array


# --- what is asked for ----------------------------------------------------------------------------
def columns_of(flowsheet: Flowsheet, values: Mapping[str, ArrayLike]) -> Columns:
    """Values by name as columns of one length, checked; designs out of range are marked."""
    columns = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    counts = {
        len(c) for name, c in columns.items() if c.ndim == 1 + name.endswith(".mass_fraction")
    }
    if len(counts) > 1:
        said = ", ".join(f"{name}: {len(c)}" for name, c in columns.items() if c.ndim)
        raise InputError(f"values have different lengths ({said}): give one row a design", "values")
    count = counts.pop() if counts else 1
    given: dict[str, dict[str, Array]] = {unit.name: {} for unit in flowsheet.units}
    own: dict[str, dict[str, Array]] = {feed.name: {} for feed in flowsheet.feeds}
    refused: dict[int, str] = {}
    known = _names(flowsheet)
    for full, column in columns.items():
        name, _, field_name = full.partition(".")
        if full not in known:
            raise InputError(
                f"{full} is not a number of this circuit that may differ between designs: the "
                f"nearest is {nearest(full, known)}",
                full,
            )
        wide = field_name == "mass_fraction"
        classes = flowsheet.size_classes.count
        if wide and (column.ndim not in (1, 2) or column.shape[-1] != classes):
            raise InputError(
                f"{full} has the shape {column.shape}: give {classes} fractions a design", full
            )
        shape = (count, classes) if wide else (count,)
        column = np.broadcast_to(column, shape)
        (own if name in own else given)[name][field_name] = column
        columns[full] = column
    for unit in flowsheet.units:
        if not isinstance(unit, ScreenUnit):
            _refuse_units(unit, given[unit.name], refused)
    rate = {
        feed.name: _rates(feed.name, feed, own[feed.name], count, refused)
        for feed in flowsheet.feeds
    }
    return Columns(count, columns, rate, given, refused)


def _names(flowsheet: Flowsheet) -> list[str]:
    """Names of all numbers that may differ between designs."""
    names = [
        f"{feed.name}.{name}"
        for feed in flowsheet.feeds
        for name in ("mass_flow_rate", "mass_fraction")
    ]
    for unit in flowsheet.units:
        if isinstance(unit, ScreenUnit):
            names += [f"{unit.name}.{n}" for n in places(unit.config) if not n.startswith("feed.")]
        else:
            names += [f"{unit.name}.{field_name}" for field_name in numbers_of(type(unit))]
    return names


def _refuse_units(unit: Unit, given: Given, refused: dict[int, str]) -> None:
    """Mark designs in which a number of a unit is out of range, or lies outside of its table."""
    for field_name, column in given.items():
        entry = numbers_of(type(unit))[field_name]
        least, most = entry.limits
        for design in np.flatnonzero(~((column >= least) & (column <= most))).tolist():
            try:
                entry.check(f"{unit.name}.{field_name}", float(column[design]))
            except ValueError as error:
                refused.setdefault(design, str(error))
    off_table = getattr(unit, "off_table", None)
    if off_table and "closed_side_setting" in given:
        for design, setting in enumerate(given["closed_side_setting"].tolist()):
            if (fault := off_table(setting)) is not None:
                refused.setdefault(design, fault)


def _rates(name: str, feed: Feed, own: Given, count: int, refused: dict[int, str]) -> Array:
    """Rates by class of a fresh feed [design, class], kg/s; designs that are no feed are marked."""
    rate = own.get("mass_flow_rate", np.full(count, feed.mass_flow_rate))
    fractions = own.get("mass_fraction", np.tile(feed.mass_fraction, (count, 1)))
    entry = entries(Feed)["mass_flow_rate"]
    whole = np.abs(fractions.sum(axis=1) - 1.0) <= 1e-12
    plain = whole & (fractions >= 0.0).all(axis=1) & (rate >= 0.0) & (rate <= MOST_FED)
    fractions = fractions.copy()
    for design in np.flatnonzero(~plain).tolist():
        try:
            entry.check(f"{name}.mass_flow_rate", float(rate[design]))
            fractions[design] = checked_fractions(fractions[design])
        except ValueError as error:
            refused.setdefault(design, str(error).replace("feed.", f"{name}."))
            fractions[design] = feed.mass_fraction
    return np.asarray(np.where(np.isfinite(rate), rate, 0.0)[:, None] * fractions)


# --- the linear circuit ---------------------------------------------------------------------------
class Network:
    """A flowsheet as linear equations, for designs that are picked from all of them."""

    def __init__(self, flowsheet: Flowsheet, columns: Columns) -> None:
        self.flowsheet, self._columns = flowsheet, columns
        self.screens = {u.name: u for u in flowsheet.units if isinstance(u, ScreenUnit)}
        self._transfer = {
            unit.name: unit.transfers(flowsheet.edges, columns.given[unit.name])
            for unit in flowsheet.units
            if unit.name not in self.screens
        }
        self.fresh = np.sum([rates.sum(axis=1) for rates in columns.rate.values()], axis=0)
        # Rows of the shares [design, row, class]: what each outlet of each screen gets.
        self.rows = {
            (name, outlet): row
            for row, (name, outlet) in enumerate(
                (name, outlet) for name, unit in self.screens.items() for outlet in unit.targets
            )
        }

    def solve(self, shares: Array, picked: NDArray[np.intp]) -> tuple[dict[str, Array], Array]:
        """Feeds of all units [picked design, class] under the shares of those designs, kg/s.

        And what comes back to where loops are cut [picked design], kg/s: what comes there, but for
        the first time. Huge where it grows without end.
        """
        sheet, classes = self.flowsheet, self.flowsheet.size_classes.count
        cut = sheet.cut
        wide = 1 + len(cut) * classes
        inflow = {name: np.zeros((picked.size, classes, wide)) for name in sheet.unit}
        for feed in sheet.feeds:
            if feed.to in inflow:
                inflow[feed.to][:, :, 0] += self._columns.rate[feed.name][picked]
        for name in sheet.order:
            come = inflow[name]
            if name in cut:
                come = np.zeros_like(come)
                first = 1 + cut.index(name) * classes
                come[:, np.arange(classes), first + np.arange(classes)] = 1.0
            for outlet, target in sheet.unit[name].targets.items():
                if target in inflow:
                    inflow[target] += apply(self.transfer(shares, name, outlet, picked), come)
        if not cut:
            return {name: come[:, :, 0] for name, come in inflow.items()}, np.zeros(picked.size)
        equations = np.concatenate([inflow[name] for name in cut], axis=1)
        unknown = self._unknown(equations)
        back = (unknown - equations[:, :, 0]).sum(axis=1)
        feeds = {}
        for name, come in inflow.items():
            if name in cut:
                first = cut.index(name) * classes
                feeds[name] = unknown[:, first : first + classes]
            else:
                feeds[name] = come[:, :, 0] + (come[:, :, 1:] @ unknown[:, :, None])[:, :, 0]
        return feeds, back

    def transfer(self, shares: Array, name: str, outlet: str, picked: NDArray[np.intp]) -> Array:
        """What an outlet gets of the feed of its unit, in the picked designs."""
        if name in self.screens:
            return np.asarray(shares[:, self.rows[name, outlet]])
        transfer = self._transfer[name][outlet]
        return transfer if len(transfer) == 1 else transfer[picked]

    @staticmethod
    def _unknown(equations: Array) -> Array:
        """x of x = A x + b; equations [design, n, 1 + n]: b, then A."""
        back, constant = equations[:, :, 1:], equations[:, :, :1]
        one = np.eye(equations.shape[1])
        try:
            return np.asarray(np.linalg.solve(one - back, constant)[:, :, 0])
        except np.linalg.LinAlgError:  # in one design at least something comes back for ever
            found = np.empty(constant.shape[:2])
            for design in range(len(back)):
                stays = np.linalg.matrix_rank(one - back[design]) < one.shape[0]
                kept = (1.0 - LOSS * stays) * back[design]
                found[design] = np.linalg.solve(one - kept, constant[design])[:, 0]
            return found


# --- turns ----------------------------------------------------------------------------------------
class _Turns:
    """The designs of a flowsheet on their way to steady states."""

    def __init__(self, network: Network, columns: Columns, threads: int | None) -> None:
        self.network, self.columns, self.threads = network, columns, threads
        count, classes = columns.count, network.flowsheet.size_classes.count
        self.reason = dict(columns.refused)
        self.status = np.full(count, CLOSED, dtype="<U16")
        self.status[list(self.reason)] = REFUSED
        for design in np.flatnonzero((network.fresh <= 0.0) & (self.status == CLOSED)).tolist():
            self.end(design, REFUSED, "nothing is fed: give a feed rate above 0")
        self.shares = np.zeros((count, len(network.rows), classes))
        for name, screen in network.screens.items():
            for outlet, share in screen.ideal(columns.given[name]).items():
                self.shares[:, network.rows[name, outlet]] = share
        self.turns, self.residual = np.zeros(count, np.int64), np.zeros(count)
        self.power = {name: np.full(count, np.nan) for name in network.screens}

    def turn(self, live: NDArray[np.intp], number: int) -> tuple[Array, Array]:
        """Give the screens their feeds: new shares of the live designs, and the feeds' weights."""
        now, _ = self.network.solve(self.shares[live], live)
        fresh = self.network.fresh[live]
        self.turns[live] = number
        load = np.max([rates.sum(axis=1) for rates in now.values()], axis=0) / fresh
        for place in np.flatnonzero(~(load <= MOST_LOAD)).tolist():
            self.end(
                live[place], DOES_NOT_CLOSE, self._grows({n: r[place] for n, r in now.items()})
            )
        new, weight = self.shares[live], np.zeros((live.size, *self.shares.shape[1:]))
        for name, screen in self.network.screens.items():
            fed = now[name]
            at = np.flatnonzero((self.status[live] == CLOSED) & (fed.sum(axis=1) > 0.0))
            if not at.size:
                continue
            designs, fed = live[at], fed[at]
            given = {n: column[designs] for n, column in self.columns.given[name].items()}
            table = screen.solve(fed, given, self.threads, sharp=number > PATIENCE)
            self.power[name][designs] = table.drive_power
            for place, text in table.refused.items():
                what = REFUSED if number == 1 else DOES_NOT_CLOSE
                self.end(int(designs[place]), what, f"{name}: {text}")
            for outlet, rates in screen.products(table).items():
                row = self.network.rows[name, outlet]
                known = new[at, row]
                new[at, row] = np.divide(rates, fed, out=known, where=fed > 0.0)
                weight[at, row] = fed / fresh[at, None]
        self.residual[live] = 0.5 * (np.abs(new - self.shares[live]) * weight).sum(axis=(1, 2))
        return new, weight

    def end(self, design: int, status: str, reason: str) -> None:
        self.status[design], self.reason[design] = status, reason

    def _grows(self, feeds: Mapping[str, Array]) -> str:
        """Which class comes back to which unit without end."""
        name = max(feeds, key=lambda unit: np.nan_to_num(feeds[unit], nan=np.inf).max())
        grown = int(np.argmax(np.nan_to_num(feeds[name], nan=np.inf)))
        low, high = np.array(self.network.flowsheet.edges)[grown : grown + 2] / MM
        return (
            f"grains of {low:g} to {high:g} mm come back to {name} without end: they are neither "
            "crushed nor leave. Set the crusher closer, or open the screen"
        )


class _Mixing:
    """Anderson's mixing, each design for itself; all that are left took as many turns."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._past: list[tuple[Array, Array]] = []  # shares and their changes by turn [design, n]

    def __call__(self, live: NDArray[np.intp], old: Array, new: Array, weight: Array) -> Array:
        """Shares to go on with, from those of the last turn, those that came of them, and weights.

        The mean of the last turns that leaves the least change. It stays a share: where a mean
        leaves 0..1, the new shares are taken as they are.
        """
        flat = (live.size, -1)
        x, change, w = old.reshape(flat), (new - old).reshape(flat), weight.reshape(flat)
        kept = [np.zeros((self._count, x.shape[1])) for _ in range(2)]
        kept[0][live], kept[1][live] = x, change
        past = self._past = [*self._past, (kept[0], kept[1])][-1 - DEPTH :]
        if len(past) == 1:
            return new
        before = [(a[live], b[live]) for a, b in past]
        steps = np.stack([b[0] - a[0] for a, b in pairwise(before)], axis=2)
        slopes = np.stack([b[1] - a[1] for a, b in pairwise(before)], axis=2)
        seen = slopes * w[:, :, None]
        normal = np.swapaxes(seen, 1, 2) @ seen
        # So that alike turns, whose changes say the same, do not blow up.
        damped = np.trace(normal, axis1=1, axis2=2)[:, None, None] * 1e-12 + 1e-300
        normal = normal + damped * np.eye(normal.shape[1])
        wanted = np.swapaxes(seen, 1, 2) @ (change * w)[:, :, None]
        mean = x + change - ((steps + slopes) @ np.linalg.solve(normal, wanted))[:, :, 0]
        share = ((mean >= 0.0) & (mean <= 1.0)).all(axis=1, keepdims=True)
        return np.where(share, mean, x + change).reshape(old.shape)


def solve_streams(
    flowsheet: Flowsheet,
    columns: Columns,
    *,
    tolerance: float,
    turns: int,
    threads: int | None = None,
    mixing: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Solution:
    """Streams of all designs; each is closed to `tolerance` of its fresh feed, or told why not."""
    network = Network(flowsheet, columns)
    state = _Turns(network, columns, threads)
    mix = _Mixing(columns.count)
    live = np.flatnonzero(state.status == CLOSED)
    for number in range(1, turns + 1):
        if not live.size:
            break
        new, weight = state.turn(live, number)
        open_ = state.status[live] == CLOSED
        go = np.flatnonzero(open_ & (state.residual[live] > tolerance))
        old = state.shares[live[go]]
        state.shares[live] = new
        live, new, weight = live[go], new[go], weight[go]
        if mixing and live.size and network.rows:
            state.shares[live] = mix(live, old, new, weight)
        if progress is not None:
            progress(columns.count - live.size, columns.count)
    for design in live.tolist():
        state.end(
            design,
            DOES_NOT_CLOSE,
            f"after {turns} turns the streams still change by {state.residual[design]:.2g} of the "
            "fresh feed: the circuit swings",
        )
    return _solution(network, state)


def _solution(network: Network, state: _Turns) -> Solution:
    """Streams that balance to round-off, from the last shares; nan where a design has none."""
    sheet = network.flowsheet
    good = np.flatnonzero(state.status == CLOSED)
    count, classes = len(state.status), sheet.size_classes.count
    solved, back = network.solve(state.shares[good], good)
    returned = np.full(count, np.nan)
    returned[good] = back
    feeds = {name: np.full((count, classes), np.nan) for name in sheet.unit}
    outlets = {}
    for name, unit in sheet.unit.items():
        feeds[name][good] = solved[name]
        for outlet in unit.targets:
            stream = np.full((count, classes), np.nan)
            transfer = network.transfer(state.shares[good], name, outlet, good)
            stream[good] = apply(transfer, solved[name][:, :, None])[:, :, 0]
            outlets[name, outlet] = stream
    return Solution(
        feeds,
        outlets,
        returned,
        state.power,
        state.status,
        state.reason,
        state.turns,
        state.residual,
    )
