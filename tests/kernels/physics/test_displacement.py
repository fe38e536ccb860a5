"""Rigid body on a vibrating plane: exact solutions, reference cases, small-step integration.

Exact: Blekhman, Vibrational Mechanics (World Scientific, 2000); flight fraction and velocity at
infinite friction as for vibratory conveyors. Reference cases: tests/data/README.md.
"""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import vibroscreen
from tests.places import DATA
from vibroscreen import units
from vibroscreen.errors import InputError
from vibroscreen.kernels.physics import prescribed, rigid_body
from vibroscreen.kernels.physics.motion import EDGE, EDGES, GRAVITY, MAX_ORDER, WORK_SIZE
from vibroscreen.motion import (
    MAX_AMPLITUDE,
    ConveyingRegime,
    Harmonic,
    Motion,
    conveying_regime,
    transport_velocity,
)

CASES = DATA / "conveying_reference_cases.csv"
ELLIPTICITY = {"linear": 0.0, "circular+1": -1.0, "circular-1": 1.0}
SLOWEST = 0.05  # m/s, below which errors count against this velocity
PLATEAU = (math.sqrt(1.0 + math.pi**2), math.sqrt(4.0 + math.pi**2))

many = settings(
    deadline=None, database=None, max_examples=150, suppress_health_check=[HealthCheck.too_slow]
)


def of_throw_number(
    throw: float,
    frequency: float = 15.0,
    throw_angle: float = 0.7,
    ellipticity: float = 0.0,
    inclination: float = 0.0,
) -> Motion:
    """Motion of the given throw number on a deck of that inclination."""
    reach = math.hypot(math.sin(throw_angle), ellipticity * math.cos(throw_angle))
    pull = throw * units.GRAVITY * math.cos(inclination) / reach
    amplitude = pull / (2.0 * math.pi * frequency) ** 2
    return Motion.elliptical(amplitude, frequency, throw_angle, ellipticity)


def reference_cases() -> list[dict[str, str]]:
    with CASES.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def solved(kernel: Callable[..., None], motion: Motion, drive: list[float]) -> np.ndarray:
    result = np.full(7, np.nan)
    work = np.full(WORK_SIZE, np.nan)
    values = np.array([motion.frequency, *drive, 0.0])
    kernel(motion.on_panel(), values, result, work)
    return result


# --- published conventions and reference cases ---------------------------------------------------


@pytest.mark.parametrize("case", reference_cases(), ids=lambda case: f"Gamma {case['Gamma']}")
def test_reference_case(case: dict[str, str]) -> None:
    inclination = float(case["deck_angle_deg_down_positive"]) * units.DEG
    motion = Motion.elliptical(
        float(case["amplitude_mm"]) * units.MM,
        float(case["freq_Hz"]),
        float(case["throw_angle_deg"]) * units.DEG,
        ELLIPTICITY[case["motion"]],
    )
    regime = conveying_regime(motion, inclination, float(case["mu"]))
    expected = float(case["mean_velocity_m_s"])
    assert abs(regime.velocity - expected) < 1e-4 * max(abs(expected), SLOWEST)
    assert regime.flight_fraction == pytest.approx(float(case["flight_fraction"]), abs=2e-6)
    assert regime.flights_per_period == float(case["flights_per_period"])
    assert regime.throw_number == pytest.approx(float(case["Gamma"]), rel=5e-6)
    assert regime.spread == 0.0


def test_circular_motion_is_named_by_the_sense_at_the_top_of_the_orbit() -> None:
    for sense, ellipticity in (("with_flow", 1.0), ("against_flow", -1.0)):
        motion = Motion.circular(0.004, 14.0, sense)
        assert motion.ellipticity == ellipticity
        rows = motion.on_panel()
        phase = math.pi / 2.0  # eta = A sin(wt) is largest
        along_rate = rows[0, 2] * math.cos(phase) - rows[0, 1] * math.sin(phase)
        assert rows[0, 4] == pytest.approx(0.004)
        assert along_rate == pytest.approx(ellipticity * 0.004)


def test_gravity_is_the_same_in_kernels_and_units() -> None:
    assert GRAVITY == units.GRAVITY


# --- exact solutions -----------------------------------------------------------------------------


