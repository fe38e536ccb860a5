"""Steps of a column in time (MODEL.md, "Explicit schemes", "The implicit scheme").

Three schemes share the sub-models; two of them the rates of `column_rates`:
  the pair of Dormand and Prince, order 5 with an embedded 4, where accuracy asks for short steps;
  a chain of four to ten stages, order 3, where stability does;
  an implicit step that keeps masses positive whatever its length, extrapolated, beyond all that.
All are linear in the masses they move, so every sum is kept to round-off. How long a step may be is
the business of package.py.
"""

from __future__ import annotations

import numpy as np

from vibroscreen.kernels import state
from vibroscreen.kernels.fours import all_four, apart, four, larger, largest, put_four
from vibroscreen.kernels.language import kernel, view2
from vibroscreen.kernels.rates import (
    INTEGRAL,
    K1,
    K2,
    K3,
    K4,
    K5,
    K6,
    K7,
    NOW,
    STAGED,
    active_column,
    active_vector,
    bed_load,
    block,
    block_load,
    block_passed,
    column_rates,
    cover_of,
    layers_for,
    mean_landing,
    passage_factors,
    restack,
    rows_followed,
)
from vibroscreen.kernels.segregation import layer_mass, weighted_mass

# Schemes. A short step is cheapest by high order, a wide one by many cheap stages.
PAIR, CHAIN = range(2)
# Block of `trial`: errors of a step; between steps the column or its time integral over a part.
OF_PART = 2
# The explicit pair is stable up to this step times the fastest rate.
STABLE = 3.2

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


# --- the explicit pair ---------------------------------------------------------------------------
@kernel
def stage_value(buffer, stage, h, size):
    """Column at a stage 2 to 7 into STAGED; that of stage 7 is the solution of order 5."""
    y, out = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    k1, k2 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, K2)
    k3, k4 = block(buffer, state.AT.stage, K3), block(buffer, state.AT.stage, K4)
    k5, k6 = block(buffer, state.AT.stage, K5), block(buffer, state.AT.stage, K6)
    row = stage - 2
    a1, a2, a3 = h * A[row, 0], h * A[row, 1], h * A[row, 2]
    a4, a5, a6 = h * A[row, 3], h * A[row, 4], h * A[row, 5]
    if stage == 2:
        for i in range(0, size, 4):
            put_four(out, i, four(y, i) + a1 * four(k1, i))
    elif stage == 3:
        for i in range(0, size, 4):
            put_four(out, i, four(y, i) + (a1 * four(k1, i) + a2 * four(k2, i)))
    elif stage == 4:
        for i in range(0, size, 4):
            more = a1 * four(k1, i) + a2 * four(k2, i) + a3 * four(k3, i)
            put_four(out, i, four(y, i) + more)
    elif stage == 5:
        for i in range(0, size, 4):
            more = a1 * four(k1, i) + a2 * four(k2, i) + a3 * four(k3, i) + a4 * four(k4, i)
            put_four(out, i, four(y, i) + more)
    elif stage == 6:
        for i in range(0, size, 4):
            more = a1 * four(k1, i) + a2 * four(k2, i) + a3 * four(k3, i) + a4 * four(k4, i)
            put_four(out, i, four(y, i) + (more + a5 * four(k5, i)))
    else:
        for i in range(0, size, 4):
            more = a1 * four(k1, i) + a3 * four(k3, i) + a4 * four(k4, i) + a5 * four(k5, i)
            put_four(out, i, four(y, i) + (more + a6 * four(k6, i)))


@kernel
def embedded_error(buffer, h, layers, stage, e1, e2, e3, e4, e5, e6):
    """Error of a step: h times the sum of e1 to e6 times the rates in K1, in `stage`, and in K7."""
    k1, k2 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, stage[0])
    k3, k4 = block(buffer, state.AT.stage, stage[1]), block(buffer, state.AT.stage, stage[2])
    k5, k6 = block(buffer, state.AT.stage, stage[3]), block(buffer, state.AT.stage, K7)
    out = block(buffer, state.AT.trial, OF_PART)
    h1, h2, h3, h4, h5, h6 = h * e1, h * e2, h * e3, h * e4, h * e5, h * e6
    for i in range(0, (layers + 1) * state.extent(buffer).active, 4):
        one = h1 * four(k1, i) + h2 * four(k2, i) + h3 * four(k3, i)
        put_four(out, i, one + (h4 * four(k4, i) + h5 * four(k5, i) + h6 * four(k6, i)))
    return worst_error(buffer, layers)


