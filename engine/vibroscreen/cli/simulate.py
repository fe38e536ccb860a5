"""`vibroscreen simulate`: a screen through time, under a series of feeds and motions."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vibroscreen.cli.options import Csv, Json, Plot, ScreenFile, Set, Strict, end, load, one_format
from vibroscreen.cli.solved import labels_of, two_lines
from vibroscreen.cli.terminal import finite, picture, progress, say, say_json, table
from vibroscreen.config import ScreenConfig
from vibroscreen.report.pictures import COLOURS, DASHES, FEED, STEEL, deck_name, styled
from vibroscreen.results import StepResult
from vibroscreen.series import Series, figures_of_step, read_series, run_series
from vibroscreen.units import HOUR, KW, KWH, MINUTE, TONNE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = """vibroscreen simulate screen.toml series.csv
vibroscreen simulate screen.toml series.csv --step 5 --plot shift.png
vibroscreen simulate screen.toml series.csv --set bed.initial=steady --csv > shift.csv"""

Row = dict[str, Any]

SHOWN = 24  # rows that are printed for people


def command(
    screen: ScreenFile,
    series: Annotated[
        Path,
        typer.Argument(
            metavar="SERIES",
            help="Feed and motion through time (CSV): time_s, rate_t_h, passing_16_mm, "
            "frequency_hz, stroke_mm, ...; see the guide.",
        ),
    ],
    step: Annotated[
        float | None,
        typer.Option(metavar="S", help="Longest step, s; by default the interval of the series."),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="End of the run, s since the first row; by default an interval after the last.",
        ),
    ] = None,
    changes: Set = None,
    as_json: Json = False,
    as_csv: Csv = False,
    plot: Plot = None,
    strict: Strict = False,
) -> None:
    """Run a screen through a series of feeds and motions in time."""
    one_format(json=as_json, csv=as_csv)
    config = load(screen, changes)
    through = read_series(series, config)
    steps: list[StepResult] = []
    rows: list[Row] = []
    with progress("simulating") as advance:
        for time, result in run_series(config, through, step, until, advance):
            rows.append(_row(time, through, result))
            steps = [result]
    alarms = _alarms(rows)
    if as_json:
        say_json({"name": config.name, "rows": rows})
    elif as_csv:
        _write_csv(rows)
    else:
        _print(config, rows, steps[-1], alarms)
    if plot is not None:
        picture(_drawn(config, rows), plot)
    end(list(alarms), strict=strict)


def _row(time: float, series: Series, result: StepResult) -> Row:
    """What a step gave, in the units of the keys: means over it, and the state at its end."""
    row: Row = {"time_s": time}
    if stamp := series.moment_of(time):
        row["time"] = stamp
    row.update({key: finite(value) for key, value in figures_of_step(result).items()})
    row["alarms"] = " ".join(result.alarms)
    return row


def _alarms(rows: Sequence[Row]) -> dict[str, tuple[float, float]]:
    """Time at which each alarm was first set, and for how long it was [s]."""
    found: dict[str, tuple[float, float]] = {}
    before = 0.0
    for row in rows:
        for name in row["alarms"].split():
            first, lasted = found.get(name, (row["time_s"], 0.0))
            found[name] = (first, lasted + row["time_s"] - before)
        before = row["time_s"]
    return found


def _write_csv(rows: Sequence[Row]) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(rows[0])
    for row in rows:
        writer.writerow(
            f"{value:.10g}" if isinstance(value, float) else value for value in row.values()
        )


def _print(
    config: ScreenConfig, rows: Sequence[Row], last: StepResult, alarms: dict[str, Any]
) -> None:
    every = math.ceil(len(rows) / SHOWN)
    shown = [*rows[every - 1 :: every]]
    if shown[-1] is not rows[-1]:
        shown.append(rows[-1])
    decks = len(config.decks)
    names = [name for name in rows[0] if name.endswith("_t_h")]
    labels = labels_of(decks)
    depths = [f"deck[{k}].depth_discharge_mm" for k in range(1, decks + 1)]
    dated = "time" in rows[0]
    days = {row["time"].split()[0] for row in rows} if dated else set()
    lines = [
        (
            row["time"].split()[-1] if len(days) == 1 else row.get("time", f"{row['time_s']:g}"),
            *(f"{row[name]:.1f}" for name in names),
            *(f"{row[name]:.3g}" for name in depths),
            f"{row['drive_power_kw']:.1f}",
            "!" if row["alarms"] else "",
        )
        for row in shown
    ]
    say(f"{config.name}: {rows[-1]['time_s']:g} s in {len(rows)} steps", "bold")
    say()
    beds = [f"bed {k}\nmm" for k in range(1, decks + 1)] if decks > 1 else ["bed\nmm"]
    heads = [f"{label}\nt/h" if decks == 1 else two_lines(label) for label in labels]
    first = min(days) if len(days) == 1 else "time"
    table(
        "At the end of steps; rates in t/h, as means over them",
        (f"{first}\n{'' if dated else 's'}", *heads, *beds, "drive\nkW", ""),
        lines,
    )
    if every > 1:
        say(f"Every {every} steps; --csv gives all", "dim")
    say()
    energy = _energy(rows)
    fed, *products = (_mass(rows, name) for name in names)
    told = ", ".join(f"{label} {m:.4g} t" for label, m in zip(labels[1:], products, strict=True))
    say(f"In all: fed {fed:.4g} t, {told}, {last.hold_up / TONNE:.3g} t on the decks")
    specific = f", {energy / fed:.3g} kWh/t of feed" if fed > 0.0 else ""
    say(f"Drive: {energy:.4g} kWh{specific}")
    for name, (first, lasted) in alarms.items():
        say(f"{name}: first at {first:g} s, {lasted:g} s in all", "yellow")
    if last.alarm_reasons:
        for name, reason in last.alarm_reasons.items():
            say(f"{name} at the end: {reason}", "yellow")
    if not alarms:
        say("No alarms")


def _durations(rows: Sequence[Row]) -> list[float]:
    ends = [row["time_s"] for row in rows]
    return [later - one for one, later in zip([0.0, *ends[:-1]], ends, strict=True)]


def _mass(rows: Sequence[Row], name: str) -> float:
    """Mass of a stream over the run [t]."""
    parts = zip(_durations(rows), rows, strict=True)
    return math.fsum(time * row[name] for time, row in parts) / HOUR


def _energy(rows: Sequence[Row]) -> float:
    """Electric energy of the drive [kWh]: the power at the end of a step over it."""
    parts = zip(_durations(rows), rows, strict=True)
    return math.fsum(time * row["drive_power_kw"] * KW for time, row in parts) / KWH


def _drawn(config: ScreenConfig, rows: Sequence[Row]) -> Figure:
    """Streams, beds and power over the time; shaded where an alarm is set."""
    last = rows[-1]["time_s"]
    units = (("h", HOUR, 3.0 * HOUR), ("min", MINUTE, 5.0 * MINUTE), ("s", 1.0, 0.0))
    unit, factor, _ = next(one for one in units if last > one[2])
    times = [0.0, *(row["time_s"] / factor for row in rows)]
    with styled():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.4, 6.0), layout="constrained")
        streams, beds, power = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1, 1))
        names = (name for name in rows[0] if name.endswith("_t_h"))
        lines = zip(cycle(COLOURS), cycle(DASHES), strict=False)
        looks = [{"color": colour, "linestyle": dashes} for colour, dashes in islice(lines, 5)]
        labels = labels_of(len(config.decks))
        looks_of_streams = [{"color": FEED}, *looks[: len(labels) - 1]]
        for name, label, look in zip(names, labels, looks_of_streams, strict=True):
            means = [rows[0][name], *(row[name] for row in rows)]
            streams.step(times, means, where="pre", label=label, **look)
        for k, (deck, look) in enumerate(zip(config.decks, looks, strict=False), start=1):
            depths = [row[f"deck[{k}].depth_discharge_mm"] for row in rows]
            beds.plot(times[1:], depths, label=deck_name(k, deck), **look)
        power.plot(times[1:], [row["drive_power_kw"] for row in rows], color=STEEL)
        alarms = [bool(rows[0]["alarms"]), *(bool(row["alarms"]) for row in rows)]
        for axes in (streams, beds, power):
            across = axes.get_xaxis_transform()
            shade = {"color": "#d55e00", "alpha": 0.15, "linewidth": 0}
            axes.fill_between(times, 0, 1, alarms, step="pre", transform=across, **shade)
        streams.set(title=config.name[:80], ylabel="t/h (shaded: alarms)", ylim=(0.0, None))
        beds.set(ylabel="bed at the\ndischarge [mm]", ylim=(0.0, None))
        power.set(ylabel="drive [kW]", xlabel=f"time [{unit}]", ylim=(0.0, None))
        for axes in (streams, beds):
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure
