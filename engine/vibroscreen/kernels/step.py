"""One communication step: check, displacement, feed, deck, ledger, outputs (MODEL.md, "A step").

`advance` and `initialise` give a code of state.py; anything but ACCEPTED means that nothing was
changed and that the field `refusal` says what was wrong. Python enters by kernels/entry.py.
"""

from math import isfinite, pi

from vibroscreen.compiler.elementary import sin
from vibroscreen.compiler.language import (
    Record,
    kernel,
    numbers,
    record,
    view2,
)
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.cascade import advance_decks, all_covered
from vibroscreen.kernels.bed.classes import merge_classes, split_classes
from vibroscreen.kernels.bed.deck import clear_deck
from vibroscreen.kernels.bed.front import join_queue, start_cohort
from vibroscreen.kernels.bed.held import depth_at_discharge, depth_at_feed, held_by_node
from vibroscreen.kernels.bed.package import part_cohorts
from vibroscreen.kernels.bed.travel import (
    deck_length,
    panel_count,
    residence_time,
    riding_time_over,
)
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.physics.bed_of_grains import bed_of_grains
from vibroscreen.kernels.physics.closure import (
    OF_PASSAGE,
    OF_SEGREGATION,
    passage_factor,
    peak_normal_velocity,
    percolation_factor,
    throw_height,
)
from vibroscreen.kernels.physics.layer import NOTHING
from vibroscreen.kernels.physics.motion import GRAVITY, call_displacement, compose_motion
from vibroscreen.kernels.physics.passage import BOUNCE
from vibroscreen.kernels.physics.prescribed import prescribed
from vibroscreen.kernels.physics.rigid_body import rigid_body
from vibroscreen.kernels.physics.segregation import CLASSIFIED, EXCHANGE

PRESCRIBED, RIGID_BODY, BED = 1, 2, 3
STEADY_START = 2  # bed.initial
# A feed or fraction this little below its limit is round-off of another tool.
ROUND_OFF = 1e-9
FRACTION_SUM = 1e-3
# The bed is deep at the discharge above this many apertures.
DEEP = 4.0
# A throw below this velocity, m/s, renews nothing.
SLOWEST_THROW = 1e-9
# Of the scene, what a law before `bounce` reads, and what the rates of any law of ours do.
BEFORE_BOUNCE, BEFORE_TRANSPORT = state.SCENE.index("rim"), state.SCENE.index("dissipation")
FIRST_OF_MOTION = state.INPUT.index("frequency")
END_OF_MOTION = state.INPUT.index("ellipticity") + 1
# What the displacement depends on besides the motion.
OF_DISPLACEMENT = tuple(
    state.PARAMETER.index(name)
    for name in ("friction_deck", "friction_internal", "rolling", "displacement_model")
)
PASSAGE_LAW = state.PARAMETER.index("passage_law")
SEGREGATION_MODEL = state.PARAMETER.index("segregation_model")
DISPLACEMENT_MODEL = state.PARAMETER.index("displacement_model")
INCLINATION = state.PANEL.index("inclination")
OF_PANEL_DISPLACEMENT = (state.PANEL.index("inclination"), state.PANEL.index("velocity_factor"))
# Residence times in which a deck is surely full of the duty.
FILLING = 1.01


def _limits(
    kind: Record, *limits: tuple[str, float, float]
) -> tuple[tuple[int, float, float], ...]:
    """Places in a record of what is limited, with the least and the most."""
    return tuple((kind.index(name), least, most) for name, least, most in limits)


# Limits of what can change while a plant runs.
INPUT_LIMITS = _limits(
    state.INPUT,
    ("feed_rate", -ROUND_OFF, 1e6),
    ("frequency", 0.0, 100.0),
    ("amplitude", 0.0, 1.0),
    ("throw_angle", -pi, pi),
    ("ellipticity", -1.0, 1.0),
    ("displacement_velocity", 0.0, 20.0),
)
PARAMETER_LIMITS = _limits(
    state.PARAMETER,
    ("friction_deck", 0.0, 100.0),
    ("friction_internal", 0.0, 100.0),
    ("rolling", 0.0, 0.95),
    ("passage_velocity", 0.0, 100.0),
    ("passage_rim", 0.0, 1.0),
    ("passage_passing_time", 0.0, 100.0),
    ("passage_drift", 0.0, 10.0),
    ("passage_damping", 0.0, 100.0),
    ("passage_lift", 0.0, 100.0),
    ("passage_stirring", 0.0, 100.0),
    ("passage_calming", 0.0, 100.0),
    ("passage_depletion", 0.0, 100.0),
    ("passage_levelling", 0.0, 100.0),
    ("segregation_velocity", 0.0, 100.0),
    ("segregation_dilation", 0.0, 1.0),
    ("segregation_relative_dilation", 0.0, 10.0),
    ("segregation_mixing", 0.0, 100.0),
    ("segregation_proportion", 0.0, 1.0),
)
PANEL_LIMITS = _limits(
    state.PANEL,
    ("inclination", -0.5 * pi, 0.5 * pi),
    ("open_area", 0.0, 1.0),
    ("velocity_factor", 0.0, 10.0),
)


