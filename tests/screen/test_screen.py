"""The objects: Screen, its results and refusals, state, threads, batches, performance."""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import pytest

from tests.fixed import fixed_screen
from tests.places import SCREENS
from vibroscreen import (
    ConfigError,
    Feed,
    Harmonic,
    InputError,
    Motion,
    Screen,
    ScreenConfig,
    performance,
)
from vibroscreen.kernels import state
from vibroscreen.sections import (
    Bed,
    Deck,
    Displacement,
    Material,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, MM

DEFAULT = fixed_screen()
SHARE = DEFAULT.feed.mass_fraction
PRESCRIBED = Displacement("prescribed", 0.3)


def variant(**changes: object) -> ScreenConfig:
    return dataclasses.replace(DEFAULT, **changes)


@pytest.fixture
def screen() -> Screen:
    return Screen(variant(displacement=PRESCRIBED))


def whole_state(screen: Screen) -> bytes:
    """All that lies in the buffer but for scratch: what a refused step must not touch."""
    return screen.buffer[: screen.layout.section["work"].start].tobytes()


# --- refusals ----------------------------------------------------------------------------------
def put(field: str, name: str | int, value: float):
    """A refusal by a number written into the buffer, as an FMU does."""
    index = name if isinstance(name, int) else state.KINDS[field].index(name)
    return lambda screen: screen.view(field).reshape(-1).__setitem__(index, value)


REFUSALS = {
    "feed nan": (
        put("input", "feed_mass_flow_rate", np.nan),
        "feed.mass_flow_rate",
        "is not a finite",
    ),
    "feed inf": (
        put("input", "feed_mass_flow_rate", np.inf),
        "feed.mass_flow_rate",
        "is not a finite",
    ),
    "feed negative": (
        put("input", "feed_mass_flow_rate", -1.0),
        "feed.mass_flow_rate",
        r"= -1 kg/s is out of range \(0 to 5000 kg/s\): give a finite rate",
    ),
    "fraction nan": (put("fraction", 2, np.nan), "feed.mass_fraction[3]", "is not a finite number"),
    "fraction negative": (
        put("fraction", 0, -0.01),
        "feed.mass_fraction[1]",
        r"= -0.01 is out of range \(0 to 1\): give a share of the mass",
    ),
    "fraction above one": (put("fraction", 11, 1.1), "feed.mass_fraction[12]", "is out of range"),
    "sum": (put("fraction", 1, 0.9), "feed.mass_fraction", "sums to .*not to 1 within 0.001"),
    "frequency": (
        put("input", "motion_frequency", 930.0),
        "motion.frequency",
        r"= 930 Hz is out of range \(0 to 100 Hz\): were 1/min meant. 930 1/min is 15.5 Hz",
    ),
    "frequency negative": (
        put("input", "motion_frequency", -1.0),
        "motion.frequency",
        "is out of range",
    ),
    "amplitude": (
        put("input", "motion_amplitude", 5.0),
        "motion.amplitude",
        "were millimetres meant",
    ),
    "throw angle": (
        put("input", "motion_throw_angle", 45.0),
        "motion.throw_angle",
        r"were degrees meant. 45 deg is 0\.785398 rad",
    ),
    "ellipticity": (
        put("input", "motion_ellipticity", -1.5),
        "motion.ellipticity",
        "is out of range",
    ),
    "velocity": (
        put("input", "displacement_velocity", -0.1),
        "displacement.velocity",
        "cannot convey upwards",
    ),
    "friction": (
        put("parameter", "material_friction_deck", np.nan),
        "material.friction_deck",
        "is not a finite",
    ),
    "u": (put("parameter", "passage_velocity", -1.0), "passage.velocity", "is out of range"),
    "w": (
        put("parameter", "segregation_velocity", -1.0),
        "segregation.velocity",
        "is out of range",
    ),
    "dilation": (
        put("parameter", "segregation_dilation", 20.0),
        "segregation.dilation",
        "were millimetres meant",
    ),
    "proportion": (
        put("parameter", "segregation_proportion", 2.0),
        "segregation.proportion",
        "is out of range",
    ),
    "open area": (put("panel", "open_area", 55.0), "deck[1].panel[1].open_area", "is out of range"),
    "inclination": (
        put("panel", "inclination", 5.0),
        "deck[1].panel[1].inclination",
        "were degrees meant",
    ),
    "velocity factor": (
        put("panel", "velocity_factor", -1.0),
        "deck[1].panel[1].velocity_factor",
        "is out of range",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refused_step_names_the_variable_and_keeps_the_state(name: str, screen: Screen) -> None:
    break_it, variable, text = REFUSALS[name]
    screen.step(7.0)
    good = screen.state
    break_it(screen)
    before = whole_state(screen)
    with pytest.raises(InputError, match=text) as caught:
        screen.advance(1.0)
    assert caught.value.variable == variable
    assert str(caught.value).startswith(variable)
    assert whole_state(screen) == before
    # and nothing hidden is broken either: go on as if it had never been
    screen.state = good
    twin = Screen(screen.config)
    twin.step(7.0)
    screen.step(9.0)
    twin.step(9.0)
    assert screen.state == twin.state


def test_the_first_offender_is_named(screen: Screen) -> None:
    screen.view("fraction")[[4, 7]] = -1.0
    screen.record("input").motion_amplitude = np.nan
    with pytest.raises(InputError) as caught:
        screen.advance(1.0)
    assert caught.value.variable == "motion.amplitude"
    screen.record("input").motion_amplitude = 0.005
    with pytest.raises(InputError) as caught:
        screen.advance(1.0)
    assert caught.value.variable == "feed.mass_fraction[5]"


def test_too_steep_for_the_rigid_body_while_running() -> None:
    screen = Screen(DEFAULT)
    screen.step(7.0)
    screen.record("panel")[0, 0].inclination = 30.0 * DEG
    before = whole_state(screen)
    with pytest.raises(
        InputError, match=r"inclination = 0.523599 rad \(30 deg, slope 0.5774\)"
    ) as e:
        screen.step(1.0)
    assert "friction at the base (0.5)" in str(e.value)
    assert 'displacement.model = "bed" or "prescribed"' in str(e.value)
    assert e.value.variable == "deck[1].panel[1].inclination"
    assert whole_state(screen) == before
    screen.record("panel")[0, 0].inclination = 5.0 * DEG
    screen.step(1.0)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_step_size_is_positive(dt: float, screen: Screen) -> None:
    screen.step(3.0)
    before = whole_state(screen)
    with pytest.raises(InputError, match=r"dt = .* s is not a finite positive time") as caught:
        screen.step(dt, Feed(10.0, SHARE), Motion.linear(0.004, 12.0, 0.7))
    assert caught.value.variable == "dt"
    assert whole_state(screen) == before


def test_a_feed_that_is_hardly_a_number_leaves_outputs_finite(screen: Screen) -> None:
    screen.step(30.0)
    figures = [state.OUTPUT.index(name) for name in ("undersize_recovery", "efficiency")]
    before = screen.view("output")[figures]
    assert (before > 0.0).all()
    screen.step(1.0, Feed(5e-324, SHARE))
    assert np.isfinite(screen.view("output")).all()
    assert (screen.view("output")[figures] == before).all()


def test_the_longest_step(screen: Screen) -> None:
    """A bed that only sorts comes to rest within 1e9 s; to ask for more is an error of some tool."""
    closed = variant(
        passage=Passage("gaudin", velocity=0.0), displacement=Displacement("prescribed", 0.0)
    )
    for any_screen in (screen, Screen(closed)):
        any_screen.step(3.0, Feed(10.0, SHARE))
        before = whole_state(any_screen)
        with pytest.raises(InputError, match=r"dt = 1e\+150 s is more than 1e\+09 s: ") as caught:
            any_screen.step(1e150, Feed(0.0))
        assert caught.value.variable == "dt"
        assert whole_state(any_screen) == before
        any_screen.step(1e9, Feed(0.0))


def test_refused_step_forgets_the_harmonics_that_came_with_it(screen: Screen) -> None:
    screen.step(3.0)
    before = whole_state(screen)
    motion = Motion.harmonics(15.0, [Harmonic(1, along=0.003, normal=0.003)])
    with pytest.raises(InputError):
        screen.step(-1.0, None, motion)
    assert whole_state(screen) == before


def test_refused_step_of_the_wrong_type_keeps_the_state(screen: Screen) -> None:
    screen.step(3.0)
    before = whole_state(screen)
    with pytest.raises((InputError, TypeError)):
        screen.step("1", Feed(10.0, SHARE))
    assert whole_state(screen) == before


def test_feed_of_another_number_of_classes(screen: Screen) -> None:
    before = whole_state(screen)
    with pytest.raises(InputError, match=r"feed\.mass_fraction has 2 values, the screen has 12"):
        screen.step(1.0, Feed(10.0, (0.5, 0.5)), Motion.linear(0.001, 12.0, 0.7))
    assert whole_state(screen) == before
    screen.step(1.0, Feed(0.0, (0.5, 0.5)))  # ignored while nothing is fed


def test_round_off_of_another_tool_is_taken(screen: Screen) -> None:
    screen.record("input").feed_mass_flow_rate = -1e-12
    screen.advance(1.0)
    assert screen.result().hold_up == 0.0
    fraction = screen.view("fraction")
    fraction[:] = 0.0
    fraction[0], fraction[1], fraction[2] = 1.0004, -1e-12, 0.0
    screen.record("input").feed_mass_flow_rate = 10.0
    with pytest.raises(InputError, match=r"feed.mass_fraction\[1\]"):
        screen.advance(1.0)
    fraction[0] = 0.9995
    screen.advance(1.0)
    assert screen.balance().fed.to_numpy() == pytest.approx([10.0] + [0.0] * 11, rel=1e-14)
    assert screen.result().hold_up + screen.balance().undersize.sum() == pytest.approx(10.0)


def test_fractions_are_ignored_while_nothing_is_fed(screen: Screen) -> None:
    screen.record("input").feed_mass_flow_rate = 0.0
    screen.view("fraction")[:] = np.nan
    screen.advance(1.0)
    assert screen.result().undersize.mass_fraction == pytest.approx(SHARE, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"decks": (Deck(),) * 5}, "deck: 5 decks are more than a box has: give at most 4"),
        (
            {"decks": (Deck(), Deck(2.0, (Panel(6.0 / 65),) * 65))},
            r"deck\[2\].panel: 65 panels are more than a deck can have, 64",
        ),
        ({"solver": Solver(packages=20)}, "solver.packages = 20 is too little room for the 64"),
    ],
)
def test_configurations_that_the_engine_cannot_run(changes: dict, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        Screen(variant(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"decks": (Deck(2.4, (Panel(open_area=0.0),)),)},
        {"decks": (Deck(2.4, (Panel(velocity_factor=0.0),)),)},
        {"material": Material(friction_deck=0.0)},
        {"material": Material(friction_deck=20.0)},
        {"passage": Passage(velocity=0.0)},
        {"segregation": Segregation(velocity=0.0)},
        {"decks": (Deck(2.4, (Panel(inclination=45.0 * DEG),)),)},
        {"feed": Feed(0.0)},
        {"decks": (Deck(),) * 4},
        {"decks": (Deck(2.0, (Panel(6.0 / 64),) * 64), Deck())},
    ],
)
def test_what_the_configuration_takes_the_engine_runs(changes: dict) -> None:
    screen = Screen(variant(displacement=PRESCRIBED, **changes))
    result = screen.step(10.0)
    assert np.isfinite(result.hold_up)


