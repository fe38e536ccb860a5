"""What is told of the python runtime's limits is so, and is told where people look."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from lxml import etree

from tests.fmu.bare_host import BARE, BareHost, Ended
from vibroscreen_fmu.documentation import index_html
from vibroscreen_fmu.python_limits import HOST_SETUP, LOST, PYTHON_LIMITS, lost_characters

CRASHES = (-signal.SIGSEGV, -signal.SIGABRT)
ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="tried on Linux")


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> BareHost:
    """The python FMU of the default screen, unzipped in a folder with a harmless path."""
    return BareHost("python", tmp_path_factory.mktemp("limits"))


@pytest.fixture(scope="module")
def well(host: BareHost) -> Ended:
    """How the host ends where nothing is lost."""
    ended = host.play()
    assert ended.code == 0
    return ended


def played(host: BareHost, folder: Path, names: Sequence[str]) -> dict[str, Ended]:
    """How the host ends with the FMU in folders of these names."""
    places = [host.copied(folder / name) for name in names]
    with ThreadPoolExecutor(max_workers=2) as pool:
        found = list(pool.map(lambda place: host.play(fmu=place), places))
    return dict(zip(names, found, strict=True))


@ON_LINUX
def test_the_characters_that_end_a_host_are_these(
    host: BareHost, well: Ended, tmp_path: Path
) -> None:
    """Every one that is told of does, and what is told to be fine is."""
    for name, ended in played(host, tmp_path, [f"a{c}b" for c in f"{LOST}é"]).items():
        assert ended.code in CRASHES, f"{name}: {ended}"
        assert lost_characters(tmp_path / name), name
    fine = ["a b", "a.b", "a_b", "a-b", "a~b", "aZ09"]
    for name, ended in played(host, tmp_path, fine).items():
        assert ended == well, name
        assert lost_characters(tmp_path / name) == "", name


@ON_LINUX
def test_paths_that_are_not_coded_are_fine(host: BareHost, well: Ended, tmp_path: Path) -> None:
    path = str(host.fmu / "resources")
    for location in (f"file://{path}", f"file://{path}/", path):
        assert host.play(location=location) == well, location
    place = host.copied(tmp_path / "R&D (x86)")
    assert host.play(fmu=place).code in CRASHES
    assert host.play(fmu=place, location=f"file://{place / 'resources'}") == well


@ON_LINUX
def test_a_host_that_is_not_python_needs_the_commands_of_the_page(
    host: BareHost, well: Ended, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With them it runs; without them the library does not load."""
    assert len(well.said) == 2
    monkeypatch.setattr("tests.fmu.bare_host.commands_of_the_page", lambda: BARE)
    code, said = host.play()
    assert code == 3
    assert "undefined symbol: _Py_NoneStruct" in said[0]


def test_lost_characters_are_told_once_in_their_order(tmp_path: Path) -> None:
    assert lost_characters(tmp_path / "R&D é" / "(é&") == "&é("
    assert "".join(c for c in LOST if lost_characters(tmp_path / f"a{c}b") == c) == LOST


# --- the page ------------------------------------------------------------------------------------
def test_the_page_tells_all_of_it(host: BareHost) -> None:
    page = etree.HTML((host.fmu / "documentation" / "index.html").read_bytes())
    text = " ".join(" ".join(page.itertext()).split())
    for paragraph in PYTHON_LIMITS:
        for part in (paragraph,) if isinstance(paragraph, str) else paragraph:
            assert " ".join(part.split()) in text
    for character in LOST:
        assert f" {character} " in text
    assert [pre.text for pre in page.iter("pre")] == [HOST_SETUP]
    assert [len(items) for items in page.iter("ul")] == [4]


def test_the_page_is_readable_on_any_screen(host: BareHost) -> None:
    """Prose in a narrow column; tables and commands scroll in boxes of their own."""
    page = etree.HTML((host.fmu / "documentation" / "index.html").read_bytes())
    viewport = page.find(".//meta[@name='viewport']")
    assert viewport.get("content").startswith("width=device-width")
    wide = [*page.iter("table"), *page.iter("pre")]
    assert len(wide) == 5
    assert {element.getparent().get("class") for element in wide} == {"wide"}
    style = page.findtext(".//style")
    assert "h1, h2, p, ul { max-width: 34em }" in style
    assert ".wide { overflow-x: auto" in style


def test_paragraphs_lists_and_commands() -> None:
    chapters = [("Title", ("Some text.", ("one", "two"), "first\nsecond"))]
    page = etree.HTML(index_html("Model", "what it is", chapters, (), "MIT"))
    body = page.find("body")
    shown = [(e.tag, "".join(e.itertext())) for e in body if e.tag in ("h2", "p", "ul", "div")]
    assert shown[:5] == [
        ("p", "what it is"),
        ("h2", "Title"),
        ("p", "Some text."),
        ("ul", "onetwo"),
        ("div", "first\nsecond"),
    ]
    assert [item.text for item in body.iter("li")] == ["one", "two"]
