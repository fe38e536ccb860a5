"""Mean velocity of a rigid body on a vibrating rough plane (Blekhman; MODEL.md, "Displacement")."""

import math

from vibroscreen.compiler.elementary import cos, tan
from vibroscreen.compiler.language import kernel, numbers, record, view1, view2
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics import motion

NODES_FUNDAMENTAL = 16
NODES_PER_ORDER = 64  # brackets a wiggle of 1e-4 of the amplitude between two nodes
PERIODS_ACCELERATED = 32  # the Poincare map is extrapolated to its fixed point
PERIODS_PLAIN = 48  # it is left alone: regimes of up to LONGEST_REGIME periods are found
LONGEST_REGIME = 16
BLOCKS = 16  # an irregular regime is the mean of BLOCKS times BLOCK_PERIODS periods
BLOCK_PERIODS = 8
SAME_STATE = 1e-12
# Laws.
FORCE, FORWARD, BACK, FLIGHT, FALL = range(5)
# Points of Gauss in -1..1 and their weights.
GAUSS = (
    (-0.9324695142031521, 0.1713244923791704),
    (-0.6612093864662645, 0.3607615730481386),
    (-0.2386191860831969, 0.4679139345726910),
    (0.2386191860831969, 0.4679139345726910),
    (0.6612093864662645, 0.3607615730481386),
    (0.9324695142031521, 0.1713244923791704),
)


# --- roots ---------------------------------------------------------------------------------------
@kernel
def _set_place(work, phase, place, derivative):
    """Write a phase and xi and eta or their derivatives there, each with the next one."""
    wave = motion.wave_of(work)
    along, normal, along_rate, normal_rate = motion.wave_at(wave, phase, derivative)
    place.phase = phase
    place.along, place.along_rate = along, along_rate
    place.normal, place.normal_rate = normal, normal_rate


@kernel
def _root(work, law, derivative, rate, low, high, falls, guess):
    """Phase between low and high where a law, or what it makes of the body, is zero.

    derivative: 0 height, 1 velocity of the body, which moves on under the law with the velocity
    `rate`; 2 the law, 3 its rate. falls: it is positive at low. Newton's method kept inside a
    shrinking bracket, so it ends; the last step is below 1e-10.
    """
    wave, body = motion.wave_of(work), motion.body_of(work)
    origin, linear, quadratic = body.phase, law.constant, 0.0
    constant = rate - law.along * body.along_rate - law.normal * body.normal_rate
    if derivative == 0:
        linear, quadratic = constant, 0.5 * law.constant
        constant = body.height - law.along * body.along - law.normal * body.normal
    elif derivative > 1:
        origin, linear, constant = 0.0, 0.0, law.constant if derivative == 2 else 0.0
    phase = guess
    for _ in range(80):
        time = phase - origin
        along, normal, along_rate, normal_rate = motion.wave_at(wave, phase, derivative)
        value = constant + time * (linear + time * quadratic)
        value = value + law.along * along + law.normal * normal
        slope = linear + 2.0 * time * quadratic
        slope = slope + law.along * along_rate + law.normal * normal_rate
        if (value > 0.0) == falls:
            low = phase
        else:
            high = phase
        following = 0.5 * (low + high)
        if abs(value) <= abs(slope) * (high - low) and slope != 0.0:
            newton = phase - value / slope
            if low <= newton <= high:
                following = newton
        step = abs(following - phase)
        phase = following
        if step < 1e-10:
            break
    return phase


# --- segments of the period ----------------------------------------------------------------------
@kernel
def _add_edge(work, phase):
    """Insert a phase among the edges of the segments, in order."""
    edge = view2(work, motion.EDGE, motion.MAX_EDGES, 8)
    count = int(work[motion.EDGES])
    if count < motion.MAX_EDGES - 1:
        k = count
        while k > 1 and edge[k - 1, 0] > phase:
            edge[k, 0] = edge[k - 1, 0]
            k -= 1
        edge[k, 0] = phase
        work[motion.EDGES] = count + 1


@kernel
def _pull(law, place):
    """What a law gives where a place holds xi'' and eta''."""
    return law.constant + law.along * place.along + law.normal * place.normal


