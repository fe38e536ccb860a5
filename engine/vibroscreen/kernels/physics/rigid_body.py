"""Mean velocity of a rigid body on a vibrating rough plane (Blekhman; MODEL.md, "Displacement")."""

import math

from vibroscreen.compiler.language import kernel, view1, view2
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics.elementary import cos, tan
from vibroscreen.kernels.physics import motion

NODES_FUNDAMENTAL = 16
NODES_PER_ORDER = 64  # brackets a wiggle of 1e-4 of the amplitude between two nodes
PERIODS_ACCELERATED = 32  # the Poincare map is extrapolated to its fixed point
PERIODS_PLAIN = 48  # it is left alone: regimes of up to LONGEST_REGIME periods are found
LONGEST_REGIME = 16
BLOCKS = 16  # an irregular regime is the mean of BLOCKS times BLOCK_PERIODS periods
BLOCK_PERIODS = 8
SAME_STATE = 1e-12
# entries of BODY; the first five are a place
SLIP = 5
HEIGHT = 6
RISE = 7
FLYING = 8
TRAVEL = 9
AIRBORNE = 10
FLIGHTS = 11
LOSS = 12
MEASURED = 13
LEAST = 14  # least slip velocity within the period, 0 if it sticks or turns
GAUSS_POINT = (
    -0.9324695142031521,
    -0.6612093864662645,
    -0.2386191860831969,
    0.2386191860831969,
    0.6612093864662645,
    0.9324695142031521,
)
GAUSS_WEIGHT = (
    0.1713244923791704,
    0.3607615730481386,
    0.4679139345726910,
    0.4679139345726910,
    0.3607615730481386,
    0.1713244923791704,
)


@kernel
def _set_place(wave, phase, place):
    """Phase, xi, xi', eta, eta' of the deck, written to place."""
    along, normal, along_rate, normal_rate = motion.wave_at(wave, phase, 0)
    place[0] = phase
    place[1] = along
    place[2] = along_rate
    place[3] = normal
    place[4] = normal_rate


@kernel
def _form_static(work, row, derivative):
    """Law `row` (derivative 2) or its rate (derivative 3) as a function of the phase, for _root."""
    law = view2(work, motion.LAW, 5, 3)
    form = view1(work, motion.FORM, 6)
    form[0] = law[row, 0] if derivative == 2 else 0.0
    form[1] = 0.0
    form[2] = 0.0
    form[3] = law[row, 1]
    form[4] = law[row, 2]
    form[5] = 0.0


@kernel
def _form_motion(work, row, derivative, position, rate):
    """Position (derivative 0) or velocity (1) under law `row` from the body on, for _root."""
    law = view2(work, motion.LAW, 5, 3)
    form = view1(work, motion.FORM, 6)
    body = view1(work, motion.BODY, 15)
    velocity_part = rate - law[row, 1] * body[2] - law[row, 2] * body[4]
    form[3] = law[row, 1]
    form[4] = law[row, 2]
    form[5] = body[0]
    if derivative == 1:
        form[0] = velocity_part
        form[1] = law[row, 0]
        form[2] = 0.0
    else:
        form[0] = position - law[row, 1] * body[1] - law[row, 2] * body[3]
        form[1] = velocity_part
        form[2] = 0.5 * law[row, 0]


