"""Outputs of a step, also of the step of 1 s that a steady solution is: box, decks, alarms."""

from math import pi

from vibroscreen.compiler.elementary import sin
from vibroscreen.compiler.language import kernel, numbers
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import falls, travel
from vibroscreen.kernels.bed.held import depth_at_discharge, depth_at_feed
from vibroscreen.kernels.bed.package import bed_capacity
from vibroscreen.kernels.checks import BED
from vibroscreen.kernels.ledger import balance_error, ledger_total
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics.bed_of_grains import BED_CONSTANTS, BED_THROW, bed_friction
from vibroscreen.kernels.physics.layer import NOTHING
from vibroscreen.kernels.physics.motion import GRAVITY
from vibroscreen.kernels.physics.opening import bar_of

# A bed is deep at the discharge above so many apertures, at bulk densities [kg/m3] up to LIGHT and
# from HEAVY on, linear between (VSMA).
DEEP_LIGHT, DEEP_HEAVY, LIGHT, HEAVY = 4.0, 5.0, 800.0, 1600.0
# No screen is built for more: depth of a bed, m; its velocity, m/s; K.
DEEPEST, FASTEST, HARDEST = 0.5, 3.0, 10.0
NOT_CONVEYED = 2.0  # status of displacement models; above it: outside of what they were checked for
ALARMS, REASONS = state.ALARMS, state.REASONS


@kernel
def write_stream(buffer, row, fraction, duration):
    """Fractions of a stream over the step (without flow they stay); returns its mean rate, kg/s."""
    mass = state.class_mass(buffer, row)
    total = vectors.total(mass)
    if total > 0.0:
        vectors.ratio(fraction, mass, total)
    return total / duration


@kernel
def least_aperture(buffer, deck):
    """Smallest aperture of a deck, m."""
    aperture = state.panel(buffer, deck, 0).aperture
    for number in range(1, travel.panel_count(buffer, deck)):
        aperture = min(aperture, state.panel(buffer, deck, number).aperture)
    return aperture


@kernel
def write_separation(buffer, deck, fed, duration):
    """Feed, products and efficiency of a deck in the step; `fed`: what the screen was fed, kg.

    Shares of what does not flow stay as they are.
    """
    result, book = state.deck_result(buffer, deck), state.book(buffer, deck)
    size = state.size(buffer)
    under, over = falls.undersize(buffer, deck), falls.oversize(buffer, deck)
    # On a lower deck falls what passed the one above in the same step.
    come = state.feed_fraction(buffer)
    if deck > 0:
        come, fed = falls.undersize(buffer, deck - 1), 1.0
    aperture = least_aperture(buffer, deck)
    fine_come, fine_under, fine_over = 0.0, 0.0, 0.0
    coarse_come, coarse_under, coarse_over = 0.0, 0.0, 0.0
    for i in range(size.size):
        if size[i] < aperture:
            fine_come += come[i] * fed
            fine_under += under[i]
            fine_over += over[i]
        else:
            coarse_come += come[i] * fed
            coarse_under += under[i]
            coarse_over += over[i]
    result.aperture = aperture
    result.feed_rate = (fine_come + coarse_come) / duration
    result.undersize_rate = (fine_under + coarse_under) / duration
    result.oversize_rate = (fine_over + coarse_over) / duration
    # A feed that is hardly a number gives no ratio that is one.
    book.unfed = 0.0 if fine_come > NOTHING else 1.0
    if fine_come > NOTHING:
        result.efficiency = fine_under / fine_come
    if fine_over + coarse_over > NOTHING:
        result.misplaced_undersize = fine_over / (fine_over + coarse_over)
    if fine_under + coarse_under > NOTHING:
        result.misplaced_oversize = coarse_under / (fine_under + coarse_under)


