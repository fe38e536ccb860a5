"""No kilogram is lost or made, nothing is negative, memory does not grow."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from vibroscreen import Feed, Screen, ScreenConfig
from vibroscreen.kernels import state
from vibroscreen.sections import Bed, Displacement, Passage, Segregation, Solver
from vibroscreen.size_classes import SizeClasses

EDGES = (0.0, 0.004, 0.008, 0.0125, 0.016, 0.022, 0.045)
MODELS = ("well_mixed", "proportional", "exchange", "classified")
CLOSURE = 1e-12


def small_screen(**changes: object) -> Screen:
    """Six classes of one node, coarse tolerance: the book-keeping is that of any screen."""
    base = ScreenConfig(
        SizeClasses(EDGES, subdivision=1),
        bed=Bed(layers=6),
        solver=Solver(1e-2),
    )
    return Screen(dataclasses.replace(base, **changes))


def check_signs(screen: Screen) -> None:
    """Nothing that lies or flows is negative, and every number is finite."""
    lay_ = screen.layout
    for name in ("load", "length", "lead", "lead_passed", "partial", "held", "reference"):
        field = screen.view(name)
        assert np.isfinite(field).all(), name
        assert field.min() >= 0.0, name
    output = screen.view("output")
    assert np.isfinite(screen.buffer[lay_.section["outputs"]]).all()
    assert output[: state.OUTPUT.index("depth_discharge") + 1].min() >= 0.0
    for name in ("undersize_fraction", "oversize_fraction"):
        fraction = screen.view(name)
        assert fraction.min() >= 0.0
        assert abs(fraction.sum() - 1.0) < 1e-9
    book = screen.record("deck")[0]
    assert book.packages + book.cells <= lay_.dimension["packages"]


def check_closed(screen: Screen) -> None:
    """By class: initial + fed - undersize - oversize - held is 0 within 1e-12 of what was fed."""
    balance = screen.balance()
    assert (balance.error.abs() <= CLOSURE * (balance.fed + balance.initial)).all(), balance
    # the table's own columns say the same within the round-off of plain sums
    plain = balance.initial + balance.fed - balance.undersize - balance.oversize - balance.held
    for k in range(1, len(screen.config.decks)):
        plain -= balance[f"intermediate_{k}"]
    assert (plain.abs() <= 1e-11 * (balance.fed + balance.initial)).all()
    result = screen.result()
    assert abs(result.balance_error - balance.error.sum()) <= 1e-13 * balance.fed.sum()
    assert result.hold_up == pytest.approx(balance.held.sum(), rel=1e-12, abs=1e-12)


def random_step(screen: Screen, rng: np.random.Generator) -> float:
    """Change some inputs at random and draw a step; zeros are among all of them."""
    inputs, fraction = screen.record("input"), screen.view("fraction")
    if rng.random() < 0.6:
        share = rng.random(fraction.size) * (rng.random(fraction.size) < 0.8)
        share[rng.integers(fraction.size)] += 0.1
        fraction[:] = share / share.sum()
    if rng.random() < 0.7:
        inputs.feed_mass_flow_rate = rng.choice([0.0, 0.0, rng.uniform(0.0, 150.0), 600.0, 1e-9])
    if rng.random() < 0.5:
        inputs.motion_frequency = rng.choice([0.0, 15.5, rng.uniform(5.0, 25.0)])
        inputs.motion_amplitude = rng.choice([0.0, 0.005, rng.uniform(0.001, 0.008)])
        inputs.displacement_velocity = rng.choice([0.0, 0.3, rng.uniform(0.0, 1.0), 1e-7])
        inputs.motion_throw_angle = rng.choice([0.8, rng.uniform(0.4, 1.6)])
        inputs.motion_ellipticity = rng.choice([0.0, rng.uniform(-1.0, 1.0)])
    return float(10.0 ** rng.uniform(np.log10(0.05), np.log10(400.0)))


def random_run(screen: Screen, steps: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    fed = np.zeros(screen.view("fraction").size)
    for _ in range(steps):
        dt = random_step(screen, rng)
        screen.advance(dt)
        check_signs(screen)
        fed += screen.view("fraction") * screen.record("input").feed_mass_flow_rate * dt
    check_closed(screen)
    assert screen.balance().fed.to_numpy() == pytest.approx(fed, rel=1e-9)
    empty(screen)
    check_signs(screen)
    check_closed(screen)
    balance = screen.balance()
    assert (balance.held <= CLOSURE * balance.fed).all()
    assert balance.fed.min() > 0.0
    assert balance.oversize.min() > 0.0
    assert balance.undersize.iloc[:3].min() > 0.0
    assert balance.undersize.iloc[4:].max() == 0.0


def empty(screen: Screen) -> None:
    inputs = screen.record("input")
    inputs.feed_mass_flow_rate, inputs.motion_frequency, inputs.motion_amplitude = 0.0, 15.5, 0.005
    inputs.displacement_velocity = 0.3
    inputs.motion_throw_angle, inputs.motion_ellipticity = 0.8, 0.0
    for dt in (7.0, 1000.0, 1000.0):
        screen.advance(dt)


@pytest.mark.parametrize("displacement", ["prescribed", "rigid_body"])
def test_ten_thousand_random_steps(displacement: str) -> None:
    random_run(small_screen(displacement=Displacement(displacement)), 10_000, seed=2)


@pytest.mark.parametrize("law", ["gaudin", "pelevin", "bounce"])
@pytest.mark.parametrize("model", MODELS)
def test_random_steps_of_every_model(model: str, law: str) -> None:
    screen = small_screen(
        displacement=Displacement("prescribed"),
        segregation=Segregation(model),
        passage=Passage(law, velocity=0.3),
    )
    random_run(screen, 200, seed=3)


def test_random_steps_of_the_default_screen() -> None:
    """Wide classes split, tolerance of 1e-4."""
    screen = Screen(ScreenConfig.default().replace(displacement=Displacement("prescribed")))
    rng = np.random.default_rng(4)
    for _ in range(150):
        screen.advance(random_step(screen, rng))
        check_signs(screen)
        check_closed(screen)


def test_little_room_for_packages_merges_and_closes() -> None:
    screen = small_screen(displacement=Displacement("prescribed"), solver=Solver(1e-2, packages=68))
    random_run(screen, 600, seed=5)
    assert screen.counters()["merges"] > 3


def test_many_changes_in_small_steps() -> None:
    """Packages shorter than a cell collect: the queue does not outgrow its room."""
    screen = small_screen(displacement=Displacement("prescribed", 0.2))
    inputs = screen.record("input")
    for k in range(3000):
        inputs.feed_mass_flow_rate = 40.0 + k % 7
        screen.advance(0.05)
    check_signs(screen)
    check_closed(screen)


def test_long_steady_operation_closes() -> None:
    """A round-off in the constant rates must not add up: 100 000 s in steps of 10 s."""
    screen = small_screen(displacement=Displacement("prescribed", 0.3))
    for _ in range(10_000):
        screen.advance(10.0)
    check_closed(screen)
    assert screen.counters()["steady_steps"] > 9_000


@pytest.mark.parametrize("model", MODELS)
def test_a_vibrating_deck_that_does_not_convey_runs_dry(model: str) -> None:
    """A batch of fines decays below the smallest number without a NaN."""
    screen = small_screen(
        displacement=Displacement("prescribed", 0.3),
        segregation=Segregation(model),
        passage=Passage("pelevin", velocity=1.0),
        feed=Feed(80.0, (0.6, 0.4, 0.0, 0.0, 0.0, 0.0)),
    )
    inputs = screen.record("input")
    screen.advance(5.0)
    inputs.feed_mass_flow_rate = inputs.displacement_velocity = 0.0
    for _ in range(3000):
        screen.advance(0.5)
    check_signs(screen)
    check_closed(screen)
    assert screen.result().hold_up < 1e-12


@pytest.mark.parametrize("model", ["well_mixed", "exchange"])
def test_deck_that_stops_piles_up_and_carries_on(model: str) -> None:
    screen = small_screen(
        displacement=Displacement("prescribed", 0.3), segregation=Segregation(model)
    )
    share = (0.1, 0.1, 0.2, 0.1, 0.2, 0.3)
    rates, velocity = (
        Feed(50.0, share),
        screen.view("input")[state.INPUT.index("displacement_velocity") :],
    )
    screen.step(40.0, rates)
    before = screen.result()
    # the drive stops: nothing moves, nothing passes, the feed still falls
    screen.record("input").motion_frequency = 0.0
    for _ in range(10):
        still = screen.step(3.0, rates)
        assert still.undersize.mass_flow_rate == still.oversize.mass_flow_rate == 0.0
        check_signs(screen)
    assert still.hold_up == pytest.approx(before.hold_up + 50.0 * 30.0, rel=1e-12)
    assert still.depth_feed > 10.0 * before.depth_feed
    # it starts again without feed: the pile rides down and leaves
    screen.record("input").motion_frequency = 15.5
    velocity[0] = 0.3
    flow = [screen.step(1.0, Feed(0.0)) for _ in range(30)]
    check_closed(screen)
    assert max(x.oversize.mass_flow_rate for x in flow) > 20.0 * before.oversize.mass_flow_rate
    assert flow[-1].hold_up <= CLOSURE * 3500.0
    # the pile needs a residence time to the discharge: 20 s
    late = [x.oversize.mass_flow_rate for x in flow]
    assert int(np.argmax(late)) in (19, 20, 21)
    check_closed(screen)


@pytest.mark.parametrize(("velocity", "parts"), [(0.19, 9), (0.49, 9), (0.26, 5), (0.3, 4)])
def test_last_package_leaves_when_steps_divide_the_residence_time(
    velocity: float, parts: int
) -> None:
    """A package whose rear ends at the discharge to round-off must not stay behind."""
    screen = small_screen(
        displacement=Displacement("prescribed", velocity), segregation=Segregation("well_mixed")
    )
    dt = 6.0 / velocity / parts
    for _ in range(6):
        screen.step(5.0, Feed(80.0, (0.1, 0.1, 0.2, 0.1, 0.2, 0.3)))
        for _ in range(parts + 3):
            result = screen.step(dt, Feed(0.0))
        assert result.depth_discharge == 0.0
        assert result.hold_up == 0.0
        assert screen.record("deck")[0].packages <= 1.0


def test_steps_do_not_allocate() -> None:
    screen = small_screen(displacement=Displacement("prescribed"))
    rng = np.random.default_rng(6)
    steps = [random_step(screen, rng) for _ in range(300)]

    def run() -> None:
        inputs = screen.record("input")
        for k, dt in enumerate(steps):
            inputs.feed_mass_flow_rate = 50.0 * (k % 3)
            screen.advance(dt)

    run()
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    run()
    after = rtsys.get_allocation_stats()
    # one a call, for the view of the buffer that Python hands over, and given back
    assert after.alloc - before.alloc <= len(steps)
    assert after.alloc - before.alloc == after.free - before.free
    tracemalloc.start()
    run()
    first = tracemalloc.get_traced_memory()[0]
    for _ in range(3):
        run()
    grown = tracemalloc.get_traced_memory()[0] - first
    tracemalloc.stop()
    assert grown < 2_000


def test_heavy_feed_closes_and_empties() -> None:
    """More than the deck can carry away: piles, capacity alarm, and all of it comes out."""
    screen = small_screen(displacement=Displacement("prescribed", 0.01), bed=Bed(0.01, layers=3))
    share = (0.1, 0.1, 0.2, 0.1, 0.2, 0.3)
    for dt in (0.05, 3.0, 100.0, 700.0):
        result = screen.step(dt, Feed(200.0, share))
        check_signs(screen)
        check_closed(screen)
    assert "alarm.capacity" in result.alarms
    empty(screen)
    check_closed(screen)
    assert screen.result().hold_up <= CLOSURE * 2e5