@kernel
def _bracket_law(work, law):
    """Add the roots of a law between the two nodes, also a pair around an extremum inside."""
    low, high, place = motion.node_of(work, 0), motion.node_of(work, 1), motion.place_of(work)
    before, after = _pull(law, low), _pull(law, high)
    positive = before > 0.0
    start, end = low.phase, high.phase
    if positive != (after > 0.0):
        guess = start + (end - start) * before / (before - after)
        _add_edge(work, _root(work, law, 2, 0.0, start, end, positive, guess))
        return
    rate_before = law.along * low.along_rate + law.normal * low.normal_rate
    rate_after = law.along * high.along_rate + law.normal * high.normal_rate
    towards_zero = rate_before < 0.0 if positive else rate_before > 0.0
    if towards_zero and (rate_before > 0.0) != (rate_after > 0.0):
        top = _root(work, law, 3, 0.0, start, end, rate_before > 0.0, 0.5 * (start + end))
        _set_place(work, top, place, 2)
        if (_pull(law, place) > 0.0) != positive:
            guess = 0.5 * (start + top)
            _add_edge(work, _root(work, law, 2, 0.0, start, top, positive, guess))
            guess = 0.5 * (top + end)
            _add_edge(work, _root(work, law, 2, 0.0, top, end, not positive, guess))


@kernel
def _node_count(work):
    order = work[motion.ORDER]
    return NODES_FUNDAMENTAL if order == 1.0 else int(NODES_PER_ORDER * order)


@kernel
def _next_node(work, number):
    """Move the pair of nodes on: node 0 takes the values of node 1, node 1 those of `number`."""
    node = motion.node_of(work, 1)
    _advance(motion.node_of(work, 0), node)
    _set_place(work, 2.0 * math.pi * number / _node_count(work), node, 2)


@kernel
def _find_edges(work):
    """Cut the period into segments in which no law changes its sign; the signs go with them."""
    edge, place = view2(work, motion.EDGE, motion.MAX_EDGES, 8), motion.place_of(work)
    edge[0, 0] = 0.0
    work[motion.EDGES] = 1.0
    _next_node(work, 0)
    for number in range(1, _node_count(work) + 1):
        _next_node(work, number)
        for row in range(FORCE, BACK + 1):
            _bracket_law(work, motion.law_of(work, row))
    count = int(work[motion.EDGES])
    edge[count, 0] = 2.0 * math.pi
    work[motion.EDGES] = count + 1
    for k in range(count + 1):
        _set_place(work, edge[k, 0], motion.edge_of(work, k), 0)
        if k < count:
            _set_place(work, 0.5 * (edge[k, 0] + edge[k + 1, 0]), place, 2)
            for row in range(FORCE, BACK + 1):
                pulls = _pull(motion.law_of(work, row), place) > 0.0
                edge[k, 5 + row] = 1.0 if pulls else -1.0


# --- slip and flight -----------------------------------------------------------------------------
@kernel
def _gain(law, body, place):
    """Velocity that a law adds between the body's phase and place."""
    gain = law.constant * (place.phase - body.phase)
    gain = gain + law.along * (place.along_rate - body.along_rate)
    return gain + law.normal * (place.normal_rate - body.normal_rate)


@kernel
def _path(law, body, place, rate):
    """Distance under a law from the body's phase to place, starting with velocity `rate`."""
    time = place.phase - body.phase
    along = place.along - body.along - body.along_rate * time
    normal = place.normal - body.normal - body.normal_rate * time
    return time * (rate + 0.5 * law.constant * time) + law.along * along + law.normal * normal


@kernel
def _advance(body, place):
    body.phase = place.phase
    body.along, body.along_rate = place.along, place.along_rate
    body.normal, body.normal_rate = place.normal, place.normal_rate


@kernel
def _friction_loss(work, law, end):
    """Friction work mu n |s'| from the body's phase to `end` while it slips under a law."""
    body, wave = motion.body_of(work), motion.wave_of(work)
    panels = 1 + int((end - body.phase) * work[motion.ORDER])
    half = 0.5 * (end - body.phase) / panels
    loss = 0.0
    for panel in range(panels):
        for point, weight in GAUSS:
            phase = body.phase + half * (2 * panel + 1 + point)
            along, normal, _, normal_rate = motion.wave_at(wave, phase, 1)
            slip = body.slip + law.constant * (phase - body.phase)
            slip += law.along * (along - body.along_rate) + law.normal * (normal - body.normal_rate)
            loss += weight * abs(slip * law.normal * (1.0 + normal_rate))
    return half * loss


