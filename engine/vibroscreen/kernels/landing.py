"""What falls from one deck to the next, by place (MODEL.md, "Several decks").

Two ways, both conservative:
  of a steady deck, knots: what has passed up to a place [kg/s] and the rates there; between them a
      monotone cubic. The leading slice below takes from it what lands on it at any moment.
  of packages with a history, records: what fell, and from where to where. It is laid on the
      packages below that are under it in the middle of the step.
"""

from __future__ import annotations

from vibroscreen.kernels import state
from vibroscreen.kernels.language import kernel
from vibroscreen.kernels.place import (
    cell_length,
    conveys,
    deck_length,
    deck_width,
    panel_velocity,
    place_after,
)

# Two knots nearer than this part of the deck's length are one.
SAME_PLACE = 1e-12


# --- along a steady deck -------------------------------------------------------------------------
@kernel
def knot_vector(buffer, at, deck, knot):
    """What a field holds of a knot, by node."""
    return state.node_vector(buffer, at, deck * state.extent(buffer).knots + knot)


@kernel
def knot_places(buffer, deck):
    """Places of the knots of a deck, m."""
    return state.vector(buffer, state.AT.knot_place, state.extent(buffer).knots, deck)


@kernel
def record_knot(buffer, place):
    """Add a knot of the deck that is recorded, from the rows passed and passing of `record`."""
    deck = state.extent(buffer).recorded - 1
    book = state.book(buffer, deck)
    places = knot_places(buffer, deck)
    count = book.knots
    again = count > 0 and place - places[count - 1] <= SAME_PLACE * deck_length(buffer, deck)
    if not again and count == state.extent(buffer).knots:
        thin_knots(buffer, deck)
        count = book.knots
    knot = count - 1 if again else count
    width = deck_width(buffer, deck)
    first = width * panel_velocity(buffer, state.AT.scene, deck, 0)
    here = width * panel_velocity(buffer, state.AT.scene, deck, book.lead_panel)
    before_passed = state.node_vector(buffer, state.AT.lead_passed, deck)
    passed = state.node_vector(buffer, state.AT.record, 0)
    passing = state.node_vector(buffer, state.AT.record, 1)
    total = knot_vector(buffer, state.AT.knot_passed, deck, knot)
    before = knot_vector(buffer, state.AT.knot_before, deck, knot)
    after = knot_vector(buffer, state.AT.knot_after, deck, knot)
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
def record_nothing(buffer, start, stop):
    """Add the knots of a stretch on which nothing passes."""
    passed = state.vector(buffer, state.AT.record, 2 * state.extent(buffer).nodes, 0)
    for i in range(passed.size):
        passed[i] = 0.0
    record_knot(buffer, start)
    record_knot(buffer, stop)


@kernel
def thin_knots(buffer, deck):
    """Make room: every second knot inside goes; sums stay, as they are sums up to a place."""
    book = state.book(buffer, deck)
    places = knot_places(buffer, deck)
    count = book.knots
    kept = 0
    for knot in range(count):
        if knot % 2 == 1 and knot < count - 1:
            continue
        if kept != knot:
            places[kept] = places[knot]
            for at in (state.AT.knot_passed, state.AT.knot_before, state.AT.knot_after):
                to = knot_vector(buffer, at, deck, kept)
                come = knot_vector(buffer, at, deck, knot)
                for i in range(to.size):
                    to[i] = come[i]
        kept += 1
    book.knots = kept


@kernel
def end_rates(total, rate_start, rate_end, width):
    """Rates at both ends of an interval, held within what keeps the cubic monotone."""
    most = 3.0 * max(0.0, total) / width
    return min(max(rate_start, 0.0), most), min(max(rate_end, 0.0), most)