@kernel
def _root(work, derivative, low, high, falls, guess):
    """Phase between low and high where the form is zero; falls: it is positive at low.

    Newton's method kept inside a shrinking bracket, so it ends; the last step is below 1e-10.
    """
    wave = view2(work, motion.WAVE, motion.ROWS, 5)
    form = view1(work, motion.FORM, 6)
    phase = guess
    for _ in range(80):
        time = phase - form[5]
        along, normal, along_rate, normal_rate = motion.wave_at(wave, phase, derivative)
        value = form[0] + time * (form[1] + time * form[2]) + form[3] * along + form[4] * normal
        rate = form[1] + 2.0 * time * form[2] + form[3] * along_rate + form[4] * normal_rate
        if (value > 0.0) == falls:
            low = phase
        else:
            high = phase
        following = 0.5 * (low + high)
        if abs(value) <= abs(rate) * (high - low) and rate != 0.0:
            newton = phase - value / rate
            if low <= newton <= high:
                following = newton
        step = abs(following - phase)
        phase = following
        if step < 1e-10:
            break
    return phase


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
def _bracket_law(work, row):
    """Add the roots of a law between the two nodes, also a pair around an extremum inside."""
    law = view2(work, motion.LAW, 5, 3)
    node = view2(work, motion.NODE, 2, 5)
    low = node[0, 0]
    high = node[1, 0]
    before = law[row, 0] + law[row, 1] * node[0, 1] + law[row, 2] * node[0, 2]
    after = law[row, 0] + law[row, 1] * node[1, 1] + law[row, 2] * node[1, 2]
    positive = before > 0.0
    if positive != (after > 0.0):
        _form_static(work, row, 2)
        guess = low + (high - low) * before / (before - after)
        _add_edge(work, _root(work, 2, low, high, positive, guess))
        return
    rate_before = law[row, 1] * node[0, 3] + law[row, 2] * node[0, 4]
    rate_after = law[row, 1] * node[1, 3] + law[row, 2] * node[1, 4]
    towards_zero = rate_before < 0.0 if positive else rate_before > 0.0
    if towards_zero and (rate_before > 0.0) != (rate_after > 0.0):
        middle = 0.5 * (low + high)
        _form_static(work, row, 3)
        extremum = _root(work, 3, low, high, rate_before > 0.0, middle)
        along, normal, _, _ = motion.wave_at(view2(work, motion.WAVE, motion.ROWS, 5), extremum, 2)
        if (law[row, 0] + law[row, 1] * along + law[row, 2] * normal > 0.0) != positive:
            _form_static(work, row, 2)
            _add_edge(work, _root(work, 2, low, extremum, positive, 0.5 * (low + extremum)))
            _add_edge(work, _root(work, 2, extremum, high, not positive, 0.5 * (extremum + high)))


@kernel
def _next_node(work, number, count):
    """Move the pair of nodes on: node 0 takes the values of node 1, node 1 those of `number`."""
    node = view2(work, motion.NODE, 2, 5)
    for k in range(5):
        node[0, k] = node[1, k]
    phase = 2.0 * math.pi * number / count
    along, normal, along_rate, normal_rate = motion.wave_at(
        view2(work, motion.WAVE, motion.ROWS, 5), phase, 2
    )
    node[1, 0] = phase
    node[1, 1] = along
    node[1, 2] = normal
    node[1, 3] = along_rate
    node[1, 4] = normal_rate


@kernel
def _node_count(order):
    """Nodes per period among which roots are bracketed."""
    return NODES_FUNDAMENTAL if order == 1.0 else int(NODES_PER_ORDER * order)


@kernel
def _find_edges(work):
    """Cut the period into segments in which no law changes its sign; the signs go with them."""
    law = view2(work, motion.LAW, 5, 3)
    edge = view2(work, motion.EDGE, motion.MAX_EDGES, 8)
    wave = view2(work, motion.WAVE, motion.ROWS, 5)
    edge[0, 0] = 0.0
    work[motion.EDGES] = 1.0
    nodes = _node_count(work[motion.ORDER])
    _next_node(work, 0, nodes)
    for number in range(1, nodes + 1):
        _next_node(work, number, nodes)
        for row in range(3):
            _bracket_law(work, row)
    count = int(work[motion.EDGES])
    edge[count, 0] = 2.0 * math.pi
    work[motion.EDGES] = count + 1
    for k in range(count + 1):
        _set_place(wave, edge[k, 0], view1(work, motion.EDGE + 8 * k, 5))
        if k < count:
            along, normal, _, _ = motion.wave_at(wave, 0.5 * (edge[k, 0] + edge[k + 1, 0]), 2)
            for row in range(3):
                value = law[row, 0] + law[row, 1] * along + law[row, 2] * normal
                edge[k, 5 + row] = 1.0 if value > 0.0 else -1.0


@kernel
def _gain(law, row, body, place):
    """Velocity that law `row` adds between the body's phase and place."""
    time = place[0] - body[0]
    return (
        law[row, 0] * time + law[row, 1] * (place[2] - body[2]) + law[row, 2] * (place[4] - body[4])
    )


@kernel
def _path(law, row, body, place, rate):
    """Distance under law `row` from the body's phase to place, starting with velocity `rate`."""
    time = place[0] - body[0]
    along = place[1] - body[1] - body[2] * time
    normal = place[3] - body[3] - body[4] * time
    return time * (rate + 0.5 * law[row, 0] * time) + law[row, 1] * along + law[row, 2] * normal


@kernel
def _advance(body, place):
    """The body's phase becomes that of place."""
    for k in range(5):
        body[k] = place[k]


@kernel
def _friction_loss(work, row, end):
    """Friction work mu n |s'| from the body's phase to `end` while it slips under law `row`."""
    law = view2(work, motion.LAW, 5, 3)
    body = view1(work, motion.BODY, 15)
    wave = view2(work, motion.WAVE, motion.ROWS, 5)
    panels = 1 + int((end - body[0]) * work[motion.ORDER])
    half = 0.5 * (end - body[0]) / panels
    loss = 0.0
    for panel in range(panels):
        for k in range(6):
            phase = body[0] + half * (2 * panel + 1 + GAUSS_POINT[k])
            along, normal, _, normal_rate = motion.wave_at(wave, phase, 1)
            slip = body[SLIP] + law[row, 0] * (phase - body[0])
            slip += law[row, 1] * (along - body[2]) + law[row, 2] * (normal - body[4])
            loss += GAUSS_WEIGHT[k] * abs(slip * law[row, 2] * (1.0 + normal_rate))
    return half * loss


@kernel
def _slip(work, row, segment):
    """Slip forward (row 1) or back (row 2) to the end of the segment or until it stops."""
    law = view2(work, motion.LAW, 5, 3)
    body = view1(work, motion.BODY, 15)
    place = view1(work, motion.PLACE, 5)
    end = view1(work, motion.EDGE + 8 * (segment + 1), 5)
    forward = row == 1
    slows = (work[motion.EDGE + 8 * segment + 5 + row] < 0.0) == forward
    velocity = body[SLIP] + _gain(law, row, body, end)
    stopped = velocity <= 0.0 if forward else velocity >= 0.0
    _advance(place, end)
    if stopped and slows:
        _form_motion(work, row, 1, 0.0, body[SLIP])
        guess = body[0] + (end[0] - body[0]) * body[SLIP] / (body[SLIP] - velocity)
        phase = _root(work, 1, body[0], end[0], forward, guess)
        _set_place(view2(work, motion.WAVE, motion.ROWS, 5), phase, place)
    body[TRAVEL] += _path(law, row, body, place, body[SLIP])
    if body[MEASURED] > 0.0:
        body[LOSS] += _friction_loss(work, row, place[0])
    body[SLIP] = 0.0 if stopped else velocity
    body[LEAST] = min(body[LEAST], abs(body[SLIP]))
    _advance(body, place)


