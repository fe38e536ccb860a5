"""The configuration: every key and default of the contract, the round trip, and every refusal."""

from __future__ import annotations

import copy
import dataclasses
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.places import SCREENS
from vibroscreen import config as configuration
from vibroscreen.config import ScreenConfig, legal_keys, typical_fractions
from vibroscreen.errors import ConfigError
from vibroscreen.fields import from_si, to_si
from vibroscreen.motion import Harmonic, Motion
from vibroscreen.sections import (
    DEFAULT_TABLE,
    TABLE_COLUMNS,
    Bed,
    Deck,
    Displacement,
    Drive,
    Material,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed
from vibroscreen.units import DEG, GRAVITY, MM, T_H

QUARRY = SCREENS / "quarry.toml"

# The file of the contract, word for word but for comments.
CONTRACT = """
name = "quarry screen"
[size_classes]
edges_mm = [0, 2, 4, 8, 16, 31.5, 63]
subdivision = 0
[[deck]]
width_m = 2.4
[[deck.panel]]
length_m = 6.0
inclination_deg = 5.0
aperture_mm = 16.0
open_area = 0.55
velocity_factor = 1.0
[material]
bulk_density_kg_m3 = 1600.0
friction_deck = 0.5
friction_internal = 0.6
[motion]
kind = "linear"
stroke_mm = 10.0
frequency_hz = 15.5
throw_angle_deg = 45.0
[displacement]
model = "rigid_body"
[passage]
law = "pelevin"
velocity_m_s = 0.1
[segregation]
model = "exchange"
velocity_m_s = 0.1
dilation_mm = 1.0
proportion = 0.5
[bed]
contact_depth_mm = 20.0
initial = "empty"
[drive]
vibrating_mass_kg = 6000.0
bearing_friction = 0.005
bearing_diameter_mm = 120.0
efficiency = 0.9
[solver]
tolerance = 1e-4
[feed]
rate_t_h = 300.0
mass_fraction = [0.15, 0.10, 0.15, 0.20, 0.25, 0.15]
"""
# What the contract has for the numbers that go with the aperture, and what is taken where they are
# left out ("Numbers of typical practice"; the study of it: engine/validation/typical_practice.py).
USUAL = (
    ('model = "rigid_body"', 'model = "bed"'),
    (
        'law = "pelevin"\nvelocity_m_s = 0.1',
        'law = "pelevin"\nrelative_velocity = 0.56\nclosure = "vibration"',
    ),
    (
        "velocity_m_s = 0.1\ndilation_mm = 1.0",
        'relative_velocity = 0.034\nclosure = "vibration"\nrelative_dilation = 0.8',
    ),
    ("contact_depth_mm = 20.0", "relative_contact_depth = 1.0\nrelative_layer_depth = 1.0"),
)
# Keys that the contract tells of in words, and room for layers and packages.
TOLD = {
    "material.calibration",
    "bed.layer_depth_mm",
    "bed.layers",
    "bed.reconstruction",
    "deck.panel.opening",
    "deck.panel.relative_thickness",
    "deck.panel.slot_length_mm",
    "deck.panel.thickness_mm",
    "displacement.velocity_m_s",
    "feed.passing",
    "motion.ellipticity",
    "motion.harmonic.along_mm",
    "motion.harmonic.along_phase_deg",
    "motion.harmonic.normal_mm",
    "motion.harmonic.normal_phase_deg",
    "motion.harmonic.order",
    "motion.sense",
    "bed.relative_contact_depth",
    "bed.relative_layer_depth",
    "material.rolling",
    "passage.relative_velocity",
    "segregation.relative_velocity",
    "passage.closure",
    "passage.bouncing",
    "passage.crowding",
    "passage.drift",
    "passage.levelling",
    "passage.rim",
    "passage.velocity_table",
    "segregation.closure",
    "segregation.mixing_m_s",
    "segregation.relative_dilation",
    "solver.packages",
}
EDGES = "[size_classes]\nedges_mm = [0, 4, 16, 63]\n"

Place = tuple[str | int, ...]


def leaves(tree: Any, place: Place = ()) -> Iterator[Place]:
    """Places of all values in a TOML tree; a list of tables is entered, a list of numbers not."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from leaves(value, (*place, key))
    elif isinstance(tree, list) and isinstance(tree[0], dict):
        for index, value in enumerate(tree):
            yield from leaves(value, (*place, index))
    else:
        yield place


def changed(place: Place, value: Any = None, text: str = CONTRACT) -> dict[str, Any]:
    """The tree of a file with one value changed, or without it."""
    tree = tomllib.loads(text)
    table: Any = tree
    for key in place[:-1]:
        table = table[key]
    if value is None:
        del table[place[-1]]
    else:
        table[place[-1]] = value
    return tree


def value_at(place: Place) -> Any:
    value: Any = tomllib.loads(CONTRACT)
    for key in place:
        value = value[key]
    return value


def dotted(place: Place) -> str:
    return ".".join(key for key in place if isinstance(key, str))


def usual() -> str:
    """The contract's file with the numbers of typical practice."""
    text = CONTRACT
    for old, new in USUAL:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


PLACES = list(leaves(tomllib.loads(CONTRACT)))
USUAL_PLACES = list(leaves(tomllib.loads(usual())))
OTHER = {
    "name": "another",
    "motion.kind": "circular",
    "displacement.model": "prescribed",
    "passage.law": "gaudin",
    "segregation.model": "classified",
    "bed.initial": "steady",
    "size_classes.edges_mm": [0, 2, 4, 8, 16, 31.5, 64],
    "size_classes.subdivision": 3,
    "feed.mass_fraction": [0.10, 0.15, 0.15, 0.20, 0.25, 0.15],
}


def test_contract_is_read_in_si() -> None:
    config = ScreenConfig.loads(CONTRACT)
    assert config == ScreenConfig(
        name="quarry screen",
        size_classes=SizeClasses((0.0, 0.002, 0.004, 0.008, 0.016, 0.0315, 0.063), 0),
        decks=(Deck(2.4, (Panel(6.0, 5.0 * DEG, 0.016, 0.55, 1.0),)),),
        material=Material(1600.0, 0.5, 0.6),
        motion=Motion.linear(amplitude=0.005, frequency=15.5, throw_angle=45.0 * DEG),
        displacement=Displacement("rigid_body", 0.0),
        passage=Passage("pelevin", 0.1, None),
        segregation=Segregation("exchange", 0.1, 0.001, 0.5),
        bed=Bed(0.020, None, "empty", 32),
        drive=Drive(6000.0, 0.005, 0.12, 0.9),
        solver=Solver(1e-4, 0),
        feed=Feed(300.0 * T_H, (0.15, 0.10, 0.15, 0.20, 0.25, 0.15)),
    )


def test_legal_keys_are_those_of_the_contract() -> None:
    assert set(legal_keys()) == {dotted(place) for place in PLACES} | TOLD


@pytest.mark.parametrize("place", PLACES, ids=dotted)
def test_every_key_is_read(place: Place) -> None:
    now = value_at(place)
    other = OTHER[dotted(place)] if dotted(place) in OTHER else now * 0.96875
    tree = changed(place, other)
    if dotted(place) == "motion.kind":
        del tree["motion"]["throw_angle_deg"]
    assert ScreenConfig.from_dict(tree) != ScreenConfig.loads(CONTRACT)


@pytest.mark.parametrize(
    "place",
    [place for place in USUAL_PLACES if dotted(place) != "size_classes.edges_mm"],
    ids=dotted,
)
def test_every_default_is_the_value_of_the_contract(place: Place) -> None:
    left_out = ScreenConfig.from_dict(changed(place, text=usual()))
    assert left_out.explicit() == ScreenConfig.loads(usual()).explicit()


def test_size_classes_alone_make_the_screen_of_the_contract() -> None:
    tree = {"size_classes": {"edges_mm": [0, 2, 4, 8, 16, 31.5, 63]}}
    assert ScreenConfig.from_dict(tree).explicit() == ScreenConfig.loads(usual()).explicit()


def test_keys_told_in_words_are_read() -> None:
    config = ScreenConfig.loads(
        EDGES
        + "[displacement]\nmodel = 'prescribed'\nvelocity_m_s = 0.3\n"
        + "[bed]\nlayer_depth_mm = 15\nlayers = 8\n[solver]\npackages = 96\n"
        + "[feed]\npassing = [0, 0.25, 0.75, 1]\n"
    )
    assert config.displacement == Displacement("prescribed", 0.3)
    assert config.bed == Bed(layer_depth=0.015, layers=8)
    assert config.solver == Solver(packages=96)
    assert config.feed == Feed(300.0 * T_H, (0.25, 0.5, 0.25))


def test_layers_are_as_deep_as_the_contact_layer_unless_given() -> None:
    assert Bed(contact_depth=0.03).effective["layer_depth"] == 0.03
    deep = ScreenConfig.loads(EDGES + "[bed]\ncontact_depth_mm = 30")
    assert deep.value_of("bed.layer_depth") == 0.03
    relative = deep.with_values({"bed.contact_depth": 0.0, "bed.relative_contact_depth": 1.5})
    assert relative.value_of("bed.layer_depth") == 0.0
    assert relative.value_of("bed.relative_layer_depth") == 1.5
    usual = dataclasses.replace(Bed(), relative_contact_depth=2.0)
    assert usual.effective["relative_layer_depth"] == 2.0


def test_default_is_the_typical_quarry_screen() -> None:
    config = ScreenConfig.default()
    assert config.explicit() == ScreenConfig.load(QUARRY).explicit()
    assert config.size_classes.count == 12
    assert config.size_classes.edges[-1] == 0.075
    assert config.decks == (Deck(2.4, (Panel(6.0, 5.0 * DEG, 0.016, 0.55),)),)
    assert config.motion == Motion.linear(0.005, 15.5, 45.0 * DEG)
    assert config.feed.mass_flow_rate == pytest.approx(300.0 / 3.6)
    assert math.fsum(config.feed.mass_fraction) == pytest.approx(1.0, abs=1e-15)
    assert config.apertures == (0.016,)


def test_every_value_of_the_quarry_screen_is_the_default() -> None:
    tree = tomllib.loads(QUARRY.read_text(encoding="utf-8"))
    assert {dotted(place) for place in leaves(tree)} >= {dotted(place) for place in USUAL_PLACES}
    alone = {"size_classes": {"edges_mm": tree["size_classes"]["edges_mm"]}}
    assert ScreenConfig.from_dict(alone).explicit() == ScreenConfig.from_dict(tree).explicit()


# --- numbers that go with the aperture -----------------------------------------------------------
def test_numbers_go_with_the_aperture() -> None:
    """A part of the aperture alone switches off what is written by default, and the closure on."""
    told = ScreenConfig.loads(
        EDGES
        + "[passage]\nrelative_velocity = 0.56\n[segregation]\nrelative_velocity = 0.034\n"
        + "relative_dilation = 0.8\n[bed]\nrelative_contact_depth = 1.0\n"
    )
    assert told.passage.effective == {"velocity": 0.0, "relative_velocity": 0.56}
    assert told.passage.follows_vibration
    assert told.segregation.effective["dilation"] == told.segregation.effective["velocity"] == 0.0
    depths = (0.0, 1.0, 0.0, 1.0)
    assert tuple(told.bed.effective.values()) == depths
    assert ScreenConfig.loads(told.to_toml()) == told
    assert told.explicit().explicit() == told.explicit()
    fixed = told.with_values({"passage.velocity": 0.1})
    assert fixed.passage.effective == {"velocity": 0.1, "relative_velocity": 0.56}
    assert not fixed.passage.follows_vibration


# --- the typical feed ----------------------------------------------------------------------------
def test_typical_feed_scales_with_the_top_size() -> None:
    assert typical_fractions((0.0, 1.0, 2.0)) == typical_fractions((0.0, 0.001, 0.002))


def test_typical_feed_is_close_to_its_rosin_rammler_curve() -> None:
    size = np.linspace(0.0, 1.0, 101)
    constant, modulus = configuration.ROSIN_RAMMLER
    curve = -np.expm1(-((size / constant) ** modulus))
    passing = np.concatenate([[0.0], np.cumsum(typical_fractions(tuple(size)))])
    assert passing == pytest.approx(curve / curve[-1], abs=0.03)


@given(st.lists(st.floats(1e-6, 1.0), min_size=2, max_size=40, unique=True))
@example([1e-6, math.nextafter(1e-6, 1.0)])
@settings(deadline=None)
def test_typical_feed_fits_any_classes(edges: list[float]) -> None:
    config = ScreenConfig(SizeClasses(tuple(sorted(edges))))
    assert len(config.feed.mass_fraction) == len(edges) - 1
    assert math.fsum(config.feed.mass_fraction) == pytest.approx(1.0, abs=1e-14)
    assert min(config.feed.mass_fraction) >= 0.0


# --- motion --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "motion"),
    [
        ('kind = "circular"\nsense = "with_flow"', Motion.circular(0.005, 15.5, "with_flow")),
        ('kind = "circular"', Motion.circular(0.005, 15.5, "with_flow")),
        (
            'kind = "circular"\nsense = "against_flow"\nstroke_mm = 8\nfrequency_hz = 14',
            Motion.circular(0.004, 14.0, "against_flow"),
        ),
        (
            'kind = "elliptical"\nellipticity = -0.3\nthrow_angle_deg = 60',
            Motion.elliptical(0.005, 15.5, 60.0 * DEG, -0.3),
        ),
        ('kind = "elliptical"', Motion.elliptical(0.005, 15.5, 45.0 * DEG, 0.5)),
        ("stroke_mm = 8", Motion.linear(0.004, 15.5, 45.0 * DEG)),
        (
            (
                'kind = "harmonics"\nfrequency_hz = 12\n'
                "[[motion.harmonic]]\norder = 1\nalong_mm = 4\nalong_phase_deg = 10\n"
                "normal_mm = 3\nnormal_phase_deg = -20\n"
                "[[motion.harmonic]]\norder = 2\nnormal_mm = 0.5"
            ),
            Motion.harmonics(
                12.0,
                [
                    Harmonic(1, 0.004, 10.0 * DEG, 0.003, -20.0 * DEG),
                    Harmonic(2, 0.0, 0.0, 0.0005, 0.0),
                ],
            ),
        ),
        (
            (
                'kind = "harmonics"\nstroke_mm = 10\nthrow_angle_deg = 45\n'
                "[[motion.harmonic]]\norder = 2\nalong_mm = 1"
            ),
            Motion(15.5, 0.005, 45.0 * DEG, harmonic=(Harmonic(2, 0.001),)),
        ),
    ],
)
def test_motion_kinds(text: str, motion: Motion) -> None:
    config = ScreenConfig.loads(EDGES + "[motion]\n" + text)
    assert config.motion == motion
    assert ScreenConfig.loads(config.to_toml()) == config


