"""Sheets of surveys: every form says the same, and what cannot be used is told with its place."""

from __future__ import annotations

import math
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.places import DATA, ROOT
from vibroscreen import InputError, ScreenConfig
from vibroscreen.survey import read_sheets, read_survey

CASES = DATA / "cases"
QUARRY = ROOT / "engine" / "validation" / "data" / "quarry_sheets.csv"
SHEETS = QUARRY.read_text(encoding="utf-8")

# Retained on 8, 4, 2 mm and in the pan: 10, 30, 40 and 20 %.
PASSING = "run,stream,rate_t_h,sieve_mm,passing_pct\n" + "".join(
    f"a,feed,100,{size},{share}\n" for size, share in ((4, 60), (8, 90), (2, 20))
)
SAME = {
    "fractions": PASSING.replace("pct", "fraction")
    .replace("60", ".6")
    .replace("90", ".9")
    .replace(",20", ",.2"),
    "wet": "run,stream,rate_wet_t_h,moisture_pct,sieve_mm,passing_pct\n"
    "a,feed,125,20,8,90\na,feed,125,20,4,60\na,feed,125,20,2,20\n",
    "retained": "run;stream;Rate (t/h);Sieve (mm);Retained [%]\n"
    "a;feed;100;8;10\na;feed;100;pan;20\na;feed;100;4;30\na;feed;100;2;40\n",
    "cumulative": "run\tstream\trate_kg_h\tsieve_um\tcumulative retained, %\n"
    "a\tfeed\t100000\t8000\t10,0\na\tfeed\t100000\t2000\t80,0\na\tfeed\t100000\t4000\t40,0\n",
    "masses": "run;stream;rate_t_h;size_mm;weight_g\n"
    "a;Feed;100,0;8;50,5\na;Feed;;4,0;151,5\na;Feed;;2;202\na;Feed;;pan;101\n",
    "columns": "run,sieve_mm,feed_rate_t_h,feed_passing_pct\na,2,100,20\na,4,,60\na,8,,90\n",
    "gaps": PASSING + "a,feed,100,1,\na,feed,,,\n",
}