@kernel
def _slip(work, row, segment):
    """Slip FORWARD or BACK to the end of the segment or until it stops."""
    law, body, place = motion.law_of(work, row), motion.body_of(work), motion.place_of(work)
    end = motion.edge_of(work, segment + 1)
    forward = row == FORWARD
    slows = (work[motion.EDGE + 8 * segment + 5 + row] < 0.0) == forward
    velocity = body.slip + _gain(law, body, end)
    stopped = velocity <= 0.0 if forward else velocity >= 0.0
    _advance(place, end)
    if stopped and slows:
        guess = body.phase + (end.phase - body.phase) * body.slip / (body.slip - velocity)
        stop = _root(work, law, 1, body.slip, body.phase, end.phase, forward, guess)
        _set_place(work, stop, place, 0)
    body.travel += _path(law, body, place, body.slip)
    if body.measured > 0.0:
        body.loss += _friction_loss(work, law, place.phase)
    body.slip = 0.0 if stopped else velocity
    body.least = min(body.least, abs(body.slip))
    _advance(body, place)


@kernel
def _landing(work, segment):
    """Phase within the segment at which the flying body meets the deck; -1 if it does not.

    The height is convex where the contact force would be negative and concave elsewhere.
    """
    law, body, place = motion.law_of(work, FALL), motion.body_of(work), motion.place_of(work)
    end = motion.edge_of(work, segment + 1)
    low, high = body.phase, end.phase
    height = body.height + _path(law, body, end, body.rise)
    if work[motion.EDGE + 8 * segment + 5] > 0.0:
        if height > 0.0:
            return -1.0
        return _root(work, law, 0, body.rise, low, high, True, high)
    rise = body.rise + _gain(law, body, end)
    if body.rise >= 0.0 or (rise <= 0.0 and height > 0.0):
        return -1.0
    if rise > 0.0:
        high = _root(work, law, 1, body.rise, low, high, False, 0.5 * (low + high))
        _set_place(work, high, place, 0)
        if body.height + _path(law, body, place, body.rise) > 0.0:
            return -1.0
    return _root(work, law, 0, body.rise, low, high, True, low)


@kernel
def _fly(work, segment):
    """Flight to the end of the segment, or to the landing and the plastic impact in it."""
    law, fall = motion.law_of(work, FLIGHT), motion.law_of(work, FALL)
    body, place = motion.body_of(work), motion.place_of(work)
    landing = _landing(work, segment)
    if landing >= 0.0:
        _set_place(work, landing, place, 0)
    else:
        _advance(place, motion.edge_of(work, segment + 1))
    velocity = body.slip + _gain(law, body, place)
    rise = body.rise + _gain(fall, body, place)
    body.travel += _path(law, body, place, body.slip)
    body.airborne += place.phase - body.phase
    if landing < 0.0:
        body.height = max(0.0, body.height + _path(fall, body, place, body.rise))
        body.rise, body.slip = rise, velocity
    else:
        left = max(0.0, abs(velocity) + motion.law_of(work, FORWARD).normal * abs(rise))
        body.loss += 0.5 * (rise * rise + velocity * velocity - left * left)
        body.slip = left if velocity > 0.0 else -left
        body.height, body.rise, body.flying = 0.0, 0.0, 0.0
        body.least = min(body.least, left)
    _advance(body, place)


@kernel
def _one_period(work):
    """Follow the body through one period of the deck, from phase 0 to phase 0."""
    body = motion.body_of(work)
    edge = view2(work, motion.EDGE, motion.MAX_EDGES, 8)
    body.least = math.inf
    for k in range(int(work[motion.EDGES]) - 1):
        while body.phase < edge[k + 1, 0]:
            if body.flying == 0.0 and edge[k, 5] < 0.0:
                body.flying = 1.0
                body.flights += 1.0
            if body.flying > 0.0:
                _fly(work, k)
            elif body.slip > 0.0 or (body.slip == 0.0 and edge[k, 6] > 0.0):
                _slip(work, FORWARD, k)
            elif body.slip < 0.0 or (body.slip == 0.0 and edge[k, 7] < 0.0):
                _slip(work, BACK, k)
            else:
                body.least = 0.0
                _advance(body, motion.edge_of(work, k + 1))
    _advance(body, motion.edge_of(work, 0))


# --- the regime ----------------------------------------------------------------------------------
@kernel
def _past(work):
    """States of the body two periods ago, one period ago, and at the reference."""
    at = motion.PAST
    return view1(work, at, 4), view1(work, at + 4, 4), view1(work, at + 8, 4)


