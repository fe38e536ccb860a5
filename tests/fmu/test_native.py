"""The native runtime: the same bytes as the runtime in Python, on every platform, and nothing else.

Both answer the same calls (tests/fmu/native.py), a program in C hands them to the library
(tests/fmu/replay.c). Windows and aarch64 run where wine and qemu are; what is not there is said.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

import build_fmu
from tests.fmu.native import (
    HOST,
    OK,
    REPLAY,
    Call,
    Python,
    compiled,
    replayed,
    unzipped_library,
    walk,
)
from tests.places import ROOT, SCREENS
from vibroscreen import Screen, ScreenConfig, registry
from vibroscreen.compiler import machine
from vibroscreen.errors import TEXT, ConfigError
from vibroscreen.kernels import library
from vibroscreen.sections import Bed, Displacement, Passage, Segregation, Solver
from vibroscreen_fmu.native.fmu import PLATFORMS, write_native_fmu
from vibroscreen_fmu.package import screen_model
from vibroscreen_fmu.python_slave import ScreenSlave
from vibroscreen_fmu.row_slave import slave_class

HEADERS = Path(fmpy.__file__).parent / "c-code"
FOREIGN = ("win64", "aarch64-linux")
# The steps of a run; a double deck costs several times as much as a single one.
STEPS = 500
NULLS = 8  # calls with pointers to nothing that get the status that they should
SANITIZED_STEPS, VALGRIND_STEPS = 400, 40


def configurations() -> dict[str, ScreenConfig]:
    """Screens that have all parts of the engine at work."""
    default = ScreenConfig.default()
    tabled = Passage(velocity_table=((0.002, 0.05), (0.03, 0.2)))
    return {
        "default": default,
        "two decks": ScreenConfig.load(SCREENS / "two_deck.toml"),
        "banana": ScreenConfig.load(SCREENS / "banana.toml"),
        "table": default.replace(passage=tabled, solver=Solver(tolerance=1e-3)),
        "full at the start": default.replace(
            bed=Bed(initial="steady", contact_depth=0.03), segregation=Segregation("classified")
        ),
        "given velocity": default.replace(
            displacement=Displacement("prescribed", 0.3),
            segregation=Segregation("proportional"),
            passage=Passage("gaudin"),
        ),
    }


LENGTHS = {"default": 2000, "two decks": 1000}


@dataclass
class Built:
    """A screen as library of this machine, and as the slave of the python runtime."""

    config: ScreenConfig
    library: Path
    guid: str
    python: Python


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Built]:
    """Screens by name, each built once."""
    known: dict[str, Built] = {}

    def build(name: str) -> Built:
        if name not in known:
            folder = tmp_path_factory.mktemp("native")
            config = configurations()[name]
            path = write_native_fmu(config, folder, [HOST])
            unzipped = unzipped_library(path, folder / "unzipped")
            guid = read_model_description(str(path)).guid
            known[name] = Built(config, unzipped, guid, Python(config, folder))
        return known[name]

    return build


@pytest.fixture(scope="module")
def every_platform(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The default screen's FMU for all platforms."""
    folder = tmp_path_factory.mktemp("platforms")
    return build_fmu.build(ScreenConfig.default(), folder, "native", PLATFORMS)


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program that hands calls to a library; it stops if a step takes memory."""
    made = tmp_path_factory.mktemp("replay") / "replay"
    return compiled(REPLAY, made, "-DCOUNT_ALLOCATIONS", "-rdynamic")


def first_difference(python: Python, got: bytes) -> str:
    """Where an answer leaves that of the python runtime."""
    place = 0
    for number, piece in enumerate(python.out):
        if got[place : place + len(piece)] != piece:
            return f"answer {number}: {got[place : place + len(piece) + 80]!r}, not {piece!r}"
        place += len(piece)
    return "none" if place == len(got) else "more answers"


# --- the same bytes ------------------------------------------------------------------------------
@pytest.mark.parametrize("name", configurations())
def test_answers_of_both_runtimes_are_the_same_bytes(
    name: str, built: Callable[[str], Built], replay: Path, tmp_path: Path
) -> None:
    """Outputs, states, refusals and their messages, over random steps; by both builds."""
    one = built(name)
    calls = list(walk(one.python.ports, LENGTHS.get(name, STEPS), seed=1))
    wanted = one.python.answer(calls)
    assert b"logStatusError" in wanted
    assert len(wanted) > 50 * LENGTHS.get(name, STEPS)
    got = replayed([replay], one.library, calls, one.guid, tmp_path)
    assert got == wanted, first_difference(one.python, got)
    plain = {"VIBROSCREEN_PROCESSOR": "plain"}
    fewer = calls[: len(calls) // (1 if name == "default" else 4)]
    got = replayed([replay], one.library, fewer, one.guid, tmp_path, **plain)
    assert wanted.startswith(got)
    assert len(got) > len(wanted) // 8


@pytest.mark.parametrize("name", ["default", "two decks"])
def test_a_hostile_host_gets_the_same_answers(
    name: str, built: Callable[[str], Built], replay: Path, tmp_path: Path
) -> None:
    one = built(name)
    tolerances: list[Call] = [("t", value) for value in (5.0, np.nan, -1.0, 1e-9, 0.1, 3e-4)]
    calls = [*tolerances, *walk(one.python.ports, 300, seed=2, hostile=True), ("t", 1e-3)]
    wanted = one.python.answer(calls)
    assert wanted.count(b"logStatusWarning") >= 3
    assert b"logStatusError solver.tolerance is a fixed parameter" in wanted
    for text in ("no_time", "fixed", "not_settable", "other_type", "broken_state", "no_state"):
        pattern = re.sub(r"\\\{[^}]*\\\}", ".*", re.escape(TEXT[text]))
        assert re.search(pattern.encode(), wanted), text
    got = replayed([replay], one.library, [*calls, ("P",)], one.guid, tmp_path)
    assert got.startswith(wanted), first_difference(one.python, got)
    assert got[len(wanted) :].endswith(bytes([NULLS]))


BAD = [
    {"bed.contact_depth": -1.0},
    {"bed.contact_depth": np.nan},
    {"bed.layer_depth": 9.0},
    {"material.bulk_density": 1.6},
    {"drive.efficiency": 0.0},
    {"drive.bearing_friction": np.inf},
    {"solver.tolerance": 1.0},
    {"deck[1].width": 2400.0},
    {"deck[1].panel[1].length": 0.0},
    {"deck[1].panel[1].aperture": 16.0},
    {"deck[1].panel[1].aperture": -np.inf},
    {"deck[2].panel[1].aperture": 0.4},
    {"deck[1].panel[2].length": 1.0},
    {"deck[2].panel[1].length": 3.5},
    {"size_class[2].upper": 0.003},
    {"size_class[2].upper": 1e-5, "size_class[3].lower": 1e-5},
    {"size_class[1].lower": -0.001},
    {"size_class[1].lower": 20.0},
    {"segregation.model": 9},
    {"passage.law": 0},
    {"deck[1].panel[1].inclination": 0.6, "deck[1].width": 2.0},
    {"deck[1].panel[1].inclination": 0.6},
    {"feed.mass_flow_rate": -1.0, "deck[1].width": 2.0},
    {"feed.mass_fraction[1]": 0.9},
    {"motion.frequency": 930.0},
]


@pytest.mark.parametrize("values", BAD, ids=lambda values: ", ".join(values))
@pytest.mark.parametrize("name", ["two decks", "table"])
def test_refused_starts_are_told_in_the_same_words(
    name: str,
    values: dict[str, float],
    built: Callable[[str], Built],
    replay: Path,
    tmp_path: Path,
) -> None:
    """Then the screen starts with what is right, and both agree on what it gives."""
    one = built(name)
    ports = {port.name: port for port in one.python.ports}
    if not values.keys() <= ports.keys():
        return  # of the other screen
    calls: list[Call] = [*settings(ports, values), ("X",)]
    good = {key: ports[key].start or 0.0 for key in values}
    calls += [*settings(ports, good), ("X",), ("D", 2.0), ("S",)]
    wanted = one.python.answer(calls)
    assert b"logStatusError" in wanted
    got = replayed([replay], one.library, calls, one.guid, tmp_path)
    assert got == wanted, first_difference(one.python, got)


def settings(ports: dict, values: dict[str, float]) -> list[Call]:
    """Calls that set variables by name."""
    return [
        ("R", [ports[name].reference], [value])
        if ports[name].kind == "Real"
        else ("I", [ports[name].reference], [int(value)])
        for name, value in values.items()
    ]


CHANGED = [
    {"segregation.model": 1},
    {"displacement.model": 1, "displacement.velocity": 0.25},
    {"solver.tolerance": 1e-3, "passage.velocity": 0.15, "segregation.dilation": 0.002},
    {"deck[1].panel[1].aperture": 0.0125, "deck[1].width": 2.0},
    {"bed.initial": 2, "bed.contact_depth": 0.015},
    {"size_class[3].upper": 0.0041, "size_class[4].lower": 0.0041},
]


@pytest.mark.parametrize("values", CHANGED, ids=lambda values: ", ".join(values))
@pytest.mark.parametrize("name", ["default", "table"])
def test_fixed_parameters_of_the_host(
    name: str,
    values: dict[str, float],
    built: Callable[[str], Built],
    replay: Path,
    tmp_path: Path,
) -> None:
    """Other sizes, layers and cells: laid out alike, run alike, and a state brings them along."""
    one = built(name)
    ports = {port.name: port for port in one.python.ports}
    outputs = [p.reference for p in one.python.ports if p.causality == "output"]
    run: list[Call] = [("D", 3.0), ("r", outputs), ("D", 40.0), ("r", outputs), ("S",)]
    calls = [*settings(ports, values), ("X",), *run, ("N",), *run, ("K",), ("Z",), ("k",), *run]
    wanted = one.python.answer(calls)
    assert b"logStatusError" not in wanted
    got = replayed([replay], one.library, calls, one.guid, tmp_path)
    assert got == wanted, first_difference(one.python, got)
    if name == "default":
        plain = [*settings(ports, {"deck[1].width": 2.4}), ("X",), *run]
        assert one.python.answer(plain)[2:] != wanted[len(values) + 1 :][: len(wanted)]


def test_a_state_of_either_runtime_is_one_of_the_other(
    built: Callable[[str], Built], replay: Path, tmp_path: Path
) -> None:
    one = built("default")
    slave = one.python.make()
    slave.exit_initialization_mode()
    slave.do_step(0.0, 7.0)
    state = slave._get_fmu_state()
    calls: list[Call] = [
        ("B", state),
        ("D", 5.0),
        ("S",),
        ("r", [p.reference for p in one.python.ports if p.causality == "output"]),
    ]
    got = replayed([replay], one.library, calls, one.guid, tmp_path)
    assert got == one.python.answer(calls)
    assert got.startswith(OK + OK)
    other = slave_class(ScreenSlave, "VibratingScreen", "another build")
    stranger = other(instance_name="screen", resources=str(one.python.folder))
    calls = [("B", stranger._get_fmu_state()), ("S",)]
    got = replayed([replay], one.library, calls, one.guid, tmp_path)
    assert got == one.python.answer(calls)
    assert b"are of another build of the FMU" in got


# --- other platforms -----------------------------------------------------------------------------
def of_wine(program: str) -> str | None:
    """Path of a program of wine; Debian's package wine64 leaves them outside of PATH."""
    return shutil.which(program, path=f"{os.environ['PATH']}:/usr/lib/wine")


