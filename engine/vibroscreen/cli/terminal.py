"""What commands say: results on the standard output, everything else on that of errors.

Text is set in 80 columns, or less where the terminal is narrower, whether there is a terminal or
not: a file gets what a person sees, but for the colours.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rich.console import Console, JustifyMethod
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

import vibroscreen
from vibroscreen.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Advance",
    "finite",
    "picture",
    "progress",
    "row_of",
    "say",
    "say_json",
    "table",
    "tell",
    "tell_error",
    "told",
    "written",
]

WIDTH = 80


def _console(*, errors: bool = False) -> Console:
    """A console on the stream that is one now: tests put others in their places."""
    width = min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)
    return Console(stderr=errors, width=width, markup=False, highlight=False, emoji=False)


def _text(text: str, style: str = "") -> Text:
    """Text that is shown as it is: no markup, and nothing that a terminal takes for an order."""
    shown = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    return Text(shown, style=style)


def say(text: str = "", style: str = "") -> None:
    """Print a line of the result, wrapped between words."""
    _console().print(_text(text, style))


def say_json(document: Mapping[str, Any]) -> None:
    """Print a result for machines, with the version that found it."""
    whole = {"version": vibroscreen.__version__, **document}
    print(json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False))


def finite(value: float) -> float | None:
    """A number as JSON takes it: None for what is none."""
    return float(value) if math.isfinite(value) else None


def row_of(row: Mapping[Hashable, Any]) -> dict[str, str | bool | float | None]:
    """A row of a table as JSON takes it."""
    return {
        str(name): value if isinstance(value, str | bool) else finite(value)
        for name, value in row.items()
    }


def tell(text: str, style: str = "") -> None:
    """Print what is not the result: where a file went, what went wrong. Never wrapped."""
    _console(errors=True).print(_text(text, style), soft_wrap=True)


def tell_error(error: BaseException) -> None:
    """Print what is wrong and, below it, what was said beside."""
    tell(told(error), "red")


def told(error: BaseException) -> str:
    """What is wrong, and what was said beside."""
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {(error.strerror or 'cannot be used').lower()}"
    if isinstance(error, MemoryError):
        text = (
            "there is not enough memory for this screen: give fewer bed.layers, solver.packages or "
            "size classes"
        )
    return "\n".join([text, *getattr(error, "__notes__", ())])


def written(*files: Path) -> None:
    """Print which files were written."""
    tell(f"written: {', '.join(map(str, files))}")


def picture(figure: Figure, path: Path) -> None:
    """Write a picture in the format that its name ends in. Raises InputError for none."""
    try:
        figure.savefig(path)
    except ValueError:
        raise InputError(
            f"--plot {path}: {path.suffix or path.name!r} is no format of a picture: let the name "
            "end in .png, .svg or .pdf"
        ) from None
    written(path)


def table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    left: int = 1,
    colours: Sequence[str] = (),
) -> None:
    """Print a table: so many columns to the left, numbers to the right.

    colours: of the first cell of every row.
    """
    found = Table(box=None, pad_edge=False, show_header=any(columns))
    for place, column in enumerate(columns):
        justify: JustifyMethod = "left" if place < left else "right"
        found.add_column(_text(column), justify=justify, overflow="fold")
    for place, row in enumerate(rows):
        cells = [*map(_text, row)]
        if colours:
            cells[0].stylize(colours[place])
        found.add_row(*cells)
    if title:
        say(title, "bold")
    _console().print(found)


class Advance(Protocol):
    """Called with what is done, and of how much."""

    def __call__(self, done: float, of: float, /) -> None: ...


@contextmanager
def progress(doing: str) -> Iterator[Advance]:
    """A bar with what is going on, gone when it is done; only where somebody looks at it."""
    console = _console(errors=True)
    if not console.is_terminal:
        yield lambda done, of: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(doing, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)
