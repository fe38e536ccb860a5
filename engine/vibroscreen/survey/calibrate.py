"""Fit numbers of the model to surveys: their values, how sure they are, and how well they predict.

`calibrate` fits numbers of a screen (by the names of the FMU's variables) to recoveries by class of
several runs, on decks or in batches. `fit` is what it stands on: bounded least squares from several
starts for any function of named parameters. Confidence is that of linear regression at the
optimum (Bates and Watts, Nonlinear Regression Analysis and Its Applications, 1988, ch. 2);
collinearity is told by condition indices and variance proportions (Belsley, Kuh and Welsch,
Regression Diagnostics, 1980, ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.fields import nearest
from vibroscreen.screen import Screen
from vibroscreen.survey.streams import StreamRun, Streams
from vibroscreen.sweep import Sweep, places
from vibroscreen.units import PERCENT

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Calibration", "Fit", "HeldOut", "Parameter", "Run", "calibrate", "fit"]

Array = NDArray[np.float64]
Predict = Callable[[Array], Array]
Progress = Callable[[int, int], None]
Closure = Callable[[Mapping[str, float], Any], Mapping[str, float]]

SCALES = ("log", "linear")
INTERVALS = ("linear", "profile")
# Losses, and where they begin to hold back, in standard deviations: 95 per cent efficient for
# normal errors (Holland and Welsch, Communications in Statistics A 6, 1977, 813).
LOSSES = {"linear": math.inf, "huber": 1.345, "cauchy": 2.385}
# Of a group whose measurements count for less on average, good ones for 0.87 by Cauchy's loss.
DOUBTED = 0.5
AT_ITS_BOUND, HARDLY = "lies at its bound", "is hardly fixed by the data"
# Searches of a robust fit, each with the scale of the last; median of a normal's size.
ROUNDS, NORMAL_MEDIAN = 4, 0.6745
# Places that are tried for a limit of a profile.
MOST_PROFILED = 12
# Step of a central difference: part of the value ("log") or of the range ("linear"). Recoveries
# carry an error of the solver, so it is wide: the error of the difference is of second order.
STEP = 0.01
# Drawn for every start that is followed; the best of them are.
DRAWS_PER_START = 10
MOST_EVALUATIONS = 100
# What a prediction that is not finite (a design that was refused) misses by, in measured units.
MISS = 1.0
CONFIDENCE = 0.95
# Collinear from this condition index on (Belsley, Kuh and Welsch: 30), for the parameters that
# have more than half of their variance from it.
CONDITION = 30.0
SHARE = 0.5
AT_BOUND = 1e-4  # of the range
# Hardly fixed: an interval over more than a factor of 10, or half of a linear range.
WIDE = 0.5 * math.log(10.0)
TOGETHER = 0.9
# Starts end alike within this part of the range; as well within this part of the sum of squares.
ALIKE, AS_GOOD = 0.02, 0.01


@dataclass(frozen=True)
class Parameter:
    """A number to be fitted between its bounds, in the unit of the variable.

    name: of the FMU's variable, such as "passage.velocity". sets: the variables that take its
    value, where they are others or several (`("bed.contact_depth", "bed.layer_depth")`), or none
    for a number that only a closure reads. start: the first start, by default the value of the
    first run's configuration or, without one, the middle. scale: "log" for what is known by its
    order of magnitude, or "linear". runs: the names of the runs that it acts on, all unless given;
    so one variable may have a number for every run, under names of their own. Raises InputError.
    """

    name: str
    lower: float
    upper: float
    start: float | None = None
    scale: str = "log"
    sets: tuple[str, ...] | None = None
    runs: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.scale not in SCALES:
            raise InputError(
                f"{self.name}: scale = {self.scale!r} is unknown: give one of {', '.join(SCALES)}"
            )
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise InputError(
                f"{self.name} has the bounds {self.lower:g} to {self.upper:g}: give finite ones"
            )
        if self.lower >= self.upper:
            raise InputError(
                f"{self.name} has the lower bound {self.lower:g}, not below the upper one "
                f"{self.upper:g}: give the lower bound first"
            )
        if self.scale == "log" and self.lower <= 0.0:
            raise InputError(
                f'{self.name} has the lower bound {self.lower:g}, and scale "log" needs one above '
                '0: raise it, or use scale = "linear"'
            )
        if self.start is not None and not self.lower <= self.start <= self.upper:
            raise InputError(
                f"{self.name} starts at {self.start:g}, outside of its bounds {self.lower:g} to "
                f"{self.upper:g}: widen them or give another start"
            )

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables that take the value."""
        return (self.name,) if self.sets is None else self.sets

    def acts_on(self, run: str) -> bool:
        """Whether a run takes the value."""
        return self.runs is None or run in self.runs

    def to_scale(self, value: float | Array) -> Any:
        """The value on its scale."""
        return np.log(value) if self.scale == "log" else value

    def from_scale(self, place: float | Array) -> Any:
        """The value from its place on the scale."""
        return np.exp(np.clip(place, -300.0, 300.0)) if self.scale == "log" else place


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


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A group that was left out: values fitted to the others, and its root mean square error."""

    value: Array
    rmse: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters fitted to measured numbers.

    By parameter p: value, lower and upper (95 per cent confidence), correlation[p, p]. By measured
    number n: measured, modelled, sigma, group, and held_out_modelled (its group left out of the
    fit; nan where that was not asked for, or where the others say nothing of a parameter). rmse and
    held_out_rmse: root mean squares of modelled - measured, unweighted. starts[start, p + 1]: where
    each start ended, and its sum of squares. warnings: what not to trust, in plain words.
    """

    parameters: tuple[Parameter, ...]
    value: Array
    lower: Array
    upper: Array
    correlation: Array
    measured: Array
    modelled: Array
    sigma: Array
    group: tuple[str, ...]
    starts: Array
    held_out_modelled: Array
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def rmse(self) -> float:
        """Root mean square error of all that was fitted."""
        return _rms(self.modelled - self.measured)

    @property
    def held_out_rmse(self) -> float:
        """The same of every group by the fit to the others; nan unless all were left out."""
        return _rms(self.held_out_modelled - self.measured)

    @property
    def values(self) -> dict[str, float]:
        """Fitted values by name."""
        return {p.name: float(v) for p, v in zip(self.parameters, self.value, strict=True)}

    def frame(self) -> pd.DataFrame:
        """Table by parameter: value, 95 per cent interval, bounds, range over the left-out fits."""
        import pandas as pd

        table = pd.DataFrame(
            {
                "value": self.value,
                "lower_95": self.lower,
                "upper_95": self.upper,
                "bound_lower": [p.lower for p in self.parameters],
                "bound_upper": [p.upper for p in self.parameters],
            },
            index=pd.Index([p.name for p in self.parameters], name="parameter"),
        )
        if self.held_out:
            values = np.array([held.value for held in self.held_out.values()])
            table["held_out_min"], table["held_out_max"] = values.min(axis=0), values.max(axis=0)
        return table


