"""Openings on a slope, slots and round holes: against grains that fall past wires in space, by chance.

The geometry of the wires is said here anew: distances between lines in space, no projected opening.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vibroscreen import InputError, Screen, ScreenConfig, solve_steady_many
from vibroscreen.compiler.language import Row
from vibroscreen.errors import ConfigError
from vibroscreen.fields import in_engine
from vibroscreen.kernels import state
from vibroscreen.kernels.physics import opening
from vibroscreen.kernels.physics.passage import passage_probability
from vibroscreen.sections import Displacement, Panel, Passage
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, MM
from vibroscreen.variables import PANELS, PARAMETERS

GAUDIN, PELEVIN, BOUNCE = 1, 2, 3
MESH = ScreenConfig(
    SizeClasses((0.0, 0.003, 0.008, 0.014, 0.0155, 0.018, 0.03)),
    displacement=Displacement("prescribed", 0.3),
)


def scene_of(panel: Panel, law: int = GAUDIN, rim: float = 0.0) -> Row:
    """What a panel offers to a law, of a bed four apertures deep that is not thrown or carried."""
    numbers = Row(np.array([in_engine(panel, v.field) for v in PANELS]), 0, state.PANEL)
    parameter = Row(np.zeros(len(PARAMETERS)), 0, state.PARAMETER)
    parameter.passage_law, parameter.passage_rim = law, rim
    scene = Row(np.zeros(len(state.SCENE)), 0, state.SCENE)
    scene.aperture, scene.open_area, scene.rim = panel.aperture, panel.open_area, rim
    scene.across, scene.along = opening.sides_of(numbers)
    scene.seen = opening.seen_along(numbers)
    scene.closed = opening.closing_size(numbers, parameter)
    scene.cover, scene.density, scene.bed_load = 1.0, 1.0, 4.0 * panel.aperture
    return scene


def passing(
    panel: Panel,
    sizes: list[float],
    law: int = GAUDIN,
    fractions: list[float] = (),
    rim: float = 0.0,
) -> np.ndarray:
    """P of ascending sizes [m] on a panel."""
    found = np.full(len(sizes), np.nan)
    share = np.array(fractions or [0.0] * len(sizes))
    passage_probability(law, 0, np.array(sizes), share, scene_of(panel, law, rim), found)
    return found


def mesh(slope: float, across: float, along: float, wire: float) -> Panel:
    """Openings [mm] between round wires [mm] on a slope [deg]; the wire follows from the rest."""
    open_area = across * along / ((across + wire) * (along + wire))
    shape = "square" if across == along else "slot" if across < along else "slot_across"
    least, most = min(across, along) * MM, max(across, along) * MM
    return Panel(
        inclination=slope * DEG,
        aperture=least,
        open_area=open_area,
        opening=shape,
        slot_length=0.0 if shape == "square" else most,
    )


# --- by chance -------------------------------------------------------------------------------------
def clear_of(point: np.ndarray, wire: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Least distance of vertical lines through points [n, 3] to lines in space through a point."""
    normal = np.cross(way, (0.0, 0.0, 1.0))
    return np.abs((point - wire) @ normal) / np.linalg.norm(normal)


@pytest.mark.parametrize(
    ("slope", "across", "along", "wire"),
    [(0, 8, 8, 3), (18, 8, 8, 3), (34, 12, 12, 7), (-20, 8, 8, 3), (25, 5, 20, 4), (25, 20, 5, 4)],
)
def test_grains_that_fall_past_wires(
    slope: float, across: float, along: float, wire: float
) -> None:
    """Grains fall on every place of the plan alike; one passes that touches no wire.

    What falls on an area of the deck is cos(slope) of what falls on the same area of the plan.
    """
    rng = np.random.default_rng(11)
    down = np.array([0.0, math.cos(slope * DEG), -math.sin(slope * DEG)])
    count, pitch_x, pitch_y = 200_000, across + wire, along + wire
    x, y = rng.uniform(0.0, pitch_x, count), rng.uniform(0.0, pitch_y * down[1], count)
    start = np.column_stack([x, y, np.full(count, 50.0)])
    clear = np.full(count, np.inf)
    for k in range(-1, 3):
        crossing = clear_of(start, k * pitch_y * down, np.array([1.0, 0.0, 0.0]))
        with_flow = clear_of(start, np.array([k * pitch_x, 0.0, 0.0]), down)
        clear = np.minimum(clear, np.minimum(crossing, with_flow))
    panel = mesh(slope, across, along, wire)
    for size in (0.5, 2.0, 3.5, 4.5, 6.0, 7.0):
        share = float(np.mean(clear > 0.5 * (size + wire))) * down[1]
        noise = 5.0 * math.sqrt(max(share, 1e-4) / count)
        assert passing(panel, [size * MM])[0] == pytest.approx(share, abs=noise), size


@pytest.mark.parametrize(("slope", "excess"), [(0, 0.0), (20, 0.0005), (45, 0.0075)])
def test_grains_that_fall_through_round_holes_of_a_thin_plate(slope: float, excess: float) -> None:
    """The centre stays clear of the rim, a circle that is seen as an ellipse.

    The formula takes centres from an ellipse with axes shorter by d, which holds all of them and
    a few more.
    """
    rng = np.random.default_rng(12)
    half, count = 0.5 * math.cos(slope * DEG), 60_000
    place = rng.uniform(-0.5, 0.5, (count, 2)) * (1.0, 2.0 * half)
    turn = np.linspace(0.0, 2.0 * math.pi, 2001)
    rim = np.column_stack([0.5 * np.cos(turn), half * np.sin(turn)])
    inside = (place[:, 0] / 0.5) ** 2 + (place[:, 1] / half) ** 2 < 1.0
    clear = np.zeros(count)
    clear[inside] = [np.hypot(*(rim - centre).T).min() for centre in place[inside]]
    panel = Panel(
        inclination=slope * DEG, aperture=0.01, open_area=0.4, opening="round", thickness=0.0
    )
    for size in (0.1, 0.3, 0.5, 0.6):
        # of the hole's own circle, per area of the deck: 1 x 2 half was drawn from
        share = np.mean(clear > 0.5 * size) * 2.0 * half / (math.pi / 4.0)
        over = passing(panel, [size * 0.01])[0] / 0.4 - share
        noise = 5.0 * math.sqrt(share / count)
        assert -noise <= over <= excess + noise


# --- limits ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("law", [GAUDIN, PELEVIN, BOUNCE])
def test_a_level_deck_does_not_see_the_medium(law: int) -> None:
    sizes, share = (
        [0.0, 0.003, 0.006, 0.009, 0.0159, 0.016, 0.02],
        [0.1, 0.2, 0.3, 0.1, 0.1, 0.1, 0.1],
    )
    plain = passing(Panel(inclination=0.0), sizes, law, share)
    for change in ({"thickness": 0.01}, {"opening": "round"}, {"relative_thickness": 3.0}):
        assert (passing(Panel(inclination=0.0, **change), sizes, law, share) == plain).all()


def test_a_long_slot_hinders_grains_in_one_direction_only() -> None:
    sizes = [0.0, 0.002, 0.005, 0.0079]
    panel = Panel(inclination=0.0, aperture=0.008, open_area=0.4, opening="slot", slot_length=29.0)
    expected = 0.4 * (1.0 - np.array(sizes) / 0.008)
    assert passing(panel, sizes) == pytest.approx(expected, rel=4e-4)
    flat = dataclasses.replace(panel, opening="slot_across")
    assert passing(flat, sizes) == pytest.approx(passing(panel, sizes), rel=1e-14)
    # on a slope the long side loses a part of itself, the short one the same length and more
    steep, steep_flat = (dataclasses.replace(one, inclination=20.0 * DEG) for one in (panel, flat))
    lost = math.cos(20.0 * DEG)
    bar = 0.008 * (1.0 / 0.4 - 1.0)  # between endless slots
    assert passing(steep, [0.0])[0] == pytest.approx(0.4 * lost, rel=1e-3)
    assert passing(steep_flat, [0.0])[0] == pytest.approx(
        0.4 * ((0.008 + bar) * lost - bar) / 0.008, rel=1e-3
    )


@settings(max_examples=200, deadline=None)
@given(open_area=st.floats(1e-6, 0.95), length=st.floats(1.0, 1e3))
def test_bars_make_the_open_area(open_area: float, length: float) -> None:
    bar = opening.implied_bar(opening.SLOT, 1.0, length, open_area)
    assert length / ((1.0 + bar) * (length + bar)) == pytest.approx(open_area, rel=1e-12)
    square = opening.implied_bar(opening.SQUARE, 1.0, 1.0, open_area)
    assert square == pytest.approx(1.0 / math.sqrt(open_area) - 1.0, rel=1e-9, abs=1e-15)
    if open_area < math.pi / math.sqrt(12.0):
        bridge = opening.implied_bar(opening.ROUND, 1.0, 1.0, open_area)
        rhombus = (1.0 + bridge) ** 2 * math.sin(math.pi / 3.0)  # one hole lies on so much
        assert math.pi / 4.0 / rhombus == pytest.approx(open_area, rel=1e-12)


