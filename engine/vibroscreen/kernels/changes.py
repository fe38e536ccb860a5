"""What changed since the last step: scenes and feed are brought up to date, and no more."""

from vibroscreen.compiler.language import kernel, numbers
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.classes import split_classes
from vibroscreen.kernels.bed.front import join_queue, start_cohort
from vibroscreen.kernels.bed.package import part_cohorts
from vibroscreen.kernels.bed.travel import panel_count
from vibroscreen.kernels.checks import check, check_layers
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.physics.passage import BOUNCE
from vibroscreen.kernels.physics.segregation import CLASSIFIED
from vibroscreen.kernels.scene import keep_scenes, prepare_scenes

# Of the scene, what a law before `bounce` reads, and what the rates of any law of ours do.
BEFORE_BOUNCE = state.SCENE.index("passage_velocity") + 1
BEFORE_TRANSPORT = state.SCENE.index("dissipation")
# What the displacement depends on besides the motion.
_NAMES = "material_friction_deck material_friction_internal material_rolling displacement_model"
OF_DISPLACEMENT = tuple(state.PARAMETER.index(name) for name in _NAMES.split())
OF_PANEL_DISPLACEMENT = (state.PANEL.index("inclination"), state.PANEL.index("velocity_factor"))


@kernel
def put(seen, place, x):
    """Copy a vector into `seen` from a place on; returns the place behind it."""
    vectors.copy(seen[place : place + x.size], x)
    return place + x.size


@kernel
def look(buffer, seen):
    """Copy all that may change between steps to `seen`: motion first, feed last."""
    extent, inputs = state.extent(buffer), state.inputs(buffer)
    place = put(seen, 0, numbers(inputs)[1:])
    place = put(seen, place, numbers(state.parameters(buffer)))
    panels = extent.decks * extent.panels * len(state.PANEL)
    place = put(seen, place, state.vector(buffer, state.AT.panel, panels, 0))
    place = put(seen, place, state.vector(buffer, state.AT.harmonic, 5 * state.MAX_HARMONICS, 0))
    rate = max(0.0, inputs.feed_mass_flow_rate)
    seen[place] = rate
    fraction = state.fraction(buffer)
    for k in range(fraction.size):
        seen[place + 1 + k] = fraction[k] if rate > 0.0 else 0.0


@kernel
def seen(buffer):
    """What is seen now, and what was seen last."""
    size = motion_part(buffer) + 1 + state.extent(buffer).classes
    last = state.vector(buffer, state.AT.last_seen, size, 0)
    return state.vector(buffer, state.AT.seen_now, size, 0), last


@kernel
def differ(one, two, start, stop):
    for k in range(start, stop):
        if one[k] != two[k]:
            return True
    return False


@kernel
def motion_part(buffer):
    """How many of the first numbers of `seen` are motion, parameters and panels."""
    panels = state.extent(buffer).decks * state.extent(buffer).panels
    scalars = len(state.INPUT) - 1 + len(state.PARAMETER)
    return scalars + panels * len(state.PANEL) + 5 * state.MAX_HARMONICS


@kernel
def check_given(buffer):
    """Check inputs and parameters, and that the layers are those of the model."""
    return check(buffer) or check_layers(buffer)


@kernel
def prepare(buffer, fresh):
    """Check inputs and parameters and bring scenes and feed up to date; ACCEPTED or a refusal."""
    return check_given(buffer) or follow_given(buffer, fresh)


@kernel
def follow_given(buffer, fresh):
    """Bring scenes and feed up to date with inputs and parameters, which were checked.

    What changed is compared with what was seen last, so that the displacement is solved only when
    motion, inclination or friction changed, and packages keep their shared trajectory otherwise.
    Gives ACCEPTED or a refusal.
    """
    (now, last), switch = seen(buffer), state.switches(buffer)
    look(buffer, now)
    moved = fresh or differ(now, last, 0, motion_part(buffer))
    fed = fresh or differ(now, last, motion_part(buffer), now.size)
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
    vectors.copy(last, now)
    state.memory(buffer).settled = 0.0
    for deck in range(state.extent(buffer).decks):
        join_queue(buffer, deck)
        if not alike or (moved and panel_count(buffer, deck) > 1):
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
            scene = numbers(state.scene_now(buffer, deck, number))
            used = numbers(state.scene(buffer, deck, number))
            if differ(scene, used, 0, ends):
                return False
    return True


@kernel
def displaced(buffer, now, last):
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
def spread_feed(buffer):
    """Split the fed classes over the nodes inside them, normalised to one."""
    fraction, spread = state.fraction(buffer), state.class_mass(buffer, 0)
    total = 0.0
    for k in range(fraction.size):
        spread[k] = max(0.0, fraction[k])
        total += spread[k]
    vectors.ratio(spread, spread, total)
    edge, slope = state.edge(buffer), state.slope(buffer)
    node_class, position = state.node_class(buffer), state.node_position(buffer)
    weight, fed = state.node_weight(buffer), state.feed_fraction(buffer)
    split_classes(edge, spread, node_class, position, weight, slope, fed)
