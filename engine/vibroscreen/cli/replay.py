"""`vibroscreen replay`: a plant's data through a screen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from vibroscreen.cli.options import Json, Plot, ScreenFile, Set, Strict, end, load
from vibroscreen.cli.solved import labels_of
from vibroscreen.cli.terminal import picture, progress, say, say_json, table, written
from vibroscreen.config import ScreenConfig
from vibroscreen.replay import Limits, PlantData, Source, Summary, read_plant, replay, table_file
from vibroscreen.replay.fmu import fmu_stepper
from vibroscreen.replay.run import Engine, Stepper
from vibroscreen.replay.track import TRACKED, Track, track
from vibroscreen.units import DAY, HOUR, MINUTE, PERCENT, TONNE

EXAMPLES = """vibroscreen replay plant.csv screen.toml --time Time --rate WI101.PV --plot day.png
vibroscreen replay plant.parquet screen.toml --column undersize_t_h=WI103 --gap stop -o day.parquet
vibroscreen replay plant.csv screen.toml --track open_area --plot blinding.png
vibroscreen replay plant.csv screen.toml --time-format '%d.%m.%Y %H:%M' --zone Europe/Prague"""


def command(
    plant: Annotated[
        Path, typer.Argument(metavar="PLANT", help="A historian's export (CSV or parquet).")
    ],
    screen: ScreenFile,
    time: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMN", help="Column of times; else time, time_s, time_min, time_h."
        ),
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(metavar="COLUMN", help="Column of the feed rate of dry solids, t/h."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=COLUMN",
            help="Column of another number, its unit in the key: frequency_rpm, stroke_mm, "
            "passing_16_mm, rate_kg_s, and products as measured: undersize_t_h, oversize_t_h, "
            "intermediate[1]_t_h; again for more. Columns with such names need none.",
        ),
    ] = None,
    gap: Annotated[
        str,
        typer.Option(
            metavar="hold|stop|interpolate",
            help="What is fed where there is no number: the last one, nothing, or between.",
        ),
    ] = "hold",
    time_format: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Of times that are not ISO 8601: as %d.%m.%Y %H:%M, or s, min, h, unix.",
        ),
    ] = None,
    zone: Annotated[
        str | None, typer.Option(help="Zone of times without one, as Europe/Prague.")
    ] = None,
    gap_min: Annotated[
        float | None,
        typer.Option(help="Rows further apart have a gap between them; else 3 usual intervals."),
    ] = None,
    stuck_min: Annotated[
        float, typer.Option(help="A rate that stays the same for longer is marked; 0: never.")
    ] = Limits.stuck / MINUTE,
    spike: Annotated[
        float,
        typer.Option(help="A rate so many times the usual scatter off is left out; 0: never."),
    ] = Limits.spike,
    follow: Annotated[
        str | None,
        typer.Option(
            "--track",
            metavar="open_area|passage",
            help="Follow this number of the screen by the measured products: blinding shows.",
        ),
    ] = None,
    track_min: Annotated[
        float, typer.Option(help="Time over which products are summed for --track, min.")
    ] = 10.0,
    fmu: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Run this FMU of the screen in the engine's place."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write a row for every row: .parquet or .csv."),
    ] = None,
    changes: Set = None,
    as_json: Json = False,
    plot: Plot = None,
    strict: Strict = False,
) -> None:
    """Run a screen through a plant's data, beside what was measured."""
    config = load(screen, changes)
    source = Source(time, time_format, zone, _columns(rate, column or ()))
    limits = Limits(spike, stuck_min * MINUTE, None if gap_min is None else gap_min * MINUTE)
    data = read_plant(plant, config, source, gap, limits)
    tracked = None
    if follow is not None:
        with progress("tracking") as advance:
            tracked = track(config, data, follow, track_min * MINUTE, progress=advance)
    summary = Summary(tuple(data.products))
    curves = None
    with ExitStack() as stack:
        takers: list[Callable[[pd.DataFrame], None]] = [summary.add]
        if output is not None:
            takers.append(stack.enter_context(table_file(output)))
        if plot is not None:
            from vibroscreen.replay.pictures import Curves, draw

            curves = Curves(data)
            takers.append(curves.add)
        stepper: Callable[[ScreenConfig], Stepper] = Engine
        if fmu is not None:
            stepper = stack.enter_context(fmu_stepper(fmu))
        advance = stack.enter_context(progress("replaying"))
        for part in replay(config, data, stepper, advance):
            if tracked is not None:
                part = tracked.beside(part)
            for take in takers:
                take(part)
    if output is not None:
        written(output)
    if as_json:
        say_json(_tree(config, data, summary, tracked))
    else:
        _print(config, data, summary)
        if tracked is not None:
            _print_track(tracked, data)
    if plot is not None and curves is not None:
        picture(draw(config, data, curves, tracked), plot)
    end(list(summary.alarms), strict=strict)


