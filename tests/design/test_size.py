"""Standard sizes for duties."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.places import ROOT
from vibroscreen import Feed, InputError, Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.size import choose, resized
from vibroscreen.size_classes import SizeClasses
from vibroscreen.sizing_rules import rules_of
from vibroscreen.units import GRAVITY, MM

QUARRY = ROOT / "plant_examples" / "screens" / "quarry.toml"
# Apertures in mm, and a share of VSMA's feed for 95 % on the deck of 6.0 x 2.4 m.
DUTIES = [
    (3, 0.5),
    (4, 0.8),
    (6, 1.0),
    (8, 0.5),
    (10, 0.8),
    (16, 1.0),
    (20, 0.5),
    (31.5, 0.8),
    (50, 0.6),
    (75, 0.5),
]


def duty(aperture_mm: float, share: float) -> ScreenConfig:
    """A deck at an aperture, fed a share of what VSMA says it recovers 95 % of."""
    base = ScreenConfig.load(QUARRY)
    ratio = aperture_mm / 16.0
    edges = tuple(edge * ratio for edge in base.size_classes.edges)
    config = base.replace(size_classes=SizeClasses(edges)).with_values(
        {"deck[1].panel[1].aperture": aperture_mm * MM}
    )
    (rules,) = rules_of(config)
    rate = config.feed.mass_flow_rate * share / rules.load
    return config.replace(feed=Feed(rate, config.feed.mass_fraction))


@pytest.mark.parametrize(("aperture_mm", "share"), DUTIES)
def test_the_chosen_size_meets_the_duty_and_the_next_smaller_does_not(
    aperture_mm: float, share: float
) -> None:
    """At 1e-5, solved by itself; the area is VSMA's within 1.5, or the reason is given."""
    config, wanted = duty(aperture_mm, share), 0.88
    found = choose(config, wanted)
    sharp = found.config.with_values({"solver.tolerance": 1e-5})
    alone = Screen(sharp).solve_steady()
    assert alone.decks[0].efficiency >= wanted - 1e-9
    assert "alarm.bed_depth" not in alone.alarms
    if found.smaller is not None:
        size = float(found.smaller["width_m"]), float(found.smaller["length_m"])
        less = Screen(resized(sharp, *size)).solve_steady()
        assert less.decks[0].efficiency < wanted or "alarm.bed_depth" in less.alarms
    deck = found.config.decks[0]
    ratio = deck.width * deck.length / found.vsma_area
    assert bool(found.beside_vsma) == (not 1 / 1.5 <= ratio <= 1.5)
    weight = found.config.drive.vibrating_mass * GRAVITY
    stroke = 2 * found.config.motion.amplitude
    assert found.support_force == pytest.approx(weight * stroke / 2 / (50 * MM))


def test_no_size_is_told_with_what_the_best_one_reaches() -> None:
    with pytest.raises(InputError, match=r"efficiency = 0\.999 is reached by no standard size"):
        choose(ScreenConfig.load(QUARRY), 0.999)
    with pytest.raises(InputError, match=r"efficiency = 95 is out of range"):
        choose(ScreenConfig.load(QUARRY), 95)


def test_panels_keep_their_shares_and_the_box_weighs_by_its_area() -> None:
    two = ScreenConfig.load(QUARRY.with_name("two_deck.toml"))
    other = resized(two, 3.0, 7.2)
    for deck, before in zip(other.decks, two.decks, strict=True):
        assert deck.length == pytest.approx(7.2)
        assert deck.panels[0].length / deck.length == pytest.approx(
            before.panels[0].length / before.length
        )
    assert other.drive.vibrating_mass / two.drive.vibrating_mass == pytest.approx(
        3.0 * 7.2 / (two.decks[0].width * two.decks[0].length)
    )


def test_the_command(tmp_path: Path) -> None:
    file = tmp_path / "chosen.toml"
    said = CliRunner().invoke(app, ["size", str(QUARRY), "--efficiency", "0.75", "-o", str(file)])
    assert said.exit_code == 0, said.output
    assert "chosen" in said.stdout
    assert "VSMA asks for" in said.stdout
    told = json.loads(
        CliRunner().invoke(app, ["size", str(QUARRY), "--efficiency", "0.75", "--json"]).stdout
    )
    chosen = ScreenConfig.load(file)
    assert chosen.decks[0].width == told["width_m"]
    assert min(told["efficiency"]) >= 0.75
    none = CliRunner().invoke(app, ["size", str(QUARRY), "--efficiency", "0.9999"])
    assert none.exit_code == 1
    assert "reached by no standard size" in " ".join(none.output.split())
