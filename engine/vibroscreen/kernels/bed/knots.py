"""What falls from one deck to the next, by place (MODEL.md, "Several decks").

Two ways, both conservative:
  of a steady deck, knots: what has passed up to a place [kg/s] and the rates there; between them a
      monotone cubic. The leading slice below takes from it what lands on it at any moment.
  of packages with a history, records: what fell, and from where to where. It is laid on the
      packages below that are under it in the middle of the step.
"""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.travel import deck_length, panel_velocity
from vibroscreen.kernels.numerics import vectors

# Two knots nearer than this part of the deck's length are one.
SAME_PLACE = 1e-12


@kernel
def record_knot(buffer, place):
    """Add a knot of the deck that is recorded, from the rows passed and passing of `record`."""
    deck = state.work(buffer).recorded - 1
    book, places = state.book(buffer, deck), state.knot_place(buffer, deck)
    count = book.knots
    again = count > 0 and place - places[count - 1] <= SAME_PLACE * deck_length(buffer, deck)
    if not again and count == state.extent(buffer).knots:
        thin_knots(buffer, deck)
        count = book.knots
    knot = count - 1 if again else count
    width = state.width(buffer)[deck]
    first = width * panel_velocity(buffer, deck, 0)
    here = width * panel_velocity(buffer, deck, book.lead_panel)
    before_passed = state.lead_passed(buffer, deck)
    passed, passing = state.recorded(buffer, 0), state.recorded(buffer, 1)
    total = state.knot_passed(buffer, deck, knot)
    before, after = state.knot_before(buffer, deck, knot), state.knot_after(buffer, deck, knot)
    for i in range(passed.size):
        after[i] = width * passing[i]
        if not again:
            before[i] = after[i]
        if not again or knot > 0:
            # Also what has just passed at once, as sizes that are used up do.
            total[i] = first * before_passed[i] + here * passed[i]
    if not again:
        places[knot] = place
        book.knots = count + 1.0


@kernel
def thin_knots(buffer, deck):
    """Make room: every second knot inside goes; sums stay, as they are sums up to a place."""
    book, places = state.book(buffer, deck), state.knot_place(buffer, deck)
    count, kept = book.knots, 0
    for row in range(count):
        if row % 2 == 1 and row < count - 1:
            continue
        if kept != row:
            places[kept] = places[row]
            vectors.copy(
                state.knot_passed(buffer, deck, kept), state.knot_passed(buffer, deck, row)
            )
            vectors.copy(
                state.knot_before(buffer, deck, kept), state.knot_before(buffer, deck, row)
            )
            vectors.copy(state.knot_after(buffer, deck, kept), state.knot_after(buffer, deck, row))
        kept += 1
    book.knots = kept


@kernel
def between_knots(buffer, deck, knot):
    """What has passed up to a knot and to the next one, and the rates at both, in between."""
    start, stop = state.knot_passed(buffer, deck, knot), state.knot_passed(buffer, deck, knot + 1)
    after, before = state.knot_after(buffer, deck, knot), state.knot_before(buffer, deck, knot + 1)
    return start, stop, after, before


@kernel
def end_rates(total, rate_start, rate_end, width):
    """Rates at both ends of an interval, held within what keeps the cubic monotone."""
    most = 3.0 * max(0.0, total) / width
    return min(max(rate_start, 0.0), most), min(max(rate_end, 0.0), most)


@kernel
def lead_source(buffer, deck, place, velocity):
    """Set what lands on the leading slice from `place` on; how long it holds, s, and its terms.

    The coefficients in time of the cubic's derivative, per area of this deck, kg/(m2 s).
    """
    above = deck - 1
    upper, book = state.book(buffer, above), state.book(buffer, deck)
    places = state.knot_place(buffer, above)
    count = upper.knots
    slack = SAME_PLACE * deck_length(buffer, deck)
    if count < 2 or place >= places[count - 1] - slack:
        return 1e300, 0.0
    knot = min(book.knot, count - 2)
    while knot > 0 and places[knot] > place + slack:
        knot -= 1
    while knot + 2 < count and places[knot + 1] <= place + slack:
        knot += 1
    book.knot = knot
    width = places[knot + 1] - places[knot]
    x, rise = (place - places[knot]) / width, velocity / width
    start, stop, after, before = between_knots(buffer, above, knot)
    per_area = 1.0 / state.width(buffer)[deck]
    source, terms = state.source(buffer), 0.0
    for i in range(start.size):
        total = stop[i] - start[i]
        one, two = end_rates(total, after[i], before[i], width)
        mean = total / width
        # rate(x) = one + x (6 mean - 4 one - 2 two) + 3 x^2 (one + two - 2 mean)
        linear = 6.0 * mean - 4.0 * one - 2.0 * two
        square = 3.0 * (one + two - 2.0 * mean)
        source[0, i] = per_area * (one + x * (linear + x * square))
        source[1, i] = per_area * rise * (linear + 2.0 * x * square)
        source[2, i] = per_area * rise * rise * square
        terms = 3.0 if total > 0.0 else terms
    return max(slack, places[knot + 1] - place) / velocity, terms


@kernel
def passed_up_to(buffer, deck, place, passed):
    """What passes a steady deck up to a place [m], into `passed[node]`, kg/s."""
    book, places = state.book(buffer, deck), state.knot_place(buffer, deck)
    count = book.knots
    vectors.fill(passed, 0.0)
    if count == 0:
        return
    knot = 0
    while knot + 2 < count and places[knot + 1] < place:
        knot += 1
    if count == 1 or place <= places[knot]:
        vectors.copy(passed, state.knot_passed(buffer, deck, knot))
        return
    start, stop, after, before = between_knots(buffer, deck, knot)
    width = places[knot + 1] - places[knot]
    x = min(1.0, (place - places[knot]) / width)
    for i in range(passed.size):
        total = stop[i] - start[i]
        one, two = end_rates(total, after[i], before[i], width)
        one, two = one * width, two * width
        share = x * (one + x * (3.0 * total - 2.0 * one - two + x * (one + two - 2.0 * total)))
        passed[i] = start[i] + share
