"""A deck through one step."""

from vibroscreen.compiler.language import kernel, numbers
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import front, package, queue, travel
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
    cells = travel.cell_count(buffer, deck)
    if deck > 0 and free.size > cells:
        for cell in range(cells - 1, -1, -1):
            panel = travel.cell_panel(buffer, deck, cell)
            length = travel.cell_length(buffer, deck, panel)
            package.join_back(buffer, deck, package.new_slot(buffer, deck, panel, length))


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
    queue.advance_queue(buffer, 0, step)
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
