"""What is left out changes nothing: every switch off against on, and its counter."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.fixed import FIXED, fixed_screen, fixed_segregation
from vibroscreen import Feed, InputError, Motion, Screen, ScreenConfig
from vibroscreen.kernels import state
from vibroscreen.sections import Deck, Displacement, Panel, Passage

DEFAULT = fixed_screen()
SHARE = DEFAULT.feed.mass_fraction
# Without its finest and two of its coarse classes: empty sizes.
HOLED = (0.0, 0.2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.1)
TOP = Deck(2.4, (Panel(6.0, 0.0, 0.016, 0.5),))
LOWER = Deck(2.4, (Panel(2.0, 0.0, 0.008, 0.5), Panel(4.0, 0.0, 0.008, 0.5, 1.4)))
BOXES = {"single": (TOP,), "two decks": (TOP, LOWER)}
SWITCHES = dict(zip(state.SWITCH, range(len(state.SWITCH)), strict=True))
TOLERANCE = DEFAULT.solver.tolerance

# Counter that grows with the skip, and one that falls: (switch: more of, less of).
COUNTERS = {
    "coarse_sizes": ("coarse_sizes_skipped", None),
    "empty_sizes": ("empty_sizes_skipped", None),
    "used_up_sizes": ("used_up_sizes_skipped", None),
    "explicit": ("pair_steps", "sub_steps"),
    "idle_packages": ("packages_skipped", "packages_integrated"),
    "shared_trajectory": (None, "packages_integrated"),
    "closed_cohorts": ("cohorts_followed", "packages_integrated"),
    "steady_scene": ("steady_steps", None),
    "displacement": (None, "displacement_solutions"),
}
# Exact to round-off, the others within the tolerance (twice: either run may err by it).
EXACT = ("idle_packages", "steady_scene", "displacement")


def config_of(box: str) -> ScreenConfig:
    return DEFAULT.replace(
        decks=BOXES[box],
        displacement=Displacement("prescribed", 0.3),
        bed=dataclasses.replace(FIXED["bed"], layers=12),
        passage=Passage("pelevin", velocity=0.3),
        feed=Feed(60.0, SHARE),
    )


def run(config: ScreenConfig, off: str | None) -> tuple[np.ndarray, dict[str, int]]:
    """Cumulative masses of a run as parts of what was fed [stream, class], and the counters."""
    screen = Screen(config)
    if off is not None:
        screen.view("switch")[SWITCHES[off]] = 0.0
    plan = [
        (Feed(60.0, HOLED), 15.5, 8, 2.0),
        (Feed(90.0, SHARE), 15.5, 6, 3.0),
        *((Feed(80.0 + 5.0 * k, SHARE), 15.5, 1, 1.0) for k in range(4)),
        (Feed(90.0, SHARE), 13.0, 20, 5.0),
        (Feed(0.0), 13.0, 12, 5.0),
        (Feed(0.0), 0.0, 3, 5.0),
        (Feed(50.0, HOLED), 13.0, 6, 2.0),
    ]
    for feed, frequency, count, dt in plan:
        for _ in range(count):
            screen.step(dt, feed, Motion.linear(0.005, frequency, 0.8))
    balance = screen.balance()
    fed = balance.fed.to_numpy()
    assert (balance.error.abs() <= 1e-12 * fed).all()
    names = ["undersize", "oversize", "held"]
    names += [name for name in balance if name.startswith("intermediate")]
    masses = balance[names].to_numpy().T
    return np.divide(masses, fed, out=np.zeros_like(masses), where=fed > 0.0), screen.counters()


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("model", ["exchange", "well_mixed"])
def test_every_switch_changes_nothing_but_the_work(box: str, model: str) -> None:
    config = config_of(box).replace(segregation=fixed_segregation(model))
    masses, counters = run(config, None)
    for name in SWITCHES:
        others, without = run(config, name)
        allowed = 1e-11 if name in EXACT else 2.0 * TOLERANCE
        error = abs(others - masses).max()
        assert error <= allowed, f"{name}: {error:.1e}"
        more, less = COUNTERS[name]
        if more is not None:
            assert counters[more] > without[more] == 0, name
        if less is not None:
            assert counters[less] < without[less], name


@pytest.mark.parametrize("box", BOXES)
def test_switches_of_the_steady_solution(box: str) -> None:
    """The streams of a steady solution with a switch off: those that a slice can see."""
    screen = Screen(config_of(box))
    feed = Feed(60.0, HOLED)
    plain = screen.solve_steady(feed).recovery
    for name in ("coarse_sizes", "empty_sizes", "used_up_sizes", "explicit"):
        other = Screen(config_of(box))
        other._column.view(other._column_buffer, "switch")[SWITCHES[name]] = 0.0
        assert other.solve_steady(feed).recovery == pytest.approx(plain, abs=2.0 * TOLERANCE), name


def test_a_lower_deck_on_which_nothing_falls_costs_nothing() -> None:
    """Its packages are empty: none is integrated, whatever the top deck carries.

    Steps are as short as the pieces in which a deck with one below moves.
    """
    coarse = Feed(60.0, (0.0,) * 9 + (0.4, 0.3, 0.3))
    screen = Screen(config_of("two decks"))
    for k in range(6):
        screen.step(1.2 + 0.01 * k, Feed(60.0 + k, coarse.mass_fraction))
    one = Screen(config_of("single"))
    for k in range(6):
        one.step(1.2 + 0.01 * k, Feed(60.0 + k, coarse.mass_fraction))
    two, alone = screen.counters(), one.counters()
    assert two["packages_integrated"] == alone["packages_integrated"]
    assert two["column_steps"] == alone["column_steps"]
    assert two["packages_skipped"] > alone["packages_skipped"]


def test_cut_sizes_are_found_when_somebody_reads_them() -> None:
    lazy, eager = Screen(DEFAULT), Screen(DEFAULT)
    for k in range(5):
        for screen in (lazy, eager):
            screen.record("input").motion_frequency = 15.0 + 0.1 * k
            screen.advance(10.0)
        eager.result()
    assert lazy.counters()["partitions"] == 0
    assert eager.counters()["partitions"] == 5
    one, other = lazy.result(), eager.result()
    assert one.cut_size == other.cut_size > 0.0
    assert one.ecart_probable == other.ecart_probable
    lazy.result()
    assert lazy.counters()["partitions"] == 1


def test_an_unknown_skip_is_named() -> None:
    with pytest.raises(InputError, match=r"coarse is no skip: give one of coarse_sizes, "):
        Screen(DEFAULT).switch(coarse=False)
