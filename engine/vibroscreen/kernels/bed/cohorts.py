"""Packages that came in together share one trajectory."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import falls, package, ride, travel
from vibroscreen.kernels.numerics import parts, vectors
from vibroscreen.kernels.physics.layer import NOTHING


@kernel
def goes_on_as_one(buffer, deck):
    """Whether a cohort that is about to close may keep its one trajectory."""
    book, switch = state.book(buffer, deck), state.switches(buffer)
    if switch.closed_cohorts == 0.0 or switch.shared_trajectory == 0.0:
        return False
    if deck > 0 or not package.in_cells(buffer, deck) or package.free_slots(buffer, deck) < 2:
        return False
    if book.covered > 0.0:  # it may leave as a whole
        return state.extent(buffer).decks == 1
    return book.cells > 0.0 and travel.panel_count(buffer, deck) == 1


@kernel
def keep_leader(buffer, deck):
    """Let a cohort that is about to close go on as one: its leading slice gets a slot of its own.

    Its cells become parts of it. Everything in it goes through one trajectory as long as only the
    velocity changes, and a part is the mean of this over its ages. Returns what `leader` is to say
    of the parts; 0: each is a package of its own.
    """
    if not goes_on_as_one(buffer, deck):
        return 0.0
    book, index = state.book(buffer, deck), package.new_slot(buffer, deck, 0, 0.0)
    passed, fed = state.passed(buffer, deck, index), state.lead_feed(buffer, deck)
    vectors.copy(state.reference(buffer, deck, index), fed)
    vectors.copy(passed, state.lead_passed(buffer, deck))
    vectors.copy_rows(state.load(buffer, deck, index), state.lead(buffer, deck), book.lead_layers)
    state.layers_used(buffer, deck)[index] = book.lead_layers
    state.entry_velocity(buffer, deck)[index] = travel.panel_velocity(buffer, deck, 0)
    book.leaders += 1
    return index + 1.0


@kernel
def leaves_whole(buffer, duration):
    """Whether one cohort covers the only deck, as a steady one does, and leaves in `duration` s."""
    book, span = state.book(buffer, 0), 0.0
    whole = travel.residence_time(buffer, 0)
    if book.packages == 0.0 or state.extent(buffer).decks > 1 or book.cohort_front > 0.0:
        return False
    if package.leader_at(buffer, 0, 0) == 0.0 or not travel.conveys(buffer, 0):
        return False
    entry = state.entry_velocity(buffer, 0)[int(package.leader_at(buffer, 0, 0)) - 1]
    if entry != travel.panel_velocity(buffer, 0, 0) or duration < whole * (1.0 - package.MOMENT):
        return False
    end = package.cohort_end(buffer, 0, 0)
    for k in range(end):
        span += package.span_of(buffer, 0, package.slot_at(buffer, 0, k))
    return end == book.packages and abs(span - whole) <= package.MOMENT * whole


@kernel
def let_go(buffer):
    """Let a cohort that covers the deck leave it as a whole.

    As much passes of each part as of its leading slice, which is at the discharge; the rest is
    oversize.
    """
    leading = int(package.leader_at(buffer, 0, 0)) - 1
    first, before = travel.panel_velocity(buffer, 0, 0), state.part_before(buffer, 0)
    whole = state.passed(buffer, 0, leading)
    undersize, oversize = falls.undersize(buffer, 0), falls.oversize(buffer, 0)
    for k in range(state.book(buffer, 0).packages):
        index = package.slot_at(buffer, 0, k)
        area = package.area_of(buffer, 0, index)
        on_panel = first / package.velocity_of(buffer, 0, index)
        load, layers = state.load(buffer, 0, index), package.layers_of(buffer, 0, index)
        vectors.fill(before, 0.0)
        vectors.add_rows(before, 1.0, load, layers)
        passed = state.passed(buffer, 0, index)
        for i in range(before.size):
            passes = min(before[i], max(0.0, on_panel * whole[i] - passed[i]))
            undersize[i] += area * passes
            oversize[i] += area * (before[i] - passes)
    package.part_cohort(buffer, 0, 0)
    while state.book(buffer, 0).packages > 0.0:
        package.leave_queue(buffer, 0, state.book(buffer, 0).packages - 1)
    state.counters(buffer).cohorts_followed += 1.0


@kernel
def stays_together(buffer, deck, place, rear, duration, span):
    """Whether a closed cohort of `span` s stays one for a step."""
    if state.switches(buffer).closed_cohorts == 0.0 or duration < span * (1.0 - package.MOMENT):
        return False
    if not travel.conveys(buffer, deck):
        return True
    front = rear + package.span_of(buffer, deck, package.slot_at(buffer, deck, place)) + duration
    return front <= travel.residence_time(buffer, deck)


@kernel
def follow_cohort(buffer, deck, place, rear, duration):
    """Advance the leading slice of a closed cohort, whose first part has its rear at `rear` s.

    The ages of its parts after the step lie in what the slice goes through now, if that takes at
    least as long as the cohort took to come in; else, and where its front leaves the deck, it is
    parted. Returns the place behind it, or 0.
    """
    length, end = state.length(buffer, deck), package.cohort_end(buffer, deck, place)
    index = int(package.leader_at(buffer, deck, place)) - 1
    entry = state.entry_velocity(buffer, deck)[index]
    span = 0.0
    for k in range(place, end):
        span += length[package.slot_at(buffer, deck, k)] / entry
    if not stays_together(buffer, deck, place, rear, duration, span):
        package.part_cohort(buffer, deck, place)
        return 0
    ends, slots = state.part_end(buffer), state.part_slot(buffer)
    start = max(0.0, duration - span)
    age = start
    count = end - place
    for part in range(count):
        member = package.slot_at(buffer, deck, end - 1 - part)
        age += length[member] / entry
        ends[part] = duration if part == count - 1 else min(age, duration)
        slots[part] = state.slot(buffer, deck, member)
        empty_part(buffer, deck, member, part)
    parts.begin_parts(buffer, count, start)
    ride.integrate_package(buffer, deck, index, duration, 0.0)
    parts.begin_parts(buffer, 0, 0.0)
    # What passed of the slice so far, with which the parts' own share begins.
    passed = state.passed(buffer, deck, index)
    begin = start
    for part in range(count):
        mean = state.part_passed(buffer, part)
        scale = 1.0 / (ends[part] - begin) if ends[part] > begin else 0.0
        for i in range(passed.size):
            mean[i] = passed[i] + scale * mean[i]
        begin = ends[part]
    vectors.add(passed, 1.0, state.column_flux(buffer, 0))
    state.counters(buffer).cohorts_followed += 1.0
    return end


@kernel
def empty_part(buffer, deck, index, part):
    """Make a part of a cohort ready to take the mean over its new ages; what it held is kept."""
    load, layers = state.load(buffer, deck, index), package.layers_of(buffer, deck, index)
    before = state.part_before(buffer, part)
    vectors.fill(before, 0.0)
    vectors.fill(state.part_passed(buffer, part), 0.0)
    vectors.add_rows(before, 1.0, load, layers)
    vectors.clear_rows(load, 0, layers)


@kernel
def take_part(buffer, deck, index, row, part):
    """Settle a part of a cohort after a step, and book what passed of it.

    That is the growth of the mean of what passed, so what is held is what was, less this: the mean
    loads say only how it lies.
    """
    load, passed = state.load(buffer, deck, index), state.passed(buffer, deck, index)
    before, mean = state.part_before(buffer, part), state.part_passed(buffer, part)
    flux = state.column_flux(buffer, 0)
    rows = max(package.layers_of(buffer, deck, index), state.book(buffer, deck).rows)
    for i in range(passed.size):
        held = 0.0
        for j in range(rows):
            load[j, i] = max(0.0, load[j, i])
            held += load[j, i]
        flux[i] = min(before[i], max(0.0, mean[i] - passed[i]))
        passed[i] += flux[i]
        left = before[i] - flux[i]
        scale = left / held if held > NOTHING else 0.0
        for j in range(rows):
            load[j, i] *= scale
        if scale == 0.0:
            load[0, i] = left
    package.settle(buffer, deck, index, rows)
    ride.pass_through(buffer, deck, row, package.area_of(buffer, deck, index), 0.0)