def test_a_blank_plate_has_no_bars() -> None:
    assert opening.implied_bar(opening.SQUARE, 1.0, 1.0, 0.0) == 0.0


@pytest.mark.parametrize("shape", ["square", "slot", "slot_across"])
def test_pelevin_is_the_sum_as_printed(shape: str) -> None:
    """Gaudin's factors of eq. 6 written out: the room beside a grain is shorter by it both ways."""
    panel = Panel(
        inclination=25.0 * DEG,
        aperture=0.016,
        opening=shape,
        slot_length=0.0 if shape == "square" else 0.04,
        thickness=0.005,
    )
    short, long = 0.016, 0.016 if shape == "square" else 0.04
    x, b = (long, short) if shape == "slot_across" else (short, long)
    s = (b + 0.005) * math.cos(25.0 * DEG) - 0.005

    def alone(d: float, x: float, s: float, area: float) -> float:
        return 0.55 * max(0.0, x - d) * max(0.0, s - d) / area

    sizes = [0.0, 0.001, 0.004, 0.004, 0.0075, 0.012, 0.0139, 0.02]
    share = [0.05, 0.2, 0.15, 0.1, 0.2, 0.1, 0.1, 0.1]
    expected = [
        alone(d, x, s, x * b)
        + sum(
            f * alone(e, x, s, x * b) * alone(d, x - e, s - e, (x - e) * (s - e))
            for e, f in zip(sizes, share, strict=True)
            if d + e <= min(x, s) and e < min(x, s)
        )
        for d in sizes
    ]
    assert passing(panel, sizes, PELEVIN, share) == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_bare_bounces_on_a_slope_are_gaudin() -> None:
    panel = Panel(inclination=18.0 * DEG, aperture=0.008, thickness=0.003)
    sizes = list(np.linspace(0.0, 0.0085, 18))
    assert passing(panel, sizes, BOUNCE) == pytest.approx(passing(panel, sizes), rel=1e-13)


@settings(max_examples=200, deadline=None)
@given(
    slope=st.floats(-45.0, 45.0),
    open_area=st.floats(0.01, 0.95),
    thickness=st.one_of(st.none(), st.floats(0.0, 0.1)),
    rim=st.floats(0.0, 1.0),
    shape=st.sampled_from(["square", "slot", "slot_across", "round"]),
)
def test_nothing_passes_from_the_closing_size_on(
    slope: float, open_area: float, thickness: float | None, rim: float, shape: str
) -> None:
    panel = Panel(
        inclination=slope * DEG,
        open_area=open_area,
        opening=shape,
        slot_length=0.03 if shape.startswith("slot") else 0.0,
        thickness=thickness,
    )
    for law in (GAUDIN, PELEVIN, BOUNCE):
        closed = scene_of(panel, law, rim).closed
        assert 0.0 <= closed <= panel.aperture
        if closed > 0.0:
            found = passing(panel, [closed * (1.0 - 1e-6), closed], law, rim=rim)
            assert found[0] > 0.0
            assert found[1] == 0.0
        else:
            assert passing(panel, [0.0], law, rim=rim)[0] == 0.0


# --- in a screen -----------------------------------------------------------------------------------
def inclined(law: str = "pelevin", **panel: object) -> ScreenConfig:
    deck = dataclasses.replace(
        MESH.decks[0], panels=(Panel(**{"inclination": 20.0 * DEG, **panel}),)
    )
    return MESH.replace(decks=(deck,), passage=Passage(law, 0.1))


@pytest.mark.parametrize("law", ["gaudin", "pelevin"])
def test_what_a_slope_hides_counts_as_not_recovered(law: str) -> None:
    """(16 + 5.574) cos(20 deg) - 5.574 = 14.699 mm, and 16 mm stays what efficiency is about."""
    result = Screen(inclined(law)).solve_steady()
    (deck,) = result.decks
    assert deck.aperture == 0.016
    curve = deck.partition
    hidden = (curve.size > 0.0146991) & (curve.size < 0.016)
    assert hidden.any()
    assert (curve.to_oversize[hidden] == 1.0).all()
    assert (curve.to_oversize[curve.size < 0.01469] < 1.0).all()
    assert curve.cut_size < 0.0146991
    size = Screen(inclined(law)).nodes.size
    assert ((size > 0.0146991) & (size < 0.016)).any()
    steeper = Screen(inclined(law, thickness=0.008)).solve_steady()
    thinner = Screen(inclined(law, thickness=0.0)).solve_steady()
    assert steeper.efficiency < result.efficiency < thinner.efficiency