# --- round trip ----------------------------------------------------------------------------------
BANANA = """
name = "banana \\"double deck\\" \\u007f \\n ü"
[size_classes]
edges_mm = [0.1, 1, 3.15, 22.4, 63]
subdivision = 4
[[deck]]
width_m = 2.1
[[deck.panel]]
length_m = 2.7
inclination_deg = 19.3
aperture_mm = 33.3
open_area = 0.61
[[deck.panel]]
length_m = 3.3
inclination_deg = 11.7
aperture_mm = 31.7
[[deck]]
[[deck.panel]]
inclination_deg = 9.1
aperture_mm = 7.7
[motion]
kind = "elliptical"
stroke_mm = 9.3
frequency_hz = 16.1
throw_angle_deg = 51.3
ellipticity = 0.37
[passage]
velocity_table = "default"
[bed]
initial = "steady"
contact_depth_mm = 17.3
[feed]
rate_t_h = 217.7
passing = [0, 0.1, 0.33, 0.77, 1]
"""


@pytest.mark.parametrize("text", [CONTRACT, BANANA, EDGES])
def test_what_was_read_is_written_and_read_back_exactly(text: str) -> None:
    config = ScreenConfig.loads(text)
    assert ScreenConfig.loads(config.to_toml()) == config


def test_decks_and_panels_keep_their_order() -> None:
    config = ScreenConfig.loads(BANANA)
    assert config.name == 'banana "double deck" \x7f \n ü'
    assert [len(deck.panels) for deck in config.decks] == [2, 1]
    assert config.apertures == pytest.approx((0.0333, 0.0317, 0.0077))
    assert config.decks[0].length == pytest.approx(6.0)


@given(st.floats(1e-9, 1e9), st.sampled_from([MM, 0.5 * MM, DEG, T_H, 1.0]))
def test_a_value_comes_back_within_the_last_place_and_from_then_on_exactly(
    value: float, factor: float
) -> None:
    once = to_si(from_si(value, factor), factor)
    assert abs(once - value) <= math.ulp(value)
    assert to_si(from_si(once, factor), factor) == once


@given(st.floats(1e-6, 1e6), st.sampled_from([MM, 0.5 * MM, DEG, T_H]))
def test_what_a_user_wrote_is_kept_to_the_digit_or_to_a_shorter_one(
    written: float, factor: float
) -> None:
    found = from_si(written * factor, factor)
    assert found * factor == written * factor
    assert len(repr(found)) <= len(repr(written)) + 1


def test_written_numbers_are_those_of_the_file() -> None:
    assert tomllib.loads(ScreenConfig.load(QUARRY).to_toml()) == tomllib.loads(
        QUARRY.read_text(encoding="utf-8")
    )


def test_python_values_survive_the_round_trip_to_the_last_place() -> None:
    config = ScreenConfig.default().replace(
        decks=(Deck(panels=(Panel(inclination=0.1, aperture=math.pi / 300.0),)),),
        motion=Motion.linear(math.e / 400.0, 15.1, 0.7),
    )
    once = ScreenConfig.loads(config.to_toml())
    assert once.decks[0].panels[0].aperture == pytest.approx(math.pi / 300.0, rel=3e-16)
    assert once.motion.throw_angle == pytest.approx(0.7, rel=3e-16)
    assert ScreenConfig.loads(once.to_toml()) == once