def emulator(target: str) -> list[str]:
    """What runs programs of a platform here; skips, and says so, where nothing does."""
    if target == "win64":
        wine = of_wine("wine64") or of_wine("wine")
        return [wine] if wine else pytest.skip("wine is not installed: win64 was built, not run")
    qemu = shutil.which("qemu-aarch64")
    root = Path("/usr/aarch64-linux-gnu")
    if not qemu or not root.is_dir():
        pytest.skip("qemu-user or libc6-arm64-cross is not installed: aarch64 was built, not run")
    return [qemu, "-L", str(root)]


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """The environment of programs for Windows: a folder and a server of their own.

    One server for all of them: a program that starts while the last server ends does not get far.
    """
    found = {"WINEDEBUG": "-all", "WINEPREFIX": str(tmp_path_factory.mktemp("wine"))}
    server = of_wine("wineserver64")
    if server:
        subprocess.run([server, "-p"], env={**os.environ, **found}, check=True)
    yield found
    if server:
        subprocess.run([server, "-k"], env={**os.environ, **found}, check=False)


@pytest.mark.parametrize("target", FOREIGN)
def test_other_platforms_give_the_same_bytes(
    target: str,
    every_platform: Path,
    built: Callable[[str], Built],
    quiet: dict[str, str],
    tmp_path: Path,
) -> None:
    program = emulator(target)
    one = built("default")
    folder = Path(extract(str(every_platform), unzipdir=str(tmp_path / "unzipped")))
    name = "replay.exe" if target == "win64" else "replay"
    made = compiled(REPLAY, tmp_path / name, target=target)
    (unzipped,) = (folder / "binaries" / target).iterdir()
    calls = list(walk(one.python.ports, STEPS, seed=3, hostile=True))
    got = replayed([*program, made], unzipped, calls, one.guid, tmp_path, **quiet)
    wanted = one.python.answer(calls)
    assert got == wanted, first_difference(one.python, got)
    # The library alone, and a resource location as a URI.
    named = shutil.copytree(folder / "resources", tmp_path / "Müll & 100 % [1]")
    uri = named.as_uri().replace("file:///", "file:///Z:/" if target == "win64" else "file:///")
    some = calls[:20]
    got = replayed([*program, made], unzipped, some, one.guid, tmp_path, uri, **quiet)
    assert got == one.python.answer(some)


