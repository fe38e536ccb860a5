"""A column through a time: steps of the cheapest scheme until it is over."""

from __future__ import annotations

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.knots import record_knot
from vibroscreen.kernels.numerics.column import (
    INTEGRAL,
    K1,
    K2,
    NOW,
    block,
    block_load,
    block_passed,
    close_sizes,
    gather,
    scatter,
)
from vibroscreen.kernels.numerics.explicit import take_explicit
from vibroscreen.kernels.numerics.implicit import carry_debts, pay_integral, take_implicit
from vibroscreen.kernels.numerics.kinks import (
    LANDING,
    mass_to_kink,
    settle_top,
    time_to_pass,
    top_growth,
)
from vibroscreen.kernels.numerics.layers import bed_load, layers_for, restack
from vibroscreen.kernels.numerics.parts import add_integral_to_part, add_step_to_parts, time_in_part
from vibroscreen.kernels.numerics.rates import (
    column_rates,
    fastest_rate,
    keep_top_share,
    reconstructed,
)
from vibroscreen.kernels.numerics.step_control import explicit_length, implicit_length
from vibroscreen.kernels.numerics.within import land_in_step, sum_step
from vibroscreen.kernels.physics.layer import layer_mass

# Steps below this part of the horizon are taken whatever the estimate says (counted).
SHORTEST = 1e-10
# Accepted steps after which sizes are looked through again.
REVIEW = 24
# Explicit schemes are not used where the pair would need more than STIFF / STABLE steps.
STIFF = 30000.0


@kernel
def clear_sums(buffer, rows):
    """Zero the sums of `integrate` in `rows` layers."""
    for row in range(2):
        flux = state.node_vector(buffer, state.AT.column_flux, row)
        for i in range(flux.size):
            flux[i] = 0.0
    total_time = state.column(buffer, state.AT.column_time, 0)
    for j in range(rows):
        for i in range(total_time.shape[1]):
            total_time[j, i] = 0.0


@kernel
def integrate(buffer, scene, book, load, reference, layers, duration):
    """Let a column go through `duration` s; returns the number of layers after it.

    `load` is advanced in place. The fields column_flux (what passed, kg/m2, and its time integral)
    and column_time (time integral of the loads, kg s/m2, in book.rows rows) hold the sums over the
    duration.
    `reference` is what was fed of each node, kg/m2: errors are a part of it. The first
    `source_terms` rows of `source` are the coefficients in time of what lands on top,
    kg/(m2 s^(1 + row)).
    """
    # What lands may open layers, nothing else does.
    clear_sums(buffer, layers if state.extent(buffer).source_terms == 0.0 else load.shape[0])
    used = layers
    step = state.step(buffer)
    step.duration, step.left = duration, duration
    step.shortest = SHORTEST * max(duration, scene.horizon)
    while step.left > 0.0:
        gather(buffer, scene, load, reference, layers)
        layers_for(buffer, scene, bed_load(block_load(buffer, state.AT.stage, NOW), layers))
        before, rows = step.left, layers
        layers = advance_block(buffer, scene, book, step, layers)
        close_sizes(buffer, load, rows, layers, duration - before, before - step.left)
        rows = max(rows, book.rows)
        used = max(used, rows)
        pay_integral(buffer, rows)
        scatter(buffer, load, layers, rows, before - step.left)
    book.rows = used
    return layers


@kernel
def advance_block(buffer, scene, book, step, layers):
    """Up to REVIEW accepted steps of the block NOW; returns the number of layers."""
    step.most, step.fresh = layers, 0
    step.before, step.length = 0.0, 0.0
    for _ in range(REVIEW):
        if step.left <= 0.0:
            break
        layers = look_ahead(buffer, scene, step, layers)
        if is_explicit(buffer, scene, step, layers):
            layers = advance_explicit(buffer, scene, book, step, layers)
        else:
            layers = advance_implicit(buffer, scene, book, step, layers)
        step.left = 0.0 if step.length == step.left else step.left - step.length
    if step.left <= 0.0 and state.extent(buffer).recorded > 0:
        if step.fresh == 0:
            rates_now(buffer, scene, layers, step.duration)
        note_passage(buffer, scene, step.duration)
    book.rows = step.most
    return layers


@kernel
def rates_now(buffer, scene, layers, moment):
    """Rates of the block NOW into K1."""
    keep_top_share(buffer, layers)
    column_rates(buffer, scene, state.AT.stage, NOW, layers, state.AT.stage, K1, moment)


