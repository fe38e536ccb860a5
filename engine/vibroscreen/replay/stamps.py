"""Times of a historian's export: dates with zones or without, or numbers since any moment."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vibroscreen.columns import TIMES
from vibroscreen.errors import InputError
from vibroscreen.replay.table import numbers

__all__ = ["NUMBERS", "Clock"]

ISO = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:?\d\d.*)?")
OFFSET = re.compile(r"(?:Z|[+-]\d\d:?\d\d|UTC|GMT)$")
# Times that are numbers: seconds in each. unix: since the beginning of 1970, UTC.
NUMBERS = {**{name.removeprefix("time_"): factor for name, factor in TIMES.items()}, "unix": 1.0}
NOTHING = np.iinfo(np.int64).min  # no time
MOST_SECONDS = 9e9


@dataclass
class Clock:
    """Reads times, and knows how they were written.

    form: a key of NUMBERS, a format of strptime, or None for ISO 8601. zone: of times that stand
    without one, as Europe/Prague.
    """

    form: str | None
    zone: str | None
    offsets: set[str] = field(default_factory=set)
    zoned: int = 0
    local: int = 0
    example: str = ""

    @property
    def dated(self) -> bool:
        """Whether times are dates, not numbers since an unknown moment."""
        return self.form not in NUMBERS or self.form == "unix"

    def read(self, cells: pd.Series, *, comma: bool) -> NDArray[np.int64]:
        """Times of cells [ns], NOTHING for what is none."""
        if self.form in NUMBERS:
            seconds, _ = numbers(cells, comma=comma)
            seconds *= NUMBERS[str(self.form)]
            good = np.abs(seconds) < MOST_SECONDS
            self.zoned += self.form == "unix"
            return np.where(good, np.where(good, seconds, 0.0) * 1e9, NOTHING).astype(np.int64)
        if isinstance(cells.dtype, pd.DatetimeTZDtype):
            self.zoned += len(cells)
            return _nanoseconds(cells.dt.tz_convert("UTC"))
        if pd.api.types.is_datetime64_dtype(cells.dtype):
            self.local += len(cells)
            return self._localised(cells)
        return self._parsed(cells.where(cells.notna(), "").astype(str).str.strip())

    def _parsed(self, text: pd.Series) -> NDArray[np.int64]:
        told = text.str.extract(f"({OFFSET.pattern})", expand=False)
        zoned = told.notna().to_numpy()
        if self.form is None:
            text = text.where(text.str.fullmatch(ISO), None)
        form = "ISO8601" if self.form is None else self.form
        try:
            found = pd.to_datetime(text, format=form, errors="coerce", utc=True)
        except (ValueError, TypeError, re.error) as error:
            raise InputError(
                f"--time-format {self.form!r} is none ({error}): write it as '%d.%m.%Y %H:%M:%S'",
                "time_format",
            ) from None
        good = found.notna().to_numpy()
        self.offsets.update(told[zoned & good].unique())
        self.zoned += int((zoned & good).sum())
        self.local += int((~zoned & good).sum())
        stamps = _nanoseconds(found)
        if self.zone is not None:
            local = found[~zoned].dt.tz_localize(None)
            stamps[~zoned] = self._localised(local)
        return stamps

    def _localised(self, cells: pd.Series) -> NDArray[np.int64]:
        """Times without a zone, in that of the clock; an hour that is there twice is no time."""
        if self.zone is None:
            return _nanoseconds(cells)
        try:
            there = cells.dt.tz_localize(self.zone, ambiguous="NaT", nonexistent="NaT")
        except (KeyError, ValueError, OSError):
            raise InputError(
                f"--zone {self.zone!r} is no time zone: write it as Europe/Prague or UTC", "zone"
            ) from None
        return _nanoseconds(there.dt.tz_convert("UTC"))

    def check(self) -> str:
        """What is to be told of the zones. Raises InputError for times with and without one."""
        if self.zoned and self.local and self.zone is None and self.dated:
            raise InputError(
                f"{self.zoned} times stand with a zone and {self.local} without: give the zone of "
                "the others, as --zone Europe/Prague",
                "zone",
            )
        if len(self.offsets) > 1:
            zones = ", ".join(sorted(self.offsets))
            return f"times stand in {len(self.offsets)} zones ({zones}), taken as UTC"
        return ""

    @property
    def utc(self) -> bool:
        """Whether times are told in UTC."""
        return self.dated and (self.zoned > 0 or self.zone is not None)


def _nanoseconds(stamps: pd.Series) -> NDArray[np.int64]:
    """Times [ns]; NOTHING where there is none, or where it is out of all bounds."""
    seconds = stamps.dt.tz_localize(None) if stamps.dt.tz is not None else stamps
    exact = seconds.to_numpy().astype("datetime64[us]").astype(np.int64)
    good = (exact != NOTHING) & (np.abs(exact) < MOST_SECONDS * 1e6)
    return np.where(good, np.where(good, exact, 0) * 1000, NOTHING).astype(np.int64)
