"""Runs of a fit that are told by their streams: what was measured, as it was measured.

A model that is fitted must meet rates and shares of all products while the feed, by class, is not
known better than it was measured. So for every set of fitted numbers the feed is adjusted as well,
by one step of Gauss and Newton from the reconciled one, and what is left over counts: the
profile of the likelihood over the feed (Golub and Pereyra, Inverse Problems 19, 2003, R1). Errors
of products that balance are correlated; here they are not reckoned with twice.
"""

from __future__ import annotations

import math
import threading
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
from vibroscreen.survey.table import told_of_run
from vibroscreen.sweep import Sweep
from vibroscreen.units import MM

__all__ = ["Point", "Settings", "StreamRun", "Streams", "stream_runs", "tables_of"]

Array = NDArray[np.float64]
# Values by variable of every run at a point of the fitted numbers; and at several points.
Point = Sequence[Mapping[str, float]]
Settings = Sequence[Point]

# Part of the feed by which a class is changed for a slope.
STEP = 0.02
# Pull of the feed to the reconciled one, far weaker than any measurement.
PULL = 1e-4
# Points whose slopes are kept: searches ask for differences about the last ones.
REMEMBERED = 4


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
        with told_of_run(run.name):
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
    """What predicts runs told by their streams, of one list of classes, solved together."""

    def __init__(
        self, runs: Sequence[StreamRun], index: Sequence[int], columns: Sequence[slice]
    ) -> None:
        self.runs, self.index, self.columns = tuple(runs), index, columns
        self.configs = [run.config for run in runs]
        self.sweep = Sweep(self.configs)
        own = np.array([config.feed.mass_fraction for config in self.configs])
        self.rates = np.array([config.feed.mass_flow_rate for config in self.configs])
        steps = np.vstack([np.zeros(own.shape[1]), STEP * np.eye(own.shape[1])])
        self.feeds = (own + steps[:, None]) * self.rates[:, None]  # [feed, run, class]
        self._known = threading.local()  # slopes by point, of the searches of each thread

    def predict(self, settings: Settings, found: Array, about: Point | None = None) -> None:
        """Write what is measured in these runs at every point, with the feed that fits best.

        about: a point whose slopes by the feed go for all; else each point has its own.
        """
        shared = None if about is None else self._slopes(about)
        expected = self._expected(settings, 1 if shared else len(self.feeds))
        for k, point in enumerate(settings):
            own = [block[k] for block in expected]
            slopes = shared or self._remember(point, own)
            parts = zip(self.runs, self.columns, slopes, own, strict=True)
            for run, column, slope, block in parts:
                found[k, column] = _profiled(run, block[0], slope)

    def _slopes(self, point: Point) -> list[Array]:
        """Weighted derivatives by the feed of what is expected at a point, run by run."""
        known = vars(self._known).get(self._key(point))
        if known is None:
            known = self._remember(
                point, [block[0] for block in self._expected([point], len(self.feeds))]
            )
        return known

    def _remember(self, point: Point, expected: Sequence[Array]) -> list[Array]:
        """Slopes at a point, kept as differences about it are likely to be asked for."""
        known = vars(self._known)
        slopes = [
            (block[1:] - block[0]).T / (STEP * rate / run.rows.unit * run.errors[:, None])
            for block, rate, run in zip(expected, self.rates, self.runs, strict=True)
        ]
        known[self._key(point)] = slopes
        if len(known) > REMEMBERED:
            del known[next(iter(known))]
        return slopes

    def _key(self, point: Point) -> str:
        return repr([point[i] for i in self.index])

    def _expected(self, settings: Settings, count: int) -> list[Array]:
        """What should be measured by the first feeds, by run: [point, feed, measured].

        nan where a steady state is refused.
        """
        feeds = self.feeds[:count]
        shape = (len(settings), count, len(self.runs))
        values = {
            name: np.broadcast_to(table[:, None], shape).ravel()
            for name, table in tables_of(settings, self.index, self.configs).items()
        }
        rates = feeds.sum(axis=2)
        values["feed.mass_flow_rate"] = np.tile(rates.ravel(), shape[0])
        fractions = (feeds / rates[:, :, None]).reshape(-1, feeds.shape[2])
        values["feed.mass_fraction"] = np.tile(fractions, (shape[0], 1))
        solved = self.sweep.solve(values, refused="mark")
        between = [solved.intermediate[:, k] for k in reversed(range(solved.intermediate.shape[1]))]
        products = np.concatenate([solved.undersize, *between, solved.oversize], axis=1)
        products[list(solved.refused)] = np.nan
        products = products.reshape(*shape, -1)
        return [
            run.rows.expected(products[:, :, k] / run.rows.unit)[..., run.kept]
            for k, run in enumerate(self.runs)
        ]


def tables_of(
    settings: Settings, index: Sequence[int], configs: Sequence[ScreenConfig]
) -> dict[str, Array]:
    """Values of runs by name, [point, run]; what is not set is that of the run's configuration."""
    names = dict.fromkeys(name for point in settings for i in index for name in point[i])
    return {
        name: np.array(
            [
                [
                    point[i][name] if name in point[i] else config.value_of(name)
                    for i, config in zip(index, configs, strict=True)
                ]
                for point in settings
            ]
        )
        for name in names
    }


def _profiled(run: StreamRun, expected: Array, slope: Array) -> Array:
    """What is expected with the feed adjusted to what is measured."""
    if not (np.isfinite(expected).all() and np.isfinite(slope).all()):
        return np.full_like(expected, np.nan)
    miss = (run.measured - expected) / run.errors
    pull = PULL * np.eye(slope.shape[1])
    change = np.linalg.lstsq(
        np.vstack([slope, pull]), np.append(miss, np.zeros(len(pull))), rcond=None
    )[0]
    found: Array = expected + run.errors * (slope @ change)
    return found
