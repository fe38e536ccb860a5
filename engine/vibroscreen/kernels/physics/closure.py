"""How passage and percolation follow from the vibration (MODEL.md, "Closures in the vibration")."""

from math import pi, sqrt

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics.motion import GRAVITY

# Places in the field `closure`; 1 there: the velocity follows from the vibration.
OF_PASSAGE, OF_SEGREGATION = 0, 1
# Depth of the bed for which the velocity of passage is given, in apertures: what is usual at most
# at the discharge.
USUAL_DEPTH = 4.0
# Throw number for which the velocity of percolation is given: what screens are mostly run at.
USUAL_THROW = 3.0
# Throw number at which a flight lasts two periods.
LONG_FLIGHT = 2.0 * pi


@kernel
def peak_acceleration(harmonic, frequency):
    """Largest acceleration of the deck over g, K [1]; of several harmonics the sum, a bound.

    harmonic[k]: order, then the factors [m] of cos and sin along, and of cos and sin normal.
    """
    total = 0.0
    for k in range(harmonic.shape[0]):
        along = harmonic[k, 1] * harmonic[k, 1] + harmonic[k, 2] * harmonic[k, 2]
        normal = harmonic[k, 3] * harmonic[k, 3] + harmonic[k, 4] * harmonic[k, 4]
        both = harmonic[k, 1] * harmonic[k, 3] + harmonic[k, 2] * harmonic[k, 4]
        half = 0.5 * (along - normal)
        major = 0.5 * (along + normal) + sqrt(half * half + both * both)
        total += harmonic[k, 0] * harmonic[k, 0] * sqrt(major)
    speed = 2.0 * pi * frequency
    return total * speed * speed / GRAVITY


@kernel
def peak_normal_velocity(harmonic, frequency):
    """Largest velocity of the deck normal to itself, V [m/s]; of several harmonics the sum."""
    total = 0.0
    for k in range(harmonic.shape[0]):
        normal = harmonic[k, 3] * harmonic[k, 3] + harmonic[k, 4] * harmonic[k, 4]
        total += harmonic[k, 0] * sqrt(normal)
    return 2.0 * pi * frequency * total


@kernel
def throw_height(harmonic, frequency):
    """Height to which the deck throws, V^2/(2 g) [m]."""
    velocity = peak_normal_velocity(harmonic, frequency)
    return 0.5 * velocity * velocity / GRAVITY


@kernel
def looseness(acceleration):
    """How loose shaking keeps the bed: 1 - 1/K^2, 0 up to K = 1."""
    return 1.0 - 1.0 / (acceleration * acceleration) if acceleration > 1.0 else 0.0


@kernel
def passage_factor(harmonic, frequency, aperture, throw_number):
    """u over that of a bed as deep as usual, fully loose and hardly thrown [1].

    looseness^2, over sqrt(1 + h_t/(4 a)): a bed thrown higher lands less often; and over
    1 + (G/(2 pi))^4: of flights of two periods and longer most landings are lost.
    """
    loose = looseness(peak_acceleration(harmonic, frequency))
    higher = throw_height(harmonic, frequency) / (USUAL_DEPTH * aperture)
    long = throw_number / LONG_FLIGHT
    long *= long
    return loose * loose / (sqrt(1.0 + higher) * (1.0 + long * long))


@kernel
def percolation_factor(harmonic, frequency, throw_number):
    """w over its value in a fully loose bed at the usual throw number 3: looseness G/3 [1]."""
    loose = looseness(peak_acceleration(harmonic, frequency))
    return loose * throw_number / USUAL_THROW
