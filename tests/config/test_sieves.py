"""Sieve analyses in all the ways that laboratories write them give the same curve."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vibroscreen import InputError
from vibroscreen.sieves import Sieves, read_sieves

EDGES = (0.0, 2.0, 8.0, 16.0, 31.5)  # mm
PASSING = (0.0, 0.125, 0.3, 0.65, 1.0)

# The same analysis: by what the table holds, how it is separated, from which end, in which words.
SAME = {
    "passing": "size_mm,passing_pct\n2,12.5\n8,30\n16,65\n31.5,100\n",
    "coarsest first": "Sieve (mm);% passing\n31,5;100\n16;65\n8;30\n2;12,5\n",
    "no order": "size_mm\tfiner\n8\t0.3\n31.5\t1\n2\t0.125\n16\t0.65\n",
    "fractions below a sign": "mm;passing %\n2;0,125\n8;0,3\n16;0,65\n31,5;1\n",
    "signs in the cells": 'size,"passing"\n31.5 mm,100%\n16 mm,65 %\n8 mm,30 %\n2 mm,12.5%\n',
    "blanks": "size_mm  passing\n31,5   100\n16  65,0\n8  30\n2  12,5\n",
    "micrometres": "size_um,cumulative passing %\n2000,12.5\n8000,30\n16000,65\n31500,100\n",
    "inches": 'Sieve [in],passing\n0.07874015748031496,12.5\n0.3149606299212598,30\n0.6299212598425197,65\n1.2401574803149606,100\n',
    "retained by sieve": "size_mm;retained_pct\n31.5;0\n16;35\n8;35\n2;17.5\npan;12.5\n",
    "retained, no pan": "size_mm;retained_pct\n31.5;0\n16;35\n8;35\n2;17.5\n",
    "retained fractions": "size_mm retained\n31.5 0\n16 0.35\n8 0.35\n2 0.175\n0 0.125\n",
    "weighed": "sieve mm;retained g\n31.5;0\n16;700\n8;700\n2;350\npan;250\nTotal;2000\n",
    "retained in all": "size_mm;cumulative retained %\n31.5;0\n16;35\n8;70\n2;87.5\npan;100\n",
    "retained in all, but not said": "size_mm;retained %\n31.5;0\n16;35\n8;70\n2;87.5\npan;100\n",
    "no head, passing": "31.5 100\n16 65\n8 30\n2 12.5\n0 0\n",
    "no head, retained": "31.5 0\n16 35\n8 35\n2 17.5\n0 12.5\n",
    "all columns": "sieve mm;mass g;retained %;cum. retained %;passing %\n31.5;0;0;0;100\n"
    "16;700;35;35;65\n8;700;35;70;30\n2;350;17.5;87.5;12.5\npan;250;12.5;100;0\n",
    "a title and comments": "# Tuesday\nQuarry north\nsize;passing\nmm;%\n31.5;100\n16;65 # checked\n8;30\n2;12.5\n\n",
    "classes": "class_mm;mass_pct retained\n16-31.5;35\n8-16;35\n2-8;17.5\n0-2;12.5\n",
    "classes with signs": "class mm;retained %\n-31.5 +16;35\n-16 +8;35\n-8 +2;17.5\n-2;12.5\n",
    "below the finest": "class mm;retained %\n>16;35\n>8;35\n>2;17.5\n<2;12.5\n>31.5;0\n",
    "more than all": "size_mm,passing_pct\n2,12.5\n8,30\n16,65\n31.5,100\n45,100\n63,100\n",
}  # fmt: skip


def read(text: str | bytes, folder: Path) -> Sieves:
    """A table in a file."""
    path = folder / "sieves.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_sieves(path)


@pytest.mark.parametrize("text", SAME.values(), ids=SAME)
def test_one_analysis(text: str, tmp_path: Path) -> None:
    """However it is written."""
    found = read(text, tmp_path)
    assert_allclose([edge * 1e3 for edge in found.edges], EDGES, rtol=1e-12)
    assert_allclose(found.passing, PASSING, atol=1e-9)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_files_of_spreadsheets(encoding: str, tmp_path: Path) -> None:
    """Marks at the beginning, wide letters, letters of western Europe; ends of lines of Windows."""
    text = "Größe µm;% passing\r\n2000;12,5\r\n8000;30\r\n16000;65\r\n31500;100\r\n"
    assert_allclose(read(text.encode(encoding), tmp_path).passing, PASSING)


def test_what_was_taken_for_granted(tmp_path: Path) -> None:
    """A limit above the largest sieve, a loss, a missing pan, a missing unit: said, a note each."""
    found = read("size;passing\n8;30\n16;65\n31.5;95\n", tmp_path)
    assert_allclose(found.edges, [0.0, 0.008, 0.016, 0.0315, 0.045])
    assert found.passing[-2:] == (0.95, 1.0)
    assert found.notes == (
        "no unit is given for the sizes: taken as mm",
        "5 % are coarser than the largest sieve, 31.5 mm: taken as up to 45 mm",
    )
    lossy = read("size_mm;retained_pct\n16;39.2\n8;29.4\npan;29.4\n32;0\n", tmp_path)
    assert lossy.notes == ("what is retained sums to 98, not to 100: scaled to it",)
    assert_allclose(lossy.passing, [0.0, 0.3, 0.6, 1.0])
    no_pan = read("size_mm;retained g\n32;0\n16;50\n8;50\n", tmp_path)
    assert no_pan.notes == ("there is no pan: nothing is taken to be finer than size 8",)
    assert_allclose(no_pan.passing, [0.0, 0.0, 0.5, 1.0])
    assert read(SAME["passing"], tmp_path).notes == ()


REFUSED = {
    "": "the file holds no table of sizes and shares: give a line for each sieve, such as 16;54.6",
    "hello\nworld\n": "the file holds no table of sizes and shares",
    "size_mm;passing\n16;50\n": "the file holds no table",
    "PK\x03\x04": "the file is a spreadsheet: save the table as CSV",
    "a\0b": "the file is no text: save the table as CSV",
    "mesh;passing\n4;100\n8;50\n": "sizes are given as mesh numbers, which do not say how wide",
    "size_mm;passing\n8;30\n16;20\n32;100\n": "30 % pass size 8 and 20 % pass size 16: passing never "
    "falls with size; is it what is retained? Then say so in the head",
    "size_mm;passing\n8;30\n16;130\n": "130 % pass size 16, more than all: correct it",
    "size_mm;passing\n8;-3\n16;100\n": "line 2: -3 is no share of a mass: mend it",
    "size_mm;passing\n8;30\n16;nan\n": "line 3: nan is no share of a mass",
    "size_mm;passing\n8;30\n16;inf\n": "line 3: inf is no share of a mass",
    "size_mm;passing\n8;30\n8;40\n16;100\n": "lines 2 and 3 give size 8 twice: leave one",
    "size_mm;passing;x\n8;30;1\n16;;2\n": "line 3 has no number in column 2",
    "size_mm;passing\n8;30\n16;60\n": "only 60 % pass the largest sieve, 16 mm: give a sieve that all",
    "size_mm;passing\n0;30\n16;100\n": "30 % are finer than nothing: the share of the pan is 0",
    "size_mm;passing\n8;30\nsixteen;100\n": "the file holds no table",
    "size_mm;passing\n8;30\n10;40\nsixteen;100\n": "line 4 ('sixteen;100') is no sieve: give a size",
    "size_mm;retained\n8;30\n16;30\npan;20\n": "what is retained sums to 80, not to 100: correct it",
    "size_mm;retained\n8;60\n16;70\n": "sums to 130, not to 100: correct it, or say in the head that it",
    "size_mm;retained g\n8;0\n16;0\n": "nothing is retained on any sieve: give what was weighed",
    "size_mm;cum retained\n8;130\n16;60\n": "130 % are retained in all, more than there is",
    "8 20\n16 30\n32 50\n": "only 50 % pass the largest sieve",
    "8 10 20\n16 20 30\n32 100 100\n": "the head does not say which column is meant: name one",
    "8 5\n16 60\n32 40\n": "the numbers do not say whether they are what passes or what is retained",
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_what_cannot_be_read(text: str, tmp_path: Path) -> None:
    """Line and value, what is wrong and what to do, and the file."""
    with pytest.raises(InputError) as caught:
        read(text, tmp_path)
    assert REFUSED[text] in str(caught.value)
    assert caught.value.__notes__ == [f"in {tmp_path / 'sieves.csv'}"]


def legal(text: str) -> None:
    """A curve from 0 to 1 that never falls, or a message."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            found = read(text.encode("utf-8", "surrogatepass"), Path(folder))
        except InputError:
            return
    assert found.passing[0] == 0.0
    assert found.passing[-1] == 1.0
    assert list(found.passing) == sorted(found.passing)
    assert list(found.edges) == sorted(set(found.edges))
    assert len(found.edges) == len(found.passing)


@given(st.text(max_size=200))
def test_no_text_breaks_the_reader(text: str) -> None:
    """Whatever it is."""
    legal(text)


HEADS = ("", "mm;passing", "mm;retained", "um;cum retained %", "in;mass g", "mm;%", "size;fraction")


@given(
    st.sampled_from(HEADS),
    st.lists(st.tuples(st.floats(), st.floats() | st.floats(0, 100)), max_size=8),
    st.sampled_from("; ,\t"),
)
def test_no_numbers_break_the_reader(
    head: str, rows: list[tuple[float, float]], separator: str
) -> None:
    """Any sizes and shares under any head."""
    lines = [head.replace(";", separator), *(f"{size}{separator}{share}" for size, share in rows)]
    legal("\n".join(lines))
