"""Split of the size classes: exact sums, the reference interpolant, and the quadrature error."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator

from vibroscreen import size_classes
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels.classes import cumulative_slopes, merge_classes, split_classes
from vibroscreen.size_classes import Nodes, SizeClasses
from vibroscreen.units import MM

Array = NDArray[np.float64]
APERTURE = 16.0 * MM


def split(classes: SizeClasses, fraction: Array, nodes: Nodes) -> Array:
    node_fraction = np.full(nodes.count, np.nan)
    split_classes(
        np.array(classes.edges),
        fraction,
        nodes.class_index.astype(float),
        nodes.position,
        nodes.weight,
        np.zeros(classes.count + 1),
        node_fraction,
    )
    return node_fraction


def merge(classes: SizeClasses, node_value: Array, nodes: Nodes) -> Array:
    class_value = np.full(classes.count, np.nan)
    merge_classes(node_value, nodes.class_index.astype(float), class_value)
    return class_value


def cumulative(edges: Array, fraction: Array) -> PchipInterpolator:
    return PchipInterpolator(edges, np.concatenate([[0.0], np.cumsum(fraction)]))


@st.composite
def analyses(draw: st.DrawFn) -> tuple[SizeClasses, Array, list[float]]:
    """Size classes, mass fractions with empty classes among them, apertures."""
    count = draw(st.integers(1, 12))
    widths = draw(st.lists(st.floats(1e-6, 0.1), min_size=count, max_size=count))
    lowest = draw(st.sampled_from([0.0, 1e-4]))
    edges = tuple(lowest + np.concatenate([[0.0], np.cumsum(widths)]))
    mass = st.one_of(st.just(0.0), st.floats(1e-9, 1.0))
    masses = np.array(draw(st.lists(mass, min_size=count, max_size=count)))
    masses[draw(st.integers(0, count - 1))] += 1.0
    apertures = draw(st.lists(st.floats(1e-5, 0.5), min_size=1, max_size=3))
    subdivision = draw(st.integers(0, 6))
    return SizeClasses(edges, subdivision), masses / masses.sum(), apertures


@given(analyses())
@settings(max_examples=150, deadline=None)
def test_split_keeps_the_mass_of_every_class_and_is_never_negative(
    analysis: tuple[SizeClasses, Array, list[float]],
) -> None:
    classes, fraction, apertures = analysis
    nodes = classes.nodes(apertures)
    node_fraction = split(classes, fraction, nodes)
    assert (node_fraction >= 0.0).all()
    assert merge(classes, node_fraction, nodes) == pytest.approx(fraction, rel=1e-14, abs=0.0)
    assert (node_fraction[fraction[nodes.class_index] == 0.0] == 0.0).all()


@given(analyses())
@settings(max_examples=150, deadline=None)
def test_nodes_are_ascending_inside_their_class_and_weights_sum_to_one(
    analysis: tuple[SizeClasses, Array, list[float]],
) -> None:
    classes, _, apertures = analysis
    nodes = classes.nodes(apertures)
    assert (np.diff(nodes.size) > 0.0).all()
    assert (nodes.size >= classes.lower[nodes.class_index]).all()
    assert (nodes.size <= classes.upper[nodes.class_index]).all()
    assert np.bincount(nodes.class_index, nodes.weight) == pytest.approx(1.0, rel=1e-14)


@given(analyses())
@settings(max_examples=100, deadline=None)
def test_slopes_are_those_of_the_reference_interpolant(
    analysis: tuple[SizeClasses, Array, list[float]],
) -> None:
    classes, fraction, _ = analysis
    edges = np.array(classes.edges)
    slope = np.full(classes.count + 1, np.nan)
    cumulative_slopes(edges, fraction, slope)
    expected = cumulative(edges, fraction).derivative()(edges)
    scale = (fraction / np.diff(edges)).max()
    # The reference takes differences of sums, which loses digits in classes of little mass.
    smallest = np.diff(edges).min()
    assert slope == pytest.approx(expected, rel=1e-6, abs=1e-9 * scale + 1e-14 / smallest)


def test_density_is_the_derivative_of_the_reference_interpolant() -> None:
    config = ScreenConfig.default()
    classes = SizeClasses(config.size_classes.edges, 5)
    fraction = np.array(config.feed.mass_fraction)
    nodes = classes.nodes([APERTURE])
    width = (classes.upper - classes.lower)[nodes.class_index]
    density = split(classes, fraction, nodes) / (nodes.weight * width)
    expected = cumulative(np.array(classes.edges), fraction).derivative()(nodes.size)
    assert density == pytest.approx(expected, rel=1e-12)


def test_class_without_density_at_its_nodes_is_spread_by_weight() -> None:
    # Both limits next to empty classes: the density 6 x (1 - x) vanishes only at the limits.
    edges, fraction = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 1.0, 0.0])
    node_fraction = np.full(2, np.nan)
    ends, weight = np.array([0.0, 1.0]), np.array([0.25, 0.75])
    split_classes(edges, fraction, np.ones(2), ends, weight, np.zeros(4), node_fraction)
    assert node_fraction.tolist() == [0.25, 0.75]


def test_one_node_a_class_is_the_arithmetic_mean_with_all_of_its_mass() -> None:
    classes = SizeClasses((0.0, 2.0 * MM, 8.0 * MM, 63.0 * MM), subdivision=1)
    nodes = classes.nodes([4.0 * MM])
    fraction = np.array([0.2, 0.5, 0.3])
    assert nodes.size == pytest.approx(classes.mean, rel=1e-15)
    assert split(classes, fraction, nodes).tolist() == fraction.tolist()


def test_classes_break_at_every_aperture_inside_them() -> None:
    classes = SizeClasses((0.0, 4.0 * MM, 20.0 * MM, 63.0 * MM), subdivision=3)
    nodes = classes.nodes([8.0 * MM, 16.0 * MM, 8.0 * MM, 4.0 * MM])
    assert np.bincount(nodes.class_index).tolist() == [3, 9, 3]
    pieces = np.searchsorted([4.0 * MM, 8.0 * MM, 16.0 * MM, 20.0 * MM], nodes.size)
    assert np.bincount(pieces).tolist() == [3, 3, 3, 3, 3]


def test_engine_chooses_few_nodes_where_nothing_passes() -> None:
    classes = SizeClasses((0.0, 4.0 * MM, 20.0 * MM, 63.0 * MM))
    below, above = size_classes.NODES_BELOW, size_classes.NODES_ABOVE
    inside = classes.nodes([16.0 * MM])
    assert np.bincount(inside.class_index).tolist() == [below, below + above, above]
    at_limit = classes.nodes([20.0 * MM])
    assert np.bincount(at_limit.class_index).tolist() == [below, below, above]
    assert at_limit.size[-above:].mean() == pytest.approx(41.5 * MM)


def test_what_can_pass_keeps_its_mass_in_a_class_that_holds_the_aperture() -> None:
    edges = np.array([0.0, 2.0, 4.0, 8.0, 20.0, 63.0]) * MM
    fraction = np.array([0.15, 0.10, 0.15, 0.40, 0.20])
    classes = SizeClasses(tuple(edges))
    nodes = classes.nodes([APERTURE])
    passing = split(classes, fraction, nodes)[nodes.size < APERTURE].sum()
    assert passing == pytest.approx(float(cumulative(edges, fraction)(APERTURE)), rel=1e-13)


def class_error(subdivision: int, passage: float | None) -> float:
    """Largest error of a class mean of (1 - d/a)^2, or of the recovery 1 - exp(-K (1 - d/a)^2).

    On the default screen, against adaptive quadrature over the same density.
    """

    def quantity(size: Array | float) -> Array:
        gaudin = np.maximum(0.0, 1.0 - np.asarray(size) / APERTURE) ** 2
        return gaudin if passage is None else -np.expm1(-passage * gaudin)

    config = ScreenConfig.default()
    classes = SizeClasses(config.size_classes.edges, subdivision)
    fraction = np.array(config.feed.mass_fraction)
    nodes = classes.nodes([APERTURE])
    found = merge(classes, split(classes, fraction, nodes) * quantity(nodes.size), nodes)
    density = cumulative(np.array(classes.edges), fraction).derivative()
    exact = [
        quad(lambda d: float(density(d) * quantity(d)), low, high, epsabs=1e-13, limit=200)[0]
        for low, high in zip(classes.lower, classes.upper, strict=True)
    ]
    return float(np.abs((found - exact) / fraction).max())


# Measured once and rounded up; the choice of NODES_BELOW rests on these.
@pytest.mark.parametrize(
    ("subdivision", "single_pass", "recovery_15", "recovery_30", "recovery_50"),
    [
        (1, 1.0e-2, 5.0e-2, 1.0e-2, 2.0e-1),
        (2, 6.0e-5, 4.0e-4, 7.0e-3, 2.5e-2),
        (3, 1.0e-11, 2.0e-5, 6.0e-4, 2.0e-3),
        (4, 1.0e-11, 7.0e-7, 3.0e-5, 1.0e-4),
        (6, 1.0e-11, 1.0e-9, 2.0e-8, 1.0e-7),
        (0, 1.0e-11, 7.0e-7, 3.0e-5, 1.0e-4),
    ],
)
def test_quadrature_error_of_a_class(
    subdivision: int,
    single_pass: float,
    recovery_15: float,
    recovery_30: float,
    recovery_50: float,
) -> None:
    assert class_error(subdivision, None) < single_pass
    assert class_error(subdivision, 15.0) < recovery_15
    assert class_error(subdivision, 30.0) < recovery_30
    assert class_error(subdivision, 50.0) < recovery_50


def test_engine_choice_meets_the_default_tolerance_and_one_node_less_does_not() -> None:
    tolerance = ScreenConfig.default().solver.tolerance
    assert class_error(size_classes.NODES_BELOW, 50.0) < tolerance
    assert class_error(size_classes.NODES_BELOW - 1, 50.0) > tolerance


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        (
            (0.0, 0.004, 0.002),
            (
                "size_classes.edges[3] = 0.002 m is not larger than edges[2] = 0.004 m: "
                "list the limits in ascending order"
            ),
        ),
        (
            (0.0, 0.0),
            (
                "size_classes.edges[2] = 0 m is not larger than edges[1] = 0 m: "
                "list the limits in ascending order"
            ),
        ),
        (
            (0.0,),
            (
                "size_classes.edges has 1 values, too few: give 2 or more numbers "
                "(edges_mm in a TOML file)"
            ),
        ),
        (
            0.016,
            (
                "size_classes.edges = 0.016 is not a list of numbers: give 2 or more numbers "
                "(edges_mm in a TOML file)"
            ),
        ),
        (
            (-0.001, 0.016),
            (
                "size_classes.edges[1] = -0.001 m is smaller than 0 m: give a number from 0 m up to "
                "10 m (edges_mm in a TOML file)"
            ),
        ),
        (
            (0.0, 16.0),
            (
                "size_classes.edges[2] = 16 m is larger than 10 m: were millimetres meant? "
                "give edges_mm or metres"
            ),
        ),
        (
            (0.0, float("nan")),
            (
                "size_classes.edges[2] = nan m is not finite: give a number from 0 m up to 10 m "
                "(edges_mm in a TOML file)"
            ),
        ),
        (
            (0.0, True),
            (
                "size_classes.edges[2] = True is not a number: give a number from 0 m up to 10 m "
                "(edges_mm in a TOML file)"
            ),
        ),
    ],
)
def test_refusals_of_limits(edges: tuple[float, ...], message: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        SizeClasses(edges)
    assert str(refusal.value) == message


@pytest.mark.parametrize(
    ("subdivision", "message"),
    [
        (
            -1,
            (
                "size_classes.subdivision = -1 is smaller than 0: give a whole number from 0 up to "
                "100 (subdivision in a TOML file)"
            ),
        ),
        (
            2.0,
            (
                "size_classes.subdivision = 2.0 is not a whole number: give a whole number from 0 up "
                "to 100 (subdivision in a TOML file)"
            ),
        ),
    ],
)
def test_refusals_of_subdivision(subdivision: int, message: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        SizeClasses((0.0, 0.016), subdivision)
    assert str(refusal.value) == message


def test_limits_may_be_an_array() -> None:
    edges: Any = np.array([0.0, 1.0, 2.0]) * MM
    classes = SizeClasses(edges)
    assert classes == SizeClasses((0.0, 0.001, 0.002))
    assert classes.count == 2
    assert classes.mean.tolist() == [0.0005, 0.0015]
