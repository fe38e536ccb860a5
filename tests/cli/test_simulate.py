"""`vibroscreen simulate`: a shift through a screen."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from tests.places import SCREENS
from vibroscreen.cli import app

TWO_DECK = SCREENS / "two_deck.toml"
SERIES = "time_s;rate_t_h;frequency_rpm\n0;250;930\n60;300;\n120;900;\n180;0;\n240;250,5;900\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "series.csv").write_text(SERIES)
    return tmp_path


def simulate(*arguments: object) -> Result:
    """`vibroscreen simulate two_deck.toml series.csv`."""
    command = ["simulate", str(TWO_DECK), "series.csv", *map(str, arguments)]
    return CliRunner().invoke(app, command)


def rows(*arguments: object) -> list[dict[str, str]]:
    """What --csv prints."""
    done = simulate("--csv", *arguments)
    assert done.exit_code == 0, done.output
    return list(csv.DictReader(io.StringIO(done.stdout)))


def test_mass_is_that_of_the_table() -> None:
    """What was fed leaves in a product or lies on the decks."""
    found = rows("--step", 7)
    ends = np.array([float(row["time_s"]) for row in found])
    spent = np.diff(ends, prepend=0.0)
    assert ends[-1] == 300.0
    mass = {
        name: float(spent @ [float(row[name]) for row in found]) / 3.6
        for name in ("feed_t_h", "oversize_t_h", "intermediate[1]_t_h", "undersize_t_h")
    }
    assert mass["feed_t_h"] == pytest.approx((250 + 300 + 900 + 0 + 250.5) * 60 / 3.6)
    held = float(found[-1]["hold_up_kg"])
    assert mass.pop("feed_t_h") == pytest.approx(sum(mass.values()) + held, rel=1e-8)


def test_for_people() -> None:
    """Not more rows than a page, sums of masses and energy, alarms with their time."""
    done = simulate("--step", 2)
    text = done.stdout
    assert text.startswith("double-deck quarry screen: 300 s in 150 steps\n")
    table = [line for line in text.partition("\n\nIn all")[0].splitlines() if line[:1].isdigit()]
    assert 20 <= len(table) <= 25
    assert table[-1].startswith("300 ")
    assert "Every 7 steps; --csv gives all" in text
    found = rows("--step", 2)
    power = [float(row["drive_power_kw"]) for row in found]
    assert f"Drive: {np.mean(power) * 300 / 3600:.4g} kWh" in text
    said = " ".join(text.split())
    assert "In all: fed 28.34 t, over deck 1 " in said
    assert "alarm.bed_depth: first at 1" in said
    assert simulate("--step", 2, "--strict").exit_code == 3


def test_for_machines(folder: Path) -> None:
    """JSON has the rows of the table; a picture is written beside."""
    done = simulate("--json", "--plot", "run.png")
    found = json.loads(done.stdout)
    assert done.stderr == "written: run.png\n"
    assert (folder / "run.png").stat().st_size > 20_000
    assert found["name"] == "double-deck quarry screen"
    for said, row in zip(found["rows"], rows(), strict=True):
        assert list(said) == list(row)
        assert said["undersize_t_h"] == pytest.approx(float(row["undersize_t_h"]))


def test_dates(folder: Path) -> None:
    """The day stands above, the time in every row; in the table both."""
    (folder / "series.csv").write_text(
        "time,rate_t_h\n2024-05-01 06:00,250\n2024-05-01 06:01,300\n"
    )
    assert [row["time"] for row in rows()] == ["2024-05-01 06:01:00", "2024-05-01 06:02:00"]
    text = simulate().stdout
    assert "\n2024-05-01 " in text
    assert "\n06:01:00 " in text


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (("--step", "0"), 1, "step = 0 s, until = 300 s: give times above 0 s"),
        (("--step", "soon"), 2, "Invalid value for '--step'"),
        (("--csv", "--json"), 2, "--json and --csv exclude each other"),
        (("--set", "deck[1].width_m=0"), 1, "deck[1].width_m = 0 is out of range"),
        (("--plot", "run.gif2"), 1, "'.gif2' is no format of a picture"),
    ],
)
def test_what_cannot_be_run(arguments: tuple[str, ...], code: int, told: str) -> None:
    """Told by its text."""
    done = simulate(*arguments)
    assert done.exit_code == code
    assert told in done.stderr


def test_a_series_that_is_none(folder: Path) -> None:
    """Missing, or with a line that cannot be."""
    (folder / "series.csv").write_text("time_s,rate_t_h\n0,250\n1,-3\n")
    done = simulate()
    assert done.exit_code == 1
    assert done.stderr.splitlines() == [
        "line 3: rate_t_h = -3 is out of range (0 to 18000 t/h): give a finite rate, 0 for no feed",
        "in series.csv",
    ]
    (folder / "series.csv").unlink()
    assert simulate().stderr == "series.csv: no such file or directory\n"