@kernel
def _distance(now, past):
    """Largest difference between two states of the body; infinite if only one flies."""
    if now[3] != past[3]:
        return math.inf
    largest = 0.0
    for k in range(3):
        largest = max(largest, abs(now[k] - past[k]))
    return largest


@kernel
def _extrapolate(work, scale):
    """Move the body's state to where its last three states lead; True if it was moved.

    Aitken's formula, except where two states alternate: for the flight first, which does not depend
    on the slip velocity, then for the slip velocity. One that did not come to zero within the
    period changes by the same amount in every period: as many periods as will stay so are skipped.
    No move is longer than `scale`.
    """
    now, (before, last, _) = motion.moving_of(work), _past(work)
    least = motion.body_of(work).least
    if before[3] != now[3] or last[3] != now[3]:
        return False
    flight_step = max(abs(last[1] - before[1]), abs(last[2] - before[2]))
    start = 1 if flight_step > 1e-9 else 0
    end = 3 if flight_step > 1e-9 else 1
    first, mixed = 0.0, 0.0
    for k in range(start, end):
        step = last[k] - before[k]
        first += step * step
        mixed += step * (now[k] - last[k])
    factor = 0.0
    if start == 0 and least > 0.0:
        if abs(mixed - first) < 1e-9 * first:
            factor = math.floor(least / math.sqrt(first))
    elif -0.999 * first < mixed < 0.999999 * first:
        factor = mixed / (first - mixed)
    if factor * factor * first > scale * scale:
        factor = scale / math.sqrt(first)
    if factor == 0.0 or now[1] + factor * (now[1] - last[1]) < 0.0:
        return False
    for k in range(start, end):
        now[k] += factor * (now[k] - last[k])
    return True


@kernel
def _settle(work):
    """Follow the body until its state repeats; the number of periods of the regime, 0 if irregular.

    Differences count against the size of the deck's own acceleration and gravity.
    """
    wave, now = motion.wave_of(work), motion.moving_of(work)
    scale = 1.0
    for k in range(motion.ROWS):
        for i in range(1, 5):
            scale += wave[k, 0] * wave[k, 0] * abs(wave[k, i])
    before, last, reference = _past(work)
    since = 0
    vectors.copy(last, now)
    vectors.copy(reference, now)
    for period in range(1, PERIODS_ACCELERATED + PERIODS_PLAIN + 1):
        vectors.copy(before, last)
        vectors.copy(last, now)
        _one_period(work)
        if _distance(now, reference) < SAME_STATE * scale:
            return period - since
        renew = period - since >= LONGEST_REGIME
        if period <= PERIODS_ACCELERATED:
            moved = period >= 6 and period % 3 == 0 and _extrapolate(work, scale)
            renew = moved or period - since >= 4
        if renew:
            vectors.copy(reference, now)
            since = period
    return 0


@kernel
def clear_sums(body):
    body.travel, body.airborne, body.flights, body.loss = 0.0, 0.0, 0.0, 0.0


@kernel
def _measure(work, blocks, periods):
    """Follow the body through blocks of so many periods; the standard deviation of their travel."""
    body = motion.body_of(work)
    clear_sums(body)
    body.measured = 1.0
    mean, squares = 0.0, 0.0
    for block in range(blocks):
        start = body.travel
        for _ in range(periods):
            _one_period(work)
        change = body.travel - start - mean
        mean += change / (block + 1)
        squares += change * (body.travel - start - mean)
    return math.sqrt(squares / (blocks - 1)) if blocks > 1 else 0.0


# --- the model -----------------------------------------------------------------------------------
@kernel
def _throw_number(work):
    """Largest upward pull of the deck over g cos(alpha) [1]: the maximum of -eta''."""
    wave, place = motion.wave_of(work), motion.place_of(work)
    low, high = motion.node_of(work, 0), motion.node_of(work, 1)
    if wave[0, 0] == 1.0 and wave[1, 0] == 0.0:
        return math.sqrt(wave[0, 3] * wave[0, 3] + wave[0, 4] * wave[0, 4])
    largest = 0.0
    _next_node(work, 0)
    for number in range(1, _node_count(work) + 1):
        _next_node(work, number)
        if low.normal_rate < 0.0 and high.normal_rate >= 0.0:
            start, end, force = low.phase, high.phase, motion.law_of(work, FORCE)
            lowest = _root(work, force, 3, 0.0, start, end, False, 0.5 * (start + end))
            _set_place(work, lowest, place, 2)
            largest = max(largest, -place.normal)
    return largest


