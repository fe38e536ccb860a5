"""Segregation in the bed: the model is chosen by its number (MODEL.md, "Segregation").

    model(size[node], load[layer, node], layers, scene, contact[node], percolation[layer, node])

writes the contact weights [m2/kg] and the percolation downwards [1/s].
"""

from vibroscreen.compiler.language import kernel, own_model
from vibroscreen.kernels import state
from vibroscreen.kernels.physics import classified, exchange, proportional, well_mixed

call_segregation = own_model(
    "segregation", "vector", "matrix", "int64", state.SCENE, "vector", "matrix"
)
WELL_MIXED, PROPORTIONAL, EXCHANGE, CLASSIFIED = 1, 2, 3, 4


@kernel
def segregate(model, address, size, load, layers, scene, contact, percolation):
    """Contact weights and percolation rates of the chosen model; `address` is a user's own."""
    if model == WELL_MIXED:
        well_mixed.well_mixed(size, load, layers, scene, contact, percolation)
    elif model == PROPORTIONAL:
        proportional.proportional(size, load, layers, scene, contact, percolation)
    elif model == EXCHANGE:
        exchange.exchange(size, load, layers, scene, contact, percolation)
    elif model == CLASSIFIED:
        classified.classified(size, load, layers, scene, contact, percolation)
    else:
        call_segregation(address, size, load, layers, scene, contact, percolation)
