"""An implicit step that keeps masses positive (MODEL.md, "The implicit scheme").

Of first order whatever its length; extrapolated to higher ones.
"""

from vibroscreen.compiler.elementary import raised
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, kinks, rates
from vibroscreen.kernels.numerics.column import mean_landing
from vibroscreen.kernels.numerics.layers import bed_load, layers_for, restack
from vibroscreen.kernels.physics.layer import layer_mass, weighted_mass


@kernel
def implicit_step(load, rate, down, up, pivot, stay, layers, h):
    """Solve (1 + h T_i) x = load for every size in place, T_i tridiagonal over the layers.

    The elimination is written without a subtraction (`stay` is the part of a pivot that does not
    lead upwards), so masses stay positive and sum up to round-off for any h.
    """
    nodes = load.shape[1]
    for i in range(nodes):
        stay[i] = 1.0 + h * rate[i]
    for j in range(layers - 1):
        upward = h * up[j]
        for i in range(nodes):
            pivot[j, i] = 1.0 / (stay[i] + upward)
            stay[i] = 1.0 + h * down[j + 1, i] * (stay[i] * pivot[j, i])
            load[j + 1, i] += upward * pivot[j, i] * load[j, i]
    top = layers - 1
    for i in range(nodes):
        load[top, i] /= stay[i]
    for j in range(top - 1, -1, -1):
        for i in range(nodes):
            load[j, i] = (load[j, i] + h * down[j + 1, i] * load[j + 1, i]) * pivot[j, i]


@kernel
def basic_step(buffer, scene, k, layers, h, moment):
    """One step of first order on trial k: passage and percolation, then landing and settling.

    Blocks TRIAL + 2k and + 2k + 1 hold the column and its time integral. Returns the number of
    layers after it.
    """
    trial = blocks.TRIAL + 2 * k
    load, passed = blocks.stage_load(buffer, trial), blocks.stage_passed(buffer, trial)
    column, time = blocks.stage(buffer, trial), blocks.stage(buffer, trial + 1)
    rate, contact = state.node_work(buffer, 0), state.node_work(buffer, 1)
    stay = state.node_work(buffer, 3)
    down, up = state.percolation(buffer), state.upward(buffer)
    nodes = rate.size
    cover = min(1.0, layer_mass(load, 0) / scene.contact_load)
    pace = rates.passage_factors(buffer, scene, load, load, layers, cover, contact, rate)
    for i in range(nodes):
        rate[i] = max(0.0, rate[i]) * pace * contact[i]
    for j in range(layers - 1):
        # A layer sends up as much as percolates down into it: 1/s on its mass.
        mass = layer_mass(load, j)
        up[j] = weighted_mass(load, j + 1, down, j + 1) / mass if mass > 0.0 else 0.0
    implicit_step(load, rate, down, up, state.scratch(buffer), stay, layers, h)
    for i in range(nodes):
        passed[i] += h * rate[i] * load[0, i]
    terms = state.work(buffer).source_terms
    if terms > 0:
        source = state.source_now(buffer)
        for i in range(nodes):
            load[layers - 1, i] += h * mean_landing(source, i, terms, h, moment)
    layers = restack(buffer, scene, load, layers)
    for i in range((layers + 1) * nodes):
        time[i] += h * column[i]
    return layers


@kernel
def run_trial(buffer, scene, k, layers, rows, h, moment):
    """k + 1 basic steps over h from NOW into trial k, which uses at most `rows` layers."""
    now = blocks.stage(buffer, blocks.NOW)
    trial = blocks.TRIAL + 2 * k
    column, time = blocks.stage(buffer, trial), blocks.stage(buffer, trial + 1)
    nodes = state.work(buffer).active
    for i in range((rows + 1) * nodes):
        # What passed counts from here; above the loads lies the share of the top layer.
        column[i] = now[i] if nodes <= i < (layers + 1) * nodes else 0.0
        time[i] = 0.0
    layers_for(buffer, scene, bed_load(blocks.stage_load(buffer, blocks.NOW), layers))
    part = h / (k + 1)
    for n in range(k + 1):
        layers = basic_step(buffer, scene, k, layers, part, moment + n * part)


@kernel
def rows_in_use(buffer, scene, load, layers, h, moment):
    """Layers that a step of h may need: what lands opens new ones, nothing else does."""
    terms = state.work(buffer).source_terms
    if terms == 0:
        return layers
    landing = 0.0
    source = state.source_now(buffer)
    for i in range(state.work(buffer).active):
        landing += mean_landing(source, i, terms, h, moment)
    more = layers_for(buffer, scene, bed_load(load, layers) + h * landing) + 1
    return max(layers, min(more, load.shape[0]))


@kernel
def extrapolate(buffer, k, rows):
    """Aitken-Neville on the trials 0..k; the best value lies in trial 0, the next in trial 1.

    Trial k keeps its own first-order value. `rows` is the highest number of layers in use.
    """
    size = (rows + 1) * state.work(buffer).active
    for level in range(1, k + 1):
        factor = 1.0 / ((k + 1.0) / (k + 1.0 - level) - 1.0)
        for part in range(2):
            trial = blocks.TRIAL + 2 * (k - level) + part
            better, coarse = blocks.stage(buffer, trial + 2), blocks.stage(buffer, trial)
            for i in range(size):
                coarse[i] = better[i] + factor * (better[i] - coarse[i])