@kernel
def _landing(work, segment):
    """Phase within the segment at which the flying body meets the deck; -1 if it does not.

    The height is convex where the contact force would be negative and concave elsewhere.
    """
    law = view2(work, motion.LAW, 5, 3)
    body = view1(work, motion.BODY, 15)
    end = view1(work, motion.EDGE + 8 * (segment + 1), 5)
    low = body[0]
    high = end[0]
    height = body[HEIGHT] + _path(law, 4, body, end, body[RISE])
    if work[motion.EDGE + 8 * segment + 5] > 0.0:
        if height > 0.0:
            return -1.0
        _form_motion(work, 4, 0, body[HEIGHT], body[RISE])
        return _root(work, 0, low, high, True, high)
    rise = body[RISE] + _gain(law, 4, body, end)
    if body[RISE] >= 0.0 or (rise <= 0.0 and height > 0.0):
        return -1.0
    if rise > 0.0:
        _form_motion(work, 4, 1, 0.0, body[RISE])
        high = _root(work, 1, low, high, False, 0.5 * (low + high))
        _set_place(view2(work, motion.WAVE, motion.ROWS, 5), high, view1(work, motion.PLACE, 5))
        if body[HEIGHT] + _path(law, 4, body, view1(work, motion.PLACE, 5), body[RISE]) > 0.0:
            return -1.0
    _form_motion(work, 4, 0, body[HEIGHT], body[RISE])
    return _root(work, 0, low, high, True, low)


@kernel
def _fly(work, segment):
    """Flight to the end of the segment, or to the landing and the plastic impact in it."""
    law = view2(work, motion.LAW, 5, 3)
    body = view1(work, motion.BODY, 15)
    place = view1(work, motion.PLACE, 5)
    landing = _landing(work, segment)
    if landing >= 0.0:
        _set_place(view2(work, motion.WAVE, motion.ROWS, 5), landing, place)
    else:
        _advance(place, view1(work, motion.EDGE + 8 * (segment + 1), 5))
    velocity = body[SLIP] + _gain(law, 3, body, place)
    rise = body[RISE] + _gain(law, 4, body, place)
    body[TRAVEL] += _path(law, 3, body, place, body[SLIP])
    body[AIRBORNE] += place[0] - body[0]
    if landing < 0.0:
        body[HEIGHT] = max(0.0, body[HEIGHT] + _path(law, 4, body, place, body[RISE]))
        body[RISE] = rise
        body[SLIP] = velocity
    else:
        left = max(0.0, abs(velocity) + law[1, 2] * abs(rise))
        body[LOSS] += 0.5 * (rise * rise + velocity * velocity - left * left)
        body[SLIP] = left if velocity > 0.0 else -left
        body[HEIGHT] = 0.0
        body[RISE] = 0.0
        body[FLYING] = 0.0
        body[LEAST] = min(body[LEAST], left)
    _advance(body, place)


@kernel
def _one_period(work):
    """Follow the body through one period of the deck, from phase 0 to phase 0."""
    body = view1(work, motion.BODY, 15)
    edge = view2(work, motion.EDGE, motion.MAX_EDGES, 8)
    body[LEAST] = math.inf
    for k in range(int(work[motion.EDGES]) - 1):
        while body[0] < edge[k + 1, 0]:
            if body[FLYING] == 0.0 and edge[k, 5] < 0.0:
                body[FLYING] = 1.0
                body[FLIGHTS] += 1.0
            if body[FLYING] > 0.0:
                _fly(work, k)
            elif body[SLIP] > 0.0 or (body[SLIP] == 0.0 and edge[k, 6] > 0.0):
                _slip(work, 1, k)
            elif body[SLIP] < 0.0 or (body[SLIP] == 0.0 and edge[k, 7] < 0.0):
                _slip(work, 2, k)
            else:
                body[LEAST] = 0.0
                _advance(body, view1(work, motion.EDGE + 8 * (k + 1), 5))
    _advance(body, view1(work, motion.EDGE, 5))


@kernel
def _distance(work, row):
    """Largest difference between the body's state and a past one; infinite if only one flies."""
    body = view1(work, motion.BODY, 15)
    past = view2(work, motion.PAST, 3, 4)
    if body[FLYING] != past[row, 3]:
        return math.inf
    largest = 0.0
    for k in range(3):
        largest = max(largest, abs(body[SLIP + k] - past[row, k]))
    return largest


