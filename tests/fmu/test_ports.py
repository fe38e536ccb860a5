"""The table of ports: complete, in order, and as the configuration says."""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.places import SCREENS
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.figures import DECK
from vibroscreen.layout import Layout
from vibroscreen.registry import BUILT_IN
from vibroscreen.screen import Screen
from vibroscreen.sections import Bed, Deck, Panel, Passage
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, MM
from vibroscreen_fmu.drawing import drawn
from vibroscreen_fmu.icons import PICTURES
from vibroscreen_fmu.port import UNITS, Port
from vibroscreen_fmu.ports import ports
from vibroscreen_fmu.python_slave import configured

EDGES = (0.0, 5 * MM, 10 * MM, 20 * MM)
SHIPPED = sorted(SCREENS.glob("*.toml"))


def table(config: ScreenConfig) -> dict[str, Port]:
    return {port.name: port for port in ports(config)}


def checked(config: ScreenConfig, values: Mapping[Port, float]) -> None:
    """Set parameters as a host does, and start the screen with them."""
    screen = Screen(config)
    row = screen.buffer[screen.layout.section["parameters"]]
    for port, value in values.items():
        row[port.reference] = value
    screen.initialise()


@pytest.fixture
def config() -> ScreenConfig:
    return ScreenConfig(SizeClasses(EDGES))


def with_panels(*counts: int) -> ScreenConfig:
    """A screen with so many panels on each deck, no two of them alike."""
    number = iter(range(1, 1 + sum(counts)))
    decks = tuple(
        Deck(
            2.0 + d, tuple(Panel(6.0 / count, inclination=next(number) * DEG) for _ in range(count))
        )
        for d, count in enumerate(counts)
    )
    return ScreenConfig(SizeClasses(EDGES), decks=decks)


@pytest.mark.parametrize("panels", [1, 3])
@pytest.mark.parametrize("decks", [1, 2, 4])
def test_every_place_has_one_port(decks: int, panels: int) -> None:
    rows = ports(with_panels(*(panels,) * decks))
    assert [port.reference for port in rows] == list(range(len(rows)))
    assert len({port.name for port in rows}) == len(rows)
    # 31 parameters, 2 x 3 limits, width and 9 values a panel; 6 inputs; 29 outputs; 3 streams;
    # 17 of every deck; rate, mass, sizes and composition of what leaves over a lower deck
    assert len(rows) == (
        31 + 6 + decks * (1 + 9 * panels) + 6 + 29 + 3 * 3 + 17 * decks + (decks - 1) * (4 + 3)
    )


@pytest.mark.parametrize("counts", [(1, 3), (3, 1), (2, 1, 3, 1)])
def test_decks_of_unlike_panels_leave_room_without_ports(counts: Sequence[int]) -> None:
    config = with_panels(*counts)
    rows, found = ports(config), table(config)
    references = [port.reference for port in rows]
    assert references == sorted(set(references))
    layout = Screen(config).layout
    first = layout.section["parameters"].start
    panel, size = layout.offset["panel"] - first, 9 * max(counts)
    unused = {
        panel + size * d + place
        for d, count in enumerate(counts)
        for place in range(9 * count, size)
    }
    assert set(references) == set(range(layout.section["outputs"].stop - first)) - unused
    assert {
        name.rpartition(".")[0] for name in found if name.startswith("deck[") and ".panel[" in name
    } == {
        f"deck[{d}].panel[{p}]"
        for d, count in enumerate(counts, start=1)
        for p in range(1, count + 1)
    }


def test_parameters_of_unlike_panels_are_their_own() -> None:
    config = with_panels(1, 3)
    found, screen = table(config), Screen(config)
    for d, deck in enumerate(config.decks):
        assert found[f"deck[{d + 1}].width"].start == deck.width
        for p, panel in enumerate(deck.panels):
            port = found[f"deck[{d + 1}].panel[{p + 1}].inclination"]
            assert port.start == panel.inclination
            assert port.path == ("decks", d, "panels", p, "inclination")
            place = port.reference + screen.layout.section["parameters"].start
            assert screen.buffer[place] == panel.inclination


