"""Packages on a deck: entry, transport over its panels, discharge, merging (MODEL.md, "The deck").

Places along a deck are told by the riding time [s] from the feed end, in which every package moves
by the same amount whatever panel it is on. A deck holds two rows of packages, from the discharge to
the feed end:
  the queue: packages with a history of their own, first to be discharged first;
  the cohort: all that entered since motion, material and feed last changed (on a lower deck: since
      what falls on it is steady). Its slices share one trajectory, so its cells hold the same at
      any time, and only its leading slice (`lead`) is integrated. When it reaches the discharge
      the deck is steady.
When something changes, the cohort joins the queue and a new one begins. Loads are in kg/m2, a
package keeps its length while it rides on a panel, so mass = width x length x load is moved, never
made. Where the deck stands still (or creeps) the feed lands on top of a pile.
"""

from __future__ import annotations

from vibroscreen.kernels import state
from vibroscreen.kernels.landing import fall_row, fall_vector, lead_source, record_nothing
from vibroscreen.kernels.language import kernel, numbers
from vibroscreen.kernels.package import begin_parts, clear_sums, integrate
from vibroscreen.kernels.place import (
    cell_count,
    cell_end,
    cell_length,
    cell_panel,
    conveys,
    deck_length,
    deck_width,
    panel_count,
    panel_end_time,
    panel_velocity,
    place_after,
    residence_time,
    riding_time,
)
from vibroscreen.kernels.rates import bed_load, restack
from vibroscreen.kernels.schemes import carry_debts
from vibroscreen.kernels.segregation import NOTHING

# A feed piles up where it would lie deeper than this part of the deck's length, on a deck that
# takes longer than this to carry it to the discharge, s. One that conveys faster carries any feed.
PILE_DEPTH = 0.5
PILE_TIME = 300.0
# What a deck below may use of the tolerance.
SHARE_BELOW = 0.25
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
def clear_deck(buffer, deck):
    """An empty deck: no cohort; a lower deck is laid out with empty packages of a cell's length."""
    book = state.book(buffer, deck)
    kept = numbers(book)
    for i in range(kept.size):
        kept[i] = 0.0
    book.share = 1.0 if deck == 0 else SHARE_BELOW
    free = state.package_vector(buffer, state.AT.free, deck)
    for index in range(free.size):
        free[index] = free.size - 1 - index
    cells = cell_count(buffer, deck)
    if deck > 0 and free.size > cells:
        queue = state.package_vector(buffer, state.AT.queue, deck)
        for cell in range(cells - 1, -1, -1):
            index = new_slot(buffer, deck)
            panel = cell_panel(buffer, deck, cell)
            state.package_vector(buffer, state.AT.on_panel, deck)[index] = panel
            state.package_vector(buffer, state.AT.length, deck)[index] = cell_length(
                buffer, deck, panel
            )
            queue[book.packages] = index
            book.packages += 1


# --- slots ---------------------------------------------------------------------------------------
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
    return panel_velocity(buffer, state.AT.scene, deck, panel_of(buffer, deck, index))


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
    tolerance = state.parameters(buffer).tolerance
    return unlikeness(buffer, deck, one, two) ** 2 <= tolerance


# --- the queue -----------------------------------------------------------------------------------
@kernel
def integrate_package(buffer, deck, index, duration):
    """Advance the column of a package; its step and order are remembered with it."""
    book = state.book(buffer, deck)
    whole = state.slot(buffer, deck, index)
    pace = state.vector(buffer, state.AT.pace, 4, whole)
    lead_pace = (book.step, book.order, book.pace, book.wide)
    use_pace(book, pace)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    used[index] = integrate(
        buffer,
        package_scene(buffer, deck, index),
        book,
        state.column(buffer, state.AT.load, whole),
        state.node_vector(buffer, state.AT.reference, whole),
        int(used[index]),
        duration,
    )
    keep_pace(book, pace)
    use_pace(book, lead_pace)
    state.counters(buffer).packages_integrated += 1.0


@kernel
def pass_through(buffer, deck, row, scale, scale_time):
    """Book what passed, scale x passed + scale_time x its integral, as undersize of the deck."""
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    passed = state.node_vector(buffer, state.AT.column_flux, 0)
    passed_time = state.node_vector(buffer, state.AT.column_flux, 1)
    fallen = fall_vector(buffer, deck, row)
    record = deck + 1 < state.extent(buffer).decks
    for i in range(passed.size):
        mass = scale * passed[i] + scale_time * passed_time[i]
        undersize[i] += mass
        if record:
            fallen[i] += mass


@kernel
def land_on(buffer, row, area, time):
    """Spread what lands on a package over an area [m2] and a time [s], kg/(m2 s)."""
    if area * time <= 0.0:
        return
    source = state.node_vector(buffer, state.AT.source, 0)
    landing = state.node_vector(buffer, state.AT.landing, row)
    for i in range(source.size):
        source[i] = landing[i] / (area * time)
        if source[i] != 0.0:
            state.extent(buffer).source_terms = 1.0


@kernel
def refer_to_landing(buffer, deck, index, row):
    """Add what lands on a package to what was fed to it, the measure of its errors, kg/m2."""
    reference = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, index))
    landing = state.node_vector(buffer, state.AT.landing, row)
    area = deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
    for i in range(reference.size):
        if landing[i] > 0.0:
            reference[i] += landing[i] / area