@kernel
def lead_source(buffer, deck, place, velocity):
    """Set what lands on the leading slice from `place` on; returns the time for which it holds, s.

    The coefficients in time of the cubic's derivative, per area of this deck, kg/(m2 s).
    """
    above = deck - 1
    upper, book = state.book(buffer, above), state.book(buffer, deck)
    places = knot_places(buffer, above)
    count = upper.knots
    state.extent(buffer).source_terms = 0.0
    slack = SAME_PLACE * deck_length(buffer, deck)
    if count < 2 or place >= places[count - 1] - slack:
        return 1e300
    knot = min(book.knot, count - 2)
    while knot > 0 and places[knot] > place + slack:
        knot -= 1
    while knot + 2 < count and places[knot + 1] <= place + slack:
        knot += 1
    book.knot = knot
    width = places[knot + 1] - places[knot]
    x, rise = (place - places[knot]) / width, velocity / width
    start = knot_vector(buffer, state.AT.knot_passed, above, knot)
    stop = knot_vector(buffer, state.AT.knot_passed, above, knot + 1)
    after = knot_vector(buffer, state.AT.knot_after, above, knot)
    before = knot_vector(buffer, state.AT.knot_before, above, knot + 1)
    per_area = 1.0 / deck_width(buffer, deck)
    nodes = start.size
    source = state.vector(buffer, state.AT.source, 3 * nodes, 0)
    for i in range(nodes):
        total = stop[i] - start[i]
        one, two = end_rates(total, after[i], before[i], width)
        mean = total / width
        # rate(x) = one + x (6 mean - 4 one - 2 two) + 3 x^2 (one + two - 2 mean)
        linear = 6.0 * mean - 4.0 * one - 2.0 * two
        square = 3.0 * (one + two - 2.0 * mean)
        source[i] = per_area * (one + x * (linear + x * square))
        source[nodes + i] = per_area * rise * (linear + 2.0 * x * square)
        source[2 * nodes + i] = per_area * rise * rise * square
        if total > 0.0:
            state.extent(buffer).source_terms = 3.0
    return max(slack, places[knot + 1] - place) / velocity


@kernel
def passed_up_to(buffer, deck, place, passed):
    """What passes a steady deck up to a place [m], into `passed[node]`, kg/s."""
    book = state.book(buffer, deck)
    places = knot_places(buffer, deck)
    count = book.knots
    for i in range(passed.size):
        passed[i] = 0.0
    if count == 0:
        return
    knot = 0
    while knot + 2 < count and places[knot + 1] < place:
        knot += 1
    start = knot_vector(buffer, state.AT.knot_passed, deck, knot)
    if count == 1 or place <= places[knot]:
        for i in range(passed.size):
            passed[i] = start[i]
        return
    stop = knot_vector(buffer, state.AT.knot_passed, deck, knot + 1)
    after = knot_vector(buffer, state.AT.knot_after, deck, knot)
    before = knot_vector(buffer, state.AT.knot_before, deck, knot + 1)
    width = places[knot + 1] - places[knot]
    x = min(1.0, (place - places[knot]) / width)
    for i in range(passed.size):
        total = stop[i] - start[i]
        one, two = end_rates(total, after[i], before[i], width)
        one, two = one * width, two * width
        share = x * (one + x * (3.0 * total - 2.0 * one - two + x * (one + two - 2.0 * total)))
        passed[i] = start[i] + share


# --- from packages with a history ----------------------------------------------------------------
@kernel
def fall_vector(buffer, deck, row):
    """What fell from a package of a deck, by node, kg."""
    return state.node_vector(buffer, state.AT.fall, deck * state.extent(buffer).falls + row)


@kernel
def clear_falls(buffer, deck):
    """Forget what fell from a deck; what falls from now on is steady if the deck is."""
    count = state.vector(buffer, state.AT.fall_count, 4, deck)
    count[0], count[1] = 0.0, state.book(buffer, deck).covered
    fallen = state.node_vector(buffer, state.AT.fall_cohort, deck)
    for i in range(fallen.size):
        fallen[i] = 0.0


@kernel
def fell_steadily(buffer, deck):
    """Whether the deck was steady when what fell from it began to fall."""
    return state.vector(buffer, state.AT.fall_count, 4, deck)[1] == 1.0


@kernel
def fall_row(buffer, deck, row, start, stop):
    """Begin to record what falls from a package, from its rear and front (riding times, s)."""
    if deck + 1 == state.extent(buffer).decks:
        return
    falls = state.extent(buffer).falls
    state.vector(buffer, state.AT.fall_start, falls, deck)[row] = start
    state.vector(buffer, state.AT.fall_stop, falls, deck)[row] = stop
    fallen = fall_vector(buffer, deck, row)
    for i in range(fallen.size):
        fallen[i] = 0.0


@kernel
def clear_landing(buffer, count):
    """Nothing lands on the packages of a deck."""
    for row in range(count):
        landing = state.node_vector(buffer, state.AT.landing, row)
        for i in range(landing.size):
            landing[i] = 0.0