def test_references_are_places_in_the_buffer_of_a_screen(config: ScreenConfig) -> None:
    layout: Layout = Screen(config).layout
    variables = slice(layout.section["parameters"].start, layout.section["outputs"].stop)
    assert len(ports(config)) == variables.stop - variables.start
    found = table(config)
    for name, field, index in (
        ("material.bulk_density", "parameter", 0),
        ("size_class[2].upper", "upper", 1),
        ("deck[1].width", "width", 0),
        ("deck[1].panel[1].aperture", "panel", 2),
        ("feed.mass_fraction[3]", "fraction", 2),
        ("oversize.mass_fraction[1]", "oversize_fraction", 0),
    ):
        assert found[name].reference == layout.offset[field] + index - variables.start, name


def test_outputs_of_decks_are_those_of_the_screen() -> None:
    """Every number of a step's result stands where its port says."""
    screen = Screen(with_panels(2, 1, 3))
    for _ in range(5):
        result = screen.step(20.0)
    values = screen.buffer[screen.layout.section["parameters"].start :]
    outputs = {
        name: values[port.reference]
        for name, port in table(screen.config).items()
        if port.causality == "output"
    }
    assert len(result.intermediate) == 2
    assert len(result.decks) == 3
    expected: dict[str, float] = {}
    for k, stream in enumerate(result.intermediate, start=1):
        assert stream.mass_flow_rate > 0.0
        expected[f"intermediate[{k}].mass_flow_rate"] = stream.mass_flow_rate
        for name in ("p80", "p50"):
            size = getattr(screen.record("intermediate")[k - 1], name)
            assert 0.0 < size < 20 * MM
            expected[f"intermediate[{k}].{name}"] = size
        expected[f"intermediate[{k}].mass"] = screen.balance()[f"intermediate_{k}"].sum()
        for i, fraction in enumerate(stream.mass_fraction, start=1):
            expected[f"intermediate[{k}].mass_fraction[{i}]"] = fraction
    for d, deck in enumerate(result.decks, start=1):
        for figure in DECK:
            expected[f"deck[{d}].{figure.name}"] = getattr(deck, figure.scalar)
    own = {name for name in outputs if name.startswith(("intermediate[", "deck["))}
    assert own == set(expected)
    for name, value in expected.items():
        assert outputs[name] == pytest.approx(value, rel=1e-15), name


@pytest.mark.parametrize("decks", [1, 2])
def test_outputs_of_decks_are_told_with_unit_and_meaning(decks: int) -> None:
    found = table(with_panels(*(1,) * decks))
    for d in range(1, decks + 1):
        units = {
            "bed.hold_up": "kg",
            "bed.depth_feed": "m",
            "bed.depth_over_aperture_discharge": "1",
            "bed.transport_velocity": "m/s",
            "motion.throw_number": "1",
            "performance.oversize_rate": "kg/s",
            "performance.efficiency": "1",
            "performance.misplaced_undersize": "1",
            "performance.misplaced_oversize": "1",
            "performance.cut_size": "m",
            "performance.ecart_probable": "m",
            "performance.imperfection": "1",
        }
        for short, unit in units.items():
            port = found[f"deck[{d}].{short}"]
            assert (port.unit, port.causality, port.variability) == (unit, "output", "continuous")
            assert port.start is None
            assert f"deck {d}" in port.description
    # what is said of one deck alone is not there
    assert ("intermediate[1].mass" in found) == (decks > 1)
    if decks > 1:
        assert found["intermediate[1].mass_flow_rate"].unit == "kg/s"
        assert found["intermediate[1].mass"].unit == "kg"
        assert found["intermediate[1].mass_fraction[3]"].least == 0.0
        for name in ("mass_flow_rate", "mass", "mass_fraction[3]"):
            assert "over deck 2" in found[f"intermediate[1].{name}"].description