@kernel
def ride(buffer, deck, index, row, duration):
    """Let a package lie on the deck as a whole for `duration` s; what passes is undersize."""
    if duration > 0.0:
        integrate_package(buffer, deck, index, duration)
        area = deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
        pass_through(buffer, deck, row, area, 0.0)


@kernel
def discharge(buffer, deck, index, row, duration, rest):
    """Shorten a package to the length `rest` over the deck's end, evenly in `duration` s.

    With length l(t): undersize W integral of l dp, oversize W integral of load (-dl); both follow
    exactly from the time integrals of what passed and of the loads.
    """
    length = state.package_vector(buffer, state.AT.length, deck)
    integrate_package(buffer, deck, index, duration)
    width = deck_width(buffer, deck)
    shortening = (length[index] - rest) / duration
    pass_through(buffer, deck, row, width * rest, width * shortening)
    oversize = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks + deck)
    time = state.column(buffer, state.AT.column_time, 0)
    for j in range(int(state.book(buffer, deck).rows)):
        for i in range(oversize.size):
            oversize[i] += width * shortening * time[j, i]
    length[index] = rest


@kernel
def idle(buffer, deck, index, row):
    """Whether nothing can happen inside a package: empty and nothing lands, or all is at rest."""
    if state.switches(buffer).idle_packages == 0.0:
        return False
    if deck > 0:
        landing = state.node_vector(buffer, state.AT.landing, row)
        for i in range(landing.size):
            if landing[i] != 0.0:
                return False
    scene = package_scene(buffer, deck, index)
    if scene.passage_velocity + scene.segregation_velocity + scene.mixing == 0.0:
        return not conveys(buffer, deck)
    used = int(state.package_vector(buffer, state.AT.layers_used, deck)[index])
    return (
        bed_load(state.column(buffer, state.AT.load, state.slot(buffer, deck, index)), used) == 0.0
    )


@kernel
def shed(buffer, deck, index):
    """Let what is left of a package fall over the deck's end at once."""
    load = state.column(buffer, state.AT.load, state.slot(buffer, deck, index))
    length = state.package_vector(buffer, state.AT.length, deck)
    area = deck_width(buffer, deck) * length[index]
    oversize = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks + deck)
    for j in range(int(state.package_vector(buffer, state.AT.layers_used, deck)[index])):
        for i in range(oversize.size):
            oversize[i] += area * load[j, i]
    length[index] = 0.0


@kernel
def cross(buffer, deck, index):
    """Move a package to the next panel: its length changes with the velocity, its mass stays."""
    panel = state.package_vector(buffer, state.AT.on_panel, deck)
    before = package_velocity(buffer, deck, index)
    panel[index] += 1.0
    stretch = package_velocity(buffer, deck, index) / before
    whole = state.slot(buffer, deck, index)
    load = state.column(buffer, state.AT.load, whole)
    reference = state.node_vector(buffer, state.AT.reference, whole)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    state.package_vector(buffer, state.AT.length, deck)[index] *= stretch
    for i in range(reference.size):
        reference[i] /= stretch
        for j in range(int(used[index])):
            load[j, i] /= stretch
    used[index] = restack(buffer, package_scene(buffer, deck, index), load, int(used[index]))


@kernel
def ride_panels(buffer, deck, index, row, middle, duration, time):
    """Let a package ride for `duration` s, over the ends of panels; `middle` is its riding time.

    What lands on it comes evenly within `time` s, of which this is a part.
    """
    left = duration
    width = deck_width(buffer, deck)
    while True:
        step = left
        panel = panel_of(buffer, deck, index)
        crosses = False
        if panel + 1 < panel_count(buffer, deck) and conveys(buffer, deck):
            until = panel_end_time(buffer, state.AT.scene, deck, panel) - middle
            crosses = until < left
            step = max(0.0, until) if crosses else left
        if deck > 0:
            area = width * state.package_vector(buffer, state.AT.length, deck)[index]
            land_on(buffer, row, area, time)
        ride(buffer, deck, index, row, step)
        state.extent(buffer).source_terms = 0.0
        left -= step
        middle += step
        if not crosses:
            return
        cross(buffer, deck, index)


@kernel
def advance_package(buffer, deck, index, row, rear, duration):
    """Move a package whose rear is at the riding time `rear`; returns the length that is left."""
    length = state.package_vector(buffer, state.AT.length, deck)
    whole, over = duration, 0.0  # time as a whole on the deck, then while it is discharged
    span = package_span(buffer, deck, index)
    rest = span
    if conveys(buffer, deck):
        end = residence_time(buffer, state.AT.scene, deck)
        whole = min(duration, max(0.0, end - rear - span))
        if whole < min(duration, MOMENT * span):
            whole = 0.0
        over = min(duration, max(0.0, end - rear)) - whole
        rest = min(rest, end - rear - duration)
        if rest < MOMENT * end / cell_count(buffer, deck):
            rest = 0.0
        if rest >= span:
            whole, over = whole + over, 0.0
    if idle(buffer, deck, index, row):
        state.counters(buffer).packages_skipped += 1.0
        ride_over(buffer, deck, index, rear + 0.5 * span + whole)
        if rest == 0.0 and over + whole > 0.0 and conveys(buffer, deck):
            shed(buffer, deck, index)
        elif rest < span:
            length[index] = rest * package_velocity(buffer, deck, index)
        return length[index]
    if deck > 0:
        refer_to_landing(buffer, deck, index, row)
    ride_panels(buffer, deck, index, row, rear + 0.5 * span, whole, whole + over)
    if rest < span and over > 0.0:
        rest *= package_velocity(buffer, deck, index)
        if deck > 0:
            area = 0.5 * deck_width(buffer, deck) * (length[index] + rest)
            land_on(buffer, row, area, whole + over)
        discharge(buffer, deck, index, row, over, rest)
        state.extent(buffer).source_terms = 0.0
    elif rest == 0.0 and conveys(buffer, deck):
        shed(buffer, deck, index)
    return length[index]