@entry("float64(vector, vector, vector, float64, float64)")
def partition_size(size, fine, coarse, level, closed):
    """Size whose part `level` reports to the coarse stream, m; negative: the end class instead.

    From the size `closed` on nothing passes, which the nodes beside it need not show.
    """
    before_size, before = 0.0, -1.0
    for i in range(size.size):
        total = fine[i] + coarse[i]
        if total <= 0.0:
            continue
        part = coarse[i] / total
        if part >= level:
            if before < 0.0:
                return size[i] if part == level else -size[i]
            here = size[i]
            if part == 1.0 and before_size < closed < here:
                here = closed
            return before_size + (here - before_size) * (level - before) / (part - before)
        before_size, before = size[i], part
    return -before_size


@kernel
def write_cut(buffer, deck):
    """Cut size and ecart probable of a deck in the step, from its partition over the nodes."""
    result, size = state.deck_result(buffer, deck), state.size(buffer)
    under, over = falls.undersize(buffer, deck), falls.oversize(buffer, deck)
    closed = 0.0
    for number in range(travel.panel_count(buffer, deck)):
        closed = max(closed, state.scene(buffer, deck, number).closed)
    quarter = partition_size(size, under, over, 0.25, closed)
    half = partition_size(size, under, over, 0.5, closed)
    three = partition_size(size, under, over, 0.75, closed)
    if half != 0.0:
        result.cut_size = abs(half)
        result.ecart_probable = 0.5 * (abs(three) - abs(quarter))
        result.imperfection = result.ecart_probable / result.cut_size
    return 1.0 if min(quarter, half, three) <= 0.0 else 0.0


@kernel
def finer_size(buffer, mass, share, before):
    """Size that a share of a stream is finer than, m; `before` if nothing flows.

    Each node stands for as much of its class as it weighs; there the mass lies evenly.
    """
    edge = state.edge(buffer)
    node_class, weight = state.node_class(buffer), state.node_weight(buffer)
    total = vectors.total(mass)
    if total <= NOTHING:
        return before
    missing, low, last = share * total, edge[0], -1
    for i in range(mass.size):
        k = int(node_class[i])
        low = low if k == last else edge[k]
        last = k
        width = weight[i] * (edge[k + 1] - edge[k])
        if mass[i] > 0.0 and mass[i] >= missing:
            return low + width * missing / mass[i]
        missing -= mass[i]
        low += width
    return low


@kernel
def write_sizes(buffer):
    """Sizes of the cuts of all decks, of the feed and of the products of the step."""
    output, decks = state.outputs(buffer), state.extent(buffer).decks
    output.alarm_performance = 0.0
    state.alarm(buffer, ALARMS.performance).reason = 0.0
    for deck in range(decks):
        result = state.deck_result(buffer, deck)
        missed = write_cut(buffer, deck)
        if state.book(buffer, deck).unfed > 0.0:
            alarm(buffer, ALARMS.performance, REASONS.nothing_fed, deck, 0.0, result.aperture, 0.0)
        elif missed > 0.0:
            alarm(buffer, ALARMS.performance, REASONS.no_crossing, deck, result.cut_size, 0.0, 0.0)
    top, lowest = state.deck_result(buffer, 0), falls.undersize(buffer, decks - 1)
    output.cut_size, output.ecart_probable = top.cut_size, top.ecart_probable
    if top.feed_rate > 0.0:
        fed = state.feed_fraction(buffer)
        output.feed_p80 = finer_size(buffer, fed, 0.8, output.feed_p80)
        output.feed_p50 = finer_size(buffer, fed, 0.5, output.feed_p50)
    output.undersize_p80 = finer_size(buffer, lowest, 0.8, output.undersize_p80)
    output.undersize_p50 = finer_size(buffer, lowest, 0.5, output.undersize_p50)
    output.oversize_p80 = finer_size(buffer, falls.oversize(buffer, 0), 0.8, output.oversize_p80)
    output.oversize_p50 = finer_size(buffer, falls.oversize(buffer, 0), 0.5, output.oversize_p50)
    for k in range(decks - 1):
        between, mass = state.intermediate(buffer, k), falls.oversize(buffer, k + 1)
        between.p80 = finer_size(buffer, mass, 0.8, between.p80)
        between.p50 = finer_size(buffer, mass, 0.5, between.p50)