def throw_number_of_flight_fraction(fraction: float) -> float:
    turn = 2.0 * math.pi * fraction
    ratio = (math.cos(turn) + 0.5 * turn**2 - 1.0) / (turn - math.sin(turn))
    return math.hypot(1.0, ratio)


@pytest.mark.parametrize("fraction", [0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
@pytest.mark.parametrize("friction", [0.2, 1.0])
def test_flight_fraction_follows_from_the_throw_number(fraction: float, friction: float) -> None:
    throw = throw_number_of_flight_fraction(fraction)
    motion = of_throw_number(throw, inclination=0.1)
    regime = conveying_regime(motion, 0.1, friction)
    assert regime.throw_number == pytest.approx(throw, rel=1e-14)
    assert regime.flight_fraction == pytest.approx(fraction, abs=1e-9)
    assert regime.flights_per_period == 1.0


@pytest.mark.parametrize("throw", [1.0 + 1e-9, 1.001, 1.5, 3.0, 5.0])
def test_take_off_phase(throw: float) -> None:
    motion = of_throw_number(throw)
    result = np.zeros(7)
    work = np.zeros(WORK_SIZE)
    drive = np.array([motion.frequency, 0.0, 0.5, 0.0])
    rigid_body.rigid_body(motion.on_panel(), drive, result, work)
    count = int(work[EDGES])
    phases = work[EDGE:][: 8 * count : 8]
    assert np.all(np.diff(phases) >= 0.0)
    take_off = math.asin(1.0 / throw)
    # sin is flat at the top: a rounding error there moves the phase by its square root
    close = 1e-15 / math.cos(take_off) + 1e-14
    assert np.min(np.abs(phases - take_off)) < close
    assert np.min(np.abs(phases - (math.pi - take_off))) < close


@pytest.mark.parametrize("fraction", [0.05, 0.4, 0.8, 0.99, 1.0])
@pytest.mark.parametrize(("throw_angle", "inclination"), [(0.5, 0.0), (0.9, 0.2), (1.3, -0.1)])
def test_velocity_at_infinite_friction(
    fraction: float, throw_angle: float, inclination: float
) -> None:
    throw = throw_number_of_flight_fraction(fraction) if fraction < 1.0 else sum(PLATEAU) / 2.0
    motion = of_throw_number(
        throw, frequency=13.0, throw_angle=throw_angle, inclination=inclination
    )
    fall = units.GRAVITY * fraction**2 / (2.0 * motion.frequency)
    exact = fall * (math.cos(inclination) / math.tan(throw_angle) + math.sin(inclination))
    regime = solved(rigid_body.rigid_body, motion, [inclination, 1e7, 0.0])
    assert regime[0] == pytest.approx(exact, rel=1e-5)


@given(
    position=st.floats(0.002, 0.99),
    throw_angle=st.floats(0.2, 1.5),
    ellipticity=st.floats(-1.0, 1.0),
    inclination=st.floats(-0.2, 0.3),
)
@many
def test_plateau_of_one_flight_a_period(
    position: float, throw_angle: float, ellipticity: float, inclination: float
) -> None:
    """The body falls by g/f in each period and loses just that in the impact: g2/(2 f) W/kg."""
    throw = PLATEAU[0] + position * (PLATEAU[1] - PLATEAU[0])
    motion = of_throw_number(throw, 14.0, throw_angle, ellipticity, inclination)
    regime = conveying_regime(motion, inclination, 0.5)
    assert regime.flight_fraction == pytest.approx(1.0, abs=1e-12)
    assert regime.flights_per_period == 1.0
    assert regime.spread == pytest.approx(0.0, abs=1e-12)  # round-off of blocks
    assert regime.dissipation == pytest.approx(units.GRAVITY**2 / (2.0 * 14.0), rel=1e-9)


def test_plateau_ends() -> None:
    below, above = PLATEAU[0] - 1e-3, PLATEAU[1] + 1e-2
    assert conveying_regime(of_throw_number(below), 0.0, 0.5).flight_fraction < 1.0
    doubled = conveying_regime(of_throw_number(above), 0.0, 0.5)
    assert doubled.flights_per_period == pytest.approx(1.0)
    single = conveying_regime(of_throw_number(PLATEAU[1] - 1e-6), 0.0, 0.5)
    assert doubled.velocity == pytest.approx(single.velocity, rel=0.02)


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.9])
def test_fast_shaking_along_the_deck_turns_dry_friction_viscous(ratio: float) -> None:
    """tan(alpha)/mu = (2/pi) asin(v/(A w)): the time shares of slip forward and back balance."""
    motion = Motion.linear(0.1, 100.0, 0.0)
    friction = 0.4
    regime = conveying_regime(motion, math.atan(ratio * friction), friction)
    fastest = motion.amplitude * 2.0 * math.pi * motion.frequency
    assert regime.velocity == pytest.approx(fastest * math.sin(0.5 * math.pi * ratio), rel=1e-5)
    assert regime.flight_fraction == 0.0


