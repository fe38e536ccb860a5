"""The velocity that the user gives."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics import motion, rigid_body


@kernel
def prescribed(harmonic, drive, result, work):
    """Velocity of the bed as given [m/s]: drive[3]; at rest while the deck does not vibrate.

    Arguments as in rigid_body. Flights, throw number and dissipation are those of the rigid body,
    0 where it has no regime; spread and status are 0.
    """
    rigid_body.rigid_body(harmonic, drive, result, work)
    result[0] = drive[3] if work[motion.ORDER] > 0.0 else 0.0
    result[1] = 0.0
    result[6] = 0.0
