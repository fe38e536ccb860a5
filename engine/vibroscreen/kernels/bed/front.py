"""The front of the feed: what comes in under one feed and motion (MODEL.md, "The deck").

A leading slice, cells behind it, and a pile where the bed stands still.
"""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import cohorts, falls, held, knots, package, travel
from vibroscreen.kernels.numerics import implicit, integrate, parts, vectors
from vibroscreen.kernels.numerics.layers import bed_load, restack

# A feed piles up where it would lie deeper than this part of the deck's length, on a deck that
# takes longer than this to carry it to the discharge, s. One that conveys faster carries any feed.
PILE_DEPTH = 0.5
PILE_TIME = 300.0
# What a deck below may use of the tolerance.
SHARE_BELOW = 0.25


# --- a pile, and the start and the end of a cohort -----------------------------------------------
@kernel
def open_pile(buffer, deck):
    """Begin a package on which the feed lands until it has moved by its own length."""
    book = state.book(buffer, deck)
    join_queue(buffer, deck)
    length = travel.cell_length(buffer, deck, 0)
    package.join_back(buffer, deck, package.new_slot(buffer, deck, 0, length))
    book.pile_open, book.pile_rear = 1.0, -length


@kernel
def feed_pile(buffer, deck, index, duration):
    """Set the feed as a source on top of the pile, kg/(m2 s); returns its terms."""
    source, reference = state.source(buffer), state.reference(buffer, deck, index)
    area, rate = package.area_of(buffer, deck, index), state.book(buffer, deck).cohort_fed
    fraction = state.feed_fraction(buffer)
    for i in range(fraction.size):
        source[0, i] = rate * fraction[i] / area
        reference[i] += source[0, i] * duration
    return 1.0 if rate > 0.0 else 0.0


@kernel
def start_cohort(buffer, deck, rate):
    """Let the slices that enter from now on share one trajectory; `rate` is the feed, kg/s.

    On a lower deck they enter empty; what was fed to the screen is only their measure of errors.
    """
    book, partial = state.book(buffer, deck), state.partial(buffer, deck)
    velocity = travel.panel_velocity(buffer, deck, 0)
    load = rate / (state.width(buffer)[deck] * velocity) if velocity > 0.0 else 0.0
    vectors.clear_rows(partial, 0, partial.shape[0])
    vectors.fill(state.partial_passed(buffer, deck), 0.0)
    book.share = 1.0 if deck == 0 else SHARE_BELOW
    book.cohort_on, book.cohort_fed = 1.0, rate
    book.cohort_front, book.covered = 0.0, 0.0
    book.lead_panel, book.knots, book.knot = 0.0, 0.0, 0.0
    book.partial_layers = 1.0
    lay_lead(buffer, deck, load)


@kernel
def lay_lead(buffer, deck, load):
    """Begin a leading slice of `load` kg/m2 of the feed's composition, on a lower deck empty."""
    book, scene = state.book(buffer, deck), state.scene(buffer, deck, 0)
    lead, fed = state.lead(buffer, deck), state.lead_feed(buffer, deck)
    vectors.clear_rows(lead, 0, lead.shape[0])
    vectors.fill(state.lead_passed(buffer, deck), 0.0)
    vectors.multiple(fed, load, state.feed_fraction(buffer))
    if deck == 0:
        vectors.copy(state.vector(buffer, state.AT.lead, fed.size, 0), fed)
    book.step, book.pace, book.wide = 0.0, 0.0, 0.0
    book.lead_layers = restack(buffer, scene, lead, 1)


@kernel
def join_queue(buffer, deck):
    """The cohort's cells join the queue as packages of their own; the cohort is empty after it."""
    book = state.book(buffer, deck)
    before, leading = book.packages, 0.0
    if book.cohort_on > 0.0 and book.cohort_front > 0.0:
        leading = cohorts.keep_leader(buffer, deck)
        append_piece(buffer, deck)
    cell = state.cell(buffer, deck)
    while book.cells > 0.0:
        book.cells -= 1
        package.join_back(buffer, deck, cell[book.cells])
    leader = state.leader(buffer, deck)
    for place in range(before, book.packages):
        leader[package.slot_at(buffer, deck, place)] = leading
    book.cohort_on, book.cohort_front, book.covered = 0.0, 0.0, 0.0
    if before > 0 and before < book.packages:
        join_neighbours(buffer, deck, before - 1)


