"""Named sets of numbers: what a screen takes of them, what it is told, and how they are refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vibroscreen import Motion, ScreenConfig, number_sets
from vibroscreen.errors import ConfigError
from vibroscreen.number_sets import TABLES, NumberSet, Range
from vibroscreen.sections import Deck, Material, Panel, Passage
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import MM

EDGES = "[size_classes]\nedges_mm = [0, 4, 8, 16, 31.5, 63]\n"
OWN = """
name = "our quarry"
fitted_to = "surveys of May"
rmse = 0.02
[range]
aperture_mm = [10, 20]
motion = ["linear"]
[displacement]
model = "rigid_body"
[passage]
law = "gaudin"
velocity_m_s = 0.3
closure = "vibration"
[segregation]
relative_velocity = 0.05
dilation_mm = 2
[bed]
contact_depth_mm = 15
layer_depth_mm = 5
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "ours.toml").write_text(OWN)
    return tmp_path


def load(folder: Path, more: str = "") -> ScreenConfig:
    """A screen beside the set that it names."""
    text = f'{EDGES}[material]\ncalibration = "ours.toml"\n{more}'
    (folder / "screen.toml").write_text(text)
    return ScreenConfig.load(folder / "screen.toml")


def test_the_shipped_sets_can_be_read() -> None:
    assert number_sets.names() == ("typical dry stone", "dem plate", "ivanov-vaisberg")
    for name in number_sets.names():
        config = ScreenConfig(
            SizeClasses((0.0, 0.0005, 0.02)),
            (Deck(panels=(Panel(aperture=0.5 * MM),)),),
            material=Material(calibration=name),
        )
        assert config.calibration.name == config.material.calibration == name
        assert config.calibration.fitted_to
        assert not any("is not that of" in said for said in config.beyond_calibration())


def test_a_set_gives_what_is_not_written(own: Path) -> None:
    config = load(own)
    assert (config.displacement.model, config.passage.law) == ("rigid_body", "gaudin")
    assert config.passage.effective == {"velocity": 0.3, "relative_velocity": 0.0}
    assert config.passage.follows_vibration
    assert config.segregation.effective["dilation"] == pytest.approx(2.0 * MM)
    assert config.segregation.effective["relative_velocity"] == 0.05
    assert config.bed.effective["layer_depth"] == pytest.approx(5.0 * MM)
    assert config.beyond_calibration() == []


@pytest.mark.parametrize(
    ("more", "number", "value"),
    [
        ("[passage]\nlaw = 'pelevin'", "passage.velocity", 0.3),
        ("[passage]\nvelocity_m_s = 0.1", "passage.velocity", 0.1),
        ("[passage]\nrelative_velocity = 0.5", "passage.velocity", 0.0),
        ("[segregation]\nvelocity_m_s = 0.1", "segregation.relative_velocity", 0.0),
        ("[segregation]\nrelative_dilation = 0.4", "segregation.dilation", 0.0),
        ("[bed]\nrelative_contact_depth = 2", "bed.contact_depth", 0.0),
        ("[bed]\nrelative_contact_depth = 2", "bed.relative_layer_depth", 2.0),
        ("[bed]\nlayer_depth_mm = 8", "bed.contact_depth", 15.0 * MM),
    ],
)
def test_what_is_written_wins(own: Path, more: str, number: str, value: float) -> None:
    """Also over another way of saying the same."""
    assert load(own, more).value_of(number) == pytest.approx(value)


def test_a_velocity_of_ones_own_stays_unless_told(own: Path) -> None:
    """One in m/s follows the vibration only if told to, whatever the set says of its own."""
    assert not load(own, "[passage]\nvelocity_m_s = 0.1").passage.follows_vibration
    told = load(own, '[passage]\nvelocity_m_s = 0.1\nclosure = "vibration"')
    assert told.passage.follows_vibration
    assert not load(own, '[passage]\nclosure = "none"').passage.follows_vibration


def test_python_takes_the_same(own: Path) -> None:
    """Sections that are left out are the set's, and so is what a section leaves out."""
    named = NumberSet.load(own / "ours.toml")
    sizes = load(own).size_classes
    assert ScreenConfig(sizes, material=Material(calibration=named)) == load(own)
    by_path = ScreenConfig(sizes, material=Material(calibration=str(own / "ours.toml")))
    assert by_path == load(own)
    part = ScreenConfig(sizes, material=Material(calibration=named), passage=Passage("gaudin"))
    assert part == load(own)


def test_a_set_travels_with_its_screen(own: Path) -> None:
    """What a screen writes does not need the file of the set."""
    config = load(own)
    text = config.to_toml()
    (own / "ours.toml").unlink()
    assert ScreenConfig.loads(text) == config
    assert hash(ScreenConfig.loads(text)) == hash(config)


