"""Mean velocity of a bed of grains, fitted to particle simulations (MODEL.md, "Displacement")."""

import math

from vibroscreen.compiler.elementary import tan
from vibroscreen.compiler.language import kernel, numbers, record, view1, view2
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics import motion, rigid_body

# the bed needs no edges: their place holds what it needs
SWING_STEPS = 200
STEP = 2.0 * math.pi / SWING_STEPS
SWING = motion.EDGE  # [SWING_STEPS, 2] velocity that the deck gains in a step, along and normal
SETTLING_PERIODS = 64
BED_THROW = 4.5  # throw number up to which the bed was checked
# softness of landing [1], damping [1], friction of shaken grains [1], drag [s/m]: first and third
# fitted to particle simulations (engine/validation/bed_velocity.py), the others round
BED_CONSTANTS = (1.34, 2.0, 0.565, 0.08)


@kernel
def _set_swing(work):
    """Velocity that the deck gains along and normal in each of SWING_STEPS steps of a period."""
    wave, swing = motion.wave_of(work), view2(work, SWING, SWING_STEPS, 2)
    along, normal, _, _ = motion.wave_at(wave, 0.0, 1)
    for k in range(SWING_STEPS):
        phase = 2.0 * math.pi * (k + 1) / SWING_STEPS
        next_along, next_normal, _, _ = motion.wave_at(wave, phase, 1)
        swing[k, 0], swing[k, 1] = next_along - along, next_normal - normal
        along, normal = next_along, next_normal


@kernel
def _press(height, rise, gain, landing, damping):
    """Contact force on the bed in a step of backward Euler, then its height and rise after it.

    The bed pushes with spring and damper of the landing time and cannot pull; `gain` is what the
    deck gains in normal velocity.
    """
    free = rise - STEP - gain
    force = 0.0
    if height + STEP * min(rise, 0.0) < 0.0:
        resistance = (2.0 * damping + STEP / landing) / landing
        spring = height / (landing * landing)
        slowed = (free - STEP * spring) / (1.0 + STEP * resistance)
        force = max(0.0, -resistance * slowed - spring)
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
    body = motion.body_of(work)
    damping = work[motion.CONSTANT + 1]
    rate = (1.0 - work[motion.ROLLS]) * damping / landing
    rigid_body.clear_sums(body)
    height, rise, slip = body.height, body.rise, body.slip
    memory = 1.0
    for k in range(periods * SWING_STEPS):
        gain = view1(work, SWING + 2 * (k % SWING_STEPS), 2)
        flies, fast, fell = body.flying, slip, rise
        force, height, rise = _press(height, rise, gain[1], landing, damping)
        body.flying = 1.0 if force == 0.0 else 0.0
        body.airborne += STEP * body.flying
        body.flights += 1.0 if body.flying > flies else 0.0
        free = slip + STEP * slope - gain[0]
        drop, change = _drag(free, share * force, rate, grip, drag)
        slip = free - STEP * drop
        memory *= 1.0 - STEP * change
        body.travel += STEP * slip
        # with mean velocities of a step the deck's work is exactly what is lost less gravity's
        body.loss += 0.5 * STEP * (drop * (slip + fast) - force * (rise + fell))
    body.height, body.rise, body.slip = height, rise, slip
    return memory


@kernel
def _settle_landing(work, landing, longer):
    """Follow the bed off the deck until its state repeats; the number of periods to measure.

    1, or `longer` where landings do not repeat every period.
    """
    body, swing = motion.body_of(work), view2(work, SWING, SWING_STEPS, 2)
    damping = work[motion.CONSTANT + 1]
    for _ in range(SETTLING_PERIODS):
        height, rise = body.height, body.rise
        for k in range(SWING_STEPS):
            force, height, rise = _press(height, rise, swing[k, 1], landing, damping)
        moved = abs(height - body.height) + abs(rise - body.rise)
        body.height, body.rise = height, rise
        body.flying = 1.0 if force == 0.0 else 0.0
        if moved < 1e-9:
            return 1
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
