"""What the explicit schemes share: errors, and taking a step (MODEL.md, "Explicit schemes")."""

from vibroscreen.compiler.fours import all_four, apart, four, larger, largest, put_four
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks

# Schemes. A short step is cheapest by high order, a wide one by many cheap stages.
PAIR, CHAIN = range(2)
# The explicit pair is stable up to this step times the fastest rate.
STABLE = 3.2


@kernel
def embedded_error(buffer, h, layers, stage, weight):
    """Error of a step: h times the weighted sum of the rates in K1, in `stage`, and in K7."""
    k1, k2 = blocks.stage(buffer, blocks.K1), blocks.stage(buffer, stage[0])
    k3, k4 = blocks.stage(buffer, stage[1]), blocks.stage(buffer, stage[2])
    k5, k6 = blocks.stage(buffer, stage[3]), blocks.stage(buffer, blocks.K7)
    out = blocks.stage(buffer, blocks.OF_PART)
    h1, h2, h3 = h * weight[0], h * weight[1], h * weight[2]
    h4, h5, h6 = h * weight[3], h * weight[4], h * weight[5]
    for i in range(0, (layers + 1) * state.work(buffer).active, 4):
        one = h1 * four(k1, i) + h2 * four(k2, i) + h3 * four(k3, i)
        put_four(out, i, one + (h4 * four(k4, i) + h5 * four(k5, i) + h6 * four(k6, i)))
    return worst_error(buffer, layers)


@kernel
def worst_error(buffer, layers):
    """Largest error of a step, as a part of what was fed of a size; its errors lie in OF_PART.

    What passed wrongly counts 3/2. What lies in a wrong layer counts by how far it was moved over
    the depth of the bed, twice: the sum over the layers' upper faces of what went through them.
    """
    nodes, weight = state.work(buffer).active, state.compact(buffer, 1)
    out = blocks.stage(buffer, blocks.OF_PART)
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
def take_explicit(buffer, layers, last_rates):
    """The step becomes the state, its last rates the next first ones. False: there are debts."""
    y, new, k1, k7 = blocks.step_ends(buffer)
    debts = all_four(0.0)
    for i in range(0, (layers + 1) * state.work(buffer).active, 4):
        value = four(new, i)
        put_four(y, i, value)
        debts = larger(debts, 0.0 - value)
    if last_rates:
        for i in range(0, blocks.rows_followed(buffer, layers), 4):
            put_four(k1, i, four(k7, i))
    return largest(debts) == 0.0


@kernel
def third_order_error(buffer, h, layers):
    """What a step of order 2 leaves out, from values and rates at both ends (as a part of feed)."""
    y, new, k1, k7 = blocks.step_ends(buffer)
    out = blocks.stage(buffer, blocks.OF_PART)
    for i in range(0, (layers + 1) * state.work(buffer).active, 4):
        rates = 0.4 * h * (four(k1, i) + four(k7, i))
        put_four(out, i, 0.8 * (four(y, i) - four(new, i)) + rates)
    return worst_error(buffer, layers)


@kernel
def integrate_ends(buffer, h, size):
    """Add the time integral of a step of the chain (Hermite)."""
    y, new, k1, k7 = blocks.step_ends(buffer)
    total = blocks.stage(buffer, blocks.INTEGRAL)
    half, twelfth = 0.5 * h, h * h / 12.0
    for i in range(0, size, 4):
        one = half * (four(y, i) + four(new, i)) + twelfth * (four(k1, i) - four(k7, i))
        put_four(total, i, four(total, i) + one)
