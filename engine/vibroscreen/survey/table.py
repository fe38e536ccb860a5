"""Files of tables as laboratories give them, CSV and XLSX: rows by the names of their columns.

Heads are told in plain words, "Sieve (mm)" or "Rate wet, t/h"; here they become sieve_mm and
rate_wet_t_h. Names of the FMU's variables stay as they are.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from vibroscreen.errors import ConfigError, InputError
from vibroscreen.lab_text import decoded

__all__ = ["Row", "Table", "number", "read_tables", "told_of_run"]

VARIABLE = re.compile(r"[a-z_]+(\[\d+\])?(\.[a-z_]+(\[\d+\])?)+")
# Signs and words of heads, and what they become.
SIGNS = (
    (r"t\s*/\s*h\b|\btph\b", " t_h "),
    (r"kg\s*/\s*h\b", " kg_h "),
    (r"kg\s*/\s*s\b", " kg_s "),
    (r"%|\bper\s*cent\b|\bpercent\b", " pct "),
    ("[\u00b5\u03bc]m|\\bmicrons?\\b", " um "),
    (r'\binch(es)?\b|"', " in "),
)


# A survey is far below these: what is above is something else, and is told before it is read.
MOST_BYTES, MOST_ROWS, MOST_CELLS = 100_000_000, 20_000, 20_000_000
# What spreadsheets show where a formula went wrong; other cells that begin so are comment.
WRONG = ("#DIV/0!", "#N/A", "#NAME?", "#NULL!", "#NUM!", "#REF!", "#VALUE!")


class Row(NamedTuple):
    """A row: where it stands, its cells by column, and whether its decimals may follow a comma."""

    place: str
    cells: Mapping[str, str]
    comma: bool


@dataclass(frozen=True)
class Table:
    """A sheet of a workbook, or a CSV file: its name, its columns and its rows."""

    name: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def read_tables(path: Path) -> tuple[Table, ...]:
    """Tables of a file, one a sheet that holds something.

    Raises InputError that names sheet and row, OSError, ImportError without openpyxl for XLSX.
    """
    if path.stat().st_size > MOST_BYTES:
        raise _too_large(f"the file has {path.stat().st_size / 1e6:.0f} MB")
    raw = path.read_bytes()
    if raw.startswith(b"PK"):
        tables = [_table(name, grid, comma=True) for name, grid in _workbook(raw) if grid]
    else:
        grid, comma = _lines(_text(raw))
        tables = [_table("", grid, comma=comma)] if grid else []
    if not tables:
        raise InputError("survey holds no rows: give one for every class of every run", "survey")
    return tuple(tables)


@contextlib.contextmanager
def told_of_run(name: str) -> Iterator[None]:
    """Errors within tell the run that they are about."""
    try:
        yield
    except (ConfigError, InputError) as error:
        error.add_note(f"in run {name!r}")
        raise


def _too_large(said: str) -> InputError:
    return InputError(
        f"{said}: a survey has a row for each sieve of each stream, up to {MOST_ROWS} of them; "
        "keep those of the survey (vibroscreen replay takes what a plant records through time)",
        "survey",
    )


def number(row: Row, column: str, *, empty: bool = False) -> float:
    """A cell as a number; an empty one is nan where it may be. Raises InputError."""
    text = row.cells[column]
    if not text and empty:
        return math.nan
    plain = text.removesuffix("%").strip()
    if row.comma and plain.count(",") == 1 and "." not in plain:
        plain = plain.replace(",", ".")
    try:
        value = float(plain) if "_" not in plain else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{row.place}: {column} = {text!r} is not a finite number: give one", column
        )
    return value


Grid = list[tuple[str, list[str]]]


def _text(raw: bytes) -> str:
    text = decoded(raw)
    if text is None:
        raise InputError("the file is no text and no XLSX: save the table as one of them", "survey")
    return text


def _lines(text: str) -> tuple[Grid, bool]:
    """Cells by line, and whether decimals may follow a comma; what follows a # is comment."""
    numbered = enumerate(text.splitlines(), start=1)
    kept = [(k, line) for k, line in numbered if line.split("#")[0].strip(" \t;,")]
    if not kept:
        return [], False
    if len(kept) > MOST_ROWS:
        raise _too_large(f"the table has {len(kept)} rows")
    head = kept[0][1]
    separator = max(";\t,", key=head.count)  # the first of those that are as frequent
    try:
        rows = list(csv.reader([line for _, line in kept], delimiter=separator))
    except csv.Error as error:
        raise InputError(f"the table cannot be parted into cells: {error}", "survey") from None
    if len(rows) != len(kept):  # a quote that spans lines
        raise InputError("a quoted cell goes over several lines: close every quote", "survey")
    places = [f"line {k}" for k, _ in kept]
    return list(zip(places, rows, strict=True)), separator != ","


