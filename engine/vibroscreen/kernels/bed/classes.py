"""Size classes split into narrow nodes and summed back (MODEL.md, "Wide classes").

A sieve analysis says how much lies between two sieves, not where. The cumulative curve through the
sieves is interpolated by the monotone cubic of Fritsch and Carlson with the harmonic mean of
Brodlie (Fritsch & Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300), the interpolant of
scipy.interpolate.PchipInterpolator. Its derivative is the density of mass over size inside a class.

How many nodes a piece of a class needs is estimated (`quadrature_error`); docs/measured.md says how
well. One node leaves the centroid of a class free: only for narrow classes at loose tolerances.
"""

from math import pi, sqrt

from vibroscreen.compiler.elementary import cos, exp, raised
from vibroscreen.compiler.language import kernel, record
from vibroscreen.kernels import state
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics import packing, segregation
from vibroscreen.kernels.physics.motion import GRAVITY

MOST_NODES = 24  # on a piece, where the engine chooses
# Part of the tolerance that the nodes may use: half their error costs a node or two a class, half
# that of the steps more. Not where a kink leaves an error of second order (sorted models).
NODE_SHARE = 0.6
# Least K = rho_b u phi W L/Q0 that the nodes are made for (15 on the default screen), through the
# openings and through the gaps of `exchange`, whose open area is about GAP_SHARE of a deck's.
LEAST_PASSAGE, LEAST_PERCOLATION, GAP_SHARE = 50.0, 10.0, 0.4
MOST_STRENGTH = 1e5
THIN_VELOCITY = 0.3  # m/s, not known before the displacement is solved
# Kinks that move through the classes while a slice rides: the gap of `exchange`, the coarsest
# sorted grain of `proportional` and `classified`. Error with n nodes on a piece of width w (of the
# gap, of the aperture), over feeds and K from 1 to 50, class factors 1.15 to 4:
#     exchange     50 V (w/n)^4 at a percolation velocity V m/s, from 0.1 m/s up; where nothing of
#                  the piece passes, so that it acts by the gaps that it makes, 20 V (w/n)^4
#     sorted       0.1 (w/n)^2 the median, 1 (w/n)^2 the worst
GAP_KINK, CLOSED_KINK, LEAST_KINK_VELOCITY = 50.0, 20.0, 0.1
SORTED_KINK = 0.1


@kernel
def quadrature_error(nodes, near, width, most):
    """Estimated error of a class's recovery from `nodes` Gauss-Legendre nodes on a piece of it.

    near: distance of the piece from the aperture, width: its width, both over the aperture;
    most: largest K. One node: a quarter of the width (the centroid may lie there) times the
    steepest slope. More: the
    remainder with the second derivative of the density, 24/width^2, and that of order 2n - 2 of
    exp(-K s^2), where it is largest for any K; 1 + z/3n keeps it in bounds where it is no longer
    small.
    """
    if nodes == 1:
        s = max(near, 1.0 / sqrt(2.0 * most))
        k = min(most, 1.0 / (s * s))
        return 0.25 * width * 2.0 * k * s * exp(-k * s * s)
    factor = 0.25  # n!^3/(2n)!^2
    for n in range(1, nodes):
        factor *= (n + 1.0) / (4.0 * (2.0 * n + 1.0) * (2.0 * n + 1.0))
    order = nodes - 1.0
    k = most
    if near * near * k > 2.0 * order:
        k = 2.0 * order / (near * near)
    z = k * width * width
    factor *= 12.0 * nodes / (2.0 * nodes + 1.0) * exp(-0.5 * k * near * near)
    return factor * raised(z / (1.0 + z / (3.0 * nodes)), order)


@kernel
def piece_nodes(low, high, aperture, most, tolerance):
    """Nodes that a piece of a class [m] needs for an aperture or a gap [m], 1 or more.

    most: largest K. MOST_NODES where even they leave an error above the tolerance; 1 above the
    aperture.
    """
    if low >= aperture:
        return 1
    near = max(0.0, 1.0 - high / aperture)
    width = (high - low) / aperture
    nodes = 1
    while nodes < MOST_NODES and (quadrature_error(nodes, near, width, most) > tolerance):
        nodes += 1
    return nodes


@kernel
def percolation_at(parameter, aperture):
    """Velocity of percolation on a panel of that aperture, m/s, but for the closure."""
    relative = parameter.segregation_relative_velocity
    return parameter.segregation_velocity + relative * sqrt(GRAVITY * aperture)