def test_start_values_are_those_of_the_configuration() -> None:
    config = ScreenConfig.default()
    found = table(config)
    panel = config.decks[0].panels[0]
    assert found["deck[1].panel[1].aperture"].start == panel.aperture
    assert found["deck[1].panel[1].inclination"].start == panel.inclination
    assert found["material.friction_internal"].start == config.material.friction_internal
    assert found["feed.mass_flow_rate"].start == config.feed.mass_flow_rate
    assert found["feed.mass_fraction[12]"].start == config.feed.mass_fraction[11]
    assert found["motion.amplitude"].start == config.motion.amplitude
    assert found["passage.law"].start == 2.0
    assert found["segregation.model"].start == 3.0
    assert found["undersize.mass"].start is None


def test_limits_are_those_of_the_configuration(config: ScreenConfig) -> None:
    found = table(config)
    limits = {name: (port.least, port.most) for name, port in found.items()}
    assert limits["solver.tolerance"] == (1e-9, 1e-1)
    assert limits["deck[1].panel[1].open_area"] == (0.0, 0.95)
    assert limits["feed.mass_flow_rate"][0] == 0.0
    assert limits["feed.mass_fraction[1]"] == (0.0, 1.0)
    assert limits["motion.ellipticity"] == (-1.0, 1.0)
    assert limits["passage.law"] == (None, None)
    for port in found.values():
        if port.start is not None:
            assert port.least is None or port.start >= port.least, port.name
            assert port.most is None or port.start <= port.most, port.name


def test_every_port_is_described_and_has_a_known_unit() -> None:
    for port in ports(with_panels(2, 1)):
        assert port.unit in UNITS, port.name
        assert port.description[0].isupper(), port.name
        assert not port.description.endswith("."), port.name


def test_items_of_enumerations_are_in_the_order_of_the_engine(config: ScreenConfig) -> None:
    choices = {port.name: port.enumeration for port in ports(config) if port.enumeration}
    items = {name: tuple(item for item, _ in choice.items) for name, choice in choices.items()}
    assert items == {
        "passage.law": BUILT_IN["passage"],
        "segregation.model": BUILT_IN["segregation"],
        "displacement.model": BUILT_IN["displacement"],
        "bed.initial": ("empty", "steady"),
        "deck[1].panel[1].opening": ("square", "slot", "round", "slot_across"),
    }


def test_every_parameter_can_be_changed_in_the_configuration(config: ScreenConfig) -> None:
    """What a parameter's port says about its place in ScreenConfig is so."""
    config = config.explicit()  # as the slave reads it
    before = {port.name: port.start for port in ports(config)}
    for port in ports(config):
        # limits of classes change in pairs
        if port.causality != "parameter" or port.name.startswith("size_class["):
            continue
        assert port.start is not None
        value = port.start % 2 + 1.0 if port.enumeration else port.start * 1.01
        if port.name.endswith(".opening"):
            value = 3.0  # a slot has a length too
        after = {port.name: port.start for port in ports(configured(config, {port: value}))}
        assert after == before | {port.name: value}


def test_limits_of_classes_change_together(config: ScreenConfig) -> None:
    found = table(config)
    upper, lower = found["size_class[1].upper"], found["size_class[2].lower"]
    changed = configured(config, {upper: 6 * MM, lower: 6 * MM})
    assert changed.size_classes.edges == (0.0, 6 * MM, 10 * MM, 20 * MM)
    message = r"size_class\[1\]\.upper = 0\.006 m differs from .* \(0\.005 m\): set both"
    with pytest.raises(InputError, match=message):
        checked(config, {upper: 6 * MM, lower: 5 * MM})


