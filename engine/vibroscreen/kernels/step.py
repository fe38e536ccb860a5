"""One communication step: check, displacement, feed, deck, ledger, outputs (MODEL.md, "A step").

`advance` and `initialise` give a code of layout.py; anything but ACCEPTED means that nothing was
changed and that the field `refusal` says what was wrong. Python enters by kernels/entry.py.
"""

from __future__ import annotations

from math import isfinite, pi

from vibroscreen.kernels.cascade import advance_decks, all_covered
from vibroscreen.kernels.classes import merge_classes, split_classes
from vibroscreen.kernels.closure import (
    OF_PASSAGE,
    OF_SEGREGATION,
    passage_factor,
    peak_normal_velocity,
    percolation_factor,
    throw_height,
)
from vibroscreen.kernels.deck import (
    clear_deck,
    depth_at_discharge,
    depth_at_feed,
    held_by_node,
    join_queue,
    part_cohorts,
    start_cohort,
)
from vibroscreen.kernels.displacement import (
    GRAVITY,
    bed_of_grains,
    compose_motion,
    prescribed,
    rigid_body,
)
from vibroscreen.kernels.elementary import sin
from vibroscreen.kernels.language import call_displacement, entry, kernel, view2
from vibroscreen.kernels.layout import (
    ACCEPTED,
    ALARM_BED_DEPTH,
    ALARM_CAPACITY,
    ALARM_PERFORMANCE,
    ALARM_TRANSPORT,
    AMPLITUDE,
    APERTURE,
    AT_CLASS_MASS,
    AT_CLOSURE,
    AT_COUNTER,
    AT_DECK_BED,
    AT_DISPLACEMENT_RESULT,
    AT_DISPLACEMENT_WORK,
    AT_DRIVE_SETTING,
    AT_EDGE,
    AT_FEED_FRACTION,
    AT_FRACTION,
    AT_HARMONIC,
    AT_HELD,
    AT_HOLD_UP_WORK,
    AT_INITIAL_MASS,
    AT_INPUT,
    AT_INTERMEDIATE,
    AT_INTERMEDIATE_FRACTION,
    AT_LAST_SEEN,
    AT_LEDGER,
    AT_MEMORY,
    AT_MOTION_HARMONIC,
    AT_NODE_CLASS,
    AT_NODE_POSITION,
    AT_NODE_WEIGHT,
    AT_NODE_WORK,
    AT_OUTPUT,
    AT_OVERSIZE_FRACTION,
    AT_PANEL,
    AT_PARAMETER,
    AT_PASSAGE_FACTOR,
    AT_REFUSAL,
    AT_SCENE,
    AT_SCENE_NOW,
    AT_SEEN_NOW,
    AT_SIZE,
    AT_SLOPE,
    AT_STEADY_RATE,
    AT_STEP_MASS,
    AT_SWITCH,
    AT_UNDERSIZE_FRACTION,
    BAD_SUM,
    BALANCE_ERROR,
    BEARING_DIAMETER,
    BEARING_FRICTION,
    BED_VELOCITY,
    BULK_DENSITY,
    C_DISPLACEMENT,
    C_PARTITIONS,
    C_STEADY_STEPS,
    C_STEPS,
    CONTACT_DEPTH,
    COUNTER,
    CUT_SIZE,
    D_CAPACITY_ALARM,
    DECK_BED,
    DECK_DEPTH_DISCHARGE,
    DECK_DEPTH_FEED,
    DECK_HOLD_UP,
    DECK_VELOCITY,
    DEPTH_DISCHARGE,
    DEPTH_FEED,
    DISPLACEMENT_ADDRESS,
    DISPLACEMENT_MODEL,
    DISPLACEMENT_RESULT,
    DISPLACEMENT_VELOCITY,
    DRIVE_EFFICIENCY,
    DRIVE_POWER,
    ECART_PROBABLE,
    EFFICIENCY,
    ELLIPTICITY,
    FED,
    FEED_MASS,
    FEED_RATE,
    FIXED_SCENE,
    FREQUENCY,
    FRICTION_DECK,
    FRICTION_INTERNAL,
    HOLD_UP,
    INCLINATION,
    INITIAL,
    INPUT,
    INTERMEDIATE,
    INTERMEDIATE_MASS,
    INTERMEDIATE_RATE,
    LAYER_DEPTH,
    LAYERED,
    LENGTH,
    M_SETTLED,
    M_UNREAD,
    MAX_HARMONICS,
    MEMORY,
    N_CLASSES,
    N_DECKS,
    N_DISPLACEMENT_WORK,
    N_PANELS,
    NO_MODEL,
    NO_VELOCITY,
    NOT_FINITE,
    OPEN_AREA,
    OUTPUT,
    OVER,
    OVERSIZE_MASS,
    OVERSIZE_RATE,
    PANEL,
    PARAMETER,
    PASSAGE_ADDRESS,
    PASSAGE_CALMING,
    PASSAGE_DAMPING,
    PASSAGE_DEPLETION,
    PASSAGE_DRIFT,
    PASSAGE_LAW,
    PASSAGE_LEVELLING,
    PASSAGE_LIFT,
    PASSAGE_PASSING_TIME,
    PASSAGE_RIM,
    PASSAGE_STIRRING,
    PASSAGE_VELOCITY,
    R_CODE,
    R_INDEX,
    R_LIMIT,
    R_VALUE,
    REFUSAL,
    ROLLING,
    S_AMPLITUDE,
    S_APERTURE,
    S_CALMING,
    S_CONTACT_LOAD,
    S_DAMPING,
    S_DENSITY,
    S_DEPLETION,
    S_DILATION,
    S_DISSIPATION,
    S_DRIFT,
    S_ELLIPTICITY,
    S_FREQUENCY,
    S_HORIZON,
    S_INCLINATION,
    S_LAYER_LOAD,
    S_LEVELLING,
    S_LIFT,
    S_LOOSENING,
    S_MIXING,
    S_OPEN_AREA,
    S_PASSAGE_VELOCITY,
    S_PASSING_TIME,
    S_PROPORTION,
    S_RELATIVE_DILATION,
    S_RIM,
    S_SEGREGATION_VELOCITY,
    S_STIRRING,
    S_THROW_ANGLE,
    S_THROW_NUMBER,
    S_TRANSPORT_STATUS,
    S_TRANSPORT_VELOCITY,
    SEGREGATION_ADDRESS,
    SEGREGATION_DILATION,
    SEGREGATION_MIXING,
    SEGREGATION_MODEL,
    SEGREGATION_PROPORTION,
    SEGREGATION_RELATIVE_DILATION,
    SEGREGATION_VELOCITY,
    SWITCH,
    THROW_ANGLE,
    THROW_NUMBER_OUT,
    TOO_LARGE,
    TOO_SMALL,
    TOO_STEEP,
    UNDER,
    UNDERSIZE_MASS,
    UNDERSIZE_RATE,
    UNDERSIZE_RECOVERY,
    VELOCITY_FACTOR,
    VIBRATING_MASS,
    W_DISPLACEMENT,
    W_PARTITION,
    W_SHARED,
    W_STEADY,
    class_vector,
    deck_vector,
    node_vector,
    panel_vector,
    scalars,
    scene_vector,
    vector,
)
from vibroscreen.kernels.passage import BOUNCE
from vibroscreen.kernels.place import deck_length, panel_count, residence_time
from vibroscreen.kernels.segregation import CLASSIFIED, EXCHANGE, NOTHING

