"""Fit numbers of the model to surveys: their values, how sure they are, and how well they predict.

`calibrate` fits numbers of a screen (by the names of the FMU's variables) to what surveys measured,
recoveries by class on decks or in batches, or streams. `fit` is what it stands on.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.fields import nearest
from vibroscreen.screen import Screen
from vibroscreen.survey.fit import Fit, HeldOut, Search, fit, solved
from vibroscreen.survey.kinds import kinds_of
from vibroscreen.survey.parameters import Parameter
from vibroscreen.survey.search import Problem
from vibroscreen.survey.streams import Point, Settings, StreamRun, Streams, tables_of
from vibroscreen.survey.typical import unusual
from vibroscreen.sweep import Sweep, places

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Calibration", "Fit", "HeldOut", "Parameter", "Run", "calibrate", "fit"]

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
Closure = Callable[[Mapping[str, float], Any], Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Run:
    """One run of a survey: the screen and duty it ran with, and the recoveries that were measured.

    config: with the feed, motion and deck of the run. recovery: part of each class that reached the
    undersize, [class] on a deck; with areal_mass [kg/m2] and times [s] a batch on a plate, [time,
    class] (`Screen.sieve_batch`); nan where nothing was measured. sigma: standard error of a
    recovery [1], one or as many; only their ratios matter. group: what is left out together, the
    run by itself unless given. Raises InputError.
    """

    name: str
    config: ScreenConfig
    recovery: Array
    sigma: float | Array = 1.0
    group: str = ""
    areal_mass: float | None = None
    times: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        classes = self.config.size_classes.count
        shape = (classes,) if self.areal_mass is None else (len(self.times), classes)
        for name in ("recovery", "sigma"):
            values = np.asarray(getattr(self, name), dtype=float)
            if name == "sigma":
                values = np.broadcast_to(values, values.shape or shape)
            if values.shape != shape:
                raise InputError(
                    f"{name} of run {self.name!r} has the shape {values.shape}: give {shape}, a "
                    "number a class (and a time)",
                    name,
                )
            object.__setattr__(self, name, values)
        recovery, sigma = self.recovery, np.asarray(self.sigma)
        if np.isinf(recovery).any() or np.isnan(recovery).all():
            raise InputError(
                f"recovery of run {self.name!r} holds no finite number: give what was measured, "
                "nan for what was not",
                "recovery",
            )
        if not (np.isfinite(sigma) & (sigma > 0.0))[~np.isnan(recovery)].all():
            raise InputError(
                f"sigma of run {self.name!r} is not above 0 everywhere: give standard errors, or "
                "nan recoveries for what does not count",
                "sigma",
            )
        object.__setattr__(self, "group", self.group or self.name)

    @property
    def measured(self) -> Array:
        """Recoveries that were measured, times and classes in turn."""
        found: Array = self.recovery[~np.isnan(self.recovery)]
        return found

    @property
    def errors(self) -> Array:
        """Their standard errors."""
        found: Array = np.asarray(self.sigma)[~np.isnan(self.recovery)]
        return found


# --- runs of a screen ----------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Calibration:
    """Numbers of a screen fitted to runs: the fit, and what it says run by run."""

    fit: Fit
    runs: tuple[Run | StreamRun, ...]
    closure: Closure | None = field(default=None, repr=False)

    def settings(self, run: Run | StreamRun) -> dict[str, float]:
        """Fitted values of the FMU's variables for a run."""
        return _settings(self.fit.parameters, self.fit.value, run, self.closure)

    def configure(self, config: ScreenConfig, run: Run | StreamRun | None = None) -> ScreenConfig:
        """A configuration with the fitted values: those that all runs share, or those of a run."""
        if run is None:
            shared = [p.runs is None for p in self.fit.parameters]
            parameters = tuple(p for p, s in zip(self.fit.parameters, shared, strict=True) if s)
            run = Run("", config, np.zeros(config.size_classes.count))
            values = self.fit.value[shared]
            return config.with_values(_settings(parameters, values, run, self.closure))
        return config.with_values(self.settings(run))

    def frame(self) -> pd.DataFrame:
        """Long table of all that was measured: run, time_s, size_class, recoveries, sigma.

        Of runs by streams: run, stream, kind, size_m, with shares [1] and rates over the largest.
        """
        import pandas as pd

        rows = [
            (run.name, run.times[t] if run.times else math.nan, k + 1)
            for run in self.runs
            if isinstance(run, Run)
            for t, k in _measured_places(run)
        ]
        told = [
            (run.name, *label)
            for run in self.runs
            if isinstance(run, StreamRun)
            for label in run.labels
        ]
        table = pd.DataFrame(rows, columns=["run", "time_s", "size_class"])
        if told:
            streams = pd.DataFrame(told, columns=["run", "stream", "kind", "size_m"])
            table = pd.concat([table, streams], ignore_index=True) if rows else streams
        table["measured"], table["modelled"] = self.fit.measured, self.fit.modelled
        table["held_out"], table["sigma"] = self.fit.held_out_modelled, self.fit.sigma
        table["residual"] = table["modelled"] - table["measured"]
        return table

    def plot(self) -> Figure:
        """Measured recoveries against modelled ones, a picture of matplotlib.

        Raises ImportError without it.
        """
        from vibroscreen.report.pictures import draw_calibration

        return draw_calibration(self)

    def _repr_html_(self) -> str:
        """Tables for a notebook: fitted values, root mean square error by run, warnings."""
        errors = self.frame().groupby("run", sort=False)["residual"]
        by_run = errors.agg(lambda e: float(np.sqrt((e**2).mean()))).rename("RMSE").to_frame()
        told = "".join(f"<li>{escape(warning)}</li>" for warning in self.fit.warnings)
        parts = [t.to_html(float_format="{:.4g}".format) for t in (self.fit.frame(), by_run)]
        return "\n".join([*parts, f"<ul>{told}</ul>" if told else "<p>no warnings</p>"])


