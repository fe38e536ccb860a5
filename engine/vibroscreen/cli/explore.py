"""`vibroscreen explore`: a screen as a page with the engine inside."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from vibroscreen.cli.options import ScreenFile, Set, load
from vibroscreen.cli.terminal import written
from vibroscreen.explorer import write_page

EXAMPLES = """vibroscreen explore screen.toml
vibroscreen explore screen.toml -o to_hand_on.html --no-open"""


def command(
    screen: ScreenFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="The page; by default SCREEN.html, right here."
        ),
    ] = None,
    show: Annotated[
        bool, typer.Option("--open/--no-open", help="Whether the browser opens the page.")
    ] = True,
    changes: Set = None,
) -> None:
    """Write a page with the engine inside, and open it.

    The page is one file that needs no server and no network: hand it on, open it on a telephone.
    """
    page = write_page(load(screen, changes), output or Path(f"{screen.stem}.html"))
    written(page)
    if show:
        webbrowser.open(page.resolve().as_uri())