PRESCRIBED, RIGID_BODY, BED = 1, 2, 3
STEADY_START = 2  # bed.initial
# A feed or fraction this little below its limit is round-off of another tool.
ROUND_OFF = 1e-9
FRACTION_SUM = 1e-3
# The bed is deep at the discharge above this many apertures.
DEEP = 4.0
# A throw below this velocity, m/s, renews nothing.
SLOWEST_THROW = 1e-9
# Residence times in which a deck is surely full of the duty.
FILLING = 1.01

# Limits of what can change while a plant runs: (index, least, most).
INPUT_LIMITS = (
    (FEED_RATE, -ROUND_OFF, 1e6),
    (FREQUENCY, 0.0, 100.0),
    (AMPLITUDE, 0.0, 1.0),
    (THROW_ANGLE, -pi, pi),
    (ELLIPTICITY, -1.0, 1.0),
    (DISPLACEMENT_VELOCITY, 0.0, 20.0),
)
PARAMETER_LIMITS = (
    (FRICTION_DECK, 0.0, 100.0),
    (FRICTION_INTERNAL, 0.0, 100.0),
    (ROLLING, 0.0, 0.95),
    (PASSAGE_VELOCITY, 0.0, 100.0),
    (PASSAGE_RIM, 0.0, 1.0),
    (PASSAGE_PASSING_TIME, 0.0, 100.0),
    (PASSAGE_DRIFT, 0.0, 10.0),
    (PASSAGE_DAMPING, 0.0, 100.0),
    (PASSAGE_LIFT, 0.0, 100.0),
    (PASSAGE_STIRRING, 0.0, 100.0),
    (PASSAGE_CALMING, 0.0, 100.0),
    (PASSAGE_DEPLETION, 0.0, 100.0),
    (PASSAGE_LEVELLING, 0.0, 100.0),
    (SEGREGATION_VELOCITY, 0.0, 100.0),
    (SEGREGATION_DILATION, 0.0, 1.0),
    (SEGREGATION_RELATIVE_DILATION, 0.0, 10.0),
    (SEGREGATION_MIXING, 0.0, 100.0),
    (SEGREGATION_PROPORTION, 0.0, 1.0),
)
PANEL_LIMITS = (
    (INCLINATION, -0.5 * pi, 0.5 * pi),
    (OPEN_AREA, 0.0, 1.0),
    (VELOCITY_FACTOR, 0.0, 10.0),
)


# --- checks ------------------------------------------------------------------------------------
@kernel
def refuse(buffer, code, index, value, limit):
    """Say why a step is refused; `index` is a place of the buffer."""
    refusal = scalars(buffer, AT_REFUSAL, REFUSAL)
    refusal[R_CODE], refusal[R_INDEX] = code, index
    refusal[R_VALUE], refusal[R_LIMIT] = value, limit
    return code


@kernel
def check_value(buffer, index, least, most):
    """Check one place of the buffer against its limits."""
    value = buffer[index]
    if not isfinite(value):
        return refuse(buffer, NOT_FINITE, index, value, 0.0)
    if value < least:
        return refuse(buffer, TOO_SMALL, index, value, least)
    if value > most:
        return refuse(buffer, TOO_LARGE, index, value, most)
    return ACCEPTED


@kernel
def check_fractions(buffer):
    """Check the feed fractions; they count only while something is fed."""
    start = int(buffer[AT_FRACTION])
    classes = int(buffer[N_CLASSES])
    total = 0.0
    for k in range(classes):
        code = check_value(buffer, start + k, -ROUND_OFF, 1.0 + ROUND_OFF)
        if code != ACCEPTED:
            return code
        total += max(0.0, buffer[start + k])
    if abs(total - 1.0) > FRACTION_SUM:
        return refuse(buffer, BAD_SUM, start, total, FRACTION_SUM)
    return ACCEPTED


@kernel
def check_model(buffer, index, built_in, address):
    """Check the number of a sub-model: built in, or a user's own that is there."""
    place = int(buffer[AT_PARAMETER]) + index
    number = buffer[place]
    if number < 1.0 or (number > built_in and buffer[address] <= 0.0):
        return refuse(buffer, NO_MODEL, place, number, built_in)
    return ACCEPTED