@kernel
def step_error(buffer, rows):
    """Largest difference of the two best extrapolations as a part of what was fed of a size."""
    best, second = blocks.TRIAL, blocks.TRIAL + 2
    flux, coarse_flux = blocks.stage_passed(buffer, best), blocks.stage_passed(buffer, second)
    load, coarse_load = blocks.stage_load(buffer, best), blocks.stage_load(buffer, second)
    weight = state.compact(buffer, 1)
    worst = 0.0
    for i in range(weight.size):
        moved = 0.0
        for j in range(rows):
            moved += abs(load[j, i] - coarse_load[j, i])
        error = abs(flux[i] - coarse_flux[i]) + 0.5 * moved
        worst = max(worst, error * weight[i])
    return worst


@kernel
def carry_debts(flux, load, rows):
    """Pay what a high order drew below zero from the same size next to it; sums stay.

    From the top layer down to what passed, and back up if that became a debt: a size as a whole
    is never below zero, so nothing is. Such debts are of the size of the step's error.
    """
    for i in range(flux.size):
        debt = 0.0
        for j in range(rows - 1, -1, -1):
            debt += load[j, i]
            load[j, i] = max(0.0, debt)
            debt = min(0.0, debt)
        flux[i] += debt
        debt = min(0.0, flux[i])
        flux[i] = max(0.0, flux[i])
        for j in range(rows):
            debt += load[j, i]
            load[j, i] = max(0.0, debt)
            debt = min(0.0, debt)


@kernel
def pay_debts(buffer, index, rows):
    """`carry_debts` within a block."""
    carry_debts(blocks.stage_passed(buffer, index), blocks.stage_load(buffer, index), rows)


@kernel
def take_implicit(buffer, scene, rows, h):
    """Take trial 0 as the state after h and add its sums; returns the layers."""
    size = (rows + 1) * state.work(buffer).active
    now, total = blocks.stage(buffer, blocks.NOW), blocks.stage(buffer, blocks.INTEGRAL)
    best, time = blocks.stage(buffer, blocks.TRIAL), blocks.stage(buffer, blocks.TRIAL + 1)
    gone = state.work(buffer).active
    pay_debts(buffer, blocks.TRIAL, rows)
    pay_debts(buffer, blocks.TRIAL + 1, rows)
    for i in range(gone):
        total[i] += h * now[i] + time[i]
        now[i] += best[i]
    for i in range(gone, size):
        total[i] += time[i]
        now[i] = best[i]
    return restack(buffer, scene, blocks.stage_load(buffer, blocks.NOW), rows)


# --- its length and order ------------------------------------------------------------------------
@kernel
def implicit_length(buffer, scene, book, step, layers, left):
    """Find the length of an implicit step that meets the tolerance, its trials done; s."""
    counter = state.counters(buffer)
    moment = step.duration - step.left
    if book.step <= 0.0:
        # The screen could take the contact layer once in four times that.
        pace = scene.passage_velocity * scene.density / scene.contact_load
        book.step, book.order = min(left, 0.25 / pace) if pace > 0.0 else left, 3
    while True:
        planned, order = book.step, book.order
        h = left if planned > 0.99 * left else min(planned, 0.5 * left)
        if step.shortest < step.kink < h:
            h = step.kink
        used = try_implicit(buffer, scene, layers, h, moment, book)
        if used < 0 and h > step.shortest:
            counter.column_steps_rejected += 1
            continue
        if used < 0:
            counter.column_steps_forced += 1
            book.step = 4.0 * h
        elif h < planned:
            book.step, book.order = max(planned, book.step), max(order, book.order)
        return h


@kernel
def try_implicit(buffer, scene, layers, h, moment, book):
    """Raise the order until the error of a step of h meets the tolerance.

    Returns the number of trials, negative if it does not meet it; the next step and order go to
    `book`.
    """
    allowed = kinks.allowance(buffer, scene, book, h)
    counter = state.counters(buffer)
    target = book.order
    rows = rows_in_use(buffer, scene, blocks.stage_load(buffer, blocks.NOW), layers, h, moment)
    book.rows = rows
    last, last_cost, last_fit = 1.0, 1e300, h
    used = 0
    for k in range(min(target + 1, state.MAX_ORDER)):
        run_trial(buffer, scene, k, layers, rows, h, moment)
        counter.sub_steps += k + 1
        extrapolate(buffer, k, rows)
        used = k + 1
        if k == 0:
            continue
        error = max(step_error(buffer, rows) / allowed, 1e-30)
        fit = h * min(6.0, max(0.1, 0.9 * raised(0.5 / error, 1.0 / used)))
        cost = trial_cost(used) / fit
        if error <= 1.0:
            book.order, book.step = used, fit
            if last_cost < 0.9 * cost:
                book.order, book.step = used - 1, last_fit
            elif used < state.MAX_ORDER - 1:
                book.order, book.step = used + 1, trial_cost(used + 1) / cost
            return used
        gain = min(1.0, error / last) if k > 1 else 0.1
        expected = error * raised(gain, target - used)
        book.step = h * min(0.6, max(0.1, 0.9 * raised(0.5 / expected, 1.0 / target)))
        if k > 1 and expected * gain > 4.0:
            break
        last, last_cost, last_fit = error, cost, fit
    return -used


@kernel
def trial_cost(order):
    """Basic steps of an extrapolated step of this order, and one for its overhead."""
    return 1.0 + 0.5 * order * (order + 1)