# --- replace, frozen ------------------------------------------------------------------------------
def test_replace_checks_again() -> None:
    config = ScreenConfig.default().replace(material=Material(friction_deck=0.4))
    assert config.material.friction_base == 0.4
    with pytest.raises(ConfigError, match=r"feed\.mass_fraction has 12 values, the screen has 2"):
        config.replace(size_classes=SizeClasses((0.0, 0.016, 0.063)))


def test_configuration_is_frozen_and_hashable() -> None:
    config: Any = ScreenConfig.default()
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.name = "other"
    assert hash(config) == hash(copy.deepcopy(config))


# --- velocity table ------------------------------------------------------------------------------
def test_shipped_table_is_what_its_comment_says() -> None:
    table = pd.read_csv(DEFAULT_TABLE, comment="#")
    assert tuple(table.columns) == TABLE_COLUMNS
    expected = 0.25 * np.sqrt(GRAVITY * table.aperture_mm * MM)
    assert table.velocity_m_s.to_numpy() == pytest.approx(expected.to_numpy(), rel=5e-4)
    passage = ScreenConfig.loads(EDGES + '[passage]\nvelocity_table = "default"').passage
    assert passage.velocity_at(0.016) == pytest.approx(0.1, rel=0.01)
    for aperture in (0.0005, 0.0115, 0.045):
        expected_velocity = 0.25 * math.sqrt(GRAVITY * aperture)
        assert passage.velocity_at(aperture) == pytest.approx(expected_velocity, rel=0.004)


