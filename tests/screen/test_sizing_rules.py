"""What the sizing rules say of the decks of a screen; the formulas themselves: test_engineering_rules."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.fixed import fixed_screen
from tests.places import SCREENS
from vibroscreen import ScreenConfig
from vibroscreen.sizing_rules import Rules, rules_of

FOOT, SHORT_TON = 0.3048, 907.18474


def of(**changes: float) -> Rules:
    """Rules of the top deck of the default screen with other numbers."""
    values = {
        name.replace("__", ".").replace("panel.", "deck[1].panel[1]."): v
        for name, v in changes.items()
    }
    (found,) = rules_of(fixed_screen().with_values(values))
    return found


def test_the_default_screen_by_hand() -> None:
    """VSMA's factors read from its tables by hand, for 16 mm, 55 % open, 1600 kg/m3, 300 t/h.

    Passing of the feed, from the file: 54.6 % at 16 mm, 35.672 % at 8 mm. A at .62992 in, between
    2.82 (.625) and 3.08 (.75); B at 45.4004 % oversize, between .84 (45) and .79 (50); C at 35.6775 % half-size,
    between .9 (35) and 1 (40).
    """
    rules = of()
    fed = np.cumsum(rules.config.feed.mass_fraction)
    passed, half = fed[6], fed[4]
    capacity = 2.82 + (16 / 25.4 - 0.625) / 0.125 * (3.08 - 2.82)
    usual = 59 + (16 / 25.4 - 0.625) / 0.125 * (61 - 59)
    over = 0.84 - (100 * (1 - passed) - 45) / 5 * 0.05
    fine = 0.9 + (100 * half - 35) / 5 * 0.1
    weight = 1600 / (100 * 0.45359237 / FOOT**3)
    rate = capacity * over * fine * weight * 55 / usual  # short tons an hour and square foot
    area = 300e3 * passed / SHORT_TON / rate * FOOT**2
    assert rules.area_at_95 == pytest.approx(area, rel=1e-6)
    assert rules.area == pytest.approx(14.4)
    assert rules.load == pytest.approx(area / 14.4)
    assert rules.beyond == ()


def test_a_lower_deck_is_fed_what_the_upper_one_lets_through() -> None:
    """All of the feed finer than 31.5 mm, and nothing else; VSMA takes a tenth of its capacity."""
    upper, lower = rules_of(ScreenConfig.load(SCREENS / "two_deck.toml"))
    passed = np.cumsum(upper.config.feed.mass_fraction)
    assert lower.passing(0.0315) == 1.0
    assert lower.passing(0.016) == pytest.approx(passed[6] / passed[8])
    assert lower.undersize_rate == pytest.approx(250 / 3.6 * passed[4])
    assert upper.passing(0.0315) == pytest.approx(passed[8])
    # The upper deck has two media.
    assert upper.open_area == pytest.approx((1.2 * 0.40 + 4.8 * 0.62) / 6.0)
    assert "one medium a deck: taken as 31.5 mm with 57.6 % open area" in upper.beyond[0]
    assert lower.beyond == ()


def test_as_a_single_deck() -> None:
    """A lower deck is rated as the same deck alone with the same feed, but for VSMA's D and Karra's."""
    upper, lower = rules_of(ScreenConfig.load(SCREENS / "two_deck.toml"))
    finer = np.array(upper.config.feed.mass_fraction)[:9]
    alone = lower.config.replace(
        decks=lower.config.decks[1:],
        size_classes=type(lower.config.size_classes)(lower.config.size_classes.edges[:10]),
        feed=type(lower.config.feed)(250 / 3.6 * finer.sum(), tuple(finer / finer.sum())),
    )
    (single,) = rules_of(alone)
    assert lower.area_at_95 == pytest.approx(single.area_at_95 / 0.9)
    assert lower.cut_size / single.cut_size == pytest.approx((1 / 0.9) ** -0.148)


def test_what_lies_beyond_the_rules_is_said() -> None:
    """Ends of tables with their value, too little area, too low a load; nothing is silent."""
    assert any("1/1.9" in text for text in of(feed__mass_flow_rate=1000 / 3.6).beyond)
    assert math.isnan(of(feed__mass_flow_rate=1000 / 3.6).vsma_recovery)
    assert any(
        "above the throughfall aperture" in text for text in of(feed__mass_flow_rate=10.0).beyond
    )
    fine = of(panel__aperture=0.0005)
    assert any("table ends at an aperture of 0.794 mm, this is 0.5 mm" in t for t in fine.beyond)
    assert math.isnan(fine.cut_size)
    assert any("throughfall aperture below 0.6" in text for text in fine.beyond)
    coarse = of(panel__aperture=0.2)
    assert any("aperture of 102 mm, this is 200 mm" in text for text in coarse.beyond)
    assert any("oversize in the feed of 5 %, this is 0 %" in text for text in coarse.beyond)
    assert any("half-size in the feed of 90 %, this is 100 %" in text for text in coarse.beyond)


@pytest.mark.parametrize(
    "changes",
    [
        {"panel__open_area": 0.0},
        {"panel__inclination": 0.46, "panel__open_area": 0.05},
        {"feed__mass_flow_rate": 0.0},
        {"panel__aperture": 0.5},
        {"panel__aperture": 2e-5},
    ],
)
def test_no_screen_breaks_the_rules(changes: dict[str, float]) -> None:
    """Numbers, infinity or nan, and a reason for each that is none."""
    rules = of(**changes)
    assert rules.area_at_95 >= 0.0
    for number in (rules.vsma_recovery, rules.cut_size, rules.karra_recovery):
        assert math.isnan(number) or number >= 0.0
    if math.isnan(rules.cut_size):
        assert any(text.startswith("Karra has no cut size") for text in rules.beyond)
