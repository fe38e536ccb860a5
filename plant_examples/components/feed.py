"""The size distribution of a feed."""

from __future__ import annotations

import numpy as np

from components.mixer import Rates

__all__ = ["rosin_rammler"]


def rosin_rammler(edges: Rates, size: float, exponent: float) -> Rates:
    """Mass fraction by class of a feed with 63.2 % finer than `size` m, cut off at the top."""
    passing = -np.expm1(-((edges / size) ** exponent))
    return np.diff(passing / passing[-1])
