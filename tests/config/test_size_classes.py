"""Split of the size classes: exact sums, the reference interpolant, and the quadrature error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator

from vibroscreen.compiler.language import Row
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels.bed.classes import (
    LEAST_PASSAGE,
    LEAST_PERCOLATION,
    MOST_NODES,
    build_nodes,
    cumulative_slopes,
    merge_classes,
    most_nodes,
    piece_nodes,
    split_classes,
)
from vibroscreen.kernels.physics.segregation import CLASSIFIED, EXCHANGE, PROPORTIONAL, WELL_MIXED
from vibroscreen.kernels.state import PARAMETER
from vibroscreen.size_classes import Nodes, SizeClasses
from vibroscreen.units import MM

Array = NDArray[np.float64]
APERTURE = 16.0 * MM
TOLERANCE = 1e-4


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


def nodes_of(
    classes: SizeClasses,
    apertures: Sequence[float],
    tolerance: float,
    segregation_model: int = EXCHANGE,
    dilation: float = 0.0,
    strength: tuple[float, float] = (0.0, 0.0),
    percolation_velocity: float = 0.0,
) -> Nodes:
    """Nodes of all classes for the apertures [m], as the engine places them.

    strength: K = rho_b u phi W L/Q0 of the openings and of the gaps (kernels/bed/classes.py).
    """
    setting = np.zeros(len(PARAMETER))
    parameter = Row(setting, 0, PARAMETER)
    parameter.size_classes_subdivision = classes.subdivision
    parameter.solver_tolerance = tolerance
    parameter.segregation_model = segregation_model
    parameter.segregation_dilation = dilation
    parameter.segregation_velocity = percolation_velocity
    aperture = np.sort(np.array(apertures, dtype=float))
    room = most_nodes(classes.count, aperture.size, float(classes.subdivision))
    size, node_class, position, weight = np.empty((4, room))
    count = build_nodes(
        np.array(classes.edges),
        aperture,
        setting,
        np.maximum(strength, (LEAST_PASSAGE, LEAST_PERCOLATION)),
        size,
        node_class,
        position,
        weight,
    )
    return Nodes(size[:count], node_class[:count].astype(np.intp), position[:count], weight[:count])


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
    nodes = nodes_of(classes, apertures, TOLERANCE)
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
    nodes = nodes_of(classes, apertures, TOLERANCE)
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
    nodes = nodes_of(classes, [APERTURE], TOLERANCE)
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
    nodes = nodes_of(classes, [4.0 * MM], TOLERANCE)
    fraction = np.array([0.2, 0.5, 0.3])
    assert nodes.size == pytest.approx(classes.mean, rel=1e-15)
    assert split(classes, fraction, nodes).tolist() == fraction.tolist()


def test_classes_break_at_every_aperture_inside_them() -> None:
    classes = SizeClasses((0.0, 4.0 * MM, 20.0 * MM, 63.0 * MM), subdivision=3)
    nodes = nodes_of(classes, [8.0 * MM, 16.0 * MM, 8.0 * MM, 4.0 * MM], TOLERANCE)
    assert np.bincount(nodes.class_index).tolist() == [3, 9, 3]
    pieces = np.searchsorted([4.0 * MM, 8.0 * MM, 16.0 * MM, 20.0 * MM], nodes.size)
    assert np.bincount(pieces).tolist() == [3, 3, 3, 3, 3]


def test_engine_needs_no_more_than_mass_and_mean_where_nothing_passes() -> None:
    edges = np.array([0.0, 4.0, 20.0, 63.0]) * MM
    classes = SizeClasses(tuple(edges))
    for model, least in ((WELL_MIXED, 1), (CLASSIFIED, 1), (PROPORTIONAL, 1), (EXCHANGE, 2)):
        nodes = nodes_of(classes, [APERTURE], TOLERANCE, model, 1.0 * MM)
        assert (nodes.class_index == 2).sum() == least
        # the other side of an aperture has its own mass
        assert ((nodes.class_index == 1) & (nodes.size > APERTURE)).sum() == 2
    fraction = np.array([0.2, 0.5, 0.3])
    density = cumulative(edges, fraction).derivative()
    moment = quad(lambda d: d * float(density(d)), edges[2], edges[3])[0]
    nodes = nodes_of(classes, [APERTURE], TOLERANCE, EXCHANGE, 1.0 * MM)
    held = split(classes, fraction, nodes)
    coarse = nodes.class_index == 2
    assert (held * nodes.size)[coarse].sum() == pytest.approx(moment, rel=1e-12)


@given(
    low=st.floats(0.0, 0.999),
    width=st.floats(1e-4, 1.0),
    tolerance=st.sampled_from([1e-2, 1e-3, 1e-4, 1e-5, 1e-6]),
)
@settings(deadline=None)
def test_nodes_of_a_piece_grow_with_its_width_and_the_wanted_accuracy(
    low: float, width: float, tolerance: float
) -> None:
    nodes = piece_nodes(low, low + width, 1.0, 500.0, tolerance)
    assert 1 <= nodes <= MOST_NODES
    assert piece_nodes(low, low + 0.5 * width, 1.0, 500.0, tolerance) <= nodes
    assert piece_nodes(low, low + width, 1.0, 500.0, 0.1 * tolerance) >= nodes
    assert piece_nodes(low + 1.0, low + 1.0 + width, 1.0, 500.0, tolerance) == 1


@given(analyses(), st.sampled_from([WELL_MIXED, PROPORTIONAL, EXCHANGE, CLASSIFIED]))
@settings(deadline=None)
def test_nodes_fit_into_their_room(
    analysis: tuple[SizeClasses, Array, list[float]], model: int
) -> None:
    classes, _, apertures = analysis
    nodes = nodes_of(classes, apertures, 1e-9, model)
    assert nodes.count <= most_nodes(classes.count, len(apertures), float(classes.subdivision))


@pytest.mark.parametrize("count", [1, 2, 5, 16, 100])
def test_nodes_are_those_of_gauss_and_legendre(count: int) -> None:
    nodes = nodes_of(SizeClasses((0.0, 2.0), count), [2.0], TOLERANCE)
    abscissa, weight = np.polynomial.legendre.leggauss(count)
    assert nodes.size == pytest.approx(1.0 + abscissa, abs=1e-15)
    assert nodes.weight == pytest.approx(0.5 * weight, rel=1e-11)


def test_what_can_pass_keeps_its_mass_in_a_class_that_holds_the_aperture() -> None:
    edges = np.array([0.0, 2.0, 4.0, 8.0, 20.0, 63.0]) * MM
    fraction = np.array([0.15, 0.10, 0.15, 0.40, 0.20])
    classes = SizeClasses(tuple(edges))
    nodes = nodes_of(classes, [APERTURE], TOLERANCE)
    passing = split(classes, fraction, nodes)[nodes.size < APERTURE].sum()
    assert passing == pytest.approx(float(cumulative(edges, fraction)(APERTURE)), rel=1e-13)


def class_error(
    classes: SizeClasses, fraction: Array, aperture: float, passage: float, nodes: Nodes
) -> float:
    """Largest error of a class's recovery 1 - exp(-K (1 - d/a)^2), K = passage.

    Against adaptive quadrature of the same density, with scipy's interpolant.
    """

    def recovery(size: Array | float) -> Array:
        free = np.maximum(0.0, 1.0 - np.asarray(size) / aperture)
        return -np.expm1(-passage * free * free)

    found = merge(classes, split(classes, fraction, nodes) * recovery(nodes.size), nodes)
    scale = classes.upper[-1]
    density = cumulative(np.array(classes.edges) / scale, fraction).derivative()
    worst = 0.0
    for k in np.flatnonzero(fraction > 1e-3):
        low, high = classes.lower[k], classes.upper[k]
        points = [aperture / scale] if low < aperture < high else None
        exact, _ = quad(
            lambda x: float(density(x) * recovery(x * scale)),
            low / scale,
            high / scale,
            points=points,
            epsabs=1e-12,
            epsrel=1e-12,
            limit=200,
        )
        worst = max(worst, abs(found[k] - exact) / fraction[k])
    return worst


@st.composite
def measured_classes(draw: st.DrawFn) -> tuple[SizeClasses, Array]:
    """Classes from a factor 1.1 to a factor 4 and any fractions."""
    count = draw(st.integers(2, 12))
    factor = draw(st.lists(st.floats(1.1, 4.0), min_size=count, max_size=count))
    edges = 100.0 * MM / np.concatenate([[1.0], np.cumprod(factor)])[::-1]
    edges = edges if draw(st.booleans()) else np.concatenate([[0.0], edges])
    share = st.one_of(st.just(0.0), st.floats(0.01, 1.0))
    masses = np.array(draw(st.lists(share, min_size=edges.size - 1, max_size=edges.size - 1)))
    masses[draw(st.integers(0, masses.size - 1))] += 0.1
    return SizeClasses(tuple(edges)), masses / masses.sum()


@given(
    measured_classes(),
    st.floats(2.0 * MM, 120.0 * MM),
    st.floats(0.5, 50.0),
    st.sampled_from([1e-2, 1e-3, 1e-4, 1e-5, 1e-6]),
)
@settings(max_examples=200, deadline=None)
def test_error_of_a_class_stays_below_the_tolerance(
    analysis: tuple[SizeClasses, Array], aperture: float, passage: float, tolerance: float
) -> None:
    classes, fraction = analysis
    nodes = nodes_of(classes, [aperture], tolerance, WELL_MIXED)
    assert class_error(classes, fraction, aperture, passage, nodes) < tolerance


@given(measured_classes(), st.floats(5.0 * MM, 60.0 * MM), st.floats(0.5, 50.0))
@settings(max_examples=50, deadline=None)
def test_error_of_a_class_stays_below_the_tolerance_at_each_of_two_apertures(
    analysis: tuple[SizeClasses, Array], aperture: float, passage: float
) -> None:
    classes, fraction = analysis
    apertures = [aperture, 2.0 * aperture]
    nodes = nodes_of(classes, apertures, TOLERANCE, WELL_MIXED)
    for one in apertures:
        assert class_error(classes, fraction, one, passage, nodes) < TOLERANCE


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        (
            (0.0, 0.004, 0.002),
            (
                "size_classes.edges[3] = 0.002 m is not larger than the limit below it (0.004 m): list the limits finest first, and what belongs to them in the same order"
            ),
        ),
        (
            (0.0, 0.0),
            (
                "size_classes.edges[2] = 0 m is not larger than the limit below it (0 m): list the limits finest first, and what belongs to them in the same order"
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
                "size_classes.edges[1] = -0.001 m is out of range (0 to 2 m): give a number in this range (edges_mm in a TOML file)"
            ),
        ),
        (
            (0.0, 16.0),
            (
                "size_classes.edges[2] = 16 m is out of range (0 to 2 m): were millimetres meant? 16 mm is 0.016 m"
            ),
        ),
        (
            (0.0, float("nan")),
            (
                "size_classes.edges[2] = nan m is not a finite number (0 to 2 m): give a number in this range (edges_mm in a TOML file)"
            ),
        ),
        (
            (0.0, True),
            (
                "size_classes.edges[2] = True is not a number (0 to 2 m): give a number in this range (edges_mm in a TOML file)"
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
                "size_classes.subdivision = -1 is out of range (0 to 100): give a whole number in this range (subdivision in a TOML file)"
            ),
        ),
        (
            2.0,
            (
                "size_classes.subdivision = 2.0 is not a whole number (0 to 100): give a whole number in this range (subdivision in a TOML file)"
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