@kernel
def append_piece(buffer, deck):
    book = state.book(buffer, deck)
    span, panel = book.cohort_front, 0
    if package.in_cells(buffer, deck):
        if book.covered > 0.0:
            return
        cells = book.cells
        panel = travel.cell_panel(buffer, deck, cells)
        if cells > 0:
            span -= travel.cell_end(buffer, deck, cells - 1)
    else:
        while panel + 1 < travel.panel_count(buffer, deck):
            if travel.panel_end_time(buffer, deck, panel) > 0.5 * span:
                break
            panel += 1
    if span <= 0.0:
        return
    length = span * travel.panel_velocity(buffer, deck, panel)
    index = package.new_slot(buffer, deck, panel, length)
    if package.in_cells(buffer, deck):
        finish_cell(buffer, deck, index, length)
    package.join_back(buffer, deck, index)


@kernel
def join_neighbours(buffer, deck, place):
    """Merge the packages at `place` and behind it if they are short and alike, or both empty."""
    length = state.length(buffer, deck)
    one, two = package.slot_at(buffer, deck, place), package.slot_at(buffer, deck, place + 1)
    panel = package.panel_of(buffer, deck, one)
    for k in range(place, place + 2):
        if package.leader_at(buffer, deck, k) > 0.0:
            return
    if panel != package.panel_of(buffer, deck, two):
        return
    loads = package.load_of(buffer, deck, one) + package.load_of(buffer, deck, two)
    short = length[one] + length[two] <= travel.cell_length(buffer, deck, panel) * package.JOIN
    if (loads == 0.0 and deck == 0) or (short and package.alike(buffer, deck, one, two)):
        package.merge_into(buffer, deck, place)


# --- the leading slice ---------------------------------------------------------------------------
@kernel
def on_first_panel(buffer, deck):
    """Velocity of the leading slice, m/s, and that on the first panel."""
    panel = state.book(buffer, deck).lead_panel
    return travel.panel_velocity(buffer, deck, panel), travel.panel_velocity(buffer, deck, 0)


@kernel
def integrate_lead(buffer, deck, place, duration, terms):
    """Let the leading slice go through `duration` s from a place on.

    `terms`: of the source that lands on it. What passes is recorded for the deck below.
    """
    work, book = state.work(buffer), state.book(buffer, deck)
    scene, lead = state.scene(buffer, deck, book.lead_panel), state.lead(buffer, deck)
    fed = state.lead_feed(buffer, deck)
    layers = book.lead_layers
    work.recorded = deck + 1.0 if deck + 1 < state.extent(buffer).decks else 0.0
    work.recorded_from = place
    if terms == 0.0 and bed_load(lead, layers) == 0.0:
        integrate.clear_sums(buffer, layers)
        book.rows = layers
        if work.recorded > 0:
            vectors.fill(state.recorded(buffer, 0), 0.0)
            vectors.fill(state.recorded(buffer, 1), 0.0)
            knots.record_knot(buffer, place)
            knots.record_knot(buffer, place + scene.transport_velocity * duration)
    else:
        layers = integrate.integrate(buffer, scene, book, lead, fed, layers, duration, terms)
        book.lead_layers = layers
    work.recorded = 0.0


@kernel
def advance_lead(buffer, deck, duration):
    """Advance the leading slice within its panel; what passes is kept, and what the cohort does.

    lead_passed is what passed of the slice, as areal mass on the first panel [kg/m2]. With it the
    cohort behind the slice passes width x v x lead_passed [kg/s] at any moment.
    """
    book = state.book(buffer, deck)
    velocity, _ = on_first_panel(buffer, deck)
    left = duration
    while left > 0.0:
        step, terms = left, 0.0
        place = travel.place_after(buffer, deck, book.cohort_front + (duration - left))
        if deck > 0:
            holds, terms = knots.lead_source(buffer, deck, place, velocity)
            step = min(left, holds)
        integrate_lead(buffer, deck, place, step, terms)
        book_lead(buffer, deck, step)
        left -= step


