"""Size classes of a sieve analysis, and the narrow nodes that stand for them inside the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import ConfigError
from vibroscreen.fields import Number, Numbers, check_fields, number, of
from vibroscreen.units import MM

Array = NDArray[np.float64]

# Nodes on each piece below the largest aperture where the engine chooses. The recovery of a grain
# of size d is about 1 - exp(-K (1 - d/aperture)^2), K = rho_b u phi width L/Q0, which is 15 on
# the default screen and grows as the bed thins out. Largest error of a class's recovery on that
# screen against adaptive quadrature of the same density (tests/test_size_classes.py):
#     nodes      1        2        3        4        6
#     K = 15   4.1e-2   3.3e-4   1.5e-5   6.5e-7   2.3e-10
#     K = 30   7.0e-3   6.0e-3   5.0e-4   2.3e-5   1.7e-8
#     K = 50   7.2e-2   2.0e-2   1.8e-3   8.9e-5   4.8e-8
# Four is the least that stays below the default tolerance of 1e-4 up to K = 50. The near-size
# class has nearly all of the error; a single pass, (1 - d/aperture)^2, is exact with three.
NODES_BELOW = 4
# Nothing passes above the largest aperture, but the mean size there sets the gaps of `exchange`.
# The density of mass inside a class is a quadratic in size: two nodes keep its mass and its mean
# (one node a class costs 3e-3 in recovery on the default screen, two 4e-5).
NODES_ABOVE = 2


@dataclass(frozen=True, eq=False)
class Nodes:
    """Sizes [m] that the engine works with, ascending, each inside a size class.

    All arrays have length n. class_index: the class from 0, ascending; position: place inside the
    class, 0..1; weight: share of the class's width, summing to 1 over a class.
    """

    size: Array
    class_index: NDArray[np.intp]
    position: Array
    weight: Array

    @property
    def count(self) -> int:
        """Number of nodes."""
        return self.size.size


@dataclass(frozen=True)
class SizeClasses:
    """Limits of the size classes [m], ascending, and how the engine splits the classes.

    N + 1 edges, the first may be 0. subdivision: 1 = one node a class at the arithmetic mean of
    its limits; k > 1 = k nodes on each piece between the class's limits and the apertures inside
    it; 0 = chosen by the engine. Raises ConfigError.
    """

    edges: tuple[float, ...] = field(
        metadata=of(
            Numbers(
                "edges_mm",
                Number("edges_mm", "m", MM, at_least=0.0, at_most=10.0),
                least=2,
            )
        )
    )
    subdivision: int = field(
        default=0, metadata=number("subdivision", whole=True, at_least=0, at_most=100)
    )

    def __post_init__(self) -> None:
        check_fields(self, "size_classes")
        for k in range(1, len(self.edges)):
            if self.edges[k] <= self.edges[k - 1]:
                raise ConfigError(
                    f"size_classes.edges[{k + 1}] = {self.edges[k]:.6g} m is not larger than "
                    f"edges[{k}] = {self.edges[k - 1]:.6g} m: list the limits in ascending order"
                )

    @property
    def count(self) -> int:
        """Number of classes N."""
        return len(self.edges) - 1

    @property
    def lower(self) -> Array:
        """Lower limit of every class [m]."""
        return np.array(self.edges[:-1])

    @property
    def upper(self) -> Array:
        """Upper limit of every class [m]."""
        return np.array(self.edges[1:])

    @property
    def mean(self) -> Array:
        """Arithmetic mean of the limits of every class [m]."""
        return 0.5 * (self.lower + self.upper)

    def nodes(self, apertures: Sequence[float]) -> Nodes:
        """Quadrature nodes of all classes for the given apertures [m].

        Passage is smooth in size but for kinks at the apertures: a class is broken there and each
        piece gets Gauss-Legendre nodes.
        """
        largest = max(apertures)
        rows: list[tuple[float, int, float, float]] = []
        for k, (low, high) in enumerate(pairwise(self.edges)):
            width = high - low
            ends = [low]
            for aperture in sorted(apertures) if self.subdivision != 1 else ():
                # A piece of no width but round-off would have several nodes at one size.
                if min(aperture - ends[-1], high - aperture) > 1e-9 * width:
                    ends.append(aperture)
            ends.append(high)
            for start, stop in pairwise(ends):
                count = self.subdivision or (NODES_ABOVE if start >= largest else NODES_BELOW)
                abscissa, weight = np.polynomial.legendre.leggauss(count)
                for x, w in zip(abscissa, weight, strict=True):
                    size = 0.5 * (start + stop) + 0.5 * (stop - start) * float(x)
                    share = 0.5 * (stop - start) / width * float(w)
                    rows.append((size, k, (size - low) / width, share))
        size_, index, position, weights = zip(*rows, strict=True)
        return Nodes(
            np.array(size_), np.array(index, dtype=np.intp), np.array(position), np.array(weights)
        )