def test_one_fmu_for_all_platforms(every_platform: Path) -> None:
    assert validate_fmu(str(every_platform)) == []
    with zipfile.ZipFile(every_platform) as archive:
        found = {Path(name).parts[1] for name in archive.namelist() if name.startswith("binaries")}
        start = {
            target: archive.read(f"binaries/{target}/VibratingScreen{suffix}")
            for target, suffix in library.SUFFIX.items()
        }
    assert found == set(PLATFORMS)
    assert all(len(content) < 800_000 for name, content in start.items() if name != "darwin64")
    start = {target: content[:4] for target, content in start.items()}
    assert build_fmu.platforms_of(every_platform) == sorted(PLATFORMS)
    assert start["linux64"] == start["aarch64-linux"] == b"\x7fELF"
    assert start["win64"][:2] == b"MZ"
    assert start["darwin64"] == bytes.fromhex("cafebabe")  # for two processors


# --- what it is made of --------------------------------------------------------------------------
def test_the_library_needs_the_c_library_and_shows_fmi(built: Callable[[str], Built]) -> None:
    one = built("default").library
    shown, taken = machine.symbols(one.read_bytes())
    declared = re.findall(
        r"\bFMI2_Export fmi2\w+TYPE\s+(fmi2\w+);", (HEADERS / "fmi2Functions.h").read_text()
    )
    simulation = {name for name in declared if not re.search(MODEL_EXCHANGE, name)}
    assert {name for name in shown if not name.startswith("vibroscreen_")} == simulation
    assert {"vibroscreen_run", "vibroscreen_plan"} < shown
    assert taken <= machine.ALLOWED
    needed = subprocess.run(["ldd", one], capture_output=True, text=True, check=True).stdout
    names = {Path(line.split()[0]).name for line in needed.splitlines()}
    assert {name.partition(".")[0] for name in names} <= {
        "linux-vdso",
        "libc",
        "libdl",
        "libm",
        "ld-linux-x86-64",
    }


