"""Where the evidence lies, and what a section of VALIDATION.md holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["DATA", "PICTURES", "REPORT", "SCREENS", "Section", "table"]

HERE = Path(__file__).resolve().parent
DATA = HERE / "data"
REPORT = HERE / "VALIDATION.md"
PICTURES = HERE  # of the report, beside it
SCREENS = HERE.parents[1] / "plant_examples" / "screens"


@dataclass(frozen=True)
class Section:
    """One data set of the validation: its title, the command for its figures, and its writer.

    `write(pictures)` draws its pictures into that folder (file names without spaces) and returns
    the Markdown text below the title; a picture is linked as `![what it shows](NAME)`.
    It says what was fitted, what was held out, the error and the target.
    """

    title: str
    command: str
    write: Callable[[Path], str]


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Markdown table; columns after the first are set to the right, numbers as they are given."""
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"row {row!r} has {len(row)} cells, the head {len(head)}")
        lines.append("| " + " | ".join(str(cell) for cell in row) + " |")
    return "\n".join(lines) + "\n"
