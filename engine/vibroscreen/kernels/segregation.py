"""Segregation: what lies on the screen, and how grains percolate (MODEL.md, "Segregation").

Signature of a segregation model:

    model(size[node], load[layer, node], layers, scene, contact[node], percolation[layer, node])

reads areal masses in kg/m2 (row 0 lies on the screen; models without layers hold the whole bed in
row 0) and writes
  contact[i], m2/kg: the mass fraction in the contact layer is F_0i = contact_i load[0, i];
  percolation[j, i], 1/s: layer j > 0 gives percolation[j, i] load[j, i] kg/(m2 s) to layer j - 1;
      the same total mass returns with the composition of the layer below (done by rates.py).
"""

from __future__ import annotations

from math import sqrt

from vibroscreen.kernels.fours import all_four, four, four_in, larger, put_four_in, total
from vibroscreen.kernels.language import call_segregation, kernel

WELL_MIXED, PROPORTIONAL, EXCHANGE, CLASSIFIED = 1, 2, 3, 4
# Less than this has no composition: its inverse would not be a finite number, kg/m2.
NOTHING = 1e-280

_RADIUS_FACTOR = 2.0 * sqrt(3.0) / 3.0
_HEXAGON_FACTOR = sqrt(3.0)
_PI = 3.141592653589793
_SOLID_FACTOR = sqrt(_HEXAGON_FACTOR / _PI)


@kernel
def gap_radius(mean_radius, dilation):
    """Radius of the gap between three grains on a triangle, m: (2/sqrt3 - 1) R + (2/sqrt3) dr."""
    return (_RADIUS_FACTOR - 1.0) * mean_radius + _RADIUS_FACTOR * dilation


@kernel
def gap_of(size, dilation, relative):
    """Gaps among grains of one size [m] that dilate by dilation + relative size: 2 r, m."""
    return 2.0 * gap_radius(0.5 * size, dilation + relative * size)


@kernel
def gap_open_area(mean_radius, dilation):
    """Open area of the gaps: min(1, pi r^2 / (sqrt3 (R + dr)^2))."""
    if mean_radius + dilation <= 0.0:
        return 0.0
    ratio = gap_radius(mean_radius, dilation) / (mean_radius + dilation)
    return min(1.0, _PI / _HEXAGON_FACTOR * ratio * ratio)


@kernel
def layer_mass(load, row):
    """Areal mass of one layer, kg/m2."""
    nodes, mass = load.shape[1], all_four(0.0)
    whole = nodes - nodes % 4
    for i in range(0, whole, 4):
        mass += four_in(load, row, i)
    rest = 0.0
    for i in range(whole, nodes):
        rest += load[row, i]
    return total(mass) + rest


@kernel
def weighted_mass(load, row, weight, weight_row):
    """Sum over the sizes of a layer of weight times areal mass."""
    nodes, mass = load.shape[1], all_four(0.0)
    whole = nodes - nodes % 4
    for i in range(0, whole, 4):
        mass += four_in(load, row, i) * four_in(weight, weight_row, i)
    rest = 0.0
    for i in range(whole, nodes):
        rest += load[row, i] * weight[weight_row, i]
    return total(mass) + rest


@kernel
def mass_and_moment(load, row, size):
    """Areal mass of a layer, kg/m2, and the sum over its sizes of size times areal mass, kg/m."""
    nodes, mass, moment = load.shape[1], all_four(0.0), all_four(0.0)
    whole = nodes - nodes % 4
    for i in range(0, whole, 4):
        held = four_in(load, row, i)
        mass += held
        moment += held * four(size, i)
    rest, rest_moment = 0.0, 0.0
    for i in range(whole, nodes):
        rest += load[row, i]
        rest_moment += load[row, i] * size[i]
    return total(mass) + rest, total(moment) + rest_moment


@kernel
def mix_contact(mass, contact):
    """Contact weights where row 0 of `mass` kg/m2 is mixed evenly."""
    share = 1.0 / mass if mass > NOTHING else 0.0
    for i in range(contact.size):
        contact[i] = share


@kernel
def well_mixed(size, load, layers, scene, contact, percolation):
    """The contact layer has the mean composition of the bed (the classical first-order model)."""
    mix_contact(layer_mass(load, 0), contact)


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


@kernel
def proportional(size, load, layers, scene, contact, percolation):
    """Contact composition (1 - chi) mean + chi classified (the paper's original separation)."""
    classified(size, load, layers, scene, contact, percolation)
    mass = layer_mass(load, 0)
    share = 1.0 / mass if mass > NOTHING else 0.0
    chi = scene.proportion
    for i in range(size.size):
        contact[i] = (1.0 - chi) * share + chi * contact[i]


@kernel
def exchange(size, load, layers, scene, contact, percolation):
    """Grains fall through the gaps of the layer below their own (the paper's improved separation).

    Layer j gives rho_b (w phi_j (1 - d_i/(2 r_j))^2 + mixing) F_ji min(1, fill_j, fill_j-1) to the
    layer below, r_j and phi_j from its own mean grain radius and the dilation.
    """
    mass = layer_mass(load, 0)
    mix_contact(mass, contact)
    pace = scene.density * scene.segregation_velocity
    stirring = scene.density * scene.mixing
    dilation, relative = scene.dilation, scene.relative_dilation
    whole = 1.0 / scene.layer_full
    fill_below = mass / scene.contact_load
    wide = size.size - size.size % 4
    for j in range(1, layers):
        mass, moment = mass_and_moment(load, j, size)
        fill = mass * whole
        # Times the mass of the layer: 2 r_j and, as phi_j = min(1, (opening/solid)^2), `solid`.
        apart = 2.0 * (dilation * mass + relative * moment)
        opening = gap_radius(moment, apart)
        solid = _SOLID_FACTOR * (moment + apart)
        square = mass * max(opening * opening, solid * solid)
        held = min(1.0, fill, fill_below)
        rate = pace * held / square if square > NOTHING else 0.0
        stirred = stirring * held / mass if mass > NOTHING else 0.0
        for i in range(0, wide, 4):
            gap = larger(0.0, opening - mass * four(size, i))
            put_four_in(percolation, j, i, rate * gap * gap + stirred)
        for i in range(wide, size.size):
            free = max(0.0, opening - mass * size[i])
            percolation[j, i] = rate * free * free + stirred
        fill_below = fill


@kernel
def segregate(model, address, size, load, layers, scene, contact, percolation):
    """Contact weights and percolation rates of the chosen model; `address` is a user's own."""
    if model == WELL_MIXED:
        well_mixed(size, load, layers, scene, contact, percolation)
    elif model == PROPORTIONAL:
        proportional(size, load, layers, scene, contact, percolation)
    elif model == EXCHANGE:
        exchange(size, load, layers, scene, contact, percolation)
    elif model == CLASSIFIED:
        classified(size, load, layers, scene, contact, percolation)
    else:
        call_segregation(address, size, load, layers, scene, contact, percolation)
