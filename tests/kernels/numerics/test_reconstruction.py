"""Layers of linear composition: nearer to the continuum at equal layers, and no mass is lost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.benchmarks import work_precision as bench
from vibroscreen import ConfigError, Feed, Screen, ScreenConfig, register
from vibroscreen.sections import Bed, Segregation, Solver

LAYERS = (16, 32, 64)
TOLERANCE = 1e-4
# Title of a scene: its error at equal layers falls by this factor at least, and order in layers.
EXPECTED = {"c1": (3.0, 0.9), "c2": (4.0, 1.0), "c3": (1.6, 1.0)}


def followed(
    scene: bench.ColumnScene, layers: int, reconstruction: str, tolerance: float = TOLERANCE
) -> bench.ClosedColumn:
    register("segregation", scene.law.__name__, scene.law, layered=True)
    column = bench.ClosedColumn(scene, layers, tolerance, reconstruction)
    column.follow()
    return column


@pytest.mark.parametrize("scene", bench.column_scenes(), ids=lambda s: s.title[:2])
def test_error_is_smaller_at_equal_layers(scene: bench.ColumnScene) -> None:
    factor, order = EXPECTED[scene.title[:2]]
    errors: dict[str, list[float]] = {"none": [], "linear": []}
    for layers in LAYERS:
        for name, found in errors.items():
            column = followed(scene, layers, name)
            found.append(column.error(column.load()))
    ratio = np.array(errors["none"]) / errors["linear"]
    assert ratio.min() > factor, ratio
    assert -np.polyfit(np.log(LAYERS), np.log(errors["linear"]), 1)[0] > order, errors


@pytest.mark.parametrize("scene", bench.column_scenes(), ids=lambda s: s.title[:2])
def test_classes_and_full_layers_are_kept(scene: bench.ColumnScene) -> None:
    load = followed(scene, 32, "linear").load()
    whole = bench.DENSITY * bench.COLUMN_DEPTH
    fed = whole * np.array([scene.fine, 1.0 - scene.fine])
    assert load.min() >= 0.0
    assert load.sum(axis=0) == pytest.approx(fed, rel=1e-12)
    assert load.sum(axis=1) == pytest.approx(np.full(32, whole / 32), rel=1e-9)


@pytest.mark.parametrize("scene", bench.column_scenes(), ids=lambda s: s.title[:2])
def test_full_column_takes_no_implicit_step(scene: bench.ColumnScene) -> None:
    column = followed(scene, 32, "linear")
    layout, buffer = bench.slice_of(column.screen)
    assert layout.record(buffer, "counter").sub_steps == 0.0


def deck(reconstruction: str | None, **bed: object) -> ScreenConfig:
    config = ScreenConfig.default()
    if reconstruction is not None:
        bed["reconstruction"] = reconstruction
    return config.replace(
        bed=dataclasses.replace(config.bed, **bed),
        segregation=Segregation("exchange"),
        solver=Solver(1e-3),
    )


def test_none_is_the_default_and_the_same_to_the_bit() -> None:
    assert Bed().reconstruction == "none"
    one, two = (Screen(deck(name)).solve_steady().recovery for name in (None, "none"))
    assert np.array_equal(one, two)
    with pytest.raises(ConfigError, match="reconstruction"):
        Bed(reconstruction="cubic")


def test_two_layers_have_no_slope() -> None:
    """Ends are even: a bed of two layers is the same with either."""
    scene = bench.column_scenes()[0]
    none, linear = (followed(scene, 2, name, 1e-8).load() for name in ("none", "linear"))
    assert none == pytest.approx(linear, rel=1e-5)


def test_key_in_a_file() -> None:
    config = deck("linear")
    assert ScreenConfig.loads(config.to_toml()).bed == config.bed


def test_exchange_deck_keeps_all_mass() -> None:
    """Thin upper layers on a deck with a feed that changes, discharge and layers that run out."""
    config = deck("linear", layer_depth=0.01, layers=24)
    screen = Screen(config)
    fed = config.feed
    for rate in (1.0, 1.0, 1.3, 0.7, 0.0):
        for _ in range(4):
            screen.step(2.0, Feed(rate * fed.mass_flow_rate, fed.mass_fraction))
            balance = screen.balance()
            assert (balance.error.abs() <= 1e-12 * (balance.fed + balance.initial)).all()
    for name in ("load", "lead", "lead_passed", "partial"):
        assert screen.view(name).min() >= 0.0
    steady = screen.solve_steady(fed)
    assert steady.recovery.min() >= 0.0
    assert steady.recovery.max() <= 1.0
