"""Packages that came in together share one trajectory."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import package, ride, travel
from vibroscreen.kernels.numerics import layers, parts
from vibroscreen.kernels.physics.layer import NOTHING


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
    if (
        off
        or deck > 0
        or travel.panel_count(buffer, deck) > 1
        or not package.in_cells(buffer, deck)
    ):
        return 0.0
    if book.cells == 0.0 or book.covered > 0.0 or package.free_slots(buffer, deck) < 2:
        return 0.0
    index = package.new_slot(buffer, deck)
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
    velocity = travel.panel_velocity(buffer, deck, 0)
    state.package_vector(buffer, state.AT.entry_velocity, deck)[index] = velocity
    book.leaders += 1
    return index + 1.0


@kernel
def follow_cohort(buffer, deck, place, rear, duration):
    """Advance the leading slice of a closed cohort, whose first part has its rear at `rear` s.

    The ages of its parts after the step lie in what the slice goes through now, if that takes at
    least as long as the cohort took to come in; else, and where its front leaves the deck, it is
    parted. Returns the place behind it, or 0.
    """
    length = state.package_vector(buffer, state.AT.length, deck)
    first, end = package.queue_slot(buffer, deck, place), package.cohort_end(buffer, deck, place)
    index = int(state.package_vector(buffer, state.AT.leader, deck)[first]) - 1
    entry = state.package_vector(buffer, state.AT.entry_velocity, deck)[index]
    span = 0.0
    for k in range(place, end):
        span += length[package.queue_slot(buffer, deck, k)] / entry
    leaves = False
    if travel.conveys(buffer, deck):
        front = rear + package.package_span(buffer, deck, first) + duration
        leaves = front > travel.residence_time(buffer, deck)
    off = state.switches(buffer).closed_cohorts == 0.0
    if off or leaves or duration < span * (1.0 - package.MOMENT):
        package.part_cohort(buffer, deck, place)
        return 0
    ends = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)
    slots = state.vector(buffer, state.AT.part_slot, state.extent(buffer).packages, 0)
    start = max(0.0, duration - span)
    age = start
    for part in range(end - place):
        member = package.queue_slot(buffer, deck, end - 1 - part)
        age += length[member] / entry
        ends[part] = duration if part == end - place - 1 else min(age, duration)
        slots[part] = state.slot(buffer, deck, member)
        empty_part(buffer, deck, member, part)
    parts.begin_parts(buffer, end - place, start)
    ride.integrate_package(buffer, deck, index, duration)
    parts.begin_parts(buffer, 0, 0.0)
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
    used[index] = layers.restack(buffer, package.package_scene(buffer, deck, index), load, rows)
    area = (
        travel.deck_width(buffer, deck) * state.package_vector(buffer, state.AT.length, deck)[index]
    )
    ride.pass_through(buffer, deck, row, area, 0.0)