def _columns(rate: str | None, told: Sequence[str]) -> dict[str, str]:
    """Columns by key of what was told."""
    found = {} if rate is None else {"rate_t_h": rate}
    for text in told:
        key, equals, name = (part.strip() for part in text.partition("="))
        if not (key and equals and name):
            raise typer.BadParameter(
                f"{text!r} is not KEY=COLUMN: write --column undersize_t_h=WI103",
                param_hint="--column",
            )
        found[key] = name
    return found


def _print(config: ScreenConfig, data: PlantData, summary: Summary) -> None:
    say(f"{config.name}: {_length(data.end)} in {summary.rows} rows of {data.interval:g} s", "bold")
    if data.start is not None:
        say(f"{data.moment(0.0)} to {data.moment(data.end)}")
    say()
    table(
        "Data",
        ("column", "what was found", "rows", "first"),
        [(f.column, f.what, str(f.rows), f.first) for f in data.findings],
        left=2,
    )
    if not data.findings:
        say("Nothing is missing or odd")
    share = summary.filled / summary.rows / PERCENT
    say(f"{summary.filled} of {summary.rows} rows have a number filled in, {share:.3g} %")
    say()
    if summary.compared:
        table(
            "Products, means over the time in which they were measured, t/h",
            ("", "hours", "model", "measured", "apart", "rms by row"),
            [
                (
                    one.product,
                    f"{one.hours:.4g}",
                    f"{one.modelled:.1f}",
                    f"{one.measured:.1f}",
                    f"{one.modelled - one.measured:+.1f}",
                    f"{one.rms:.1f}",
                )
                for one in summary.compared
            ],
        )
        say()
    fed, *products = summary.masses.values()
    labels = labels_of(len(config.decks))[1:]
    told = ", ".join(f"{label} {m:.4g} t" for label, m in zip(labels, products, strict=True))
    held = summary.last["hold_up_kg"] / TONNE
    say(f"In all: fed {fed:.4g} t, {told}, {held:.3g} t on the decks")
    say(f"Drive: {summary.energy:.4g} kWh")
    for name, (first, lasted) in summary.alarms.items():
        say(f"{name}: first at {data.moment(first)}, {_length(lasted)} in all", "yellow")
    if not summary.alarms:
        say("No alarms")


def _print_track(found: Track, data: PlantData) -> None:
    """The factor at the start, at the end, and where it is least."""
    places = {"first": 0, "least": int(found.factor.argmin()), "last": -1}
    say()
    level = f"{found.level / PERCENT:g} % interval"
    table(
        f"Followed: {TRACKED[found.number]} over that of the file, {level}",
        ("", "at", "factor", "from", "to"),
        [
            (
                name,
                data.moment(found.seconds[k]),
                *(f"{row[k]:.3f}" for row in (found.factor, found.lower, found.upper)),
            )
            for name, k in places.items()
        ],
        left=2,
    )
    if found.falls:
        say(f"The {TRACKED[found.number]} falls: the decks blind, or what is fed changed", "yellow")


def _length(seconds: float) -> str:
    """A time as people say it."""
    for unit, size in (("d", DAY), ("h", HOUR), ("min", MINUTE)):
        if seconds > 2.0 * size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds:.4g} s"


def _tree(
    config: ScreenConfig, data: PlantData, summary: Summary, found: Track | None
) -> dict[str, Any]:
    """All but the rows, for `json.dumps`."""
    return {
        "name": config.name,
        "rows": summary.rows,
        "filled": summary.filled,
        "interval_s": data.interval,
        "first": data.moment(0.0),
        "last": data.moment(data.end),
        "findings": [finding._asdict() for finding in data.findings],
        "masses_t": summary.masses,
        "hold_up_kg": summary.last["hold_up_kg"],
        "energy_kwh": summary.energy,
        "compared_t_h": [one._asdict() for one in summary.compared],
        "alarms": [
            {"name": name, "first": data.moment(first), "lasted_s": lasted}
            for name, (first, lasted) in summary.alarms.items()
        ],
        "track": None
        if found is None
        else {
            "number": found.number,
            "level": found.level,
            "noise": found.noise,
            "falls": found.falls,
            "at": [data.moment(second) for second in found.seconds],
            "factor": found.factor.tolist(),
            "lower": found.lower.tolist(),
            "upper": found.upper.tolist(),
        },
    }
