"""Motion of the deck along and normal to a panel, as harmonics (MODEL.md, "Displacement")."""

from vibroscreen.compiler.elementary import cos, sin, sine_cosine
from vibroscreen.compiler.fields import record_at, record_in
from vibroscreen.compiler.language import Record, kernel, own_model, view1, view2
from vibroscreen.kernels.library import entry

# A displacement model of one's own: harmonics, drive, result and work as in rigid_body.
call_displacement = own_model("displacement", "matrix", "vector", "vector", "vector")
GRAVITY = 9.81
ROWS = 5
MAX_ORDER = 8
MAX_EDGES = 6 * MAX_ORDER + 2
DRIVE = Record("frequency inclination friction velocity rolling")
RESULT = Record("velocity spread airborne flights dissipation throw status")
# A phase and where the deck is then: xi, xi', eta, eta'.
PLACE = Record("phase along along_rate normal normal_rate")
# measured: whether losses count; least: slip velocity within the period, 0 if it sticks or turns
BODY = Record(*PLACE, "slip height rise flying travel airborne flights loss measured least")
# Velocity of the deck along and normal, and the sums of both over the steps so far, times the step.
SWUNG = Record("along normal travel rise")
# Acceleration of the body: a constant, and parts of xi'' and eta''.
LAW = Record("constant", "along", "normal")
# Offsets in the work array.
WAVE = 0  # [ROWS, 5] order, along cos, along sin, normal cos, normal sin
LAWS = WAVE + 5 * ROWS  # contact force, slip forward, slip back, flight along, flight normal
EDGE = LAWS + 15  # [MAX_EDGES, 8] a place, and the signs of the laws 0 to 2 from there on
BODY_AT = EDGE + 8 * MAX_EDGES
PLACE_AT = BODY_AT + 15
NODE = PLACE_AT + 5  # [2, 5] two places with xi'' and eta'' instead of xi and eta
PAST = NODE + 10  # [3, 4] state two periods ago, one period ago, reference
ORDER = PAST + 12  # highest order
EDGES = ORDER + 1  # number of edges in use
CONSTANT = EDGES + 1  # what the bed has beyond the rigid body, in the order of BED_CONSTANTS
ROLLS = CONSTANT + 4  # share of the grip that rolling takes
SWING_STEPS = 200
SWING = ROLLS + 1  # [SWING_STEPS, 4] the deck at the end of every step of a period (SWUNG)
WORK_SIZE = SWING + 4 * SWING_STEPS
# The body on the deck: where it is in the period, how it moves, and its sums.
body_of, place_of = record_at(BODY_AT, BODY), record_at(PLACE_AT, PLACE)
law_of, edge_of = record_in(LAWS, LAW, 3), record_in(EDGE, PLACE, 8)
node_of = record_in(NODE, PLACE, 5)
swung_of = record_in(SWING, SWUNG, 4)


@kernel
def wave_of(work):
    return view2(work, WAVE, ROWS, 5)


@kernel
def moving_of(work):
    """What repeats with the period: slip, height, rise, and whether the body flies."""
    return view1(work, BODY_AT + len(PLACE), 4)


@entry("void(vector, matrix, float64, matrix)")
def compose_motion(motion, extra, rotation, harmonic):
    """Motion of the deck along and normal to a panel [m] as harmonics.

    motion[4] = frequency, amplitude, throw angle, ellipticity of the first panel; extra[k, 5] =
    order, along, along phase, normal, normal phase; rotation = inclination of the panel minus that
    of the first one [rad], so that the throw angle b becomes b + rotation. Written to
    harmonic[5, 5]: order, then the factors of cos and sin along and of cos and sin normal.
    """
    amplitude, throw_angle = motion[1], motion[2] + rotation
    harmonic[0, 0] = 1.0
    harmonic[0, 1] = -amplitude * motion[3] * sin(throw_angle)
    harmonic[0, 2] = amplitude * cos(throw_angle)
    harmonic[0, 3] = amplitude * motion[3] * cos(throw_angle)
    harmonic[0, 4] = amplitude * sin(throw_angle)
    turn_cos, turn_sin = cos(rotation), sin(rotation)
    for k in range(ROWS - 1):
        along_cos = extra[k, 1] * cos(extra[k, 2])
        along_sin = -extra[k, 1] * sin(extra[k, 2])
        normal_cos = extra[k, 3] * cos(extra[k, 4])
        normal_sin = -extra[k, 3] * sin(extra[k, 4])
        harmonic[k + 1, 0] = extra[k, 0]
        harmonic[k + 1, 1] = along_cos * turn_cos - normal_cos * turn_sin
        harmonic[k + 1, 2] = along_sin * turn_cos - normal_sin * turn_sin
        harmonic[k + 1, 3] = along_cos * turn_sin + normal_cos * turn_cos
        harmonic[k + 1, 4] = along_sin * turn_sin + normal_sin * turn_cos


@kernel
def wave_at(wave, phase, derivative):
    """Derivative of order `derivative` of xi and eta, then the next one of both."""
    along, normal, along_rate, normal_rate = 0.0, 0.0, 0.0, 0.0
    first_sine, first_cosine = sine_cosine(phase)
    for k in range(ROWS):
        order = wave[k, 0]
        if order == 0.0:
            break
        sine, cosine = first_sine, first_cosine
        for _ in range(int(order) - 1):
            turned = cosine * first_cosine - sine * first_sine
            sine, cosine = sine * first_cosine + cosine * first_sine, turned
        if derivative & 1:
            cosine, sine = -sine, cosine
        factor = 1.0
        for _ in range(derivative):
            factor *= order
        if derivative & 2:
            factor = -factor
        along += factor * (wave[k, 1] * cosine + wave[k, 2] * sine)
        normal += factor * (wave[k, 3] * cosine + wave[k, 4] * sine)
        factor *= order
        along_rate += factor * (wave[k, 2] * cosine - wave[k, 1] * sine)
        normal_rate += factor * (wave[k, 4] * cosine - wave[k, 3] * sine)
    return along, normal, along_rate, normal_rate
