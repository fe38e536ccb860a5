"""Packing, percolation and exchange between layers against hand-computed numbers and limits."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from vibroscreen import Feed, InputError, Screen, ScreenConfig, packing_gap
from vibroscreen.compiler.language import Row
from vibroscreen.kernels import state
from vibroscreen.kernels.physics.classified import classified
from vibroscreen.kernels.physics.exchange import exchange
from vibroscreen.kernels.physics.proportional import proportional
from vibroscreen.kernels.physics.well_mixed import well_mixed
from vibroscreen.sections import (
    Bed,
    Deck,
    Displacement,
    Material,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses

# DESIGN.md, "Exact solutions", item 5: dr/R, r/R, phi. For dr/R = .05 it prints .07425, from an r
# rounded before it is squared; pi/sqrt3 (.212436/1.05)^2 = .0742446.
PACKING = [
    (0.00, 0.15470, 0.04341),
    (0.05, 0.21244, 0.07424),
    (0.10, 0.27017, 0.10942),
    (0.20, 0.38564, 0.18732),
]


@pytest.mark.parametrize(("dilation", "radius", "open_area"), PACKING)
def test_packing_numbers(dilation: float, radius: float, open_area: float) -> None:
    gap, phi = packing_gap(0.01, 0.01 * dilation)
    assert gap / 0.01 == pytest.approx(radius, abs=5e-6)
    assert phi == pytest.approx(open_area, abs=5e-6)


def test_packing_limits() -> None:
    # dr >> R: r/(R + dr) -> 2/sqrt3, pi/sqrt3 x 4/3 = 2.418 > 1: all open
    assert packing_gap(0.001, 1.0)[1] == 1.0
    assert packing_gap(0.0, 0.0) == (0.0, 0.0)
    with pytest.raises(InputError, match="dilation = -1 is not a finite number"):
        packing_gap(0.001, -1.0)


def scene_of(**values: float) -> Row:
    scene = Row(np.zeros(len(state.SCENE)), 0, state.SCENE)
    for name, value in values.items():
        setattr(scene, name, value)
    return scene


@pytest.mark.parametrize("mass", [0.0, 5e-324, 1e-310, 1e-290, 1e-100, 1.0])
@pytest.mark.parametrize("size", [1e-170, 1e-3])
@pytest.mark.parametrize("dilation", [0.0, 5e-324, 1e-3])
def test_exchange_of_next_to_nothing_is_finite(mass: float, size: float, dilation: float) -> None:
    scene = scene_of(
        density=1600.0,
        contact_load=16.0,
        layer_full=16.0,
        segregation_velocity=0.02,
        dilation=dilation,
    )
    load = np.array([[16.0, 0.0], [mass, mass]])
    contact, rate = np.zeros(2), np.zeros((2, 2))
    exchange(np.array([size, 2.0 * size]), load, 2, scene, contact, rate)
    assert np.isfinite(rate).all()
    assert np.isfinite(contact).all()
    assert (rate >= 0.0).all()


# Two classes, three layers, contact and upper layer of different depth [m], [kg/m2].
TWO_SIZES = np.array([0.001, 0.010])
THREE_LAYERS = np.array([[12.0, 12.0], [10.0, 10.0], [2.0, 6.0]])


def test_exchange_flux_by_hand() -> None:
    """Two classes, three layers, contact and upper layer of different depth."""
    # d = 1 and 10 mm; middle layer 20 kg/m2 of half each: R = (.5 x 1 + .5 x 10)/2 = 2.75 mm,
    # dr = 1 mm: r = .1547005 x 2.75 + 1.1547005 x 1 = 1.5801270 mm, opening 3.1602540 mm,
    # phi = pi/sqrt3 (1.5801270/3.75)^2 = 1.8137994 x .1775503 = .3220407
    # fines: (1 - 1/3.1602540)^2 = .4672676; coarse 10 > 3.16: 0
    # rho w = 1600 x .1 = 160, fills: contact 24/32 = .75, middle 20/16 (>1) -> min = .75
    # flux of the fines = 160 x .3220407 x .4672676 x .5 x .75 = 9.028750
    scene = scene_of(
        density=1600.0,
        contact_load=32.0,
        layer_load=16.0,
        layer_full=16.0,
        segregation_velocity=0.1,
        dilation=0.001,
    )
    contact, rate = np.zeros(2), np.zeros((3, 2))
    exchange(TWO_SIZES, THREE_LAYERS, 3, scene, contact, rate)
    assert contact == pytest.approx([1 / 24, 1 / 24], rel=1e-14)
    expected = 9.028750
    assert rate[1, 0] * THREE_LAYERS[1, 0] == pytest.approx(expected, rel=1e-6)
    assert rate[1, 1] == 0.0
    # top layer: 8 kg/m2, F = .25, .75: mean 7.75 mm, R = 3.875, r = .5994645 + 1.1547005 =
    # 1.7541650, opening 3.5083300, phi = 1.8137994 x (1.7541651/4.875)^2 = .2348448
    # (1 - 1/3.5083302)^2 = .5111737; fill 8/16 = .5 (below 1.25):
    # 160 x .2348448 x .5111737 x .25 x .5 = 2.400930
    expected = 2.400930
    assert rate[2, 0] * THREE_LAYERS[2, 0] == pytest.approx(expected, rel=1e-6)


def test_dilation_may_be_a_part_of_the_mean_grain() -> None:
    """0.1 of the mean size, 5.5 mm in the middle and 7.75 mm on top, beside what is a length."""
    common = {"density": 1600.0, "contact_load": 32.0, "layer_full": 16.0}

    def rates(**dilation: float) -> np.ndarray:
        contact, rate = np.zeros(2), np.zeros((3, 2))
        scene = scene_of(**common, segregation_velocity=0.1, **dilation)
        exchange(TWO_SIZES, THREE_LAYERS, 3, scene, contact, rate)
        return rate

    both = rates(dilation=0.0002, relative_dilation=0.1)
    assert both[1] == pytest.approx(rates(dilation=0.0002 + 0.00055)[1], rel=1e-12)
    assert both[2] == pytest.approx(rates(dilation=0.0002 + 0.000775)[2], rel=1e-12)


def test_mixing_moves_all_sizes_alike() -> None:
    """rho_b w_m F fill: of 20 kg/m2 over a contact layer of fill 0.75, of 8 kg/m2 of fill 0.5."""
    scene = scene_of(density=1600.0, contact_load=32.0, layer_full=16.0, mixing=0.01)
    contact, rate = np.zeros(2), np.zeros((3, 2))
    exchange(TWO_SIZES, THREE_LAYERS, 3, scene, contact, rate)
    assert rate[1] * THREE_LAYERS[1] == pytest.approx([16.0 * 0.5 * 0.75] * 2, rel=1e-12)
    assert rate[2] * THREE_LAYERS[2] == pytest.approx(
        [16.0 * 0.25 * 0.5, 16.0 * 0.75 * 0.5], rel=1e-12
    )


def test_contact_of_the_other_models_by_hand() -> None:
    # bed of 2, 3, 15 kg/m2, contact layer 4 kg/m2: the finest 4 are 2 and 2 of the 3
    size, load = np.array([0.001, 0.002, 0.003]), np.array([[2.0, 3.0, 15.0]])
    scene = scene_of(contact_load=4.0, proportion=0.25)
    contact, rate = np.zeros(3), np.zeros((1, 3))
    classified(size, load, 1, scene, contact, rate)
    assert contact * load[0] == pytest.approx([0.5, 0.5, 0.0], rel=1e-14)
    well_mixed(size, load, 1, scene, contact, rate)
    assert contact * load[0] == pytest.approx([0.1, 0.15, 0.75], rel=1e-14)
    proportional(size, load, 1, scene, contact, rate)
    # .75 (.1, .15, .75) + .25 (.5, .5, 0)
    assert contact * load[0] == pytest.approx([0.2, 0.2375, 0.5625], rel=1e-14)
    assert not rate.any()


def test_classified_bed_thinner_than_the_contact_layer_is_mixed() -> None:
    load = np.array([[1.0, 0.0, 3.0]])
    contact, rate = np.zeros(3), np.zeros((1, 3))
    classified(np.array([0.001, 0.002, 0.003]), load, 1, scene_of(contact_load=9.0), contact, rate)
    assert contact * load[0] == pytest.approx([0.25, 0.0, 0.75], rel=1e-14)


# --- the bed in time ---------------------------------------------------------------------------
def plate(**changes: object) -> ScreenConfig:
    """Two classes, 2 and 12 mm, on a vibrating plate of 16 mm."""
    base = ScreenConfig(
        SizeClasses((0.001, 0.003, 0.021), subdivision=1),
        decks=(Deck(2.0, (Panel(6.0, 0.0, 0.016, 0.5),)),),
        material=Material(1600.0),
        displacement=Displacement("prescribed", 0.3),
        passage=Passage("gaudin", velocity=0.0),
        segregation=Segregation("exchange", velocity=0.05, dilation=0.001),
        bed=Bed(contact_depth=0.01),
        solver=Solver(1e-6),
        feed=Feed(20.0, (0.5, 0.5)),
    )
    return dataclasses.replace(base, **changes)


def profile_of(config: ScreenConfig, feed: Feed) -> np.ndarray:
    """Loads [point, layer, class] along the deck."""
    return Screen(config).solve_steady(feed).profile.load


DEEP = Feed(1600.0 * 0.05 * 2.0 * 0.3, (0.5, 0.5))  # a bed of 50 mm: five layers


def test_closed_deck_keeps_layers_and_mass_and_fines_sink() -> None:
    load = profile_of(plate(), DEEP)
    assert load.shape[1] == 5
    assert load.sum(axis=2) == pytest.approx(np.full((65, 5), 16.0), rel=1e-12)
    assert load.sum(axis=1) == pytest.approx(np.full((65, 2), 40.0), rel=1e-12)
    assert (load >= 0.0).all()
    fines = load[:, :, 0] / load.sum(axis=2)
    assert fines[0] == pytest.approx(np.full(5, 0.5), rel=1e-12)
    assert (np.diff(fines[:, 0]) >= -1e-9).all()
    assert fines[-1, 0] > 0.9
    assert fines[-1, 4] < 0.1
    assert (np.diff(fines[-1]) <= 1e-9).all()


def test_no_percolation_velocity_leaves_layers_mixed() -> None:
    config = plate(segregation=Segregation("exchange", velocity=0.0, dilation=0.001))
    load = profile_of(config, DEEP)
    assert load == pytest.approx(np.full((65, 5, 2), 8.0), rel=1e-12)


def test_batch_on_closed_plate_loses_nothing() -> None:
    recovery = Screen(plate()).sieve_batch(80.0, (0.5, 0.5), times=[0.0, 1.0, 100.0])
    assert not recovery.any()


def test_first_exchange_by_hand() -> None:
    """Slope of the fines in the contact layer at the feed end, two full layers."""
    # F = .5 in both layers, d = 2 and 12 mm: R = 3.5 mm, dr = 1 mm:
    # r = .15470054 x 3.5 + 1.15470054 = 1.69615 mm, opening 3.39230 mm,
    # phi = pi/sqrt3 (1.69615/4.5)^2 = .2576879, (1 - 2/3.39230)^2 = .1684531
    # down: rho w phi s F = 80 x .2576879 x .1684531 x .5 = 1.736332 kg/(m2 s) of fines;
    # up the same mass, half of it fines: the contact layer gains half of it
    rho_w = 1600.0 * 0.05
    r = (2.0 / math.sqrt(3.0) - 1.0) * 3.5 + 2.0 / math.sqrt(3.0)
    phi = math.pi / math.sqrt(3.0) * (r / 4.5) ** 2
    down = rho_w * phi * (1.0 - 2.0 / (2.0 * r)) ** 2 * 0.5
    assert down == pytest.approx(1.736332, rel=1e-6)
    config = plate(
        solver=Solver(1e-9),
        decks=(Deck(2.0, (Panel(0.064, 0.0, 0.016, 0.5),)),),
    )
    feed = Feed(1600.0 * 0.02 * 2.0 * 0.3, (0.5, 0.5))
    result = Screen(config).solve_steady(feed).profile
    time = result.position / 0.3
    gain = (result.load[:, 0, 0] - result.load[0, 0, 0])[1:] / time[1:]
    # extrapolate the secant to zero time
    assert 2.0 * gain[0] - gain[1] == pytest.approx(0.5 * down, rel=1e-4)


def test_mixing_holds_percolation_in_balance() -> None:
    """Two full layers, x of fines above and 1 - x below; coarse grains do not fit the gaps.

    Fines go down at w p + w_m, all that goes down is w p x + w_m and comes back with 1 - x of fines:
    (w p + w_m) x = (w p x + w_m) (1 - x).
    """
    velocity, mixing = 0.5, 0.03

    def balance(x: float) -> float:
        radius = 0.5 * (2.0 * x + 12.0 * (1.0 - x))
        gap = (2.0 / math.sqrt(3.0) - 1.0) * radius + 2.0 / math.sqrt(3.0)
        phi = math.pi / math.sqrt(3.0) * (gap / (radius + 1.0)) ** 2
        falls = velocity * phi * (1.0 - 1.0 / gap) ** 2
        return (falls + mixing) * x - (falls * x + mixing) * (1.0 - x)

    above = brentq(balance, 1e-6, 0.5)
    assert 0.05 < above < 0.45
    config = plate(segregation=Segregation("exchange", velocity, 0.001, mixing=mixing))
    load = profile_of(config, Feed(1600.0 * 0.02 * 2.0 * 0.3, (0.5, 0.5)))[-1]
    assert load[1, 0] / load[1].sum() == pytest.approx(above, rel=1e-5)
    assert load.sum(axis=0) == pytest.approx([16.0, 16.0], rel=1e-12)


def test_fast_mixing_is_well_mixed() -> None:
    """Reduction: w_m -> inf."""
    changes = {"passage": Passage("gaudin", velocity=0.05), "solver": Solver(1e-5)}
    fast = Segregation("exchange", 0.02, 0.001, mixing=100.0)
    mixed = Screen(plate(segregation=fast, **changes)).solve_steady(DEEP)
    limit = Screen(plate(segregation=Segregation("well_mixed"), **changes)).solve_steady(DEEP)
    assert mixed.recovery == pytest.approx(limit.recovery, abs=1e-3)


def test_fast_exchange_sorts_like_classified() -> None:
    """Reduction: w -> inf, all fines below all coarse; the contact layer is the finest of the bed.

    Sizes far apart, so that coarse grains never percolate and the deck passes fines alone.
    """
    fast = Segregation("exchange", velocity=50.0, dilation=0.001)
    changes = {"passage": Passage("gaudin", velocity=0.05), "solver": Solver(1e-5)}
    feed = Feed(1600.0 * 0.05 * 2.0 * 0.3, (0.4, 0.6))
    sorted_bed = Screen(plate(segregation=fast, **changes)).solve_steady(feed)
    ideal = Screen(plate(segregation=Segregation("classified"), **changes)).solve_steady(feed)
    assert sorted_bed.recovery == pytest.approx(ideal.recovery, abs=3e-2)
    slow = Screen(
        plate(segregation=Segregation("exchange", velocity=0.05, dilation=0.001), **changes)
    ).solve_steady(feed)
    assert (
        abs(sorted_bed.recovery - ideal.recovery).max() < abs(slow.recovery - ideal.recovery).max()
    )


def test_proportional_between_its_limits() -> None:
    """Reduction: chi = 0 is well mixed, chi = 1 is classified, bit for bit in the recovery."""
    changes = {"passage": Passage("pelevin", velocity=0.1)}
    ends = [
        (Segregation("proportional", proportion=0.0), Segregation("well_mixed")),
        (Segregation("proportional", proportion=1.0), Segregation("classified")),
    ]
    for mixed, limit in ends:
        one = Screen(plate(segregation=mixed, **changes)).solve_steady(DEEP)
        two = Screen(plate(segregation=limit, **changes)).solve_steady(DEEP)
        assert one.recovery == pytest.approx(two.recovery, rel=1e-12)


def test_exchange_in_a_bed_of_one_layer_is_well_mixed() -> None:
    """Reduction: without layers above there is nothing to exchange with."""
    changes = {"passage": Passage("pelevin", velocity=0.1), "bed": Bed(contact_depth=0.2)}
    one = Screen(plate(**changes)).solve_steady(DEEP)
    two = Screen(plate(segregation=Segregation("well_mixed"), **changes)).solve_steady(DEEP)
    assert one.recovery == pytest.approx(two.recovery, rel=1e-12)


def test_bed_deeper_than_its_layers_thickens_the_upper_ones() -> None:
    config = plate(bed=Bed(contact_depth=0.01, layer_depth=0.005, layers=5))
    load = profile_of(config, DEEP)[0].sum(axis=1)
    # 80 kg/m2: 16 on the screen, the other 64 in four layers that could hold 8 each
    assert load == pytest.approx([16.0] * 5, rel=1e-12)