# --- checks ------------------------------------------------------------------------------------
@kernel
def refuse(buffer, code, index, value, limit):
    """Say why a step is refused; `index` is a place of the buffer."""
    refusal = state.refusal(buffer)
    refusal.code, refusal.index = code, index
    refusal.value, refusal.limit = value, limit
    return code


@kernel
def check_value(buffer, index, least, most):
    """Check one place of the buffer against its limits."""
    value = buffer[index]
    if not isfinite(value):
        return refuse(buffer, state.NOT_FINITE, index, value, 0.0)
    if value < least:
        return refuse(buffer, state.TOO_SMALL, index, value, least)
    if value > most:
        return refuse(buffer, state.TOO_LARGE, index, value, most)
    return state.ACCEPTED


@kernel
def check_fractions(buffer):
    """Check the feed fractions; they count only while something is fed."""
    start = int(buffer[state.AT.fraction])
    classes = state.extent(buffer).classes
    total = 0.0
    for k in range(classes):
        code = check_value(buffer, start + k, -ROUND_OFF, 1.0 + ROUND_OFF)
        if code != state.ACCEPTED:
            return code
        total += max(0.0, buffer[start + k])
    if abs(total - 1.0) > FRACTION_SUM:
        return refuse(buffer, state.BAD_SUM, start, total, FRACTION_SUM)
    return state.ACCEPTED


@kernel
def check_model(buffer, index, built_in, address):
    """Check the number of a sub-model: built in, or a user's own that is there."""
    place = int(buffer[state.AT.parameter]) + index
    number = buffer[place]
    if number < 1.0 or (number > built_in and address <= 0):
        return refuse(buffer, state.NO_MODEL, place, number, built_in)
    return state.ACCEPTED


@kernel
def check_models(buffer):
    """Check the sub-models; layers must be there if, and only if, the segregation uses them."""
    extent = state.extent(buffer)
    code = check_model(buffer, PASSAGE_LAW, BOUNCE, extent.passage_address)
    if code == state.ACCEPTED:
        code = check_model(buffer, DISPLACEMENT_MODEL, BED, extent.displacement_address)
    if code == state.ACCEPTED:
        code = check_model(buffer, SEGREGATION_MODEL, CLASSIFIED, extent.segregation_address)
    place = int(buffer[state.AT.parameter]) + SEGREGATION_MODEL
    number = buffer[place]
    if code == state.ACCEPTED and number <= CLASSIFIED:
        if (extent.layered > 0) != (number == EXCHANGE):
            return refuse(buffer, state.NO_MODEL, place, number, CLASSIFIED)
    return code


@kernel
def check(buffer):
    """Check all that may change between steps, before anything changes."""
    for index, least, most in INPUT_LIMITS:
        code = check_value(buffer, int(buffer[state.AT.input]) + index, least, most)
        if code != state.ACCEPTED:
            return code
    for index, least, most in PARAMETER_LIMITS:
        code = check_value(buffer, int(buffer[state.AT.parameter]) + index, least, most)
        if code != state.ACCEPTED:
            return code
    for number in range(state.extent(buffer).decks * state.extent(buffer).panels):
        for index, least, most in PANEL_LIMITS:
            place = int(buffer[state.AT.panel]) + number * len(state.PANEL) + index
            code = check_value(buffer, place, least, most)
            if code != state.ACCEPTED:
                return code
    if state.inputs(buffer).feed_rate > 0.0:
        code = check_fractions(buffer)
        if code != state.ACCEPTED:
            return code
    return check_models(buffer)


