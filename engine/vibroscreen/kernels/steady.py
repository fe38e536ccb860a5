"""One slice followed from the feed to the discharge of every deck, or kept on a plate.

No packages are needed: a slice of a lower deck starts empty and takes up what falls on it, read
from the knots of the deck above (MODEL.md, "Steady state and batches").
"""

from __future__ import annotations

from vibroscreen.kernels.classes import build_nodes, most_nodes, set_strength
from vibroscreen.kernels.deck import advance_lead, cross_lead, start_cohort
from vibroscreen.kernels.language import kernel, view1
from vibroscreen.kernels.layout import (
    ACCEPTED,
    APERTURE,
    AT_APERTURES,
    AT_CARRY,
    AT_CLASS_MASS,
    AT_DESIGN,
    AT_DESIGN_HARMONIC,
    AT_DESIGN_RESULT,
    AT_EDGE,
    AT_FALL_COHORT,
    AT_FEED_FRACTION,
    AT_HARMONIC,
    AT_HOLD_UP_WORK,
    AT_INPUT,
    AT_LAST_SEEN,
    AT_LEAD,
    AT_LEAD_FEED,
    AT_LEAD_PASSED,
    AT_NODE_CLASS,
    AT_NODE_POSITION,
    AT_NODE_WEIGHT,
    AT_OUTPUT,
    AT_PARAMETER,
    AT_PARTIAL,
    AT_RECOVERY,
    AT_REFUSAL,
    AT_SCENE,
    AT_SIZE,
    AT_STEP_MASS,
    AT_STRENGTH,
    CUT_SIZE,
    D_CAPACITY_ALARM,
    D_COHORT_FRONT,
    D_LEAD_LAYERS,
    D_LEAD_PANEL,
    D_PACE,
    D_PARTIAL_LAYERS,
    D_STEP,
    D_WIDE,
    ECART_PROBABLE,
    F_CODE,
    F_CUT_SIZE,
    F_ECART,
    F_HOLD_UP,
    F_RECOVERY,
    F_RESIDENCE,
    F_VELOCITY,
    FEED_RATE,
    FIGURE,
    FREQUENCY,
    INPUT,
    LENGTH,
    MAX_HARMONICS,
    N_CLASSES,
    N_DECKS,
    N_NODES,
    N_PANELS,
    NO_CONVEYING,
    NO_FEED,
    OPEN_AREA,
    OUTPUT,
    OVER,
    PARAMETER,
    R_INDEX,
    R_LIMIT,
    R_VALUE,
    REFUSAL,
    S_HORIZON,
    S_TRANSPORT_VELOCITY,
    SUBDIVISION,
    UNDER,
    UNDERSIZE_RECOVERY,
    class_vector,
    column,
    deck_vector,
    node_vector,
    panel_vector,
    scalars,
    scene_vector,
    vector,
)
from vibroscreen.kernels.place import (
    conveys,
    deck_width,
    panel_count,
    panel_end_time,
    panel_velocity,
    residence_time,
)
from vibroscreen.kernels.rates import bed_load, restack
from vibroscreen.kernels.step import (
    motion_part,
    prepare,
    read_partition,
    refuse,
    sum_streams,
    write_streams,
)


@kernel
def start_slice(buffer, deck):
    """Put a slice at the feed end of a deck: on the top one what is fed, on a lower one nothing."""
    rate = max(0.0, scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE])
    start_cohort(buffer, deck, rate)
    clear_slice(buffer, deck)


@kernel
def clear_slice(buffer, deck):
    """Zero the sums that a slice adds to."""
    decks = int(buffer[N_DECKS])
    carry, fallen = node_vector(buffer, AT_CARRY, deck), node_vector(buffer, AT_FALL_COHORT, deck)
    under = node_vector(buffer, AT_STEP_MASS, deck)
    over = node_vector(buffer, AT_STEP_MASS, decks + deck)
    partial = column(buffer, AT_PARTIAL, deck)
    for i in range(carry.size):
        carry[i], fallen[i], under[i], over[i] = 0.0, 0.0, 0.0, 0.0
    for j in range(partial.shape[0]):
        for i in range(carry.size):
            partial[j, i] = 0.0
    deck_vector(buffer, deck)[D_CAPACITY_ALARM] = 0.0