@kernel
def ride_over(buffer, deck, index, middle):
    """Move a package in which nothing happens on to the panel of its middle."""
    if conveys(buffer, deck):
        panel = panel_of(buffer, deck, index)
        while panel + 1 < panel_count(buffer, deck):
            if panel_end_time(buffer, state.AT.scene, deck, panel) > middle:
                break
            cross(buffer, deck, index)
            panel += 1


@kernel
def queue_rear(buffer, deck):
    """Riding time of the rear end of the queue, s (its place where the deck stands still)."""
    book = state.book(buffer, deck)
    if book.pile_open > 0.0:
        return riding_time(buffer, state.AT.scene, deck, book.pile_rear)
    return book.cohort_front


@kernel
def advance_queue(buffer, deck, duration):
    """Advance all packages of the queue, the one nearest to the discharge first."""
    book = state.book(buffer, deck)
    count = book.packages
    # A lower deck's new packages came in at the start of the step, and its cohort is ahead.
    rear = queue_rear(buffer, deck)
    if deck > 0 and conveys(buffer, deck):
        rear -= duration
    for place in range(count - 1, 0, -1):
        rear += package_span(buffer, deck, queue_slot(buffer, deck, place))
    gone, followed = 0, 0
    for place in range(count):
        index = queue_slot(buffer, deck, place)
        pile = place == count - 1 and book.pile_open > 0.0
        if place >= followed and state.package_vector(buffer, state.AT.leader, deck)[index] > 0.0:
            followed = follow_cohort(buffer, deck, place, rear, duration)
        behind = 0.0
        if place + 1 < count:
            behind = package_span(buffer, deck, queue_slot(buffer, deck, place + 1))
        fall_row(buffer, deck, place, rear, rear + package_span(buffer, deck, index))
        if place < followed:
            take_part(buffer, deck, index, place, followed - 1 - place)
        elif pile:
            feed_pile(buffer, deck, index, duration)
            ride(buffer, deck, index, place, duration)
            state.extent(buffer).source_terms = 0.0
        elif advance_package(buffer, deck, index, place, rear, duration) <= 0.0 and place == gone:
            gone += 1
        rear -= behind
    state.vector(buffer, state.AT.fall_count, 4, deck)[0] = count
    for _ in range(gone):
        leave_queue(buffer, deck, 0)
    if book.pile_open > 0.0:
        book.pile_rear += panel_velocity(buffer, state.AT.scene, deck, 0) * duration


# --- closed cohorts ------------------------------------------------------------------------------
@kernel
def keep_leader(buffer, deck):
    """Let a cohort that is about to close go on as one: its leading slice gets a slot of its own.

    Its cells become parts of it. Everything in it goes through one trajectory as long as only the
    velocity changes, and a part is the mean of this over its ages. Returns what `leader` is to say
    of the parts; 0: each is a package of its own.
    """
    book = state.book(buffer, deck)
    switch = state.switches(buffer)
    off = switch.closed_cohorts == 0.0 or switch.shared_trajectory == 0.0
    if off or deck > 0 or panel_count(buffer, deck) > 1 or not in_cells(buffer, deck):
        return 0.0
    if book.cells == 0.0 or book.covered > 0.0 or free_slots(buffer, deck) < 2:
        return 0.0
    index = new_slot(buffer, deck)
    whole = state.slot(buffer, deck, index)
    load = state.column(buffer, state.AT.load, whole)
    lead = state.column(buffer, state.AT.lead, deck)
    reference = state.node_vector(buffer, state.AT.reference, whole)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    passed = state.node_vector(buffer, state.AT.passed, whole)
    gone = state.node_vector(buffer, state.AT.lead_passed, deck)
    layers = book.lead_layers
    for i in range(fed.size):
        reference[i], passed[i] = fed[i], gone[i]
        for j in range(layers):
            load[j, i] = lead[j, i]
    state.package_vector(buffer, state.AT.layers_used, deck)[index] = layers
    velocity = panel_velocity(buffer, state.AT.scene, deck, 0)
    state.package_vector(buffer, state.AT.entry_velocity, deck)[index] = velocity
    book.leaders += 1
    return index + 1.0


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
def follow_cohort(buffer, deck, place, rear, duration):
    """Advance the leading slice of a closed cohort, whose first part has its rear at `rear` s.

    The ages of its parts after the step lie in what the slice goes through now, if that takes at
    least as long as the cohort took to come in; else, and where its front leaves the deck, it is
    parted. Returns the place behind it, or 0.
    """
    length = state.package_vector(buffer, state.AT.length, deck)
    first, end = queue_slot(buffer, deck, place), cohort_end(buffer, deck, place)
    index = int(state.package_vector(buffer, state.AT.leader, deck)[first]) - 1
    entry = state.package_vector(buffer, state.AT.entry_velocity, deck)[index]
    span = 0.0
    for k in range(place, end):
        span += length[queue_slot(buffer, deck, k)] / entry
    leaves = False
    if conveys(buffer, deck):
        front = rear + package_span(buffer, deck, first) + duration
        leaves = front > residence_time(buffer, state.AT.scene, deck)
    off = state.switches(buffer).closed_cohorts == 0.0
    if off or leaves or duration < span * (1.0 - MOMENT):
        part_cohort(buffer, deck, place)
        return 0
    ends = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)
    slots = state.vector(buffer, state.AT.part_slot, state.extent(buffer).packages, 0)
    start = max(0.0, duration - span)
    age = start
    for part in range(end - place):
        member = queue_slot(buffer, deck, end - 1 - part)
        age += length[member] / entry
        ends[part] = duration if part == end - place - 1 else min(age, duration)
        slots[part] = state.slot(buffer, deck, member)
        empty_part(buffer, deck, member, part)
    begin_parts(buffer, end - place, start)
    integrate_package(buffer, deck, index, duration)
    begin_parts(buffer, 0, 0.0)
    # What passed of the slice so far, with which the parts' own share begins.
    passed = state.node_vector(buffer, state.AT.passed, state.slot(buffer, deck, index))
    gone = state.node_vector(buffer, state.AT.column_flux, 0)
    begin = start
    for part in range(end - place):
        mean = state.node_vector(buffer, state.AT.part_passed, part)
        scale = 1.0 / (ends[part] - begin) if ends[part] > begin else 0.0
        for i in range(passed.size):
            mean[i] = passed[i] + scale * mean[i]
        begin = ends[part]
    for i in range(passed.size):
        passed[i] += gone[i]
    state.counters(buffer).cohorts_followed += 1.0
    return end