@kernel
def check_models(buffer):
    """Check the sub-models; layers must be there if, and only if, the segregation uses them."""
    code = check_model(buffer, PASSAGE_LAW, BOUNCE, PASSAGE_ADDRESS)
    if code == ACCEPTED:
        code = check_model(buffer, DISPLACEMENT_MODEL, BED, DISPLACEMENT_ADDRESS)
    if code == ACCEPTED:
        code = check_model(buffer, SEGREGATION_MODEL, CLASSIFIED, SEGREGATION_ADDRESS)
    place = int(buffer[AT_PARAMETER]) + SEGREGATION_MODEL
    number = buffer[place]
    if code == ACCEPTED and number <= CLASSIFIED:
        if (buffer[LAYERED] > 0.0) != (number == EXCHANGE):
            return refuse(buffer, NO_MODEL, place, number, CLASSIFIED)
    return code


@kernel
def check(buffer):
    """Check all that may change between steps, before anything changes."""
    for index, least, most in INPUT_LIMITS:
        code = check_value(buffer, int(buffer[AT_INPUT]) + index, least, most)
        if code != ACCEPTED:
            return code
    for index, least, most in PARAMETER_LIMITS:
        code = check_value(buffer, int(buffer[AT_PARAMETER]) + index, least, most)
        if code != ACCEPTED:
            return code
    for number in range(int(buffer[N_DECKS]) * int(buffer[N_PANELS])):
        for index, least, most in PANEL_LIMITS:
            place = int(buffer[AT_PANEL]) + number * len(PANEL) + index
            code = check_value(buffer, place, least, most)
            if code != ACCEPTED:
                return code
    if scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE] > 0.0:
        code = check_fractions(buffer)
        if code != ACCEPTED:
            return code
    return check_models(buffer)


# --- what changed ------------------------------------------------------------------------------
@kernel
def look(buffer, seen):
    """Copy all that may change between steps to `seen`: motion first, feed last."""
    parameter = scalars(buffer, AT_PARAMETER, len(PARAMETER))
    inputs = scalars(buffer, AT_INPUT, len(INPUT))
    place = 0
    for k in range(1, inputs.size):
        seen[place] = inputs[k]
        place += 1
    for k in range(parameter.size):
        seen[place] = parameter[k]
        place += 1
    for deck in range(int(buffer[N_DECKS])):
        for number in range(int(buffer[N_PANELS])):
            panel = panel_vector(buffer, deck, number)
            for k in range(panel.size):
                seen[place] = panel[k]
                place += 1
    harmonic = view2(buffer, int(buffer[AT_HARMONIC]), MAX_HARMONICS, 5)
    for k in range(MAX_HARMONICS):
        for part in range(5):
            seen[place] = harmonic[k, part]
            place += 1
    rate = max(0.0, inputs[FEED_RATE])
    seen[place] = rate
    fraction = class_vector(buffer, AT_FRACTION, 0)
    for k in range(fraction.size):
        seen[place + 1 + k] = fraction[k] if rate > 0.0 else 0.0


@kernel
def differ(one, two, start, stop):
    """Whether two vectors differ anywhere in start..stop."""
    for k in range(start, stop):
        if one[k] != two[k]:
            return True
    return False


# --- displacement ------------------------------------------------------------------------------
@kernel
def vibrates(buffer):
    """Whether anything moves: a frequency, and an amplitude or a harmonic."""
    inputs = scalars(buffer, AT_INPUT, len(INPUT))
    moved = abs(inputs[AMPLITUDE])
    harmonic = view2(buffer, int(buffer[AT_HARMONIC]), MAX_HARMONICS, 5)
    for k in range(MAX_HARMONICS):
        if harmonic[k, 0] > 0.0:
            moved += abs(harmonic[k, 1]) + abs(harmonic[k, 3])
    return inputs[FREQUENCY] > 0.0 and moved > 0.0


@kernel
def panel_motion(buffer, panel):
    """Motion of the deck along and normal to a panel as harmonics (`compose_motion`)."""
    inputs = scalars(buffer, AT_INPUT, len(INPUT))
    harmonic = view2(buffer, int(buffer[AT_MOTION_HARMONIC]), MAX_HARMONICS + 1, 5)
    extra = view2(buffer, int(buffer[AT_HARMONIC]), MAX_HARMONICS, 5)
    rotation = panel[INCLINATION] - panel_vector(buffer, 0, 0)[INCLINATION]
    compose_motion(inputs[FREQUENCY : ELLIPTICITY + 1], extra, rotation, harmonic)
    return harmonic


@kernel
def solve_displacement(buffer, deck, number):
    """Velocity of the bed on a panel and what goes with it, into displacement_result."""
    parameter = scalars(buffer, AT_PARAMETER, len(PARAMETER))
    inputs = scalars(buffer, AT_INPUT, len(INPUT))
    panel = panel_vector(buffer, deck, number)
    result = scalars(buffer, AT_DISPLACEMENT_RESULT, DISPLACEMENT_RESULT)
    work = scalars(buffer, AT_DISPLACEMENT_WORK, int(buffer[N_DISPLACEMENT_WORK]))
    drive = scalars(buffer, AT_DRIVE_SETTING, 5)
    harmonic = panel_motion(buffer, panel)
    drive[0], drive[1] = inputs[FREQUENCY], panel[INCLINATION]
    drive[2] = min(parameter[FRICTION_DECK], parameter[FRICTION_INTERNAL])
    drive[3] = inputs[DISPLACEMENT_VELOCITY]
    drive[4] = parameter[ROLLING]
    model = int(parameter[DISPLACEMENT_MODEL])
    if model == PRESCRIBED:
        prescribed(harmonic, drive, result, work)
    elif model == RIGID_BODY:
        rigid_body(harmonic, drive, result, work)
    elif model == BED:
        bed_of_grains(harmonic, drive, result, work)
    else:
        call_displacement(int(buffer[DISPLACEMENT_ADDRESS]), harmonic, drive, result, work)
    result[0] *= panel[VELOCITY_FACTOR]


