"""What fell from packages with a history lands on the deck below."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import knots, travel


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
    length = travel.deck_length(buffer, deck)
    ridden = moment if travel.conveys(buffer, above) else 0.0
    for row in range(int(state.vector(buffer, state.AT.fall_count, 4, above)[0])):
        low = travel.place_after(buffer, above, start[row] + ridden)
        high = travel.place_after(buffer, above, stop[row] + ridden)
        low, high = max(0.0, min(low, length)), max(0.0, min(high, length))
        if high <= low:
            # What a pile before the feed end passes, and what has just left.
            near = min(travel.cell_length(buffer, deck, 0), length)
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
    front = travel.deck_length(buffer, above)
    if not fell_steadily(buffer, above):
        ridden = max(0.0, upper.cohort_front - moment)
        front = min(front, travel.place_after(buffer, above, ridden))
    rear = min(front, here[last])
    knots.passed_up_to(buffer, above, rear, low)
    knots.passed_up_to(buffer, above, front, whole)
    # The rear package is the last: it starts where the cohort ends; the others follow.
    for package in range(last, -1, -1):
        if there[package] <= here[package] or here[package] >= front:
            continue
        knots.passed_up_to(buffer, above, min(front, there[package]), high)
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