@kernel
def look_ahead(buffer, scene, step, layers):
    """Rates at the start of a step, and when the next kink comes; returns the number of layers."""
    moment = step.duration - step.left
    if step.fresh == 0:
        rates_now(buffer, scene, layers, moment)
    for attempt in range(2):
        settled = settle_top(buffer, scene, layers, top_growth(buffer, layers))
        if settled == layers or (attempt == 1 and settled > layers):
            break
        layers = settled
        step.most = max(step.most, layers)
        rates_now(buffer, scene, layers, moment)
        step.before, step.length = 0.0, 0.0
    if state.extent(buffer).recorded > 0:
        note_passage(buffer, scene, moment)
    growth, before, h = top_growth(buffer, layers), step.before, step.length
    slope = (abs(growth) - abs(before)) / h if h > 0.0 and before * growth > 0.0 else 0.0
    load = block_load(buffer, state.AT.stage, NOW)
    step.growth, step.distance = growth, mass_to_kink(buffer, scene, load, layers, growth)
    step.kink = -1.0
    if step.distance > 0.0:
        step.kink = time_to_pass(step.distance, abs(growth), slope)
    step.fastest = fastest_rate(buffer, scene, layers)
    return layers


@kernel
def is_explicit(buffer, scene, step, layers):
    """Whether the next step is one of an explicit scheme.

    With a linear reconstruction all steps are explicit, but where the bed is deeper than its
    layers: there the implicit scheme has every layer mixed evenly.
    """
    load = block_load(buffer, state.AT.stage, NOW)
    # A full bed that only round-off makes grow is not deep.
    least = LANDING * scene.layer_full / step.left
    full = layers == load.shape[0] and state.extent(buffer).layered > 0
    if scene.layer_full > scene.layer_load or (full and step.growth > least):
        return False
    stiff = state.switches(buffer).explicit == 0.0 or step.fastest * step.left >= STIFF
    return reconstructed(buffer) or not stiff


@kernel
def advance_explicit(buffer, scene, book, step, layers):
    """Take a step of an explicit scheme; returns the number of layers after it."""
    moment = step.duration - step.left
    explicit_length(buffer, scene, book, step, layers)
    h, scheme, landed = step.length, step.scheme, step.landed
    state.counters(buffer).column_steps += 1
    step.before = step.growth
    if state.extent(buffer).part < state.extent(buffer).parts:
        add_step_to_parts(buffer, layers, h, landed * h, moment, scheme)
    ended = landed == 1.0  # with its last rates at its end
    if landed < 1.0:
        land_in_step(buffer, layers, h, landed, scheme)
        step.length = h * landed
    else:
        sum_step(buffer, layers, h, scheme)
    paid = take_explicit(buffer, layers, ended)
    if landed < 1.0:  # before debts are paid: a layer without mass would be left with some
        layers = settle_top(buffer, scene, layers, step.growth)
        step.most = max(step.most, layers)
        step.before = 0.0
    if not paid:
        load = block_load(buffer, state.AT.stage, NOW)
        past = layer_mass(load, layers - 1) < 0.0
        carry_debts(block_passed(buffer, state.AT.stage, NOW), load, layers)
        # Faces have debts in any layer: those that paid are filled.
        if reconstructed(buffer) or past:
            layers = restack(buffer, scene, load, layers)
            step.most = max(step.most, layers)
        if past:
            step.before = 0.0
    step.fresh = 1 if ended and paid else 0
    keep_top_share(buffer, layers)
    return layers


@kernel
def advance_implicit(buffer, scene, book, step, layers):
    """Take a step of the implicit scheme; returns the number of layers after it."""
    moment, until = step.duration - step.left, step.left
    extent = state.extent(buffer)
    if extent.part < extent.parts:
        until = time_in_part(buffer, moment, step.left)
        before_sum = block(buffer, state.AT.stage, K2)
        sums = block(buffer, state.AT.stage, INTEGRAL)
        for i in range(sums.size):
            before_sum[i] = sums[i]
    step.length = implicit_length(buffer, scene, book, step, layers, until)
    state.counters(buffer).column_steps += 1
    rows = book.rows
    layers = take_implicit(buffer, scene, rows, step.length)
    if extent.part < extent.parts:
        add_integral_to_part(buffer, rows, step.length, moment)
    step.most = max(step.most, rows)
    if scene.layer_full > scene.layer_load:
        book.capacity_alarm = 1.0
    step.fresh = 0
    return layers


@kernel
def note_passage(buffer, scene, moment):
    """Record what has passed of the slice and passes now, for the deck below."""
    place = state.node_vector(buffer, state.AT.place, 0)
    share = state.node_vector(buffer, state.AT.share, 0)
    passed = state.node_vector(buffer, state.AT.record, 0)
    passing = state.node_vector(buffer, state.AT.record, 1)
    before = state.node_vector(buffer, state.AT.column_flux, 0)
    now, rate = block_passed(buffer, state.AT.stage, NOW), block_passed(buffer, state.AT.stage, K1)
    for i in range(passed.size):
        n = int(place[i])
        passed[i] = before[i]
        passing[i] = 0.0
        if n >= 0:
            passed[i] += share[i] * now[n]
            passing[i] = share[i] * rate[n]
    record_knot(buffer, state.extent(buffer).recorded_from + moment * scene.transport_velocity)
