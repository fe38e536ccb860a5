"""One slice followed from the feed to the discharge of every deck, or kept on a plate.

No packages are needed: a slice of a lower deck starts empty and takes up what falls on it, read
from the knots of the deck above (MODEL.md, "Steady state and batches").
"""

from math import nan

from vibroscreen.compiler.language import kernel, numbers, record
from vibroscreen.kernels import changes, checks, outputs, scene, state, step
from vibroscreen.kernels.bed import classes, falls, front, travel
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.numerics.layers import bed_load
from vibroscreen.kernels.physics import opening

FEED_RATE = state.INPUT.index("feed_mass_flow_rate")


@kernel
def start_slice(buffer, deck):
    """Put a slice at the feed end of a deck: on the top one what is fed, on a lower one nothing."""
    front.start_cohort(buffer, deck, max(0.0, state.inputs(buffer).feed_mass_flow_rate))
    vectors.fill(state.carry(buffer, deck), 0.0)
    vectors.fill(state.fall_cohort(buffer, deck), 0.0)
    falls.clear_streams(buffer, deck)


@kernel
def sort_in(ascending, count, value):
    """Put a value among the first `count` of a row, unless it is there; returns how many then."""
    place = count
    while place > 0 and ascending[place - 1] > value:
        place -= 1
    if place > 0 and ascending[place - 1] == value:
        return count
    for k in range(count, place, -1):
        ascending[k] = ascending[k - 1]
    ascending[place] = value
    return count + 1


@kernel
def place_nodes(buffer):
    """Write the nodes of the screen in the buffer, and how many there are."""
    extent, parameter = state.extent(buffer), state.parameters(buffer)
    strength = state.strength(buffer)
    panels = extent.decks * extent.panels
    kinks = state.vector(buffer, state.AT.kinks, 2 * panels, 0)
    count = 0
    area, reach = 0.0, 0.0
    for deck in range(extent.decks):
        open_length = 0.0
        for number in range(travel.panel_count(buffer, deck)):
            panel = state.panel(buffer, deck, number)
            open_length += panel.length * panel.open_area
            count = sort_in(kinks, count, panel.aperture)
            closing = opening.closing_size(panel, parameter)
            if closing > 0.0:
                count = sort_in(kinks, count, closing)
        reach = max(reach, open_length)
        area = max(area, open_length * state.width(buffer)[deck])
    feed = state.inputs(buffer).feed_mass_flow_rate
    exposure = area / feed if feed > 0.0 else 0.0
    classes.set_strength(parameter, kinks[:count], exposure, reach, strength)
    room = classes.most_nodes(extent.classes, 2 * panels, parameter.size_classes_subdivision)
    edge, size = state.edge(buffer), state.vector(buffer, state.AT.size, room, 0)
    of_class = state.vector(buffer, state.AT.node_class, room, 0)
    position = state.vector(buffer, state.AT.node_position, room, 0)
    weight = state.vector(buffer, state.AT.node_weight, room, 0)
    said, used = numbers(parameter), kinks[:count]
    extent.nodes = classes.build_nodes(edge, used, said, strength, size, of_class, position, weight)


@kernel
def prepare_slice(buffer):
    """Check the inputs in the buffer and start a slice on the top deck; ACCEPTED or not."""
    return changes.check_given(buffer) or begin_slice(buffer)


@kernel
def begin_slice(buffer):
    """Take inputs that were checked into use and start a slice on the top deck; ACCEPTED or not."""
    code = changes.follow_given(buffer, False)
    if code == state.ACCEPTED:
        for deck in range(state.extent(buffer).decks):
            horizon = travel.residence_time(buffer, deck)
            for panel in range(travel.panel_count(buffer, deck)):
                state.scene(buffer, deck, panel).horizon = horizon
        start_slice(buffer, 0)
    return code


@kernel
def follow(buffer, deck, duration):
    """Let the slice of a deck ride on for `duration` s, over the ends of panels."""
    book = state.book(buffer, deck)
    left = duration
    while left > 0.0:
        panel = book.lead_panel
        until = travel.time_to_next(buffer, deck, panel, book.cohort_front)
        crosses, step = until <= left, max(0.0, min(until, left))
        if step > 0.0:
            front.advance_lead(buffer, deck, step)
        book.cohort_front += step
        left -= step
        if crosses:
            book.cohort_front = travel.panel_end_time(buffer, deck, panel)
            front.cross_lead(buffer, deck)


@kernel
def lay_batch(buffer, areal_mass, horizon):
    """Put a batch of `areal_mass` kg/m2 of the feed's composition on the plate."""
    state.scene(buffer, 0, 0).horizon = horizon
    front.lay_lead(buffer, 0, areal_mass)


@kernel
def solve_steady(buffer):
    """Steady state under the inputs in the buffer; ACCEPTED or why there is none.

    Afterwards `step_mass` and `class_mass` hold the streams [kg/s] by node and class, `recovery`
    the part of each class that reaches the undersize, 0 for one that is not fed, `hold_up_work`
    what lies on every deck [kg], and all outputs are those of a steady step.
    """
    return changes.check_given(buffer) or solve_checked(buffer)


@kernel
def solve_checked(buffer):
    """The same under inputs and parameters that were checked."""
    place = int(buffer[state.AT.input])
    if state.inputs(buffer).feed_mass_flow_rate <= 0.0:
        return checks.refuse(buffer, state.REFUSED.no_feed, place + FEED_RATE, 0.0, 0.0)
    code = begin_slice(buffer)
    if code != state.ACCEPTED:
        return code
    for deck in range(state.extent(buffer).decks):
        if not travel.conveys(buffer, deck):
            return scene.refuse_still(buffer)
    solve_decks(buffer)
    step.sum_streams(buffer, 1.0)
    write_outputs(buffer)
    write_class_recovery(buffer)
    return state.ACCEPTED


@kernel
def write_outputs(buffer):
    """Outputs of the steady state: those of a step of 1 s; nan for what there is nothing of."""
    decks = state.extent(buffer).decks
    vectors.fill(numbers(state.outputs(buffer)), nan)
    for deck in range(decks):
        vectors.fill(numbers(state.deck_result(buffer, deck)), nan)
        if deck > 0:
            vectors.fill(numbers(state.intermediate(buffer, deck - 1)), nan)
        state.book(buffer, deck).covered = 1.0  # the slice is at the discharge
    outputs.write_streams(buffer, 1.0)
    outputs.write_state(buffer, vectors.total(state.hold_up_work(buffer)))
    outputs.read_sizes(buffer)
    for deck in range(decks):
        state.book(buffer, deck).covered = 0.0


@kernel
def write_class_recovery(buffer):
    """Part of each class that reaches the undersize, from the streams by class."""
    recovery = state.recovery(buffer)
    vectors.fill(recovery, 0.0)
    for row in range(state.UNDER, state.OVER + state.extent(buffer).decks):
        vectors.add(recovery, 1.0, state.class_mass(buffer, row))
    under = state.class_mass(buffer, state.UNDER)
    for k in range(recovery.size):
        recovery[k] = under[k] / recovery[k] if recovery[k] > 0.0 else 0.0


@kernel
def solve_many(buffer, count, rebuild):
    """Steady states of the first `count` rows of `design`, into `design_result`.

    rebuild: whether what changes from row to row needs other nodes.
    """
    # Parameters and inputs lie in a row.
    size = int(buffer[state.AT.output]) - int(buffer[state.AT.parameter])
    setting = state.vector(buffer, state.AT.parameter, size, 0)
    harmonic = state.vector(buffer, state.AT.harmonic, state.MAX_HARMONICS * 5, 0)
    extent = state.extent(buffer)
    row_size = 0
    for width in state.result_widths(extent.decks, extent.classes):
        row_size += width
    for row in range(count):
        vectors.copy(setting, state.vector(buffer, state.AT.design, size, row))
        vectors.copy(harmonic, state.design_harmonic(buffer, row))
        code = changes.check_given(buffer)
        if code == state.ACCEPTED and rebuild > 0.0:
            place_nodes(buffer)
            _, seen = changes.seen(buffer)
            seen[changes.motion_part(buffer)] = -1.0  # the feed is spread over other nodes
        if code == state.ACCEPTED:
            code = solve_checked(buffer)
        result = state.vector(buffer, state.AT.design_result, row_size, row)
        vectors.fill(result, 0.0)
        if code != state.ACCEPTED:
            vectors.copy(result[: len(state.REFUSAL)], numbers(state.refusal(buffer)))
        else:
            figure = record(result, 0, state.FIGURE)
            figure.residence_time = travel.residence_time(buffer, 0)
            write_result(buffer, result)


@kernel
def write_result(buffer, result):
    """A row of many steady solutions behind its FIGURE: outputs, alarms, streams."""
    extent = state.extent(buffer)
    widths = state.result_widths(extent.decks, extent.classes)
    place = widths[0]
    for at, size in (
        (state.AT.output, widths[1]),
        (state.AT.deck_result, widths[2]),
        (state.AT.intermediate, widths[3]),
        (state.AT.alarm, widths[4]),
        (state.AT.class_mass, widths[5]),
    ):
        place = changes.put(result, place, state.vector(buffer, at, size, 0))


@kernel
def lay_first_cell(buffer, deck):
    """Find what lies on the first cell of a lower deck, which a step calls its feed end."""
    start_slice(buffer, deck)
    follow(buffer, deck, travel.cell_end(buffer, deck, 0))
    book = state.book(buffer, deck)
    laid = bed_load(state.partial(buffer, deck), book.partial_layers)
    book.first_load = laid / travel.cell_length(buffer, deck, 0)


@kernel
def solve_decks(buffer):
    """Follow the slices of all decks to the discharge; the top one's is at the feed end."""
    decks, hold_up = state.extent(buffer).decks, state.hold_up_work(buffer)
    for deck in range(decks):
        if deck > 0:
            lay_first_cell(buffer, deck)
            start_slice(buffer, deck)
        if travel.conveys(buffer, deck):
            follow(buffer, deck, travel.residence_time(buffer, deck))
        book, width = state.book(buffer, deck), state.width(buffer)[deck]
        vectors.fill(falls.undersize(buffer, deck), 0.0)
        front.stream_of_covered_deck(buffer, deck, 1.0)
        hold_up[deck] = width * bed_load(state.partial(buffer, deck), book.partial_layers)
