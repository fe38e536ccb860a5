"""What leaves a deck, and where what fell from packages with a history lands on the deck below."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import travel
from vibroscreen.kernels.bed.knots import passed_up_to
from vibroscreen.kernels.numerics import vectors


@kernel
def undersize(buffer, deck):
    """What passed a deck in the step, by node, kg."""
    return state.step_mass(buffer, 0, deck)


@kernel
def oversize(buffer, deck):
    """What left over the end of a deck in the step, by node, kg."""
    return state.step_mass(buffer, 1, deck)


@kernel
def clear_streams(buffer, deck):
    """Begin a step of a deck: nothing has left it."""
    vectors.fill(undersize(buffer, deck), 0.0)
    vectors.fill(oversize(buffer, deck), 0.0)
    state.book(buffer, deck).capacity_alarm = 0.0


@kernel
def clear_falls(buffer, deck):
    """Forget what fell from a deck; what falls from now on is steady if the deck is."""
    count = state.fall_count(buffer, deck)
    count[0], count[1] = 0.0, state.book(buffer, deck).covered
    vectors.fill(state.fall_cohort(buffer, deck), 0.0)


@kernel
def fell_steadily(buffer, deck):
    """Whether the deck was steady when what fell from it began to fall."""
    return state.fall_count(buffer, deck)[1] == 1.0


@kernel
def fall_row(buffer, deck, row, start, stop):
    """Begin to record what falls from a package, from its rear and front (riding times, s)."""
    if deck + 1 == state.extent(buffer).decks:
        return
    state.fall_start(buffer, deck)[row] = start
    state.fall_stop(buffer, deck)[row] = stop
    vectors.fill(state.fall(buffer, deck, row), 0.0)


@kernel
def fall_stretch(buffer, above, row, ridden):
    """From where to where, m, a record of the deck above falls after it rode on for so many s."""
    low = travel.place_after(buffer, above, state.fall_start(buffer, above)[row] + ridden)
    high = travel.place_after(buffer, above, state.fall_stop(buffer, above)[row] + ridden)
    length = travel.deck_length(buffer, above + 1)
    low, high = max(0.0, min(low, length)), max(0.0, min(high, length))
    if high <= low:
        # What a pile before the feed end passes, and what has just left.
        near = min(travel.cell_length(buffer, above + 1, 0), length)
        low = 0.0 if low < 0.5 * length else length - near
        high = low + near
    return low, high


@kernel
def lay_records(buffer, deck, count, share, moment):
    """Lay a share of what fell from the packages above on the `count` packages of a deck.

    landing_start and landing_stop hold where those are `moment` s into the step, m. What no
    package is under goes to the nearest one.
    """
    above = deck - 1
    here, there = state.landing_start(buffer), state.landing_stop(buffer)
    ridden = moment if travel.conveys(buffer, above) else 0.0
    for row in range(int(state.fall_count(buffer, above)[0])):
        low, high = fall_stretch(buffer, above, row, ridden)
        fallen = state.fall(buffer, above, row)
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
                vectors.add(state.landing(buffer, package), part * share, fallen)
        if left > 0.0 and nearest >= 0:
            vectors.add(state.landing(buffer, nearest), left * share, fallen)


@kernel
def take_due(buffer, deck, share, lies, due):
    """Share of what fell from the cohort above, less what the deck's own cohort has taken, kg.

    What cannot be laid stays in `carry`, with its sign; `lies`: whether any package is there.
    """
    fallen, carry = state.fall_cohort(buffer, deck - 1), state.carry(buffer, deck)
    for i in range(due.size):
        due[i] = share * fallen[i] + carry[i]
        carry[i] = 0.0
        if not lies or due[i] < 0.0:
            carry[i] = due[i]
            due[i] = 0.0


@kernel
def lay_cohort(buffer, deck, count, share, moment):
    """Lay what fell from the cohort above on the packages of a deck that its own one is not under.

    In proportion to what passes the deck above between the ends of each package. `carry` holds,
    with its sign, what the deck's own cohort has taken of it.
    """
    above = deck - 1
    here, there = state.landing_start(buffer), state.landing_stop(buffer)
    due, low = state.spare(buffer, 0), state.spare(buffer, 1)
    high, whole = state.spare(buffer, 2), state.spare(buffer, 3)
    last = -1
    for package in range(count):
        if there[package] > here[package]:
            last = package
    take_due(buffer, deck, share, last >= 0, due)
    if last < 0:
        return
    front = travel.deck_length(buffer, above)
    if not fell_steadily(buffer, above):
        ridden = max(0.0, state.book(buffer, above).cohort_front - moment)
        front = min(front, travel.place_after(buffer, above, ridden))
    passed_up_to(buffer, above, min(front, here[last]), low)
    passed_up_to(buffer, above, front, whole)
    # The rear package is the last: it starts where the cohort ends; the others follow.
    for package in range(last, -1, -1):
        if there[package] <= here[package] or here[package] >= front:
            continue
        passed_up_to(buffer, above, min(front, there[package]), high)
        landing = state.landing(buffer, package)
        for i in range(due.size):
            rest = whole[i] - low[i]
            part = due[i] * min(1.0, max(0.0, high[i] - low[i]) / rest) if rest > 0.0 else 0.0
            landing[i] += part
            due[i] -= part
            low[i] = max(low[i], high[i])
    vectors.add(state.landing(buffer, last), 1.0, due)
