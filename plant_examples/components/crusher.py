"""A cone crusher: Whiten's classification and breakage matrices, power by Bond's third theory.

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

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from components.stream import Array
from vibroscreen.units import KW, KWH_T, MICROMETRE, MM

__all__ = ["ConeCrusher", "broadbent_callcott", "passing_size"]


def broadbent_callcott(ratio: Array) -> Array:
    """Mass fraction of fragments finer than `ratio` times their parent's size, 1. Source [3]."""
    return np.asarray(np.expm1(-ratio) / np.expm1(-1.0))


def passing_size(edges: Array, stream: Array, share: float = 0.8) -> float:
    """Size that a share of the stream's mass is finer than, m: F80, P80.

    Linear in the cumulative curve between the limits of the classes; `stream` must flow.
    """
    passing = np.concatenate(([0.0], np.cumsum(stream)))
    return float(np.interp(share * passing[-1], passing, edges))


@dataclass(frozen=True)
class ConeCrusher:
    """A cone crusher without hold-up, on the size classes between `edges` (N + 1 limits, m).

    What enters is classified: the share C of a class is caught and broken, the rest leaves; the
    fragments are classified again. With B the breakage matrix, source [1]:
    product = (I - C)(I - B C)^-1 feed. With the assumed K1 and K2 about 80 % of the product of a
    coarse feed is finer than the closed-side setting.
    """

    edges: Array
    closed_side_setting: float  # m
    unbroken_ratio: float = 0.8  # K1/CSS: finer is never broken; assumed in the range of [2]
    broken_ratio: float = 2.3  # K2/CSS: coarser is always broken; assumed in the range of [2]
    exponent: float = 2.3  # K3, source [1]
    breakage_function: Callable[[Array], Array] = broadbent_callcott
    work_index: float = 14.0 * KWH_T  # J/kg, limestone, source [4]
    idle_power: float = 110.0 * KW  # W, source [5]

    def __post_init__(self) -> None:
        """ValueError unless the limits ascend and 0 < K1 < K2."""
        if self.edges[0] < 0.0 or not np.all(np.diff(self.edges) > 0.0):
            raise ValueError("edges must ascend from 0 or more: give the N + 1 limits finest first")
        if not 0.0 < self.closed_side_setting < np.inf:
            raise ValueError(
                f"closed_side_setting = {self.closed_side_setting / MM} mm must be positive: "
                "give it in metres"
            )
        if not 0.0 < self.unbroken_ratio < self.broken_ratio:
            raise ValueError(
                f"unbroken_ratio = {self.unbroken_ratio} must be positive and less than "
                f"broken_ratio = {self.broken_ratio}: 0.5 ... 0.95 and 1.7 ... 3.5 are usual"
            )

    @property
    def size(self) -> Array:
        """Size that stands for each class, the arithmetic mean of its limits, m."""
        return 0.5 * (self.edges[:-1] + self.edges[1:])

    @cached_property
    def classification(self) -> Array:
        """Share of each class that is caught and broken, C, 1.

        C = 1 - ((K2 - d)/(K2 - K1))^K3 between K1 and K2, source [1]. Fragments of the finest
        class stay in it, so breaking it makes no difference and it counts as unbroken.
        """
        unbroken = self.unbroken_ratio * self.closed_side_setting
        broken = self.broken_ratio * self.closed_side_setting
        escape = np.clip((broken - self.size) / (broken - unbroken), 0.0, 1.0)
        caught = 1.0 - escape**self.exponent
        caught[0] = 0.0
        return caught

    @cached_property
    def breakage(self) -> Array:
        """Share of the fragments of class j that fall in class i, 1; columns sum to one."""
        ratio = np.minimum(self.edges[:, None] / self.size[None, :], 1.0)
        finer = self.breakage_function(ratio)
        finer[0, :] = 0.0  # all that is finer belongs to the finest class
        return np.diff(finer, axis=0)

    @cached_property
    def transfer(self) -> Array:
        """Share of class j that leaves in class i, (I - C)(I - B C)^-1, 1; columns sum to one."""
        one, caught = np.eye(self.size.size), self.classification
        passes = np.linalg.solve(one - self.breakage * caught, one)
        return np.asarray((1.0 - caught)[:, None] * passes)

    def crush(self, feed: Array) -> Array:
        """Product by size class, kg/s; conserves the mass of the feed (kg/s by class)."""
        return np.asarray(self.transfer @ feed)

    def power(self, feed: Array) -> float:
        """Electric power, W: idle plus 10 W_i (1/sqrt(P80) - 1/sqrt(F80)) per mass, source [4].

        The sizes in the formula are in micrometres; `work_index` is energy per mass.
        """
        if not feed.sum() > 0.0:
            return self.idle_power
        feed_size = passing_size(self.edges, feed) / MICROMETRE
        product_size = passing_size(self.edges, self.crush(feed)) / MICROMETRE
        energy = 10.0 * self.work_index * (product_size**-0.5 - feed_size**-0.5)
        return float(self.idle_power + feed.sum() * energy)
