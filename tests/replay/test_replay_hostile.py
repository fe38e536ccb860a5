"""Files that no historian should write: a message or a result, never a traceback or a nan."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from tests.places import SCREENS
from vibroscreen import ConfigError, InputError, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.replay import GAPS, Limits, PlantData, Source, read_plant, replay
from vibroscreen.replay.channels import RATE

CONFIG = ScreenConfig.load(SCREENS / "quarry.toml")
TIMES = st.one_of(
    st.integers(0, 40).map(lambda k: f"2024-05-01 06:{k:02d}:00"),
    st.integers(0, 23).map(lambda k: f"2024-10-27T{k:02d}:30:00+0{k % 3}:00"),
    st.sampled_from(
        ["", "n/a", "0", "60", "1e400", "-5", "2024-02-30", "9999-12-31", "0001-01-01 00:00",
         "2024-05-01T24:00:00Z", "1,5", "2024-05-01 06:00:60", "nan", "\u0663", "x" * 300]
    ),
    st.floats().map(str),
)  # fmt: skip
CELLS = st.one_of(
    st.floats().map(str),
    st.floats(-10.0, 500.0).map(lambda x: f"{x:.1f}"),
    st.sampled_from(
        ["", "Bad", "NaN", "inf", "1,5", "1e999", "=A1", "#REF!", '"', "--", "\u00b5", "\0", "True"]
    ),
)
HEADS = st.sampled_from(["time", "time_s", "Time", "rate_t_h", "WI-1", "undersize_t_h", "", "frequency_rpm", "passing_16_mm"])  # fmt: skip
ENCODINGS = st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252", "utf-7"])


@st.composite
def exports(draw: st.DrawFn) -> bytes:
    """A table that is nearly right, then shuffled, cut and spoilt."""
    separator = draw(st.sampled_from([",", ";", "\t", "|"]))
    time = draw(st.sampled_from(["time", "time_s"]))
    head = [time, "rate_t_h", *draw(st.lists(HEADS, max_size=2))]
    head = draw(st.permutations(head)) if draw(st.booleans()) else head
    rows = draw(st.lists(st.tuples(TIMES, *[CELLS] * (len(head) - 1)), max_size=12))
    if draw(st.booleans()):
        rows = [(f"{60 * k}" if time == "time_s" else f"2024-05-01 06:{k:02d}", *row[1:]) for k, row in enumerate(rows)]  # fmt: skip
    lines = [separator.join(row) for row in (head, *rows)]
    if draw(st.booleans()):
        lines[1:] = draw(st.permutations(lines[1:]))
    raw = "\n".join(lines).encode(draw(ENCODINGS), errors="replace")
    raw = raw[: draw(st.integers(0, len(raw)))] if draw(st.integers(0, 4)) == 0 else raw
    if draw(st.integers(0, 4)) == 0:
        place = draw(st.integers(0, len(raw)))
        raw = raw[:place] + draw(st.binary(max_size=6)) + raw[place:]
    return raw


def in_order(plant: PlantData) -> None:
    """Numbers everywhere, times that rise, and something said of every row that was filled."""
    assert (np.diff(plant.seconds) > 0.0).all()
    assert (plant.lasts > 0.0).all()
    assert (plant.inputs[RATE] >= 0.0).all()
    for values in plant.inputs.values():
        assert np.isfinite(values).all()
    assert all(plant.marks[plant.filled])
    assert plant.filled.sum() == 0 or plant.findings


@settings(max_examples=200, deadline=None)
@given(exports(), st.sampled_from(GAPS), st.sampled_from([None, "Europe/Prague"]))
def test_a_message_or_a_result(raw: bytes, gaps: str, zone: str | None) -> None:
    """Read it, and run what is short enough."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plant.csv"
        path.write_bytes(raw)
        try:
            plant = read_plant(path, CONFIG, Source(zone=zone), gaps, Limits())
        except (InputError, ConfigError):
            return
        in_order(plant)
        if plant.seconds.size > 300:
            return
        parts = replay(CONFIG, plant)
        with contextlib.suppress(InputError):  # a step that is longer than any
            for part in parts:
                numbers = part.select_dtypes("number")
                measured = [name for name in numbers if "_measured" in str(name)]
                assert np.isfinite(numbers.drop(columns=measured).to_numpy()).all()


@settings(max_examples=40, deadline=None)
@given(exports())
def test_the_command_has_no_traceback(raw: bytes) -> None:
    """It ends well, or with a message and the exit code of what can be mended."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plant.csv"
        path.write_bytes(raw)
        done = CliRunner().invoke(
            app, ["replay", str(path), str(SCREENS / "quarry.toml"), "--json", "--gap-min", "1e5"]
        )
        assert done.exit_code in (0, 1), done.output
        assert done.exception is None or isinstance(done.exception, SystemExit)
        assert (done.exit_code == 1) == bool(done.stderr.strip())
        assert "NaN" not in done.stdout
