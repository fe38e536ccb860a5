"""What single spheres on the plate say of the law of passage."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from plate.errors import rmse
from plate.model import BOUNCING
from plate.simulations import APERTURE, COARSEST, OPEN_AREA, read
from vibroscreen import Motion
from vibroscreen.kernels.physics.bounce import bounce
from vibroscreen.kernels.physics.closure import passage_factor, throw_height
from vibroscreen.units import DEG, GRAVITY, MM

Array = NDArray[np.float64]
AMPLITUDE, FREQUENCY = 3.0 * MM, 15.0  # Hz, vertical


@dataclass(frozen=True)
class Isolated:
    """Bouncing that lone spheres tell, and RMSE of their part on deck.

    error: with that bouncing; held: with the plate's; free: with a rate for each of the six sizes.
    """

    bouncing: float
    error: float
    held: float
    free: float


def isolated(velocity: float, rim: float) -> Isolated:
    """How lone spheres pass by the law, with the velocity [m/s] and the rim of a bed.

    Fitted are the bouncing and the cycles until the spheres have come down to the deck.
    """
    part = read("isolated_passage").query("1 <= cycles <= 44")
    columns = [str(name) for name in part.columns if str(name).startswith("on_deck")]
    size = np.array([float(name.removeprefix("on_deck_d")) for name in columns]) * MM
    cycles, on_deck = part["cycles"].to_numpy(), part[columns].to_numpy()
    harmonic = Motion.linear(AMPLITUDE, FREQUENCY, 90.0 * DEG).on_panel()
    height = throw_height(harmonic, FREQUENCY)
    throw = AMPLITUDE * (2.0 * np.pi * FREQUENCY) ** 2 / GRAVITY
    u = velocity * passage_factor(harmonic, FREQUENCY, APERTURE, throw)

    def missed(rate: Array, start: float) -> Array:
        left = np.exp(-np.maximum(0.0, cycles[:, None] - start) * rate)
        return np.ravel(left - on_deck)

    def by_law(bouncing: float, start: float) -> Array:
        alone = SimpleNamespace(
            **dict.fromkeys(("aperture", "across", "along", "seen", "closed"), APERTURE),
            open_area=OPEN_AREA,
            density=1.0,
            bed_load=0.0,
            cover=0.0,
            throw_height=height,
            transport_velocity=0.0,
            rim=rim,
            crowding=0.0,
            drift=0.0,
            levelling=0.0,
            bouncing=bouncing,
        )
        passing = np.zeros(size.size)
        bounce(size, np.zeros(size.size), alone, passing)
        return missed(u * passing / (COARSEST * FREQUENCY), start)

    law = least_squares(lambda point: by_law(*point), [5.0, 0.7], bounds=(0.0, 100.0))
    held = least_squares(lambda point: by_law(BOUNCING, point[0]), [0.7])
    free = least_squares(lambda point: missed(point[:6], point[6]), [0.2] * 6 + [0.7])
    return Isolated(float(law.x[0]), rmse(law.fun), rmse(held.fun), rmse(free.fun))
