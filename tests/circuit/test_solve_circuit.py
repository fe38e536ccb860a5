"""Circuits solved directly: against linear algebra, the dynamic run, and what cannot close."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

from tests.places import ROOT
from vibroscreen import Feed, InputError, Screen, ScreenConfig
from vibroscreen.circuit import (
    CircuitTable,
    ConeCrusher,
    Crusher,
    Flowsheet,
    Product,
    RunningCircuit,
    ScreenUnit,
    solve_circuit,
    solve_circuit_many,
)
from vibroscreen.cli import app
from vibroscreen.errors import ConfigError
from vibroscreen.units import KW, MM, T_H

CLOSED = ROOT / "plant_examples" / "circuits" / "closed.toml"
SIZES = """
[size_classes]
edges_mm = [0, 4, 8, 16, 31.5, 63]
[[feed]]
name = "fresh"
to = "{to}"
rate_t_h = 200
passing = [0, 0.1, 0.25, 0.45, 0.8, 1]
"""
CRUSHER = """
[[cone_crusher]]
name = "{name}"
closed_side_setting_mm = {css}
capacity_t_h = {capacity}
product = "{to}"
"""
SCREEN = """
[[screen]]
name = "{name}"
file = "plant_examples/screens/{file}.toml"
undersize = "{under}"
oversize = "{over}"
{more}
"""


def balances(table: CircuitTable) -> None:
    """Mass of all units that hold their sizes, by class, and of the whole, to round-off."""
    sheet, good = table.flowsheet, np.isfinite(table.circulating_load)
    assert good.any()
    scale = table.fresh[good, None]
    for unit in sheet.units:
        come, left = table.feed(unit.name)[good], 0.0
        for outlet in unit.targets:
            left = left + table.stream(unit.name, outlet)[good]
        if isinstance(unit, Crusher):
            come, left = come.sum(axis=1, keepdims=True), left.sum(axis=1, keepdims=True)
        assert_allclose((left - come) / scale, 0.0, atol=1e-12)
    product = np.sum([table.product(p.name)[good].sum(axis=1) for p in sheet.products], axis=0)
    assert_allclose(product / table.fresh[good], 1.0, rtol=0, atol=1e-12)


def by_substitution(sheet: Flowsheet) -> float:
    """Load of the closed circuit by plain substitution: o = oversize of S(C (f + o))."""
    crusher, unit = sheet.unit["crusher"], sheet.unit["screen"]
    assert isinstance(crusher, Crusher)
    assert isinstance(unit, ScreenUnit)
    screen, fresh = Screen(unit.config), sheet.feeds[0].class_rates
    back = np.zeros_like(fresh)
    for _ in range(60):
        rates = crusher.crush(sheet.edges, fresh + back)
        feed = Feed(float(rates.sum()), tuple((rates / rates.sum()).tolist()))
        back = screen.solve_steady(feed).oversize.class_rates
    return float(back.sum() / fresh.sum())


def test_the_closed_circuit_is_that_of_plain_substitution_and_of_the_dynamic_run() -> None:
    """All three find one load; the dynamic run is stepped until it has settled."""
    sheet = Flowsheet.load(CLOSED).with_tolerance(1e-6)
    table = solve_circuit(sheet, tolerance=1e-9)
    assert table.status == ["closed"]
    balances(table)
    load = table.circulating_load[0]
    assert load == pytest.approx(by_substitution(sheet), abs=1e-6)
    running = RunningCircuit(sheet)
    for _ in range(32):
        streams = running.step(150.0)
    assert streams["belt", "product"].sum() / table.fresh[0] == pytest.approx(load, abs=1e-6)
    assert abs(running.balance_error) < 1e-12 * running.fed
    for name, power in table.power.items():
        assert running.power[name] == pytest.approx(float(power[0]), rel=1e-5, abs=1e-3)


def test_without_mixing_it_is_the_same_in_more_turns() -> None:
    sheet = Flowsheet.load(CLOSED)
    settings = {"crusher.closed_side_setting": np.linspace(12, 15, 30) * MM}
    mixed = solve_circuit_many(sheet, settings)
    plain = solve_circuit_many(sheet, settings, mixing=False)
    assert set(mixed.status) == set(plain.status) == {"closed"}
    assert_allclose(mixed.circulating_load, plain.circulating_load, atol=2e-5)
    assert mixed.turns.sum() < plain.turns.sum()


def test_designs_together_are_each_alone_bit_for_bit() -> None:
    sheet = Flowsheet.load(CLOSED)
    rng = np.random.default_rng(0)
    count = 70
    fractions = rng.dirichlet(np.full(12, 2.0), count)
    values = {
        "fresh.mass_flow_rate": rng.uniform(200, 320, count) * T_H,
        "fresh.mass_fraction": fractions,
        "screen.motion.frequency": rng.uniform(14.5, 17, count),
        "screen.deck[1].panel[1].aperture": rng.uniform(15, 18, count) * MM,
        "crusher.closed_side_setting": rng.uniform(12, 15, count) * MM,
    }
    all_of_them = solve_circuit_many(sheet, values, threads=2)
    balances(all_of_them)
    for part in (slice(0, 1), slice(13, 40), slice(69, 70)):
        some = solve_circuit_many(sheet, {n: v[part] for n, v in values.items()}, threads=1)
        assert_array_equal(some.status, all_of_them.status[part])
        assert_array_equal(some.circulating_load, all_of_them.circulating_load[part])
        assert_array_equal(some.energy, all_of_them.energy[part])
    row = all_of_them.frame().iloc[5]
    assert row["crusher feed, t/h"] == pytest.approx(all_of_them.feed("crusher")[5].sum() / T_H)


def test_no_recycle_is_unit_after_unit() -> None:
    """An open circuit: the screen's products are those of the crushed feed."""
    text = SIZES.format(to="c") + CRUSHER.format(name="c", css=20, capacity=500, to="s")
    text += SCREEN.format(name="s", file="quarry", under="fine", over="coarse", more="")
    text += '[[product]]\nname = "fine"\n[[product]]\nname = "coarse"\n'
    sheet = Flowsheet.loads(text, ROOT)
    assert sheet.cut == ()
    table = solve_circuit(sheet)
    balances(table)
    crusher = sheet.unit["c"]
    assert isinstance(crusher, Crusher)
    rates = crusher.crush(sheet.edges, sheet.feeds[0].class_rates)
    unit = sheet.unit["s"]
    assert isinstance(unit, ScreenUnit)
    steady = Screen(unit.config).solve_steady(Feed(rates.sum(), tuple(rates / rates.sum())))
    assert_allclose(table.product("fine")[0], steady.undersize.class_rates, rtol=1e-12, atol=1e-12)
    assert table.circulating_load[0] == 0.0


