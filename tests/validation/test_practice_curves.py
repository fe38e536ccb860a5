"""The calibrated plate answers to what can be set as practice says: signs, and where the best lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import practice_curves as study
from practice_curves import FREE, HELD

CURVES = {curve.name.partition(",")[0]: curve for curve in study.CURVES}


@pytest.fixture(scope="module")
def found() -> dict[str, dict[str, np.ndarray]]:
    return {name: study.lines(curve) for name, curve in CURVES.items()}


@pytest.mark.parametrize("velocity", [HELD, FREE])
def test_the_best_throw_number(found: dict[str, dict[str, np.ndarray]], velocity: str) -> None:
    """3 to 3.5, and less on both sides: by stroke, by frequency, and by both velocities."""
    for name in ("throw number", "stroke", "frequency"):
        values = found[name][velocity]
        at = int(values.argmax())
        assert (np.diff(values[: at + 1]) >= 0.0).all(), name
        assert (np.diff(values[at:]) <= 0.0).all(), name
        assert values[-1] < 0.85 * values[at], name
    best = CURVES["throw number"].values[int(found["throw number"][velocity].argmax())]
    assert 3.0 <= best <= 3.5


def test_a_deck_that_hardly_shakes_passes_nothing(
    found: dict[str, dict[str, np.ndarray]],
) -> None:
    """A stroke of 2 mm at 15 Hz, and 6 Hz at the stroke of 8 mm: K is below 1."""
    for name in ("stroke", "frequency"):
        assert found[name][HELD][0] == 0.0


def test_more_room_for_the_same_feed(found: dict[str, dict[str, np.ndarray]]) -> None:
    """Open area, length and aperture only help; open area and length ever less."""
    for name in ("open area", "length", "aperture"):
        assert (np.diff(found[name][HELD]) > -1e-3).all(), name
    for name in ("open area", "length"):
        gained = np.diff(found[name][HELD])
        assert gained[-1] < 0.5 * gained[0], name
    width = found["width"][HELD]
    assert width[0] < 0.5 < 0.95 < width[-1]


def test_overfed_and_bare_decks_lose(found: dict[str, dict[str, np.ndarray]]) -> None:
    """Recovery falls beyond the feed that covers the deck; far below it, grains bounce over it."""
    wide = found["feed"][f"stroke 12 mm, {HELD}"]
    at = int(wide.argmax())
    assert 0.2 <= CURVES["feed"].values[at] <= 0.7
    assert wide[0] < wide[at] - 0.02
    assert (np.diff(wide[at:]) < 0.0).all()
    assert wide[-1] < 0.5


def test_slopes_and_throw_angles(found: dict[str, dict[str, np.ndarray]]) -> None:
    """By the velocity of the bed: somewhat down is best, and a throw angle of 30 to 45 degrees."""
    for name, low, high in (("inclination", 5.0, 13.0), ("throw angle", 30.0, 45.0)):
        assert low <= CURVES[name].values[int(found[name][FREE].argmax())] <= high
    # what remains of the angles where the velocity is held is small
    assert np.ptp(found["throw angle"][HELD]) < 0.06


def test_the_page(tmp_path: Path) -> None:
    text = study.write(tmp_path)
    assert "(practice_curves.png)" in text
    assert (tmp_path / "practice_curves.png").stat().st_size > 10_000
    for curve in study.CURVES:
        assert curve.says in text