def test_own_table_is_read_beside_the_file_and_interpolated(tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("# own\naperture_mm,velocity_m_s\n10,0.1\n20,0.3\n")
    (tmp_path / "screen.toml").write_text(EDGES + '[passage]\nvelocity_table = "u.csv"\n')
    config = ScreenConfig.load(tmp_path / "screen.toml")
    assert config.passage.velocity_table == ((0.01, 0.1), (0.02, 0.3))
    assert config.passage.velocity_at(0.016) == pytest.approx(0.22)
    (tmp_path / "u.csv").unlink()
    assert ScreenConfig.loads(config.to_toml()) == config


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "a,b\n1,2\n3,4\n",
            " has the columns a, b: name them aperture_mm, velocity_m_s",
        ),
        (
            "# own\naperture_mm,velocity_m_s\n10,0.1\n20,fast\n",
            (
                ", line 3 after the comments: could not convert string to float: 'fast': "
                "give a number in every column"
            ),
        ),
        (
            None,
            (
                " cannot be read (No such file or directory): give a file relative to the TOML "
                'file, or "default"'
            ),
        ),
    ],
)
def test_refusals_of_a_table_file(tmp_path: Path, content: str | None, message: str) -> None:
    path = tmp_path / "u.csv"
    if content is not None:
        path.write_text(content)
    tree = {
        "size_classes": {"edges_mm": [0, 16]},
        "passage": {"velocity_table": "u.csv"},
    }
    with pytest.raises(ConfigError) as refusal:
        ScreenConfig.from_dict(tree, tmp_path)
    assert str(refusal.value) == f"passage.velocity_table = {path}{message}"


# --- refusals ------------------------------------------------------------------------------------
def refused(text: str) -> str:
    with pytest.raises(ConfigError) as refusal:
        ScreenConfig.loads(text)
    return str(refusal.value)


