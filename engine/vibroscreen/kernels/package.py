"""One slice of the bed in time: which scheme, how long a step (MODEL.md, "A package in time").

The error estimate of a scheme sets its next step (and order); steps end at the moments at which a
layer runs out or is filled, where going past them would cost too much. Time integrals over parts
of a trajectory go to packages that share it.
"""

from __future__ import annotations

from math import ceil, sqrt

from vibroscreen.kernels import state
from vibroscreen.kernels.elementary import raised
from vibroscreen.kernels.landing import record_knot
from vibroscreen.kernels.language import kernel
from vibroscreen.kernels.rates import (
    INTEGRAL,
    K1,
    K2,
    K7,
    NOW,
    STAGED,
    active_vector,
    bed_load,
    block,
    block_load,
    block_passed,
    block_share,
    close_sizes,
    column_rates,
    fastest_rate,
    follows_share,
    gather,
    keep_top_share,
    layers_for,
    places_kept,
    reconstructed,
    restack,
    scatter,
    worst_of,
)
from vibroscreen.kernels.schemes import (
    CHAIN,
    CHAIN_LEAST,
    CHAIN_MOST,
    CHAIN_STABLE,
    OF_PART,
    PAIR,
    STABLE,
    carry_debts,
    chain_stages,
    chain_step,
    extrapolate,
    integral_in_step,
    land_in_step,
    pair_step,
    part_to_kink,
    pay_integral,
    rows_in_use,
    run_trial,
    step_error,
    sum_step,
    take_explicit,
    take_implicit,
    third_order_error,
)
from vibroscreen.kernels.segregation import CLASSIFIED, PROPORTIONAL, layer_mass

# A step that ends where a layer runs out (or is filled) may miss it by this part of a full one.
LANDING = 1e-6
# A layer that runs out may be missed by this part of the tolerance, if that is more: what is left
# of it joins the layer below, which is the top one then and need not be full.
MISS = 0.1
# A step that should end where a layer runs out goes on for so much of what is expected; one that
# would end a little before that is made longer by up to the second factor.
PAST = 1.2
STRETCH = 1.35
# A step that went past such a moment is shortened to no less than this part of it at once.
LEAST_LANDING = 0.1
# It may go past that moment where what it puts into a wrong layer is an error of at most this times
# the allowance. After the step it may be more by the second factor, as it was foretold before it.
OVER_MARGIN, FORETOLD = 2.0, 2.0
# It does so where this part at least of what it draws from the layer may be beyond what that holds.
WORTH = 0.2
# A part of `tolerance` that a step may always use, however short it is.
LEAST_SHARE = 0.05
# Steps below this part of the horizon are taken whatever the estimate says (counted).
SHORTEST = 1e-10
# Accepted steps after which sizes are looked through again.
REVIEW = 24
# Explicit schemes are not used where the pair would need more than STIFF / STABLE steps.
STIFF = 30000.0
# A first step of the pair, as a part of the longest that is stable: at a tolerance of 1e-3, and at
# most. An error of order 6 in a step meets a tolerance with its sixth root.
FIRST_PAIR, MOST_FIRST = 0.33, 0.7
# The pair's estimate is that of order 4. Of what changes smoothly at any real rate up to the
# fastest, order 5 leaves out at most this part of it, times h times fastest rate.
HIGHER, LEAST_HIGHER = 0.39, 0.02
# Estimates may be this much above the tolerance, as what they find is mostly damped later on: the
# error of a recovery stays below it (tests/benchmarks/work_precision.py). Models that sort the bed
# have a kink at every size, where no order is left; a reconstruction has them in every layer.
MARGIN = (5.0, 7.0)
MARGIN_SORTED = (3.0, 2.0)
# The same for the steps of the chain that an error of third order in a step of the pair foretells,
# and how many times as long as that step they may be.
MARGIN_WIDE = 20.0
MOST_WIDER = 5.0
# A last step may be this part longer than planned: the estimate has that much in reserve.
SLACK = 0.12
# Parts of the step that an estimate allows.
SAFETY, SAFETY_WIDE = 0.93, 0.85


