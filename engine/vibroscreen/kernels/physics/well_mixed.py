"""The classical model: every layer has the composition of the bed."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics.layer import layer_mass, mix_contact


@kernel
def well_mixed(size, load, layers, scene, contact, percolation):
    """The contact layer has the mean composition of the bed (the classical first-order model)."""
    mix_contact(layer_mass(load, 0), contact)
