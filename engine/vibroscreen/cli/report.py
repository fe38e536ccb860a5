"""`vibroscreen report`: what a screen does, as one file to hand on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vibroscreen.cli.options import ScreenFile, Set, Strict, end, load
from vibroscreen.cli.terminal import progress, written
from vibroscreen.config import ScreenConfig
from vibroscreen.report import write
from vibroscreen.screen import Screen

EXAMPLES = """vibroscreen report screen.toml
vibroscreen report screen.toml -o screen.pdf --specification product.csv
vibroscreen report screen.toml --compare other.toml -o both.html
vibroscreen report screen.toml --compare screen.toml --set feed.rate_t_h=350"""


def command(
    screen: ScreenFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="The report: .html or .pdf; by default SCREEN_report.html.",
        ),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(metavar="SCREEN", help="Another screen (TOML), side by side with the first."),
    ] = None,
    specification: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="Limits of the products' gradations: size_mm, least_percent, most_percent, and "
            "product where it is not the undersize.",
        ),
    ] = None,
    changes: Set = None,
    strict: Strict = False,
) -> None:
    """Write what a screen does as one file to hand on: HTML or PDF."""
    target = output or screen.with_name(f"{screen.stem}_report.html")
    with progress("drawing"):
        steady = Screen(load(screen, changes)).solve_steady()
        other = None if compare is None else Screen(ScreenConfig.load(compare)).solve_steady()
        write(steady, target, other, specification or ())
    written(target)
    end([*steady.alarms, *(other.alarms if other else ())], strict=strict)
