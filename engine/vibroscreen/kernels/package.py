"""One slice of the bed in time: sub-models give rates, one place here moves mass (MODEL.md,
"A package in time").

A column holds areal masses load[layer, node] in kg/m2; row 0 lies on the screen. It is gathered
into a compact block without the sizes that take no part, integrated there and scattered back. Four
schemes share its sub-models; three of them the rates of `column_rates`:
  the pair of Dormand and Prince, order 5 with an embedded 4, where accuracy asks for short steps;
  a chain of four to ten stages, order 3, where stability does;
  a stabilised scheme of order 2 with many stages, where the fastest rate is far beyond the step;
  an implicit step that keeps masses positive whatever its length, extrapolated, beyond all that.
All are linear in the masses they move, so every sum is kept to round-off. The error estimate sets
step (and order); steps end at the moments at which a layer runs out or is filled.
"""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np

from vibroscreen.kernels.elementary import cosh, log, raised, sinh
from vibroscreen.kernels.jit import folded, inlined, kernel, view1, view2, viewing
from vibroscreen.kernels.landing import record_knot
from vibroscreen.kernels.layout import (
    AT_COLUMN_FLUX,
    AT_COLUMN_TIME,
    AT_COMPACT,
    AT_COUNTER,
    AT_LOAD,
    AT_NODE_WORK,
    AT_PARAMETER,
    AT_PART_END,
    AT_PART_PASSED,
    AT_PART_SLOT,
    AT_PERCOLATION,
    AT_PLACE,
    AT_RECONSTRUCTION,
    AT_RECORD,
    AT_SCRATCH,
    AT_SHARE,
    AT_SIZE,
    AT_SOURCE,
    AT_SOURCE_NOW,
    AT_STAGE,
    AT_SWITCH,
    AT_TRIAL,
    AT_UPWARD,
    C_CHAIN_STEPS,
    C_COARSE_SKIPPED,
    C_COLUMN_FORCED,
    C_COLUMN_REJECTED,
    C_COLUMN_STEPS,
    C_EMPTY_SKIPPED,
    C_LANDINGS,
    C_PAIR_STEPS,
    C_RATES,
    C_STABILISED_STEPS,
    C_SUB_STEPS,
    C_USED_UP_SKIPPED,
    COUNTER,
    D_CAPACITY_ALARM,
    D_FIRST_PACE,
    D_ORDER,
    D_PACE,
    D_ROWS,
    D_SHARE,
    D_STEP,
    D_WIDE,
    LAYERED,
    MAX_ORDER,
    N_ACTIVE,
    N_LAYERS,
    N_NODES,
    N_PACKAGES,
    N_PARTS,
    N_SOURCE,
    PARAMETER,
    PART,
    PARTS_FROM,
    PASSAGE_ADDRESS,
    PASSAGE_LAW,
    RECORDED,
    RECORDED_FROM,
    S_APERTURE,
    S_BED_LOAD,
    S_CONTACT_LOAD,
    S_COVER,
    S_DENSITY,
    S_DILATION,
    S_HORIZON,
    S_LAYER_FULL,
    S_LAYER_LOAD,
    S_OPEN_AREA,
    S_PASSAGE_VELOCITY,
    S_TRANSPORT_VELOCITY,
    SEGREGATION_ADDRESS,
    SEGREGATION_MODEL,
    SEGREGATION_PROPORTION,
    SWITCH,
    TOLERANCE,
    W_COARSE,
    W_EMPTY,
    W_EXPLICIT,
    W_USED_UP,
    column,
    node_vector,
    vector,
)
from vibroscreen.kernels.passage import BOUNCE, passage_probability
from vibroscreen.kernels.segregation import (
    CLASSIFIED,
    NOTHING,
    PROPORTIONAL,
    gap_radius,
    layer_mass,
    segregate,
    weighted_mass,
)

# A layer is opened only for more than this part of a full one: round-off makes no layers.
SLIVER = 1e-9
# A top layer below this part of a full one is no reason to cut an implicit step.
THIN = 1e-3
# A step that ends where a layer runs out (or is filled) may miss it by this part of a full one.
LANDING = 1e-6
# A layer that runs out may be missed by this part of the tolerance, if that is more: what is left
# of it joins the layer below, which is the top one then and need not be full.
MISS = 0.1
# A step that should end where a layer runs out goes on for so much of what is expected; one that
# would end a little before that is made longer by up to the second factor.
PAST = 1.2
STRETCH = 1.35
# A step that went past such a moment is shortened to no less than this part of it at once.
LEAST_LANDING = 0.1
# A part of `tolerance` that a step may always use, however short it is.
LEAST_SHARE = 0.05
# Steps below this part of the horizon are taken whatever the estimate says (counted).
SHORTEST = 1e-10
# A size of which this part of the tolerance is left has passed.
USED_UP = 1e-4
# Accepted steps after which sizes are looked through again.
REVIEW = 24
# Proportions inside the sizes that move alike are equal up to this.
ALIKE = 1e-12
# Differences of a mass fraction below this bound no slope.
EVEN = 1e-14
# The explicit pair is stable up to this step times the fastest rate, and is not used where it
# would need more than STIFF / STABLE steps.
STABLE = 3.2
STIFF = 3000.0

# The stabilised scheme: its damping and the most stages of a step.
DAMPING = 2.0 / 13.0
MOST_STAGES = 60
# A first step of the pair, as a part of the longest that is stable: at a tolerance of 1e-3, and at
# most. An error of order 6 in a step meets a tolerance with its sixth root.
FIRST_PAIR, MOST_FIRST = 0.33, 0.7
# Schemes. A short step is cheapest by high order, a wide one by many cheap stages.
PAIR, CHAIN, STABILISED = range(3)
# The pair's estimate is that of order 4. Of what changes smoothly at any real rate up to the
# fastest, order 5 leaves out at most this part of it, times h times fastest rate.
HIGHER, LEAST_HIGHER = 0.39, 0.02
# Estimates may be this much above the tolerance, as what they find is mostly damped later on: the
# error of a recovery stays below it (tests/benchmarks/work_precision.py). Models that sort the bed
# have a kink at every size, where no order is left; a reconstruction has them in every layer.
MARGIN = (5.0, 7.0, 5.0)
MARGIN_SORTED = (3.0, 2.0, 5.0)
# The same for the steps of the chain that an error of third order in a step of the pair foretells,
# and how many times as long as that step they may be.
MARGIN_WIDE = 20.0
MOST_WIDER = 5.0
# A last step may be this part longer than planned: the estimate has that much in reserve.
SLACK = 0.12
# The stabilised scheme steps so much less far than the chain; it is tried where the chain's step,
# times the fastest rate, is longer than the chain is stable.
SHORTER = 1.5
# Parts of the step that an estimate allows.
SAFETY, SAFETY_WIDE = 0.93, 0.85

# Blocks of `stage`: the column, the column at a stage, the rates at the stages, time integrals.
NOW, STAGED, K1, K2, K3, K4, K5, K6, K7, INTEGRAL = range(10)
# Blocks of `trial` while rates are found: loads at the faces of the layers; and between steps: the
# time integral over a part of one.
LOWER, UPPER = 0, 1
OF_PART = 2

