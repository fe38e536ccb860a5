"""What a panel offers to the sub-models: medium, vibration, velocity of its bed."""

from math import isfinite, sqrt

from vibroscreen.compiler.language import kernel, numbers
from vibroscreen.kernels import checks, state
from vibroscreen.kernels.bed.travel import panel_count, riding_time_over
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics import closure, motion, opening
from vibroscreen.kernels.physics.bed_of_grains import bed_of_grains
from vibroscreen.kernels.physics.prescribed import prescribed
from vibroscreen.kernels.physics.rigid_body import rigid_body, set_motion

PRESCRIBED, RIGID_BODY = 1, 2
FIRST_OF_MOTION = state.INPUT.index("motion_frequency")
END_OF_MOTION = state.INPUT.index("motion_ellipticity") + 1
BED_VELOCITY = state.INPUT.index("displacement_velocity")
INCLINATION, VELOCITY_FACTOR = (state.PANEL.index(n) for n in ("inclination", "velocity_factor"))
THROW = motion.RESULT.index("throw")


@kernel
def vibrates(buffer):
    """Whether anything moves: a frequency, and an amplitude or a harmonic."""
    inputs, harmonic = state.inputs(buffer), state.harmonic(buffer)
    moved = abs(inputs.motion_amplitude)
    for k in range(state.MAX_HARMONICS):
        if harmonic[k, 0] > 0.0:
            moved += abs(harmonic[k, 1]) + abs(harmonic[k, 3])
    return inputs.motion_frequency > 0.0 and moved > 0.0


@kernel
def panel_motion(buffer, panel):
    """Motion of the deck along and normal to a panel as harmonics (`compose_motion`)."""
    inputs, harmonic = state.inputs(buffer), state.motion_harmonic(buffer)
    said = numbers(inputs)[FIRST_OF_MOTION:END_OF_MOTION]
    steeper = panel.inclination - state.panel(buffer, 0, 0).inclination
    motion.compose_motion(said, state.harmonic(buffer), steeper, harmonic)
    return harmonic


@kernel
def solve_displacement(buffer, deck, number):
    """Velocity of the bed on a panel and what goes with it, into displacement_result."""
    parameter, inputs = state.parameters(buffer), state.inputs(buffer)
    panel, result = state.panel(buffer, deck, number), state.displacement_result(buffer)
    extent, work = state.extent(buffer), state.displacement_work(buffer)
    drive = state.drive_setting(buffer)
    harmonic = panel_motion(buffer, panel)
    drive[0], drive[1] = inputs.motion_frequency, panel.inclination
    drive[2] = min(parameter.material_friction_deck, parameter.material_friction_internal)
    drive[3] = inputs.displacement_velocity
    drive[4] = parameter.material_rolling
    model = parameter.displacement_model
    if model == PRESCRIBED:
        prescribed(harmonic, drive, result, work)
    elif model == RIGID_BODY:
        rigid_body(harmonic, drive, result, work)
    elif model == checks.BED:
        bed_of_grains(harmonic, drive, result, work)
    else:
        set_motion(harmonic, drive, result, work)
        throw = result[THROW]
        motion.call_displacement(extent.displacement_address, harmonic, drive, result, work)
        result[THROW] = throw  # of the motion, whatever the model: percolation follows it
    result[0] *= panel.velocity_factor


@kernel
def velocity_by(buffer, model):
    """Velocity of the bed on the first panel by a displacement model [m/s]; below 0 it rides up."""
    parameter = state.parameters(buffer)
    own = parameter.displacement_model
    parameter.displacement_model = model
    solve_displacement(buffer, 0, 0)
    parameter.displacement_model = own
    return state.displacement_result(buffer)[0]


@kernel
def refuse_still(buffer):
    """Say why a bed does not move, and how fast it would ride as grains where a body rides up."""
    parameter, inputs = state.parameters(buffer), state.inputs(buffer)
    place = int(buffer[state.AT.input])
    if parameter.displacement_model == PRESCRIBED and inputs.displacement_velocity == 0.0:
        place += BED_VELOCITY
        return checks.refuse(buffer, state.REFUSED.no_bed_velocity, place, 0.0, 0.0)
    place += FIRST_OF_MOTION
    if not vibrates(buffer):
        return checks.refuse(buffer, state.REFUSED.no_conveying, place, 0.0, 0.0)
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            if state.panel(buffer, deck, number).velocity_factor == 0.0:
                still = state.panel_place(buffer, deck, number) + VELOCITY_FACTOR
                return checks.refuse(buffer, state.REFUSED.still_panel, still, 0.0, 0.0)
    if parameter.displacement_model == RIGID_BODY:
        body, grains = velocity_by(buffer, RIGID_BODY), velocity_by(buffer, checks.BED)
        if body <= 0.0 and grains > 0.0:
            return checks.refuse(buffer, state.REFUSED.body_stays, place, body, grains)
    return checks.refuse(buffer, state.REFUSED.no_conveying, place, 0.0, 0.0)


