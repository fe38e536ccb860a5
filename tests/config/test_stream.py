"""The feed and the streams: what is accepted, what is refused and in which words."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vibroscreen.errors import InputError
from vibroscreen.stream import ROUND_OFF, SUM_TOLERANCE, Feed, Stream, checked_fractions
from vibroscreen.units import T_H


def test_feed_keeps_fractions_that_sum_to_one() -> None:
    feed = Feed(300.0 * T_H, (0.2, 0.3, 0.5))
    assert feed.mass_fraction == (0.2, 0.3, 0.5)
    assert feed.class_rates == pytest.approx(np.array([60.0, 90.0, 150.0]) * T_H, rel=1e-15)


def test_fractions_within_the_tolerance_are_normalised() -> None:
    feed = Feed(1.0, (0.2, 0.3, 0.5005))
    assert math.fsum(feed.mass_fraction) == pytest.approx(1.0, abs=1e-15)
    assert feed.mass_fraction[0] == pytest.approx(0.2 / 1.0005, rel=1e-15)


@given(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=30), st.floats(0.9991, 1.0009))
def test_normalising_twice_changes_nothing(masses: list[float], total: float) -> None:
    once = checked_fractions([total * mass / math.fsum(masses) for mass in masses])
    assert checked_fractions(once) == once


def test_fractions_are_ignored_while_the_rate_is_zero() -> None:
    feed = Feed(0.0, (math.nan, 7.0))
    assert feed.mass_flow_rate == 0.0
    assert feed.class_rates.tolist() == [0.0, 0.0]


def test_round_off_below_zero_is_zero() -> None:
    assert Feed(-0.5 * ROUND_OFF, (1.0,)).mass_flow_rate == 0.0
    assert Feed(1.0, (-0.5 * ROUND_OFF, 1.0 + 0.5 * ROUND_OFF)).mass_fraction == (0.0, 1.0)


def test_feed_of_passing_is_the_difference_of_neighbours() -> None:
    feed = Feed.of_passing(2.0, [0.0, 0.25, 0.75, 1.0])
    assert feed == Feed(2.0, (0.25, 0.5, 0.25))


def test_feed_takes_arrays() -> None:
    assert Feed(np.float64(2.0), np.array([0.25, 0.75])) == Feed(2.0, (0.25, 0.75))


@pytest.mark.parametrize(
    ("rate", "fraction", "variable", "message"),
    [
        (
            math.nan,
            (1.0,),
            "feed.mass_flow_rate",
            "feed.mass_flow_rate = nan kg/s is not a finite number (0 to 5000 kg/s): give a finite rate, 0 for no feed",
        ),
        (
            math.inf,
            (1.0,),
            "feed.mass_flow_rate",
            "feed.mass_flow_rate = inf kg/s is not a finite number (0 to 5000 kg/s): give a finite rate, 0 for no feed",
        ),
        (
            -2.0,
            (1.0,),
            "feed.mass_flow_rate",
            "feed.mass_flow_rate = -2 kg/s is out of range (0 to 5000 kg/s): give a finite rate, 0 for no feed",
        ),
        (
            True,
            (1.0,),
            "feed.mass_flow_rate",
            "feed.mass_flow_rate = True is not a number (0 to 5000 kg/s): give a finite rate, 0 for no feed",
        ),
        (
            1.0,
            (0.5, 0.6, -0.1),
            "feed.mass_fraction[3]",
            "feed.mass_fraction[3] = -0.1 is out of range (0 to 1): give a share of the mass",
        ),
        (
            1.0,
            (40.0, 60.0),
            "feed.mass_fraction[1]",
            "feed.mass_fraction[1] = 40 is out of range (0 to 1): were per cent meant? 40 per cent is 0.4",
        ),
        (
            1.0,
            (0.5, math.nan),
            "feed.mass_fraction[2]",
            "feed.mass_fraction[2] = nan is not a finite number: give a share of the mass",
        ),
        (
            1.0,
            (0.5, "0.5"),
            "feed.mass_fraction[2]",
            "feed.mass_fraction[2] = '0.5' is not a number: give a share of the mass",
        ),
        (
            1.0,
            (0.5, 0.3),
            "feed.mass_fraction",
            (
                "feed.mass_fraction sums to 0.8, not to 1 within 0.001: give the mass fractions of "
                "all size classes, or divide each by the sum"
            ),
        ),
        (
            1.0,
            0.5,
            "feed.mass_fraction",
            (
                "feed.mass_fraction = 0.5 is not a list of numbers: give 1 or more numbers "
                "(mass_fraction in a TOML file)"
            ),
        ),
    ],
)
def test_refusals_of_a_feed(
    rate: float, fraction: tuple[float, ...], variable: str, message: str
) -> None:
    with pytest.raises(InputError) as refusal:
        Feed(rate, fraction)
    assert str(refusal.value) == message
    assert refusal.value.variable == variable


@pytest.mark.parametrize(
    ("passing", "message"),
    [
        ((1.0,), "feed.passing has fewer than 2 values: give one at every class limit"),
        (
            (0.1, 0.5, 1.0),
            (
                "feed.passing[1] = 0.1 is not 0, all of the feed lies in the classes: "
                "add a finer limit to the size classes"
            ),
        ),
        (
            (0.0, 0.5, 0.9),
            (
                "feed.passing[3] = 0.9 is not 1, all of the feed lies in the classes: "
                "add a coarser limit to the size classes"
            ),
        ),
        (
            (0.0, 0.5, 0.4, 1.0),
            (
                "feed.passing[3] = 0.4 is smaller than feed.passing[2] = 0.5: passing never falls "
                "with size, list it finest limit first"
            ),
        ),
    ],
)
def test_refusals_of_passing(passing: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError) as refusal:
        Feed.of_passing(1.0, passing)
    assert str(refusal.value) == message


def test_count_of_classes_is_named_on_both_sides() -> None:
    feed = Feed(1.0, (0.5, 0.5))
    feed.check_classes(2)
    with pytest.raises(InputError) as refusal:
        feed.check_classes(12)
    assert str(refusal.value) == (
        "feed.mass_fraction has 2 values, the screen has 12 size classes: "
        "give one fraction a class, finest first"
    )


def test_sum_is_refused_just_beyond_the_tolerance() -> None:
    Feed(1.0, (0.5, 0.5 + 0.99 * SUM_TOLERANCE))
    with pytest.raises(InputError):
        Feed(1.0, (0.5, 0.5 + 1.01 * SUM_TOLERANCE))


def test_stream_gives_rates_and_passing() -> None:
    stream = Stream(4.0, np.array([0.25, 0.5, 0.25]))
    assert stream.class_rates.tolist() == [1.0, 2.0, 1.0]
    assert stream.passing.tolist() == [0.0, 0.25, 0.75, 1.0]


def test_stream_that_does_not_flow_repeats_the_last_fractions() -> None:
    last = np.array([0.25, 0.75])
    flowing = Stream.of_class_rates(np.array([1.0, 3.0]), np.array([1.0, 0.0]))
    assert flowing.mass_flow_rate == 4.0
    assert flowing.mass_fraction.tolist() == [0.25, 0.75]
    resting = Stream.of_class_rates(np.zeros(2), last)
    assert resting.mass_flow_rate == 0.0
    assert resting.mass_fraction.tolist() == last.tolist()
    assert resting.mass_fraction is not last
