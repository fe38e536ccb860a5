"""Outputs of a step: streams, recovery, sizes of the cut, bed, power, alarms."""

from math import pi

from vibroscreen.compiler.elementary import sin
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed import travel
from vibroscreen.kernels.bed.held import depth_at_discharge, depth_at_feed
from vibroscreen.kernels.ledger import balance_error, ledger_total
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics.layer import NOTHING
from vibroscreen.kernels.physics.motion import GRAVITY

# The bed is deep at the discharge above this many apertures.
DEEP = 4.0


@kernel
def write_stream(buffer, row, fraction, duration):
    """Fractions of a stream over the step (without flow they stay); returns its mean rate, kg/s."""
    mass = state.class_vector(buffer, state.AT.class_mass, row)
    total = vectors.total(mass)
    if total > 0.0:
        vectors.ratio(fraction, mass, total)
    return total / duration


@kernel
def apertures_of_top(buffer):
    least = most = state.panel(buffer, 0, 0).aperture
    for number in range(1, travel.panel_count(buffer, 0)):
        aperture = state.panel(buffer, 0, number).aperture
        least, most = min(least, aperture), max(most, aperture)
    return least, most


@kernel
def write_recovery(buffer):
    """Undersize recovery and efficiency of the step: of what is fed finer than the aperture.

    The recovery is that of the box, through the lowest deck; the efficiency that of the top deck.
    """
    output = state.outputs(buffer)
    size = state.node_vector(buffer, state.AT.size, 0)
    passed = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks - 1)
    passed_top = state.node_vector(buffer, state.AT.step_mass, 0)
    fraction = state.node_vector(buffer, state.AT.feed_fraction, 0)
    aperture, _ = apertures_of_top(buffer)
    fed, out, out_top = 0.0, 0.0, 0.0
    total = vectors.total(state.class_vector(buffer, state.AT.class_mass, state.FED))
    for i in range(size.size):
        if size[i] < aperture:
            fed += fraction[i] * total
            out += passed[i]
            out_top += passed_top[i]
    if fed > NOTHING:  # a feed that is hardly a number gives no ratio that is one
        output.undersize_recovery = out / fed
        output.efficiency = out_top / fed


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
def write_partition(buffer):
    """Cut size and ecart probable of the step from the partition over the nodes."""
    output = state.outputs(buffer)
    size = state.node_vector(buffer, state.AT.size, 0)
    decks = state.extent(buffer).decks
    fine = state.node_vector(buffer, state.AT.node_work, 0)
    coarse = state.node_vector(buffer, state.AT.step_mass, decks)
    # What does not leave over the top deck passes it: through all decks, or over a lower one.
    passed = state.node_vector(buffer, state.AT.step_mass, decks - 1)
    vectors.copy(fine, passed)
    for deck in range(1, decks):
        vectors.add(fine, 1.0, state.node_vector(buffer, state.AT.step_mass, decks + deck))
    _, closed = apertures_of_top(buffer)
    quarter = partition_size(size, fine, coarse, 0.25, closed)
    half = partition_size(size, fine, coarse, 0.5, closed)
    three = partition_size(size, fine, coarse, 0.75, closed)
    output.alarm_performance = 1.0 if min(quarter, half, three) <= 0.0 else 0.0
    if half != 0.0:
        output.cut_size = abs(half)
        output.ecart_probable = 0.5 * (abs(three) - abs(quarter))


@kernel
def read_partition(buffer):
    """Cut size and ecart probable, found when somebody reads them: once for a step."""
    memory = state.memory(buffer)
    if memory.unread > 0.0:
        memory.unread = 0.0
        write_partition(buffer)
        state.counters(buffer).partitions += 1.0


@kernel
def write_state(buffer):
    """Outputs that describe the moment: hold-up, depths, velocity, power, alarms."""
    output, scene = state.outputs(buffer), state.scene(buffer, state.AT.scene, 0, 0)
    parameter, inputs = state.parameters(buffer), state.inputs(buffer)
    output.hold_up = vectors.total(state.class_vector(buffer, state.AT.held, 0))
    output.transport_velocity = scene.transport_velocity
    output.throw_number = scene.throw_number
    output.alarm_bed_depth, output.alarm_capacity, output.alarm_transport = 0.0, 0.0, 0.0
    bed = 0.0
    for deck in range(state.extent(buffer).decks):
        bed += write_bed(buffer, deck)
    top = state.deck_bed(buffer, 0)
    output.depth_feed, output.depth_discharge = top.depth_feed, top.depth_discharge
    speed = 2.0 * pi * inputs.motion_frequency
    force = parameter.drive_vibrating_mass * inputs.motion_amplitude * speed * speed
    journal = 0.5 * speed * parameter.drive_bearing_diameter
    bearing = parameter.drive_bearing_friction * force * journal
    output.drive_power = (bed + bearing) / parameter.drive_efficiency
    output.balance_error = balance_error(buffer)


@kernel
def write_bed(buffer, deck):
    """Hold-up, depths, velocity and alarms of a deck; returns the power that its bed takes, W."""
    output, bed = state.outputs(buffer), state.deck_bed(buffer, deck)
    bed.hold_up = state.vector(buffer, state.AT.hold_up_work, state.extent(buffer).decks, 0)[deck]
    bed.depth_feed = depth_at_feed(buffer, deck)
    bed.depth_discharge = depth_at_discharge(buffer, deck)
    bed.transport_velocity = state.scene(buffer, state.AT.scene, deck, 0).transport_velocity
    length = travel.deck_length(buffer, deck)
    panels, power = travel.panel_count(buffer, deck), 0.0
    for number in range(panels):
        scene = state.scene(buffer, state.AT.scene, deck, number)
        fall = GRAVITY * scene.transport_velocity * sin(scene.inclination)
        share = state.panel(buffer, deck, number).length / length
        power += share * max(0.0, scene.dissipation - fall)
        if scene.transport_status >= 2.0:
            output.alarm_transport = 1.0
    if bed.depth_discharge > DEEP * state.panel(buffer, deck, panels - 1).aperture:
        output.alarm_bed_depth = 1.0
    if state.book(buffer, deck).capacity_alarm > 0.0:
        output.alarm_capacity = 1.0
    return bed.hold_up * power


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
    output = state.outputs(buffer)
    under = state.class_vector(buffer, state.AT.undersize_fraction, 0)
    over = state.class_vector(buffer, state.AT.oversize_fraction, 0)
    output.undersize_rate = write_stream(buffer, state.UNDER, under, duration)
    output.oversize_rate = write_stream(buffer, state.OVER, over, duration)
    for k in range(state.extent(buffer).decks - 1):
        fraction = state.class_vector(buffer, state.AT.intermediate_fraction, k)
        rate = write_stream(buffer, state.OVER + 1 + k, fraction, duration)
        state.intermediate(buffer, k).rate = rate
    write_recovery(buffer)
    state.memory(buffer).unread = 1.0