def fit(
    predict: Predict,
    parameters: Sequence[Parameter],
    measured: ArrayLike,
    *,
    sigma: ArrayLike = 1.0,
    group: Sequence[str] = (),
    starts: int = 8,
    seed: int = 0,
    progress: Progress | None = None,
    adjusted: int = 0,
    intervals: str = "linear",
    confidence: float = CONFIDENCE,
    loss: str = "linear",
    leave_out: bool = True,
) -> Fit:
    """Least squares of (predict - measured)/sigma over named parameters within their bounds.

    predict(points[k, p]) gives the predictions [k, n] of k points at once, nan where there is none;
    measured[n]; sigma: one or n standard errors, only their ratios matter; group[n]: what is left
    out together in turn, nothing without or where leave_out is False. starts: the first is that of
    the parameters, the others are the best of ten times as many drawn at random (`seed`) over the
    bounds. progress is called with the number of searches done and of all. adjusted: so many other
    numbers predict adjusts by itself; then sigma is taken as known, and residuals only widen
    intervals. intervals: "linear", from the slopes at the optimum, or "profile", up to where the
    least sum of squares with a parameter held has risen by as much as `confidence` allows (Bates
    and Watts, ch. 6), from the outermost of the minima that fit as well; it takes a search for each
    place that is tried, and holds where parameters make up for each other. loss: "linear" for least
    squares, or "huber" or "cauchy", by which what lies far off counts for less; then intervals are
    linear (Huber, Robust Statistics, 1981, sec. 7.6), and a group that hardly counts is told and
    left out of the fit, which it would go on to bias. Raises InputError, ImportError without scipy.
    """
    if intervals not in INTERVALS:
        raise InputError(
            f"intervals = {intervals!r} is unknown: give one of {', '.join(INTERVALS)}", "intervals"
        )
    if loss not in LOSSES:
        raise InputError(f"loss = {loss!r} is unknown: give one of {', '.join(LOSSES)}", "loss")
    if loss != "linear" and intervals == "profile":
        raise InputError(
            f'intervals = "profile" goes with least squares, not with loss = {loss!r}: give '
            '"linear"',
            "intervals",
        )
    if not 0.0 < confidence < 1.0:
        raise InputError(
            f"confidence = {confidence:g} is no chance: give one above 0 and below 1", "confidence"
        )
    problem = _Problem(predict, tuple(parameters), measured, sigma, group, adjusted)
    groups = tuple(dict.fromkeys(problem.group))
    groups = groups if len(groups) > 1 and leave_out else ()
    sides = 2 * len(problem.parameters) if intervals == "profile" else 0
    total = starts + len(groups) + sides

    def report(done: int) -> None:
        if progress is not None:
            progress(done, total)

    report(0)
    everything = np.ones(problem.measured.size, dtype=bool)
    ends = []
    for start in problem.starts(starts, seed):
        ends.append(problem.search(start, everything))
        report(len(ends))
    ends.sort(key=lambda end: end[1])
    kept, doubts = everything, list[str]()
    if loss != "linear":
        ends = problem.robust(ends, loss, everything)
        kept, doubts = problem.doubted(ends[0][0])
        if doubts:
            ends = problem.robust(ends, loss, kept)
    best = ends[0][0]
    modelled = problem.predictions(best[None])[0]
    jacobian = problem.jacobian(best) / problem.sigma[:, None]
    lower, upper, correlation, warnings = problem.confidence(
        best, modelled, jacobian, confidence, kept
    )
    if sides:
        lower, upper, told = problem.profiles(
            ends, lower, upper, confidence, lambda done: report(starts + done)
        )
        warnings = [w for w in warnings if AT_ITS_BOUND not in w and HARDLY not in w] + told
    warnings += problem.other_minima(ends)
    warnings += doubts
    held_out: dict[str, HeldOut] = {}
    held_out_modelled = np.full(problem.measured.size, np.nan)
    again = problem.distinct(ends)[:3]
    for name in groups:
        out = np.array([one == name for one in problem.group])
        unknown = [
            p.name
            for p, column in zip(problem.parameters, jacobian[~out].T, strict=True)
            if not column.any()
        ]
        if unknown:
            warnings.append(
                f"{', '.join(unknown)} acts on no run but {name}: leaving {name} out, nothing says "
                "its value and there is no prediction; share the parameter or give a closure"
            )
            continue
        found = min(
            (problem.search(start, kept & ~out) for start in again), key=lambda end: end[1]
        )[0]
        held_out_modelled[out] = problem.predictions(found[None])[0, out]
        error = _rms(held_out_modelled[out] - problem.measured[out])
        held_out[name] = HeldOut(problem.values(found), error)
        report(starts + sides + len(held_out))
    report(total)
    return Fit(
        problem.parameters,
        problem.values(best),
        lower,
        upper,
        correlation,
        problem.measured,
        modelled,
        problem.sigma,
        problem.group,
        np.array([[*problem.values(place), cost] for place, cost in ends]),
        held_out_modelled,
        held_out,
        tuple(warnings),
    )


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _scipy() -> Any:
    """The scipy modules of a fit."""
    try:
        import scipy.optimize
        import scipy.stats
    except ImportError:
        raise ImportError(
            "vibroscreen.calibrate needs scipy, which is not installed: "
            "pip install 'vibroscreen[calibrate]'"
        ) from None
    return scipy


