"""The paper's original model: a part of the bed is sorted, the rest mixed."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics import classified, layer


@kernel
def proportional(size, load, layers, scene, contact, percolation):
    """Contact composition (1 - chi) mean + chi classified (the paper's original separation)."""
    classified.classified(size, load, layers, scene, contact, percolation)
    mass = layer.layer_mass(load, 0)
    share = 1.0 / mass if mass > layer.NOTHING else 0.0
    chi = scene.proportion
    for i in range(size.size):
        contact[i] = (1.0 - chi) * share + chi * contact[i]