@kernel
def place_nodes(buffer):
    """Write the nodes of the screen in the buffer, and how many there are."""
    decks = int(buffer[N_DECKS])
    parameter = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)
    strength = scalars(buffer, AT_STRENGTH, 2)
    apertures = scalars(buffer, AT_APERTURES, decks * int(buffer[N_PANELS]))
    count = 0
    area, reach = 0.0, 0.0
    for deck in range(decks):
        open_length = 0.0
        for number in range(panel_count(buffer, deck)):
            panel = panel_vector(buffer, deck, number)
            open_length += panel[LENGTH] * panel[OPEN_AREA]
            # Sorted in.
            place = count
            while place > 0 and apertures[place - 1] > panel[APERTURE]:
                apertures[place] = apertures[place - 1]
                place -= 1
            apertures[place] = panel[APERTURE]
            count += 1
        reach = max(reach, open_length)
        area = max(area, open_length * deck_width(buffer, deck))
    feed = scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE]
    set_strength(parameter, area / feed if feed > 0.0 else 0.0, reach, strength)
    room = most_nodes(int(buffer[N_CLASSES]), decks * int(buffer[N_PANELS]), parameter[SUBDIVISION])
    buffer[N_NODES] = build_nodes(
        scalars(buffer, AT_EDGE, int(buffer[N_CLASSES]) + 1),
        view1(buffer, int(buffer[AT_APERTURES]), count),
        parameter,
        strength,
        scalars(buffer, AT_SIZE, room),
        scalars(buffer, AT_NODE_CLASS, room),
        scalars(buffer, AT_NODE_POSITION, room),
        scalars(buffer, AT_NODE_WEIGHT, room),
    )


@kernel
def prepare_slice(buffer):
    """Take the inputs in the buffer into use and start a slice on the top deck; ACCEPTED or not."""
    code = prepare(buffer, False)
    if code == ACCEPTED:
        for deck in range(int(buffer[N_DECKS])):
            horizon = residence_time(buffer, AT_SCENE, deck)
            for panel in range(panel_count(buffer, deck)):
                scene_vector(buffer, AT_SCENE, deck, panel)[S_HORIZON] = horizon
        start_slice(buffer, 0)
    return code


@kernel
def follow(buffer, deck, duration):
    """Let the slice of a deck ride on for `duration` s, over the ends of panels."""
    book = deck_vector(buffer, deck)
    left = duration
    while left > 0.0:
        panel = int(book[D_LEAD_PANEL])
        step = left
        crosses = False
        if conveys(buffer, deck) and panel + 1 < panel_count(buffer, deck):
            until = panel_end_time(buffer, AT_SCENE, deck, panel) - book[D_COHORT_FRONT]
            crosses = until <= left
            step = max(0.0, until) if crosses else left
        if step > 0.0:
            advance_lead(buffer, deck, step)
        book[D_COHORT_FRONT] += step
        left -= step
        if crosses:
            book[D_COHORT_FRONT] = panel_end_time(buffer, AT_SCENE, deck, panel)
            cross_lead(buffer, deck)


@kernel
def lay_batch(buffer, areal_mass, horizon):
    """Put a batch of `areal_mass` kg/m2 of the feed's composition on the plate."""
    book = deck_vector(buffer, 0)
    scene = scene_vector(buffer, AT_SCENE, 0, 0)
    lead = column(buffer, AT_LEAD, 0)
    fed, passed = node_vector(buffer, AT_LEAD_FEED, 0), node_vector(buffer, AT_LEAD_PASSED, 0)
    fraction = node_vector(buffer, AT_FEED_FRACTION, 0)
    for i in range(fed.size):
        fed[i] = areal_mass * fraction[i]
        passed[i] = 0.0
        for j in range(lead.shape[0]):
            lead[j, i] = 0.0
        lead[0, i] = fed[i]
    scene[S_HORIZON] = horizon
    book[D_STEP], book[D_PACE], book[D_WIDE] = 0.0, 0.0, 0.0
    book[D_LEAD_LAYERS] = restack(buffer, scene, lead, 1)


@kernel
def solve_steady(buffer):
    """Steady state under the inputs in the buffer; ACCEPTED or why there is none.

    Afterwards `step_mass` and `class_mass` hold the streams [kg/s] by node and class, `recovery`
    the part of each class that reaches the undersize, 0 for one that is not fed, `hold_up_work`
    what lies on every deck [kg], and the outputs are those of a steady step.
    """
    place = int(buffer[AT_INPUT])
    if scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE] <= 0.0:
        return refuse(buffer, NO_FEED, place + FEED_RATE, 0.0, 0.0)
    code = prepare_slice(buffer)
    if code != ACCEPTED:
        return code
    for deck in range(int(buffer[N_DECKS])):
        if not conveys(buffer, deck):
            frequency = scalars(buffer, AT_INPUT, len(INPUT))[FREQUENCY]
            return refuse(buffer, NO_CONVEYING, place + FREQUENCY, frequency, 0.0)
    solve_decks(buffer)
    sum_streams(buffer, 1.0)
    write_streams(buffer, 1.0)
    write_recovery(buffer)
    return ACCEPTED