@kernel
def worst_error(buffer, layers):
    """Largest error of a step, as a part of what was fed of a size; its errors lie in OF_PART.

    What passed wrongly counts 3/2. What lies in a wrong layer counts by how far it was moved over
    the depth of the bed, twice: the sum over the layers' upper faces of what went through them.
    """
    nodes = state.extent(buffer).active
    weight, out = active_vector(buffer, state.AT.compact, 1), block(buffer, state.AT.trial, OF_PART)
    face, worst = 2.0 / layers, all_four(0.0)
    for i in range(0, nodes, 4):
        moved = four(out, i)
        error = 1.5 * apart(moved)
        for row in range(1, layers):
            moved += four(out, row * nodes + i)
            error += face * apart(moved)
        worst = larger(worst, error * four(weight, i))
    return largest(worst)


@kernel
def integrate_stages(buffer, h, size):
    """Add the time integral of a step of the pair, from its stages."""
    y, total = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, INTEGRAL)
    k1, k2 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, K2)
    k3, k4 = block(buffer, state.AT.stage, K3), block(buffer, state.AT.stage, K4)
    k5 = block(buffer, state.AT.stage, K5)
    g1, g2, g3, g4, g5 = h * h * I1, h * h * I2, h * h * I3, h * h * I4, h * h * I5
    for i in range(0, size, 4):
        one = g1 * four(k1, i) + g2 * four(k2, i) + g3 * four(k3, i) + g4 * four(k4, i)
        one = h * four(y, i) + (one + g5 * four(k5, i))
        put_four(total, i, four(total, i) + one)


@kernel
def take_explicit(buffer, layers, last_rates):
    """The step becomes the state, its last rates the next first ones. False: there are debts."""
    y, new = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    debts = all_four(0.0)
    for i in range(0, (layers + 1) * state.extent(buffer).active, 4):
        value = four(new, i)
        put_four(y, i, value)
        debts = larger(debts, 0.0 - value)
    if last_rates:
        k1, k7 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, K7)
        for i in range(0, rows_followed(buffer, layers), 4):
            put_four(k1, i, four(k7, i))
    return largest(debts) == 0.0


@kernel
def pair_step(buffer, scene, layers, h, moment):
    """Try a step of the explicit pair of order 5; returns its error, a part of what was fed."""
    size = rows_followed(buffer, layers)
    for stage in range(2, 8):
        stage_value(buffer, stage, h, size)
        at = moment + C[stage - 2] * h
        column_rates(
            buffer, scene, state.AT.stage, STAGED, layers, state.AT.stage, K1 + stage - 1, at
        )
    return embedded_error(buffer, h, layers, (K3, K4, K5, K6), E1, E3, E4, E5, E6, E7)


# --- the chain of order 3 ------------------------------------------------------------------------
@kernel
def chain_stage(buffer, last, h_last, h_first, size):
    """Next stage of the chain, y + h_last k_last + h_first k1, into STAGED."""
    y, out = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    k, k1 = block(buffer, state.AT.stage, last), block(buffer, state.AT.stage, K1)
    if h_first == 0.0:
        for i in range(0, size, 4):
            put_four(out, i, four(y, i) + h_last * four(k, i))
    else:
        for i in range(0, size, 4):
            put_four(out, i, four(y, i) + (h_last * four(k, i) + h_first * four(k1, i)))


@kernel
def chain_end(buffer, stage, h, row, size):
    """Solution of the chain from the rates of its last three stages, into STAGED."""
    y, out = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    k1, k2 = block(buffer, state.AT.stage, stage[1]), block(buffer, state.AT.stage, stage[2])
    k3 = block(buffer, state.AT.stage, stage[3])
    h1, h2, h3 = h * CHAIN_END[row, 0], h * CHAIN_END[row, 1], h * CHAIN_END[row, 2]
    for i in range(0, size, 4):
        more = h1 * four(k1, i) + h2 * four(k2, i) + h3 * four(k3, i)
        put_four(out, i, four(y, i) + more)


@kernel
def chain_stages(spread):
    """Fewest stages with which the chain is stable up to `spread` = h times fastest rate."""
    stages = CHAIN_LEAST
    while stages < CHAIN_MOST and CHAIN_STABLE[stages - CHAIN_LEAST] < (1.0 - 1e-9) * spread:
        stages += 1
    return stages


@kernel
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
        column_rates(buffer, scene, state.AT.stage, STAGED, layers, state.AT.stage, kept[3], at)
    chain_end(buffer, kept, h, row, size)
    column_rates(buffer, scene, state.AT.stage, STAGED, layers, state.AT.stage, K7, moment + h)
    e1, e2, e3 = CHAIN_ERROR[row, 0], CHAIN_ERROR[row, 1], CHAIN_ERROR[row, 2]
    e4, e5, e6 = CHAIN_ERROR[row, 3], CHAIN_ERROR[row, 4], CHAIN_ERROR[row, 5]
    return embedded_error(buffer, h, layers, kept, e1, e2, e3, e4, e5, e6)


