"""Streams of solids: the feed as a user gives it, and what leaves the screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import InputError, told
from vibroscreen.fields import Number, Numbers, as_tuple, listed, said
from vibroscreen.keys import file_value, split
from vibroscreen.size_classes import coarse_first
from vibroscreen.units import PERCENT, T_H

Array = NDArray[np.float64]

MOST_FED = 5000.0  # kg/s, 18 000 t/h; the largest banana screens take half of it
# What a master's arithmetic may leave below zero or above one: taken as the limit itself.
ROUND_OFF = 1e-9
# Fractions that sum to one within this are normalised, others refused.
SUM_TOLERANCE = 1e-3
# Sums that differ from one by less are left alone, so that normalising twice changes nothing.
_SUM_ROUND_OFF = 1e-14

# Shares that sum to more are per cent.
_PER_CENT = 1.5
# Words in keys of lists that say what a feed is made of.
_SHARES = ("retained", "passing", "fraction", "distribution", "composition")
_MOIST = ("moisture", "moisture_content", "water", "water_content")


class _Rate(Number):
    """The feed rate, which is that of dry solids."""

    def meant(self, path: str, key: str, raw: Any) -> str | None:
        words, _ = split(key)
        if words not in _MOIST or not isinstance(raw, int | float):
            return super().meant(path, key, raw)
        share = raw * PERCENT if raw > 1.0 or words != key else float(raw)
        rate = file_value("feed", self.key)
        if not isinstance(rate, int | float):
            return f"{path} of dry solids, the moist rate times {1.0 - share:.6g}"
        dry = rate * (1.0 - share)
        return f"{path} = {dry:.6g} in its place, of dry solids: {rate:.6g} x (1 - {share:.6g})"


_RATE = _Rate(
    "rate_t_h",
    "kg/s",
    T_H,
    at_least=0.0,
    at_most=MOST_FED,
    also="feed feed_rate rate capacity throughput tonnage mass_flow_rate",
    slack=ROUND_OFF,
    variability="continuous",
    tells="Feed to the top deck",
    cure="give a finite rate, 0 for no feed",
    error=InputError,
)
# A number whose limits are checked after the type of all.
_ANY = Number("mass_fraction", cure="give a share of the mass", error=InputError)
_LEAST, _MOST = _RATE.limits
_FRACTION = Number(
    "mass_fraction",
    at_least=0.0,
    at_most=1.0,
    slack=ROUND_OFF,
    variability="continuous",
    tells="Mass fraction of the class in the feed; ignored while nothing is fed",
    cure="give a share of the mass",
    error=InputError,
)


def fractions_of_passing(passing: Sequence[float]) -> tuple[float, ...]:
    """Mass fraction of every class [1], finest first, from the cumulative passing at the limits.

    N + 1 values for N classes, ascending from 0 to 1. Raises InputError.
    """
    values = _numbers("feed.passing", passing)
    if len(values) < 2:
        raise InputError("feed.passing has fewer than 2 values: give one at every class limit")
    for place, value in enumerate(values, start=1):
        if value > 1.0 + SUM_TOLERANCE:
            raise _FRACTION.refusal(f"feed.passing[{place}]", value, "too_large")
    if values[0] > values[-1]:
        raise InputError(
            f"feed.passing falls from {values[0]:.6g} to {values[-1]:.6g}, the sizes rise: list "
            "both in the same order"
        )
    for place, wanted, cure in (
        (1, 0.0, "add a finer limit to the size classes"),
        (len(values), 1.0, "add a coarser limit to the size classes"),
    ):
        if abs(values[place - 1] - wanted) > SUM_TOLERANCE:
            raise InputError(
                f"feed.passing[{place}] = {values[place - 1]:.6g} is not {wanted:g}, all of the "
                f"feed lies in the classes: {cure}"
            )
    for place in range(2, len(values) + 1):
        if values[place - 1] < values[place - 2]:
            raise InputError(
                f"feed.passing[{place}] = {values[place - 1]:.6g} is smaller than "
                f"feed.passing[{place - 1}] = {values[place - 2]:.6g}: passing never falls with "
                "size, list it finest limit first"
            )
    return tuple(high - low for low, high in pairwise(values))


def checked_fractions(mass_fraction: Sequence[float]) -> tuple[float, ...]:
    """Mass fractions in 0..1 that sum to 1 [1], normalised where they do within 1e-3.

    Raises InputError that names the first one out of range, or `feed.mass_fraction` for the sum.
    """
    plain = as_tuple(mass_fraction) or ()
    kinds = set(map(type, plain))
    if kinds == {np.float64}:
        plain, kinds = tuple(map(float, plain)), {float}
    # Most feeds are floats in range, which need no check one by one; the sum tells of what is no
    # number and compares with nothing.
    if kinds == {float} and min(plain) >= 0.0 and max(plain) <= 1.0:
        total = math.fsum(plain)
        if abs(total - 1.0) <= SUM_TOLERANCE:
            return _normalised(plain, total)
    values = []
    for place, value in enumerate(_numbers("feed.mass_fraction", mass_fraction), start=1):
        share = min(max(value, 0.0), 1.0)
        if abs(share - value) > ROUND_OFF:
            _FRACTION.check(f"feed.mass_fraction[{place}]", value)
        values.append(share)
    total = math.fsum(values)
    if abs(total - 1.0) > SUM_TOLERANCE:
        raise InputError(told("bad_sum", value=total, limit=SUM_TOLERANCE), "feed.mass_fraction")
    return _normalised(tuple(values), total)


def _normalised(values: tuple[float, ...], total: float) -> tuple[float, ...]:
    """Fractions over their sum; as they are where that is one already."""
    if abs(total - 1.0) <= _SUM_ROUND_OFF:
        return values
    return tuple([value / total for value in values])


class _Composition(Numbers):
    """`mass_fraction` by class, or `passing` at the limits of the classes."""

    @property
    def keys(self) -> tuple[str, ...]:
        return (self.key, "passing")

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not raw:
            raise InputError(f"{name} = {raw!r} is empty: give one value a class or leave it out")
        if isinstance(raw, list) and coarse_first(file_value("size_classes", "edges_mm")):
            raw = raw[::-1]
        return fractions_of_passing(raw) if name.endswith("passing") else raw

    def check(self, name: str, value: Any) -> tuple[float, ...]:
        return checked_fractions(value) if value != () else ()

    def meant(self, path: str, key: str, raw: Any) -> str | None:
        numbers = isinstance(raw, list) and all(isinstance(one, int | float) for one in raw)
        if not numbers or not any(word in key for word in _SHARES):
            return None
        shares = [one * PERCENT if max(raw) > _PER_CENT else float(one) for one in raw]
        coarse = coarse_first(file_value("size_classes", "edges_mm"))
        rising = sorted(shares, reverse=coarse)
        passing = path.removesuffix("passing").removesuffix(self.key) + "passing"
        if "passing" in key or ("retained" in key and shares == rising):
            return f"{listed(passing, shares)}, what is finer than each size"
        if "retained" in key and shares == rising[::-1]:
            finer = [1.0 - share for share in shares]
            return f"{listed(passing, finer)}, what is finer than each size"
        return f"{listed(path, shares)}, the share of every class in the order of the sizes"


@dataclass(frozen=True)
class Feed:
    """What falls on the feed end: mass flow rate [kg/s] and mass fraction by class, finest first.

    Fractions lie in 0..1 and sum to 1 within 1e-3 (then they are normalised); they are ignored
    while the rate is zero. Without fractions the configuration fills in a typical composition.
    Raises InputError whose `variable` is the offending one, such as `feed.mass_fraction[3]`.
    """

    mass_flow_rate: float = said(300.0 * T_H, _RATE)
    mass_fraction: tuple[float, ...] = said((), _Composition("mass_fraction", _FRACTION))

    def __post_init__(self) -> None:
        rate = self.mass_flow_rate
        if type(rate) is not float or not _LEAST <= rate <= _MOST:
            rate = _RATE.check("feed.mass_flow_rate", _unrounded(rate))
            object.__setattr__(self, "mass_flow_rate", rate)
        fractions = as_tuple(self.mass_fraction)
        if fractions is None:
            fractions = checked_fractions(self.mass_fraction)
        elif fractions and rate > 0.0:
            fractions = checked_fractions(fractions)
        if fractions is not self.mass_fraction:
            object.__setattr__(self, "mass_fraction", fractions)

    @classmethod
    def of_passing(cls, rate: float, passing: Sequence[float]) -> Feed:
        """Feed of `rate` [kg/s] from the cumulative passing [1] at the limits of the classes."""
        return cls(rate, fractions_of_passing(passing))

    @property
    def class_rates(self) -> Array:
        """Mass flow rate of every class [kg/s], shape [N]."""
        if self.mass_flow_rate == 0.0:
            return np.zeros(len(self.mass_fraction))
        return self.mass_flow_rate * np.array(self.mass_fraction)

    def check_classes(self, count: int) -> None:
        """Refuse a feed that does not have `count` size classes, with InputError."""
        if len(self.mass_fraction) != count:
            raise InputError(
                f"feed.mass_fraction has {len(self.mass_fraction)} values, the screen has {count} "
                "size classes: give one fraction a class, finest first"
            )


@dataclass(frozen=True, eq=False)
class Stream:
    """Solids that flow: mass flow rate [kg/s] and mass fraction by class, finest first, shape [N].

    The fractions of a stream that does not flow repeat the last ones.
    """

    mass_flow_rate: float
    mass_fraction: Array

    @classmethod
    def of_class_rates(cls, class_rates: Array, last_fraction: Array) -> Stream:
        """Stream from the mass flow rate of every class [kg/s], shape [N]."""
        total = math.fsum(class_rates)
        return cls(total, class_rates / total if total > 0.0 else last_fraction.copy())

    @property
    def class_rates(self) -> Array:
        """Mass flow rate of every class [kg/s], shape [N]."""
        return self.mass_flow_rate * self.mass_fraction

    @property
    def passing(self) -> Array:
        """Cumulative mass fraction finer than every class limit [1], shape [N + 1]."""
        return np.concatenate([[0.0], np.cumsum(self.mass_fraction)])


def product_names(decks: int) -> tuple[str, ...]:
    """Names of the products of a box, from the top: `intermediate[k]` is left over deck k + 1."""
    return ("oversize", *(f"intermediate[{k}]" for k in range(1, decks)), "undersize")


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    """Values as floats; InputError for the first that is no finite number."""
    return Numbers(name.rpartition(".")[2], _ANY).check(name, values)


def _unrounded(value: Any) -> Any:
    """Zero for what round-off left below it, anything else as it is."""
    return 0.0 if isinstance(value, Real) and -ROUND_OFF <= float(value) < 0.0 else value
