"""Files as a new user writes them: what is wrong is told with value, limit and cure, in their units.

The files of tests/data/cases are those of the project's trial; the texts below change one of them.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from tests.places import ROOT
from vibroscreen import InputError, Motion, Screen, ScreenConfig, solve_steady_many
from vibroscreen.errors import ConfigError
from vibroscreen.sections import Deck, Material, Panel
from vibroscreen.size_classes import SizeClasses

CASES = ROOT / "tests" / "data" / "cases"
GOOD = (CASES / "double_deck.toml").read_text()
EDGES = "edges_mm = [0, 0.063, 2.5, 5, 8, 10, 12.5, 16, 20, 25, 40, 63]"
PASSING = "passing = [0, 0.03, 0.11, 0.18, 0.25, 0.30, 0.35, 0.42, 0.49, 0.58, 0.82, 1.0]"
COARSE_EDGES = "edges_mm = [63, 40, 25, 20, 16, 12.5, 10, 8, 5, 2.5, 0.063, 0]"


def refused(make: Callable[[], Any]) -> str:
    """What is said of what is not taken."""
    with pytest.raises((ConfigError, InputError)) as refusal:
        make()
    return str(refusal.value)


def changed(*changes: tuple[str, str]) -> str:
    """The good file with other words, at their first place."""
    text = GOOD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


FILES = {
    "passing_in_per_cent": "feed.passing[2] = 3 is out of range (0 to 1): were per cent meant? 3 per cent "
    "is 0.03",
    "retained": "feed.retained = [0, 0.03, 0.11, 0.18, 0.25, 0.3, ...] is unknown: write "
    "feed.passing = [0, 0.03, 0.11, 0.18, 0.25, 0.3, 0.35, 0.42, 0.49, 0.58, 0.82, 1], what is "
    "finer than each size",
    "rpm": "motion.rpm = 930 is unknown: write motion.frequency_hz = 15.5 (930 1/min)",
    "moisture": "material.moisture = 0.05 is unknown: write feed.rate_t_h = 332.5 in its place, of "
    "dry solids: 350 x (1 - 0.05)",
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_the_trial(name: str) -> None:
    assert refused(lambda: ScreenConfig.load(CASES / f"{name}.toml")) == FILES[name]


def test_the_commonest_quarry_screen_conveys() -> None:
    """Circular, 10 mm, 15 Hz, 18 degrees: beds on such screens ride at .4 to .7 m/s."""
    result = Screen(ScreenConfig.load(CASES / "circular_inclined.toml")).solve_steady()
    assert all(0.4 < deck.transport_velocity < 0.7 for deck in result.decks)


def test_a_rigid_body_is_told_which_model_conveys() -> None:
    """On the same screen it rides up, a bed of grains down."""
    text = (CASES / "circular_inclined.toml").read_text()
    text += '[displacement]\nmodel = "rigid_body"\n'
    said = refused(Screen(ScreenConfig.loads(text)).solve_steady)
    assert "motion.frequency = 15 Hz, motion.amplitude = 0.005 m do not convey a rigid body" in said
    assert "deck[1].panel[1] (18 deg, it rides at -0.0536 m/s)" in said
    assert 'use displacement.model = "bed", grains ride down at 0.582 m/s' in said
    said = refused(lambda: ScreenConfig.loads(text.replace("= 18", "= 30")))
    for place in (1, 2):
        assert f"deck[{place}].panel[1].inclination_deg = 30 (30 deg, slope 0.5774)" in said
    assert 'would run away: make the deck flatter or use displacement.model = "bed"' in said


OPEN = ("aperture_mm = 20", "aperture_mm = 20\nopen_area = 55")
OWN: dict[str, tuple[tuple[tuple[str, str], ...], str]] = {
    "open area in per cent": (
        (OPEN,),
        "deck[1].panel[1].open_area = 55 is out of range (0 to 0.95): were per cent meant? 55 per cent is "
        "0.55",
    ),
    "1/min for Hz": (
        (("frequency_hz=15.5", "frequency_hz=930"),),
        "motion.frequency_hz = 930 is out of range (0 to 100 Hz): were 1/min meant? 930 1/min is "
        "15.5 Hz",
    ),
    "speed_rpm": (
        (("frequency_hz=15.5", "speed_rpm=930"),),
        "motion.speed_rpm = 930 is unknown: write motion.frequency_hz = 15.5 (930 1/min)",
    ),
    "speed without a unit": (
        (("frequency_hz=15.5", "speed=930"),),
        "motion.speed = 930 is unknown: write motion.frequency_hz = 15.5 (930 1/min)",
    ),
    "amplitude": (
        (("stroke_mm=10", "amplitude_mm=5"),),
        "motion.amplitude_mm = 5 is unknown: write motion.stroke_mm = 10 (the stroke is 2 times the "
        "amplitude)",
    ),
    "stroke in m": (
        (("stroke_mm=10", "stroke_m=0.01"),),
        "motion.stroke_m = 0.01 is unknown: write motion.stroke_mm = 10 (0.01 m)",
    ),
    "stroke in um": (
        (("stroke_mm=10", "stroke_mm=10000"),),
        "motion.stroke_mm = 10000 is out of range (0 to 200 mm): were micrometres meant? 10000 um "
        "is 10 mm",
    ),
    "angle of the motion": (
        (("throw_angle_deg=45", "angle_deg=45"),),
        "motion.angle_deg = 45 is unknown: write motion.throw_angle_deg = 45",
    ),
    "slope": (
        (("inclination_deg = 5", "slope_deg = 5"),),
        "deck[1].panel[1].slope_deg = 5 is unknown: write deck[1].panel[1].inclination_deg = 5",
    ),
    "inclination on the deck": (
        (("width_m = 2.4", "width_m = 2.4\ninclination = 5"),),
        "deck[1].inclination = 5 is unknown: write deck[1].panel.inclination_deg = 5",
    ),
    "a wall": (
        (("inclination_deg = 5", "inclination_deg = 60"),),
        "deck[1].panel[1].inclination_deg = 60 is out of range (-45 to 45 deg): give a number in "
        "this range",
    ),
    "hole": (
        (("aperture_mm = 20", "hole_mm = 20"),),
        "deck[1].panel[1].hole_mm = 20 is unknown: write deck[1].panel[1].aperture_mm = 20",
    ),
    "aperture in inches": (
        (("aperture_mm = 20", "aperture_in = 0.75"),),
        "deck[1].panel[1].aperture_in = 0.75 is unknown: write deck[1].panel[1].aperture_mm = 19.05 "
        "(0.75 in)",
    ),
    "aperture in m": (
        (("aperture_mm = 20", "aperture_mm = 0.01"),),
        "deck[1].panel[1].aperture_mm = 0.01 is out of range (0.02 to 500 mm): were metres meant? "
        "0.01 m is 10 mm",
    ),
    "aperture in um": (
        (("aperture_mm = 20", "aperture_mm = 16000"),),
        "deck[1].panel[1].aperture_mm = 16000 is out of range (0.02 to 500 mm): were micrometres "
        "meant? 16000 um is 16 mm",
    ),
    "mesh": (
        (("aperture_mm = 20", "mesh = 4"),),
        "deck[1].panel[1].mesh = 4 is unknown: a mesh number does not say how wide an opening is, "
        "give the clear opening: aperture_mm",
    ),
    "an opening longer than the deck": (
        (*(("length_m = 6.1", "length_m = 0.1"),) * 2, ("aperture_mm = 20", "aperture_mm = 200")),
        "deck[1].panel[1].aperture_mm = 200 is larger than the deck is long (100 mm): give the "
        "clear opening of the medium",
    ),
    "coarser below": (
        (("aperture_mm = 20", "aperture_mm = 8"),),
        "deck[2].panel[1].aperture_mm = 10 is larger than any opening of the deck above (8 mm), "
        "here nothing would be screened: list the coarsest deck first, or swap the two",
    ),
    "width without a unit": (
        (("width_m = 2.4", "width = 2.4"),),
        "deck[1].width = 2.4 is unknown: write deck[1].width_m = 2.4",
    ),
    "width in mm": (
        (("width_m = 2.4", "width_m = 2400"),),
        "deck[1].width_m = 2400 is out of range (0.001 to 10 m): were millimetres meant? 2400 mm "
        "is 2.4 m",
    ),
    "length in mm": (
        (("length_m = 6.1", "length_mm = 6100"),),
        "deck[1].panel[1].length_mm = 6100 is unknown: write deck[1].panel[1].length_m = 6.1 "
        "(6100 mm)",
    ),
    "density in t/m3": (
        (("[motion]", "[material]\nbulk_density_kg_m3 = 1.6\n[motion]"),),
        "material.bulk_density_kg_m3 = 1.6 is out of range (10 to 25000 kg/m3): were t/m3 meant? "
        "1.6 t/m3 is 1600 kg/m3",
    ),
    "density under another key": (
        (("[motion]", "[material]\ndensity_t_m3 = 1.6\n[motion]"),),
        "material.density_t_m3 = 1.6 is unknown: write material.bulk_density_kg_m3 = 1600 "
        "(1.6 t/m3)",
    ),
    "density without a unit": (
        (("[motion]", "[material]\ndensity = 1.6\n[motion]"),),
        "material.density = 1.6 is unknown: write material.bulk_density_kg_m3 = 1600 (1.6 t/m3)",
    ),
    "efficiency in per cent": (
        (("[motion]", "[drive]\nefficiency = 90\n[motion]"),),
        "drive.efficiency = 90 is out of range (0.01 to 1): were per cent meant? 90 per cent is 0.9",
    ),
    "tph": (
        (("rate_t_h = 350", "tph = 350"),),
        "feed.tph = 350 is unknown: write feed.rate_t_h = 350",
    ),
    "rate in kg/h": (
        (("rate_t_h = 350", "rate_t_h = 350000"),),
        "feed.rate_t_h = 350000 is out of range (0 to 18000 t/h): were kg/h meant? 350000 kg/h is "
        "350 t/h",
    ),
    "rate in kg/s": (
        (("rate_t_h = 350", "rate_kg_s = 100"),),
        "feed.rate_kg_s = 100 is unknown: write feed.rate_t_h = 360 (100 kg/s)",
    ),
    "moisture in per cent": (
        (("rate_t_h = 350", "rate_t_h = 350\nmoisture_percent = 4"),),
        "feed.moisture_percent = 4 is unknown: write feed.rate_t_h = 336 in its place, of dry "
        "solids: 350 x (1 - 0.04)",
    ),
    "fractions in per cent": (
        ((EDGES, "edges_mm = [0, 8, 20, 63]"), (PASSING, "mass_fraction = [15, 25, 60]")),
        "feed.mass_fraction[1] = 15 is out of range (0 to 1): were per cent meant? 15 per cent is 0.15",
    ),
    "fractions of another sum": (
        ((EDGES, "edges_mm = [0, 8, 20, 63]"), (PASSING, "mass_fraction = [0.2, 0.3, 0.52]")),
        "feed.mass_fraction sums to 1.02, not to 1 within 0.001: give the mass fractions of all "
        "size classes, or divide each by the sum",
    ),
    "passing_percent": (
        ((EDGES, "edges_mm = [0, 8, 63]"), (PASSING, "passing_percent = [0, 25, 100]")),
        "feed.passing_percent = [0, 25, 100] is unknown: write feed.passing = [0, 0.25, 1], what is "
        "finer than each size",
    ),
    "retained by class": (
        ((EDGES, "edges_mm = [63, 20, 8, 0]"), (PASSING, "retained_percent = [60, 15, 25]")),
        "feed.retained_percent = [60, 15, 25] is unknown: write feed.mass_fraction = [0.6, 0.15, "
        "0.25], the share of every class in the order of the sizes",
    ),
    "retained on and above": (
        ((EDGES, "edges_mm = [63, 20, 8, 0]"), (PASSING, "retained = [0, 60, 75, 100]")),
        "feed.retained = [0, 60, 75, 100] is unknown: write feed.passing = [1, 0.4, 0.25, 0], what "
        "is finer than each size",
    ),
    "sizes in any order": (
        ((EDGES, "edges_mm = [63, 8, 20, 0]"), (PASSING, "")),
        "size_classes.edges_mm[2] = 8 is not larger than the limit below it (63 mm): list the limits "
        "finest first, and what belongs to them in the same order",
    ),
    "passing in the other order": (
        ((EDGES, "edges_mm = [0, 8, 63]"), (PASSING, "passing = [1, 0.25, 0]")),
        "feed.passing falls from 1 to 0, the sizes rise: list both in the same order",
    ),
    "sizes under another key": (
        ((EDGES, "edges_mm = [0, 8, 63]\nsieves_um = [0, 8000]"), (PASSING, "")),
        "size_classes.sieves_um = [0, 8000] is unknown: write size_classes.edges_mm = [0, 8]",
    ),
}


@pytest.mark.parametrize("case", OWN)
def test_files_of_the_same_kinds(case: str) -> None:
    changes, message = OWN[case]
    assert refused(lambda: ScreenConfig.loads(changed(*changes))) == message


def test_all_that_is_wrong_is_told_at_once() -> None:
    text = changed(
        OPEN,
        ("aperture_mm = 10", "aperture_mm = 10\nhole = 3"),
        ("stroke_mm=10", "stroke_mm=-10"),
        ("frequency_hz=15.5", "rpm=930"),
        ("[motion]", '[material]\nfriction_deck = "rough"\n[motion]'),
        (PASSING, PASSING.replace("0.03", "3")),
    )
    with pytest.raises(ConfigError) as refusal:
        ScreenConfig.loads(text)
    starts = [
        "deck[1].panel[1].open_area = 55 ",
        "deck[2].panel[1].hole = 3 is unknown",
        "material.friction_deck = 'rough' is not a number",
        "motion.rpm = 930 is unknown",
        "motion.stroke_mm = -10 is out of range (0 to 200 mm)",
        "feed.passing[2] = 3 is out of range",
    ]
    errors = refusal.value.errors
    assert [error[: len(start)] for error, start in zip(errors, starts, strict=True)] == starts
    assert str(refusal.value).splitlines() == list(errors)
    assert pickle.loads(pickle.dumps(refusal.value)).errors == errors


@pytest.mark.parametrize("key", ["passing", "mass_fraction"])
def test_sizes_may_come_coarsest_first(key: str) -> None:
    passing = [float(value) for value in PASSING[11:-1].split(",")]
    values = {"passing": passing, "mass_fraction": [0.1, *[0.05] * 8, 0.2, 0.3]}[key]
    fine = changed((PASSING, f"{key} = {values}"))
    coarse = fine.replace(EDGES, COARSE_EDGES).replace(str(values), str(values[::-1]))
    assert coarse != fine
    assert ScreenConfig.loads(coarse) == ScreenConfig.loads(fine)


def sweep(name: str, value: float) -> Callable[[], Any]:
    return lambda: solve_steady_many(ScreenConfig.loads(GOOD), {name: value})


PYTHON: dict[str, tuple[Callable[[], Any], str]] = {
    "degrees": (
        lambda: Motion.linear(0.005, 15.5, 45.0),
        "motion.throw_angle = 45 rad is out of range (-3.14159 to 3.14159 rad): were degrees meant? "
        "45 deg is 0.785398 rad",
    ),
    "inclination in degrees": (
        lambda: Panel(inclination=5.0),
        "deck.panel.inclination = 5 rad is out of range (-0.785398 to 0.785398 rad): were degrees "
        "meant? 5 deg is 0.0872665 rad",
    ),
    "aperture in mm": (
        lambda: Panel(aperture=16.0),
        "deck.panel.aperture = 16 m is out of range (2e-05 to 0.5 m): were millimetres meant? 16 mm "
        "is 0.016 m",
    ),
    "density": (
        lambda: Material(bulk_density=1.6),
        "material.bulk_density = 1.6 kg/m3 is out of range (10 to 25000 kg/m3): were t/m3 meant? "
        "1.6 t/m3 is 1600 kg/m3",
    ),
    "sizes coarsest first": (
        lambda: SizeClasses((0.063, 0.008, 0.0)),
        "size_classes.edges[2] = 0.008 m is not larger than the limit below it (0.063 m): list the "
        "limits finest first, and what belongs to them in the same order",
    ),
    "coarser below": (
        lambda: ScreenConfig.default().replace(
            decks=(Deck(panels=(Panel(aperture=0.01),)), Deck(panels=(Panel(aperture=0.02),)))
        ),
        "deck[2].panel[1].aperture = 0.02 m is larger than any opening of the deck above (0.01 m), "
        "here nothing would be screened: list the coarsest deck first, or swap the two",
    ),
    "aperture of a sweep": (
        sweep("deck[1].panel[1].aperture", 16.0),
        "design 0: deck[1].panel[1].aperture = 16 m is out of range (2e-05 to 0.5 m): were "
        "millimetres meant? 16 mm is 0.016 m",
    ),
    "coarser below in a sweep": (
        sweep("deck[2].panel[1].aperture", 0.03),
        "design 0: deck[2].panel[1].aperture = 0.03 m is larger than any opening of the deck above "
        "(0.02 m), here nothing would be screened: list the coarsest deck first, or swap the two",
    ),
    "speed of a sweep": (
        sweep("motion.frequency", 930.0),
        "design 0: motion.frequency = 930 Hz is out of range (0 to 100 Hz): were 1/min meant? 930 "
        "1/min is 15.5 Hz",
    ),
}


@pytest.mark.parametrize("case", PYTHON)
def test_the_same_in_python_and_sweeps(case: str) -> None:
    make, message = PYTHON[case]
    assert refused(make) == message


def test_a_blank_plate_below_may_have_any_opening() -> None:
    blank = Deck(panels=(Panel(aperture=0.05, open_area=0.0),))
    config = ScreenConfig.default().replace(decks=(Deck(), blank))
    steady = Screen(config).solve_steady()
    assert math.fsum(steady.undersize.class_rates) == 0.0