def written(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    """The text as a file."""
    path = folder / "survey.csv"
    path.write_bytes(text.encode(encoding))
    return path


def workbook(folder: Path, sheets: dict[str, list[list[Any]]]) -> Path:
    """Sheets as an XLSX file."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(folder / "survey.xlsx")
    return folder / "survey.xlsx"


@pytest.mark.parametrize("form", SAME)
def test_forms_say_the_same(form: str, tmp_path: Path) -> None:
    """100 t/h dry of 20, 60 and 90 % finer than 2, 4 and 8 mm, said in many ways."""
    (run,) = read_sheets(written(tmp_path, SAME[form])).runs
    sheet = run.sheets["feed"]
    assert sheet.rate == pytest.approx(100.0 / 3.6)
    assert_allclose(sheet.sizes, [0.002, 0.004, 0.008])
    assert sheet.passing is not None
    assert_allclose(sheet.passing, [0.2, 0.6, 0.9], atol=1e-12)


def test_the_sheets_of_a_laboratory() -> None:
    """Each stream on its own sieves; rates dry; the scale that is missing is not made up."""
    survey = read_sheets(QUARRY)
    assert [run.name for run in survey.runs] == ["morning", "noon", "evening"]
    assert survey.notes == ()
    noon = survey.runs[1].sheets
    assert list(noon) == ["feed", "undersize", "oversize"]
    assert noon["feed"].rate == pytest.approx(322.0 * (1.0 - 0.035) / 3.6)
    assert math.isnan(noon["oversize"].rate)
    assert_allclose(noon["oversize"].sizes, [0.0112, 0.016, 0.0224, 0.0315, 0.045, 0.063])
    assert noon["undersize"].sizes[3] == 0.0056


def test_middle_products_by_class() -> None:
    """A double deck's middle product is a stream as the others; rates add up to the file's."""
    survey = read_sheets(CASES / "survey_middle_product.csv")
    assert len(survey.runs) == 4
    sheet = survey.runs[0].sheets["intermediate[1]"]
    assert sheet.class_rates is not None
    assert_allclose(sheet.class_rates * 3.6, 1.0)
    assert sheet.sizes[0] == 6.3e-5


def test_semicolons_and_moisture() -> None:
    """Decimal commas are read; moisture beside a rate without a word is told of."""
    config = ScreenConfig.default()
    run = read_survey(CASES / "survey_semicolon.csv", config)[0]
    assert run.recovery[2] == 1.0101
    with pytest.warns(UserWarning, match="taken as of dry solids"):
        (moist, *_) = read_survey(CASES / "survey_moisture.csv", config)
    assert moist.config.feed.mass_flow_rate == pytest.approx(200.0 / 3.6)


def test_workbooks(tmp_path: Path) -> None:
    """A sheet a run below a title, or a sheet a stream: as the CSV file."""
    (plain,) = read_sheets(written(tmp_path, PASSING)).runs
    head, *rows = (line.split(",") for line in PASSING.splitlines())
    of_run = [["Survey of May"], [], head[1:], *([row[1], *map(float, row[2:])] for row in rows)]
    of_stream = [head[2:], *([float(cell) for cell in row[2:]] for row in rows)]
    for sheets, name in (({"a": of_run}, "a"), ({"Feed": of_stream}, "survey")):
        survey = read_sheets(workbook(tmp_path, sheets))
        (run,) = survey.runs
        assert run.name == name
        assert any("no column run" in note for note in survey.notes)
        assert_allclose(run.sheets["feed"].passing, plain.sheets["feed"].passing)
        assert run.sheets["feed"].rate == plain.sheets["feed"].rate


def test_standard_errors_and_settings(tmp_path: Path) -> None:
    """In SI units; those of masses add up over the sieves above."""
    text = (
        "run,stream,rate_t_h,rate_sigma_t_h,sieve_mm,retained_pct,sigma_retained_pct,motion.frequency\n"
        "a,feed,100,4,8,10,3,14.5\na,feed,,,4,90,4,\n"
    )
    (run,) = read_sheets(written(tmp_path, text)).runs
    sheet = run.sheets["feed"]
    assert sheet.rate_error == pytest.approx(4.0 / 3.6)
    assert sheet.error is not None
    assert_allclose(sheet.error, [0.05, 0.03])
    assert run.settings == {"motion.frequency": 14.5}


ROW = "run,stream,rate_t_h,sieve_mm,passing_pct\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "survey holds no rows"),
        (ROW, "survey holds no rows"),
        (ROW + "a,feed,1,8\n", "line 2 has 4 cells, not 5 as the head"),
        (ROW + "a,fed,1,8,90\n", r"line 2: stream 'fed' of run 'a' is unknown: expected are feed"),
        (ROW + ",feed,1,8,90\n", "line 2: run is empty"),
        (ROW + "a,intermediate[0],1,8,90\n", "line 2: stream 'intermediate.0.' of run 'a' is unknown"),
        (ROW + "a,feed,1e300,8,90\n", "line 2: run 'a', feed: rate_t_h = 1e300 is more than 18000 t/h"),
        (ROW + "a,feed,1,8,90\na,feed,2,4,80\n", "line 3: run 'a', feed: rate_t_h = 2 differs"),
        (ROW + "a,feed,-1,8,90\n", "line 2: run 'a', feed: rate_t_h = -1 is negative"),
        (ROW + "a,feed,1,8,90\na,feed,1,8,80\n", "line 3: run 'a', feed: sieve 8 stands in line 2"),
        (ROW + "a,feed,1,4,90\na,feed,1,8,20\n", "line 3: run 'a', feed: 20 % pass 8 mm and 90 % pass 4 mm"),
        (ROW + "a,feed,1,4,190\n", "line 2: run 'a', feed: 190 % pass: expected is 0 to 100 %"),
        (ROW + "a,feed,1,4,.1\na,feed,1,8,.9\n", "shares of 1. Then name the column passing_fraction"),
        (ROW + "a,feed,1,4,1_0\n", "line 2: run 'a', feed: passing_pct = '1_0' is not a finite number"),
        (ROW.replace("passing_pct", "pasing_pct") + "a,feed,1,4,9\n", "'pasing_pct' is unknown: did you mean 'passing_pct'"),
        (ROW.replace("rate_t_h", "motion.frequncy") + "a,feed,1,4,9\n", "column 'motion.frequncy': motion.frequncy is not a number of"),
        (ROW.replace("sieve_mm", "sieve_t_h") + "a,feed,1,4,9\n", "has the unit t_h: give one of mm, um"),
        (ROW.replace("stream", "group") + "a,feed,1,4,9\n", "column 'stream' is missing: expected are run"),
        (ROW.replace("rate_t_h", "rate_wet_t_h") + "a,feed,1,4,9\n", "rate_wet is given without moisture"),
        (ROW.replace("passing", "retained") + "a,feed,1,4,\na,feed,1,8,10\n", "retained on 4 mm is empty"),
        (ROW.replace("passing", "retained") + "a,feed,1,4,80\na,feed,1,8,40\n", "sums to 120 %, not to 100"),
        (ROW.replace("passing_pct", "mass_g") + "a,feed,1,4,80\n", "masses need that of the pan"),
        (ROW.replace("rate_t_h", "size_mm") + "a,feed,1,4,80\n", "columns 'size_mm' and 'sieve_mm' tell the same"),
        ("run,lower_mm,upper_mm,feed_t_h\na,0,4,1\na,5,8,1\n", "line 3: run 'a', feed: class 5 to 8 mm"),
        ("run,lower_mm,upper_mm,feed_t_h\na,2,4,1\n", "the finest class begins above 0"),
    ],
)  # fmt: skip
def test_what_cannot_be_used(text: str, message: str, tmp_path: Path) -> None:
    """Run, stream, row and what was expected, and the file."""
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        read_sheets(path)
    assert caught.value.__notes__ == [f"in {path}"]


def test_what_cannot_be_used_in_workbooks(tmp_path: Path) -> None:
    """The sheet is named; a formula without a value is none; a broken file is told."""
    head = ROW.strip().split(",")
    path = workbook(tmp_path, {"May": [head, ["a", "feed", 1, 8, "=90+1"]]})
    with pytest.raises(InputError, match="sheet 'May', row 2: the formula =90"):
        read_sheets(path)
    path = workbook(tmp_path, {"May": [head, ["a", "feed", 1, 8, "n/a"]]})
    with pytest.raises(InputError, match="sheet 'May', row 2: run 'a', feed: passing_pct = 'n/a'"):
        read_sheets(path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="the workbook cannot be read"):
        read_sheets(path)


def test_a_formula_counts_by_its_value(tmp_path: Path) -> None:
    """As spreadsheet programs write it, with the value beside the formula: 45 + 45 is 90 %."""
    path = workbook(tmp_path, {"May": [ROW.strip().split(","), ["a", "feed", 1, 8, "=45+45"]]})
    with zipfile.ZipFile(path) as book:
        parts = {name: book.read(name) for name in book.namelist()}
    name = next(name for name in parts if name.startswith("xl/worksheets/"))
    formula = re.search(rb"<f>45\+45</f><v ?/?>(</v>)?", parts[name])
    assert formula is not None
    parts[name] = parts[name].replace(formula[0], b"<f>45+45</f><v>90</v>")
    with zipfile.ZipFile(path, "w") as book:
        for part, content in parts.items():
            book.writestr(part, content)
    (run,) = read_sheets(path).runs
    assert_allclose(run.sheets["feed"].passing, [0.9])


def test_what_is_no_survey_by_its_size(tmp_path: Path) -> None:
    """A million rows, a file of a gigabyte, a sheet used to its last cell: told, not read."""
    path = written(tmp_path, ROW + "a,feed,1,8,90\n" * 1_000_000)
    with pytest.raises(InputError, match="the table has 1000001 rows: a survey has a row for each"):
        read_sheets(path)
    with path.open("r+b") as file:
        file.truncate(10**9)  # holes take no room
    with pytest.raises(InputError, match="the file has 1000 MB"):
        read_sheets(path)
    empty = read_sheets(written(tmp_path, ROW + "a,feed,1,8,90\n" + ",,,,\n" * 1_000_000))
    assert len(empty.runs) == 1
    book = openpyxl.Workbook()
    book.active.append(ROW.strip().split(","))
    book.active.cell(1_048_576, 16_384, "x")
    book.save(tmp_path / "survey.xlsx")
    with pytest.raises(InputError, match=r"sheet 'Sheet' has .* rows and more"):
        read_sheets(tmp_path / "survey.xlsx")


@pytest.mark.parametrize(
    "head",
    [
        ROW.strip() + ",motion.frequency\na,feed,9,8,50,-14\na,undersize,5,8,80,-14",
        "run,lower_mm,upper_mm,feed_t_h,oversize_t_h,motion.frequency\na,0,8,9,5,-14",
    ],
)
def test_a_number_of_a_run_that_cannot_be(head: str, tmp_path: Path) -> None:
    """Numbers of the screen in a run are refused with the run and the file."""
    path = written(tmp_path, head)
    with pytest.raises(InputError, match=r"motion\.frequency = -14 Hz is out of range") as caught:
        read_survey(path, ScreenConfig.default())
    assert caught.value.__notes__ == ["in run 'a'", f"in {path}"]


def check(path: Path) -> None:
    """A survey without a number that is none where one was measured, or a message."""
    try:
        survey = read_sheets(path)
    except InputError:
        return
    assert survey.runs
    for run in survey.runs:
        for sheet in run.sheets.values():
            shares = sheet.passing if sheet.class_rates is None else sheet.class_rates
            assert sheet.rate >= 0.0 or math.isnan(sheet.rate)
            assert list(sheet.sizes) == sorted(set(sheet.sizes))
            if sheet.passing is not None:
                assert ((shares >= 0.0) & (shares <= 1.0)).all()


@given(seed=st.integers(0, 2**32 - 1), kind=st.integers(0, 6))
@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
def test_hostile_files(seed: int, kind: int, tmp_path: Path) -> None:
    """Shuffled, cut, in wrong encodings, with cells that do not belong: a message or a result."""
    rng = np.random.default_rng(seed)
    lines = SHEETS.splitlines()
    if kind == 0:
        lines = [lines[0], *(lines[1 + k] for k in rng.permutation(len(lines) - 1))]
    elif kind == 1:
        rng.shuffle(lines)
    elif kind in (2, 3):
        odd = [
            "",
            "nan",
            "inf",
            "-1",
            "1e999",
            "=A1",
            '"',
            "\u00b5",
            "x,y",
            "0",
            "1,5",
            "\0",
            "#",
            "1e-320",
        ]
        for _ in range(3):
            cells = lines[k := int(rng.integers(len(lines)))].split(",")
            cells[int(rng.integers(len(cells)))] = odd[int(rng.integers(len(odd)))]
            lines[k] = ",".join(cells)
    raw = "\n".join(lines).encode(["utf-8", "utf-16", "cp1252"][int(rng.integers(3))], "replace")
    if kind == 4:
        raw = raw[: int(rng.integers(len(raw)))]
    elif kind == 5:
        at = int(rng.integers(len(raw)))
        raw = raw[:at] + rng.bytes(8) + raw[at:]
    elif kind == 6:
        raw = raw.replace(b",", [b";", b"\t", b"|", b" "][int(rng.integers(4))])
    path = tmp_path / "survey.csv"
    path.write_bytes(raw)
    check(path)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
def test_hostile_workbooks(seed: int, tmp_path: Path) -> None:
    """Formulas, dates, texts and truths among the cells, and bytes changed: a message or a result."""
    rng = np.random.default_rng(seed)
    odd = [
        None,
        True,
        "=1/0",
        "=A1",
        "text",
        1e308,
        -5,
        "#REF!",
        np.datetime64("2026-05-01").item(),
    ]
    rows: list[list[Any]] = [line.split(",") for line in SHEETS.splitlines()[:23]]
    for _ in range(int(rng.integers(3))):
        row = rows[int(rng.integers(len(rows)))]
        row[int(rng.integers(len(row)))] = odd[int(rng.integers(len(odd)))]
    path = workbook(tmp_path, {"May": rows})
    if rng.random() < 0.5:
        raw = bytearray(path.read_bytes())
        raw[int(rng.integers(len(raw)))] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(raw))
    check(path)