MODEL_EXCHANGE = (
    "EventMode|NewDiscreteStates|ContinuousTimeMode|CompletedIntegratorStep|SetTime|"
    "ContinuousStates|GetDerivatives|EventIndicators|NominalsOf"
)


def test_the_fmu_is_the_same_every_time(built: Callable[[str], Built], tmp_path: Path) -> None:
    one = write_native_fmu(built("default").config, tmp_path / "one", [HOST])
    two = write_native_fmu(built("default").config, tmp_path / "two", [HOST])
    assert one.read_bytes() == two.read_bytes()
    # Another screen has the same library.
    other = zipfile.ZipFile(write_native_fmu(built("banana").config, tmp_path / "other", [HOST]))
    name = f"binaries/{HOST}/{built('banana').library.name}"
    assert other.read(name) == zipfile.ZipFile(one).read(name)


def test_contract_of_both_runtimes(every_platform: Path) -> None:
    """Same names, references, types and GUID; only what the host needs differs."""
    native = read_model_description(str(every_platform))
    model = screen_model(ScreenConfig.default())
    assert [(p.name, p.reference) for p in model.ports] == [
        (v.name, v.valueReference) for v in native.modelVariables
    ]
    from vibroscreen_fmu.model_description import guid_of, model_description

    assert native.guid == guid_of(model.name, model.ports, model.description)
    python = model_description(model.name, model.ports, model.description).decode()
    with zipfile.ZipFile(every_platform) as archive:
        text = archive.read("modelDescription.xml").decode()
    assert 'needsExecutionTool="false"' in text
    assert 'needsExecutionTool="true"' in python
    same = re.compile(r'needsExecutionTool="\w+"|generationTool="[^"]*"')
    assert same.sub("", text) == same.sub("", python)


