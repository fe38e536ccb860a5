"""Exports of historians: what is read, what is told, what is filled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.places import SCREENS
from vibroscreen import InputError, ScreenConfig
from vibroscreen.replay import Limits, PlantData, Source, read_plant
from vibroscreen.units import T_H

CONFIG = ScreenConfig.load(SCREENS / "quarry.toml")
TWO_DECK = ScreenConfig.load(SCREENS / "two_deck.toml")


def read(
    text: str, folder: Path, gaps: str = "hold", limits: Limits | None = None, **source: object
) -> PlantData:
    """An export in a file."""
    path = folder / "plant.csv"
    path.write_text(text, encoding="utf-8")
    return read_plant(path, CONFIG, Source(**source), gaps, limits)  # type: ignore[arg-type]


def rates(plant: PlantData) -> list[float]:
    """Feed [t/h]."""
    return [round(float(rate / T_H), 9) for rate in plant.inputs["mass_flow_rate"]]


def told(plant: PlantData) -> dict[str, tuple[int, str]]:
    """How often what was found, and when first."""
    return {f"{f.column}: {f.what}": (f.rows, f.first) for f in plant.findings}


SAME = {
    "iso": "time,rate_t_h,frequency_hz\n2024-05-01T06:00,300,15\n2024-05-01T06:01,360,15\n2024-05-01T06:02,330,16\n",
    "seconds": "time_s,rate_t_h,frequency_hz\n10,300,15\n70,360,15\n130,330,16\n",
    "semicolons": "time_h;rate_t_h;frequency_rpm\n0;300,0;900\n0,016666666666666666;360;900\n0,03333333333333333;330;960\n",
    "zones": "time,rate_kg_s,frequency_hz\n2024-05-01T06:00:00+02:00,83.333333333333,15\n2024-05-01T04:01Z,100,15\n2024-05-01T06:02:00+02:00,91.666666666667,16\n",
    "a title above": "Export of Monday\n\nTime;rate_t_h;frequency_hz\n2024-05-01 06:00;300;15\n2024-05-01 06:01;360;15\n2024-05-01 06:02;330;16\n",
    "quotes": '"time","rate_t_h","frequency_hz"\n"2024-05-01 06:00","300","15"\n"2024-05-01 06:01","360","15"\n"2024-05-01 06:02","330","16"\n',
}  # fmt: skip


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_one_export(text: str, tmp_path: Path) -> None:
    """However it is written."""
    plant = read(text, tmp_path)
    assert_allclose(plant.seconds, [0.0, 60.0, 120.0], atol=1e-6)
    assert_allclose(plant.lasts, 60.0, atol=1e-6)
    assert_allclose(rates(plant), [300.0, 360.0, 330.0])
    assert_allclose(plant.inputs["frequency"], [15.0, 15.0, 16.0])
    assert not plant.filled.any()
    assert set(plant.marks) == {""}


def test_columns_of_any_name(tmp_path: Path) -> None:
    """Told by key, units by the key; a product as well."""
    text = "When;WI 1;SIC;WI 2\n1.5.2024 06:00;300;900;150\n1.5.2024 06:01;310;900;\n"
    columns = {"rate_t_h": "wi 1", "frequency_rpm": "SIC", "undersize_kg_h": "WI 2"}
    plant = read(text, tmp_path, time="when", form="%d.%m.%Y %H:%M", columns=columns)
    assert rates(plant) == [300.0, 310.0]
    assert_allclose(plant.inputs["frequency"], 15.0)
    assert_allclose(plant.products["undersize"], [150.0 / 3600.0, np.nan])
    assert plant.moment(60.0) == "2024-05-01 06:01:00"


def test_parquet(tmp_path: Path) -> None:
    """Typed columns, times with a zone, null."""
    when = pd.date_range("2024-05-01 06:00", periods=4, freq="1min", tz="Europe/Prague")
    frame = pd.DataFrame({"time": when, "rate_t_h": [300.0, None, 320.0, 330.0], "x": ["a"] * 4})
    frame.to_parquet(tmp_path / "plant.parquet")
    plant = read_plant(tmp_path / "plant.parquet", CONFIG)
    assert rates(plant) == [300.0, 300.0, 320.0, 330.0]
    assert plant.moment(0.0) == "2024-05-01 04:00:00 UTC"
    assert told(plant)["rate_t_h: empty"] == (1, "2024-05-01 04:01:00")


def test_rows_out_of_order_twice_and_without_time(tmp_path: Path) -> None:
    """Sorted, the last of two counts, all told."""
    text = "time_s,rate_t_h\n0,1\n120,3\n60,2\n,7\n120,4\n180,5\n"
    plant = read(text, tmp_path)
    assert rates(plant) == [1.0, 2.0, 4.0, 5.0]
    assert told(plant) == {
        "time_s: rows without a time, left out": (1, "row 4"),
        "time_s: rows out of order, sorted": (1, "row 3"),
        "time_s: rows at the time of another, the last one counts": (1, "120 s"),
    }


HOLES = (
    "time_s,rate_t_h,frequency_hz\n0,100,15\n60,,\n120,Bad,\n180,400,18\n420,500,18\n480,500,18\n"
)


@pytest.mark.parametrize(
    ("gaps", "fed", "frequency"),
    [
        ("hold", [100, 100, 100, 400, 400, 400, 400, 500, 500], [15, 15, 15, 18, 18, 18, 18, 18, 18]),
        ("stop", [100, 0, 0, 400, 0, 0, 0, 500, 500], [15, 15, 15, 18, 18, 18, 18, 18, 18]),
        ("interpolate", [100, 200, 300, 400, 425, 450, 475, 500, 500], [15, 16, 17, 18, 18, 18, 18, 18, 18]),
    ],
)  # fmt: skip
def test_gaps(gaps: str, fed: list[float], frequency: list[float], tmp_path: Path) -> None:
    """Holes in a column, and rows that are not there: each filled as told, and marked."""
    plant = read(HOLES, tmp_path, gaps)
    assert_allclose(plant.seconds, 60.0 * np.arange(9))
    assert_allclose(rates(plant), fed)
    assert_allclose(plant.inputs["frequency"], frequency)
    assert [bool(one) for one in plant.filled] == [
        False,
        True,
        True,
        False,
        True,
        True,
        True,
        False,
        False,
    ]
    assert plant.marks[1] == "rate_t_h filled; frequency_hz filled"
    assert set(plant.marks[4:7]) == {"gap"}
    found = told(plant)
    assert found["time_s: gaps in time, the longest 4 min, 3 rows put in"] == (1, "180 s")
    assert found["rate_t_h: empty"] == (1, "60 s")
    assert found["rate_t_h: no number"] == (1, "120 s")
    how = {"hold": "held", "stop": "taken as 0", "interpolate": "interpolated"}[gaps]
    assert found[f"rate_t_h: rows filled in: {how}"] == (5, "60 s")


def test_before_the_first_number(tmp_path: Path) -> None:
    """The first one stands for what came before, and is marked."""
    plant = read("time_s,rate_t_h\n0,\n60,200\n120,210\n", tmp_path)
    assert rates(plant) == [200.0, 200.0, 210.0]
    assert plant.marks[0] == "rate_t_h filled"


def test_a_belt_below_zero(tmp_path: Path) -> None:
    """Is taken as standing still, and told; what is far out of range is a hole."""
    text = "time_s,rate_t_h,undersize_t_h\n0,100,-2\n60,-1.5,50\n120,90000,1e9\n180,110,60\n"
    plant = read(text, tmp_path)
    assert rates(plant) == [100.0, 0.0, 0.0, 110.0]
    assert_allclose(plant.products["undersize"] / T_H, [0.0, 50.0, np.nan, 60.0])
    assert plant.marks[1] == "rate_t_h limited"
    assert told(plant)["rate_t_h: below 0, taken as 0"] == (1, "60 s")
    assert told(plant)["rate_t_h: out of range, left out"] == (1, "120 s")


def test_stuck_and_spikes(tmp_path: Path) -> None:
    """A rate that never moves is marked and used; one far off its neighbours is left out."""
    noise = np.random.default_rng(1).normal(300.0, 3.0, 60).round(2)
    noise[10:25] = 305.0
    noise[40] = 700.0
    noise[[45, *range(50, 55)]] = 0.0  # stops, and a restart after them
    lines = "\n".join(f"{60 * k},{rate}" for k, rate in enumerate(noise))
    plant = read(f"time_s,rate_t_h\n{lines}\n", tmp_path, limits=Limits(stuck=600.0))
    assert [k for k in range(60) if "stuck" in plant.marks[k]] == list(range(10, 25))
    assert [k for k in range(60) if "spike" in plant.marks[k]] == [40]
    assert rates(plant)[40] == noise[39]
    assert rates(plant)[10] == 305.0
    assert (rates(plant)[45], rates(plant)[52]) == (0.0, 0.0)
    assert rates(plant)[55:] == list(noise[55:])
    calm = read(f"time_s,rate_t_h\n{lines}\n", tmp_path, limits=Limits(spike=0.0, stuck=0.0))
    assert set(calm.marks) == {""}


@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_gradations(scale: float, tmp_path: Path) -> None:
    """Per cent or parts of one; one that falls with size is a hole."""
    inner = CONFIG.size_classes.edges[1:-1]
    head = ",".join(f"passing_{edge * 1e3:g}_mm" for edge in inner)
    finer = np.linspace(0.1, 0.9, len(inner))
    wrong = finer[::-1]
    rows = [",".join(f"{one * scale:.9g}" for one in row) for row in (finer, wrong, finer**2)]
    text = "".join(f"{60 * k},300,{row}\n" for k, row in enumerate(rows))
    plant = read(f"time_s,rate_t_h,{head}\n{text}", tmp_path)
    assert_allclose(plant.inputs["passing"], [finer, finer, finer**2], rtol=1e-8)
    assert plant.marks[1] == "passing filled"
    assert told(plant)["passing: gradations that fall with size, left out"] == (1, "60 s")
    assert ("passing: gradations, taken as per cent" in told(plant)) == (scale == 100.0)


def test_zones(tmp_path: Path) -> None:
    """Two offsets are told; times without one take that of --zone, and are refused without it."""
    text = "time,rate_t_h\n2024-10-27T02:30:00+02:00,1\n2024-10-27T02:30:00+01:00,2\n"
    plant = read(text, tmp_path)
    assert_allclose(plant.seconds, [0.0, 3600.0])
    assert "time: times stand in 2 zones (+01:00, +02:00), taken as UTC" in told(plant)
    mixed = "time,rate_t_h\n2024-05-01T06:00:00Z,1\n2024-05-01T09:00:00,2\n"
    with pytest.raises(InputError, match="1 times stand with a zone and 1 without: give the zone"):
        read(mixed, tmp_path)
    there = read(mixed, tmp_path, zone="Europe/Prague")
    assert_allclose(there.seconds, [0.0, 3600.0])  # 9 h in summer is 7 h UTC


def test_products_of_the_screen(tmp_path: Path) -> None:
    """What leaves over a lower deck."""
    path = tmp_path / "plant.csv"
    path.write_text("time_s,rate_t_h,intermediate_t_h,oversize_t_h\n0,300,90,50\n60,300,91,51\n")
    plant = read_plant(path, TWO_DECK)
    assert_allclose(plant.products["intermediate[1]"] / T_H, [90.0, 91.0])


@pytest.mark.parametrize(
    ("text", "source", "message"),
    [
        ("", {}, "no head with a column 'time' or 'time_s'"),
        ("t,rate_t_h\n0,1\n", {}, "the first is 't,rate_t_h': name the column of times with --time"),
        ("time_s,tons\n0,1\n1,1\n", {}, "no column is told to be the feed rate: give --rate; there are tons"),
        ("time_s,a\n0,1\n1,1\n", {"columns": {"rate_t_h": "b"}}, "rate_t_h = 'b' is no column of the file: did you mean 'a'?"),
        ("time_s,a\n0,1\n1,1\n", {"columns": {"rate": "a"}}, "rate tells no unit: give one, as in rate_t_h"),
        ("time_s,a\n0,1\n1,1\n", {"columns": {"rte_t_h": "a"}}, "the column 'rte_t_h' is unknown: did you mean 'rate_t_h'?"),
        ("time_s,rate_t_h,intermediate_t_h\n0,1,1\n1,1,1\n", {}, "the screen has no product intermediate[1]: it has oversize, undersize"),
        ("time_s,rate_t_h,rate_t_h\n0,1,1\n", {}, "the column 'rate_t_h' is there twice"),
        ("time_s,rate_t_h,a\n0,1,1\n1,1,1\n", {"columns": {"rate_kg_s": "a"}}, "columns 'a' and 'rate_t_h' give the same number"),
        ("time_s,rate_t_h,passing_16_mm\n0,1,1\n1,1,1\n", {}, "passing_1_mm is missing: give all inner limits"),
        ("time,rate_t_h\n1.5.2024 06:00,1\n1.5.2024 06:01,1\n", {}, "0 of 2 rows have a time that can be read: give two or more; times that are not"),
        ("time,rate_t_h\n45000,1\n45001,1\n", {}, "0 of 2 rows have a time"),
        ("time_s,rate_t_h\n5,1\n5,1\n", {}, "all rows have the same time"),
        ("time_s,rate_t_h\n0,x\n5,\n", {}, "rate_t_h has no number that can be used in 2 rows: name another column"),
        ("time_s,rate_t_h\n0,1e9\n5,1e9\n", {}, "2 are out of range (0 to 18000)"),
        ('time_s,rate_t_h\n0,"1\n5,2\n', {}, "cannot be parted into cells"),
        ("time_s,rate_t_h\n0,1\n1,1\n2,1\n1e9,1\n", {}, "makes 1e+09 rows of 1 s, more than 1e+07: cut the file there"),
        ("time,rate_t_h\n2024-05-01,1\n2024-05-02,1\n", {"zone": "Mars"}, "--zone 'Mars' is no time zone"),
    ],
)  # fmt: skip
def test_what_cannot_be_read(
    text: str, source: dict[str, object], message: str, tmp_path: Path
) -> None:
    """What is wrong, and what to do; the file below."""
    with pytest.raises(InputError) as caught:
        read(text, tmp_path, **source)
    assert message in str(caught.value)
    assert caught.value.__notes__ == [f"in {tmp_path / 'plant.csv'}"]


def test_no_text_and_broken_parquet(tmp_path: Path) -> None:
    """Neither is a table."""
    path = tmp_path / "plant.csv"
    for raw, message in ((b"\x00\x01\x02", "is no text and no parquet"), (b"PAR1 and nothing", "parquet file is broken")):  # fmt: skip
        path.write_bytes(raw)
        with pytest.raises(InputError, match=message):
            read_plant(path, CONFIG)
    path.write_bytes("time_s;rate_t_h\n0;1,5\n1;2\n".encode("utf-16"))
    assert rates(read_plant(path, CONFIG)) == [1.5, 2.0]
    with pytest.raises(InputError, match="gap = 'guess' is unknown: give one of hold, stop, inter"):
        read_plant(path, CONFIG, gaps="guess")
    with pytest.raises(InputError, match="spike = -1 is not a number from 0 up"):
        Limits(spike=-1.0)
