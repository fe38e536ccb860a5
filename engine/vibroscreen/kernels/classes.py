"""Size classes split into narrow nodes and summed back (MODEL.md, "Wide classes").

A sieve analysis says how much lies between two sieves, not where. The cumulative curve through the
sieves is interpolated by the monotone cubic of Fritsch and Carlson with the harmonic mean of
Brodlie (Fritsch & Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300), the interpolant of
scipy.interpolate.PchipInterpolator. Its derivative is the density of mass over size inside a class.
"""

from __future__ import annotations

from vibroscreen.kernels.jit import kernel


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
        width = next_width
        density = next_density


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
        total = 0.0
        end = first
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
    for k in range(class_value.size):
        class_value[k] = 0.0
    for i in range(node_value.size):
        class_value[int(node_class[i])] += node_value[i]
