"""Passage through the openings: probability factor of a try, by size (MODEL.md, "Passage").

Signature of a passage law:

    law(size[node], fraction[node], scene, probability[node])

reads node sizes in m (ascending), the mass fractions F_0 in the contact layer and the scene
(indices S_* of layout.py), and writes P_i, dimensionless. The passage per plan area is
rho_b u P_i F_0i cover, kg/(m2 s).
"""

from __future__ import annotations

from vibroscreen.kernels.jit import call_passage, kernel
from vibroscreen.kernels.layout import S_APERTURE, S_OPEN_AREA

GAUDIN, PELEVIN = 1, 2


@kernel
def gaudin(size, fraction, scene, probability):
    """Gaudin: P = phi (1 - d/a)^2 for d < a, else 0 (paper, eq. 5)."""
    aperture = scene[S_APERTURE]
    open_area = scene[S_OPEN_AREA]
    for i in range(size.size):
        free = max(0.0, 1.0 - size[i] / aperture)
        probability[i] = open_area * free * free


@kernel
def pelevin(size, fraction, scene, probability):
    """Pelevin: Gaudin plus passage beside a grain that is already in the opening (paper, eq. 6).

    P_i = P^a(d_i) + sum over d_j + d_i <= a of F_j P^a(d_j) P^(a - d_j)(d_i), phi in both factors
    as printed: a rate factor, it may exceed 1. The double sum is a quadratic in d_i over a prefix
    of the sorted sizes; with c_j = a - d_j and x = c_i = a - d_i,
    sum of F_j (c_j/a)^2 (1 - d_i/c_j)^2 = sum of F_j (c_j - d_i)^2 / a^2,
    whose prefix sums stay free of cancellation because they hold no 1/c_j.
    """
    aperture = scene[S_APERTURE]
    open_area = scene[S_OPEN_AREA]
    gaudin(size, fraction, scene, probability)
    beside = open_area * open_area / (aperture * aperture)
    s0, s1, s2 = 0.0, 0.0, 0.0
    j = 0
    for i in range(size.size - 1, -1, -1):
        # The coarser the grain, the fewer fit beside it: the prefix grows as d_i falls.
        while j < size.size and size[j] < aperture and size[j] + size[i] <= aperture:
            room = aperture - size[j]
            s0 += fraction[j]
            s1 += fraction[j] * room
            s2 += fraction[j] * room * room
            j += 1
        d = size[i]
        probability[i] += beside * max(0.0, s2 - 2.0 * d * s1 + d * d * s0)


@kernel
def passage_probability(law, address, size, fraction, scene, probability):
    """P_i of the chosen law; `address` is that of a user's own."""
    if law == GAUDIN:
        gaudin(size, fraction, scene, probability)
    elif law == PELEVIN:
        pelevin(size, fraction, scene, probability)
    else:
        call_passage(address, size, fraction, scene, probability)
