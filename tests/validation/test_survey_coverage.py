"""The study of coverage runs, and what it prints is what it counts."""

from __future__ import annotations

import pytest

import survey_coverage as study
from vibroscreen import ScreenConfig


def test_few_surveys(capsys: pytest.CaptureFixture[str]) -> None:
    """Two surveys of two kinds: shares between 0 and 1, and the tests of the scales beside."""
    table = study.main(surveys=2, kinds=["recoveries", "one gross error"])
    assert list(table.index) == ["recoveries", "one gross error"]
    assert table.isin([0.0, 0.5, 1.0]).all(axis=None)
    assert "6 runs: a scale 10 % high is named in" in capsys.readouterr().out


def test_scales_are_named() -> None:
    """Of 12 surveys of six runs at least 9 name the scale: fewer in 1 of 200 such sets at 0.93."""
    found, false = study.named(12, runs=6)
    assert found >= 9 / 12
    assert false <= 3 / 12


def test_made_up_streams_balance() -> None:
    """The truth that surveys are made up from closes by class."""
    config = ScreenConfig.load(study.planning.SCREEN).with_values(study.planning.TRUTH)
    for run in study.products(config, 2):
        feed = run["feed"] / run["feed"].sum()
        assert feed == pytest.approx(config.feed.mass_fraction, abs=1e-6)
