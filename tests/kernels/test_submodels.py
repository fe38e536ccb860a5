"""A user's own sub-model is one function, registered by name; nothing else changes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numba import njit

from tests.fixed import fixed_screen, fixed_segregation
from vibroscreen import ConfigError, Feed, Screen, ScreenConfig, register, registry
from vibroscreen.kernels.physics.packing import gap_open_area, gap_radius
from vibroscreen.sections import Deck, Displacement, Panel, Passage, Segregation

LEVEL = Deck(panels=(Panel(inclination=0.0),))  # a law of one's own need not project openings
DEFAULT = fixed_screen().replace(decks=(LEVEL,))
PRESCRIBED = Displacement("prescribed", 0.3)


def variant(**changes: object) -> ScreenConfig:
    return dataclasses.replace(DEFAULT, **changes)


def recovery_of(**changes: object) -> np.ndarray:
    return Screen(variant(**changes)).solve_steady().recovery


# --- passage -----------------------------------------------------------------------------------
@njit
def gaudin_again(size, fraction, scene, probability):
    for i in range(size.size):
        free = max(0.0, 1.0 - size[i] / scene.aperture)
        probability[i] = scene.open_area * free * free


def linear_law(size, fraction, scene, probability):
    """A plain function: it is compiled when it is registered."""
    for i in range(size.size):
        free = max(0.0, 1.0 - size[i] / scene.aperture)
        probability[i] = scene.open_area * free


@njit
def all_of_the_deck(size, fraction, scene, probability):
    for i in range(size.size):
        probability[i] = scene.open_area if size[i] < scene.aperture else 0.0


def test_own_passage_law() -> None:
    register("passage", "test_gaudin", gaudin_again)
    own = recovery_of(passage=Passage("test_gaudin"))
    assert own == pytest.approx(recovery_of(passage=Passage("gaudin")), rel=1e-14)


def test_own_passage_law_as_a_plain_function() -> None:
    register("passage", "test_linear", linear_law)
    own = recovery_of(passage=Passage("test_linear"))
    gaudin = recovery_of(passage=Passage("gaudin"))
    assert (own[:7] > gaudin[:7]).all()
    assert not own[7:].any()


def test_own_passage_law_dynamic_and_exact() -> None:
    """P = phi for all undersize: one exponential, in steps as in the steady state.

    Well mixed, thinner than the contact layer: recovery 1 - exp(-u phi t/h_c).
    """
    register("passage", "test_open", all_of_the_deck)
    config = variant(
        passage=Passage("test_open", velocity=0.01),
        displacement=PRESCRIBED,
        feed=Feed(5.0, DEFAULT.feed.mass_fraction),
        segregation=Segregation("well_mixed"),
    )
    expected = -np.expm1(-0.01 * 0.55 * 20.0 / 0.02)
    screen = Screen(config)
    assert screen.solve_steady().recovery[:7] == pytest.approx(np.full(7, expected), abs=1e-4)
    screen.step(25.0)
    result = screen.step(1.0)
    rates = result.undersize.class_rates[:7] / config.feed.class_rates[:7]
    assert rates == pytest.approx(np.full(7, expected), abs=1e-4)


def test_registering_again_replaces_the_law() -> None:
    register("passage", "test_again", gaudin_again)
    old = Screen(variant(passage=Passage("test_again")))
    number = registry.model("passage", "test_again").number
    register("passage", "test_again", linear_law)
    assert registry.model("passage", "test_again").number == number
    register("passage", "test_linear_too", linear_law)
    new = recovery_of(passage=Passage("test_again"))
    assert new == pytest.approx(recovery_of(passage=Passage("test_linear_too")), rel=1e-14)
    # a screen that exists keeps the law it was built with
    assert old.solve_steady().recovery == pytest.approx(
        recovery_of(passage=Passage("gaudin")), rel=1e-14
    )


# --- segregation -------------------------------------------------------------------------------
@njit
def exchange_again(size, load, layers, scene, contact, percolation):
    """The built-in `exchange`, written another way."""
    mass = np.zeros(layers)
    for j in range(layers):
        mass[j] = load[j].sum()
    for i in range(size.size):
        contact[i] = 1.0 / mass[0] if mass[0] > 0.0 else 0.0
    for j in range(1, layers):
        full_below = scene.contact_load if j == 1 else scene.layer_full
        fill = min(1.0, mass[j] / scene.layer_full, mass[j - 1] / full_below)
        radius = 0.5 * (load[j] * size).sum() / mass[j] if mass[j] > 0.0 else 0.0
        opening = 2.0 * gap_radius(radius, scene.dilation)
        phi = gap_open_area(radius, scene.dilation)
        flux = scene.density * scene.segregation_velocity * phi * fill
        for i in range(size.size):
            small = size[i] < opening and mass[j] > 0.0
            free = 1.0 - size[i] / opening if small else 0.0
            percolation[j, i] = flux * free**2 / mass[j] if small else 0.0


@njit
def coarse_first(size, load, layers, scene, contact, percolation):
    """The worst bed: the coarsest grains lie on the screen."""
    mass = 0.0
    for i in range(size.size):
        mass += load[0, i]
    held = min(mass, scene.contact_load)
    left = held
    for i in range(size.size - 1, -1, -1):
        taken = min(load[0, i], left)
        contact[i] = taken / (load[0, i] * held) if taken > 0.0 else 0.0
        left -= taken


def test_own_layered_segregation() -> None:
    register("segregation", "test_exchange", exchange_again, layered=True)
    # the engine would choose other nodes for a model that it does not know
    nodes = dataclasses.replace(DEFAULT.size_classes, subdivision=3)
    own = recovery_of(segregation=fixed_segregation("test_exchange"), size_classes=nodes)
    built_in = recovery_of(segregation=fixed_segregation("exchange"), size_classes=nodes)
    assert own == pytest.approx(built_in, abs=1e-9)
    screen = Screen(variant(segregation=Segregation("test_exchange")))
    assert screen.solve_steady().profile.load.shape[1] > 1


def test_own_segregation_without_layers() -> None:
    register("segregation", "test_coarse_first", coarse_first)
    config = variant(segregation=Segregation("test_coarse_first"), displacement=PRESCRIBED)
    screen = Screen(config)
    steady = screen.solve_steady()
    assert steady.profile.load.shape[1] == 1
    mixed = recovery_of(segregation=Segregation("well_mixed"), displacement=PRESCRIBED)
    assert (steady.recovery[:7] < mixed[:7]).all()
    for _ in range(6):
        result = screen.step(5.0)
    assert result.undersize.class_rates == pytest.approx(
        steady.undersize.class_rates, abs=1e-4 * 83.0
    )
    assert (screen.balance().error.abs() <= 1e-12 * screen.balance().fed).all()


# --- displacement ------------------------------------------------------------------------------
@njit
def prescribed_again(harmonic, drive, result, work):
    """drive: frequency, inclination, friction, prescribed velocity; result[0]: velocity, m/s."""
    for k in range(result.size):
        result[k] = 0.0
    result[0] = drive[3]


@njit
def with_the_frequency(harmonic, drive, result, work):
    for k in range(result.size):
        result[k] = 0.0
    result[0] = 0.02 * drive[0]


def test_own_displacement() -> None:
    register("displacement", "test_prescribed", prescribed_again)
    own = recovery_of(displacement=Displacement("test_prescribed", 0.3))
    assert own == pytest.approx(recovery_of(displacement=PRESCRIBED), rel=1e-14)


def test_the_throw_number_is_that_of_the_motion_whatever_a_model_writes() -> None:
    """Percolation follows it: `prescribed_again` writes 0."""
    register("displacement", "test_prescribed", prescribed_again)
    usual = ScreenConfig.default()
    own, built_in = (
        Screen(usual.replace(displacement=Displacement(name, 0.3))).solve_steady()
        for name in ("test_prescribed", "prescribed")
    )
    assert own.recovery == pytest.approx(built_in.recovery, rel=1e-14)
    assert own.decks[0].throw_number == pytest.approx(
        0.005 * (2.0 * np.pi * 15.5) ** 2 * np.sin(0.25 * np.pi) / (9.81 * np.cos(np.pi / 36.0))
    )


def test_own_displacement_follows_the_motion() -> None:
    register("displacement", "test_frequency", with_the_frequency)
    screen = Screen(variant(displacement=Displacement("test_frequency")))
    assert screen.step(1.0).transport_velocity == pytest.approx(0.31, rel=1e-14)
    faster = dataclasses.replace(DEFAULT.motion, frequency=20.0)
    assert screen.step(1.0, motion=faster).transport_velocity == pytest.approx(0.4, rel=1e-14)
    assert screen.solve_steady(motion=faster).residence_time == pytest.approx(15.0, rel=1e-14)


def test_all_three_together_close() -> None:
    register("passage", "test_linear", linear_law)
    register("segregation", "test_coarse_first", coarse_first)
    register("displacement", "test_frequency", with_the_frequency)
    screen = Screen(
        variant(
            passage=Passage("test_linear"),
            segregation=Segregation("test_coarse_first"),
            displacement=Displacement("test_frequency"),
        )
    )
    for rate in (80.0, 20.0, 0.0):
        screen.step(11.0, Feed(rate, DEFAULT.feed.mass_fraction))
    balance = screen.balance()
    assert (balance.error.abs() <= 1e-12 * balance.fed).all()
    assert balance.oversize.sum() > 0.0


# --- refusals ----------------------------------------------------------------------------------
def test_refusals_by_text() -> None:
    with pytest.raises(ValueError, match="family = 'pasage' is unknown: give one of displacement"):
        register("pasage", "mine", gaudin_again)
    with pytest.raises(ValueError, match="'gaudin' is a built-in passage model: choose another"):
        register("passage", "gaudin", gaudin_again)
    assert "gaudin" in registry.names("passage")
    with pytest.raises(ConfigError, match=r"passage\.law"):
        Passage("nobody_registered_this")
    with pytest.raises(ConfigError, match=r"segregation\.model"):
        Segregation("nobody_registered_this")
