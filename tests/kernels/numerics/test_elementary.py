"""Elementary functions of the kernels against sixty digits, and where a number ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal, getcontext, localcontext

import numpy as np
import pytest

from vibroscreen.compiler import elementary

DIGITS = 60
ONE = Decimal(1)


def exact(function: Callable[..., Decimal]) -> Callable[..., Decimal]:
    """A function of Decimal that works with DIGITS digits."""

    def worked(*arguments: float) -> Decimal:
        with localcontext() as context:
            context.prec = DIGITS
            return +function(*map(Decimal, arguments))

    return worked


def sine(x: Decimal) -> Decimal:
    """Taylor's series; the argument goes up to 1e6, so digits are added for what cancels."""
    getcontext().prec = DIGITS + 10
    x = x % (2 * pi())
    term, total, n = x, x, 1
    while abs(term) > Decimal(10) ** -DIGITS:
        term *= -x * x / ((n + 1) * (n + 2))
        total, n = total + term, n + 2
    return total


def pi() -> Decimal:
    """Machin's formula."""

    def arctan_of_one_over(n: int) -> Decimal:
        power, total, k = ONE / n, ONE / n, 1
        while abs(power) > Decimal(10) ** -(DIGITS + 10):
            power /= -n * n
            total, k = total + power / (2 * k + 1), k + 1
        return total

    return 4 * (4 * arctan_of_one_over(5) - arctan_of_one_over(239))


EXACT = {
    "exp": exact(Decimal.exp),
    "log": exact(Decimal.ln),
    "raised": exact(lambda x, y: (y * x.ln()).exp()),
    "sin": exact(sine),
    "cos": exact(lambda x: sine(x + pi() / 2)),
    "tan": exact(lambda x: sine(x) / sine(x + pi() / 2)),
    "sinh": exact(lambda x: (x.exp() - (-x).exp()) / 2),
    "cosh": exact(lambda x: (x.exp() + (-x).exp()) / 2),
}


def error(name: str, *arguments: float) -> float:
    """Error of a function, in units in the last place of the result."""
    got, wanted = getattr(elementary, name)(*arguments), EXACT[name](*arguments)
    return abs(float((Decimal(got) - wanted) / Decimal(math.ulp(float(wanted)))))


def spread(low: float, high: float, seed: int = 1) -> list[float]:
    return np.random.default_rng(seed).uniform(low, high, 300).tolist()


def spread_log(low: float, high: float, seed: int = 2) -> list[float]:
    return np.exp(spread(math.log(low), math.log(high), seed)).tolist()


RANGES = {
    "exp": ([*spread(-1, 1), *spread(-700, 700), *spread_log(1e-20, 1), 0.0], 0.9),
    "log": ([*spread(0.5, 2), *spread(0.999, 1.001), *spread_log(1e-307, 1e307), 5e-324], 0.9),
    "sin": ([*spread(-4, 4), *spread(-1e6, 1e6), *spread_log(1e-20, 1)], 0.9),
    "cos": ([*spread(-4, 4), *spread(-1e6, 1e6)], 0.9),
    "tan": ([*spread(-1.6, 1.6), *spread(-1e6, 1e6), *spread_log(1e-20, 1)], 2.0),
    "sinh": ([*spread(-2, 2), *spread(-709, 709), *spread_log(1e-5, 1)], 2.0),
    "cosh": ([*spread(-2, 2), *spread(-709, 709)], 2.0),
}


@pytest.mark.parametrize("name", RANGES)
def test_errors_are_as_stated(name: str) -> None:
    places, bound = RANGES[name]
    worst = max(places, key=lambda x: error(name, x))
    assert error(name, worst) < bound, f"{name}({worst!r})"


def test_angles_beside_quarter_turns() -> None:
    """Where a sine or cosine is nearly zero all its digits come from what reduction leaves."""
    quarters = [k * math.pi / 2 for k in (*range(-40, 41), 999, 1000, 636_000, 636_001)]
    assert max(error("sin", x) for x in quarters if x) < 0.9
    assert max(error("cos", x) for x in quarters) < 0.9


def test_raised() -> None:
    exponents = [0.2, 0.25, -0.25, -0.5, 1.0 / 3.0, 1.0, 2.0, 7.0, *spread(-1.0, 1.0)[:40]]
    near = [(x, y) for x in spread_log(1e-12, 1e12)[:40] for y in exponents]
    assert max(error("raised", x, y) for x, y in near if abs(y * math.log(x)) < 40.0) < 0.9
    bases = spread_log(1e-300, 1e300)
    far = [(x, y / math.log(x)) for x, y in zip(bases, spread(-690, 690), strict=True)]
    assert max(error("raised", x, y) for x, y in far) < 4.0


INF = math.inf


@pytest.mark.parametrize(
    ("name", "arguments", "value"),
    [
        ("exp", (INF,), INF),
        ("exp", (-INF,), 0.0),
        ("exp", (709.79,), INF),
        ("exp", (709.78,), math.exp(709.78)),
        ("exp", (-745.2,), 0.0),
        ("exp", (-745.1,), 5e-324),
        ("log", (0.0,), -INF),
        ("log", (1.0,), 0.0),
        ("log", (INF,), INF),
        ("raised", (0.0, 2.0), 0.0),
        ("raised", (0.0, -2.0), INF),
        ("raised", (INF, -0.5), 0.0),
        ("raised", (INF, 0.5), INF),
        ("raised", (5.0, 0.0), 1.0),
        ("raised", (2.0, 1e300), INF),
        ("raised", (2.0, -1e300), 0.0),
        ("raised", (4.0, 0.5), 2.0),
        ("sin", (0.0,), 0.0),
        ("cos", (0.0,), 1.0),
        ("sinh", (0.0,), 0.0),
        ("cosh", (710.4,), math.cosh(710.4)),
    ],
)
def test_ends(name: str, arguments: tuple[float, ...], value: float) -> None:
    got = getattr(elementary, name)(*arguments)
    assert got == value or abs(got - value) <= 2.0 * math.ulp(value)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        *((name, (math.nan,)) for name in ("exp", "log", "sin", "cos", "tan", "sinh", "cosh")),
        *((name, (INF,)) for name in ("sin", "cos", "tan")),
        ("log", (-1.0,)),
        ("raised", (-1.0, 2.0)),
        ("raised", (math.nan, 2.0)),
        ("raised", (2.0, math.nan)),
    ],
)
def test_no_number(name: str, arguments: tuple[float, ...]) -> None:
    assert math.isnan(getattr(elementary, name)(*arguments))


@pytest.mark.parametrize("x", [1e7, -3e9, 1e15, 1e16, 1e22, -1e100, 1e299])
def test_angles_of_many_turns_stay_on_the_circle(x: float) -> None:
    sine, cosine = elementary.sine_cosine(x)
    assert sine * sine + cosine * cosine == pytest.approx(1.0, abs=1e-12)
    if abs(x) < 1e15:
        assert sine == pytest.approx(math.sin(x), abs=1e-15 * abs(x))
