"""The survey of the data folder, and how many runs are enough."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

import survey_planning as example
from tests.places import ROOT
from vibroscreen import ScreenConfig
from vibroscreen.cli import app
from vibroscreen.survey import read_survey


def test_the_survey_is_what_it_says() -> None:
    """Made anew with the seed it is the file, to the digits printed."""
    config = ScreenConfig.load(example.SCREEN)
    again = example.surveyed(config, 4, np.random.default_rng(example.SEED))
    for run, read in zip(again, read_survey(example.SURVEY, config), strict=True):
        assert run.name == read.name
        assert_allclose(run.recovery, read.recovery, atol=2e-4)
        assert_allclose(run.config.feed.mass_fraction, read.config.feed.mass_fraction, atol=1e-6)


def test_the_command_of_the_readme(tmp_path: Path) -> None:
    """Survey and screen of the repository in, a screen with the true numbers out."""
    target = tmp_path / "fitted.toml"
    command = ["calibrate", str(example.SURVEY), str(example.SCREEN), "--output", str(target)]
    for name in example.TRUTH:
        command += ["--fit", name]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    written = ScreenConfig.load(target)
    fitted = [written.value_of(name) for name in example.TRUTH]
    assert_allclose(fitted, list(example.TRUTH.values()), rtol=0.25)


def test_the_code_of_the_guide(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It runs as printed and finds the numbers that all runs share."""
    page = ROOT / "engine" / "docs" / "calibrate.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    block = next(part for part in blocks if "read_survey" in part)
    names: dict[str, Any] = {}
    monkeypatch.chdir(ROOT)
    exec(compile(block, page.name, "exec"), names)
    found = [names["calibrated"].value_of(name) for name in example.TRUTH]
    assert_allclose(found, list(example.TRUTH.values()), rtol=0.25)
    assert names["found"].fit.rmse == pytest.approx(example.NOISE, rel=0.3)
    assert "passage.relative_velocity" in capsys.readouterr().out


def test_more_runs_fix_more() -> None:
    """Intervals get narrower; they hold the truth; a single run is told to be too few."""
    plans = example.study(surveys=6)
    spread = np.array([plan.spread for plan in plans])
    assert (np.diff(spread, axis=0) < 0.0).all()
    assert plans[0].warned == 1.0
    assert plans[-1].warned == 0.0
    # 36 intervals of 95 %: fewer than 29 hold the truth in 1 of 10 000 such sets
    assert sum(plan.covered.sum() * len(plan.fits) for plan in plans[2:]) >= 29


def test_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth and fit side by side, and the picture."""
    plans = example.study(surveys=2)
    monkeypatch.setattr(example, "study", lambda surveys=2: plans)
    text = example.write(tmp_path)
    for name in example.TRUTH:
        assert f"| {name} | {example.TRUTH[name]:.3g} |" in text
    assert (tmp_path / "calibration.png").stat().st_size > 10_000
    assert list(example.main().index) == list(example.COUNTS)