def test_blank_plate_passes_nothing() -> None:
    blank = variant(displacement=PRESCRIBED, decks=(Deck(2.4, (Panel(open_area=0.0),)),))
    assert not Screen(blank).solve_steady().recovery.any()


# --- solve_steady ------------------------------------------------------------------------------
def test_steady_result_is_consistent() -> None:
    screen = Screen(DEFAULT)
    result = screen.solve_steady()
    feed = DEFAULT.feed
    total = result.undersize.class_rates + result.oversize.class_rates
    assert total == pytest.approx(feed.class_rates, rel=1e-12)
    assert result.undersize.class_rates == pytest.approx(result.recovery * feed.class_rates)
    assert result.recovery[7:] == pytest.approx(np.zeros(5), abs=0.0)
    assert (np.diff(result.recovery) <= 1e-12).all()
    assert result.residence_time == pytest.approx(6.0 / result.transport_velocity, rel=1e-14)
    profile = result.profile
    assert profile.load.shape[0] == profile.position.size == 65
    whole = profile.load.sum(axis=1) + profile.passed
    carried = 2.4 * result.transport_velocity
    assert whole * carried == pytest.approx(np.tile(feed.class_rates, (65, 1)), rel=1e-11)
    assert profile.passed[-1] * carried == pytest.approx(result.undersize.class_rates, abs=1e-2)
    assert profile.depth[0] == pytest.approx(feed.mass_flow_rate / carried / 1600.0, rel=1e-12)
    frame = result.frame()
    assert list(frame.index) == list(range(1, 13))
    assert frame.feed_kg_s.sum() == pytest.approx(300.0 / 3.6, rel=1e-12)
    assert len(profile.frame()) == profile.load.size
    # 16 mm is a limit of the classes: finer classes are the undersize
    fine = result.undersize.class_rates[:7].sum() / feed.class_rates[:7].sum()
    assert result.undersize_recovery == pytest.approx(fine, rel=1e-12)
    assert result.efficiency == pytest.approx(fine, rel=1e-12)


