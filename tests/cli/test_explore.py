"""`vibroscreen explore`: where the page goes, what opens it, what is wrong by its text."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from tests.places import SCREENS
from vibroscreen.cli import app

QUARRY = SCREENS / "quarry.toml"


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """An empty folder to work in; the addresses that a browser is asked to open."""
    found: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", found.append)
    return found


def run(*arguments: object) -> Result:
    """`vibroscreen explore` with its streams apart."""
    return CliRunner().invoke(app, ["explore", *map(str, arguments)])


def test_the_page_lies_here_and_is_opened(opened: list[str], tmp_path: Path) -> None:
    done = run(QUARRY)
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "written: quarry.html\n")
    page = tmp_path / "quarry.html"
    assert opened == [page.as_uri()]
    assert "<h1>quarry screen</h1>" in page.read_text(encoding="utf-8")


def test_another_place_and_other_values(opened: list[str]) -> None:
    """Nothing is opened where that is not wanted."""
    done = run(QUARRY, "-o", "other.html", "--no-open", "--set", "name=Other & <b>bold</b>")
    assert (done.exit_code, done.stderr, opened) == (0, "written: other.html\n", [])
    text = Path("other.html").read_text(encoding="utf-8")
    assert "<h1>Other &amp; &lt;b&gt;bold&lt;/b&gt;</h1>" in text


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["none.toml"], "none.toml: no such file or directory\n"),
        ([QUARRY, "-o", "none/page.html"], "none/page.html: no such file or directory\n"),
        (
            [QUARRY, "--set", "deck.panel.open_area=55"],
            "deck[1].panel[1].open_area = 55 is out of range (0 to 0.95): were per cent meant? "
            "55 per cent is 0.55\n",
        ),
    ],
)
def test_what_is_wrong_is_told(opened: list[str], arguments: list[object], text: str) -> None:
    done = run(*arguments)
    assert (done.exit_code, done.stdout, opened) == (1, "", [])
    assert done.stderr.startswith(text)
    assert not list(Path().glob("*.html"))
