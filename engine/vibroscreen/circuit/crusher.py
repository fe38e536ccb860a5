"""Crushers: Whiten's classification and breakage matrices, power by Bond's third theory, capacity.

Sources
[1] W. J. Whiten, The simulation of crushing plants with models developed using multiple spline
    regression, J. S. Afr. Inst. Min. Metall. 72 (1972) 257-264: the matrix form, K3 = 2.3.
[2] R. P. King, Modeling and simulation of mineral processing systems, Butterworth-Heinemann, 2001:
    K1 = a1 CSS with a1 = 0.5 ... 0.95, K2 = a2 CSS with a2 = 1.7 ... 3.5.
[3] S. R. Broadbent, T. G. Callcott, Coal breakage processes, Phil. Trans. R. Soc. A 249 (1956)
    99-123: B(x/y) = (1 - exp(-x/y))/(1 - exp(-1)), without a free constant.
[4] F. C. Bond, Crushing and grinding calculations, Brit. Chem. Eng. 6 (1961) 378-385, 543-548:
    the power law; average work index of limestone, 14.0 kWh/t, as tabulated with it by Dyssol.
[5] B. Rocha, T. Campos, J. Silva, L. M. Tavares, Fit-for-purpose model of HP500 cone crusher in
    size reduction of itabirite iron ore, Minerals 14 (2024) 919: no-load power of an HP500, 110 kW.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from vibroscreen.circuit.unit import Array, Given, Mixed, Running, Target, Unit, apply
from vibroscreen.errors import ConfigError
from vibroscreen.fields import (
    Entry,
    Number,
    as_tuple,
    ascending_pairs,
    from_si,
    number,
    said,
    to_si,
)
from vibroscreen.units import KW, KWH_T, MICROMETRE, MM, T_H

__all__ = ["ConeCrusher", "Crusher", "JawCrusher", "broadbent_callcott", "passing_size"]

Table = tuple[tuple[float, float], ...]

_SETTING = Number("closed_side_setting_mm", "m", MM, above=0.0, at_most=0.5)
_CAPACITY = Number("capacity_t_h", "kg/s", T_H, above=0.0)


class _Capacity(Entry):
    """A rate [kg/s], or rows (closed-side setting [m], rate [kg/s]), ascending."""

    key = "capacity_t_h"

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        if not isinstance(raw, list):
            return to_si(raw, T_H)
        rows = [as_tuple(row) for row in raw]
        return tuple(
            (to_si(row[0], MM), *(to_si(v, T_H) for v in row[1:])) if row else row for row in rows
        )

    def check(self, name: str, value: Any) -> float | Table:
        if as_tuple(value) is None:
            if isinstance(value, float) and value == math.inf:
                return value
            return float(_CAPACITY.check(name, value))
        return ascending_pairs(
            name,
            value,
            ("setting", _SETTING),
            ("rate", _CAPACITY),
            "is neither a rate nor a table of two or more rows "
            "(closed-side setting in mm, t/h): give one of them, as the maker's list has it",
        )

    def write(self, value: Any) -> Any:
        if isinstance(value, float):
            return from_si(value, T_H)
        return [[from_si(s, MM), from_si(q, T_H)] for s, q in value]


def broadbent_callcott(ratio: Array) -> Array:
    """Mass fraction of fragments finer than `ratio` times their parent's size [1]. Source [3]."""
    return np.asarray(np.expm1(-ratio) / np.expm1(-1.0))


