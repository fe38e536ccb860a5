"""Dynamic against steady and exact solutions; the communication step does not show."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from tests.kernels.numerics.test_exact_solutions import (
    LENGTH,
    MIXED,
    RHO,
    WIDTH,
    exact_load,
    exact_recovery,
    gaudin,
    scene,
)
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.sections import Bed, Displacement, Passage, Segregation, Solver
from vibroscreen.units import DEG

DEFAULT = ScreenConfig.default()
RICH, POOR = DEFAULT.feed.mass_fraction, tuple(reversed(DEFAULT.feed.mass_fraction))
MODELS = ("well_mixed", "proportional", "exchange", "classified")


def variant(**changes: object) -> ScreenConfig:
    return dataclasses.replace(DEFAULT, **changes)


# --- dynamic = steady --------------------------------------------------------------------------
STEADY = {
    "default": {},
    "well mixed": {"segregation": Segregation("well_mixed")},
    "proportional": {"segregation": Segregation("proportional")},
    "classified": {"segregation": Segregation("classified")},
    "gaudin": {"passage": Passage("gaudin")},
    "thin contact layer": {
        "segregation": Segregation("well_mixed"),
        "bed": Bed(contact_depth=0.002),
        "displacement": Displacement("prescribed", 0.3),
    },
    "fine tolerance": {"solver": Solver(1e-6)},
    "shallow": {"feed": Feed(10.0, RICH)},
    "deep": {"feed": Feed(400.0, RICH)},
}


@pytest.mark.parametrize("dt", [0.07, 1.0, 7.0, 60.0])
@pytest.mark.parametrize("name", STEADY)
def test_steps_reach_the_steady_state(name: str, dt: float) -> None:
    config = variant(**STEADY[name])
    screen = Screen(config)
    steady = screen.solve_steady()
    count = int(np.ceil(1.001 * steady.residence_time / dt))
    for _ in range(count):
        screen.step(dt)
    result = screen.step(dt)
    allowed = config.solver.tolerance * config.feed.class_rates
    for now, end in ((result.undersize, steady.undersize), (result.oversize, steady.oversize)):
        assert (abs(now.class_rates - end.class_rates) <= allowed + 1e-12).all()
    assert result.hold_up == pytest.approx(steady.hold_up, rel=1e-3)
    assert result.depth_feed == pytest.approx(steady.profile.depth[0], rel=1e-6)
    assert result.depth_discharge == pytest.approx(steady.profile.depth[-1], rel=1e-3)
    assert result.undersize_recovery == pytest.approx(steady.undersize_recovery, abs=1e-3)
    assert result.efficiency == pytest.approx(steady.efficiency, abs=1e-3)
    assert result.transport_velocity == steady.transport_velocity
    later = screen.step(dt)
    assert later.undersize.class_rates == pytest.approx(result.undersize.class_rates, rel=1e-9)


def test_deck_is_not_steady_before_the_residence_time() -> None:
    screen = Screen(variant(displacement=Displacement("prescribed", 0.3)))
    assert screen.step(19.9).oversize.mass_flow_rate == 0.0
    # from 19.9 to 20.1 s the front leaves: half of the step has oversize
    full = screen.solve_steady().oversize.mass_flow_rate
    assert screen.step(0.2).oversize.mass_flow_rate == pytest.approx(0.5 * full, rel=1e-3)
    assert screen.step(0.2).oversize.mass_flow_rate == pytest.approx(full, rel=1e-3)


# --- initial = steady --------------------------------------------------------------------------
@pytest.mark.parametrize("name", STEADY)
def test_initially_steady_screen_starts_and_stays_there(name: str) -> None:
    changes = dict(STEADY[name])
    bed = dataclasses.replace(changes.pop("bed", Bed()), initial="steady")
    config = variant(bed=bed, **changes)
    screen = Screen(config)
    steady = screen.solve_steady()
    allowed = config.solver.tolerance * config.feed.class_rates + 1e-12
    start = screen.result()
    assert start.hold_up == pytest.approx(steady.hold_up, rel=1e-3)
    assert screen.balance().initial.sum() == pytest.approx(start.hold_up, rel=1e-12)
    for dt in (0.0, 0.3, 5.0, 90.0):
        now = screen.step(dt) if dt else start
        assert (abs(now.undersize.class_rates - steady.undersize.class_rates) <= allowed).all()
        assert (abs(now.oversize.class_rates - steady.oversize.class_rates) <= allowed).all()
        assert now.hold_up == pytest.approx(start.hold_up, rel=1e-9)
        assert abs(now.balance_error) < 1e-12 * start.hold_up
    balance = screen.balance()
    assert balance.fed.sum() == pytest.approx(95.3 * config.feed.mass_flow_rate, rel=1e-12)


def test_initially_steady_without_feed_or_motion_is_empty() -> None:
    bed = Bed(initial="steady")
    for changes in ({"feed": Feed(0.0, RICH)}, {"motion": Motion.linear(0.005, 0.0, 45 * DEG)}):
        screen = Screen(variant(bed=bed, **changes))
        assert screen.result().hold_up == 0.0
        assert screen.balance().initial.sum() == 0.0


# --- the communication step --------------------------------------------------------------------
def inputs_at(minute: int) -> tuple[Feed, Motion]:
    """Feed, composition and frequency of every minute of the run."""
    feeds = [Feed(60.0, RICH), Feed(110.0, RICH), Feed(110.0, POOR), Feed(70.0, RICH), Feed(0.0)]
    frequency = [15.5, 15.5, 17.0, 13.0, 14.0]
    return feeds[minute], Motion.linear(0.005, frequency[minute], 45 * DEG)


def cumulative(config: ScreenConfig, dt: float) -> np.ndarray:
    """Undersize, oversize and fed mass by class at every full minute, [minute, stream, class]."""
    screen = Screen(config)
    rows = []
    for minute in range(5):
        for _ in range(round(60.0 / dt)):
            screen.step(dt, *inputs_at(minute))
        rows.append(screen.balance()[["undersize", "oversize", "fed"]].to_numpy().T)
    return np.array(rows)


STEP_SCREENS = {
    "default": {},
    "well mixed": {"segregation": Segregation("well_mixed")},
    "classified": {"segregation": Segregation("classified")},
    "prescribed": {"displacement": Displacement("prescribed", 0.25)},
    "slow": {"displacement": Displacement("prescribed", 0.1)},
    "tolerance of 1e-5": {"solver": Solver(1e-5)},
}


@pytest.mark.parametrize("name", STEP_SCREENS)
def test_communication_step_does_not_show(name: str) -> None:
    config = variant(**STEP_SCREENS[name])
    reference = cumulative(config, 60.0)
    allowed = config.solver.tolerance * reference[:, 2:, :]
    for dt in (0.1, 1.0, 5.0, 20.0):
        masses = cumulative(config, dt)
        assert masses[:, 2] == pytest.approx(reference[:, 2], rel=1e-12)
        difference = abs(masses - reference)[:, :2]
        assert (difference <= allowed + 1e-12).all(), (dt, (difference / allowed).max())


@pytest.mark.parametrize("name", [name for name in STEP_SCREENS if name != "slow"])
def test_transients_meet_the_tolerance(name: str) -> None:
    """The masses of the whole run against those of a hundredth of the tolerance."""
    config = variant(**STEP_SCREENS[name])
    fine = dataclasses.replace(config, solver=Solver(config.solver.tolerance / 100.0))
    masses, reference = cumulative(config, 60.0), cumulative(fine, 60.0)
    difference = abs(masses - reference)[:, :2] / reference[:, 2:, :].clip(min=1e-300)
    assert difference.max() <= config.solver.tolerance


def test_one_step_longer_than_the_residence_time() -> None:
    one, many = (Screen(variant(displacement=Displacement("prescribed", 0.3))) for _ in range(2))
    one.step(100.0)
    for _ in range(100):
        many.step(1.0)
    both = [s.balance() for s in (one, many)]
    allowed = 1e-4 * both[0].fed
    assert ((both[0].undersize - both[1].undersize).abs() <= allowed).all()
    assert ((both[0].held - both[1].held).abs() <= allowed).all()
    last = one.step(3600.0, Feed(0.0))
    assert last.hold_up == 0.0
    assert last.oversize.mass_flow_rate > 0.0
    assert one.step(3600.0).oversize.mass_flow_rate == 0.0


# --- a transient with a closed solution --------------------------------------------------------
VELOCITIES, SWITCH, END = (0.3, 0.5), 25.0, 33.0


def position_of(entry: float, now: float) -> float:
    """Way of a slice since its entry, m."""
    slow = max(0.0, min(now, SWITCH) - min(entry, SWITCH))
    fast = max(0.0, now - max(entry, SWITCH))
    return VELOCITIES[0] * slow + VELOCITIES[1] * fast


def exit_of(entry: float) -> float:
    """Time at which a slice reaches the discharge, s."""
    slow = max(0.0, SWITCH - entry)
    if VELOCITIES[0] * slow >= LENGTH:
        return entry + LENGTH / VELOCITIES[0]
    return max(entry, SWITCH) + (LENGTH - VELOCITIES[0] * slow) / VELOCITIES[1]


def entry_that_leaves_at(moment: float) -> float:
    low, high = 0.0, moment
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if exit_of(middle) < moment else (low, middle)
    return low


def exact_transient(config: ScreenConfig) -> tuple[np.ndarray, np.ndarray]:
    """Undersize and oversize by class until END, kg: every slice by the closed solution."""
    rates = config.feed.class_rates
    breaks = [0.0, SWITCH, entry_that_leaves_at(SWITCH), entry_that_leaves_at(END), END]
    breaks = sorted(b for b in breaks if 0.0 <= b <= END)
    under, over = np.zeros(rates.size), np.zeros(rates.size)
    abscissa, weight = np.polynomial.legendre.leggauss(12)
    for start, stop in pairwise(breaks):
        if stop - start < 1e-9:
            continue
        for x, w in zip(abscissa, weight, strict=True):
            entry = 0.5 * (start + stop) + 0.5 * (stop - start) * x
            velocity = VELOCITIES[0] if entry < SWITCH else VELOCITIES[1]
            share = 0.5 * (stop - start) * w * WIDTH * velocity
            load = rates / (WIDTH * velocity)
            leaves = exit_of(entry)
            left, deep = exact_load(load, 0.05, 0.01, min(leaves, END) - entry)
            assert deep
            under += share * (load - left)
            over += share * left * (leaves < END)
    return under, over


def test_the_exact_transient_is_consistent() -> None:
    """The test's own arithmetic: entry, way and exit fit together."""
    for entry in (0.0, 10.0, 24.0, 26.0):
        assert position_of(entry, exit_of(entry)) == pytest.approx(LENGTH, rel=1e-12)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5, 1e-6])
def test_change_of_velocity_against_the_closed_solution(tolerance: float) -> None:
    """Well mixed, Gaudin: from an empty deck, at 25 s the velocity rises from .3 to .5 m/s."""
    config = scene(
        Feed(60.0, MIXED), tolerance=tolerance, velocity=VELOCITIES[0], contact_depth=0.01
    )
    under, over = exact_transient(config)
    screen = Screen(config)
    screen.advance(SWITCH)
    screen.record("input").displacement_velocity = VELOCITIES[1]
    screen.advance(END - SWITCH)
    balance = screen.balance()
    fed = config.feed.class_rates * END
    assert (abs(balance.undersize - under) <= tolerance * fed).all()
    assert (abs(balance.oversize - over) <= tolerance * fed).all()
    assert exact_recovery(config)[1]
    assert (gaudin() > 0.0).sum() == 5


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5, 1e-6])
def test_deck_that_stops_conveying_against_the_closed_solution(tolerance: float) -> None:
    """v falls to 0 without feed: every slice stays where it is and goes on passing."""
    config = scene(Feed(60.0, MIXED), tolerance=tolerance, velocity=0.3, contact_depth=0.01)
    screen = Screen(config)
    screen.advance(LENGTH / 0.3)
    screen.record("input").displacement_velocity = 0.0
    screen.step(5.0, Feed(0.0))
    rates = config.feed.class_rates
    load = rates / (WIDTH * 0.3)
    abscissa, weight = np.polynomial.legendre.leggauss(20)
    under = np.zeros(rates.size)
    for x, w in zip(abscissa, weight, strict=True):
        age = 0.5 * LENGTH / 0.3 * (1.0 + x)
        left, deep = exact_load(load, 0.05, 0.01, age + 5.0)
        assert deep
        under += 0.5 * w * LENGTH * WIDTH * (load - left)
    balance = screen.balance()
    assert (abs(balance.undersize - under) <= tolerance * rates * LENGTH / 0.3).all()
    assert balance.oversize.max() < 1e-9  # the front is at the discharge to round-off
    assert load.sum() > RHO * 0.01


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_restless_feed_and_velocity_against_the_closed_solution(tolerance: float) -> None:
    """Both change with every step of 1 s: what came in together goes through one trajectory."""
    draw = np.random.default_rng(5)
    steps = 40
    feed, velocity = draw.uniform(40.0, 80.0, steps), draw.uniform(0.25, 0.4, steps)
    clock, way = np.arange(steps + 1.0), np.append(0.0, np.cumsum(velocity))
    config = scene(Feed(60.0, MIXED), tolerance=tolerance, contact_depth=0.01)
    shares = config.feed.class_rates / 60.0
    # Entries that leave at full seconds.
    leaving = np.interp(way[way > LENGTH] - LENGTH, way, clock)
    under, over = np.zeros(shares.size), np.zeros(shares.size)
    abscissa, weight = np.polynomial.legendre.leggauss(8)
    for start, stop in pairwise(np.unique(np.append(clock, leaving))):
        k = int(0.5 * (start + stop))
        load = feed[k] * shares / (WIDTH * velocity[k])
        for x, w in zip(abscissa, weight, strict=True):
            entry = 0.5 * (start + stop) + 0.5 * (stop - start) * x
            goal = np.interp(entry, clock, way) + LENGTH
            leaves = np.interp(goal, way, clock) if goal < way[-1] else np.inf
            left, deep = exact_load(load, 0.05, 0.01, min(leaves, steps) - entry)
            assert deep
            share = 0.5 * (stop - start) * w * WIDTH * velocity[k]
            under += share * (load - left)
            over += share * left * (leaves < steps)
    for closed_cohorts in (True, False):
        screen = Screen(config)
        screen.switch(closed_cohorts=closed_cohorts)
        for k in range(steps):
            screen.record("input").displacement_velocity = velocity[k]
            screen.step(1.0, Feed(feed[k], MIXED))
        balance = screen.balance()
        assert (abs(balance.undersize - under) <= tolerance * balance.fed).all()
        assert (abs(balance.oversize - over) <= tolerance * balance.fed).all()
        assert (balance.error.abs() <= 1e-14 * balance.fed).all()
        assert (screen.counters()["cohorts_followed"] > 0) == closed_cohorts