@kernel
def empty_part(buffer, deck, index, part):
    """Make a part of a cohort ready to take the mean over its new ages; what it held is kept."""
    load = state.column(buffer, state.AT.load, state.slot(buffer, deck, index))
    before = state.node_vector(buffer, state.AT.part_before, part)
    passed = state.node_vector(buffer, state.AT.part_passed, part)
    for i in range(before.size):
        before[i], passed[i] = 0.0, 0.0
    for j in range(int(state.package_vector(buffer, state.AT.layers_used, deck)[index])):
        for i in range(before.size):
            before[i] += load[j, i]
            load[j, i] = 0.0


@kernel
def take_part(buffer, deck, index, row, part):
    """Settle a part of a cohort after a step, and book what passed of it.

    That is the growth of the mean of what passed, so what is held is what was, less this: the mean
    loads say only how it lies.
    """
    whole = state.slot(buffer, deck, index)
    load = state.column(buffer, state.AT.load, whole)
    passed = state.node_vector(buffer, state.AT.passed, whole)
    before = state.node_vector(buffer, state.AT.part_before, part)
    mean = state.node_vector(buffer, state.AT.part_passed, part)
    flux = state.node_vector(buffer, state.AT.column_flux, 0)
    used = state.package_vector(buffer, state.AT.layers_used, deck)
    rows = int(max(used[index], state.book(buffer, deck).rows))
    held = state.node_vector(buffer, state.AT.node_work, 0)
    scale = state.node_vector(buffer, state.AT.node_work, 1)
    for i in range(passed.size):
        held[i] = 0.0
    for j in range(rows):
        for i in range(passed.size):
            load[j, i] = max(0.0, load[j, i])
            held[i] += load[j, i]
    for i in range(passed.size):
        flux[i] = min(before[i], max(0.0, mean[i] - passed[i]))
        passed[i] += flux[i]
        left = before[i] - flux[i]
        scale[i] = left / held[i] if held[i] > NOTHING else 0.0
    for j in range(rows):
        for i in range(passed.size):
            load[j, i] *= scale[i]
    for i in range(passed.size):
        if scale[i] == 0.0:
            load[0, i] = before[i] - flux[i]
    used[index] = restack(buffer, package_scene(buffer, deck, index), load, rows)
    area = deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
    pass_through(buffer, deck, row, area, 0.0)


# --- the pile ------------------------------------------------------------------------------------
@kernel
def open_pile(buffer, deck):
    """Begin a package on which the feed lands until it has moved by its own length."""
    book = state.book(buffer, deck)
    join_queue(buffer, deck)
    index = new_slot(buffer, deck)
    length = cell_length(buffer, deck, 0)
    state.package_vector(buffer, state.AT.length, deck)[index] = length
    join_back(buffer, deck, index)
    book.pile_open, book.pile_rear = 1.0, -length


@kernel
def feed_pile(buffer, deck, index, duration):
    """Set the feed as a source on top of the pile, kg/(m2 s)."""
    source = state.node_vector(buffer, state.AT.source, 0)
    reference = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, index))
    area = deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
    rate = state.book(buffer, deck).cohort_fed
    fraction = state.node_vector(buffer, state.AT.feed_fraction, 0)
    state.extent(buffer).source_terms = 1.0 if rate > 0.0 else 0.0
    for i in range(source.size):
        source[i] = rate * fraction[i] / area
        reference[i] += source[i] * duration


