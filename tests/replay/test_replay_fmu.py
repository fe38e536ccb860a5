"""A plant's data through an FMU in the engine's place."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner, Result

from build_fmu import build
from tests.places import SCREENS
from vibroscreen.cli import app
from vibroscreen.config import ScreenConfig

TEXT = (
    "time_s,rate_t_h,frequency_rpm,intermediate_t_h\n0,250,930,60\n60,300,930,70\n120,0,930,5\n"
    "180,280,900,70\n240,1200,900,\n300,200,0,10\n"
)


EDGES = "size_classes.edges_mm=[0, 1, 2, 4, 5.6, 8, 11.2, 16, 22.4, 31.5, 45, 64, 75]"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data, and the FMU of the screen with two decks."""
    path = tmp_path_factory.mktemp("fmu")
    build(ScreenConfig.load(SCREENS / "two_deck.toml"), path)
    (path / "plant.csv").write_text(TEXT)
    return path


def command(folder: Path, screen: str, *arguments: object) -> Result:
    """`vibroscreen replay plant.csv SCREEN`."""
    line = ["replay", folder / "plant.csv", SCREENS / screen, *arguments]
    return CliRunner().invoke(app, [*map(str, line)])


def test_it_gives_what_the_engine_gives(folder: Path) -> None:
    """The same table, alarms and all."""
    for name, more in (("engine.csv", ()), ("fmu.csv", ("--fmu", folder / "VibratingScreen.fmu"))):
        done = command(folder, "two_deck.toml", "-o", folder / name, *more)
        assert done.exit_code == 0, done.output
    engine, fmu = (pd.read_csv(folder / name) for name in ("engine.csv", "fmu.csv"))
    assert engine["alarms"].notna().any()
    pd.testing.assert_frame_equal(engine, fmu, rtol=1e-8, atol=1e-9)


def test_what_is_no_fmu_of_the_screen(folder: Path) -> None:
    """Another screen, no FMU at all, no file: told without a traceback."""
    fmu = folder / "VibratingScreen.fmu"
    plain = folder / "plain.csv"
    plain.write_text("time_s,rate_t_h\n0,250\n60,300\n")
    for more in (("quarry.toml",), ("two_deck.toml", "--set", EDGES)):
        line = ["replay", plain, SCREENS / more[0], *more[1:], "--fmu", fmu]
        done = CliRunner().invoke(app, [*map(str, line)])
        assert done.exit_code == 1
        assert "build it from this" in done.stderr
    done = command(folder, "two_deck.toml", "--fmu", folder / "plant.csv")
    assert done.exit_code == 1
    assert "is no FMU" in done.stderr
    done = command(folder, "two_deck.toml", "--fmu", folder / "none.fmu")
    assert done.exit_code == 1
    assert "none.fmu: no such file or directory" in done.stderr


def test_a_step_that_the_fmu_refuses(folder: Path) -> None:
    """In its words, with the time."""
    long = folder / "long.csv"
    long.write_text("time_s,rate_t_h\n0,100\n3e9,100\n6e9,100\n")
    line = ["replay", long, SCREENS / "two_deck.toml", "--fmu", folder / "VibratingScreen.fmu"]
    done = CliRunner().invoke(app, [*map(str, line)])
    assert done.exit_code == 1
    assert "take shorter steps" in done.stderr
    assert "at 0 s of the data" in done.stderr
