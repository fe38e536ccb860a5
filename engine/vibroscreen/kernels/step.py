"""One communication step: check, displacement, feed, deck, ledger, outputs (MODEL.md, "A step").

`advance` and `initialise` give a code of state.py; anything but ACCEPTED means that nothing was
changed and that the record `refusal` says what was wrong. Python enters by kernels/entry.py.
"""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.cascade import advance_decks, all_covered
from vibroscreen.kernels.bed.classes import merge_classes
from vibroscreen.kernels.bed.deck import clear_deck
from vibroscreen.kernels.bed.travel import panel_count, residence_time
from vibroscreen.kernels.changes import prepare
from vibroscreen.kernels.ledger import balance_error, book_masses, count_held
from vibroscreen.kernels.outputs import held_in_total, write_state, write_streams, write_sums

STEADY_START = 2  # bed.initial
# Residence times in which a deck is surely full of the duty.
FILLING = 1.01


@kernel
def fed_masses(buffer, row, duration):
    """Class masses fed in the step, kg."""
    rate = max(0.0, state.inputs(buffer).feed_mass_flow_rate)
    mass = state.class_vector(buffer, state.AT.class_mass, row)
    merge_classes(
        state.node_vector(buffer, state.AT.feed_fraction, 0),
        state.node_vector(buffer, state.AT.node_class, 0),
        mass,
    )
    for k in range(mass.size):
        mass[k] *= rate * duration


@kernel
def steady_step(buffer, duration):
    """A step in a steady scene: all rates are known, only the sums grow."""
    for row in range(state.OVER + state.extent(buffer).decks):
        rate = state.class_vector(buffer, state.AT.steady_rate, row)
        mass = state.class_vector(buffer, state.AT.class_mass, row)
        for k in range(rate.size):
            mass[k] = rate[k] * duration
    book_masses(buffer)
    write_sums(buffer)
    state.outputs(buffer).balance_error = balance_error(buffer)
    state.counters(buffer).steady_steps += 1.0


@kernel
def move(buffer, duration):
    """Advance the decks; the masses of the step lie in step_mass and class_mass after it."""
    decks = state.extent(buffer).decks
    for row in range(2 * decks):
        mass = state.node_vector(buffer, state.AT.step_mass, row)
        for i in range(mass.size):
            mass[i] = 0.0
    for deck in range(decks):
        state.book(buffer, deck).capacity_alarm = 0.0
    advance_decks(buffer, duration)
    sum_streams(buffer, duration)


@kernel
def sum_streams(buffer, duration):
    """Sum the masses of the step over the classes: what was fed, the undersize, each oversize."""
    decks = state.extent(buffer).decks
    fed_masses(buffer, state.FED, duration)
    classes = state.node_vector(buffer, state.AT.node_class, 0)
    # What passes the lowest deck, and what leaves over each.
    for row in range(decks + 1):
        mass = state.node_vector(buffer, state.AT.step_mass, decks - 1 + row)
        merge_classes(
            mass, classes, state.class_vector(buffer, state.AT.class_mass, state.UNDER + row)
        )


@kernel
def at_rest(buffer):
    """Whether nothing vibrates and nothing is fed: nothing can change."""
    alive = max(0.0, state.inputs(buffer).feed_mass_flow_rate)
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            scene = state.scene(buffer, state.AT.scene, deck, number)
            alive += scene.passage_velocity + scene.segregation_velocity
            alive += scene.mixing
            alive += scene.transport_velocity
    return alive == 0.0


@kernel
def advance(buffer, duration):
    """Advance the screen by `duration` s > 0 with the inputs in the buffer."""
    code = prepare(buffer, False)
    if code != state.ACCEPTED:
        return code
    memory = state.memory(buffer)
    state.counters(buffer).steps += 1.0
    if memory.settled == 1.0 and state.switches(buffer).steady_scene > 0.0:
        steady_step(buffer, duration)
        return state.ACCEPTED
    settled = all_covered(buffer) or at_rest(buffer)
    move(buffer, duration)
    book_masses(buffer)
    count_held(buffer)
    write_streams(buffer, duration)
    write_sums(buffer)
    write_state(buffer, held_in_total(buffer))
    if settled and state.switches(buffer).steady_scene > 0.0:
        memory.settled = 1.0
        for row in range(state.OVER + state.extent(buffer).decks):
            rate = state.class_vector(buffer, state.AT.steady_rate, row)
            mass = state.class_vector(buffer, state.AT.class_mass, row)
            for k in range(rate.size):
                rate[k] = mass[k] / duration
    return state.ACCEPTED


@kernel
def initialise(buffer):
    """Start: empty decks, or full of the duty in the inputs where bed.initial is steady."""
    for deck in range(state.extent(buffer).decks):
        clear_deck(buffer, deck)
    code = prepare(buffer, True)
    if code != state.ACCEPTED:
        return code
    fraction = state.class_vector(buffer, state.AT.fraction, 0)
    for at in (state.AT.undersize_fraction, state.AT.oversize_fraction):
        stream = state.class_vector(buffer, at, 0)
        for k in range(stream.size):
            stream[k] = fraction[k]
    for between in range(state.extent(buffer).decks - 1):
        stream = state.class_vector(buffer, state.AT.intermediate_fraction, between)
        for k in range(stream.size):
            stream[k] = fraction[k]
    filling = 0.0
    for deck in range(state.extent(buffer).decks):
        filling += residence_time(buffer, deck)
    full = state.parameters(buffer).bed_initial == STEADY_START
    if full and residence_time(buffer, 0) > 0.0:
        move(buffer, FILLING * filling)
        move(buffer, 1.0)
    count_held(buffer)
    if full and residence_time(buffer, 0) > 0.0:
        held = state.class_vector(buffer, state.AT.held, 0)
        initial = state.class_vector(buffer, state.AT.initial_mass, 0)
        for k in range(held.size):
            initial[k] = held[k]
        write_streams(buffer, 1.0)
    write_state(buffer, held_in_total(buffer))
    return state.ACCEPTED
