"""What commands say: results on the standard output, everything else on that of errors.

Text is set in 80 columns, or less where the terminal is narrower, whether there is a terminal or
not: a file gets what a person sees, but for the colours.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

__all__ = ["Advance", "progress", "say", "table", "tell", "tell_error"]

WIDTH = 80


def _console(*, errors: bool = False) -> Console:
    """A console on the stream that is one now: tests put others in their places."""
    width = min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)
    return Console(stderr=errors, width=width, markup=False, highlight=False, emoji=False)


def say(text: str = "", style: str = "") -> None:
    """Print a line of the result, wrapped between words."""
    _console().print(Text(text, style=style))


def tell(text: str, style: str = "") -> None:
    """Print what is not the result: where a file went, what went wrong. Never wrapped."""
    _console(errors=True).print(Text(text, style=style), soft_wrap=True)


def tell_error(error: BaseException) -> None:
    """Print what is wrong and, below it, what was said beside."""
    tell("\n".join([_text_of(error), *getattr(error, "__notes__", ())]), "red")


def _text_of(error: BaseException) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {(error.strerror or 'cannot be used').lower()}"
    return str(error)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table: the first column to the left, numbers to the right."""
    found = Table(box=None, pad_edge=False)
    for place, column in enumerate(columns):
        found.add_column(Text(column), justify="right" if place else "left", overflow="fold")
    for row in rows:
        found.add_row(*map(Text, row))
    say(title, "bold")
    _console().print(found)


class Advance(Protocol):
    """Called with what is done, and of how much."""

    def __call__(self, done: int, of: int, /) -> None: ...


@contextmanager
def progress(doing: str) -> Iterator[Advance]:
    """A bar with what is going on, gone when it is done; only where somebody looks at it."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=_console(errors=True), transient=True) as bar:
        task = bar.add_task(doing, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)
