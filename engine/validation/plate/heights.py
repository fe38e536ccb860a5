"""How high a bed is thrown, from the mean heights of its grains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from plate.errors import rmse
from plate.model import CALMING, LIFT
from plate.simulations import COARSEST, DRIFTING, bed_profile, read
from vibroscreen import Motion
from vibroscreen.kernels.physics.closure import throw_height
from vibroscreen.units import DEG

Array = NDArray[np.float64]


def heights() -> tuple[float, float, float, float]:
    """Lift and calming that the mean heights of the decks tell, RMS of the misses, mean lift [m].

    A bed of depth H that fills H and the lift evenly has its middle at half of both; all beds
    thinner than the contact layer are thrown alike.
    """
    cases = read("deck_cases").set_index("case").drop(list(DRIFTING))
    part = bed_profile()
    part = part[part["case"].isin(cases.index)]
    normal = {
        str(name): Motion.circular(case["A_m"], case["f_Hz"], "against_flow")
        if case["motion"] == "circular"
        else Motion.linear(case["A_m"], case["f_Hz"], case["beta_deg"] * DEG)
        for name, case in cases.iterrows()
    }
    throw = np.array(
        [
            throw_height(normal[name].on_panel(), normal[name].frequency)
            for name in part["case"].astype(str)
        ]
    )
    depth = part["depth_settled_m"].to_numpy()
    lifted = 2.0 * part["zmean_m"].to_numpy() - depth
    layers = np.maximum(depth, COARSEST) / COARSEST

    def misses(point: Array) -> Array:
        return np.asarray(point[0] * throw / (1.0 + point[1] * layers) - lifted)

    found = least_squares(misses, [LIFT, CALMING], x_scale=[1.0, 0.1], ftol=1e-12, xtol=1e-12)
    lift, calming = (float(number) for number in found.x)
    return lift, calming, rmse(found.fun), float(lifted.mean())
