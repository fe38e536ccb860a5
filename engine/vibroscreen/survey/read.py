"""Surveys of screens as laboratories and control rooms give them.

A table, CSV or a sheet of XLSX, has a row for each sieve of each stream of each run:

    run                   name of the run; without it the name of the sheet
    stream                feed, undersize, oversize, intermediate (over deck 2), intermediate[2] ...
    sieve_mm              opening; also _um, _in, _m; pan for what no sieve keeps
    passing_pct           also retained_pct (on each sieve), retained_cumulative_pct, _fraction for
                          shares of 1, mass_g (on each sieve, with the pan)
    rate_t_h              of dry solids; or rate_wet_t_h with moisture_pct; also _kg_h, _kg_s
    sigma_...             standard error of a share or a rate, in the unit of its column's name
    group                 runs that are left out of a fit together
    any number of the screen by the name of the FMU's variable, in SI units

Without a column `stream` what is told of a stream has its name before it, `feed_passing_pct`,
`oversize_rate_t_h`, with one column of sieves; or sheets of a workbook are named by the streams.
Streams may also be given by class: lower_mm, upper_mm and feed_t_h, undersize_t_h,
intermediate_t_h, oversize_t_h. Rows and columns come in any order; an empty cell is a gap.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.fields import nearest
from vibroscreen.stream import MOST_FED
from vibroscreen.survey.table import VARIABLE, Row, Table, number, read_tables
from vibroscreen.units import INCH, KG_H, MICROMETRE, MM, PERCENT, T_H

__all__ = ["Sheet", "Survey", "SurveyRun", "read_sheets", "sheets_of"]

Array = NDArray[np.float64]

STREAM = r"feed|undersize|oversize|intermediate(?:_?\d+_?)?"
RATES = {"t_h": T_H, "kg_h": KG_H, "kg_s": 1.0}
SIZES = {"mm": MM, "um": MICROMETRE, "in": INCH, "m": 1.0}
SHARES = {"pct": PERCENT, "fraction": 1.0}
UNITS = {
    "sieve": SIZES,
    "lower": SIZES,
    "upper": SIZES,
    "rate": RATES,
    "rate_wet": RATES,
    "class_rate": RATES,
    "moisture": SHARES,
    "passing": SHARES,
    "retained": SHARES,
    "retained_cumulative": SHARES,
    "mass": {"g": 1e-3, "kg": 1.0},
}
# What may stand for the words of this page.
WORDS = (
    (r"\bsize\b|\baperture\b|\bopening\b|\bmesh\b", "sieve"),
    (r"\bfiner\b|\bthrough\b", "passing"),
    (r"\bweight\b", "mass"),
    (r"\bwater\b", "moisture"),
    (r"\bflow\b|\btonnage\b|\bthroughput\b", "rate"),
    (r"\bwet rate\b", "rate wet"),
    (r"\bdry\b|\bcumulative passing\b(?= pct| fraction|$)", "\0"),
    (r"\bcum\b", "cumulative"),
    (r"\bcumulative retained\b", "retained cumulative"),
    (r"\bpassing cumulative\b|\bcumulative passing\b", "passing"),
    (r"\bstandard error\b|\bstd\b|\berror\b|\bsd\b", "sigma"),
    (r"\bmiddle product\b|\bmiddle\b|\bmidsize\b", "intermediate"),
    (r"\bunderflow\b", "undersize"),
    (r"\boverflow\b", "oversize"),
)
TEXTS = ("run", "stream", "group")
RATED = ("rate", "rate_wet", "class_rate")
PAN = re.compile(r"pan|bottom|rest|receiver|0(\.0*)?", re.IGNORECASE)
# Shares of a sheet may sum to one within this, passing may fall with size and shares may lie
# outside of 0 to 1 by as much: weighings and round-off.
LOSS = 0.02
EXPECTED = (
    "run, stream, sieve_mm with passing_pct, retained_pct or mass_g, rate_t_h or rate_wet_t_h with "
    "moisture_pct; or run, lower_mm, upper_mm with feed_t_h, undersize_t_h, oversize_t_h"
)


@dataclass(frozen=True, eq=False)
class Sheet:
    """What was measured of one stream in one run.

    rate: of dry solids [kg/s], nan if it was not measured; sizes: ascending [m]. Either passing:
    finer than each size [1]; or class_rates: between each size and the one below, from 0 up [kg/s].
    Errors are standard errors, nan where they are not known. place: where the sheet begins.
    """

    stream: str
    place: str
    sizes: tuple[float, ...]
    rate: float = math.nan
    rate_error: float = math.nan
    passing: Array | None = None
    class_rates: Array | None = None
    error: Array | None = None


@dataclass(frozen=True, eq=False)
class SurveyRun:
    """One run: sheets by stream, numbers of the screen in it by the FMU's names, SI units."""

    name: str
    sheets: Mapping[str, Sheet]
    settings: Mapping[str, float]
    group: str = ""


