"""Packages of a deck: slots, neighbours, merging."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import travel
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.numerics.layers import bed_load, restack

# A package moved by less than this part of a length has moved by round-off.
MOMENT = 1e-9
# Two pieces become one package up to this part over the length of a cell.
JOIN = 1.0 + 1e-9


# --- what a slot holds ---------------------------------------------------------------------------
@kernel
def layers_of(buffer, deck, index):
    return int(state.layers_used(buffer, deck)[index])


@kernel
def load_of(buffer, deck, index):
    """Areal mass of a package, kg/m2."""
    return bed_load(state.load(buffer, deck, index), layers_of(buffer, deck, index))


@kernel
def area_of(buffer, deck, index):
    """Plan area of a package, m2."""
    return state.width(buffer)[deck] * state.length(buffer, deck)[index]


@kernel
def panel_of(buffer, deck, index):
    """Panel on which a package counts: that of its middle."""
    return int(state.on_panel(buffer, deck)[index])


@kernel
def scene_of(buffer, deck, index):
    return state.scene(buffer, deck, panel_of(buffer, deck, index))


@kernel
def velocity_of(buffer, deck, index):
    return travel.panel_velocity(buffer, deck, panel_of(buffer, deck, index))


@kernel
def span_of(buffer, deck, index):
    """Riding time from the rear to the front of a package, s; its length where all stands still."""
    velocity = velocity_of(buffer, deck, index)
    length = state.length(buffer, deck)[index]
    return length / velocity if velocity > 0.0 else length


@kernel
def settle(buffer, deck, index, layers):
    load, used = state.load(buffer, deck, index), state.layers_used(buffer, deck)
    used[index] = restack(buffer, scene_of(buffer, deck, index), load, layers)


# --- slots and the queue -------------------------------------------------------------------------
@kernel
def bed_capacity(buffer, deck):
    """Depth that `bed.layers` layers together hold, m; also where a model has none of its own."""
    scene = state.scene(buffer, deck, 0)
    upper = (state.extent(buffer).bed_layers - 1.0) * scene.layer_load
    return (scene.contact_load + upper) / scene.density


@kernel
def free_slots(buffer, deck):
    book = state.book(buffer, deck)
    return int(state.extent(buffer).packages - book.packages - book.cells - book.leaders)


@kernel
def give_back(buffer, deck, index):
    """Put slot `index` on the pile of free ones; call before the package leaves its row."""
    state.free(buffer, deck)[free_slots(buffer, deck)] = index


@kernel
def new_slot(buffer, deck, panel, length):
    """A free slot with an empty package; merges neighbours of the queue if there is none."""
    if free_slots(buffer, deck) == 0:
        part_cohorts(buffer, deck)
    if free_slots(buffer, deck) == 0:
        merge_likest(buffer, deck)
    index = int(state.free(buffer, deck)[free_slots(buffer, deck) - 1])
    load = state.load(buffer, deck, index)
    vectors.fill(state.reference(buffer, deck, index), 0.0)
    vectors.clear_rows(load, 0, load.shape[0])
    state.leader(buffer, deck)[index] = 0.0
    state.on_panel(buffer, deck)[index] = panel
    state.length(buffer, deck)[index] = length
    state.layers_used(buffer, deck)[index] = 1.0
    keep_pace(state.book(buffer, deck), state.pace(buffer, deck, index))
    return index


@kernel
def keep_pace(book, pace):
    """Remember steps and order of the integration with a package."""
    pace[0], pace[1], pace[2], pace[3] = book.step, book.order, book.pace, book.wide


@kernel
def use_pace(book, pace):
    book.step, book.order, book.pace, book.wide = pace[0], pace[1], pace[2], pace[3]


@kernel
def slot_at(buffer, deck, place):
    return int(state.queue(buffer, deck)[place])


@kernel
def join_back(buffer, deck, index):
    book = state.book(buffer, deck)
    state.queue(buffer, deck)[book.packages] = index
    book.packages += 1


@kernel
def leave_queue(buffer, deck, place):
    """Take the package at `place` out of the queue and free its slot."""
    book, queue = state.book(buffer, deck), state.queue(buffer, deck)
    give_back(buffer, deck, queue[place])
    book.packages -= 1
    for k in range(place, book.packages):
        queue[k] = queue[k + 1]


# --- merging -------------------------------------------------------------------------------------
@kernel
def merge_into(buffer, deck, place):
    """Merge the package behind `place` into the one at `place`, layer by layer, conservatively."""
    keep, gone = slot_at(buffer, deck, place), slot_at(buffer, deck, place + 1)
    length = state.length(buffer, deck)
    stretch = 1.0  # of what comes from another panel
    apart = panel_of(buffer, deck, keep) != panel_of(buffer, deck, gone)
    if apart and travel.conveys(buffer, deck):
        stretch = velocity_of(buffer, deck, keep) / velocity_of(buffer, deck, gone)
    whole = length[keep] + stretch * length[gone]
    if whole > 0.0:
        load, more = state.load(buffer, deck, keep), state.load(buffer, deck, gone)
        reference, fed = state.reference(buffer, deck, keep), state.reference(buffer, deck, gone)
        layers = max(layers_of(buffer, deck, keep), layers_of(buffer, deck, gone))
        for i in range(reference.size):
            reference[i] = (length[keep] * reference[i] + length[gone] * fed[i]) / whole
            for j in range(layers):
                load[j, i] = (length[keep] * load[j, i] + length[gone] * more[j, i]) / whole
        settle(buffer, deck, keep, layers)
        length[keep] = whole
    leave_queue(buffer, deck, place + 1)
    state.counters(buffer).merges += 1.0


@kernel
def unlikeness(buffer, deck, one, two):
    """How much two packages differ: largest difference of a node, as a part of what was fed."""
    load, other = state.load(buffer, deck, one), state.load(buffer, deck, two)
    reference, fed = state.reference(buffer, deck, one), state.reference(buffer, deck, two)
    layers = max(layers_of(buffer, deck, one), layers_of(buffer, deck, two))
    worst = 0.0
    for i in range(reference.size):
        difference = 0.0
        for j in range(layers):
            difference += load[j, i] - other[j, i]
        scale = max(reference[i], fed[i])
        if scale > 0.0:
            worst = max(worst, abs(difference) / scale)
    return worst


@kernel
def merge_likest(buffer, deck):
    """Merge the two neighbours whose mixing matters least; says so where it matters.

    Rates are smooth, so what mixing changes is of second order in the difference.
    """
    book, length = state.book(buffer, deck), state.length(buffer, deck)
    best, least = 0, 1e300
    for place in range(book.packages - 1):
        one, two = slot_at(buffer, deck, place), slot_at(buffer, deck, place + 1)
        together = length[one] + length[two]
        weight = length[one] * length[two] / together if together > 0.0 else 0.0
        # Length breaks the tie of packages that are alike.
        cost = unlikeness(buffer, deck, one, two) ** 2 * weight + 1e-12 * together
        if cost < least:
            best, least = place, cost
    one, two = slot_at(buffer, deck, best), slot_at(buffer, deck, best + 1)
    if not alike(buffer, deck, one, two):
        book.capacity_alarm = 1.0
    merge_into(buffer, deck, best)


@kernel
def alike(buffer, deck, one, two):
    """Whether mixing two packages changes a recovery by less than the tolerance."""
    return unlikeness(buffer, deck, one, two) ** 2 <= state.parameters(buffer).solver_tolerance


# --- closed cohorts ------------------------------------------------------------------------------
@kernel
def leader_at(buffer, deck, place):
    return state.leader(buffer, deck)[slot_at(buffer, deck, place)]


@kernel
def cohort_end(buffer, deck, place):
    """Place behind the last part of the closed cohort whose first part is at `place`."""
    name = leader_at(buffer, deck, place)
    end = place + 1
    while end < state.book(buffer, deck).packages and leader_at(buffer, deck, end) == name:
        end += 1
    return end


@kernel
def part_cohort(buffer, deck, place):
    """From now on the parts of the closed cohort at `place` are packages of their own."""
    index = int(leader_at(buffer, deck, place)) - 1
    leader = state.leader(buffer, deck)
    for k in range(place, cohort_end(buffer, deck, place)):
        part = slot_at(buffer, deck, k)
        vectors.copy(state.pace(buffer, deck, part), state.pace(buffer, deck, index))
        leader[part] = 0.0
    give_back(buffer, deck, index)
    state.book(buffer, deck).leaders -= 1.0


@kernel
def part_cohorts(buffer, deck):
    """Part all closed cohorts of a deck: what comes is not the same for all of each."""
    for place in range(state.book(buffer, deck).packages):
        if leader_at(buffer, deck, place) > 0.0:
            part_cohort(buffer, deck, place)


@kernel
def in_cells(buffer, deck):
    """Whether the cohort keeps cells: the top deck's does only while it is fed."""
    return deck > 0 or state.book(buffer, deck).cohort_fed > 0.0
