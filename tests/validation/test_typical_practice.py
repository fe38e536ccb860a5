"""Numbers of typical practice: feeds, shelves, and the recommended constants beside the rules."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import typical_practice as example
from typical_practice import Answer, GradedFeed, Grid, TypicalFeed, deck_length, shelf_of


@pytest.fixture(scope="module")
def answer() -> Answer:
    """The recommended constants over every third load."""
    return Answer.to(Grid(loads=example.LOADS[::3]), example.RECOMMENDED)


@pytest.mark.parametrize("oversize", example.OVERSIZE)
@pytest.mark.parametrize("half", example.HALF_SIZE)
def test_graded_feed(oversize: float, half: float) -> None:
    """Passing at the aperture, at half of it and at the top; rising, with one slope at a."""
    feed = GradedFeed(oversize, half)
    assert_allclose(feed(np.array([0.5, 1.0])), (1.0 - oversize) * np.array([half, 1.0]))
    assert float(feed(example.LARGEST)) == pytest.approx(1.0)
    assert (np.diff(feed(np.linspace(0.0, 8.0, 500))) >= 0.0).all()
    below, at, above = feed(np.array([1.0 - 1e-5, 1.0, 1.0 + 1e-5]))
    assert above - at == pytest.approx(at - below, rel=1e-3)


def test_typical_feed_is_that_of_the_default_screen() -> None:
    """45 % oversize; two thirds of the undersize finer than half the aperture."""
    feed = TypicalFeed()
    assert feed.oversize == pytest.approx(0.454, abs=1e-3)
    assert feed.half == pytest.approx(0.653, abs=1e-3)


def test_shelf() -> None:
    """None where the curve steepens all the way; 0 where it is level before it rises again."""
    middle = 0.5 * (example.EDGES[1 : example.BELOW + 1] + example.EDGES[: example.BELOW])
    assert shelf_of(middle**6) == 1.0
    step = np.where(middle < 0.3, middle, np.where(middle < 0.7, 0.3, 0.3 + (middle - 0.7) * 2.0))
    assert shelf_of(step) == pytest.approx(0.0, abs=1e-12)


def test_deck_length() -> None:
    """6 m from 16 mm on, shorter for fine apertures."""
    assert deck_length(0.016) == example.LENGTH
    assert 2.4 < deck_length(example.APERTURES[0]) < 4.0


def test_recommended_meets_the_rules(answer: Answer) -> None:
    """The targets: 0.03 over apertures and loads, 0.045 with the other feeds; no shelf."""
    assert answer.typical_rmse < 0.03
    assert answer.others_rmse < 0.045
    assert answer.shelf.min() > 0.95
    assert np.diff(answer.partition).min() > -1e-4
    assert (np.diff(answer.recovery, axis=2) < 0.0).all()


def test_quarry_screen() -> None:
    """0.93 to 0.95 of the undersize at 300 t/h; cut of 0.75 to 0.95 a up to three times that."""
    frame = example.quarry()
    assert 0.93 < frame.recovery[300.0] < 0.95
    cut = frame["cut/a"][:900.0]
    assert ((cut > 0.75) & (cut < 0.95)).all()
    assert frame.loc[300.0, "depth/a"] < 4.0
    assert 0.2 < frame.loc[300.0, "velocity m/s"] < 0.5


def test_what_changes_nothing_and_what_does() -> None:
    """Width with feed, and all lengths, change nothing; length, width and open area help."""
    frame = example.trends()
    usual = frame.recovery["as it is"]
    assert frame.recovery["twice as wide, twice the feed"] == pytest.approx(usual, abs=1e-4)
    assert frame.recovery["all lengths times 3"] == pytest.approx(usual, abs=1e-3)
    assert frame.recovery["1.5 times the feed"] < usual
    assert frame.recovery["open area 0.45"] < usual < frame.recovery["open area 0.65"]
    assert usual < frame.recovery["1.5 times as wide"] < frame.recovery["1.5 times as long"]
