"""A deck through one step."""

from vibroscreen.compiler.language import kernel, numbers
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import cohorts, falls, front, package, ride, travel
from vibroscreen.kernels.numerics import vectors


@kernel
def clear_deck(buffer, deck):
    """An empty deck: no cohort; a lower deck is laid out with empty packages of a cell's length."""
    book = state.book(buffer, deck)
    vectors.fill(numbers(book), 0.0)
    book.share = 1.0 if deck == 0 else front.SHARE_BELOW
    free = state.free(buffer, deck)
    for index in range(free.size):
        free[index] = free.size - 1 - index
    cells = state.extent(buffer).cells
    if deck > 0 and free.size > cells:
        for cell in range(cells - 1, -1, -1):
            panel = travel.cell_panel(buffer, deck, cell)
            length = travel.cell_length(buffer, deck, panel)
            package.join_back(buffer, deck, package.new_slot(buffer, deck, panel, length))


@kernel
def advance_queue(buffer, deck, duration):
    """Advance all packages of the queue, the one nearest to the discharge first."""
    book = state.book(buffer, deck)
    count = book.packages
    # A lower deck's new packages came in at the start of the step, and its cohort is ahead.
    rear = ride.queue_rear(buffer, deck)
    if deck > 0 and travel.conveys(buffer, deck):
        rear -= duration
    for place in range(count - 1, 0, -1):
        rear += package.span_of(buffer, deck, package.slot_at(buffer, deck, place))
    gone, followed = 0, 0
    for place in range(count):
        index = package.slot_at(buffer, deck, place)
        if place >= followed and package.leader_at(buffer, deck, place) > 0.0:
            followed = cohorts.follow_cohort(buffer, deck, place, rear, duration)
        behind = 0.0
        if place + 1 < count:
            behind = package.span_of(buffer, deck, package.slot_at(buffer, deck, place + 1))
        falls.fall_row(buffer, deck, place, rear, rear + package.span_of(buffer, deck, index))
        if place < followed:
            cohorts.take_part(buffer, deck, index, place, followed - 1 - place)
        elif place == count - 1 and book.pile_open > 0.0:
            terms = front.feed_pile(buffer, deck, index, duration)
            ride.ride(buffer, deck, index, place, duration, terms)
        else:
            left = ride.advance_package(buffer, deck, index, place, rear, duration)
            gone += 1 if left <= 0.0 and place == gone else 0
        rear -= behind
    state.fall_count(buffer, deck)[0] = count
    for _ in range(gone):
        package.leave_queue(buffer, deck, 0)
    if book.pile_open > 0.0:
        book.pile_rear += travel.panel_velocity(buffer, deck, 0) * duration


@kernel
def advance_top(buffer, duration):
    """Advance the top deck under constant motion and feed; returns the time it took, s.

    That is less than `duration` where a pile has moved on to the deck.
    """
    book, scene = state.book(buffer, 0), state.scene(buffer, 0, 0)
    velocity = travel.panel_velocity(buffer, 0, 0)
    rate = book.cohort_fed
    deepest = front.PILE_DEPTH * travel.deck_length(buffer, 0) * scene.density
    slow = velocity == 0.0 or travel.residence_time(buffer, 0) > front.PILE_TIME
    heavy = slow and rate > 0.0 and rate >= state.width(buffer)[0] * velocity * deepest
    if heavy and book.pile_open == 0.0:
        front.open_pile(buffer, 0)
    piling = book.pile_open > 0.0
    step = duration
    if piling and velocity > 0.0:
        step = min(duration, max(0.0, -book.pile_rear / velocity))
    if cohorts.leaves_whole(buffer, step):
        cohorts.let_go(buffer)
    else:
        advance_queue(buffer, 0, step)
    if piling and velocity > 0.0 and step < duration:
        book.pile_open, book.pile_rear = 0.0, 0.0
    if not piling and velocity > 0.0:
        front.grow_cohort(buffer, 0, step)
    return step


@kernel
def extend_tail(buffer, deck, duration):
    """Let an empty stretch come in at the feed end of a lower deck, up to a cell long a package."""
    length = state.length(buffer, deck)
    fresh = travel.panel_velocity(buffer, deck, 0) * duration
    count = state.book(buffer, deck).packages
    if count > 0:
        tail = package.slot_at(buffer, deck, count - 1)
        whole = length[tail] + fresh
        longest = travel.cell_length(buffer, deck, 0) * package.JOIN
        if package.panel_of(buffer, deck, tail) == 0 and whole <= longest:
            load, reference = state.load(buffer, deck, tail), state.reference(buffer, deck, tail)
            layers = package.layers_of(buffer, deck, tail)
            part = length[tail] / whole
            for i in range(reference.size):
                reference[i] *= part
                for j in range(layers):
                    load[j, i] *= part
            package.settle(buffer, deck, tail, layers)
            length[tail] = whole
            return
    package.join_back(buffer, deck, package.new_slot(buffer, deck, 0, fresh))