def test_weak_vibration_leaves_the_body_stuck() -> None:
    regime = conveying_regime(Motion.linear(0.001, 8.0, 0.6), 0.1, 0.5)
    assert regime.throw_number > 0.0
    assert regime.velocity == regime.dissipation == regime.flights_per_period == 0.0


@pytest.mark.parametrize(
    "motion",
    [
        Motion.linear(0.0, 15.0, 0.7),
        Motion.linear(0.005, 0.0, 0.7),
        Motion.harmonics(15.0, [Harmonic(1)]),
    ],
)
@pytest.mark.parametrize("inclination", [0.0, 0.1, 1.2])
def test_no_vibration_gives_nothing(motion: Motion, inclination: float) -> None:
    assert motion.at_rest
    assert conveying_regime(motion, inclination, 0.5) == ConveyingRegime(0, 0, 0, 0, 0, 0)


# --- independent integration in small steps ------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """A vibrating plane: inclination in rad, friction as a ratio."""

    motion: Motion
    inclination: float
    friction: float


def two_harmonics(amplitude: float, share: float, throw_angle: float = 0.7) -> Motion:
    """Linear motion whose second harmonic, turned and late, makes up a share of the first."""
    parts = [
        Harmonic(
            1,
            amplitude * math.cos(throw_angle),
            -0.5 * math.pi,
            amplitude * math.sin(throw_angle),
            -0.5 * math.pi,
        ),
        Harmonic(2, share * amplitude, 0.4, -share * amplitude, 1.3),
    ]
    return Motion.harmonics(16.0, parts)


SCENES = [
    Scene(Motion.linear(0.0015, 16.0, 0.52), 0.0, 0.3),  # slip without throw
    Scene(Motion.linear(0.003, 12.5, 0.35), 0.17, 0.4),
    Scene(Motion.elliptical(0.002, 14.0, 0.8, -0.4), 0.05, 0.25),
    Scene(Motion.linear(0.003, 16.0, 0.52), 0.0, 0.5),  # throw, slip and stick
    Scene(Motion.linear(0.003, 15.0, 0.6), -0.08, 0.4),
    Scene(Motion.elliptical(0.004, 14.0, 0.9, 0.5), 0.12, 0.6),
    Scene(Motion.linear(0.004, 16.0, 0.785), 0.087, 0.5),
    Scene(Motion.circular(0.004, 14.0, "with_flow"), 0.3, 0.5),  # one flight a period
    Scene(Motion.circular(0.004, 14.0, "against_flow"), 0.3, 0.5),
    Scene(two_harmonics(0.0012, 0.2), 0.05, 0.3),
    Scene(two_harmonics(0.003, 0.1), 0.0, 0.5),
    Scene(two_harmonics(0.003, 0.25), 0.1, 0.4),
    Scene(two_harmonics(0.002, -0.3), 0.2, 0.5),
]


