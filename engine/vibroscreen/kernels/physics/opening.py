"""What a falling grain sees of an opening, and the size from which on none passes (MODEL.md)."""

from math import pi, sqrt

from vibroscreen.compiler.elementary import sin
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics.passage import BOUNCE, PELEVIN

# Places in `sections.OPENINGS`, from 1 on. A slot lies along the flow or across it.
SQUARE, SLOT, ROUND, SLOT_ACROSS = 1, 2, 3, 4
# Open area of round holes in rows that are staggered by 60 degrees and touch.
TOUCHING = pi / sqrt(12.0)


@kernel
def implied_bar(shape, across, along, open_area):
    """Bar between openings of these sides [m] that make the open area, m; 0 on a blank plate.

    Of a mesh: open_area = across along/((across + bar) (along + bar)). Of round holes: the least
    distance between staggered ones, open_area = TOUCHING (across/(across + bar))^2.
    """
    if open_area <= 0.0:
        return 0.0
    if shape == ROUND:
        return max(0.0, across * (sqrt(TOUCHING / open_area) - 1.0))
    covered = across * along * (1.0 / open_area - 1.0)
    half = 0.5 * (across + along)
    return covered / (half + sqrt(half * half + covered))


@kernel
def bar_of(panel):
    """Thickness of the medium of a panel, m."""
    across, along = sides_of(panel)
    implied = implied_bar(panel.opening, across, along, panel.open_area)
    return panel.thickness + panel.relative_thickness * implied


@kernel
def sides_of(panel):
    """Sides of an opening across the flow and along it, m."""
    across = panel.slot_length if panel.opening == SLOT_ACROSS else panel.aperture
    return across, panel.slot_length if panel.opening == SLOT else panel.aperture


@kernel
def seen_along(panel):
    """What a falling grain sees of the side along the flow, m: (b + t) cos(alpha) - t, or 0."""
    half = sin(0.5 * panel.inclination)
    along = sides_of(panel)[1]
    return max(0.0, along - (along + bar_of(panel)) * (2.0 * half * half))


@kernel
def closing_size(panel, parameter):
    """Size from which on no grain passes a panel, m.

    A grain that the rim guides in needs less than its size of what it sees; a law of one's own is
    taken to let pass what is smaller than the opening.
    """
    law, seen = parameter.passage_law, seen_along(panel)
    if law > BOUNCE or seen <= 0.0:
        return panel.aperture if law > BOUNCE else 0.0
    clear = 1.0 if law <= PELEVIN else 1.0 - parameter.passage_rim
    return seen / clear if seen < clear * panel.aperture else panel.aperture