# --- parts of a trajectory -----------------------------------------------------------------------
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
            integral_in_step(buffer, layers, h, a, b, scheme)
            held = block_load(buffer, state.AT.trial, OF_PART)
            if layer_mass(held, layers - 1) < 0.0:  # the step goes past the top layer
                carry_debts(block_passed(buffer, state.AT.trial, OF_PART), held, layers)
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
    before, total = block(buffer, state.AT.stage, K2), block(buffer, state.AT.stage, INTEGRAL)
    out = block(buffer, state.AT.trial, OF_PART)
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
    gone = block_passed(buffer, state.AT.trial, OF_PART)
    held = block_load(buffer, state.AT.trial, OF_PART)
    straight = places_kept(place)
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


# --- steps ---------------------------------------------------------------------------------------
@kernel
def allowance(buffer, scene, book, h):
    """Error that a step of h may have, as a part of what was fed of a size.

    A deck below has a smaller share of the tolerance, as the errors of all above it add to its own.
    """
    tolerance = state.parameters(buffer).tolerance * book.share
    horizon = scene.horizon
    return tolerance * (max(LEAST_SHARE, h / horizon) if horizon > 0.0 else LEAST_SHARE)


@kernel
def first_step(scene, duration):
    """A first implicit step: the time in which the screen could take the contact layer once, s."""
    pace = scene.passage_velocity * scene.density / scene.contact_load
    return min(duration, 0.25 / pace) if pace > 0.0 else duration


@kernel
def time_to_pass(mass, rate, slope):
    """Time in which `mass` passes at a rate that changes linearly, s; -1 if it never does."""
    root = rate * rate + 2.0 * slope * mass
    if rate <= 0.0 or root <= 0.0:
        return -1.0
    return 2.0 * mass / (rate + sqrt(root))


@kernel
def miss_of(buffer, layers, growth):
    """Part of a full layer by which a step may miss the moment of a kink."""
    if layers > 1 and growth < 0.0:
        return max(LANDING, MISS * state.parameters(buffer).tolerance)
    return LANDING


@kernel
def mass_to_kink(buffer, scene, load, layers, growth):
    """Mass that the top layer loses or gains until the rates have a kink, kg/m2; 0: none ahead.

    A layer runs out or is filled; the bed gets thinner or thicker than the contact layer.
    """
    mass = layer_mass(load, layers - 1)
    if layers > 1:
        full = scene.layer_full
        distance = mass if growth < 0.0 else full - mass
    else:
        full = scene.contact_load
        distance = mass - full if growth < 0.0 else full - mass
    return distance if distance > miss_of(buffer, layers, growth) * full else 0.0


@kernel
def misplaced(buffer, scene, layers, now, rate, over):
    """What a step puts into a wrong layer that draws `over` kg/m2 too much from the top one.

    As `worst_error` counts what lies one layer too low. The layer below, full in that step, is the
    top one in truth and shrinks: what percolates out of it does, and what settles out of it is not
    refilled. Both grow with what is drawn too much, so their integral does with its square. The
    same for every layer that runs out, down to the contact layer, which may not.
    """
    load, change = block_load(buffer, state.AT.stage, now), block_load(buffer, state.AT.stage, rate)
    share = block_share(buffer, state.AT.stage, now, layers)
    weight = active_vector(buffer, state.AT.compact, 1)
    error = active_vector(buffer, state.AT.node_work, 1)
    flux = active_vector(buffer, state.AT.node_work, 2)
    full = scene.layer_full
    row = layers - 1
    lost = -layer_mass(change, row)
    settling = lost / full
    for i in range(error.size):
        error[i], flux[i] = 0.0, -change[row, i]
    while over > 0.0 and row > 1 and lost > 0.0:
        row -= 1
        part = min(1.0, over / full)
        scale = 0.5 * part * part / settling
        over -= full
        for i in range(error.size):
            refill = lost * share[0, i] if row == layers - 2 else settling * load[row + 1, i]
            flux[i] -= change[row, i]  # all that goes down from this layer
            error[i] += scale * abs(flux[i] + refill - 2.0 * settling * load[row, i])
    return 2.0 / layers * worst_of(error, weight) if over <= 0.0 else 1e300


