"""A chain of four to ten stages, order 3, where stability asks for short steps."""

import numpy as np

from vibroscreen.compiler.fours import four, put_four
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.numerics import blocks, explicit, rates

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
REACH = float(CHAIN_STABLE[-1])


@kernel
def chain_stage(buffer, last, h_last, h_first, size):
    """Next stage of the chain, y + h_last k_last + h_first k1, into STAGED."""
    y, out = blocks.stage(buffer, blocks.NOW), blocks.stage(buffer, blocks.STAGED)
    k, k1 = blocks.stage(buffer, last), blocks.stage(buffer, blocks.K1)
    if h_first == 0.0:
        for i in range(0, size, 4):
            put_four(out, i, four(y, i) + h_last * four(k, i))
    else:
        for i in range(0, size, 4):
            put_four(out, i, four(y, i) + (h_last * four(k, i) + h_first * four(k1, i)))


@kernel
def chain_end(buffer, stage, h, row, size):
    """Solution of the chain from the rates of its last three stages, into STAGED."""
    y, out = blocks.stage(buffer, blocks.NOW), blocks.stage(buffer, blocks.STAGED)
    k1, k2 = blocks.stage(buffer, stage[1]), blocks.stage(buffer, stage[2])
    k3 = blocks.stage(buffer, stage[3])
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
    size = blocks.rows_followed(buffer, layers)
    row = stages - CHAIN_LEAST
    kept = (blocks.K1, blocks.K1, blocks.K1, blocks.K1)  # blocks of the last four rates
    for j in range(stages - 1):
        last = CHAIN_STAGE[row, j]
        first = CHAIN_FIRST[row] if j == stages - 2 else 0.0
        chain_stage(buffer, kept[3], h * last, h * first, size)
        kept = (kept[1], kept[2], kept[3], blocks.K2 + j % 4)
        at = moment + (last + first) * h
        rates.column_rates(buffer, scene, blocks.STAGED, layers, kept[3], at)
    chain_end(buffer, kept, h, row, size)
    rates.column_rates(buffer, scene, blocks.STAGED, layers, blocks.K7, moment + h)
    e1, e2, e3 = CHAIN_ERROR[row, 0], CHAIN_ERROR[row, 1], CHAIN_ERROR[row, 2]
    e4, e5, e6 = CHAIN_ERROR[row, 3], CHAIN_ERROR[row, 4], CHAIN_ERROR[row, 5]
    return explicit.embedded_error(buffer, h, layers, kept, (e1, e2, e3, e4, e5, e6))
