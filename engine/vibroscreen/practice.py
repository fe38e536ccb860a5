"""How a steady state stands to what plants find good: green, amber or red, each with its reason.

Limits are those of the trade, rounded; where books differ the wider range is taken. Depths of the
bed: VSMA. Efficiency: screens are sized for 90 to 95 % (VSMA's factors end at 95 %), 85 % still
counts as reasonable (Ortega-Rivas, Unit Operations of Particulate Solids, 2012, ch. 9). Throw
number and K: what linear and circular screens are commonly set to, from no single source.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from vibroscreen.kernels.outputs import deep_in_apertures
from vibroscreen.results import DeckResult
from vibroscreen.steady import SteadyResult
from vibroscreen.units import MM, PERCENT, T_M3

__all__ = ["AMBER", "GREEN", "RED", "Finding", "findings", "worst"]

GREEN, AMBER, RED = LEVELS = ("green", "amber", "red")

GOOD_EFFICIENCY, FAIR_EFFICIENCY = 0.90, 0.85
# Of the depth that raises the alarm.
NEARLY_DEEP = 0.8
USUAL_THROW = (1.5, 5.0)
USUAL_K = (2.5, 6.0)
# Alarms that say of a result only that a number of it stands for another one.
MILD = ("alarm.performance",)
# Alarms that are told as a finding of their own.
TOLD = ("alarm.bed_depth",)


@dataclass(frozen=True)
class Finding:
    """What was looked at, how it stands, and why in plain words."""

    level: str
    subject: str
    reason: str


def worst(found: tuple[Finding, ...]) -> str:
    """The worst level of all."""
    return max((one.level for one in found), key=LEVELS.index, default=GREEN)


def findings(steady: SteadyResult) -> tuple[Finding, ...]:
    """How a steady state stands, from the top deck down, then the box and its alarms."""
    return tuple(_findings(steady))


def _findings(steady: SteadyResult) -> Iterator[Finding]:
    for deck in steady.decks:
        if deck.feed_rate > 0.0:
            yield _efficiency(deck)
            yield _depth(steady, deck)
    yield _within(
        "throw number",
        steady.throw_number,
        USUAL_THROW,
        low="the bed is hardly thrown, near-size grains stay in the openings",
        high="hard on the machine, and grains meet the openings less often",
    )
    yield _within(
        "acceleration K",
        steady.acceleration_number,
        USUAL_K,
        low="a gentle drive, few tries for a grain",
        high="boxes are seldom built for it",
    )
    for name, reason in steady.alarm_reasons.items():
        if name not in TOLD:
            yield Finding(AMBER if name in MILD else RED, name, reason)


def _efficiency(deck: DeckResult[float]) -> Finding:
    """Of what comes to a deck finer than its aperture, the share that passes it."""
    subject, value = f"deck {deck.deck}, efficiency", deck.efficiency
    if math.isnan(value):
        return Finding(AMBER, subject, "nothing finer than its aperture comes to it")
    share, size = value / PERCENT, deck.aperture / MM
    said = f"{share:.1f} % of what comes to it finer than {size:.4g} mm passes"
    good, fair = GOOD_EFFICIENCY / PERCENT, FAIR_EFFICIENCY / PERCENT
    if value >= GOOD_EFFICIENCY:
        return Finding(GREEN, subject, f"{said}; screens are sized for {good:.0f} to 95 %")
    level = AMBER if value >= FAIR_EFFICIENCY else RED
    limit = f"less than {good if level == AMBER else fair:.0f} %"
    return Finding(level, subject, f"{said}: {limit}")


def _depth(steady: SteadyResult, deck: DeckResult[float]) -> Finding:
    """Depth of the bed at the discharge, in apertures of the last panel."""
    density = steady.config.material.bulk_density
    most, value = float(deep_in_apertures(density)), deck.depth_over_aperture_discharge
    level = RED if value > most else AMBER if value > NEARLY_DEEP * most else GREEN
    return Finding(
        level,
        f"deck {deck.deck}, bed",
        f"{deck.depth_discharge / MM:.3g} mm deep at the discharge, {value:.2g} apertures: at "
        f"{density / T_M3:.3g} t/m3 up to {most:.3g} are good practice",
    )


def _within(subject: str, value: float, usual: tuple[float, float], low: str, high: str) -> Finding:
    """A number of the motion against what is usual."""
    least, most = usual
    said = f"{value:.3g}; usual are {least:g} to {most:g}"
    if least <= value <= most:
        return Finding(GREEN, subject, said)
    return Finding(AMBER, subject, f"{said}: {low if value < least else high}")
