"""Good practice: levels follow the numbers, every alarm is told, reasons name value and limit."""

from __future__ import annotations

import dataclasses

import pytest

from tests.places import DATA, SCREENS
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.practice import AMBER, GREEN, RED, Finding, findings, worst
from vibroscreen.sections import Displacement
from vibroscreen.sizing_rules import rules_of
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


def test_how_fast_the_bed_rides() -> None:
    """Amber where it is slow or fast; the first panel of a banana deck may be fast."""
    told = found(100.0)["deck 1, conveying"]
    velocity = SCREEN.solve_steady(Feed(100.0 * T_H, DUTY)).decks[0].transport_velocity
    assert told == Finding(GREEN, "deck 1, conveying", f"{velocity:.3g} m/s; usual are 0.15 to 0.8")
    for velocity, level, why in (
        (0.1, AMBER, ": the bed is carried slowly and lies deep"),
        (0.5, GREEN, ""),
        (1.2, AMBER, ": grains meet few openings on their way"),
    ):
        config = SCREEN.config.replace(displacement=Displacement("prescribed", velocity))
        one = {f.subject: f for f in findings(Screen(config).solve_steady())}["deck 1, conveying"]
        assert one.level == level
        assert one.reason == f"{velocity:g} m/s; usual are 0.15 to 0.8{why}"
    banana = ScreenConfig.load(
        SCREENS / "banana.toml",
        {"displacement.velocity_m_s": 1.2, "displacement.model": "prescribed"},
    )
    one = {f.subject: f for f in findings(Screen(banana).solve_steady())}["deck 1, conveying"]
    assert one.level == GREEN
    assert one.reason.endswith(" m/s; usual are 0.15 and more")


def test_a_deep_bed_is_red_by_the_rule_of_its_alarm() -> None:
    steady = SCREEN.solve_steady(Feed(900.0 * T_H, DUTY))
    assert "alarm.bed_depth" in steady.alarms
    one = {f.subject: f for f in findings(steady)}["deck 1, bed"]
    assert one.level == RED
    assert one.reason.endswith("at 1.6 t/m3 up to 5 are good practice")
    assert worst(findings(steady)) == RED


def test_the_area_against_sizing_rules() -> None:
    """At the rates at which VSMA finds 95 % just possible, and a half more."""
    rule = rules_of(SCREEN.config)[0]
    full = 300.0 / rule.load  # t/h; VSMA's area goes with the rate
    for part, level, enough in (
        (0.99, GREEN, ""),
        (1.14, GREEN, ", for 90 %"),
        (1.2, AMBER, ", for 89 %"),
        (1.36, RED, ", for 85 %"),
        (2.5, RED, ", for less than 70 %"),
    ):
        one = found(part * full)["deck 1, area"]
        asked = f"VSMA asks for {14.4 * part:.3g} m2 for 95 %, the deck has 14.4 m2"
        assert (one.level, one.reason) == (level, f"{asked}{enough}")


def test_a_model_far_from_the_rules_is_amber() -> None:
    """With grains that hardly pass, where Karra finds the same as before."""
    lazy = SCREEN.config.with_values({"passage.velocity": 0.01})
    told = {one.subject: one for one in findings(Screen(lazy).solve_steady())}
    one = told["deck 1, model and rules"]
    assert one.level == AMBER
    karra = rules_of(lazy)[0].karra_recovery
    assert f"Karra {100.0 * karra:.1f} %: calibrate" in one.reason


def test_a_screen_beyond_what_its_numbers_were_fitted_to_is_amber() -> None:
    subject, motion = "numbers of the model", SCREEN.config.motion
    one = {f.subject: f for f in findings(SCREEN.solve_steady())}[subject]
    assert one.level == GREEN
    assert SCREEN.config.beyond_calibration() == []
    other = SCREEN.config.replace(motion=dataclasses.replace(motion, frequency=21.0))
    outside = other.beyond_calibration()
    one = {f.subject: f for f in findings(Screen(other).solve_steady())}[subject]
    assert one.level == AMBER
    assert one.reason.startswith("; ".join(outside[:2]))
    assert one.reason.endswith(
        f"; and {len(outside) - 2} more" if len(outside) > 2 else outside[-1]
    )


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