TOML_REFUSALS = {
    "no size classes": ("", "size_classes is missing, it has no default: give it"),
    "no limits": (
        "[size_classes]\nsubdivision = 1",
        "size_classes.edges_mm is missing, it has no default: give it",
    ),
    "not TOML": (
        "name = quarry",
        "the text is not TOML (Invalid value (at line 1, column 8)): correct it there",
    ),
    "sizes out of order": (
        "[size_classes]\nedges_mm = [0, 16, 8]",
        (
            "size_classes.edges_mm[3] = 8 is not larger than the limit below it (16 mm): list the limits finest first, and what belongs to them in the same order"
        ),
    ),
    "unknown table": (
        EDGES + "[materials]",
        "materials is unknown: did you mean material?",
    ),
    "unknown key": (
        EDGES + "[material]\nfriction_decks = 0.5",
        "material.friction_decks is unknown: did you mean material.friction_deck?",
    ),
    "key without its unit": (
        EDGES + "[[deck]]\n[[deck.panel]]\n[[deck]]\n[[deck.panel]]\n[[deck.panel]]\naperture = 16",
        "deck[2].panel[2].aperture = 16 is unknown: write deck[2].panel[2].aperture_mm = 16",
    ),
    "key in another unit": (
        EDGES + "[[deck]]\n[[deck.panel]]\naperture_m = 0.016",
        "deck[1].panel[1].aperture_m = 0.016 is unknown: write deck[1].panel[1].aperture_mm = 16 (0.016 m)",
    ),
    "key one table too high": (
        EDGES + "[[deck]]\naperture_mm = 16",
        "deck[1].aperture_mm = 16 is unknown: write deck[1].panel.aperture_mm = 16",
    ),
    "table where a list is": (
        EDGES + "[deck]\nwidth_m = 2.4",
        "deck = {'width_m': 2.4} is not a list of tables: write [[deck]]",
    ),
    "number where a table is": (
        "material = 3\n" + EDGES,
        "material = 3 is not a table: write [material]",
    ),
    "no panel": (
        EDGES + "[[deck]]\npanel = []",
        "deck[1].panel = () is not a list of Panel: give one or more",
    ),
    "name": ("name = 3\n" + EDGES, "name = 3 is not a text: put it in quotes"),
    "aperture 0": (
        EDGES + "[[deck]]\n[[deck.panel]]\naperture_mm = 0",
        (
            "deck[1].panel[1].aperture_mm = 0 is out of range (0.02 to 500 mm): give a number in this range"
        ),
    ),
    "aperture in the wrong unit": (
        EDGES + "[[deck]]\n[[deck.panel]]\naperture_mm = 16000",
        (
            "deck[1].panel[1].aperture_mm = 16000 is out of range (0.02 to 500 mm): were micrometres meant? 16000 um is 16 mm"
        ),
    ),
    "NaN": (
        EDGES + "[[deck]]\n[[deck.panel]]\nopen_area = nan",
        (
            "deck[1].panel[1].open_area = nan is not a finite number (0 to 0.95): give the open part of the deck's area"
        ),
    ),
    "infinite": (
        EDGES + "[drive]\nvibrating_mass_kg = inf",
        (
            "drive.vibrating_mass_kg = inf is not a finite number (0 to 1e+06 kg): give a number in this range"
        ),
    ),
    "beyond the range of a double": (
        EDGES + f"[drive]\nvibrating_mass_kg = 1{'0' * 400}",
        (
            "drive.vibrating_mass_kg = inf is not a finite number (0 to 1e+06 kg): give a number in this range"
        ),
    ),
    "bool for a number": (
        EDGES + "[material]\nfriction_deck = true",
        ("material.friction_deck = True is not a number (0 to 100): give a friction coefficient"),
    ),
    "text for a number": (
        EDGES + '[bed]\ncontact_depth_mm = "20"',
        ("bed.contact_depth_mm = '20' is not a number (0 to 5000 mm): give a number in this range"),
    ),
    "fraction for a whole number": (
        EDGES + "[bed]\nlayers = 8.5",
        ("bed.layers = 8.5 is not a whole number (2 to 10000): give a whole number in this range"),
    ),
    "one layer": (
        EDGES + "[bed]\nlayers = 1",
        ("bed.layers = 1 is out of range (2 to 10000): give a whole number in this range"),
    ),
    "negative velocity": (
        EDGES + "[displacement]\nvelocity_m_s = -0.2",
        (
            "displacement.velocity_m_s = -0.2 is out of range (0 to 20 m/s): give a velocity down the deck; it cannot convey upwards"
        ),
    ),
    "density in t/m3": (
        EDGES + "[material]\nbulk_density_kg_m3 = 1.6",
        (
            "material.bulk_density_kg_m3 = 1.6 is out of range (10 to 25000 kg/m3): were t/m3 meant? 1.6 t/m3 is 1600 kg/m3"
        ),
    ),
    "length in mm": (
        EDGES + "[[deck]]\nwidth_m = 2400",
        "deck[1].width_m = 2400 is out of range (0.001 to 10 m): were millimetres meant? 2400 mm is 2.4 m",
    ),
    "vertical deck": (
        EDGES + "[[deck]]\n[[deck.panel]]\ninclination_deg = 90",
        (
            "deck[1].panel[1].inclination_deg = 90 is out of range (-45 to 45 deg): give a number in this range"
        ),
    ),
    "efficiency 0": (
        EDGES + "[drive]\nefficiency = 0",
        ("drive.efficiency = 0 is out of range (0.01 to 1): give a number in this range"),
    ),
    "tolerance": (
        EDGES + "[solver]\ntolerance = 1e-12",
        ("solver.tolerance = 1e-12 is out of range (1e-09 to 0.1): give a number in this range"),
    ),
    "too steep": (
        EDGES
        + "[displacement]\nmodel = 'rigid_body'\n[[deck]]\n[[deck.panel]]\ninclination_deg = 27",
        (
            'deck[1].panel[1].inclination_deg = 27 (27 deg, slope 0.5095) is too steep for the friction at the base (0.5), a rigid body would run away: make the deck flatter or use displacement.model = "bed" or "prescribed"'
        ),
    ),
    "unequal decks": (
        EDGES + "[[deck]]\n[[deck]]\n[[deck.panel]]\nlength_m = 5.5",
        (
            "deck[2].panel[1].length_m: this deck is 5.5 m long, deck[1] is 6 m: decks of one box are equally long, change the lengths of the panels"
        ),
    ),
    "unknown displacement": (
        EDGES + '[displacement]\nmodel = "rigidbody"',
        (
            "displacement.model = 'rigidbody' is unknown: give one of prescribed, rigid_body, "
            "bed (did you mean 'rigid_body'?)"
        ),
    ),
    "unknown law": (
        EDGES + '[passage]\nlaw = "godin"',
        (
            "passage.law = 'godin' is unknown: give one of gaudin, pelevin, bounce (did you mean 'gaudin'?)"
        ),
    ),
    "unknown segregation": (
        EDGES + "[segregation]\nmodel = 3",
        (
            "segregation.model = 3 is unknown: give one of well_mixed, proportional, exchange, "
            "classified"
        ),
    ),
    "unknown start": (
        EDGES + '[bed]\ninitial = "full"',
        "bed.initial = 'full' is unknown: give one of empty, steady",
    ),
    "unknown motion": (
        EDGES + '[motion]\nkind = "circle"',
        (
            "motion.kind = 'circle' is unknown: give one of linear, circular, elliptical, "
            "harmonics (did you mean 'circular'?)"
        ),
    ),
    "key of another motion": (
        EDGES + '[motion]\nkind = "linear"\nsense = "with_flow"',
        'motion.sense is unknown for kind = "linear": it belongs to kind = "circular"',
    ),
    "unknown key of a motion": (
        EDGES + "[motion]\nstroke_m = 0.01",
        "motion.stroke_m = 0.01 is unknown: write motion.stroke_mm = 10 (0.01 m)",
    ),
    "motion is no table": ("motion = 3\n" + EDGES, "motion = 3 is not a table: write [motion]"),
    "harmonics without any": (
        EDGES + '[motion]\nkind = "harmonics"',
        (
            'motion.harmonic is missing, motion.kind = "harmonics" has no other movement: '
            "give at least one [[motion.harmonic]]"
        ),
    ),
    "key of a harmonic": (
        EDGES + '[motion]\nkind = "harmonics"\n[[motion.harmonic]]\n[[motion.harmonic]]\nalong = 1',
        "motion.harmonic[2].along = 1 is unknown: write motion.harmonic[2].along_mm = 1",
    ),
    "both feeds": (
        EDGES + "[feed]\npassing = [0, 1]\nmass_fraction = [1]",
        "feed.mass_fraction and feed.passing say the same twice: give one of them",
    ),
    "negative feed": (
        EDGES + "[feed]\nrate_t_h = -3.6",
        "feed.rate_t_h = -3.6 is out of range (0 to 18000 t/h): give a finite rate, 0 for no feed",
    ),
    "sum of the fractions": (
        EDGES + "[feed]\nmass_fraction = [0.5, 0.2, 0.2]",
        "feed.mass_fraction sums to 0.9, not to 1 within 0.001: give the mass fractions of all size classes, or divide each by the sum",
    ),
    "sum of the fractions without feed": (
        EDGES + "[feed]\nrate_t_h = 0\nmass_fraction = [0.5, 0.2, 0.2]",
        "feed.mass_fraction sums to 0.9, not to 1 within 0.001: give the mass fractions of all size classes, or divide each by the sum",
    ),
    "number of fractions": (
        EDGES + "[feed]\nmass_fraction = [0.5, 0.5]",
        (
            "feed.mass_fraction has 2 values, the screen has 3 size classes: "
            "give one fraction a class, finest first"
        ),
    ),
    "no fractions": (
        EDGES + "[feed]\nmass_fraction = []",
        "feed.mass_fraction = [] is empty: give one value a class or leave it out",
    ),
    "number of passing values": (
        EDGES + "[feed]\npassing = [0, 0.5, 1]",
        (
            "feed.mass_fraction has 2 values, the screen has 3 size classes: "
            "give one fraction a class, finest first"
        ),
    ),
    "aperture beyond the table": (
        EDGES + "[[deck]]\n[[deck.panel]]\n[passage]\nvelocity_table = [[1, 0.1], [10, 0.2]]",
        (
            "deck[1].panel[1].aperture_mm = 16 lies outside of passage.velocity_table, which ends at 10 mm: add rows to the table or give passage.velocity"
        ),
    ),
    "velocity and table": (
        EDGES + '[passage]\nvelocity_m_s = 0.2\nvelocity_table = "default"',
        "passage.velocity_m_s = 0.2 is given beside passage.velocity_table: give one of them",
    ),
    "table of one row": (
        EDGES + "[passage]\nvelocity_table = [[16, 0.1]]",
        (
            "passage.velocity_table = ((0.016, 0.1),) is not a table of two or more rows (aperture, "
            'velocity): give a CSV file with the columns aperture_mm, velocity_m_s, or "default"'
        ),
    ),
    "table out of order": (
        EDGES + "[passage]\nvelocity_table = [[20, 0.1], [10, 0.2]]",
        (
            "passage.velocity_table[2].aperture = 10 mm is not larger than the one before, 20 mm: sort the rows by aperture"
        ),
    ),
    "table with a negative velocity": (
        EDGES + "[passage]\nvelocity_table = [[10, 0.1], [20, -0.2]]",
        (
            "passage.velocity_table[2].velocity = -0.2 is out of range (0 to 100 m/s): give a number in this range"
        ),
    ),
}