def integrate(
    scenes: list[Scene], settle: int = 12, mean: int = 4, steps: int = 4000
) -> dict[str, np.ndarray]:
    """Velocity, flight fraction, dissipation and power of the deck by small-step integration.

    In each step gravity acts first; where the body would be inside the deck, an impulse brings it
    to the deck's normal velocity and friction, limited by that impulse, towards the tangential one.
    Shares nothing with the kernels: no events, no regimes, no closed forms. The error falls in
    proportion to the step. [scene], SI units.
    """
    inclination = np.array([scene.inclination for scene in scenes])
    friction = np.array([scene.friction for scene in scenes])
    step = np.array([1.0 / scene.motion.frequency / steps for scene in scenes])
    place, along, normal = (np.zeros((steps, len(scenes))) for _ in range(3))
    phase = 2.0 * np.pi * np.arange(1, steps + 1) / steps
    for k, scene in enumerate(scenes):
        speed = 2.0 * np.pi * scene.motion.frequency
        m = scene.motion
        minor = m.ellipticity * m.amplitude
        throw_sin, throw_cos = np.sin(m.throw_angle), np.cos(m.throw_angle)
        place[:, k] = m.amplitude * throw_sin * np.sin(phase) + minor * throw_cos * np.cos(phase)
        along[:, k] = m.amplitude * throw_cos * np.cos(phase) + minor * throw_sin * np.sin(phase)
        normal[:, k] = m.amplitude * throw_sin * np.cos(phase) - minor * throw_cos * np.sin(phase)
        for part in m.harmonic:
            n = part.order
            place[:, k] += part.normal * np.cos(n * phase + part.normal_phase)
            along[:, k] -= n * part.along * np.sin(n * phase + part.along_phase)
            normal[:, k] -= n * part.normal * np.sin(n * phase + part.normal_phase)
        along[:, k] *= speed
        normal[:, k] *= speed
    pull_along = units.GRAVITY * np.sin(inclination) * step
    pull_normal = units.GRAVITY * np.cos(inclination) * step
    velocity, rise, height = along[-1].copy(), normal[-1].copy(), place[-1].copy()
    sums = {name: np.zeros(len(scenes)) for name in ("velocity", "flight", "loss", "power")}
    deck_before = along[-1]
    for period in range(settle + mean):
        for i in range(steps):
            before = velocity
            velocity = velocity + pull_along
            rise = rise - pull_normal
            height = height + rise * step
            touch = height <= place[i]
            push = np.where(touch, np.maximum(0.0, normal[i] - rise), 0.0)
            grip = np.clip(along[i] - velocity, -friction * push, friction * push)
            if period >= settle:
                sums["power"] += push * normal[i] + grip * along[i]
                sums["loss"] -= push * (rise + 0.5 * push - normal[i])
                sums["loss"] -= grip * (velocity + 0.5 * grip - along[i])
                sums["flight"] += ~touch
                slip = before + velocity + grip - deck_before - along[i]
                sums["velocity"] += 0.5 * slip
            velocity = velocity + grip
            rise = rise + push
            height = np.where(touch, place[i], height)
            deck_before = along[i]
    duration = mean * steps * step
    return {
        "velocity": sums["velocity"] * step / duration,
        "flight": sums["flight"] / (mean * steps),
        "loss": sums["loss"] / duration,
        "power": sums["power"] / duration,
    }


@pytest.fixture(scope="module")
def integrated() -> dict[str, np.ndarray]:
    return integrate(SCENES)


@pytest.mark.parametrize("number", range(len(SCENES)))
def test_regime_against_small_steps(number: int, integrated: dict[str, np.ndarray]) -> None:
    scene = SCENES[number]
    regime = conveying_regime(scene.motion, scene.inclination, scene.friction)
    expected = integrated["velocity"][number]
    assert abs(regime.velocity - expected) < 6e-3 * max(abs(expected), SLOWEST)
    assert regime.flight_fraction == pytest.approx(integrated["flight"][number], abs=0.01)
    assert regime.dissipation == pytest.approx(integrated["loss"][number], rel=8e-3)


@pytest.mark.parametrize("number", range(len(SCENES)))
def test_energy_balance(number: int, integrated: dict[str, np.ndarray]) -> None:
    """What friction and impacts dissipate comes from the deck and from gravity along it."""
    scene = SCENES[number]
    regime = conveying_regime(scene.motion, scene.inclination, scene.friction)
    gravity = units.GRAVITY * regime.velocity * math.sin(scene.inclination)
    assert regime.dissipation == pytest.approx(integrated["power"][number] + gravity, rel=8e-3)


# --- invariants ----------------------------------------------------------------------------------

scenes = {
    "throw": st.floats(0.2, 3.6),
    "throw_angle": st.floats(0.15, 1.5),
    "ellipticity": st.floats(-1.0, 1.0),
    "inclination": st.floats(-0.15, 0.3),
    "margin": st.floats(0.02, 0.6),
}