@kernel
def set_transport(buffer, deck, number, scene):
    """Solve the displacement of a panel into its scene; refuses a deck too steep for its model."""
    result = state.displacement_result(buffer)
    if not vibrates(buffer):
        vectors.fill(result, 0.0)
    else:
        solve_displacement(buffer, deck, number)
    if result[6] == 1.0:
        place = state.panel_place(buffer, deck, number) + INCLINATION
        friction = state.drive_setting(buffer)[2]
        return checks.refuse(buffer, state.REFUSED.too_steep, place, buffer[place], friction)
    if not (isfinite(result[0]) and isfinite(result[4]) and isfinite(result[5])):
        place = int(buffer[state.AT.parameter]) + checks.DISPLACEMENT_MODEL
        return checks.refuse(buffer, state.REFUSED.no_velocity, place, result[0], 0.0)
    scene.transport_velocity = max(0.0, result[0])
    scene.dissipation = result[4]
    scene.throw_number = result[5]
    scene.transport_status = result[6]
    return state.ACCEPTED


@kernel
def same_transport(buffer, deck, number):
    """An earlier panel with the same displacement, by its deck and number; deck -1: none."""
    panel = state.panel(buffer, deck, number)
    for other in range(deck + 1):
        for k in range(number if other == deck else panel_count(buffer, other)):
            known = state.panel(buffer, other, k)
            alike = known.velocity_factor == panel.velocity_factor
            if alike and known.inclination == panel.inclination:
                return other, k
    return -1, 0


@kernel
def stop_together(buffer, deck):
    """A deck conveys on all of its panels or on none: one that does not stops the bed."""
    panels = panel_count(buffer, deck)
    slowest = 1e300
    for number in range(panels):
        slowest = min(slowest, state.scene_now(buffer, deck, number).transport_velocity)
    if slowest <= 0.0:
        for number in range(panels):
            state.scene_now(buffer, deck, number).transport_velocity = 0.0


@kernel
def close_scene(buffer, deck, number, scene):
    """What the vibration of a panel does: throw the bed, and scale u and w where so chosen."""
    chosen, aperture = state.closure(buffer), state.panel(buffer, deck, number).aperture
    harmonic = panel_motion(buffer, state.panel(buffer, deck, number))
    frequency = state.inputs(buffer).motion_frequency
    scene.throw_height, throw = closure.throw_height(harmonic, frequency), scene.throw_number
    if chosen[closure.OF_PASSAGE] > 0.0:
        scene.passage_velocity *= closure.passage_factor(harmonic, frequency, aperture, throw)
    if chosen[closure.OF_SEGREGATION] > 0.0:
        loose = closure.percolation_factor(harmonic, frequency, throw)
        scene.segregation_velocity *= loose
        scene.mixing *= loose


@kernel
def set_scene(buffer, deck, number, scene):
    """What a panel offers to the sub-models; without vibration nothing passes or percolates."""
    parameter, inputs = state.parameters(buffer), state.inputs(buffer)
    panel = state.panel(buffer, deck, number)
    alive = 1.0 if vibrates(buffer) else 0.0
    density = parameter.material_bulk_density
    scene.density = density
    scene.contact_load = density * checks.contact_depth(buffer, panel)
    scene.layer_load = density * checks.layer_depth(buffer, panel)
    offered, said = numbers(scene), numbers(parameter)
    for to, come in state.OF_LAWS:
        offered[to] = said[come]
    factor = state.passage_factor(buffer, deck)[number]
    fall = sqrt(motion.GRAVITY * panel.aperture)
    passing = parameter.passage_velocity * factor + parameter.passage_relative_velocity * fall
    sinking = parameter.segregation_velocity + parameter.segregation_relative_velocity * fall
    scene.passage_velocity, scene.segregation_velocity = alive * passing, alive * sinking
    scene.mixing = alive * parameter.segregation_mixing
    close_scene(buffer, deck, number, scene)
    scene.aperture, scene.open_area = panel.aperture, panel.open_area
    scene.across, scene.along = opening.sides_of(panel)
    scene.seen, scene.closed = opening.seen_along(panel), opening.closing_size(panel, parameter)
    scene.frequency, scene.amplitude = inputs.motion_frequency, inputs.motion_amplitude
    steeper = panel.inclination - state.panel(buffer, 0, 0).inclination
    scene.throw_angle = inputs.motion_throw_angle + steeper
    scene.ellipticity, scene.inclination = inputs.motion_ellipticity, panel.inclination
    panels = panel_count(buffer, deck)
    scene.horizon = riding_time_over(buffer, True, deck, panels)


@kernel
def prepare_scenes(buffer, solve):
    """New scenes into scene_now; the scenes in use stay as they are."""
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            scene = state.scene_now(buffer, deck, number)
            used = numbers(state.scene(buffer, deck, number))
            vectors.copy(numbers(scene), used)
            if solve:
                alike, panel = same_transport(buffer, deck, number)
                if alike >= 0:
                    known = state.scene_now(buffer, alike, panel)
                    scene.transport_velocity = known.transport_velocity
                    scene.dissipation, scene.throw_number = known.dissipation, known.throw_number
                    scene.transport_status = known.transport_status
                else:
                    code = set_transport(buffer, deck, number, scene)
                    if code != state.ACCEPTED:
                        return code
    for deck in range(state.extent(buffer).decks):
        stop_together(buffer, deck)
        for number in range(panel_count(buffer, deck)):
            set_scene(buffer, deck, number, state.scene_now(buffer, deck, number))
    return state.ACCEPTED


@kernel
def keep_scenes(buffer):
    for deck in range(state.extent(buffer).decks):
        for number in range(panel_count(buffer, deck)):
            used = numbers(state.scene(buffer, deck, number))
            fixed = used[: state.FIXED_SCENE]
            vectors.copy(fixed, numbers(state.scene_now(buffer, deck, number)))
