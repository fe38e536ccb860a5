"""All decks over one communication step, top deck first (MODEL.md, "Several decks").

The top deck moves in pieces that depend on nothing below it, so that its streams do not depend on
what is below. A deck below moves in parts of a piece, under what fell from the deck above.
"""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import falls, front, package, ride, travel
from vibroscreen.kernels.bed.deck import advance_queue, advance_top, extend_tail
from vibroscreen.kernels.numerics import vectors

# Pieces of a communication step of the top deck, for one residence time.
PIECES = 16
# A deck that stands still: shortest piece, s, and the most of them in a step.
STILL_PIECE, STILL_PIECES = 1.0, 64


@kernel
def covered(buffer, deck):
    """Whether the deck is steady: its cohort covers it."""
    return state.book(buffer, deck).covered == 1.0


@kernel
def all_covered(buffer):
    for deck in range(state.extent(buffer).decks):
        if not covered(buffer, deck):
            return False
    return True


@kernel
def piece_of(buffer, left, duration):
    """Length of the next piece of the top deck, s."""
    if covered(buffer, 0):
        return left
    if travel.conveys(buffer, 0):
        # Even pieces, and none for a step that is hardly longer than one.
        piece = left
        if state.extent(buffer).decks > 1:  # what falls is laid piece by piece
            parts = int(PIECES * left / travel.residence_time(buffer, 0) + 0.5)
            piece = left / max(1, parts)
        until = front.time_to_cover(buffer, 0)
        return min(piece, until) if until > 0.0 else piece
    if state.scene(buffer, 0, 0).passage_velocity == 0.0:
        return left
    return min(left, max(STILL_PIECE, duration / STILL_PIECES))


@kernel
def advance_decks(buffer, duration):
    """Advance all decks; the masses of the step lie in `step_mass` after it."""
    left = duration
    while left > 0.0:
        piece = piece_of(buffer, left, duration)
        falls.clear_falls(buffer, 0)
        if covered(buffer, 0):
            front.stream_of_covered_deck(buffer, 0, piece)
        else:
            piece = advance_top(buffer, piece)
        if state.extent(buffer).decks > 1 and piece > 0.0:
            advance_below(buffer, piece)
        left = 0.0 if piece == left else left - piece


@kernel
def part_of(buffer, left):
    """Length of the next part of a piece for the decks below the top one, s."""
    part = left
    for deck in range(1, state.extent(buffer).decks):
        if covered(buffer, deck) or not travel.conveys(buffer, deck):
            continue
        part = min(part, travel.residence_time(buffer, deck) / state.extent(buffer).cells)
        if state.book(buffer, deck).cohort_on > 0.0:
            part = min(part, front.time_to_cover(buffer, deck))
    return part


@kernel
def advance_below(buffer, piece):
    """Advance the decks below the top one by a piece under what fell from the top one."""
    left = piece
    while left > 0.0:
        start_cohorts_below(buffer)
        part = part_of(buffer, left)
        for deck in range(1, state.extent(buffer).decks):
            # The records of the top deck are those of the whole piece.
            whole = piece if deck == 1 else part
            moment = piece - left + 0.5 * part if deck == 1 else 0.5 * part
            falls.clear_falls(buffer, deck)
            advance_under(buffer, deck, part, part / whole, moment, whole)
        left = 0.0 if part == left else left - part


@kernel
def start_cohorts_below(buffer):
    """Begin a cohort on every deck on which what falls has become steady."""
    for deck in range(1, state.extent(buffer).decks):
        book = state.book(buffer, deck)
        steady = covered(buffer, deck - 1)
        if deck == 1:
            # What fell in a piece in which the top deck became steady is still to be laid.
            steady = falls.fell_steadily(buffer, 0)
        if steady and travel.conveys(buffer, deck) and book.cohort_on == 0.0:
            front.start_cohort(buffer, deck, state.book(buffer, 0).cohort_fed)


@kernel
def advance_under(buffer, deck, duration, share, moment, whole):
    """Advance a deck by `duration` s under a share of what fell from the one above in `whole` s."""
    book = state.book(buffer, deck)
    if covered(buffer, deck):
        front.stream_of_covered_deck(buffer, deck, duration)
        return
    if book.cohort_on > 0.0:
        front.grow_cohort(buffer, deck, duration)
    elif travel.conveys(buffer, deck):
        extend_tail(buffer, deck, duration)
    count = book.packages
    place_packages(buffer, deck, duration)
    for row in range(count):
        vectors.fill(state.landing(buffer, row), 0.0)
    falls.lay_records(buffer, deck, count, share, moment)
    falls.lay_cohort(buffer, deck, count, share, whole - moment)
    advance_queue(buffer, deck, duration)
    if covered(buffer, deck):
        pay_rest(buffer, deck)


@kernel
def place_packages(buffer, deck, duration):
    """Where the packages of a deck are in the middle of a step, m, within the deck."""
    start, stop = state.landing_start(buffer), state.landing_stop(buffer)
    length = travel.deck_length(buffer, deck)
    rear = ride.queue_rear(buffer, deck)
    if travel.conveys(buffer, deck):
        rear -= 0.5 * duration
    for row in range(state.book(buffer, deck).packages - 1, -1, -1):
        ahead = rear + package.span_of(buffer, deck, package.slot_at(buffer, deck, row))
        start[row] = min(length, max(0.0, travel.place_after(buffer, deck, rear)))
        stop[row] = min(length, max(0.0, travel.place_after(buffer, deck, ahead)))
        rear = ahead


@kernel
def pay_rest(buffer, deck):
    """Book what round-off left between a cohort and the packages before it, once it covers.

    A debt that the oversize cannot bear stays until something falls on packages again.
    """
    carry, oversize = state.carry(buffer, deck), falls.oversize(buffer, deck)
    for i in range(carry.size):
        paid = max(carry[i], -oversize[i])
        oversize[i] += paid
        carry[i] -= paid
