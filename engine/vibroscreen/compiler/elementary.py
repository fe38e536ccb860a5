"""Elementary functions from + - * / and bits alone: the same bits on every machine.

Those of a C library differ in the last digit between versions, processors with and without fused
multiply-add, and systems. Largest errors, in units in the last place of the result, against
200-bit arithmetic (tests/kernels/numerics/test_elementary.py):

    exp, log, sine, cosine      0.9  (angles up to ANGLE_LIMIT; beyond, the digits fade)
    tangent, sinh, cosh         2
    raised                      0.9 where |y ln x| < 40, 4 anywhere

Series are those of Taylor, and of artanh for the logarithm, after the argument was brought near
zero; what rounding leaves over is carried along where a digit depends on it.
"""

from math import factorial

from vibroscreen.compiler.language import bits_of, kernel, number_of

_INF = float("inf")
_NAN = float("nan")
# Sums of parts of which the first have so few digits that their multiples are exact.
_LN2, _LN2_REST = 0.6931471805592082, 7.371002565167799e-13
_QUARTER = 1.5707963267341256
_QUARTER_REST = 6.077100506303966e-11
_QUARTER_LAST = 2.0222662487959506e-21
_TURN = 6.283185307179586
ANGLE_LIMIT = 1e6  # rad, to which multiples of a quarter turn are exact
_WHOLE = 4503599627370496.0  # from here on every number is whole
_SQRT2 = 1.4142135623730951
_SPLIT = 134217729.0  # 2^27 + 1
_FRACTION_BITS = 0x000FFFFFFFFFFFFF
_ONE_BITS = 0x3FF0000000000000
# Coefficients of series, highest power first.
_EXP = tuple(1.0 / factorial(n) for n in range(13, 2, -1))
_SINE = tuple(1.0 / factorial(n) for n in range(19, 2, -2))
_COSINE = tuple(1.0 / factorial(n) for n in range(20, 3, -2))
_ARTANH = tuple(2.0 / n for n in range(23, 2, -2))


@kernel
def _series(coefficient, z):
    """Polynomial in z by Horner's rule."""
    total = coefficient[0]
    for k in range(1, len(coefficient)):
        total = total * z + coefficient[k]
    return total


@kernel
def _product_rest(a, b, product):
    """What rounding took from a b (Dekker)."""
    t = _SPLIT * a
    a_high = t - (t - a)
    a_low = a - a_high
    t = _SPLIT * b
    b_high = t - (t - b)
    b_low = b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@kernel
def _scaled(x, exponent):
    """x 2^exponent for 1/2 < x < 2, through the denormal numbers too."""
    if exponent > 1000:
        return x * number_of((1000 + 1023) << 52) * number_of((exponent - 1000 + 1023) << 52)
    if exponent < -1000:
        return x * number_of((1023 - 1000) << 52) * number_of((exponent + 1000 + 1023) << 52)
    return x * number_of((exponent + 1023) << 52)


@kernel
def _exp_of(x, rest):
    """exp(x + rest), |rest| far below |x|."""
    if x != x:
        return x
    if x > 710.0:
        return _INF
    if x < -746.0:
        return 0.0
    t = x * 1.4426950408889634
    exponent = int(t + 0.5) if t >= 0.0 else int(t - 0.5)
    high = x - exponent * _LN2
    low = exponent * _LN2_REST - rest
    r = high - low
    rest = (high - r) - low
    return _scaled(1.0 + (r + (r * r * (0.5 + r * _series(_EXP, r)) + rest)), exponent)