@given(**scenes, frequency=st.floats(8.0, 60.0))
@many
def test_velocity_scales_with_gravity_over_frequency(
    throw: float,
    throw_angle: float,
    ellipticity: float,
    inclination: float,
    margin: float,
    frequency: float,
) -> None:
    friction = abs(math.tan(inclination)) + margin
    regimes = [
        conveying_regime(
            of_throw_number(throw, f, throw_angle, ellipticity, inclination), inclination, friction
        )
        for f in (8.0, frequency)
    ]
    for name in ("velocity", "dissipation"):
        slow, fast = (getattr(regime, name) for regime in regimes)
        assert fast * frequency == pytest.approx(slow * 8.0, rel=2e-5, abs=1e-6)


@given(**scenes)
@many
def test_mirrored_motion_on_a_level_deck_turns_the_velocity_round(
    throw: float, throw_angle: float, ellipticity: float, inclination: float, margin: float
) -> None:
    motion = of_throw_number(throw, 15.0, throw_angle, ellipticity)
    mirrored = Motion.elliptical(motion.amplitude, 15.0, math.pi - throw_angle, -motion.ellipticity)
    assert inclination < 1.0
    there = conveying_regime(motion, 0.0, margin)
    back = conveying_regime(mirrored, 0.0, margin)
    assert back.velocity == pytest.approx(-there.velocity, rel=1e-6, abs=1e-7)
    assert back.dissipation == pytest.approx(there.dissipation, rel=1e-6, abs=1e-7)


@given(**scenes, factor=st.sampled_from([1.0 - 1e-7, 1.0 + 1e-7]))
@many
def test_velocity_is_continuous_where_regimes_repeat(
    throw: float,
    throw_angle: float,
    ellipticity: float,
    inclination: float,
    margin: float,
    factor: float,
) -> None:
    friction = abs(math.tan(inclination)) + margin
    velocity = [
        transport_velocity(
            of_throw_number(throw * k, 15.0, throw_angle, ellipticity, inclination),
            inclination,
            friction * k,
        )
        for k in (1.0, factor)
    ]
    assert abs(velocity[1] - velocity[0]) < 1e-4 * max(abs(velocity[0]), SLOWEST)


@given(offset=st.floats(1e-15, 1e-6), throw_angle=st.floats(0.2, 1.5))
@many
def test_take_off_just_above_throw_number_one(offset: float, throw_angle: float) -> None:
    velocity = [
        transport_velocity(of_throw_number(throw, throw_angle=throw_angle), 0.05, 0.4)
        for throw in (1.0 - offset, 1.0, 1.0 + offset)
    ]
    assert velocity == pytest.approx([velocity[1]] * 3, abs=1e-6)


@given(**scenes)
@many
def test_fundamental_given_as_a_harmonic(
    throw: float, throw_angle: float, ellipticity: float, inclination: float, margin: float
) -> None:
    friction = abs(math.tan(inclination)) + margin
    motion = of_throw_number(throw, 15.0, throw_angle, ellipticity, inclination)
    rows = motion.on_panel()[0]
    along = math.hypot(rows[1], rows[2]), -math.atan2(rows[2], rows[1])
    normal = math.hypot(rows[3], rows[4]), -math.atan2(rows[4], rows[3])
    other = Motion.harmonics(15.0, [Harmonic(1, *along, *normal)])
    expected = conveying_regime(motion, inclination, friction)
    regime = conveying_regime(other, inclination, friction)
    assert regime.throw_number == pytest.approx(expected.throw_number, rel=1e-12)
    assert regime.velocity == pytest.approx(expected.velocity, rel=1e-5, abs=1e-6)
    assert regime.dissipation == pytest.approx(expected.dissipation, rel=1e-5, abs=1e-6)


def test_small_harmonic_changes_little_and_reads_the_same_at_any_order() -> None:
    motion = of_throw_number(2.0)
    expected = transport_velocity(motion, 0.05, 0.5)
    for order in range(1, MAX_ORDER + 1):
        extra = Motion(15.0, motion.amplitude, 0.7, 0.0, (Harmonic(order, 1e-10, 0.3, 1e-10, 1.0),))
        assert transport_velocity(extra, 0.05, 0.5) == pytest.approx(expected, rel=1e-4)