def test_a_screen_makes_a_set_of_its_numbers(tmp_path: Path) -> None:
    """One that was calibrated, say; another screen that names its file has the same numbers."""
    config = ScreenConfig.default().with_values(
        {"passage.relative_velocity": 0.5, "segregation.velocity": 0.02}
    )
    about = {"fitted_to": "two surveys", "rmse": 0.03, "range": Range(aperture=(0.01, 0.02))}
    (tmp_path / "ours.toml").write_text(config.number_set("our stone", **about).to_toml())
    again = load(tmp_path)
    for name in TABLES:
        assert getattr(again.explicit(), name) == getattr(config.explicit(), name)
    assert again.calibration.fitted_to == "two surveys"
    assert again.calibration.range.aperture == (0.01, 0.02)
    assert again.beyond_calibration() == []


def test_what_is_beyond_a_set_is_told(own: Path) -> None:
    """Name, value, range and unit."""
    config = load(own, "[passage]\nvelocity_m_s = 0.1\n[bed]\ncontact_depth_mm = 30\n")
    config = config.with_values({"deck[1].panel[1].aperture": 25.0 * MM})
    config = config.replace(motion=Motion.circular(0.005, 12.0))
    assert config.beyond_calibration() == [
        'passage.velocity = 0.1 m/s is not that of "our quarry" (passage.velocity = 0.3 m/s)',
        "passage.closure = 'none' is not that of \"our quarry\" (passage.closure = 'vibration')",
        'bed.contact_depth = 30 mm is not that of "our quarry" (bed.contact_depth = 15 mm)',
        'bed.layer_depth = 30 mm is not that of "our quarry" (bed.layer_depth = 5 mm)',
        "deck[1].panel[1].aperture = 25 mm lies outside of 10 to 20 mm, where "
        '"our quarry" was fitted',
        'motion.kind = circular with_flow is none of those of "our quarry" (linear)',
    ]


def test_the_default_screen_lies_within_what_its_numbers_were_fitted_to() -> None:
    assert ScreenConfig.default().beyond_calibration() == []


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"deck[1].panel[1].aperture": 0.12}, "deck[1].panel[1].aperture = 120 mm lies outside of"),
        ({"deck[1].panel[1].inclination": 0.35}, "deck[1].panel[1].inclination = 20.05 deg"),
        ({"feed.mass_flow_rate": 300.0}, "load of deck[1] (feed over VSMA's at 95 %) = 2.086 lies"),
        ({"motion.frequency": 25.0}, "throw number of deck[1] = 8.927 lies outside of"),
        (
            {"deck[1].panel[1].aperture": 0.063},
            "part of the feed of deck[1] above the aperture = 0.02809 lies",
        ),
    ],
)
def test_beyond_typical_practice(values: dict[str, float], said: str) -> None:
    """G at 25 Hz: 5 mm sin 45 (2 pi 25)^2/(g cos 5) = 8.927; the feed's coarsest class: 0.02809.

    The default screen has a load of 0.5796 by VSMA's tables, at 3.6 times the feed 2.0864.
    """
    assert any(
        said in one for one in ScreenConfig.default().with_values(values).beyond_calibration()
    )


def test_a_set_without_a_range_is_told(own: Path) -> None:
    (own / "ours.toml").write_text('name = "bare"\n')
    assert load(own).beyond_calibration() == [
        '"bare" does not say where it holds: give it a [range]'
    ]


REFUSED = {
    "unknown": (
        None,
        "material.calibration = 'typicl dry stone' is unknown: give one of \"typical dry stone\", "
        '"dem plate", "ivanov-vaisberg", or the path of a set of your own',
    ),
    "no file": (None, "cannot be read (No such file or directory): give a file relative to the"),
    "no TOML": ("name = our", "is not TOML"),
    "unknown key": ('name = "ours"\nrmsee = 0.1', "rmsee is unknown: did you mean rmse?"),
    "range": ('name = "ours"\n[range]\naperture_mm = [20, 10]', "range.aperture_mm"),
    "one number": ('name = "ours"\n[range]\nload = 2', "range.load = 2 is not a range"),
    "motion": ('name = "ours"\n[range]\nmotion = ["round"]', "list some of linear, elliptical"),
    "table": (
        'name = "ours"\n[passage]\nvelocity_table = "u.csv"',
        "write its rows (aperture_mm, velocity_m_s) here",
    ),
    "number": ('name = "ours"\n[passage]\nvelocity_m_s = -1', "passage.velocity_m_s = -1"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(own: Path, name: str) -> None:
    text, said = REFUSED[name]
    (own / "ours.toml").unlink()
    if text is not None:
        (own / "ours.toml").write_text(text)
    named = "typicl dry stone" if name == "unknown" else "ours.toml"
    (own / "screen.toml").write_text(f'{EDGES}[material]\ncalibration = "{named}"\n')
    with pytest.raises(ConfigError, match=re.escape(said)):
        ScreenConfig.load(own / "screen.toml")