# --- what both schemes share ---------------------------------------------------------------------
@kernel
def third_order_error(buffer, h, layers):
    """What a step of order 2 leaves out, from values and rates at both ends (as a part of feed)."""
    y, new = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    k1, k7 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, K7)
    out = block(buffer, state.AT.trial, OF_PART)
    for i in range(0, (layers + 1) * state.extent(buffer).active, 4):
        rates = 0.4 * h * (four(k1, i) + four(k7, i))
        put_four(out, i, 0.8 * (four(y, i) - four(new, i)) + rates)
    return worst_error(buffer, layers)


@kernel
def integrate_ends(buffer, h, size):
    """Add the time integral of a step of the chain (Hermite)."""
    y, new = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    k1, k7 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, K7)
    total = block(buffer, state.AT.stage, INTEGRAL)
    half, twelfth = 0.5 * h, h * h / 12.0
    for i in range(0, size, 4):
        one = half * (four(y, i) + four(new, i)) + twelfth * (four(k1, i) - four(k7, i))
        put_four(total, i, four(total, i) + one)


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
    y, new = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, STAGED)
    k1, k7 = block(buffer, state.AT.stage, K1), block(buffer, state.AT.stage, K7)
    out = block(buffer, state.AT.trial, OF_PART)
    size = (layers + 1) * state.extent(buffer).active
    gd, g1, g7 = whole - near + 2.0 * bend, h * (near - bend), -h * bend
    for i in range(0, size, 4):
        one = start * four(y, i) + gd * (four(new, i) - four(y, i))
        put_four(out, i, one + (g1 * four(k1, i) + g7 * four(k7, i)))
    if more > 0.0:
        k3, k4 = block(buffer, state.AT.stage, K3), block(buffer, state.AT.stage, K4)
        k5, k6 = block(buffer, state.AT.stage, K5), block(buffer, state.AT.stage, K6)
        g = h * more
        r1, r3, r4, r5, r6, r7 = g * D1, g * D3, g * D4, g * D5, g * D6, g * D7
        for i in range(0, size, 4):
            one = r1 * four(k1, i) + r3 * four(k3, i) + r4 * four(k4, i)
            one += r5 * four(k5, i) + r6 * four(k6, i) + r7 * four(k7, i)
            put_four(out, i, four(out, i) + one)


@kernel
def part_to_kink(buffer, layers, h, scheme, change):
    """Part of an explicit step after which the top layer has changed by `change` kg/m2."""
    row = layers - 1
    d = layer_mass(block_load(buffer, state.AT.stage, STAGED), row)
    d -= layer_mass(block_load(buffer, state.AT.stage, NOW), row)
    first = h * layer_mass(block_load(buffer, state.AT.stage, K1), row) - d
    second = d - first - h * layer_mass(block_load(buffer, state.AT.stage, K7), row)
    third = 0.0
    if scheme == PAIR:
        third = D1 * layer_mass(block_load(buffer, state.AT.stage, K1), row)
        third += D3 * layer_mass(block_load(buffer, state.AT.stage, K3), row)
        third += D4 * layer_mass(block_load(buffer, state.AT.stage, K4), row)
        third += D5 * layer_mass(block_load(buffer, state.AT.stage, K5), row)
        third += D6 * layer_mass(block_load(buffer, state.AT.stage, K6), row)
        third += D7 * layer_mass(block_load(buffer, state.AT.stage, K7), row)
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
    total, staged = block(buffer, state.AT.stage, INTEGRAL), block(buffer, state.AT.stage, STAGED)
    out = block(buffer, state.AT.trial, OF_PART)
    size = (layers + 1) * state.extent(buffer).active
    integral_in_step(buffer, layers, h, 0.0, t, scheme)
    for i in range(0, size, 4):
        put_four(total, i, four(total, i) + four(out, i))
    value_in_step(buffer, layers, h, t, scheme)
    for i in range(0, size, 4):
        put_four(staged, i, four(out, i))


@kernel
def sum_step(buffer, layers, h, scheme):
    """Add the time integral of a whole explicit step of any scheme."""
    size = (layers + 1) * state.extent(buffer).active
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
    load = block_load(buffer, state.AT.trial, 2 * k)
    passed = block_passed(buffer, state.AT.trial, 2 * k)
    column, time = block(buffer, state.AT.trial, 2 * k), block(buffer, state.AT.trial, 2 * k + 1)
    rate = active_vector(buffer, state.AT.node_work, 0)
    contact = active_vector(buffer, state.AT.node_work, 1)
    stay = active_vector(buffer, state.AT.node_work, 3)
    down = active_column(buffer, state.AT.percolation)
    up = state.vector(buffer, state.AT.upward, state.extent(buffer).layers, 0)
    nodes = rate.size
    cover = cover_of(scene, layer_mass(load, 0))
    pace = passage_factors(buffer, scene, load, load, layers, cover, contact, rate)
    for i in range(nodes):
        rate[i] = max(0.0, rate[i]) * pace * contact[i]
    upward_rates(load, down, layers, up)
    implicit_step(load, rate, down, up, active_column(buffer, state.AT.scratch), stay, layers, h)
    for i in range(nodes):
        passed[i] += h * rate[i] * load[0, i]
    terms = state.extent(buffer).source_terms
    if terms > 0:
        source = view2(buffer, int(buffer[state.AT.source_now]), 3, nodes)
        for i in range(nodes):
            load[layers - 1, i] += h * mean_landing(source, i, terms, h, moment)
    layers = restack(buffer, scene, load, layers)
    for i in range((layers + 1) * nodes):
        time[i] += h * column[i]
    return layers


