"""Vibration of the deck and the mean velocity at which a body or a bed would ride on it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import InputError
from vibroscreen.fields import Entry, Number, check_fields, entries, number
from vibroscreen.kernels.physics.bed_of_grains import BED_CONSTANTS, solve_bed
from vibroscreen.kernels.physics.closure import peak_acceleration
from vibroscreen.kernels.physics.motion import CONSTANT, MAX_ORDER, ROWS, WORK_SIZE, compose_motion
from vibroscreen.kernels.physics.rigid_body import rigid_body
from vibroscreen.sections import Material, Panel
from vibroscreen.units import DEG, GRAVITY, MM

__all__ = ["ConveyingRegime", "Harmonic", "Motion", "conveying_regime", "transport_velocity"]

MAX_AMPLITUDE = 0.1  # m, half the stroke; gyratory screens have .04
PHASES = 720  # of a period, at which the acceleration is looked at
HALF_STROKE = 0.5 * MM  # m, the amplitude from the stroke in mm
MAX_HARMONICS = ROWS - 1
SENSES = {"with_flow": 1.0, "against_flow": -1.0}
_SOLVERS = {"rigid_body": rigid_body, "bed": solve_bed}


def _given(entry: Entry, **about: Any) -> Number:
    """What is said of a number of the configuration, of one that a function is given."""
    assert isinstance(entry, Number)
    return dataclasses.replace(entry, error=InputError, **about)


# A body rides on any slope, also on one that no screen has.
_UPRIGHT = {"at_least": None, "at_most": None, "above": -0.5 * math.pi, "below": 0.5 * math.pi}
_INCLINATION = _given(entries(Panel)["inclination"], **_UPRIGHT)
_FRICTION = _given(entries(Material)["friction_deck"])
_ROLLING = _given(entries(Material)["rolling"])


def _moves(default: float | None, key: str, *scale: Any, **about: Any) -> Any:
    """A field of the motion, which changes while the screen runs."""
    missing = dataclasses.MISSING if default is None else default
    return number(missing, key, *scale, variability="continuous", error=InputError, **about)


def _part(key: str, unit: str, factor: float, most: float) -> Any:
    """A field of a harmonic."""
    return number(0.0, key, unit, factor, at_least=-most, at_most=most, error=InputError)


@dataclass(frozen=True)
class Harmonic:
    """Part of the deck's motion at `order` times the frequency [m], phases in rad.

    Adds along * cos(order w t + along_phase) to the motion along the deck (down-slope positive)
    and normal * cos(order w t + normal_phase) to the motion normal to it (up). The values are
    checked by the Motion that takes it in.
    """

    order: int = number(
        1,
        "order",
        whole=True,
        at_least=1,
        at_most=MAX_ORDER,
        cure="give the multiple of motion.frequency",
        error=InputError,
    )
    along: float = _part("along_mm", "m", MM, MAX_AMPLITUDE)
    along_phase: float = _part("along_phase_deg", "rad", DEG, 2.0 * math.pi)
    normal: float = _part("normal_mm", "m", MM, MAX_AMPLITUDE)
    normal_phase: float = _part("normal_phase_deg", "rad", DEG, 2.0 * math.pi)


@dataclass(frozen=True)
class Motion:
    """Periodic motion of the deck: frequency [Hz], amplitude [m], throw angle [rad], ellipticity.

    xi = A (cos b sin wt - e sin b cos wt) along the deck, down-slope positive, and
    eta = A (sin b sin wt + e cos b cos wt) normal to it, up, plus at most four harmonics. The
    amplitude is the semi-major axis, half the stroke; the throw angle b is that of the major axis
    over the first panel of the top deck; with e > 0 the deck moves with the flow at the top of its
    orbit. Raises InputError with the name of the value that is out of range.
    """

    frequency: float = _moves(
        None,
        "frequency_hz",
        "Hz",
        at_least=0.0,
        at_most=100.0,
        also="speed rotation",
        tells="Frequency of the vibration",
    )
    amplitude: float = _moves(
        None,
        "stroke_mm",
        "m",
        HALF_STROKE,
        at_least=0.0,
        at_most=MAX_AMPLITUDE,
        also="amplitude",
        tells="Amplitude of the vibration: semi-major axis, half the stroke",
    )
    throw_angle: float = _moves(
        45.0 * DEG,
        "throw_angle_deg",
        "rad",
        DEG,
        at_least=-math.pi,
        at_most=math.pi,
        also="angle stroke_angle direction",
        tells="Direction of the vibration over the top deck's first panel",
    )
    ellipticity: float = _moves(
        0.0,
        "ellipticity",
        at_least=-1.0,
        at_most=1.0,
        tells="Shape of the orbit: 0 linear, 1 circular with the flow, -1 circular against it",
        cure="minor over major axis, 0 is linear, 1 and -1 are circular",
    )
    harmonic: tuple[Harmonic, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, "motion")
        object.__setattr__(self, "harmonic", tuple(self.harmonic))
        if len(self.harmonic) > MAX_HARMONICS:
            raise InputError(
                f"motion.harmonic = {len(self.harmonic)} harmonics are more than the engine has "
                f"room for ({MAX_HARMONICS}): leave out the smallest"
            )
        for place, part in enumerate(self.harmonic, start=1):
            check_fields(part, f"motion.harmonic[{place}]")

    @classmethod
    def linear(cls, amplitude: float, frequency: float, throw_angle: float) -> Motion:
        """Motion along a straight line: half the stroke [m], frequency [Hz], throw angle [rad]."""
        return cls(frequency, amplitude, throw_angle)

    @classmethod
    def circular(cls, amplitude: float, frequency: float, sense: str = "with_flow") -> Motion:
        """Motion on a circle: radius [m], frequency [Hz], sense of rotation.

        `with_flow`: at the top of its orbit the deck moves with the flow, `against_flow`: the
        other way round.
        """
        if sense not in SENSES:
            raise InputError(
                f"motion.sense = {sense!r} is not a sense of rotation: "
                f"use {' or '.join(repr(name) for name in SENSES)}"
            )
        return cls(frequency, amplitude, 90.0 * DEG, SENSES[sense])

    @classmethod
    def elliptical(
        cls, amplitude: float, frequency: float, throw_angle: float, ellipticity: float
    ) -> Motion:
        """Motion on an ellipse: semi-major axis [m] and its angle [rad], frequency [Hz]."""
        return cls(frequency, amplitude, throw_angle, ellipticity)

    @classmethod
    def harmonics(cls, frequency: float, parts: Sequence[Harmonic]) -> Motion:
        """Any periodic motion of frequency [Hz] as a sum of harmonics [m, rad]."""
        return cls(frequency, 0.0, 0.0, 0.0, tuple(parts))

    @property
    def at_rest(self) -> bool:
        """Whether nothing vibrates: frequency or all amplitudes zero."""
        return self.frequency == 0.0 or (
            self.amplitude == 0.0
            and all(part.along == 0.0 and part.normal == 0.0 for part in self.harmonic)
        )

    @cached_property
    def fundamental(self) -> NDArray[np.float64]:
        """Frequency [Hz], amplitude [m], throw angle [rad], ellipticity, for the kernels."""
        return np.array([self.frequency, self.amplitude, self.throw_angle, self.ellipticity])

    @cached_property
    def harmonic_rows(self) -> NDArray[np.float64]:
        """Harmonics [m, rad] for the kernels, zero padded.

        Shape [4, 5], rows (order, along, along phase, normal, normal phase).
        """
        rows = np.zeros((MAX_HARMONICS, 5))
        for row, part in zip(rows, self.harmonic, strict=False):
            row[:] = (part.order, part.along, part.along_phase, part.normal, part.normal_phase)
        return rows

    @property
    def peak_acceleration(self) -> float:
        """Largest acceleration over g, K [1]; of several harmonics the sum, a bound."""
        return float(peak_acceleration(self.on_panel(), self.frequency))

    def throw_number(self, inclination: float, rotation: float = 0.0) -> float:
        """Largest acceleration towards a panel over the gravity on it [1].

        inclination [rad]: of the panel; rotation [rad]: by how much it is steeper than the first.
        """
        order, _, _, cosine, sine = self.on_panel(rotation)[..., None].swapaxes(0, 1)
        phase = np.linspace(0.0, 2.0 * math.pi, PHASES, endpoint=False)
        waves = order**2 * (cosine * np.cos(order * phase) + sine * np.sin(order * phase))
        fastest = waves.sum(axis=0).max() * (2.0 * math.pi * self.frequency) ** 2
        return float(fastest) / (GRAVITY * math.cos(inclination))

    def on_panel(self, rotation: float = 0.0) -> NDArray[np.float64]:
        """Motion along and normal to a panel [m] that is `rotation` [rad] steeper than the first.

        Shape [5, 5], rows (order, along cos, along sin, normal cos, normal sin).
        """
        rows = np.zeros((ROWS, 5))
        compose_motion(self.fundamental, self.harmonic_rows, rotation, rows)
        return rows


@dataclass(frozen=True)
class ConveyingRegime:
    """How a body or a bed rides on the deck.

    velocity: mean velocity along the deck, down-slope positive [m/s]; negative where the body
    travels towards the feed end. spread: 0 in a regime that repeats within 16 periods, and of a
    bed; elsewhere the standard deviation [m/s] of the velocities of 16 blocks of 8 periods (above
    throw number 8 of longer blocks, as flights are longer). flight_fraction: share of the time in
    flight [1]. flights_per_period: take-offs per period [1]. dissipation: by friction and impacts
    [W/kg]. throw_number: largest normal acceleration of the deck towards the ground over
    g cos(inclination) [1].
    """

    velocity: float
    spread: float
    flight_fraction: float
    flights_per_period: float
    dissipation: float
    throw_number: float


def conveying_regime(
    motion: Motion,
    inclination: float,
    friction: float,
    model: str = "rigid_body",
    constants: Sequence[float] = BED_CONSTANTS,
    rolling: float = 0.0,
) -> ConveyingRegime:
    """Regime of the bed on a deck of `inclination` [rad, down-slope] and `friction` [1].

    `model` "rigid_body": stick, slip forward and back and flight, plastic normal impacts,
    tangential impulse limited by friction; from rest on the deck at phase 0 (Blekhman, Vibrational
    Mechanics, 2000). Raises InputError where the deck is as steep as its friction or steeper, up or
    down (tan(inclination) >= friction): the body runs away and has no mean velocity. "bed": grains
    that land softly and slip by speed (MODEL.md, Bed of grains); `constants` are its softness of
    landing [1], damping [1], friction of shaken grains [1] and drag [s/m], `rolling` [1] is the
    share of the grip of the deck that rolling grains take.
    """
    _INCLINATION.check("inclination", inclination)
    _FRICTION.check("friction", friction)
    _ROLLING.check("rolling", rolling)
    if model not in _SOLVERS:
        raise InputError(f"model = {model!r} is unknown: give one of {', '.join(_SOLVERS)}")
    runs_away = model == "rigid_body" and abs(math.tan(inclination)) >= friction
    if runs_away and not motion.at_rest:
        raise InputError(
            f"inclination = {inclination:.4g} rad ({inclination / DEG:.4g} deg, tangent "
            f"{math.tan(inclination):.4g}) is too steep for the friction at the base "
            f"({friction:g}), a rigid body would run away: make the deck flatter or use "
            'displacement.model = "bed" or "prescribed"'
        )
    result = np.zeros(7)
    drive = np.array([motion.frequency, inclination, friction, 0.0, rolling])
    work = np.zeros(WORK_SIZE)
    work[CONSTANT : CONSTANT + len(BED_CONSTANTS)] = constants
    _SOLVERS[model](motion.on_panel(), drive, result, work)
    return ConveyingRegime(*(float(value) for value in result[:6]))


def transport_velocity(
    motion: Motion, inclination: float, friction: float, model: str = "rigid_body"
) -> float:
    """Mean velocity of a rigid body or a `bed` along the deck [m/s], down-slope positive.

    inclination [rad], down-slope positive; friction [1]; models and errors as in
    `conveying_regime`, which gives more of the same regime. A negative velocity means that the deck
    does not convey.
    """
    return conveying_regime(motion, inclination, friction, model).velocity
