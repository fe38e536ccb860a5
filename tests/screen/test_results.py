"""Results by deck: the same in steps, steady states and tables; alarms with their reasons."""

from __future__ import annotations

import dataclasses
import pickle
import re

import numpy as np
import pytest

from tests.fixed import FIXED
from tests.places import DATA, SCREENS
from vibroscreen import (
    Feed,
    Motion,
    Screen,
    ScreenConfig,
    SteadyResult,
    StepResult,
    figures,
    solve_steady_many,
)
from vibroscreen.errors import TEXT
from vibroscreen.kernels import state
from vibroscreen.kernels.outputs import deep_in_apertures
from vibroscreen.motion import conveying_regime
from vibroscreen.sections import Displacement, Material
from vibroscreen.sweep import ALARM_NAMES
from vibroscreen.units import DEG, MM

# With the numbers under which it printed what nobody wants.
DOUBLE = ScreenConfig.load(DATA / "double_deck.toml").replace(**FIXED)
BOX = [figure.scalar for figure in figures.figures_of(figures.BoxFigures)]
DECK = [figure.scalar for figure in figures.DECK]
# What a steady scene gives to the bit, whatever packages average.
EXACT = {
    *("depth_feed", "transport_velocity", "throw_number", "acceleration_number", "aperture"),
    *("exciter_force", "depth_over_aperture_feed"),
}


def settled(config: ScreenConfig) -> tuple[StepResult, SteadyResult]:
    """A step of a screen that is steady, and its steady state."""
    screen = Screen(config)
    for _ in range(60):
        result = screen.step(5.0)
    return result, screen.solve_steady()


def test_the_headline_of_a_double_deck_is_that_of_its_top_deck() -> None:
    """Not product through 10 mm over feed below 20 mm, which is 0.43 and nobody's efficiency."""
    step, steady = settled(DOUBLE)
    fed, upper = steady.feed.class_rates, DOUBLE.size_classes.upper
    product, middle = (s.class_rates for s in (steady.undersize, *steady.intermediate))
    below_20, below_10 = upper <= 20.0 * MM * (1.0 + 1e-9), upper <= 10.0 * MM * (1.0 + 1e-9)
    assert product[below_20].sum() / fed[below_20].sum() == pytest.approx(0.43, abs=5e-3)
    passed = product + middle
    top = passed[below_20].sum() / fed[below_20].sum()
    lower = product[below_10].sum() / passed[below_10].sum()
    assert top == pytest.approx(0.628, abs=2e-3)
    assert lower == pytest.approx(0.912, abs=3e-3)
    for result in (step, steady):
        assert result.undersize_recovery == result.efficiency == result.decks[0].efficiency
        found = [deck.efficiency for deck in result.decks]
        assert found == pytest.approx([top, lower], abs=1e-4)
    over = steady.oversize.class_rates[below_20].sum() / steady.oversize.mass_flow_rate
    wrong = steady.decks[0].misplaced_undersize, steady.decks[1].misplaced_undersize
    between = middle[below_10].sum() / middle.sum()
    assert wrong == pytest.approx((over, between), rel=1e-9)
    assert [deck.misplaced_oversize for deck in steady.decks] == [0.0, 0.0]
    assert step.alarms == steady.alarms == ()


@pytest.mark.parametrize("name", ["quarry", "two_deck", "banana", "double_deck"])
def test_a_steady_scene_gives_the_numbers_of_a_steady_state(name: str) -> None:
    folder = DATA if name == "double_deck" else SCREENS
    config = ScreenConfig.load(folder / f"{name}.toml")
    step, steady = settled(config)
    tolerance = config.solver.tolerance
    for key in BOX:
        if key == "balance_error":
            continue
        one, other = getattr(step, key), getattr(steady, key)
        assert one == pytest.approx(other, rel=1e-9 if key in EXACT else 5.0 * tolerance), key
    for ours, theirs in zip(step.decks, steady.decks, strict=True):
        for key in DECK:
            exact = key in EXACT and (ours.deck == 1 or "depth" not in key)
            wanted = pytest.approx(getattr(theirs, key), rel=1e-9 if exact else 20.0 * tolerance)
            assert getattr(ours, key) == wanted, (ours.deck, key)
        for stream in ("feed", "undersize", "oversize"):
            one, other = getattr(ours, stream), getattr(theirs, stream)
            allowed = 2.0 * tolerance * config.feed.mass_flow_rate
            assert one.class_rates == pytest.approx(other.class_rates, abs=allowed)
    assert step.alarm_reasons.keys() == steady.alarm_reasons.keys()