@kernel
def lay_records(buffer, deck, count, share, moment):
    """Lay a share of what fell from the packages above on the `count` packages of a deck.

    landing_start and landing_stop hold where those are `moment` s into the step, m. What no
    package is under goes to the nearest one.
    """
    above = deck - 1
    falls = state.extent(buffer).falls
    start = state.vector(buffer, state.AT.fall_start, falls, above)
    stop = state.vector(buffer, state.AT.fall_stop, falls, above)
    here = state.vector(buffer, state.AT.landing_start, falls, 0)
    there = state.vector(buffer, state.AT.landing_stop, falls, 0)
    length = deck_length(buffer, deck)
    ridden = moment if conveys(buffer, above) else 0.0
    for row in range(int(state.vector(buffer, state.AT.fall_count, 4, above)[0])):
        low = place_after(buffer, state.AT.scene, above, start[row] + ridden)
        high = place_after(buffer, state.AT.scene, above, stop[row] + ridden)
        low, high = max(0.0, min(low, length)), max(0.0, min(high, length))
        if high <= low:
            # What a pile before the feed end passes, and what has just left.
            near = min(cell_length(buffer, deck, 0), length)
            low = 0.0 if low < 0.5 * length else length - near
            high = low + near
        fallen = fall_vector(buffer, above, row)
        left = 1.0
        nearest, gap = -1, 1e300
        for package in range(count):
            bottom, top = here[package], there[package]
            if top <= bottom:
                continue
            overlap = (min(high, top) - max(low, bottom)) / (high - low)
            if -overlap < gap:
                nearest, gap = package, -overlap
            if overlap > 0.0:
                part = min(overlap, left)
                left -= part
                landing = state.node_vector(buffer, state.AT.landing, package)
                for i in range(landing.size):
                    landing[i] += part * share * fallen[i]
        if left > 0.0 and nearest >= 0:
            landing = state.node_vector(buffer, state.AT.landing, nearest)
            for i in range(landing.size):
                landing[i] += left * share * fallen[i]


@kernel
def lay_cohort(buffer, deck, count, share, moment):
    """Lay what fell from the cohort above on the packages of a deck that its own one is not under.

    In proportion to what passes the deck above between the ends of each package. `carry` holds,
    with its sign, what the deck's own cohort has taken of it.
    """
    above = deck - 1
    upper = state.book(buffer, above)
    falls = state.extent(buffer).falls
    here = state.vector(buffer, state.AT.landing_start, falls, 0)
    there = state.vector(buffer, state.AT.landing_stop, falls, 0)
    fallen = state.node_vector(buffer, state.AT.fall_cohort, above)
    carry = state.node_vector(buffer, state.AT.carry, deck)
    nodes = fallen.size
    due = state.node_vector(buffer, state.AT.node_work, 0)
    low = state.node_vector(buffer, state.AT.node_work, 1)
    high = state.node_vector(buffer, state.AT.node_work, 2)
    whole = state.node_vector(buffer, state.AT.node_work, 3)
    last = -1
    for package in range(count):
        if there[package] > here[package]:
            last = package
    for i in range(nodes):
        due[i] = share * fallen[i] + carry[i]
        carry[i] = 0.0
        if last < 0 or due[i] < 0.0:
            carry[i] = due[i]
            due[i] = 0.0
    if last < 0:
        return
    front = deck_length(buffer, above)
    if not fell_steadily(buffer, above):
        ridden = max(0.0, upper.cohort_front - moment)
        front = min(front, place_after(buffer, state.AT.scene, above, ridden))
    rear = min(front, here[last])
    passed_up_to(buffer, above, rear, low)
    passed_up_to(buffer, above, front, whole)
    # The rear package is the last: it starts where the cohort ends; the others follow.
    for package in range(last, -1, -1):
        if there[package] <= here[package] or here[package] >= front:
            continue
        passed_up_to(buffer, above, min(front, there[package]), high)
        landing = state.node_vector(buffer, state.AT.landing, package)
        for i in range(nodes):
            rest = whole[i] - low[i]
            part = due[i] * min(1.0, max(0.0, high[i] - low[i]) / rest) if rest > 0.0 else 0.0
            landing[i] += part
            due[i] -= part
            low[i] = max(low[i], high[i])
    landing = state.node_vector(buffer, state.AT.landing, last)
    for i in range(nodes):
        landing[i] += due[i]
