"""Pictures: what they show is what the result says, and names of files are no formulas."""

from __future__ import annotations

import io
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.places import ROOT, SCREENS
from vibroscreen import Screen, ScreenConfig
from vibroscreen.calibrate import Calibration, Parameter, Run, calibrate
from vibroscreen.report import draw_map, draw_sketch, picture
from vibroscreen.steady import SteadyResult
from vibroscreen.units import PERCENT

NAMES = ("$\\frac{1}$ <b>run & '1'</b>", "_hidden", "$x")


@pytest.fixture(scope="module")
def steady() -> SteadyResult:
    path = ROOT / "tests" / "data" / "cases" / "double_deck.toml"
    return Screen(ScreenConfig.load(path)).solve_steady()


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    config = ScreenConfig.default().with_values({"solver.tolerance": 1e-3})
    rates = (30.0, 50.0, 70.0)
    configs = [config.with_values({"feed.mass_flow_rate": rate}) for rate in rates]
    runs = [
        Run(name, one, Screen(one).solve_steady().recovery)
        for name, one in zip(NAMES, configs, strict=True)
    ]
    return calibrate(runs, [Parameter("passage.velocity", 0.05, 0.2)], starts=1)


def test_the_map_shows_the_content_of_the_layers(steady: SteadyResult) -> None:
    figure = picture(draw_map, steady, 1, slice(0, 5))
    (mesh,) = figure.axes[0].collections
    profile = steady.profiles[0]
    shown = np.ma.getdata(mesh.get_array())  # type: ignore[no-untyped-call]
    wanted = profile.content(range(5)) / PERCENT
    assert shown.reshape(wanted.shape) == pytest.approx(wanted, nan_ok=True)
    corners = np.asarray(mesh.get_coordinates())
    assert corners[0, :, 1] == pytest.approx(1e3 * profile.height[0])
    assert corners[-1, :, 1] == pytest.approx(1e3 * profile.height[-1])
    assert figure.axes[0].get_title() == "deck 1: 0 to 10 mm"


def test_the_sketch_is_to_scale() -> None:
    config = ScreenConfig.load(SCREENS / "banana.toml")
    (axes,) = picture(draw_sketch, config).axes
    line = axes.lines[0]
    steps = np.hypot(*np.diff(np.array([line.get_xdata(), line.get_ydata()], dtype=float)))
    slopes = -np.diff(line.get_ydata()) / np.diff(line.get_xdata())
    assert steps == pytest.approx([1.22] * 5)
    assert np.degrees(np.arctan(slopes)) == pytest.approx([34.0, 28.0, 22.0, 16.0, 10.0])
    assert axes.get_aspect() == 1.0


def test_names_of_runs_are_texts(calibration: Calibration) -> None:
    figure = calibration.plot()
    out = io.BytesIO()
    figure.savefig(out, format="svg")
    legend = figure.axes[-1].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(NAMES)
    tree = ElementTree.fromstring(out.getvalue())
    comments = out.getvalue().decode()
    assert "<b>" not in comments
    assert tree.tag.endswith("svg")


def test_a_calibration_shows_itself_in_a_notebook(calibration: Calibration) -> None:
    html = calibration._repr_html_()
    assert "passage.velocity" in html
    assert "&lt;b&gt;run" in html
    assert "<b>" not in html.replace("<b>alarm", "")
    assert "no warnings" in html