def test_decks_hand_their_streams_on() -> None:
    step, steady = settled(DOUBLE)
    for result in (step, steady):
        top, lower = result.decks
        assert (lower.feed.class_rates == top.undersize.class_rates).all()
        for deck in result.decks:
            gone = deck.undersize.class_rates + deck.oversize.class_rates
            assert deck.feed.class_rates == pytest.approx(gone, rel=1e-3, abs=1e-9)
            for name in ("feed", "undersize", "oversize"):
                rate = getattr(deck, name).mass_flow_rate
                assert getattr(deck, f"{name}_rate") == pytest.approx(rate, rel=1e-12)
            curve = deck.partition
            assert curve.cut_size == pytest.approx(deck.cut_size, rel=1e-12)
            assert curve.ecart_probable == pytest.approx(deck.ecart_probable, rel=1e-9)
            assert deck.imperfection == deck.ecart_probable / deck.cut_size
        through = lower.undersize.class_rates
        assert through == pytest.approx(result.undersize.class_rates, rel=1e-12)
    depth = [profile.depth for profile in steady.profiles]
    for deck, along in zip(steady.decks, depth, strict=True):
        assert deck.depth_discharge == pytest.approx(along[-1], rel=1e-4)
        over = deck.depth_discharge / DOUBLE.decks[deck.deck - 1].panels[-1].aperture
        assert deck.depth_over_aperture_discharge == pytest.approx(over, rel=1e-12)
    assert steady.decks[0].depth_feed == pytest.approx(depth[0][0], rel=1e-12)
    assert 0.0 < steady.decks[1].depth_feed < depth[1][1]


def test_sizes_of_products_by_hand() -> None:
    """With one size a class a stream lies evenly in every class."""
    config = ScreenConfig.load(SCREENS / "two_deck.toml")
    classes = dataclasses.replace(config.size_classes, subdivision=1)
    steady = Screen(config.replace(size_classes=classes)).solve_steady()
    edges = np.array(classes.edges)
    for share, key in ((0.8, "p80"), (0.5, "p50")):
        fed = np.concatenate([[0.0], np.cumsum(steady.feed.mass_fraction)])
        wanted = np.interp(share, fed, edges)
        assert getattr(steady, f"feed_{key}") == pytest.approx(wanted, rel=1e-9)
        for name in ("undersize", "oversize"):
            wanted = np.interp(share, getattr(steady, name).passing, edges)
            assert getattr(steady, f"{name}_{key}") == pytest.approx(wanted, rel=1e-9)
    wanted = np.interp(0.8, steady.intermediate[0].passing, edges)
    assert steady.intermediate_p80 == pytest.approx((wanted,), rel=1e-9)


def test_products_end_at_the_apertures_inside_a_class() -> None:
    """20 mm lies on a limit, 18 mm inside of a class: nothing that passed is coarser."""
    panel = dataclasses.replace(DOUBLE.decks[1].panels[0], aperture=11.0 * MM)
    decks = (DOUBLE.decks[0], dataclasses.replace(DOUBLE.decks[1], panels=(panel,)))
    steady = Screen(DOUBLE.replace(decks=decks)).solve_steady()
    assert steady.undersize_p50 < steady.undersize_p80 < 11.0 * MM
    assert steady.intermediate_p80[0] < 20.0 * MM < steady.oversize_p80


