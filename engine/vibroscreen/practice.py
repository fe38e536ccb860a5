"""How a steady state stands to what plants find good: green, amber or red, each with its reason.

Limits are those of the trade, rounded; where books differ the wider range is taken. Areas and
depths of the bed: VSMA. Efficiency: screens are sized for 90 to 95 % (VSMA's factors end at 95 %),
85 % still counts as reasonable (Ortega-Rivas, Unit Operations of Particulate Solids, 2012, ch. 9).
Throw number and K: what linear and circular screens are commonly set to, from no single source.
Velocity of the bed: VSMA reckons with 45 ft/min on level and 75 ft/min on inclined screens.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from vibroscreen.config import ScreenConfig
from vibroscreen.kernels.outputs import deep_in_apertures
from vibroscreen.results import DeckResult
from vibroscreen.sizing_rules import Rules, rules_of
from vibroscreen.steady import SteadyResult
from vibroscreen.units import MM, PERCENT, T_M3

__all__ = ["AMBER", "GREEN", "RED", "Finding", "findings", "sizing_rules", "worst"]

GREEN, AMBER, RED = LEVELS = ("green", "amber", "red")

MOST_EFFICIENCY, GOOD_EFFICIENCY, FAIR_EFFICIENCY = 0.95, 0.90, 0.85
# Of the depth that raises the alarm.
NEARLY_DEEP = 0.8
USUAL_THROW = (1.5, 5.0)
USUAL_K = (2.5, 6.0)
USUAL_VELOCITY = (0.15, 0.8)  # m/s, about half and twice what VSMA reckons with
# Efficiencies of model and rules that differ by more; rules among themselves scatter by 0.03.
APART = 0.1
MOST_TOLD = 2  # reasons in one finding
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
            yield _conveying(steady, deck)
            yield from _rules(deck, sizing_rules(steady)[deck.deck - 1])
    yield _within(
        "throw number",
        steady.throw_number,
        USUAL_THROW,
        low="the bed is hardly thrown, near-size grains stay in the openings",
        high="hard on the machine, and grains meet the openings less often",
    )
    if steady.acceleration_number > 0.0:  # it is that of the fundamental, which may be none
        yield _within(
            "acceleration K",
            steady.acceleration_number,
            USUAL_K,
            low="a gentle drive, few tries for a grain",
            high="boxes are seldom built for it",
        )
    yield _numbers(steady.config)
    for name, reason in steady.alarm_reasons.items():
        if name not in TOLD:
            yield Finding(AMBER if name in MILD else RED, name, reason)


def _numbers(config: ScreenConfig) -> Finding:
    """Whether the screen lies within what the numbers of its model were fitted to."""
    subject, outside = "numbers of the model", config.beyond_calibration()
    if outside:
        told, more = "; ".join(outside[:MOST_TOLD]), len(outside) - MOST_TOLD
        return Finding(AMBER, subject, f"{told}; and {more} more" if more > 0 else told)
    named = config.calibration
    said = f'within what "{named.name}" was fitted to, {named.fitted_to}'
    if not named.shipped:
        return Finding(GREEN, subject, said)
    return Finding(GREEN, subject, f"{said}; no survey of this screen is in it")


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


def _conveying(steady: SteadyResult, deck: DeckResult[float]) -> Finding:
    """Velocity of the bed; where slopes differ the first panel of a deck may be fast."""
    slopes = {panel.inclination for panel in steady.config.decks[deck.deck - 1].panels}
    least, most = USUAL_VELOCITY
    return _within(
        f"deck {deck.deck}, conveying",
        deck.transport_velocity,
        (least, most if len(slopes) == 1 else math.inf),
        low="the bed is carried slowly and lies deep",
        high="grains meet few openings on their way",
        unit=" m/s",
    )


def sizing_rules(steady: SteadyResult) -> tuple[Rules, ...]:
    """What VSMA and Karra say of every deck under the feed of a steady state."""
    return rules_of(steady.config.replace(feed=steady.feed))


def _rules(deck: DeckResult[float], rule: Rules) -> Iterator[Finding]:
    """Area of a deck against VSMA, and whether Karra finds another efficiency."""
    recovery = 0.0 if math.isnan(rule.vsma_recovery) else rule.vsma_recovery
    level = GREEN if recovery >= GOOD_EFFICIENCY else AMBER if recovery >= FAIR_EFFICIENCY else RED
    asked = f"VSMA asks for {rule.area_at_95:.3g} m2 for 95 %, the deck has {rule.area:.3g} m2"
    if recovery < MOST_EFFICIENCY:
        asked += f", for {recovery / PERCENT:.0f} %" if recovery else ", for less than 70 %"
    yield Finding(level, f"deck {deck.deck}, area", asked)
    if abs(deck.efficiency - rule.karra_recovery) > APART and not rule.beyond:
        yield Finding(
            AMBER,
            f"deck {deck.deck}, model and rules",
            f"this model finds an efficiency of {deck.efficiency / PERCENT:.1f} %, Karra "
            f"{rule.karra_recovery / PERCENT:.1f} %: calibrate before you design",
        )


def _within(
    subject: str, value: float, usual: tuple[float, float], low: str, high: str, unit: str = ""
) -> Finding:
    """A number of the motion against what is usual."""
    least, most = usual
    range_ = f"{least:g} to {most:g}" if most < math.inf else f"{least:g} and more"
    said = f"{value:.3g}{unit}; usual are {range_}"
    if least <= value <= most:
        return Finding(GREEN, subject, said)
    return Finding(AMBER, subject, f"{said}: {low if value < least else high}")