# --- the cohort ----------------------------------------------------------------------------------
@kernel
def start_cohort(buffer, deck, rate):
    """Let the slices that enter from now on share one trajectory; `rate` is the feed, kg/s.

    On a lower deck they enter empty; what was fed to the screen is only their measure of errors.
    """
    book = state.book(buffer, deck)
    scene = state.scene(buffer, state.AT.scene, deck, 0)
    lead = state.column(buffer, state.AT.lead, deck)
    partial = state.column(buffer, state.AT.partial, deck)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    passed = state.node_vector(buffer, state.AT.lead_passed, deck)
    partial_passed = state.node_vector(buffer, state.AT.partial_passed, deck)
    fraction = state.node_vector(buffer, state.AT.feed_fraction, 0)
    velocity = panel_velocity(buffer, state.AT.scene, deck, 0)
    load = rate / (deck_width(buffer, deck) * velocity) if velocity > 0.0 else 0.0
    for j in range(lead.shape[0]):
        for i in range(fed.size):
            lead[j, i], partial[j, i] = 0.0, 0.0
    for i in range(fed.size):
        fed[i] = load * fraction[i]
        passed[i], partial_passed[i] = 0.0, 0.0
        if deck == 0:
            lead[0, i] = fed[i]
    book.share = 1.0 if deck == 0 else SHARE_BELOW
    book.cohort_on, book.cohort_fed = 1.0, rate
    book.cohort_front, book.covered = 0.0, 0.0
    book.lead_panel, book.knots, book.knot = 0.0, 0.0, 0.0
    book.step, book.pace, book.wide, book.partial_layers = 0.0, 0.0, 0.0, 1.0
    book.lead_layers = restack(buffer, scene, lead, 1)


@kernel
def in_cells(buffer, deck):
    """Whether the cohort keeps cells: the top deck's does only while it is fed."""
    return deck > 0 or state.book(buffer, deck).cohort_fed > 0.0


@kernel
def join_queue(buffer, deck):
    """The cohort's cells join the queue as packages of their own; the cohort is empty after it."""
    book = state.book(buffer, deck)
    before = book.packages
    leading = 0.0
    if book.cohort_on > 0.0 and book.cohort_front > 0.0:
        leading = keep_leader(buffer, deck)
        append_piece(buffer, deck)
    cell = state.package_vector(buffer, state.AT.cell, deck)
    while book.cells > 0.0:
        book.cells -= 1
        join_back(buffer, deck, cell[book.cells])
    leader = state.package_vector(buffer, state.AT.leader, deck)
    for place in range(before, book.packages):
        leader[queue_slot(buffer, deck, place)] = leading
    book.cohort_on, book.cohort_front, book.covered = 0.0, 0.0, 0.0
    if before > 0 and before < book.packages:
        join_neighbours(buffer, deck, before - 1)


@kernel
def append_piece(buffer, deck):
    """Append the cohort's unfinished cell, or its empty stretch, to the queue."""
    book = state.book(buffer, deck)
    span = book.cohort_front
    panel = 0
    if in_cells(buffer, deck):
        if book.covered > 0.0:
            return
        cells = book.cells
        panel = cell_panel(buffer, deck, cells)
        if cells > 0:
            span -= cell_end(buffer, state.AT.scene, deck, cells - 1)
    else:
        while panel + 1 < panel_count(buffer, deck):
            if panel_end_time(buffer, state.AT.scene, deck, panel) > 0.5 * span:
                break
            panel += 1
    if span <= 0.0:
        return
    index = new_slot(buffer, deck)
    length = span * panel_velocity(buffer, state.AT.scene, deck, panel)
    state.package_vector(buffer, state.AT.on_panel, deck)[index] = panel
    if in_cells(buffer, deck):
        finish_cell(buffer, deck, index, length)
    state.package_vector(buffer, state.AT.length, deck)[index] = length
    join_back(buffer, deck, index)


@kernel
def join_neighbours(buffer, deck, place):
    """Merge the packages at `place` and behind it if they are short and alike, or both empty."""
    length = state.package_vector(buffer, state.AT.length, deck)
    one, two = queue_slot(buffer, deck, place), queue_slot(buffer, deck, place + 1)
    leader = state.package_vector(buffer, state.AT.leader, deck)
    if leader[one] + leader[two] > 0.0:
        return
    if panel_of(buffer, deck, one) != panel_of(buffer, deck, two):
        return
    loads = package_load(buffer, deck, place) + package_load(buffer, deck, place + 1)
    longest = cell_length(buffer, deck, panel_of(buffer, deck, one))
    short = length[one] + length[two] <= longest * JOIN
    if (loads == 0.0 and deck == 0) or (short and alike(buffer, deck, one, two)):
        merge_into(buffer, deck, place)


@kernel
def finish_cell(buffer, deck, index, length):
    """Turn what the cohort's unfinished cell collected (kg/m) into a package of `length` m."""
    book = state.book(buffer, deck)
    partial = state.column(buffer, state.AT.partial, deck)
    whole = state.slot(buffer, deck, index)
    load = state.column(buffer, state.AT.load, whole)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    reference = state.node_vector(buffer, state.AT.reference, whole)
    passed = state.node_vector(buffer, state.AT.passed, whole)
    collected = state.node_vector(buffer, state.AT.partial_passed, deck)
    layers = book.partial_layers
    for i in range(fed.size):
        reference[i] = fed[i]
        passed[i] = collected[i] / length
        collected[i] = 0.0
        for j in range(layers):
            load[j, i] = partial[j, i] / length
            partial[j, i] = 0.0
    scene = package_scene(buffer, deck, index)
    state.package_vector(buffer, state.AT.layers_used, deck)[index] = restack(
        buffer, scene, load, layers
    )
    state.package_vector(buffer, state.AT.length, deck)[index] = length
    book.partial_layers = 1.0