@kernel
def write_recovery(buffer):
    """Part of each class that reaches the undersize, from the streams by class."""
    recovery = class_vector(buffer, AT_RECOVERY, 0)
    for k in range(recovery.size):
        total = 0.0
        for row in range(UNDER, OVER + int(buffer[N_DECKS])):
            total += class_vector(buffer, AT_CLASS_MASS, row)[k]
        under = class_vector(buffer, AT_CLASS_MASS, UNDER)[k]
        recovery[k] = under / total if total > 0.0 else 0.0


@kernel
def solve_many(buffer, count, rebuild):
    """Steady states of the first `count` rows of `design`, into `design_result`.

    rebuild: whether what changes from row to row needs other nodes.
    """
    size = scalars(buffer, AT_PARAMETER, setting_size(buffer))
    seen = scalars(buffer, AT_LAST_SEEN, motion_part(buffer) + 1 + int(buffer[N_CLASSES]))
    harmonic = scalars(buffer, AT_HARMONIC, MAX_HARMONICS * 5)
    streams = OVER + int(buffer[N_DECKS])
    classes = int(buffer[N_CLASSES])
    for row in range(count):
        setting = vector(buffer, AT_DESIGN, size.size, row)
        for k in range(size.size):
            size[k] = setting[k]
        other = vector(buffer, AT_DESIGN_HARMONIC, harmonic.size, row)
        for k in range(harmonic.size):
            harmonic[k] = other[k]
        if rebuild > 0.0:
            place_nodes(buffer)
            seen[motion_part(buffer)] = -1.0  # the feed is spread over other nodes
        code = solve_steady(buffer)
        result = vector(buffer, AT_DESIGN_RESULT, len(FIGURE) + streams * classes, row)
        for k in range(result.size):
            result[k] = 0.0
        result[F_CODE] = code
        if code != ACCEPTED:
            refusal = scalars(buffer, AT_REFUSAL, REFUSAL)
            for k in (R_INDEX, R_VALUE, R_LIMIT):
                result[F_CODE + k] = refusal[k]
        else:
            write_result(buffer, result)


@kernel
def setting_size(buffer):
    """How many numbers parameters and inputs are; they lie in a row."""
    return int(buffer[AT_OUTPUT]) - int(buffer[AT_PARAMETER])


@kernel
def write_result(buffer, result):
    """Figures of a steady solution, and the class rates of its streams."""
    read_partition(buffer)
    output = scalars(buffer, AT_OUTPUT, len(OUTPUT))
    scene = scene_vector(buffer, AT_SCENE, 0, 0)
    result[F_VELOCITY] = scene[S_TRANSPORT_VELOCITY]
    result[F_RESIDENCE] = residence_time(buffer, AT_SCENE, 0)
    for deck in range(int(buffer[N_DECKS])):
        result[F_HOLD_UP] += scalars(buffer, AT_HOLD_UP_WORK, int(buffer[N_DECKS]))[deck]
    result[F_RECOVERY] = output[UNDERSIZE_RECOVERY]
    result[F_CUT_SIZE] = output[CUT_SIZE]
    result[F_ECART] = output[ECART_PROBABLE]
    place = len(FIGURE)
    for row in range(OVER + int(buffer[N_DECKS])):
        mass = class_vector(buffer, AT_CLASS_MASS, row)
        for k in range(mass.size):
            result[place] = mass[k]
            place += 1


@kernel
def solve_decks(buffer):
    """Follow the slices of all decks to the discharge; the top one's is at the feed end."""
    decks = int(buffer[N_DECKS])
    hold_up = scalars(buffer, AT_HOLD_UP_WORK, decks)
    for deck in range(decks):
        if deck > 0:
            start_slice(buffer, deck)
        if conveys(buffer, deck):
            follow(buffer, deck, residence_time(buffer, AT_SCENE, deck))
        book = deck_vector(buffer, deck)
        width = deck_width(buffer, deck)
        last = panel_count(buffer, deck) - 1
        passing = width * panel_velocity(buffer, AT_SCENE, deck, 0)
        leaving = width * panel_velocity(buffer, AT_SCENE, deck, last)
        under = node_vector(buffer, AT_STEP_MASS, deck)
        over = node_vector(buffer, AT_STEP_MASS, decks + deck)
        passed, lead = node_vector(buffer, AT_LEAD_PASSED, deck), column(buffer, AT_LEAD, deck)
        for i in range(passed.size):
            under[i] = passing * passed[i]
            over[i] = 0.0
        for j in range(int(book[D_LEAD_LAYERS])):
            for i in range(passed.size):
                over[i] += leaving * lead[j, i]
        partial = column(buffer, AT_PARTIAL, deck)
        hold_up[deck] = width * bed_load(partial, int(book[D_PARTIAL_LAYERS]))