@kernel
def _log_of(x):
    """ln(x) for 0 < x < inf, and what rounding took from it."""
    exponent = 0
    if x < 2.2250738585072014e-308:
        x *= 18014398509481984.0  # 2^54
        exponent = -54
    bits = bits_of(x)
    exponent += (bits >> 52) - 1023
    m = number_of((bits & _FRACTION_BITS) | _ONE_BITS)
    if m > _SQRT2:
        m *= 0.5
        exponent += 1
    # ln(m) = 2 artanh(q), q = (m - 1)/(m + 1)
    over = m - 1.0
    under = m + 1.0
    under_rest = m - (under - 1.0)
    q = over / under
    product = q * under
    q_rest = ((over - product) - _product_rest(q, under, product) - q * under_rest) / under
    z = q * q
    small = 2.0 * q_rest + q * z * _series(_ARTANH, z)
    # Exponent first: it is zero, or larger than all the rest.
    whole = exponent * _LN2
    high = whole + 2.0 * q
    low = (whole - high) + 2.0 * q if exponent != 0 else 0.0
    low += small + exponent * _LN2_REST
    total = high + low
    return total, (high - total) + low


@kernel
def exp(x):
    """e^x."""
    return _exp_of(x, 0.0)


@kernel
def log(x):
    """Natural logarithm; -inf at 0, nan below."""
    if x != x or x < 0.0:
        return _NAN
    if x == 0.0:
        return -_INF
    if x == _INF:
        return x
    return _log_of(x)[0]


@kernel
def raised(x, y):
    """x^y for x >= 0; nan below."""
    if y == 0.0:
        return 1.0
    if x != x or y != y or x < 0.0:
        return _NAN
    if x == 0.0 or x == _INF:
        return _INF if (x == _INF) == (y > 0.0) else 0.0
    high, low = _log_of(x)
    product = y * high
    if not abs(product) < 800.0:
        return _INF if product > 0.0 else 0.0
    return _exp_of(product, _product_rest(y, high, product) + y * low)


@kernel
def _half_exp(x):
    """e^x/2, also where e^x is too large for a number."""
    if x < 700.0:
        return 0.5 * exp(x)
    less = x - _LN2
    return _exp_of(less, ((x - less) - _LN2) - _LN2_REST)


@kernel
def sinh(x):
    """Hyperbolic sine."""
    if abs(x) < 1.0:
        z = x * x
        return x + x * z * _series(_SINE, z)
    half = _half_exp(abs(x))
    size = half - 0.25 / half
    return size if x > 0.0 else -size


@kernel
def cosh(x):
    """Hyperbolic cosine."""
    half = _half_exp(abs(x))
    return half + 0.25 / half


@kernel
def _reduced(x):
    """Quarter turns in an angle, and the rest within an eighth turn either side, in two parts."""
    if not abs(x) < 1e300:
        return 0, _NAN, 0.0
    while abs(x) > ANGLE_LIMIT:
        turns = x / _TURN
        x -= _TURN * (float(int(turns)) if abs(turns) < _WHOLE else turns)
    t = x * 0.6366197723675814
    quarter = int(t + 0.5) if t >= 0.0 else int(t - 0.5)
    high = x - quarter * _QUARTER
    product = quarter * _QUARTER_REST
    first = high - product
    back = first - high
    low = (high - (first - back)) - (product + back) - quarter * _QUARTER_LAST
    r = first + low
    return quarter, r, (first - r) + low


@kernel
def _sine_of(r, rest):
    """Sine of r + rest, |r| < 0.8."""
    z = -r * r
    return r + (r * z * _series(_SINE, z) + rest * (1.0 + 0.5 * z))


@kernel
def _cosine_of(r, rest):
    """Cosine of r + rest, |r| < 0.8."""
    z = r * r
    half = 0.5 * z
    near = 1.0 - half
    return near + (((1.0 - near) - half) + (z * z * _series(_COSINE, -z) - r * rest))


@kernel
def sine_cosine(x):
    """Sine and cosine of an angle in rad."""
    quarter, r, rest = _reduced(x)
    sine, cosine = _sine_of(r, rest), _cosine_of(r, rest)
    if quarter & 1:
        sine, cosine = cosine, -sine
    if quarter & 2:
        sine, cosine = -sine, -cosine
    return sine, cosine


@kernel
def sin(x):
    """Sine of an angle in rad."""
    return sine_cosine(x)[0]


@kernel
def cos(x):
    """Cosine of an angle in rad."""
    return sine_cosine(x)[1]


@kernel
def tan(x):
    """Tangent of an angle in rad."""
    sine, cosine = sine_cosine(x)
    return sine / cosine
