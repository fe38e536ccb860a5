"""What a plant did through time: feed and motion from a table, and a screen that goes through it.

A row holds from its time on until the next one. Columns (columns.py), in any order, separated by
semicolons, tabs or commas (decimals may stand behind a comma where commas do not separate); from #
on is comment. What is not given is that of the screen; an empty cell is as in the row before.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from vibroscreen.columns import MOST, STAMP, TIMES, input_column, passing_columns
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.motion import Motion
from vibroscreen.results import StepResult
from vibroscreen.screen import Screen
from vibroscreen.stream import Feed, fractions_of_passing, product_names
from vibroscreen.units import KW, MM, PERCENT, T_H

__all__ = ["Moment", "Series", "figures_of_step", "read_series", "run_series"]

MOST_STEPS = 1e7


class Moment(NamedTuple):
    """Feed and motion from a time on [s since the first row]."""

    time: float
    feed: Feed
    motion: Motion


@dataclass(frozen=True)
class Series:
    """Moments in their order, and when the first was, if dates are given."""

    moments: tuple[Moment, ...]
    start: datetime | None = None

    @property
    def interval(self) -> float:
        """The usual time between two moments [s]."""
        return median(later.time - one.time for one, later in pairwise(self.moments))

    def moment_of(self, seconds: float) -> str:
        """Date and time so many seconds after the first row; empty without dates."""
        if self.start is None:
            return ""
        return str((self.start + timedelta(seconds=seconds)).replace(microsecond=0))


# --- the table -----------------------------------------------------------------------------------
Row = Mapping[str, str]


def read_series(path: str | Path, config: ScreenConfig) -> Series:
    """Feed and motion through time from a CSV file; what it does not say is of the configuration.

    Raises InputError with the line and column of what cannot be used, OSError.
    """
    path = Path(path)
    try:
        return _series(path.read_text(encoding="utf-8-sig"), config)
    except UnicodeDecodeError:
        raise InputError(f"{path} is not text in UTF-8: save it in this encoding") from None
    except InputError as error:
        error.add_note(f"in {path}")
        raise


def _series(text: str, config: ScreenConfig) -> Series:
    lines = [
        (number, line.split("#")[0])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.split("#")[0].strip(";,\t ")
    ]
    if len(lines) < 3:
        raise InputError(
            "series: it has fewer than two rows: give a head, such as time_s;rate_t_h, and a row "
            "for each time"
        )
    separator = next((one for one in ";\t" if one in lines[0][1]), ",")
    cells = [
        [cell.strip() for cell in row]
        for row in csv.reader((line for _, line in lines), delimiter=separator)
    ]
    head = [name.lower() for name in cells[0]]
    columns = _Columns(head, config, decimal_comma=separator != ",")
    start: datetime | None = None
    moments: list[Moment] = []
    feed, motion = config.feed, config.motion
    for (number, _), row in zip(lines[1:], cells[1:], strict=True):
        try:
            if len(row) != len(head):
                raise InputError(f"it has {len(row)} cells, the head {len(head)}: give as many")
            given = dict(zip(head, row, strict=True))
            seconds, stamp = columns.time(given)
            start = start or stamp
            if stamp is not None and start is not None:
                seconds = (stamp - start).total_seconds()
            feed, motion = columns.feed(given, feed), columns.motion(given, motion)
            if moments and seconds <= moments[-1].time:
                raise InputError("its time is not later than that of the row before: sort the rows")
        except (InputError, ConfigError, TypeError) as error:
            raise InputError(f"line {number}: {error}") from None
        moments.append(Moment(seconds, feed, motion))
    first = moments[0].time
    return Series(tuple(m._replace(time=m.time - first) for m in moments), start)


class _Columns:
    """Which column says what."""

    def __init__(self, head: Sequence[str], config: ScreenConfig, *, decimal_comma: bool) -> None:
        self.decimal_comma = decimal_comma
        times = [name for name in head if name in TIMES or name == STAMP]
        if len(times) != 1:
            given = " and ".join(times) if times else "none"
            raise InputError(
                f"series: it needs one column of times, and has {given}: give one of "
                f"{', '.join(TIMES)} or {STAMP} (date and time)"
            )
        if twice := {name for name in head if head.count(name) > 1}:
            raise InputError(f"series: the column {min(twice)!r} is there twice: leave one")
        self._time = times[0]
        self._passing = [*passing_columns(head, config.size_classes.edges).values()]
        others = (name for name in head if name != self._time and name not in self._passing)
        self._inputs = [input_column(name) for name in others]

    def _number(self, name: str, text: str) -> float:
        if self.decimal_comma:
            text = text.replace(",", ".")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"{name} = {text!r} is no finite number: give one, or nothing")
        return value

    def time(self, row: Row) -> tuple[float, datetime | None]:
        """Time [s], or the date."""
        text = row[self._time]
        if self._time != STAMP:
            return self._number(self._time, text) * TIMES[self._time], None
        try:
            return 0.0, datetime.fromisoformat(text)
        except ValueError:
            raise InputError(
                f"time = {text!r} is no date and time: write it as 2024-05-01 06:00:00, or give "
                "time_s"
            ) from None

    def _values(self, row: Row, kind: type) -> dict[str, Any]:
        """Fields of a feed or a motion that the row gives [SI]."""
        return {
            column.field: column.read(self._number(column.name, row[column.name]))
            for column in self._inputs
            if column.kind is kind and row[column.name]
        }

    def feed(self, row: Row, before: Feed) -> Feed:
        """The feed of a row."""
        changes = self._values(row, Feed)
        if any(row[name] for name in self._passing):
            shares = [self._number(name, row[name]) for name in self._passing]
            scale = PERCENT if max(shares) > MOST else 1.0
            finer = [0.0, *(share * scale for share in shares), 1.0]
            changes["mass_fraction"] = fractions_of_passing(finer)
        return dataclasses.replace(before, **changes) if changes else before

    def motion(self, row: Row, before: Motion) -> Motion:
        """The motion of a row."""
        changes = self._values(row, Motion)
        return dataclasses.replace(before, **changes) if changes else before


# --- the run -------------------------------------------------------------------------------------
def run_series(
    config: ScreenConfig,
    series: Series,
    step: float | None = None,
    until: float | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Iterator[tuple[float, StepResult]]:
    """Ends of the steps [s since the first row] and what each gave.

    step: the longest that a step lasts [s], the usual interval of the series unless given; a step
    ends where a row begins. until: when the run ends [s], unless given one such interval after the
    last row. The screen starts as the configuration says, empty or in the steady state of the first
    row. progress: called with what is done and of how much [s]. Raises InputError with the time of
    a step that is refused.
    """
    interval = series.interval
    longest, last = interval if step is None else step, series.moments[-1].time + interval
    end = last if until is None else until
    if not longest > 0.0 or not end > 0.0:
        raise InputError(f"step = {longest:g} s, until = {end:g} s: give times above 0 s", "step")
    if end / longest > MOST_STEPS:
        raise InputError(
            f"step = {longest:g} s makes {end / longest:.3g} steps of {end:g} s, more than "
            f"{MOST_STEPS:g}: give longer steps",
            "step",
        )
    first = series.moments[0]
    screen = Screen(config.replace(feed=first.feed, motion=first.motion))
    ends = [*(moment.time for moment in series.moments[1:]), math.inf]
    for moment, until_next in zip(series.moments, ends, strict=True):
        stop = min(until_next, end)
        count = max(1, math.ceil((stop - moment.time) / longest - 1e-9))
        for k in range(count if stop > moment.time else 0):
            now, then = (moment.time + (stop - moment.time) * j / count for j in (k, k + 1))
            try:
                result = screen.step(then - now, moment.feed, moment.motion)
            except InputError as error:
                error.add_note(f"at {now:g} s of the series")
                raise
            yield then, result
            if progress is not None:
                progress(then, end)


def figures_of_step(result: StepResult) -> dict[str, float]:
    """What a step gave, in the units of the keys: means over it, and the state at its end."""
    products = result.products
    row = {"feed_t_h": result.decks[0].feed_rate / T_H}
    for name in product_names(len(result.decks)):
        row[f"{name}_t_h"] = products[name].mass_flow_rate / T_H
    for deck in result.decks:
        row[f"deck[{deck.deck}].efficiency"] = deck.efficiency
        row[f"deck[{deck.deck}].depth_discharge_mm"] = deck.depth_discharge / MM
    row["undersize_p80_mm"] = result.undersize_p80 / MM
    row["hold_up_kg"] = result.hold_up
    row["drive_power_kw"] = result.drive_power / KW
    row["balance_error_kg"] = result.balance_error
    return row
