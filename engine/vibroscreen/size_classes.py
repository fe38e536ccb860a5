"""Size classes of a sieve analysis, and the narrow nodes that stand for them inside the engine."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import ConfigError
from vibroscreen.fields import Number, Numbers, check_fields, number, of
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


def coarse_first(sizes: Any) -> bool:
    """Whether this is a list of sizes that falls all the way."""
    numbers = isinstance(sizes, list) and all(isinstance(size, int | float) for size in sizes)
    return numbers and len(sizes) > 1 and all(low < high for high, low in pairwise(sizes))


@dataclass(frozen=True)
class _Edges(Numbers):
    """Limits of size classes, ascending; a file may list them coarsest first."""

    def read(self, name: str, raw: Any, folder: Path) -> Any:
        return super().read(name, raw[::-1] if coarse_first(raw) else raw, folder)

    def check(self, name: str, value: Any) -> tuple[float, ...]:
        edges = super().check(name, value)
        for place, (low, high) in enumerate(pairwise(edges), start=2):
            if high <= low:
                text = self.item.told("not_ascending", f"{name}[{place}]", high, low)
                raise ConfigError(text)
        return edges


_EDGE = Number(
    "edges_mm", "m", MM, at_least=0.0, at_most=2.0, also="edge sizes size sieves sieve limits"
)


@dataclass(frozen=True)
class SizeClasses:
    """Limits of the size classes [m], ascending, and how the engine splits the classes.

    N + 1 edges, the first may be 0. A TOML file may list them coarsest first, and its feed with
    them: they are turned; here, where the feed is apart, that is refused. subdivision: 1 = one node
    a class at the arithmetic mean of its limits; k > 1 = k nodes on each piece between the class's
    limits and the apertures inside it; 0 = chosen by the engine. Raises ConfigError.
    """

    edges: tuple[float, ...] = field(metadata=of(_Edges("edges_mm", _EDGE, least=2)))
    subdivision: int = number(
        0,
        "subdivision",
        whole=True,
        at_least=0,
        at_most=100,
        variability="constant",
        tells="Sizes that stand for a class: 1 its mean, 0 chosen by the engine",
    )

    def __post_init__(self) -> None:
        check_fields(self, "size_classes")

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
