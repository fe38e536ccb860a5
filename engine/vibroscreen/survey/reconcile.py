"""Streams by class that balance, from sheets that do not: weighted least squares with constraints.

Unknown are the rates by class of all products of a run; the feed and what passes each deck are
their sums, so that the balances over the box and every deck hold by construction. Measured rates,
shares and classes are met as well as their standard errors ask for, none below 0. Adjustments,
covariance and tests are those of Narasimhan and Jordache, Data Reconciliation and Gross Error
Detection, 2000, ch. 3 and 7: the global test on the sum of squares, the measurement test on each
adjustment over its own standard error, and the same along a factor on all readings of one scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import InputError
from vibroscreen.stream import product_names
from vibroscreen.survey.read import Survey, SurveyRun
from vibroscreen.units import MM, PERCENT, T_H

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Measurement", "Noise", "Reconciled", "Reconciliation", "Rows", "ScaleTest", "reconcile"]

Array = NDArray[np.float64]

# Chances of a false alarm of the three tests; together one survey in 20.
GLOBAL, BY_SCALE, BY_MEASUREMENT = 0.005, 0.04, 0.005
# Draws that the limit of the scales' tests is read from; twice the log of a ratio of likelihoods.
DRAWS, AS_LIKELY = 40_000, 3.84
# A measurement without redundancy: its adjustment is 0 whatever it says.
REDUNDANT = 1e-6
RANK = 1e-7  # of the largest singular value
# Pull of what nothing determines towards even shares: too weak to be seen where something does.
PULL = 1e-7
MOST_ITERATIONS = 50
MOST_CLASSES = 200
CONVERGED = 1e-11


@dataclass(frozen=True)
class Noise:
    """Standard errors of what comes without: the model of scales, sampling and sieving.

    scale: of a rate, relative; sieve: of a share that passes, absolute [1]; class_rate: of a rate
    by class, relative, and at least `floor` of its stream. Raises InputError.
    """

    scale: float = 0.04
    sieve: float = 0.008
    class_rate: float = 0.05
    floor: float = 0.0005

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and 0.0 < value < 1.0):
                raise InputError(
                    f"noise.{name} = {value:g} is no standard error: give a share above 0 and "
                    "below 1",
                    name,
                )


@dataclass(frozen=True)
class Measurement:
    """A number that was measured, and what became of it.

    kind: "rate" [kg/s], "passing" [1] at a size, or "class" [kg/s] that ends at a size [m]. value,
    sigma and fitted in its unit. test: adjustment over its own standard error, 0 where there is no
    redundancy; redundancy: 0, nothing checks it, to 1, all else says it.
    """

    run: str
    stream: str
    kind: str
    size: float
    value: float
    sigma: float
    fitted: float
    test: float
    redundancy: float

    @property
    def adjustment(self) -> float:
        """What was added to the measured value, in standard errors."""
        return (self.fitted - self.value) / self.sigma

    def __str__(self) -> str:
        at = f" {self.size / MM:.4g} mm" if self.kind != "rate" else ""
        unit, name = (PERCENT, "%") if self.kind == "passing" else (T_H, "t/h")
        return (
            f"run {self.run!r}, {self.stream}, {self.kind}{at}: {self.value / unit:.4g} {name} "
            f"measured, {self.fitted / unit:.4g} fits"
        )


@dataclass(frozen=True, eq=False)
class Reconciled:
    """A run whose streams balance.

    edges: limits of the classes [m], the last inf where the coarsest sieve did not pass all. By
    stream: rates [class] and their standard errors [kg/s], 0 for rates that are held at 0 as the
    measurements would take them below; whether each is determined, by them or as 0. products:
    the order of covariance[product class, product class] [kg2/s2], of what is determined. rows and
    sigma: what was measured and its standard errors.
    """

    name: str
    edges: tuple[float, ...]
    rates: Mapping[str, Array]
    error: Mapping[str, Array]
    determined: Mapping[str, NDArray[np.bool_]]
    products: tuple[str, ...]
    covariance: Array
    run: SurveyRun
    rows: Rows = field(repr=False)
    sigma: Array = field(repr=False)

    def through(self, deck: int) -> Array:
        """What passes a deck, from 1, by class [kg/s]: the feed of the next one."""
        found: Array = sum(
            (self.rates[name] for name in self.products[: len(self.products) - deck]),
            start=np.zeros(len(self.edges) - 1),
        )
        return found


@dataclass(frozen=True)
class ScaleTest:
    """How a scale stands to all else: the factor that it reads by, its standard error, the test."""

    stream: str
    factor: float
    error: float
    test: float

    def __str__(self) -> str:
        off = self.factor - 1.0
        return (
            f"{self.stream} read {abs(off) / PERCENT:.3g} % too {'high' if off > 0 else 'low'} in "
            f"all runs (standard error {self.error / PERCENT:.2g} %)"
        )


@dataclass(frozen=True, eq=False)
class Reconciliation:
    """Runs that balance, what was adjusted, and what is suspect.

    squares: sum of squared adjustments in sigmas, to be compared with freedom, the redundancy;
    chance: that good measurements do no better. limit_scale, limit_measurement: of the tests.
    warnings: gross errors and what cannot be determined, in plain words.
    """

    runs: tuple[Reconciled, ...]
    measurements: tuple[Measurement, ...]
    squares: float
    freedom: int
    chance: float
    scales: tuple[ScaleTest, ...]
    limit_scale: float
    limit_measurement: float
    gross_errors: tuple[str, ...]
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """All that should be looked at."""
        return (*self.gross_errors, *self.undetermined)

    def frame(self) -> pd.DataFrame:
        """Table of the streams: run, stream, limits [m], rate and standard error [kg/s]."""
        import pandas as pd

        return pd.DataFrame(
            [
                (run.name, stream, low, high, rate, error, bool(known))
                for run in self.runs
                for stream, rates in run.rates.items()
                for low, high, rate, error, known in zip(
                    run.edges[:-1],
                    run.edges[1:],
                    rates.tolist(),
                    run.error[stream].tolist(),
                    run.determined[stream].tolist(),
                    strict=True,
                )
            ],
            columns=["run", "stream", "lower_m", "upper_m", "rate", "error", "determined"],
        )

    def measurement_frame(self) -> pd.DataFrame:
        """Table of the measurements, with adjustments and tests in sigmas."""
        import pandas as pd

        rows = [{**vars(one), "adjustment": one.adjustment} for one in self.measurements]
        return pd.DataFrame(rows)


def reconcile(
    survey: Survey, noise: Noise | None = None, decks: int | None = None
) -> Reconciliation:
    """Streams of every run that balance over the box and every deck, by class.

    noise: standard errors of what comes without; decks: as many as the streams tell unless given.
    Raises InputError, ImportError without scipy.
    """
    try:
        import scipy.optimize  # noqa: F401
    except ImportError:
        raise ImportError(
            "vibroscreen.survey.reconcile needs scipy, which is not installed: "
            "pip install 'vibroscreen[calibrate]'"
        ) from None
    noise = noise or Noise()
    products = _products(survey, decks)
    parts = [_solved(run, products, noise) for run in survey.runs]
    return _tested(parts, survey.notes)


def _products(survey: Survey, decks: int | None) -> tuple[str, ...]:
    """Products from the lowest deck up: what passes deck k is the sum of the first D + 1 - k."""
    told = 1 + max(
        (
            int(stream[len("intermediate[") : -1])
            for run in survey.runs
            for stream in run.sheets
            if stream.startswith("intermediate")
        ),
        default=0,
    )
    if decks is not None and told > decks:
        raise InputError(
            f"intermediate[{told - 1}] is the oversize of deck {told}, and the screen has {decks}: "
            "number the middle products from the top, intermediate[1] left over deck 2",
            "stream",
        )
    count = decks or told
    if count > 4:
        raise InputError(
            f"intermediate[{count - 1}] is the oversize of deck {count}: a box has up to 4",
            "stream",
        )
    return product_names(count)[::-1]


# --- one run -------------------------------------------------------------------------------------
class Rows:
    """What was measured in a run, as rows over the unknowns.

    A measurement is part[j] x over whole[j] x, where whole is 0 for rates; x in units of `unit`.
    """

    def __init__(self, run: SurveyRun, products: Sequence[str], noise: Noise) -> None:
        self.run, self.products, self.noise = run, tuple(products), noise
        self._columns: dict[str, Array] = {}
        sheets = run.sheets.values()
        sizes = np.unique(np.concatenate([[0.0], *(sheet.sizes for sheet in sheets)]))
        apart = np.append(True, np.diff(sizes) > 1e-6 * sizes[1:])
        self.edges = sizes[apart]
        if any(sheet.class_rates is None for sheet in sheets):
            self.edges = np.append(self.edges, math.inf)
        self.classes = self.edges.size - 1
        if self.classes < 1:
            raise InputError(f"run {run.name!r} has no gradation: give shares by sieve", "run")
        if self.classes > MOST_CLASSES:
            raise InputError(
                f"run {run.name!r} has {self.classes} sieves over all streams: keep up to "
                f"{MOST_CLASSES}, those around the apertures first",
                "sieve",
            )
        self.told: list[tuple[str, str, float, float, float]] = []
        part, whole = [], []
        for stream, sheet in run.sheets.items():
            total = self.columns(stream)
            if not math.isnan(sheet.rate):
                self.told.append((stream, "rate", 0.0, sheet.rate, sheet.rate_error))
                part.append(total.sum(axis=0))
                whole.append(np.zeros(total.shape[1]))
            values = sheet.passing if sheet.class_rates is None else sheet.class_rates
            if values is None:
                continue
            kind = "passing" if sheet.class_rates is None else "class"
            below = 0.0
            errors = np.full(values.size, math.nan) if sheet.error is None else sheet.error
            for size, value, error in zip(sheet.sizes, values, errors, strict=True):
                finer = self.edges[1:] < size * (1.0 + 1e-6)
                if kind == "class":
                    finer &= self.edges[1:] > below * (1.0 + 1e-6)
                    below = size
                    if math.isnan(value):
                        continue
                self.told.append((stream, kind, size, float(value), float(error)))
                part.append(total[finer].sum(axis=0))
                whole.append(total.sum(axis=0) if kind == "passing" else np.zeros(total.shape[1]))
        rated = [t for t in self.told if t[1] != "passing" and t[3] > 0.0]
        if not rated:
            raise InputError(
                f"run {run.name!r}: no rate above 0 is measured, so no stream has one: give the "
                "rate of one stream",
                "rate",
            )
        self.part, self.whole = np.array(part), np.array(whole)
        self.is_share = np.array([t[1] == "passing" for t in self.told])
        self.unit = max(t[3] for t in rated)
        self.value = np.array([t[3] for t in self.told])
        self.value[~self.is_share] /= self.unit

    def columns(self, stream: str) -> Array:
        """Rates of a stream by class over the unknowns: [class, product class]."""
        if stream not in self._columns:
            weight = [1.0 if stream in ("feed", name) else 0.0 for name in self.products]
            self._columns[stream] = np.kron(np.array(weight), np.eye(self.classes))
        return self._columns[stream]

    def sigma(self, x: Array | None) -> Array:
        """Standard errors; where they are not known by their model at x, or at what is measured."""
        found = np.empty(len(self.told))
        expected = self.value if x is None else self.expected(x)
        totals = {
            s: math.fsum(t[3] for t in self.told if t[0] == s and t[1] == "class") / self.unit
            for s in self.run.sheets
        }
        for j, (stream, kind, _, _, error) in enumerate(self.told):
            if not math.isnan(error):
                found[j] = error if kind == "passing" else error / self.unit
            elif kind == "passing":
                found[j] = self.noise.sieve
            elif kind == "rate":
                found[j] = self.noise.scale * max(expected[j], 0.01)
            else:
                total = totals[stream] if x is None else float((self.columns(stream) @ x).sum())
                least = self.noise.floor * max(total, 0.01)
                found[j] = math.hypot(self.noise.class_rate * expected[j], least)
        return found

    def expected(self, x: Array) -> Array:
        """What the measurements should be at x, or at rows of x."""
        found: Array = x @ self.part.T
        whole = x @ self.whole.T
        return np.divide(found, whole, out=found, where=self.is_share & (whole > 0.0))

    def slope(self, x: Array) -> Array:
        """Derivative of what is expected by x."""
        whole = np.where(self.is_share, np.maximum(self.whole @ x, 1e-9), 1.0)[:, None]
        share = np.where(self.is_share, self.expected(x), 0.0)[:, None]
        found: Array = (self.part - share * self.whole) / whole
        return found


@dataclass(frozen=True, eq=False)
class _Solved:
    """A run solved: its rows, unknowns, standard errors, and what the measurements determine."""

    rows: Rows
    x: Array
    sigma: Array
    axes: Array  # of what is free and determined, over singular values, [axis, unknown]
    slope: Array  # weighted
    rank: int
    determined: Array  # projection on what is determined or fixed at 0

    @cached_property
    def hat(self) -> Array:
        """How what is expected, over its standard errors, goes along the axes."""
        found: Array = self.slope @ self.axes.T
        return found


def _solved(run: SurveyRun, products: Sequence[str], noise: Noise) -> _Solved:
    rows = Rows(run, products, noise)
    sigma = rows.sigma(None)
    x = _first(rows, sigma)
    x = _least(rows, x, sigma, 1e-5)
    sigma = rows.sigma(x)  # by what was found: what was measured too low would weigh too much
    x = _least(rows, x, sigma, CONVERGED)
    slope = rows.slope(x) / sigma[:, None]
    # A rate at 0 that the measurements would take below it is fixed there.
    pushed = slope.T @ ((rows.expected(x) - rows.value) / sigma)
    free = (x > 1e-12) | (pushed < 1e-6)
    _, singular, axes = np.linalg.svd(slope[:, free], full_matrices=False)
    rank = int((singular > RANK * singular[0]).sum()) if singular.size else 0
    whole = np.zeros((rank, x.size))
    whole[:, free] = axes[:rank]
    known = whole.T @ whole + np.diag((~free).astype(float))
    return _Solved(rows, x, sigma, whole / singular[:rank, None], slope, rank, known)


def _first(rows: Rows, sigma: Array) -> Array:
    """Unknowns to begin with: shares times the rate that their stream may have."""
    share = np.where(rows.is_share, rows.value, 0.0)[:, None]
    matrix = (rows.part - share * rows.whole) / sigma[:, None]
    target = np.where(rows.is_share, 0.0, rows.value) / sigma
    return _above_zero(matrix, target)


def _above_zero(matrix: Array, target: Array) -> Array:
    """Least squares with no unknown below 0; what nothing determines is shared evenly."""
    from scipy.optimize import nnls

    count = matrix.shape[1]
    pull = PULL * float(np.abs(matrix).max()) * np.eye(count)
    try:
        found: Array = nnls(np.vstack([matrix, pull]), np.append(target, np.zeros(count)))[0]
    except RuntimeError:
        raise InputError(
            "the streams do not come to a balance: look for a rate or a share that is far off",
            "survey",
        ) from None
    return found


def _least(rows: Rows, x: Array, sigma: Array, end: float) -> Array:
    """The least sum of squares by Gauss and Newton, until no step is larger than `end`."""

    def cost(place: Array) -> float:
        return float((((rows.expected(place) - rows.value) / sigma) ** 2).sum())

    now = cost(x)
    for _ in range(MOST_ITERATIONS):
        slope = rows.slope(x) / sigma[:, None]
        target = slope @ x - (rows.expected(x) - rows.value) / sigma
        step = _above_zero(slope, target) - x
        part, there = 1.0, cost(x + step)
        while there > now * (1.0 + 1e-9) + 1e-9 and part > 1e-3:
            part *= 0.5
            there = cost(x + part * step)
        x, now = np.maximum(x + part * step, 0.0), there
        if np.abs(step).max() < end:
            break
    return x


# --- tests ---------------------------------------------------------------------------------------
def _tested(parts: Sequence[_Solved], notes: Sequence[str]) -> Reconciliation:
    """All runs with the tests over them."""
    from scipy.stats import chi2, norm

    measurements, squares, freedom = list[Measurement](), 0.0, 0
    for part in parts:
        own = _measured(part)
        measurements += own
        squares += math.fsum(one.adjustment**2 for one in own)
        freedom += len(own) - part.rank
    scales, limit_scale = _scales(parts)
    checked = sum(one.redundancy > REDUNDANT for one in measurements)
    alarm = 1.0 - (1.0 - BY_MEASUREMENT) ** (1.0 / max(checked, 1))
    found = Reconciliation(
        tuple(_reconciled(part) for part in parts),
        tuple(measurements),
        squares,
        freedom,
        float(chi2.sf(squares, freedom)) if freedom > 0 else 1.0,
        scales,
        limit_scale,
        float(norm.isf(0.5 * alarm)),
        (),
        tuple(_undetermined(parts)),
        tuple(notes),
    )
    return replace(found, gross_errors=tuple(_gross_errors(found)))


def _measured(part: _Solved) -> list[Measurement]:
    """What was measured in a run, and what became of it."""
    rows, expected = part.rows, part.rows.expected(part.x)
    residual = (rows.value - expected) / part.sigma
    redundancy = np.clip(1.0 - (part.hat**2).sum(axis=1), 0.0, 1.0)
    checked = redundancy > REDUNDANT
    test = np.where(checked, -residual / np.sqrt(np.where(checked, redundancy, 1.0)), 0.0)
    unit = np.where(rows.is_share, 1.0, rows.unit)
    told = zip(
        rows.told,
        (part.sigma * unit).tolist(),
        (expected * unit).tolist(),
        test.tolist(),
        redundancy.tolist(),
        strict=True,
    )
    return [
        Measurement(rows.run.name, stream, kind, size, value, sigma, fits, tested, checks)
        for (stream, kind, size, value, _), sigma, fits, tested, checks in told
    ]


def _scales(parts: Sequence[_Solved]) -> tuple[tuple[ScaleTest, ...], float]:
    """Each scale over all runs, and the limit that the largest of good ones seldom passes.

    A factor on all readings of a scale is estimated with all else as it is; factors of scales that
    weigh the same streams are correlated, so the limit is that of the largest of all together.
    """
    names = list(dict.fromkeys(name for part in parts for name in part.rows.run.sheets))
    pull, information, most = (
        np.zeros(len(names)),
        np.zeros((len(names),) * 2),
        np.zeros(len(names)),
    )
    for part in parts:
        rows, expected = part.rows, part.rows.expected(part.x)
        owns = np.array([[t[0] == name and t[1] != "passing" for t in rows.told] for name in names])
        lead = owns * (expected / part.sigma)
        seen = lead @ part.hat
        pull += lead @ ((rows.value - expected) / part.sigma)
        information += lead @ lead.T - seen @ seen.T
        most += (lead**2).sum(axis=1)
    weight = np.diag(information)
    kept = np.flatnonzero(weight > REDUNDANT * np.maximum(most, 1.0))
    if kept.size == 0:
        return (), math.inf
    pull, weight, error = pull[kept], weight[kept], weight[kept] ** -0.5
    together = information[np.ix_(kept, kept)] * np.outer(error, error)
    draws = np.random.default_rng(0).standard_normal((DRAWS, kept.size))
    turns, sizes, _ = np.linalg.svd(together, hermitian=True)
    largest = np.abs(draws @ (turns * np.sqrt(sizes)).T).max(axis=1)
    tests = zip(
        [names[k] for k in kept],
        (1.0 + pull / weight).tolist(),
        error.tolist(),
        (pull * error).tolist(),
        strict=True,
    )
    limit = float(np.quantile(largest, 1.0 - BY_SCALE))
    return tuple(ScaleTest(*told) for told in tests), limit


def _gross_errors(found: Reconciliation) -> list[str]:
    """What the tests find, the worst of a kind each: its error smears over the others."""
    said = []
    suspects = _suspects(found)
    if suspects:
        tests = " and ".join(f"{abs(one.test):.1f}" for one in suspects)
        cure = "that scale" if len(suspects) == 1 else "both scales, the survey cannot tell which"
        said.append(
            f"the rates of {', or those of '.join(map(str, suspects))} (test {tests} above "
            f"{found.limit_scale:.1f}): check {cure}, or leave its rates out"
        )
    worst = max(found.measurements, key=lambda one: abs(one.test), default=None)
    if worst is not None and abs(worst.test) > found.limit_measurement:
        said.append(
            f"{worst} (test {abs(worst.test):.1f} above {found.limit_measurement:.1f}): weigh it "
            "anew or leave it out"
        )
    if found.chance < GLOBAL:
        said.append(
            f"the measurements contradict each other more than their errors allow: "
            f"{found.squares:.1f} squared sigmas for a redundancy of {found.freedom}; there is a "
            "gross error, or the standard errors are too small"
        )
    return said


def _suspects(found: Reconciliation) -> list[ScaleTest]:
    """The scale that reads wrong, and a second one where it would explain the readings as well.

    As well: its likelihood is above that of 1 in 7, which a scale that is wrong seldom misses.
    """
    worst = sorted(found.scales, key=lambda one: -abs(one.test))[:2]
    if not worst or abs(worst[0].test) <= found.limit_scale:
        return []
    return [one for one in worst if worst[0].test ** 2 - one.test**2 < AS_LIKELY]


def _undetermined(parts: Sequence[_Solved]) -> list[str]:
    """What nothing says, by run and stream."""
    said = []
    for part in parts:
        rows = part.rows
        for stream in ("feed", *rows.products):
            known = _known(part, stream)
            if known.all():
                continue
            edges = rows.edges / MM
            spans = [
                f"above {edges[k]:.4g}"
                if k == known.size - 1 and math.isinf(edges[-1])
                else f"{edges[k]:.4g} to {edges[k + 1]:.4g}"
                for k in np.flatnonzero(~known)
            ]
            shown = ", ".join(spans[:4]) + (f" and {len(spans) - 4} more" if len(spans) > 4 else "")
            said.append(
                f"run {rows.run.name!r}: nothing determines {stream} at {shown} mm; what is given "
                "there are even shares"
            )
    return said


def _known(part: _Solved, stream: str) -> NDArray[np.bool_]:
    """By class whether the measurements determine a stream; what must be 0 is determined."""
    columns = part.rows.columns(stream)
    apart = np.abs(columns - columns @ part.determined).max(axis=1)
    known: NDArray[np.bool_] = (apart < 1e-5) | (columns @ part.x < 1e-9)
    return known


def _reconciled(part: _Solved) -> Reconciled:
    rows = part.rows
    x = part.x.reshape(len(rows.products), rows.classes) * rows.unit
    rates: dict[str, Array] = {"feed": x.sum(axis=0), **dict(zip(rows.products, x, strict=True))}
    axes = part.axes * rows.unit
    error = {name: np.sqrt(((axes @ rows.columns(name).T) ** 2).sum(axis=0)) for name in rates}
    known = {name: _known(part, name) for name in rates}
    count = rows.classes
    if math.isinf(rows.edges[-1]) and x[:, -1].max() < 1e-9 * rows.unit:
        count -= 1  # nothing is coarser than the coarsest sieve
    axes = axes[:, np.tile(np.arange(rows.classes) < count, len(rows.products))]
    return Reconciled(
        rows.run.name,
        tuple(rows.edges[: count + 1].tolist()),
        {name: values[:count] for name, values in rates.items()},
        {name: values[:count] for name, values in error.items()},
        {name: values[:count] for name, values in known.items()},
        rows.products,
        axes.T @ axes,
        rows.run,
        rows,
        part.sigma,
    )
