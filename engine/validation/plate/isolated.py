"""What single spheres on the plate say of the law of passage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from plate.errors import rmse
from plate.simulations import APERTURE, read
from vibroscreen.units import MM

Array = NDArray[np.float64]


def isolated() -> tuple[float, float, float]:
    """Rim that isolated spheres tell, RMSE of their part on deck, and that with six free rates."""
    part = read("isolated_passage").query("1 <= cycles <= 44")
    columns = [str(name) for name in part.columns if str(name).startswith("on_deck")]
    size = np.array([float(name.removeprefix("on_deck_d")) for name in columns]) * MM
    cycles, on_deck = part["cycles"].to_numpy(), part[columns].to_numpy()

    def error(rate: Array, start: float) -> Array:
        left = np.exp(-np.maximum(0.0, cycles[:, None] - start) * rate)
        return np.ravel(left - on_deck)

    def by_law(point: Array) -> Array:
        return error(point[0] * (1.0 - (1.0 - point[1]) * size / APERTURE) ** 2, point[2])

    law = least_squares(by_law, [0.8, 0.3, 0.7])
    free = least_squares(lambda point: error(point[:6], point[6]), [0.2] * 6 + [0.7])
    return float(law.x[1]), rmse(law.fun), rmse(free.fun)