@pytest.mark.parametrize(
    "panel",
    [
        {},
        {"opening": "slot", "slot_length": 0.05},
        {"opening": "slot_across", "slot_length": 0.05},
        {"opening": "slot", "slot_length": 0.4, "inclination": 0.0},
        {"opening": "round"},
    ],
)
@pytest.mark.parametrize("law", ["gaudin", "pelevin", "bounce"])
def test_nodes_serve_every_opening(law: str, panel: dict[str, object]) -> None:
    """The nodes that the engine chooses against 24 in every piece of a class."""
    config = inclined(law, **panel)
    fine = config.replace(size_classes=SizeClasses(config.size_classes.edges, 24))
    chosen, many = (Screen(one).solve_steady().recovery for one in (config, fine))
    assert chosen == pytest.approx(many, abs=2e-4)


def test_designs_of_many_openings_are_those_of_configurations() -> None:
    """Apertures, slopes and wires of a sweep; the implied bar follows the aperture."""
    values = {
        "deck[1].panel[1].aperture": [0.010, 0.012, 0.016],
        "deck[1].panel[1].inclination": [0.0, 15.0 * DEG, 30.0 * DEG],
    }
    base = inclined("gaudin")
    for more in ({}, {"deck[1].panel[1].thickness": [0.002, 0.0, 0.006]}):
        table = solve_steady_many(base, {**values, **more})
        for k, found in enumerate(table.recovery):
            one = base.with_values({name: row[k] for name, row in {**values, **more}.items()})
            assert found == pytest.approx(Screen(one).solve_steady().recovery, abs=1e-12)


def test_hidden_openings_pass_nothing_and_say_so() -> None:
    result = Screen(inclined(inclination=40.0 * DEG, thickness=0.06)).solve_steady()
    assert result.undersize.mass_flow_rate == 0.0
    assert result.alarm_reasons["alarm.plausibility"] == (
        "bars of 0.06 m hide the openings of 0.016 m on deck 1 from falling grains on its slope: "
        "make the panel flatter, or give the thickness of thinner bars"
    )


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            'opening = "slot"\nslot_length_mm = 10',
            "deck[1].panel[1].slot_length_mm = 10 is less than the aperture (16 mm): give the long "
            "side of the slots, the aperture is their short one",
        ),
        (
            "slot_length_mm = 40",
            "deck[1].panel[1].slot_length_mm = 40 is given for openings that are no slots: write "
            'opening = "slot" or "slot_across", or leave it out',
        ),
        (
            'opening = "slits"',
            "deck[1].panel[1].opening = 'slits' is unknown: give one of square, slot, round, "
            "slot_across (did you mean 'slot'?)",
        ),
        (
            'shape = "round"',
            "deck[1].panel[1].shape = 'round' is unknown: write deck[1].panel[1].opening = \"round\"",
        ),
        (
            "opening_mm = 12",
            "deck[1].panel[1].opening_mm = 12 is unknown: write deck[1].panel[1].aperture_mm = 12",
        ),
        (
            "wire_mm = 5",
            "deck[1].panel[1].wire_mm = 5 is unknown: write deck[1].panel[1].thickness_mm = 5",
        ),
        (
            "bar_mm = 5",
            "deck[1].panel[1].bar_mm = 5 is unknown: write deck[1].panel[1].thickness_mm = 5",
        ),
        (
            "slot_mm = 50",
            "deck[1].panel[1].slot_mm = 50 is unknown: write deck[1].panel[1].slot_length_mm = 50",
        ),
        (
            "thickness_mm = 600",
            "deck[1].panel[1].thickness_mm = 600 is out of range (0 to 500 mm): give the diameter of "
            "the wire, or the thickness of the bars",
        ),
    ],
)
def test_what_a_user_may_get_wrong(lines: str, message: str) -> None:
    text = f"[size_classes]\nedges_mm = [0, 8, 16, 40]\n[[deck]]\n[[deck.panel]]\n{lines}\n"
    with pytest.raises(ConfigError) as refusal:
        ScreenConfig.loads(text)
    assert str(refusal.value) == message


def test_the_same_is_said_of_designs_and_of_a_screen_that_runs() -> None:
    slots = inclined(opening="slot", slot_length=0.05)
    message = r"deck\[1\].panel\[1\].slot_length = 0.01 m is less than the aperture \(0.016 m\)"
    with pytest.raises(InputError, match=message):
        solve_steady_many(slots, {"deck[1].panel[1].slot_length": [0.05, 0.01]})
    screen = Screen(slots)
    screen.record("panel")[0, 0].slot_length = 0.01
    with pytest.raises(InputError, match=message):
        screen.step(1.0)
    screen.record("panel")[0, 0].opening = float(opening.ROUND)
    with pytest.raises(InputError, match="given for openings that are no slots"):
        screen.step(1.0)
