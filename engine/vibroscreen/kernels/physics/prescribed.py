"""The velocity that the user gives."""

from vibroscreen.compiler.language import kernel, record
from vibroscreen.kernels.physics import motion
from vibroscreen.kernels.physics.rigid_body import rigid_body


@kernel
def prescribed(harmonic, drive, result, work):
    """Velocity of the bed as given [m/s]: drive[3]; at rest while the deck does not vibrate.

    Arguments as in rigid_body. Flights, throw number and dissipation are those of the rigid body,
    0 where it has no regime; spread and status are 0.
    """
    rigid_body(harmonic, drive, result, work)
    found = record(result, 0, motion.RESULT)
    found.velocity = record(drive, 0, motion.DRIVE).velocity if work[motion.ORDER] > 0.0 else 0.0
    found.spread, found.status = 0.0, 0.0
