"""What a plant did, from a historian's export: rows in their order, every gap filled and marked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vibroscreen.columns import MOST, STAMP, TIMES
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.replay.channels import GRADATION, INPUT, PRODUCT, RATE, Channel, channels_of
from vibroscreen.replay.quality import Finding, Limits, limited, spikes, stuck
from vibroscreen.replay.stamps import NOTHING, Clock
from vibroscreen.replay.table import EMPTY, TEXT, Export, numbers, open_export
from vibroscreen.units import HOUR, MINUTE, PERCENT

__all__ = ["GAPS", "PlantData", "Source", "read_plant"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

GAPS = ("hold", "stop", "interpolate")
# Rows that a run may have, those in gaps included.
MOST_ROWS = 10_000_000
# Rows that lie further apart than so many usual intervals have a gap between them.
GAP_INTERVALS = 3.0


class Source(NamedTuple):
    """Which column of an export says what.

    time: the column of times, None for time, time_s, time_min or time_h; form: a key of
    stamps.NUMBERS or a format of strptime, None for ISO 8601; zone: of times without one; columns:
    names by key, as {"rate_t_h": "WI-101.PV"}; columns whose names are keys need not be told.
    """

    time: str | None = None
    form: str | None = None
    zone: str | None = None
    columns: Mapping[str, str] = {}


@dataclass(frozen=True, eq=False)
class PlantData:
    """Feed, motion and measured products through time, SI; a row holds until the next one.

    seconds, lasts: beginning of every row since the first, and its length [s]; inputs: by field of
    Feed and Motion, `passing` [row, inner limit] among them if there are gradations [1]; products:
    rates as measured [kg/s], nan where there is none; filled: rows in which an input was filled in;
    marks: what was done to each row, in words; interval: the usual one [s]; start: the first time,
    None for numbers.
    """

    seconds: Array
    lasts: Array
    inputs: Mapping[str, Array]
    products: Mapping[str, Array]
    filled: Mask
    marks: NDArray[np.object_]
    findings: tuple[Finding, ...]
    interval: float
    start: pd.Timestamp | None = None

    @property
    def end(self) -> float:
        """End of the last row [s]."""
        return float(self.seconds[-1] + self.lasts[-1])

    def moment(self, second: float) -> str:
        """When that is, as a person writes it; in UTC where the data say so."""
        if self.start is None:
            return f"{second:g} s"
        there = (self.start + timedelta(seconds=second)).floor("s").tz_localize(None)
        return f"{there} UTC" if self.start.tz is not None else str(there)


def read_plant(
    path: str | Path,
    config: ScreenConfig,
    source: Source | None = None,
    gaps: str = "hold",
    limits: Limits | None = None,
) -> PlantData:
    """Data of a plant for a screen, from CSV or parquet.

    gaps: what is fed where there is no number: "hold" the last one, "stop" nothing, "interpolate"
    between neighbours; of what is not fed, stop holds. All that was done to the data is in
    `findings` and `marks`. Raises InputError for a file that cannot be used, OSError, ImportError
    without pyarrow for parquet.
    """
    path = Path(path)
    if gaps not in GAPS:
        raise InputError(f"gap = {gaps!r} is unknown: give one of {', '.join(GAPS)}", "gap")
    try:
        return _Reading(path, config, source or Source(), limits or Limits()).filled(gaps)
    except InputError as error:
        error.add_note(f"in {path}")
        raise


class _Reading:
    """One file on its way to PlantData: rows in order first, then what is wrong, then gaps."""

    def __init__(self, path: Path, config: ScreenConfig, source: Source, limits: Limits) -> None:
        self.limits = limits
        self.findings: list[Finding] = []
        self.marks: dict[str, Mask] = {}
        names = [name.strip().lower() for name in ((source.time,) if source.time else _TIMES)]
        export = open_export(path, *names)
        self.time = next(one for one in export.columns if one.strip().lower() in names)
        key = self.time.strip().lower()
        form = key.removeprefix("time_") if source.form is None and key in TIMES else source.form
        self.clock = Clock(form, source.zone)
        others = [name for name in export.columns if name != self.time]
        self.channels = channels_of(others, source.columns, config)
        self.stamps, rows = self._rows(export)
        self.seconds: Array = (self.stamps - self.stamps[0]) / 1e9
        self.cells = {c.key: [self._judged(c, *one) for one in rows[c.key]] for c in self.channels}

    def _rows(
        self, export: Export
    ) -> tuple[NDArray[np.int64], dict[str, list[tuple[Array, NDArray[np.int8]]]]]:
        """Times [ns] and cells by channel and column, in the order of time, each time once."""
        columns = list(dict.fromkeys(name for one in self.channels for name in one.columns))
        stamps, parts = [], []
        for part in export.parts([self.time, *columns]):
            stamps.append(self.clock.read(part[self.time], comma=export.comma))
            parts.append([numbers(part[name], comma=export.comma) for name in columns])
        every = np.concatenate(stamps) if stamps else np.empty(0, dtype=np.int64)
        kept = self._in_order(every)
        rows = {
            name: (
                np.concatenate([part[k][0] for part in parts])[kept],
                np.concatenate([part[k][1] for part in parts])[kept],
            )
            for k, name in enumerate(columns)
        }
        return every[kept], {one.key: [rows[name] for name in one.columns] for one in self.channels}

    def _in_order(self, every: NDArray[np.int64]) -> Places:
        """Places of the rows that count, in the order of time."""
        told = self.clock.check()
        order, lost = np.flatnonzero(every != NOTHING), np.flatnonzero(every == NOTHING)
        if order.size < 2:
            raise InputError(
                f"{order.size} of {every.size} rows have a time that can be read: give two or "
                "more; times that are not as 2024-05-01 06:00:00 need --time-format "
                "'%d.%m.%Y %H:%M', or s, min, h, unix for numbers",
                "time",
            )
        if lost.size:
            self._tell(self.time, "rows without a time, left out", lost.size, f"row {lost[0] + 1}")
        late = np.flatnonzero(np.diff(every[order]) < 0)
        if late.size:
            first = f"row {order[late[0] + 1] + 1}"
            self._tell(self.time, "rows out of order, sorted", late.size, first)
        order = order[np.argsort(every[order], kind="stable")]
        last = np.append(np.diff(every[order]) != 0, True)
        if not last.all():
            what, first = "rows at the time of another, the last one counts", every[order][~last][0]
            self._tell(self.time, what, int((~last).sum()), self._when(first))
        if last.sum() < 2:
            raise InputError("all rows have the same time: give two times or more", "time")
        if told:
            self._tell(self.time, told, order.size, "")
        kept: Places = order[last]
        return kept

    def _when(self, stamp: float) -> str:
        if not self.clock.dated:
            return f"{stamp / 1e9:g} s"
        return str(pd.Timestamp(int(stamp)).floor("s"))

    def _tell(self, column: str, what: str, count: int, first: str) -> None:
        self.findings.append(Finding(column, what, int(count), first))

    def _note(self, column: str, what: str, where: Mask, mark: str = "") -> None:
        """Tell of rows, and mark them."""
        if where.any():
            self._tell(column, what, int(where.sum()), self._when(self.stamps[where.argmax()]))
            if mark:
                self.marks[f"{column} {mark}"] = where

    # --- what is wrong -------------------------------------------------------------------------
    def _judged(self, channel: Channel, cells: Array, kind: NDArray[np.int8]) -> Array:
        """Numbers in SI; what cannot be used becomes nan. Raises InputError if nothing can."""
        found, name = cells * channel.factor, channel.name
        self._note(name, "empty", kind == EMPTY)
        self._note(name, "no number", kind == TEXT)
        below, out = limited(found, channel.least, channel.most)
        self._note(name, "out of range, left out", out)
        self._note(name, "below 0, taken as 0", below, "limited")
        found[out], found[below] = np.nan, 0.0
        if channel.is_rate:
            far = spikes(found, self.limits.spike)
            self._note(name, "spikes, left out", far, "spike")
            found[far] = np.nan
            longest = self.limits.stuck
            same = stuck(found, self.seconds, longest)
            self._note(name, f"stuck at a number for over {longest / MINUTE:g} min", same, "stuck")
        if not np.isfinite(found).any():
            least, most = (limit / channel.factor for limit in (channel.least, channel.most))
            why = f", {out.sum()} are out of range ({least:g} to {most:g})" if out.any() else ""
            raise InputError(
                f"{name} has no number that can be used in {found.size} rows{why}: name another "
                "column, or leave it out",
                name,
            )
        return found

    def _gradations(self) -> Array:
        """Passing at the inner limits [1]; rows of nan where it is none."""
        rows = np.column_stack(self.cells["passing"])
        whole: Mask = np.asarray(np.isfinite(rows).all(axis=1))
        if whole.any() and np.median(rows[whole].max(axis=1)) > MOST:
            rows *= PERCENT
            self._tell("passing", "gradations, taken as per cent", int(whole.sum()), "")
        with np.errstate(invalid="ignore"):
            rise = np.diff(rows, prepend=0.0, append=1.0, axis=1).min(axis=1)
        falls: Mask = whole & (rise < -_ROUND_OFF)
        self._note("passing", "gradations with gaps, left out", ~whole)
        self._note("passing", "gradations that fall with size, left out", falls)
        rows[~whole | falls] = np.nan
        if not np.isfinite(rows).any():
            raise InputError("no gradation of the feed can be used: leave the columns out")
        return rows

    # --- gaps ----------------------------------------------------------------------------------
    def filled(self, gaps: str) -> PlantData:
        """The data with rows in gaps of time, and with a number in every row."""
        usual = float(np.median(np.diff(self.seconds)))
        whole, place = self._with_gaps(usual)
        marks = {name: _wide(mask, place, whole.size, False) for name, mask in self.marks.items()}
        missing = _wide(np.zeros(place.size, dtype=bool), place, whole.size, True)
        inputs, products, filled = {}, {}, missing.copy()
        for channel in self.channels:
            grade = channel.role == GRADATION
            cells = self._gradations() if grade else np.column_stack(self.cells[channel.key])
            rows = _wide(cells, place, whole.size, np.nan)
            if channel.role == PRODUCT:
                products[channel.key] = rows[:, 0]
                continue
            holes = np.isnan(rows[:, 0])
            filled |= holes
            how = "hold" if gaps == "stop" and channel.key != RATE else gaps
            full = _fill(rows, whole, how)
            inputs[channel.key] = full[:, 0] if channel.role == INPUT else full
            if holes.any():
                first = self._when(self.stamps[0] + whole[holes.argmax()] * 1e9)
                self._tell(channel.name, f"rows filled in: {_HOW[how]}", int(holes.sum()), first)
            if (holes & ~missing).any():
                marks[f"{channel.name} filled"] = holes & ~missing
        if missing.any():
            marks["gap"] = missing
        zone = "UTC" if self.clock.utc else None
        return PlantData(
            seconds=whole,
            lasts=np.diff(whole, append=whole[-1] + usual),
            inputs=inputs,
            products=products,
            filled=filled,
            marks=_words(marks, whole.size),
            findings=tuple(self.findings),
            interval=usual,
            start=pd.Timestamp(int(self.stamps[0]), tz=zone) if self.clock.dated else None,
        )

    def _with_gaps(self, usual: float) -> tuple[Array, Places]:
        """Times of all rows, those in gaps as well, and places of the given ones among them."""
        longest = self.limits.gap if self.limits.gap is not None else GAP_INTERVALS * usual
        apart = np.diff(self.seconds)
        extra = np.where(apart > max(longest, usual), np.ceil(apart / usual - 1e-6) - 1.0, 0.0)
        if self.seconds.size + extra.sum() > MOST_ROWS:
            worst = int(extra.argmax())
            raise InputError(
                f"the gap of {apart[worst] / HOUR:.4g} h after {self._when(self.stamps[worst])} "
                f"makes {extra[worst]:.3g} rows of {usual:g} s, more than {MOST_ROWS:g}: cut the "
                "file there",
                "time",
            )
        count = extra.astype(np.int64)
        place = np.arange(self.seconds.size) + np.concatenate([[0], np.cumsum(count)])
        whole = np.empty(int(place[-1]) + 1)
        whole[place] = self.seconds
        gaps = np.flatnonzero(count)
        for k in gaps:
            inside = slice(place[k] + 1, place[k + 1])
            whole[inside] = self.seconds[k] + usual * np.arange(1, count[k] + 1)
        if gaps.size:
            longest = apart[gaps].max() / MINUTE
            what = f"gaps in time, the longest {longest:.4g} min, {count.sum()} rows put in"
            self._tell(self.time, what, gaps.size, self._when(self.stamps[gaps[0]]))
        return whole, place


_TIMES = (STAMP, *TIMES)
# What decimals may leave a gradation to fall by.
_ROUND_OFF = 1e-9
_HOW = {"hold": "held", "stop": "taken as 0", "interpolate": "interpolated"}


def _wide(values: NDArray[Any], place: Places, size: int, rest: float) -> NDArray[Any]:
    """Values at their places in more rows, the rest elsewhere."""
    wide = np.full((size, *values.shape[1:]), rest, dtype=values.dtype)
    wide[place] = values
    return wide


def _fill(rows: Array, seconds: Array, how: str) -> Array:
    """Rows without holes; before the first number stands the first."""
    holes = np.isnan(rows[:, 0])
    if not holes.any():
        return rows
    there = np.flatnonzero(~holes)
    if how == "interpolate":
        columns = [np.interp(seconds, seconds[there], column[there]) for column in rows.T]
        return np.column_stack(columns)
    if how == "stop":
        return np.where(holes[:, None], 0.0, rows)
    return rows[np.maximum.accumulate(np.where(holes, there[0], np.arange(holes.size)))]


def _words(marks: Mapping[str, Mask], size: int) -> NDArray[np.object_]:
    """What was done to each row, parted by semicolons."""
    said = np.full(size, "", dtype=object)
    for name, mask in marks.items():
        said[mask] = [f"{before}; {name}" if before else name for before in said[mask]]
    return said
