"""What lies on a deck, and how deep."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import package, ride, travel
from vibroscreen.kernels.numerics.layers import bed_load


@kernel
def held_by_node(buffer, deck, held):
    """Add what lies on a deck to `held[node]`, kg; returns its sum over the sizes."""
    book = state.book(buffer, deck)
    width = travel.deck_width(buffer, deck)
    length = state.package_vector(buffer, state.AT.length, deck)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    queue = state.package_vector(buffer, state.AT.queue, deck)
    cell = state.package_vector(buffer, state.AT.cell, deck)
    packages = book.packages
    total = 0.0
    for place in range(packages + book.cells):
        index = int(queue[place]) if place < packages else int(cell[place - packages])
        area = width * length[index]
        load = state.column(buffer, state.AT.load, state.slot(buffer, deck, index))
        total += area * bed_load(load, int(used[index]))
        for j in range(int(used[index])):
            for i in range(held.size):
                held[i] += area * load[j, i]
    if book.covered == 0.0 and book.cohort_on > 0.0:
        partial = state.column(buffer, state.AT.partial, deck)
        total += width * bed_load(partial, book.partial_layers)
        for j in range(book.partial_layers):
            for i in range(held.size):
                held[i] += width * partial[j, i]
    return total


@kernel
def package_load(buffer, deck, place):
    """Areal mass of a package of the queue, kg/m2."""
    index = package.queue_slot(buffer, deck, place)
    used = int(state.package_vector(buffer, state.AT.layers_used, deck)[index])
    return bed_load(state.column(buffer, state.AT.load, state.slot(buffer, deck, index)), used)


@kernel
def depth_at_feed(buffer, deck):
    """Depth of the bed at the feed end, m; on a lower deck that of its first cell."""
    book = state.book(buffer, deck)
    count = book.packages
    density = state.scene(buffer, state.AT.scene, deck, 0).density
    if deck == 0 and book.pile_open == 0.0 and book.cohort_front > 0.0:
        load = book.cohort_fed / travel.deck_width(buffer, deck)
        return load / (travel.panel_velocity(buffer, deck, 0) * density)
    if book.cells > 0.0:
        index = int(state.package_vector(buffer, state.AT.cell, deck)[0])
        used = int(state.package_vector(buffer, state.AT.layers_used, deck)[index])
        return (
            bed_load(state.column(buffer, state.AT.load, state.slot(buffer, deck, index)), used)
            / density
        )
    return package_load(buffer, deck, count - 1) / density if count > 0 else 0.0


@kernel
def depth_at_discharge(buffer, deck):
    """Depth of the bed at the discharge end, m."""
    book = state.book(buffer, deck)
    density = state.scene(buffer, state.AT.scene, deck, 0).density
    if book.covered > 0.0:
        if not package.in_cells(buffer, deck):
            return 0.0
        return bed_load(state.column(buffer, state.AT.lead, deck), book.lead_layers) / density
    count = book.packages
    if count == 0:
        return 0.0
    front = ride.queue_rear(buffer, deck)
    for place in range(count):
        front += package.package_span(buffer, deck, package.queue_slot(buffer, deck, place))
    end = travel.deck_length(buffer, deck)
    if travel.conveys(buffer, deck):
        end = travel.residence_time(buffer, deck)
    slack = 1e-9 * end
    if travel.panel_count(buffer, deck) > 1:
        # Where panels change their velocities, packages across their ends get longer or shorter.
        slack += 0.5 * package.package_span(buffer, deck, package.queue_slot(buffer, deck, 0))
    at_end = front >= end - slack
    return package_load(buffer, deck, 0) / density if at_end else 0.0