def test_steady_solution_leaves_the_screen_alone(screen: Screen) -> None:
    screen.step(5.0)
    before = whole_state(screen)
    screen.solve_steady(Feed(30.0, SHARE), Motion.linear(0.004, 12.0, 0.7))
    screen.sieve_batch(40.0, SHARE, times=[1.0, 5.0])
    _ = screen.solve_steady().profile
    assert whole_state(screen) == before


def test_steady_solution_sees_what_was_tuned(screen: Screen) -> None:
    screen.record("parameter").passage_velocity = 0.05
    expected = Screen(
        variant(displacement=PRESCRIBED, passage=Passage(velocity=0.05))
    ).solve_steady()
    assert screen.solve_steady().recovery == pytest.approx(expected.recovery, abs=1e-15)


def test_order_of_questions_does_not_matter(screen: Screen) -> None:
    """A batch asked for in between must not loosen the steps of a steady solution."""
    plain = screen.solve_steady().recovery
    for times in ([0.01], [0.0], [1e5]):
        screen.sieve_batch(40.0, SHARE, times=times)
        assert (screen.solve_steady().recovery == plain).all()
    batch = Screen(screen.config).sieve_batch(40.0, SHARE, times=[2.0, 9.0])
    assert (screen.sieve_batch(40.0, SHARE, times=[2.0, 9.0]) == batch).all()