@given(rotation=st.floats(-0.5, 0.5), ellipticity=st.floats(-1.0, 1.0))
@many
def test_motion_over_a_steeper_panel_is_the_same_motion_turned(
    rotation: float, ellipticity: float
) -> None:
    harmonic = Harmonic(2, 0.001, 0.3, 0.0005, 1.0)
    motion = Motion(15.0, 0.004, 0.7, ellipticity, (harmonic,))
    first, turned = motion.on_panel(), motion.on_panel(rotation)
    cosine, sine = math.cos(rotation), math.sin(rotation)
    np.testing.assert_allclose(
        turned[:, 1:3], first[:, 1:3] * cosine - first[:, 3:5] * sine, atol=1e-17
    )
    np.testing.assert_allclose(
        turned[:, 3:5], first[:, 1:3] * sine + first[:, 3:5] * cosine, atol=1e-17
    )


harmonics = st.lists(
    st.builds(
        Harmonic,
        st.integers(1, MAX_ORDER),
        st.floats(-0.05, 0.05),
        st.floats(-6.0, 6.0),
        st.floats(-0.05, 0.05),
        st.floats(-6.0, 6.0),
    ),
    max_size=4,
)


@given(
    motion=st.builds(
        Motion,
        st.floats(0.0, 100.0),
        st.floats(0.0, MAX_AMPLITUDE),
        st.floats(-math.pi, math.pi),
        st.floats(-1.0, 1.0),
        st.one_of(st.just(()), harmonics.map(tuple)),
    ),
    inclination=st.floats(-1.5, 1.5),
    margin=st.floats(1e-6, 2.0),
)
@many
def test_any_motion_has_a_finite_answer(motion: Motion, inclination: float, margin: float) -> None:
    friction = abs(math.tan(inclination)) + margin
    regime = conveying_regime(motion, inclination, friction)
    assert all(math.isfinite(getattr(regime, field.name)) for field in fields(regime))
    assert 0.0 <= regime.flight_fraction <= 1.0 + 1e-9
    assert regime.dissipation >= 0.0
    assert regime.spread >= 0.0


def test_irregular_regime_reports_its_spread_and_repeats() -> None:
    regimes = [conveying_regime(of_throw_number(4.5), 0.05, 0.5) for _ in range(2)]
    assert regimes[0] == regimes[1]
    spreads = [
        conveying_regime(of_throw_number(throw), 0.05, 0.5).spread
        for throw in np.linspace(3.75, 9.0, 60)
    ]
    assert max(spreads) > 1e-3
    assert spreads.count(0.0) > 10


# --- kernels: status and the prescribed velocity -------------------------------------------------


def test_status_of_the_kernel() -> None:
    motion = Motion.linear(0.004, 16.0, 0.785)
    assert solved(rigid_body.rigid_body, motion, [0.0, 0.5, 0.0])[6] == 0.0
    for inclination in (0.5, -0.5, 2.0):
        steep = solved(rigid_body.rigid_body, motion, [inclination, 0.5, 0.0])
        assert steep[0] == 0.0
        assert steep[6] == (1.0 if abs(inclination) < 1.5 else 0.0)
    uphill = solved(rigid_body.rigid_body, Motion.linear(0.004, 16.0, 2.3), [0.0, 0.5, 0.0])
    assert uphill[0] < 0.0
    assert uphill[6] == 2.0
    upright = solved(
        rigid_body.rigid_body, Motion.linear(0.004, 14.0, 0.5 * math.pi), [0.0, 0.5, 0.0]
    )
    assert upright[0] == pytest.approx(0.0, abs=1e-12)
    assert upright[6] == 0.0


def test_prescribed_velocity_keeps_the_dissipation_of_the_rigid_body() -> None:
    motion = Motion.linear(0.004, 16.0, 0.785)
    body = solved(rigid_body.rigid_body, motion, [0.05, 0.5, 0.3])
    given_velocity = solved(prescribed.prescribed, motion, [0.05, 0.5, 0.3])
    assert given_velocity[0] == 0.3
    assert given_velocity[1] == given_velocity[6] == 0.0
    assert np.array_equal(given_velocity[2:6], body[2:6])
    steep = solved(prescribed.prescribed, motion, [0.6, 0.5, 0.3])
    assert steep[0] == 0.3
    assert steep[4] == steep[6] == 0.0
    assert steep[5] > 0.0
    still = solved(prescribed.prescribed, Motion.linear(0.0, 16.0, 0.7), [0.6, 0.5, 0.3])
    assert np.array_equal(still, np.zeros(7))
    along = solved(prescribed.prescribed, Motion.linear(0.004, 16.0, 0.0), [0.0, 0.5, 0.3])
    assert along[0] == 0.3
    assert along[5] == 0.0