class _Problem:
    """A fit in places on the parameters' scales: 0 at the lower bounds, 1 at the upper ones."""

    def __init__(
        self,
        predict: Predict,
        parameters: tuple[Parameter, ...],
        measured: ArrayLike,
        sigma: ArrayLike,
        group: Sequence[str],
        adjusted: int = 0,
    ) -> None:
        self.scipy, self.adjusted = _scipy(), adjusted
        self.loss, self.scale = "linear", 1.0
        self.predict, self.parameters = predict, parameters
        self.measured = np.asarray(measured, dtype=float)
        self.sigma = np.broadcast_to(np.asarray(sigma, dtype=float), self.measured.shape)
        self.group = tuple(group)
        names = [p.name for p in parameters]
        if not names or len(set(names)) < len(names):
            raise InputError(
                f"parameters = {', '.join(names) or 'none'}: give one or more, each name once",
                "parameters",
            )
        if self.measured.size <= len(names) + adjusted:
            by_class = f" and {adjusted} rates of the feed by class" if adjusted else ""
            raise InputError(
                f"measured: {self.measured.size} numbers cannot fix {len(names)} parameters"
                f"{by_class}: fit fewer or measure more",
                "measured",
            )
        if self.group and len(self.group) != self.measured.size:
            raise InputError(
                f"group has {len(self.group)} names for {self.measured.size} measured numbers: "
                "give one each",
                "group",
            )
        self.low = np.array([p.to_scale(p.lower) for p in parameters])
        self.width = np.array([p.to_scale(p.upper) for p in parameters]) - self.low
        self.wide = np.array(
            [
                WIDE / w if p.scale == "log" else 0.25
                for p, w in zip(parameters, self.width, strict=True)
            ]
        )
        self.step = np.array(
            [
                STEP / w if p.scale == "log" else STEP
                for p, w in zip(parameters, self.width, strict=True)
            ]
        )

    def values(self, place: Array) -> Array:
        """Values [..., p] of places [..., p]."""
        scaled = self.low + place * self.width
        columns = [p.from_scale(scaled[..., k]) for k, p in enumerate(self.parameters)]
        return np.stack(columns, axis=-1)

    def predictions(self, places: Array) -> Array:
        """Predictions [k, n] at places [k, p]; what is not finite misses by MISS."""
        found = np.asarray(self.predict(self.values(places)), dtype=float)
        if found.shape != (len(places), self.measured.size):
            raise InputError(
                f"predict gave the shape {found.shape} for {len(places)} points: give "
                f"{(len(places), self.measured.size)}",
                "predict",
            )
        return np.where(np.isfinite(found), found, self.measured + MISS)

    def residuals(self, places: Array) -> Array:
        """Weighted residuals [k, n]."""
        weighted: Array = (self.predictions(places) - self.measured) / self.sigma
        return weighted

    def jacobian(self, place: Array) -> Array:
        """Derivative [n, p] of the predictions, by central differences within the bounds."""
        ahead = np.minimum(place + self.step, 1.0)
        behind = np.maximum(place - self.step, 0.0)
        count = place.size
        points = np.tile(place, (2 * count, 1))
        points[np.arange(count), np.arange(count)] = ahead
        points[count + np.arange(count), np.arange(count)] = behind
        found = self.predictions(points)
        slope: Array = ((found[:count] - found[count:]) / (ahead - behind)[:, None]).T
        return slope

    def starts(self, count: int, seed: int) -> list[Array]:
        """Places to start at: that of the parameters, then the best of those drawn."""
        first = np.array(
            [
                0.5 if p.start is None else (p.to_scale(p.start) - low) / width
                for p, low, width in zip(self.parameters, self.low, self.width, strict=True)
            ]
        )
        if count < 2:
            return [first]
        draw = self.scipy.stats.qmc.LatinHypercube(len(self.parameters), rng=seed)
        drawn = draw.random(DRAWS_PER_START * (count - 1))
        order = np.argsort((self.residuals(drawn) ** 2).sum(axis=1), kind="stable")
        return [first, *drawn[order[: count - 1]]]

    def search(
        self, start: Array, kept: NDArray[np.bool_], held: int | None = None
    ) -> tuple[Array, float]:
        """The minimum that a start leads to, over the numbers that are kept, and its squares.

        held: a parameter that stays where it starts.
        """
        weight = 1.0 / self.sigma[kept]
        free = np.arange(start.size) != (-1 if held is None else held)

        def whole(part: Array) -> Array:
            place = start.copy()
            place[free] = part
            return place

        if not free.any():
            return start, float((self.residuals(start[None])[0, kept] ** 2).sum())
        found = self.scipy.optimize.least_squares(
            lambda part: self.residuals(whole(part)[None])[0, kept],
            np.clip(start[free], 1e-6, 1.0 - 1e-6),
            jac=lambda part: self.jacobian(whole(part))[kept][:, free] * weight[:, None],
            bounds=(0.0, 1.0),
            loss=self.loss,
            f_scale=self.scale,
            xtol=1e-7,
            ftol=1e-9 if held is None else 1e-4,
            gtol=1e-10,
            max_nfev=MOST_EVALUATIONS,
        )
        return whole(found.x), 2.0 * float(found.cost)

    def robust(
        self, ends: Sequence[tuple[Array, float]], loss: str, kept: NDArray[np.bool_]
    ) -> list[tuple[Array, float]]:
        """Ends again by another loss, whose scale is that of the middle half of the residuals."""
        found = list(ends)
        for _ in range(ROUNDS):
            residual = self.residuals(found[0][0][None])[0, kept]
            spread = float(np.median(np.abs(residual))) / NORMAL_MEDIAN
            spread *= math.sqrt(residual.size / (residual.size - len(self.parameters)))
            known = 1.0 if self.adjusted else max(spread, 1e-12)
            self.loss, self.scale = loss, LOSSES[loss] * known
            found = [self.search(place, kept) for place, _ in found]
            found.sort(key=lambda end: end[1])
        return found

    def weights(self, residual: Array) -> tuple[Array, Array]:
        """How much each residual counts, and the slope of what it pulls with."""
        if self.loss == "linear":
            return np.ones_like(residual), np.ones_like(residual)
        u = np.abs(residual) / self.scale
        if self.loss == "huber":
            return 1.0 / np.maximum(u, 1.0), (u <= 1.0).astype(float)
        return 1.0 / (1.0 + u**2), (1.0 - u**2) / (1.0 + u**2) ** 2

    def doubted(self, place: Array) -> tuple[NDArray[np.bool_], list[str]]:
        """Which numbers are of groups that count, and what is told of the other groups."""
        weight, _ = self.weights(self.residuals(place[None])[0])
        group = np.array(self.group or ("",) * weight.size)
        means = {name: float(weight[group == name].mean()) for name in dict.fromkeys(self.group)}
        doubted = [name for name, mean in means.items() if mean < DOUBTED]
        kept = ~np.isin(group, doubted)
        if kept.sum() <= len(self.parameters) + self.adjusted:
            kept = np.ones(weight.size, dtype=bool)
        left_out = "it is left out of the fit, " if not kept.all() else ""
        return kept, [
            f"{name} lies far from the fit to the others, its measurements count for "
            f"{means[name] / PERCENT:.0f} % on average: {left_out}look for a gross error in it"
            for name in doubted
        ]

    def profiles(
        self,
        ends: Sequence[tuple[Array, float]],
        lower: Array,
        upper: Array,
        confidence: float,
        done: Callable[[int], None],
    ) -> tuple[Array, Array, list[str]]:
        """Limits by the profile of the sum of squares, and which parameters have none.

        lower, upper: limits from slopes, to begin with.
        """
        best, least = ends[0]
        level = self.rise(least, confidence)
        good = [end for end in ends if end[1] < least + level]
        limits, told = np.array([self.values(best)] * 2), []
        for k, p in enumerate(self.parameters):
            reach = 1.0
            with np.errstate(divide="ignore", invalid="ignore"):
                linear = (p.to_scale(np.array([lower[k], upper[k]])) - self.low[k]) / self.width[k]
            if np.isfinite(linear).all() and linear[1] > linear[0]:
                reach = 0.5 * float(linear[1] - linear[0])
            open_sides = []
            for side, sign in enumerate((-1.0, 1.0)):
                start = max(good, key=lambda end: sign * end[0][k])
                step = min(0.5 * reach, 0.1)
                place, closed = self.crossing(start, k, sign, step, least, level)
                limits[side, k] = self.values(np.where(np.arange(best.size) == k, place, best))[k]
                if not closed:
                    open_sides.append("above" if sign > 0.0 else "below")
                done(2 * k + side + 1)
            if open_sides:
                told.append(
                    f"the data do not limit {p.name} {' or '.join(open_sides)} within its bounds "
                    f"{p.lower:.4g} to {p.upper:.4g} (95 % interval {limits[0, k]:.3g} to "
                    f"{limits[1, k]:.3g}): fix it, or add runs that depend on it".replace(
                        "95 %", f"{confidence / PERCENT:g} %"
                    )
                )
        return limits[0], limits[1], told

    def rise(self, least: float, confidence: float) -> float:
        """By how much the sum of squares may rise above the least."""
        freedom = self.measured.size - len(self.parameters) - self.adjusted
        if self.adjusted:
            quantile = self.scipy.stats.norm.ppf(0.5 + 0.5 * confidence)
            return float(quantile**2 * max(least / freedom, 1.0))
        quantile = self.scipy.stats.t.ppf(0.5 + 0.5 * confidence, freedom)
        return float(quantile**2 * least / freedom)

    def crossing(
        self,
        begin: tuple[Array, float],
        held: int,
        sign: float,
        step: float,
        least: float,
        level: float,
    ) -> tuple[float, bool]:
        """Where the least sum of squares with one parameter held has risen by `level`.

        And whether it is there within the bounds. begin: a minimum, and its squares.
        """
        everything = np.ones(self.measured.size, dtype=bool)
        end = 1.0 if sign > 0.0 else 0.0
        place = begin[0]
        near = float(place[held])
        far = near
        root = math.sqrt(level)
        for _ in range(MOST_PROFILED):
            if abs(end - near) < AT_BOUND:
                return end, False
            far = min(max(near + sign * step, 0.0), 1.0)
            start = place.copy()
            start[held] = far
            there, squares = self.search(start, everything, held)
            if squares - least >= level:
                break
            near, place = far, there
            step *= 2.0
        else:
            return end, False

        def over(at: float) -> float:
            start = place.copy()
            start[held] = at
            return math.sqrt(max(self.search(start, everything, held)[1] - least, 0.0)) - root

        # A search from elsewhere may end in another valley.
        if over(near) >= 0.0:
            return near, True
        if over(far) <= 0.0:
            return far, True
        inside = 0.002 * abs(far - float(begin[0][held]))
        found = self.scipy.optimize.brentq(over, near, far, xtol=inside, rtol=1e-12, disp=False)
        return float(found), True

    def distinct(self, ends: Sequence[tuple[Array, float]]) -> list[Array]:
        """Ends that are not alike, best first."""
        apart: list[Array] = []
        for place, _ in ends:
            if all(np.abs(place - other).max() > ALIKE for other in apart):
                apart.append(place)
        return apart

    def other_minima(self, ends: Sequence[tuple[Array, float]]) -> list[str]:
        """A warning where starts end elsewhere and fit as well."""
        best, least = ends[0]
        good = [place for place, cost in ends if cost <= (1.0 + AS_GOOD) * least + 1e-12]
        apart = [p for p in good if np.abs(p - best).max() > 10.0 * ALIKE]
        if not apart:
            return []
        spread = np.abs(np.array(apart) - best).max(axis=0)
        values = self.values(np.array([*apart, best]))
        said = ", ".join(
            f"{p.name} from {values[:, k].min():.3g} to {values[:, k].max():.3g}"
            for k, p in enumerate(self.parameters)
            if spread[k] > 10.0 * ALIKE
        )
        return [
            f"{len(apart)} of {len(ends)} starts end elsewhere and fit as well: {said}; the data "
            "do not decide, narrow the bounds or measure more"
        ]

    def confidence(
        self,
        place: Array,
        modelled: Array,
        jacobian: Array,
        chance: float,
        kept: NDArray[np.bool_],
    ) -> tuple[Array, Array, Array, list[str]]:
        """Limits, correlation, and what the data cannot tell."""
        count, jacobian = place.size, jacobian[kept]
        bound = (place < AT_BOUND) | (place > 1.0 - AT_BOUND)
        warnings = [
            f"{p.name} = {v:.4g} {AT_ITS_BOUND}: it has no interval, and the others are too "
            "narrow; widen the bound or fix the value"
            for p, v, at in zip(self.parameters, self.values(place), bound, strict=True)
            if at
        ]
        norm = np.sqrt((jacobian**2).sum(axis=0))
        moves = norm > 1e-9 * max(1.0, float(norm.max()))
        warnings += [
            f"{p.name} changes nothing that was measured: leave it out"
            for p, m in zip(self.parameters, moves, strict=True)
            if not m
        ]
        free = np.flatnonzero(~bound & moves)
        residual = ((modelled - self.measured) / self.sigma)[kept]
        freedom = max(residual.size - count - self.adjusted, 1)
        weight, slope = self.weights(residual)
        mean = float(slope.mean())
        scatter = float(((weight * residual) ** 2).sum()) / freedom
        if self.loss != "linear":
            scatter *= (1.0 + count / residual.size * float(slope.var()) / mean**2) ** 2 / mean**2
        scatter = max(scatter, 1.0) if self.adjusted else scatter
        error = np.full(count, np.inf)
        correlation = np.full((count, count), np.nan)
        np.fill_diagonal(correlation, 1.0)
        if free.size:
            scaled = jacobian[:, free] / norm[free]
            _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
            singular = np.maximum(singular, 1e-12 * singular[0])
            parts = (axes / singular[:, None]) ** 2  # [axis, parameter]
            inverse = (axes.T / singular**2) @ axes
            variance = scatter * inverse
            deviation = np.sqrt(np.diag(variance))
            error[free] = deviation / norm[free]
            if deviation.all():
                correlation[np.ix_(free, free)] = variance / np.outer(deviation, deviation)
            index = singular[0] / singular
            share = parts / parts.sum(axis=0)
            for axis in np.flatnonzero(index > CONDITION):
                involved = [self.parameters[k].name for k in free[share[axis] > SHARE]]
                if len(involved) > 1:
                    warnings.append(
                        f"the data cannot tell {' and '.join(involved)} apart (condition index "
                        f"{index[axis]:.0f}): a change of one is made up for by the other; fix "
                        "one, or add runs in which they act differently"
                    )
        error[bound] = 0.0
        known = self.scipy.stats.norm.ppf(0.5 + 0.5 * chance)
        quantile = self.scipy.stats.t.ppf(0.5 + 0.5 * chance, freedom)
        reach = (known if self.adjusted else quantile) * error
        for k in free:
            if reach[k] > self.wide[k]:
                p = self.parameters[k]
                low, high = (self.values(place + side * reach)[k] for side in (-1.0, 1.0))
                with_others = "".join(
                    f"; it goes with {self.parameters[i].name} (correlation "
                    f"{correlation[k, i]:.2f})"
                    for i in free
                    if i != k and abs(correlation[k, i]) > TOGETHER
                )
                warnings.append(
                    f"{p.name} {HARDLY}, 95 % interval {low:.2g} to {high:.2g}"
                    f"{with_others}: fix it, or add runs that depend on it"
                )
        with np.errstate(invalid="ignore"):
            lower, upper = self.values(place - reach), self.values(place + reach)
        return lower, upper, correlation, warnings


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
        by_run = errors.agg(lambda e: _rms(e.to_numpy())).rename("RMSE").to_frame()
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
    confidence: float = CONFIDENCE,
    loss: str = "linear",
) -> Calibration:
    """Fit numbers of the model to the recoveries of some runs.

    parameters are given by the names of the FMU's variables. closure(values, run) may turn the
    fitted values into others, such as a velocity from its law over the aperture: it gets them by
    parameter's name and returns {variable: value}, which are set in place of those of the same
    name. leave_out: fit again without each group of runs in turn and predict it. starts, seed,
    progress, intervals, confidence and loss: see `fit`; intervals are profiles for runs by
    streams under least squares, linear for others unless given. Raises InputError, and
    ImportError without scipy.

    A run whose steady state the engine refuses counts as missed by 1 in every recovery.
    """
    runs, parameters = tuple(runs), tuple(parameters)
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
    parameters = tuple(_started(p, runs) for p in parameters)
    models = _models(runs)
    any_streams = any(isinstance(run, StreamRun) for run in runs)
    group = [run.group for run in runs for _ in run.measured]

    def predict(points: Array) -> Array:
        found = np.zeros((len(points), len(group)))
        settings = [
            [_settings(parameters, point, run, closure) for run in runs] for point in points
        ]
        for model in models:
            model.predict(settings, found)
        return found

    result = fit(
        predict,
        parameters,
        np.concatenate([run.measured for run in runs]),
        sigma=np.concatenate([run.errors for run in runs]),
        group=group,
        leave_out=leave_out,
        adjusted=sum(run.config.size_classes.count for run in runs if isinstance(run, StreamRun)),
        starts=starts,
        seed=seed,
        progress=progress,
        intervals=intervals or ("profile" if any_streams and loss == "linear" else "linear"),
        confidence=confidence,
        loss=loss,
    )
    return Calibration(result, runs, closure)


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
        self.sweep = Sweep([run.config for run in runs])
        self.configs = [run.config for run in runs]

    def predict(self, settings: list[list[dict[str, float]]], found: Array) -> None:
        """Write the recoveries of these runs at every point."""
        rows = [point[i] for point in settings for i in self.index]
        names = dict.fromkeys(name for row in rows for name in row)
        values = {
            name: [
                row[name] if name in row else self.configs[r % len(self.configs)].value_of(name)
                for r, row in enumerate(rows)
            ]
            for name in names
        }
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
        self.screen = Screen(run.config)
        self.known = {
            name: place
            for name, place in places(run.config).items()
            if name.partition(".")[0] not in ("feed", "motion", "displacement")
        }
        self.start = self.screen.layout.section["parameters"].start

    def predict(self, settings: list[list[dict[str, float]]], found: Array) -> None:
        """Write the recoveries of the batch at every point."""
        run = self.run
        assert run.areal_mass is not None
        for row, point in zip(found, settings, strict=True):
            for name, value in point[self.number].items():
                if name not in self.known:
                    raise InputError(
                        f"{name} is not a number that a batch has: the nearest is "
                        f"{nearest(name, self.known)}",
                        name,
                    )
                self.screen.buffer[self.start + self.known[name]] = value
            recovery = self.screen.sieve_batch(
                run.areal_mass, run.config.feed.mass_fraction, times=run.times
            )
            row[self.column] = recovery[self.kept]


def _models(runs: Sequence[Run | StreamRun]) -> list[_Decks | _Batch | Streams]:
    """Runs with what predicts them: decks of one structure together, batches one by one."""
    ends = np.cumsum([0, *(run.measured.size for run in runs)])
    columns = [slice(int(a), int(b)) for a, b in pairwise(ends)]
    together: dict[object, list[int]] = {}
    models: list[_Decks | _Batch | Streams] = []
    for i, run in enumerate(runs):
        if isinstance(run, StreamRun):
            models.append(Streams(run, i, columns[i]))
        elif run.areal_mass is not None:
            models.append(_Batch(run, i, columns[i]))
        else:
            together.setdefault(run.config.size_classes, []).append(i)
    for index in together.values():
        decks = [run for i in index if isinstance(run := runs[i], Run)]
        models.append(_Decks(decks, index, [columns[i] for i in index]))
    return models