def test_changes_are_checked_as_a_whole(config: ScreenConfig) -> None:
    long_deck = dataclasses.replace(config, decks=(Deck(panels=(Panel(2.0), Panel(2.0))),) * 2)
    found = table(long_deck)
    lengths = [port for name, port in found.items() if name.endswith(".length")]
    assert len(lengths) == 4
    changed = configured(long_deck, dict.fromkeys(lengths, 3.0))
    assert [deck.length for deck in changed.decks] == [6.0, 6.0]
    with pytest.raises(InputError, match="decks of one box are equally long"):
        checked(long_deck, {lengths[0]: 3.0})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "passage.law",
            7.0,
            r"passage\.law = 7 is out of range \(1 to 3\): give 1 gaudin, 2 pelevin",
        ),
        ("deck[1].panel[1].aperture", math.nan, r"^deck\[1\]\.panel\[1\]\.aperture = nan m"),
        ("deck[1].panel[1].inclination", 80 * DEG, r"^deck\[1\]\.panel\[1\]\.inclination = 1\.39"),
        ("deck[1].width", -1.0, r"^deck\[1\]\.width = -1 m is out of range \(0\.001 to 10 m\)"),
        ("material.bulk_density", 1.6, r"^material\.bulk_density = 1\.6 kg/m3"),
    ],
)
def test_bad_values_are_refused_by_name(
    config: ScreenConfig, name: str, value: float, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        checked(config, {table(config)[name]: value})


def test_a_velocity_takes_the_place_of_a_table(config: ScreenConfig) -> None:
    rows = ((10 * MM, 0.1), (20 * MM, 0.2))
    tabled = config.replace(passage=Passage(velocity_table=rows))
    port = table(tabled)["passage.velocity"]
    assert port.start == tabled.passage.velocity_at(16 * MM)
    assert configured(tabled, {port: 0.3}).passage == Passage(velocity=0.3)
    aperture = table(tabled)["deck[1].panel[1].aperture"]
    finer = configured(tabled, {aperture: 10 * MM})
    assert table(finer)["passage.velocity"].start == 0.1


def test_the_layer_depth_stays_when_the_contact_depth_changes(config: ScreenConfig) -> None:
    """An FMU has both written out, so that a variable changes what it says and nothing else."""
    written = config.replace(bed=Bed(contact_depth=0.02)).explicit()
    bed = configured(written, {table(written)["bed.contact_depth"]: 0.03}).bed
    assert (bed.effective["contact_depth"], bed.effective["layer_depth"]) == (0.03, 0.02)


# --- the screens that are shipped ----------------------------------------------------------------
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_screens_survive_the_way_into_the_fmu(path: Path) -> None:
    config = ScreenConfig.load(path)
    again = ScreenConfig.loads(config.to_toml())
    assert again == config
    assert again.to_toml() == config.to_toml()
    assert ports(again) == ports(config)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_screens_do_what_they_are_for(path: Path) -> None:
    """Fines pass, oversize does not, the bed moves, and steps end in the steady solution."""
    screen = Screen(ScreenConfig.load(path))
    steady = screen.solve_steady()
    upper = screen.config.size_classes.upper
    # The plate has no fines: its finest class is 3 mm on openings of 8 mm.
    assert steady.recovery[0] > (0.99 if screen.config.size_classes.edges[0] == 0.0 else 0.95)
    assert (steady.recovery[upper > steady.aperture * (1.0 + 1e-9)] == 0.0).all()
    assert (steady.recovery[:-1] >= steady.recovery[1:] - 1e-12).all()
    fed = screen.config.feed.mass_flow_rate
    streams = (steady.undersize, steady.oversize, *steady.intermediate)
    assert sum(stream.mass_flow_rate for stream in streams) == pytest.approx(fed, rel=1e-12)
    assert min(stream.mass_flow_rate for stream in streams) > 0.1 * fed
    for _ in range(60):
        result = screen.step(5.0)
    assert result.alarms == ()
    assert min(bed.transport_velocity for bed in result.decks) > 0.0
    fed_mass = screen.record("output").feed_mass
    assert abs(result.balance_error) <= 1e-12 * fed_mass
    for found, expected in zip(
        (result.undersize, result.oversize, *result.intermediate), streams, strict=True
    ):
        assert found.mass_flow_rate == pytest.approx(expected.mass_flow_rate, abs=1e-4 * fed)


def test_pictures_are_those_that_are_drawn() -> None:
    """The files beside the sources, but for what versions of the library draw differently."""
    for name, content in drawn().items():
        now, kept = (
            np.asarray(Image.open(file).convert("RGBA"), dtype=float)
            for file in (io.BytesIO(content), PICTURES / name)
        )
        assert now.shape == kept.shape
        assert np.abs(now - kept).mean() < 2.0