def calibrate(
    runs: Sequence[Run | StreamRun],
    parameters: Sequence[Parameter],
    *,
    closure: Closure | None = None,
    starts: int = 8,
    seed: int = 0,
    leave_out: bool = True,
    progress: Progress | None = None,
    intervals: str | None = None,
    confidence: float = 0.95,
    loss: str = "linear",
    executor: Executor | None = None,
) -> Calibration:
    """Fit numbers of the model to the recoveries of some runs.

    parameters are given by the names of the FMU's variables. closure(values, run) may turn the
    fitted values into others, such as a velocity from its law over the aperture: it gets them by
    parameter's name and returns {variable: value}, which are set in place of those of the same
    name. leave_out: fit again without each group of runs in turn and predict it, and without each
    kind: all runs of one frequency, aperture, feed rate or whatever else several share and others
    do not. starts, seed, progress, intervals, confidence, loss and executor: see `fit`; intervals
    are profiles for runs by streams under least squares, linear for others unless given. Warns of
    numbers far from where they usually lie. Raises InputError, and ImportError without scipy.

    A run whose steady state the engine refuses counts as missed by 1 in every recovery.
    """
    runs, parameters = tuple(runs), tuple(parameters)
    _check(runs, parameters)
    parameters = tuple(_started(p, runs) for p in parameters)
    by_streams = [run for run in runs if isinstance(run, StreamRun)]
    usual = "profile" if by_streams and loss == "linear" else "linear"
    how = Search(starts, seed, intervals or usual, confidence, loss, leave_out, executor, progress)
    predictor = _Predictor(runs, parameters, closure)
    problem = Problem(
        predictor.predict,
        parameters,
        np.concatenate([run.measured for run in runs]),
        np.concatenate([run.errors for run in runs]),
        [run.group for run in runs for _ in run.measured],
        sum(run.config.size_classes.count for run in by_streams),
        predictor.predict_about,
    )
    found = Calibration(solved(problem, how, kinds_of(runs) if leave_out else None), runs, closure)
    return replace(found, fit=replace(found.fit, warnings=(*found.fit.warnings, *_unusual(found))))


def _check(runs: Sequence[Run | StreamRun], parameters: Sequence[Parameter]) -> None:
    """Refuse runs without a name of their own, and parameters of runs that are none."""
    names = [run.name for run in runs]
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"runs = {', '.join(names) or 'none'}: give one or more, each name once", "runs"
        )
    for parameter in parameters:
        for name in parameter.runs or ():
            if name not in names:
                raise InputError(
                    f"{parameter.name} acts on the run {name!r}, which is none: "
                    f"did you mean {nearest(name, names)!r}?",
                    "runs",
                )


def _unusual(found: Calibration) -> list[str]:
    """Of fitted numbers that lie far from where they usually do, a sentence each."""
    told: dict[str, str] = {}
    for run in found.runs:
        values = found.settings(run)
        config = run.config.with_values(values)
        for said in unusual(config, values, run.name):
            told.setdefault(said.partition(" = ")[0], said)
    return list(told.values())


class _Predictor:
    """What a fit predicts for runs at points of its parameters."""

    def __init__(
        self,
        runs: Sequence[Run | StreamRun],
        parameters: Sequence[Parameter],
        closure: Closure | None,
    ) -> None:
        self.runs, self.parameters, self.closure = runs, parameters, closure
        self.models = _models(runs)
        self.count = sum(run.measured.size for run in runs)

    def predict(self, points: Array) -> Array:
        """Predictions at points, feeds of streams adjusted at each."""
        return self._predicted(points, None)

    def predict_about(self, point: Array, points: Array) -> Array:
        """The same with feeds adjusted by their slopes at one point, for differences about it."""
        return self._predicted(points, self._settings(point))

    def _predicted(self, points: Array, about: Point | None) -> Array:
        found = np.zeros((len(points), self.count))
        settings = [self._settings(point) for point in points]
        for model in self.models:
            model.predict(settings, found, about)
        return found

    def _settings(self, point: Array) -> Point:
        return [_settings(self.parameters, point, run, self.closure) for run in self.runs]