@kernel
def advance_lead(buffer, deck, duration):
    """Advance the leading slice within its panel; what passes is kept, and what the cohort does.

    lead_passed is what passed of the slice, as areal mass on the first panel [kg/m2]. With it the
    cohort behind the slice passes width x v x lead_passed [kg/s] at any moment.
    """
    book = state.book(buffer, deck)
    panel = book.lead_panel
    scene = state.scene(buffer, state.AT.scene, deck, panel)
    lead = state.column(buffer, state.AT.lead, deck)
    partial = state.column(buffer, state.AT.partial, deck)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    before_passed = state.node_vector(buffer, state.AT.lead_passed, deck)
    passed = state.node_vector(buffer, state.AT.column_flux, 0)
    passed_time = state.node_vector(buffer, state.AT.column_flux, 1)
    time = state.column(buffer, state.AT.column_time, 0)
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    fallen = state.node_vector(buffer, state.AT.fall_cohort, deck)
    carry = state.node_vector(buffer, state.AT.carry, deck)
    velocity = panel_velocity(buffer, state.AT.scene, deck, panel)
    first = panel_velocity(buffer, state.AT.scene, deck, 0)
    width = deck_width(buffer, deck)
    on_first = velocity / first if first > 0.0 else 1.0
    below = deck + 1 < state.extent(buffer).decks
    left = duration
    while left > 0.0:
        step = left
        place = place_after(buffer, state.AT.scene, deck, book.cohort_front + (duration - left))
        if deck > 0:
            step = min(left, lead_source(buffer, deck, place, velocity))
        before = book.lead_layers
        state.extent(buffer).recorded = deck + 1.0 if below else 0.0
        state.extent(buffer).recorded_from = place
        if state.extent(buffer).source_terms == 0.0 and bed_load(lead, before) == 0.0:
            clear_sums(buffer, before)
            book.rows = before
            if below:
                record_nothing(buffer, place, place + velocity * step)
        else:
            book.lead_layers = integrate(buffer, scene, book, lead, fed, before, step)
        state.extent(buffer).source_terms, state.extent(buffer).recorded = 0.0, 0.0
        rows = book.rows
        for i in range(fed.size):
            mass = width * (first * before_passed[i] * step + velocity * passed_time[i])
            undersize[i] += mass
            before_passed[i] += on_first * passed[i]
            if below:
                fallen[i] += mass
            taken = mass
            for j in range(rows):
                partial[j, i] += velocity * time[j, i]
                taken += width * velocity * time[j, i]
            if deck > 0:
                carry[i] -= taken
        book.partial_layers = max(book.partial_layers, rows)
        left -= step


@kernel
def cells_ahead(buffer, deck, duration):
    """Want the means over the cells that the slice covers in `duration` s, within its panel.

    Each becomes a part of its trajectory, also a last one that it does not finish. Returns the time
    it takes, s, and whether the last one is finished.
    """
    book = state.book(buffer, deck)
    ends = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)
    slots = state.vector(buffer, state.AT.part_slot, state.extent(buffer).packages, 0)
    cell, panel = state.package_vector(buffer, state.AT.cell, deck), book.lead_panel
    count, taken, finished = 0, 0.0, True
    while finished and taken < duration and book.cells < cell_count(buffer, deck):
        done = book.cells
        if cell_panel(buffer, deck, done) != panel:
            break
        target = cell_end(buffer, state.AT.scene, deck, done)
        until = max(0.0, target - book.cohort_front)
        finished = until <= duration or book.cohort_front + duration >= target
        taken = max(taken, min(until, duration))
        index = new_slot(buffer, deck)
        state.package_vector(buffer, state.AT.on_panel, deck)[index] = panel
        passed = state.node_vector(buffer, state.AT.part_passed, count)
        for i in range(passed.size):
            passed[i] = 0.0
        ends[count], slots[count] = taken, state.slot(buffer, deck, index)
        count += 1
        cell[done] = index
        book.cells += 1
    begin_parts(buffer, count, 0.0)
    return taken, finished


@kernel
def advance_over_cells(buffer, deck, duration):
    """Advance the leading slice of the top deck over cells, with one integration for all of them.

    As `advance_lead`, but within its panel; returns the time it took, s.
    """
    book = state.book(buffer, deck)
    before = book.cells
    taken, finished = cells_ahead(buffer, deck, duration)
    scene = state.scene(buffer, state.AT.scene, deck, book.lead_panel)
    lead = state.column(buffer, state.AT.lead, deck)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    if book.pace == 0.0 and book.cohort_front == 0.0:
        book.pace = book.first_pace
    extent = state.extent(buffer)
    extent.recorded = 1 if deck + 1 < extent.decks else 0
    extent.recorded_from = place_after(buffer, state.AT.scene, deck, book.cohort_front)
    layers = book.lead_layers
    book.lead_layers = integrate(buffer, scene, book, lead, fed, layers, taken)
    state.extent(buffer).recorded = 0.0
    begin_parts(buffer, 0, 0.0)
    last = book.cells - 1
    begin = 0.0
    for done in range(before, last + 1):
        begin = collect_cell(buffer, deck, done, done - before, begin)
        if done < last:
            end_cell(buffer, deck, done)
    passed = state.node_vector(buffer, state.AT.column_flux, 0)
    gone = state.node_vector(buffer, state.AT.lead_passed, deck)
    velocity = panel_velocity(buffer, state.AT.scene, deck, book.lead_panel)
    first = panel_velocity(buffer, state.AT.scene, deck, 0)
    for i in range(passed.size):
        gone[i] += velocity / first * passed[i]
    if finished:
        book.cohort_front = cell_end(buffer, state.AT.scene, deck, last)
        end_cell(buffer, deck, last)
    else:
        book.cohort_front += taken
        book.cells -= 1
    return taken