def test_lazy_profile_belongs_to_its_own_solution(screen: Screen) -> None:
    parameter = screen.record("parameter")
    first = screen.solve_steady()
    parameter.passage_velocity = 0.01
    second = screen.solve_steady(Feed(40.0, SHARE), Motion.linear(0.004, 14.0, 45 * DEG))
    for result in (first, second, first):
        carried = 2.4 * result.transport_velocity
        passed = carried * result.profile.passed[-1].sum()
        assert passed == pytest.approx(result.undersize.mass_flow_rate, rel=1e-3)


def test_lazy_profile_after_other_harmonics() -> None:
    def motion(size: float) -> Motion:
        part = Harmonic(1, along=size, along_phase=-1.57, normal=size, normal_phase=-1.57)
        return Motion.harmonics(15.5, [part])

    screen = Screen(DEFAULT)
    first = screen.solve_steady(motion=motion(0.0035))
    load = first.profile.load
    second = Screen(DEFAULT)
    late = second.solve_steady(motion=motion(0.0035))
    second.solve_steady(motion=motion(0.005))
    assert (late.profile.load == load).all()


@pytest.mark.parametrize(
    ("feed", "motion", "text"),
    [
        (Feed(0.0), None, "feed.mass_flow_rate = 0 kg/s has no steady separation"),
        (Feed(1.0, (1.0,)), None, "feed.mass_fraction has 1 values"),
        (None, Motion.linear(0.005, 0.0, 0.7), "motion.frequency = 0 Hz.* do not convey"),
        (None, Motion.linear(0.0, 15.0, 0.7), "motion.amplitude = 0 m do not convey"),
    ],
)
def test_no_steady_state(feed: Feed | None, motion: Motion | None, text: str) -> None:
    with pytest.raises(InputError, match=text):
        Screen(DEFAULT).solve_steady(feed, motion)


def test_initially_steady_screen_answers_everything() -> None:
    """The buffer of the steady solution has room for one slice and must not be filled."""
    screen = Screen(variant(bed=dataclasses.replace(DEFAULT.bed, initial="steady")))
    plain = Screen(DEFAULT)
    assert (screen.solve_steady().recovery == plain.solve_steady().recovery).all()
    assert (
        screen.sieve_batch(40.0, SHARE, times=[3.0]) == plain.sieve_batch(40.0, SHARE, times=[3.0])
    ).all()


# --- motion ------------------------------------------------------------------------------------
def test_change_of_harmonics_alone_is_seen() -> None:
    """Motions of harmonics differ in their harmonics only: the fundamental is zero."""

    def motion(size: float) -> Motion:
        part = Harmonic(1, along=size, along_phase=-1.57, normal=size, normal_phase=-1.57)
        return Motion.harmonics(15.5, [part])

    screen = Screen(DEFAULT)
    for size in (0.0035, 0.005, 0.003):
        expected = Screen(DEFAULT).step(1.0, motion=motion(size)).transport_velocity
        assert screen.step(1.0, motion=motion(size)).transport_velocity == expected
        assert screen.solve_steady(motion=motion(size)).transport_velocity == expected


def test_displacement_is_solved_only_when_needed() -> None:
    screen = Screen(DEFAULT)
    for k in range(10):
        screen.step(5.0, Feed(50.0 + k, SHARE))
    screen.record("parameter").passage_velocity = 0.2
    screen.step(5.0)
    assert screen.counters()["displacement_solutions"] == 1
    screen.step(5.0, motion=Motion.linear(0.005, 16.0, 45 * DEG))
    screen.record("panel")[0, 0].inclination = 6.0 * DEG
    screen.step(5.0)
    assert screen.counters()["displacement_solutions"] == 3


# --- a step's outputs --------------------------------------------------------------------------
def test_nothing_fed_and_nothing_moving_costs_nothing(screen: Screen) -> None:
    screen.step(5.0)
    rest = Motion.linear(0.005, 0.0, 45 * DEG)
    first = screen.step(5.0, Feed(0.0), rest)
    counters = screen.counters()
    again = screen.step(500.0)
    now = screen.counters()
    assert first.undersize.mass_flow_rate == again.undersize.mass_flow_rate == 0.0
    assert again.hold_up == first.hold_up > 0.0
    assert now["column_steps"] == counters["column_steps"]
    assert now["steady_steps"] == counters["steady_steps"] + 1
    assert again.transport_velocity == 0.0
    assert again.throw_number == 0.0
    # it wakes up again
    assert (
        screen.step(5.0, motion=Motion.linear(0.005, 15.5, 45 * DEG)).undersize.mass_flow_rate > 0
    )


def test_fractions_of_a_stream_that_stops_stay(screen: Screen) -> None:
    running = screen.step(30.0)
    stopped = screen.step(1.0, Feed(0.0), Motion.linear(0.005, 0.0, 45 * DEG))
    assert stopped.undersize.mass_flow_rate == 0.0
    assert (stopped.undersize.mass_fraction == running.undersize.mass_fraction).all()
    assert (stopped.oversize.mass_fraction == running.oversize.mass_fraction).all()
    assert stopped.undersize_recovery == running.undersize_recovery
    assert stopped.efficiency == running.efficiency > 0.0
    assert stopped.cut_size == running.cut_size
    assert "alarm.performance" in stopped.alarms


def test_throw_number_and_power_by_hand() -> None:
    result = Screen(DEFAULT).step(1.0)
    omega = 2.0 * np.pi * 15.5
    # A sin(45 deg) w^2/(g cos 5 deg)
    throw = 0.005 * np.sin(45 * DEG) * omega**2 / (9.81 * np.cos(5 * DEG))
    assert result.throw_number == pytest.approx(throw, rel=1e-12)
    empty = Screen(DEFAULT).step(1.0, Feed(0.0))
    bearing = 0.005 * (6000.0 * 0.005 * omega**2) * (omega * 0.12 / 2.0) / 0.9
    assert empty.drive_power == pytest.approx(bearing, rel=1e-12)
    assert result.drive_power > empty.drive_power


def test_cut_size_lies_where_half_reports_to_the_oversize() -> None:
    screen = Screen(DEFAULT)
    steady = screen.solve_steady()
    result = screen.step(60.0)
    result = screen.step(60.0)
    assert result.cut_size == pytest.approx(steady.cut_size, rel=2e-3)
    assert result.ecart_probable == pytest.approx(steady.ecart_probable, rel=2e-2)
    curve = steady.partition
    at_cut = np.interp(steady.cut_size, curve.size, curve.to_oversize)
    assert at_cut == pytest.approx(0.5, abs=1e-12)
    assert "alarm.performance" not in result.alarms or not curve.crossed


@pytest.mark.parametrize("model", ["well_mixed", "proportional", "classified", "exchange"])
def test_capacity_alarm_is_about_layers(model: str) -> None:
    """Only `exchange` has layers that a bed can outgrow; a bed of 80 mm fits into 16 of 20 mm."""
    feed = Feed(1600.0 * 0.08 * 2.4 * 0.3, SHARE)
    screen = Screen(variant(displacement=PRESCRIBED, segregation=Segregation(model), feed=feed))
    for _ in range(4):
        assert "alarm.capacity" not in screen.step(12.0).alarms
    shallow = variant(displacement=PRESCRIBED, bed=Bed(0.01, layers=4), feed=feed)
    alarms = [Screen(shallow).step(dt).alarms for dt in (1.0, 40.0)]
    assert all("alarm.capacity" in a for a in alarms)