@kernel
def _set_law(work, row, constant, along, normal):
    law = motion.law_of(work, row)
    law.constant, law.along, law.normal = constant, along, normal


@kernel
def _set_wave(harmonic, scale, work):
    """Rows in use times `scale`, highest order and the laws that do not depend on friction."""
    wave = motion.wave_of(work)
    rows = 0
    for k in range(motion.ROWS):
        size = 0.0
        for i in range(1, 5):
            size += abs(harmonic[k, i])
        if harmonic[k, 0] > 0.0 and size > 0.0:
            wave[rows, 0] = harmonic[k, 0]
            for i in range(1, 5):
                wave[rows, i] = harmonic[k, i] * scale
            work[motion.ORDER] = max(work[motion.ORDER], harmonic[k, 0])
            rows += 1
    vectors.clear_rows(wave, rows, motion.ROWS)
    _set_law(work, FORCE, 1.0, 0.0, 1.0)
    _set_law(work, FALL, -1.0, 0.0, -1.0)


@kernel
def scales(drive):
    """Angular velocity of the drive, 1/s, and gravity normal to the panel, m/s2."""
    given = record(drive, 0, motion.DRIVE)
    return 2.0 * math.pi * given.frequency, motion.GRAVITY * cos(given.inclination)


@kernel
def set_motion(harmonic, drive, result, work):
    """Clear the result, set the wave and the throw number; False if the deck is at rest."""
    vectors.fill(result, 0.0)
    speed, weight = scales(drive)
    work[motion.ORDER] = 0.0
    if not (speed > 2.0 * math.pi * 1e-9 and weight > 0.0):
        return False
    _set_wave(harmonic, speed * speed / weight, work)
    if work[motion.ORDER] == 0.0:
        return False
    record(result, 0, motion.RESULT).throw = _throw_number(work)
    return True


@kernel
def write_result(periods, deviation, drive, result, work):
    """Means over the measured periods in SI units."""
    body, found = motion.body_of(work), record(result, 0, motion.RESULT)
    speed, weight = scales(drive)
    velocity_unit = weight / speed
    phase = 2.0 * math.pi * periods
    found.velocity = velocity_unit * body.travel / phase
    found.spread = velocity_unit * deviation / (2.0 * math.pi)
    found.airborne = body.airborne / phase
    found.flights = body.flights / periods
    found.dissipation = weight * velocity_unit * body.loss / phase
    found.status = 2.0 if found.velocity < -1e-9 * velocity_unit else 0.0


@kernel
def block_periods(throw):
    """Periods to measure an irregular regime: more where a flight may last longer."""
    return BLOCK_PERIODS * (1 + int(min(throw, 128.0) / 8.0))


@entry("void(matrix, vector, vector, vector)")
def rigid_body(harmonic, drive, result, work):
    """Mean velocity of the bed along the deck [m/s], as that of a rigid body, and its regime.

    harmonic[5, 5] from compose_motion; drive[5] = frequency [Hz], inclination [rad], friction [1],
    prescribed velocity and rolling (not used here); result[7] = velocity [m/s], spread [m/s],
    flight fraction [1], flights per period [1], friction and impact dissipation [W/kg], throw
    number [1], status; work[WORK_SIZE] is scratch. Status 1: |tan(inclination)| >= friction, so no
    regime, velocity 0; 2: the mean velocity is negative. A regime that repeats after up to 16
    periods has spread 0. Otherwise the values are means over 128 periods that start 80 periods
    after rest at phase 0, and the spread is the standard deviation of the velocities of 16 blocks
    of 8 periods (blocks are longer where a flight may last longer, above throw number 8).
    """
    if not set_motion(harmonic, drive, result, work):
        return
    given, found = record(drive, 0, motion.DRIVE), record(result, 0, motion.RESULT)
    slope = tan(given.inclination)
    if not abs(slope) < given.friction:
        found.status = 1.0
        return
    _set_law(work, FORWARD, slope - given.friction, -1.0, -given.friction)
    _set_law(work, BACK, slope + given.friction, -1.0, given.friction)
    _set_law(work, FLIGHT, slope, -1.0, 0.0)
    _find_edges(work)
    vectors.fill(numbers(motion.body_of(work)), 0.0)
    _advance(motion.body_of(work), motion.edge_of(work, 0))
    regime = _settle(work)
    blocks, periods = (1, regime) if regime > 0 else (BLOCKS, block_periods(found.throw))
    deviation = _measure(work, blocks, periods)
    write_result(blocks * periods, deviation / periods, drive, result, work)