@kernel
def read_sizes(buffer):
    """Sizes of cuts and products, found when somebody reads them: once for a step."""
    memory = state.memory(buffer)
    if memory.unread > 0.0:
        memory.unread = 0.0
        write_sizes(buffer)
        state.counters(buffer).partitions += 1.0


@kernel
def alarm(buffer, place, reason, deck, value, limit, other):
    """Set an alarm, with the first reason for it; deck -1 for the box."""
    why = state.alarm(buffer, place)
    numbers(state.outputs(buffer))[state.FIRST_ALARM + place] = 1.0
    if why.reason == 0.0:
        why.reason, why.deck = reason, deck + 1.0
        why.value, why.limit, why.other = value, limit, other


@kernel
def write_state(buffer, hold_up):
    """Outputs that describe the moment: hold-up [kg], depths, velocity, power, alarms."""
    output, parameter = state.outputs(buffer), state.parameters(buffer)
    inputs = state.inputs(buffer)
    for place in (ALARMS.bed_depth, ALARMS.capacity, ALARMS.transport, ALARMS.plausibility):
        numbers(output)[state.FIRST_ALARM + place] = 0.0
        state.alarm(buffer, place).reason = 0.0
    bed = 0.0
    for deck in range(state.extent(buffer).decks):
        bed += write_bed(buffer, deck)
        watch_bed(buffer, deck)
    top = state.deck_result(buffer, 0)
    output.hold_up = hold_up
    output.transport_velocity, output.throw_number = top.transport_velocity, top.throw_number
    output.depth_feed, output.depth_discharge = top.depth_feed, top.depth_discharge
    speed = 2.0 * pi * inputs.motion_frequency
    force = parameter.drive_vibrating_mass * inputs.motion_amplitude * speed * speed
    journal = 0.5 * speed * parameter.drive_bearing_diameter
    bearing = parameter.drive_bearing_friction * force * journal
    output.drive_power = (bed + bearing) / parameter.drive_efficiency
    output.exciter_force = force
    output.acceleration_number = inputs.motion_amplitude * speed * speed / GRAVITY
    if output.acceleration_number > HARDEST:
        number = output.acceleration_number
        alarm(buffer, ALARMS.plausibility, REASONS.implausible_motion, -1, number, HARDEST, 0.0)
    output.balance_error = balance_error(buffer)


@kernel
def write_bed(buffer, deck):
    """Hold-up, depths and velocity of a deck; returns the power that its bed takes, W."""
    result, first = state.deck_result(buffer, deck), state.scene(buffer, deck, 0)
    panels = travel.panel_count(buffer, deck)
    result.aperture = least_aperture(buffer, deck)
    result.hold_up = state.hold_up_work(buffer)[deck]
    result.depth_feed = depth_at_feed(buffer, deck)
    result.depth_discharge = depth_at_discharge(buffer, deck)
    result.depth_over_aperture_feed = result.depth_feed / first.aperture
    last = state.scene(buffer, deck, panels - 1)
    result.depth_over_aperture_discharge = result.depth_discharge / last.aperture
    result.transport_velocity, result.throw_number = first.transport_velocity, first.throw_number
    length = travel.deck_length(buffer, deck)
    power = 0.0
    for number in range(panels):
        scene = state.scene(buffer, deck, number)
        fall = GRAVITY * scene.transport_velocity * sin(scene.inclination)
        share = state.panel(buffer, deck, number).length / length
        power += share * max(0.0, scene.dissipation - fall)
    return result.hold_up * power


@kernel
def deep_in_apertures(density):
    """Depth at the discharge from which on a bed is deep, in apertures; bulk density in kg/m3."""
    share = (density - LIGHT) / (HEAVY - LIGHT)
    return DEEP_LIGHT + (DEEP_HEAVY - DEEP_LIGHT) * min(1.0, max(0.0, share))