RESTLESS = {
    "exchange": {"segregation": Segregation("exchange")},
    "proportional": {"segregation": Segregation("proportional")},
    "classified": {"segregation": Segregation("classified")},
    "thin layers": {"bed": Bed(layer_depth=0.004, layers=60)},
    "linear in a layer": {"bed": Bed(layer_depth=0.01, layers=20, reconstruction="linear")},
    "strong passage": {"passage": Passage("gaudin", velocity=5.0)},
    "strong percolation": {"segregation": Segregation("exchange", velocity=1.0)},
    "stiff": {"segregation": Segregation("exchange", velocity=90.0), "solver": Solver(1e-3)},
}


@pytest.mark.parametrize("name", RESTLESS)
def test_closed_cohorts_give_what_single_packages_give(name: str) -> None:
    """Feed and frequency change with every step; longer steps than the cohorts took come too."""
    results = []
    config = variant(**RESTLESS[name])
    for closed_cohorts in (True, False):
        screen = Screen(config)
        screen.switch(closed_cohorts=closed_cohorts)
        draw = np.random.default_rng(11)
        streams = []
        for k in range(40):
            feed = Feed(DEFAULT.feed.mass_flow_rate * draw.uniform(0.5, 1.3), RICH)
            motion = Motion.linear(0.005, 15.5 + draw.uniform(-1.0, 1.0), 45.0 * DEG)
            before = screen.balance().undersize
            screen.step(1.0 if k % 5 else 1.7, feed, motion)
            passed = screen.balance().undersize - before
            assert (passed >= 0.0).all()
            streams.append(passed.to_numpy())
        balance = screen.balance()
        assert (balance.error.abs() <= 1e-14 * balance.fed).all()
        results.append((np.array(streams), balance))
    fed = results[0][1].fed.to_numpy()
    allowed = 2.0 * config.solver.tolerance
    for stream in ("undersize", "oversize", "held"):
        one, two = (balance[stream].to_numpy() for _, balance in results)
        assert (abs(one - two) <= allowed * fed).all()
    # The streams of every step: packages average over a cell, in which a sorted bed has a kink
    # (2e-3 against 512 cells, as much with closed cohorts).
    difference = abs(results[0][0] - results[1][0]).max(axis=0)
    assert (difference <= 4e-3 * fed / 40.0).all()


