"""Passage through the openings: probability factor of a try, by size (MODEL.md, "Passage").

Signature of a passage law:

    law(size[node], fraction[node], scene, probability[node])

reads node sizes in m (ascending), the mass fractions F_0 in the contact layer and the scene
(indices S_* of layout.py), and writes P_i, dimensionless. The passage per plan area is
rho_b u P_i F_0i cover, kg/(m2 s).
"""

from __future__ import annotations

from math import sqrt

from vibroscreen.kernels.displacement import GRAVITY
from vibroscreen.kernels.language import call_passage, kernel

GAUDIN, PELEVIN, BOUNCE = 1, 2, 3
SOLIDS = 0.58  # volume of the grains over that of the bed: spheres poured loosely
_PER_VOLUME = SOLIDS * 6.0 / 3.141592653589793  # grains of size d in a volume: this over d^3


@kernel
def stop_coarse(size, aperture, probability):
    """Let no size pass that is not below the aperture; returns the number of sizes that are."""
    passing = size.size
    while passing > 0 and size[passing - 1] >= aperture:
        passing -= 1
        probability[passing] = 0.0
    return passing


@kernel
def gaudin(size, fraction, scene, probability):
    """Gaudin: P = phi (1 - d/a)^2 for d < a, else 0 (paper, eq. 5)."""
    aperture = scene.aperture
    open_area = scene.open_area
    scale = open_area / (aperture * aperture)
    for i in range(size.size):
        free = max(0.0, aperture - size[i])
        probability[i] = scale * free * free


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


@kernel
def bounce(size, fraction, scene, probability):
    """Grains that bounce: guided by the rim, carried on, crowded in the openings, held and thrown.

    P_i = phi G_i/(E (1 + N_i) (1 + B)), H = depth of the bed, H_c = max(H, h_c),
    H_b = H/sqrt(1 + (levelling H/h_c)^2), what the deck shakes of it,
    E = (1 + lift/((1 + calming H_c/h_c) H_c)) (1 + damping H_b/(S a)),
    G_i = g_i^2/(1 + drift v/sqrt(g a) d_i/(g_i a)), g_i = 1 - (1 - rim) d_i/a for d_i < a, else 0,
    S = 1 + stirring v/sqrt(g a), N_i = depletion u phi G_i H_b/(E V a). B = the time for which an
    opening is taken up, passing_time sqrt(a/g)/(S loosening) for one grain or for as many finer
    ones as fill it, times their number a second.
    """
    aperture = scene.aperture
    fall = sqrt(GRAVITY * aperture)
    ride = scene.transport_velocity / fall
    carried = scene.drift * ride / aperture
    beyond = (1.0 - scene.rim) / aperture
    stirred = 1.0 + scene.stirring * ride
    level = scene.levelling * scene.bed_load / scene.contact_load
    shaken = scene.bed_load / sqrt(1.0 + level * level)
    held = 1.0 + scene.damping * shaken / (stirred * scene.density * aperture)
    bed = max(scene.bed_load, scene.contact_load)
    calm = 1.0 + scene.calming * bed / scene.contact_load
    held *= 1.0 + scene.lift * scene.density / (calm * bed)
    short = scene.depletion * shaken / scene.density
    short *= scene.passage_velocity * scene.open_area / held
    crowd = 0.0
    passing = stop_coarse(size, aperture, probability)
    for i in range(passing):
        d = size[i]
        guided = 1.0 - beyond * d
        freed = guided * guided * guided
        room = max(d, 0.5 * aperture)
        space = room * room * room
        slow = space * (guided + carried * d + short * freed)
        easy = freed / slow if guided > 0.0 else 0.0
        crowd += easy * fraction[i]
        probability[i] = space * easy
    tries = scene.passage_velocity * scene.cover / (held * scene.loosening)
    taken = scene.passing_time * aperture / (fall * stirred) * aperture * aperture
    busy = taken * tries * _PER_VOLUME * crowd if tries > 0.0 else 0.0
    scale = scene.open_area / (held * (1.0 + busy))
    for i in range(passing):
        probability[i] *= scale


@kernel
def passage_probability(law, address, size, fraction, scene, probability):
    """P_i of the chosen law; `address` is that of a user's own."""
    if law == GAUDIN:
        gaudin(size, fraction, scene, probability)
    elif law == PELEVIN:
        pelevin(size, fraction, scene, probability)
    elif law == BOUNCE:
        bounce(size, fraction, scene, probability)
    else:
        call_passage(address, size, fraction, scene, probability)
