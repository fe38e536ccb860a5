"""A batch of feed that covers the deck leaves it as a whole under the next feed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.places import SCREENS
from vibroscreen import Feed, Screen, ScreenConfig

SCREENS_OF_ONE = {
    name: ScreenConfig.load(SCREENS / f"{name}.toml") for name in ("quarry", "banana")
}


def feeds(config: ScreenConfig, count: int) -> list[Feed]:
    """Feeds of changing rate and gradation; every fifth is none."""
    rng = np.random.default_rng(5)
    share = np.array(config.feed.mass_fraction)
    found = []
    for k in range(count):
        part = share * np.exp(0.2 * rng.standard_normal(share.size))
        rate = config.feed.mass_flow_rate * rng.uniform(0.5, 1.2) if k % 5 else 0.0
        found.append(Feed(rate, tuple(part / part.sum())))
    return found


def products(screen: Screen, dt: float, feed: Feed) -> np.ndarray:
    """What leaves in a step by class, kg."""
    result = screen.step(dt, feed)
    return dt * np.array([result.undersize.class_rates, result.oversize.class_rates])


@pytest.mark.parametrize("name", SCREENS_OF_ONE)
def test_a_minute_is_sixty_seconds(name: str) -> None:
    """A new feed each minute: in one step as in 60, without integrating a package."""
    config = SCREENS_OF_ONE[name]
    minute, second = Screen(config), Screen(config)
    for feed in feeds(config, 12):
        once = products(minute, 60.0, feed)
        parts = sum(products(second, 1.0, feed) for _ in range(60))
        fed = 60.0 * config.feed.mass_flow_rate
        assert abs(once - parts).max() <= config.solver.tolerance * fed
        assert minute.result().hold_up == pytest.approx(second.result().hold_up, rel=1e-4, abs=1e-6)
    counters = minute.counters()
    assert counters["packages_integrated"] == 0
    assert counters["cohorts_followed"] == 8  # as many fed minutes have one behind them
    assert counters["rates"] < second.counters()["rates"] / 20
    assert abs(minute.result().balance_error) < 1e-9


@pytest.mark.parametrize("name", SCREENS_OF_ONE)
def test_what_does_not_pass_is_all_oversize(name: str) -> None:
    """Not one grain above the openings, whatever leaves as a whole; mass closes by class."""
    config = SCREENS_OF_ONE[name]
    screen = Screen(config)
    widest = max(panel.aperture for panel in config.decks[0].panels)
    coarse = np.array(config.size_classes.lower) >= widest
    for feed in feeds(config, 12):
        under, over = products(screen, 60.0, feed)
        assert not under[coarse].any()
        assert min(under.min(), over.min()) >= 0.0
    balance = screen.balance()
    assert (abs(balance.error) <= 1e-12 * balance.fed).all()


def test_another_frequency_parts_the_batch() -> None:
    """Passage follows the vibration: what lies on the deck has a history of its own then."""
    config = SCREENS_OF_ONE["quarry"]
    minute, second = Screen(config), Screen(config)
    for frequency in (15.5, 14.0, 16.5):
        motion = dataclasses.replace(config.motion, frequency=frequency)
        once = minute.step(60.0, config.feed, motion)
        rates = [second.step(1.0, config.feed, motion).undersize.mass_flow_rate for _ in range(60)]
        assert once.undersize.mass_flow_rate == pytest.approx(np.mean(rates), rel=1e-4)
    assert minute.counters()["packages_integrated"] > 0