@kernel
def collect_cell(buffer, deck, cell, part, begin):
    """Book what a part of the slice's way passed and left in a cell; returns when it ended, s."""
    book = state.book(buffer, deck)
    index = int(state.package_vector(buffer, state.AT.cell, deck)[cell])
    end = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)[part]
    load = state.column(buffer, state.AT.load, state.slot(buffer, deck, index))
    partial = state.column(buffer, state.AT.partial, deck)
    time = state.node_vector(buffer, state.AT.part_passed, part)
    before = state.node_vector(buffer, state.AT.lead_passed, deck)
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    fallen = state.node_vector(buffer, state.AT.fall_cohort, deck)
    collected = state.node_vector(buffer, state.AT.partial_passed, deck)
    panel = panel_of(buffer, deck, index)
    velocity = panel_velocity(buffer, state.AT.scene, deck, panel)
    first = panel_velocity(buffer, state.AT.scene, deck, 0)
    rows, width = book.rows, deck_width(buffer, deck)
    carry_debts(time, load, rows)
    for i in range(time.size):
        along = first * before[i] * (end - begin) + velocity * time[i]
        collected[i] += along
        undersize[i] += width * along
        fallen[i] += width * along
        for j in range(rows):
            partial[j, i] += velocity * load[j, i]
            load[j, i] = 0.0
    book.partial_layers = max(book.partial_layers, rows)
    return end


@kernel
def cross_lead(buffer, deck):
    """Move the leading slice to the next panel: it gets longer with the velocity, and thinner."""
    book = state.book(buffer, deck)
    panel = book.lead_panel
    velocity = panel_velocity(buffer, state.AT.scene, deck, panel)
    stretch = panel_velocity(buffer, state.AT.scene, deck, panel + 1) / velocity
    lead = state.column(buffer, state.AT.lead, deck)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    layers = book.lead_layers
    for i in range(fed.size):
        fed[i] /= stretch
        for j in range(layers):
            lead[j, i] /= stretch
    book.lead_panel = panel + 1.0
    scene = state.scene(buffer, state.AT.scene, deck, panel + 1)
    book.lead_layers = restack(buffer, scene, lead, layers)


@kernel
def stream_of_covered_deck(buffer, deck, duration):
    """Undersize and oversize where the cohort covers the deck: all rates are constant."""
    book = state.book(buffer, deck)
    if not in_cells(buffer, deck):
        return
    last = panel_count(buffer, deck) - 1
    passing = deck_width(buffer, deck) * panel_velocity(buffer, state.AT.scene, deck, 0) * duration
    leaving = (
        deck_width(buffer, deck) * panel_velocity(buffer, state.AT.scene, deck, last) * duration
    )
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    oversize = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks + deck)
    fallen = state.node_vector(buffer, state.AT.fall_cohort, deck)
    passed = state.node_vector(buffer, state.AT.lead_passed, deck)
    lead = state.column(buffer, state.AT.lead, deck)
    layered = state.extent(buffer).layered > 0
    if layered and depth_at_feed(buffer, deck) > bed_capacity(buffer, deck):
        book.capacity_alarm = 1.0
    for i in range(passed.size):
        undersize[i] += passing * passed[i]
        fallen[i] += passing * passed[i]
        for j in range(book.lead_layers):
            oversize[i] += leaving * lead[j, i]


@kernel
def time_to_cover(buffer, deck):
    """Time until the cohort covers the deck, s."""
    book = state.book(buffer, deck)
    return residence_time(buffer, state.AT.scene, deck) - book.cohort_front


@kernel
def grow_cohort(buffer, deck, duration):
    """Advance the front of the cohort, cell by cell, until it covers the deck."""
    book = state.book(buffer, deck)
    left = duration
    while left > 0.0 and book.covered == 0.0:
        if not in_cells(buffer, deck):
            left -= grow_empty(buffer, deck, left)
        elif deck == 0:
            left -= advance_over_cells(buffer, deck, left)
        else:
            left -= grow_cell(buffer, deck, left)
    if left > 0.0:
        stream_of_covered_deck(buffer, deck, left)


@kernel
def grow_empty(buffer, deck, duration):
    """Advance the front of a cohort without feed; returns the time it took, s."""
    book = state.book(buffer, deck)
    target = residence_time(buffer, state.AT.scene, deck)
    until = max(0.0, target - book.cohort_front)
    if until > duration and book.cohort_front + duration < target:
        book.cohort_front += duration
        return duration
    book.cohort_front, book.covered = target, 1.0
    return min(until, duration)