@pytest.mark.parametrize("depth", [0.07, 0.4])
def test_deep_beds_of_models_without_layers_start_steady_and_close(depth: float) -> None:
    config = variant(
        displacement=PRESCRIBED,
        segregation=Segregation("well_mixed"),
        bed=Bed(contact_depth=0.002, initial="steady"),
        feed=Feed(1600.0 * depth * 2.4 * 0.3, SHARE),
    )
    screen = Screen(config)
    assert screen.result().hold_up == pytest.approx(screen.solve_steady().hold_up, rel=1e-3)
    result = screen.step(3.0)
    assert abs(result.balance_error) < 1e-9


def test_no_conveying_raises_the_transport_alarm() -> None:
    # thrown against the slope: the bed travels towards the feed end
    screen = Screen(DEFAULT)
    result = screen.step(10.0, motion=Motion.linear(0.005, 15.5, 135 * DEG))
    assert result.transport_velocity == 0.0
    assert "alarm.transport" in result.alarms
    assert result.oversize.mass_flow_rate == 0.0
    assert result.undersize.mass_flow_rate > 0.0
    back = screen.step(10.0, motion=Motion.linear(0.005, 15.5, 45 * DEG))
    assert "alarm.transport" not in back.alarms


def test_deep_bed_raises_its_alarm(screen: Screen) -> None:
    # 4 apertures are 64 mm
    for depth, alarm in ((0.06, False), (0.30, True)):
        feed = Feed(1600.0 * depth * 2.4 * 0.3, (0.0,) * 11 + (1.0,))
        screen.step(25.0, feed)
        result = screen.step(1.0)
        assert result.depth_discharge == pytest.approx(depth, rel=1e-9)
        assert ("alarm.bed_depth" in result.alarms) is alarm


# --- state -------------------------------------------------------------------------------------
def history(screen: Screen, start: int, stop: int) -> list[bytes]:
    states = []
    for k in range(start, stop):
        rate = (80.0, 0.0, 120.0, 40.0)[k % 4]
        frequency = (15.5, 15.5, 13.0, 0.0, 17.0)[k % 5]
        screen.step(0.3 + 3.7 * (k % 3), Feed(rate, SHARE), Motion.linear(0.005, frequency, 0.8))
        states.append(screen.state)
    return states


@pytest.mark.parametrize("model", ["rigid_body", "prescribed"])
def test_restored_screen_continues_bit_for_bit(model: str) -> None:
    config = variant(displacement=Displacement(model, 0.3 if model == "prescribed" else 0.0))
    one = Screen(config)
    history(one, 0, 13)
    saved = one.state
    expected = history(one, 13, 30)
    other = Screen(config)
    history(other, 5, 9)  # another past
    other.sieve_batch(30.0, SHARE, times=[1.0])
    other.state = saved
    assert other.state == saved
    assert history(other, 13, 30) == expected
    one.state = saved
    assert history(one, 13, 30) == expected


def test_restored_result_and_harmonics() -> None:
    one, other = Screen(DEFAULT), Screen(DEFAULT)
    part = Harmonic(2, along=0.001, normal=0.001)
    result = one.step(9.0, motion=Motion(15.5, 0.005, 45 * DEG, 0.0, (part,)))
    other.state = one.state
    assert other.result().hold_up == result.hold_up
    assert one.step(9.0).undersize.mass_flow_rate == other.step(9.0).undersize.mass_flow_rate


def test_state_of_another_screen_is_refused(screen: Screen) -> None:
    before = screen.state
    with pytest.raises(InputError, match="is not a state of this screen"):
        screen.state = before[:-8]
    assert screen.state == before


