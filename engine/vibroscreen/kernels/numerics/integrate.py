"""A column through a time: steps of the cheapest scheme until it is over."""

from __future__ import annotations

from vibroscreen.kernels import state
from vibroscreen.kernels.bed.knots import record_knot
from vibroscreen.kernels.language import kernel
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
    and column_time (time integral of the loads, kg s/m2, in D_ROWS rows) hold the sums over the
    duration.
    `reference` is what was fed of each node, kg/m2: errors are a part of it. The first N_SOURCE
    rows of `source` are the coefficients in time of what lands on top, kg/(m2 s^(1 + row)).
    """
    # What lands may open layers, nothing else does.
    clear_sums(buffer, layers if state.extent(buffer).source_terms == 0.0 else load.shape[0])
    used = layers
    explicit = state.switches(buffer).explicit > 0.0
    shortest = SHORTEST * max(duration, scene.horizon)
    left = duration
    while left > 0.0:
        gather(buffer, scene, load, reference, layers)
        layers_for(buffer, scene, bed_load(block_load(buffer, state.AT.stage, NOW), layers))
        before, rows = left, layers
        layers, left = advance_block(
            buffer, scene, book, layers, duration, left, shortest, explicit
        )
        close_sizes(buffer, load, rows, layers, duration - before, before - left)
        rows = max(rows, book.rows)
        used = max(used, rows)
        pay_integral(buffer, rows)
        scatter(buffer, load, layers, rows, before - left)
    book.rows = used
    return layers


@kernel
def advance_block(buffer, scene, book, layers, duration, left, shortest, explicit):
    """Up to REVIEW accepted steps of the block NOW; returns layers and the time that is left.

    With a linear reconstruction all steps are explicit, but where the bed is deeper than its
    layers: there the implicit scheme has every layer mixed evenly.
    """
    counter = state.counters(buffer)
    load = block_load(buffer, state.AT.stage, NOW)
    most = layers
    linear = reconstructed(buffer)
    fresh = False  # whether K1 holds the rates at NOW
    before, h = 0.0, 0.0  # growth of the top layer a step ago
    for _ in range(REVIEW):
        if left <= 0.0:
            break
        moment = duration - left
        if not fresh:
            keep_top_share(buffer, layers)
            column_rates(buffer, scene, state.AT.stage, NOW, layers, state.AT.stage, K1, moment)
        for attempt in range(2):
            settled = settle_top(buffer, scene, layers, top_growth(buffer, layers))
            if settled == layers or (attempt == 1 and settled > layers):
                break
            layers = settled
            most = max(most, layers)
            keep_top_share(buffer, layers)
            column_rates(buffer, scene, state.AT.stage, NOW, layers, state.AT.stage, K1, moment)
            before, h = 0.0, 0.0
        if state.extent(buffer).recorded > 0.0:
            note_passage(buffer, scene, moment)
        growth = top_growth(buffer, layers)
        slope = (abs(growth) - abs(before)) / h if h > 0.0 and before * growth > 0.0 else 0.0
        distance = mass_to_kink(buffer, scene, load, layers, growth)
        kink = time_to_pass(distance, abs(growth), slope) if distance > 0.0 else -1.0
        fastest = fastest_rate(buffer, scene, layers)
        # A full bed that only round-off makes grow is not deep.
        least = LANDING * scene.layer_full / left
        deep = scene.layer_full > scene.layer_load or (
            layers == load.shape[0] and state.extent(buffer).layered > 0.0 and growth > least
        )
        stiff = not explicit or fastest * left >= STIFF
        if not deep and (linear or not stiff):
            h, scheme, landed = explicit_length(
                buffer, scene, book, layers, left, growth, distance, kink, fastest, moment, shortest
            )
            counter.column_steps += 1
            before = growth
            if state.extent(buffer).part < state.extent(buffer).parts:
                add_step_to_parts(buffer, layers, h, landed * h, moment, scheme)
            ended = landed == 1.0  # with its last rates at its end
            if landed < 1.0:
                land_in_step(buffer, layers, h, landed, scheme)
                h *= landed
            else:
                sum_step(buffer, layers, h, scheme)
            paid = take_explicit(buffer, layers, ended)
            if landed < 1.0:  # before debts are paid: a layer without mass would be left with some
                layers = settle_top(buffer, scene, layers, growth)
                most = max(most, layers)
                before = 0.0
            if not paid:
                past = layer_mass(load, layers - 1) < 0.0
                carry_debts(block_passed(buffer, state.AT.stage, NOW), load, layers)
                if linear or past:  # faces have debts in any layer: fill those that paid
                    layers = restack(buffer, scene, load, layers)
                    most = max(most, layers)
                before = 0.0 if past else before
            fresh = ended and paid
            keep_top_share(buffer, layers)
        else:
            until = left
            if state.extent(buffer).part < state.extent(buffer).parts:
                until = time_in_part(buffer, moment, left)
                before_sum = block(buffer, state.AT.stage, K2)
                sums = block(buffer, state.AT.stage, INTEGRAL)
                for i in range(sums.size):
                    before_sum[i] = sums[i]
            h = implicit_length(buffer, scene, book, layers, until, kink, moment, shortest)
            counter.column_steps += 1
            rows = book.rows
            layers = take_implicit(buffer, scene, rows, h)
            if state.extent(buffer).part < state.extent(buffer).parts:
                add_integral_to_part(buffer, rows, h, moment)
            most = max(most, rows)
            if scene.layer_full > scene.layer_load:
                book.capacity_alarm = 1.0
            fresh = False
        left = 0.0 if h == left else left - h
    if left <= 0.0 and state.extent(buffer).recorded > 0.0:
        if not fresh:
            keep_top_share(buffer, layers)
            column_rates(buffer, scene, state.AT.stage, NOW, layers, state.AT.stage, K1, duration)
        note_passage(buffer, scene, duration)
    book.rows = most
    return layers, left


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
