"""Four numbers side by side: the same bits as one after another, compiled and as plain Python."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numba.core.errors import TypingError

from tests.places import ROOT
from vibroscreen import Feed, Screen, ScreenConfig
from vibroscreen.compiler.fours import (
    all_four,
    apart,
    four,
    four_in,
    in_fours,
    larger,
    largest,
    put_four,
    put_four_in,
    total,
)
from vibroscreen.kernels.entry import START_SLICE, run
from vibroscreen.kernels.numerics import blocks, column
from vibroscreen.size_classes import SizeClasses

if os.environ.get("NUMBA_DISABLE_JIT") == "1":

    def compiled(function):
        return function

else:
    from vibroscreen.compiler.whole import compiled

WIDTH = 12

# Far from what overflows, where all bits are defined.
numbers = arrays(np.float64, WIDTH, elements=st.floats(-1e100, 1e100))


@compiled
def everything(values, rows, out):
    """Every operation once; sum and largest number of rows[1]."""
    whole, most = all_four(0.0), all_four(0.0)
    for i in range(0, values.size, 4):
        x, y = four(values, i), four_in(rows, 1, i)
        put_four_in(out, 0, i, larger(0.0, 2.0 - x) + y * x)
        z = 3.0 * x - (y + 1.0) * 0.5
        z += y
        z -= x
        z *= 0.25
        put_four_in(out, 1, i, z)
        put_four(values, i, apart(x))
        whole += y
        most = larger(most, y)
    return total(whole), largest(most)


@settings(deadline=None)  # the first one compiles
@given(numbers, numbers)
def test_four_at_once_are_the_bits_of_one_after_another(first, second) -> None:
    """Against numpy, element by element; a sum is that of four sums side by side."""
    rows = np.array([np.zeros(WIDTH), second])
    values, out = first.copy(), np.zeros((2, WIDTH))
    whole, most = everything(values, rows, out)
    room = 2.0 - first
    wanted = np.array(
        [
            np.where(room > 0.0, room, 0.0) + second * first,
            ((3.0 * first - (second + 1.0) * 0.5) + second - first) * 0.25,
        ]
    )
    np.testing.assert_array_equal(out.view(np.int64), wanted.view(np.int64))
    np.testing.assert_array_equal(values.view(np.int64), np.abs(first).view(np.int64))
    a, b, c, d = (0.0 + x[0] + x[1] + x[2] for x in second.reshape(-1, 4).T)
    assert whole == (a + b) + (c + d)
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


@pytest.mark.parametrize(
    "values",
    [np.zeros((8, 2))[:, 0], np.zeros(8, dtype=np.float32), np.zeros(8, dtype=np.int64)],
    ids=["strided", "float32", "int64"],
)
def test_other_arrays_are_refused(values: np.ndarray) -> None:
    """What is not doubles one after the other would be read as something else."""

    @compiled
    def read(values):
        return total(four(values, 0))

    assert read(np.ones(4)) == 4.0
    with pytest.raises(TypingError):
        read(values)


@pytest.mark.parametrize("classes", range(1, 9))
@pytest.mark.parametrize("coarse", [False, True])
def test_sizes_that_take_part_are_padded(classes: int, coarse: bool) -> None:
    """The last size comes again up to a multiple of four, without mass and weight."""
    edges = tuple(0.004 * k for k in range(classes + 1))
    config = ScreenConfig(
        SizeClasses(edges, subdivision=1), feed=Feed(20.0, (1.0 / classes,) * classes)
    )
    screen = Screen(config)
    screen.switch(coarse_sizes=coarse)
    layout, buffer = screen._slice()
    run(buffer, START_SLICE, 0.0, 0.0)
    load, scene = layout.view(buffer, "lead")[0], layout.record(buffer, "scene")[0, 0]
    layers = int(np.count_nonzero(load.sum(axis=1)))
    column.gather(buffer, scene, load, layout.view(buffer, "lead_feed")[0], layers)
    active = layout.record(buffer, "work").active
    place = layout.view(buffer, "place")
    taking_part = int(place.max()) + 1
    assert active == in_fours(taking_part)
    assert 1 <= taking_part <= classes
    size, weight = layout.view(buffer, "compact").ravel()[: 2 * active].reshape(2, active)
    assert (np.diff(size[:taking_part]) > 0.0).all()
    assert (size[taking_part:] == size[taking_part - 1]).all()
    assert (weight[:taking_part] > 0.0).all()
    assert (weight[taking_part:] == 0.0).all()
    now = layout.view(buffer, "stage")[blocks.NOW, : (layers + 1) * active]
    held = now.reshape(layers + 1, active)[1:]
    assert (held[:, taking_part:] == 0.0).all()
    assert held.sum() == pytest.approx(load.sum(), rel=1e-14)


def test_plain_python_means_the_same() -> None:
    """The tests above hold where nothing is compiled, but that any array can be read."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", __file__]
    command += ["-k", "not refused and not plain_python"]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout
