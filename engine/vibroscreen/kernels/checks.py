"""What a screen is given is checked once, here: by configurations, sweeps, steps and FMUs.

The limits lie in the buffer beside what they limit; the field of each number says them
(../sections.py). A code of state.py tells what is wrong; the record `refusal` holds the rest.
"""

from math import inf, isfinite

from vibroscreen.compiler.language import kernel, view2
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.travel import deck_length, panel_count
from vibroscreen.kernels.physics import opening
from vibroscreen.kernels.physics.passage import BOUNCE
from vibroscreen.kernels.physics.segregation import CLASSIFIED, EXCHANGE

# Feed fractions sum to one within this; then they are normalised.
FRACTION_SUM = 1e-3
# Lengths of decks of one box differ by round-off only.
SAME_LENGTH = 1e-9
BED = 3  # the last displacement model that is built in
PASSAGE_LAW = state.PARAMETER.index("passage_law")
SEGREGATION_MODEL = state.PARAMETER.index("segregation_model")
DISPLACEMENT_MODEL = state.PARAMETER.index("displacement_model")
CONTACT_DEPTH = state.PARAMETER.index("bed_contact_depth")
LEAST_DEPTH = 1e-9  # m, of a layer
LENGTH, APERTURE = state.PANEL.index("length"), state.PANEL.index("aperture")
SLOT_LENGTH = state.PANEL.index("slot_length")


@kernel
def refuse(buffer, code, index, value, limit):
    """Say why a screen is refused; `index` is a place of the buffer."""
    refusal = state.refusal(buffer)
    refusal.code, refusal.index = code, index
    refusal.value, refusal.limit = value, limit
    return code


@kernel
def check(buffer):
    """Check all that a screen is given, before anything changes; ACCEPTED or a refusal."""
    code = check_values(buffer) or check_edges(buffer)
    return code or check_models(buffer) or check_decks(buffer)


@kernel
def check_values(buffer):
    """Check every parameter and input against its limits; fractions count while one is fed."""
    first = int(buffer[state.AT.parameter])
    fed = state.inputs(buffer).feed_mass_flow_rate > 0.0
    stop = int(buffer[state.AT.fraction])
    stop += state.extent(buffer).classes if fed else 0
    limit = view2(buffer, int(buffer[state.AT.limit]), stop - first, 2)
    for k in range(limit.shape[0]):
        value = buffer[first + k]
        if not isfinite(value):
            return refuse(buffer, state.REFUSED.not_finite, first + k, value, 0.0)
        if value < limit[k, 0]:
            return refuse(buffer, state.REFUSED.too_small, first + k, value, limit[k, 0])
        if value > limit[k, 1]:
            return refuse(buffer, state.REFUSED.too_large, first + k, value, limit[k, 1])
    return check_sum(buffer) if fed else state.ACCEPTED


@kernel
def check_sum(buffer):
    fraction = state.fraction(buffer)
    total = 0.0
    for k in range(fraction.size):
        total += max(0.0, fraction[k])
    if abs(total - 1.0) > FRACTION_SUM:
        place = int(buffer[state.AT.fraction])
        return refuse(buffer, state.REFUSED.bad_sum, place, total, FRACTION_SUM)
    return state.ACCEPTED


@kernel
def check_edges(buffer):
    """Check that size classes lie one above the other, without gaps."""
    lower, upper = state.lower(buffer), state.upper(buffer)
    for k in range(upper.size):
        place = int(buffer[state.AT.upper]) + k
        if k + 1 < upper.size and upper[k] != lower[k + 1]:
            return refuse(buffer, state.REFUSED.two_limits, place, upper[k], lower[k + 1])
        if upper[k] <= lower[k]:
            return refuse(buffer, state.REFUSED.not_ascending, place, upper[k], lower[k])
    return state.ACCEPTED


@kernel
def check_model(buffer, index, built_in, address):
    """Check the number of a sub-model: built in, or the user's own that is there."""
    place = int(buffer[state.AT.parameter]) + index
    number = buffer[place]
    own = buffer[int(buffer[state.AT.limit]) + 2 * index + 1]
    if number > built_in and (address <= 0 or number != own):
        return refuse(buffer, state.REFUSED.no_choice, place, number, built_in)
    return state.ACCEPTED


@kernel
def check_models(buffer):
    extent = state.extent(buffer)
    return (
        check_model(buffer, PASSAGE_LAW, BOUNCE, extent.passage_address)
        or check_model(buffer, DISPLACEMENT_MODEL, BED, extent.displacement_address)
        or check_model(buffer, SEGREGATION_MODEL, CLASSIFIED, extent.segregation_address)
    )


@kernel
def check_layers(buffer):
    """Check that there are layers if, and only if, the segregation uses them."""
    place = int(buffer[state.AT.parameter]) + SEGREGATION_MODEL
    number = buffer[place]
    if number <= CLASSIFIED and (state.extent(buffer).layered > 0) != (number == EXCHANGE):
        return refuse(buffer, state.REFUSED.no_choice, place, number, CLASSIFIED)
    return state.ACCEPTED


@kernel
def contact_depth(buffer, panel):
    """Depth of the contact layer on a panel, m."""
    parameter = state.parameters(buffer)
    return parameter.bed_contact_depth + parameter.bed_relative_contact_depth * panel.aperture


@kernel
def layer_depth(buffer, panel):
    """Depth of the layers above on a panel, m."""
    parameter = state.parameters(buffer)
    return parameter.bed_layer_depth + parameter.bed_relative_layer_depth * panel.aperture


@kernel
def check_opening(buffer, panel, place):
    """Check that slots are long and others have no length; place: of the aperture in the buffer."""
    length, beside = panel.slot_length, place + SLOT_LENGTH - APERTURE
    if panel.opening == opening.SLOT or panel.opening == opening.SLOT_ACROSS:
        if length < panel.aperture:
            return refuse(buffer, state.REFUSED.short_slot, beside, length, panel.aperture)
    elif length > 0.0:
        return refuse(buffer, state.REFUSED.no_slot, beside, length, 0.0)
    return state.ACCEPTED


@kernel
def check_decks(buffer):
    """Check that decks are equally long, and what they are made of; never coarser below."""
    first, above = deck_length(buffer, 0), inf
    for deck in range(state.extent(buffer).decks):
        length = deck_length(buffer, deck)
        coarsest = 0.0
        for number in range(panel_count(buffer, deck)):
            panel = state.panel(buffer, deck, number)
            place = state.panel_place(buffer, deck, number) + APERTURE
            if panel.aperture > length:
                return refuse(buffer, state.REFUSED.short_deck, place, panel.aperture, length)
            code = check_opening(buffer, panel, place)
            if code != state.ACCEPTED:
                return code
            if panel.aperture > above and panel.open_area > 0.0:
                return refuse(buffer, state.REFUSED.coarser_below, place, panel.aperture, above)
            if min(contact_depth(buffer, panel), layer_depth(buffer, panel)) < LEAST_DEPTH:
                place = int(buffer[state.AT.parameter]) + CONTACT_DEPTH
                return refuse(buffer, state.REFUSED.no_layer, place, buffer[place], LEAST_DEPTH)
            coarsest = max(coarsest, panel.aperture)
        above = coarsest
        if abs(length - first) > SAME_LENGTH * max(length, first):
            place = state.panel_place(buffer, deck, 0) + LENGTH
            return refuse(buffer, state.REFUSED.unequal_decks, place, length, first)
    return state.ACCEPTED