@dataclass(frozen=True, eq=False)
class Survey:
    """Runs of a survey, and what was taken for granted in reading it, a sentence each."""

    runs: tuple[SurveyRun, ...]
    notes: tuple[str, ...] = ()


def read_sheets(path: str | Path) -> Survey:
    """What a survey measured of each stream, as it was measured.

    Raises InputError that names sheet, run, stream and row and what was expected, OSError,
    ImportError without openpyxl for XLSX.
    """
    try:
        return sheets_of(read_tables(Path(path)))
    except InputError as error:
        error.add_note(f"in {path}")
        raise


# --- columns -------------------------------------------------------------------------------------
class Column(NamedTuple):
    """What a column tells: of one stream or, with "", of that of its row; its unit in SI."""

    name: str
    stream: str
    what: str
    sigma: bool
    unit: float


def _column(name: str, notes: list[str]) -> Column:
    """What the name of a column says. Raises InputError."""
    if name in TEXTS:
        return Column(name, "", "text", False, 1.0)
    if VARIABLE.fullmatch(name) and "." in name:
        try:  # whatever the decks, panels and classes: each has the numbers of the first
            ScreenConfig.default().value_of(re.sub(r"\[\d+\]", "[1]", name))
        except ConfigError as error:
            raise InputError(f"column {name!r}: {error}", name) from None
        return Column(name, "", "setting", False, 1.0)
    if name in ("recovery", "feed_fraction", "time_s", "areal_mass_kg_m2"):
        raise InputError(
            f"column {name!r} is of a survey of recoveries, which has no streams to balance: "
            "vibroscreen calibrate takes it as it is",
            name,
        )
    words = name.replace("_", " ")
    for pattern, word in WORDS:
        words = re.sub(pattern, word, words)
    words = re.sub(" *\0 *", " ", words).strip().replace(" ", "_")
    sigma = "sigma" in words.split("_")
    words = "_".join(word for word in words.split("_") if word != "sigma")
    whats = "|".join(sorted(UNITS, key=len, reverse=True))
    units = "|".join(unit for table in UNITS.values() for unit in table)
    match = re.fullmatch(rf"(?:({STREAM})_?)?({whats})?(?:_?({units}))?", words)
    if match is None or not (match[1] or match[2]):
        known = [f"{what}_{next(iter(table))}" for what, table in UNITS.items()] + [*TEXTS]
        raise InputError(
            f"column {name!r} is unknown: did you mean {nearest(name, known)!r}? Expected are "
            f"{EXPECTED}; numbers of the screen go by the names of the FMU's variables",
            name,
        )
    stream, what, unit = match[1] or "", match[2] or "class_rate", match[3]
    table = UNITS[what]
    if unit is None:
        unit = next(iter(table))
        notes.append(f"column {name!r} gives no unit: taken as {unit}")
    if unit not in table:
        raise InputError(
            f"column {name!r} has the unit {unit}: give one of {', '.join(table)}", name
        )
    return Column(name, _stream(stream) if stream else "", what, sigma, table[unit])


@cache
def _stream(text: str) -> str:
    """The name of a stream: intermediate[k] left over deck k + 1."""
    plain = text.strip().lower()
    for pattern, word in WORDS[-3:]:
        plain = re.sub(pattern, word, plain)
    match = re.fullmatch(r"(feed|undersize|oversize)|intermediate\W?_?(\d*)\W?_?", plain)
    if match is None or (match[2] and int(match[2]) == 0):
        return ""
    return match[1] or f"intermediate[{int(match[2] or 1)}]"


# --- runs and streams ----------------------------------------------------------------------------
class Cell(NamedTuple):
    """The rows that tell of one stream of a run, and the columns that do."""

    rows: list[Row]
    columns: tuple[Column, ...]


