"""Passage law `bounce` and the closures in the vibration: limits and exact solutions."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.config import Harmonic
from vibroscreen.errors import ConfigError
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

GRAVITY = 9.81
APERTURE, OPEN_AREA, RHO, CONTACT = 0.008, 0.5, 1600.0, 0.01
SWING = 2.0 * math.pi * 15.0 * 0.003  # m/s, V of the plate
THROW = SWING**2 / (2.0 * GRAVITY)  # m
FALL = math.sqrt(GRAVITY * APERTURE)  # m/s
SOLIDS = 0.58
# Classes whose means are 2, 4, 6, 7 and 12 mm.
SIZES = np.array([2.0, 4.0, 6.0, 7.0, 12.0]) * 1e-3
EDGES = (0.0015, 0.0025, 0.0055, 0.0065, 0.0075, 0.0165)
NOT_OF_THE_LAW = {"law", "velocity", "velocity_table", "closure"}
NUMBERS = {number.name for number in dataclasses.fields(Passage)} - NOT_OF_THE_LAW
BARE = dict.fromkeys(NUMBERS, 0.0)
TOLERANCE = 1e-6


def plate(velocity: float = 0.1, model: str = "well_mixed", **passage: object) -> ScreenConfig:
    """A deck of 2 x 1 m with the law bounce, bare of all that is not given."""
    law = str(passage.pop("law", "bounce"))
    constants = {**BARE, **passage} if law == "bounce" else passage
    return ScreenConfig(
        SizeClasses(EDGES, 1),
        decks=(Deck(1.0, (Panel(2.0, 0.0, APERTURE, OPEN_AREA),)),),
        material=Material(RHO),
        motion=Motion.linear(0.003, 15.0, 0.5 * math.pi),
        displacement=Displacement("prescribed", 0.2),
        passage=Passage(law, velocity, **constants),
        segregation=Segregation(model),
        bed=Bed(CONTACT),
        solver=Solver(TOLERANCE),
        feed=Feed(5.0, (0.1, 0.2, 0.3, 0.2, 0.2)),
    )


def batch(config: ScreenConfig, load: float, size: int, times: list[float]) -> np.ndarray:
    """Recovery over time of a batch of one size."""
    only = tuple(1.0 if k == size else 0.0 for k in range(SIZES.size))
    return Screen(config).sieve_batch(load, only, times=times)[:, size]


@pytest.mark.parametrize("model", ["well_mixed", "proportional", "exchange", "classified"])
def test_bare_it_is_gaudin(model: str) -> None:
    bounce = Screen(plate(model=model)).solve_steady().recovery
    gaudin = Screen(plate(model=model, law="gaudin")).solve_steady().recovery
    assert_allclose(bounce, gaudin, rtol=0.0, atol=1e-12)


def test_a_rim_that_guides_all_makes_sizes_alike() -> None:
    recovery = Screen(plate(0.001, rim=1.0)).solve_steady().recovery
    assert_allclose(recovery[:4], recovery[0], rtol=1e-9)
    assert 0.1 < recovery[0] < 0.9
    assert recovery[4] == 0.0


@pytest.mark.parametrize("rim", [0.0, 0.3, 1.0])
def test_a_thin_bed_passes_at_the_rate_of_a_grain_alone(rim: float) -> None:
    """k = u phi (1 - (1 - rim) d/a)^2/h_c, whatever the damping and the time in the opening."""
    config = plate(0.05, rim=rim, passing_time=2.0, damping=3.0)
    times = [0.2, 1.0, 3.0]
    for k in (1, 3):
        shape = (1.0 - (1.0 - rim) * SIZES[k] / APERTURE) ** 2
        rate = 0.05 * OPEN_AREA * shape / CONTACT
        assert_allclose(
            batch(config, 1e-5, k, times), -np.expm1(-rate * np.array(times)), atol=2e-5
        )


@pytest.mark.parametrize("k", [1, 2, 3])
def test_crowded_openings_pass_one_grain_at_a_time(k: int) -> None:
    """However fast grains try, an opening passes one in passing_time sqrt(a/g)."""
    passing_time, time = 2.0, 0.5
    config = plate(100.0, rim=0.3, passing_time=passing_time)
    solid = RHO / SOLIDS * math.pi / 6.0 * SIZES[k] ** 3
    most = OPEN_AREA / APERTURE**2 * solid / (passing_time * math.sqrt(APERTURE / GRAVITY))
    load = 10.0 * RHO * CONTACT
    passed = load * batch(config, load, k, [time])[0]
    assert 0.9 * most * time < passed < most * time


def test_finer_grains_share_an_opening_by_volume() -> None:
    """Below half an aperture the throughput of the crowded openings no longer falls with size."""
    config = plate(100.0, rim=1.0, passing_time=2.0)
    load = 10.0 * RHO * CONTACT
    fine, half = (load * batch(config, load, k, [0.5])[0] for k in (0, 1))
    assert_allclose(fine, half, rtol=1e-5)


def carried(guided: np.ndarray, sizes: np.ndarray, drift: float, velocity: float) -> np.ndarray:
    """Chance of a try: sinking, at sqrt(g a)/(drift d), and riding on, at v/(g a), compete."""
    sinks = FALL / (drift * sizes)
    rides = velocity / (guided * APERTURE)
    return guided**2 * sinks / (sinks + rides)


def test_a_fast_bed_carries_grains_over_the_openings() -> None:
    """Recovery 1 - exp(-u phi G L/(h_c v)) in a thin bed."""
    drift, velocity = 0.4, 0.2
    config = plate(0.05, rim=0.2, drift=drift).replace(feed=Feed(1e-5, (0.25,) * 4 + (0.0,)))
    recovery = Screen(config).solve_steady().recovery[:4]
    shape = carried(1.0 - 0.8 * SIZES[:4] / APERTURE, SIZES[:4], drift, velocity)
    assert_allclose(
        recovery, -np.expm1(-0.05 * OPEN_AREA * shape * 2.0 / (CONTACT * velocity)), atol=2e-5
    )


def test_the_faster_the_bed_the_less_passes_a_second_and_of_near_size_most() -> None:
    """Per time on the deck: the rate -log(1 - recovery) v falls with v, by more for coarser grains."""
    rate = []
    for velocity in (0.05, 0.2, 0.8, 3.0):
        config = plate(0.02, rim=0.2, drift=0.4).replace(
            feed=Feed(1e-5, (0.25,) * 4 + (0.0,)),
            displacement=Displacement("prescribed", velocity),
        )
        recovery = Screen(config).solve_steady().recovery[:4]
        rate.append(-np.log1p(-recovery) * velocity)
    left = np.array(rate)[1:] / np.array(rate)[:-1]
    assert (left < 1.0).all()
    assert (np.diff(left, axis=1) < 0.0).all()
    # In the limit riding on decides: the rate goes with 1/v, it never is nothing.
    assert (rate[-1] > 0.0).all()
    assert (left[-1] > 0.8 / 3.0).all()


def test_a_batch_is_not_carried() -> None:
    """A batch lies on a plate that does not convey, also on a screen that does."""
    still = plate(0.05, drift=0.5).replace(displacement=Displacement("prescribed", 0.0))
    assert (batch(plate(0.05, drift=0.5), 20.0, 1, [1.0]) == batch(still, 20.0, 1, [1.0])).all()


def test_a_deep_bed_holds_its_grains_down() -> None:
    """dm/dt = -q/(1 + damping m/(rho_b a)), while the contact layer is full: a quadratic in m."""
    damping, velocity = 0.7, 0.05
    config = plate(velocity, rim=1.0, damping=damping)
    load, times = 6.0 * RHO * CONTACT, np.array([0.5, 1.0, 2.0])
    flux, half = RHO * velocity * OPEN_AREA, 0.5 * damping / (RHO * APERTURE)
    # m + half m^2 = load + half load^2 - flux t
    right = load + half * load**2 - flux * times
    left = (np.sqrt(1.0 + 4.0 * half * right) - 1.0) / (2.0 * half)
    assert left[-1] > RHO * CONTACT
    assert_allclose(batch(config, load, 1, list(times)), 1.0 - left / load, atol=2e-6)


# A deep bed of one size, in contact layers, and the depth that would pass were it not hindered, m.
DEEP, TIME, VELOCITY = 6.0, 1.5, 0.05
UNHINDERED = VELOCITY * OPEN_AREA * TIME


def left_of_deep_bed(**passage: float) -> float:
    """What is left of the deep bed after TIME, in contact layers: more than one, so it was full."""
    load = DEEP * RHO * CONTACT
    left = DEEP * (1.0 - batch(plate(VELOCITY, rim=1.0, **passage), load, 1, [TIME])[0])
    assert left > 1.0
    return float(left)


def test_damping_levels_off_with_depth() -> None:
    """dm/dt = -q/(1 + D m/s), s = sqrt(1 + (c m)^2), m over the contact layer: m + D s/c^2."""
    damping, levelling = 0.9, 0.4
    left = left_of_deep_bed(damping=damping, levelling=levelling)
    held = math.hypot(1.0, levelling * DEEP) - math.hypot(1.0, levelling * left)
    share = damping * CONTACT / APERTURE * held / levelling**2
    assert_allclose(CONTACT * (DEEP - left + share), UNHINDERED, rtol=1e-5)
    # without levelling the bed is damped more and less passes
    assert left_of_deep_bed(damping=damping) > left


def test_a_thrown_bed_lies_loosely() -> None:
    """dm/dt = -q m/(m + rho_b l) while the contact layer is full: m + rho_b l log m falls evenly."""
    lift = 1.6
    left = left_of_deep_bed(lift=lift)
    fallen = CONTACT * (DEEP - left) + lift * THROW * math.log(DEEP / left)
    assert_allclose(fallen, UNHINDERED, rtol=1e-5)


@pytest.mark.parametrize(("lift", "calming"), [(0.5, 0.0), (2.0, 0.0), (2.0, 3.0)])
@pytest.mark.parametrize("load", [1e-5, 0.9 * RHO * CONTACT])
def test_a_thin_thrown_bed_passes_at_a_lower_rate(lift: float, calming: float, load: float) -> None:
    """k = u phi g^2/(h_c + l): as if the contact layer were deeper by the lift, whatever the bed."""
    thrown = lift * THROW / (1.0 + calming)
    rate = 0.05 * OPEN_AREA * (1.0 - SIZES[1] / APERTURE) ** 2 / (CONTACT + thrown)
    times = [0.2, 1.0, 3.0]
    recovery = batch(plate(0.05, lift=lift, calming=calming), load, 1, times)
    assert_allclose(recovery, -np.expm1(-rate * np.array(times)), atol=2e-5)


def test_a_deep_bed_is_thrown_less() -> None:
    """dm/dt = -q/(1 + r l/(m (1 + c m))), m and l over the contact layer: m + l log of m/(1 + c m)."""
    lift, calming = 4.0, 0.6
    left = left_of_deep_bed(lift=lift, calming=calming)
    share = math.log(DEEP / (1.0 + calming * DEEP)) - math.log(left / (1.0 + calming * left))
    fallen = CONTACT * (DEEP - left) + lift * THROW * share
    assert_allclose(fallen, UNHINDERED, rtol=1e-5)
    # without calming more is thrown and less passes
    assert left_of_deep_bed(lift=lift) > left


def test_the_deck_runs_short_under_a_deep_bed() -> None:
    """dm/dt = -q/(1 + r m), r = depletion u phi g^2/(rho_b V a): a quadratic in m, as damping has."""
    depletion, velocity = 0.8, 0.2
    load, times = 6.0 * RHO * CONTACT, np.array([0.2, 0.5, 0.9])
    for k in (1, 3):
        shape = (1.0 - 0.7 * SIZES[k] / APERTURE) ** 2
        config = plate(velocity, rim=0.3, depletion=depletion)
        flux = RHO * velocity * OPEN_AREA * shape
        half = 0.5 * depletion * flux / (RHO**2 * SWING * APERTURE)
        right = load + half * load**2 - flux * times
        left = (np.sqrt(1.0 + 4.0 * half * right) - 1.0) / (2.0 * half)
        assert left[-1] > RHO * CONTACT
        assert_allclose(batch(config, load, k, list(times)), 1.0 - left / load, atol=2e-6)


def test_a_deep_bed_chooses_less_between_sizes() -> None:
    """Depletion takes more from what passes more easily, and nothing from a thin bed."""
    ratio = []
    for load in (1e-4, 20.0, 80.0):
        rate = [
            -np.log1p(-batch(plate(0.5, rim=0.3, depletion=1.0), load, k, [0.05])[0])
            for k in (0, 1, 2, 3)
        ]
        ratio.append(np.array(rate) / rate[0])
    assert (np.diff(np.array(ratio)[:, 1:], axis=0) > 0.0).all()
    shape = (1.0 - 0.7 * SIZES[:4] / APERTURE) ** 2
    assert_allclose(ratio[0], shape / shape[0], rtol=1e-3)


def test_at_the_limit_of_renewal_sizes_pass_alike() -> None:
    """However fast grains try, V a/(depletion H) is what the throw brings to the deck."""
    load, time, depletion = 6.0 * RHO * CONTACT, 0.02, 2.0
    most = RHO * SWING * APERTURE / (depletion * load / RHO)  # kg/(m2 s) at the start
    for k in (0, 3):
        passed = load * batch(plate(100.0, rim=0.9, depletion=depletion), load, k, [time])[0]
        assert 0.95 * most * time < passed < 1.1 * most * time


@pytest.mark.parametrize("law", [{"closure": "vibration"}, {}])
def test_a_deck_that_swings_along_itself_renews_nothing(law: dict[str, object]) -> None:
    """V = 0: with depletion nothing passes, and nothing is undefined."""
    config = plate(0.5, depletion=1.0, **law).replace(motion=Motion.linear(0.005, 15.0, 0.0))
    recovery = Screen(config).solve_steady().recovery
    assert np.isfinite(recovery).all()
    assert (recovery >= 0.0).all()
    assert (recovery < 1e-4).all()


def test_riding_on_takes_from_damping_and_crowding_alike() -> None:
    """Stirring is the same as damping and passing_time over 1 + stirring v/sqrt(g a)."""
    stirring, velocity = 0.7, 0.2
    less = 1.0 + stirring * velocity / FALL
    stirred = plate(0.3, rim=0.3, passing_time=2.0, damping=1.0, stirring=stirring)
    by_hand = plate(0.3, rim=0.3, passing_time=2.0 / less, damping=1.0 / less)
    assert_allclose(
        Screen(stirred).solve_steady().recovery,
        Screen(by_hand).solve_steady().recovery,
        atol=1e-9,
    )


def test_a_mixed_deck_against_scipy() -> None:
    """All of the law at once in a well mixed bed of five sizes."""
    rim, passing_time, drift, damping, u, v = 0.3, 1.8, 0.5, 0.5, 0.5, 0.2
    lift, stirring, calming, depletion, levelling = 0.8, 0.6, 0.5, 0.7, 0.3
    config = plate(
        u,
        rim=rim,
        passing_time=passing_time,
        drift=drift,
        damping=damping,
        lift=lift,
        stirring=stirring,
        calming=calming,
        depletion=depletion,
        levelling=levelling,
    )
    less = 1.0 + stirring * v / FALL
    passes = SIZES < APERTURE
    chance = np.zeros(SIZES.size)
    guided = 1.0 - (1.0 - rim) * SIZES[passes] / APERTURE
    chance[passes] = carried(guided, SIZES[passes], drift, v)
    fed = np.array(config.feed.mass_fraction) * 5.0 / v

    def change(_: float, load: np.ndarray) -> np.ndarray:
        depth = load.sum() / RHO
        shaken = depth / math.hypot(1.0, levelling * depth / CONTACT)
        held = 1.0 + damping / less * shaken / APERTURE
        bed = max(depth, CONTACT)
        held *= 1.0 + lift * THROW / (1.0 + calming * bed / CONTACT) / bed
        short = depletion * u * OPEN_AREA * chance * shaken / (held * SWING * APERTURE)
        lying = load / load.sum() * min(1.0, load.sum() / (RHO * CONTACT))
        tried = RHO * u * OPEN_AREA * chance * lying / (held * (1.0 + short))  # kg/(m2 s), alone
        grain = RHO / SOLIDS * math.pi / 6.0 * np.maximum(SIZES, 0.5 * APERTURE) ** 3
        a_second = (tried / grain).sum() * APERTURE**2 / OPEN_AREA
        taken = passing_time / less * math.sqrt(APERTURE / GRAVITY)
        return -tried / (1.0 + taken * a_second)

    exact = solve_ivp(change, (0.0, 2.0 / v), fed, rtol=1e-10, atol=1e-12)
    assert_allclose(
        Screen(config).solve_steady().recovery, 1.0 - exact.y[:, -1] / fed, atol=5 * TOLERANCE
    )


# --- closures --------------------------------------------------------------------------------------
MOTIONS = {
    "linear": (Motion.linear(0.004, 15.0, math.radians(45.0)), 0.004, 0.004 * math.sqrt(0.5)),
    "circular": (Motion.circular(0.004, 14.0, "against_flow"), 0.004, 0.004),
    "elliptical": (
        Motion.elliptical(0.005, 12.0, math.radians(60.0), 0.4),
        0.005,
        0.005 * math.hypot(math.sin(math.radians(60.0)), 0.4 * math.cos(math.radians(60.0))),
    ),
    "harmonics": (
        Motion(20.0, 0.0, 0.0, 0.0, harmonic=(Harmonic(1, 0.003, 0.4, 0.003, 0.4),)),
        0.003 * math.sqrt(2.0),
        0.003,
    ),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_velocities_follow_from_the_vibration(name: str) -> None:
    """The closure is the same as giving u and w that were scaled by hand."""
    motion, amplitude, normal = MOTIONS[name]
    speed = 2.0 * math.pi * motion.frequency
    acceleration, velocity = amplitude * speed**2 / GRAVITY, normal * speed
    loose = (1.0 - 1.0 / acceleration**2) ** 2
    closed = plate(0.5, "exchange", passing_time=1.8, rim=0.3, closure="vibration").replace(
        motion=motion, segregation=Segregation("exchange", 0.05, 0.003, closure="vibration")
    )
    factor = loose * math.sqrt(FALL / velocity)
    # The time in the opening is longer where tries are rarer.
    by_hand = plate(0.5 * factor, "exchange", passing_time=1.8 / factor, rim=0.3).replace(
        motion=motion,
        segregation=Segregation(
            "exchange", 0.05 * loose * velocity**2 / (GRAVITY * CONTACT), 0.003
        ),
    )
    assert_allclose(
        Screen(closed).solve_steady().recovery, Screen(by_hand).solve_steady().recovery, atol=1e-9
    )


def test_a_slope_turns_the_throw() -> None:
    """V is normal to the panel at hand: a later panel is shaken at its own throw angle."""
    flat = plate(0.3, closure="vibration").replace(
        motion=Motion.linear(0.005, 15.0, math.radians(30.0))
    )
    first = Panel(0.5, 0.0, APERTURE, 0.0)
    steep = Panel(1.5, math.radians(30.0), APERTURE, OPEN_AREA)
    turned = flat.replace(decks=(Deck(1.0, (first, steep)),))
    velocity = 0.005 * 2.0 * math.pi * 15.0 * math.sin(math.radians(60.0))
    acceleration = 0.005 * (2.0 * math.pi * 15.0) ** 2 / GRAVITY
    factor = (1.0 - 1.0 / acceleration**2) ** 2 * math.sqrt(FALL / velocity)
    by_hand = plate(0.3 * factor).replace(motion=flat.motion, decks=turned.decks)
    assert_allclose(
        Screen(turned).solve_steady().recovery, Screen(by_hand).solve_steady().recovery, atol=1e-9
    )


@pytest.mark.parametrize("amplitude", [0.0, 0.001])
def test_weak_shaking_passes_nothing(amplitude: float) -> None:
    """Up to a peak acceleration of g the bed is not loose."""
    config = plate(0.5, passing_time=1.8, closure="vibration")
    motion = Motion.linear(amplitude, 15.0, 0.5 * math.pi)
    screen = Screen(config.replace(motion=motion))
    assert not screen.sieve_batch(20.0, config.feed.mass_fraction, times=[5.0]).any()


def test_percolation_rises_with_the_stroke() -> None:
    """The contact layer of a deck without openings gets finer, the wider the stroke."""
    base = plate(0.0, "exchange").replace(
        segregation=Segregation("exchange", 0.05, 0.003, closure="vibration"),
        feed=Feed(15.0, (0.1, 0.2, 0.3, 0.2, 0.2)),
    )
    share = []
    for amplitude in (0.0013, 0.002, 0.003, 0.004):
        motion = Motion.linear(amplitude, 15.0, 0.5 * math.pi)
        profile = Screen(base.replace(motion=motion)).solve_steady().profile
        share.append(profile.load[16, 0, 0] / profile.load[16, 0].sum())
    assert (np.diff(share) > 0.0).all()


def test_what_a_user_may_get_wrong() -> None:
    with pytest.raises(ConfigError, match=r"passage.rim = 1.2 is out of range"):
        Passage("bounce", rim=1.2)
    with pytest.raises(ConfigError, match=r"passage.closure = 'throw' is unknown"):
        Passage("bounce", closure="throw")
