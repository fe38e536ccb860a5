"""Searches for the least sum of squares, or of a robust loss, over named parameters.

A search is that of scipy (trust regions within the bounds), on places: 0 at the lower bound of a
parameter, 1 at the upper one, on its scale.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.errors import InputError
from vibroscreen.survey.parameters import Parameter
from vibroscreen.units import PERCENT

__all__ = ["LOSSES", "Predict", "Problem"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Predict = Callable[[Array], Array]
End = tuple[Array, float]

# Losses, and where they begin to hold back, in standard deviations: 95 per cent efficient for
# normal errors (Holland and Welsch, Communications in Statistics A 6, 1977, 813).
LOSSES = {"linear": math.inf, "huber": 1.345, "cauchy": 2.385}
# Of a group whose measurements count for less on average, good ones for 0.87 by Cauchy's loss.
DOUBTED = 0.5
# Chance of a false alarm by which a group is called odd.
ODD = 0.01
# Searches of a robust fit, each with the scale of the last; median of a normal's size.
ROUNDS, NORMAL_MEDIAN = 3, 0.6745
# Step of a central difference: part of the value ("log") or of the range ("linear"). Recoveries
# carry an error of the solver, so it is wide: the error of the difference is of second order.
STEP = 0.01
# Drawn for every start that is followed; the best of them are.
DRAWS_PER_START = 10
MOST_EVALUATIONS = 100
# A search ends with steps as small as this part of its place; with a parameter held, when only its
# squares are asked for, which are flat there.
END, END_HELD = 1e-6, 1e-3
# What a prediction that is not finite (a design that was refused) misses by, in measured units.
MISS = 1.0
# Starts end alike within this part of the range.
ALIKE = 0.02


def scipy_of_a_fit() -> Any:
    """The scipy modules of a fit. Raises ImportError."""
    try:
        import scipy.optimize
        import scipy.stats
    except ImportError:
        raise ImportError(
            "vibroscreen.calibrate needs scipy, which is not installed: "
            "pip install 'vibroscreen[calibrate]'"
        ) from None
    return scipy


class Problem:
    """What is fitted, to what, and how a search goes from a place.

    predict(points[k, p]): predictions [k, n]; about(point[p], points[k, p]): the same for points
    around one, where what predict adjusts by itself may go with that one; so slopes cost less.
    """

    def __init__(
        self,
        predict: Predict,
        parameters: Sequence[Parameter],
        measured: ArrayLike,
        sigma: ArrayLike,
        group: Sequence[str] = (),
        adjusted: int = 0,
        about: Callable[[Array, Array], Array] | None = None,
    ) -> None:
        self.scipy, self.adjusted = scipy_of_a_fit(), adjusted
        self.loss, self.scale = "linear", 1.0
        self.predict, self.about, self.parameters = predict, about, tuple(parameters)
        self.measured = np.asarray(measured, dtype=float)
        self.sigma = np.broadcast_to(np.asarray(sigma, dtype=float), self.measured.shape)
        self.group = tuple(group)
        self._check()
        self.low = np.array([p.to_scale(p.lower) for p in parameters])
        self.width = np.array([p.to_scale(p.upper) for p in parameters]) - self.low
        self.step = np.array(
            [
                STEP / w if p.scale == "log" else STEP
                for p, w in zip(parameters, self.width, strict=True)
            ]
        )
        self.everything = np.ones(self.measured.size, dtype=bool)

    def _check(self) -> None:
        names = [p.name for p in self.parameters]
        if not names or len(set(names)) < len(names):
            raise InputError(
                f"parameters = {', '.join(names) or 'none'}: give one or more, each name once",
                "parameters",
            )
        if self.measured.size <= len(names) + self.adjusted:
            by_class = f" and {self.adjusted} rates of the feed by class" if self.adjusted else ""
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

    # --- places, and what is predicted there -----------------------------------------------------
    def values(self, place: Array) -> Array:
        """Values [..., p] of places [..., p]."""
        scaled = self.low + place * self.width
        columns = [p.from_scale(scaled[..., k]) for k, p in enumerate(self.parameters)]
        return np.stack(columns, axis=-1)

    def place(self, value: float | Array, number: int) -> Any:
        """Place of values of a parameter."""
        scaled = self.parameters[number].to_scale(value)
        return (scaled - self.low[number]) / self.width[number]

    def predictions(self, places: Array, about: Array | None = None) -> Array:
        """Predictions [k, n] at places [k, p]; what is not finite misses by MISS."""
        points = self.values(places)
        if about is None or self.about is None:
            found = np.asarray(self.predict(points), dtype=float)
        else:
            found = self.about(self.values(about), points)
        if found.shape != (len(places), self.measured.size):
            raise InputError(
                f"predict gave the shape {found.shape} for {len(places)} points: give "
                f"{(len(places), self.measured.size)}",
                "predict",
            )
        return np.where(np.isfinite(found), found, self.measured + MISS)

    def residuals(self, places: Array, about: Array | None = None) -> Array:
        """Weighted residuals [k, n]."""
        weighted: Array = (self.predictions(places, about) - self.measured) / self.sigma
        return weighted

    def jacobian(self, place: Array, free: Mask | None = None, about: Array | None = None) -> Array:
        """Derivative [n, p] of the predictions by parameters that are free, by central differences.

        Within the bounds. about: as of `predictions`, the place itself unless given.
        """
        ahead = np.minimum(place + self.step, 1.0)
        behind = np.maximum(place - self.step, 0.0)
        moved = np.arange(place.size) if free is None else np.flatnonzero(free)
        count = moved.size
        points = np.tile(place, (2 * count, 1))
        points[np.arange(count), moved] = ahead[moved]
        points[count + np.arange(count), moved] = behind[moved]
        found = self.predictions(points, place if about is None else about)
        slope: Array = ((found[:count] - found[count:]) / (ahead - behind)[moved, None]).T
        return slope

    # --- searches --------------------------------------------------------------------------------
    def starts(self, count: int, seed: int) -> list[Array]:
        """Places to start at: that of the parameters, then the best of those drawn."""
        first = np.array(
            [
                0.5 if p.start is None else self.place(p.start, k)
                for k, p in enumerate(self.parameters)
            ]
        )
        if count < 2:
            return [first]
        draw = self.scipy.stats.qmc.LatinHypercube(len(self.parameters), rng=seed)
        drawn = draw.random(DRAWS_PER_START * (count - 1))
        order = np.argsort((self.residuals(drawn, first) ** 2).sum(axis=1), kind="stable")
        return [first, *drawn[order[: count - 1]]]

    def search(
        self, start: Array, kept: Mask, held: int | None = None, about: Array | None = None
    ) -> End:
        """The minimum that a start leads to, over the numbers that are kept, and its squares.

        held: a parameter that stays where it starts; about: as of `predictions`.
        """
        weight = 1.0 / self.sigma[kept]
        free = np.arange(start.size) != (-1 if held is None else held)

        def whole(part: Array) -> Array:
            place = start.copy()
            place[free] = part
            return place

        if not free.any():
            return start, float((self.residuals(start[None], about)[0, kept] ** 2).sum())
        found = self.scipy.optimize.least_squares(
            lambda part: self.residuals(whole(part)[None], about)[0, kept],
            np.clip(start[free], 1e-6, 1.0 - 1e-6),
            jac=lambda part: self.jacobian(whole(part), free, about)[kept] * weight[:, None],
            bounds=(0.0, 1.0),
            loss=self.loss,
            f_scale=self.scale,
            xtol=END if held is None else END_HELD,
            ftol=1e-9 if held is None else 1e-4,
            gtol=1e-10,
            max_nfev=MOST_EVALUATIONS,
        )
        return whole(found.x), 2.0 * float(found.cost)

    def distinct(self, ends: Sequence[End]) -> list[Array]:
        """Ends that are not alike, best first."""
        apart: list[Array] = []
        for place, _ in ends:
            if all(np.abs(place - other).max() > ALIKE for other in apart):
                apart.append(place)
        return apart

    # --- robust losses ---------------------------------------------------------------------------
    def odd(self, ends: Sequence[End]) -> tuple[list[End], Mask, list[str]]:
        """Ends of least squares without the groups that do not go with the others.

        And which numbers are of the others, and what is told. A group is odd where the squares
        without it are fewer by more than chance has (Chow, Econometrica 28, 1960, 591); the oddest
        first, as long as most groups are left.
        """
        group, kept, told = np.array(self.group), self.everything, list[str]()
        count = len(dict.fromkeys(self.group))
        found = list(ends)
        while len(told) + 1 < 0.5 * count:
            place, squares = found[0]
            names = dict.fromkeys(group[kept].tolist())
            without = {name: self.search(place, kept & (group != name)) for name in names}
            chances = {
                name: self._chance(squares, end[1], kept, group == name)
                for name, end in without.items()
            }
            name = min(chances, key=lambda one: chances[one])
            if chances[name] * len(names) > ODD:
                break
            kept = kept & (group != name)
            found = [without[name]]
            told.append(
                f"{name} lies far from the fit to the others, which chance alone does in "
                f"{chances[name]:.1g} of surveys: it is left out of the fit, look for a gross "
                "error in it"
            )
        return found, kept, told

    def _chance(self, squares: float, without: float, kept: Mask, out: Mask) -> float:
        """Chance that a group takes as many squares with it, if it is as the others."""
        stats = self.scipy.stats
        part = 1.0 - self.adjusted / kept.size  # of the numbers that are not used up by the feed
        of_group = part * float((kept & out).sum())
        of_others = part * float((kept & ~out).sum()) - len(self.parameters)
        if of_others <= 0.0:
            return 1.0
        gone = max(squares - without, 0.0)
        if self.adjusted:
            return float(stats.chi2.sf(gone, of_group))
        scatter = max(without / of_others, 1e-300)
        return float(stats.f.sf(gone / of_group / scatter, of_group, of_others))

    def robust(self, ends: Sequence[End], loss: str, kept: Mask) -> list[End]:
        """Ends again by another loss, whose scale is that of the middle half of the residuals."""
        places = self.distinct(ends)
        for _ in range(ROUNDS):
            known = 1.0 if self.adjusted else self.spread(places[0], kept)
            self.loss, self.scale = loss, LOSSES[loss] * known
            found = sorted((self.search(place, kept) for place in places), key=lambda end: end[1])
            places = self.distinct(found)
        return found

    def spread(self, place: Array, kept: Mask) -> float:
        """Standard deviation of residuals by the middle half of them, above 0."""
        residual = self.residuals(place[None])[0, kept]
        found = float(np.median(np.abs(residual))) / NORMAL_MEDIAN
        found *= math.sqrt(residual.size / (residual.size - len(self.parameters)))
        return max(found, 1e-12)

    def weights(self, residual: Array) -> tuple[Array, Array]:
        """How much each residual counts, and the slope of what it pulls with."""
        if self.loss == "linear":
            return np.ones_like(residual), np.ones_like(residual)
        u = np.abs(residual) / self.scale
        if self.loss == "huber":
            return 1.0 / np.maximum(u, 1.0), (u <= 1.0).astype(float)
        return 1.0 / (1.0 + u**2), (1.0 - u**2) / (1.0 + u**2) ** 2

    def doubted(self, place: Array, kept: Mask) -> tuple[Mask, list[str]]:
        """Which of the numbers that are kept are of groups that count, and what is told."""
        weight, _ = self.weights(self.residuals(place[None])[0])
        group = np.array(self.group or ("",) * weight.size)
        names = dict.fromkeys(group[kept].tolist()) if self.group else {}
        means = {name: float(weight[kept & (group == name)].mean()) for name in names}
        doubted = [name for name, mean in means.items() if mean < DOUBTED]
        good = kept & ~np.isin(group, doubted)
        if good.sum() <= len(self.parameters) + self.adjusted:
            good = kept
        left_out = "it is left out of the fit, " if good is not kept else ""
        return good, [
            f"{name} lies far from the fit to the others, its measurements count for "
            f"{means[name] / PERCENT:.0f} % on average: {left_out}look for a gross error in it"
            for name in doubted
        ]
