"""Circuits of FMUs in every co-simulation tool that runs here; all find the same streams."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu

import build_fmu
import two_stage
from circuit_of_fmus import expected_load, main, write_circuit
from tests.fmu import masters
from tests.places import ROOT
from vibroscreen.circuit import solve_circuit
from vibroscreen.config import ScreenConfig
from vibroscreen.kernels import library
from vibroscreen_fmu.circuit.ssp import write_ssp

# Coupling delays a stream by up to a step at every element. A steady state does not know of delays:
# what is left between tools after 40 minutes is what still settles. To the load computed apart it
# is the engine's error, solver.tolerance = 1e-4 for a recovery.
COUPLING_ERROR = 5e-6
ENGINE_ERROR = 2e-5
CHECK = "from fmu_manipulation_toolbox.cli.fmutool import fmutool as f; f()"


@pytest.fixture(scope="session", params=build_fmu.RUNTIMES)
def circuit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the circuit's FMUs and its SSP, with the screen of a runtime."""
    folder = tmp_path_factory.mktemp("circuit")
    screen = build_fmu.build(ScreenConfig.default(), folder / "screen", request.param)
    write_circuit(folder, screen)
    return folder


def beside(packages: tuple[str, ...]) -> Path:
    """Folder of packages that come before those that are here; kept beside the engine."""
    tag = hashlib.sha256(repr((sys.version, packages)).encode()).hexdigest()[:16]
    kept = library.cache_folder() / f"{packages[0].partition('=')[0]}-{tag}"
    if not kept.is_dir():
        kept.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
            place = Path(folder, "packages")
            command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps"]
            subprocess.run([*command, "--target", str(place), *packages], check=True)
            try:
                place.rename(kept)
            except OSError:
                if not kept.is_dir():  # else another run was faster
                    raise
    return kept


def run_python(arguments: Iterable[str], *first: Path) -> subprocess.CompletedProcess[str]:
    """A Python of its own that sees our folders, `first` before all others; it must end well."""
    folders = (*first, ROOT, *(ROOT / part for part in ("engine", "fmu_src", "plant_examples")))
    path = os.pathsep.join(map(str, folders))
    with tempfile.TemporaryDirectory() as left:  # by tools that leave what they unzipped
        done = subprocess.run(
            [sys.executable, *arguments],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PYTHONPATH": path, "TMPDIR": left},
        )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@functools.cache
def expected() -> float:
    """The load that follows from the units alone."""
    return expected_load()


def rates_by(
    tool: Callable[..., list[float]], circuit: Path, *first: Path, case: str = "closed"
) -> list[float]:
    """What a tool finds in a process of its own."""
    script = str(Path(__file__).with_name("masters.py"))
    words = [script, tool.__name__, str(circuit), *([case] if case != "closed" else [])]
    rates: list[float] = json.loads(run_python(words, *first).stdout.splitlines()[-1])
    return rates


def found_by(tool: Callable[..., list[float]], circuit: Path, *first: Path) -> float:
    """The load that a tool finds."""
    (load,) = rates_by(tool, circuit, *first)
    print(f"{tool.__name__}: circulating load {load:.9f}, expected {expected():.9f}")
    return load


@pytest.fixture(scope="session")
def by_hand(circuit: Path) -> float:
    """The load that a script finds, which steps element by element."""
    return found_by(masters.fmpy_loop, circuit)


def test_a_script_finds_the_load_of_the_units(by_hand: float) -> None:
    assert by_hand == pytest.approx(expected(), abs=ENGINE_ERROR)
    assert 0.15 < by_hand < 0.3


@pytest.mark.parametrize("tool", masters.TOOLS[1:], ids=lambda tool: tool.__name__)
def test_tools_find_the_same_load(
    circuit: Path, by_hand: float, tool: Callable[..., list[float]]
) -> None:
    load = found_by(tool, circuit)
    assert load == pytest.approx(by_hand, abs=COUPLING_ERROR)
    assert load == pytest.approx(expected(), abs=ENGINE_ERROR)


@pytest.mark.parametrize("tool", masters.APART, ids=lambda tool: tool.__name__)
def test_tools_with_an_fmpy_of_their_own_find_the_same_load(
    circuit: Path, by_hand: float, tool: Callable[..., list[float]]
) -> None:
    load = found_by(tool, circuit, beside(masters.APART[tool]))
    assert load == pytest.approx(by_hand, abs=COUPLING_ERROR)
    assert load == pytest.approx(expected(), abs=ENGINE_ERROR)


# --- three products --------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def three_products(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the SSP of two-stage crushing, as its file says."""
    folder = tmp_path_factory.mktemp("two_stage")
    write_ssp(two_stage.TODAY, folder / two_stage.SSP, two_stage.DURATION)
    return folder


@pytest.mark.parametrize("tool", masters.OF_SSP, ids=lambda tool: tool.__name__)
def test_tools_find_the_products_of_the_steady_circuit(
    three_products: Path, tool: Callable[..., list[float]]
) -> None:
    """Two crushers, two decks, a gate and a belt: all products within 1e-6 of the fresh feed."""
    table = solve_circuit(two_stage.TODAY, tolerance=1e-9)
    wanted = {
        name: table.product(name)[0].sum() / table.fresh[0] for name in ("0/8", "8/32", "32/90")
    }
    found = rates_by(tool, three_products, case="two_stage")
    named = dict(zip(two_stage.TODAY.leaving.values(), found, strict=True))
    assert named == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("model", masters.ELEMENTS)
def test_checkers_find_no_problem(circuit: Path, model: str) -> None:
    path = circuit / f"{model}.fmu"
    assert validate_fmu(str(path)) == []
    done = run_python(["-c", CHECK, "-input", str(path), "-check"])
    said = (done.stdout + done.stderr).splitlines()
    assert any("seems to be compliant with FMI-2.0" in line for line in said)
    assert any("No semantic error" in line for line in said)
    # The tool marks what it has to say; it also says that it has changed nothing.
    assert [line for line in said if not line.startswith("INFO ")] == []


@pytest.mark.parametrize("model", ["mixer", "crusher", "belt"])
def test_small_units_need_no_compiler(circuit: Path, model: str) -> None:
    """Nothing but numpy, so that they start at once."""
    path = circuit / f"{model}.fmu"
    script = (
        "import sys; from fmpy import simulate_fmu; simulate_fmu(sys.argv[1], stop_time=10.0);"
        "print(*(name for name in ('numba', 'pandas', 'scipy', 'llvmlite') if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""


def test_a_loop_is_no_algebraic_loop(circuit: Path) -> None:
    for model in masters.ELEMENTS:
        description = read_model_description(str(circuit / f"{model}.fmu"))
        assert all(unknown.dependencies == [] for unknown in description.outputs), model


def test_the_example_answers_its_question(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    found, load = main(tmp_path, None)
    assert found == pytest.approx(load, abs=ENGINE_ERROR)
    assert capsys.readouterr().out.splitlines()[-1].endswith("it couples right.")
