"""Layers of a column: full loads, restacking, cover."""

from math import ceil

from vibroscreen.compiler.language import kernel, view2
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics.layer import layer_mass

# A layer is opened only for more than this part of a full one: round-off makes no layers.
SLIVER = 1e-9


@kernel
def bed_load(load, layers):
    """Areal mass of a column, kg/m2."""
    mass = 0.0
    for j in range(layers):
        mass += layer_mass(load, j)
    return mass


@kernel
def layers_for(buffer, scene, mass):
    """Layers that a bed of `mass` kg/m2 has; sets the full load of an upper layer.

    A bed deeper than the layers can hold thickens the upper layers, never the contact layer.
    """
    scene.bed_load = mass
    scene.layer_full = scene.layer_load
    above = mass - scene.contact_load
    if state.extent(buffer).layered == 0.0 or above <= SLIVER * scene.layer_load:
        return 1
    most = state.extent(buffer).layers - 1
    if above > most * scene.layer_load * (1.0 + SLIVER):
        scene.layer_full = above / most
        return 1 + most
    return 1 + min(most, int(ceil(above / scene.layer_load - SLIVER)))


@kernel
def restack(buffer, scene, load, layers):
    """Settle: cut the column anew at the full loads of its layers; returns the number of layers.

    The stack keeps its order, so a layer is refilled with what lies right above it, and what does
    not fit into a layer goes to the one above. Rows that become free are zeroed.
    """
    wanted = layers_for(buffer, scene, bed_load(load, layers))
    if wanted == 1 and layers == 1:
        return 1
    nodes = load.shape[1]
    old = view2(buffer, int(buffer[state.AT.scratch]), load.shape[0], nodes)
    vectors.copy_rows(old, load, layers)
    source = 0
    whole = layer_mass(old, 0)
    left = 1.0  # what remains of the layer `source`, as a part of it
    for j in range(wanted):
        need = scene.contact_load if j == 0 else scene.layer_full
        vectors.clear_rows(load, j, j + 1)
        while source < layers:
            last = j == wanted - 1
            part = need / whole if not last and whole * left > need else left
            for i in range(nodes):
                load[j, i] += part * old[source, i]
            need -= part * whole
            if part < left:
                left -= part
                break
            source += 1
            left = 1.0
            if source < layers:
                whole = layer_mass(old, source)
            if need <= 0.0 and not last:
                break
    vectors.clear_rows(load, wanted, layers)
    return wanted