def _workbook(raw: bytes) -> list[tuple[str, Grid]]:
    """Cells by row of every sheet; a formula counts by the value that is stored with it."""
    try:
        import openpyxl
    except ImportError:
        raise ImportError(
            "reading XLSX needs openpyxl, which is not installed: "
            "pip install 'vibroscreen[calibrate]'"
        ) from None
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as parts:
            sheets = [one for one in parts.infolist() if one.filename.startswith("xl/")]
            if sum(one.file_size for one in sheets) > MOST_BYTES:
                raise _too_large("the workbook is large")
            formulas = any(
                re.search(rb"<f[ >]", parts.read(one))
                for one in sheets
                if one.filename.startswith("xl/worksheets/")
            )
        values = _cells(openpyxl.load_workbook(io.BytesIO(raw), read_only=True, data_only=True))
        written = (
            _cells(openpyxl.load_workbook(io.BytesIO(raw), read_only=True)) if formulas else values
        )
    except InputError:
        raise
    except Exception as error:  # a broken file makes openpyxl raise what its parsers do
        raise InputError(
            f"the workbook cannot be read ({type(error).__name__}): save it anew as XLSX or CSV",
            "survey",
        ) from None
    return [(name, _grid(name, rows, written[name])) for name, rows in values.items()]


Rows = dict[int, tuple[Any, ...]]


def _grid(name: str, values: Rows, written: Rows) -> Grid:
    """Cells of a sheet by row, from values and what is written where they come from."""
    grid: Grid = []
    for k, texts in written.items():
        place, row = f"sheet {name!r}, row {k}", values.get(k, ())
        for column, text in enumerate(texts):
            value = row[column] if column < len(row) else None
            if value is None and isinstance(text, str) and text.startswith("="):
                raise InputError(
                    f"{place}: the formula {text[:40]} has no value stored with it: open and "
                    "save the workbook in a spreadsheet program",
                    "survey",
                )
        cells = ["" if value is None else _shown(value) for value in row]
        while cells and not cells[-1]:
            cells.pop()
        if not cells or (cells[0].startswith("#") and cells[0] not in WRONG):
            continue
        if grid or len(cells) > 1:  # a title stands above the head
            grid.append((place, cells))
    return grid


def _cells(book: Any) -> dict[str, Rows]:
    """Rows of every sheet that hold something, by number from 1."""
    found: dict[str, Rows] = {}
    seen = 0
    for sheet in book.worksheets:
        own = found[sheet.title] = {}
        for k, row in enumerate(sheet.iter_rows(values_only=True), start=1):
            seen += len(row)
            if any(value is not None for value in row):
                own[k] = row
            if len(own) > MOST_ROWS or seen > MOST_CELLS:
                raise _too_large(f"sheet {sheet.title!r} has {k} rows and more")
    return found


def _shown(value: Any) -> str:
    return repr(value) if isinstance(value, float) else str(value).strip()


def _table(name: str, grid: Grid, *, comma: bool) -> Table:
    (place, head), *body = grid
    columns = tuple(_named(cell) for cell in head)
    said = f"{place}: " if name else ""
    for k, column in enumerate(columns):
        if not column:
            raise InputError(f"{said}column {k + 1} has no name in the head: give one", "survey")
        if column in columns[:k]:
            raise InputError(f"{said}column {column!r} stands twice: give each once", column)
    rows = []
    for where, cells in body:
        short = len(columns) - len(cells)
        if short < 0 or (short > 0 and not name):
            raise InputError(
                f"{where} has {len(cells)} cells, not {len(columns)} as the head: give one a "
                "column",
                "survey",
            )
        texts = [cell.strip() for cell in (*cells, *[""] * short)]
        rows.append(Row(where, dict(zip(columns, texts, strict=True)), comma))
    return Table(name, columns, tuple(rows))


def _named(cell: str) -> str:
    """A head as the name of a column."""
    text = cell.strip()
    if VARIABLE.fullmatch(text):
        return text
    text = text.lower()
    for pattern, sign in SIGNS:
        text = re.sub(pattern, sign, text)
    return re.sub(r"\W+", "_", text).strip("_")
