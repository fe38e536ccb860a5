"""Four numbers side by side: what loops over sizes take at once.

A compiler's own vector loops check at run time that arrays lie apart, and pay for rows longer than
most beds have. The compiler makes each of these one instruction where the processor has it
(lowering.py), with the bits of one number after another. Sizes that take part are padded to a
multiple of four (column.gather).

    four(values, i), four_in(values, row, i)                 the numbers at i to i + 3
    put_four(values, i, x), put_four_in(values, row, i, x)   a four, or one number four times, there
    all_four(x)                                              one number four times
    x + y, x - y, x * y                                      of fours, or of a four and a number
    larger(x, y), apart(x)                                   the larger of each; without signs
    total(x), largest(x)                                     (x0 + x1) + (x2 + x3); of the four

As plain Python they are small arrays.
"""

from __future__ import annotations

import numpy as np

from vibroscreen.compiler.language import kernel


@kernel
def in_fours(count):
    """The next multiple of four."""
    return (count + 3) // 4 * 4


def four(values, i):
    return values[i : i + 4].copy()


def four_in(values, row, i):
    return values[row, i : i + 4].copy()


def put_four(values, i, x):
    values[i : i + 4] = x


def put_four_in(values, row, i, x):
    values[row, i : i + 4] = x


def larger(x, y):
    return np.where(y > x, y, x)


def apart(x):
    return abs(x)


def total(x):
    return (x[0] + x[1]) + (x[2] + x[3])


def largest(x):
    return max(max(x[0], x[1]), max(x[2], x[3]))


def all_four(x):
    return np.full(4, x)