@kernel
def set_transport(buffer, deck, number, scene):
    """Solve the displacement of a panel into its scene; refuses a deck too steep for its model."""
    result = scalars(buffer, AT_DISPLACEMENT_RESULT, DISPLACEMENT_RESULT)
    if not vibrates(buffer):
        for k in range(result.size):
            result[k] = 0.0
    else:
        solve_displacement(buffer, deck, number)
    if result[6] == 1.0:
        place = int(buffer[AT_PANEL]) + (deck * int(buffer[N_PANELS]) + number) * len(PANEL)
        friction = scalars(buffer, AT_DRIVE_SETTING, 5)[2]
        panel = panel_vector(buffer, deck, number)
        return refuse(buffer, TOO_STEEP, place + INCLINATION, panel[INCLINATION], friction)
    if not (isfinite(result[0]) and isfinite(result[4]) and isfinite(result[5])):
        place = int(buffer[AT_PARAMETER]) + DISPLACEMENT_MODEL
        return refuse(buffer, NO_VELOCITY, place, result[0], 0.0)
    scene[S_TRANSPORT_VELOCITY] = max(0.0, result[0])
    scene[S_DISSIPATION] = result[4]
    scene[S_THROW_NUMBER] = result[5]
    scene[S_TRANSPORT_STATUS] = result[6]
    return ACCEPTED


@kernel
def same_transport(buffer, deck, number):
    """An earlier panel (deck x panels + panel) with the same displacement, or -1."""
    panel = panel_vector(buffer, deck, number)
    panels = int(buffer[N_PANELS])
    for other in range(deck):
        for k in range(panel_count(buffer, other)):
            known = panel_vector(buffer, other, k)
            alike = known[VELOCITY_FACTOR] == panel[VELOCITY_FACTOR]
            if alike and known[INCLINATION] == panel[INCLINATION]:
                return other * panels + k
    for k in range(number):
        known = panel_vector(buffer, deck, k)
        alike = known[VELOCITY_FACTOR] == panel[VELOCITY_FACTOR]
        if alike and known[INCLINATION] == panel[INCLINATION]:
            return deck * panels + k
    return -1


