"""The ledger: what was fed, left and is held, by class; sums that lose nothing (Neumaier)."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import classes
from vibroscreen.kernels.bed.held import held_by_node
from vibroscreen.kernels.numerics import vectors


@kernel
def book_masses(buffer):
    """Add the class masses of the step to the ledger: nothing is rounded away (Neumaier)."""
    for row in range(state.OVER + state.extent(buffer).decks):
        whole, rest = state.ledger(buffer, row, 0), state.ledger(buffer, row, 1)
        mass = state.class_mass(buffer, row)
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
    whole, total = state.ledger(buffer, row, 0), vectors.total(state.ledger(buffer, row, 1))
    for k in range(whole.size):
        total += whole[k]
    return total


@kernel
def balance_error(buffer):
    """Fed - discharged - held since the start, kg, class by class."""
    initial, held = state.initial_mass(buffer), state.held(buffer)
    fed, fed_rest = state.ledger(buffer, state.FED, 0), state.ledger(buffer, state.FED, 1)
    error = 0.0
    for k in range(held.size):
        left, rest = fed[k], fed_rest[k]
        for row in range(state.UNDER, state.OVER + state.extent(buffer).decks):
            left -= state.ledger(buffer, row, 0)[k]
            rest -= state.ledger(buffer, row, 1)[k]
        error += (left - held[k] + initial[k]) + rest
    return error


@kernel
def count_held(buffer):
    """What lies on all decks by class, into `held`, kg."""
    node = state.spare(buffer, 0)
    vectors.fill(node, 0.0)
    hold_up = state.hold_up_work(buffer)
    for deck in range(hold_up.size):
        hold_up[deck] = held_by_node(buffer, deck, node)
    classes.sum_nodes(buffer, node, state.held(buffer))