def test_two_threads_give_what_one_gives() -> None:
    configs = [DEFAULT, variant(segregation=Segregation("classified"))]
    serial = [history(Screen(c), 0, 40) for c in configs]
    parallel: dict[int, list[bytes]] = {}

    def work(place: int, config: ScreenConfig) -> None:
        parallel[place] = history(Screen(config), 0, 40)

    threads = [threading.Thread(target=work, args=(k, configs[k % 2])) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in range(4):
        assert parallel[k] == serial[k % 2]


def test_initialise_starts_anew(screen: Screen) -> None:
    fresh = screen.state
    history(screen, 0, 9)
    screen.view("input")[:] = Screen(screen.config).view("input")
    screen.view("fraction")[:] = SHARE
    screen.initialise()
    assert screen.state == fresh


def test_refused_initialisation_keeps_the_state(screen: Screen) -> None:
    screen.step(5.0)
    screen.record("input").feed_mass_flow_rate = np.nan
    before = whole_state(screen)
    with pytest.raises(InputError, match=r"feed\.mass_flow_rate = nan"):
        screen.initialise()
    assert whole_state(screen) == before


# --- batch -------------------------------------------------------------------------------------
def test_batch_recovery_rises_and_keeps_its_shape(screen: Screen) -> None:
    times = [0.0, 0.5, 1.0, 1.0, 5.0, 60.0]
    recovery = screen.sieve_batch(60.0, SHARE, times=times)
    assert recovery.shape == (6, 12)
    assert not recovery[0].any()
    assert (np.diff(recovery, axis=0) >= -1e-12).all()
    assert (recovery[2] == recovery[3]).all()
    assert (recovery <= 1.0 + 1e-12).all()
    assert not recovery[:, 7:].any()
    assert recovery[-1, 0] > 0.999
    one = screen.sieve_batch(60.0, SHARE, times=[5.0])[0]
    assert one == pytest.approx(recovery[4], abs=1e-4)


def test_batch_is_a_slice_of_the_steady_deck(screen: Screen) -> None:
    """Reduction: the same areal mass for the residence time."""
    steady = screen.solve_steady()
    areal = DEFAULT.feed.mass_flow_rate / (2.4 * 0.3)
    batch = screen.sieve_batch(areal, SHARE, times=[steady.residence_time])[0]
    assert batch == pytest.approx(steady.recovery, abs=1e-10)


def test_batch_at_rest_and_empty_classes(screen: Screen) -> None:
    rest = Motion.linear(0.0, 15.5, 45 * DEG)
    assert not screen.sieve_batch(60.0, SHARE, rest, times=[10.0]).any()
    share = (0.5, 0.0, 0.5) + (0.0,) * 9
    recovery = screen.sieve_batch(60.0, share, times=[2.0])[0]
    assert recovery[1] == 0.0
    assert recovery[0] > recovery[2] > 0.0
    assert screen.sieve_batch(60.0, SHARE).shape == (0, 12)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((0.0, SHARE, None, [1.0]), "areal_mass = 0.0 kg/m2 is not a finite positive mass"),
        ((np.nan, SHARE, None, [1.0]), "areal_mass = nan"),
        ((10.0, SHARE, None, [2.0, 1.0]), "times: give ascending times"),
        ((10.0, SHARE, None, [-1.0]), "times: give ascending times"),
        ((10.0, SHARE, None, [np.nan]), "times: give finite times"),
        ((10.0, (1.0,), None, [1.0]), "feed.mass_fraction has 1 values"),
        ((10.0, (0.5,) * 12, None, [1.0]), "feed.mass_fraction sums to 6, not to 1"),
    ],
)
def test_batch_refusals(arguments: tuple, text: str, screen: Screen) -> None:
    with pytest.raises(InputError, match=text):
        screen.sieve_batch(*arguments)


# --- performance -------------------------------------------------------------------------------
SIZES = [1.0, 2.0, 4.0, 8.0]
FINE, COARSE = [9.0, 6.0, 2.0, 0.0], [1.0, 4.0, 8.0, 10.0]


def test_partition_by_hand() -> None:
    # to the oversize: .1, .4, .8, 1: half lies at 2 + 2 x .1/.4 = 2.5,
    # a quarter at 1 + .15/.3 = 1.5, three quarters at 2 + 2 x .35/.4 = 3.75
    curve = performance.partition(SIZES, FINE, COARSE)
    assert curve.to_oversize == pytest.approx([0.1, 0.4, 0.8, 1.0])
    assert curve.cut_size == pytest.approx(2.5, rel=1e-14)
    assert curve.ecart_probable == pytest.approx(0.5 * (3.75 - 1.5), rel=1e-14)
    assert curve.crossed
    assert list(curve.frame().columns) == ["size_m", "to_oversize"]


def test_partition_without_a_crossing_stays_at_the_end_class() -> None:
    low = performance.partition(SIZES, [1.0] * 4, [0.0] * 4)
    assert (low.cut_size, low.ecart_probable, low.crossed) == (8.0, 0.0, False)
    high = performance.partition(SIZES, [0.0] * 4, [1.0] * 4)
    assert (high.cut_size, high.ecart_probable, high.crossed) == (1.0, 0.0, False)
    with pytest.raises(ValueError, match="both empty"):
        performance.partition(SIZES, [0.0] * 4, [0.0] * 4)


