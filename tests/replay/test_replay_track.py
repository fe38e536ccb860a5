"""A deck that blinds is seen in the products; one that does not stays as it is."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tests.places import SCREENS
from vibroscreen import Feed, InputError, Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.replay import PlantData, Track, track
from vibroscreen.replay.track import scaled
from vibroscreen.units import T_H

QUARRY = SCREENS / "quarry.toml"
CONFIG = ScreenConfig.load(QUARRY)
MINUTES = np.arange(720)
# In steps of twenty minutes.
BLINDING = np.interp(MINUTES // 20 * 20 + 10, [0, 180, 720], [1.0, 1.0, 0.6])
NOISE = 0.02  # of the scale on the undersize, a row


def made(openness: np.ndarray, seed: int) -> PlantData:
    """Minutes of a plant whose open area is `openness` times that of the file."""
    rng = np.random.default_rng(seed)
    count = openness.size
    rates = CONFIG.feed.mass_flow_rate * (1.0 + 0.1 * np.sin(np.arange(count) / 40.0))
    rates = rates * (1.0 + 0.03 * rng.standard_normal(count))
    screen, under = Screen(CONFIG), np.empty(count)
    panel = screen.record("panel")[0, 0]
    for k, rate in enumerate(rates.tolist()):
        panel.open_area = CONFIG.decks[0].panels[0].open_area * openness[k]
        result = screen.step(60.0, Feed(rate, CONFIG.feed.mass_fraction))
        under[k] = result.undersize.mass_flow_rate
    return PlantData(
        seconds=60.0 * np.arange(count),
        lasts=np.full(count, 60.0),
        inputs={"mass_flow_rate": rates},
        products={"undersize": under * (1.0 + NOISE * rng.standard_normal(count))},
        filled=np.zeros(count, dtype=bool),
        marks=np.full(count, "", dtype=object),
        findings=(),
        interval=60.0,
    )


def held(found: Track, openness: np.ndarray) -> float:
    """Share of the windows whose interval holds the truth."""
    truth = np.interp(found.seconds / 60.0, MINUTES, openness)
    return float(np.mean((found.lower <= truth) & (truth <= found.upper)))


def test_blinding_is_followed() -> None:
    """Within the stated 90 % interval, over some plants; each of them is told to fall."""
    found = [track(CONFIG, made(BLINDING, seed)) for seed in range(3)]
    assert np.mean([held(one, BLINDING) for one in found]) >= 0.8
    for one in found:
        assert one.falls
        assert one.level == 0.9
        assert one.factor[-1] == pytest.approx(0.6, abs=0.12)
        assert one.factor[0] == pytest.approx(1.0, abs=0.12)
        # ten rows in a window
        assert one.noise == pytest.approx(NOISE / np.sqrt(10.0), rel=0.3)


def test_what_does_not_fall_stays() -> None:
    """At 1, within the interval; nothing is told to fall."""
    even = np.ones(MINUTES.size)
    found = [track(CONFIG, made(even, seed)) for seed in range(3)]
    assert np.mean([held(one, even) for one in found]) >= 0.8
    for one in found:
        assert not one.falls
        assert np.ptp(one.factor) < 0.12
        assert one.factor == pytest.approx(1.0, abs=0.12)


def test_holes_widen_the_interval() -> None:
    """Windows without a measured product, or with inputs that were filled in, do not count."""
    plant = made(BLINDING, 7)
    plant.products["undersize"][300:420] = np.nan  # type: ignore[index]
    plant.filled[500:520] = True
    found = track(CONFIG, plant)
    middles = found.seconds / 60.0
    assert not ((middles > 300.0) & (middles < 420.0)).any()
    assert not ((middles > 500.0) & (middles < 520.0)).any()
    assert held(found, BLINDING) >= 0.6


def test_the_velocity_of_passage() -> None:
    """Of the laws of passage both numbers set the same rate: where one falls so does the other."""
    plant = made(np.full(240, 0.8), 1)
    area, passage = (track(CONFIG, plant, number) for number in ("open_area", "passage"))
    for one in (area, passage):
        assert one.upper[-1] < 1.0
    assert passage.number == "passage"
    half = scaled(CONFIG, "passage", 0.5)
    assert half.value_of("passage.relative_velocity") == pytest.approx(
        0.5 * CONFIG.value_of("passage.relative_velocity")
    )
    part = pd.DataFrame({"time_s": [0.0, 6000.0], "lasts_s": [60.0, 60.0]})
    beside = area.beside(part)
    assert list(beside)[2:] == ["open_area_factor", "open_area_lower", "open_area_upper"]
    assert (beside["open_area_lower"] < beside["open_area_factor"]).all()


def test_what_cannot_be_followed() -> None:
    """Told, with what to do."""
    plant = made(np.ones(60), 1)
    with pytest.raises(InputError, match="track = 'wear' is unknown: give open_area or passage"):
        track(CONFIG, plant, "wear")
    with pytest.raises(
        InputError, match="6 windows of 600 s with a measured product, fewer than 8"
    ):
        track(CONFIG, plant)
    with pytest.raises(InputError, match="window = 0 s"):
        track(CONFIG, plant, window=0.0)
    with pytest.raises(InputError, match="track needs a product as measured"):
        track(CONFIG, dataclasses.replace(plant, products={}))


def test_the_command(tmp_path: Path) -> None:
    """Columns beside the rows, a table, a picture; nothing of it without --track."""
    plant = made(np.interp(MINUTES[:240] // 10, [0, 24], [1.0, 0.6]), 3)
    frame = pd.DataFrame(
        {"time_s": plant.seconds, "rate_t_h": plant.inputs["mass_flow_rate"] / T_H}
    )
    frame["undersize_t_h"] = plant.products["undersize"] / T_H
    frame.to_csv(tmp_path / "plant.csv", index=False)
    files = [str(tmp_path / name) for name in ("plant.csv", "out.csv", "out.png")]
    line = ["replay", files[0], str(QUARRY), "-o", files[1]]
    done = CliRunner().invoke(app, [*line, "--track", "open_area", "--plot", files[2]])
    assert done.exit_code == 0, done.output
    assert "Followed: open area over that of the file, 90 % interval" in done.stdout
    assert "The open area falls" in done.stdout
    assert pd.read_csv(files[1])["open_area_factor"].iloc[-1] < 0.8
    assert Path(files[2]).stat().st_size > 20_000
    found = json.loads(CliRunner().invoke(app, [*line, "--json"]).stdout)
    assert found["track"] is None
    assert "open_area_factor" not in pd.read_csv(files[1])
