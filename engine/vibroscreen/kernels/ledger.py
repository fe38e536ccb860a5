"""The ledger: what was fed, left and is held, by class; sums that lose nothing (Neumaier)."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import classes
from vibroscreen.kernels.bed.held import held_by_node
from vibroscreen.kernels.numerics import vectors


@kernel
def sums_of(buffer, row):
    """Cumulative masses of a stream by class, kg, and their compensation."""
    whole = state.class_vector(buffer, state.AT.ledger, 2 * row)
    return whole, state.class_vector(buffer, state.AT.ledger, 2 * row + 1)


@kernel
def book_masses(buffer):
    """Add the class masses of the step to the ledger: nothing is rounded away (Neumaier)."""
    for row in range(state.OVER + state.extent(buffer).decks):
        whole, rest = sums_of(buffer, row)
        mass = state.class_vector(buffer, state.AT.class_mass, row)
        for k in range(mass.size):
            total = whole[k] + mass[k]
            if abs(whole[k]) >= abs(mass[k]):
                rest[k] += (whole[k] - total) + mass[k]
            else:
                rest[k] += (mass[k] - total) + whole[k]
            whole[k] = total


@kernel
def ledger_total(buffer, row):
    """Cumulative mass of all classes of a stream, kg."""
    whole, rest = sums_of(buffer, row)
    total = vectors.total(rest)
    for k in range(whole.size):
        total += whole[k]
    return total


@kernel
def balance_error(buffer):
    """Fed - discharged - held since the start, kg, class by class."""
    initial = state.class_vector(buffer, state.AT.initial_mass, 0)
    held = state.class_vector(buffer, state.AT.held, 0)
    fed, fed_rest = sums_of(buffer, state.FED)
    error = 0.0
    for k in range(held.size):
        left, rest = fed[k], fed_rest[k]
        for row in range(state.UNDER, state.OVER + state.extent(buffer).decks):
            out, out_rest = sums_of(buffer, row)
            left -= out[k]
            rest -= out_rest[k]
        error += (left - held[k] + initial[k]) + rest
    return error


@kernel
def count_held(buffer):
    """What lies on all decks by class, into `held`, kg."""
    node = state.node_vector(buffer, state.AT.node_work, 0)
    vectors.fill(node, 0.0)
    hold_up = state.vector(buffer, state.AT.hold_up_work, state.extent(buffer).decks, 0)
    for deck in range(hold_up.size):
        hold_up[deck] = held_by_node(buffer, deck, node)
    classes.sum_nodes(buffer, node, state.class_vector(buffer, state.AT.held, 0))
