"""Means over parts of a trajectory."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, column, implicit, within
from vibroscreen.kernels.physics.layer import layer_mass


@kernel
def begin_parts(buffer, count, start):
    """Want the means over `count` parts of a trajectory, the first of which begins at `start` s."""
    work = state.work(buffer)
    work.parts, work.part, work.parts_from = count, 0.0, start


@kernel
def time_in_part(buffer, moment, left):
    """Time until the part at hand begins or ends, at most what is left, s."""
    work, ends = state.work(buffer), state.part_end(buffer)
    until = ends[work.part] - moment
    if moment < work.parts_from:
        until = work.parts_from - moment
    return min(left, until) if until > 0.0 else left


@kernel
def add_step_to_parts(buffer, layers, h, taken, moment, scheme):
    """Add the first `taken` s of an explicit step of h, not yet taken, to the parts it meets."""
    work, ends = state.work(buffer), state.part_end(buffer)
    begin = work.parts_from if work.part == 0 else ends[work.part - 1]
    while work.part < work.parts and begin < moment + taken:
        end = ends[work.part]
        a, b = max(0.0, (begin - moment) / h), min(taken, end - moment) / h
        if b > a:
            within.integral_in_step(buffer, layers, h, a, b, scheme)
            held = blocks.stage_load(buffer, blocks.OF_PART)
            if layer_mass(held, layers - 1) < 0.0:  # the step goes past the top layer
                implicit.pay_debts(buffer, blocks.OF_PART, layers)
            give_to_part(buffer, layers, h * (b - a))
        if end > moment + taken:
            return
        begin = end
        work.part += 1


@kernel
def add_integral_to_part(buffer, rows, h, moment):
    """Add a step that ends with the part at hand: INTEGRAL, less what it was before (block K2)."""
    work, ends = state.work(buffer), state.part_end(buffer)
    if moment < work.parts_from:
        return
    before, total = blocks.stage(buffer, blocks.K2), blocks.stage(buffer, blocks.INTEGRAL)
    out = blocks.stage(buffer, blocks.OF_PART)
    for i in range((rows + 1) * work.active):
        out[i] = total[i] - before[i]
    give_to_part(buffer, rows, h)
    if moment + h >= ends[work.part]:
        work.part += 1


@kernel
def give_to_part(buffer, rows, duration):
    """Add block OF_PART, the integral over `duration` s, to the part at hand."""
    part = state.work(buffer).part
    load = state.load(buffer, 0, state.part_slot(buffer)[part])
    passed = state.part_passed(buffer, part)
    place, share = state.place(buffer), state.share(buffer)
    flux, gone = state.column_flux(buffer, 0), blocks.stage_passed(buffer, blocks.OF_PART)
    for i in range(passed.size):
        n = int(place[i])
        if n == i:
            passed[i] += duration * flux[i] + share[i] * gone[i]
        else:
            passed[i] += duration * flux[i]
            passed[i] += share[i] * gone[n] if n >= 0 else 0.0
    straight = column.places_kept(place)
    column.add_spread(buffer, straight, load, blocks.stage_load(buffer, blocks.OF_PART), rows)
