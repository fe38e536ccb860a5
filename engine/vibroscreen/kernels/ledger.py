"""The ledger: what was fed, left and is held, by class; sums that lose nothing (Neumaier)."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.classes import merge_classes
from vibroscreen.kernels.bed.held import held_by_node


@kernel
def add_compensated(ledger_sum, ledger_rest, mass):
    """Add `mass` to sums with their compensation (Neumaier): nothing is rounded away."""
    for k in range(mass.size):
        total = ledger_sum[k] + mass[k]
        if abs(ledger_sum[k]) >= abs(mass[k]):
            ledger_rest[k] += (ledger_sum[k] - total) + mass[k]
        else:
            ledger_rest[k] += (mass[k] - total) + ledger_sum[k]
        ledger_sum[k] = total


@kernel
def book_masses(buffer):
    """Add the class masses of the step (rows fed, undersize, oversize) to the ledger."""
    for row in range(state.OVER + state.extent(buffer).decks):
        add_compensated(
            state.class_vector(buffer, state.AT.ledger, 2 * row),
            state.class_vector(buffer, state.AT.ledger, 2 * row + 1),
            state.class_vector(buffer, state.AT.class_mass, row),
        )


@kernel
def ledger_total(buffer, row):
    """Cumulative mass of all classes of a stream, kg."""
    total = 0.0
    whole = state.class_vector(buffer, state.AT.ledger, 2 * row)
    rest = state.class_vector(buffer, state.AT.ledger, 2 * row + 1)
    for k in range(whole.size):
        total += rest[k]
    for k in range(whole.size):
        total += whole[k]
    return total


@kernel
def balance_error(buffer):
    """Fed - discharged - held since the start, kg, class by class."""
    initial = state.class_vector(buffer, state.AT.initial_mass, 0)
    held = state.class_vector(buffer, state.AT.held, 0)
    error = 0.0
    for k in range(held.size):
        open_sum = state.class_vector(buffer, state.AT.ledger, 2 * state.FED)[k]
        rest = state.class_vector(buffer, state.AT.ledger, 2 * state.FED + 1)[k]
        for row in range(state.UNDER, state.OVER + state.extent(buffer).decks):
            open_sum -= state.class_vector(buffer, state.AT.ledger, 2 * row)[k]
            rest -= state.class_vector(buffer, state.AT.ledger, 2 * row + 1)[k]
        error += (open_sum - held[k] + initial[k]) + rest
    return error


@kernel
def count_held(buffer):
    """What lies on all decks by class, into `held`, kg."""
    node = state.node_vector(buffer, state.AT.node_work, 0)
    for i in range(node.size):
        node[i] = 0.0
    hold_up = state.scalars(buffer, state.AT.hold_up_work, state.extent(buffer).decks)
    for deck in range(state.extent(buffer).decks):
        hold_up[deck] = held_by_node(buffer, deck, node)
    merge_classes(
        node,
        state.node_vector(buffer, state.AT.node_class, 0),
        state.class_vector(buffer, state.AT.held, 0),
    )
