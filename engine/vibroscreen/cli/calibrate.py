"""`vibroscreen calibrate`: numbers of the model from a survey."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vibroscreen.calibrate import Calibration, Parameter, Run, calibrate
from vibroscreen.cli.options import Plot, ScreenFile
from vibroscreen.cli.terminal import picture, progress, say, table, tell, written
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.screen import settings_of
from vibroscreen.sections import BESIDE
from vibroscreen.survey import read_survey
from vibroscreen.survey.streams import StreamRun
from vibroscreen.sweep import cores

if TYPE_CHECKING:
    import pandas as pd

FITTED = ("passage.velocity", "segregation.velocity")  # or what they are over the aperture
# Bounds of a parameter that is given without: its value over and times this, within what is legal.
REACH = 100.0
EXAMPLES = """vibroscreen calibrate survey.csv screen.toml
vibroscreen calibrate survey.csv screen.toml --fit passage.relative_velocity=.1:10 --plot a.png"""


def command(
    survey: Annotated[
        Path, typer.Argument(metavar="SURVEY", help="What was measured (CSV, XLSX).")
    ],
    screen: ScreenFile,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=LOWER:UPPER]",
            help="A number to fit, by the FMU's name, with its bounds in SI units. Again for more. "
            f"Default: {', '.join(FITTED)}, or relative_velocity where the screen has that.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The new TOML; by default SCREEN_calibrated.toml."),
    ] = None,
    plot: Plot = None,
    starts: Annotated[int, typer.Option(min=1, help="Searches, from different places.")] = 8,
    intervals: Annotated[
        str | None,
        typer.Option(
            help="linear, from slopes, or profile, which holds where numbers make up for each "
            "other. Default: profile for streams, linear for recoveries."
        ),
    ] = None,
    loss: Annotated[
        str,
        typer.Option(help="linear, or huber or cauchy, by which gross errors count for less."),
    ] = "linear",
    leave_out: Annotated[
        bool,
        typer.Option(help="Fit again without each run (or group) and each kind, and predict it."),
    ] = True,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Searches side by side; by default one a core.")
    ] = None,
) -> None:
    """Fit numbers of a screen to a survey and write it with them."""
    config = ScreenConfig.load(screen)
    runs = read_survey(survey, config)
    parameters = [_parameter(text, runs[0]) for text in fit or _usual(config)]
    with progress("searching") as advance, ThreadPoolExecutor(workers or cores()) as executor:
        result = calibrate(
            runs,
            parameters,
            starts=starts,
            leave_out=leave_out,
            progress=advance,
            intervals=intervals,
            loss=loss,
            executor=executor,
        )
    _tell(result, by_streams=any(isinstance(run, StreamRun) for run in runs))
    target = output or screen.with_name(f"{screen.stem}_calibrated.toml")
    target.write_text(result.configure(config).to_toml(), encoding="utf-8")
    written(target)
    if plot is not None:
        picture(result.plot(), plot)


def _tell(result: Calibration, *, by_streams: bool) -> None:
    """What was fitted, how well, and what not to trust; of streams errors in standard errors."""
    found = result.fit
    _print(found.frame().drop(columns=["bound_lower", "bound_upper"]), "Fitted, SI units")
    names = [p.name for p in found.parameters]
    if len(names) > 1:
        rows = zip(names, found.correlation, strict=True)
        table("Correlation", ("", *names), [(name, *map(_text, row)) for name, row in rows])
    frame = result.frame()
    unit = frame["sigma"] if by_streams else 1.0
    of_runs = "RMSE by run, in sigmas" if by_streams else "RMSE by run"
    frame["residual"] /= unit
    _print(frame.groupby("run", sort=False)[["residual"]].agg(_rms), of_runs)
    if by_streams:
        say(f"RMSE of {len(frame)} rates and shares: {_rms(frame['residual']):.3f} standard errors")
    else:
        say(f"RMSE of {found.measured.size} recoveries: {found.rmse:.4f}")
    if found.held_out:
        errors = _rms((frame["held_out"] - frame["measured"]) / unit)
        shown = f"{errors:.3f} standard errors" if by_streams else f"{errors:.4f}"
        left_out = found.left_out_frame()
        _print(
            left_out.drop(columns="rmse" if by_streams else "in_sigmas"),
            "Left out of the fit: RMSE of it, and what the others give",
        )
        say(f"RMSE of runs left out of the fit: {shown}")
    for warning in found.warnings:
        tell(f"warning: {warning}", "yellow")


def _rms(values: pd.Series[float]) -> float:
    return float((values**2).mean() ** 0.5)


def _usual(config: ScreenConfig) -> list[str]:
    """Both velocities, in m/s or over the aperture as the screen has them."""
    return [name if config.value_of(name) > 0.0 else BESIDE[name] for name in FITTED]


def _parameter(text: str, run: Run | StreamRun) -> Parameter:
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


def _text(value: float) -> str:
    return f"{value:.4g}"


def _print(frame: pd.DataFrame, title: str) -> None:
    """A pandas table, its index first."""
    columns = (str(frame.index.name or ""), *map(str, frame.columns))
    table(title, columns, [(str(index), *map(_text, row)) for index, row in frame.iterrows()])