TWO = (
    SIZES.format(to="first")
    + CRUSHER.format(name="second", css=22, capacity=600, to="first")
    + CRUSHER.format(name="third", css=10, capacity=600, to="last")
    + SCREEN.format(
        name="first", file="two_deck", under="0/8", over="second", more='intermediate = ["last"]'
    )
    + SCREEN.format(name="last", file="quarry", under="8/16", over="gate", more="")
    + """
[[splitter]]
name = "gate"
share = 0.8
product = "third"
rest = "chips"
[[product]]
name = "0/8"
[[product]]
name = "8/16"
[[product]]
name = "chips"
"""
)


def test_two_recycles_and_three_products() -> None:
    """Everything balances, each unit gives what it must; the dynamic run is within tolerance."""
    sheet = Flowsheet.loads(TWO, ROOT)
    assert len(sheet.cut) == 2
    table = solve_circuit(sheet, tolerance=1e-8)
    assert table.status == ["closed"]
    balances(table)
    for name in ("first", "last"):
        unit, feed = sheet.unit[name], table.feed(name)[0]
        assert isinstance(unit, ScreenUnit)
        own = Screen(unit.config).solve_steady(Feed(feed.sum(), tuple(feed / feed.sum())))
        assert_allclose(own.oversize.class_rates, table.stream(name, "oversize")[0], atol=1e-6)
    assert_allclose(table.product("chips"), 0.25 * table.feed("third"), rtol=1e-12)
    running = RunningCircuit(sheet)
    for _ in range(40):
        streams = running.step(150.0)
    assert abs(running.balance_error) < 1e-12 * running.fed
    for key in (("first", "undersize"), ("last", "undersize"), ("gate", "rest")):
        assert_allclose(streams[key], table.stream(*key)[0], atol=1e-4 * table.fresh[0])