@kernel
def _kink_nodes(low, high, edge, aperture, parameter, strength):
    """Nodes that a piece of a class needs for the segregation model, 1 or more.

    Two keep the mean size, on which the gaps depend. The gap lies between those of a layer of the
    finest and of the coarsest class at the configured dilation; a piece among them is treated as
    one that ends at the gap. Models of one's own are taken for smooth.
    """
    model, tolerance = parameter.segregation_model, parameter.solver_tolerance
    least, coefficient, power = 1, 0.0, 1.0
    scale = aperture
    if model == segregation.EXCHANGE:
        tolerance *= NODE_SHARE
        dilation, relative = parameter.segregation_dilation, parameter.segregation_relative_dilation
        finest = packing.gap_of(0.5 * (edge[0] + edge[1]), dilation, relative)
        coarsest = packing.gap_of(edge[edge.size - 1], dilation, relative)
        if low >= coarsest:
            return 2
        least = 2
        if high <= finest:
            return max(least, piece_nodes(low, high, finest, strength[1], tolerance))
        kink = GAP_KINK if low < aperture else CLOSED_KINK
        coefficient = kink * max(LEAST_KINK_VELOCITY, percolation_at(parameter, aperture))
        scale, power = high, 0.25
    elif model == segregation.CLASSIFIED or model == segregation.PROPORTIONAL:
        if low < aperture:
            coefficient, power = SORTED_KINK, 0.5
    elif model != segregation.WELL_MIXED:
        least = 2
    need = (high - low) / scale * raised(coefficient / tolerance, power)
    return min(MOST_NODES, max(least, int(need) + 1))


@kernel
def most_nodes(classes, apertures, subdivision):
    """Room that `build_nodes` may need for so many classes and apertures."""
    return (classes + apertures) * max(MOST_NODES, int(subdivision))


@kernel
def _piece_count(low, high, whole, edge, aperture, parameter, strength):
    """Nodes on a piece of a class; `whole` where the piece is the class."""
    if parameter.size_classes_subdivision >= 1.0:
        return parameter.size_classes_subdivision
    # One node cannot hold what a class has on either side of an aperture.
    nodes = 1 if whole else 2
    tolerance = NODE_SHARE * parameter.solver_tolerance
    for k in range(aperture.size):
        nodes = max(nodes, piece_nodes(low, high, aperture[k], strength[0], tolerance))
    largest = aperture[aperture.size - 1]
    return max(nodes, _kink_nodes(low, high, edge, largest, parameter, strength))


@kernel
def set_strength(parameter, aperture, exposure, reach, strength):
    """K of the openings and of the gaps that nodes are made for.

    aperture: those of the screen [m], ascending; exposure = phi W L/Q0 [m2 s/kg] gives that of a
    deep bed, reach = phi L [m] that of one that has become thin: u phi L/(v h_c), at a velocity of
    THIN_VELOCITY. Writes strength[2].
    """
    largest = aperture[aperture.size - 1]
    fall = sqrt(GRAVITY * largest)
    depth = parameter.bed_contact_depth + parameter.bed_relative_contact_depth * aperture[0]
    thin = reach / (THIN_VELOCITY * depth)
    tries = max(thin, parameter.material_bulk_density * exposure)
    passage = tries * (parameter.passage_velocity + parameter.passage_relative_velocity * fall)
    percolation = GAP_SHARE * tries * percolation_at(parameter, largest)
    strength[0] = min(MOST_STRENGTH, max(LEAST_PASSAGE, passage))
    strength[1] = min(MOST_STRENGTH, max(LEAST_PERCOLATION, percolation))


@kernel
def _legendre(nodes, k):
    """Abscissa k of Gauss-Legendre in -1..1 and its weight, by Newton's method."""
    x = -cos(pi * (k + 0.75) / (nodes + 0.5))
    slope = 1.0
    for _ in range(6):
        before, value = 1.0, x
        for n in range(2, nodes + 1):
            before, value = value, ((2.0 * n - 1.0) * x * value - (n - 1.0) * before) / n
        slope = nodes * (before - x * value) / (1.0 - x * x)
        x -= value / slope
    return x, 2.0 / ((1.0 - x * x) * slope * slope)


