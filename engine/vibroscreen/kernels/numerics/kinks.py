"""Where the rates have a kink: a layer runs out or is filled, and what a step may miss it by."""

from math import sqrt

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, vectors
from vibroscreen.kernels.physics.layer import layer_mass

# A step that ends where a layer runs out (or is filled) may miss it by this part of a full one.
LANDING = 1e-6
# A layer that runs out may be missed by this part of the tolerance, if that is more: what is left
# of it joins the layer below, which is the top one then and need not be full.
MISS = 0.1
# It may go past that moment where what it puts into a wrong layer is an error of at most this times
# the allowance. After the step it may be more by the second factor, as it was foretold before it.
OVER_MARGIN, FORETOLD = 2.0, 2.0
# It does so where this part at least of what it draws from the layer may be beyond what that holds.
WORTH = 0.2
# A part of `tolerance` that a step may always use, however short it is.
LEAST_SHARE = 0.05


@kernel
def allowance(buffer, scene, book, h):
    """Error that a step of h may have, as a part of what was fed of a size.

    A deck below has a smaller share of the tolerance, as the errors of all above it add to its own.
    """
    tolerance = state.parameters(buffer).solver_tolerance * book.share
    horizon = scene.horizon
    return tolerance * (max(LEAST_SHARE, h / horizon) if horizon > 0.0 else LEAST_SHARE)


@kernel
def time_to_pass(mass, rate, slope):
    """Time in which `mass` passes at a rate that changes linearly, s; -1 if it never does."""
    root = rate * rate + 2.0 * slope * mass
    if rate <= 0.0 or root <= 0.0:
        return -1.0
    return 2.0 * mass / (rate + sqrt(root))


@kernel
def miss_of(buffer, layers, growth):
    """Part of a full layer by which a step may miss the moment of a kink."""
    if layers > 1 and growth < 0.0:
        return max(LANDING, MISS * state.parameters(buffer).solver_tolerance)
    return LANDING


@kernel
def mass_to_kink(buffer, scene, load, layers, growth):
    """Mass that the top layer loses or gains until the rates have a kink, kg/m2; 0: none ahead.

    A layer runs out or is filled; the bed gets thinner or thicker than the contact layer.
    """
    mass = layer_mass(load, layers - 1)
    full = scene.layer_full if layers > 1 else scene.contact_load
    thinner = mass if layers > 1 else mass - full
    distance = thinner if growth < 0.0 else full - mass
    return distance if distance > miss_of(buffer, layers, growth) * full else 0.0


@kernel
def misplaced(buffer, scene, layers, now, rate, over):
    """What a step puts into a wrong layer that draws `over` kg/m2 too much from the top one.

    As `worst_error` counts what lies one layer too low. The layer below, full in that step, is the
    top one in truth and shrinks: what percolates out of it does, and what settles out of it is not
    refilled. Both grow with what is drawn too much, so their integral does with its square. The
    same for every layer that runs out, down to the contact layer, which may not.
    """
    load, change = blocks.stage_load(buffer, now), blocks.stage_load(buffer, rate)
    share, weight = blocks.stage_share(buffer, now, layers), state.compact(buffer, 1)
    error, flux = state.node_work(buffer, 1), state.node_work(buffer, 2)
    full = scene.layer_full
    row = layers - 1
    lost = -layer_mass(change, row)
    settling = lost / full
    for i in range(error.size):
        error[i], flux[i] = 0.0, -change[row, i]
    while over > 0.0 and row > 1 and lost > 0.0:
        row -= 1
        part = min(1.0, over / full)
        scale = 0.5 * part * part / settling
        over -= full
        for i in range(error.size):
            refill = lost * share[0, i] if row == layers - 2 else settling * load[row + 1, i]
            flux[i] -= change[row, i]  # all that goes down from this layer
            error[i] += scale * abs(flux[i] + refill - 2.0 * settling * load[row, i])
    return 2.0 / layers * blocks.worst_of(error, weight) if over <= 0.0 else 1e300


@kernel
def over_allowed(buffer, scene, book, layers, h, growth):
    """What a step of h may draw from the top layer beyond what it holds, kg/m2; 0: not worth it."""
    allowed = OVER_MARGIN * allowance(buffer, scene, book, h)
    drawn = -growth * h
    over = min(drawn, (layers - 2) * scene.layer_full)
    while over > WORTH * drawn:
        error = misplaced(buffer, scene, layers, blocks.NOW, blocks.K1, over)
        if error <= allowed:
            return over
        over *= 0.9 * sqrt(allowed / error)
    return 0.0


@kernel
def settle_top(buffer, scene, layers, growth):
    """Close a top layer that has run out, open one above a full one; returns the layers."""
    load = blocks.stage_load(buffer, blocks.NOW)
    full = scene.layer_full if layers > 1 else scene.contact_load
    mass = layer_mass(load, layers - 1)
    if layers > 1 and growth < 0.0 and mass <= miss_of(buffer, layers, growth) * full:
        for i in range(load.shape[1]):
            load[layers - 2, i] += load[layers - 1, i]
            load[layers - 1, i] = 0.0
        return layers - 1
    open_next = state.extent(buffer).layered > 0.0 and growth > 0.0 and layers < load.shape[0]
    if open_next and mass >= (1.0 - LANDING) * full:
        vectors.clear_rows(load, layers, layers + 1)
        return layers + 1
    return layers
