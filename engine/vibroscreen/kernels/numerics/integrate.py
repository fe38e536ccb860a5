"""A column through a time: steps of the cheapest scheme until it is over."""

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.knots import record_knot
from vibroscreen.kernels.numerics import (
    blocks,
    column,
    explicit,
    implicit,
    kinks,
    pair,
    parts,
    rates,
    reconstruction,
    step_control,
    vectors,
    within,
)
from vibroscreen.kernels.numerics.layers import bed_load, layers_for, restack
from vibroscreen.kernels.physics.layer import layer_mass

# Steps below this part of the horizon are taken whatever the estimate says (counted).
SHORTEST = 1e-10
# Accepted steps after which sizes are looked through again.
REVIEW = 24
# Explicit schemes are not used where the pair would need more than STIFF / STABLE steps.
STIFF = 30000.0


@kernel
def clear_sums(buffer, rows):
    for row in range(2):
        vectors.fill(state.column_flux(buffer, row), 0.0)
    vectors.clear_rows(state.column_time(buffer), 0, rows)


@kernel
def integrate(buffer, scene, book, load, reference, layers, duration, terms):
    """Let a column go through `duration` s; returns the number of layers after it.

    `load` is advanced in place. The fields column_flux (what passed, kg/m2, and its time integral)
    and column_time (time integral of the loads, kg s/m2, in book.rows rows) hold the sums over the
    duration. `reference` is what was fed of each node, kg/m2: errors are a part of it. The first
    `terms` rows of `source` are the coefficients in time of what lands on top, kg/(m2 s^(1 + row)).
    """
    # What lands may open layers, nothing else does.
    state.work(buffer).source_terms = terms
    clear_sums(buffer, layers if terms == 0.0 else load.shape[0])
    used = layers
    step = state.step(buffer)
    step.duration, step.left = duration, duration
    step.shortest = SHORTEST * max(duration, scene.horizon)
    while step.left > 0.0:
        column.gather(buffer, scene, load, reference, layers)
        layers_for(buffer, scene, bed_load(blocks.stage_load(buffer, blocks.NOW), layers))
        before, rows = step.left, layers
        layers = advance_block(buffer, scene, book, step, layers)
        column.close_sizes(buffer, load, rows, layers, duration - before, before - step.left)
        rows = max(rows, book.rows)
        used = max(used, rows)
        implicit.pay_debts(buffer, blocks.INTEGRAL, rows)
        column.scatter(buffer, load, layers, rows, before - step.left)
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
    if step.left <= 0.0 and state.work(buffer).recorded > 0:
        if step.fresh == 0:
            rates_now(buffer, scene, layers, step.duration)
        note_passage(buffer, scene, step.duration)
    book.rows = step.most
    return layers


@kernel
def rates_now(buffer, scene, layers, moment):
    rates.keep_top_share(buffer, layers)
    rates.column_rates(buffer, scene, blocks.NOW, layers, blocks.K1, moment)


@kernel
def look_ahead(buffer, scene, step, layers):
    """Rates at the start of a step, and when the next kink comes; returns the number of layers."""
    moment = step.duration - step.left
    if step.fresh == 0:
        rates_now(buffer, scene, layers, moment)
    for attempt in range(2):
        growth = blocks.top_mass(buffer, blocks.K1, layers)
        settled = kinks.settle_top(buffer, scene, layers, growth)
        if settled == layers or (attempt == 1 and settled > layers):
            break
        layers = settled
        step.most = max(step.most, layers)
        rates_now(buffer, scene, layers, moment)
        step.before, step.length = 0.0, 0.0
    if state.work(buffer).recorded > 0:
        note_passage(buffer, scene, moment)
    growth, before, h = blocks.top_mass(buffer, blocks.K1, layers), step.before, step.length
    slope = (abs(growth) - abs(before)) / h if h > 0.0 and before * growth > 0.0 else 0.0
    load = blocks.stage_load(buffer, blocks.NOW)
    step.growth, step.distance = growth, kinks.mass_to_kink(buffer, scene, load, layers, growth)
    step.kink = -1.0
    if step.distance > 0.0:
        step.kink = kinks.time_to_pass(step.distance, abs(growth), slope)
    step.fastest = rates.fastest_rate(buffer, scene, layers)
    return layers