def test_same_result_without_compilation() -> None:
    """The kernels are plain Python too: NUMBA_DISABLE_JIT=1 in a fresh interpreter."""
    program = (
        "import json\n"
        "from vibroscreen.motion import Harmonic, Motion, conveying_regime\n"
        "extra = (Harmonic(2, 2e-4, 0.3, 2e-4, 1.0),)\n"
        "for motion in (Motion.linear(0.003, 16.0, 0.5), Motion(16.0, 0.003, 0.5, 0.2, extra)):\n"
        "    print(json.dumps(vars(conveying_regime(motion, 0.05, 0.5))))\n"
    )
    source = str(Path(vibroscreen.__file__).parents[1])
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1", PYTHONPATH=source)
    output = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    extra = (Harmonic(2, 2e-4, 0.3, 2e-4, 1.0),)
    motions = (Motion.linear(0.003, 16.0, 0.5), Motion(16.0, 0.003, 0.5, 0.2, extra))
    for line, motion in zip(output.splitlines(), motions, strict=True):
        assert json.loads(line) == pytest.approx(vars(conveying_regime(motion, 0.05, 0.5)))


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("inclination", [0.5, -0.5])
def test_too_steep_is_refused_with_both_values_and_the_cure(inclination: float) -> None:
    motion = Motion.linear(0.004, 16.0, 0.785)
    with pytest.raises(InputError) as refused:
        transport_velocity(motion, inclination, 0.4)
    message = str(refused.value)
    assert refused.value.variable == "inclination"
    assert f"inclination = {inclination:g} rad" in message
    assert "(0.4)" in message
    assert 'displacement.model = "bed" or "prescribed"' in message


@pytest.mark.parametrize(
    ("values", "variable", "said"),
    [
        ({"amplitude": 4.0}, "motion.amplitude", "were millimetres meant?"),
        ({"amplitude": -0.001}, "motion.amplitude", "out of range (0 to 0.1 m)"),
        ({"amplitude": math.nan}, "motion.amplitude", "= nan m"),
        ({"amplitude": "4 mm"}, "motion.amplitude", "is not a number"),
        ({"frequency": 960.0}, "motion.frequency", "were 1/min meant?"),
        ({"frequency": True}, "motion.frequency", "is not a number"),
        ({"throw_angle": 45.0}, "motion.throw_angle", "were degrees meant?"),
        ({"ellipticity": 1.5}, "motion.ellipticity", "out of range (-1 to 1)"),
        ({"harmonic": (Harmonic(2),) * 5}, "motion.harmonic", "5 harmonics"),
        ({"harmonic": (Harmonic(2), Harmonic(0))}, "motion.harmonic[2].order", "(1 to 8)"),
        ({"harmonic": (Harmonic(2, 5.0),)}, "motion.harmonic[1].along", "5 mm is 0.005 m"),
        ({"harmonic": (Harmonic(2, 0.0, 90.0),)}, "motion.harmonic[1].along_phase", "90 deg is"),
    ],
)
def test_motion_out_of_range_is_refused(values: dict[str, Any], variable: str, said: str) -> None:
    whole: dict[str, Any] = {"frequency": 15.0, "amplitude": 0.004, **values}
    with pytest.raises(InputError) as refused:
        Motion(**whole)
    assert refused.value.variable == variable
    assert str(refused.value).startswith(f"{variable} = ")
    assert said in str(refused.value)


def test_unknown_sense_and_bad_arguments_are_refused() -> None:
    with pytest.raises(InputError, match=r"motion\.sense = 'left'"):
        Motion.circular(0.004, 14.0, "left")
    motion = Motion.circular(0.004, 14.0)
    with pytest.raises(InputError, match="inclination = 5 rad"):
        transport_velocity(motion, 5.0, 0.5)
    with pytest.raises(InputError, match="friction = -1"):
        transport_velocity(motion, 0.0, -1.0)