def _settings(
    parameters: Sequence[Parameter], point: Array, run: Run | StreamRun, closure: Closure | None
) -> dict[str, float]:
    """Values of the FMU's variables in a run at a point of the parameters."""
    acting = [(p, float(v)) for p, v in zip(parameters, point, strict=True) if p.acts_on(run.name)]
    found = {name: value for p, value in acting for name in p.variables}
    if closure is not None:
        found.update(closure({p.name: value for p, value in acting}, run))
    return found


def _started(parameter: Parameter, runs: Sequence[Run | StreamRun]) -> Parameter:
    """A parameter that starts where the configuration of its first run stands, if it may."""
    run = next(run for run in runs if parameter.acts_on(run.name))
    if parameter.start is not None or not parameter.variables:
        return parameter
    start = run.config.value_of(parameter.variables[0])
    start = min(max(start, parameter.lower), parameter.upper)
    return Parameter(**{**vars(parameter), "start": start})


def _measured_places(run: Run) -> list[tuple[int, int]]:
    """Time and class of every recovery that was measured, in the order of the fit."""
    return [(t, k) for t, k in np.argwhere(~np.isnan(np.atleast_2d(run.recovery))).tolist()]


class _Decks:
    """Runs on decks that are solved together."""

    def __init__(self, runs: Sequence[Run], index: Sequence[int], columns: Sequence[slice]) -> None:
        self.index, self.columns = index, columns
        self.kept = [~np.isnan(run.recovery) for run in runs]
        self.configs = [run.config for run in runs]
        self.sweep = Sweep(self.configs)

    def predict(self, settings: Settings, found: Array, about: Point | None = None) -> None:
        """Write the recoveries of these runs at every point."""
        tables = tables_of(settings, self.index, self.configs)
        values = {name: table.ravel() for name, table in tables.items()}
        table = self.sweep.solve(values, refused="mark")
        recovery = table.recovery
        recovery[list(table.refused)] = np.nan
        recovery = recovery.reshape(len(settings), len(self.index), -1)
        for k, (column, kept) in enumerate(zip(self.columns, self.kept, strict=True)):
            found[:, column] = recovery[:, k, kept]


class _Batch:
    """A batch on a plate."""

    def __init__(self, run: Run, number: int, column: slice) -> None:
        self.run, self.number, self.column = run, number, column
        self.kept = ~np.isnan(run.recovery)
        self.known = {
            name: place
            for name, place in places(run.config).items()
            if name.partition(".")[0] not in ("feed", "motion", "displacement")
        }
        self._own = threading.local()  # a screen of each thread

    def predict(self, settings: Settings, found: Array, about: Point | None = None) -> None:
        """Write the recoveries of the batch at every point."""
        run = self.run
        assert run.areal_mass is not None
        if not hasattr(self._own, "screen"):
            self._own.screen = Screen(run.config)
        screen: Screen = self._own.screen
        start = screen.layout.section["parameters"].start
        for row, point in zip(found, settings, strict=True):
            for name, value in point[self.number].items():
                if name not in self.known:
                    raise InputError(
                        f"{name} is not a number that a batch has: the nearest is "
                        f"{nearest(name, self.known)}",
                        name,
                    )
                screen.buffer[start + self.known[name]] = value
            recovery = screen.sieve_batch(
                run.areal_mass, run.config.feed.mass_fraction, times=run.times
            )
            row[self.column] = recovery[self.kept]


def _models(runs: Sequence[Run | StreamRun]) -> list[_Decks | _Batch | Streams]:
    """Runs with what predicts them: those of one list of classes together, batches one by one."""
    ends = np.cumsum([0, *(run.measured.size for run in runs)])
    columns = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    together: dict[object, list[int]] = {}
    models: list[_Decks | _Batch | Streams] = []
    for i, run in enumerate(runs):
        if isinstance(run, Run) and run.areal_mass is not None:
            models.append(_Batch(run, i, columns[i]))
        else:
            together.setdefault((type(run), run.config.size_classes), []).append(i)
    for index in together.values():
        own = [columns[i] for i in index]
        decks = [run for i in index if isinstance(run := runs[i], Run)]
        streams = [run for i in index if isinstance(run := runs[i], StreamRun)]
        models.append(_Decks(decks, index, own) if decks else Streams(streams, index, own))
    return models
