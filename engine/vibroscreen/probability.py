"""The paper's formulas for one grain size or one packing, outside of a screen."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.compiler.language import Row
from vibroscreen.errors import InputError
from vibroscreen.kernels import state
from vibroscreen.kernels.physics.gaudin import gaudin
from vibroscreen.kernels.physics.packing import gap_open_area, gap_radius
from vibroscreen.kernels.physics.pelevin import pelevin

Array = NDArray[np.float64]


def _sizes(name: str, values: ArrayLike) -> Array:
    """Finite numbers that are not negative, at least one-dimensional."""
    array = np.atleast_1d(np.asarray(values, dtype=float))
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        worst = array[~(np.isfinite(array) & (array >= 0.0))][0]
        raise InputError(f"{name} = {worst:g} is not a finite number from 0 on: give metres", name)
    return array


def _scene(aperture: float, open_area: float) -> Row:
    if not (np.isfinite(aperture) and aperture > 0.0):
        raise InputError(f"aperture = {aperture:g} m is not positive: give metres", "aperture")
    if not 0.0 <= open_area <= 1.0:
        raise InputError(
            f"open_area = {open_area:g} is not in 0..1: give the open part of the area", "open_area"
        )
    scene = Row(np.zeros(len(state.SCENE)), 0, state.SCENE)
    scene.aperture, scene.open_area = aperture, open_area
    scene.across = scene.along = scene.seen = scene.closed = aperture
    return scene


def gaudin_probability(size: ArrayLike, aperture: float, open_area: float) -> Array | float:
    """Gaudin's probability of passage, dimensionless: phi (1 - d/a)^2, 0 from d = a on (eq. 5).

    size: a grain size in m, or an array of them; aperture in m; open_area as a part of the area.
    Raises InputError for values that are not finite or negative.
    """
    sizes = _sizes("size", size)
    out = np.zeros(sizes.size)
    gaudin(sizes.ravel(), np.zeros(sizes.size), _scene(aperture, open_area), out)
    return float(out[0]) if np.ndim(size) == 0 else out.reshape(sizes.shape)


def pelevin_probability(
    sizes: ArrayLike, fractions: ArrayLike, aperture: float, open_area: float
) -> Array:
    """Pelevin's passage factor by size, dimensionless, it may exceed 1 (eq. 6).

    sizes[n] in m; fractions[n]: mass fractions in the contact layer, in the order of the sizes
    (any order of sizes is taken); aperture in m; open_area as a part of the area. Raises
    InputError for unequal lengths, and for values that are not finite or negative.
    """
    size, fraction = _sizes("sizes", sizes), _sizes("fractions", fractions)
    if size.shape != fraction.shape or size.ndim != 1:
        raise InputError(
            f"fractions has {fraction.size} values for {size.size} sizes: give one a size",
            "fractions",
        )
    order = np.argsort(size, kind="stable")
    sorted_out, out = np.zeros(size.size), np.zeros(size.size)
    pelevin(size[order], fraction[order], _scene(aperture, open_area), sorted_out)
    out[order] = sorted_out
    return out


def packing_gap(mean_radius: float, dilation: float) -> tuple[float, float]:
    """Radius of the gap between grains, m, and the open area of all gaps, as a part of the area.

    mean_radius of the grains in m; dilation: extra distance by shaking, m. The paper's amended
    formulas, simplified: r = (2/sqrt3 - 1) R + (2/sqrt3) dr, phi = min(1, pi r^2/(sqrt3 (R+dr)^2)).
    Raises InputError for values that are not finite or negative.
    """
    radius = float(_sizes("mean_radius", mean_radius)[0])
    extra = float(_sizes("dilation", dilation)[0])
    return float(gap_radius(radius, extra)), float(gap_open_area(radius, extra))
