"""Pelevin's chance to pass beside finer grains (eq. 6), linear in time by sums over sizes."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics.gaudin import stop_coarse


@kernel
def pelevin(size, fraction, scene, probability):
    """Pelevin: Gaudin plus passage beside a grain that is already in the opening (paper, eq. 6).

    P_i = P^a(d_i) + sum over d_j + d_i <= a of F_j P^a(d_j) P^(a - d_j)(d_i), phi in both factors
    as printed: a rate factor, it may exceed 1. The double sum is a quadratic in d_i over a prefix
    of the sorted sizes; with c_j = a - d_j and x = c_i = a - d_i,
    sum of F_j (c_j/a)^2 (1 - d_i/c_j)^2 = sum of F_j (c_j - d_i)^2 / a^2,
    whose prefix sums stay free of cancellation because they hold no 1/c_j.
    """
    aperture = scene.aperture
    open_area = scene.open_area
    alone = open_area / (aperture * aperture)
    beside = open_area * open_area / (aperture * aperture)
    s0, s1, s2 = 0.0, 0.0, 0.0
    j = 0
    passing = stop_coarse(size, aperture, probability)
    for i in range(passing - 1, -1, -1):
        # The coarser the grain, the fewer fit beside it: the prefix grows as d_i falls.
        d, free = size[i], aperture - size[i]
        while j < passing and size[j] + d <= aperture:
            room = aperture - size[j]
            moment = fraction[j] * room
            s0 += fraction[j]
            s1 += moment
            s2 += moment * room
            j += 1
        shared = max(0.0, s2 - 2.0 * d * s1 + d * d * s0)
        probability[i] = alone * free * free + beside * shared