@kernel
def is_explicit(buffer, scene, step, layers):
    """Whether the next step is one of an explicit scheme.

    With a linear reconstruction all steps are explicit, but where the bed is deeper than its
    layers: there the implicit scheme has every layer mixed evenly.
    """
    load = blocks.stage_load(buffer, blocks.NOW)
    # A full bed that only round-off makes grow is not deep.
    least = kinks.LANDING * scene.layer_full / step.left
    full = layers == load.shape[0] and state.extent(buffer).layered > 0
    if scene.layer_full > scene.layer_load or (full and step.growth > least):
        return False
    stiff = state.switches(buffer).explicit == 0.0 or step.fastest * step.left >= STIFF
    return reconstruction.reconstructed(buffer) or not stiff


@kernel
def advance_explicit(buffer, scene, book, step, layers):
    """Take a step of an explicit scheme; returns the number of layers after it."""
    moment = step.duration - step.left
    step_control.explicit_length(buffer, scene, book, step, layers)
    h, scheme, landed = step.length, step.scheme, step.landed
    state.counters(buffer).column_steps += 1
    step.before = step.growth
    if state.work(buffer).part < state.work(buffer).parts:
        parts.add_step_to_parts(buffer, layers, h, landed * h, moment, scheme)
    ended = landed == 1.0  # with its last rates at its end
    if landed < 1.0:
        within.land_in_step(buffer, layers, h, landed, scheme)
        step.length = h * landed
    else:
        size = (layers + 1) * state.work(buffer).active
        if scheme == explicit.PAIR:
            pair.integrate_stages(buffer, h, size)
        else:
            explicit.integrate_ends(buffer, h, size)
    paid = explicit.take_explicit(buffer, layers, ended)
    if landed < 1.0:  # before debts are paid: a layer without mass would be left with some
        layers = kinks.settle_top(buffer, scene, layers, step.growth)
        step.most = max(step.most, layers)
        step.before = 0.0
    if not paid:
        load = blocks.stage_load(buffer, blocks.NOW)
        past = layer_mass(load, layers - 1) < 0.0
        implicit.pay_debts(buffer, blocks.NOW, layers)
        # Faces have debts in any layer: those that paid are filled.
        if reconstruction.reconstructed(buffer) or past:
            layers = restack(buffer, scene, load, layers)
            step.most = max(step.most, layers)
        if past:
            step.before = 0.0
    step.fresh = 1 if ended and paid else 0
    rates.keep_top_share(buffer, layers)
    return layers


@kernel
def advance_implicit(buffer, scene, book, step, layers):
    """Take a step of the implicit scheme; returns the number of layers after it."""
    moment, until = step.duration - step.left, step.left
    work = state.work(buffer)
    if work.part < work.parts:
        until = parts.time_in_part(buffer, moment, step.left)
        vectors.copy(blocks.stage(buffer, blocks.K2), blocks.stage(buffer, blocks.INTEGRAL))
    step.length = implicit.implicit_length(buffer, scene, book, step, layers, until)
    state.counters(buffer).column_steps += 1
    rows = book.rows
    layers = implicit.take_implicit(buffer, scene, rows, step.length)
    if work.part < work.parts:
        parts.add_integral_to_part(buffer, rows, step.length, moment)
    step.most = max(step.most, rows)
    if scene.layer_full > scene.layer_load:
        book.capacity_alarm = 1.0
    step.fresh = 0
    return layers


@kernel
def note_passage(buffer, scene, moment):
    """Record what has passed of the slice and passes now, for the deck below."""
    place, share = state.place(buffer), state.share(buffer)
    passed, passing = state.recorded(buffer, 0), state.recorded(buffer, 1)
    before = state.column_flux(buffer, 0)
    now, rate = blocks.stage_passed(buffer, blocks.NOW), blocks.stage_passed(buffer, blocks.K1)
    for i in range(passed.size):
        n = int(place[i])
        passed[i] = before[i]
        passing[i] = 0.0
        if n >= 0:
            passed[i] += share[i] * now[n]
            passing[i] = share[i] * rate[n]
    record_knot(buffer, state.work(buffer).recorded_from + moment * scene.transport_velocity)
