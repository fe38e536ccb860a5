"""Many steady states at once: the same bits as one by one, whatever the threads; clear refusals."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.fixed import fixed_screen
from vibroscreen import ConfigError, Feed, InputError, Motion, Screen, ScreenConfig
from vibroscreen.kernels import state
from vibroscreen.screen import slice_layout
from vibroscreen.sections import Bed, Deck, Displacement, Panel, Passage, Segregation, Solver
from vibroscreen.size_classes import SizeClasses
from vibroscreen.sweep import CHUNK, SteadyTable, places, solve_steady_many
from vibroscreen.units import DEG, MM

COUNT = 2 * CHUNK + 5
RNG = np.random.default_rng(3)
VALUES = {
    "deck[1].panel[1].aperture": RNG.uniform(12 * MM, 20 * MM, COUNT),
    "deck[1].panel[1].inclination": RNG.uniform(0.0, 8.0 * DEG, COUNT),
    "deck[1].width": RNG.uniform(1.8, 3.0, COUNT),
    "motion.frequency": RNG.uniform(14.0, 17.0, COUNT),
    "feed.mass_flow_rate": RNG.uniform(40.0, 120.0, COUNT),
    "passage.velocity": RNG.uniform(0.05, 0.2, COUNT),
    "segregation.dilation": RNG.uniform(0.5 * MM, 2.0 * MM, COUNT),
}


def configured(base: ScreenConfig, values: dict[str, np.ndarray], k: int) -> ScreenConfig:
    """The configuration that design k of VALUES stands for."""
    panel = dataclasses.replace(
        base.decks[0].panels[0],
        aperture=values["deck[1].panel[1].aperture"][k],
        inclination=values["deck[1].panel[1].inclination"][k],
    )
    return base.replace(
        decks=(Deck(values["deck[1].width"][k], (panel,)), *base.decks[1:]),
        motion=dataclasses.replace(base.motion, frequency=values["motion.frequency"][k]),
        feed=Feed(values["feed.mass_flow_rate"][k], base.feed.mass_fraction),
        passage=Passage(velocity=values["passage.velocity"][k]),
        segregation=dataclasses.replace(
            base.segregation, dilation=values["segregation.dilation"][k]
        ),
    )


def assert_same(table: SteadyTable, k: int, config: ScreenConfig) -> None:
    steady = Screen(config).solve_steady()
    assert (table.recovery[k] == steady.recovery).all()
    assert (table.undersize[k] == steady.undersize.class_rates).all() or table.undersize[
        k
    ] == pytest.approx(steady.undersize.class_rates, rel=1e-14)
    assert table.oversize[k] == pytest.approx(steady.oversize.class_rates, rel=1e-14)
    for between, stream in zip(table.intermediate[k], steady.intermediate, strict=True):
        assert between == pytest.approx(stream.class_rates, rel=1e-14)
    assert table.hold_up[k] == steady.hold_up
    assert table.cut_size[k] == steady.cut_size
    assert table.ecart_probable[k] == steady.ecart_probable
    assert table.transport_velocity[k] == steady.transport_velocity
    assert table.residence_time[k] == pytest.approx(steady.residence_time, rel=1e-14)
    assert table.undersize_recovery[k] == pytest.approx(steady.undersize_recovery, rel=1e-13)


LOWER = Deck(2.4, (Panel(2.0, 5 * DEG, 6 * MM, 0.4), Panel(4.0, 2 * DEG, 5 * MM, 0.4)))


@pytest.mark.parametrize("lower", [(), (LOWER,)], ids=["one deck", "two decks"])
def test_many_give_the_bits_of_one_by_one(lower: tuple[Deck, ...]) -> None:
    base = ScreenConfig.default()
    base = base.replace(decks=(*base.decks, *lower))
    table = solve_steady_many(base, VALUES)
    assert table.recovery.shape == (COUNT, base.size_classes.count)
    for k in (0, CHUNK - 1, CHUNK, COUNT - 1):
        assert_same(table, k, configured(base, VALUES, k))
    # mass: what is fed leaves
    fed = np.outer(VALUES["feed.mass_flow_rate"], base.feed.mass_fraction)
    out = table.undersize + table.oversize + table.intermediate.sum(axis=1)
    assert out == pytest.approx(fed, rel=1e-12)


def test_threads_and_order_do_not_show() -> None:
    base = ScreenConfig.default()
    one = solve_steady_many(base, VALUES, threads=1)
    two = solve_steady_many(base, VALUES, threads=2)
    back = solve_steady_many(base, {name: v[::-1] for name, v in VALUES.items()}, threads=2)
    for name in ("recovery", "oversize", "hold_up", "cut_size"):
        assert (getattr(one, name) == getattr(two, name)).all()
        assert (getattr(one, name) == getattr(back, name)[::-1]).all()


def test_configurations_together() -> None:
    base = fixed_screen()
    configs = [configured(base, VALUES, k) for k in range(7)]
    ellipse = Motion.elliptical(0.005, 16.0, 0.8, 0.3)
    configs.append(base.replace(motion=ellipse, bed=Bed(15 * MM, layers=16)))
    table = solve_steady_many(configs)
    for k, config in enumerate(configs):
        assert_same(table, k, config)


def test_a_class_may_have_its_own_column_and_one_value_goes_for_all() -> None:
    classes = SizeClasses((0.0, 8 * MM, 16 * MM, 32 * MM))
    base = ScreenConfig(classes, displacement=Displacement("prescribed", 0.3))
    share = np.array([[0.2, 0.3, 0.5], [0.5, 0.3, 0.2]])
    rows = solve_steady_many(base, {"feed.mass_fraction": share, "feed.mass_flow_rate": 50.0})
    single = {f"feed.mass_fraction[{k + 1}]": share[:, k] for k in range(3)}
    columns = solve_steady_many(base, {**single, "feed.mass_flow_rate": 50.0})
    assert (rows.undersize == columns.undersize).all()
    assert rows.undersize.sum(axis=1) + rows.oversize.sum(axis=1) == pytest.approx(50.0, rel=1e-12)
    frame = rows.frame()
    assert list(frame["feed.mass_flow_rate"]) == [50.0, 50.0]
    assert frame.index.name == "design"


def test_refused_designs_are_raised_or_marked() -> None:
    base = ScreenConfig.default()
    values = {
        "feed.mass_flow_rate": [80.0, 0.0, 80.0, 80.0, -1.0],
        "motion.frequency": [15.5, 15.5, 0.0, 1000.0, 15.5],
    }
    with pytest.raises(InputError, match=r"design 1: feed\.mass_flow_rate = 0 kg/s has no steady"):
        solve_steady_many(base, values)
    table = solve_steady_many(base, values, refused="mark")
    assert list(table.refused) == [1, 2, 3, 4]
    assert "do not convey" in table.refused[2]
    assert re.search(r"motion\.frequency = 1000 Hz is out of range", table.refused[3])
    assert np.isfinite(table.recovery).all()
    assert (table.recovery[1:] == 0.0).all()
    assert_same(table, 0, base.replace(feed=Feed(80.0, base.feed.mass_fraction)))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"motion.frequenzy": [15.0]}, r"motion\.frequenzy is not a number .*motion\.frequency"),
        ({"passage.law": [1.0]}, r"passage\.law is not a number that a sweep can change"),
        ({"motion.frequency": [15.0, np.nan]}, r"motion\.frequency is not finite in design 1"),
        ({"motion.frequency": [[15.0]]}, r"motion\.frequency has the shape \(1, 1\)"),
        ({"motion.frequency": []}, r"motion\.frequency has the shape \(0,\)"),
        (
            {"motion.frequency": [15.0, 16.0], "motion.amplitude": [0.005] * 3},
            r"different lengths \(motion\.frequency: 2, motion\.amplitude: 3\)",
        ),
        ({"feed.mass_fraction": [[0.5, 0.5]]}, r"has 2 fractions a design, the screen has 12"),
        (
            {"deck[1].panel[1].aperture": [0.016, -0.01]},
            r"design 1: deck\[1\]\.panel\[1\]\.aperture = -0\.01 m",
        ),
        ({"material.bulk_density": [1.6]}, r"design 0: material\.bulk_density = 1\.6 kg/m3"),
    ],
)
def test_bad_values_are_refused_by_name(values: dict[str, object], text: str) -> None:
    with pytest.raises((ConfigError, InputError), match=text):
        solve_steady_many(ScreenConfig.default(), values)


def test_decks_of_one_box_stay_equally_long() -> None:
    base = ScreenConfig.default()
    base = base.replace(decks=(base.decks[0], LOWER))
    with pytest.raises(
        InputError, match=r"design 1: deck\[2\].*: this deck is 7 m long, deck\[1\]"
    ):
        solve_steady_many(base, {"deck[2].panel[1].length": [2.0, 3.0]})


def test_designs_of_another_structure() -> None:
    base = ScreenConfig.default()
    other = base.replace(segregation=Segregation("well_mixed"))
    with pytest.raises(InputError, match=r"designs\[1\] has another segregation\.model"):
        solve_steady_many([base, other])
    with pytest.raises(InputError, match="designs is empty"):
        solve_steady_many([])
    with pytest.raises(InputError, match="values go with one configuration"):
        solve_steady_many([base], {"motion.frequency": [15.0]})


def test_a_velocity_table_follows_the_aperture() -> None:
    rows = ((5 * MM, 0.05), (25 * MM, 0.25))
    base = ScreenConfig.default().replace(passage=Passage(velocity_table=rows))
    apertures = np.array([10 * MM, 16 * MM])
    table = solve_steady_many(base, {"deck[1].panel[1].aperture": apertures})
    for k, aperture in enumerate(apertures):
        panel = dataclasses.replace(base.decks[0].panels[0], aperture=aperture)
        config = base.replace(decks=(Deck(2.4, (panel,)),))
        assert table.recovery[k] == pytest.approx(Screen(config).solve_steady().recovery, abs=1e-14)


def test_progress_counts_up_to_all() -> None:
    seen: list[tuple[int, int]] = []
    solve_steady_many(
        ScreenConfig.default().replace(solver=Solver(1e-2)),
        {"motion.frequency": np.full(COUNT, 15.0)},
        progress=lambda done, total: seen.append((done, total)),
    )
    assert max(done for done, _ in seen) == COUNT
    assert {total for _, total in seen} == {COUNT}


def test_every_place_is_that_of_its_name() -> None:
    config = ScreenConfig.default()
    config = config.replace(decks=(config.decks[0], LOWER))
    layout = slice_layout(config)
    first = layout.section["parameters"].start
    found = places(config)
    panel, place = len(state.PANEL), state.PANEL.index("aperture")
    assert found["material.bulk_density"] == layout.offset["parameter"] - first
    assert found["deck[2].panel[2].aperture"] == layout.offset["panel"] + 3 * panel + place - first
    assert len(set(found.values())) == len(found)


def test_a_design_alone_has_its_own_nodes() -> None:
    """One design, or all alike, with another aperture than the configuration: as `Screen` says."""
    config = ScreenConfig.default()
    name = "deck[1].panel[1].aperture"
    alone = Screen(config.with_values({name: 0.018})).solve_steady().undersize.class_rates
    for count in (1, 3):
        table = solve_steady_many(config, {name: np.full(count, 0.018)})
        np.testing.assert_allclose(table.undersize, np.tile(alone, (count, 1)), rtol=1e-13)
