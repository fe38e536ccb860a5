"""Means over parts of a trajectory."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, column, implicit, within
from vibroscreen.kernels.physics.layer import layer_mass


@kernel
def begin_parts(buffer, count, start):
    """Want the means over `count` parts of a trajectory, the first of which begins at `start` s."""
    state.extent(buffer).parts = count
    state.extent(buffer).part = 0.0
    state.extent(buffer).parts_from = start


@kernel
def time_in_part(buffer, moment, left):
    """Time until the part at hand begins or ends, at most what is left, s."""
    ends = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)
    until = ends[state.extent(buffer).part] - moment
    if moment < state.extent(buffer).parts_from:
        until = state.extent(buffer).parts_from - moment
    return min(left, until) if until > 0.0 else left


@kernel
def add_step_to_parts(buffer, layers, h, taken, moment, scheme):
    """Add the first `taken` s of an explicit step of h, not yet taken, to the parts it meets."""
    ends = state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)
    begin = (
        state.extent(buffer).parts_from
        if state.extent(buffer).part == 0.0
        else ends[state.extent(buffer).part - 1]
    )
    while state.extent(buffer).part < state.extent(buffer).parts and begin < moment + taken:
        end = ends[state.extent(buffer).part]
        a, b = max(0.0, (begin - moment) / h), min(taken, end - moment) / h
        if b > a:
            within.integral_in_step(buffer, layers, h, a, b, scheme)
            held = blocks.trial_load(buffer, blocks.OF_PART)
            if layer_mass(held, layers - 1) < 0.0:  # the step goes past the top layer
                implicit.carry_debts(blocks.trial_passed(buffer, blocks.OF_PART), held, layers)
            give_to_part(buffer, layers, h * (b - a))
        if end > moment + taken:
            return
        begin = end
        state.extent(buffer).part += 1


@kernel
def add_integral_to_part(buffer, rows, h, moment):
    """Add a step that ends with the part at hand: INTEGRAL, less what it was before (block K2)."""
    if moment < state.extent(buffer).parts_from:
        return
    before, total = blocks.stage(buffer, blocks.K2), blocks.stage(buffer, blocks.INTEGRAL)
    out = blocks.trial(buffer, blocks.OF_PART)
    for i in range((rows + 1) * state.extent(buffer).active):
        out[i] = total[i] - before[i]
    give_to_part(buffer, rows, h)
    part = state.extent(buffer).part
    if (
        moment + h
        >= state.vector(buffer, state.AT.part_end, state.extent(buffer).packages, 0)[part]
    ):
        state.extent(buffer).part += 1


@kernel
def give_to_part(buffer, rows, duration):
    """Add block OF_PART, the integral over `duration` s, to the part at hand."""
    part, nodes = state.extent(buffer).part, state.extent(buffer).nodes
    whole = int(state.vector(buffer, state.AT.part_slot, state.extent(buffer).packages, 0)[part])
    load = state.column(buffer, state.AT.load, whole)
    passed = state.node_vector(buffer, state.AT.part_passed, part)
    place = state.node_vector(buffer, state.AT.place, 0)
    share = state.node_vector(buffer, state.AT.share, 0)
    flux = state.node_vector(buffer, state.AT.column_flux, 0)
    gone = blocks.trial_passed(buffer, blocks.OF_PART)
    held = blocks.trial_load(buffer, blocks.OF_PART)
    straight = column.places_kept(place)
    for i in range(straight):
        passed[i] += duration * flux[i] + share[i] * gone[i]
    for i in range(straight, nodes):
        passed[i] += duration * flux[i]
        n = int(place[i])
        if n >= 0:
            passed[i] += share[i] * gone[n]
    for j in range(rows):
        for i in range(straight):
            load[j, i] += share[i] * held[j, i]
        for i in range(straight, nodes):
            n = int(place[i])
            if n >= 0:
                load[j, i] += share[i] * held[j, n]
