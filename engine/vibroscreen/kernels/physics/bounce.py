"""Passage by many tries: grains try at each landing of a thrown bed (MODEL.md, "Bounce")."""

from math import sqrt

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics import closure, gaudin, motion


@kernel
def bounce(size, fraction, scene, probability):
    """Grains try at each landing of the bed, are carried on while they sink, and crowd each other.

    P_i = phi g_i l_i/(E (1 + B)), H = depth of the bed, h_t = height to which the deck throws,
    H_b = min(H, a/levelling), what the deck shakes of it,
    E^2 = (H_b + h_t (1 + bouncing (1 - cover)^2))/(4 a + h_t): how far the bed comes down,
    g_i = 1 - (1 - rim) d_i/across for d_i < a, else 0: the free part of the side across the flow,
    l_i = max(0, along - (1 - rim) d_i - max(along - seen, drift v sqrt(d_i/g)))/along: the same of
    the side along the flow, less the way along it of a sinking grain, that falls or is carried on,
    B = crowding cover sum of F_i g_i l_i (a/max(d_i, a/2))^3: grains that try the same opening.
    """
    aperture = scene.aperture
    hidden = 1.0 - scene.seen / scene.along
    beyond, ahead = (1.0 - scene.rim) / scene.across, (1.0 - scene.rim) / scene.along
    carried = scene.drift * scene.transport_velocity / (sqrt(motion.GRAVITY) * scene.along)
    depth = scene.bed_load / scene.density
    level = scene.levelling * depth / aperture
    bare = 1.0 - scene.cover
    thrown = scene.throw_height * (1.0 + scene.bouncing * bare * bare)
    down = depth / max(1.0, level) + thrown
    usual = closure.USUAL_DEPTH * aperture + scene.throw_height
    held = sqrt(down / usual)
    crowd = 0.0
    passing = gaudin.stop_coarse(size, scene.closed, probability)
    for i in range(passing):
        d = size[i]
        free = (1.0 - beyond * d) * max(0.0, 1.0 - ahead * d - max(hidden, carried * sqrt(d)))
        room = aperture / max(d, 0.5 * aperture)
        crowd += free * fraction[i] * (room * room * room)
        probability[i] = free
    busy = scene.crowding * scene.cover * crowd
    slow = held * (1.0 + busy)
    scale = scene.open_area / slow if slow > 0.0 else 0.0
    for i in range(passing):
        probability[i] *= scale