@kernel
def book_lead(buffer, deck, step):
    """Book what a step of the leading slice means for it and for the cohort behind it."""
    book = state.book(buffer, deck)
    velocity, first = on_first_panel(buffer, deck)
    on_first = velocity / first if first > 0.0 else 1.0
    width, rows = state.width(buffer)[deck], book.rows
    partial, before_passed = state.partial(buffer, deck), state.lead_passed(buffer, deck)
    passed, passed_time = state.column_flux(buffer, 0), state.column_flux(buffer, 1)
    time = state.column_time(buffer)
    undersize, fallen = falls.undersize(buffer, deck), state.fall_cohort(buffer, deck)
    carry = state.carry(buffer, deck)
    below = deck + 1 < state.extent(buffer).decks
    for i in range(passed.size):
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


@kernel
def cross_lead(buffer, deck):
    """Move the leading slice to the next panel: it gets longer with the velocity, and thinner."""
    book = state.book(buffer, deck)
    panel = book.lead_panel
    velocity = travel.panel_velocity(buffer, deck, panel)
    stretch = travel.panel_velocity(buffer, deck, panel + 1) / velocity
    lead = state.lead(buffer, deck)
    layers = book.lead_layers
    vectors.divide(state.lead_feed(buffer, deck), lead, layers, stretch)
    book.lead_panel = panel + 1.0
    book.lead_layers = restack(buffer, state.scene(buffer, deck, panel + 1), lead, layers)


# --- cells ---------------------------------------------------------------------------------------
@kernel
def new_cell(buffer, deck, panel):
    book, index = state.book(buffer, deck), package.new_slot(buffer, deck, panel, 0.0)
    state.cell(buffer, deck)[book.cells] = index
    book.cells += 1
    return index


@kernel
def cells_ahead(buffer, deck, duration):
    """Want the means over the cells that the slice covers in `duration` s, within its panel.

    Each becomes a part of its trajectory, also a last one that it does not finish. Returns the time
    it takes, s, and whether the last one is finished.
    """
    book = state.book(buffer, deck)
    ends, slots = state.part_end(buffer), state.part_slot(buffer)
    count, taken, finished = 0, 0.0, True
    while finished and taken < duration and book.cells < state.extent(buffer).cells:
        if travel.cell_panel(buffer, deck, book.cells) != book.lead_panel:
            break
        target = travel.cell_end(buffer, deck, book.cells)
        until = max(0.0, target - book.cohort_front)
        finished = until <= duration or book.cohort_front + duration >= target
        taken = max(taken, min(until, duration))
        index = new_cell(buffer, deck, book.lead_panel)
        vectors.fill(state.part_passed(buffer, count), 0.0)
        ends[count], slots[count] = taken, state.slot(buffer, deck, index)
        count += 1
    parts.begin_parts(buffer, count, 0.0)
    return taken, finished


@kernel
def advance_over_cells(buffer, deck, duration):
    """Advance the leading slice of the top deck over cells, with one integration for all of them.

    As `advance_lead`, but within its panel; returns the time it took, s.
    """
    book = state.book(buffer, deck)
    before = book.cells
    taken, finished = cells_ahead(buffer, deck, duration)
    if book.pace == 0.0 and book.cohort_front == 0.0:
        book.pace = book.first_pace
    integrate_lead(buffer, deck, travel.place_after(buffer, deck, book.cohort_front), taken, 0.0)
    parts.begin_parts(buffer, 0, 0.0)
    last = book.cells - 1
    begin = 0.0
    for done in range(before, last + 1):
        begin = collect_cell(buffer, deck, done, done - before, begin)
        if done < last:
            end_cell(buffer, deck, done)
    velocity, first = on_first_panel(buffer, deck)
    vectors.add(state.lead_passed(buffer, deck), velocity / first, state.column_flux(buffer, 0))
    if finished:
        book.cohort_front = travel.cell_end(buffer, deck, last)
        end_cell(buffer, deck, last)
    else:
        book.cohort_front += taken
        book.cells -= 1
    return taken


