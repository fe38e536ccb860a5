"""Passage law `bounce`: limits, values by hand, and exact solutions of decks and batches."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels.physics.bounce import bounce
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
# Classes whose means are 2, 4, 6, 7 and 12 mm.
SIZES = np.array([2.0, 4.0, 6.0, 7.0, 12.0]) * 1e-3
EDGES = (0.0015, 0.0025, 0.0055, 0.0065, 0.0075, 0.0165)
BARE = {"rim": 0.0, "crowding": 0.0, "drift": 0.0, "levelling": 0.0, "bouncing": 0.0}
LAW = {"rim": 0.3, "crowding": 2.0, "drift": 0.2, "levelling": 0.2, "bouncing": 10.0}
TOLERANCE = 1e-6


def passing(sizes: list[float], fractions: list[float] | None = None, **scene: float) -> np.ndarray:
    """P of the sizes [m]: a bare law on a bed four apertures deep that covers the deck."""
    usual = {
        "aperture": APERTURE,
        "open_area": OPEN_AREA,
        "density": RHO,
        "bed_load": RHO * 4.0 * APERTURE,
        "cover": 1.0,
        "throw_height": THROW,
        "transport_velocity": 0.2,
    }
    side = scene.get("aperture", APERTURE)  # of a level deck
    usual |= dict.fromkeys(("across", "along", "seen", "closed"), side)
    found = np.full(len(sizes), math.nan)
    share = np.array(fractions or [1.0 / len(sizes)] * len(sizes))
    bounce(np.array(sizes), share, SimpleNamespace(**{**usual, **BARE, **scene}), found)
    return found


def test_bare_on_the_usual_bed_it_is_gaudin() -> None:
    expected = OPEN_AREA * np.maximum(0.0, 1.0 - SIZES / APERTURE) ** 2
    assert_allclose(passing(list(SIZES)), expected, rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("rim", [0.0, 0.3, 1.0])
def test_a_grain_as_wide_as_the_opening(rim: float) -> None:
    """As d goes to a: phi rim^2. What is as wide does not pass."""
    just, not_quite = passing([APERTURE * (1.0 - 1e-9), APERTURE], rim=rim)
    assert just == pytest.approx(OPEN_AREA * rim**2, abs=1e-8)
    assert not_quite == 0.0


def test_a_number_by_hand() -> None:
    """6 mm at 8 mm, 20 mm of bed: each step with the calculator.

    g = 1 - .75 * .75 = .4375; sqrt(g a) = .28014 m/s, so .25 * .14007/.28014 * sqrt(.75) = .10825
    of the opening is lost on the way, l = .32925, g l = .144045; h_t = 3 mm, H_b = 8/.5 = 16 mm of
    the 20, E^2 = (16 + 3 (1 + 8/4))/(32 + 3) = .714286, E = .845154; B = 2 * .5 * .144045/.75^3 =
    .341440; P = .5 * .144045/(.845154 * 1.341440) = .063527.
    """
    found = passing(
        [0.006],
        rim=0.25,
        crowding=2.0,
        drift=0.25,
        levelling=0.5,
        bouncing=8.0,
        transport_velocity=0.14007,
        throw_height=0.003,
        bed_load=RHO * 0.020,
        cover=0.5,
    )
    assert found == pytest.approx([0.063527], rel=2e-5)


def test_the_bed_carries_grains_over_the_openings() -> None:
    """Coarser ones more of their passage; the opening is never less than lost."""
    kept = [
        passing(list(SIZES[:4]), rim=0.3, drift=0.2, transport_velocity=v)
        / passing(list(SIZES[:4]), rim=0.3)
        for v in (0.0, 0.1, 0.4, 0.8, 5.0)
    ]
    assert (kept[0] == 1.0).all()
    assert (np.diff(kept, axis=0) <= 0.0).all()
    assert (np.diff(kept[1:3], axis=1) < 0.0).all()
    assert (kept[-1] == 0.0).all()


def test_a_deep_bed_takes_longer_to_come_down() -> None:
    """Tries go with 1/sqrt(H + h_t); with `levelling` no more than a/levelling counts of H."""

    def tries(depth: float, levelling: float = 0.0) -> float:
        return float(passing([0.004], bed_load=RHO * depth, levelling=levelling)[0])

    for depth in (0.01, 0.05, 0.5):
        assert tries(depth) / tries(0.02) == pytest.approx(
            math.sqrt((0.02 + THROW) / (depth + THROW))
        )
    assert tries(1e6, 0.2) == tries(5.0 * APERTURE, 0.2) == tries(5.0 * APERTURE)
    assert tries(4.9 * APERTURE, 0.2) == tries(4.9 * APERTURE)


def test_a_lone_grain_bounces_on() -> None:
    """Its tries are those of a bare deck over sqrt(1 + bouncing); a covered deck does not see it."""
    alone = {"bed_load": 0.0, "cover": 0.0}
    assert passing([0.004], bouncing=8.0, **alone) == pytest.approx(passing([0.004], **alone) / 3.0)
    assert passing([0.004], bouncing=8.0) == passing([0.004])
    usual = OPEN_AREA * 0.25 * math.sqrt((4.0 * APERTURE + THROW) / THROW)
    assert passing([0.004], **alone) == pytest.approx(usual)


@pytest.mark.parametrize("height", [0.0, 1e-30])
def test_without_bed_and_throw_nothing_is_undefined(height: float) -> None:
    found = passing([0.004, 0.009], bed_load=0.0, cover=0.0, throw_height=height)
    assert np.isfinite(found).all()
    assert found[1] == 0.0


def test_crowded_openings() -> None:
    """At most phi (d/a)^3/crowding of one size passes; below a/2 it no longer falls with size."""
    for d in (0.004, 0.006, 0.007):
        most = OPEN_AREA * (d / APERTURE) ** 3 / 50.0
        assert 0.7 * most < passing([d], rim=1.0, crowding=50.0)[0] < most
    finer = passing([0.001, 0.004], rim=1.0, crowding=50.0)
    assert finer[0] == finer[1]
    # what cannot pass takes up no opening, and a half covered deck is crowded half as much
    half = passing([0.004, 0.012], [0.5, 0.5], rim=0.3, crowding=2.0)[0]
    assert half == pytest.approx(passing([0.004], rim=0.3, crowding=1.0)[0])
    assert passing([0.004], rim=0.3, crowding=2.0, cover=0.5)[0] == pytest.approx(half)


def test_finer_grains_pass_more_easily() -> None:
    sizes = list(np.linspace(0.0, 0.99 * APERTURE, 60))
    for scene in ({}, {"transport_velocity": 0.6}, {"bed_load": 1.0, "cover": 0.05}):
        found = passing(sizes, **{**LAW, **scene})
        assert (np.diff(found) <= 0.0).all()
        assert (found >= 0.0).all()


@pytest.mark.parametrize("factor", [0.1, 7.0])
def test_lengths_scale(factor: float) -> None:
    """All lengths over the aperture, velocities over sqrt(g a): P is the same at every scale."""
    large = passing(
        list(factor * SIZES),
        **LAW,
        aperture=factor * APERTURE,
        bed_load=factor * RHO * 0.02,
        cover=0.6,
        throw_height=factor * THROW,
        transport_velocity=math.sqrt(factor) * 0.2,
    )
    assert_allclose(large, passing(list(SIZES), **LAW, bed_load=RHO * 0.02, cover=0.6), rtol=1e-12)


# --- in the engine ---------------------------------------------------------------------------------
def plate(velocity: float = 0.1, model: str = "well_mixed", **passage: object) -> ScreenConfig:
    """A deck of 2 x 1 m with the law bounce, bare of all that is not given."""
    return ScreenConfig(
        SizeClasses(EDGES, 1),
        decks=(Deck(1.0, (Panel(2.0, 0.0, APERTURE, OPEN_AREA),)),),
        material=Material(RHO),
        motion=Motion.linear(0.003, 15.0, 0.5 * math.pi),
        displacement=Displacement("prescribed", 0.2),
        passage=Passage("bounce", velocity, **{**BARE, **passage}),
        segregation=Segregation(model),
        bed=Bed(CONTACT),
        solver=Solver(TOLERANCE),
        feed=Feed(5.0, (0.1, 0.2, 0.3, 0.2, 0.2)),
    )


def batch(config: ScreenConfig, load: float, size: int, times: list[float]) -> np.ndarray:
    """Recovery over time of a batch of one size."""
    only = tuple(1.0 if k == size else 0.0 for k in range(SIZES.size))
    return Screen(config).sieve_batch(load, only, times=times)[:, size]


@pytest.mark.parametrize("bouncing", [0.0, 8.0])
def test_a_thin_bed_passes_at_the_rate_of_a_grain_alone(bouncing: float) -> None:
    """k = u phi g^2/(h_c E), E^2 = h_t (1 + bouncing)/(4 a + h_t), however crowded a deck may be."""
    config = plate(0.05, rim=0.3, crowding=50.0, levelling=0.2, bouncing=bouncing)
    held = math.sqrt(THROW * (1.0 + bouncing) / (4.0 * APERTURE + THROW))
    times = [0.2, 1.0, 3.0]
    for k in (1, 3):
        rate = 0.05 * OPEN_AREA * (1.0 - 0.7 * SIZES[k] / APERTURE) ** 2 / (CONTACT * held)
        assert_allclose(
            batch(config, 1e-6, k, times), -np.expm1(-rate * np.array(times)), atol=2e-5
        )


def test_a_deep_bed_in_time() -> None:
    """dm/dt = -q/sqrt(H + h_t) while the contact layer is full: (H + h_t)^1.5 falls evenly."""
    load, times = 6.0 * RHO * CONTACT, np.array([0.5, 1.0, 2.0])
    flux = 0.05 * OPEN_AREA * math.sqrt(4.0 * APERTURE + THROW)  # m^1.5/s
    start = (6.0 * CONTACT + THROW) ** 1.5
    left = (start - 1.5 * flux * times) ** (2.0 / 3.0) - THROW
    assert left[-1] > CONTACT
    recovery = batch(plate(0.05, rim=1.0), load, 1, list(times))
    assert_allclose(recovery, 1.0 - left / (6.0 * CONTACT), atol=2e-6)


def test_a_batch_is_not_carried() -> None:
    """A batch lies on a plate that does not convey, also on a screen that does."""
    still = plate(0.05, drift=0.5).replace(displacement=Displacement("prescribed", 0.0))
    assert (batch(plate(0.05, drift=0.5), 20.0, 1, [1.0]) == batch(still, 20.0, 1, [1.0])).all()


def test_no_feed() -> None:
    config = plate(0.1, **LAW)
    result = Screen(config).step(10.0, Feed(0.0, config.feed.mass_fraction))
    assert result.undersize.mass_flow_rate == 0.0
    assert result.hold_up == 0.0


def test_a_mixed_deck_against_scipy() -> None:
    """All of the law at once in a well mixed bed of five sizes."""
    u, v = 0.02, 0.2
    config = plate(u, **LAW)
    passes = SIZES < APERTURE
    share = SIZES[passes] / APERTURE
    guided = 1.0 - (1.0 - LAW["rim"]) * share
    free = np.zeros(SIZES.size)
    free[passes] = guided * (guided - LAW["drift"] * v / FALL * np.sqrt(share))
    room = np.maximum(SIZES / APERTURE, 0.5) ** 3
    fed = np.array(config.feed.mass_fraction) * 5.0 / v

    def change(_: float, load: np.ndarray) -> np.ndarray:
        depth = load.sum() / RHO
        cover = min(1.0, depth / CONTACT)
        lying = load / load.sum() * cover
        shaken = min(depth, APERTURE / LAW["levelling"])
        high = THROW * (1.0 + LAW["bouncing"] * (1.0 - cover) ** 2)
        held = math.sqrt((shaken + high) / (4.0 * APERTURE + THROW))
        busy = LAW["crowding"] * (free * lying / room).sum()
        return np.asarray(-RHO * u * OPEN_AREA * free * lying / (held * (1.0 + busy)))

    exact = solve_ivp(change, (0.0, 2.0 / v), fed, rtol=1e-10, atol=1e-12)
    recovery = 1.0 - exact.y[:, -1] / fed
    assert 0.1 < recovery[3] < recovery[0] < 0.999
    assert_allclose(Screen(config).solve_steady().recovery, recovery, atol=5 * TOLERANCE)


@pytest.mark.parametrize("factor", [0.25, 6.0])
def test_a_screen_at_another_scale(factor: float) -> None:
    """All lengths times a factor at the same g, velocities times its root: the same recovery."""
    root = math.sqrt(factor)

    def at(scale: float, root: float) -> ScreenConfig:
        return ScreenConfig(
            SizeClasses(tuple(scale * edge for edge in EDGES), 1),
            decks=(Deck(scale, (Panel(2.0 * scale, 0.0, scale * APERTURE, OPEN_AREA),)),),
            material=Material(RHO),
            motion=Motion.linear(0.003 * scale, 15.0 / root, math.radians(50.0)),
            displacement=Displacement("rigid_body"),
            passage=Passage("bounce", 0.03 * root, closure="vibration", **LAW),
            segregation=Segregation("exchange", 0.02 * root, 0.001 * scale, closure="vibration"),
            bed=Bed(CONTACT * scale),
            solver=Solver(TOLERANCE),
            feed=Feed(5.0 * scale**2 * root, (0.1, 0.2, 0.3, 0.2, 0.2)),
        )

    small, other = (Screen(at(*s)).solve_steady().recovery for s in ((1.0, 1.0), (factor, root)))
    assert 0.2 < small[2] < 0.98
    assert_allclose(other, small, atol=1e-8)


def test_what_a_user_may_get_wrong() -> None:
    with pytest.raises(ConfigError, match=r"passage.rim = 1.2 is out of range"):
        Passage("bounce", rim=1.2)
    with pytest.raises(ConfigError, match=r"passage.closure = 'throw' is unknown"):
        Passage("bounce", closure="throw")
