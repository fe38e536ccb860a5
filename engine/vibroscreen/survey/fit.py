"""Bounded least squares from several starts, for any function of named parameters.

What is fitted, how sure it is (`intervals`), and how well it predicts what was left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.errors import InputError
from vibroscreen.survey.intervals import (
    AT_ITS_BOUND,
    HARDLY,
    Side,
    linear,
    other_minima,
    profiled,
    unlimited,
)
from vibroscreen.survey.parameters import Parameter
from vibroscreen.survey.search import LOSSES, End, Mask, Predict, Problem

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Fit", "HeldOut", "Search", "fit", "solved"]

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
Item = TypeVar("Item")
Result = TypeVar("Result")

CONFIDENCE = 0.95
INTERVALS = ("linear", "profile")
# Ends from which a fit without a group goes on.
AGAIN = 3
# Chance below which residuals are larger than errors that are known.
MISFIT = 0.001


@dataclass(frozen=True)
class Search:
    """How a fit searches, see `fit`. Raises InputError."""

    starts: int = 8
    seed: int = 0
    intervals: str = "linear"
    confidence: float = CONFIDENCE
    loss: str = "linear"
    leave_out: bool = True
    executor: Executor | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        if self.intervals not in INTERVALS:
            raise InputError(
                f"intervals = {self.intervals!r} is unknown: give one of {', '.join(INTERVALS)}",
                "intervals",
            )
        if self.loss not in LOSSES:
            raise InputError(
                f"loss = {self.loss!r} is unknown: give one of {', '.join(LOSSES)}", "loss"
            )
        if self.loss != "linear" and self.intervals == "profile":
            raise InputError(
                f'intervals = "profile" goes with least squares, not with loss = {self.loss!r}: '
                'give "linear"',
                "intervals",
            )
        if not 0.0 < self.confidence < 1.0:
            raise InputError(
                f"confidence = {self.confidence:g} is no chance: give one above 0 and below 1",
                "confidence",
            )


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What was left out: values fitted to the others, and its error by them.

    rmse: root mean square of modelled - measured; in_sigmas: the same over the standard errors.
    """

    value: Array
    rmse: float
    in_sigmas: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters fitted to measured numbers.

    By parameter p: value, lower and upper (95 per cent confidence), correlation[p, p]. By measured
    number n: measured, modelled, sigma, group, and held_out_modelled (its group left out of the
    fit; nan where that was not asked for, or where the others say nothing of a parameter). held_out
    has what was left out by group, kinds by kind of groups that are left out together. rmse and
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
    kinds: Mapping[str, HeldOut] = field(default_factory=dict)
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

    def left_out_frame(self) -> pd.DataFrame:
        """Table by what was left out, groups and then kinds: its error, and the values without."""
        import pandas as pd

        left_out = {**self.held_out, **self.kinds}
        errors = [(held.rmse, held.in_sigmas, *held.value) for held in left_out.values()]
        columns = ["rmse", "in_sigmas", *(p.name for p in self.parameters)]
        return pd.DataFrame(errors, index=pd.Index(left_out, name="left out"), columns=columns)


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
    executor: Executor | None = None,
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
    left out of the fit, which it would go on to bias. executor: of threads, in which starts,
    profiles and fits without a group run side by side; what comes out is the same. Raises
    InputError, ImportError without scipy.
    """
    how = Search(starts, seed, intervals, confidence, loss, leave_out, executor, progress)
    return solved(Problem(predict, parameters, measured, sigma, group, adjusted), how)


def solved(problem: Problem, how: Search, kinds: Mapping[str, frozenset[str]] | None = None) -> Fit:
    """The fit of a problem; kinds: groups that are left out together as well, by what they share.

    Raises InputError.
    """
    groups = {name: frozenset([name]) for name in dict.fromkeys(problem.group)}
    left_out = {**groups, **(kinds or {})} if len(groups) > 1 and how.leave_out else {}
    sides = [Side(k, sign) for k in range(len(problem.parameters)) for sign in (-1.0, 1.0)]
    sides = sides if how.intervals == "profile" else []
    told = _Told(how, how.starts + len(sides) + len(left_out))
    search = partial(problem.search, kept=problem.everything)
    ends = told.each(search, problem.starts(how.starts, how.seed))
    ends.sort(key=lambda end: end[1])
    kept, doubts = problem.everything, list[str]()
    if how.loss != "linear":
        ends, kept, doubts = _robust(problem, ends, how.loss)
    best = ends[0][0]
    jacobian = problem.jacobian(best) / problem.sigma[:, None]
    slopes = linear(problem, best, jacobian, how.confidence, kept)
    lower, upper, warnings = slopes.lower, slopes.upper, list(slopes.warnings)
    if sides:
        profile = _profile(problem, ends, jacobian, (lower, upper), how.confidence)
        limits = told.each(profile, sides)
        lower, upper = (np.array([side.value for side in limits[k::2]]) for k in (0, 1))
        warnings = [w for w in warnings if AT_ITS_BOUND not in w and HARDLY not in w]
        warnings += unlimited(problem, limits, how.confidence)
    without = partial(_without, problem, problem.distinct(ends)[:AGAIN], jacobian, kept)
    found = dict(zip(left_out, told.each(without, left_out.values()), strict=True))
    held_out_modelled = np.full(problem.measured.size, np.nan)
    for name in groups:
        if name in found and found[name].held is not None:
            held_out_modelled[found[name].out] = found[name].modelled
    warnings += [*_too_far(problem, best, kept), *other_minima(problem, ends), *doubts]
    warnings += [f"{one.unknown} {name}{UNKNOWN}" for name, one in found.items() if one.unknown]
    held = {name: one.held for name, one in found.items() if one.held is not None}
    return Fit(
        problem.parameters,
        problem.values(best),
        lower,
        upper,
        slopes.correlation,
        problem.measured,
        problem.predictions(best[None])[0],
        problem.sigma,
        problem.group,
        np.array([[*problem.values(place), cost] for place, cost in ends]),
        held_out_modelled,
        {name: one for name, one in held.items() if name in groups},
        {name: one for name, one in held.items() if name not in groups},
        tuple(warnings),
    )


UNKNOWN = (
    ": leaving it out, nothing says the value and there is no prediction; share the parameter or "
    "give a closure"
)


class _Told:
    """Searches, side by side or in turn, that tell how many are done."""

    def __init__(self, how: Search, total: int) -> None:
        self.how, self.total, self.done = how, total, 0
        self.report(0)

    def report(self, more: int) -> None:
        self.done += more
        if self.how.progress is not None:
            self.how.progress(self.done, self.total)

    def each(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """What a function gives for each, in their order."""
        executor = self.how.executor
        results = []
        for one in map(function, items) if executor is None else executor.map(function, items):
            results.append(one)
            self.report(1)
        return results


def _too_far(problem: Problem, place: Array, kept: Mask) -> list[str]:
    """A warning where known errors do not explain by how much what is kept is missed."""
    residual = problem.residuals(place[None])[0, kept]
    freedom = residual.size - problem.adjusted * residual.size / kept.size - place.size
    chance = problem.scipy.stats.chi2.sf((residual**2).sum(), max(freedom, 1.0))
    if not problem.adjusted or chance > MISFIT:
        return []
    return [
        f"what was measured is missed by {_rms(residual):.2g} standard errors, which good "
        f"measurements of such a screen do in {chance:.1g} of surveys: look for gross errors "
        "(vibroscreen reconcile), for what of the screen is not as its file says, or fit more of "
        "its numbers; the intervals are wider by as much"
    ]


def _robust(problem: Problem, ends: Sequence[End], loss: str) -> tuple[list[End], Mask, list[str]]:
    """Ends by a robust loss, what counts in them, and which groups do not."""
    found, kept, told = problem.odd(ends)
    found = problem.robust(found, loss, kept)
    good, doubts = problem.doubted(found[0][0], kept)
    return (problem.robust(found, loss, good) if doubts else found), good, [*told, *doubts]


def _profile(
    problem: Problem,
    ends: Sequence[End],
    jacobian: Array,
    slopes: tuple[Array, Array],
    confidence: float,
) -> Callable[[Side], Side]:
    """What finds a limit; slopes: the limits that the slopes give."""
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (
            np.array([problem.place(v, k) for k, v in enumerate(limit)]) for limit in slopes
        )
        reach = 0.5 * (high - low)
    reach = np.where(np.isfinite(reach) & (reach > 0.0), reach, 1.0)
    least = ends[0][1]
    freedom = problem.measured.size - len(problem.parameters) - problem.adjusted
    stats, chance = problem.scipy.stats, 0.5 + 0.5 * confidence
    if problem.adjusted:
        level = stats.norm.ppf(chance) ** 2 * max(least / freedom, 1.0)
    else:
        level = stats.t.ppf(chance, freedom) ** 2 * least / freedom
    return lambda side: profiled(
        problem, ends, jacobian, float(reach[side.number]), side, float(level)
    )


@dataclass(frozen=True, eq=False)
class _Without:
    """A fit to the others: which numbers were left out, what it predicts of them.

    unknown: parameters that the others say nothing of, in words; then held is None.
    """

    out: Mask
    unknown: str = ""
    modelled: Array | None = None
    held: HeldOut | None = None


def _without(
    problem: Problem, places: Sequence[Array], jacobian: Array, kept: Mask, names: frozenset[str]
) -> _Without:
    """The fit without some groups, from places."""
    out = np.array([one in names for one in problem.group])
    unknown = [
        p.name
        for p, column in zip(problem.parameters, jacobian[~out].T, strict=True)
        if not column.any()
    ]
    if unknown:
        return _Without(out, f"{', '.join(unknown)} acts on no run but")
    ends = [problem.search(start, kept & ~out) for start in places]
    place = min(ends, key=lambda end: end[1])[0]
    modelled = problem.predictions(place[None])[0, out]
    miss = modelled - problem.measured[out]
    held = HeldOut(problem.values(place), _rms(miss), _rms(miss / problem.sigma[out]))
    return _Without(out, "", modelled, held)


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))
