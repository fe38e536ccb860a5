"""Passage and percolation by the vibration: values by hand, signs, and where the best lies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.places import SCREENS
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.config import Harmonic
from vibroscreen.kernels.physics.closure import passage_factor, percolation_factor
from vibroscreen.sections import Bed, Deck, Displacement, Material, Panel, Passage, Segregation
from vibroscreen.size_classes import SizeClasses

GRAVITY = 9.81
APERTURE, CONTACT = 0.008, 0.01
EDGES = (0.0015, 0.0025, 0.0055, 0.0065, 0.0075, 0.0165)
LAWS = ("gaudin", "pelevin", "bounce")


def screen(law: str, motion: Motion, u: float, w: float, closure: str = "vibration") -> Screen:
    """A deck of 2 x 1 m at 0.2 m/s."""
    config = ScreenConfig(
        SizeClasses(EDGES, 1),
        decks=(Deck(1.0, (Panel(2.0, 0.0, APERTURE, 0.5),)),),
        material=Material(1600.0),
        motion=motion,
        displacement=Displacement("prescribed", 0.2),
        passage=Passage(law, u, closure=closure),
        segregation=Segregation("exchange", w, 0.003, closure=closure),
        bed=Bed(CONTACT),
        feed=Feed(5.0, (0.1, 0.2, 0.3, 0.2, 0.2)),
    )
    return Screen(config)


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


def factors(frequency: float, amplitude: float, normal: float) -> tuple[float, float]:
    """What the closures make of u and w on a level deck, from K, V and G."""
    speed = 2.0 * math.pi * frequency
    loose = max(0.0, 1.0 - 1.0 / (amplitude * speed**2 / GRAVITY) ** 2)
    high = (normal * speed) ** 2 / (2.0 * GRAVITY)
    throw = normal * speed**2 / GRAVITY
    of_u = loose**2 / math.sqrt(1.0 + high / (4.0 * APERTURE))
    return of_u / (1.0 + (throw / (2.0 * math.pi)) ** 4), loose * throw / 3.0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", MOTIONS)
def test_velocities_follow_from_the_vibration(law: str, name: str) -> None:
    """The closure is the same as giving u and w that were scaled by hand."""
    motion, amplitude, normal = MOTIONS[name]
    of_u, of_w = factors(motion.frequency, amplitude, normal)
    closed = screen(law, motion, 0.1, 0.05).solve_steady().recovery
    by_hand = screen(law, motion, 0.1 * of_u, 0.05 * of_w, "none").solve_steady().recovery
    assert 0.05 < closed[0] < 1.0
    assert_allclose(closed, by_hand, atol=1e-9)


def test_a_slope_turns_the_throw() -> None:
    """V and G are normal to the panel at hand: a later panel has its own throw angle."""
    motion = Motion.linear(0.005, 15.0, math.radians(30.0))
    decks = (
        Deck(
            1.0,
            (Panel(0.5, 0.0, APERTURE, 0.0), Panel(1.5, math.radians(30.0), APERTURE, 0.5)),
        ),
    )
    flat = screen("gaudin", motion, 0.1, 0.0).config.replace(decks=decks)
    speed = 2.0 * math.pi * 15.0
    velocity = 0.005 * speed * math.sin(math.radians(60.0))
    loose = (1.0 - (GRAVITY / (0.005 * speed**2)) ** 2) ** 2
    throw = velocity * speed / (GRAVITY * math.cos(math.radians(30.0)))
    factor = loose / math.sqrt(1.0 + velocity**2 / (8.0 * GRAVITY * APERTURE))
    factor /= 1.0 + (throw / (2.0 * math.pi)) ** 4
    by_hand = flat.replace(
        passage=Passage("gaudin", 0.1 * factor), segregation=Segregation("exchange", 0.0, 0.003)
    )
    assert_allclose(
        Screen(flat).solve_steady().recovery, Screen(by_hand).solve_steady().recovery, atol=1e-9
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("amplitude", [0.0, 0.001])
def test_weak_shaking_passes_nothing(law: str, amplitude: float) -> None:
    """Up to a peak acceleration of g the bed is not loose."""
    weak = screen(law, Motion.linear(amplitude, 15.0, 0.5 * math.pi), 0.5, 0.05)
    assert not weak.sieve_batch(20.0, weak.config.feed.mass_fraction, times=[5.0]).any()


def vertical(throw: float, frequency: float = 15.0) -> tuple[np.ndarray, float]:
    """Harmonics of a vertical motion of that throw number, and its frequency."""
    amplitude = throw * GRAVITY / (2.0 * math.pi * frequency) ** 2
    return Motion.linear(amplitude, frequency, 0.5 * math.pi).on_panel(), frequency


@pytest.mark.parametrize("aperture", [0.004, 0.016, 0.064])
@pytest.mark.parametrize("frequency", [12.0, 15.0, 20.0])
def test_passage_over_the_throw_number(aperture: float, frequency: float) -> None:
    """Rises to a throw number of about 3, falls beyond, and little is left at long flights."""
    throw = np.arange(1.05, 10.0, 0.05)
    u = np.array([passage_factor(*vertical(t, frequency), aperture, t) for t in throw])
    best = int(u.argmax())
    assert 2.7 <= throw[best] <= 3.6
    assert (np.diff(u[: best + 1]) > 0.0).all()
    assert (np.diff(u[best:]) < 0.0).all()
    assert u.max() < 1.0
    assert u[-1] < 0.2 * u.max()


def test_percolation_rises_with_the_throw() -> None:
    w = np.array([percolation_factor(*vertical(t), t) for t in np.arange(0.5, 8.0, 0.25)])
    assert (w[:3] == 0.0).all()
    assert (np.diff(w[2:]) > 0.0).all()


def test_percolation_makes_the_contact_layer_finer() -> None:
    """The contact layer of a deck without openings gets finer, the wider the stroke."""
    share = []
    for amplitude in (0.0013, 0.002, 0.003, 0.004):
        motion = Motion.linear(amplitude, 15.0, 0.5 * math.pi)
        profile = screen("bounce", motion, 0.0, 0.05).solve_steady().profile
        share.append(profile.load[16, 0, 0] / profile.load[16, 0].sum())
    assert (np.diff(share) > 0.0).all()


@pytest.mark.parametrize("varied", ["stroke", "frequency"])
def test_the_best_throw_number_of_a_deck(varied: str) -> None:
    """The calibrated plate at a given velocity of its bed recovers most at a throw of 3 to 3.5."""
    plate = ScreenConfig.load(SCREENS / "dem_plate.toml").replace(
        displacement=Displacement("prescribed", 0.2)
    )
    panel = plate.decks[0].panels[0]
    plate = plate.with_values({"deck[1].panel[1].velocity_factor": 1.0})
    assert panel.inclination == 0.0
    fraction = np.array(plate.feed.mass_fraction)
    below = plate.size_classes.mean < panel.aperture
    throws, found = np.arange(1.0, 6.01, 0.25), []
    for throw in throws:
        normal = throw * GRAVITY * math.sqrt(2.0) / (2.0 * math.pi) ** 2  # m/s2 over 4 pi^2
        amplitude, frequency = (
            (normal / 15.0**2, 15.0) if varied == "stroke" else (0.004, math.sqrt(normal / 0.004))
        )
        motion = Motion.linear(amplitude, frequency, math.radians(45.0))
        recovery = Screen(plate.replace(motion=motion)).solve_steady().recovery
        found.append(float(recovery[below] @ fraction[below] / fraction[below].sum()))
    assert 3.0 <= throws[int(np.argmax(found))] <= 3.5
    assert found[0] < 0.5 * max(found)
    assert found[-1] < 0.75 * max(found)
