"""The packages behind the front of the feed, one after the other."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import cohorts, falls, front, package, ride, travel


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
        span = package.span_of(buffer, deck, index)
        falls.fall_row(buffer, deck, place, rear, rear + span)
        if place < followed:
            cohorts.take_part(buffer, deck, index, place, followed - 1 - place)
        elif place == count - 1 and book.pile_open > 0.0:
            front.feed_pile(buffer, deck, index, duration)
            ride.ride(buffer, deck, index, place, duration)
            state.work(buffer).source_terms = 0.0
        else:
            left = ride.advance_package(buffer, deck, index, place, rear, duration)
            gone += 1 if left <= 0.0 and place == gone else 0
        rear -= behind
    state.fall_count(buffer, deck)[0] = count
    for _ in range(gone):
        package.leave_queue(buffer, deck, 0)
    if book.pile_open > 0.0:
        book.pile_rear += travel.panel_velocity(buffer, deck, 0) * duration
