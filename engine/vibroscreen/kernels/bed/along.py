"""What lies at a place of a deck at this moment."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import package, travel
from vibroscreen.kernels.bed.ride import queue_rear
from vibroscreen.kernels.numerics import vectors


@kernel
def read_bed(buffer, deck, place):
    """Write what lies at a place [m] of a deck into `column_time` [layer, node], kg/m2."""
    column = state.column_time(buffer)
    vectors.clear_rows(column, 0, column.shape[0])
    book = state.book(buffer, deck)
    front = travel.place_after(buffer, deck, book.cohort_front)
    if book.covered > 0.0 or (book.cohort_on > 0.0 and place < front):
        read_cohort(buffer, deck, place, column)
        return
    rear = queue_rear(buffer, deck)
    for row in range(book.packages - 1, -1, -1):
        index = package.slot_at(buffer, deck, row)
        rear += package.span_of(buffer, deck, index)
        if place <= travel.place_after(buffer, deck, rear):
            read_package(buffer, deck, index, column)
            return


@kernel
def read_cohort(buffer, deck, place, column):
    """What lies at a place [m] behind the front of the feed: a cell, or what began as one."""
    if not package.in_cells(buffer, deck):
        return
    book, begin = state.book(buffer, deck), 0.0
    for cell in range(book.cells):
        begin = travel.cell_end(buffer, deck, cell)
        end = travel.place_after(buffer, deck, begin)
        if place <= end or cell + 1 == state.extent(buffer).cells:
            read_package(buffer, deck, int(state.cell(buffer, deck)[cell]), column)
            return
    panel = travel.cell_panel(buffer, deck, book.cells)
    length = (book.cohort_front - begin) * travel.panel_velocity(buffer, deck, panel)
    partial = state.partial(buffer, deck)
    for j in range(book.partial_layers):
        for i in range(column.shape[1]):
            column[j, i] = partial[j, i] / length


@kernel
def read_package(buffer, deck, index, column):
    load = state.load(buffer, deck, index)
    vectors.copy_rows(column, load, package.layers_of(buffer, deck, index))
