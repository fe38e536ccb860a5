"""Arguments and options that commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["Plot", "ScreenFile"]

ScreenFile = Annotated[
    Path, typer.Argument(metavar="SCREEN", help="What the screen is, and its duty (TOML).")
]
Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE", help="A picture; .png, .svg or .pdf."),
]
