"""What lies on a deck, and how deep."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import package, travel
from vibroscreen.kernels.bed.ride import queue_rear
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.numerics.layers import bed_load


@kernel
def held_by_node(buffer, deck, held):
    """Add what lies on a deck to `held[node]`, kg; returns its sum over the sizes."""
    book, queue = state.book(buffer, deck), state.queue(buffer, deck)
    cell = state.cell(buffer, deck)
    packages, total = book.packages, 0.0
    for place in range(packages + book.cells):
        index = int(queue[place]) if place < packages else int(cell[place - packages])
        area, load = package.area_of(buffer, deck, index), state.load(buffer, deck, index)
        layers = package.layers_of(buffer, deck, index)
        total += area * bed_load(load, layers)
        vectors.add_rows(held, area, load, layers)
    if book.covered == 0.0 and book.cohort_on > 0.0:
        partial, width = state.partial(buffer, deck), state.width(buffer)[deck]
        total += width * bed_load(partial, book.partial_layers)
        vectors.add_rows(held, width, partial, book.partial_layers)
    return total


# m/s; a bed that rides more slowly has no depth of its own at the feed end: what lies there has.
STILL = 1e-9


@kernel
def depth_at_feed(buffer, deck):
    """Depth of the bed at the feed end, m; on a lower deck that of its first cell."""
    book, density = state.book(buffer, deck), state.scene(buffer, deck, 0).density
    velocity = travel.panel_velocity(buffer, deck, 0)
    if deck == 0 and book.pile_open == 0.0 and book.cohort_front > 0.0 and velocity > STILL:
        load = book.cohort_fed / state.width(buffer)[deck]
        return load / (velocity * density)
    if book.first_load > 0.0:
        return book.first_load / density  # of a slice alone
    if book.cells > 0.0:
        first = int(state.cell(buffer, deck)[0])
        return package.load_of(buffer, deck, first) / density
    if book.packages == 0:
        return 0.0
    last = package.slot_at(buffer, deck, book.packages - 1)
    return package.load_of(buffer, deck, last) / density


@kernel
def depth_at_discharge(buffer, deck):
    book, density = state.book(buffer, deck), state.scene(buffer, deck, 0).density
    if book.covered > 0.0:
        if not package.in_cells(buffer, deck):
            return 0.0
        return bed_load(state.lead(buffer, deck), book.lead_layers) / density
    if book.packages == 0:
        return 0.0
    front = queue_rear(buffer, deck)
    for place in range(book.packages):
        front += package.span_of(buffer, deck, package.slot_at(buffer, deck, place))
    end = travel.deck_length(buffer, deck)
    if travel.conveys(buffer, deck):
        end = travel.residence_time(buffer, deck)
    slack, first = 1e-9 * end, package.slot_at(buffer, deck, 0)
    if travel.panel_count(buffer, deck) > 1:
        # Where panels change their velocities, packages across their ends get longer or shorter.
        slack += 0.5 * package.span_of(buffer, deck, first)
    return package.load_of(buffer, deck, first) / density if front >= end - slack else 0.0
