"""Command line: `vibroscreen calibrate survey.csv screen.toml`, `vibroscreen solve screen.toml`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import pandas as pd

from vibroscreen.calibrate import Parameter, Run, calibrate
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.screen import Screen, settings_of
from vibroscreen.survey import read_survey
from vibroscreen.units import KN, KW, MM, T_H

try:
    import typer
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.table import Table
except ImportError:
    raise SystemExit(
        "the command line needs typer and rich, which are not installed: "
        "pip install 'vibroscreen[calibrate]'"
    ) from None

__all__ = ["main"]

FITTED = ("passage.velocity", "segregation.velocity")
# Bounds of a parameter that is given without: its value over and times this, within what is legal.
REACH = 100.0

app = typer.Typer(add_completion=False, no_args_is_help=True, help="A vibrating screen.")
console = Console(soft_wrap=True, highlight=False)


def main() -> None:
    """Run the command line."""
    app()


@contextmanager
def _told() -> Iterator[None]:
    """Errors that a user can mend are told without a traceback."""
    try:
        yield
    except (ConfigError, InputError, ImportError, OSError) as error:
        said = "\n".join([str(error), *getattr(error, "__notes__", ())])
        Console(stderr=True, soft_wrap=True, markup=False).print(said)
        raise typer.Exit(code=1) from None


@app.command()
def solve(
    screen: Annotated[Path, typer.Argument(help="What the screen is, and its duty (TOML).")],
) -> None:
    """Print the steady state of a screen under its duty."""
    with _told():
        steady = Screen(ScreenConfig.load(screen)).solve_steady()
        table = steady.frame()
        sizes = zip(table["lower_m"] / MM, table["upper_m"] / MM, strict=True)
        table.index = pd.Index([f"{low:g} to {high:g}" for low, high in sizes], name="class, mm")
        rates = table.filter(like="_kg_s") / T_H
        rates.columns = [name.replace("_kg_s", "").replace("_", " ") for name in rates.columns]
        _print(rates.assign(recovery=table["recovery"]).round(4), "steady state, t/h")
        for deck in steady.decks:
            console.print(
                f"deck {deck.deck}, {deck.aperture / MM:g} mm: efficiency {deck.efficiency:.4f}, "
                f"misplaced undersize {deck.misplaced_undersize:.4f}, cut size "
                f"{deck.cut_size / MM:.4g} mm, ecart probable {deck.ecart_probable / MM:.3g} mm, "
                f"bed {deck.depth_feed / MM:.3g} to {deck.depth_discharge / MM:.3g} mm"
            )
        console.print(
            f"box: hold-up {steady.hold_up:.4g} kg, drive {steady.drive_power / KW:.3g} kW, "
            f"exciter {steady.exciter_force / KN:.4g} kN, K {steady.acceleration_number:.3g}, "
            f"P80 of the undersize {steady.undersize_p80 / MM:.4g} mm"
        )
        for name, reason in steady.alarm_reasons.items():
            console.print(f"{name}: {reason}")


@app.command(name="calibrate")
def calibrate_(
    survey: Annotated[Path, typer.Argument(help="What was measured (CSV, see README).")],
    screen: Annotated[Path, typer.Argument(help="What the screen is (TOML).")],
    fit: Annotated[
        list[str] | None,
        typer.Option(
            help="A number to fit, by the FMU's name: NAME or NAME=LOWER:UPPER (SI). Again for "
            f"more. Default: {', '.join(FITTED)}."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="The new TOML; by default SCREEN_calibrated.toml.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="A picture, measured against modelled.")] = None,
    starts: Annotated[int, typer.Option(min=1, help="Searches, from different places.")] = 8,
    leave_out: Annotated[
        bool, typer.Option(help="Fit again without each run (or group), and predict it.")
    ] = True,
) -> None:
    """Fit numbers of a screen to a survey and write it with them."""
    with _told():
        config = ScreenConfig.load(screen)
        runs = read_survey(survey, config)
        parameters = [_parameter(text, runs[0]) for text in fit or FITTED]
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
            task = progress.add_task("searching")
            result = calibrate(
                runs,
                parameters,
                starts=starts,
                leave_out=leave_out,
                progress=lambda done, of: progress.update(task, completed=done, total=of),
            )
        found = result.fit
        _print(found.frame().drop(columns=["bound_lower", "bound_upper"]), "fitted, SI units")
        names = [p.name for p in parameters]
        if len(names) > 1:
            _print(pd.DataFrame(found.correlation, names, names), "correlation")
        _print(result.frame().groupby("run", sort=False)[["residual"]].agg(_rms), "RMSE by run")
        console.print(f"RMSE of {found.measured.size} recoveries: {found.rmse:.4f}")
        if found.held_out:
            console.print(f"RMSE of runs left out of the fit: {found.held_out_rmse:.4f}")
        for warning in found.warnings:
            console.print(f"warning: {warning}", style="yellow", markup=False)
        target = output or screen.with_name(f"{screen.stem}_calibrated.toml")
        target.write_text(result.configure(config).to_toml(), encoding="utf-8")
        if plot is not None:
            from vibroscreen.report import draw_calibration

            draw_calibration(result, plot)
        console.print(f"written: {target}{f', {plot}' if plot else ''}", markup=False)


def _rms(values: pd.Series[float]) -> float:
    return float((values**2).mean() ** 0.5)


def _parameter(text: str, run: Run) -> Parameter:
    """A parameter from NAME or NAME=LOWER:UPPER."""
    name, equals, bounds = text.partition("=")
    name = name.strip()
    value = run.config.value_of(name)
    if equals:
        try:
            lower, upper = (float(bound) for bound in bounds.split(":"))
        except ValueError:
            raise InputError(
                f"--fit {text}: {bounds!r} are no bounds: write {name}=LOWER:UPPER", name
            ) from None
    elif value > 0.0:
        known = {number.name: number for number in settings_of(run.config) if number}
        least, most = known[name].limits
        lower, upper = max(value / REACH, least), min(value * REACH, most)
    else:
        raise InputError(f"{name} = {value:g} gives no bounds: write {name}=LOWER:UPPER", name)
    return Parameter(name, lower, upper, scale="log" if lower > 0.0 else "linear")


def _print(frame: pd.DataFrame, title: str) -> None:
    """A pandas table on the console."""
    table = Table(title=title)
    table.add_column(str(frame.index.name or ""), overflow="fold")
    for name in frame.columns:
        table.add_column(str(name), justify="right", overflow="fold")
    for index, row in frame.iterrows():
        table.add_row(str(index), *(f"{value:.4g}" for value in row))
    console.print(table)
