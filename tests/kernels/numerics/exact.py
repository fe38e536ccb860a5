"""Exact solutions that share no code with the engine, for tests and benchmarks (DESIGN.md, 2).

Two kinds of grains in a closed column (Gray and Thornton): fine fraction F(z, t), z up from the
screen, and the scalar law F_t = (f(F))_z with the downward flux f of the fine grains, f = 0 at the
screen and at the surface. Its solutions are those of the convex hull: where f is concave the jump
from fine below to coarse above is a shock, where it is convex a fan.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]


def well_mixed_deep_bed(load: Array, rate: Array, time: float) -> Array:
    """Areal masses [kg/m2] after `time` s of a well mixed bed deeper than the contact layer.

    load[i] in kg/m2, rate[i] = rho_b u P_i in kg/(m2 s). dm_i/dt = -rate_i m_i/M, so m_i =
    m_i0 exp(-rate_i tau), and t = integral of M over tau. Raises ValueError if all would be gone.
    """
    moving = rate > 0.0

    def clock(tau: float) -> float:
        passing = load[moving] * -np.expm1(-rate[moving] * tau) / rate[moving]
        return float(passing.sum() + tau * load[~moving].sum()) - time

    high = 1e-3
    while clock(high) < 0.0:
        high *= 2.0
        if high > 1e9:
            raise ValueError("the whole bed has passed before that time")
    return load * np.exp(-rate * brentq(clock, 0.0, high, xtol=1e-15, rtol=1e-15))


def sorted_bed_yield(position: Array, undersize: float, strength: float) -> Array:
    """Yield of undersize up to `position` [m] as a part of the feed: eq. (3) of the paper.

    undersize: content of the feed; strength = rho_b u phi width/Q0 in 1/m. Holds for a feed that
    is linear in size from 0, Gaudin's law and a bed that is sorted completely.
    """
    return undersize * position / (position + undersize / strength)


def two_kinds_mixed(height: Array, time: float, fine: float, pace: float, depth: float) -> Array:
    """Fine fraction at `height` [m] of a column that starts mixed, f = pace F (1 - F).

    fine: content at the start; pace in m/s; depth in m. Pure fine below a shock that rises at
    pace x fine, pure coarse above one that sinks at pace x (1 - fine); sorted after depth/pace.
    """
    if time >= depth / pace:
        return np.where(height < fine * depth, 1.0, 0.0)
    low, high = pace * fine * time, depth - pace * (1.0 - fine) * time
    return np.where(height < low, 1.0, np.where(height > high, 0.0, fine))


def two_kinds_stacked(
    height: Array, time: float, coarse: float, pace: float, depth: float
) -> Array:
    """Fine fraction at `height` [m] of a column with all fine grains on top, f = pace F (1 - F).

    coarse: depth [m] of the coarse grains, which start below; pace in m/s; depth in m.
    Characteristics move at dz/dt = -pace (1 - 2 F), so the step opens to the fan
    F = (1 + (z - coarse)/(pace t))/2. From the moment coarse/pace at which it is on the screen,
    fine grains gather there below a shock at z = coarse + pace t - 2 sqrt(coarse pace t), which
    solves dz/dt = pace F(z, t); in the same way coarse grains gather at the surface. The shocks
    meet when sqrt(pace t) = sqrt(coarse) + sqrt(depth - coarse): then the bed is sorted.
    """
    way = pace * time
    if way <= 0.0:
        return np.where(height < coarse, 0.0, 1.0)
    fine = depth - coarse
    if np.sqrt(way) >= np.sqrt(coarse) + np.sqrt(fine):
        return np.where(height < fine, 1.0, 0.0)
    fan = np.clip(0.5 * (1.0 + (height - coarse) / way), 0.0, 1.0)
    low = coarse + way - 2.0 * np.sqrt(coarse * way) if way > coarse else 0.0
    high = coarse - way + 2.0 * np.sqrt(fine * way) if way > fine else depth
    return np.where(height < low, 1.0, np.where(height > high, 0.0, fan))


def hindered_kinds_mixed(
    height: Array, time: float, fine: float, pace: float, depth: float
) -> Array:
    """Fine fraction at `height` [m] of a column that starts mixed, f = pace F (1 - F)^2.

    fine: content at the start, below 2/3; pace in m/s; depth in m. Fine grains that percolate the
    slower the more of them there are: f has an inflection at 2/3, so on the way to pure fine the
    lower convex hull of f is the tangent from F = fine to F* = 1 - fine/2 (a shock) and f itself
    from there on (a fan at the screen, z/t = pace (1 - F)(3 F - 1)). Above, a shock that sinks at
    pace (1 - fine)^2. Until the two shocks meet; raises ValueError after that.
    """
    tangent = 1.0 - 0.5 * fine
    low = pace * (1.0 - tangent) * (3.0 * tangent - 1.0) * time
    high = depth - pace * (1.0 - fine) ** 2 * time
    if low > high:
        raise ValueError(f"time = {time:g} s is after the shocks have met")
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.where(height > 0.0, height / (pace * time), 0.0)  # (1 - F)(3 F - 1)
    fan = (2.0 + np.sqrt(np.maximum(0.0, 1.0 - 3.0 * speed))) / 3.0
    return np.where(height < low, fan, np.where(height > high, 0.0, fine))


def layer_means(profile: Callable[[Array], Array], boundary: Array, points: int = 200) -> Array:
    """Mean of `profile(height)` over the layers between `boundary`[layer + 1], m; midpoint rule."""
    place = (np.arange(points) + 0.5) / points
    height = boundary[:-1, None] + np.diff(boundary)[:, None] * place
    return profile(height).mean(axis=1)