def test_partition_leaves_out_empty_sizes() -> None:
    curve = performance.partition(SIZES, [9.0, 0.0, 2.0, 0.0], [1.0, 0.0, 8.0, 0.0])
    assert curve.size == pytest.approx([1.0, 4.0])
    # .1 at 1, .8 at 4: half at 1 + 3 x .4/.7
    assert curve.cut_size == pytest.approx(1.0 + 3.0 * 0.4 / 0.7, rel=1e-14)


def test_recoveries_by_hand() -> None:
    feed = [10.0, 10.0, 10.0, 10.0]
    # finer than 4: 20 fed, 15 passed; from 4 on: 20 fed, 18 over
    assert performance.undersize_recovery(SIZES, feed, FINE, 4.0) == pytest.approx(0.75)
    assert performance.oversize_recovery(SIZES, feed, COARSE, 4.0) == pytest.approx(0.9)
    assert performance.deck_efficiency(SIZES, feed, FINE, 4.0) == pytest.approx(0.75)
    assert performance.screening_efficiency(SIZES, feed, FINE, COARSE, 4.0) == pytest.approx(0.675)
    assert performance.misplaced_fines(SIZES, COARSE, 4.0) == pytest.approx(5.0 / 23.0)
    assert np.isnan(performance.undersize_recovery(SIZES, feed, FINE, 0.5))
    assert np.isnan(performance.oversize_recovery(SIZES, feed, COARSE, 9.0))
    assert np.isnan(performance.misplaced_fines(SIZES, [0.0] * 4, 4.0))


def test_cut_size_is_not_above_the_aperture() -> None:
    """Nothing from the aperture on passes, however far the next size above it is."""
    classes = SizeClasses(tuple(d * MM for d in (0, 2, 4, 8, 16, 31.5, 63)), subdivision=1)
    fraction = (0.15, 0.10, 0.15, 0.20, 0.25, 0.15)
    duty = {"feed": Feed(10.0, fraction), "bed": Bed(initial="steady")}
    screen = Screen(ScreenConfig(classes, solver=Solver(1e-8), **duty))
    steady = screen.solve_steady()
    assert steady.undersize_recovery > 0.9
    assert 12 * MM < steady.cut_size <= 16 * MM
    assert screen.step(1.0).cut_size == pytest.approx(steady.cut_size, rel=1e-6)


@pytest.mark.parametrize("name", ["quarry", "two_deck", "banana"])
def test_the_bed_along_the_decks_is_what_is_held(name: str) -> None:
    """Summed over all places it is what the ledger holds of each class.

    What is fed to a deck that stands still piles up at the feed end itself.
    """
    screen = Screen(ScreenConfig.load(SCREENS / f"{name}.toml"))
    feed, motion = screen.config.feed, screen.config.motion
    stopped = dataclasses.replace(motion, frequency=0.0)
    for share, moves, duration in (
        *((1.0, motion, 4.0), (1.3, motion, 3.0), (0.0, motion, 2.0), (0.8, motion, 2.5)),
        *((0.8, stopped, 2.0), (0.8, motion, 1.5), (1.0, motion, 200.0)),
    ):
        rate = share * feed.mass_flow_rate
        screen.step(duration, dataclasses.replace(feed, mass_flow_rate=rate), moves)
        depth = screen.bed_at(0.0).sum() / screen.config.material.bulk_density
        if moves is stopped:
            assert depth == pytest.approx(screen.record("output").depth_feed, rel=1e-12)
            continue
        found = np.zeros(screen.config.size_classes.count)
        for number, deck in enumerate(screen.config.decks, start=1):
            places = (np.arange(1500) + 0.5) * deck.length / 1500
            loads = [screen.bed_at(place, number).sum(axis=0) for place in places]
            found += np.mean(loads, axis=0) * deck.length * deck.width
        assert found == pytest.approx(screen.view("held"), rel=0.01, abs=1e-3 * found.sum())
        # A package over the end of a panel counts on one of the two; a pile ends between places.
        assert found.sum() == pytest.approx(screen.record("output").hold_up, rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((6.1,), r"place = 6.1 m is not on the deck: give 0 to 6 m"),
        ((float("nan"),), r"place = nan m is not on the deck"),
        ((1.0, 2), r"deck = 2 is not there: give 1 to 1"),
    ],
)
def test_a_place_that_is_not_there(arguments: tuple, text: str) -> None:
    with pytest.raises(InputError, match=text):
        Screen(DEFAULT).bed_at(*arguments)