def test_a_circuit_that_cannot_close_says_which_grains_come_back() -> None:
    """An open crusher leaves 16 to 31.5 mm as it is, and the screen holds it back."""
    text = SIZES.format(to="c") + CRUSHER.format(name="c", css=60, capacity=900, to="s")
    text += SCREEN.format(name="s", file="quarry", under="fine", over="c", more="")
    table = solve_circuit(Flowsheet.loads(text + '[[product]]\nname = "fine"\n', ROOT))
    assert table.status == ["does not close"]
    assert "grains of 16 to 31.5 mm come back to" in table.reason[0]
    assert np.isnan(table.energy[0])
    assert np.isnan(table.circulating_load[0])


def test_the_cheapest_circuit_is_not_one_that_chokes_its_crusher() -> None:
    """Few kWh/t at a load of many times the feed: told as over capacity, and no energy is given."""
    sheet = Flowsheet.load(CLOSED)
    settings = np.linspace(13, 40, 28) * MM
    table = solve_circuit_many(sheet, {"crusher.closed_side_setting": settings})
    high = table.circulating_load > 2.0
    assert high.any()
    assert "closed" not in table.status[high]
    assert np.isnan(table.energy[table.status != "closed"]).all()
    over = int(np.flatnonzero(table.status == "over capacity")[0])
    assert "crusher is fed" in table.reason[over]
    assert "t/h at the most" in table.reason[over]
    closed = table.status == "closed"
    assert closed.any()
    assert (table.feed("crusher")[closed].sum(axis=1) <= 620 * T_H * (1 + 1e-12)).all()


def test_designs_out_of_range_are_marked_and_the_others_go_on() -> None:
    sheet = Flowsheet.load(CLOSED)
    values: dict[str, Any] = {
        "crusher.closed_side_setting": np.array([14, -1, 14, 14, 14]) * MM,
        "screen.deck[1].panel[1].aperture": np.array([16, 16, 16_000, 16, 16]) * MM,
        "fresh.mass_flow_rate": np.array([300, 300, 300, 0, -5]) * T_H,
    }
    table = solve_circuit_many(sheet, values)
    assert table.status.tolist() == ["closed", *["refused"] * 4]
    assert table.reason[1].startswith("crusher.closed_side_setting = -0.001 m is out of range")
    assert table.reason[2].startswith("screen: deck[1].panel[1].aperture = 16 m")
    assert table.reason[3].startswith("nothing is fed")
    assert table.reason[4].startswith("fresh.mass_flow_rate = -1.38889 kg/s is out of range")
    alone = solve_circuit(sheet)
    assert table.circulating_load[0] == alone.circulating_load[0]
    with pytest.raises(
        InputError, match=r"crusher\.setting is not a number .* crusher.closed_side_setting"
    ):
        solve_circuit_many(sheet, {"crusher.setting": [1.0]})


def test_a_band_says_what_is_in_specification() -> None:
    """Halves in 0-4 and 4-8 mm: 60 % passes 4.8 mm by a linear curve."""
    edges, rates = np.array([0.0, 4.0, 8.0]) * MM, np.array([[1.0, 1.0], [3.0, 1.0], [0.0, 0.0]])
    band = Product(name="p", at_sizes=(4.8 * MM,), least_passing=(0.59,), most_passing=(0.61,))
    assert band.meets(edges, rates).tolist() == [True, False, False]
    assert Product(name="p").meets(edges, rates).tolist() == [True, True, False]


