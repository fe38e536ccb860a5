"""A constant of a law is said in two places, its field and the law: the rest follows from them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.places import ROOT

FIELD = """
    clogged: float = number(
        0.25,
        "clogged",
        at_least=0.0,
        at_most=0.75,
        variability="tunable",
        tells="Share of the openings that stay clogged",
        cure="0 is for a clean deck",
    )
    rim: float = number("""
LAW = ("scale = open_area / ", "scale = (1.0 - scene.clogged) * open_area / ")

ASKED = """
import json
from vibroscreen import InputError, Screen, ScreenConfig, solve_steady_many
from vibroscreen.config import legal_keys
from vibroscreen.native.header import header
from vibroscreen_fmu.ports import ports

TEXT = '''
[size_classes]
edges_mm = [0, 8, 16, 40]
subdivision = 1
[passage]
law = "gaudin"
velocity_m_s = 0.1
[segregation]
model = "well_mixed"
[solver]
tolerance = 1e-2
'''
def refused(call):
    try:
        call()
    except ValueError as error:
        return str(error)
plain = ScreenConfig.loads(TEXT)
clean = ScreenConfig.loads(TEXT.replace("[segregation]", "clogged = 0.0\\n[segregation]"))
screen = Screen(plain)
before = screen.state
screen.record("parameter").passage_clogged = 0.8
(port,) = [port for port in ports(plain) if port.name == "passage.clogged"]
print(json.dumps({
    "keys": [key for key in legal_keys() if "clogged" in key],
    "written": "clogged = 0.25" in plain.to_toml(),
    "file": refused(lambda: ScreenConfig.loads(TEXT.replace("[segr", "clogged = 0.8\\n[segr"))),
    "step": refused(lambda: screen.step(1.0)),
    "sweep": refused(lambda: solve_steady_many(plain, {"passage.clogged": [0.1, 0.8]})),
    "swept": solve_steady_many(plain, {"passage.clogged": [0.0, 0.25]}).undersize_recovery.tolist(),
    "solved": [Screen(c).solve_steady().undersize_recovery for c in (clean, plain)],
    "port": [port.description, port.variability, port.unit, port.least, port.most, port.start],
    "c": "P_PASSAGE_CLOGGED" in header("", ""),
}))
"""
MESSAGE = "passage.clogged = 0.8 is out of range (0 to 0.75): 0 is for a clean deck"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a copy of the project says that has one more constant of Gaudin's law."""
    copy = tmp_path_factory.mktemp("copy")
    for folder in ("engine/vibroscreen", "fmu_src/vibroscreen_fmu"):
        shutil.copytree(ROOT / folder, copy / folder)
    _change(copy / "engine/vibroscreen/sections.py", "\n    rim: float = number(", FIELD)
    _change(copy / "engine/vibroscreen/kernels/physics/gaudin.py", *LAW)
    places = os.pathsep.join(map(str, (copy / "engine", copy / "fmu_src")))
    own = {"PYTHONPATH": places, "VIBROSCREEN_ENGINE": "python", "XDG_CACHE_HOME": str(copy)}
    done = subprocess.run(
        [sys.executable, "-c", ASKED],
        env={**os.environ, **own},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def _change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def test_a_file_has_its_key(found: dict[str, Any]) -> None:
    assert found["keys"] == ["passage.clogged"]
    assert found["written"]


def test_all_checks_know_its_limits(found: dict[str, Any]) -> None:
    assert found["file"] == found["step"] == MESSAGE
    assert found["sweep"] == f"design 1: {MESSAGE}"


def test_the_law_reads_it(found: dict[str, Any]) -> None:
    clean, clogged = found["solved"]
    assert clean > clogged + 0.02
    assert found["swept"] == pytest.approx([clean, clogged], rel=1e-12)


def test_the_fmu_has_its_variable(found: dict[str, Any]) -> None:
    said = ["Share of the openings that stay clogged", "tunable", "1", 0.0, 0.75, 0.25]
    assert found["port"] == said
    assert found["c"]