@pytest.mark.parametrize("case", TOML_REFUSALS)
def test_refusals_of_a_file(case: str) -> None:
    text, message = TOML_REFUSALS[case]
    assert refused(text) == message


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("stroke_mm = nan", "motion.stroke_mm = nan is "),
        ("stroke_mm = 5000", "motion.stroke_mm = 5000 is "),
        ("frequency_hz = 930", "motion.frequency_hz = 930 is "),
        ('frequency_hz = "15.5"', "motion.frequency_hz = '15.5' is not a number"),
        ('kind = "elliptical"\nellipticity = 2', "motion.ellipticity = 2 "),
        ('kind = "circular"\nsense = "left"', "motion.sense = 'left' "),
        ('kind = "harmonics"\n[[motion.harmonic]]\norder = 0', "motion.harmonic[1].order = 0 "),
    ],
)
def test_refusals_of_the_motion_become_errors_of_the_configuration(text: str, start: str) -> None:
    assert refused(EDGES + "[motion]\n" + text).startswith(start)


def test_too_steep_is_allowed_with_a_prescribed_velocity() -> None:
    text = EDGES + '[[deck]]\n[[deck.panel]]\ninclination_deg = 35\n[displacement]\nmodel = "{}"'
    config = ScreenConfig.loads(text.format("prescribed"))
    assert config.decks[0].panels[0].inclination == 35.0 * DEG
    assert "0.7002" in refused(text.format("rigid_body"))