def test_all_that_passes_is_not_more_than_all() -> None:
    """Sums differ in their last digits by the order in which they are taken."""
    edges, random = np.linspace(0.0, 34.0, 18) * MM, np.random.default_rng(1)
    products = random.uniform(0.0, 10.0, (500, 17))
    assert (products.sum(axis=1) < np.cumsum(products, axis=1)[:, -1]).any()
    band = Product(name="p", at_sizes=(34.0 * MM,), least_passing=(1.0,), most_passing=(1.0,))
    assert band.meets(edges, products).all()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'product = "screen"',
            'product = "scren"',
            "crusher.product = 'scren' is neither a unit nor",
        ),
        ('undersize = "0/16"', 'undersize = "belt"', "nothing leads from here to a product"),
        (
            "closed_side_setting_mm = 14",
            "css_mm = 14",
            "write cone_crusher[1].closed_side_setting_mm",
        ),
        ("capacity_t_h = 620", "", "cone_crusher[1].capacity_t_h is missing"),
        ('file = "../screens/quarry.toml"', 'file = "none.toml"', "cannot be read"),
        ('name = "belt"\n', 'name = "screen"\n', "name = 'screen' is given 2 times"),
        ("delay_s = 40", "delay_s = -40", "conveyor[1].delay_s = -40 is out of range"),
        ("[[feed]]", "[[feed]]\nfoo = 1", "feed[1].foo is unknown"),
    ],
)
def test_a_flowsheet_that_is_none_is_told(old: str, new: str, said: str) -> None:
    text = CLOSED.read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(ConfigError) as error:
        Flowsheet.loads(text.replace(old, new, 1), CLOSED.parent)
    assert said in str(error.value)


def test_a_screen_with_a_lower_deck_needs_a_name_for_what_leaves_over_it() -> None:
    config = ScreenConfig.load(ROOT / "plant_examples" / "screens" / "two_deck.toml")
    with pytest.raises(
        ConfigError, match=r"s\.intermediate has 0 names, the screen has 1 deck below"
    ):
        ScreenUnit(name="s", config=config, undersize="a", oversize="b")


def test_a_crusher_in_python() -> None:
    """Units are made in Python too."""
    crusher = ConeCrusher(name="c", closed_side_setting=14 * MM, capacity=100.0, product="p")
    sheet = Flowsheet.load(CLOSED)
    own = dataclasses.replace(
        sheet,
        units=(crusher,),
        feeds=(dataclasses.replace(sheet.feeds[0], to="c"),),
        products=(Product(name="p"),),
    )
    table = solve_circuit(own)
    assert_array_equal(table.product("p")[0], crusher.crush(own.edges, own.feeds[0].class_rates))
    assert table.power["c"][0] > 110 * KW


def test_the_command_prints_streams_and_says_why_not(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["circuit", str(CLOSED)], catch_exceptions=False)
    assert said.exit_code == 0
    assert "closed crushing circuit: closed" in said.stdout
    table = solve_circuit(Flowsheet.load(CLOSED))
    assert f"Circulating load {100 * table.circulating_load[0]:.1f} %" in said.stdout
    told = json.loads(CliRunner().invoke(app, ["circuit", str(CLOSED), "--json"]).stdout)
    assert told["outlets_t_h"]["screen.oversize"] == pytest.approx(
        table.stream("screen", "oversize")[0] / T_H
    )
    small = tmp_path / "small.toml"
    text = CLOSED.read_text(encoding="utf-8").replace("capacity_t_h = 620", "capacity_t_h = 300")
    screen = ROOT / "plant_examples" / "screens" / "quarry.toml"
    small.write_text(text.replace("../screens/quarry.toml", str(screen)), encoding="utf-8")
    choked = CliRunner().invoke(app, ["circuit", str(small), "--strict"])
    assert choked.exit_code == 3
    assert "over capacity" in choked.stdout
    assert "takes 300 t/h at the most" in " ".join(choked.stdout.split())
