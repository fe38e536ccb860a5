"""Pelevin's chance to pass beside finer grains (eq. 6), linear in time by sums over sizes."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics.gaudin import stop_coarse


@kernel
def pelevin(size, fraction, scene, probability):
    """Pelevin: Gaudin plus passage beside a grain that is already in the opening (paper, eq. 6).

    P_i = P^a(d_i) + sum over d_j + d_i <= a of F_j P^a(d_j) P^(a - d_j)(d_i), phi in both factors
    as printed: a rate factor, it may exceed 1. A grain d_j makes both sides that are seen shorter
    by d_j. The double sum is a quadratic in d_i over a prefix of the sorted sizes; with the rooms
    c_j = a - d_j and e_j = s - d_j (a, b, s: see `gaudin`), it is
    sum of F_j (c_j - d_i) (e_j - d_i)/(a b),
    whose prefix sums stay free of cancellation because they hold no 1/c_j.
    """
    across, seen = scene.across, scene.seen
    open_area = scene.open_area
    narrow = min(across, seen)
    alone = open_area / (across * scene.along)
    beside = open_area * open_area / (across * scene.along)
    s0, s1, s2 = 0.0, 0.0, 0.0
    j = 0
    passing = stop_coarse(size, narrow, probability)
    for i in range(passing - 1, -1, -1):
        # The coarser the grain, the fewer fit beside it: the prefix grows as d_i falls.
        d = size[i]
        while j < passing and size[j] + d <= narrow:
            room, length = across - size[j], seen - size[j]
            s0 += fraction[j]
            s1 += fraction[j] * (0.5 * (room + length))
            s2 += fraction[j] * room * length
            j += 1
        shared = max(0.0, s2 - 2.0 * d * s1 + d * d * s0)
        probability[i] = alone * (across - d) * (seen - d) + beside * shared