# --- what changed ------------------------------------------------------------------------------
@kernel
def look(buffer, seen):
    """Copy all that may change between steps to `seen`: motion first, feed last."""
    parameter = numbers(state.parameters(buffer))
    inputs = numbers(state.inputs(buffer))
    place = 0
    for k in range(1, inputs.size):
        seen[place] = inputs[k]
        place += 1
    for k in range(parameter.size):
        seen[place] = parameter[k]
        place += 1
    for deck in range(state.extent(buffer).decks):
        for number in range(state.extent(buffer).panels):
            panel = numbers(state.panel(buffer, deck, number))
            for k in range(panel.size):
                seen[place] = panel[k]
                place += 1
    harmonic = view2(buffer, int(buffer[state.AT.harmonic]), state.MAX_HARMONICS, 5)
    for k in range(state.MAX_HARMONICS):
        for part in range(5):
            seen[place] = harmonic[k, part]
            place += 1
    rate = max(0.0, state.inputs(buffer).feed_rate)
    seen[place] = rate
    fraction = state.class_vector(buffer, state.AT.fraction, 0)
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
    inputs = state.inputs(buffer)
    moved = abs(inputs.amplitude)
    harmonic = view2(buffer, int(buffer[state.AT.harmonic]), state.MAX_HARMONICS, 5)
    for k in range(state.MAX_HARMONICS):
        if harmonic[k, 0] > 0.0:
            moved += abs(harmonic[k, 1]) + abs(harmonic[k, 3])
    return inputs.frequency > 0.0 and moved > 0.0


@kernel
def panel_motion(buffer, panel):
    """Motion of the deck along and normal to a panel as harmonics (`compose_motion`)."""
    inputs = state.inputs(buffer)
    harmonic = view2(buffer, int(buffer[state.AT.motion_harmonic]), state.MAX_HARMONICS + 1, 5)
    extra = view2(buffer, int(buffer[state.AT.harmonic]), state.MAX_HARMONICS, 5)
    rotation = panel.inclination - state.panel(buffer, 0, 0).inclination
    compose_motion(numbers(inputs)[FIRST_OF_MOTION:END_OF_MOTION], extra, rotation, harmonic)
    return harmonic


@kernel
def solve_displacement(buffer, deck, number):
    """Velocity of the bed on a panel and what goes with it, into displacement_result."""
    parameter = state.parameters(buffer)
    inputs = state.inputs(buffer)
    panel = state.panel(buffer, deck, number)
    result = state.scalars(buffer, state.AT.displacement_result, state.DISPLACEMENT_RESULT)
    work = state.scalars(buffer, state.AT.displacement_work, state.extent(buffer).displacement_work)
    drive = state.scalars(buffer, state.AT.drive_setting, 5)
    harmonic = panel_motion(buffer, panel)
    drive[0], drive[1] = inputs.frequency, panel.inclination
    drive[2] = min(parameter.friction_deck, parameter.friction_internal)
    drive[3] = inputs.displacement_velocity
    drive[4] = parameter.rolling
    model = parameter.displacement_model
    if model == PRESCRIBED:
        prescribed(harmonic, drive, result, work)
    elif model == RIGID_BODY:
        rigid_body(harmonic, drive, result, work)
    elif model == BED:
        bed_of_grains(harmonic, drive, result, work)
    else:
        call_displacement(state.extent(buffer).displacement_address, harmonic, drive, result, work)
    result[0] *= panel.velocity_factor


@kernel
def set_transport(buffer, deck, number, scene):
    """Solve the displacement of a panel into its scene; refuses a deck too steep for its model."""
    result = state.scalars(buffer, state.AT.displacement_result, state.DISPLACEMENT_RESULT)
    if not vibrates(buffer):
        for k in range(result.size):
            result[k] = 0.0
    else:
        solve_displacement(buffer, deck, number)
    if result[6] == 1.0:
        place = int(buffer[state.AT.panel]) + (deck * state.extent(buffer).panels + number) * len(
            state.PANEL
        )
        friction = state.scalars(buffer, state.AT.drive_setting, 5)[2]
        panel = state.panel(buffer, deck, number)
        return refuse(buffer, state.TOO_STEEP, place + INCLINATION, panel.inclination, friction)
    if not (isfinite(result[0]) and isfinite(result[4]) and isfinite(result[5])):
        place = int(buffer[state.AT.parameter]) + DISPLACEMENT_MODEL
        return refuse(buffer, state.NO_VELOCITY, place, result[0], 0.0)
    scene.transport_velocity = max(0.0, result[0])
    scene.dissipation = result[4]
    scene.throw_number = result[5]
    scene.transport_status = result[6]
    return state.ACCEPTED


@kernel
def same_transport(buffer, deck, number):
    """An earlier panel (deck x panels + panel) with the same displacement, or -1."""
    panel = state.panel(buffer, deck, number)
    panels = state.extent(buffer).panels
    for other in range(deck):
        for k in range(panel_count(buffer, other)):
            known = state.panel(buffer, other, k)
            alike = known.velocity_factor == panel.velocity_factor
            if alike and known.inclination == panel.inclination:
                return other * panels + k
    for k in range(number):
        known = state.panel(buffer, deck, k)
        alike = known.velocity_factor == panel.velocity_factor
        if alike and known.inclination == panel.inclination:
            return deck * panels + k
    return -1


@kernel
def copy_transport(buffer, known, scene):
    """Take the displacement of another panel into a scene."""
    panels = state.extent(buffer).panels
    other = state.scene(buffer, state.AT.scene_now, known // panels, known % panels)
    scene.transport_velocity, scene.dissipation = other.transport_velocity, other.dissipation
    scene.throw_number, scene.transport_status = other.throw_number, other.transport_status


@kernel
def stop_together(buffer, deck):
    """A deck conveys on all of its panels or on none: one that does not stops the bed."""
    panels = panel_count(buffer, deck)
    slowest = 1e300
    for number in range(panels):
        scene = state.scene(buffer, state.AT.scene_now, deck, number)
        slowest = min(slowest, scene.transport_velocity)
    if slowest <= 0.0:
        for number in range(panels):
            state.scene(buffer, state.AT.scene_now, deck, number).transport_velocity = 0.0


# --- scene -------------------------------------------------------------------------------------
@kernel
def close_scene(buffer, deck, number, scene):
    """What the vibration of a panel does: lift the bed, and scale u and w where so chosen."""
    parameter = state.parameters(buffer)
    closure = state.scalars(buffer, state.AT.closure, 2)
    scene.loosening, scene.lift, scene.depletion = 1.0, 0.0, 0.0
    thrown = parameter.passage_lift + parameter.passage_depletion
    if closure[OF_PASSAGE] + closure[OF_SEGREGATION] + thrown == 0.0:
        return
    panel = state.panel(buffer, deck, number)
    harmonic = panel_motion(buffer, panel)
    frequency = state.inputs(buffer).frequency
    scene.lift = parameter.passage_lift * throw_height(harmonic, frequency)
    velocity = max(SLOWEST_THROW, peak_normal_velocity(harmonic, frequency))
    scene.depletion = parameter.passage_depletion / (panel.aperture * velocity)
    if closure[OF_PASSAGE] > 0.0:
        scene.loosening = passage_factor(harmonic, frequency, panel.aperture)
        scene.passage_velocity *= scene.loosening
    if closure[OF_SEGREGATION] > 0.0:
        loose = percolation_factor(harmonic, frequency, parameter.contact_depth)
        scene.segregation_velocity *= loose
        scene.mixing *= loose


@kernel
def set_scene(buffer, deck, number, scene):
    """What a panel offers to the sub-models; without vibration nothing passes or percolates."""
    parameter = state.parameters(buffer)
    inputs = state.inputs(buffer)
    panel = state.panel(buffer, deck, number)
    alive = 1.0 if vibrates(buffer) else 0.0
    scene.density = parameter.bulk_density
    scene.contact_load = parameter.bulk_density * parameter.contact_depth
    scene.layer_load = parameter.bulk_density * parameter.layer_depth
    factor = state.vector(buffer, state.AT.passage_factor, state.extent(buffer).panels, deck)[
        number
    ]
    scene.passage_velocity = alive * parameter.passage_velocity * factor
    scene.segregation_velocity = alive * parameter.segregation_velocity
    scene.mixing = alive * parameter.segregation_mixing
    close_scene(buffer, deck, number, scene)
    scene.rim, scene.passing_time = parameter.passage_rim, parameter.passage_passing_time
    scene.drift, scene.damping = parameter.passage_drift, parameter.passage_damping
    scene.stirring, scene.calming = parameter.passage_stirring, parameter.passage_calming
    scene.levelling = parameter.passage_levelling
    scene.dilation = parameter.segregation_dilation
    scene.relative_dilation = parameter.segregation_relative_dilation
    scene.proportion = parameter.segregation_proportion
    scene.aperture, scene.open_area = panel.aperture, panel.open_area
    scene.frequency, scene.amplitude = inputs.frequency, inputs.amplitude
    rotation = panel.inclination - state.panel(buffer, 0, 0).inclination
    scene.throw_angle = inputs.throw_angle + rotation
    scene.ellipticity, scene.inclination = inputs.ellipticity, panel.inclination
    scene.horizon = riding_time_over(buffer, state.AT.scene_now, deck)


@kernel
def motion_part(buffer):
    """How many of the first numbers of `seen` are motion, parameters and panels."""
    panels = state.extent(buffer).decks * state.extent(buffer).panels
    return (
        len(state.INPUT)
        - 1
        + len(state.PARAMETER)
        + panels * len(state.PANEL)
        + 5 * state.MAX_HARMONICS
    )


@kernel
def prepare(buffer, fresh):
    """Bring scenes and feed up to date with inputs and parameters; ACCEPTED or a refusal.

    What changed is compared with what was seen last, so that the displacement is solved only when
    motion, inclination or friction changed, and packages keep their shared trajectory otherwise.
    """
    code = check(buffer)
    if code != state.ACCEPTED:
        return code
    size = motion_part(buffer) + 1 + state.extent(buffer).classes
    now = state.scalars(buffer, state.AT.seen_now, size)
    last = state.scalars(buffer, state.AT.last_seen, size)
    switch = state.switches(buffer)
    look(buffer, now)
    moved = fresh or differ(now, last, 0, motion_part(buffer))
    fed = fresh or differ(now, last, motion_part(buffer), size)
    solve = switch.displacement == 0.0 or (moved and (fresh or displaced(buffer, now, last)))
    if not (moved or fed or solve or switch.shared_trajectory == 0.0):
        return state.ACCEPTED
    if moved or solve:
        code = prepare_scenes(buffer, solve)
        if code != state.ACCEPTED:
            return code
    state.counters(buffer).displacement_solutions += 1.0 if solve else 0.0
    if not (moved or fed or switch.shared_trajectory == 0.0):
        return state.ACCEPTED
    if fed and now[motion_part(buffer)] > 0.0:
        spread_feed(buffer)
    alike = not moved or same_rates(buffer, now, last)
    for k in range(size):
        last[k] = now[k]
    state.memory(buffer).settled = 0.0
    for deck in range(state.extent(buffer).decks):
        join_queue(buffer, deck)
        if not alike:
            part_cohorts(buffer, deck)
    if moved:
        keep_scenes(buffer)
    start_cohort(buffer, 0, now[motion_part(buffer)])
    return state.ACCEPTED


@kernel
def same_rates(buffer, now, last):
    """Whether nothing changed but how the bed is conveyed: a column goes on as it would have."""
    inputs = len(state.INPUT) - 1
    if differ(now, last, inputs, inputs + len(state.PARAMETER)):
        return False
    parameter = state.parameters(buffer)
    law, model = parameter.passage_law, parameter.segregation_model
    ends = BEFORE_BOUNCE if law < BOUNCE else BEFORE_TRANSPORT
    if law > BOUNCE or model > CLASSIFIED:
        ends = state.FIXED_SCENE
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            scene = numbers(state.scene(buffer, state.AT.scene_now, deck, number))
            used = numbers(state.scene(buffer, state.AT.scene, deck, number))
            if differ(scene, used, 0, ends):
                return False
    return True


@kernel
def displaced(buffer, now, last):
    """Whether anything changed that the displacement depends on."""
    inputs = len(state.INPUT) - 1
    if differ(now, last, 0, inputs):
        return True
    for k in OF_DISPLACEMENT:
        if now[inputs + k] != last[inputs + k]:
            return True
    first = inputs + len(state.PARAMETER)
    for number in range(state.extent(buffer).decks * state.extent(buffer).panels):
        for k in OF_PANEL_DISPLACEMENT:
            place = first + number * len(state.PANEL) + k
            if now[place] != last[place]:
                return True
    end = motion_part(buffer)
    return differ(now, last, end - 5 * state.MAX_HARMONICS, end)


@kernel
def prepare_scenes(buffer, solve):
    """New scenes into scene_now; the scenes in use stay as they are."""
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            scene = state.scene(buffer, state.AT.scene_now, deck, number)
            now, used = numbers(scene), numbers(state.scene(buffer, state.AT.scene, deck, number))
            for k in range(now.size):
                now[k] = used[k]
            if solve:
                known = same_transport(buffer, deck, number)
                if known >= 0:
                    copy_transport(buffer, known, scene)
                else:
                    code = set_transport(buffer, deck, number, scene)
                    if code != state.ACCEPTED:
                        return code
    for deck in range(state.extent(buffer).decks):
        stop_together(buffer, deck)
        for number in range(panel_count(buffer, deck)):
            set_scene(buffer, deck, number, state.scene(buffer, state.AT.scene_now, deck, number))
    return state.ACCEPTED


@kernel
def keep_scenes(buffer):
    """Take the scenes in scene_now into use."""
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            scene = numbers(state.scene(buffer, state.AT.scene_now, deck, number))
            used = numbers(state.scene(buffer, state.AT.scene, deck, number))
            for k in range(state.FIXED_SCENE):
                used[k] = scene[k]


@kernel
def spread_feed(buffer):
    """Split the fed classes over the nodes inside them, normalised to one."""
    fraction = state.class_vector(buffer, state.AT.fraction, 0)
    spread = state.class_vector(buffer, state.AT.class_mass, 0)
    total = 0.0
    for k in range(fraction.size):
        spread[k] = max(0.0, fraction[k])
        total += spread[k]
    for k in range(fraction.size):
        spread[k] /= total
    split_classes(
        state.scalars(buffer, state.AT.edge, fraction.size + 1),
        spread,
        state.node_vector(buffer, state.AT.node_class, 0),
        state.node_vector(buffer, state.AT.node_position, 0),
        state.node_vector(buffer, state.AT.node_weight, 0),
        state.scalars(buffer, state.AT.slope, fraction.size + 1),
        state.node_vector(buffer, state.AT.feed_fraction, 0),
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
    for row in range(state.OVER + state.extent(buffer).decks):
        add_compensated(
            state.class_vector(buffer, state.AT.ledger, 2 * row),
            state.class_vector(buffer, state.AT.ledger, 2 * row + 1),
            state.class_vector(buffer, state.AT.class_mass, row),
        )


@kernel
def ledger_total(buffer, row):
    """Cumulative mass of all classes of a stream, kg."""
    total = 0.0
    whole = state.class_vector(buffer, state.AT.ledger, 2 * row)
    rest = state.class_vector(buffer, state.AT.ledger, 2 * row + 1)
    for k in range(whole.size):
        total += rest[k]
    for k in range(whole.size):
        total += whole[k]
    return total


@kernel
def balance_error(buffer):
    """Fed - discharged - held since the start, kg, class by class."""
    initial = state.class_vector(buffer, state.AT.initial_mass, 0)
    held = state.class_vector(buffer, state.AT.held, 0)
    error = 0.0
    for k in range(held.size):
        open_sum = state.class_vector(buffer, state.AT.ledger, 2 * state.FED)[k]
        rest = state.class_vector(buffer, state.AT.ledger, 2 * state.FED + 1)[k]
        for row in range(state.UNDER, state.OVER + state.extent(buffer).decks):
            open_sum -= state.class_vector(buffer, state.AT.ledger, 2 * row)[k]
            rest -= state.class_vector(buffer, state.AT.ledger, 2 * row + 1)[k]
        error += (open_sum - held[k] + initial[k]) + rest
    return error


@kernel
def count_held(buffer):
    """What lies on all decks by class, into `held`, kg."""
    node = state.node_vector(buffer, state.AT.node_work, 0)
    for i in range(node.size):
        node[i] = 0.0
    hold_up = state.scalars(buffer, state.AT.hold_up_work, state.extent(buffer).decks)
    for deck in range(state.extent(buffer).decks):
        hold_up[deck] = held_by_node(buffer, deck, node)
    merge_classes(
        node,
        state.node_vector(buffer, state.AT.node_class, 0),
        state.class_vector(buffer, state.AT.held, 0),
    )


# --- outputs -----------------------------------------------------------------------------------
@kernel
def write_stream(buffer, row, fraction, duration):
    """Fractions of a stream over the step (without flow they stay); returns its mean rate, kg/s."""
    mass = state.class_vector(buffer, state.AT.class_mass, row)
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
    output = state.outputs(buffer)
    size = state.node_vector(buffer, state.AT.size, 0)
    passed = state.node_vector(buffer, state.AT.step_mass, state.extent(buffer).decks - 1)
    passed_top = state.node_vector(buffer, state.AT.step_mass, 0)
    fraction = state.node_vector(buffer, state.AT.feed_fraction, 0)
    aperture = state.panel(buffer, 0, 0).aperture
    for number in range(1, panel_count(buffer, 0)):
        aperture = min(aperture, state.panel(buffer, 0, number).aperture)
    fed, out, out_top = 0.0, 0.0, 0.0
    total = 0.0
    for k in range(state.extent(buffer).classes):
        total += state.class_vector(buffer, state.AT.class_mass, state.FED)[k]
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
    for i in range(size.size):
        fine[i] = passed[i]
    for deck in range(1, decks):
        between = state.node_vector(buffer, state.AT.step_mass, decks + deck)
        for i in range(size.size):
            fine[i] += between[i]
    closed = 0.0
    for number in range(panel_count(buffer, 0)):
        closed = max(closed, state.panel(buffer, 0, number).aperture)
    quarter = partition_size(size, fine, coarse, 0.25, closed)
    half = partition_size(size, fine, coarse, 0.5, closed)
    three = partition_size(size, fine, coarse, 0.75, closed)
    output.alarm_performance = 1.0 if min(quarter, half, three) <= 0.0 else 0.0
    if half != 0.0:
        output.cut_size = abs(half)
        output.ecart_probable = 0.5 * (abs(three) - abs(quarter))


@kernel
def write_state(buffer):
    """Outputs that describe the moment: hold-up, depths, velocity, power, alarms."""
    output = state.outputs(buffer)
    parameter = state.parameters(buffer)
    inputs = state.inputs(buffer)
    scene = state.scene(buffer, state.AT.scene, 0, 0)
    held = state.class_vector(buffer, state.AT.held, 0)
    total = 0.0
    for k in range(held.size):
        total += held[k]
    output.hold_up = total
    output.transport_velocity = scene.transport_velocity
    output.throw_number = scene.throw_number
    output.alarm_bed_depth, output.alarm_capacity, output.alarm_transport = 0.0, 0.0, 0.0
    bed = 0.0
    for deck in range(state.extent(buffer).decks):
        bed += write_bed(buffer, deck)
    output.depth_feed = deck_bed(buffer, 0).depth_feed
    output.depth_discharge = deck_bed(buffer, 0).depth_discharge
    speed = 2.0 * pi * inputs.frequency
    force = parameter.vibrating_mass * inputs.amplitude * speed * speed
    journal = 0.5 * speed * parameter.bearing_diameter
    bearing = parameter.bearing_friction * force * journal
    output.drive_power = (bed + bearing) / parameter.drive_efficiency
    output.balance_error = balance_error(buffer)


@kernel
def deck_bed(buffer, deck):
    """Outputs of the bed on a deck."""
    return record(
        buffer, int(buffer[state.AT.deck_bed]) + deck * len(state.DECK_BED), state.DECK_BED
    )


@kernel
def write_bed(buffer, deck):
    """Hold-up, depths, velocity and alarms of a deck; returns the power that its bed takes, W."""
    output = state.outputs(buffer)
    bed = deck_bed(buffer, deck)
    bed.hold_up = state.scalars(buffer, state.AT.hold_up_work, state.extent(buffer).decks)[deck]
    bed.depth_feed = depth_at_feed(buffer, deck)
    bed.depth_discharge = depth_at_discharge(buffer, deck)
    bed.transport_velocity = state.scene(buffer, state.AT.scene, deck, 0).transport_velocity
    panels = panel_count(buffer, deck)
    length = deck_length(buffer, deck)
    power = 0.0
    for number in range(panels):
        scene = state.scene(buffer, state.AT.scene, deck, number)
        fall = GRAVITY * scene.transport_velocity * sin(scene.inclination)
        share = state.panel(buffer, deck, number).length / length
        power += share * max(0.0, scene.dissipation - fall)
        if scene.transport_status >= 2.0:
            output.alarm_transport = 1.0
    deep = DEEP * state.scene(buffer, state.AT.scene, deck, panels - 1).aperture
    if bed.depth_discharge > deep:
        output.alarm_bed_depth = 1.0
    if state.book(buffer, deck).capacity_alarm > 0.0:
        output.alarm_capacity = 1.0
    return bed.hold_up * power


@kernel
def write_sums(buffer):
    """Cumulative masses."""
    output = state.outputs(buffer)
    output.feed_mass = ledger_total(buffer, state.FED)
    output.undersize_mass = ledger_total(buffer, state.UNDER)
    output.oversize_mass = ledger_total(buffer, state.OVER)
    for k in range(state.extent(buffer).decks - 1):
        between = state.intermediate(buffer, k)
        between.mass = ledger_total(buffer, state.OVER + 1 + k)


@kernel
def fed_masses(buffer, row, duration):
    """Class masses fed in the step, kg."""
    rate = max(0.0, state.inputs(buffer).feed_rate)
    mass = state.class_vector(buffer, state.AT.class_mass, row)
    merge_classes(
        state.node_vector(buffer, state.AT.feed_fraction, 0),
        state.node_vector(buffer, state.AT.node_class, 0),
        mass,
    )
    for k in range(mass.size):
        mass[k] *= rate * duration


# --- entries -----------------------------------------------------------------------------------
@kernel
def steady_step(buffer, duration):
    """A step in a steady scene: all rates are known, only the sums grow."""
    for row in range(state.OVER + state.extent(buffer).decks):
        rate = state.class_vector(buffer, state.AT.steady_rate, row)
        mass = state.class_vector(buffer, state.AT.class_mass, row)
        for k in range(rate.size):
            mass[k] = rate[k] * duration
    book_masses(buffer)
    write_sums(buffer)
    state.outputs(buffer).balance_error = balance_error(buffer)
    state.counters(buffer).steady_steps += 1.0


@kernel
def move(buffer, duration):
    """Advance the decks; the masses of the step lie in step_mass and class_mass after it."""
    decks = state.extent(buffer).decks
    for row in range(2 * decks):
        mass = state.node_vector(buffer, state.AT.step_mass, row)
        for i in range(mass.size):
            mass[i] = 0.0
    for deck in range(decks):
        state.book(buffer, deck).capacity_alarm = 0.0
    advance_decks(buffer, duration)
    sum_streams(buffer, duration)


@kernel
def sum_streams(buffer, duration):
    """Sum the masses of the step over the classes: what was fed, the undersize, each oversize."""
    decks = state.extent(buffer).decks
    fed_masses(buffer, state.FED, duration)
    classes = state.node_vector(buffer, state.AT.node_class, 0)
    # What passes the lowest deck, and what leaves over each.
    for row in range(decks + 1):
        mass = state.node_vector(buffer, state.AT.step_mass, decks - 1 + row)
        merge_classes(
            mass, classes, state.class_vector(buffer, state.AT.class_mass, state.UNDER + row)
        )


@kernel
def at_rest(buffer):
    """Whether nothing vibrates and nothing is fed: nothing can change."""
    alive = max(0.0, state.inputs(buffer).feed_rate)
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            scene = state.scene(buffer, state.AT.scene, deck, number)
            alive += scene.passage_velocity + scene.segregation_velocity
            alive += scene.mixing
            alive += scene.transport_velocity
    return alive == 0.0


@kernel
def write_streams(buffer, duration):
    """Outputs that are means over the step."""
    output = state.outputs(buffer)
    under = state.class_vector(buffer, state.AT.undersize_fraction, 0)
    over = state.class_vector(buffer, state.AT.oversize_fraction, 0)
    output.undersize_rate = write_stream(buffer, state.UNDER, under, duration)
    output.oversize_rate = write_stream(buffer, state.OVER, over, duration)
    for k in range(state.extent(buffer).decks - 1):
        fraction = state.class_vector(buffer, state.AT.intermediate_fraction, k)
        between = state.intermediate(buffer, k)
        between.rate = write_stream(buffer, state.OVER + 1 + k, fraction, duration)
    write_recovery(buffer)
    state.memory(buffer).unread = 1.0


@kernel
def read_partition(buffer):
    """Cut size and ecart probable, found when somebody reads them: once for a step."""
    memory = state.memory(buffer)
    if memory.unread > 0.0:
        memory.unread = 0.0
        write_partition(buffer)
        state.counters(buffer).partitions += 1.0


@kernel
def advance(buffer, duration):
    """Advance the screen by `duration` s > 0 with the inputs in the buffer."""
    code = prepare(buffer, False)
    if code != state.ACCEPTED:
        return code
    memory = state.memory(buffer)
    state.counters(buffer).steps += 1.0
    if memory.settled == 1.0 and state.switches(buffer).steady_scene > 0.0:
        steady_step(buffer, duration)
        return state.ACCEPTED
    settled = all_covered(buffer) or at_rest(buffer)
    move(buffer, duration)
    book_masses(buffer)
    count_held(buffer)
    write_streams(buffer, duration)
    write_sums(buffer)
    write_state(buffer)
    if settled and state.switches(buffer).steady_scene > 0.0:
        memory.settled = 1.0
        for row in range(state.OVER + state.extent(buffer).decks):
            rate = state.class_vector(buffer, state.AT.steady_rate, row)
            mass = state.class_vector(buffer, state.AT.class_mass, row)
            for k in range(rate.size):
                rate[k] = mass[k] / duration
    return state.ACCEPTED


@kernel
def initialise(buffer):
    """Start: empty decks, or full of the duty in the inputs where bed.initial is steady."""
    for deck in range(state.extent(buffer).decks):
        clear_deck(buffer, deck)
    code = prepare(buffer, True)
    if code != state.ACCEPTED:
        return code
    fraction = state.class_vector(buffer, state.AT.fraction, 0)
    for at in (state.AT.undersize_fraction, state.AT.oversize_fraction):
        stream = state.class_vector(buffer, at, 0)
        for k in range(stream.size):
            stream[k] = fraction[k]
    for between in range(state.extent(buffer).decks - 1):
        stream = state.class_vector(buffer, state.AT.intermediate_fraction, between)
        for k in range(stream.size):
            stream[k] = fraction[k]
    filling = 0.0
    for deck in range(state.extent(buffer).decks):
        filling += residence_time(buffer, deck)
    full = state.parameters(buffer).initial == STEADY_START
    if full and residence_time(buffer, 0) > 0.0:
        move(buffer, FILLING * filling)
        move(buffer, 1.0)
    count_held(buffer)
    if full and residence_time(buffer, 0) > 0.0:
        held = state.class_vector(buffer, state.AT.held, 0)
        initial = state.class_vector(buffer, state.AT.initial_mass, 0)
        for k in range(held.size):
            initial[k] = held[k]
        write_streams(buffer, 1.0)
    write_state(buffer)
    return state.ACCEPTED
