"""Feed and motion through time from tables, and the run under them."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from tests.places import SCREENS
from vibroscreen import InputError, Screen, ScreenConfig
from vibroscreen.series import Series, read_series, run_series

CONFIG = ScreenConfig.load(SCREENS / "quarry.toml")
INNER = CONFIG.size_classes.edges[1:-1]
PASSING = [round(0.05 + 0.9 * k / len(INNER), 4) for k in range(len(INNER))]
HEAD = ",".join(f"passing_{edge * 1e3:g}_mm" for edge in INNER)


def read(text: str, folder: Path, config: ScreenConfig = CONFIG) -> Series:
    """A table in a file."""
    path = folder / "series.csv"
    path.write_text(text, encoding="utf-8")
    return read_series(path, config)


SAME = {
    "seconds": "time_s,rate_t_h,frequency_hz\n0,300,15\n60,360,\n180,,16\n",
    "minutes, semicolons": "rate_t_h;time_min;frequency_hz\n300;10;15,0\n360;11;\n;13;16\n",
    "hours, tabs": "time_h\trate_t_h\tfrequency_hz\n0\t300\t15\n0,0166666666666666667\t360\t\n0,05\t\t16\n",
    "dates": "time,rate_t_h,frequency_hz\n2024-05-01 23:59:00,300,15\n2024-05-02T00:00:00,360,\n2024-05-02 00:02,,16\n",
    "other units": "time_s,rate_kg_s,frequency_rpm\n0,83.33333333333333,900\n60,100,\n180,,960\n",
    "full names": "time_s,feed.rate_t_h,motion.frequency_hz\n0,300,15\n60,360,\n180,,16\n",
    "comments": "# Monday\n\ntime_s,rate_t_h,frequency_hz\n0,300,15 # start\n60,360,\n180,,16\n",
}  # fmt: skip


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_one_series(text: str, tmp_path: Path) -> None:
    """However it is written; empty cells are as before, what is not given as in the screen."""
    series = read(text, tmp_path)
    assert_allclose([moment.time for moment in series.moments], [0.0, 60.0, 180.0], atol=1e-9)
    assert_allclose([m.feed.mass_flow_rate * 3.6 for m in series.moments], [300.0, 360.0, 360.0])
    assert_allclose([moment.motion.frequency for moment in series.moments], [15.0, 15.0, 16.0])
    assert {m.motion.amplitude for m in series.moments} == {CONFIG.motion.amplitude}
    assert {m.feed.mass_fraction for m in series.moments} == {CONFIG.feed.mass_fraction}
    assert series.interval == pytest.approx(90.0)


def test_dates_are_kept(tmp_path: Path) -> None:
    """The moment of any second of the run."""
    series = read(SAME["dates"], tmp_path)
    assert series.start == datetime(2024, 5, 1, 23, 59)
    assert series.moment_of(90.0) == "2024-05-02 00:00:30"
    assert read(SAME["seconds"], tmp_path).moment_of(90.0) == ""


@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_gradations_through_time(scale: float, tmp_path: Path) -> None:
    """In parts of one or per cent; a row without one keeps the one before."""
    shares = ",".join(f"{share * scale:.6g}" for share in PASSING)
    nothing = "," * (len(INNER) - 1)
    series = read(f"time_s,{HEAD}\n0,{nothing}\n5,{shares}\n10,{nothing}\n", tmp_path)
    first, *others = (moment.feed.mass_fraction for moment in series.moments)
    assert first == CONFIG.feed.mass_fraction
    for fraction in others:
        finer = [sum(fraction[: k + 1]) for k in range(len(INNER))]
        assert_allclose(finer, PASSING, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "series: it has fewer than two rows: give a head, such as time_s;rate_t_h"),
        ("time_s,rate_t_h\n0,300\n", "fewer than two rows"),
        ("rate_t_h\n1\n2\n", "series: it needs one column of times, and has none: give one of time_s"),
        ("time_s,time_h\n1,2\n2,3\n", "one column of times, and has time_s and time_h"),
        ("time_s,rate_t_h,rate_t_h\n0,1,1\n1,1,1\n", "the column 'rate_t_h' is there twice: leave one"),
        ("time_s,rte_t_h\n0,1\n1,1\n", "the column 'rte_t_h' is unknown: did you mean 'rate_t_h'?"),
        ("time_s,passing_17_mm\n0,1\n1,1\n", "passing_17_mm: the screen has no limit of classes at 17 mm: it has 0, 1, 2"),
        ("time_s,passing_16_mm\n0,50\n1,50\n", "the column passing_1_mm is missing: give all inner limits"),
        ("time_s,rate_t_h\n0,300\n5,300,1\n", "line 3: it has 3 cells, the head 2: give as many"),
        ("time_s,rate_t_h\n0,300\n0,300\n", "line 3: its time is not later than that of the row before"),
        ("time_s,rate_t_h\n0,300\nx,300\n", "line 3: time_s = 'x' is no finite number"),
        ("time_s,rate_t_h\n0,300\nnan,300\n", "line 3: time_s = 'nan' is no finite number"),
        ("time,rate_t_h\n0,300\n1,300\n", "line 2: time = '0' is no date and time: write it as 2024-05-01"),
        ("time,rate_t_h\n2024-05-01,1\n2024-05-02T00:00:00Z,1\n", "line 3: can't subtract"),
        ("time_s,rate_t_h\n0,-3\n1,3\n", "line 2: rate_t_h = -3 is out of range (0 to 18000 t/h)"),
        ("time_s,rate_t_h\n0,fast\n1,3\n", "line 2: rate_t_h = 'fast' is no finite number: give one, or"),
        ("time_s,stroke_mm\n0,10\n1,900\n", "line 3: stroke_mm = 900 is out of range (0 to 200 mm)"),
        (f"time_s,{HEAD}\n0,{','.join(['0.5'] * 11)}\n1,{','.join(['0.9', *['0.5'] * 10])}\n", "line 3: feed.passing[3] = 0.5 is smaller than feed.passing[2]"),
        (f"time_s,{HEAD}\n0,{','.join(['0.5'] * 11)}\n1,0.5{',' * 10}\n", "line 3: passing_2_mm = '' is no finite number"),
    ],
)  # fmt: skip
def test_what_cannot_be_read(text: str, told: str, tmp_path: Path) -> None:
    """The line, the column, what to do; the file below."""
    with pytest.raises(InputError) as caught:
        read(text, tmp_path)
    assert told in str(caught.value)
    assert caught.value.__notes__ == [f"in {tmp_path / 'series.csv'}"]


def test_no_text(tmp_path: Path) -> None:
    """Another encoding is refused by name."""
    path = tmp_path / "series.csv"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"series\.csv is not text in UTF-8"):
        read_series(path, CONFIG)


def test_the_run_is_that_of_the_screen(tmp_path: Path) -> None:
    """Bit for bit, in steps that end where rows begin, to one interval behind the last row."""
    series = read("time_s,rate_t_h,frequency_hz\n0,300,15\n25,600,\n40,0,16\n", tmp_path)
    found = list(run_series(CONFIG, series, step=10.0))
    first = series.moments[0]
    screen = Screen(CONFIG.replace(feed=first.feed, motion=first.motion))
    ends = [25 / 3, 50 / 3, 25.0, 32.5, 40.0, 50.0, 60.0]
    assert_allclose([time for time, _ in found], ends)
    before = 0.0
    for (time, result), row in zip(found, (0, 0, 0, 1, 1, 2, 2), strict=True):
        moment = series.moments[row]
        same = screen.step(time - before, moment.feed, moment.motion)
        assert result.undersize.mass_flow_rate == same.undersize.mass_flow_rate
        assert result.hold_up == same.hold_up
        before = time
    assert abs(found[-1][1].balance_error) < 1e-9
    usual = [time for time, _ in run_series(CONFIG, series, until=30.0)]
    assert usual == [12.5, 25.0, 30.0]  # at most 20 s, the median of 25 and 15


def test_a_run_may_start_full(tmp_path: Path) -> None:
    """In the steady state of the first row, which stays until something changes."""
    config = ScreenConfig.load(SCREENS / "quarry.toml", {"bed.initial": "steady"})
    series = read("time_s,rate_t_h\n0,200\n60,200\n", tmp_path, config)
    full = config.replace(feed=series.moments[0].feed)
    expected = Screen(full).solve_steady().undersize.mass_flow_rate
    for _, result in run_series(config, series, step=7.0):
        assert result.undersize.mass_flow_rate == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"step": 0.0}, "step = 0 s, until = 120 s: give times above 0 s"),
        ({"step": -1.0}, "give times above 0 s"),
        ({"step": float("nan")}, "give times above 0 s"),
        ({"until": 0.0}, "give times above 0 s"),
        ({"step": 1e-9}, "makes 1.2e.11 steps of 120 s, more than 1e.07: give longer steps"),
    ],
)
def test_runs_that_cannot_be(given: dict[str, float], told: str, tmp_path: Path) -> None:
    """Steps of no length or without end."""
    series = read("time_s,rate_t_h\n0,200\n60,200\n", tmp_path)
    with pytest.raises(InputError, match=told):
        list(run_series(CONFIG, series, **given))