# Dormand and Prince (J. Comput. Appl. Math. 6 (1980) 19).
A = np.array(
    [
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
C = np.array([1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
B_LOW = np.array([5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40])
E1, E3, E4, E5, E6, E7 = (float(x) for x in (np.append(A[5], 0.0) - B_LOW)[[0, 2, 3, 4, 5, 6]])
# Weights of the time integral of the column: sum over stages of b_s a_sl.
I1, I2, I3, I4, I5 = (float(x) for x in (A[5][1:] @ A[:5])[:5])
# Within a step (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.6).
D1, D3, D4 = -12715105075 / 11282082432, 87487479700 / 32700410799, -10690763975 / 1880347072
D5, D6, D7 = 701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423

# The chain of order 3 (MODEL.md, "Explicit schemes"), 4 to 10 stages, one after the other: weights
# of the rates of the stage before in stages 2 to 10; of the first rates in the last stage; of the
# last three rates in the solution; in the error of the first rates, the last four and the next;
# h times fastest rate up to which it is stable.
CHAIN_LEAST, CHAIN_MOST = 4, 10
# fmt: off
CHAIN_TABLE = np.array([
    [0.14427046289316686, 0.5371848494887748, 0.6905904469020298, 0.0,
     0.0, 0.0, 0.0, 0.0,
     0.0, 0.11242087125897463, 0.3654955652198366, 0.2341544739408038,
     0.4003499608393596, 0.5013976595561942, 0.0, -0.7710599551085868,
     0.2602777931367525, 0.19270453789930442, -0.18332003548366424, 4.6],
    [0.06356688774762347, 0.18482727112456626, 0.5381591773810129, 0.6232849527829973,
     0.0, 0.0, 0.0, 0.0,
     0.0, 0.17482730170454278, 0.4370652729370526, 0.11566197323175036,
     0.4472727538311971, -0.4363302894244509, 1.225925418293629, -1.0292785000769114,
     0.162881436919389, 0.2582999840548957, -0.18149804976655143, 7.3],
    [0.03491340460721057, 0.09437347520458064, 0.202692675341121, 0.5336382540704556,
     0.5983727207696756, 0.0, 0.0, 0.0,
     0.0, 0.19494866229776256, 0.47681014527115223, 0.04506886211801619,
     0.4781209926108315, -0.06962907148323531, 0.5722234623283942, -0.663869497187842,
     0.04668158423692593, 0.2852052832615315, -0.1706117611557742, 10.5],
    [0.021147129397929485, 0.05448586714770053, 0.11065392763485507, 0.21119619126137487,
     0.5309639169343771, 0.5874961574319711, 0.0, 0.0,
     0.0, 0.2031794106977637, 0.49829673088043586, 0.007403938232068646,
     0.4942993308874955, -0.04794264270639428, 0.4838172413352529, -0.5495172382432685,
     -0.028825979550851567, 0.30881915616660605, -0.16635053700134458, 14.5],
    [0.013904634100353273, 0.0345697825629958, 0.06704742893389132, 0.12144235568816567,
     0.21799876593065234, 0.5332001799019902, 0.5874194315030722, 0.0,
     0.0, 0.20771313832153246, 0.5119567460923031, -0.001278858551687598,
     0.48932211245938456, -0.04349637464684547, 0.4261869187759521, -0.4630385430435354,
     -0.07103982274339878, 0.3139820114577775, -0.16259418979994994, 19.0],
    [0.009677360386705981, 0.02340862417049773, 0.043795471250583806, 0.07575933317954844,
     0.12906326228667747, 0.2231418100931081, 0.5360803652868539, 0.589130472314013,
     0.0, 0.2110950409345087, 0.5214279422075182, -0.0025821203779932064,
     0.48115417817047507, -0.04773107550380132, 0.3980151744021842, -0.40667612685299415,
     -0.09908626402803135, 0.3152693928642275, -0.15979110088158482, 24.0],
    [0.006917393955876888, 0.01638093050346751, 0.029816307535879116, 0.04977028066694128,
     0.08105840393051947, 0.1332421804952913, 0.22547317737666206, 0.5375921876948283,
     0.5893780606298459, 0.21323039415659778, 0.5257673642231893, -0.0031335390337724387,
     0.47736617481058324, -0.04948538633645205, 0.38315111466989354, -0.37710431161945296,
     -0.11432853080314959, 0.3157681939510985, -0.1580010798619375, 30.0],
])
# fmt: on
CHAIN_STAGE, CHAIN_FIRST = CHAIN_TABLE[:, :9].copy(), CHAIN_TABLE[:, 9].copy()
CHAIN_END, CHAIN_ERROR = CHAIN_TABLE[:, 10:13].copy(), CHAIN_TABLE[:, 13:19].copy()
CHAIN_STABLE = CHAIN_TABLE[:, 19].copy()


# --- the compact column --------------------------------------------------------------------------
@viewing
def active_vector(buffer, at, row):
    """Row `row` of a field of vectors over the sizes that take part."""
    return vector(buffer, at, int(buffer[N_ACTIVE]), row)


@viewing
def active_column(buffer, at):
    """A work column over the sizes that take part."""
    return view2(buffer, int(buffer[at]), int(buffer[N_LAYERS]), int(buffer[N_ACTIVE]))


@viewing
def block(buffer, at, index):
    """A block as one vector: what passed, the loads of the layers, the share of the top one."""
    rows = int(buffer[N_LAYERS]) + 2
    start = int(buffer[at]) + index * rows * int(buffer[N_NODES])
    return view1(buffer, start, rows * int(buffer[N_ACTIVE]))


@viewing
def block_passed(buffer, at, index):
    """What passed, row 0 of a block."""
    rows = int(buffer[N_LAYERS]) + 2
    start = int(buffer[at]) + index * rows * int(buffer[N_NODES])
    return view1(buffer, start, int(buffer[N_ACTIVE]))


@viewing
def block_load(buffer, at, index):
    """Loads of a block [layer, active size]."""
    rows = int(buffer[N_LAYERS]) + 2
    start = int(buffer[at]) + index * rows * int(buffer[N_NODES]) + int(buffer[N_ACTIVE])
    return view2(buffer, start, rows - 2, int(buffer[N_ACTIVE]))


@viewing
def block_share(buffer, at, index, layers):
    """Mass fractions of the top one of `layers` layers [1, active size]: the row above it."""
    rows, nodes = int(buffer[N_LAYERS]) + 2, int(buffer[N_ACTIVE])
    start = int(buffer[at]) + index * rows * int(buffer[N_NODES])
    return view2(buffer, start + (layers + 1) * nodes, 1, nodes)


@kernel
def first_coarse(buffer, scene, load, layers):
    """First of the sizes that neither pass nor percolate and are mixed alike in all layers.

    They move alike as long as nothing lands on them, so one size carries them all (their mean).
    """
    size = node_vector(buffer, AT_SIZE, 0)
    nodes = size.size
    parameter = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)
    model = int(parameter[SEGREGATION_MODEL])
    known = int(parameter[PASSAGE_LAW]) <= BOUNCE and model <= CLASSIFIED
    if vector(buffer, AT_SWITCH, len(SWITCH), 0)[W_COARSE] == 0.0 or not known:
        return nodes
    if buffer[N_SOURCE] > 0.0:
        return nodes
    closed = scene[S_APERTURE]
    if buffer[LAYERED] > 0.0:
        closed = max(closed, 2.0 * gap_radius(0.5 * size[nodes - 1], scene[S_DILATION]))
    first = nodes
    while first > 0 and size[first - 1] >= closed:
        first -= 1
    lowest = 0.0
    for i in range(first, nodes):
        lowest += load[0, i]
    for j in range(1, layers):
        mass = 0.0
        for i in range(first, nodes):
            mass += load[j, i]
        for i in range(first, nodes):
            if abs(load[j, i] * lowest - load[0, i] * mass) > ALIKE * lowest * mass:
                return nodes
    return first


@kernel
def gather(buffer, scene, load, reference, layers):
    """Copy a column into the block NOW without the sizes that take no part.

    Left out are sizes of which nothing is there or lands; what is left of a size that is used up
    passes at once; the coarse sizes that move alike become one. `place` says where a size is. The
    last size may come twice, the second time without mass.
    """
    nodes = load.shape[1]
    switch = vector(buffer, AT_SWITCH, len(SWITCH), 0)
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    tolerance = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)[TOLERANCE]
    size, total = node_vector(buffer, AT_SIZE, 0), node_vector(buffer, AT_NODE_WORK, 0)
    place, share = node_vector(buffer, AT_PLACE, 0), node_vector(buffer, AT_SHARE, 0)
    source = view2(buffer, int(buffer[AT_SOURCE]), 3, nodes)
    flux = node_vector(buffer, AT_COLUMN_FLUX, 0)
    terms = int(buffer[N_SOURCE])
    passing = scene[S_PASSAGE_VELOCITY] > 0.0 and switch[W_USED_UP] > 0.0 and terms == 0
    least = USED_UP * tolerance
    coarse = first_coarse(buffer, scene, load, layers)
    for i in range(nodes):
        total[i] = load[0, i]
    for j in range(1, layers):
        for i in range(nodes):
            total[i] += load[j, i]
    count = 0
    for i in range(coarse):
        if passing and 0.0 < total[i] < least * reference[i] and size[i] < scene[S_APERTURE]:
            flux[i] += total[i]
            total[i] = 0.0
            for j in range(layers):
                load[j, i] = 0.0
            counter[C_USED_UP_SKIPPED] += 1.0
        lands = False
        for k in range(terms):
            lands = lands or source[k, i] != 0.0
        if total[i] > 0.0 or lands or switch[W_EMPTY] == 0.0:
            place[i] = count
            count += 1
        else:
            place[i] = -1.0
            counter[C_EMPTY_SKIPPED] += 1.0
        share[i] = 1.0
    gathered, moment = 0.0, 0.0
    for i in range(coarse, nodes):
        gathered += total[i]
        moment += total[i] * size[i]
    for i in range(coarse, nodes):
        place[i] = count if gathered > 0.0 else -1.0
        share[i] = total[i] / gathered if gathered > 0.0 else 0.0
    if gathered > 0.0:
        counter[C_COARSE_SKIPPED] += nodes - coarse - 1.0
    taking_part = max(1, count + (1 if gathered > 0.0 else 0))
    # Loops go over four sizes at once: one of nothing is cheaper than three that are left over.
    idle = taking_part % 4 == 3 and taking_part < nodes
    buffer[N_ACTIVE] = taking_part + (1 if idle else 0)
    fill_block(buffer, load, reference, layers, coarse)
    compact_size = active_vector(buffer, AT_COMPACT, 0)
    if gathered > 0.0:
        compact_size[count] = moment / gathered
    if idle:
        compact_size[taking_part] = compact_size[taking_part - 1]
    return coarse


@kernel
def places_kept(place):
    """Number of the first sizes that have the same place in a block as in a column."""
    kept = 0
    while kept < place.size and place[kept] == kept:
        kept += 1
    return kept


@kernel
def fill_block(buffer, load, reference, layers, coarse):
    """Sizes, references, sources and loads of the sizes that take part into compact fields."""
    nodes = load.shape[1]
    count = int(buffer[N_ACTIVE])
    size, place = node_vector(buffer, AT_SIZE, 0), node_vector(buffer, AT_PLACE, 0)
    source = view2(buffer, int(buffer[AT_SOURCE]), 3, nodes)
    compact_size = active_vector(buffer, AT_COMPACT, 0)
    weight = active_vector(buffer, AT_COMPACT, 1)
    landing = view2(buffer, int(buffer[AT_SOURCE_NOW]), 3, count)
    now, integral = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, INTEGRAL)
    terms = int(buffer[N_SOURCE])
    rows_above = layers if terms == 0 else load.shape[0]
    for k in range((rows_above + 1) * count):
        now[k] = 0.0
        integral[k] = 0.0
    for n in range(count):
        weight[n] = 0.0
        compact_size[n] = 0.0
    for i in range(nodes):
        n = int(place[i])
        if n >= 0:
            compact_size[n] = size[i]
            weight[n] += reference[i]
    for n in range(count):
        weight[n] = 1.0 / weight[n] if weight[n] > NOTHING else 0.0
    for k in range(terms):
        for n in range(count):
            landing[k, n] = 0.0
        for i in range(nodes):
            n = int(place[i])
            if n >= 0:
                landing[k, n] = source[k, i]
    rows = block_load(buffer, AT_STAGE, NOW)
    straight = min(coarse, places_kept(place))
    for j in range(layers):
        for i in range(straight):
            rows[j, i] = load[j, i]
        for i in range(straight, coarse):
            n = int(place[i])
            if n >= 0:
                rows[j, n] = load[j, i]
        for i in range(coarse, nodes):
            n = int(place[i])
            if n >= 0:
                rows[j, n] += load[j, i]


@kernel
def scatter(buffer, load, layers, rows, elapsed):
    """Copy the block NOW back into a column of `rows` rows in use, and add its sums."""
    nodes = load.shape[1]
    place, share = node_vector(buffer, AT_PLACE, 0), node_vector(buffer, AT_SHARE, 0)
    now, integral = block_load(buffer, AT_STAGE, NOW), block_load(buffer, AT_STAGE, INTEGRAL)
    gone, gone_time = block_passed(buffer, AT_STAGE, NOW), block_passed(buffer, AT_STAGE, INTEGRAL)
    passed = node_vector(buffer, AT_COLUMN_FLUX, 0)
    passed_time = node_vector(buffer, AT_COLUMN_FLUX, 1)
    time = column(buffer, AT_COLUMN_TIME, 0)
    for i in range(nodes):
        passed_time[i] += elapsed * passed[i]
        n = int(place[i])
        if n < 0:
            continue
        passed[i] += share[i] * gone[n]
        passed_time[i] += share[i] * gone_time[n]
    # Most sizes keep their places: plain copies, which are fast.
    straight = places_kept(place)
    for j in range(rows):
        left = 1.0 if j < layers else 0.0
        for i in range(straight):
            load[j, i] = left * (share[i] * now[j, i])
            time[j, i] += share[i] * integral[j, i]
        for i in range(straight, nodes):
            n = int(place[i])
            if n >= 0:
                load[j, i] = left * (share[i] * now[j, n])
                time[j, i] += share[i] * integral[j, n]


# --- layers --------------------------------------------------------------------------------------
@kernel
def bed_load(load, layers):
    """Areal mass of a column, kg/m2."""
    mass = 0.0
    for j in range(layers):
        mass += layer_mass(load, j)
    return mass


@kernel
def layers_for(buffer, scene, mass):
    """Layers that a bed of `mass` kg/m2 has; sets the full load of an upper layer.

    A bed deeper than the layers can hold thickens the upper layers, never the contact layer.
    """
    scene[S_BED_LOAD] = mass
    scene[S_LAYER_FULL] = scene[S_LAYER_LOAD]
    above = mass - scene[S_CONTACT_LOAD]
    if buffer[LAYERED] == 0.0 or above <= SLIVER * scene[S_LAYER_LOAD]:
        return 1
    most = int(buffer[N_LAYERS]) - 1
    if above > most * scene[S_LAYER_LOAD] * (1.0 + SLIVER):
        scene[S_LAYER_FULL] = above / most
        return 1 + most
    return 1 + min(most, int(ceil(above / scene[S_LAYER_LOAD] - SLIVER)))


@kernel
def restack(buffer, scene, load, layers):
    """Settle: cut the column anew at the full loads of its layers; returns the number of layers.

    The stack keeps its order, so a layer is refilled with what lies right above it, and what does
    not fit into a layer goes to the one above. Rows that become free are zeroed.
    """
    wanted = layers_for(buffer, scene, bed_load(load, layers))
    if wanted == 1 and layers == 1:
        return 1
    nodes = load.shape[1]
    old = view2(buffer, int(buffer[AT_SCRATCH]), load.shape[0], nodes)
    for j in range(layers):
        for i in range(nodes):
            old[j, i] = load[j, i]
    source = 0
    whole = layer_mass(old, 0)
    left = 1.0  # what remains of the layer `source`, as a part of it
    for j in range(wanted):
        need = scene[S_CONTACT_LOAD] if j == 0 else scene[S_LAYER_FULL]
        for i in range(nodes):
            load[j, i] = 0.0
        while source < layers:
            last = j == wanted - 1
            part = left
            if not last and whole * left > need:
                part = need / whole
            for i in range(nodes):
                load[j, i] += part * old[source, i]
            need -= part * whole
            if part < left:
                left -= part
                break
            source += 1
            left = 1.0
            if source < layers:
                whole = layer_mass(old, source)
            if need <= 0.0 and not last:
                break
    for j in range(wanted, layers):
        for i in range(nodes):
            load[j, i] = 0.0
    return wanted


# --- rates ---------------------------------------------------------------------------------------
@folded
def passage_factors(buffer, scene, load, lower, layers, cover, contact, factor):
    """P_i of the sizes in row 0 and their contact weights; fills the percolation too.

    `lower` are the loads as they are at the lower faces of the layers; in row 0 they are `load`.
    Returns rho_b u cover: of each size the rate rho_b u cover P_i contact_i, 1/s, passes of what
    row 0 holds, as F_0i = contact_i load_0i.
    """
    parameter = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)
    size = active_vector(buffer, AT_COMPACT, 0)
    fraction = active_vector(buffer, AT_NODE_WORK, 2)
    segregate(
        int(parameter[SEGREGATION_MODEL]),
        int(buffer[SEGREGATION_ADDRESS]),
        size,
        lower,
        layers,
        scene,
        contact,
        active_column(buffer, AT_PERCOLATION),
    )
    for i in range(size.size):
        fraction[i] = contact[i] * load[0, i]
    scene[S_COVER] = cover
    law = int(parameter[PASSAGE_LAW])
    passage_probability(law, int(buffer[PASSAGE_ADDRESS]), size, fraction, scene, factor)
    return scene[S_DENSITY] * scene[S_PASSAGE_VELOCITY] * cover


