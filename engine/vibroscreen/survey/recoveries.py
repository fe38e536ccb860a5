"""Surveys by size class: what was fed and what part of it passed, on decks or in batches.

A row is a size class of a run (and a time of a batch). Columns:

    run                        name of the run
    lower_mm, upper_mm         limits of the class
    rate_t_h                   feed of the run, with feed_fraction and recovery by class; or
    feed_t_h, undersize_t_h, oversize_t_h      two of them by class, or all three; or
    areal_mass_kg_m2, time_s   of a batch on a plate, with feed_fraction and recovery by class
    feed_fraction, recovery    share of the feed; part that reached the undersize, empty if unknown
    sigma                      standard error of the recovery; without it all count alike
    group                      runs that are left out together; without it each by itself
    any number of the screen   by the name of the FMU's variable, in SI units, the same in all rows
                               of a run: deck[1].panel[1].aperture, motion.frequency
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.fields import nearest
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import SUM_TOLERANCE, Feed
from vibroscreen.survey.calibrate import Run
from vibroscreen.survey.read import sheets_of
from vibroscreen.survey.streams import StreamRun, stream_runs
from vibroscreen.survey.table import Row, Table, number, read_tables, told_of_run
from vibroscreen.units import MM, T_H

__all__ = ["read_survey"]

Array = NDArray[np.float64]

LIMITS = ("lower_mm", "upper_mm")
STREAMS = ("feed_t_h", "undersize_t_h", "oversize_t_h")
BATCH = ("areal_mass_kg_m2", "time_s")
COLUMNS = (
    "run",
    *LIMITS,
    "rate_t_h",
    "feed_fraction",
    "recovery",
    *STREAMS,
    *BATCH,
    "sigma",
    "group",
    "moisture_pct",
)
# A recovery may err beyond 0 and 1 by what is measured; more is another unit.
BEYOND = 0.2


def read_survey(path: str | Path, config: ScreenConfig) -> tuple[Run | StreamRun, ...]:
    """Runs of a survey on a screen; what a run does not say is that of the configuration.

    Sheets of streams, and three or more streams by class, are runs by what was measured; other
    surveys are runs by recoveries. Raises InputError with the place and column of what cannot be
    used, OSError, ImportError.
    """
    try:
        tables = read_tables(Path(path))
        if not any(_by_streams(table.columns) for table in tables):
            return tuple(run for table in tables for run in _runs_of(table, config))
        survey = sheets_of(tables)
        for note in survey.notes:
            warnings.warn(note, stacklevel=2)
        return stream_runs(survey, config)
    except (ConfigError, InputError) as error:
        error.add_note(f"in {path}")
        raise


def _by_streams(columns: Sequence[str]) -> bool:
    """Whether a table tells streams, so many that they are to be reconciled."""
    classes = [name for name in columns if name.endswith("_t_h") and name != "rate_t_h"]
    return "recovery" not in columns and ("lower_mm" not in columns or len(classes) > 2)


def _runs_of(table: Table, config: ScreenConfig) -> tuple[Run, ...]:
    """Runs of a table on a screen; what a run does not say is that of the configuration.

    Raises InputError with the line and column of what cannot be used.
    """
    _check_columns(table.columns, config)
    runs: dict[str, list[Row]] = {}
    for row in table.rows:
        runs.setdefault(row.cells["run"], []).append(row)
    if not runs:
        raise InputError("survey holds no rows: give one for every class of every run", "survey")
    if "moisture_pct" in table.columns:
        warnings.warn(
            "the rates are taken as of dry solids, moisture_pct does not change them: where they "
            "are wet multiply them by 1 - moisture",
            stacklevel=2,
        )
    return tuple(_run(name, rows, config) for name, rows in runs.items())


def _check_columns(names: Sequence[str], config: ScreenConfig) -> None:
    for name in names:
        if name in COLUMNS:
            continue
        try:
            config.value_of(name)
        except ConfigError:
            raise InputError(
                f"column {name!r} is unknown: did you mean {nearest(name, COLUMNS)!r}? Besides, "
                "numbers of the screen may be given by the names of the FMU's variables",
                name,
            ) from None
    streams = [name for name in STREAMS if name in names]
    batch = [name for name in BATCH if name in names]
    needed = ["run", *LIMITS]
    if len(batch) > 0:
        needed += [*BATCH, "feed_fraction", "recovery"]
    elif len(streams) < 2:
        needed += ["rate_t_h", "feed_fraction", "recovery"]
    for name in needed:
        if name not in names:
            raise InputError(
                f"column {name!r} is missing: a survey has run, lower_mm, upper_mm and either "
                "rate_t_h, feed_fraction, recovery or two of feed_t_h, undersize_t_h, "
                "oversize_t_h or areal_mass_kg_m2, time_s, feed_fraction, recovery",
                name,
            )
    both = [name for name in ("recovery", "feed_fraction", "rate_t_h") if name in names]
    if len(streams) > 0 and len(both) > 0:
        raise InputError(
            f"columns {streams[0]!r} and {both[0]!r} say the same twice: give streams by class, or "
            "fractions and recoveries",
            both[0],
        )


def _run(name: str, rows: Sequence[Row], config: ScreenConfig) -> Run:
    """One run from its rows."""
    head = rows[0].cells
    times: tuple[float, ...] = ()
    if "time_s" in head:
        given = [number(row, "time_s") for row in rows]
        times = tuple(sorted(set(given)))
        blocks = [
            sorted((r for r, t in zip(rows, given, strict=True) if t == time), key=_lower)
            for time in times
        ]
    else:
        blocks = [sorted(rows, key=_lower)]
    edges = _edges(name, blocks)
    recovery, feed = _measured(name, blocks)
    settings = {column: _constant(name, rows, column) for column in head if column not in COLUMNS}
    rate = feed.sum() * T_H if "feed_fraction" not in head else config.feed.mass_flow_rate
    if "rate_t_h" in head:
        rate = _constant(name, rows, "rate_t_h") * T_H
    sigma = _table(blocks, "sigma") if "sigma" in head else np.ones_like(recovery)
    with told_of_run(name):
        own = replace(
            config,
            size_classes=SizeClasses(edges, config.size_classes.subdivision),
            feed=Feed(rate, tuple(feed / feed.sum())),
        ).with_values(settings)
    # That nothing larger than the openings passes says nothing of the screen.
    openings = (max(panel.aperture for panel in deck.panels) for deck in own.decks)
    recovery = np.where(own.size_classes.lower < min(openings), recovery, np.nan)
    group = {row.cells["group"] for row in rows} if "group" in head else {""}
    if len(group) > 1:
        raise InputError(f"group of run {name!r} differs within the run: give one", "group")
    if not times:
        return Run(name, own, recovery[0], sigma[0], group.pop())
    mass = _constant(name, rows, "areal_mass_kg_m2")
    return Run(name, own, recovery, sigma, group.pop(), mass, times)


def _lower(row: Row) -> float:
    return number(row, "lower_mm")


def _constant(run: str, rows: Sequence[Row], column: str) -> float:
    """A number that all rows of a run share."""
    values = {number(row, column): row for row in rows}
    if len(values) > 1:
        raise InputError(
            f"{column} of run {run!r} is {' and '.join(f'{v:g}' for v in values)}: a run has one, "
            "give each its own name",
            column,
        )
    return next(iter(values))


def _edges(run: str, blocks: Sequence[Sequence[Row]]) -> tuple[float, ...]:
    """Limits of the classes [m], which follow each other and are the same at all times."""
    lists = []
    for block in blocks:
        limits = [[number(row, column) for column in LIMITS] for row in block]
        for row, before, this in zip(block[1:], limits[:-1], limits[1:], strict=True):
            if before[1] != this[0]:
                raise InputError(
                    f"{row.place}: class {this[0]:g} to {this[1]:g} mm of run {run!r} does not "
                    f"begin where the finer one ends, {before[1]:g} mm: classes follow each other, "
                    "one row each",
                    "lower_mm",
                )
        lists.append((limits[0][0], *(limit[1] for limit in limits)))
    if len(set(lists)) > 1:
        raise InputError(
            f"classes of run {run!r} differ between its times: give the same", "time_s"
        )
    return tuple(edge * MM for edge in lists[0])


def _table(blocks: Sequence[Sequence[Row]], column: str, *, empty: bool = False) -> Array:
    """Numbers of a column, [time, class]."""
    return np.array([[number(row, column, empty=empty) for row in block] for block in blocks])


def _measured(run: str, blocks: Sequence[Sequence[Row]]) -> tuple[Array, Array]:
    """Recoveries [time, class], and what was fed by class, in t/h or as fractions."""
    first = blocks[0][0].cells
    if "recovery" in first:
        recovery = _table(blocks, "recovery", empty=True)
        feed = _table(blocks, "feed_fraction")
        if (feed != feed[0]).any():
            raise InputError(
                f"feed_fraction of run {run!r} differs between its times: a batch has one",
                "feed_fraction",
            )
        total = float(feed[0].sum())
        if abs(total - 1.0) > 10.0 * SUM_TOLERANCE:
            cure = "divide by 100" if abs(total - 100.0) < 1.0 else "give the shares of all classes"
            raise InputError(
                f"feed_fraction of run {run!r} sums to {total:g}, not to 1: {cure}", "feed_fraction"
            )
        _check_recovery(blocks, recovery, "recovery")
        return recovery, feed[0]
    streams = {name: _table(blocks, name)[0] if name in first else None for name in STREAMS}
    fed, under, over = (streams[name] for name in STREAMS)
    for name, stream in streams.items():
        if stream is not None and (stream < 0.0).any():
            row = blocks[0][int(np.flatnonzero(stream < 0.0)[0])]
            raise InputError(
                f"{row.place}: {name} = {row.cells[name]} is negative: give a rate", name
            )
    if under is not None and over is not None:
        fed = under + over
    assert fed is not None
    if under is None:
        assert over is not None
        under = fed - over
    if fed.sum() <= 0.0:
        raise InputError(f"run {run!r} has no feed: give rates above 0", STREAMS[0])
    recovery = np.divide(under, fed, out=np.full_like(fed, np.nan), where=fed > 0.0)[None]
    _check_recovery(blocks, recovery, "undersize_t_h over feed_t_h")
    return recovery, fed


def _check_recovery(blocks: Sequence[Sequence[Row]], recovery: Array, name: str) -> None:
    """Refuse recoveries that can be none."""
    for block, values in zip(blocks, recovery, strict=True):
        for row, value in zip(block, values, strict=True):
            if value < -BEYOND or value > 1.0 + BEYOND:
                cure = "were per cent meant? divide by 100" if name == "recovery" else "check them"
                raise InputError(
                    f"{row.place}: {name} = {value:g} is not from 0 to 1: {cure}", name
                )
