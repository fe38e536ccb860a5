"""The paper's improved separation: a layer is a screen for what lies above it."""

from vibroscreen.compiler.fours import four, larger, put_four_in
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.physics import layer, packing


@kernel
def exchange(size, load, layers, scene, contact, percolation):
    """Grains fall through the gaps of the layer below their own (the paper's improved separation).

    Layer j gives rho_b (w phi_j (1 - d_i/(2 r_j))^2 + mixing) F_ji min(1, fill_j, fill_j-1) to the
    layer below, r_j and phi_j from its own mean grain radius and the dilation.
    """
    mass = layer.layer_mass(load, 0)
    layer.mix_contact(mass, contact)
    pace = scene.density * scene.segregation_velocity
    stirring = scene.density * scene.mixing
    dilation, relative = scene.dilation, scene.relative_dilation
    whole = 1.0 / scene.layer_full
    fill_below = mass / scene.contact_load
    wide = size.size - size.size % 4
    for j in range(1, layers):
        mass, moment = layer.mass_and_moment(load, j, size)
        fill = mass * whole
        # Times the mass of the layer: 2 r_j and, as phi_j = min(1, (opening/solid)^2), `solid`.
        apart = 2.0 * (dilation * mass + relative * moment)
        opening = packing.gap_radius(moment, apart)
        solid = packing._SOLID_FACTOR * (moment + apart)
        square = mass * max(opening * opening, solid * solid)
        held = min(1.0, fill, fill_below)
        rate = pace * held / square if square > layer.NOTHING else 0.0
        stirred = stirring * held / mass if mass > layer.NOTHING else 0.0
        for i in range(0, wide, 4):
            gap = larger(0.0, opening - mass * four(size, i))
            put_four_in(percolation, j, i, rate * gap * gap + stirred)
        for i in range(wide, size.size):
            free = max(0.0, opening - mass * size[i])
            percolation[j, i] = rate * free * free + stirred
        fill_below = fill
