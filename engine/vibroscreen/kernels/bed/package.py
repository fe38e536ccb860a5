"""Packages of a deck: slots, neighbours, merging."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.travel import conveys, panel_velocity
from vibroscreen.kernels.numerics.layers import restack

# A package moved by less than this part of a length has moved by round-off.
MOMENT = 1e-9
# Two pieces become one package up to this part over the length of a cell.
JOIN = 1.0 + 1e-9


@kernel
def bed_capacity(buffer, deck):
    """Depth that `bed.layers` layers together hold, m; also where a model has none of its own."""
    scene = state.scene(buffer, state.AT.scene, deck, 0)
    upper = (state.extent(buffer).bed_layers - 1.0) * scene.layer_load
    return (scene.contact_load + upper) / scene.density


@kernel
def free_slots(buffer, deck):
    """Number of package slots that nobody uses."""
    book = state.book(buffer, deck)
    return int(state.extent(buffer).packages - book.packages - book.cells - book.leaders)


@kernel
def give_back(buffer, deck, index):
    """Put slot `index` on the pile of free ones; call before the package leaves its row."""
    state.package_vector(buffer, state.AT.free, deck)[free_slots(buffer, deck)] = index


@kernel
def new_slot(buffer, deck):
    """A free slot, emptied; merges neighbours of the queue if there is none."""
    if free_slots(buffer, deck) == 0:
        part_cohorts(buffer, deck)
    if free_slots(buffer, deck) == 0:
        merge_likest(buffer, deck)
    index = int(state.package_vector(buffer, state.AT.free, deck)[free_slots(buffer, deck) - 1])
    whole = state.slot(buffer, deck, index)
    load = state.column(buffer, state.AT.load, whole)
    reference = state.node_vector(buffer, state.AT.reference, whole)
    for i in range(reference.size):
        reference[i] = 0.0
        for j in range(load.shape[0]):
            load[j, i] = 0.0
    state.package_vector(buffer, state.AT.leader, deck)[index] = 0.0
    state.package_vector(buffer, state.AT.length, deck)[index] = 0.0
    state.package_vector(buffer, state.AT.layers_used, deck)[index] = 1.0
    state.package_vector(buffer, state.AT.on_panel, deck)[index] = 0.0
    pace = state.vector(buffer, state.AT.pace, 4, whole)
    book = state.book(buffer, deck)
    keep_pace(book, pace)
    return index


@kernel
def keep_pace(book, pace):
    """Remember steps and order of the integration with a package."""
    pace[0], pace[1], pace[2], pace[3] = book.step, book.order, book.pace, book.wide


@kernel
def use_pace(book, pace):
    """Go on with remembered steps and order."""
    book.step, book.order, book.pace, book.wide = pace[0], pace[1], pace[2], pace[3]


@kernel
def queue_slot(buffer, deck, place):
    """Slot of the package at a place of the queue."""
    return int(state.package_vector(buffer, state.AT.queue, deck)[place])


@kernel
def join_back(buffer, deck, index):
    """Put a package behind the last one of the queue."""
    book = state.book(buffer, deck)
    state.package_vector(buffer, state.AT.queue, deck)[book.packages] = index
    book.packages += 1


@kernel
def leave_queue(buffer, deck, place):
    """Take the package at `place` out of the queue and free its slot."""
    book = state.book(buffer, deck)
    queue = state.package_vector(buffer, state.AT.queue, deck)
    give_back(buffer, deck, queue[place])
    book.packages -= 1
    for k in range(place, book.packages):
        queue[k] = queue[k + 1]


@kernel
def panel_of(buffer, deck, index):
    """Panel on which a package counts: that of its middle."""
    return int(state.package_vector(buffer, state.AT.on_panel, deck)[index])


@kernel
def package_scene(buffer, deck, index):
    """Scene of the panel on which a package counts."""
    return state.scene(buffer, state.AT.scene, deck, panel_of(buffer, deck, index))


@kernel
def package_velocity(buffer, deck, index):
    """Velocity of a package, m/s."""
    return panel_velocity(buffer, deck, panel_of(buffer, deck, index))


@kernel
def package_span(buffer, deck, index):
    """Riding time from the rear to the front of a package, s; its length where all stands still."""
    velocity = package_velocity(buffer, deck, index)
    length = state.package_vector(buffer, state.AT.length, deck)[index]
    return length / velocity if velocity > 0.0 else length


@kernel
def merge_into(buffer, deck, place):
    """Merge the package behind `place` into the one at `place`, layer by layer, conservatively."""
    keep, gone = queue_slot(buffer, deck, place), queue_slot(buffer, deck, place + 1)
    length = state.package_vector(buffer, state.AT.length, deck)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    stretch = 1.0  # of what comes from another panel
    if panel_of(buffer, deck, keep) != panel_of(buffer, deck, gone) and conveys(buffer, deck):
        velocity = package_velocity(buffer, deck, keep)
        stretch = velocity / package_velocity(buffer, deck, gone)
    whole = length[keep] + stretch * length[gone]
    if whole > 0.0:
        load = state.column(buffer, state.AT.load, state.slot(buffer, deck, keep))
        more = state.column(buffer, state.AT.load, state.slot(buffer, deck, gone))
        reference = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, keep))
        fed = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, gone))
        layers = int(max(used[keep], used[gone]))
        for i in range(reference.size):
            reference[i] = (length[keep] * reference[i] + length[gone] * fed[i]) / whole
            for j in range(layers):
                load[j, i] = (length[keep] * load[j, i] + length[gone] * more[j, i]) / whole
        used[keep] = restack(buffer, package_scene(buffer, deck, keep), load, layers)
        length[keep] = whole
    leave_queue(buffer, deck, place + 1)
    state.counters(buffer).merges += 1.0


@kernel
def unlikeness(buffer, deck, one, two):
    """How much two packages differ: largest difference of a node, as a part of what was fed."""
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    load = state.column(buffer, state.AT.load, state.slot(buffer, deck, one))
    other = state.column(buffer, state.AT.load, state.slot(buffer, deck, two))
    reference = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, one))
    fed = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, two))
    layers = int(max(used[one], used[two]))
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
    book = state.book(buffer, deck)
    length = state.package_vector(buffer, state.AT.length, deck)
    best, least = 0, 1e300
    for place in range(book.packages - 1):
        one, two = queue_slot(buffer, deck, place), queue_slot(buffer, deck, place + 1)
        together = length[one] + length[two]
        weight = length[one] * length[two] / together if together > 0.0 else 0.0
        # Length breaks the tie of packages that are alike.
        cost = unlikeness(buffer, deck, one, two) ** 2 * weight + 1e-12 * together
        if cost < least:
            best, least = place, cost
    one, two = queue_slot(buffer, deck, best), queue_slot(buffer, deck, best + 1)
    if not alike(buffer, deck, one, two):
        book.capacity_alarm = 1.0
    merge_into(buffer, deck, best)


@kernel
def alike(buffer, deck, one, two):
    """Whether mixing two packages changes a recovery by less than the tolerance."""
    tolerance = state.parameters(buffer).solver_tolerance
    return unlikeness(buffer, deck, one, two) ** 2 <= tolerance


@kernel
def cohort_end(buffer, deck, place):
    """Place behind the last part of the closed cohort whose first part is at `place`."""
    leader = state.package_vector(buffer, state.AT.leader, deck)
    name = leader[queue_slot(buffer, deck, place)]
    end = place + 1
    while end < int(state.book(buffer, deck).packages):
        if leader[queue_slot(buffer, deck, end)] != name:
            break
        end += 1
    return end


@kernel
def part_cohort(buffer, deck, place):
    """From now on the parts of the closed cohort at `place` are packages of their own."""
    leader = state.package_vector(buffer, state.AT.leader, deck)
    first = queue_slot(buffer, deck, place)
    index = int(leader[first]) - 1
    pace = state.vector(buffer, state.AT.pace, 4, state.slot(buffer, deck, index))
    for k in range(place, cohort_end(buffer, deck, place)):
        part = queue_slot(buffer, deck, k)
        kept = state.vector(buffer, state.AT.pace, 4, state.slot(buffer, deck, part))
        for n in range(pace.size):
            kept[n] = pace[n]
        leader[part] = 0.0
    give_back(buffer, deck, index)
    state.book(buffer, deck).leaders -= 1.0


@kernel
def part_cohorts(buffer, deck):
    """Part all closed cohorts of a deck: what comes is not the same for all of each."""
    for place in range(int(state.book(buffer, deck).packages)):
        if (
            state.package_vector(buffer, state.AT.leader, deck)[queue_slot(buffer, deck, place)]
            > 0.0
        ):
            part_cohort(buffer, deck, place)


@kernel
def in_cells(buffer, deck):
    """Whether the cohort keeps cells: the top deck's does only while it is fed."""
    return deck > 0 or state.book(buffer, deck).cohort_fed > 0.0
