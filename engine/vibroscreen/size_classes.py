"""Size classes of a sieve analysis, and the narrow nodes that stand for them inside the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vibroscreen.compiler.language import Row
from vibroscreen.errors import ConfigError, told
from vibroscreen.fields import Number, Numbers, check_fields, number, of
from vibroscreen.kernels.bed.classes import (
    LEAST_PASSAGE,
    LEAST_PERCOLATION,
    build_nodes,
    most_nodes,
)
from vibroscreen.kernels.physics.segregation import EXCHANGE
from vibroscreen.kernels.state import PARAMETER
from vibroscreen.units import MM

Array = NDArray[np.float64]


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
                name, other = f"size_classes.edges[{k + 1}]", f"edges[{k}]"
                low, high = self.edges[k - 1 : k + 1]
                raise ConfigError(
                    told("not_ascending", name=name, value=high, other=other, limit=low)
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

    def nodes(
        self,
        apertures: Sequence[float],
        tolerance: float,
        segregation_model: int = EXCHANGE,
        dilation: float = 0.0,
        strength: tuple[float, float] = (0.0, 0.0),
        percolation_velocity: float = 0.0,
    ) -> Nodes:
        """Quadrature nodes of all classes for the given apertures [m].

        Where the engine chooses, as many as keep the error of a class's recovery below the
        tolerance [1]; `exchange` needs most, its gaps follow from the dilation [m] and its
        kinks from the percolation velocity [m/s]. A strong screen needs more: strength is
        K = rho_b u phi W L/Q0 of the openings and of the gaps (kernels/classes.py).
        """
        setting = np.zeros(len(PARAMETER))
        parameter = Row(setting, 0, PARAMETER)
        parameter.subdivision = self.subdivision
        parameter.tolerance = tolerance
        parameter.segregation_model = segregation_model
        parameter.segregation_dilation = dilation
        parameter.segregation_velocity = percolation_velocity
        aperture = np.sort(np.array(apertures, dtype=float))
        room = most_nodes(self.count, aperture.size, float(self.subdivision))
        size, node_class, position, weight = np.empty((4, room))
        count = build_nodes(
            np.array(self.edges),
            aperture,
            setting,
            np.maximum(strength, (LEAST_PASSAGE, LEAST_PERCOLATION)),
            size,
            node_class,
            position,
            weight,
        )
        return Nodes(
            size[:count].copy(),
            node_class[:count].astype(np.intp),
            position[:count].copy(),
            weight[:count].copy(),
        )
