"""`vibroscreen report`: writes the report that Python writes; what is wrong is told by text."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from tests.places import SCREENS
from vibroscreen import ScreenConfig, report
from vibroscreen.cli import app

QUARRY, TWO_DECK = SCREENS / "quarry.toml", SCREENS / "two_deck.toml"


def run(*arguments: object) -> Result:
    """`vibroscreen report` with its streams apart."""
    return CliRunner().invoke(app, ["report", *map(str, arguments)])


def words(page: str) -> str:
    """A page without its pictures, whose ids differ between two of them."""
    return re.sub(r"data:image/svg\+xml;base64,[\w+/=]+", "", page)


def test_the_report_is_that_of_python(tmp_path: Path) -> None:
    both = tmp_path / "both.html"
    band = tmp_path / "band.csv"
    band.write_text("size_mm, least_percent, most_percent\n8, 50, 60\n", encoding="utf-8")
    done = run(
        QUARRY,
        "-o",
        both,
        "--compare",
        TWO_DECK,
        "--specification",
        band,
        "-s",
        "feed.rate_t_h=120",
    )
    assert done.exit_code == 0, done.output
    assert done.stdout == ""
    assert done.stderr == f"written: {both}\n"
    first = ScreenConfig.load(QUARRY, {"feed.rate_t_h": 120})
    wanted = report.html(first, ScreenConfig.load(TWO_DECK), band)
    assert words(both.read_text(encoding="utf-8")) == words(wanted)


def test_it_lies_beside_the_screen(tmp_path: Path) -> None:
    screen = tmp_path / "my screen.toml"
    screen.write_text(QUARRY.read_text(encoding="utf-8"), encoding="utf-8")
    done = run(screen)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "my screen_report.html").stat().st_size > 10_000
    done = run(screen, "-o", tmp_path / "deep.pdf", "--strict", "--set", "feed.rate_t_h=900")
    assert done.exit_code == 3
    assert (tmp_path / "deep.pdf").read_bytes().startswith(b"%PDF")


def test_what_is_wrong_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = run(QUARRY, "-o", tmp_path / "report.docx")
    assert bad.exit_code == 1
    assert bad.stderr.endswith(
        "report.docx has no suffix that says its format: give .html or .pdf\n"
    )
    bad = run(QUARRY, "--specification", tmp_path / "none.csv")
    assert bad.exit_code == 1
    assert bad.stderr.endswith("none.csv: no such file or directory\n")
    bad = run(tmp_path / "none.toml")
    assert bad.exit_code == 1
    assert bad.stderr.endswith("none.toml: no such file or directory\n")
    monkeypatch.setitem(sys.modules, "plutoprint", None)
    bad = run(QUARRY, "-o", tmp_path / "report.pdf")
    assert bad.exit_code == 1
    assert bad.stderr == (
        "a report needs plutoprint, which is not installed: pip install 'vibroscreen[report]'\n"
    )
    monkeypatch.setitem(sys.modules, "jinja2", None)
    bad = run(QUARRY, "-o", tmp_path / "report.html")
    assert bad.exit_code == 1
    assert bad.stderr == (
        "a report needs jinja2, which is not installed: pip install 'vibroscreen[report]'\n"
    )
