"""A plant's data through a screen, part by part."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner, Result

from tests.places import SCREENS
from vibroscreen import Feed, InputError, Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.replay import read_plant, replay, run, table_file

QUARRY = SCREENS / "quarry.toml"
CONFIG = ScreenConfig.load(QUARRY)
TEXT = (
    "time,rate_t_h,frequency_rpm,undersize_t_h\n"
    "2024-05-01 06:00:00,250,930,120\n2024-05-01 06:01:00,300,930,\n2024-05-01 06:02:00,-4,930,150\n"
    "2024-05-01 06:03:00,280,900,140\n2024-05-01 06:13:00,290,900,145\n"
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plant.csv").write_text(TEXT)
    return tmp_path


def command(*arguments: object) -> Result:
    """`vibroscreen replay plant.csv quarry.toml`."""
    return CliRunner().invoke(app, ["replay", "plant.csv", str(QUARRY), *map(str, arguments)])


def test_rows_are_steps_of_the_screen(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit, whatever the parts; masses are those of the data."""
    plant = read_plant(folder / "plant.csv", CONFIG, gaps="stop")
    whole = pd.concat(list(replay(CONFIG, plant)), ignore_index=True)
    monkeypatch.setattr(run, "PART", 3)
    parts = list(replay(CONFIG, plant))
    assert [len(part) for part in parts] == [3, 3, 3, 3, 2]
    pd.testing.assert_frame_equal(whole, pd.concat(parts, ignore_index=True))
    rates = [250.0, 300.0, 0.0, 280.0, *[0.0] * 9, 290.0]
    assert whole["feed_t_h"].to_numpy() == pytest.approx(rates)
    screen = Screen(CONFIG)
    for k, rate in enumerate(rates):
        frequency = 15.5 if k < 3 else 15.0
        motion = CONFIG.motion.linear(CONFIG.motion.amplitude, frequency, CONFIG.motion.throw_angle)
        result = screen.step(60.0, Feed(rate / 3.6, CONFIG.feed.mass_fraction), motion)
        assert whole["undersize_t_h"][k] / 3.6 == pytest.approx(result.undersize.mass_flow_rate)
    fed = float((whole["feed_t_h"] * whole["lasts_s"]).sum()) / 3.6
    out = sum(
        float((whole[f"{name}_t_h"] * whole["lasts_s"]).sum()) for name in ("undersize", "oversize")
    )
    assert fed == pytest.approx(out / 3.6 + whole["hold_up_kg"].iloc[-1], rel=1e-9)
    assert list(whole["filled"]) == [*[False] * 4, *[True] * 9, False]
    assert whole["marks"][2] == "rate_t_h limited"
    assert str(whole["time"].iloc[-1]) == "2024-05-01 06:13:00"


def test_a_refused_step_tells_when(folder: Path) -> None:
    """The message of the engine, and the time."""
    (folder / "plant.csv").write_text("time_s,rate_t_h\n0,100\n1e9,100\n4e9,100\n")
    with pytest.raises(InputError, match=r"dt = 3e.09 s is more than 1e.09 s") as caught:
        list(replay(CONFIG, read_plant(folder / "plant.csv", CONFIG)))
    assert caught.value.__notes__ == ["at 1e+09 s of the data"]


@pytest.mark.parametrize("name", ["day.parquet", "day.csv"])
def test_files(name: str, folder: Path) -> None:
    """The same numbers in both; what is none is empty."""
    done = command("-o", name, "--plot", "day.png", "--gap", "stop")
    assert done.exit_code == 0, done.output
    assert done.stderr == f"written: {name}\nwritten: day.png\n"
    assert (folder / "day.png").stat().st_size > 20_000
    plant = read_plant(folder / "plant.csv", CONFIG, gaps="stop")
    expected = pd.concat(list(replay(CONFIG, plant)), ignore_index=True)
    if name.endswith(".csv"):
        with (folder / name).open() as file:
            rows = list(csv.DictReader(file))
        assert rows[1]["undersize_measured_t_h"] == ""
        assert "nan" not in (folder / name).read_text()
        found = [float(row["undersize_t_h"]) for row in rows]
    else:
        frame = pd.read_parquet(folder / name)
        assert list(frame) == list(expected)
        assert frame["undersize_measured_t_h"].isna().sum() == 10
        found = frame["undersize_t_h"].tolist()
    assert found == pytest.approx(expected["undersize_t_h"].tolist())


def test_for_people() -> None:
    """Data, products beside measured ones, masses, alarms with their time."""
    text = " ".join(command("--gap", "stop").stdout.split())
    assert text.startswith(
        "quarry screen: 14 min in 14 rows of 60 s 2024-05-01 06:00:00 to 2024-05-01 06:14:00"
    )
    assert "rate_t_h below 0, taken as 0 1 2024-05-01 06:02:00" in text
    assert "9 of 14 rows have a number filled in, 64.3 %" in text
    assert "In all: fed 18.67 t, oversize" in text  # (250 + 300 + 280 + 290) / 60
    assert "alarm.performance: first at 2024-05-01 06:0" in text
    assert command("--strict").exit_code == 3


def test_for_machines() -> None:
    """What was found, masses, and how the measured product compares."""
    found = json.loads(command("--json").stdout)
    assert (found["rows"], found["filled"], found["interval_s"]) == (14, 9, 60.0)
    assert {"column": "rate_t_h", "what": "below 0, taken as 0", "rows": 1, "first": "2024-05-01 06:02:00"} in found["findings"]  # fmt: skip
    (compared,) = found["compared_t_h"]
    assert compared["hours"] == pytest.approx(4.0 / 60.0)
    assert compared["measured"] == pytest.approx(np.mean([120.0, 150.0, 140.0, 145.0]))


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (("--gap", "guess"), 1, "gap = 'guess' is unknown"),
        (("--rate", "W"), 1, "rate_t_h = 'W' is no column of the file: did you mean"),
        (("--column", "W"), 2, "'W' is not KEY=COLUMN: write --column"),
        (
            ("--output", "day.doc"),
            1,
            "day.doc: '.doc' is no format of a table: let the name end in",
        ),
        (("--time-format", "%Q"), 1, "--time-format '%Q' is none"),
        (("--stuck-min", "-1"), 1, "stuck = -60 is not a number from 0 up"),
    ],
)
def test_what_cannot_be_replayed(arguments: tuple[str, ...], code: int, told: str) -> None:
    """Told by its text, never by a traceback."""
    done = command(*arguments)
    assert done.exit_code == code
    assert told in " ".join(done.stderr.split())


def test_a_file_that_stays_empty(folder: Path) -> None:
    """A name that is none is told before the run."""
    with pytest.raises(OSError, match="No such file"), table_file(folder / "no" / "day.parquet"):
        pass
