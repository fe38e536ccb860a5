"""The default screen is what sizing rules make of it."""

from __future__ import annotations

import numpy as np
import pytest

from vibroscreen import Feed, Screen, ScreenConfig
from vibroscreen.units import T_H

CONFIG = ScreenConfig.default()


@pytest.fixture(scope="module")
def screen() -> Screen:
    return Screen(CONFIG)


def test_recovery_of_the_duty(screen: Screen) -> None:
    """VSMA says .95, Karra .937 (vibroscreen/sizing_rules.py)."""
    assert 0.93 <= screen.solve_steady().decks[0].efficiency <= 0.95


@pytest.mark.parametrize("rate", [150.0, 300.0, 600.0, 900.0])
def test_partition_has_no_shelf(screen: Screen, rate: float) -> None:
    """It rises with size up to the aperture, and the cut lies below it as in practice."""
    deck = screen.solve_steady(Feed(rate * T_H, CONFIG.feed.mass_fraction)).decks[0]
    part = deck.partition.to_oversize
    assert (np.diff(part) >= -1e-5).all()
    assert 0.75 <= deck.cut_size / deck.aperture <= 0.95
    # Between a tenth and nine tenths it never lies level.
    inside = (part > 0.1) & (part < 0.9)
    slope = np.diff(part[inside]) / np.diff(deck.partition.size[inside] / deck.aperture)
    assert slope.min() > 0.1


def test_more_feed_recovers_less_and_more_deck_more(screen: Screen) -> None:
    def efficiency(config: ScreenConfig, rate: float = 450.0) -> float:
        feed = Feed(rate * T_H, config.feed.mass_fraction)
        return float(Screen(config).solve_steady(feed).decks[0].efficiency)

    first = efficiency(CONFIG)
    assert efficiency(CONFIG, 600.0) < first
    for name, value in (
        ("deck[1].width", 2.7),
        ("deck[1].panel[1].length", 6.6),
        ("deck[1].panel[1].open_area", 0.6),
    ):
        assert efficiency(CONFIG.with_values({name: value})) > first
    wide = CONFIG.with_values({"deck[1].width": 4.8})
    assert efficiency(wide, 900.0) == pytest.approx(first, abs=2e-4)


def test_best_throw(screen: Screen) -> None:
    """Nothing up to K = 1; best between throw numbers of 2 and 4.5 at two loads; less beyond."""
    for rate in (300.0, 600.0):
        feed = Feed(rate * T_H, CONFIG.feed.mass_fraction)
        strokes = np.array([0.0015, 0.002, 0.003, 0.004, 0.0045, 0.005, 0.006, 0.007, 0.009, 0.012])
        found, throw = [], []
        for amplitude in strokes:
            changed = CONFIG.with_values({"motion.amplitude": float(amplitude)})
            result = Screen(changed).solve_steady(feed)
            found.append(result.decks[0].efficiency)
            throw.append(result.decks[0].throw_number)
        best = throw[int(np.argmax(found))]
        assert 2.0 <= best <= 4.5
        assert found[-1] < max(found) - 0.01
        assert found[0] < max(found) - 0.05
