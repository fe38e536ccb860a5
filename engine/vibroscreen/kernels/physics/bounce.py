"""Passage by many tries: grains of a thrown bed bounce until they fall (MODEL.md, "Bounce")."""

from math import sqrt

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics import gaudin, motion

SOLIDS = 0.58  # volume of the grains over that of the bed: spheres poured loosely
_PER_VOLUME = SOLIDS * 6.0 / 3.141592653589793  # grains of size d in a volume: this over d^3


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
    fall = sqrt(motion.GRAVITY * aperture)
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
    passing = gaudin.stop_coarse(size, aperture, probability)
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
