"""What lies at a place of a deck at this moment."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import package, travel
from vibroscreen.kernels.bed.ride import queue_rear
from vibroscreen.kernels.numerics import vectors


@kernel
def read_bed(buffer, deck, place):
    """Write what lies at a place [m] of a deck into `column` [layer, node], kg/m2."""
    column = state.column(buffer, state.AT.column, 0)
    vectors.clear_rows(column, 0, column.shape[0])
    book, time = state.book(buffer, deck), travel.riding_time(buffer, deck, place)
    if (book.cohort_on > 0.0 and time < book.cohort_front) or book.covered > 0.0:
        read_cohort(buffer, deck, time, column)
        return
    rear = queue_rear(buffer, deck)
    for row in range(book.packages - 1, -1, -1):
        index = package.slot_at(buffer, deck, row)
        rear += package.span_of(buffer, deck, index)
        if time <= rear:
            read_package(buffer, deck, index, column)
            return


@kernel
def read_cohort(buffer, deck, time, column):
    """What lies at a riding time [s] behind the front of the feed: a cell, or what began as one."""
    if not package.in_cells(buffer, deck):
        return
    book = state.book(buffer, deck)
    begin = 0.0
    for cell in range(book.cells):
        begin = travel.cell_end(buffer, deck, cell)
        if time <= begin or cell + 1 == travel.cell_count(buffer, deck):
            index = int(state.package_vector(buffer, state.AT.cell, deck)[cell])
            read_package(buffer, deck, index, column)
            return
    panel = travel.cell_panel(buffer, deck, book.cells)
    length = (book.cohort_front - begin) * travel.panel_velocity(buffer, deck, panel)
    partial = state.column(buffer, state.AT.partial, deck)
    for j in range(book.partial_layers):
        for i in range(column.shape[1]):
            column[j, i] = partial[j, i] / length


@kernel
def read_package(buffer, deck, index, column):
    load, layers = package.column_of(buffer, deck, index), package.layers_of(buffer, deck, index)
    vectors.copy_rows(column, load, layers)
