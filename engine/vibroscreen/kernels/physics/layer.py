"""Sums over a layer of the bed, four sizes side by side."""

from vibroscreen.compiler.fours import all_four, four, four_in, total
from vibroscreen.compiler.language import kernel

# Less than this has no composition: its inverse would not be a finite number, kg/m2.
NOTHING = 1e-280


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
