"""Arguments and options that commands share."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from vibroscreen.config import ScreenConfig

__all__ = [
    "Csv",
    "Json",
    "Plot",
    "Scheduler",
    "ScreenFile",
    "Set",
    "Strict",
    "assignments",
    "cluster",
    "end",
    "load",
    "one_format",
]

ScreenFile = Annotated[
    Path, typer.Argument(metavar="SCREEN", help="What the screen is, and its duty (TOML).")
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-s",
        metavar="KEY=VALUE",
        help="Another value for a key of the file, for this run; again for more. "
        "KEY= takes a key out.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Solve on a cluster of dask.distributed."),
]
Json = Annotated[bool, typer.Option("--json", help="Print it for machines, as JSON.")]
Csv = Annotated[bool, typer.Option("--csv", help="Print it for machines, as CSV.")]
Plot = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE", help="A picture: .png, .svg or .pdf."),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="End with exit code 3 where an alarm is set.")
]


def load(path: Path, changes: Sequence[str] | None) -> ScreenConfig:
    """The screen of a file, with what was set for this run."""
    return ScreenConfig.load(path, assignments(changes))


def assignments(changes: Sequence[str] | None) -> dict[str, Any]:
    """Values by key of what was set."""
    return dict(_assignment(text) for text in changes or ())


def _assignment(text: str) -> tuple[str, Any]:
    """Key and value of KEY=VALUE; a value that is not TOML is a text, an empty one None."""
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not key:
        raise typer.BadParameter(
            f"{text!r} is not KEY=VALUE: write --set 'deck[1].panel[1].aperture_mm=18'",
            param_hint="--set",
        )
    if not value:
        return key, None
    try:
        return key, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        pass
    try:
        return key, float(value)  # .5 is a number, though none of TOML
    except ValueError:
        return key, value


def one_format(*, json: bool, csv: bool) -> None:
    """Refuse both at once."""
    if json and csv:
        raise typer.BadParameter(
            "--json and --csv exclude each other: give one", param_hint="--csv"
        )


def end(alarms: Sequence[str], *, strict: bool) -> None:
    """End with 3 where there are alarms and that was asked for."""
    if strict and alarms:
        raise typer.Exit(code=3)


def cluster(address: str | None, stack: ExitStack) -> Executor | None:
    """The workers of a scheduler, which starts a task anew where a worker is lost; or none."""
    if address is None:
        return None
    import logging

    from distributed import Client

    # It would print traces of what is said in a line when the scheduler is gone.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = stack.enter_context(Client(address, timeout=10))
    except OSError as error:
        raise OSError(f"no scheduler answers at {address}: {error}") from None
    executor: Executor = client.get_executor(retries=5)
    return executor