@folded
def cover_of(scene, mass):
    """Part of the deck that a contact layer of `mass` kg/m2 covers, min(1, sigma_0/sigma_c)."""
    return min(1.0, mass / scene[S_CONTACT_LOAD])


@kernel
def reconstructed(buffer):
    """Whether the composition inside a layer is linear."""
    return buffer[int(buffer[AT_RECONSTRUCTION])] > 0.0


@kernel
def slope_factor(load, row, below, mass, above, share):
    """Theta of a layer: the part of the central slopes of its sizes that makes no new extremum.

    One for all sizes, so that the slopes sum up to zero and a full layer stays full at its faces.
    below, mass, above: of the three layers, kg/m2; share: span of the layer over that of the slope.
    """
    theta = 1.0
    a, b, c = 1.0 / below, 1.0 / mass, 1.0 / above
    for i in range(load.shape[1]):
        middle = b * load[row, i]
        down, up = middle - a * load[row - 1, i], c * load[row + 1, i] - middle
        least, most = min(abs(down), abs(up)), max(abs(down), abs(up))
        if most > EVEN:
            room = 2.0 * least if down * up > 0.0 else 0.0
            slope = share * abs(down + up)
            if theta * slope > room:
                theta = room / slope
    return theta


@kernel
def reconstruct(buffer, load, layers):
    """Loads as they are at the lower and upper faces of the layers, into two blocks of `trial`.

    Mass fractions are linear over a layer with a monotonised central slope, even in the contact
    layer and in the top one. The implicit scheme, whose blocks these are, does without.
    """
    lower, upper = block_load(buffer, AT_TRIAL, LOWER), block_load(buffer, AT_TRIAL, UPPER)
    nodes = load.shape[1]
    for i in range(nodes):
        lower[0, i] = upper[0, i] = load[0, i]
        lower[layers - 1, i] = upper[layers - 1, i] = load[layers - 1, i]
    below, mass = layer_mass(load, 0), layer_mass(load, 1)
    for j in range(1, layers - 1):
        above = layer_mass(load, j + 1)
        theta = 0.0
        if min(below, mass, above) > NOTHING:
            share = 2.0 * mass / (below + 2.0 * mass + above)
            theta = 0.5 * mass * share * slope_factor(load, j, below, mass, above, share)
        a, c = (theta / below, theta / above) if theta > 0.0 else (0.0, 0.0)
        for i in range(nodes):
            half = c * load[j + 1, i] - a * load[j - 1, i]
            lower[j, i], upper[j, i] = load[j, i] - half, load[j, i] + half
        below, mass = mass, above


@kernel
def column_rates(buffer, scene, at_state, state, layers, at_rate, rate, moment):
    """Rates of change of a column, from block `state` into block `rate`, kg/(m2 s).

    Passage out of row 0, percolation with its return flow, settling (what passes is refilled from
    above, layer by layer), landing on the top layer `moment` s after the start. Layers exchange
    what they hold on the average, or with `bed.reconstruction` what they hold at the face.

    What settles out of a top layer that runs out has a composition that is 0/0 at its end, so the
    composition is followed beside the masses as x' = -percolation x + return flow, in the row above
    them; where something lands, a thin top layer has that of the start of the step.
    """
    load, change = block_load(buffer, at_state, state), block_load(buffer, at_rate, rate)
    passing = block_passed(buffer, at_rate, rate)
    weight = active_vector(buffer, AT_NODE_WORK, 0)
    contact = active_vector(buffer, AT_NODE_WORK, 1)
    percolation = active_column(buffer, AT_PERCOLATION)
    nodes = passing.size
    top = layer_mass(load, layers - 1)
    upper = (layers - 2) * scene[S_LAYER_FULL]
    scene[S_BED_LOAD] = top if layers == 1 else scene[S_CONTACT_LOAD] + upper + top
    lower, upper = load, load
    if layers > 2 and reconstructed(buffer):
        reconstruct(buffer, load, layers)
        lower, upper = block_load(buffer, AT_TRIAL, LOWER), block_load(buffer, AT_TRIAL, UPPER)
    falling = follows_share(buffer, layers)
    cover = cover_of(scene, top) if layers == 1 else 1.0
    pace = passage_factors(buffer, scene, load, lower, layers, cover, contact, weight)
    for i in range(nodes):
        weight[i] = max(0.0, weight[i]) * pace * contact[i]
        passing[i] = weight[i] * load[0, i]
        change[0, i] = -passing[i]
    lost = vector_sum(passing)
    full = scene[S_CONTACT_LOAD]
    settling = lost / scene[S_LAYER_FULL]
    for j in range(1, layers):
        if j < layers - 1 or (not falling and top > THIN * scene[S_LAYER_FULL]):
            upward = weighted_mass(lower, j, percolation, j) / full
            refill = settling if j < layers - 1 else lost / top
            for i in range(nodes):
                flux = (percolation[j, i] + refill) * lower[j, i] - upward * upper[j - 1, i]
                change[j, i] = -flux
                change[j - 1, i] += flux
        elif falling:
            share = block_share(buffer, at_state, state, layers)
            share_change = block_share(buffer, at_rate, rate, layers)
            upward = weighted_mass(share, 0, percolation, j) / full
            for i in range(nodes):
                moved = percolation[j, i] * share[0, i] - upward * upper[j - 1, i]
                flux = top * moved + lost * share[0, i]
                share_change[0, i] = -moved
                change[j, i] = -flux
                change[j - 1, i] += flux
        else:
            share = block_share(buffer, AT_STAGE, NOW, layers)
            upward = weighted_mass(lower, j, percolation, j) / full
            for i in range(nodes):
                flux = percolation[j, i] * lower[j, i] - upward * upper[j - 1, i]
                flux += lost * share[0, i]
                change[j, i] = -flux
                change[j - 1, i] += flux
        full = scene[S_LAYER_FULL]
    land(buffer, change, layers - 1, moment)
    vector(buffer, AT_COUNTER, len(COUNTER), 0)[C_RATES] += 1.0
    return lost


@kernel
def follows_share(buffer, layers):
    """Whether the composition of the top layer is followed beside its masses."""
    return layers > 1 and buffer[N_SOURCE] == 0.0


@kernel
def rows_followed(buffer, layers):
    """Length of the part of a block that a scheme advances."""
    return (layers + (2 if follows_share(buffer, layers) else 1)) * int(buffer[N_ACTIVE])


@kernel
def land(buffer, change, row, moment):
    """Add to a row what lands on it `moment` s after the start, kg/(m2 s)."""
    terms = int(buffer[N_SOURCE])
    if terms == 0:
        return
    source = view2(buffer, int(buffer[AT_SOURCE_NOW]), 3, change.shape[1])
    if terms == 1:
        for i in range(change.shape[1]):
            change[row, i] += source[0, i]
    else:
        for i in range(change.shape[1]):
            change[row, i] += source[0, i] + moment * (source[1, i] + moment * source[2, i])