def sheets_of(tables: Sequence[Table]) -> Survey:
    """The survey that tables hold. Raises InputError."""
    notes: list[str] = []
    found: dict[str, dict[str, Cell]] = {}
    of_run: dict[str, list[tuple[Row, tuple[Column, ...]]]] = {}
    for table in tables:
        where = f"sheet {table.name!r}: " if table.name else ""
        try:
            columns = tuple(_column(name, notes) for name in table.columns)
            _check(columns, table.name)
        except InputError as error:
            raise InputError(where + str(error), error.variable) from None
        if "run" not in table.columns:
            notes.append(f"{where}no column run: all rows are taken as of one run")
        for row in table.rows:
            run = row.cells.get("run", "survey" if _stream(table.name) else table.name or "survey")
            if not run:
                raise InputError(f"{row.place}: run is empty: name the run in every row", "run")
            of_run.setdefault(run, []).append((row, columns))
            for stream in _streams(row, run, columns, table.name):
                cell = found.setdefault(run, {}).setdefault(stream, Cell([], columns))
                if cell.columns != columns:
                    raise InputError(
                        f"{row.place}: stream {stream} of run {run!r} stands in another sheet too "
                        f"({cell.rows[0].place}): give each stream once",
                        "stream",
                    )
                cell.rows.append(row)
    if not found:
        raise InputError("survey holds no rows: give one for every sieve of every run", "survey")
    runs = []
    for name, streams in found.items():
        sheets = {s: _sheet(name, s, cell, notes) for s, cell in streams.items()}
        group = {row.cells.get("group", "") for row, _ in of_run[name]}
        if len(group) > 1:
            raise InputError(f"group of run {name!r} differs within the run: give one", "group")
        runs.append(SurveyRun(name, sheets, _settings(name, of_run[name]), group.pop()))
    return Survey(tuple(runs), tuple(dict.fromkeys(notes)))


def _check(columns: Sequence[Column], sheet: str) -> None:
    """Refuse tables that cannot say a gradation."""
    names = {column.what for column in columns if not column.sigma}
    by_row = "stream" in {column.name for column in columns}
    by_class = {"lower", "upper"} <= names
    if by_class:
        missing = "" if "class_rate" in names else "feed_t_h or another stream"
    else:
        shares = names & {"passing", "retained", "retained_cumulative", "mass"}
        missing = "sieve_mm" if "sieve" not in names else "" if shares else "passing_pct"
        told = by_row or any(column.stream for column in columns) or _stream(sheet)
        missing = missing or ("" if told else "stream")
    if missing:
        raise InputError(f"column {missing!r} is missing: expected are {EXPECTED}", missing)
    for k, column in enumerate(columns):
        for other in columns[:k]:
            if column[1:4] == other[1:4] and column.what not in ("text", "setting"):
                raise InputError(
                    f"columns {other.name!r} and {column.name!r} tell the same: give one",
                    column.name,
                )
        if by_row and column.stream:
            raise InputError(
                f"column {column.name!r} tells of one stream beside a column stream: use one way",
                column.name,
            )
        if by_class and column.what not in ("lower", "upper", "class_rate", "text", "setting"):
            raise InputError(
                f"column {column.name!r} does not go with classes, lower_mm and upper_mm: give "
                "rates by class, or sieves with shares",
                column.name,
            )


def _streams(row: Row, run: str, columns: Sequence[Column], sheet: str) -> list[str]:
    """Streams that a row tells of."""
    if "stream" not in row.cells:
        named = list(dict.fromkeys(column.stream for column in columns if column.stream))
        return named or [_stream(sheet)]
    stream = _stream(row.cells["stream"])
    if not stream:
        raise InputError(
            f"{row.place}: stream {row.cells['stream']!r} of run {run!r} is unknown: expected are "
            "feed, undersize, oversize and intermediate[k], what leaves over deck k + 1",
            "stream",
        )
    return [stream]


def _settings(run: str, rows: Iterable[tuple[Row, tuple[Column, ...]]]) -> dict[str, float]:
    found: dict[str, float] = {}
    for row, columns in rows:
        for column in columns:
            if column.what == "setting" and row.cells[column.name]:
                value = number(row, column.name)
                if found.setdefault(column.name, value) != value:
                    raise InputError(
                        f"{row.place}: {column.name} = {value:g} of run {run!r} is "
                        f"{found[column.name]:g} in another row: a run has one",
                        column.name,
                    )
    return found


