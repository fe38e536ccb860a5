"""Fits to streams: known numbers come back, and intervals are those of the profile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from tests.places import DATA, ROOT
from tests.survey.test_calibrate import BOTH, LINE, RATES, U, W, X, line, screen
from vibroscreen import InputError, Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.survey import Sheet, Survey, SurveyRun, read_survey
from vibroscreen.survey.calibrate import Parameter, calibrate, fit
from vibroscreen.survey.streams import stream_runs

FOLDER = ROOT / "engine" / "validation" / "data"


def surveyed(noise: float, seed: int = 0) -> Survey:
    """Four runs of the true screen: rates, and shares on all sieves, with a noise."""
    rng = np.random.default_rng(seed)
    runs = []
    for rate in RATES:
        config = screen(rate)
        steady = Screen(config).solve_steady()
        sizes = config.size_classes.edges[1:-1]
        sheets = {}
        for name in ("feed", "undersize", "oversize"):
            rates = steady.streams[name].class_rates
            passing = np.cumsum(rates)[:-1] / rates.sum()
            passing = np.clip(passing + noise * rng.standard_normal(passing.size), 0.0, 1.0)
            total = rates.sum() * (1.0 + noise * rng.standard_normal())
            error = np.full(passing.size, max(noise, 1e-3))
            sheets[name] = Sheet(
                name, "here", sizes, total, max(noise, 1e-3) * rate, passing, None, error
            )
        runs.append(SurveyRun(f"{rate:g}", sheets, {}))
    return Survey(tuple(runs))


def test_known_numbers_come_back_from_streams() -> None:
    """Without noise within 1 % (the solver's tolerance); with 1 % the profiles hold them."""
    start = screen(30.0, 0.02, 0.05)
    found = calibrate(
        stream_runs(surveyed(0.0), start), BOTH, starts=2, leave_out=False, intervals="linear"
    )
    assert_allclose(found.fit.value, [U, W], rtol=1e-2)
    assert (np.abs(found.fit.modelled - found.fit.measured) < 1e-3).all()
    noisy = calibrate(stream_runs(surveyed(0.01, 1), start), BOTH, starts=1, leave_out=True)
    assert (noisy.fit.lower < [U, W]).all()
    assert (noisy.fit.upper > [U, W]).all()
    assert set(noisy.fit.held_out) == {f"{rate:g}" for rate in RATES}
    table = noisy.frame()
    assert set(table["stream"]) == {"feed", "undersize", "oversize"}
    # the undersize of a deck of 10 mm has nothing to say on 10 mm, and 5 shares and 3 rates else
    assert len(table) == 4 * (5 + 4 + 5 + 3)


def test_three_numbers_of_the_quarry_screen() -> None:
    """Sheets made up with known numbers: the 90 % intervals hold all three."""
    config = ScreenConfig.load(FOLDER / "survey_screen.toml")
    truth = [0.353, 0.0286, 0.00787]
    numbers = [
        Parameter("passage.velocity", 0.01, 10.0),
        Parameter("segregation.velocity", 1e-3, 1.0),
        Parameter("segregation.dilation", 1e-4, 0.05),
    ]
    runs = read_survey(FOLDER / "quarry_sheets.csv", config)
    found = calibrate(runs, numbers, starts=4, leave_out=False, confidence=0.9).fit
    assert (found.lower <= truth).all()
    assert (found.upper >= truth).all()
    assert found.upper[0] / found.lower[0] < 4.0  # the passage is told, sifting hardly
    assert any("do not limit segregation.velocity above" in said for said in found.warnings)


def test_a_fit_that_misses_is_told() -> None:
    """A deck that lets nothing through cannot give the products that were measured."""
    config, true = screen(30.0, 0.02, 0.05), surveyed(0.01, 1)
    runs = stream_runs(true, config)
    slow = Parameter("passage.velocity", 1e-3, 2e-3)
    found = calibrate(runs, [slow], starts=1, leave_out=False, intervals="linear").fit
    assert any(
        "is missed by" in said and "look for gross errors" in said for said in found.warnings
    )
    free = calibrate(runs, BOTH, starts=1, leave_out=False, intervals="linear").fit
    assert not any("is missed by" in said for said in free.warnings)


def test_profiles_of_a_line_are_its_intervals() -> None:
    """Where the model is linear, profile and slopes say the same."""
    y = 1.0 + 2.0 * X + 0.1 * np.random.default_rng(1).standard_normal(X.size)
    linear = fit(line, LINE, y, starts=1)
    profile = fit(line, LINE, y, starts=1, intervals="profile")
    assert_allclose(profile.lower, linear.lower, rtol=2e-3)
    assert_allclose(profile.upper, linear.upper, rtol=2e-3)


def test_profiles_of_a_product_have_no_limits() -> None:
    """a b x says nothing of a and b by themselves: each reaches from the bound of the other."""
    parameters = (Parameter("a", 0.1, 10.0), Parameter("b", 0.1, 10.0))
    y = 2.0 * X + 0.01 * np.cos(9 * X)
    found = fit(lambda p: p[:, :1] * p[:, 1:2] * X, parameters, y, starts=2, intervals="profile")
    assert_allclose(found.lower, 0.2, rtol=0.02)
    assert_allclose(found.upper, 10.0)
    assert any(said.startswith("the data do not limit a above") for said in found.warnings)
    with pytest.raises(InputError, match="intervals = 'wald' is unknown: give one of linear"):
        fit(line, LINE, X, intervals="wald")
    with pytest.raises(InputError, match="confidence = 95 is no chance"):
        fit(line, LINE, X, confidence=95.0)


def test_sizes_above_the_aperture_are_no_evidence() -> None:
    """Of 16 mm and more nothing counts in the undersize: by recoveries and by streams."""
    config = ScreenConfig.load(FOLDER / "survey_screen.toml")
    by_recovery = read_survey(DATA / "cases" / "survey_semicolon.csv", config)[0]
    assert np.isnan(by_recovery.recovery).tolist() == [False] * 7 + [True] * 4
    run = read_survey(DATA / "cases" / "survey_streams.csv", config)[0]
    counts = [label for label in run.labels if label[0] == "undersize"]
    assert [size for _, _, size in counts] == [6.3e-5, 0.0025, 0.005, 0.008, 0.01, 0.0125, 0.016]


def test_command_line(tmp_path: Path) -> None:
    """Sheets in, a screen with fitted numbers and a picture out."""
    toml, picture = tmp_path / "fitted.toml", tmp_path / "fit.png"
    command = ["calibrate", str(FOLDER / "quarry_sheets.csv"), str(FOLDER / "survey_screen.toml"), "--fit", "passage.velocity=0.1:1", "--starts", "1", "--no-leave-out", "--output", str(toml), "--plot", str(picture)]  # fmt: skip
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert ScreenConfig.load(toml).passage.velocity == pytest.approx(0.353, rel=0.2)
    assert "standard errors" in result.output
    assert picture.stat().st_size > 10_000