def test_power_and_motion_of_the_box_by_hand() -> None:
    steady = Screen(ScreenConfig.default()).solve_steady()
    acceleration = 0.005 * (2.0 * np.pi * 15.5) ** 2
    assert steady.exciter_force == pytest.approx(6000.0 * acceleration, rel=1e-12)
    assert steady.acceleration_number == pytest.approx(acceleration / 9.81, rel=1e-12)
    assert steady.drive_power > 0.0


def test_many_give_all_figures_of_one_by_one() -> None:
    rates = np.array([50.0, 97.0, 250.0])
    table = solve_steady_many(DOUBLE, {"feed.mass_flow_rate": rates})
    for k, rate in enumerate(rates):
        config = DOUBLE.replace(feed=Feed(rate, DOUBLE.feed.mass_fraction))
        steady = Screen(config).solve_steady()
        for key in BOX:
            assert getattr(table, key)[k] == pytest.approx(getattr(steady, key), rel=1e-12), key
        for ours, theirs in zip(table.decks, steady.decks, strict=True):
            for key in DECK:
                wanted = pytest.approx(getattr(theirs, key), rel=1e-9)
                assert getattr(ours, key)[k] == wanted, (ours.deck, key)
        assert table.intermediate_p80[k] == pytest.approx(steady.intermediate_p80, rel=1e-12)
        assert table.alarm_reasons(k) == steady.alarm_reasons
        bits = {name for b, name in enumerate(ALARM_NAMES) if table.alarms[k] >> b & 1}
        assert bits == set(steady.alarms)
    assert table.alarms.tolist() == [0, 0, 1]
    frame = table.frame()
    assert (frame["deck[2].efficiency"] == table.decks[1].efficiency).all()
    assert frame["alarm.bed_depth"].tolist() == [False, False, True]
    with pytest.raises(AttributeError, match="has no streams by deck"):
        _ = table.decks[0].feed


def test_a_steady_result_that_is_read_later_is_that_of_its_own_feed() -> None:
    """What is asked of it after another solution, and of a copy of it that was never read."""
    screen, less = Screen(DOUBLE), Feed(25.0, DOUBLE.feed.mass_fraction)
    first = screen.solve_steady()
    copied = pickle.loads(pickle.dumps(first))
    second = screen.solve_steady(less, Motion.linear(0.004, 16.0, 0.8))
    alone = Screen(DOUBLE).solve_steady()
    for late in (first, copied):
        assert late.alarms == alone.alarms
        assert late.box_frame().equals(alone.box_frame())
        assert late.deck_frame().equals(alone.deck_frame())
        assert late.frame().equals(alone.frame())
        assert (late.partition.to_oversize == alone.partition.to_oversize).all()
        assert (late.profiles[1].load == alone.profiles[1].load).all()
        assert late.residence_time == alone.residence_time
    assert second.hold_up < 0.9 * first.hold_up
    assert "efficiency=" in repr(first)
    with pytest.raises(AttributeError, match="'SteadyResult' object has no attribute 'effciency'"):
        _ = first.effciency


def test_results_are_kept_and_shown() -> None:
    pytest.importorskip("matplotlib")
    step, steady = settled(DOUBLE)
    table = solve_steady_many(DOUBLE, {"feed.mass_flow_rate": np.array([50.0, 250.0])})
    again, many = pickle.loads(pickle.dumps(steady)), pickle.loads(pickle.dumps(table))
    assert (again.deck_frame() == steady.deck_frame()).all(axis=None)
    assert (again.profile.depth == steady.profile.depth).all()
    assert (many.frame() == table.frame()).all(axis=None)
    assert pickle.loads(pickle.dumps(step)).decks[1].efficiency == step.decks[1].efficiency
    for result in (step, steady):
        html = result._repr_html_()
        assert "deck[2]" in html
        assert "no alarms" in html
        assert result.frame().index.name == "size_class"
        assert result.box_frame().loc["drive_power", "unit"] == "W"
    assert "deck[2].efficiency" in table._repr_html_()
    gradation, curves, recovery, bed = steady.plot().axes
    passing = {str(line.get_label()): line.get_ydata() for line in gradation.lines}
    assert list(passing) == ["feed", "undersize", "intermediate 1", "oversize"]
    assert passing["undersize"] == pytest.approx(100.0 * steady.undersize.passing[1:])
    assert recovery.lines[1].get_ydata() == pytest.approx(100.0 * steady.profiles[1].recovery)
    assert bed.lines[0].get_ydata() == pytest.approx(1e3 * steady.profiles[0].depth)
    assert curves.lines[0].get_ydata() == pytest.approx(
        100.0 * steady.decks[0].partition.to_oversize
    )
    assert len(step.plot().axes) == 2
    (axes,) = table.plot("feed.mass_flow_rate").axes
    assert axes.get_xlabel() == "feed.mass_flow_rate"


