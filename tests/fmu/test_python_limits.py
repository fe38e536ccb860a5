"""What is told of the python runtime's limits is so, and is told where people look."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import fmpy
import pytest
from lxml import etree

from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen_fmu.documentation import index_html
from vibroscreen_fmu.package import write_fmu
from vibroscreen_fmu.python_limits import HOST_SETUP, LOST, PYTHON_LIMITS, lost_characters

HOST = Path(__file__).with_name("host.c")
HEADERS = Path(fmpy.__file__).parent / "c-code"

# Instantiates the FMU in a folder at a location, and logs one thing.
INSTANTIATE = """
import sys
from ctypes import byref
from pathlib import Path
from fmpy import fmi2, read_model_description
from fmpy.fmi1 import FMICallException

folder, location, logger = sys.argv[1:]
description = read_model_description(folder)
slave = fmi2.FMU2Slave(
    guid=description.guid,
    unzipDirectory=folder,
    modelIdentifier=description.coSimulation.modelIdentifier,
    instanceName="screen",
)
callbacks = fmi2.fmi2CallbackFunctions()
if logger == "logger":
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *_: None)
uri = (Path(folder) / "resources").as_uri()
place = None if location == "NULL" else (uri if location == "uri" else location).encode()
slave.component = slave.fmi2Instantiate(
    b"screen", 1, description.guid.encode(), place, byref(callbacks), 0, 1
)
assert slave.component
try:
    slave.doStep(0.0, 1.0)
except FMICallException as error:
    print(error.status, flush=True)
"""


class Ended(NamedTuple):
    """How a host ended, and what it printed."""

    code: int
    said: str


def instantiated(folder: Path, location: str = "uri", logger: str = "logger") -> Ended:
    """A host that instantiates the unzipped FMU in a folder."""
    command = [sys.executable, "-c", INSTANTIATE, str(folder), location, logger]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return Ended(done.returncode, done.stdout.strip())


WELL = Ended(0, "2")
CRASHES = (-signal.SIGSEGV, -signal.SIGABRT)


@pytest.fixture(scope="module")
def unzipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The python FMU of the default screen, unzipped in a folder with a harmless path."""
    folder = tmp_path_factory.mktemp("limits")
    fmpy.extract(str(write_fmu(ScreenConfig.default(), folder)), unzipdir=str(folder / "fmu"))
    return folder / "fmu"


def copies(unzipped: Path, folder: Path, names: Sequence[str]) -> list[Path]:
    """Copies of an unzipped FMU in folders of these names."""
    return [shutil.copytree(unzipped, folder / name / "fmu") for name in names]


def results(places: Sequence[Path]) -> dict[str, Ended]:
    with ThreadPoolExecutor(max_workers=2) as pool:
        found = list(pool.map(instantiated, places))
    return {place.parent.name: ended for place, ended in zip(places, found, strict=True)}


@pytest.mark.skipif(sys.platform != "linux", reason="tried on Linux")
def test_the_characters_that_end_a_host_are_these(unzipped: Path, tmp_path: Path) -> None:
    """Every one that is told of does, and what is told to be fine is."""
    names = [f"a{character}b" for character in f"{LOST}é"] + ["Program Files (x86)", "R&D"]
    for name, ended in results(copies(unzipped, tmp_path, names)).items():
        assert ended.code in CRASHES, f"{name}: {ended}"
        assert lost_characters(tmp_path / name), name
    fine = ["a b", "a.b", "a_b", "a-b", "a~b", "aZ09"]
    for name, ended in results(copies(unzipped, tmp_path, fine)).items():
        assert ended == WELL, name
        assert lost_characters(tmp_path / name) == "", name


@pytest.mark.skipif(sys.platform != "linux", reason="tried on Linux")
def test_the_locations_that_end_a_host_are_these(unzipped: Path) -> None:
    path = str(unzipped / "resources")
    for location in (f"file:{path}", f"file://localhost{path}", "", "NULL"):
        assert instantiated(unzipped, location).code in CRASHES, location
    for location in (f"file://{path}", f"file://{path}/", path):
        assert instantiated(unzipped, location) == WELL, location