@kernel
def collect_cell(buffer, deck, cell, part, begin):
    """Book what a part of the slice's way passed and left in a cell; returns when it ended, s."""
    book = state.book(buffer, deck)
    index = int(state.cell(buffer, deck)[cell])
    end, load = state.part_end(buffer)[part], state.load(buffer, deck, index)
    partial, time = state.partial(buffer, deck), state.part_passed(buffer, part)
    before = state.lead_passed(buffer, deck)
    undersize, fallen = falls.undersize(buffer, deck), state.fall_cohort(buffer, deck)
    collected = state.partial_passed(buffer, deck)
    velocity = package.velocity_of(buffer, deck, index)
    first = travel.panel_velocity(buffer, deck, 0)
    rows, width = book.rows, state.width(buffer)[deck]
    implicit.carry_debts(time, load, rows)
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
def finish_cell(buffer, deck, index, length):
    """Turn what the cohort's unfinished cell collected (kg/m) into a package of `length` m."""
    book, partial = state.book(buffer, deck), state.partial(buffer, deck)
    load, passed = state.load(buffer, deck, index), state.passed(buffer, deck, index)
    collected = state.partial_passed(buffer, deck)
    layers = book.partial_layers
    vectors.copy(state.reference(buffer, deck, index), state.lead_feed(buffer, deck))
    for i in range(passed.size):
        passed[i] = collected[i] / length
        for j in range(layers):
            load[j, i] = partial[j, i] / length
    vectors.fill(collected, 0.0)
    vectors.clear_rows(partial, 0, layers)
    package.settle(buffer, deck, index, layers)
    state.length(buffer, deck)[index] = length
    book.partial_layers = 1.0


@kernel
def end_cell(buffer, deck, cell):
    """Close a cell that the slice has covered; it goes on to the next panel, or covers the deck."""
    panel = travel.cell_panel(buffer, deck, cell)
    index = int(state.cell(buffer, deck)[cell])
    finish_cell(buffer, deck, index, travel.cell_length(buffer, deck, panel))
    if cell + 1 == state.extent(buffer).cells:
        state.book(buffer, deck).covered = 1.0
    elif travel.cell_panel(buffer, deck, cell + 1) != panel:
        cross_lead(buffer, deck)


# --- the cohort ----------------------------------------------------------------------------------
@kernel
def stream_of_covered_deck(buffer, deck, duration):
    """Undersize and oversize where the cohort covers the deck: all rates are constant."""
    book = state.book(buffer, deck)
    if not package.in_cells(buffer, deck):
        return
    last = travel.panel_count(buffer, deck) - 1
    width = state.width(buffer)[deck]
    passing = width * travel.panel_velocity(buffer, deck, 0) * duration
    leaving = width * travel.panel_velocity(buffer, deck, last) * duration
    deep = held.depth_at_feed(buffer, deck) > package.bed_capacity(buffer, deck)
    if state.extent(buffer).layered > 0 and deep:  # at the feed end, for what the layers hold
        book.capacity_alarm = 1.0
    passed = state.lead_passed(buffer, deck)
    vectors.add(falls.undersize(buffer, deck), passing, passed)
    vectors.add(state.fall_cohort(buffer, deck), passing, passed)
    lead = state.lead(buffer, deck)
    vectors.add_rows(falls.oversize(buffer, deck), leaving, lead, book.lead_layers)


@kernel
def time_to_cover(buffer, deck):
    return travel.residence_time(buffer, deck) - state.book(buffer, deck).cohort_front


@kernel
def grow_cohort(buffer, deck, duration):
    """Advance the front of the cohort, cell by cell, until it covers the deck."""
    book = state.book(buffer, deck)
    left = duration
    while left > 0.0 and book.covered == 0.0:
        if not package.in_cells(buffer, deck):
            taken, there = reach(book, travel.residence_time(buffer, deck), left)
            left -= taken
            book.covered = 1.0 if there else 0.0
        elif deck == 0:
            left -= advance_over_cells(buffer, deck, left)
        else:
            left -= grow_cell(buffer, deck, left)
    if left > 0.0:
        stream_of_covered_deck(buffer, deck, left)


@kernel
def reach(book, target, duration):
    """Move the front towards a riding time, s; returns the time it took and whether it is there."""
    until = max(0.0, target - book.cohort_front)
    there = until <= duration or book.cohort_front + duration >= target
    book.cohort_front = target if there else book.cohort_front + duration
    return min(until, duration), there


@kernel
def grow_cell(buffer, deck, duration):
    """Advance the front of a lower deck's cohort within a cell; returns the time it took, s."""
    book = state.book(buffer, deck)
    done = book.cells
    target = travel.cell_end(buffer, deck, done)
    step = min(duration, max(0.0, target - book.cohort_front))
    if step > 0.0:
        advance_lead(buffer, deck, step)
    _, there = reach(book, target, duration)
    if there:
        new_cell(buffer, deck, travel.cell_panel(buffer, deck, done))
        end_cell(buffer, deck, done)
    return step