@kernel
def copy_transport(buffer, known, scene):
    """Take the displacement of another panel into a scene."""
    panels = int(buffer[N_PANELS])
    other = scene_vector(buffer, AT_SCENE_NOW, known // panels, known % panels)
    for k in (S_TRANSPORT_VELOCITY, S_DISSIPATION, S_THROW_NUMBER, S_TRANSPORT_STATUS):
        scene[k] = other[k]


@kernel
def stop_together(buffer, deck):
    """A deck conveys on all of its panels or on none: one that does not stops the bed."""
    panels = panel_count(buffer, deck)
    slowest = 1e300
    for number in range(panels):
        scene = scene_vector(buffer, AT_SCENE_NOW, deck, number)
        slowest = min(slowest, scene[S_TRANSPORT_VELOCITY])
    if slowest <= 0.0:
        for number in range(panels):
            scene_vector(buffer, AT_SCENE_NOW, deck, number)[S_TRANSPORT_VELOCITY] = 0.0


# --- scene -------------------------------------------------------------------------------------
@kernel
def close_scene(buffer, deck, number, scene):
    """What the vibration of a panel does: lift the bed, and scale u and w where so chosen."""
    parameter = scalars(buffer, AT_PARAMETER, len(PARAMETER))
    closure = scalars(buffer, AT_CLOSURE, 2)
    scene[S_LOOSENING], scene[S_LIFT], scene[S_DEPLETION] = 1.0, 0.0, 0.0
    thrown = parameter[PASSAGE_LIFT] + parameter[PASSAGE_DEPLETION]
    if closure[OF_PASSAGE] + closure[OF_SEGREGATION] + thrown == 0.0:
        return
    panel = panel_vector(buffer, deck, number)
    harmonic = panel_motion(buffer, panel)
    frequency = scalars(buffer, AT_INPUT, len(INPUT))[FREQUENCY]
    scene[S_LIFT] = parameter[PASSAGE_LIFT] * throw_height(harmonic, frequency)
    velocity = max(SLOWEST_THROW, peak_normal_velocity(harmonic, frequency))
    scene[S_DEPLETION] = parameter[PASSAGE_DEPLETION] / (panel[APERTURE] * velocity)
    if closure[OF_PASSAGE] > 0.0:
        scene[S_LOOSENING] = passage_factor(harmonic, frequency, panel[APERTURE])
        scene[S_PASSAGE_VELOCITY] *= scene[S_LOOSENING]
    if closure[OF_SEGREGATION] > 0.0:
        loose = percolation_factor(harmonic, frequency, parameter[CONTACT_DEPTH])
        scene[S_SEGREGATION_VELOCITY] *= loose
        scene[S_MIXING] *= loose


@kernel
def set_scene(buffer, deck, number, scene):
    """What a panel offers to the sub-models; without vibration nothing passes or percolates."""
    parameter = scalars(buffer, AT_PARAMETER, len(PARAMETER))
    inputs = scalars(buffer, AT_INPUT, len(INPUT))
    panel = panel_vector(buffer, deck, number)
    alive = 1.0 if vibrates(buffer) else 0.0
    scene[S_DENSITY] = parameter[BULK_DENSITY]
    scene[S_CONTACT_LOAD] = parameter[BULK_DENSITY] * parameter[CONTACT_DEPTH]
    scene[S_LAYER_LOAD] = parameter[BULK_DENSITY] * parameter[LAYER_DEPTH]
    factor = vector(buffer, AT_PASSAGE_FACTOR, int(buffer[N_PANELS]), deck)[number]
    scene[S_PASSAGE_VELOCITY] = alive * parameter[PASSAGE_VELOCITY] * factor
    scene[S_SEGREGATION_VELOCITY] = alive * parameter[SEGREGATION_VELOCITY]
    scene[S_MIXING] = alive * parameter[SEGREGATION_MIXING]
    close_scene(buffer, deck, number, scene)
    scene[S_RIM], scene[S_PASSING_TIME] = parameter[PASSAGE_RIM], parameter[PASSAGE_PASSING_TIME]
    scene[S_DRIFT], scene[S_DAMPING] = parameter[PASSAGE_DRIFT], parameter[PASSAGE_DAMPING]
    scene[S_STIRRING], scene[S_CALMING] = parameter[PASSAGE_STIRRING], parameter[PASSAGE_CALMING]
    scene[S_LEVELLING] = parameter[PASSAGE_LEVELLING]
    scene[S_DILATION] = parameter[SEGREGATION_DILATION]
    scene[S_RELATIVE_DILATION] = parameter[SEGREGATION_RELATIVE_DILATION]
    scene[S_PROPORTION] = parameter[SEGREGATION_PROPORTION]
    scene[S_APERTURE], scene[S_OPEN_AREA] = panel[APERTURE], panel[OPEN_AREA]
    scene[S_FREQUENCY], scene[S_AMPLITUDE] = inputs[FREQUENCY], inputs[AMPLITUDE]
    rotation = panel[INCLINATION] - panel_vector(buffer, 0, 0)[INCLINATION]
    scene[S_THROW_ANGLE] = inputs[THROW_ANGLE] + rotation
    scene[S_ELLIPTICITY], scene[S_INCLINATION] = inputs[ELLIPTICITY], panel[INCLINATION]
    scene[S_HORIZON] = residence_time(buffer, AT_SCENE_NOW, deck)


@kernel
def motion_part(buffer):
    """How many of the first numbers of `seen` are motion, parameters and panels."""
    panels = int(buffer[N_DECKS]) * int(buffer[N_PANELS])
    return len(INPUT) - 1 + len(PARAMETER) + panels * len(PANEL) + 5 * MAX_HARMONICS


@kernel
def prepare(buffer, fresh):
    """Bring scenes and feed up to date with inputs and parameters; ACCEPTED or a refusal.

    What changed is compared with what was seen last, so that the displacement is solved only when
    motion, inclination or friction changed, and packages keep their shared trajectory otherwise.
    """
    code = check(buffer)
    if code != ACCEPTED:
        return code
    size = motion_part(buffer) + 1 + int(buffer[N_CLASSES])
    now, last = scalars(buffer, AT_SEEN_NOW, size), scalars(buffer, AT_LAST_SEEN, size)
    switch = scalars(buffer, AT_SWITCH, len(SWITCH))
    look(buffer, now)
    moved = fresh or differ(now, last, 0, motion_part(buffer))
    fed = fresh or differ(now, last, motion_part(buffer), size)
    solve = switch[W_DISPLACEMENT] == 0.0 or (moved and (fresh or displaced(buffer, now, last)))
    if not (moved or fed or solve or switch[W_SHARED] == 0.0):
        return ACCEPTED
    if moved or solve:
        code = prepare_scenes(buffer, solve)
        if code != ACCEPTED:
            return code
    scalars(buffer, AT_COUNTER, len(COUNTER))[C_DISPLACEMENT] += 1.0 if solve else 0.0
    if not (moved or fed or switch[W_SHARED] == 0.0):
        return ACCEPTED
    if fed and now[motion_part(buffer)] > 0.0:
        spread_feed(buffer)
    alike = not moved or same_rates(buffer, now, last)
    for k in range(size):
        last[k] = now[k]
    scalars(buffer, AT_MEMORY, len(MEMORY))[M_SETTLED] = 0.0
    for deck in range(int(buffer[N_DECKS])):
        join_queue(buffer, deck)
        if not alike:
            part_cohorts(buffer, deck)
    if moved:
        keep_scenes(buffer)
    start_cohort(buffer, 0, now[motion_part(buffer)])
    return ACCEPTED


@kernel
def same_rates(buffer, now, last):
    """Whether nothing changed but how the bed is conveyed: a column goes on as it would have."""
    inputs = len(INPUT) - 1
    if differ(now, last, inputs, inputs + len(PARAMETER)):
        return False
    parameter = scalars(buffer, AT_PARAMETER, len(PARAMETER))
    law, model = parameter[PASSAGE_LAW], parameter[SEGREGATION_MODEL]
    ends = S_RIM if law < BOUNCE else S_DISSIPATION
    if law > BOUNCE or model > CLASSIFIED:
        ends = FIXED_SCENE
    for deck in range(int(buffer[N_DECKS])):
        for number in range(panel_count(buffer, deck)):
            scene = scene_vector(buffer, AT_SCENE_NOW, deck, number)
            used = scene_vector(buffer, AT_SCENE, deck, number)
            if differ(scene, used, 0, ends):
                return False
    return True


@kernel
def displaced(buffer, now, last):
    """Whether anything changed that the displacement depends on."""
    inputs = len(INPUT) - 1
    if differ(now, last, 0, inputs):
        return True
    for k in (FRICTION_DECK, FRICTION_INTERNAL, ROLLING, DISPLACEMENT_MODEL):
        if now[inputs + k] != last[inputs + k]:
            return True
    first = inputs + len(PARAMETER)
    for number in range(int(buffer[N_DECKS]) * int(buffer[N_PANELS])):
        for k in (INCLINATION, VELOCITY_FACTOR):
            place = first + number * len(PANEL) + k
            if now[place] != last[place]:
                return True
    end = motion_part(buffer)
    return differ(now, last, end - 5 * MAX_HARMONICS, end)


@kernel
def prepare_scenes(buffer, solve):
    """New scenes into scene_now; the scenes in use stay as they are."""
    for deck in range(int(buffer[N_DECKS])):
        for number in range(panel_count(buffer, deck)):
            scene = scene_vector(buffer, AT_SCENE_NOW, deck, number)
            used = scene_vector(buffer, AT_SCENE, deck, number)
            for k in range(scene.size):
                scene[k] = used[k]
            if solve:
                known = same_transport(buffer, deck, number)
                if known >= 0:
                    copy_transport(buffer, known, scene)
                else:
                    code = set_transport(buffer, deck, number, scene)
                    if code != ACCEPTED:
                        return code
    for deck in range(int(buffer[N_DECKS])):
        stop_together(buffer, deck)
        for number in range(panel_count(buffer, deck)):
            set_scene(buffer, deck, number, scene_vector(buffer, AT_SCENE_NOW, deck, number))
    return ACCEPTED


@kernel
def keep_scenes(buffer):
    """Take the scenes in scene_now into use."""
    for deck in range(int(buffer[N_DECKS])):
        for number in range(panel_count(buffer, deck)):
            scene = scene_vector(buffer, AT_SCENE_NOW, deck, number)
            used = scene_vector(buffer, AT_SCENE, deck, number)
            for k in range(FIXED_SCENE):
                used[k] = scene[k]


@kernel
def spread_feed(buffer):
    """Split the fed classes over the nodes inside them, normalised to one."""
    fraction = class_vector(buffer, AT_FRACTION, 0)
    spread = class_vector(buffer, AT_CLASS_MASS, 0)
    total = 0.0
    for k in range(fraction.size):
        spread[k] = max(0.0, fraction[k])
        total += spread[k]
    for k in range(fraction.size):
        spread[k] /= total
    split_classes(
        scalars(buffer, AT_EDGE, fraction.size + 1),
        spread,
        node_vector(buffer, AT_NODE_CLASS, 0),
        node_vector(buffer, AT_NODE_POSITION, 0),
        node_vector(buffer, AT_NODE_WEIGHT, 0),
        scalars(buffer, AT_SLOPE, fraction.size + 1),
        node_vector(buffer, AT_FEED_FRACTION, 0),
    )


# --- ledger ------------------------------------------------------------------------------------
@kernel
def add_compensated(ledger_sum, ledger_rest, mass):
    """Add `mass` to sums with their compensation (Neumaier): nothing is rounded away."""
    for k in range(mass.size):
        total = ledger_sum[k] + mass[k]
        if abs(ledger_sum[k]) >= abs(mass[k]):
            ledger_rest[k] += (ledger_sum[k] - total) + mass[k]
        else:
            ledger_rest[k] += (mass[k] - total) + ledger_sum[k]
        ledger_sum[k] = total


@kernel
def book_masses(buffer):
    """Add the class masses of the step (rows fed, undersize, oversize) to the ledger."""
    for row in range(OVER + int(buffer[N_DECKS])):
        add_compensated(
            class_vector(buffer, AT_LEDGER, 2 * row),
            class_vector(buffer, AT_LEDGER, 2 * row + 1),
            class_vector(buffer, AT_CLASS_MASS, row),
        )


@kernel
def ledger_total(buffer, row):
    """Cumulative mass of all classes of a stream, kg."""
    total = 0.0
    whole = class_vector(buffer, AT_LEDGER, 2 * row)
    rest = class_vector(buffer, AT_LEDGER, 2 * row + 1)
    for k in range(whole.size):
        total += rest[k]
    for k in range(whole.size):
        total += whole[k]
    return total


@kernel
def balance_error(buffer):
    """Fed - discharged - held since the start, kg, class by class."""
    initial, held = class_vector(buffer, AT_INITIAL_MASS, 0), class_vector(buffer, AT_HELD, 0)
    error = 0.0
    for k in range(held.size):
        open_sum = class_vector(buffer, AT_LEDGER, 2 * FED)[k]
        rest = class_vector(buffer, AT_LEDGER, 2 * FED + 1)[k]
        for row in range(UNDER, OVER + int(buffer[N_DECKS])):
            open_sum -= class_vector(buffer, AT_LEDGER, 2 * row)[k]
            rest -= class_vector(buffer, AT_LEDGER, 2 * row + 1)[k]
        error += (open_sum - held[k] + initial[k]) + rest
    return error


@kernel
def count_held(buffer):
    """What lies on all decks by class, into `held`, kg."""
    node = node_vector(buffer, AT_NODE_WORK, 0)
    for i in range(node.size):
        node[i] = 0.0
    hold_up = scalars(buffer, AT_HOLD_UP_WORK, int(buffer[N_DECKS]))
    for deck in range(int(buffer[N_DECKS])):
        hold_up[deck] = held_by_node(buffer, deck, node)
    merge_classes(node, node_vector(buffer, AT_NODE_CLASS, 0), class_vector(buffer, AT_HELD, 0))


# --- outputs -----------------------------------------------------------------------------------
@kernel
def write_stream(buffer, row, fraction, duration):
    """Fractions of a stream over the step (without flow they stay); returns its mean rate, kg/s."""
    mass = class_vector(buffer, AT_CLASS_MASS, row)
    total = 0.0
    for k in range(mass.size):
        total += mass[k]
    if total > 0.0:
        for k in range(mass.size):
            fraction[k] = mass[k] / total
    return total / duration


@kernel
def write_recovery(buffer):
    """Undersize recovery and efficiency of the step: of what is fed finer than the aperture.

    The recovery is that of the box, through the lowest deck; the efficiency that of the top deck.
    """
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    size = node_vector(buffer, AT_SIZE, 0)
    passed = node_vector(buffer, AT_STEP_MASS, int(buffer[N_DECKS]) - 1)
    passed_top = node_vector(buffer, AT_STEP_MASS, 0)
    fraction = node_vector(buffer, AT_FEED_FRACTION, 0)
    aperture = panel_vector(buffer, 0, 0)[APERTURE]
    for number in range(1, panel_count(buffer, 0)):
        aperture = min(aperture, panel_vector(buffer, 0, number)[APERTURE])
    fed, out, out_top = 0.0, 0.0, 0.0
    total = 0.0
    for k in range(int(buffer[N_CLASSES])):
        total += class_vector(buffer, AT_CLASS_MASS, FED)[k]
    for i in range(size.size):
        if size[i] < aperture:
            fed += fraction[i] * total
            out += passed[i]
            out_top += passed_top[i]
    if fed > NOTHING:  # a feed that is hardly a number gives no ratio that is one
        output[UNDERSIZE_RECOVERY] = out / fed
        output[EFFICIENCY] = out_top / fed


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
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    size = node_vector(buffer, AT_SIZE, 0)
    decks = int(buffer[N_DECKS])
    fine, coarse = node_vector(buffer, AT_NODE_WORK, 0), node_vector(buffer, AT_STEP_MASS, decks)
    # What does not leave over the top deck passes it: through all decks, or over a lower one.
    passed = node_vector(buffer, AT_STEP_MASS, decks - 1)
    for i in range(size.size):
        fine[i] = passed[i]
    for deck in range(1, decks):
        between = node_vector(buffer, AT_STEP_MASS, decks + deck)
        for i in range(size.size):
            fine[i] += between[i]
    closed = 0.0
    for number in range(panel_count(buffer, 0)):
        closed = max(closed, panel_vector(buffer, 0, number)[APERTURE])
    quarter = partition_size(size, fine, coarse, 0.25, closed)
    half = partition_size(size, fine, coarse, 0.5, closed)
    three = partition_size(size, fine, coarse, 0.75, closed)
    output[ALARM_PERFORMANCE] = 1.0 if min(quarter, half, three) <= 0.0 else 0.0
    if half != 0.0:
        output[CUT_SIZE] = abs(half)
        output[ECART_PROBABLE] = 0.5 * (abs(three) - abs(quarter))


@kernel
def write_state(buffer):
    """Outputs that describe the moment: hold-up, depths, velocity, power, alarms."""
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    parameter = scalars(buffer, AT_PARAMETER, len(PARAMETER))
    inputs = scalars(buffer, AT_INPUT, len(INPUT))
    scene = scene_vector(buffer, AT_SCENE, 0, 0)
    held = class_vector(buffer, AT_HELD, 0)
    total = 0.0
    for k in range(held.size):
        total += held[k]
    output[HOLD_UP] = total
    output[BED_VELOCITY] = scene[S_TRANSPORT_VELOCITY]
    output[THROW_NUMBER_OUT] = scene[S_THROW_NUMBER]
    for alarm in (ALARM_BED_DEPTH, ALARM_CAPACITY, ALARM_TRANSPORT):
        output[alarm] = 0.0
    bed = 0.0
    for deck in range(int(buffer[N_DECKS])):
        bed += write_bed(buffer, deck)
    output[DEPTH_FEED] = deck_bed(buffer, 0)[DECK_DEPTH_FEED]
    output[DEPTH_DISCHARGE] = deck_bed(buffer, 0)[DECK_DEPTH_DISCHARGE]
    speed = 2.0 * pi * inputs[FREQUENCY]
    force = parameter[VIBRATING_MASS] * inputs[AMPLITUDE] * speed * speed
    journal = 0.5 * speed * parameter[BEARING_DIAMETER]
    bearing = parameter[BEARING_FRICTION] * force * journal
    output[DRIVE_POWER] = (bed + bearing) / parameter[DRIVE_EFFICIENCY]
    output[BALANCE_ERROR] = balance_error(buffer)


@kernel
def deck_bed(buffer, deck):
    """Outputs of the bed on a deck, indices DECK_*."""
    return vector(buffer, AT_DECK_BED, len(DECK_BED), deck)


@kernel
def write_bed(buffer, deck):
    """Hold-up, depths, velocity and alarms of a deck; returns the power that its bed takes, W."""
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    bed = deck_bed(buffer, deck)
    bed[DECK_HOLD_UP] = scalars(buffer, AT_HOLD_UP_WORK, int(buffer[N_DECKS]))[deck]
    bed[DECK_DEPTH_FEED] = depth_at_feed(buffer, deck)
    bed[DECK_DEPTH_DISCHARGE] = depth_at_discharge(buffer, deck)
    bed[DECK_VELOCITY] = scene_vector(buffer, AT_SCENE, deck, 0)[S_TRANSPORT_VELOCITY]
    panels = panel_count(buffer, deck)
    length = deck_length(buffer, deck)
    power = 0.0
    for number in range(panels):
        scene = scene_vector(buffer, AT_SCENE, deck, number)
        fall = GRAVITY * scene[S_TRANSPORT_VELOCITY] * sin(scene[S_INCLINATION])
        share = panel_vector(buffer, deck, number)[LENGTH] / length
        power += share * max(0.0, scene[S_DISSIPATION] - fall)
        if scene[S_TRANSPORT_STATUS] >= 2.0:
            output[ALARM_TRANSPORT] = 1.0
    deep = DEEP * scene_vector(buffer, AT_SCENE, deck, panels - 1)[S_APERTURE]
    if bed[DECK_DEPTH_DISCHARGE] > deep:
        output[ALARM_BED_DEPTH] = 1.0
    if deck_vector(buffer, deck)[D_CAPACITY_ALARM] > 0.0:
        output[ALARM_CAPACITY] = 1.0
    return bed[DECK_HOLD_UP] * power


@kernel
def write_sums(buffer):
    """Cumulative masses."""
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    output[FEED_MASS] = ledger_total(buffer, FED)
    output[UNDERSIZE_MASS] = ledger_total(buffer, UNDER)
    output[OVERSIZE_MASS] = ledger_total(buffer, OVER)
    for k in range(int(buffer[N_DECKS]) - 1):
        between = vector(buffer, AT_INTERMEDIATE, len(INTERMEDIATE), k)
        between[INTERMEDIATE_MASS] = ledger_total(buffer, OVER + 1 + k)


@kernel
def fed_masses(buffer, row, duration):
    """Class masses fed in the step, kg."""
    rate = max(0.0, scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE])
    mass = class_vector(buffer, AT_CLASS_MASS, row)
    merge_classes(
        node_vector(buffer, AT_FEED_FRACTION, 0), node_vector(buffer, AT_NODE_CLASS, 0), mass
    )
    for k in range(mass.size):
        mass[k] *= rate * duration