def test_threads_have_their_own_screens(built: Callable[[str], Built], tmp_path: Path) -> None:
    """Eight at once give what one gives alone."""
    one = built("default")
    description = one.library.parent.parent.parent
    results: dict[int, list[float]] = {}
    outputs = [
        p.reference for p in one.python.ports if p.causality == "output" and p.kind == "Real"
    ]
    feed = next(p.reference for p in one.python.ports if p.name == "feed.mass_flow_rate")

    def work(number: int) -> None:
        fmu = FMU2Slave(
            guid=one.guid,
            unzipDirectory=str(description),
            modelIdentifier="VibratingScreen",
            instanceName=f"screen {number}",
        )
        fmu.instantiate()
        fmu.setupExperiment()
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        values: list[float] = []
        for step in range(100):
            fmu.setReal([feed], [60.0 + step % 7])
            fmu.doStep(float(step), 1.0)
            values += fmu.getReal(outputs)
        fmu.terminate()
        fmu.fmi2FreeInstance(fmu.component)
        results[number] = values

    work(0)
    workers = [threading.Thread(target=work, args=(k,)) for k in range(1, 9)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(results) == 9
    assert all(values == results[0] for values in results.values())


# --- memory --------------------------------------------------------------------------------------
def sanitized(fmu: Path, folder: Path) -> Path:
    """The library in an FMU like that in `fmu`, with its C checked for what is not allowed in C.

    The kernels are those of the engine library, which it needs to lie where it does.
    """
    shutil.copytree(fmu / "resources", folder / "resources")
    flags = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
    made = folder / "binaries" / HOST / "VibratingScreen.so"
    made.parent.mkdir(parents=True)
    kernels = str(library.library())
    content = machine.link(
        machine.PLATFORMS[HOST], "checked", library.native_sources(HOST), (*flags, kernels)
    )
    made.write_bytes(content)
    return made


def test_clean_under_sanitizers(
    built: Callable[[str], Built], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not shutil.which("gcc"):
        pytest.skip("gcc is not installed: nothing here has an address sanitizer")
    monkeypatch.setattr(machine, "find_linker", lambda: (("gcc",), False))
    one = built("two decks")
    checked = sanitized(one.library.parents[2], tmp_path / "checked")
    program = tmp_path / "replay"
    compiled(REPLAY, program, "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
    calls = list(walk(one.python.ports, SANITIZED_STEPS, seed=4, hostile=True))
    got = replayed([program], checked, [*calls, ("P",)], one.guid, tmp_path)
    wanted = one.python.answer(calls)
    assert got.startswith(wanted), first_difference(one.python, got)


def test_clean_under_valgrind(built: Callable[[str], Built], tmp_path: Path) -> None:
    """Nothing read that was not written, in the kernels too; nothing lost."""
    if not shutil.which("valgrind"):
        pytest.skip("valgrind is not installed")
    one = built("default")
    program = compiled(REPLAY, tmp_path / "replay", "-g")
    calls = list(walk(one.python.ports, VALGRIND_STEPS, seed=5, hostile=True))
    checks = ["--error-exitcode=9", "--leak-check=full", "--show-leak-kinds=definite,indirect"]
    host = ["valgrind", "-q", *checks, program]
    got = replayed(host, one.library, [*calls, ("P",)], one.guid, tmp_path)
    wanted = one.python.answer(calls)
    assert got.startswith(wanted), first_difference(one.python, got)


# --- one's own sub-models ------------------------------------------------------------------------
def square_root_passage(size, fraction, scene, probability) -> None:
    """Between the law of Gaudin and none."""
    for i in range(size.size):
        ratio = size[i] / scene.aperture
        probability[i] = scene.open_area * (1.0 - ratio) if ratio < 1.0 else 0.0


def allocating_passage(size, fraction, scene, probability) -> None:
    copy = np.zeros(size.size)
    copy[0] = size[0]
    probability[:] = copy


@pytest.mark.parametrize("target", [HOST, *FOREIGN])
def test_a_sub_model_of_ones_own_lies_beside_the_engine(
    target: str, replay: Path, quiet: dict[str, str], tmp_path: Path
) -> None:
    program: list[str | Path] = [replay]
    if target != HOST:
        program = [*emulator(target), tmp_path / f"replay{'.exe' * (target == 'win64')}"]
        compiled(REPLAY, Path(program[-1]), target=target)
    registry.register("passage", "straight", square_root_passage)
    config = ScreenConfig.default().replace(passage=Passage("straight", velocity=0.08))
    path = write_native_fmu(config, tmp_path, [target])
    assert validate_fmu(str(path)) == []
    extract(str(path), unzipdir=str(tmp_path / "unzipped"))
    suffix = library.SUFFIX[target]
    unzipped = tmp_path / "unzipped" / "binaries" / target / f"VibratingScreen{suffix}"
    own = unzipped.with_stem("VibratingScreen_own")
    if target != "win64":
        shown, taken = machine.symbols(own.read_bytes())
        assert shown == {"screen_own_passage"}
        assert taken <= machine.ALLOWED
    ports = screen_model(config, built_in=False).ports
    outputs = [p for p in ports if p.causality == "output" and p.kind == "Real"]
    calls: list[Call] = [("X",), ("D", 30.0), ("r", [p.reference for p in outputs])]
    guid = read_model_description(str(path)).guid
    got = replayed(program, unzipped, calls, guid, tmp_path, **quiet)
    screen = Screen(config)
    screen.advance(30.0)
    screen.read()
    first = screen.layout.section["parameters"].start
    values = screen.buffer[[first + p.reference for p in outputs]]
    assert got == OK * 3 + values.tobytes()
    plain = Screen(config.replace(passage=Passage("gaudin", velocity=0.08)))
    assert plain.step(30.0).undersize.mass_flow_rate != screen.result().undersize.mass_flow_rate
    own.unlink()
    with pytest.raises(AssertionError, match="no instance"):
        replayed(program, unzipped, calls, guid, tmp_path, **quiet)
    said = (tmp_path / "alone" / "out").read_text()
    assert f"_own{suffix} is missing or does not load: unpack the whole FMU" in said


def test_a_sub_model_that_needs_python_is_refused(tmp_path: Path) -> None:
    registry.register("passage", "allocates", allocating_passage)
    config = ScreenConfig.default().replace(passage=Passage("allocates"))
    with pytest.raises(ConfigError, match="must not allocate, print or call Python"):
        write_native_fmu(config, tmp_path, [HOST])
    assert not list(tmp_path.glob("*.fmu"))


# --- the command ---------------------------------------------------------------------------------
BUILD = """
import sys
from pathlib import Path
from vibroscreen import ScreenConfig
from vibroscreen_fmu.native.fmu import write_native_fmu
write_native_fmu(ScreenConfig.default(), Path(sys.argv[1]), [sys.argv[2]])
print([name for name in ("numba", "llvmlite", "ziglang") if name in sys.modules])
"""


def test_an_fmu_is_built_without_a_compiler(built: Callable[[str], Built], tmp_path: Path) -> None:
    """The engine is at hand: the same file, in a process that can run no program."""
    places = os.pathsep.join(str(ROOT / part) for part in ("engine", "fmu_src"))
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", BUILD, tmp_path / "one", HOST],
        env={**os.environ, "PYTHONPATH": places, "PATH": "/nowhere"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("[]\n", "")
    again = write_native_fmu(built("default").config, tmp_path / "two", [HOST])
    assert again.read_bytes() == (tmp_path / "one" / again.name).read_bytes()


def test_both_runtimes_lie_side_by_side(tmp_path: Path) -> None:
    """The native one has the plain name."""
    config = ScreenConfig.default()
    paths = [build_fmu.build(config, tmp_path, runtime) for runtime in build_fmu.RUNTIMES]
    assert [path.name for path in paths] == ["VibratingScreen.fmu", "VibratingScreen_python.fmu"]
    one, two = (read_model_description(str(path)) for path in paths)
    assert one.guid == two.guid
    needed = [d.coSimulation.needsExecutionTool for d in (one, two)]
    assert needed == [False, True]


def test_platforms_that_are_not_possible_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = ScreenConfig.default()
    with pytest.raises(
        ConfigError, match="platform = 'vax' is unknown: give one or more of linux64"
    ):
        write_native_fmu(config, tmp_path, ["vax"])
    monkeypatch.setattr(library, "library", lambda target=None: None)
    monkeypatch.setattr(library, "at_hand", dict)
    for platforms in ((), ["win64"]):
        with pytest.raises(ConfigError, match=r"nothing here can link one: pip install ziglang"):
            write_native_fmu(config, tmp_path, platforms)
    monkeypatch.undo()
    monkeypatch.setattr(machine, "find_linker", lambda: (("cc",), False))
    with pytest.raises(ConfigError, match=r"cannot be linked by cc.*pip install ziglang"):
        machine.link(machine.PLATFORMS["win64"], "own", {}, ())
    monkeypatch.setattr(machine, "find_linker", lambda: None)
    with pytest.raises(ConfigError, match="a library needs a linker: pip install ziglang"):
        machine.link(machine.PLATFORMS[HOST], "own", {}, ())


def test_a_host_in_c_runs_a_screen(built: Callable[[str], Built], tmp_path: Path) -> None:
    """The example: its totals are those of the engine."""
    one = built("default")
    source = ROOT / "plant_examples" / "day_of_plant.c"
    assert len(source.read_text().splitlines()) < 80
    program = compiled(source, tmp_path / "day")
    place = one.library.parent.parent.parent
    done = subprocess.run([program, place, "600"], capture_output=True, text=True, check=True)
    found = re.findall(r"(\w+) feed: ([\d.]+) t of undersize in 600 s", done.stdout)
    screen = Screen(one.config)
    for _ in range(600):
        screen.advance(1.0)
    steady = screen.result()
    tonnes = screen.view("output")[3] / 1000.0
    assert steady.undersize.mass_flow_rate > 0.0
    assert [name for name, _ in found] == ["steady", "restless"]
    assert float(found[0][1]) == pytest.approx(tonnes, abs=0.05)
    assert float(found[1][1]) == pytest.approx(tonnes, rel=0.05)
