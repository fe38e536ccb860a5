"""The gap between packed grains, opened by shaking (the paper's amended formulas)."""

from math import pi, sqrt

from vibroscreen.compiler.language import kernel

_RADIUS_FACTOR = 2.0 * sqrt(3.0) / 3.0
_HEXAGON_FACTOR = sqrt(3.0)
_SOLID_FACTOR = sqrt(_HEXAGON_FACTOR / pi)


@kernel
def gap_radius(mean_radius, dilation):
    """Radius of the gap between three grains on a triangle, m: (2/sqrt3 - 1) R + (2/sqrt3) dr."""
    return (_RADIUS_FACTOR - 1.0) * mean_radius + _RADIUS_FACTOR * dilation


@kernel
def gap_of(size, dilation, relative):
    """Gaps among grains of one size [m] that dilate by dilation + relative size: 2 r, m."""
    return 2.0 * gap_radius(0.5 * size, dilation + relative * size)


@kernel
def gap_open_area(mean_radius, dilation):
    """Open area of the gaps: min(1, pi r^2 / (sqrt3 (R + dr)^2))."""
    if mean_radius + dilation <= 0.0:
        return 0.0
    ratio = gap_radius(mean_radius, dilation) / (mean_radius + dilation)
    return min(1.0, pi / _HEXAGON_FACTOR * ratio * ratio)
