"""Tables that are written part by part, so that a year needs no more memory than a day."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import pandas as pd

from vibroscreen.errors import InputError
from vibroscreen.replay.table import pyarrow

__all__ = ["SUFFIXES", "table_file"]

SUFFIXES = (".parquet", ".csv")


class Write(Protocol):
    """Called with every part of a table."""

    def __call__(self, part: pd.DataFrame, /) -> None: ...


@contextmanager
def table_file(path: Path) -> Iterator[Write]:
    """What writes the parts of a table to a file, parquet or CSV by the end of its name.

    nan is no value there. Raises InputError for another name, OSError, ImportError without pyarrow
    for parquet.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path}: {path.suffix or path.name!r} is no format of a table: let the name end in "
            f"{' or '.join(SUFFIXES)}",
            "output",
        )
    if path.suffix.lower() == ".csv":
        with path.open("w", encoding="utf-8", newline="") as file:
            yield lambda part: part.to_csv(
                file, index=False, header=file.tell() == 0, float_format="%.10g"
            )
        return
    arrow, parquet = pyarrow()
    writer: Any = None

    def write(part: pd.DataFrame) -> None:
        nonlocal writer
        table = arrow.Table.from_pandas(part, preserve_index=False)
        if writer is None:
            writer = parquet.ParquetWriter(path, table.schema)
        writer.write_table(table.cast(writer.schema))

    with path.open("wb"):  # tells at once where nothing can be written
        pass
    try:
        yield write
    finally:
        if writer is not None:
            writer.close()