# --- entries -----------------------------------------------------------------------------------
@kernel
def steady_step(buffer, duration):
    """A step in a steady scene: all rates are known, only the sums grow."""
    for row in range(OVER + int(buffer[N_DECKS])):
        rate = class_vector(buffer, AT_STEADY_RATE, row)
        mass = class_vector(buffer, AT_CLASS_MASS, row)
        for k in range(rate.size):
            mass[k] = rate[k] * duration
    book_masses(buffer)
    write_sums(buffer)
    scalars(buffer, AT_OUTPUT, len(OUTPUT))[BALANCE_ERROR] = balance_error(buffer)
    scalars(buffer, AT_COUNTER, len(COUNTER))[C_STEADY_STEPS] += 1.0


@kernel
def move(buffer, duration):
    """Advance the decks; the masses of the step lie in step_mass and class_mass after it."""
    decks = int(buffer[N_DECKS])
    for row in range(2 * decks):
        mass = node_vector(buffer, AT_STEP_MASS, row)
        for i in range(mass.size):
            mass[i] = 0.0
    for deck in range(decks):
        deck_vector(buffer, deck)[D_CAPACITY_ALARM] = 0.0
    advance_decks(buffer, duration)
    sum_streams(buffer, duration)


@kernel
def sum_streams(buffer, duration):
    """Sum the masses of the step over the classes: what was fed, the undersize, each oversize."""
    decks = int(buffer[N_DECKS])
    fed_masses(buffer, FED, duration)
    classes = node_vector(buffer, AT_NODE_CLASS, 0)
    # What passes the lowest deck, and what leaves over each.
    for row in range(decks + 1):
        mass = node_vector(buffer, AT_STEP_MASS, decks - 1 + row)
        merge_classes(mass, classes, class_vector(buffer, AT_CLASS_MASS, UNDER + row))