@kernel
def _remember(work, row):
    """Keep the body's state in row `row` of the past."""
    body = view1(work, motion.BODY, 15)
    past = view2(work, motion.PAST, 3, 4)
    for k in range(4):
        past[row, k] = body[SLIP + k]


@kernel
def _extrapolate(work, scale):
    """Move the body's state to where its last three states lead; True if it was moved.

    Aitken's formula, except where two states alternate: for the flight first, which does not depend
    on the slip velocity, then for the slip velocity. One that did not come to zero within the
    period changes by the same amount in every period: as many periods as will stay so are skipped.
    No move is longer than `scale`.
    """
    body = view1(work, motion.BODY, 15)
    past = view2(work, motion.PAST, 3, 4)
    if past[0, 3] != body[FLYING] or past[1, 3] != body[FLYING]:
        return False
    flight_step = max(abs(past[1, 1] - past[0, 1]), abs(past[1, 2] - past[0, 2]))
    start = 1 if flight_step > 1e-9 else 0
    end = 3 if flight_step > 1e-9 else 1
    first = 0.0
    mixed = 0.0
    for k in range(start, end):
        step = past[1, k] - past[0, k]
        first += step * step
        mixed += step * (body[SLIP + k] - past[1, k])
    factor = 0.0
    if start == 0 and body[LEAST] > 0.0:
        if abs(mixed - first) < 1e-9 * first:
            factor = math.floor(body[LEAST] / math.sqrt(first))
    elif -0.999 * first < mixed < 0.999999 * first:
        factor = mixed / (first - mixed)
    if factor * factor * first > scale * scale:
        factor = scale / math.sqrt(first)
    if factor == 0.0 or body[HEIGHT] + factor * (body[HEIGHT] - past[1, 1]) < 0.0:
        return False
    for k in range(start, end):
        body[SLIP + k] += factor * (body[SLIP + k] - past[1, k])
    return True


@kernel
def _settle(work):
    """Follow the body until its state repeats; the number of periods of the regime, 0 if irregular.

    Differences count against the size of the deck's own acceleration and gravity.
    """
    wave = view2(work, motion.WAVE, motion.ROWS, 5)
    scale = 1.0
    for k in range(motion.ROWS):
        for i in range(1, 5):
            scale += wave[k, 0] * wave[k, 0] * abs(wave[k, i])
    past = view2(work, motion.PAST, 3, 4)
    reference = 0
    _remember(work, 1)
    _remember(work, 2)
    for period in range(1, PERIODS_ACCELERATED + PERIODS_PLAIN + 1):
        for k in range(4):
            past[0, k] = past[1, k]
        _remember(work, 1)
        _one_period(work)
        if _distance(work, 2) < SAME_STATE * scale:
            return period - reference
        renew = period - reference >= LONGEST_REGIME
        if period <= PERIODS_ACCELERATED:
            moved = period >= 6 and period % 3 == 0 and _extrapolate(work, scale)
            renew = moved or period - reference >= 4
        if renew:
            _remember(work, 2)
            reference = period
    return 0


@kernel
def _measure(work, blocks, periods):
    """Follow the body through blocks of so many periods; the standard deviation of their travel."""
    body = view1(work, motion.BODY, 15)
    for k in range(TRAVEL, MEASURED):
        body[k] = 0.0
    body[MEASURED] = 1.0
    mean = 0.0
    squares = 0.0
    for block in range(blocks):
        start = body[TRAVEL]
        for _ in range(periods):
            _one_period(work)
        change = body[TRAVEL] - start - mean
        mean += change / (block + 1)
        squares += change * (body[TRAVEL] - start - mean)
    return math.sqrt(squares / (blocks - 1)) if blocks > 1 else 0.0