@kernel
def over_allowed(buffer, scene, book, layers, h, growth):
    """What a step of h may draw from the top layer beyond what it holds, kg/m2; 0: not worth it."""
    allowed = OVER_MARGIN * allowance(buffer, scene, book, h)
    drawn = -growth * h
    over = min(drawn, (layers - 2) * scene.layer_full)
    while over > WORTH * drawn:
        error = misplaced(buffer, scene, layers, NOW, K1, over)
        if error <= allowed:
            return over
        over *= 0.9 * sqrt(allowed / error)
    return 0.0


@kernel
def settle_top(buffer, scene, layers, growth):
    """Close a top layer that has run out, open one above a full one; returns the layers."""
    load = block_load(buffer, state.AT.stage, NOW)
    nodes = load.shape[1]
    full = scene.layer_full if layers > 1 else scene.contact_load
    mass = layer_mass(load, layers - 1)
    if layers > 1 and growth < 0.0 and mass <= miss_of(buffer, layers, growth) * full:
        for i in range(nodes):
            load[layers - 2, i] += load[layers - 1, i]
            load[layers - 1, i] = 0.0
        return layers - 1
    open_next = state.extent(buffer).layered > 0.0 and growth > 0.0 and layers < load.shape[0]
    if open_next and mass >= (1.0 - LANDING) * full:
        for i in range(nodes):
            load[layers, i] = 0.0
        return layers + 1
    return layers


@kernel
def top_growth(buffer, layers):
    """What the top layer gains, kg/(m2 s), by the rates in K1."""
    return layer_mass(block_load(buffer, state.AT.stage, K1), layers - 1)


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
def has_kinks(buffer):
    """Whether the rates have a kink at every size or in every layer."""
    parameter = state.parameters(buffer)
    model = parameter.segregation_model
    partly = model == PROPORTIONAL and parameter.segregation_proportion > 0.0
    return partly or model == CLASSIFIED or reconstructed(buffer)


@kernel
def first_pair(buffer, book):
    """A first step of the pair, as a part of the longest that is stable."""
    tolerance = state.parameters(buffer).tolerance * book.share
    return min(MOST_FIRST, FIRST_PAIR * raised(1e3 * tolerance, 1.0 / 6.0))


@kernel
def choose_scheme(buffer, book, fastest, left):
    """The scheme that is cheapest for the steps that accuracy and stability allow, and its step.

    The cost is rates over time: six a step of the pair, as many as stages of the others. Returns
    the scheme and h [s].
    """
    most = STABLE / fastest if fastest > 0.0 else left
    pace = book.pace if book.pace > 0.0 else first_pair(buffer, book) * most
    scheme, h = PAIR, min(pace, most)
    rates = 6
    wide = book.wide
    if wide > 0.0:
        scale = 1.0 / fastest if fastest > 0.0 else left
        for stages in range(CHAIN_LEAST, CHAIN_MOST + 1):
            reach = min(wide, CHAIN_STABLE[stages - CHAIN_LEAST] * scale)
            if stages * h < rates * reach:
                scheme, h, rates = CHAIN, reach, stages
            if reach == wide:
                break
    # Steps of one length to the end.
    return scheme, left / max(1.0, ceil(left / h - SLACK))


@kernel
def step_factor(error, scheme):
    """Next step over this one, of which `error` is the estimate as a part of what is allowed.

    What is allowed grows with the step: an error of order h^p leaves the root of order p - 1. That
    of the pair, 5, is taken as 16/3, that of the chain, 3, as 16/5: square roots are cheap.
    """
    root = sqrt(max(error, 1e-10))
    root = sqrt(root)
    if scheme == CHAIN:
        return SAFETY_WIDE / (root * sqrt(sqrt(root)))
    root = sqrt(root)
    return SAFETY / (root * sqrt(root))


@kernel
def longest_step(scheme, h, fastest):
    """A step that may be a little longer than h, but for stability, s."""
    if fastest == 0.0:
        return STRETCH * h
    most = STABLE if scheme == PAIR else CHAIN_STABLE[CHAIN_MOST - CHAIN_LEAST]
    return min(STRETCH * h, max(h, most / fastest))