def passing_size(edges: Array, streams: Array, share: float = 0.8) -> Array:
    """Size that a share of a stream's mass is finer than [m]: F80, P80; nan where nothing flows.

    Linear in the cumulative curve between the limits of the classes. streams: rates by class
    [..., N]; the result has the shape of what stands before the classes.
    """
    rates = np.asarray(streams, dtype=float)
    passing = np.concatenate((np.zeros((*rates.shape[:-1], 1)), np.cumsum(rates, axis=-1)), axis=-1)
    wanted = share * passing[..., -1:]
    # The first class at whose upper limit the share is reached.
    place = np.argmax(passing[..., 1:] >= wanted, axis=-1)[..., None]
    low, high = (np.take_along_axis(passing, place + end, axis=-1) for end in (0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        part = (wanted - low) / (high - low)
        size = edges[place] + part * (edges[place + 1] - edges[place])
    return np.asarray(np.where(passing[..., -1] > 0.0, size[..., 0], np.nan))


@dataclass(frozen=True, kw_only=True)
class Crusher(Unit):
    """A crusher: what enters is classified, what is caught is broken, the rest leaves.

    The share C of a class is caught; fragments are classified again. With B the breakage matrix,
    source [1]: product = (I - C)(I - B C)^-1 feed. capacity: the most that one machine takes
    [kg/s], at every setting or as a table over it; infinite where none is to limit it. hold_up:
    the mean time in the crusher [s]; through time it holds rate times that, perfectly mixed.
    """

    has_drive: ClassVar = True

    closed_side_setting: float = said(
        dataclasses.MISSING,
        dataclasses.replace(
            _SETTING,
            variability="tunable",
            tells="Smallest gap between the crushing faces",
            also="css setting closed_side",
        ),
    )
    capacity: float | Table = said(dataclasses.MISSING, _Capacity())
    product: str = said(dataclasses.MISSING, Target("product"))
    machines: int = number(1, "machines", whole=True, at_least=1, at_most=100)
    unbroken_ratio: float = number(0.8, "unbroken_ratio", above=0.0, at_most=10.0)
    broken_ratio: float = number(2.3, "broken_ratio", above=0.0, at_most=20.0)
    exponent: float = number(2.3, "exponent", above=0.0, at_most=10.0)
    work_index: float = number(
        14.0 * KWH_T, "work_index_kwh_t", "J/kg", KWH_T, above=0.0, at_most=100.0 * KWH_T
    )
    idle_power: float = number(
        110.0 * KW, "idle_power_kw", "W", KW, at_least=0.0, at_most=5000.0 * KW
    )

    hold_up: float = number(
        0.0,
        "hold_up_s",
        "s",
        at_least=0.0,
        at_most=600.0,
        tells="Mean time in the crusher",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.unbroken_ratio < self.broken_ratio:
            raise ConfigError(
                f"{self.name}.unbroken_ratio = {self.unbroken_ratio:g} is not less than "
                f"broken_ratio = {self.broken_ratio:g}: 0.5 to 0.95 and 1.7 to 3.5 are usual"
            )
        if (fault := self.off_table(self.closed_side_setting)) is not None:
            raise ConfigError(fault)

    # --- the matrices, source [1] ----------------------------------------------------------------
    def classification(self, edges: Array, given: Given | None = None) -> Array:
        """Share of each class that is caught and broken, C [1 or design, class].

        C = 1 - ((K2 - d)/(K2 - K1))^K3 between K1 and K2, source [1], at the arithmetic mean d of
        a class. Fragments of the finest class stay in it, so breaking it makes no difference and
        it counts as unbroken.
        """
        setting = self.number(given, "closed_side_setting")
        unbroken = self.number(given, "unbroken_ratio") * setting
        broken = self.number(given, "broken_ratio") * setting
        size = 0.5 * (edges[:-1] + edges[1:])
        caught = 1.0 - np.clip((broken - size) / (broken - unbroken), 0.0, 1.0) ** self.number(
            given, "exponent"
        )
        caught[:, 0] = 0.0
        return np.asarray(caught)

    def breakage(self, edges: Array) -> Array:
        """Share of the fragments of class j that fall in class i, B [i, j]; columns sum to one."""
        size = 0.5 * (edges[:-1] + edges[1:])
        finer = broadbent_callcott(np.minimum(edges[:, None] / size[None, :], 1.0))
        finer[0, :] = 0.0  # all that is finer belongs to the finest class
        return np.diff(finer, axis=0)

    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        """The matrix (I - C)(I - B C)^-1; its columns sum to one."""
        caught = self.classification(edges, given)
        one = np.eye(caught.shape[1])
        passes = np.linalg.solve(one - self.breakage(edges) * caught[:, None, :], one[None])
        return {"product": (1.0 - caught)[:, :, None] * passes}

    def crush(self, edges: Array, feed: Array) -> Array:
        """Product by size class [kg/s]; conserves the mass of the feed [kg/s], shape [N]."""
        return np.asarray(self.transfers(edges, {})["product"][0] @ feed)

    # --- power and capacity ----------------------------------------------------------------------
    def power(self, edges: Array, feed: Array, product: Array, given: Given | None = None) -> Array:
        """Electric power of all machines [W]: idle, and Bond's energy times the rate, source [4].

        10 W_i (1/sqrt(P80) - 1/sqrt(F80)) with the sizes in micrometres; feed, product: rates by
        class [..., N].
        """
        index = self.number(given, "work_index")[:, 0]
        idle = self.number(given, "idle_power")[:, 0]
        fine, coarse = (passing_size(edges, s) / MICROMETRE for s in (product, feed))
        rate = feed.sum(axis=-1)
        energy = np.where(rate > 0.0, 10.0 * index * (fine**-0.5 - coarse**-0.5), 0.0)
        return np.asarray(self.machines * idle + rate * energy)

    def most(self, setting: ArrayLike | None = None) -> Array:
        """What all machines take at a setting [m, unless that of the unit], kg/s."""
        at = np.asarray(self.closed_side_setting if setting is None else setting, dtype=float)
        if isinstance(self.capacity, float):
            return np.full(at.shape, self.machines * self.capacity)
        settings, rates = np.array(self.capacity).T
        return np.asarray(self.machines * np.interp(at, settings, rates))

    def off_table(self, setting: float) -> str | None:
        """What is said of a setting [m] that the table of the capacity does not hold."""
        if isinstance(self.capacity, float):
            return None
        least, most = self.capacity[0][0], self.capacity[-1][0]
        if least <= setting <= most:
            return None
        return (
            f"{self.name}.closed_side_setting = {_SETTING.text(setting)} lies outside of the table "
            f"of its capacity ({_SETTING.text(least)} to {_SETTING.text(most)}): add rows to "
            "capacity_t_h, or stay inside"
        )

    def start(self, edges: Array) -> Running:
        return _Crushing(self, edges)


@dataclass(frozen=True, kw_only=True)
class ConeCrusher(Crusher):
    """A cone crusher; of a coarse feed some 80 % leaves finer than the setting."""


@dataclass(frozen=True, kw_only=True)
class JawCrusher(Crusher):
    """A jaw crusher: K1 and K2 from the upper end of source [2], as its stroke is wide. Assumed."""

    unbroken_ratio: float = number(0.95, "unbroken_ratio", above=0.0, at_most=10.0)
    broken_ratio: float = number(3.0, "broken_ratio", above=0.0, at_most=20.0)


class _Crushing(Mixed):
    """A crusher that holds what came in crushed, perfectly mixed; nothing without a hold-up."""

    def __init__(self, crusher: Crusher, edges: Array) -> None:
        super().__init__(edges)
        self._transfer, self._time = crusher.transfers(edges, {})["product"], crusher.hold_up

    def step(self, feed: Array, dt: float) -> dict[str, Array]:
        """d held/dt = product - held/time, solved exactly over the step."""
        product = apply(self._transfer, feed[None, :, None])[0, :, 0]
        if self._time == 0.0:
            return {"product": product}
        leaves = -math.expm1(-dt / self._time)
        there = self._held + product * dt
        left = leaves * self._held + max(dt - leaves * self._time, 0.0) * product
        self._held = there - left
        return {"product": left / dt}