@folded
def vector_sum(values):
    """Sum of a vector; four sums side by side, as one alone waits for every addition."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = values.size - values.size % 4
    for i in range(0, whole, 4):
        a += values[i]
        b += values[i + 1]
        c += values[i + 2]
        d += values[i + 3]
    for i in range(whole, values.size):
        a += values[i]
    return (a + b) + (c + d)


@kernel
def keep_top_share(buffer, layers):
    """Composition of the top layer at the start of a step."""
    share = block_share(buffer, AT_STAGE, NOW, layers)
    load = block_load(buffer, AT_STAGE, NOW)
    top = layer_mass(load, layers - 1)
    below = max(0, layers - 2)
    row = layers - 1 if top > 0.0 else below
    mass = top if top > 0.0 else layer_mass(load, below)
    scale = 1.0 / mass if mass > NOTHING else 0.0
    for i in range(share.shape[1]):
        share[0, i] = scale * load[row, i]


@kernel
def fastest_rate(buffer, scene, layers):
    """Bound of the rates in the column, 1/s, as `column_rates` left them."""
    nodes = int(buffer[N_ACTIVE])
    fastest = largest_of(view2(buffer, int(buffer[AT_NODE_WORK]), 1, nodes), 0)
    percolation = active_column(buffer, AT_PERCOLATION)
    if fastest == 0.0 and buffer[N_SOURCE] > 0.0:
        # An empty bed does not show how fast it will pass what lands on it.
        pace = scene[S_DENSITY] * scene[S_PASSAGE_VELOCITY] / scene[S_CONTACT_LOAD]
        fastest = pace * scene[S_OPEN_AREA] * (1.0 + scene[S_OPEN_AREA])
    exchange = 0.0
    for j in range(1, layers):
        exchange = max(exchange, largest_of(percolation, j))
    return max(fastest + exchange, 3.0 * exchange)


@kernel
def close_sizes(buffer, load, before, layers, moment, elapsed):
    """Put what the steps of a block rounded away of a size into the row that holds most of it.

    `load` in `before` layers is the column at the start of the block, `moment`. The round-off of a
    step is that of the rates times h, so in a bed where all is in balance it is the same in every
    step: it would add up over many.
    """
    nodes = int(buffer[N_ACTIVE])
    place = node_vector(buffer, AT_PLACE, 0)
    missing, values = active_vector(buffer, AT_NODE_WORK, 1), block(buffer, AT_STAGE, NOW)
    for n in range(nodes):
        missing[n] = 0.0
    straight = places_kept(place)
    for j in range(before):
        for i in range(straight):
            missing[i] += load[j, i]
        for i in range(straight, load.shape[1]):
            n = int(place[i])
            if n >= 0:
                missing[n] += load[j, i]
    terms = int(buffer[N_SOURCE])
    if terms > 0:
        source = view2(buffer, int(buffer[AT_SOURCE_NOW]), 3, nodes)
        for n in range(nodes):
            missing[n] += elapsed * mean_landing(source, n, terms, elapsed, moment)
    for row in range(layers + 1):
        start = row * nodes
        for n in range(nodes):
            missing[n] -= values[start + n]
    for n in range(nodes):
        if missing[n] != 0.0:
            most = n
            for row in range(1, layers + 1):
                if values[row * nodes + n] > values[most]:
                    most = row * nodes + n
            values[most] += missing[n]


@kernel
def mean_landing(source, i, terms, h, moment):
    """Mean of what lands of a size in a step of h that starts at `moment`, kg/(m2 s)."""
    if terms == 1:
        return source[0, i]
    middle = moment + 0.5 * h
    return source[0, i] + middle * source[1, i] + (middle * middle + h * h / 12.0) * source[2, i]


@kernel
def worst_of(error, weight):
    """Largest product of two vectors, not below 0; four side by side, as in `vector_sum`."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = error.size - error.size % 4
    for i in range(0, whole, 4):
        a = max(a, error[i] * weight[i])
        b = max(b, error[i + 1] * weight[i + 1])
        c = max(c, error[i + 2] * weight[i + 2])
        d = max(d, error[i + 3] * weight[i + 3])
    for i in range(whole, error.size):
        a = max(a, error[i] * weight[i])
    return max(max(a, b), max(c, d))