@kernel
def at_rest(buffer):
    """Whether nothing vibrates and nothing is fed: nothing can change."""
    alive = max(0.0, scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE])
    for deck in range(int(buffer[N_DECKS])):
        for number in range(panel_count(buffer, deck)):
            scene = scene_vector(buffer, AT_SCENE, deck, number)
            alive += scene[S_PASSAGE_VELOCITY] + scene[S_SEGREGATION_VELOCITY]
            alive += scene[S_MIXING]
            alive += scene[S_TRANSPORT_VELOCITY]
    return alive == 0.0


@kernel
def write_streams(buffer, duration):
    """Outputs that are means over the step."""
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    under = class_vector(buffer, AT_UNDERSIZE_FRACTION, 0)
    over = class_vector(buffer, AT_OVERSIZE_FRACTION, 0)
    output[UNDERSIZE_RATE] = write_stream(buffer, UNDER, under, duration)
    output[OVERSIZE_RATE] = write_stream(buffer, OVER, over, duration)
    for k in range(int(buffer[N_DECKS]) - 1):
        fraction = class_vector(buffer, AT_INTERMEDIATE_FRACTION, k)
        between = vector(buffer, AT_INTERMEDIATE, len(INTERMEDIATE), k)
        between[INTERMEDIATE_RATE] = write_stream(buffer, OVER + 1 + k, fraction, duration)
    write_recovery(buffer)
    scalars(buffer, AT_MEMORY, len(MEMORY))[M_UNREAD] = 1.0
    if scalars(buffer, AT_SWITCH, len(SWITCH))[W_PARTITION] == 0.0:
        read_partition(buffer)


