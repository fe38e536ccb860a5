"""Four numbers side by side: the same bits as one after another, compiled and as plain Python."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vibroscreen.kernels.fours import (
    above,
    all_four,
    apart,
    four,
    four_in,
    in_fours,
    largest,
    put_four,
    put_four_in,
    total,
)
from vibroscreen.kernels.jit import kernel

ROOT = Path(__file__).resolve().parent.parent
WIDTH = 12

numbers = arrays(np.float64, WIDTH, elements=st.floats(-1e300, 1e300))


@kernel
def everything(values, rows, out):
    """Every operation once; `out`[0] is a loop over a vector, out[1] one over a row of a matrix."""
    whole, most = all_four(0.0), all_four(0.0)
    for i in range(0, values.size, 4):
        x, y = four(values, i), four_in(rows, 1, i)
        put_four_in(out, 0, i, above(0.0, 2.0 - x) + y * x)
        z = 3.0 * x - (y + 1.0) * 0.5
        z += y
        z -= x
        z *= 0.25
        put_four_in(out, 1, i, z)
        put_four(values, i, apart(x))
        whole += y
        most = above(most, y)
    return total(whole), largest(most)


@given(numbers, numbers)
def test_four_at_once_are_the_bits_of_one_after_another(first, second) -> None:
    """Against numpy, element by element; a sum is that of four sums side by side."""
    with np.errstate(over="ignore", invalid="ignore"):
        rows = np.array([np.zeros(WIDTH), second])
        values, out = first.copy(), np.zeros((2, WIDTH))
        whole, most = everything(values, rows, out)
        room = 2.0 - first
        np.testing.assert_array_equal(out[0], np.where(room > 0.0, room, 0.0) + second * first)
        bent = ((3.0 * first - (second + 1.0) * 0.5) + second - first) * 0.25
        np.testing.assert_array_equal(out[1], bent)
        np.testing.assert_array_equal(values, np.abs(first))
        a, b, c, d = second.reshape(-1, 4).T
        lanes = [(0.0 + x[0] + x[1]) + x[2] for x in (a, b, c, d)]
        assert np.array_equal(whole, (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]), equal_nan=True)
    assert most == max(0.0, second.max())


def test_what_is_not_a_number_is_never_the_larger_one() -> None:
    """As max(0.0, x) of one number: a rate that is not a number moves nothing."""
    rows = np.zeros((2, WIDTH))
    rows[1, 5] = np.nan
    _, most = everything(np.full(WIDTH, 1.0), rows, np.zeros((2, WIDTH)))
    assert most == 0.0


@pytest.mark.parametrize(("count", "padded"), [(0, 0), (1, 4), (4, 4), (5, 8), (200, 200)])
def test_padding(count: int, padded: int) -> None:
    """The next multiple of four."""
    assert in_fours(count) == padded


def test_plain_python_means_the_same() -> None:
    """The tests above hold where nothing is compiled."""
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        return
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout
