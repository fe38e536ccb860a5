"""The front of the feed: what comes in under one feed and motion (MODEL.md, "The deck").

A leading slice, cells behind it, and a pile where the bed stands still.
"""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import cohorts, held, knots, package, travel
from vibroscreen.kernels.numerics import implicit, integrate, parts
from vibroscreen.kernels.numerics.layers import bed_load, restack

# A feed piles up where it would lie deeper than this part of the deck's length, on a deck that
# takes longer than this to carry it to the discharge, s. One that conveys faster carries any feed.
PILE_DEPTH = 0.5
PILE_TIME = 300.0
# What a deck below may use of the tolerance.
SHARE_BELOW = 0.25


@kernel
def open_pile(buffer, deck):
    """Begin a package on which the feed lands until it has moved by its own length."""
    book = state.book(buffer, deck)
    join_queue(buffer, deck)
    index = package.new_slot(buffer, deck)
    length = travel.cell_length(buffer, deck, 0)
    state.package_vector(buffer, state.AT.length, deck)[index] = length
    package.join_back(buffer, deck, index)
    book.pile_open, book.pile_rear = 1.0, -length


@kernel
def feed_pile(buffer, deck, index, duration):
    """Set the feed as a source on top of the pile, kg/(m2 s)."""
    source = state.node_vector(buffer, state.AT.source, 0)
    reference = state.node_vector(buffer, state.AT.reference, state.slot(buffer, deck, index))
    area = (
        travel.deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
    )
    rate = state.book(buffer, deck).cohort_fed
    fraction = state.node_vector(buffer, state.AT.feed_fraction, 0)
    state.extent(buffer).source_terms = 1.0 if rate > 0.0 else 0.0
    for i in range(source.size):
        source[i] = rate * fraction[i] / area
        reference[i] += source[i] * duration


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
    velocity = travel.panel_velocity(buffer, deck, 0)
    load = rate / (travel.deck_width(buffer, deck) * velocity) if velocity > 0.0 else 0.0
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
def join_queue(buffer, deck):
    """The cohort's cells join the queue as packages of their own; the cohort is empty after it."""
    book = state.book(buffer, deck)
    before = book.packages
    leading = 0.0
    if book.cohort_on > 0.0 and book.cohort_front > 0.0:
        leading = cohorts.keep_leader(buffer, deck)
        append_piece(buffer, deck)
    cell = state.package_vector(buffer, state.AT.cell, deck)
    while book.cells > 0.0:
        book.cells -= 1
        package.join_back(buffer, deck, cell[book.cells])
    leader = state.package_vector(buffer, state.AT.leader, deck)
    for place in range(before, book.packages):
        leader[package.queue_slot(buffer, deck, place)] = leading
    book.cohort_on, book.cohort_front, book.covered = 0.0, 0.0, 0.0
    if before > 0 and before < book.packages:
        join_neighbours(buffer, deck, before - 1)


@kernel
def append_piece(buffer, deck):
    """Append the cohort's unfinished cell, or its empty stretch, to the queue."""
    book = state.book(buffer, deck)
    span = book.cohort_front
    panel = 0
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
    index = package.new_slot(buffer, deck)
    length = span * travel.panel_velocity(buffer, deck, panel)
    state.package_vector(buffer, state.AT.on_panel, deck)[index] = panel
    if package.in_cells(buffer, deck):
        finish_cell(buffer, deck, index, length)
    state.package_vector(buffer, state.AT.length, deck)[index] = length
    package.join_back(buffer, deck, index)


@kernel
def join_neighbours(buffer, deck, place):
    """Merge the packages at `place` and behind it if they are short and alike, or both empty."""
    length = state.package_vector(buffer, state.AT.length, deck)
    one, two = package.queue_slot(buffer, deck, place), package.queue_slot(buffer, deck, place + 1)
    leader = state.package_vector(buffer, state.AT.leader, deck)
    if leader[one] + leader[two] > 0.0:
        return
    if package.panel_of(buffer, deck, one) != package.panel_of(buffer, deck, two):
        return
    loads = held.package_load(buffer, deck, place) + held.package_load(buffer, deck, place + 1)
    longest = travel.cell_length(buffer, deck, package.panel_of(buffer, deck, one))
    short = length[one] + length[two] <= longest * package.JOIN
    if (loads == 0.0 and deck == 0) or (short and package.alike(buffer, deck, one, two)):
        package.merge_into(buffer, deck, place)


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
    scene = package.package_scene(buffer, deck, index)
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
    velocity = travel.panel_velocity(buffer, deck, panel)
    first = travel.panel_velocity(buffer, deck, 0)
    width = travel.deck_width(buffer, deck)
    on_first = velocity / first if first > 0.0 else 1.0
    below = deck + 1 < state.extent(buffer).decks
    left = duration
    while left > 0.0:
        step = left
        place = travel.place_after(buffer, deck, book.cohort_front + (duration - left))
        if deck > 0:
            step = min(left, knots.lead_source(buffer, deck, place, velocity))
        before = book.lead_layers
        state.extent(buffer).recorded = deck + 1.0 if below else 0.0
        state.extent(buffer).recorded_from = place
        if state.extent(buffer).source_terms == 0.0 and bed_load(lead, before) == 0.0:
            integrate.clear_sums(buffer, before)
            book.rows = before
            if below:
                knots.record_nothing(buffer, place, place + velocity * step)
        else:
            book.lead_layers = integrate.integrate(buffer, scene, book, lead, fed, before, step)
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
    while finished and taken < duration and book.cells < travel.cell_count(buffer, deck):
        done = book.cells
        if travel.cell_panel(buffer, deck, done) != panel:
            break
        target = travel.cell_end(buffer, deck, done)
        until = max(0.0, target - book.cohort_front)
        finished = until <= duration or book.cohort_front + duration >= target
        taken = max(taken, min(until, duration))
        index = package.new_slot(buffer, deck)
        state.package_vector(buffer, state.AT.on_panel, deck)[index] = panel
        passed = state.node_vector(buffer, state.AT.part_passed, count)
        for i in range(passed.size):
            passed[i] = 0.0
        ends[count], slots[count] = taken, state.slot(buffer, deck, index)
        count += 1
        cell[done] = index
        book.cells += 1
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
    scene = state.scene(buffer, state.AT.scene, deck, book.lead_panel)
    lead = state.column(buffer, state.AT.lead, deck)
    fed = state.node_vector(buffer, state.AT.lead_feed, deck)
    if book.pace == 0.0 and book.cohort_front == 0.0:
        book.pace = book.first_pace
    extent = state.extent(buffer)
    extent.recorded = 1 if deck + 1 < extent.decks else 0
    extent.recorded_from = travel.place_after(buffer, deck, book.cohort_front)
    layers = book.lead_layers
    book.lead_layers = integrate.integrate(buffer, scene, book, lead, fed, layers, taken)
    state.extent(buffer).recorded = 0.0
    parts.begin_parts(buffer, 0, 0.0)
    last = book.cells - 1
    begin = 0.0
    for done in range(before, last + 1):
        begin = collect_cell(buffer, deck, done, done - before, begin)
        if done < last:
            end_cell(buffer, deck, done)
    passed = state.node_vector(buffer, state.AT.column_flux, 0)
    gone = state.node_vector(buffer, state.AT.lead_passed, deck)
    velocity = travel.panel_velocity(buffer, deck, book.lead_panel)
    first = travel.panel_velocity(buffer, deck, 0)
    for i in range(passed.size):
        gone[i] += velocity / first * passed[i]
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
    index = int(state.package_vector(buffer, state.AT.cell, deck)[cell])
    end = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)[part]
    load = state.column(buffer, state.AT.load, state.slot(buffer, deck, index))
    partial = state.column(buffer, state.AT.partial, deck)
    time = state.node_vector(buffer, state.AT.part_passed, part)
    before = state.node_vector(buffer, state.AT.lead_passed, deck)
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    fallen = state.node_vector(buffer, state.AT.fall_cohort, deck)
    collected = state.node_vector(buffer, state.AT.partial_passed, deck)
    panel = package.panel_of(buffer, deck, index)
    velocity = travel.panel_velocity(buffer, deck, panel)
    first = travel.panel_velocity(buffer, deck, 0)
    rows, width = book.rows, travel.deck_width(buffer, deck)
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
def cross_lead(buffer, deck):
    """Move the leading slice to the next panel: it gets longer with the velocity, and thinner."""
    book = state.book(buffer, deck)
    panel = book.lead_panel
    velocity = travel.panel_velocity(buffer, deck, panel)
    stretch = travel.panel_velocity(buffer, deck, panel + 1) / velocity
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
    if not package.in_cells(buffer, deck):
        return
    last = travel.panel_count(buffer, deck) - 1
    passing = travel.deck_width(buffer, deck) * travel.panel_velocity(buffer, deck, 0) * duration
    leaving = travel.deck_width(buffer, deck) * travel.panel_velocity(buffer, deck, last) * duration
    undersize = state.node_vector(buffer, state.AT.step_mass, deck)
    oversize = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks + deck)
    fallen = state.node_vector(buffer, state.AT.fall_cohort, deck)
    passed = state.node_vector(buffer, state.AT.lead_passed, deck)
    lead = state.column(buffer, state.AT.lead, deck)
    layered = state.extent(buffer).layered > 0
    if layered and held.depth_at_feed(buffer, deck) > package.bed_capacity(buffer, deck):
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
    return travel.residence_time(buffer, deck) - book.cohort_front


@kernel
def grow_cohort(buffer, deck, duration):
    """Advance the front of the cohort, cell by cell, until it covers the deck."""
    book = state.book(buffer, deck)
    left = duration
    while left > 0.0 and book.covered == 0.0:
        if not package.in_cells(buffer, deck):
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
    target = travel.residence_time(buffer, deck)
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
    target = travel.cell_end(buffer, deck, done)
    until = max(0.0, target - book.cohort_front)
    step = min(duration, until)
    if step > 0.0:
        advance_lead(buffer, deck, step)
    if until > duration and book.cohort_front + duration < target:
        book.cohort_front += duration
        return step
    book.cohort_front = target
    index = package.new_slot(buffer, deck)
    state.package_vector(buffer, state.AT.on_panel, deck)[index] = travel.cell_panel(
        buffer, deck, done
    )
    state.package_vector(buffer, state.AT.cell, deck)[done] = index
    book.cells += 1
    end_cell(buffer, deck, done)
    return step


@kernel
def end_cell(buffer, deck, cell):
    """Close a cell that the slice has covered; it goes on to the next panel, or covers the deck."""
    panel = travel.cell_panel(buffer, deck, cell)
    index = int(state.package_vector(buffer, state.AT.cell, deck)[cell])
    finish_cell(buffer, deck, index, travel.cell_length(buffer, deck, panel))
    if cell + 1 == travel.cell_count(buffer, deck):
        state.book(buffer, deck).covered = 1.0
    elif travel.cell_panel(buffer, deck, cell + 1) != panel:
        cross_lead(buffer, deck)
