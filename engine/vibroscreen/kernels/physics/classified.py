"""The finest grains lie on the screen, mixed."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics.layer import NOTHING, layer_mass


@kernel
def classified(size, load, layers, scene, contact, percolation):
    """The finest grains of the bed, as many as the contact layer holds, mixed."""
    held = min(layer_mass(load, 0), scene.contact_load)
    share = 1.0 / held if held > NOTHING else 0.0
    left = held
    for i in range(size.size):
        taken = min(load[0, i], left)
        contact[i] = taken / load[0, i] * share if taken > 0.0 else 0.0
        left -= taken
        if load[0, i] == 0.0 and left > 0.0:
            contact[i] = share