@kernel
def _throw_number(work):
    """Largest upward pull of the deck over g cos(alpha) [1]: the maximum of -eta''."""
    wave = view2(work, motion.WAVE, motion.ROWS, 5)
    node = view2(work, motion.NODE, 2, 5)
    if wave[0, 0] == 1.0 and wave[1, 0] == 0.0:
        return math.sqrt(wave[0, 3] * wave[0, 3] + wave[0, 4] * wave[0, 4])
    largest = 0.0
    nodes = _node_count(work[motion.ORDER])
    _next_node(work, 0, nodes)
    for number in range(1, nodes + 1):
        _next_node(work, number, nodes)
        if node[0, 4] < 0.0 and node[1, 4] >= 0.0:
            _form_static(work, 0, 3)
            middle = 0.5 * (node[0, 0] + node[1, 0])
            lowest = _root(work, 3, node[0, 0], node[1, 0], False, middle)
            _, normal, _, _ = motion.wave_at(wave, lowest, 2)
            largest = max(largest, -normal)
    return largest


@kernel
def _set_wave(harmonic, scale, work):
    """Rows in use times `scale`, highest order and the laws that do not depend on friction."""
    wave = view2(work, motion.WAVE, motion.ROWS, 5)
    law = view2(work, motion.LAW, 5, 3)
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
    for k in range(rows, motion.ROWS):
        for i in range(5):
            wave[k, i] = 0.0
    law[0, 0] = 1.0
    law[0, 1] = 0.0
    law[0, 2] = 1.0
    law[4, 0] = -1.0
    law[4, 1] = 0.0
    law[4, 2] = -1.0


@kernel
def set_motion(harmonic, drive, result, work):
    """Clear the result, set the wave and the throw number; False if the deck is at rest."""
    for k in range(7):
        result[k] = 0.0
    speed = 2.0 * math.pi * drive[0]
    weight = motion.GRAVITY * cos(drive[1])
    work[motion.ORDER] = 0.0
    if not (drive[0] > 1e-9 and weight > 0.0):
        return False
    _set_wave(harmonic, speed * speed / weight, work)
    if work[motion.ORDER] == 0.0:
        return False
    result[5] = _throw_number(work)
    return True


@kernel
def _set_slip_laws(slope, friction, work):
    """Laws of slip forward, slip back and flight along the deck; slope = tan(inclination)."""
    law = view2(work, motion.LAW, 5, 3)
    for k in range(1, 4):
        grip = friction * (2 * k - 3) if k < 3 else 0.0
        law[k, 0] = slope + grip
        law[k, 1] = -1.0
        law[k, 2] = grip


@kernel
def write_result(periods, deviation, weight, velocity_unit, result, work):
    """Means over the measured periods in SI units."""
    body = view1(work, motion.BODY, 15)
    phase = 2.0 * math.pi * periods
    result[0] = velocity_unit * body[TRAVEL] / phase
    result[1] = velocity_unit * deviation / (2.0 * math.pi)
    result[2] = body[AIRBORNE] / phase
    result[3] = body[FLIGHTS] / periods
    result[4] = weight * velocity_unit * body[LOSS] / phase
    result[6] = 2.0 if result[0] < -1e-9 * velocity_unit else 0.0


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
    speed = 2.0 * math.pi * drive[0]
    weight = motion.GRAVITY * cos(drive[1])
    throw = result[5]
    slope = tan(drive[1])
    if not abs(slope) < drive[2]:
        result[6] = 1.0
        return
    _set_slip_laws(slope, drive[2], work)
    _find_edges(work)
    for k in range(15):
        work[motion.BODY + k] = 0.0
    _advance(view1(work, motion.BODY, 15), view1(work, motion.EDGE, 5))
    regime = _settle(work)
    blocks = 1 if regime > 0 else BLOCKS
    periods = regime if regime > 0 else block_periods(throw)
    deviation = _measure(work, blocks, periods)
    write_result(blocks * periods, deviation / periods, weight, weight / speed, result, work)