@pytest.mark.skipif(sys.platform != "linux", reason="tried on Linux")
def test_a_path_that_is_not_coded_is_fine(unzipped: Path, tmp_path: Path) -> None:
    (place,) = copies(unzipped, tmp_path, ["R&D (x86)"])
    assert instantiated(place).code in CRASHES
    assert instantiated(place, f"file://{place / 'resources'}") == WELL


@pytest.mark.skipif(sys.platform != "linux", reason="tried on Linux")
def test_no_logger_ends_a_host(unzipped: Path) -> None:
    assert instantiated(unzipped, logger="none").code in CRASHES


def test_lost_characters_are_told_once_in_their_order(tmp_path: Path) -> None:
    assert lost_characters(tmp_path / "R&D é" / "(é&") == "&é("
    assert "".join(c for c in LOST if lost_characters(tmp_path / f"a{c}b") == c) == LOST


@pytest.mark.skipif(sys.platform != "linux", reason="a host for Linux")
def test_a_host_that_is_not_python(unzipped: Path, tmp_path: Path) -> None:
    """With the commands of the page it runs and outlives refused steps; without them it cannot."""
    host = tmp_path / "host"
    compiler = [os.environ.get("CC", "cc"), "-std=gnu99", "-Wall", "-Wextra", "-Werror"]
    if not shutil.which(compiler[0]):
        compiler[:1] = [sys.executable, "-m", "ziglang", "cc"]
    subprocess.run([*compiler, "-I", HEADERS, HOST, "-o", host, "-ldl"], check=True)
    description = fmpy.read_model_description(str(unzipped))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    call = [
        host,
        next((unzipped / "binaries" / "linux64").iterdir()),
        description.guid,
        (unzipped / "resources").as_uri(),
        reference["feed.mass_flow_rate"],
        reference["undersize.mass_flow_rate"],
    ]
    words = [str(word) for word in call]
    # Nothing else of this process: its Python is found by the commands alone.
    bare = {"PATH": os.pathsep.join([str(Path(sys.executable).parent), "/usr/bin", "/bin"])}

    def run(before: str) -> subprocess.CompletedProcess[str]:
        shell = ["sh", "-c", f'{before}\nexec "$@"', "sh", *words]
        return subprocess.run(shell, env=bare, capture_output=True, text=True, check=False)

    without = run("")
    assert without.returncode == 3
    assert "undefined symbol: _Py_NoneStruct" in without.stdout
    done = run(HOST_SETUP)
    assert done.returncode == 0, done.stdout + done.stderr
    # A screen that has just been started has no oversize yet, and says so.
    told = [line for line in done.stdout.splitlines() if not line.startswith("1 logStatusWarning")]
    started, *lines, last, value = told
    refused = [line for line in lines if line != "2"]
    assert (started, last, lines.count("2")) == ("0", "0", 3)
    assert len(refused) == 3
    assert all(line.startswith("3 logStatusError feed.mass_flow_rate = -1") for line in refused)
    screen = Screen(ScreenConfig.default())
    screen.advance(10.0)
    screen.record("input").feed_mass_flow_rate = 80.0
    screen.advance(1.0)
    assert float(value) == screen.record("output").undersize_rate


# --- the page ------------------------------------------------------------------------------------
def test_the_page_tells_all_of_it(unzipped: Path) -> None:
    page = etree.HTML((unzipped / "documentation" / "index.html").read_bytes())
    text = " ".join(" ".join(page.itertext()).split())
    for paragraph in PYTHON_LIMITS:
        for part in (paragraph,) if isinstance(paragraph, str) else paragraph:
            assert " ".join(part.split()) in text
    for character in LOST:
        assert f" {character} " in text
    assert [pre.text for pre in page.iter("pre")] == [HOST_SETUP]
    assert [len(items) for items in page.iter("ul")] == [4]


def test_the_page_is_readable_on_any_screen(unzipped: Path) -> None:
    """Prose in a narrow column; tables and commands scroll in boxes of their own."""
    page = etree.HTML((unzipped / "documentation" / "index.html").read_bytes())
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
