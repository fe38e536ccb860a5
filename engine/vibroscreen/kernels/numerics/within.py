"""Values and integrals within a step that was taken, by its polynomial."""

from vibroscreen.compiler.fours import four, put_four
from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.numerics import blocks, explicit

# Within a step (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.6).
D1, D3, D4 = -12715105075 / 11282082432, 87487479700 / 32700410799, -10690763975 / 1880347072
D5, D6, D7 = 701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423
BENT = ((blocks.K1, D1), (blocks.K3, D3), (blocks.K4, D4))
BENT += ((blocks.K5, D5), (blocks.K6, D6), (blocks.K7, D7))


# With d = STAGED - y the column at the part t of an explicit step is, to order 4,
#   y + t d + t(1-t)(h k1 - d) + t^2 (1-t) (2 d - h k1 - h k7) + t^2 (1-t)^2 h sum of D k,
# or to order 3 without the last term, which is that of the pair.
@kernel
def integral_in_step(buffer, layers, h, a, b, scheme):
    """Time integral of an explicit step from a h to b h, into block OF_PART."""
    first, second, third = b - a, (b * b - a * a) / 2.0, (b * b * b - a * a * a) / 3.0
    fourth = (b * b * b * b - a * a * a * a) / 4.0
    fifth = (b * b * b * b * b - a * a * a * a * a) / 5.0
    bend = h * (third - fourth)
    more = h * (third - 2.0 * fourth + fifth) if scheme == explicit.PAIR else 0.0
    combine_step(buffer, layers, h, h * first, h * second, h * (second - third), bend, more)


@kernel
def combine_step(buffer, layers, h, start, whole, near, bend, more):
    """Sum of the terms of the polynomial of a step with these weights, into block OF_PART."""
    y, new, k1, k7 = blocks.step_ends(buffer)
    out = blocks.stage(buffer, blocks.OF_PART)
    size = (layers + 1) * state.work(buffer).active
    gd, g1, g7 = whole - near + 2.0 * bend, h * (near - bend), -h * bend
    for i in range(0, size, 4):
        one = start * four(y, i) + gd * (four(new, i) - four(y, i))
        put_four(out, i, one + (g1 * four(k1, i) + g7 * four(k7, i)))
    if more > 0.0:
        _, _, k3, k4, k5, k6, _ = blocks.rates(buffer)
        g = h * more
        r1, r3, r4, r5, r6, r7 = g * D1, g * D3, g * D4, g * D5, g * D6, g * D7
        for i in range(0, size, 4):
            one = r1 * four(k1, i) + r3 * four(k3, i) + r4 * four(k4, i)
            one += r5 * four(k5, i) + r6 * four(k6, i) + r7 * four(k7, i)
            put_four(out, i, four(out, i) + one)


@kernel
def part_to_kink(buffer, layers, h, scheme, change):
    """Part of an explicit step after which the top layer has changed by `change` kg/m2."""
    d = blocks.top_mass(buffer, blocks.STAGED, layers) - blocks.top_mass(buffer, blocks.NOW, layers)
    first = h * blocks.top_mass(buffer, blocks.K1, layers) - d
    second = d - first - h * blocks.top_mass(buffer, blocks.K7, layers)
    third = 0.0
    if scheme == explicit.PAIR:
        for stage, weight in BENT:
            third += weight * blocks.top_mass(buffer, stage, layers)
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
    total, staged = blocks.stage(buffer, blocks.INTEGRAL), blocks.stage(buffer, blocks.STAGED)
    out = blocks.stage(buffer, blocks.OF_PART)
    size = (layers + 1) * state.work(buffer).active
    integral_in_step(buffer, layers, h, 0.0, t, scheme)
    for i in range(0, size, 4):
        put_four(total, i, four(total, i) + four(out, i))
    bend = t * t * (1.0 - t)
    more = bend * (1.0 - t) if scheme == explicit.PAIR else 0.0
    combine_step(buffer, layers, h, 1.0, t, t * (1.0 - t), bend, more)
    for i in range(0, size, 4):
        put_four(staged, i, four(out, i))
