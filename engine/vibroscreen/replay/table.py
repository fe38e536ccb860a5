"""A historian's export, CSV or parquet: the wanted columns, part by part.

A CSV file may begin with lines of its own above the head; cells are parted by semicolons, tabs,
commas or bars, and decimals may follow a comma where commas do not part.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vibroscreen.errors import InputError
from vibroscreen.fields import nearest
from vibroscreen.lab_text import decoded

__all__ = ["EMPTY", "GOOD", "TEXT", "Export", "column_named", "numbers", "open_export", "pyarrow"]

# What a cell that should be a number is.
GOOD, EMPTY, TEXT = 0, 1, 2
SEPARATORS = ";\t,|"
# Lines in which the head is looked for, and rows of a part.
MOST_HEAD, PART = 50, 100_000


@dataclass(frozen=True)
class Export:
    """Columns of a file, and its rows in parts: by column, cells as text, or as parquet types them.

    line: number of the line of the first row; separator: of cells, empty for parquet; raw: the text
    of the rows, or a file of pyarrow.
    """

    columns: tuple[str, ...]
    line: int
    separator: str
    raw: Any

    @property
    def comma(self) -> bool:
        """Whether decimals may follow a comma."""
        return self.separator != ","

    def parts(self, wanted: Sequence[str]) -> Iterator[pd.DataFrame]:
        """Rows with the wanted columns. Raises InputError for a file that is broken further on."""
        if isinstance(self.raw, str):
            return _csv_parts(self, wanted)
        return _parquet_parts(self.raw, wanted)


def open_export(path: Path, *marks: str) -> Export:
    """A file whose head holds one of the columns in `marks`, whatever their case.

    Raises InputError, OSError, ImportError without pyarrow for parquet.
    """
    raw = path.read_bytes()
    if raw.startswith(b"PAR1"):
        return _parquet(raw)
    text = decoded(raw)
    if text is None:
        raise InputError("the file is no text and no parquet: export it as one of them", "plant")
    lines = list(islice(io.StringIO(text, newline=None), MOST_HEAD))
    for place, line in enumerate(lines, start=1):
        for separator in SEPARATORS:
            cells = [cell.strip().strip('"').strip() for cell in line.strip("\n").split(separator)]
            if any(mark.lower() in (cell.lower() for cell in cells) for mark in marks):
                return _export(text, cells, place, separator)
    shown = next((line.strip() for line in lines if line.strip()), "")[:80]
    raise InputError(
        f"no head with a column {' or '.join(map(repr, marks))} is in the first {MOST_HEAD} lines, "
        f"the first is {shown!r}: name the column of times with --time",
        "time",
    )


def _export(text: str, cells: list[str], line: int, separator: str) -> Export:
    named = [cell for cell in cells if cell]
    if twice := {name for name in named if named.count(name) > 1}:
        raise InputError(f"the column {min(twice)!r} is there twice: rename one", "plant")
    rest = io.StringIO(text, newline=None)
    for _ in range(line):
        rest.readline()
    return Export(tuple(cells), line + 1, separator, rest.read())


def _csv_parts(export: Export, wanted: Sequence[str]) -> Iterator[pd.DataFrame]:
    places = [export.columns.index(name) for name in wanted]
    rows = csv.reader(io.StringIO(export.raw, newline=""), delimiter=export.separator, strict=True)
    while True:
        try:
            part = [row for row in islice(rows, PART) if any(row)]
        except csv.Error as error:
            line = export.line + rows.line_num - 1
            raise InputError(
                f"line {line} cannot be parted into cells: {error}: mend its quotes", "plant"
            ) from None
        if not part:
            return
        cells = {
            name: [row[place] if place < len(row) else "" for row in part]
            for name, place in zip(wanted, places, strict=True)
        }
        yield pd.DataFrame(cells, dtype=object)


def _parquet(raw: bytes) -> Export:
    arrow, parquet = pyarrow()
    try:
        file = parquet.ParquetFile(io.BytesIO(raw))
        return Export(tuple(file.schema_arrow.names), 1, separator="", raw=file)
    except (arrow.ArrowException, OSError) as error:
        raise InputError(f"the parquet file is broken ({error}): export it anew", "plant") from None


def _parquet_parts(file: Any, wanted: Sequence[str]) -> Iterator[pd.DataFrame]:
    arrow, _ = pyarrow()
    try:
        for batch in file.iter_batches(PART, columns=list(wanted)):
            yield batch.to_pandas().reindex(columns=list(wanted))
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise InputError(f"the parquet file is broken ({error}): export it anew", "plant") from None


def pyarrow() -> tuple[Any, Any]:
    """The modules pyarrow and pyarrow.parquet. Raises ImportError that says how to get them."""
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise ImportError(
            "parquet needs pyarrow, which is not installed: pip install 'vibroscreen[replay]', or "
            "name a .csv file"
        ) from None


def column_named(columns: Sequence[str], name: str, what: str) -> str:
    """A column by its name, whatever its case. Raises InputError with the nearest one."""
    for column in columns:
        if column.strip().lower() == name.strip().lower():
            return column
    near = nearest(name, [column for column in columns if column]) if any(columns) else ""
    raise InputError(f"{what} = {name!r} is no column of the file: did you mean {near!r}?", what)


def numbers(cells: pd.Series, *, comma: bool) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """Cells as numbers, nan where there is none, and what each cell is: GOOD, EMPTY or TEXT."""
    if pd.api.types.is_numeric_dtype(cells.dtype) and not pd.api.types.is_bool_dtype(cells.dtype):
        values = cells.to_numpy(dtype=float, na_value=np.nan).copy()
        kind = np.where(np.isnan(values), EMPTY, np.where(np.isfinite(values), GOOD, TEXT))
    else:
        there = cells.notna().to_numpy()
        text = cells.where(there, "").astype(str).str.strip()
        if comma:
            text = text.str.replace(",", ".", regex=False)
        values = pd.to_numeric(text, errors="coerce").to_numpy(dtype=float, na_value=np.nan).copy()
        kind = np.where(np.isfinite(values), GOOD, np.where(text == "", EMPTY, TEXT))
    values[~np.isfinite(values)] = np.nan
    return values, kind.astype(np.int8)