# --- skips change nothing ----------------------------------------------------------------------
def nudge(screen: Screen) -> None:
    """Make the engine think that something changed: packages get a history of their own."""
    screen.view("last_seen")[:] = -1.0


@pytest.mark.parametrize("model", MODELS)
def test_shared_trajectory_gives_what_single_packages_give(model: str) -> None:
    run: list[Callable[[Screen], None]] = [lambda screen: None, nudge]
    results = []
    for before in run:
        screen = Screen(variant(segregation=Segregation(model)))
        for _ in range(12):
            before(screen)
            screen.step(4.0)
        results.append(screen.balance())
    allowed = 1e-4 * results[0].fed
    assert ((results[0].undersize - results[1].undersize).abs() <= allowed).all()
    assert ((results[0].held - results[1].held).abs() <= allowed).all()


def test_fluctuating_feed_meets_the_tolerance() -> None:
    """A feed that changes with every step of .1 s: short packages may not be averaged at will."""

    def run(tolerance: float) -> np.ndarray:
        screen = Screen(
            variant(displacement=Displacement("prescribed", 0.3), solver=Solver(tolerance))
        )
        for k in range(400):
            screen.step(0.1, Feed(60.0 + 50.0 * np.sin(0.1 * np.pi * k), RICH))
        return screen.balance()[["undersize", "oversize", "fed"]].to_numpy().T

    masses, reference = run(1e-4), run(1e-6)
    assert (abs(masses - reference)[:2] <= 1e-4 * reference[2]).all()