class _Teller:
    """Columns of one stream by what they tell; messages that name run and stream."""

    def __init__(self, run: str, stream: str, cell: Cell) -> None:
        self.run, self.stream, self.rows = run, stream, cell.rows
        self.columns = {
            (column.what, column.sigma): column
            for column in cell.columns
            if column.stream in ("", stream)
        }

    def has(self, what: str, *, sigma: bool = False) -> bool:
        return (what, sigma) in self.columns

    def value(self, row: Row, what: str, *, sigma: bool = False, empty: bool = True) -> float:
        """A number in SI units, nan for a gap."""
        column = self.columns[what, sigma]
        try:
            found = number(row, column.name, empty=empty) * column.unit
        except InputError as error:
            raise self.refusal(row, str(error).partition(": ")[2], column.name) from None
        if not math.isnan(found) and found < 0.0 and not (what == "passing" and found > -LOSS):
            said = f"{column.name} = {row.cells[column.name]} is negative: give 0 or more"
            raise self.refusal(row, said, column.name)
        if what in RATED and found > MOST_FED:
            said = (
                f"{column.name} = {row.cells[column.name]} is more than {MOST_FED / T_H:g} t/h, "
                "which no screen is fed: correct it, or name the column by its unit"
            )
            raise self.refusal(row, said, column.name)
        if sigma and found == 0.0:
            said = f"{column.name} = 0: give a standard error above 0, or none"
            raise self.refusal(row, said, column.name)
        return found

    def refusal(self, row: Row, said: str, variable: str) -> InputError:
        return InputError(f"{row.place}: run {self.run!r}, {self.stream}: {said}", variable)

    def constant(self, what: str, *, sigma: bool = False) -> float:
        """A number that the rows share; gaps do not count; nan if there is none."""
        if not self.has(what, sigma=sigma):
            return math.nan
        found = math.nan
        for row in self.rows:
            value = self.value(row, what, sigma=sigma)
            if not math.isnan(value) and not math.isnan(found) and value != found:
                name = self.columns[what, sigma].name
                raise self.refusal(
                    row, f"{name} = {row.cells[name]} differs from the rows above: give one", name
                )
            found = found if math.isnan(value) else value
        return found


def _sheet(run: str, stream: str, cell: Cell, notes: list[str]) -> Sheet:
    tell = _Teller(run, stream, cell)
    if tell.has("lower"):
        return _by_class(tell)
    rate, error = _rate(tell, notes)
    sizes, passing, sigma = _gradation(tell, notes)
    return Sheet(stream, tell.rows[0].place, sizes, rate, error, passing, None, sigma)


def _rate(tell: _Teller, notes: list[str]) -> tuple[float, float]:
    """Rate of dry solids and its standard error [kg/s]."""
    dry, wet, moisture = (tell.constant(what) for what in ("rate", "rate_wet", "moisture"))
    first = tell.rows[0]
    if moisture >= 1.0:
        raise tell.refusal(
            first, f"moisture = {moisture / PERCENT:g} %: give less than 100 %", "moisture"
        )
    if not math.isnan(dry):
        if not math.isnan(wet):
            raise tell.refusal(first, "rate and rate_wet are both given: give one", "rate")
        if not math.isnan(moisture):
            notes.append(
                "rate_t_h is taken as of dry solids, moisture does not change it: a wet rate is "
                "rate_wet_t_h"
            )
        return dry, tell.constant("rate", sigma=True)
    if math.isnan(wet):
        return math.nan, math.nan
    if math.isnan(moisture):
        raise tell.refusal(
            first, "rate_wet is given without moisture: give moisture_pct", "moisture_pct"
        )
    part = 1.0 - moisture
    return wet * part, tell.constant("rate_wet", sigma=True) * part