def test_steeper_than_the_bed_was_checked_for_is_a_warning() -> None:
    text = EDGES + "[[deck]]\n[[deck.panel]]\ninclination_deg = {}\n[displacement]\nmodel = 'bed'"
    with pytest.warns(UserWarning, match="the displacement model bed was checked") as warned:
        config = ScreenConfig.loads(text.format(22))
    assert config.decks[0].panels[0].inclination == 22.0 * DEG
    said = str(warned[0].message)
    assert said.startswith("deck[1].panel[1].inclination_deg = 22 (22 deg, slope 0.404) is")
    assert "above 0.3744, the friction of a bed on a base of friction 0.5" in said
    ScreenConfig.loads(text.format(20))


def test_error_of_a_file_notes_the_file(tmp_path: Path) -> None:
    path = tmp_path / "screen.toml"
    path.write_text(EDGES + "[beds]")
    with pytest.raises(ConfigError, match="beds is unknown: did you mean bed") as refusal:
        ScreenConfig.load(path)
    assert refusal.value.__notes__ == [f"in {path}"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Panel(aperture=0.0),
            (
                "deck.panel.aperture = 0 m is out of range (2e-05 to 0.5 m): give a number in this range (aperture_mm in a TOML file)"
            ),
        ),
        (
            lambda: Deck(panels=(Panel(), Panel(length=0.5, aperture=16.0))),
            (
                "deck.panel.aperture = 16 m is out of range (2e-05 to 0.5 m): were "
                "millimetres meant? 16 mm is 0.016 m"
            ),
        ),
        (
            lambda: Deck(panels=cast("Any", (3,))),
            "deck.panels[1] = 3 is not a Panel: give Panel(...)",
        ),
        (
            lambda: ScreenConfig.default().replace(decks=()),
            "decks = () is not a list of Deck: give one or more",
        ),
        (
            lambda: ScreenConfig.default().replace(bed=20.0),
            "bed = 20.0 is not a Bed: give Bed(...)",
        ),
        (
            lambda: Passage(velocity_table=cast("Any", 3)),
            (
                "passage.velocity_table = 3 is not a table of two or more rows (aperture, velocity): "
                'give a CSV file with the columns aperture_mm, velocity_m_s, or "default"'
            ),
        ),
    ],
)
def test_refusals_in_python(make: Any, message: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        make()
    assert str(refusal.value) == message


@given(
    st.sampled_from(PLACES),
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(),
        st.text(max_size=5),
        st.lists(st.one_of(st.floats(), st.text(max_size=3), st.booleans()), max_size=7),
        st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
    ),
)
@settings(max_examples=300, deadline=None)
def test_any_value_is_taken_or_refused_in_words(place: Place, value: Any) -> None:
    words = ""
    try:
        config = ScreenConfig.from_dict(changed(place, value))
    except ConfigError as refusal:
        words = str(refusal)
    if words:
        assert words.partition(":")[2].strip()
    else:
        assert ScreenConfig.loads(config.to_toml()) == config


def test_files_of_version_0_4_0_load_unless_they_use_what_is_gone() -> None:
    """Constants of the law bounce of then stand in files with every law: they are told of."""
    text = "[size_classes]\nedges_mm = [0, 8, 16, 40]\n[passage]\ndamping = 1.0\nlaw = "
    with pytest.warns(
        UserWarning, match=r"passage\.damping is a constant of an earlier law bounce"
    ):
        config = ScreenConfig.loads(text + '"pelevin"')
    assert config.passage.law == "pelevin"
    with pytest.raises(ConfigError, match=r"passage\.damping"):
        ScreenConfig.loads(text + '"bounce"')