@entry("int64(vector, vector, vector, vector, vector, vector, vector, vector)")
def build_nodes(edge, aperture, setting, strength, size, node_class, position, weight):
    """Write the nodes of all classes, ascending; returns how many.

    edge[N + 1] in m, aperture ascending in m; of setting: subdivision, tolerance, segregation
    model, velocity and dilation; strength[2] by `set_strength`. A class is broken at the apertures
    inside it. Arrays of `most_nodes`: size in m, node_class from 0, position in the class 0..1,
    weight summing to 1 over a class.
    """
    parameter = record(setting, 0, state.PARAMETER)
    count = 0
    for k in range(edge.size - 1):
        width = edge[k + 1] - edge[k]
        low = edge[k]
        for b in range(aperture.size + 1):
            high = edge[k + 1]
            if b < aperture.size:
                # A piece of no width but round-off would have several nodes at one size.
                inside = min(aperture[b] - low, high - aperture[b]) > 1e-9 * width
                if not inside or parameter.size_classes_subdivision == 1.0:
                    continue
                high = aperture[b]
            whole = high - low == width
            nodes = _piece_count(low, high, whole, edge, aperture, parameter, strength)
            for i in range(nodes):
                x, share = _legendre(nodes, i)
                size[count] = 0.5 * (low + high) + 0.5 * (high - low) * x
                node_class[count] = k
                position[count] = (size[count] - edge[k]) / width
                weight[count] = 0.5 * (high - low) / width * share
                count += 1
            low = high
    return count


@kernel
def _end_slope(width, next_width, density, next_density):
    """Slope of the cumulative curve at its first or last sieve, 1/m.

    Three-point one-sided difference, held within what keeps the curve monotone.
    """
    slope = ((2.0 * width + next_width) * density - width * next_density) / (width + next_width)
    return min(max(slope, 0.0), 3.0 * density)


@kernel
def cumulative_slopes(edge, fraction, slope):
    """Slope of the monotone cumulative curve at every limit of the classes, 1/m.

    edge[N + 1] ascending in m, fraction[N] not negative; writes slope[N + 1].
    """
    last = fraction.size - 1
    if last == 0:
        slope[0] = fraction[0] / (edge[1] - edge[0])
        slope[1] = slope[0]
        return
    width = edge[1] - edge[0]
    density = fraction[0] / width
    for k in range(1, last + 1):
        next_width = edge[k + 1] - edge[k]
        next_density = fraction[k] / next_width
        if k == 1:
            slope[0] = _end_slope(width, next_width, density, next_density)
        if k == last:
            slope[last + 1] = _end_slope(next_width, width, next_density, density)
        if density > 0.0 and next_density > 0.0:
            near = 2.0 * next_width + width
            far = next_width + 2.0 * width
            slope[k] = (near + far) / (near / density + far / next_density)
        else:
            slope[k] = 0.0
        width, density = next_width, next_density


@kernel
def split_classes(edge, fraction, node_class, position, weight, slope, node_fraction):
    """Mass fraction at every node, from the mass fractions of the classes.

    edge[N + 1] in m, fraction[N] not negative; node_class[n] ascending class numbers from 0,
    position[n] in 0..1 inside the class, weight[n] summing to 1 over a class; slope[N + 1] is
    scratch. Writes node_fraction[n], never negative: the nodes of a class sum to its fraction and
    an empty class gives zeros. A class whose density vanishes at all its nodes is spread by weight.
    """
    cumulative_slopes(edge, fraction, slope)
    first = 0
    while first < node_class.size:
        k = int(node_class[first])
        width = edge[k + 1] - edge[k]
        rise, fall = slope[k] * width, slope[k + 1] * width
        total, end = 0.0, first
        while end < node_class.size and int(node_class[end]) == k:
            x = position[end]
            y = 1.0 - x
            # The derivative of a monotone cubic: below zero by round-off only.
            density = rise * y * y + fall * x * x
            density += 2.0 * (3.0 * fraction[k] - rise - fall) * x * y
            node_fraction[end] = weight[end] * max(density, 0.0)
            total += node_fraction[end]
            end += 1
        for i in range(first, end):
            share = node_fraction[i] / total if total > 0.0 else weight[i]
            node_fraction[i] = fraction[k] * share
        first = end


@kernel
def merge_classes(node_value, node_class, class_value):
    """Sum of a node quantity over every class, in the unit of the quantity.

    node_value[n], node_class[n] class numbers from 0; writes class_value[N].
    """
    vectors.fill(class_value, 0.0)
    for i in range(node_value.size):
        class_value[int(node_class[i])] += node_value[i]


@kernel
def sum_nodes(buffer, node_value, class_value):
    """`merge_classes` over the classes of the screen."""
    merge_classes(node_value, state.node_class(buffer), class_value)
