"""The pair of Dormand and Prince, order 5 with an embedded 4: accuracy asks for short steps."""

import numpy as np

from vibroscreen.compiler.fours import four, put_four
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels.numerics import blocks, explicit, rates

# Dormand and Prince (J. Comput. Appl. Math. 6 (1980) 19).
_A = [
    [1 / 5, 0, 0, 0, 0, 0],
    [3 / 40, 9 / 40, 0, 0, 0, 0],
    [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
    [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
    [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
    [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
]
A = np.array(_A)
C = np.array([1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
B_LOW = np.array([5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40])
E1, E3, E4, E5, E6, E7 = (float(x) for x in (np.append(A[5], 0.0) - B_LOW)[[0, 2, 3, 4, 5, 6]])
# Weights of the time integral of the column: sum over stages of b_s a_sl.
I1, I2, I3, I4, I5 = (float(x) for x in (A[5][1:] @ A[:5])[:5])


@kernel
def stage_value(buffer, stage, h, size):
    """Column at a stage 2 to 7 into STAGED; that of stage 7 is the solution of order 5."""
    y, out = blocks.stage(buffer, blocks.NOW), blocks.stage(buffer, blocks.STAGED)
    k1, k2, k3, k4, k5, k6, _ = blocks.rates(buffer)
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
def integrate_stages(buffer, h, size):
    """Add the time integral of a step of the pair, from its stages."""
    y, total = blocks.stage(buffer, blocks.NOW), blocks.stage(buffer, blocks.INTEGRAL)
    k1, k2, k3, k4, k5, _, _ = blocks.rates(buffer)
    g1, g2, g3, g4, g5 = h * h * I1, h * h * I2, h * h * I3, h * h * I4, h * h * I5
    for i in range(0, size, 4):
        one = g1 * four(k1, i) + g2 * four(k2, i) + g3 * four(k3, i) + g4 * four(k4, i)
        one = h * four(y, i) + (one + g5 * four(k5, i))
        put_four(total, i, four(total, i) + one)


@kernel
def pair_step(buffer, scene, layers, h, moment):
    """Try a step of the explicit pair of order 5; returns its error, a part of what was fed."""
    size = blocks.rows_followed(buffer, layers)
    for stage in range(2, 8):
        stage_value(buffer, stage, h, size)
        at = moment + C[stage - 2] * h
        rates.column_rates(buffer, scene, blocks.STAGED, layers, blocks.K1 + stage - 1, at)
    stages = (blocks.K3, blocks.K4, blocks.K5, blocks.K6)
    return explicit.embedded_error(buffer, h, layers, stages, (E1, E3, E4, E5, E6, E7))