@kernel
def explicit_length(
    buffer, scene, book, layers, left, growth, distance, kink, fastest, moment, shortest
):
    """Find the length of an explicit step that meets the tolerance, its stages done.

    growth: of the top layer, kg/(m2 s); distance: what it gains or loses until a kink, kg/m2; kink:
    time until then, s. Returns the length [s], the scheme, and the part of the step that lies
    before a kink; 1: all.
    """
    counter = state.counters(buffer)
    load = block_load(buffer, state.AT.stage, NOW)
    staged = block_load(buffer, state.AT.stage, STAGED)
    full = scene.layer_full if layers > 1 else scene.contact_load
    mass, miss = layer_mass(load, layers - 1), miss_of(buffer, layers, growth)
    kinks = has_kinks(buffer)
    margin = MARGIN_SORTED if kinks else MARGIN
    scheme, h = choose_scheme(buffer, book, fastest, left)
    cut = 0.0 < kink < STRETCH * h
    passes = cut and growth < 0.0 and follows_share(buffer, layers)
    if passes:
        over = over_allowed(buffer, scene, book, layers, h, growth)
        if over > 0.0:
            cut = False
            h = min(h, (mass + over) / -growth)
    if cut:
        # A little further, where the rates go on smoothly: it ends at the kink all the same.
        past = PAST * kink if layers > 1 and growth < 0.0 else kink
        h = min(past, longest_step(scheme, h, fastest), left)
    landings, first = 0, book.wide == 0.0 and state.extent(buffer).parts > 0.0
    landed = 1.0
    while True:
        allowed = margin[scheme] * allowance(buffer, scene, book, h)
        if scheme == CHAIN:
            stages = chain_stages(h * fastest)
            error = chain_step(buffer, scene, layers, h, stages, moment) / allowed
        else:
            error = pair_step(buffer, scene, layers, h, moment) / allowed
            if not kinks and state.extent(buffer).source_terms == 0.0:
                error *= max(LEAST_HIGHER, HIGHER * h * fastest)
        moved = abs(layer_mass(staged, layers - 1) - mass)
        lands = distance > 0.0 and moved > distance + miss * full and landings < 8
        if lands and passes:
            most = FORETOLD * OVER_MARGIN * allowance(buffer, scene, book, h)
            lands = misplaced(buffer, scene, layers, STAGED, K7, moved - mass) > most
        if lands:
            # Past a kink: the step ends there, and is tried anew where its error came from that.
            part = part_to_kink(buffer, layers, h, scheme, distance if growth > 0.0 else -distance)
            counter.landings += 1
            cut = True
            if error > 1.0:
                h *= max(part, LEAST_LANDING)
                landings += 1
                continue
            landed = part
        fit = h * min(5.0, max(0.2, step_factor(error, scheme)))
        if error > 1.0 and h > shortest:
            counter.column_steps_rejected += 1
            h = min(fit, 0.9 * h)
            cut = False
            continue
        if error > 1.0:
            counter.column_steps_forced += 1
        if scheme == PAIR:
            book.pace = max(fit, book.pace) if cut else fit
            if first:  # of a cohort: the next one begins with it
                book.first_pace = fit
            error = third_order_error(buffer, h, layers) * margin[PAIR] / (allowed * MARGIN_WIDE)
            book.wide = h * min(MOST_WIDER, SAFETY_WIDE / sqrt(max(error, 1e-10)))
            counter.pair_steps += 1
        else:
            book.wide = max(fit, book.wide) if cut else fit
            counter.chain_steps += 1
        return h, scheme, landed


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


@kernel
def implicit_length(buffer, scene, book, layers, left, kink, moment, shortest):
    """Find the length of an implicit step that meets the tolerance, its trials done; s."""
    counter = state.counters(buffer)
    if book.step <= 0.0:
        book.step, book.order = first_step(scene, left), 3
    while True:
        planned, order = book.step, book.order
        h = left if planned > 0.99 * left else min(planned, 0.5 * left)
        if shortest < kink < h:
            h = kink
        used = try_implicit(buffer, scene, layers, h, moment, book)
        if used < 0 and h > shortest:
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
    allowed = allowance(buffer, scene, book, h)
    counter = state.counters(buffer)
    target = book.order
    rows = rows_in_use(buffer, scene, block_load(buffer, state.AT.stage, NOW), layers, h, moment)
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