def test_a_notebook_says_why_a_design_was_refused() -> None:
    rates = np.array([50.0, 1e9])
    table = solve_steady_many(DOUBLE, {"feed.mass_flow_rate": rates}, refused="mark")
    assert "<li>design 1: feed.mass_flow_rate = " in table._repr_html_()


def test_the_bed_along_a_deck_adds_up() -> None:
    """What lies there and what passed, by layer and class, on a deck whose panels differ too."""
    lower = DOUBLE.decks[1]
    (panel,) = lower.panels
    halves = tuple(
        dataclasses.replace(panel, length=part * panel.length, velocity_factor=factor)
        for part, factor in ((0.4, 1.0), (0.6, 1.7))
    )
    config = DOUBLE.replace(decks=(DOUBLE.decks[0], dataclasses.replace(lower, panels=halves)))
    steady = Screen(config).solve_steady()
    for deck, profile in zip(steady.decks, steady.profiles, strict=True):
        assert profile.recovery[0] == 0.0
        assert (np.diff(profile.recovery) >= 0.0).all()
        assert profile.recovery[-1] == pytest.approx(deck.efficiency, abs=config.solver.tolerance)
        assert profile.height[:, 0] == pytest.approx(0.0)
        assert profile.height[:, -1] == pytest.approx(profile.depth)
        whole = profile.content(range(config.size_classes.count))
        there = profile.load.sum(axis=2) > 0.0
        assert whole[there] == pytest.approx(1.0)
        assert np.isnan(whole[~there]).all()
        part = profile.content(3)[there] * profile.load.sum(axis=2)[there]
        assert part == pytest.approx(profile.load[..., 3][there])


def test_what_there_is_nothing_of_is_nan_in_a_steady_state() -> None:
    """A feed without undersize has no efficiency, and says so."""
    share = (0.0,) * (DOUBLE.size_classes.count - 1) + (1.0,)
    steady = Screen(DOUBLE).solve_steady(Feed(50.0, share))
    assert np.isnan(steady.efficiency)
    assert np.isnan(steady.undersize_p80)
    assert steady.decks[1].feed_rate == 0.0
    reason = "nothing finer than its aperture of 0.02 m came to deck 1"
    assert reason in steady.alarm_reasons["alarm.performance"]


