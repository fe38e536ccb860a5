"""Mean velocity of a bed of grains, fitted to particle simulations (MODEL.md, "Displacement")."""

import math

from vibroscreen.compiler.elementary import tan
from vibroscreen.compiler.language import kernel, numbers, record
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics import motion, rigid_body

STEP = 2.0 * math.pi / motion.SWING_STEPS
SETTLING_PERIODS = 64
REPEATS = 1e-9  # change of height and rise over a cycle
BED_THROW = 4.5  # throw number up to which the bed was checked
# softness of landing [1], damping [1], friction of shaken grains [1], drag [s/m]: first and third
# fitted to particle simulations (engine/validation/bed_velocity.py), the others round
BED_CONSTANTS = (1.34, 2.0, 0.565, 0.08)


@kernel
def _set_swing(work):
    """How the deck moves in each of SWING_STEPS steps of a period."""
    wave, travel, rise = motion.wave_of(work), 0.0, 0.0
    for k in range(motion.SWING_STEPS):
        deck = motion.swung_of(work, k)
        deck.along, deck.normal, _, _ = motion.wave_at(wave, STEP * (k + 1), 1)
        travel += STEP * deck.along
        rise += STEP * deck.normal
        deck.travel, deck.rise = travel, rise


@kernel
def _swung_before(work, step):
    """Velocity and sums of the deck where a step begins: along, normal, travel, rise."""
    deck = motion.swung_of(work, step - 1 if step > 0 else motion.SWING_STEPS - 1)
    if step == 0:
        return deck.along, deck.normal, 0.0, 0.0
    return deck.along, deck.normal, deck.travel, deck.rise


@kernel
def _stiff(work, landing):
    """The time for which the velocity of the bed counts beside its height in what presses it."""
    return 2.0 * work[motion.CONSTANT + 1] * landing + STEP


@kernel
def _fly(work, first, height, rise, stiff):
    """Steps from `first` on in which nothing presses the bed, and its height and rise after them.

    At most to the end of the period. The bed falls freely meanwhile, so that no step needs the one
    before: with w steps at a velocity v it comes to STEP (w v - STEP w (w + 1)/2) higher.
    `stiff`: see `_stiff`.
    """
    _, normal, _, level = _swung_before(work, first)
    start, launch = height + level, rise + normal
    flown = 0
    while first + flown < motion.SWING_STEPS:
        deck = motion.swung_of(work, first + flown)
        free = launch - STEP * (flown + 1) - deck.normal
        if height + STEP * min(rise, 0.0) < 0.0 and height + stiff * free < 0.0:
            break
        flown += 1
        rise = free
        height = start + STEP * flown * (launch - 0.5 * STEP * (flown + 1)) - deck.rise
    return flown, height, rise


@kernel
def _press(height, rise, gain, landing, stiff):
    """Contact force on the bed in a step of backward Euler, then its height and rise after it.

    The bed pushes with spring and damper of the landing time and cannot pull; `gain` is what the
    deck gains in normal velocity.
    """
    free = rise - STEP - gain
    softness = landing * landing
    force = max(0.0, -(height + stiff * free) / (softness + STEP * stiff))
    rise = free + STEP * force
    return force, height + STEP * rise, rise


@kernel
def bed_friction(friction, grains):
    """Friction of a bed that slips at its base and shears inside, at rest [1]."""
    return friction * grains / math.sqrt(friction * friction + grains * grains)


@kernel
def _drag(velocity, force, rate, grip, drag):
    """Deceleration of a bed that would slip with `velocity`, and its derivative.

    Two resistances, the lesser counts: the bed needs the landing time to take the velocity of the
    deck, and friction is limited.
    """
    speed = abs(velocity)
    if force <= 0.0 or speed == 0.0:
        return 0.0, 0.0
    soft_rate = rate / (1.0 + STEP * rate)
    soft = soft_rate * speed
    limit = force * (grip + drag * speed)
    both = math.sqrt(soft * soft + limit * limit)
    weak = limit / both
    strong = soft / both
    slope = soft_rate * weak * weak * weak + force * drag * strong * strong * strong
    value = min(soft * weak, speed / STEP)
    return (value if velocity > 0.0 else -value), min(slope, 1.0 / STEP)


@kernel
def _ride(work, periods, share, slope, landing, grip, drag):
    """Follow the bed through so many periods from its state at phase 0 on.

    `share` of the contact force counts for friction.
    Returns the derivative of the slip velocity at the end in that at the start; travel, time in the
    air, flights and loss are those of these periods.
    """
    body, stiff = motion.body_of(work), _stiff(work, landing)
    rate = (1.0 - work[motion.ROLLS]) * work[motion.CONSTANT + 1] / landing
    rigid_body.clear_sums(body)
    height, rise, slip, memory = body.height, body.rise, body.slip, 1.0
    for _ in range(periods):
        step = 0
        while step < motion.SWING_STEPS:
            along, normal, travel, _ = _swung_before(work, step)
            flown, height, rise = _fly(work, step, height, rise, stiff)
            if flown > 0:
                step += flown
                deck, launch, time = motion.swung_of(work, step - 1), slip + along, STEP * flown
                slip = launch + slope * time - deck.along
                far = time * (launch + 0.5 * slope * (time + STEP))
                body.travel += far - (deck.travel - travel)
                body.airborne += time
                body.flights += 1.0 - body.flying
                body.flying = 1.0
            else:
                deck, fast, fell = motion.swung_of(work, step), slip, rise
                step += 1
                force, height, rise = _press(height, rise, deck.normal - normal, landing, stiff)
                free = slip + STEP * slope - (deck.along - along)
                drop, change = _drag(free, share * force, rate, grip, drag)
                slip = free - STEP * drop
                memory *= 1.0 - STEP * change
                body.travel += STEP * slip
                body.flying = 0.0
                # with mean velocities of a step the deck's work is what is lost less gravity's
                body.loss += 0.5 * STEP * (drop * (slip + fast) - force * (rise + fell))
    body.height, body.rise, body.slip = height, rise, slip
    return memory


@kernel
def _land(work, landing):
    """Follow the bed off the deck through a period, in its height, rise and whether it flies."""
    body, stiff = motion.body_of(work), _stiff(work, landing)
    height, rise, step = body.height, body.rise, 0
    while step < motion.SWING_STEPS:
        flown, height, rise = _fly(work, step, height, rise, stiff)
        step += flown
        body.flying = 1.0
        if step < motion.SWING_STEPS:
            _, normal, _, _ = _swung_before(work, step)
            gain = motion.swung_of(work, step).normal - normal
            _, height, rise = _press(height, rise, gain, landing, stiff)
            step += 1
            body.flying = 0.0
    body.height, body.rise = height, rise


@kernel
def _settle_landing(work, landing, longer):
    """Follow the bed off the deck until its state repeats; the number of periods to measure.

    Those after which it repeats (Brent's search for a cycle), or `longer` where it does not.
    """
    body, marked, height, rise = motion.body_of(work), 0, 0.0, 0.0
    for period in range(1, SETTLING_PERIODS + 1):
        last_height, last_rise = body.height, body.rise
        _land(work, landing)
        if abs(body.height - last_height) + abs(body.rise - last_rise) < REPEATS:
            return 1
        if abs(body.height - height) + abs(body.rise - rise) < REPEATS:
            return period - marked
        if period >= 2 * marked:
            marked, height, rise = period, body.height, body.rise
    return longer


@kernel
def _settle_slip(work, periods, slope, landing, grip, drag):
    """Find the slip velocity that repeats after so many periods, and leave the bed after them.

    What the periods make of a slip velocity grows with it, but by less: there is one that repeats,
    and Newton's method kept between the bounds that are known finds it.
    """
    body = motion.body_of(work)
    height, rise, flies = body.height, body.rise, body.flying
    # landings that do not repeat leave some rise: without it the deck has carried the weight
    _ride(work, periods, 1.0, slope, landing, grip, drag)
    carried = 1.0 + (body.rise - rise) / (2.0 * math.pi * periods)
    share = 1.0 / max(carried, 0.1)
    low, high = -math.inf, math.inf
    slip = 0.0
    for _ in range(40):
        body.height, body.rise, body.flying, body.slip = height, rise, flies, slip
        memory = _ride(work, periods, share, slope, landing, grip, drag)
        change = body.slip - slip
        if memory == 1.0:
            break  # never on the deck
        if change > 0.0:
            low = slip
        else:
            high = slip
        following = slip + change / (1.0 - memory)
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - slip) < 1e-9 * (1.0 + abs(slip)):
            break
        slip = following


@entry("void(matrix, vector, vector, vector)")
def solve_bed(harmonic, drive, result, work):
    """The model `bed` with the constants in work[CONSTANT]; arguments as in rigid_body."""
    if not rigid_body.set_motion(harmonic, drive, result, work):
        return
    given, found = record(drive, 0, motion.DRIVE), record(result, 0, motion.RESULT)
    speed, weight = rigid_body.scales(drive)
    slope = tan(given.inclination)
    landing = work[motion.CONSTANT] * math.sqrt(max(found.throw - 1.0, 1e-6))
    grip = bed_friction(given.friction, work[motion.CONSTANT + 2])
    work[motion.ROLLS] = given.rolling
    _set_swing(work)
    vectors.fill(numbers(motion.body_of(work)), 0.0)
    periods = _settle_landing(work, landing, rigid_body.block_periods(found.throw))
    drag = work[motion.CONSTANT + 3] * (weight / speed)
    _settle_slip(work, periods, slope, landing, grip, drag)
    rigid_body.write_result(periods, 0.0, drive, result, work)
    if found.status == 0.0 and (slope > grip or found.throw > BED_THROW):
        found.status = 3.0


@kernel
def bed_of_grains(harmonic, drive, result, work):
    """Mean velocity of a bed of grains along the deck [m/s]: it lands softly and resists by speed.

    Arguments as in rigid_body; spread is 0, dissipation that of landing and slip. Status 2: the
    mean velocity is negative; 3: outside of what the constants were checked for, steeper than the
    friction of the bed or above throw number BED_THROW.
    """
    for k in range(4):
        work[motion.CONSTANT + k] = BED_CONSTANTS[k]
    solve_bed(harmonic, drive, result, work)
