"""Sizing rules by hand, and the engine beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import engineering_rules as example
from vibroscreen import ScreenConfig
from vibroscreen.sizing_rules import karra_cut_size, karra_partition, vsma_area, vsma_recovery

INCH, FOOT, SHORT_TON, POUND = 0.0254, 0.3048, 907.18474, 0.45359237
APERTURE = 0.625 * INCH
HUNDRED = 100.0 * POUND / FOOT**3  # kg/m3


def feed(size: float) -> float:
    """40 % finer than half of 5/8 inch, 75 % finer than 5/8 inch: the material of the tables."""
    return float(np.interp(size / APERTURE, [0.0, 0.5, 1.0, 2.0], [0.0, 0.4, 0.75, 1.0]))


def test_vsma_of_its_own_material() -> None:
    """All factors are 1: 2.82 short tons an hour of undisturbed undersize need one square foot."""
    rate = 2.82 * SHORT_TON / 3600.0
    area = vsma_area(rate, feed, APERTURE, 0.59, HUNDRED)
    assert area == pytest.approx(FOOT**2, rel=1e-9)
    assert vsma_area(2 * rate, feed, APERTURE, 0.59, HUNDRED) == pytest.approx(2 * area)
    assert vsma_area(rate, feed, APERTURE, 0.295, HUNDRED) == pytest.approx(2 * area)
    assert vsma_area(rate, feed, APERTURE, 0.59, 2 * HUNDRED) == pytest.approx(area / 2)
    assert vsma_area(rate, feed, APERTURE, 0.59, HUNDRED, deck=2) == pytest.approx(area / 0.9)


def test_vsma_efficiency() -> None:
    """J = 1 at 95 %, 1.35 at 85 %; held above, nothing below 70 %."""
    assert vsma_recovery(10.0, 10.0) == pytest.approx(0.95)
    assert vsma_recovery(10.0, 13.5) == pytest.approx(0.85)
    assert vsma_recovery(10.0, 5.0) == pytest.approx(0.95)
    assert np.isnan(vsma_recovery(10.0, 20.0))


def test_karra_by_hand() -> None:
    """A level deck at the rated load: d50 = 0.975 (1 - near-size)^0.511 apertures."""
    h = APERTURE * 1e3
    basic = 12.1286 * h**0.3162 - 10.2991
    rated = basic * (1.6 - 1.2 * 0.25) * (2.053 * 0.4**0.564) * HUNDRED / 1602.0  # t/h m2
    near = feed(1.25 * APERTURE) - feed(0.75 * APERTURE)
    cut = karra_cut_size(rated / 3.6 * 10.0, feed, APERTURE, 0.59, HUNDRED, 10.0)
    assert cut == pytest.approx(APERTURE * 0.975 * (1.0 - near) ** 0.511, rel=1e-9)
    tenfold = karra_cut_size(rated / 3.6 * 100.0, feed, APERTURE, 0.59, HUNDRED, 10.0)
    assert tenfold / cut == pytest.approx(10.0**-0.148)
    steep = karra_cut_size(rated / 3.6 * 10.0, feed, APERTURE, 0.59, HUNDRED, 10.0, 0.35)
    assert steep < cut


def test_karra_and_vsma_rate_alike() -> None:
    """Two sources, one screen: basic capacity x oversize x half-size within 15 %."""
    h = APERTURE * 1e3
    karra = (12.1286 * h**0.3162 - 10.2991) * (1.6 - 1.2 * 0.25) * (2.053 * 0.4**0.564)
    vsma = 2.82 * SHORT_TON / 1000.0 / FOOT**2
    assert karra == pytest.approx(vsma, rel=0.15)


def test_karras_factors_have_no_jumps() -> None:
    """Cut size over the shares of oversize and half-size: steps below 1 % where formulas change."""
    over = np.linspace(0.01, 0.97, 400)
    cuts = [
        karra_cut_size(5.0, lambda d, q=q: (1 - q) * min(1.0, d / 0.02), 0.02, 0.6, 1600.0, 10.0)
        for q in over
    ]
    assert np.abs(np.diff(np.log(cuts))).max() < 0.03


def test_karra_partition() -> None:
    """Half of the cut size's grains stay; it rises with size."""
    curve = karra_partition(np.array([0.0, 0.5, 1.0, 2.0]), 1.0)
    assert_allclose(curve[[0, 2]], [0.0, 0.5])
    assert (np.diff(curve) > 0.0).all()


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """The example, with its picture."""
    path = tmp_path_factory.mktemp("rules") / "rules.png"
    table, fitted = example.main(output=path)
    assert path.stat().st_size > 20_000
    assert len(fitted.fit.parameters) == 3
    assert fitted.fit.rmse < 0.02
    assert fitted.fit.held_out_rmse < 0.03
    return table


def test_more_feed_recovers_less(frame: pd.DataFrame) -> None:
    """By every rule and by the engine (within its tolerance)."""
    for name in ("Karra", "default", "fitted"):
        assert (frame[f"recovery {name}"].diff().dropna() < 1e-3).all(), name
    assert frame["recovery VSMA"].dropna().is_monotonic_decreasing
    assert_allclose(frame["VSMA area at 95 %, m2"] / frame.index, frame.iloc[0, 0] / 50.0)


def test_what_the_section_claims(frame: pd.DataFrame) -> None:
    """Within 0.045 of both rules up to 600 t/h, between them above; never a cut above the mesh."""
    usual, beyond = frame.loc[:600.0], frame.loc[400.0:]
    for name in ("Karra", "VSMA"):
        assert_allclose(usual["recovery default"], usual[f"recovery {name}"], atol=0.045)
    assert_allclose(beyond["cut size default"], beyond["cut size Karra"], atol=0.9)
    assert_allclose(usual["recovery fitted"], usual["recovery Karra"], atol=0.04)
    assert (frame[["cut size default", "cut size fitted"]] < 16.0).all(axis=None)
    assert frame["cut size Karra"].loc[100.0] > 16.0
    assert np.isnan(frame["recovery VSMA"].loc[1000.0])
    high = frame["recovery default"].loc[800.0:]
    assert (high > [frame["recovery VSMA"].loc[800.0], 0.7]).all()
    assert (high < frame["recovery Karra"].loc[800.0:]).all()
    sharp = frame["Ep default"] / frame["cut size default"]
    assert (sharp.loc[:600.0] < 0.13).all()
    assert_allclose(frame["Ep Karra"] / frame["cut size Karra"], 0.1328, atol=1e-3)


def test_section(tmp_path: Path) -> None:
    """Every feed rate has its row, and the numbers that the text argues with are there."""
    text = example.write(tmp_path)
    assert text.count("\n| ") == len(example.RATES) + 1
    assert "| 300 |" in text
    assert ScreenConfig.default().decks[0].panels[0].aperture == 0.016  # as the text says
