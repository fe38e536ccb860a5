"""Gaudin and Pelevin against hand-computed values and against the sum as printed (paper, eq. 5, 6).

The paper is Ivanov and Vaisberg, "Screen separation: computational model building experience".
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vibroscreen import InputError, gaudin_probability, pelevin_probability
from vibroscreen.compiler.language import Row
from vibroscreen.kernels import state
from vibroscreen.kernels.physics.passage import passage_probability


def gaudin_by_hand(size: float, aperture: float, open_area: float) -> float:
    """Eq. (5) as printed."""
    return open_area * (1.0 - size / aperture) ** 2 if size < aperture else 0.0


def pelevin_double_sum(
    sizes: list[float], fractions: list[float], aperture: float, open_area: float
) -> np.ndarray:
    """Eq. (6) as printed: quadratic cost, any order of sizes."""
    out = np.zeros(len(sizes))
    for i, d in enumerate(sizes):
        out[i] = gaudin_by_hand(d, aperture, open_area)
        for e, share in zip(sizes, fractions, strict=True):
            if d + e <= aperture and e < aperture:
                beside = gaudin_by_hand(d, aperture - e, open_area)
                out[i] += share * gaudin_by_hand(e, aperture, open_area) * beside
    return out


def test_gaudin_by_hand() -> None:
    # a = 16 mm, phi = .55: 1 - 4/16 = .75, .75^2 = .5625, x .55 = .309375
    assert gaudin_probability(0.004, 0.016, 0.55) == pytest.approx(0.309375, rel=1e-14)
    # dust: all of the open area; half the aperture: a quarter of it; the aperture and more: none
    values = gaudin_probability([0.0, 0.008, 0.016, 0.0161, 1.0], 0.016, 0.6)
    assert values == pytest.approx([0.6, 0.15, 0.0, 0.0, 0.0], rel=1e-14)
    assert values[2] == values[3] == values[4] == 0.0


def test_gaudin_keeps_shape_and_order() -> None:
    sizes = np.array([[0.012, 0.0], [0.02, 0.004]])
    values = gaudin_probability(sizes, 0.016, 1.0)
    assert values.shape == (2, 2)
    assert values == pytest.approx(np.array([[0.0625, 1.0], [0.0, 0.5625]]), rel=1e-14)
    assert isinstance(gaudin_probability(0.0, 0.01, 0.5), float)


def test_pelevin_by_hand() -> None:
    # a = 10, d = 2, 5, 8 (mm), F = .2, .3, .5, phi = .5
    # Gaudin: .5 x .8^2 = .32, .5 x .5^2 = .125, .5 x .2^2 = .02
    # d = 2 beside 2: .2 x .32 x .5 x (1 - 2/8)^2 = .2 x .32 x .28125 = .018
    #       beside 5: .3 x .125 x .5 x (1 - 2/5)^2 = .3 x .125 x .18 = .00675
    #       beside 8: 2 + 8 <= 10, but no room is left: (1 - 2/2)^2 = 0
    #       P = .32 + .018 + .00675 = .34475
    # d = 5 beside 2: .2 x .32 x .5 x (1 - 5/8)^2 = .064 x .0703125 = .0045
    #       beside 5: (1 - 5/5)^2 = 0; P = .125 + .0045 = .1295
    # d = 8 beside 2: (1 - 8/8)^2 = 0; P = .02
    values = pelevin_probability([0.002, 0.005, 0.008], [0.2, 0.3, 0.5], 0.010, 0.5)
    assert values == pytest.approx([0.34475, 0.1295, 0.02], rel=1e-13)


def test_pelevin_may_exceed_one() -> None:
    # dust alone on a fully open deck: 1 + 1 x 1 x 1 = 2, a rate factor and no probability
    assert pelevin_probability([0.0], [1.0], 0.01, 1.0) == pytest.approx([2.0], rel=1e-14)


grains = st.one_of(
    st.floats(0.0, 0.03), st.sampled_from([0.0, 0.004, 0.008, 0.012, 0.016, 0.016 - 1e-12, 0.05])
)
beds = st.lists(st.tuples(grains, st.floats(0.0, 1.0)), min_size=1, max_size=14)


@settings(max_examples=300, deadline=None)
@given(bed=beds, open_area=st.floats(0.01, 1.0))
def test_pelevin_is_the_double_sum(bed: list[tuple[float, float]], open_area: float) -> None:
    """Unsorted and equal sizes, sizes at and above the aperture."""
    sizes, shares = [d for d, _ in bed], [f for _, f in bed]
    values = pelevin_probability(sizes, shares, 0.016, open_area)
    expected = pelevin_double_sum(sizes, shares, 0.016, open_area)
    assert values == pytest.approx(expected, rel=1e-11, abs=1e-13)
    assert (values >= 0.0).all()


def test_pelevin_with_one_grain_tends_to_gaudin() -> None:
    """Reduction: a contact layer of grains too large to pass leaves Gaudin's law."""
    sizes = np.linspace(0.0, 0.015, 6)
    values = pelevin_probability([*sizes, 0.05], [0.0] * 6 + [1.0], 0.016, 0.55)
    assert values[:-1] == pytest.approx(gaudin_probability(sizes, 0.016, 0.55), rel=1e-14)
    assert values[-1] == 0.0


@pytest.mark.parametrize(("law", "second"), [(1, 0.15), (2, 0.15 + 0.5 * 0.6 * 0.15)])
def test_law_is_chosen_by_number(law: int, second: float) -> None:
    # dust and d = a/2, half each, phi = .6: Gaudin .6 and .15; Pelevin adds .5 x .6 x .15 for the
    # second beside dust (itself: no room)
    scene = Row(np.zeros(len(state.SCENE)), 0, state.SCENE)
    scene.across = scene.along = scene.seen = 0.016
    scene.open_area = 0.6
    out = np.zeros(2)
    passage_probability(law, 0, np.array([0.0, 0.008]), np.array([0.5, 0.5]), scene, out)
    assert out[1] == pytest.approx(second, rel=1e-14)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: gaudin_probability(0.001, 0.0, 0.5), "aperture = 0 m is not positive"),
        (lambda: gaudin_probability(0.001, np.nan, 0.5), "aperture = nan m is not positive"),
        (lambda: gaudin_probability(0.001, 0.01, 1.5), "open_area = 1.5 is not in 0..1"),
        (lambda: gaudin_probability([0.001, -1.0], 0.01, 0.5), "size = -1 is not a finite number"),
        (lambda: pelevin_probability([0.001], [0.5, 0.5], 0.01, 0.5), "fractions has 2 values"),
        (lambda: pelevin_probability([np.nan], [1.0], 0.01, 0.5), "sizes = nan is not a finite"),
    ],
)
def test_refusals_by_text(call, text: str) -> None:
    with pytest.raises(InputError, match=text):
        call()
