"""Good practice: levels follow the numbers, every alarm is told, reasons name value and limit."""

from __future__ import annotations

import dataclasses

import pytest

from tests.places import DATA
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.practice import AMBER, GREEN, RED, Finding, findings, worst
from vibroscreen.units import T_H

SCREEN = Screen(ScreenConfig.default())
DUTY = SCREEN.config.feed.mass_fraction


def found(rate: float, motion: Motion | None = None) -> dict[str, Finding]:
    """Findings at a feed rate [t/h], by subject."""
    return {
        one.subject: one for one in findings(SCREEN.solve_steady(Feed(rate * T_H, DUTY), motion))
    }


def test_more_feed_turns_the_light_from_green_to_red() -> None:
    levels = []
    for rate in range(40, 900, 20):
        steady = SCREEN.solve_steady(Feed(rate * T_H, DUTY))
        efficiency, one = steady.efficiency, findings(steady)[0]
        assert one.subject == "deck 1, efficiency"
        levels.append(one.level)
        assert one.level == (GREEN if efficiency >= 0.9 else AMBER if efficiency >= 0.85 else RED)
        assert one.reason.startswith(
            f"{100.0 * efficiency:.1f} % of what comes to it finer than 16 mm"
        )
    assert set(levels) == {GREEN, AMBER, RED}
    assert levels == sorted(levels, key=[GREEN, AMBER, RED].index)


@pytest.mark.parametrize(
    ("frequency", "throw", "k"),
    [(7.0, AMBER, AMBER), (15.5, GREEN, GREEN), (18.0, GREEN, AMBER), (20.0, AMBER, AMBER)],
)
def test_the_motion_against_what_is_usual(frequency: float, throw: str, k: str) -> None:
    motion = dataclasses.replace(SCREEN.config.motion, frequency=frequency, throw_angle=1.2)
    if frequency > 10.0:
        motion = dataclasses.replace(motion, throw_angle=SCREEN.config.motion.throw_angle)
    told = found(100.0, motion)
    assert (told["throw number"].level, told["acceleration K"].level) == (throw, k)


def test_a_deep_bed_is_red_by_the_rule_of_its_alarm() -> None:
    steady = SCREEN.solve_steady(Feed(900.0 * T_H, DUTY))
    assert "alarm.bed_depth" in steady.alarms
    one = {f.subject: f for f in findings(steady)}["deck 1, bed"]
    assert one.level == RED
    assert one.reason.endswith("at 1.6 t/m3 up to 5 are good practice")
    assert worst(findings(steady)) == RED


def test_alarms_are_told_with_their_reasons() -> None:
    double = Screen(ScreenConfig.load(DATA / "double_deck.toml"))
    share = (0.0,) * (double.config.size_classes.count - 1) + (1.0,)
    steady = double.solve_steady(Feed(50.0, share))
    told = {one.subject: one for one in findings(steady)}
    assert steady.alarms
    for name, reason in steady.alarm_reasons.items():
        assert told[name].reason == reason
        assert told[name].level == (AMBER if name == "alarm.performance" else RED)
    assert told["deck 1, efficiency"].level == AMBER
    assert "deck 2, efficiency" not in told  # nothing comes to it
