"""One communication step: check, displacement, feed, deck, ledger, outputs (MODEL.md, "A step").

`advance` and `initialise` give a code of state.py; anything but ACCEPTED means that nothing was
changed and that the record `refusal` says what was wrong. Python enters by kernels/entry.py.
"""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import outputs, state
from vibroscreen.kernels.bed import cascade, classes, falls, travel
from vibroscreen.kernels.bed.deck import clear_deck
from vibroscreen.kernels.changes import prepare
from vibroscreen.kernels.ledger import balance_error, book_masses, count_held
from vibroscreen.kernels.numerics import vectors

STEADY_START = 2  # bed.initial
# Residence times in which a deck is surely full of the duty.
FILLING = 1.01


@kernel
def steady_step(buffer, duration):
    """A step in a steady scene: all rates are known, only the sums grow."""
    for row in range(state.OVER + state.extent(buffer).decks):
        vectors.multiple(state.class_mass(buffer, row), duration, state.steady_rate(buffer, row))
    book_masses(buffer)
    outputs.write_sums(buffer)
    state.outputs(buffer).balance_error = balance_error(buffer)
    state.counters(buffer).steady_steps += 1.0


@kernel
def move(buffer, duration):
    """Advance the decks; the masses of the step lie in step_mass and class_mass after it."""
    for deck in range(state.extent(buffer).decks):
        falls.clear_streams(buffer, deck)
    cascade.advance_decks(buffer, duration)
    sum_streams(buffer, duration)


@kernel
def sum_streams(buffer, duration):
    """Sum the masses of the step over the classes: what was fed, the undersize, each oversize."""
    decks = state.extent(buffer).decks
    rate = max(0.0, state.inputs(buffer).feed_mass_flow_rate)
    fed = state.class_mass(buffer, state.FED)
    classes.sum_nodes(buffer, state.feed_fraction(buffer), fed)
    vectors.multiple(fed, rate * duration, fed)
    under = state.class_mass(buffer, state.UNDER)
    classes.sum_nodes(buffer, falls.undersize(buffer, decks - 1), under)
    for deck in range(decks):
        over = state.class_mass(buffer, state.OVER + deck)
        classes.sum_nodes(buffer, falls.oversize(buffer, deck), over)


@kernel
def at_rest(buffer):
    """Whether nothing vibrates and nothing is fed: nothing can change."""
    alive = max(0.0, state.inputs(buffer).feed_mass_flow_rate)
    for deck in range(state.extent(buffer).decks):
        for number in range(travel.panel_count(buffer, deck)):
            scene = state.scene(buffer, deck, number)
            alive += scene.passage_velocity + scene.segregation_velocity
            alive += scene.mixing + scene.transport_velocity
    return alive == 0.0


@kernel
def advance(buffer, duration):
    """Advance the screen by `duration` s > 0 with the inputs in the buffer."""
    code = prepare(buffer, False)
    if code != state.ACCEPTED:
        return code
    memory = state.memory(buffer)
    state.counters(buffer).steps += 1.0
    steady_scene = state.switches(buffer).steady_scene > 0.0
    if memory.settled == 1.0 and steady_scene:
        steady_step(buffer, duration)
        return state.ACCEPTED
    settled = cascade.all_covered(buffer) or at_rest(buffer)
    move(buffer, duration)
    book_masses(buffer)
    count_held(buffer)
    outputs.write_streams(buffer, duration)
    outputs.write_sums(buffer)
    outputs.write_state(buffer, vectors.total(state.held(buffer)))
    if settled and steady_scene:
        memory.settled = 1.0
        for row in range(state.OVER + state.extent(buffer).decks):
            vectors.ratio(state.steady_rate(buffer, row), state.class_mass(buffer, row), duration)
    return state.ACCEPTED


@kernel
def initialise(buffer):
    """Start: empty decks, or full of the duty in the inputs where bed.initial is steady."""
    decks = state.extent(buffer).decks
    for deck in range(decks):
        clear_deck(buffer, deck)
    code = prepare(buffer, True)
    if code != state.ACCEPTED:
        return code
    fraction = state.fraction(buffer)
    vectors.copy(state.undersize_fraction(buffer), fraction)
    vectors.copy(state.oversize_fraction(buffer), fraction)
    filling = travel.residence_time(buffer, 0)
    for deck in range(1, decks):
        vectors.copy(state.intermediate_fraction(buffer, deck - 1), fraction)
        filling += travel.residence_time(buffer, deck)
    full = state.parameters(buffer).bed_initial == STEADY_START and travel.conveys(buffer, 0)
    if full:
        move(buffer, FILLING * filling)
        move(buffer, 1.0)
    count_held(buffer)
    if full:
        vectors.copy(state.initial_mass(buffer), state.held(buffer))
        outputs.write_streams(buffer, 1.0)
    outputs.write_state(buffer, vectors.total(state.held(buffer)))
    return state.ACCEPTED
