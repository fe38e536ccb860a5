"""Runs of a fit that are told by their streams: what was measured, as it was measured.

A model that is fitted must meet rates and shares of all products while the feed, by class, is not
known better than it was measured. So for every set of fitted numbers the feed is adjusted as well,
by one step of Gauss and Newton from the reconciled one, and what is left over counts: the
profile of the likelihood over the feed (Golub and Pereyra, Inverse Problems 19, 2003, R1). Errors
of products that balance are correlated; here they are not reckoned with twice.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.sieves import COARSER
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed
from vibroscreen.survey.read import Survey
from vibroscreen.survey.reconcile import Noise, Rows, reconcile
from vibroscreen.sweep import Sweep
from vibroscreen.units import MM

__all__ = ["StreamRun", "Streams", "stream_runs"]

Array = NDArray[np.float64]

# Part of the feed by which a class is changed for a slope.
STEP = 0.02
# Pull of the feed to the reconciled one, far weaker than any measurement.
PULL = 1e-4


@dataclass(frozen=True, eq=False)
class StreamRun:
    """One run of a survey told by its streams.

    config: with the reconciled feed, in the classes of the sieves; rows: what was measured, sigma:
    its standard errors; kept: what counts, as it can tell of the screen: not that nothing larger
    than its openings came through. Shares in 1, rates over `rows.unit` [kg/s].
    """

    name: str
    config: ScreenConfig
    rows: Rows
    sigma: Array
    kept: NDArray[np.bool_]
    group: str

    @property
    def measured(self) -> Array:
        """What was measured, of what counts."""
        return self.rows.value[self.kept]

    @property
    def errors(self) -> Array:
        """Its standard errors."""
        return self.sigma[self.kept]

    @property
    def labels(self) -> list[tuple[str, str, float]]:
        """Stream, kind and size [m] of what counts."""
        told = zip(self.rows.told, self.kept, strict=True)
        return [(stream, kind, size) for (stream, kind, size, *_), keep in told if keep]


def stream_runs(
    survey: Survey, config: ScreenConfig, noise: Noise | None = None
) -> tuple[StreamRun, ...]:
    """Runs of a survey on a screen. Warns of gross errors. Raises InputError, ImportError."""
    balanced = reconcile(survey, noise, len(config.decks))
    for said in balanced.gross_errors:
        warnings.warn(said, stacklevel=2)
    runs = []
    for run in balanced.runs:
        rows, edges = run.rows, run.rows.edges.copy()
        if math.isinf(edges[-1]):
            top = config.size_classes.edges[-1]
            coarser = (size * MM for size in COARSER if size * MM > 1.2 * edges[-2])
            edges[-1] = top if top > 1.01 * edges[-2] else next(coarser, 1.4 * edges[-2])
        feed = np.zeros(rows.classes)
        feed[: run.rates["feed"].size] = run.rates["feed"]
        own = replace(
            config,
            size_classes=SizeClasses(tuple(edges.tolist()), config.size_classes.subdivision),
            feed=Feed(float(feed.sum()), tuple(feed / feed.sum())),
        ).with_values(run.run.settings)
        kept = np.array([_tells(own, rows, j) for j in range(len(rows.told))])
        runs.append(StreamRun(run.name, own, rows, run.sigma, kept, run.run.group or run.name))
    return tuple(runs)


def _tells(config: ScreenConfig, rows: Rows, number: int) -> bool:
    """Whether a measurement can tell of the screen; sizes above the openings cannot."""
    stream, kind, size, *_ = rows.told[number]
    if stream in ("feed", "oversize") or kind == "rate":
        return True
    if kind == "class":
        size = float(rows.edges[:-1][np.flatnonzero(rows.part[number])[0] % rows.classes])
    through = len(config.decks) if stream == "undersize" else int(stream[13:-1])
    openings = [max(p.aperture for p in deck.panels) for deck in config.decks[:through]]
    return size < min(openings) * (1.0 - 1e-9)


class Streams:
    """What predicts a run by its streams."""

    def __init__(self, run: StreamRun, number: int, column: slice) -> None:
        self.run, self.number, self.column = run, number, column
        self.sweep = Sweep([run.config])
        self.rate = run.config.feed.mass_flow_rate
        feed = np.array(run.config.feed.mass_fraction) * self.rate
        steps = np.vstack([np.zeros(feed.size), STEP * self.rate * np.eye(feed.size)])
        self.feeds = feed + steps

    def predict(self, settings: Sequence[Sequence[Mapping[str, float]]], found: Array) -> None:
        """Write what is measured in this run at every point, with the feed that fits best."""
        rows, kept, count = self.run.rows, self.run.kept, len(self.feeds)
        points = [point[self.number] for point in settings]
        values: dict[str, Array] = {
            name: np.repeat([point[name] for point in points], count) for name in points[0]
        }
        rates = self.feeds.sum(axis=1)
        values["feed.mass_flow_rate"] = np.tile(rates, len(points))
        values["feed.mass_fraction"] = np.tile(self.feeds / rates[:, None], (len(points), 1))
        table = self.sweep.solve(values, refused="mark")
        between = [table.intermediate[:, k] for k in reversed(range(table.intermediate.shape[1]))]
        products = np.concatenate([table.undersize, *between, table.oversize], axis=1) / rows.unit
        refused = {place // count for place in table.refused}
        for k in range(len(points)):
            if k in refused:
                found[k, self.column] = np.nan
                continue
            block = products[k * count : (k + 1) * count]
            expected = np.array([rows.expected(x) for x in block])[:, kept]
            found[k, self.column] = self._profiled(expected)

    def slopes(self, expected: Array) -> Array:
        """Weighted derivative by the feed of what is expected: [measured, class]."""
        slope: Array = (expected[1:] - expected[0]).T / (STEP * self.run.errors[:, None])
        return slope

    def _profiled(self, expected: Array) -> Array:
        """What is expected with the feed adjusted to what is measured."""
        run, slope = self.run, self.slopes(expected)
        miss = (run.measured - expected[0]) / run.errors
        pull = PULL * np.eye(slope.shape[1])
        change = np.linalg.lstsq(
            np.vstack([slope, pull]), np.append(miss, np.zeros(len(pull))), rcond=None
        )[0]
        found: Array = expected[0] + run.errors * (slope @ change)
        return found
