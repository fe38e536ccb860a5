"""Reports that a plant engineer hands on, as one file, and pictures of results."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.report.pictures import (
    draw_bed,
    draw_calibration,
    draw_gradation,
    draw_map,
    draw_partition,
    draw_recovery,
    draw_result,
    draw_sketch,
    draw_table,
    picture,
)
from vibroscreen.report.specification import Specification, read_specification
from vibroscreen.screen import Screen
from vibroscreen.steady import SteadyResult

__all__ = [
    "Specification",
    "draw_bed",
    "draw_calibration",
    "draw_gradation",
    "draw_map",
    "draw_partition",
    "draw_recovery",
    "draw_result",
    "draw_sketch",
    "draw_table",
    "html",
    "picture",
    "read_specification",
    "write",
]

What = ScreenConfig | Screen | SteadyResult


def write(
    screen: What,
    path: str | Path,
    compare: What | None = None,
    specification: str | Path | Sequence[Specification] = (),
) -> Path:
    """Write a report of a screen's steady state, .html or .pdf by the suffix of `path`.

    screen: a configuration, under its duty; a screen, the same; or a steady state that was found.
    compare: another one, side by side. specification: limits of the products' gradations, or the
    CSV file with them (`read_specification`). Raises InputError, ImportError without what the
    extra `report` brings, OSError.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".html", ".htm", ".pdf"):
        raise InputError(f"report = {path} has no suffix that says its format: give .html or .pdf")
    page = html(screen, compare, specification)
    if suffix == ".pdf":
        from vibroscreen.report.page import print_page

        print_page(page, path)
    else:
        path.write_text(page, encoding="utf-8")
    return path


def html(
    screen: What,
    compare: What | None = None,
    specification: str | Path | Sequence[Specification] = (),
) -> str:
    """The page that `write` writes."""
    from vibroscreen.report.contents import Sheet
    from vibroscreen.report.page import fill

    if isinstance(specification, str | Path):
        specification = read_specification(specification)
    screens = [screen] if compare is None else [screen, compare]
    marks = [""] if compare is None else ["A", "B"]
    sheets = [
        Sheet(_steady(one), tuple(specification), mark)
        for one, mark in zip(screens, marks, strict=True)
    ]
    return fill(sheets, date.today())


def _steady(screen: What) -> SteadyResult:
    """The steady state of a screen under its duty."""
    if isinstance(screen, ScreenConfig):
        screen = Screen(screen)
    return screen.solve_steady() if isinstance(screen, Screen) else screen
