"""The study of coverage runs, and what it prints is what it counts."""

from __future__ import annotations

import numpy as np
import pytest

import survey_coverage as study
from vibroscreen import ScreenConfig


def test_few_surveys(capsys: pytest.CaptureFixture[str]) -> None:
    """Two surveys of two kinds: shares between 0 and 1, and the tests of the scales beside."""
    table = study.main(surveys=2, kinds=["recoveries", "one gross error", study.NAMED])
    assert list(table.index) == ["recoveries", "one gross error"]
    assert table.isin([0.0, 0.5, 1.0]).all(axis=None)
    assert "a scale 10 % high, 6 runs: named" in capsys.readouterr().out


def test_scales_are_named() -> None:
    """Of 24 surveys of four runs 18 or more name the scale: fewer in 1 of 200 such sets at 0.91."""
    found, _, false = study.named(24)
    assert found >= 18 / 24
    assert false <= 4 / 24  # more in 1 of 100 sets at 0.05


def test_the_section_says_what_was_counted() -> None:
    """Shares by kind and by number of runs, as tables."""
    shares = np.array([0.95, 0.925])
    text = study.text_of({"recoveries": shares}, {4: np.array([0.9, 0.1, 0.05])}, 200)
    assert "| recoveries | 0.950 | 0.925 |" in text
    assert "| 4 | 0.900 | 0.100 | 0.050 |" in text
    assert "0.950 +- 0.031" in text


def test_made_up_streams_balance() -> None:
    """The truth that surveys are made up from closes by class."""
    config = ScreenConfig.load(study.planning.SCREEN).with_values(study.planning.TRUTH)
    for run in study.products(config, 2):
        feed = run["feed"] / run["feed"].sum()
        assert feed == pytest.approx(config.feed.mass_fraction, abs=1e-6)
