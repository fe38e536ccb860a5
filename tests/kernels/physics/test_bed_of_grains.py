"""The displacement model bed: limits, symmetries, small steps, particle simulations (DEM)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bed_velocity
from vibroscreen import Screen, ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.kernels.physics import bed_of_grains
from vibroscreen.motion import ConveyingRegime, Motion, conveying_regime, transport_velocity
from vibroscreen.sections import Deck, Displacement, Material, Panel
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, GRAVITY

LINEAR = Motion.linear(0.003, 15.0, 45.0 * DEG)
WITH_FLOW = Motion.circular(0.004, 14.0, "with_flow")
AGAINST_FLOW = Motion.circular(0.004, 14.0, "against_flow")
ELLIPTICAL = Motion.elliptical(0.004, 14.0, 50.0 * DEG, 0.4)
MOTIONS = {
    "linear": LINEAR,
    "with flow": WITH_FLOW,
    "against flow": AGAINST_FLOW,
    "elliptical": ELLIPTICAL,
}
RIGID = (1e-3, 2.0, 1e9, 0.0)  # lands at once, and only the base slips


def velocity(motion: Motion, inclination: float = 0.0, friction: float = 0.5) -> float:
    return transport_velocity(motion, inclination, friction, "bed")


# --- limits and symmetries -----------------------------------------------------------------------


def test_no_vibration_is_no_transport() -> None:
    for motion in (Motion.linear(0.0, 15.0, 0.7), Motion.linear(0.003, 0.0, 0.7)):
        regime = conveying_regime(motion, 0.6, 0.5, "bed")
        assert dataclasses.astuple(regime) == (0.0,) * 6


def test_vertical_vibration_of_a_level_deck_does_not_convey() -> None:
    for amplitude in (0.001, 0.003, 0.006):
        assert abs(velocity(Motion.linear(amplitude, 15.0, 0.5 * math.pi))) < 1e-12


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("inclination", [0.0, 0.2, 0.6])
def test_mirrored_deck_conveys_the_other_way(name: str, inclination: float) -> None:
    motion = MOTIONS[name]
    mirrored = Motion.elliptical(
        motion.amplitude, motion.frequency, math.pi - motion.throw_angle, -motion.ellipticity
    )
    ahead, back = velocity(motion, inclination), velocity(mirrored, -inclination)
    assert back == pytest.approx(-ahead, rel=1e-6)


@pytest.mark.parametrize(
    ("motion", "inclination", "friction"),
    [
        (Motion.linear(0.0012, 15.0, 30.0 * DEG), 0.0, 0.3),
        (LINEAR, 0.0, 0.5),
        (LINEAR, 0.15, 0.5),
        (Motion.linear(0.004, 14.0, 45.0 * DEG), -0.05, 0.4),
        (Motion.elliptical(0.003, 15.0, 60.0 * DEG, 0.5), 0.1, 0.6),
        (Motion.circular(0.0025, 14.0, "with_flow"), 0.2, 0.5),
    ],
)
def test_bed_that_lands_at_once_is_the_rigid_body(
    motion: Motion, inclination: float, friction: float
) -> None:
    soft = conveying_regime(motion, inclination, friction, "bed", RIGID)
    rigid = conveying_regime(motion, inclination, friction)
    assert soft.velocity == pytest.approx(rigid.velocity, rel=0.04, abs=0.003)
    assert soft.flight_fraction == pytest.approx(rigid.flight_fraction, abs=0.02)
    assert soft.flights_per_period == rigid.flights_per_period
    assert soft.dissipation == pytest.approx(rigid.dissipation, rel=0.06)
    assert soft.throw_number == rigid.throw_number


# --- the same equations in small steps -----------------------------------------------------------


def small_steps(motion: Motion, inclination: float, friction: float, rolling: float = 0.0) -> float:
    """Mean velocity in SI by explicit steps of 1/4000 period, from rest, over periods 41 to 60."""
    softness, damping, grains, drag = bed_of_grains.BED_CONSTANTS
    omega = 2.0 * math.pi * motion.frequency
    weight = GRAVITY * math.cos(inclination)
    pull = GRAVITY * math.sin(inclination)
    _, along_cos, along_sin, normal_cos, normal_sin = motion.on_panel()[0]
    throw = math.hypot(normal_cos, normal_sin) * omega**2 / weight
    landing = softness * math.sqrt(throw - 1.0) / omega
    grip = 1.0 / math.hypot(1.0 / friction, 1.0 / grains)
    steps = 4000
    step = 1.0 / (motion.frequency * steps)
    height = rise = slip = travel = 0.0
    for k in range(60 * steps):
        sine, cosine = math.sin(omega * (k + 0.5) * step), math.cos(omega * (k + 0.5) * step)
        along = -(omega**2) * (along_cos * cosine + along_sin * sine)
        normal = -(omega**2) * (normal_cos * cosine + normal_sin * sine)
        force = -2.0 * damping * rise / landing - height / landing**2 if height < 0.0 else 0.0
        force = max(0.0, force)
        resistance = 0.0
        if force > 0.0 and slip != 0.0:
            soft = (1.0 - rolling) * damping / landing * abs(slip)
            limit = force * (grip + drag * abs(slip))
            resistance = math.copysign(soft * limit / math.hypot(soft, limit), slip)
        rise += step * (force - weight - normal)
        height += step * rise
        slip += step * (pull - along - resistance)
        if k >= 40 * steps:
            travel += step * slip
    return travel * motion.frequency / 20.0


@pytest.mark.parametrize("name", MOTIONS)
def test_small_steps_give_the_same_velocity(name: str) -> None:
    expected = small_steps(MOTIONS[name], 10.0 * DEG, 0.5)
    assert velocity(MOTIONS[name], 10.0 * DEG) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("rolling", [0.2, 0.6])
@pytest.mark.parametrize("name", MOTIONS)
def test_rolling_in_small_steps(name: str, rolling: float) -> None:
    expected = small_steps(MOTIONS[name], 10.0 * DEG, 0.5, rolling)
    regime = conveying_regime(MOTIONS[name], 10.0 * DEG, 0.5, "bed", rolling=rolling)
    assert regime.velocity == pytest.approx(expected, rel=0.03)
    assert regime.velocity > velocity(MOTIONS[name], 10.0 * DEG)


def test_rolling_is_refused_where_nothing_would_grip() -> None:
    with pytest.raises(InputError, match=r"rolling = 1 is out of range \(0 to 0.95\)"):
        conveying_regime(MOTIONS["linear"], 0.0, 0.5, "bed", rolling=1.0)


def test_a_screen_rolls_as_its_material_says() -> None:
    """On the deck as in `conveying_regime`, also when it is changed while the screen runs."""
    motion = Motion.linear(0.004, 15.0, 45.0 * DEG)
    config = ScreenConfig(
        SizeClasses((0.0, 0.004, 0.012)),
        decks=(Deck(1.0, (Panel(2.0, 10.0 * DEG, 0.008, 0.5),)),),
        material=Material(friction_deck=0.5, friction_internal=0.5, rolling=0.35),
        motion=motion,
        displacement=Displacement("bed"),
    )
    for value in (0.35, 0.1):
        rolling = config.with_values({"material.rolling": value})
        regime = conveying_regime(motion, 10.0 * DEG, 0.5, "bed", rolling=value)
        assert Screen(rolling).solve_steady().transport_velocity == regime.velocity


# --- what rises with what ------------------------------------------------------------------------


@pytest.mark.parametrize("throw_angle", [30.0, 45.0, 60.0])
@pytest.mark.parametrize("inclination", [0.0, 10.0])
def test_velocity_rises_with_the_amplitude(throw_angle: float, inclination: float) -> None:
    amplitudes = np.linspace(0.0005, 0.0055, 60)
    got = [
        velocity(Motion.linear(amplitude, 15.0, throw_angle * DEG), inclination * DEG)
        for amplitude in amplitudes
    ]
    assert np.all(np.diff(got) > 0.0)


@pytest.mark.parametrize("name", MOTIONS)
def test_velocity_rises_smoothly_with_the_inclination(name: str) -> None:
    inclinations = np.linspace(-5.0, 40.0, 91) * DEG
    got = np.array([velocity(MOTIONS[name], inclination) for inclination in inclinations])
    steps = np.diff(got)
    assert np.all(steps > 0.0)
    assert np.all(steps[1:] < 1.5 * steps[:-1] + 0.005)
    assert got[-1] < 10.0


@pytest.mark.parametrize("friction", [0.3, 0.5, 0.8])
def test_velocity_has_no_jumps_in_the_amplitude(friction: float) -> None:
    amplitudes = np.linspace(0.001, 0.0055, 151)
    for sense in ("with_flow", "against_flow"):
        got = [
            velocity(Motion.circular(amplitude, 14.0, sense), 15.0 * DEG, friction)
            for amplitude in amplitudes
        ]
        assert np.abs(np.diff(got)).max() < 0.02


@settings(deadline=None, max_examples=300)
@given(
    amplitude=st.floats(1e-5, 0.02),
    frequency=st.floats(2.0, 40.0),
    throw_angle=st.floats(-3.0, 3.0),
    ellipticity=st.floats(-1.0, 1.0),
    inclination=st.floats(-1.2, 1.2),
    friction=st.floats(0.0, 2.0),
)
def test_every_motion_has_a_bounded_answer(
    amplitude: float,
    frequency: float,
    throw_angle: float,
    ellipticity: float,
    inclination: float,
    friction: float,
) -> None:
    motion = Motion.elliptical(amplitude, frequency, throw_angle, ellipticity)
    regime = conveying_regime(motion, inclination, friction, "bed")
    assert all(math.isfinite(value) for value in dataclasses.astuple(regime))
    assert regime.dissipation >= -1e-12
    # friction grows with the speed until it carries the slope
    drag = bed_of_grains.BED_CONSTANTS[3]
    bound = abs(math.tan(inclination)) / drag + 20.0 * amplitude * 2.0 * math.pi * frequency
    assert abs(regime.velocity) < 10.0 * (bound + 1.0)


# --- particle simulations -------------------------------------------------------------------------


def test_cases_that_it_was_fitted_to_and_each_left_out() -> None:
    frame, fitted = bed_velocity.compare()
    assert fitted == pytest.approx(bed_of_grains.BED_CONSTANTS, rel=0.01)
    linear = frame.motion == "linear"
    assert len(frame) == 10
    assert linear.sum() == 6
    errors = abs(frame[["bed", "left out", "rigid body"]].div(frame.v, axis=0) - 1.0)
    assert errors.bed[linear].max() < 0.10
    assert errors.bed[~linear].max() < 0.20
    assert errors["left out"][linear].max() < 0.13
    assert errors["left out"][~linear].max() < 0.20
    assert errors["rigid body"][~linear].min() > 0.35


def test_simulations_that_were_not_fitted() -> None:
    own = bed_velocity.held_out()
    assert len(own) > 150
    fast = own[own.v > 0.1]
    linear = fast.ellipticity == 0.0
    errors = abs(fast.bed / fast.v - 1.0)
    assert errors[linear].median() < 0.05
    assert errors[~linear].median() < 0.12
    assert (errors[linear] < 0.2).mean() > 0.85
    assert (errors[~linear] < 0.3).mean() > 0.85
    assert abs(own.bed - own.v)[own.v <= 0.1].max() < 0.09
    rigid = abs(fast["rigid body"] / fast.v - 1.0)
    assert errors[~linear].median() < 0.4 * rigid[~linear].median()


# --- on a screen ---------------------------------------------------------------------------------


def screen(inclination: float, motion: Motion, friction: float = 0.5) -> Screen:
    base = ScreenConfig.default()
    return Screen(
        dataclasses.replace(
            base,
            decks=(Deck(2.4, (Panel(inclination=inclination),)),),
            displacement=Displacement("bed"),
            material=Material(friction_deck=friction),
            motion=motion,
        )
    )


def test_screen_moves_its_bed_at_the_velocity_of_the_model() -> None:
    one = screen(18.0 * DEG, AGAINST_FLOW)
    one.step(20.0)
    regime: ConveyingRegime = conveying_regime(AGAINST_FLOW, 18.0 * DEG, 0.5, "bed")
    output = one.record("output")
    assert one.record("deck_result")[0].transport_velocity == regime.velocity > 0.3
    assert output.drive_power > 0.0
    assert output.alarm_transport == 0.0


def test_steep_deck_conveys_with_an_alarm() -> None:
    with pytest.warns(UserWarning, match="take its velocity as a guess"):
        one = screen(20.0 * DEG, AGAINST_FLOW, friction=0.3)
    one.step(5.0)
    assert 0.5 < one.record("deck_result")[0].transport_velocity < 3.0
    assert one.record("output").alarm_transport == 1.0


def test_deck_that_conveys_uphill_stops_its_bed() -> None:
    one = screen(0.0, AGAINST_FLOW)
    one.step(5.0)
    assert velocity(AGAINST_FLOW) < 0.0
    assert one.record("deck_result")[0].transport_velocity == 0.0
    assert one.record("output").alarm_transport == 1.0


def test_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="model = 'sand' is unknown: give one of rigid_body, bed"):
        conveying_regime(LINEAR, 0.0, 0.5, "sand")