@kernel
def grow_cell(buffer, deck, duration):
    """Advance the front of a lower deck's cohort within a cell; returns the time it took, s."""
    book = state.book(buffer, deck)
    done = book.cells
    target = cell_end(buffer, state.AT.scene, deck, done)
    until = max(0.0, target - book.cohort_front)
    step = min(duration, until)
    if step > 0.0:
        advance_lead(buffer, deck, step)
    if until > duration and book.cohort_front + duration < target:
        book.cohort_front += duration
        return step
    book.cohort_front = target
    index = new_slot(buffer, deck)
    state.package_vector(buffer, state.AT.on_panel, deck)[index] = cell_panel(buffer, deck, done)
    state.package_vector(buffer, state.AT.cell, deck)[done] = index
    book.cells += 1
    end_cell(buffer, deck, done)
    return step


@kernel
def end_cell(buffer, deck, cell):
    """Close a cell that the slice has covered; it goes on to the next panel, or covers the deck."""
    panel = cell_panel(buffer, deck, cell)
    index = int(state.package_vector(buffer, state.AT.cell, deck)[cell])
    finish_cell(buffer, deck, index, cell_length(buffer, deck, panel))
    if cell + 1 == cell_count(buffer, deck):
        state.book(buffer, deck).covered = 1.0
    elif cell_panel(buffer, deck, cell + 1) != panel:
        cross_lead(buffer, deck)


# --- the top deck over one step ------------------------------------------------------------------
@kernel
def advance_top(buffer, duration):
    """Advance the top deck under constant motion and feed; returns the time it took, s.

    That is less than `duration` where a pile has moved on to the deck.
    """
    book = state.book(buffer, 0)
    scene = state.scene(buffer, state.AT.scene, 0, 0)
    velocity = panel_velocity(buffer, state.AT.scene, 0, 0)
    rate = book.cohort_fed
    deepest = PILE_DEPTH * deck_length(buffer, 0) * scene.density
    slow = velocity == 0.0 or residence_time(buffer, state.AT.scene, 0) > PILE_TIME
    heavy = slow and rate > 0.0 and rate >= deck_width(buffer, 0) * velocity * deepest
    if heavy and book.pile_open == 0.0:
        open_pile(buffer, 0)
    piling = book.pile_open > 0.0
    step = duration
    if piling and velocity > 0.0:
        step = min(duration, max(0.0, -book.pile_rear / velocity))
    advance_queue(buffer, 0, step)
    if piling and velocity > 0.0 and step < duration:
        book.pile_open, book.pile_rear = 0.0, 0.0
    if not piling and velocity > 0.0:
        grow_cohort(buffer, 0, step)
    return step


@kernel
def extend_tail(buffer, deck, duration):
    """Let an empty stretch come in at the feed end of a lower deck, up to a cell long a package."""
    book = state.book(buffer, deck)
    length = state.package_vector(buffer, state.AT.length, deck)
    velocity = panel_velocity(buffer, state.AT.scene, deck, 0)
    longest = cell_length(buffer, deck, 0) * JOIN
    fresh = velocity * duration
    count = book.packages
    if count > 0:
        tail = queue_slot(buffer, deck, count - 1)
        whole = length[tail] + fresh
        if panel_of(buffer, deck, tail) == 0 and whole <= longest:
            load = state.column(buffer, state.AT.load, state.slot(buffer, deck, tail))
            reference = state.node_vector(
                buffer, state.AT.reference, state.slot(buffer, deck, tail)
            )
            used = state.package_vector(buffer, state.AT.layers_used, deck)
            part = length[tail] / whole
            for i in range(reference.size):
                reference[i] *= part
                for j in range(int(used[tail])):
                    load[j, i] *= part
            scene = package_scene(buffer, deck, tail)
            used[tail] = restack(buffer, scene, load, int(used[tail]))
            length[tail] = whole
            return
    index = new_slot(buffer, deck)
    length[index] = fresh
    join_back(buffer, deck, index)


# --- what lies on the deck -----------------------------------------------------------------------
@kernel
def held_by_node(buffer, deck, held):
    """Add what lies on a deck to `held[node]`, kg; returns its sum over the sizes."""
    book = state.book(buffer, deck)
    width = deck_width(buffer, deck)
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
    index = queue_slot(buffer, deck, place)
    used = int(state.package_vector(buffer, state.AT.layers_used, deck)[index])
    return bed_load(state.column(buffer, state.AT.load, state.slot(buffer, deck, index)), used)


@kernel
def depth_at_feed(buffer, deck):
    """Depth of the bed at the feed end, m; on a lower deck that of its first cell."""
    book = state.book(buffer, deck)
    count = book.packages
    density = state.scene(buffer, state.AT.scene, deck, 0).density
    if deck == 0 and book.pile_open == 0.0 and book.cohort_front > 0.0:
        load = book.cohort_fed / deck_width(buffer, deck)
        return load / (panel_velocity(buffer, state.AT.scene, deck, 0) * density)
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
        if not in_cells(buffer, deck):
            return 0.0
        return bed_load(state.column(buffer, state.AT.lead, deck), book.lead_layers) / density
    count = book.packages
    if count == 0:
        return 0.0
    front = queue_rear(buffer, deck)
    for place in range(count):
        front += package_span(buffer, deck, queue_slot(buffer, deck, place))
    end = deck_length(buffer, deck)
    if conveys(buffer, deck):
        end = residence_time(buffer, state.AT.scene, deck)
    slack = 1e-9 * end
    if panel_count(buffer, deck) > 1:
        # Where panels change their velocities, packages across their ends get longer or shorter.
        slack += 0.5 * package_span(buffer, deck, queue_slot(buffer, deck, 0))
    at_end = front >= end - slack
    return package_load(buffer, deck, 0) / density if at_end else 0.0
