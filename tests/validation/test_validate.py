"""VALIDATION.md and what writes it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

import validate
from evidence import Section, table


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Two sections that count how often they are written."""
    calls: list[str] = []

    def section(title: str) -> Section:
        def write(pictures: Path) -> str:
            calls.append(title)
            (pictures / f"{title}.png").write_bytes(b"")
            return f"{title}: {len(calls)}"

        return Section(title, f"python {title}.py", write)

    monkeypatch.setattr(validate, "SECTIONS", (section("one"), section("two")))
    return calls


def test_one_section_leaves_the_others(two: list[str], tmp_path: Path) -> None:
    """--only writes its section anew and keeps the rest and the order."""
    path = tmp_path / "REPORT.md"
    validate.main(None, path, tmp_path)
    validate.main("one", path, tmp_path)
    assert two == ["one", "two", "one"]
    assert validate.sections_of(path.read_text()) == {
        "one": "Command: `python one.py`\n\none: 3",
        "two": "Command: `python two.py`\n\ntwo: 2",
    }
    validate.main("two", path, tmp_path)
    assert path.read_text().startswith("# Validation\n")
    assert re.findall("^## (.*)$", path.read_text(), re.MULTILINE) == ["one", "two"]


@pytest.mark.usefixtures("two")
def test_unknown_section(tmp_path: Path) -> None:
    """A title that is none is refused with those that are."""
    with pytest.raises(typer.BadParameter, match="'three' is no section: give one of one, two"):
        validate.main("three", tmp_path / "REPORT.md", tmp_path)


def test_table() -> None:
    """A Markdown table; a row of the wrong length is refused."""
    assert table(("a", "b"), [(1, 2.5)]) == "| a | b |\n|---|---:|\n| 1 | 2.5 |\n"
    with pytest.raises(ValueError, match="2 cells, the head 1"):
        table(("a",), [(1, 2)])


def test_report_holds_what_it_should() -> None:
    """Every section is in the report, in order, with its command; every picture linked is there."""
    text = validate.REPORT.read_text(encoding="utf-8")
    assert re.findall("^## (.*)$", text, re.MULTILINE) == [s.title for s in validate.SECTIONS]
    bodies = validate.sections_of(text)
    for section in validate.SECTIONS:
        assert bodies[section.title].startswith(f"Command: `{section.command}`")
    linked = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert set(linked) == {path.name for path in validate.PICTURES.glob("*.png")}