@kernel
def largest_of(values, row):
    """Largest number of a row of a matrix, not below 0."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    count = values.shape[1]
    whole = count - count % 4
    for i in range(0, whole, 4):
        a = max(a, values[row, i])
        b = max(b, values[row, i + 1])
        c = max(c, values[row, i + 2])
        d = max(d, values[row, i + 3])
    for i in range(whole, count):
        a = max(a, values[row, i])
    return max(max(a, b), max(c, d))


# --- the explicit pair ---------------------------------------------------------------------------
@kernel
def stage_value(buffer, stage, h, size):
    """Column at a stage 2 to 7 into STAGED; that of stage 7 is the solution of order 5."""
    y, out = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    k1, k2 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, K2)
    k3, k4 = block(buffer, AT_STAGE, K3), block(buffer, AT_STAGE, K4)
    k5, k6 = block(buffer, AT_STAGE, K5), block(buffer, AT_STAGE, K6)
    row = stage - 2
    a1, a2, a3 = h * A[row, 0], h * A[row, 1], h * A[row, 2]
    a4, a5, a6 = h * A[row, 3], h * A[row, 4], h * A[row, 5]
    if stage == 2:
        for i in range(size):
            out[i] = y[i] + a1 * k1[i]
    elif stage == 3:
        for i in range(size):
            out[i] = y[i] + (a1 * k1[i] + a2 * k2[i])
    elif stage == 4:
        for i in range(size):
            out[i] = y[i] + (a1 * k1[i] + a2 * k2[i] + a3 * k3[i])
    elif stage == 5:
        for i in range(size):
            out[i] = y[i] + (a1 * k1[i] + a2 * k2[i] + a3 * k3[i] + a4 * k4[i])
    elif stage == 6:
        for i in range(size):
            out[i] = y[i] + (a1 * k1[i] + a2 * k2[i] + a3 * k3[i] + a4 * k4[i] + a5 * k5[i])
    else:
        for i in range(size):
            out[i] = y[i] + (a1 * k1[i] + a3 * k3[i] + a4 * k4[i] + a5 * k5[i] + a6 * k6[i])


@kernel
def embedded_error(buffer, h, layers, stage, e1, e2, e3, e4, e5, e6):
    """Largest error of a step, as a part of what was fed of a size: |passed| + half |loads|.

    h times the sum of e1 to e6 times the rates in K1, in the four blocks `stage`, and in K7.
    """
    nodes = int(buffer[N_ACTIVE])
    weight, error = active_vector(buffer, AT_COMPACT, 1), active_vector(buffer, AT_NODE_WORK, 1)
    k1, k2 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, stage[0])
    k3, k4 = block(buffer, AT_STAGE, stage[1]), block(buffer, AT_STAGE, stage[2])
    k5, k6 = block(buffer, AT_STAGE, stage[3]), block(buffer, AT_STAGE, K7)
    for row in range(layers + 1):
        share = h if row == 0 else 0.5 * h
        start = row * nodes
        for i in range(nodes):
            n = start + i
            one = e1 * k1[n] + e2 * k2[n] + e3 * k3[n] + e4 * k4[n] + e5 * k5[n] + e6 * k6[n]
            before = 0.0 if row == 0 else error[i]
            error[i] = before + share * abs(one)
    return worst_of(error, weight)


@kernel
def integrate_stages(buffer, h, size):
    """Add the time integral of a step of the pair, from its stages."""
    y, total = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, INTEGRAL)
    k1, k2 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, K2)
    k3, k4 = block(buffer, AT_STAGE, K3), block(buffer, AT_STAGE, K4)
    k5 = block(buffer, AT_STAGE, K5)
    g1, g2, g3, g4, g5 = h * h * I1, h * h * I2, h * h * I3, h * h * I4, h * h * I5
    for i in range(size):
        total[i] += h * y[i] + (g1 * k1[i] + g2 * k2[i] + g3 * k3[i] + g4 * k4[i] + g5 * k5[i])


@kernel
def take_explicit(buffer, layers, last_rates):
    """The step becomes the state, its last rates the next first ones. False: there are debts."""
    y, new = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    debts = 0
    for i in range((layers + 1) * int(buffer[N_ACTIVE])):
        y[i] = new[i]
        debts += 1 if new[i] < 0.0 else 0
    if last_rates:
        k1, k7 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, K7)
        for i in range(rows_followed(buffer, layers)):
            k1[i] = k7[i]
    return debts == 0


@inlined
def pair_step(buffer, scene, layers, h, moment):
    """Try a step of the explicit pair of order 5; returns its error, a part of what was fed."""
    size = rows_followed(buffer, layers)
    for stage in range(2, 8):
        stage_value(buffer, stage, h, size)
        at = moment + C[stage - 2] * h
        column_rates(buffer, scene, AT_STAGE, STAGED, layers, AT_STAGE, K1 + stage - 1, at)
    return embedded_error(buffer, h, layers, (K3, K4, K5, K6), E1, E3, E4, E5, E6, E7)


# --- the chain of order 3 ------------------------------------------------------------------------
@kernel
def chain_stage(buffer, last, h_last, h_first, size):
    """Next stage of the chain, y + h_last k_last + h_first k1, into STAGED."""
    y, out = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    k, k1 = block(buffer, AT_STAGE, last), block(buffer, AT_STAGE, K1)
    if h_first == 0.0:
        for i in range(size):
            out[i] = y[i] + h_last * k[i]
    else:
        for i in range(size):
            out[i] = y[i] + (h_last * k[i] + h_first * k1[i])


@kernel
def chain_end(buffer, stage, h, row, size):
    """Solution of the chain from the rates of its last three stages, into STAGED."""
    y, out = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    k1, k2 = block(buffer, AT_STAGE, stage[1]), block(buffer, AT_STAGE, stage[2])
    k3 = block(buffer, AT_STAGE, stage[3])
    h1, h2, h3 = h * CHAIN_END[row, 0], h * CHAIN_END[row, 1], h * CHAIN_END[row, 2]
    for i in range(size):
        out[i] = y[i] + (h1 * k1[i] + h2 * k2[i] + h3 * k3[i])


@kernel
def chain_stages(spread):
    """Fewest stages with which the chain is stable up to `spread` = h times fastest rate."""
    stages = CHAIN_LEAST
    while stages < CHAIN_MOST and CHAIN_STABLE[stages - CHAIN_LEAST] < (1.0 - 1e-9) * spread:
        stages += 1
    return stages


@inlined
def chain_step(buffer, scene, layers, h, stages, moment):
    """Try a step of order 3 with `stages` stages; returns its error, a part of what was fed."""
    size = rows_followed(buffer, layers)
    row = stages - CHAIN_LEAST
    kept = (K1, K1, K1, K1)  # blocks of the last four rates
    for j in range(stages - 1):
        last = CHAIN_STAGE[row, j]
        first = CHAIN_FIRST[row] if j == stages - 2 else 0.0
        chain_stage(buffer, kept[3], h * last, h * first, size)
        kept = (kept[1], kept[2], kept[3], K2 + j % 4)
        at = moment + (last + first) * h
        column_rates(buffer, scene, AT_STAGE, STAGED, layers, AT_STAGE, kept[3], at)
    chain_end(buffer, kept, h, row, size)
    column_rates(buffer, scene, AT_STAGE, STAGED, layers, AT_STAGE, K7, moment + h)
    e1, e2, e3 = CHAIN_ERROR[row, 0], CHAIN_ERROR[row, 1], CHAIN_ERROR[row, 2]
    e4, e5, e6 = CHAIN_ERROR[row, 3], CHAIN_ERROR[row, 4], CHAIN_ERROR[row, 5]
    return embedded_error(buffer, h, layers, kept, e1, e2, e3, e4, e5, e6)


# --- the stabilised scheme -----------------------------------------------------------------------
@kernel
def chebyshev_start(buffer, one, h, size):
    """First stage of the stabilised scheme: y + h one k1, into STAGED and K2."""
    y, k1 = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, K1)
    near, far = block(buffer, AT_STAGE, STAGED), block(buffer, AT_STAGE, K2)
    for i in range(size):
        near[i] = y[i] + h * one * k1[i]
    for i in range(size):
        far[i] = y[i]


@kernel
def chebyshev_stage(buffer, near, far, mu, nu, rate_now, rate_first, size):
    """Next stage, in place of the one before last: three-term recursion of Chebyshev kind."""
    y, k1 = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, K1)
    last, out = block(buffer, AT_STAGE, near), block(buffer, AT_STAGE, far)
    rate = block(buffer, AT_STAGE, K3)
    rest = 1.0 - mu - nu
    for i in range(size):
        out[i] = (rest * y[i] + mu * last[i] + nu * out[i]) + (
            rate_now * rate[i] + rate_first * k1[i]
        )


@kernel
def stages_for(spread):
    """Stages of the stabilised scheme that are stable up to `spread` = h times fastest rate."""
    return max(2, 1 + int(sqrt(1.0 + 1.54 * spread)))


@inlined
def stabilised_step(buffer, scene, layers, h, stages, moment):
    """Try a step of order 2 with `stages` stages; returns its error, a part of what was fed."""
    size = rows_followed(buffer, layers)
    w0 = 1.0 + DAMPING / (stages * stages)
    # T_s, T_s' and T_s'' at w0
    root = sqrt(w0 * w0 - 1.0)
    angle = stages * log(w0 + root)
    w1 = (sinh(angle) * (w0 * w0 - 1.0)) / (cosh(angle) * stages * root - w0 * sinh(angle))
    b2 = 1.0 / (4.0 * w0 * w0)
    b_far, b_near = b2, 1.0 / w0
    one = b_near * w1
    chebyshev_start(buffer, one, h, size)
    t_far, t_near, d_far, d_near, e_far, e_near = 1.0, w0, 0.0, 1.0, 0.0, 0.0
    c_far, c_near = 0.0, one
    near, far = STAGED, K2
    if stages % 2 == 0:
        swap_blocks(buffer, STAGED, K2, size)
        near, far = K2, STAGED
    for _ in range(2, stages + 1):
        column_rates(buffer, scene, AT_STAGE, near, layers, AT_STAGE, K3, moment + c_near * h)
        t = 2.0 * w0 * t_near - t_far
        d = 2.0 * w0 * d_near - d_far + 2.0 * t_near
        e = 2.0 * w0 * e_near - e_far + 4.0 * d_near
        b = e / (d * d)
        mu, nu = 2.0 * w0 * b / b_near, -b / b_far
        rate_now = 2.0 * w1 * b / b_near
        rate_first = -(1.0 - b_near * t_near) * rate_now
        chebyshev_stage(buffer, near, far, mu, nu, h * rate_now, h * rate_first, size)
        c = mu * c_near + nu * c_far + rate_now + rate_first
        t_far, t_near, d_far, d_near, e_far, e_near = t_near, t, d_near, d, e_near, e
        b_far, b_near, c_far, c_near = b_near, b, c_near, c
        near, far = far, near
    column_rates(buffer, scene, AT_STAGE, STAGED, layers, AT_STAGE, K7, moment + h)
    return third_order_error(buffer, h, layers)


@kernel
def swap_blocks(buffer, one, two, size):
    """Exchange the contents of two blocks."""
    a, b = block(buffer, AT_STAGE, one), block(buffer, AT_STAGE, two)
    for i in range(size):
        kept = a[i]
        a[i] = b[i]
        b[i] = kept


@kernel
def third_order_error(buffer, h, layers):
    """What a step of order 2 leaves out, from values and rates at both ends (as a part of feed)."""
    nodes = int(buffer[N_ACTIVE])
    weight, error = active_vector(buffer, AT_COMPACT, 1), active_vector(buffer, AT_NODE_WORK, 1)
    y, new = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    k1, k7 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, K7)
    for row in range(layers + 1):
        share = 1.0 if row == 0 else 0.5
        start = row * nodes
        for i in range(nodes):
            n = start + i
            one = 0.8 * (y[n] - new[n]) + 0.4 * h * (k1[n] + k7[n])
            before = 0.0 if row == 0 else error[i]
            error[i] = before + share * abs(one)
    return worst_of(error, weight)


@kernel
def integrate_ends(buffer, h, size):
    """Add the time integral of a step of the chain or the stabilised scheme (Hermite)."""
    y, new = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    k1, k7 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, K7)
    total = block(buffer, AT_STAGE, INTEGRAL)
    half, twelfth = 0.5 * h, h * h / 12.0
    for i in range(size):
        total[i] += half * (y[i] + new[i]) + twelfth * (k1[i] - k7[i])


# --- within a step -------------------------------------------------------------------------------
# With d = STAGED - y the column at the part t of an explicit step is, to order 4,
#   y + t d + t(1-t)(h k1 - d) + t^2 (1-t) (2 d - h k1 - h k7) + t^2 (1-t)^2 h sum of D k,
# or to order 3 without the last term, which is that of the pair.
@kernel
def value_in_step(buffer, layers, h, t, scheme):
    """Column at the part t of an explicit step that is not yet taken, into block OF_PART."""
    bend = t * t * (1.0 - t)
    more = bend * (1.0 - t) if scheme == PAIR else 0.0
    combine_step(buffer, layers, h, 1.0, t, t * (1.0 - t), bend, more)


@kernel
def integral_in_step(buffer, layers, h, a, b, scheme):
    """Time integral of an explicit step from a h to b h, into block OF_PART."""
    first, second, third = b - a, (b * b - a * a) / 2.0, (b * b * b - a * a * a) / 3.0
    fourth = (b * b * b * b - a * a * a * a) / 4.0
    fifth = (b * b * b * b * b - a * a * a * a * a) / 5.0
    bend = h * (third - fourth)
    more = h * (third - 2.0 * fourth + fifth) if scheme == PAIR else 0.0
    combine_step(buffer, layers, h, h * first, h * second, h * (second - third), bend, more)


@kernel
def combine_step(buffer, layers, h, start, whole, near, bend, more):
    """Sum of the terms of the polynomial of a step with these weights, into block OF_PART."""
    y, new = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, STAGED)
    k1, k7 = block(buffer, AT_STAGE, K1), block(buffer, AT_STAGE, K7)
    out = block(buffer, AT_TRIAL, OF_PART)
    size = (layers + 1) * int(buffer[N_ACTIVE])
    gd, g1, g7 = whole - near + 2.0 * bend, h * (near - bend), -h * bend
    for i in range(size):
        out[i] = start * y[i] + gd * (new[i] - y[i]) + (g1 * k1[i] + g7 * k7[i])
    if more > 0.0:
        k3, k4 = block(buffer, AT_STAGE, K3), block(buffer, AT_STAGE, K4)
        k5, k6 = block(buffer, AT_STAGE, K5), block(buffer, AT_STAGE, K6)
        g = h * more
        r1, r3, r4, r5, r6, r7 = g * D1, g * D3, g * D4, g * D5, g * D6, g * D7
        for i in range(size):
            one = r1 * k1[i] + r3 * k3[i] + r4 * k4[i]
            out[i] += one + (r5 * k5[i] + r6 * k6[i] + r7 * k7[i])


@kernel
def part_to_kink(buffer, layers, h, scheme, change):
    """Part of an explicit step after which the top layer has changed by `change` kg/m2."""
    row = layers - 1
    d = layer_mass(block_load(buffer, AT_STAGE, STAGED), row)
    d -= layer_mass(block_load(buffer, AT_STAGE, NOW), row)
    first = h * layer_mass(block_load(buffer, AT_STAGE, K1), row) - d
    second = d - first - h * layer_mass(block_load(buffer, AT_STAGE, K7), row)
    third = 0.0
    if scheme == PAIR:
        third = D1 * layer_mass(block_load(buffer, AT_STAGE, K1), row)
        third += D3 * layer_mass(block_load(buffer, AT_STAGE, K3), row)
        third += D4 * layer_mass(block_load(buffer, AT_STAGE, K4), row)
        third += D5 * layer_mass(block_load(buffer, AT_STAGE, K5), row)
        third += D6 * layer_mass(block_load(buffer, AT_STAGE, K6), row)
        third += D7 * layer_mass(block_load(buffer, AT_STAGE, K7), row)
        third *= h
    low, high, t = 0.0, 1.0, change / d
    for _ in range(60):
        left = 1.0 - t
        value = t * (d + left * (first + t * (second + left * third))) - change
        slope = d + (left - t) * first + t * (2.0 * left - t) * second
        slope += 2.0 * t * left * (left - t) * third
        if value * change > 0.0:
            high = t
        else:
            low = t
        again = t - value / slope if slope != 0.0 else low
        if abs(again - t) <= 1e-12:
            break
        t = again if low < again < high else 0.5 * (low + high)
    return t


@kernel
def land_in_step(buffer, layers, h, t, scheme):
    """End a step that is not yet taken at its part t: its column and time integral."""
    total, staged = block(buffer, AT_STAGE, INTEGRAL), block(buffer, AT_STAGE, STAGED)
    out = block(buffer, AT_TRIAL, OF_PART)
    size = (layers + 1) * int(buffer[N_ACTIVE])
    integral_in_step(buffer, layers, h, 0.0, t, scheme)
    for i in range(size):
        total[i] += out[i]
    value_in_step(buffer, layers, h, t, scheme)
    for i in range(size):
        staged[i] = out[i]


@kernel
def sum_step(buffer, layers, h, scheme):
    """Add the time integral of a whole explicit step of any scheme."""
    size = (layers + 1) * int(buffer[N_ACTIVE])
    if scheme == PAIR:
        integrate_stages(buffer, h, size)
    else:
        integrate_ends(buffer, h, size)


# --- the implicit step, extrapolated -------------------------------------------------------------
@kernel
def upward_rates(load, down, layers, up):
    """What each layer sends up, 1/s on its mass: as much as percolates down into it."""
    for j in range(layers - 1):
        mass = layer_mass(load, j)
        up[j] = weighted_mass(load, j + 1, down, j + 1) / mass if mass > 0.0 else 0.0


@kernel
def implicit_step(load, rate, down, up, pivot, stay, layers, h):
    """Solve (1 + h T_i) x = load for every size in place, T_i tridiagonal over the layers.

    The elimination is written without a subtraction (`stay` is the part of a pivot that does not
    lead upwards), so masses stay positive and sum up to round-off for any h.
    """
    nodes = load.shape[1]
    for i in range(nodes):
        stay[i] = 1.0 + h * rate[i]
    for j in range(layers - 1):
        upward = h * up[j]
        for i in range(nodes):
            pivot[j, i] = 1.0 / (stay[i] + upward)
            stay[i] = 1.0 + h * down[j + 1, i] * (stay[i] * pivot[j, i])
            load[j + 1, i] += upward * pivot[j, i] * load[j, i]
    top = layers - 1
    for i in range(nodes):
        load[top, i] /= stay[i]
    for j in range(top - 1, -1, -1):
        for i in range(nodes):
            load[j, i] = (load[j, i] + h * down[j + 1, i] * load[j + 1, i]) * pivot[j, i]


@kernel
def basic_step(buffer, scene, k, layers, h, moment):
    """One step of first order on trial k: passage and percolation, then landing and settling.

    Blocks 2k and 2k + 1 of `trial` hold the column and its time integral. Returns the number of
    layers after it.
    """
    load, passed = block_load(buffer, AT_TRIAL, 2 * k), block_passed(buffer, AT_TRIAL, 2 * k)
    state, time = block(buffer, AT_TRIAL, 2 * k), block(buffer, AT_TRIAL, 2 * k + 1)
    rate, contact = active_vector(buffer, AT_NODE_WORK, 0), active_vector(buffer, AT_NODE_WORK, 1)
    stay = active_vector(buffer, AT_NODE_WORK, 3)
    down = active_column(buffer, AT_PERCOLATION)
    up = vector(buffer, AT_UPWARD, int(buffer[N_LAYERS]), 0)
    nodes = rate.size
    cover = cover_of(scene, layer_mass(load, 0))
    pace = passage_factors(buffer, scene, load, load, layers, cover, contact, rate)
    for i in range(nodes):
        rate[i] = max(0.0, rate[i]) * pace * contact[i]
    upward_rates(load, down, layers, up)
    implicit_step(load, rate, down, up, active_column(buffer, AT_SCRATCH), stay, layers, h)
    for i in range(nodes):
        passed[i] += h * rate[i] * load[0, i]
    terms = int(buffer[N_SOURCE])
    if terms > 0:
        source = view2(buffer, int(buffer[AT_SOURCE_NOW]), 3, nodes)
        for i in range(nodes):
            load[layers - 1, i] += h * mean_landing(source, i, terms, h, moment)
    layers = restack(buffer, scene, load, layers)
    for i in range((layers + 1) * nodes):
        time[i] += h * state[i]
    return layers


@kernel
def run_trial(buffer, scene, k, layers, rows, h, moment):
    """k + 1 basic steps over h from NOW into trial k, which uses at most `rows` layers."""
    now = block(buffer, AT_STAGE, NOW)
    state, time = block(buffer, AT_TRIAL, 2 * k), block(buffer, AT_TRIAL, 2 * k + 1)
    nodes = int(buffer[N_ACTIVE])
    for i in range((rows + 1) * nodes):
        # What passed counts from here; above the loads lies the share of the top layer.
        state[i] = now[i] if nodes <= i < (layers + 1) * nodes else 0.0
        time[i] = 0.0
    layers_for(buffer, scene, bed_load(block_load(buffer, AT_STAGE, NOW), layers))
    part = h / (k + 1)
    for n in range(k + 1):
        layers = basic_step(buffer, scene, k, layers, part, moment + n * part)


@kernel
def rows_in_use(buffer, scene, load, layers, h, moment):
    """Layers that a step of h may need: what lands opens new ones, nothing else does."""
    terms = int(buffer[N_SOURCE])
    if terms == 0:
        return layers
    landing = 0.0
    source = view2(buffer, int(buffer[AT_SOURCE_NOW]), 3, int(buffer[N_ACTIVE]))
    for i in range(int(buffer[N_ACTIVE])):
        landing += mean_landing(source, i, terms, h, moment)
    more = layers_for(buffer, scene, bed_load(load, layers) + h * landing) + 1
    return max(layers, min(more, load.shape[0]))


@kernel
def extrapolate(buffer, k, rows):
    """Aitken-Neville on the trials 0..k; the best value lies in trial 0, the next in trial 1.

    Trial k keeps its own first-order value. `rows` is the highest number of layers in use.
    """
    size = (rows + 1) * int(buffer[N_ACTIVE])
    for level in range(1, k + 1):
        factor = 1.0 / ((k + 1.0) / (k + 1.0 - level) - 1.0)
        for part in range(2):
            better = block(buffer, AT_TRIAL, 2 * (k - level + 1) + part)
            coarse = block(buffer, AT_TRIAL, 2 * (k - level) + part)
            for i in range(size):
                coarse[i] = better[i] + factor * (better[i] - coarse[i])


@kernel
def step_error(buffer, rows):
    """Largest difference of the two best extrapolations as a part of what was fed of a size."""
    flux, coarse_flux = block_passed(buffer, AT_TRIAL, 0), block_passed(buffer, AT_TRIAL, 2)
    load, coarse_load = block_load(buffer, AT_TRIAL, 0), block_load(buffer, AT_TRIAL, 2)
    weight = active_vector(buffer, AT_COMPACT, 1)
    worst = 0.0
    for i in range(weight.size):
        moved = 0.0
        for j in range(rows):
            moved += abs(load[j, i] - coarse_load[j, i])
        error = abs(flux[i] - coarse_flux[i]) + 0.5 * moved
        worst = max(worst, error * weight[i])
    return worst


@kernel
def carry_debts(flux, load, rows):
    """Pay what a high order drew below zero from the same size next to it; sums stay.

    From the top layer down to what passed, and back up if that became a debt: a size as a whole
    is never below zero, so nothing is. Such debts are of the size of the step's error.
    """
    for i in range(flux.size):
        debt = 0.0
        for j in range(rows - 1, -1, -1):
            debt += load[j, i]
            load[j, i] = max(0.0, debt)
            debt = min(0.0, debt)
        flux[i] += debt
        debt = min(0.0, flux[i])
        flux[i] = max(0.0, flux[i])
        for j in range(rows):
            debt += load[j, i]
            load[j, i] = max(0.0, debt)
            debt = min(0.0, debt)


@kernel
def pay_integral(buffer, rows):
    """Pay the debts of the time integrals, if there are any."""
    total = block(buffer, AT_STAGE, INTEGRAL)
    debts = 0
    for i in range((rows + 1) * int(buffer[N_ACTIVE])):
        debts += 1 if total[i] < 0.0 else 0
    if debts > 0:
        gone, load = (
            block_passed(buffer, AT_STAGE, INTEGRAL),
            block_load(buffer, AT_STAGE, INTEGRAL),
        )
        carry_debts(gone, load, rows)


@kernel
def take_implicit(buffer, scene, rows, h):
    """Take trial 0 as the state after h and add its sums; returns the layers."""
    size = (rows + 1) * int(buffer[N_ACTIVE])
    now, total = block(buffer, AT_STAGE, NOW), block(buffer, AT_STAGE, INTEGRAL)
    best, time = block(buffer, AT_TRIAL, 0), block(buffer, AT_TRIAL, 1)
    gone = int(buffer[N_ACTIVE])
    carry_debts(block_passed(buffer, AT_TRIAL, 0), block_load(buffer, AT_TRIAL, 0), rows)
    carry_debts(block_passed(buffer, AT_TRIAL, 1), block_load(buffer, AT_TRIAL, 1), rows)
    for i in range(gone):
        total[i] += h * now[i] + time[i]
        now[i] += best[i]
    for i in range(gone, size):
        total[i] += time[i]
        now[i] = best[i]
    return restack(buffer, scene, block_load(buffer, AT_STAGE, NOW), rows)


@inlined
def try_implicit(buffer, scene, layers, h, moment, book):
    """Raise the order until the error of a step of h meets the tolerance.

    Returns the number of trials, negative if it does not meet it; the next step and order go to
    `book`.
    """
    allowed = allowance(buffer, scene, book, h)
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    target = int(book[D_ORDER])
    rows = rows_in_use(buffer, scene, block_load(buffer, AT_STAGE, NOW), layers, h, moment)
    book[D_ROWS] = rows
    last, last_cost, last_fit = 1.0, 1e300, h
    used = 0
    for k in range(min(target + 1, MAX_ORDER)):
        run_trial(buffer, scene, k, layers, rows, h, moment)
        counter[C_SUB_STEPS] += k + 1
        extrapolate(buffer, k, rows)
        used = k + 1
        if k == 0:
            continue
        error = max(step_error(buffer, rows) / allowed, 1e-30)
        fit = h * min(6.0, max(0.1, 0.9 * raised(0.5 / error, 1.0 / used)))
        cost = trial_cost(used) / fit
        if error <= 1.0:
            book[D_ORDER], book[D_STEP] = used, fit
            if last_cost < 0.9 * cost:
                book[D_ORDER], book[D_STEP] = used - 1, last_fit
            elif used < MAX_ORDER - 1:
                book[D_ORDER], book[D_STEP] = used + 1, trial_cost(used + 1) / cost
            return used
        gain = min(1.0, error / last) if k > 1 else 0.1
        expected = error * raised(gain, target - used)
        book[D_STEP] = h * min(0.6, max(0.1, 0.9 * raised(0.5 / expected, 1.0 / target)))
        if k > 1 and expected * gain > 4.0:
            break
        last, last_cost, last_fit = error, cost, fit
    return -used


@kernel
def trial_cost(order):
    """Basic steps of an extrapolated step of this order, and one for its overhead."""
    return 1.0 + 0.5 * order * (order + 1)


# --- parts of a trajectory -----------------------------------------------------------------------
@kernel
def begin_parts(buffer, count, start):
    """Want the means over `count` parts of a trajectory, the first of which begins at `start` s."""
    buffer[N_PARTS], buffer[PART], buffer[PARTS_FROM] = count, 0.0, start


@kernel
def time_in_part(buffer, moment, left):
    """Time until the part at hand begins or ends, at most what is left, s."""
    ends = vector(buffer, AT_PART_END, int(buffer[N_PACKAGES]), 0)
    until = ends[int(buffer[PART])] - moment
    if moment < buffer[PARTS_FROM]:
        until = buffer[PARTS_FROM] - moment
    return min(left, until) if until > 0.0 else left


@kernel
def add_step_to_parts(buffer, layers, h, taken, moment, scheme):
    """Add the first `taken` s of an explicit step of h, not yet taken, to the parts it meets."""
    ends = vector(buffer, AT_PART_END, int(buffer[N_PACKAGES]), 0)
    begin = buffer[PARTS_FROM] if buffer[PART] == 0.0 else ends[int(buffer[PART]) - 1]
    while buffer[PART] < buffer[N_PARTS] and begin < moment + taken:
        end = ends[int(buffer[PART])]
        a, b = max(0.0, (begin - moment) / h), min(taken, end - moment) / h
        if b > a:
            integral_in_step(buffer, layers, h, a, b, scheme)
            give_to_part(buffer, layers, h * (b - a))
        if end > moment + taken:
            return
        begin = end
        buffer[PART] += 1.0


@kernel
def add_integral_to_part(buffer, rows, h, moment):
    """Add a step that ends with the part at hand: INTEGRAL, less what it was before (block K2)."""
    if moment < buffer[PARTS_FROM]:
        return
    before, total = block(buffer, AT_STAGE, K2), block(buffer, AT_STAGE, INTEGRAL)
    out = block(buffer, AT_TRIAL, OF_PART)
    for i in range((rows + 1) * int(buffer[N_ACTIVE])):
        out[i] = total[i] - before[i]
    give_to_part(buffer, rows, h)
    part = int(buffer[PART])
    if moment + h >= vector(buffer, AT_PART_END, int(buffer[N_PACKAGES]), 0)[part]:
        buffer[PART] += 1.0


@kernel
def give_to_part(buffer, rows, duration):
    """Add block OF_PART, the integral over `duration` s, to the part at hand."""
    part, nodes = int(buffer[PART]), int(buffer[N_NODES])
    whole = int(vector(buffer, AT_PART_SLOT, int(buffer[N_PACKAGES]), 0)[part])
    load, passed = column(buffer, AT_LOAD, whole), node_vector(buffer, AT_PART_PASSED, part)
    place, share = node_vector(buffer, AT_PLACE, 0), node_vector(buffer, AT_SHARE, 0)
    flux = node_vector(buffer, AT_COLUMN_FLUX, 0)
    gone, held = block_passed(buffer, AT_TRIAL, OF_PART), block_load(buffer, AT_TRIAL, OF_PART)
    straight = places_kept(place)
    for i in range(straight):
        passed[i] += duration * flux[i] + share[i] * gone[i]
    for i in range(straight, nodes):
        passed[i] += duration * flux[i]
        n = int(place[i])
        if n >= 0:
            passed[i] += share[i] * gone[n]
    for j in range(rows):
        for i in range(straight):
            load[j, i] += share[i] * held[j, i]
        for i in range(straight, nodes):
            n = int(place[i])
            if n >= 0:
                load[j, i] += share[i] * held[j, n]


# --- steps ---------------------------------------------------------------------------------------
@kernel
def allowance(buffer, scene, book, h):
    """Error that a step of h may have, as a part of what was fed of a size.

    A deck below has a smaller share of the tolerance, as the errors of all above it add to its own.
    """
    tolerance = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)[TOLERANCE] * book[D_SHARE]
    horizon = scene[S_HORIZON]
    return tolerance * (max(LEAST_SHARE, h / horizon) if horizon > 0.0 else LEAST_SHARE)


@kernel
def first_step(scene, duration):
    """A first implicit step: the time in which the screen could take the contact layer once, s."""
    pace = scene[S_PASSAGE_VELOCITY] * scene[S_DENSITY] / scene[S_CONTACT_LOAD]
    return min(duration, 0.25 / pace) if pace > 0.0 else duration


@kernel
def time_to_pass(mass, rate, slope):
    """Time in which `mass` passes at a rate that changes linearly, s; -1 if it never does."""
    root = rate * rate + 2.0 * slope * mass
    if rate <= 0.0 or root <= 0.0:
        return -1.0
    return 2.0 * mass / (rate + sqrt(root))


@kernel
def miss_of(buffer, layers, growth):
    """Part of a full layer by which a step may miss the moment of a kink."""
    if layers > 1 and growth < 0.0:
        return max(LANDING, MISS * vector(buffer, AT_PARAMETER, len(PARAMETER), 0)[TOLERANCE])
    return LANDING


@kernel
def mass_to_kink(buffer, scene, load, layers, growth):
    """Mass that the top layer loses or gains until the rates have a kink, kg/m2; 0: none ahead.

    A layer runs out or is filled; the bed gets thinner or thicker than the contact layer.
    """
    mass = layer_mass(load, layers - 1)
    if layers > 1:
        full = scene[S_LAYER_FULL]
        distance = mass if growth < 0.0 else full - mass
    else:
        full = scene[S_CONTACT_LOAD]
        distance = mass - full if growth < 0.0 else full - mass
    return distance if distance > miss_of(buffer, layers, growth) * full else 0.0


@kernel
def settle_top(buffer, scene, layers, growth):
    """Close a top layer that has run out, open one above a full one; returns the layers."""
    load = block_load(buffer, AT_STAGE, NOW)
    nodes = load.shape[1]
    full = scene[S_LAYER_FULL] if layers > 1 else scene[S_CONTACT_LOAD]
    mass = layer_mass(load, layers - 1)
    if layers > 1 and growth < 0.0 and mass <= miss_of(buffer, layers, growth) * full:
        for i in range(nodes):
            load[layers - 2, i] += load[layers - 1, i]
            load[layers - 1, i] = 0.0
        return layers - 1
    open_next = buffer[LAYERED] > 0.0 and growth > 0.0 and layers < load.shape[0]
    if open_next and mass >= (1.0 - LANDING) * full:
        for i in range(nodes):
            load[layers, i] = 0.0
        return layers + 1
    return layers


@kernel
def top_growth(buffer, layers):
    """What the top layer gains, kg/(m2 s), by the rates in K1."""
    return layer_mass(block_load(buffer, AT_STAGE, K1), layers - 1)


@kernel
def clear_sums(buffer, rows):
    """Zero the sums of `integrate` in `rows` layers."""
    for row in range(2):
        flux = node_vector(buffer, AT_COLUMN_FLUX, row)
        for i in range(flux.size):
            flux[i] = 0.0
    total_time = column(buffer, AT_COLUMN_TIME, 0)
    for j in range(rows):
        for i in range(total_time.shape[1]):
            total_time[j, i] = 0.0


@kernel
def integrate(buffer, scene, book, load, reference, layers, duration):
    """Let a column go through `duration` s; returns the number of layers after it.

    `load` is advanced in place. The fields column_flux (what passed, kg/m2, and its time integral)
    and column_time (time integral of the loads, kg s/m2, in D_ROWS rows) hold the sums over the
    duration.
    `reference` is what was fed of each node, kg/m2: errors are a part of it. The first N_SOURCE
    rows of `source` are the coefficients in time of what lands on top, kg/(m2 s^(1 + row)).
    """
    # What lands may open layers, nothing else does.
    clear_sums(buffer, layers if buffer[N_SOURCE] == 0.0 else load.shape[0])
    used = layers
    explicit = vector(buffer, AT_SWITCH, len(SWITCH), 0)[W_EXPLICIT] > 0.0
    shortest = SHORTEST * max(duration, scene[S_HORIZON])
    left = duration
    while left > 0.0:
        gather(buffer, scene, load, reference, layers)
        layers_for(buffer, scene, bed_load(block_load(buffer, AT_STAGE, NOW), layers))
        before, rows = left, layers
        layers, left = advance_block(
            buffer, scene, book, layers, duration, left, shortest, explicit
        )
        close_sizes(buffer, load, rows, layers, duration - before, before - left)
        rows = max(rows, int(book[D_ROWS]))
        used = max(used, rows)
        pay_integral(buffer, rows)
        scatter(buffer, load, layers, rows, before - left)
    book[D_ROWS] = used
    return layers


@inlined
def advance_block(buffer, scene, book, layers, duration, left, shortest, explicit):
    """Up to REVIEW accepted steps of the block NOW; returns layers and the time that is left.

    With a linear reconstruction all steps are explicit, but where the bed is deeper than its
    layers: there the implicit scheme has every layer mixed evenly.
    """
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    load = block_load(buffer, AT_STAGE, NOW)
    most = layers
    linear = reconstructed(buffer)
    fresh = False  # whether K1 holds the rates at NOW
    before, h = 0.0, 0.0  # growth of the top layer a step ago
    for _ in range(REVIEW):
        if left <= 0.0:
            break
        moment = duration - left
        if not fresh:
            keep_top_share(buffer, layers)
            column_rates(buffer, scene, AT_STAGE, NOW, layers, AT_STAGE, K1, moment)
        for attempt in range(2):
            settled = settle_top(buffer, scene, layers, top_growth(buffer, layers))
            if settled == layers or (attempt == 1 and settled > layers):
                break
            layers = settled
            most = max(most, layers)
            keep_top_share(buffer, layers)
            column_rates(buffer, scene, AT_STAGE, NOW, layers, AT_STAGE, K1, moment)
            before, h = 0.0, 0.0
        if buffer[RECORDED] > 0.0:
            note_passage(buffer, scene, moment)
        growth = top_growth(buffer, layers)
        slope = (abs(growth) - abs(before)) / h if h > 0.0 and before * growth > 0.0 else 0.0
        distance = mass_to_kink(buffer, scene, load, layers, growth)
        kink = time_to_pass(distance, abs(growth), slope) if distance > 0.0 else -1.0
        fastest = fastest_rate(buffer, scene, layers)
        # A full bed that only round-off makes grow is not deep.
        least = LANDING * scene[S_LAYER_FULL] / left
        deep = scene[S_LAYER_FULL] > scene[S_LAYER_LOAD] or (
            layers == load.shape[0] and buffer[LAYERED] > 0.0 and growth > least
        )
        stiff = not explicit or fastest * left >= STIFF
        if not deep and (linear or not stiff):
            h, scheme, landed = explicit_length(
                buffer, scene, book, layers, left, growth, distance, kink, fastest, moment, shortest
            )
            counter[C_COLUMN_STEPS] += 1
            before = growth
            if buffer[PART] < buffer[N_PARTS]:
                add_step_to_parts(buffer, layers, h, landed * h, moment, scheme)
            ended = landed == 1.0  # with its last rates at its end
            if landed < 1.0:
                land_in_step(buffer, layers, h, landed, scheme)
                h *= landed
            else:
                sum_step(buffer, layers, h, scheme)
            paid = take_explicit(buffer, layers, ended)
            if not paid:
                carry_debts(block_passed(buffer, AT_STAGE, NOW), load, layers)
                if linear:  # faces have debts in any layer: fill those that paid
                    layers = restack(buffer, scene, load, layers)
                    most = max(most, layers)
            if landed < 1.0:
                layers = settle_top(buffer, scene, layers, growth)
                most = max(most, layers)
                before = 0.0
            fresh = ended and paid
            keep_top_share(buffer, layers)
        else:
            until = left
            if buffer[PART] < buffer[N_PARTS]:
                until = time_in_part(buffer, moment, left)
                before_sum, sums = block(buffer, AT_STAGE, K2), block(buffer, AT_STAGE, INTEGRAL)
                for i in range(sums.size):
                    before_sum[i] = sums[i]
            h = implicit_length(buffer, scene, book, layers, until, kink, moment, shortest)
            counter[C_COLUMN_STEPS] += 1
            rows = int(book[D_ROWS])
            layers = take_implicit(buffer, scene, rows, h)
            if buffer[PART] < buffer[N_PARTS]:
                add_integral_to_part(buffer, rows, h, moment)
            most = max(most, rows)
            if scene[S_LAYER_FULL] > scene[S_LAYER_LOAD]:
                book[D_CAPACITY_ALARM] = 1.0
            fresh = False
        left = 0.0 if h == left else left - h
    if left <= 0.0 and buffer[RECORDED] > 0.0:
        if not fresh:
            keep_top_share(buffer, layers)
            column_rates(buffer, scene, AT_STAGE, NOW, layers, AT_STAGE, K1, duration)
        note_passage(buffer, scene, duration)
    book[D_ROWS] = most
    return layers, left


@kernel
def has_kinks(buffer):
    """Whether the rates have a kink at every size or in every layer."""
    parameter = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)
    model = int(parameter[SEGREGATION_MODEL])
    partly = model == PROPORTIONAL and parameter[SEGREGATION_PROPORTION] > 0.0
    return partly or model == CLASSIFIED or reconstructed(buffer)


@kernel
def first_pair(buffer, book):
    """A first step of the pair, as a part of the longest that is stable."""
    tolerance = vector(buffer, AT_PARAMETER, len(PARAMETER), 0)[TOLERANCE] * book[D_SHARE]
    return min(MOST_FIRST, FIRST_PAIR * raised(1e3 * tolerance, 1.0 / 6.0))


@kernel
def choose_scheme(buffer, book, fastest, left):
    """The scheme that is cheapest for the steps that accuracy and stability allow, and its step.

    The cost is rates over time: six a step of the pair, as many as stages of the others. Returns
    the scheme and h [s].
    """
    most = STABLE / fastest if fastest > 0.0 else left
    pace = book[D_PACE] if book[D_PACE] > 0.0 else first_pair(buffer, book) * most
    scheme, h = PAIR, min(pace, most)
    rates = 6
    wide = book[D_WIDE]
    if wide > 0.0:
        scale = 1.0 / fastest if fastest > 0.0 else left
        for stages in range(CHAIN_LEAST, CHAIN_MOST + 1):
            reach = min(wide, CHAIN_STABLE[stages - CHAIN_LEAST] * scale)
            if stages * h < rates * reach:
                scheme, h, rates = CHAIN, reach, stages
            if reach == wide:
                break
    if wide * fastest > CHAIN_STABLE[CHAIN_MOST - CHAIN_LEAST] and buffer[N_SOURCE] < 2.0:
        reach = min(wide / SHORTER, (MOST_STAGES - 1) ** 2 / 1.54 / fastest)
        if stages_for(reach * fastest) * h < rates * reach:
            scheme, h = STABILISED, reach
    # Steps of one length to the end.
    return scheme, left / max(1.0, ceil(left / h - SLACK))


@kernel
def step_factor(error, scheme):
    """Next step over this one, of which `error` is the estimate as a part of what is allowed.

    What is allowed grows with the step: an error of order h^p leaves the root of order p - 1. That
    of the pair, 5, is taken as 16/3, that of the chain, 3, as 16/5: square roots are cheap.
    """
    root = sqrt(max(error, 1e-10))
    if scheme == STABILISED:
        return SAFETY_WIDE / root
    root = sqrt(root)
    if scheme == CHAIN:
        return SAFETY_WIDE / (root * sqrt(sqrt(root)))
    root = sqrt(root)
    return SAFETY / (root * sqrt(root))


@kernel
def longest_step(scheme, h, fastest):
    """A step that may be a little longer than h, but for stability, s."""
    if scheme == STABILISED or fastest == 0.0:
        return STRETCH * h
    most = STABLE if scheme == PAIR else CHAIN_STABLE[CHAIN_MOST - CHAIN_LEAST]
    return min(STRETCH * h, max(h, most / fastest))


@inlined
def explicit_length(
    buffer, scene, book, layers, left, growth, distance, kink, fastest, moment, shortest
):
    """Find the length of an explicit step that meets the tolerance, its stages done.

    growth: of the top layer, kg/(m2 s); distance: what it gains or loses until a kink, kg/m2; kink:
    time until then, s. Returns the length [s], the scheme, and the part of the step that lies
    before a kink; 1: all.
    """
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    load, staged = block_load(buffer, AT_STAGE, NOW), block_load(buffer, AT_STAGE, STAGED)
    full = scene[S_LAYER_FULL] if layers > 1 else scene[S_CONTACT_LOAD]
    mass, miss = layer_mass(load, layers - 1), miss_of(buffer, layers, growth)
    kinks = has_kinks(buffer)
    margin = MARGIN_SORTED if kinks else MARGIN
    scheme, h = choose_scheme(buffer, book, fastest, left)
    cut = 0.0 < kink < STRETCH * h
    if cut:
        # A little further, where the rates go on smoothly: it ends at the kink all the same.
        past = PAST * kink if layers > 1 and growth < 0.0 else kink
        h = min(past, longest_step(scheme, h, fastest), left)
    landings, first = 0, book[D_WIDE] == 0.0 and buffer[N_PARTS] > 0.0
    landed = 1.0
    while True:
        allowed = margin[scheme] * allowance(buffer, scene, book, h)
        if scheme == STABILISED:
            stages = stages_for(h * fastest)
            error = stabilised_step(buffer, scene, layers, h, stages, moment) / allowed
        elif scheme == CHAIN:
            stages = chain_stages(h * fastest)
            error = chain_step(buffer, scene, layers, h, stages, moment) / allowed
        else:
            error = pair_step(buffer, scene, layers, h, moment) / allowed
            if not kinks and buffer[N_SOURCE] == 0.0:
                error *= max(LEAST_HIGHER, HIGHER * h * fastest)
        moved = abs(layer_mass(staged, layers - 1) - mass)
        if distance > 0.0 and moved > distance + miss * full and landings < 8:
            # Past a kink: the step ends there, and is tried anew where its error came from that.
            part = part_to_kink(buffer, layers, h, scheme, distance if growth > 0.0 else -distance)
            counter[C_LANDINGS] += 1
            cut = True
            if error > 1.0:
                h *= max(part, LEAST_LANDING)
                landings += 1
                continue
            landed = part
        fit = h * min(5.0, max(0.2, step_factor(error, scheme)))
        if error > 1.0 and h > shortest:
            counter[C_COLUMN_REJECTED] += 1
            h = min(fit, 0.9 * h)
            cut = False
            continue
        if error > 1.0:
            counter[C_COLUMN_FORCED] += 1
        if scheme == PAIR:
            book[D_PACE] = max(fit, book[D_PACE]) if cut else fit
            if first:  # of a cohort: the next one begins with it
                book[D_FIRST_PACE] = fit
            error = third_order_error(buffer, h, layers) * margin[PAIR] / (allowed * MARGIN_WIDE)
            book[D_WIDE] = h * min(MOST_WIDER, step_factor(error, STABILISED))
            counter[C_PAIR_STEPS] += 1
        elif scheme == CHAIN:
            book[D_WIDE] = max(fit, book[D_WIDE]) if cut else fit
            counter[C_CHAIN_STEPS] += 1
        else:
            fit *= SHORTER
            book[D_WIDE] = max(fit, book[D_WIDE]) if cut else fit
            counter[C_STABILISED_STEPS] += 1
        return h, scheme, landed


@kernel
def note_passage(buffer, scene, moment):
    """Record what has passed of the slice and passes now, for the deck below."""
    place, share = node_vector(buffer, AT_PLACE, 0), node_vector(buffer, AT_SHARE, 0)
    passed, passing = node_vector(buffer, AT_RECORD, 0), node_vector(buffer, AT_RECORD, 1)
    before = node_vector(buffer, AT_COLUMN_FLUX, 0)
    now, rate = block_passed(buffer, AT_STAGE, NOW), block_passed(buffer, AT_STAGE, K1)
    for i in range(passed.size):
        n = int(place[i])
        passed[i] = before[i]
        passing[i] = 0.0
        if n >= 0:
            passed[i] += share[i] * now[n]
            passing[i] = share[i] * rate[n]
    record_knot(buffer, buffer[RECORDED_FROM] + moment * scene[S_TRANSPORT_VELOCITY])


@inlined
def implicit_length(buffer, scene, book, layers, left, kink, moment, shortest):
    """Find the length of an implicit step that meets the tolerance, its trials done; s."""
    counter = vector(buffer, AT_COUNTER, len(COUNTER), 0)
    if book[D_STEP] <= 0.0:
        book[D_STEP], book[D_ORDER] = first_step(scene, left), 3
    while True:
        planned, order = book[D_STEP], book[D_ORDER]
        h = left if planned > 0.99 * left else min(planned, 0.5 * left)
        if shortest < kink < h:
            h = kink
        used = try_implicit(buffer, scene, layers, h, moment, book)
        if used < 0 and h > shortest:
            counter[C_COLUMN_REJECTED] += 1
            continue
        if used < 0:
            counter[C_COLUMN_FORCED] += 1
            book[D_STEP] = 4.0 * h
        elif h < planned:
            book[D_STEP], book[D_ORDER] = max(planned, book[D_STEP]), max(order, book[D_ORDER])
        return h