@kernel
def watch_bed(buffer, deck):
    """Alarms of the bed of a deck."""
    result, panels = state.deck_result(buffer, deck), travel.panel_count(buffer, deck)
    times = deep_in_apertures(state.parameters(buffer).material_bulk_density)
    deep = times * state.scene(buffer, deck, panels - 1).aperture
    if result.depth_discharge > deep:
        depth = result.depth_discharge
        alarm(buffer, ALARMS.bed_depth, REASONS.deep_bed, deck, depth, deep, times)
    if state.book(buffer, deck).capacity_alarm > 0.0:
        limit = bed_capacity(buffer, deck)
        alarm(buffer, ALARMS.capacity, REASONS.full_layers, deck, result.depth_feed, limit, 0.0)
    depth = max(result.depth_feed, result.depth_discharge)
    if depth > DEEPEST:
        alarm(buffer, ALARMS.plausibility, REASONS.implausible_depth, deck, depth, DEEPEST, 0.0)
    for number in range(panels):
        scene = state.scene(buffer, deck, number)
        watch_transport(buffer, deck, scene.transport_status, scene.inclination, scene.throw_number)
        panel = state.panel(buffer, deck, number)
        if scene.seen <= 0.0 and panel.open_area > 0.0:
            reason, bar = REASONS.hidden_opening, bar_of(panel)
            alarm(buffer, ALARMS.plausibility, reason, deck, panel.aperture, bar, 0.0)
        fast = scene.transport_velocity
        if fast > FASTEST:
            reason = REASONS.implausible_velocity
            alarm(buffer, ALARMS.plausibility, reason, deck, fast, FASTEST, 0.0)


@kernel
def watch_transport(buffer, deck, status, inclination, throw):
    """Alarm of a panel by the status of its displacement model (physics/*.py)."""
    parameter = state.parameters(buffer)
    if status < NOT_CONVEYED:
        return
    friction = min(parameter.material_friction_deck, parameter.material_friction_internal)
    if status == NOT_CONVEYED:
        alarm(buffer, ALARMS.transport, REASONS.not_conveyed, deck, 0.0, 0.0, 0.0)
    elif parameter.displacement_model != BED:
        alarm(buffer, ALARMS.transport, REASONS.unchecked_motion, deck, throw, 0.0, 0.0)
    elif throw > BED_THROW:
        alarm(buffer, ALARMS.transport, REASONS.high_throw, deck, throw, BED_THROW, 0.0)
    else:
        grip = bed_friction(friction, BED_CONSTANTS[2])
        alarm(buffer, ALARMS.transport, REASONS.beyond_bed, deck, inclination, grip, 0.0)


@kernel
def write_sums(buffer):
    output = state.outputs(buffer)
    output.feed_mass = ledger_total(buffer, state.FED)
    output.undersize_mass = ledger_total(buffer, state.UNDER)
    output.oversize_mass = ledger_total(buffer, state.OVER)
    for k in range(state.extent(buffer).decks - 1):
        state.intermediate(buffer, k).mass = ledger_total(buffer, state.OVER + 1 + k)


@kernel
def write_streams(buffer, duration):
    output, under = state.outputs(buffer), state.undersize_fraction(buffer)
    over = state.oversize_fraction(buffer)
    output.undersize_rate = write_stream(buffer, state.UNDER, under, duration)
    output.oversize_rate = write_stream(buffer, state.OVER, over, duration)
    for k in range(state.extent(buffer).decks - 1):
        fraction, between = state.intermediate_fraction(buffer, k), state.intermediate(buffer, k)
        between.rate = write_stream(buffer, state.OVER + 1 + k, fraction, duration)
    fed = vectors.total(state.class_mass(buffer, state.FED))
    for deck in range(state.extent(buffer).decks):
        write_separation(buffer, deck, fed, duration)
    output.efficiency = state.deck_result(buffer, 0).efficiency
    output.undersize_recovery = output.efficiency
    state.memory(buffer).unread, state.memory(buffer).duration = 1.0, duration
