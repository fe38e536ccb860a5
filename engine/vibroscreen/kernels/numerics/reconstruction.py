"""Composition inside a layer: even, or linear with `bed.reconstruction` (MODEL.md, "Columns")."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks
from vibroscreen.kernels.physics import layer

# Differences of a mass fraction below this bound no slope.
EVEN = 1e-14


@kernel
def reconstructed(buffer):
    """Whether the composition inside a layer is linear."""
    return buffer[int(buffer[state.AT.reconstruction])] > 0.0


@kernel
def slope_factor(load, row, below, mass, above, share):
    """Theta of a layer: the part of the central slopes of its sizes that makes no new extremum.

    One for all sizes, so that the slopes sum up to zero and a full layer stays full at its faces.
    below, mass, above: of the three layers, kg/m2; share: span of the layer over that of the slope.
    """
    theta = 1.0
    a, b, c = 1.0 / below, 1.0 / mass, 1.0 / above
    for i in range(load.shape[1]):
        middle = b * load[row, i]
        down, up = middle - a * load[row - 1, i], c * load[row + 1, i] - middle
        least, most = min(abs(down), abs(up)), max(abs(down), abs(up))
        if most > EVEN:
            room = 2.0 * least if down * up > 0.0 else 0.0
            slope = share * abs(down + up)
            if theta * slope > room:
                theta = room / slope
    return theta


@kernel
def faces(buffer, load, layers):
    """Loads as they are at the lower and at the upper faces of the layers.

    Mass fractions are linear over a layer with a monotonised central slope, even in the contact
    layer and in the top one. The implicit scheme, whose blocks these are, does without.
    """
    if layers <= 2 or not reconstructed(buffer):
        return load, load
    lower = blocks.stage_load(buffer, blocks.LOWER)
    upper = blocks.stage_load(buffer, blocks.UPPER)
    nodes = load.shape[1]
    for i in range(nodes):
        lower[0, i] = upper[0, i] = load[0, i]
        lower[layers - 1, i] = upper[layers - 1, i] = load[layers - 1, i]
    below, mass = layer.layer_mass(load, 0), layer.layer_mass(load, 1)
    for j in range(1, layers - 1):
        above = layer.layer_mass(load, j + 1)
        theta = 0.0
        if min(below, mass, above) > layer.NOTHING:
            share = 2.0 * mass / (below + 2.0 * mass + above)
            theta = 0.5 * mass * share * slope_factor(load, j, below, mass, above, share)
        a, c = (theta / below, theta / above) if theta > 0.0 else (0.0, 0.0)
        for i in range(nodes):
            half = c * load[j + 1, i] - a * load[j - 1, i]
            lower[j, i], upper[j, i] = load[j, i] - half, load[j, i] + half
        below, mass = mass, above
    return lower, upper