def _gradation(
    tell: _Teller, notes: list[str]
) -> tuple[tuple[float, ...], Array | None, Array | None]:
    """Sizes [m], what is finer than each [1] and its standard error, from any kind of shares."""
    kinds = [k for k in ("passing", "retained_cumulative", "retained", "mass") if tell.has(k)]
    if not kinds:
        return (), None, None
    kind = kinds[0]
    rows: dict[float, tuple[Row, float, float]] = {}
    name = tell.columns["sieve", False].name
    for row in tell.rows:
        text = row.cells[name]
        value = tell.value(row, kind)
        if not text and math.isnan(value):
            continue
        size = 0.0 if PAN.fullmatch(text) else tell.value(row, "sieve", empty=False)
        if size in rows:
            raise tell.refusal(
                row, f"sieve {text} stands in {rows[size][0].place} too: give it once", name
            )
        sigma = tell.value(row, kind, sigma=True) if tell.has(kind, sigma=True) else math.nan
        rows[size] = (row, value, sigma)
    sizes = sorted(rows)
    values = np.array([rows[size][1] for size in sizes])
    sigmas = np.array([rows[size][2] for size in sizes])
    if kind in ("retained", "mass"):
        passing, sigmas = _summed(tell, kind, sizes, values, sigmas, notes)
    else:
        passing = 1.0 - values if kind == "retained_cumulative" else values
    column = tell.columns[kind, False].name
    known = ~np.isnan(passing) & (np.array(sizes) > 0.0)
    last = (0.0, "nothing")
    for size, value, keep in zip(sizes, passing, known, strict=True):
        if not keep:
            continue
        if not -LOSS <= value <= 1.0 + LOSS:
            raise tell.refusal(
                rows[size][0], f"{value / PERCENT:.5g} % pass: expected is 0 to 100 %", column
            )
        if value < last[0] - LOSS:
            raise tell.refusal(
                rows[size][0],
                f"{value / PERCENT:.4g} % pass {size / MM:.4g} mm and {last[0] / PERCENT:.4g} % "
                f"pass {last[1]}: passing never falls with size; is it what is retained? Then "
                "name the column retained_pct",
                column,
            )
        last = (float(value), f"{size / MM:.4g} mm")
    if kind in SHARES_BY_NAME and tell.columns[kind, False].unit == PERCENT and known.sum() > 1:
        most = float(np.nanmax(values)) / PERCENT
        if 0.0 < most <= 1.0 and tell.stream in ("feed", "undersize"):
            raise tell.refusal(
                tell.rows[0],
                f"the largest {column} is {most:g} %: are these shares of 1? Then name the column "
                f"{kind}_fraction",
                column,
            )
    kept = tuple(float(s) for s, keep in zip(sizes, known, strict=True) if keep)
    return kept, np.clip(passing[known], 0.0, 1.0), sigmas[known]


SHARES_BY_NAME = ("passing", "retained", "retained_cumulative")


def _summed(
    tell: _Teller,
    kind: str,
    sizes: Sequence[float],
    values: Array,
    sigmas: Array,
    notes: list[str],
) -> tuple[Array, Array]:
    """Passing and its standard error from what each sieve retains: shares, or masses with a pan."""
    if np.isnan(values).all():
        return values, sigmas
    for size, value in zip(sizes, values, strict=True):
        if math.isnan(value):
            raise tell.refusal(
                tell.rows[0],
                f"{kind} on {size / MM:.4g} mm is empty, so what passes the sieves below is not "
                "known: give it, or 0",
                kind,
            )
    total, pan = math.fsum(values), sizes[0] == 0.0
    if kind == "mass":
        if not pan or total <= 0.0:
            raise tell.refusal(
                tell.rows[0], "masses need that of the pan, and a sum above 0: add a row pan", kind
            )
        whole = total
    else:
        whole = total if pan else 1.0
        if total > 1.0 + LOSS or (pan and total < 1.0 - LOSS):
            raise tell.refusal(
                tell.rows[0],
                f"what is retained sums to {total / PERCENT:.5g} %, not to 100: correct it, or "
                "name the column retained_cumulative_pct",
                kind,
            )
        if not pan:
            notes.append(
                f"run {tell.run!r}, {tell.stream}: there is no pan, {(1 - total) / PERCENT:.3g} % "
                "are taken as finer than the finest sieve"
            )
    above = np.cumsum(values[::-1])[::-1]
    variance = np.cumsum(sigmas[::-1] ** 2)[::-1]
    return 1.0 - above / whole, np.sqrt(variance) / (whole if kind == "mass" else 1.0)


def _by_class(tell: _Teller) -> Sheet:
    """A stream given as rates by class."""
    rows = sorted(tell.rows, key=lambda row: tell.value(row, "lower", empty=False))
    limits = [[tell.value(row, k, empty=False) for k in ("lower", "upper")] for row in rows]
    if limits[0][0] != 0.0:
        raise tell.refusal(rows[0], "the finest class begins above 0: add one from 0", "lower_mm")
    for row, (low, high) in zip(rows, limits, strict=True):
        if high <= low:
            raise tell.refusal(row, "upper_mm is not above lower_mm: correct it", "upper_mm")
    for row, before, this in zip(rows[1:], limits[:-1], limits[1:], strict=True):
        if before[1] != this[0]:
            raise tell.refusal(
                row,
                f"class {this[0] / MM:g} to {this[1] / MM:g} mm does not begin where the finer one "
                f"ends, {before[1] / MM:g} mm: classes follow each other, one row each",
                "lower_mm",
            )
    values = np.array([tell.value(row, "class_rate") for row in rows])
    given = tell.has("class_rate", sigma=True)
    sigmas = [tell.value(row, "class_rate", sigma=True) if given else math.nan for row in rows]
    sizes = tuple(high for _, high in limits)
    return Sheet(tell.stream, rows[0].place, sizes, class_rates=values, error=np.array(sigmas))