@kernel
def run_trial(buffer, scene, k, layers, rows, h, moment):
    """k + 1 basic steps over h from NOW into trial k, which uses at most `rows` layers."""
    now = block(buffer, state.AT.stage, NOW)
    column, time = block(buffer, state.AT.trial, 2 * k), block(buffer, state.AT.trial, 2 * k + 1)
    nodes = state.extent(buffer).active
    for i in range((rows + 1) * nodes):
        # What passed counts from here; above the loads lies the share of the top layer.
        column[i] = now[i] if nodes <= i < (layers + 1) * nodes else 0.0
        time[i] = 0.0
    layers_for(buffer, scene, bed_load(block_load(buffer, state.AT.stage, NOW), layers))
    part = h / (k + 1)
    for n in range(k + 1):
        layers = basic_step(buffer, scene, k, layers, part, moment + n * part)


@kernel
def rows_in_use(buffer, scene, load, layers, h, moment):
    """Layers that a step of h may need: what lands opens new ones, nothing else does."""
    terms = state.extent(buffer).source_terms
    if terms == 0:
        return layers
    landing = 0.0
    source = view2(buffer, int(buffer[state.AT.source_now]), 3, state.extent(buffer).active)
    for i in range(state.extent(buffer).active):
        landing += mean_landing(source, i, terms, h, moment)
    more = layers_for(buffer, scene, bed_load(load, layers) + h * landing) + 1
    return max(layers, min(more, load.shape[0]))


@kernel
def extrapolate(buffer, k, rows):
    """Aitken-Neville on the trials 0..k; the best value lies in trial 0, the next in trial 1.

    Trial k keeps its own first-order value. `rows` is the highest number of layers in use.
    """
    size = (rows + 1) * state.extent(buffer).active
    for level in range(1, k + 1):
        factor = 1.0 / ((k + 1.0) / (k + 1.0 - level) - 1.0)
        for part in range(2):
            better = block(buffer, state.AT.trial, 2 * (k - level + 1) + part)
            coarse = block(buffer, state.AT.trial, 2 * (k - level) + part)
            for i in range(size):
                coarse[i] = better[i] + factor * (better[i] - coarse[i])


@kernel
def step_error(buffer, rows):
    """Largest difference of the two best extrapolations as a part of what was fed of a size."""
    flux = block_passed(buffer, state.AT.trial, 0)
    coarse_flux = block_passed(buffer, state.AT.trial, 2)
    load, coarse_load = block_load(buffer, state.AT.trial, 0), block_load(buffer, state.AT.trial, 2)
    weight = active_vector(buffer, state.AT.compact, 1)
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
    total = block(buffer, state.AT.stage, INTEGRAL)
    debts = 0
    for i in range((rows + 1) * state.extent(buffer).active):
        debts += 1 if total[i] < 0.0 else 0
    if debts > 0:
        gone = block_passed(buffer, state.AT.stage, INTEGRAL)
        load = block_load(buffer, state.AT.stage, INTEGRAL)
        carry_debts(gone, load, rows)


@kernel
def take_implicit(buffer, scene, rows, h):
    """Take trial 0 as the state after h and add its sums; returns the layers."""
    size = (rows + 1) * state.extent(buffer).active
    now, total = block(buffer, state.AT.stage, NOW), block(buffer, state.AT.stage, INTEGRAL)
    best, time = block(buffer, state.AT.trial, 0), block(buffer, state.AT.trial, 1)
    gone = state.extent(buffer).active
    carry_debts(
        block_passed(buffer, state.AT.trial, 0), block_load(buffer, state.AT.trial, 0), rows
    )
    carry_debts(
        block_passed(buffer, state.AT.trial, 1), block_load(buffer, state.AT.trial, 1), rows
    )
    for i in range(gone):
        total[i] += h * now[i] + time[i]
        now[i] += best[i]
    for i in range(gone, size):
        total[i] += time[i]
        now[i] = best[i]
    return restack(buffer, scene, block_load(buffer, state.AT.stage, NOW), rows)
