"""How sure fitted numbers are, and what the data cannot tell.

Confidence is that of linear regression at the optimum, or the profile of the sum of squares (Bates
and Watts, Nonlinear Regression Analysis and Its Applications, 1988, ch. 2 and 6); of a robust fit
that of Huber, Robust Statistics, 1981, sec. 7.6. Collinearity is told by condition indices and
variance proportions (Belsley, Kuh and Welsch, Regression Diagnostics, 1980, ch. 3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vibroscreen.survey.search import ALIKE, End, Mask, Problem
from vibroscreen.units import PERCENT

__all__ = ["Linear", "Side", "linear", "other_minima", "profiled", "unlimited"]

Array = NDArray[np.float64]

AT_ITS_BOUND, HARDLY = "lies at its bound", "is hardly fixed by the data"
# Steps outwards before a limit of a profile lies between two places; by this part of it the root of
# the rise of the squares may miss that of the limit.
MOST_STEPS, NEAR_ENOUGH = 12, 0.02
# Places about which a limit is looked for.
MOST_LOOKS = 4
# Collinear from this condition index on (Belsley, Kuh and Welsch: 30), for the parameters that
# have more than half of their variance from it.
CONDITION = 30.0
SHARE = 0.5
AT_BOUND = 1e-4  # of the range
# Hardly fixed: an interval over more than a factor of 10, or half of a linear range.
WIDE = 0.5 * math.log(10.0)
TOGETHER = 0.9
# As good: within this part of the least sum of squares.
AS_GOOD = 0.01


@dataclass(frozen=True, eq=False)
class Linear:
    """Intervals from the slopes at the optimum: limits, correlation, and what is told."""

    lower: Array
    upper: Array
    correlation: Array
    warnings: tuple[str, ...]


def linear(
    problem: Problem, place: Array, jacobian: Array, confidence: float, kept: Mask
) -> Linear:
    """Limits, correlation, and what the data that are kept cannot tell.

    jacobian: of all predictions by places, over their standard errors, [n, p].
    """
    count, jacobian = place.size, jacobian[kept]
    bound = (place < AT_BOUND) | (place > 1.0 - AT_BOUND)
    norm = np.sqrt((jacobian**2).sum(axis=0))
    moves = norm > 1e-9 * max(1.0, float(norm.max()))
    free = np.flatnonzero(~bound & moves)
    residual = problem.residuals(place[None])[0, kept]
    freedom = max(residual.size - count - problem.adjusted, 1)
    error = np.full(count, np.inf)
    correlation = np.full((count, count), np.nan)
    np.fill_diagonal(correlation, 1.0)
    together: list[str] = []
    if free.size:
        scaled = jacobian[:, free] / norm[free]
        _, singular, axes = np.linalg.svd(scaled, full_matrices=False)
        singular = np.maximum(singular, 1e-12 * singular[0])
        variance = _scatter(problem, residual, freedom) * (axes.T / singular**2) @ axes
        deviation = np.sqrt(np.diag(variance))
        error[free] = deviation / norm[free]
        if deviation.all():
            correlation[np.ix_(free, free)] = variance / np.outer(deviation, deviation)
        names = [problem.parameters[k].name for k in free]
        together = list(_collinear(names, singular, axes))
    error[bound] = 0.0
    stats, chance = problem.scipy.stats, 0.5 + 0.5 * confidence
    quantile = stats.norm.ppf(chance) if problem.adjusted else stats.t.ppf(chance, freedom)
    reach = quantile * error
    with np.errstate(invalid="ignore"):
        lower, upper = problem.values(place - reach), problem.values(place + reach)
    values = problem.values(place)
    told = [
        f"{p.name} = {v:.4g} {AT_ITS_BOUND}: it has no interval, and the others are too "
        "narrow; widen the bound or fix the value"
        for p, v, at in zip(problem.parameters, values, bound, strict=True)
        if at
    ]
    told += [
        f"{p.name} changes nothing that was measured: leave it out"
        for p, m in zip(problem.parameters, moves, strict=True)
        if not m
    ]
    wide = _wide(problem, free, reach, lower, upper, correlation)
    return Linear(lower, upper, correlation, (*told, *together, *wide))


def _scatter(problem: Problem, residual: Array, freedom: int) -> float:
    """Variance of a residual of weight 1."""
    count = len(problem.parameters)
    weight, slope = problem.weights(residual)
    mean = float(slope.mean())
    scatter = float(((weight * residual) ** 2).sum()) / freedom
    if problem.loss != "linear":
        scatter *= (1.0 + count / residual.size * float(slope.var()) / mean**2) ** 2 / mean**2
    return max(scatter, 1.0) if problem.adjusted else scatter


def _collinear(names: Sequence[str], singular: Array, axes: Array) -> Iterator[str]:
    """Which parameters make up for each other."""
    parts = (axes / singular[:, None]) ** 2  # [axis, parameter]
    share = parts / parts.sum(axis=0)
    index = singular[0] / singular
    for axis in np.flatnonzero(index > CONDITION):
        involved = [name for name, part in zip(names, share[axis], strict=True) if part > SHARE]
        if len(involved) > 1:
            yield (
                f"the data cannot tell {' and '.join(involved)} apart (condition index "
                f"{index[axis]:.0f}): a change of one is made up for by the other; fix "
                "one, or add runs in which they act differently"
            )


def _wide(
    problem: Problem, free: NDArray[np.intp], reach: Array, lower: Array, upper: Array, r: Array
) -> Iterator[str]:
    """Which parameters have intervals that say hardly anything; r: their correlation."""
    for k in free.tolist():
        p = problem.parameters[k]
        if reach[k] <= (WIDE / problem.width[k] if p.scale == "log" else 0.25):
            continue
        with_others = "".join(
            f"; it goes with {problem.parameters[i].name} (correlation {r[k, i]:.2f})"
            for i in free.tolist()
            if i != k and abs(r[k, i]) > TOGETHER
        )
        yield (
            f"{p.name} {HARDLY}, 95 % interval {lower[k]:.2g} to {upper[k]:.2g}"
            f"{with_others}: fix it, or add runs that depend on it"
        )


def other_minima(problem: Problem, ends: Sequence[End]) -> list[str]:
    """A warning where starts end elsewhere and fit as well."""
    best, least = ends[0]
    good = [place for place, cost in ends if cost <= (1.0 + AS_GOOD) * least + 1e-12]
    apart = [p for p in good if np.abs(p - best).max() > 10.0 * ALIKE]
    if not apart:
        return []
    spread = np.abs(np.array(apart) - best).max(axis=0)
    values = problem.values(np.array([*apart, best]))
    said = ", ".join(
        f"{p.name} from {values[:, k].min():.3g} to {values[:, k].max():.3g}"
        for k, p in enumerate(problem.parameters)
        if spread[k] > 10.0 * ALIKE
    )
    return [
        f"{len(apart)} of {len(ends)} starts end elsewhere and fit as well: {said}; the data "
        "do not decide, narrow the bounds or measure more"
    ]


# --- profiles ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Side:
    """A limit of a profile: of which parameter, -1 below or 1 above; its value, and whether the
    squares have risen there, within the bounds."""

    number: int
    sign: float
    value: float = math.nan
    closed: bool = False


def profiled(
    problem: Problem, ends: Sequence[End], jacobian: Array, reach: float, side: Side, level: float
) -> Side:
    """Where the least sum of squares with one parameter held has risen by `level`.

    From the outermost of the minima that fit as well. jacobian: as of `linear`; reach: how far
    away the slopes have it, in places. What the predictions adjust goes with one place, where it
    does, until a limit is found; that is looked at once more by itself.
    """
    k, least = side.number, ends[0][1]
    good = [end for end in ends if end[1] < least + level]
    begin = max(good, key=lambda end: side.sign * end[0][k])[0]
    profile = _Profile(problem, k, begin, jacobian, least, level)
    step = min(reach, 0.1)
    for _ in range(MOST_LOOKS):
        place, closed = profile.limit(side.sign, step)
        if not closed or profile.stands(place):
            break
        step = max(abs(place - float(begin[k])), 1e-6)
    value = problem.values(np.where(np.arange(begin.size) == k, place, begin))[k]
    return Side(k, side.sign, float(value), closed)


class _Profile:
    """Root of the rise of the squares over a held parameter, less that at the limit."""

    def __init__(
        self, problem: Problem, held: int, begin: Array, jacobian: Array, least: float, level: float
    ) -> None:
        self.problem, self.held, self.begin, self.least = problem, held, begin, least
        self.root = math.sqrt(level)
        others = np.arange(begin.size) != held
        self.along = np.ones(begin.size)  # how the others go with it
        self.along[others] = -np.linalg.lstsq(jacobian[:, others], jacobian[:, held], rcond=None)[0]
        self._look_from(begin)

    def _look_from(self, place: Array) -> None:
        self.about = place if self.problem.about is not None else None
        self.found = {float(self.begin[self.held]): (self.begin, -self.root)}

    def over(self, at: float) -> float:
        """At a place of the parameter; 0 where that is near enough to the limit."""
        if at not in self.found:
            near, _ = self.found[min(self.found, key=lambda one: abs(one - at))]
            start = np.clip(near + (at - near[self.held]) * self.along, 0.0, 1.0)
            start[self.held] = at
            everything = self.problem.everything
            place, squares = self.problem.search(start, everything, self.held, self.about)
            self.found[at] = place, self._rise(squares)
        return self.found[at][1]

    def _rise(self, squares: float) -> float:
        rise = math.sqrt(max(squares - self.least, 0.0)) - self.root
        return 0.0 if abs(rise) <= NEAR_ENOUGH * self.root else rise

    def stands(self, at: float) -> bool:
        """Whether a limit that was found about another place is one by itself."""
        if self.about is None:
            return True
        place = self.found[at][0] if at in self.found else self.begin
        squares = float((self.problem.residuals(place[None]) ** 2).sum())
        self._look_from(place)
        return self._rise(squares) == 0.0

    def limit(self, sign: float, step: float) -> tuple[float, bool]:
        """Where it is 0, and whether that is within the bounds."""
        near, end = float(self.begin[self.held]), 1.0 if sign > 0.0 else 0.0
        for _ in range(MOST_STEPS):
            if abs(end - near) < AT_BOUND:
                return end, False
            far = min(max(near + sign * step, 0.0), 1.0)
            rise = self.over(far)
            if rise >= 0.0:
                break
            # as far again as the squares have yet to rise, and more; at most four times
            part = 1.1 * -rise / max(rise - self.over(near), 1e-9)
            step = abs(far - near) * min(max(part, 0.1), 4.0)
            near = far
        else:
            return end, False
        inside = 0.002 * abs(far - float(self.begin[self.held]))
        optimize = self.problem.scipy.optimize
        return float(optimize.brentq(self.over, near, far, xtol=inside, rtol=1e-12)), True


def unlimited(problem: Problem, sides: Sequence[Side], confidence: float) -> list[str]:
    """Which parameters the data do not limit."""
    told = []
    for k, p in enumerate(problem.parameters):
        own = [side for side in sides if side.number == k]
        open_sides = ["above" if s.sign > 0.0 else "below" for s in own if not s.closed]
        if open_sides:
            low, high = (side.value for side in own)
            told.append(
                f"the data do not limit {p.name} {' or '.join(open_sides)} within its bounds "
                f"{p.lower:.4g} to {p.upper:.4g} ({confidence / PERCENT:g} % interval {low:.3g} "
                f"to {high:.3g}): fix it, or add runs that depend on it"
            )
    return told
