"""Numbers that go with the aperture: one set for every scale, panel by panel."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vibroscreen import Feed, Screen, ScreenConfig, solve_steady_many
from vibroscreen.motion import Motion
from vibroscreen.sections import Bed, Deck, Displacement, Panel, Passage, Segregation, Solver
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, GRAVITY, MM

EDGES = (0.0, 4 * MM, 8 * MM, 12 * MM, 16 * MM, 24 * MM, 40 * MM)
SHARE = (0.1, 0.15, 0.15, 0.15, 0.25, 0.2)
TYPICAL = {
    "passage": Passage(relative_velocity=0.56),
    "segregation": Segregation(relative_velocity=0.034, relative_dilation=0.8),
    "bed": Bed(relative_contact_depth=1.0),
    "solver": Solver(tolerance=1e-5),
}


def screen(panels: tuple[Panel, ...], rate: float = 80.0, scale: float = 1.0) -> ScreenConfig:
    return ScreenConfig(
        SizeClasses(tuple(scale * edge for edge in EDGES)),
        decks=(Deck(2.0, panels),),
        displacement=Displacement("prescribed", 0.35 * math.sqrt(scale)),
        motion=Motion.linear(5 * MM * scale, 15.5 / math.sqrt(scale), 45 * DEG),
        feed=Feed(rate, SHARE),
        **TYPICAL,
    )


def test_they_are_what_the_aperture_makes_of_them() -> None:
    """The same numbers written out for the aperture give the same screen."""
    aperture = 16 * MM
    told = screen((Panel(5.0, 5 * DEG, aperture, 0.5),))
    fall = math.sqrt(GRAVITY * aperture)
    written = told.replace(
        passage=Passage(velocity=0.56 * fall, closure="vibration"),
        segregation=Segregation(
            velocity=0.034 * fall, dilation=0.0, relative_dilation=0.8, closure="vibration"
        ),
        bed=Bed(aperture),
    )
    one, other = (Screen(config).solve_steady().recovery for config in (told, written))
    assert one == pytest.approx(other, rel=1e-12, abs=1e-12)


def test_all_lengths_scaled_change_nothing() -> None:
    """At fixed g: rates go with length^2.5, times with its root (dimensional analysis)."""
    small = screen((Panel(1.5, 5 * DEG, 16 * MM, 0.5),), rate=20.0)
    large = screen((Panel(6.0, 5 * DEG, 64 * MM, 0.5),), rate=20.0 * 4.0**1.5, scale=4.0)
    # The deck is as wide: the rate over the width goes with length^1.5.
    one, other = (Screen(config).solve_steady().recovery for config in (small, large))
    assert one == pytest.approx(other, abs=2e-5)


def test_every_panel_has_its_own() -> None:
    """A scene's numbers are those of its own aperture."""
    fine, coarse = Panel(2.5, 5 * DEG, 12 * MM, 0.5), Panel(2.5, 5 * DEG, 24 * MM, 0.5)
    box = Screen(screen((fine, coarse)))
    box.step(1.0)
    scene = box.record("scene")[0]
    assert scene[1].contact_load == pytest.approx(2.0 * scene[0].contact_load)
    assert scene[1].segregation_velocity == pytest.approx(
        math.sqrt(2.0) * scene[0].segregation_velocity
    )


def test_a_sweep_of_apertures_takes_them_along() -> None:
    base = screen((Panel(5.0, 5 * DEG, 16 * MM, 0.5),))
    apertures = np.array([12.0, 16.0, 24.0]) * MM
    table = solve_steady_many(base, {"deck[1].panel[1].aperture": apertures})
    for k, aperture in enumerate(apertures):
        one = Screen(screen((Panel(5.0, 5 * DEG, float(aperture), 0.5),))).solve_steady()
        assert table.recovery[k] == pytest.approx(one.recovery, abs=1e-12)


def test_a_number_of_a_sweep_takes_the_place_of_the_usual_one() -> None:
    base = ScreenConfig.default()
    table = solve_steady_many(base, {"passage.relative_velocity": [0.2, 0.5]})
    for k, value in enumerate((0.2, 0.5)):
        one = base.with_values({"passage.relative_velocity": value})
        assert table.recovery[k] == pytest.approx(Screen(one).solve_steady().recovery, abs=1e-12)