# --- alarms --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("density", "times"),
    [(600.0, 4.0), (800.0, 4.0), (1000.0, 4.25), (1600.0, 5.0), (2400.0, 5.0)],
)
def test_the_limit_of_bed_depth_follows_the_bulk_density(density: float, times: float) -> None:
    assert deep_in_apertures(density) == pytest.approx(times, rel=1e-12)
    base = ScreenConfig.default()
    coarse = (0.0,) * 11 + (1.0,)
    for depth, alarm in ((0.99 * times * 16.0 * MM, False), (1.01 * times * 16.0 * MM, True)):
        config = base.replace(
            material=Material(bulk_density=density),
            displacement=Displacement("prescribed", 0.3),
            feed=Feed(density * depth * 2.4 * 0.3, coarse),
        )
        steady = Screen(config).solve_steady()
        assert steady.depth_discharge == pytest.approx(depth, rel=1e-9)
        assert ("alarm.bed_depth" in steady.alarms) is alarm
        if alarm:
            said = steady.alarm_reasons["alarm.bed_depth"]
            assert f"more than {times:g} apertures ({times * 0.016:.4g} m)" in said
            assert "the bed of deck 1 is" in said


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"feed.mass_flow_rate": 600.0}, r"bed of deck 1 is 0\.5208 m deep, more than 0\.5 m"),
        ({"displacement.velocity": 3.5}, r"bed of deck 1 rides at 3\.5 m/s, faster than 3 m/s"),
        ({"motion.frequency": 25.0}, r"K = 12\.58 .* is above 10: check the frequency"),
        ({}, ""),
    ],
    ids=["depth", "velocity", "motion", "none"],
)
def test_what_is_not_built_is_told(changes: dict[str, float], said: str) -> None:
    config = ScreenConfig.default().replace(displacement=Displacement("prescribed", 0.3))
    table = solve_steady_many(config, {"feed.mass_flow_rate": 80.0, **changes})
    screen = Screen(config)
    inputs = screen.record("input")
    for name, value in changes.items():
        setattr(inputs, name.replace(".", "_"), value)
    step = screen.step(5.0)
    for reasons in (table.alarm_reasons(0), step.alarm_reasons):
        assert ("alarm.plausibility" in reasons) is bool(said)
        assert re.search(said, reasons.get("alarm.plausibility", ""))


def bed_screen(alpha: float, motion: Motion, friction: float = 0.5) -> ScreenConfig:
    base = ScreenConfig.default()
    panel = dataclasses.replace(base.decks[0].panels[0], inclination=alpha * DEG)
    return base.replace(
        decks=(dataclasses.replace(base.decks[0], panels=(panel,)),),
        displacement=Displacement("bed"),
        material=Material(friction_deck=friction),
        motion=motion,
    )


@pytest.mark.parametrize("sense", ["with_flow", "against_flow"])
@pytest.mark.parametrize("alpha", [15.0, 18.0, 20.0])
def test_a_circular_screen_conveys_without_alarm(alpha: float, sense: str) -> None:
    """What the model was checked for: throw numbers up to 4.5, slopes up to a bed's friction."""
    motion = Motion.circular(0.004, 15.0, sense)
    regime = conveying_regime(motion, alpha * DEG, 0.5, "bed")
    step, steady = settled(bed_screen(alpha, motion))
    for result in (step, steady):
        assert result.transport_velocity == pytest.approx(regime.velocity, rel=1e-12)
        assert 3.0 < result.throw_number < 4.5
        assert "alarm.transport" not in result.alarms


def test_transport_outside_of_what_was_checked_is_told() -> None:
    fast = Screen(bed_screen(18.0, Motion.circular(0.005, 16.0, "with_flow"))).step(5.0)
    assert re.search(
        r"throw number of deck 1 is 5\.4\d+, above 4\.5, up to which the displacement model bed",
        fast.alarm_reasons["alarm.transport"],
    )
    with pytest.warns(UserWarning, match="take its velocity as a guess"):
        config = bed_screen(18.0, Motion.circular(0.004, 15.0, "with_flow"), 0.3)
    steep = Screen(config).step(5.0)
    said = (
        r"deck 1 is inclined by 18 deg \(slope 0\.3249\), more than the friction of a bed \(0\.265"
    )
    assert re.search(said, steep.alarm_reasons["alarm.transport"])


def test_a_bed_that_does_not_convey_is_told() -> None:
    uphill = Motion.linear(0.005, 15.5, 135.0 * DEG)
    step = Screen(ScreenConfig.default()).step(10.0, motion=uphill)
    assert step.transport_velocity == 0.0
    assert "does not convey the bed down deck 1" in step.alarm_reasons["alarm.transport"]


def test_every_reason_has_its_text() -> None:
    assert set(state.REASONS) <= set(TEXT)
    said = [figure.name for figure in (*figures.BOX, *figures.DECK, *figures.BETWEEN)]
    assert all(name and " " not in name for name in said)