@kernel
def read_partition(buffer):
    """Cut size and ecart probable, found when somebody reads them: once for a step."""
    memory = scalars(buffer, AT_MEMORY, len(MEMORY))
    if memory[M_UNREAD] > 0.0:
        memory[M_UNREAD] = 0.0
        write_partition(buffer)
        scalars(buffer, AT_COUNTER, len(COUNTER))[C_PARTITIONS] += 1.0


@kernel
def advance(buffer, duration):
    """Advance the screen by `duration` s > 0 with the inputs in the buffer."""
    code = prepare(buffer, False)
    if code != ACCEPTED:
        return code
    memory = scalars(buffer, AT_MEMORY, len(MEMORY))
    scalars(buffer, AT_COUNTER, len(COUNTER))[C_STEPS] += 1.0
    if memory[M_SETTLED] == 1.0 and scalars(buffer, AT_SWITCH, len(SWITCH))[W_STEADY] > 0.0:
        steady_step(buffer, duration)
        return ACCEPTED
    settled = all_covered(buffer) or at_rest(buffer)
    move(buffer, duration)
    book_masses(buffer)
    count_held(buffer)
    write_streams(buffer, duration)
    write_sums(buffer)
    write_state(buffer)
    if settled and scalars(buffer, AT_SWITCH, len(SWITCH))[W_STEADY] > 0.0:
        memory[M_SETTLED] = 1.0
        for row in range(OVER + int(buffer[N_DECKS])):
            rate = class_vector(buffer, AT_STEADY_RATE, row)
            mass = class_vector(buffer, AT_CLASS_MASS, row)
            for k in range(rate.size):
                rate[k] = mass[k] / duration
    return ACCEPTED


@kernel
def initialise(buffer):
    """Start: empty decks, or full of the duty in the inputs where bed.initial is steady."""
    for deck in range(int(buffer[N_DECKS])):
        clear_deck(buffer, deck)
    code = prepare(buffer, True)
    if code != ACCEPTED:
        return code
    fraction = class_vector(buffer, AT_FRACTION, 0)
    for at in (AT_UNDERSIZE_FRACTION, AT_OVERSIZE_FRACTION):
        stream = class_vector(buffer, at, 0)
        for k in range(stream.size):
            stream[k] = fraction[k]
    for between in range(int(buffer[N_DECKS]) - 1):
        stream = class_vector(buffer, AT_INTERMEDIATE_FRACTION, between)
        for k in range(stream.size):
            stream[k] = fraction[k]
    filling = 0.0
    for deck in range(int(buffer[N_DECKS])):
        filling += residence_time(buffer, AT_SCENE, deck)
    full = scalars(buffer, AT_PARAMETER, len(PARAMETER))[INITIAL] == STEADY_START
    if full and residence_time(buffer, AT_SCENE, 0) > 0.0:
        move(buffer, FILLING * filling)
        move(buffer, 1.0)
    count_held(buffer)
    if full and residence_time(buffer, AT_SCENE, 0) > 0.0:
        held, initial = class_vector(buffer, AT_HELD, 0), class_vector(buffer, AT_INITIAL_MASS, 0)
        for k in range(held.size):
            initial[k] = held[k]
        write_streams(buffer, 1.0)
    write_state(buffer)
    return ACCEPTED
