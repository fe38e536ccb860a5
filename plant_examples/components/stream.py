"""A stream is its mass flow rate by size class; what it is made of."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "Rates", "composition"]

Array: TypeAlias = NDArray[np.float64]

Rates: TypeAlias = Array
"""Mass flow rate by size class, finest first, kg/s."""


def composition(stream: Rates, at_rest: Rates) -> Array:
    """Mass fraction of each size class in a stream, 1; sums to one.

    A stream that does not flow has no composition and takes that of `at_rest`.
    """
    reference = stream if stream.sum() > 0.0 else at_rest
    return np.asarray(reference / reference.sum())
