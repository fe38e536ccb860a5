"""The FMU as a host sees it, through fmpy: its contract, its numbers, its refusals, its end."""

from __future__ import annotations

import gc
import hashlib
import io
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import fmpy
import fmpy.fmi2 as fmi2
import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable
from fmpy.validation import validate_fmu
from lxml import etree
from pythonfmu.enums import Fmi2Status
from typer.testing import CliRunner

import build_fmu
import vibroscreen
import vibroscreen_fmu
from tests.places import ROOT, SCREENS
from vibroscreen import registry
from vibroscreen.cli import app
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.figures import DECK
from vibroscreen.kernels import state
from vibroscreen.screen import Screen
from vibroscreen.sections import Bed, Solver
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import MM
from vibroscreen_fmu.package import engine, write_fmu
from vibroscreen_fmu.python_limits import IN_SHORT
from vibroscreen_fmu.python_slave import CONFIG_FILE, ScreenSlave

N = 12
FATAL, DISCARD = "status 4", "status 2"
FRACTIONS = range(1, N + 1)


# The contract of the FMU of one deck with one panel: name, unit, display unit.
INPUTS = {
    "feed.mass_flow_rate": ("kg/s", "t/h"),
    **{f"feed.mass_fraction[{i}]": ("1", None) for i in FRACTIONS},
    "motion.frequency": ("Hz", "1/min"),
    "motion.amplitude": ("m", "mm"),
    "motion.throw_angle": ("rad", "deg"),
    "motion.ellipticity": ("1", None),
    "displacement.velocity": ("m/s", None),
}
Units = dict[str, tuple[str, str | None]]


def stream_of(name: str) -> Units:
    return {
        f"{name}.mass_flow_rate": ("kg/s", "t/h"),
        **{f"{name}.mass_fraction[{i}]": ("1", None) for i in FRACTIONS},
    }


def figures_of_deck(deck: int) -> Units:
    units = {
        "bed.hold_up": ("kg", "t"),
        "bed.depth_feed": ("m", "mm"),
        "bed.depth_discharge": ("m", "mm"),
        "bed.depth_over_aperture_feed": ("1", None),
        "bed.depth_over_aperture_discharge": ("1", None),
        "bed.transport_velocity": ("m/s", None),
        "motion.throw_number": ("1", None),
        "performance.aperture": ("m", "mm"),
        "performance.feed_rate": ("kg/s", "t/h"),
        "performance.undersize_rate": ("kg/s", "t/h"),
        "performance.oversize_rate": ("kg/s", "t/h"),
        "performance.efficiency": ("1", None),
        "performance.misplaced_undersize": ("1", None),
        "performance.misplaced_oversize": ("1", None),
        "performance.cut_size": ("m", "mm"),
        "performance.ecart_probable": ("m", "mm"),
        "performance.imperfection": ("1", None),
    }
    return {f"deck[{deck}].{name}": unit for name, unit in units.items()}


PRODUCTS = ("undersize", "oversize")
STREAMS = stream_of("undersize") | stream_of("oversize")
REAL_OUTPUTS = {
    **STREAMS,
    "feed.mass": ("kg", "t"),
    "undersize.mass": ("kg", "t"),
    "oversize.mass": ("kg", "t"),
    "bed.hold_up": ("kg", "t"),
    "bed.depth_feed": ("m", "mm"),
    "bed.depth_discharge": ("m", "mm"),
    "bed.transport_velocity": ("m/s", None),
    **figures_of_deck(1),
    "motion.throw_number": ("1", None),
    "performance.undersize_recovery": ("1", None),
    "performance.efficiency": ("1", None),
    "performance.cut_size": ("m", "mm"),
    "performance.ecart_probable": ("m", "mm"),
    "motion.acceleration_number": ("1", None),
    **{f"{name}.p{share}": ("m", "mm") for name in ("feed", *PRODUCTS) for share in (80, 50)},
    "drive.power": ("W", "kW"),
    "drive.exciter_force": ("N", "kN"),
    "balance.error": ("kg", "t"),
}
ALARMS = tuple(
    f"alarm.{name}"
    for name in ("bed_depth", "capacity", "transport", "performance", "plausibility")
)
TUNABLE = {
    "deck[1].panel[1].inclination": ("rad", "deg"),
    "deck[1].panel[1].open_area": ("1", None),
    "deck[1].panel[1].velocity_factor": ("1", None),
    "material.friction_deck": ("1", None),
    "material.friction_internal": ("1", None),
    "material.rolling": ("1", None),
    "passage.velocity": ("m/s", None),
    "passage.relative_velocity": ("1", None),
    "passage.rim": ("1", None),
    "passage.crowding": ("1", None),
    "passage.drift": ("1", None),
    "passage.levelling": ("1", None),
    "passage.bouncing": ("1", None),
    "segregation.velocity": ("m/s", None),
    "segregation.dilation": ("m", "mm"),
    "segregation.relative_dilation": ("1", None),
    "segregation.relative_velocity": ("1", None),
    "segregation.mixing": ("m/s", None),
    "segregation.proportion": ("1", None),
}
FIXED = {
    **{f"size_class[{i}].{limit}": ("m", "mm") for i in FRACTIONS for limit in ("lower", "upper")},
    "deck[1].width": ("m", None),
    "deck[1].panel[1].length": ("m", None),
    "deck[1].panel[1].aperture": ("m", "mm"),
    "deck[1].panel[1].slot_length": ("m", "mm"),
    "deck[1].panel[1].thickness": ("m", "mm"),
    "deck[1].panel[1].relative_thickness": ("1", None),
    "material.bulk_density": ("kg/m3", "t/m3"),
    "bed.contact_depth": ("m", "mm"),
    "bed.layer_depth": ("m", "mm"),
    "bed.relative_contact_depth": ("1", None),
    "bed.relative_layer_depth": ("1", None),
    "drive.vibrating_mass": ("kg", "t"),
    "drive.bearing_friction": ("1", None),
    "drive.bearing_diameter": ("m", "mm"),
    "drive.efficiency": ("1", None),
    "solver.tolerance": ("1", None),
}
CHOICES = {
    "deck[1].panel[1].opening": ["square", "slot", "round", "slot_across"],
    "passage.law": ["gaudin", "pelevin", "bounce"],
    "segregation.model": ["well_mixed", "proportional", "exchange", "classified"],
    "displacement.model": ["prescribed", "rigid_body", "bed"],
    "bed.initial": ["empty", "steady"],
}
CONSTANT = "size_classes.subdivision"
# What the double-deck screen has besides; its top deck has two panels, the lower one has one.
BELOW = {
    **stream_of("intermediate[1]"),
    "intermediate[1].mass": ("kg", "t"),
    "intermediate[1].p80": ("m", "mm"),
    "intermediate[1].p50": ("m", "mm"),
    **figures_of_deck(2),
}
# Factor from the unit to its display unit.
DISPLAY = {
    "t/h": 3.6,
    "t": 0.001,
    "mm": 1000.0,
    "deg": 180.0 / np.pi,
    "1/min": 60.0,
    "t/m3": 0.001,
    "kW": 0.001,
    "kN": 0.001,
}
# A plain feed of the default classes.
EVEN = dict.fromkeys((f"feed.mass_fraction[{i}]" for i in FRACTIONS), 1.0 / N)


REFERENCE = "extra/org.fmi-standard.fmi-ls-ref/"


class Instance:
    """A running instance that is spoken to by names and keeps what it logs."""

    def __init__(self, folder: Path, description: ModelDescription) -> None:
        self.variables = {v.name: v for v in description.modelVariables}
        self.log: list[tuple[int, str, str]] = []
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._note)
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        self.slave = fmi2.FMU2Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="screen",
        )
        self.time = 0.0
        self.slave.instantiate(callbacks=callbacks, loggingOn=True)

    def _note(
        self, _: object, __: bytes, status: int, category: bytes | None, message: bytes
    ) -> None:
        self.log.append((status, (category or b"").decode(), message.decode()))

    def start(self) -> None:
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def references(self, names: Sequence[str]) -> list[int]:
        return [self.variables[name].valueReference for name in names]

    def set(self, values: Mapping[str, float]) -> None:
        self.slave.setReal(self.references(list(values)), list(values.values()))

    def get(self, names: Sequence[str]) -> list[float]:
        return self.slave.getReal(self.references(names))

    def step(self, duration: float) -> None:
        self.slave.doStep(self.time, duration)
        self.time += duration

    @property
    def state(self) -> bytes:
        state = self.slave.getFMUstate()
        blob: bytes = self.slave.serializeFMUstate(state)
        self.slave.freeFMUstate(state)
        return blob

    @state.setter
    def state(self, blob: bytes) -> None:
        state = self.slave.deSerializeFMUstate(blob)
        try:
            self.slave.setFMUstate(state)
        finally:
            self.slave.freeFMUstate(state)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmu")


@pytest.fixture(scope="session")
def fmu(folder: Path) -> Path:
    return build_fmu.build(ScreenConfig.default(), folder, "python")


@pytest.fixture(scope="session")
def description(fmu: Path) -> ModelDescription:
    return read_model_description(str(fmu))


@pytest.fixture(scope="session")
def unzipped(fmu: Path) -> Iterator[Path]:
    place = Path(extract(str(fmu)))
    yield place
    shutil.rmtree(place)


@pytest.fixture(scope="session")
def two_decks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU of the double-deck screen."""
    config = ScreenConfig.load(SCREENS / "two_deck.toml")
    return build_fmu.build(config, tmp_path_factory.mktemp("two_decks"), "python")


@pytest.fixture
def lower(two_decks: Path, tmp_path: Path) -> Iterator[Instance]:
    """An instance of the double-deck screen that has started."""
    place = Path(extract(str(two_decks), unzipdir=str(tmp_path / "unzipped")))
    instance = Instance(place, read_model_description(str(two_decks)))
    instance.start()
    yield instance
    instance.slave.freeInstance()
    shutil.rmtree(place)


@pytest.fixture
def make(unzipped: Path, description: ModelDescription) -> Iterator[Callable[[], Instance]]:
    """Makes instances and frees them at the end."""
    made: list[Instance] = []

    def make_one() -> Instance:
        made.append(Instance(unzipped, description))
        return made[-1]

    yield make_one
    for instance in made:
        instance.slave.freeInstance()


@pytest.fixture
def screen(make: Callable[[], Instance]) -> Instance:
    """An instance that has started."""
    instance = make()
    instance.start()
    return instance


def variable(description: ModelDescription, name: str) -> ScalarVariable:
    return next(v for v in description.modelVariables if v.name == name)


# --- the contract --------------------------------------------------------------------------------
def test_fmpy_finds_no_problem(fmu: Path) -> None:
    assert validate_fmu(str(fmu)) == []


def test_variables_are_those_of_the_contract(description: ModelDescription) -> None:
    expected = {
        *((name, "input", "continuous", "Real") for name in INPUTS),
        *((name, "output", "continuous", "Real") for name in REAL_OUTPUTS),
        *((name, "output", "discrete", "Boolean") for name in ALARMS),
        *((name, "parameter", "tunable", "Real") for name in TUNABLE),
        *((name, "parameter", "fixed", "Real") for name in FIXED),
        *((name, "parameter", "fixed", "Enumeration") for name in CHOICES),
        (CONSTANT, "local", "constant", "Integer"),
    }
    found = {(v.name, v.causality, v.variability, v.type) for v in description.modelVariables}
    assert found == expected


def test_units_are_those_of_the_contract(description: ModelDescription) -> None:
    units = {
        v.name: (v.unit, v.displayUnit) for v in description.modelVariables if v.type == "Real"
    }
    assert units == INPUTS | REAL_OUTPUTS | TUNABLE | FIXED
    for unit in description.unitDefinitions:
        for display in unit.displayUnits:
            assert display.factor == pytest.approx(DISPLAY[display.name], rel=1e-15), display.name


def test_base_units(description: ModelDescription) -> None:
    base = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
    assert (base["kg/s"].kg, base["kg/s"].s) == (1, -1)
    assert (base["W"].kg, base["W"].m, base["W"].s) == (1, 2, -3)
    assert (base["kg/m3"].kg, base["kg/m3"].m) == (1, -3)
    assert base["rad"].rad == 1
    assert base["Hz"].s == -1


def test_choices_start_at_one_in_the_order_of_the_contract(description: ModelDescription) -> None:
    for name, items in CHOICES.items():
        kind = variable(description, name).declaredType
        assert [item.name for item in kind.items] == items
        assert [int(item.value) for item in kind.items] == list(range(1, len(items) + 1))
        assert all(item.description for item in kind.items)


def test_start_values_are_the_configuration(description: ModelDescription) -> None:
    config = ScreenConfig.default()
    panel = config.decks[0].panels[0]
    for name, value in {
        "feed.mass_flow_rate": config.feed.mass_flow_rate,
        "motion.frequency": config.motion.frequency,
        "motion.amplitude": config.motion.amplitude,
        "motion.throw_angle": config.motion.throw_angle,
        "material.bulk_density": config.material.bulk_density,
        "deck[1].panel[1].length": panel.length,
        "deck[1].panel[1].aperture": panel.aperture,
        "deck[1].panel[1].inclination": panel.inclination,
        "bed.layer_depth": 0.0,
        "bed.relative_layer_depth": 1.0,
        "solver.tolerance": config.solver.tolerance,
        **{f"feed.mass_fraction[{i}]": config.feed.mass_fraction[i - 1] for i in FRACTIONS},
        **{f"size_class[{i}].lower": config.size_classes.edges[i - 1] for i in FRACTIONS},
        **{f"size_class[{i}].upper": config.size_classes.edges[i] for i in FRACTIONS},
    }.items():
        assert float(variable(description, name).start) == value, name
    assert variable(description, "passage.law").start == "2"
    assert variable(description, "displacement.model").start == "3"
    assert variable(description, "bed.initial").start == "1"
    assert variable(description, CONSTANT).start == "0"


def test_outputs_depend_on_nothing_of_the_same_instant(description: ModelDescription) -> None:
    names = set(REAL_OUTPUTS) | set(ALARMS)
    for unknowns in (description.outputs, description.initialUnknowns):
        assert {unknown.variable.name for unknown in unknowns} == names
        assert all(unknown.dependencies == [] for unknown in unknowns)


def test_capabilities_and_experiment(description: ModelDescription) -> None:
    kind = description.coSimulation
    assert kind.modelIdentifier == description.modelName == "VibratingScreen"
    assert kind.needsExecutionTool
    assert kind.canHandleVariableCommunicationStepSize
    assert kind.canGetAndSetFMUstate
    assert kind.canSerializeFMUstate
    assert not kind.canBeInstantiatedOnlyOncePerProcess
    assert not kind.canInterpolateInputs
    assert description.variableNamingConvention == "structured"
    experiment = description.defaultExperiment
    assert float(experiment.startTime) == 0.0
    assert float(experiment.stopTime) == 600.0
    assert float(experiment.stepSize) == 1.0
    assert float(experiment.tolerance) == ScreenConfig.default().solver.tolerance
    assert description.version == vibroscreen.__version__
    assert description.author == "the vibroscreen authors"
    assert description.author in (ROOT / "LICENSE").read_text()
    assert description.copyright == f"Copyright (c) 2026 {description.author}"
    assert description.license == "MIT"
    assert "logStatusError" in {category.name for category in description.logCategories}


# --- the file ------------------------------------------------------------------------------------
def test_two_builds_are_the_same_bytes(fmu: Path, tmp_path: Path) -> None:
    again = write_fmu(ScreenConfig.default(), tmp_path / "deep" / "folder")
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(fmu.read_bytes()).digest()


def test_the_guid_follows_the_contract_alone(
    fmu: Path, description: ModelDescription, tmp_path: Path
) -> None:
    config = ScreenConfig.default()
    one_more = SizeClasses((*config.size_classes.edges, 0.1))
    other = write_fmu(ScreenConfig(one_more), tmp_path)
    assert read_model_description(str(other)).guid != description.guid
    same = write_fmu(config, tmp_path)
    assert read_model_description(str(same)).guid == description.guid


def test_what_lies_in_the_file(fmu: Path) -> None:
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
        requirements = archive.read("resources/requirements.txt").decode()
        page = etree.HTML(archive.read("documentation/index.html"))
        picture = archive.read("model.png")
    assert names == sorted(names)
    assert not [name for name in names if name.startswith(("/", "./")) or "\\" in name]
    assert [line.partition(">")[0] for line in requirements.split()] == ["numpy"]
    assert "pythonfmu" not in requirements
    assert picture.startswith(b"\x89PNG")
    text = " ".join(page.itertext())
    for name in (*INPUTS, *REAL_OUTPUTS, *ALARMS, *TUNABLE, *FIXED, *CHOICES, CONSTANT):
        assert name in text
    for word in (
        "numpy",
        "fmi2Fatal",
        "fmi2Discard",
        "libpython",
        "Licence",
        "t/h",
        "bed.initial = 2",
    ):
        assert word in text


def test_terminals_are_the_streams(fmu: Path, two_decks: Path) -> None:
    schema = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
    for path, middle in ((fmu, []), (two_decks, ["intermediate[1]"])):
        with zipfile.ZipFile(path) as archive:
            xml = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            icon = archive.read("terminalsAndIcons/icon.png")
            assert icon == archive.read("model.png")
            for terminal in xml.iter("TerminalGraphicalRepresentation"):
                name = f"terminalsAndIcons/{terminal.attrib['iconBaseName']}.png"
                assert archive.read(name).startswith(b"\x89PNG")
        etree.XMLSchema(etree.parse(str(schema))).assertValid(xml)
        names = {v.name for v in read_model_description(str(path)).modelVariables}
        terminals = {t.attrib["name"]: t for t in xml.iter("Terminal")}
        assert sorted(terminals) == sorted(["feed", "undersize", "oversize", *middle])
        for name, terminal in terminals.items():
            members = [m.attrib for m in terminal.iter("TerminalMemberVariable")]
            assert len(members) == N + 1
            for member in members:
                assert member["variableName"] == f"{name}.{member['memberName']}"
                assert member["variableName"] in names


def test_the_reference_run_is_what_the_fmu_does(fmu: Path, two_decks: Path) -> None:
    for path in (fmu, two_decks):
        with zipfile.ZipFile(path) as archive:
            files = {
                name.removeprefix(REFERENCE): archive.read(name)
                for name in archive.namelist()
                if name.startswith(REFERENCE)
            }
        manifest = etree.fromstring(files.pop("fmi-ls-manifest.xml"))
        related = {r.attrib["source"]: r.attrib for r in manifest.iter("Related")}
        assert related.keys() == files.keys()
        for source, content in files.items():
            assert related[source]["checksum"] == hashlib.sha3_256(content).hexdigest()
        options = dict(
            line.split(", ") for line in files["VibratingScreen_ref.opt"].decode().splitlines()
        )
        given, expected = (
            np.genfromtxt(
                io.BytesIO(files[f"VibratingScreen_{part}.csv"]),
                delimiter=",",
                names=True,
                deletechars="",
                replace_space="",
            )
            for part in ("in", "ref")
        )
        assert set(given.dtype.names) == {"time", *INPUTS}
        outputs = REAL_OUTPUTS | (BELOW if path == two_decks else {})
        assert set(expected.dtype.names) == {"time", *outputs} - {"balance.error"}
        step = float(options["StepSize"])
        result = simulate_fmu(
            str(path),
            stop_time=float(options["StopTime"]),
            step_size=step,
            output_interval=step,
            input=given,
            output=[name for name in expected.dtype.names if name != "time"],
        )
        assert len(result) == len(expected) == 61
        for name in expected.dtype.names:
            np.testing.assert_allclose(
                result[name],
                expected[name],
                rtol=float(options["RelTol"]),
                atol=float(options["AbsTol"]),
                err_msg=name,
            )
        # more is fed, then it is slower: both are seen
        masses = np.diff(expected["feed.mass"][[19, 20, 21]])
        assert masses[1] == pytest.approx(1.2 * masses[0], rel=1e-6)
        assert expected["motion.throw_number"][-1] < expected["motion.throw_number"][0]


def test_the_engine_in_the_file_has_names_of_its_own(fmu: Path) -> None:
    with zipfile.ZipFile(fmu) as archive:
        sources = {
            name: archive.read(name).decode()
            for name in archive.namelist()
            if name.endswith(".py") and name.startswith("resources/vibroscreen")
        }
    assert len(sources) > 15
    for name, text in sources.items():
        for line in text.splitlines():
            words = line.split()
            if words[:1] in (["from"], ["import"]) and words[1].startswith("vibroscreen"):
                package = words[1].partition(".")[0]
                assert f"resources/{package}/__init__.py" in sources, f"{name}: {line}"


def test_names_change_with_what_they_name() -> None:
    package = engine().package
    assert len({name.rpartition("_")[2] for name in package.values()}) == 2
    assert engine().package == package


# --- numbers -------------------------------------------------------------------------------------
def random_inputs(rng: np.random.Generator) -> dict[str, float]:
    """Changes of some inputs, zeros of feed and vibration among them."""
    changes: dict[str, float] = {}
    if rng.random() < 0.5:
        changes["feed.mass_flow_rate"] = float(rng.choice([0.0, 1e-9, 40.0, 90.0, 170.0]))
    if rng.random() < 0.4:
        share = rng.dirichlet(np.full(N, 0.7)) * rng.choice([1.0, 1.0004])
        changes |= {f"feed.mass_fraction[{i}]": float(share[i - 1]) for i in FRACTIONS}
    if rng.random() < 0.3:
        changes["motion.frequency"] = float(rng.choice([0.0, 12.0, 15.5, rng.uniform(8.0, 20.0)]))
    if rng.random() < 0.2:
        changes["motion.amplitude"] = float(rng.choice([0.0, 0.004, 0.005]))
    if rng.random() < 0.1:
        changes["motion.ellipticity"] = float(rng.uniform(-0.5, 0.5))
        changes["motion.throw_angle"] = float(rng.uniform(0.5, 1.2))
    return changes


def engine_place(name: str) -> tuple[str, int]:
    """Field and index of an input in the engine's buffer."""
    if name.startswith("feed.mass_fraction["):
        return "fraction", int(name[len("feed.mass_fraction[") : -1]) - 1
    return "input", state.INPUT.index(name.replace(".", "_"))


def test_streams_are_those_of_the_engine_bit_for_bit(screen: Instance) -> None:
    plain = Screen(ScreenConfig.default())
    rng = np.random.default_rng(1)
    conveyed = 0
    for _ in range(1000):
        changes = random_inputs(rng)
        if changes:
            screen.set(changes)
        for name, value in changes.items():
            field, index = engine_place(name)
            plain.view(field)[index] = value
        duration = float(10.0 ** rng.uniform(np.log10(0.05), np.log10(60.0)))
        screen.step(duration)
        plain.advance(duration)
        output = plain.record("output")
        expected = [
            output.undersize_rate,
            *plain.view("undersize_fraction"),
            output.oversize_rate,
            *plain.view("oversize_fraction"),
        ]
        assert screen.get(list(STREAMS)) == expected
        conveyed += output.oversize_rate > 0.0
    assert 200 < conveyed < 1000
    scalars = ["bed.hold_up", "drive.power", "undersize.mass", "balance.error"]
    result = plain.result()
    expected = [
        result.hold_up,
        result.drive_power,
        plain.record("output").undersize_mass,
        result.balance_error,
    ]
    assert screen.get(scalars) == expected


# --- several decks and panels --------------------------------------------------------------------
def test_variables_of_two_decks(two_decks: Path) -> None:
    assert validate_fmu(str(two_decks)) == []
    description = read_model_description(str(two_decks))
    panels = {
        f"deck[{deck}].{name.partition('.')[2].replace('panel[1]', f'panel[{panel}]')}": unit
        for deck, panel in ((1, 1), (1, 2), (2, 1))
        for name, unit in (TUNABLE | FIXED).items()
        if name.startswith("deck[1]")
    }
    expected = INPUTS | REAL_OUTPUTS | BELOW | TUNABLE | FIXED | panels
    real = [v for v in description.modelVariables if v.type == "Real"]
    assert {v.name: (v.unit, v.displayUnit) for v in real} == expected
    outputs = {unknown.variable.name for unknown in description.outputs}
    assert outputs == {*REAL_OUTPUTS, *BELOW, *ALARMS}
    for unknowns in (description.outputs, description.initialUnknowns):
        assert len(unknowns) == len(outputs)
        assert all(unknown.dependencies == [] for unknown in unknowns)
    places = [v.valueReference for v in description.modelVariables]
    assert places == sorted(set(places))
    # the lower deck's second panel is not there: nine references are skipped
    assert places[-1] == len(places) - 1 + 9
    starts = {v.name: float(v.start) for v in real if v.start is not None}
    assert starts["deck[1].panel[1].open_area"] == 0.40
    assert starts["deck[1].panel[2].open_area"] == 0.62
    assert starts["deck[2].panel[1].aperture"] == pytest.approx(8 * MM, rel=1e-15)


def test_the_page_tells_of_decks(two_decks: Path) -> None:
    with zipfile.ZipFile(two_decks) as archive:
        text = " ".join(etree.HTML(archive.read("documentation/index.html")).itertext())
    for name in BELOW:
        assert name in text
    assert "31.5 mm over 2.4 x 6 m at 8 mm" in text


def test_what_no_panel_fills_is_no_variable(lower: Instance) -> None:
    place = lower.references(["deck[2].panel[1].relative_thickness"])[0]
    for references in ([place + 1], [place, place + 1], list(range(place, place + 8))):
        with pytest.raises(FMICallException, match=FATAL):
            lower.slave.getReal(references)
        assert f"value reference {place + 1} is no variable" in lower.log[-2][2]
    with pytest.raises(FMICallException, match=FATAL):
        lower.slave.setReal([place + 1], [1.0])


def test_two_decks_are_those_of_the_engine_bit_for_bit(lower: Instance) -> None:
    plain = Screen(ScreenConfig.load(SCREENS / "two_deck.toml"))
    rng = np.random.default_rng(2)
    names = list(REAL_OUTPUTS | BELOW)
    flowing = 0
    for _ in range(100):
        changes = random_inputs(rng)
        for name, value in changes.items():
            field, index = engine_place(name)
            plain.view(field)[index] = value
        # tunable: parts of every panel blind
        for deck, panel in ((1, 1), (1, 2), (2, 1)):
            if rng.random() < 0.1:
                area = float(rng.uniform(0.2, 0.6))
                changes[f"deck[{deck}].panel[{panel}].open_area"] = area
                plain.record("panel")[deck - 1, panel - 1].open_area = area
        if changes:
            lower.set(changes)
        duration = float(10.0 ** rng.uniform(np.log10(0.05), np.log10(60.0)))
        lower.step(duration)
        plain.advance(duration)
        found = dict(zip(names, lower.get(names), strict=True))
        result, output = plain.result(), plain.record("output")
        expected = {
            "undersize.mass_flow_rate": result.undersize.mass_flow_rate,
            "oversize.mass_flow_rate": result.oversize.mass_flow_rate,
            "intermediate[1].mass_flow_rate": result.intermediate[0].mass_flow_rate,
            "intermediate[1].mass": float(plain.record("intermediate")[0].mass),
            "bed.hold_up": result.hold_up,
            "drive.power": result.drive_power,
            "performance.undersize_recovery": result.undersize_recovery,
            "performance.efficiency": result.efficiency,
            "performance.cut_size": result.cut_size,
            "balance.error": result.balance_error,
        }
        for stream, fractions in (
            ("undersize", result.undersize.mass_fraction),
            ("oversize", result.oversize.mass_fraction),
            ("intermediate[1]", result.intermediate[0].mass_fraction),
        ):
            expected |= {f"{stream}.mass_fraction[{i}]": fractions[i - 1] for i in FRACTIONS}
        for deck, of_deck in enumerate(result.decks, start=1):
            for figure in DECK:
                expected[f"deck[{deck}].{figure.name}"] = getattr(of_deck, figure.scalar)
        assert {name: found[name] for name in expected} == expected
        # nothing is lost between the decks
        fed = found["feed.mass"]
        assert fed == output.feed_mass
        gone = sum(found[f"{s}.mass"] for s in ("undersize", "oversize", "intermediate[1]"))
        assert gone + found["bed.hold_up"] == pytest.approx(fed, rel=1e-12, abs=1e-9)
        held = found["deck[1].bed.hold_up"] + found["deck[2].bed.hold_up"]
        assert held == pytest.approx(found["bed.hold_up"], rel=1e-12, abs=1e-12)
        flowing += found["intermediate[1].mass_flow_rate"] > 0.0
    assert 20 < flowing < 100


def test_a_state_of_two_decks_continues_bit_for_bit(lower: Instance) -> None:
    def go_on() -> list[list[float]]:
        outputs = []
        for frequency in (15.5, 0.0, 12.0, 15.5):
            lower.set({"motion.frequency": frequency})
            lower.step(7.0)
            outputs.append(lower.get(list(REAL_OUTPUTS | BELOW)))
        return outputs

    lower.step(20.0)
    blob, expected = lower.state, go_on()
    lower.state = blob
    assert go_on() == expected


def test_fixed_parameters_of_the_lower_deck(two_decks: Path, tmp_path: Path) -> None:
    place = Path(extract(str(two_decks), unzipdir=str(tmp_path / "unzipped")))
    instance = Instance(place, read_model_description(str(two_decks)))
    lengths = {
        "deck[1].panel[1].length": 1.0,
        "deck[1].panel[2].length": 4.0,
        "deck[2].panel[1].length": 5.0,
        "deck[2].panel[1].aperture": 10 * MM,
    }
    instance.set(lengths)
    instance.start()
    for _ in range(3):
        instance.step(20.0)
    config = ScreenConfig.load(SCREENS / "two_deck.toml")
    top, low = config.decks
    first, second = top.panels
    shorter = config.replace(
        decks=(
            replace(top, panels=(replace(first, length=1.0), replace(second, length=4.0))),
            replace(low, panels=(replace(low.panels[0], length=5.0, aperture=10 * MM),)),
        )
    )
    plain = Screen(shorter)
    for _ in range(3):
        plain.advance(20.0)
    names = [f"{s}.mass_flow_rate" for s in ("undersize", "oversize", "intermediate[1]")]
    result = plain.result()
    assert instance.get(names) == [
        result.undersize.mass_flow_rate,
        result.oversize.mass_flow_rate,
        result.intermediate[0].mass_flow_rate,
    ]
    # and decks that are not equally long are refused by name
    instance.slave.reset()
    instance.set({"deck[2].panel[1].length": 5.0})
    with pytest.raises(FMICallException, match=FATAL):
        instance.start()
    assert "deck[2].panel[1].length: this deck is 5 m long, deck[1] is 6 m" in instance.log[0][2]
    instance.slave.freeInstance()
    shutil.rmtree(place)


# --- the life of an instance ---------------------------------------------------------------------
def test_outputs_hold_when_initialisation_ends(screen: Instance) -> None:
    rates = screen.get(["undersize.mass_flow_rate", "oversize.mass_flow_rate", "bed.hold_up"])
    assert rates == [0.0, 0.0, 0.0]
    feed = screen.get([f"feed.mass_fraction[{i}]" for i in FRACTIONS])
    assert screen.get([f"undersize.mass_fraction[{i}]" for i in FRACTIONS]) == feed
    throw, velocity = screen.get(["motion.throw_number", "bed.transport_velocity"])
    assert throw > 1.0
    assert velocity > 0.0
    assert screen.slave.getBoolean(screen.references(ALARMS)) == [False] * len(ALARMS)
    # and they change with nothing but a step
    before = screen.get(list(REAL_OUTPUTS))
    screen.set({"feed.mass_flow_rate": 20.0, "motion.frequency": 12.0})
    assert screen.get(list(REAL_OUTPUTS)) == before
    screen.step(1.0)
    assert screen.get(list(REAL_OUTPUTS)) != before


def test_values_come_back_in_any_order(screen: Instance) -> None:
    names = ["solver.tolerance", "feed.mass_fraction[3]", "deck[1].width", "motion.frequency"]
    assert screen.get(names) == screen.get(names[::-1])[::-1]
    screen.set({"motion.frequency": 14.0, "feed.mass_fraction[3]": 0.25, "feed.mass_flow_rate": 1})
    assert screen.get(names)[1::2] == [0.25, 14.0]
    for k in range(600):  # more lists than are remembered
        first = k % len(names)
        assert len(screen.get(names[first:] + names[: k // 4])) == len(names[first:]) + len(
            names[: k // 4]
        )


# --- parameters ----------------------------------------------------------------------------------
def run_engine(config: ScreenConfig) -> list[float]:
    plain = Screen(config)
    for _ in range(3):
        plain.advance(20.0)
    return [
        float(plain.record("output").undersize_rate),
        *plain.view("undersize_fraction").tolist(),
    ]


UNDERSIZE = [name for name in STREAMS if name.startswith("undersize")]


def run_instance(instance: Instance) -> list[float]:
    for _ in range(3):
        instance.step(20.0)
    return instance.get(UNDERSIZE)


def test_fixed_parameters_count_from_initialisation_on(make: Callable[[], Instance]) -> None:
    config = ScreenConfig.default()
    instance = make()
    edges = list(config.size_classes.edges)
    edges[7] = 17 * MM  # a limit beside the aperture of 12 mm breaks no class
    instance.set(
        {
            "deck[1].panel[1].aperture": 12 * MM,
            "deck[1].width": 2.0,
            "size_class[7].upper": edges[7],
            "size_class[8].lower": edges[7],
            "segregation.relative_velocity": 0.05,
        }
    )
    choices = instance.references(["passage.law", "bed.initial"])
    instance.slave.setInteger(choices, [1, 2])
    instance.start()
    assert instance.slave.getInteger(choices) == [1, 2]
    assert instance.get(["bed.hold_up"])[0] > 0.0
    text = config.to_toml()
    for old, new in (
        ("aperture_mm = 16.0", "aperture_mm = 12.0"),
        ("width_m = 2.4", "width_m = 2.0"),
        ("11.2, 16.0, 22.4", "11.2, 17.0, 22.4"),
        ('[segregation]\nmodel = "exchange"', "[segregation]\nrelative_velocity = 0.05"),
        ('law = "pelevin"', 'law = "gaudin"'),
        ('initial = "empty"', 'initial = "steady"'),
    ):
        assert old in text
        text = text.replace(old, new)
    # The sizes inside the classes are those of the fixed parameters, whatever is tuned at the start.
    wanted = run_engine(ScreenConfig.loads(text))
    assert run_instance(instance) == pytest.approx(wanted, rel=1e-3, abs=1e-9)


def test_tunable_parameters_count_from_the_next_step_on(screen: Instance) -> None:
    plain = Screen(ScreenConfig.default())
    for open_area in (0.55, 0.3, 0.6):
        screen.set({"deck[1].panel[1].open_area": open_area})
        plain.record("panel")[0, 0].open_area = open_area
        screen.step(30.0)
        plain.advance(30.0)
        assert (
            screen.get(["undersize.mass_flow_rate"])[0] == plain.result().undersize.mass_flow_rate
        )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"deck[1].panel[1].aperture": 16.0}, r"deck[1].panel[1].aperture = 16 m is out of range"),
        ({"deck[1].panel[1].inclination": 0.9}, "deck[1].panel[1].inclination = 0.9 rad"),
        ({"size_class[3].upper": 3 * MM}, "set both to the same"),
        ({"feed.mass_flow_rate": -1.0}, "feed.mass_flow_rate = -1 kg/s"),
    ],
)
def test_bad_starts_are_refused_by_name(
    make: Callable[[], Instance], values: dict[str, float], message: str
) -> None:
    instance = make()
    instance.set(values)
    with pytest.raises(FMICallException, match=FATAL):
        instance.start()
    assert message in instance.log[0][2]


def test_a_rigid_body_that_would_run_away_is_refused(make: Callable[[], Instance]) -> None:
    instance = make()
    instance.set({"deck[1].panel[1].inclination": 0.6, "deck[1].width": 2.0})
    instance.slave.setInteger(instance.references(["displacement.model"]), [2])
    with pytest.raises(FMICallException, match=FATAL):
        instance.start()
    assert "a rigid body would run away" in instance.log[0][2]


# --- the tolerance of the host -------------------------------------------------------------------
TOLERANCES = ["solver.tolerance"]


@pytest.mark.parametrize("tolerance", [1e-9, 1e-3, 1e-1])
def test_the_tolerance_of_the_host_is_the_solvers(
    make: Callable[[], Instance], tolerance: float
) -> None:
    instance = make()
    instance.slave.setupExperiment(tolerance=tolerance, startTime=0.0)
    assert instance.get(TOLERANCES) == [tolerance]
    instance.slave.enterInitializationMode()
    instance.slave.exitInitializationMode()
    assert instance.log == []
    if tolerance == 1e-3:
        coarse = run_engine(ScreenConfig.default().replace(solver=Solver(tolerance=tolerance)))
        assert run_instance(instance) == coarse != run_engine(ScreenConfig.default())


@pytest.mark.parametrize("tolerance", [5.0, 0.0, -1e-4, 1e-10, np.nan, np.inf])
def test_a_tolerance_outside_of_the_limits_is_told_of(
    make: Callable[[], Instance], tolerance: float
) -> None:
    instance = make()
    instance.slave.setupExperiment(tolerance=tolerance, startTime=0.0)
    assert instance.log == [
        (
            fmi2.fmi2Warning,
            "logStatusWarning",
            f"tolerance = {tolerance:g} is outside of the limits of solver.tolerance, which stays "
            "0.0001: give one within 1e-09 and 0.1",
        )
    ]
    assert instance.get(TOLERANCES) == [1e-4]
    instance.slave.enterInitializationMode()
    instance.slave.exitInitializationMode()
    instance.step(1.0)


def test_what_is_set_after_the_tolerance_counts(make: Callable[[], Instance]) -> None:
    instance = make()
    instance.slave.setupExperiment(tolerance=1e-3, startTime=0.0)
    instance.set({"solver.tolerance": 1e-5})
    instance.slave.enterInitializationMode()
    instance.slave.exitInitializationMode()
    assert instance.get(TOLERANCES) == [1e-5]
    # none given: it stays
    instance.slave.reset()
    instance.set({"solver.tolerance": 1e-5})
    instance.start()
    assert instance.get(TOLERANCES) == [1e-5]


def test_an_unknown_choice_is_refused(make: Callable[[], Instance]) -> None:
    instance = make()
    instance.slave.setInteger(instance.references(["segregation.model"]), [5])
    with pytest.raises(FMICallException, match=FATAL):
        instance.start()
    assert "segregation.model = 5 is out of range (1 to 4): give 1 well_mixed" in instance.log[0][2]


# --- refusals ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"feed.mass_flow_rate": -5.0}, "feed.mass_flow_rate = -5 kg/s"),
        ({"feed.mass_flow_rate": np.nan}, "feed.mass_flow_rate = nan kg/s is not a finite number"),
        ({**EVEN, "feed.mass_fraction[3]": 1.2}, "feed.mass_fraction[3] = 1.2"),
        ({**EVEN, "feed.mass_fraction[3]": np.inf}, "feed.mass_fraction[3] = inf"),
        ({**EVEN, "feed.mass_fraction[3]": 0.2}, "feed.mass_fraction sums to 1.11667"),
        ({"motion.frequency": -1.0}, "motion.frequency = -1 Hz"),
        ({"motion.amplitude": 5.0}, "motion.amplitude = 5 m"),
        ({"deck[1].panel[1].inclination": 0.9}, "deck[1].panel[1].inclination = 0.9 rad"),
        ({"material.friction_deck": np.nan}, "material.friction_deck = nan"),
    ],
)
def test_a_refused_step_is_logged_and_changes_nothing(
    screen: Instance, values: dict[str, float], words: str
) -> None:
    screen.step(30.0)
    good = dict(zip(values, screen.get(list(values)), strict=True))
    before = screen.state
    screen.set(values)
    for _ in range(3):
        with pytest.raises(FMICallException, match=DISCARD):
            screen.step(1.0)
    # a line for each, and none without a category: that ends OMSimulator
    assert [line[:2] for line in screen.log] == [(fmi2.fmi2Error, "logStatusError")] * 3
    for _, _, message in screen.log:
        assert message.startswith(words)
        assert ": " in message
        assert "%" not in message
    screen.set(good)
    assert screen.state == before
    screen.step(1.0)


NO_TIME = [(dt, "is not a finite positive time") for dt in (0.0, -1.0, np.nan, np.inf, 5e-324)]


@pytest.mark.parametrize(
    ("duration", "words"), [*NO_TIME, (1e150, "is more than 1e+09 s: take shorter steps")]
)
def test_a_step_of_no_time_or_for_ever_is_refused(
    screen: Instance, duration: float, words: str
) -> None:
    before = screen.state
    with pytest.raises(FMICallException, match=DISCARD):
        screen.slave.doStep(0.0, duration)
    ((_, category, message),) = screen.log
    assert category == "logStatusError"
    assert words in message
    assert screen.state == before


def test_steps_before_the_start_and_after_the_end_are_refused(make: Callable[[], Instance]) -> None:
    instance = make()
    with pytest.raises(FMICallException, match=DISCARD):
        instance.step(1.0)
    instance.start()
    instance.step(1.0)
    before = instance.state
    instance.slave.terminate()
    with pytest.raises(FMICallException, match=DISCARD):
        instance.step(1.0)
    words = "a step before initialisation has ended or after the end"
    assert [line[1:] for line in instance.log] == [
        ("logStatusError", line[2]) for line in instance.log if line[2].startswith(words)
    ]
    assert len(instance.log) == 2
    instance.slave.reset()
    instance.time = 0.0
    instance.start()
    instance.step(1.0)
    assert instance.state == before


ENDS_EARLY = """
import numpy as np
from fmpy import simulate_fmu

feed = np.array(
    [(0.0, 80.0), (4.5, 80.0), (5.0, -3.0), (9.0, -3.0)],
    dtype=[("time", float), ("feed.mass_flow_rate", float)],
)
run = simulate_fmu(
    sys.argv[1],
    stop_time=9.0,
    step_size=1.0,
    output_interval=1.0,
    input=feed,
    debug_logging=sys.argv[2] == "log",
)
print("ended at", run["time"][-1])
"""


def test_simulate_fmu_of_fmpy_ends_early_without_an_exception(fmu: Path) -> None:
    """As the page says; the message is there for those who switch logging on."""
    said = "[ERROR] feed.mass_flow_rate = -3 kg/s is out of range (0 to 5000 kg/s): "
    loud, silent = (run_python(ENDS_EARLY, fmu, log) for log in ("log", "no log"))
    assert loud[-1] == silent[-1] == "ended at 5.0"
    assert len([line for line in loud if line.startswith(said)]) == 1
    assert not [line for line in silent if "is out of range" in line]


def test_the_last_successful_time_is_that_of_the_last_step(screen: Instance) -> None:
    """pythonfmu's library keeps it, so a state that is set does not take it back: the page says."""

    def time() -> float:
        return screen.slave.getRealStatus(fmi2.fmi2LastSuccessfulTime)

    screen.step(1.0)
    kept = screen.slave.getFMUstate()
    screen.step(20.0)
    screen.slave.setFMUstate(kept)
    screen.slave.freeFMUstate(kept)
    assert time() == 21.0
    screen.slave.doStep(1.0, 1.0)
    assert time() == 2.0
    with pytest.raises(FMICallException, match=DISCARD):
        screen.slave.doStep(2.0, -1.0)
    assert time() == 2.0


def test_the_efficiency_stays_without_feed_and_is_never_nan(screen: Instance) -> None:
    efficiency = ["performance.efficiency"]
    screen.set({"feed.mass_flow_rate": 0.0})
    screen.step(5.0)
    assert screen.get(efficiency) == [0.0]
    screen.set({"feed.mass_flow_rate": 80.0})
    screen.step(60.0)
    (running,) = screen.get(efficiency)
    assert 0.5 < running < 1.0
    screen.set({"feed.mass_flow_rate": 0.0})
    screen.step(5.0)
    assert screen.get(efficiency) == [running]
    # fed with what cannot pass: there is nothing to be efficient about
    coarse = dict.fromkeys(EVEN, 0.0) | {f"feed.mass_fraction[{N}]": 1.0}
    screen.set({"feed.mass_flow_rate": 80.0, **coarse})
    screen.step(5.0)
    assert screen.get(efficiency) == [running]


def test_alarms_that_come_on_are_told_once_with_their_reason(screen: Instance) -> None:
    """A bed that gets deep, stays so, gets thin, and deep again; frequency beyond what is built."""

    def told() -> list[tuple[int, str, str]]:
        warned = [line for line in screen.log if line[1] == "logStatusWarning"]
        screen.log.clear()
        return [line for line in warned if not line[2].startswith("alarm.performance")]

    screen.step(60.0)
    assert told() == []
    for rate, lines in ((300.0, 1), (300.0, 0), (60.0, 0), (300.0, 1)):
        screen.set({"feed.mass_flow_rate": rate})
        screen.step(60.0)
        found = told()
        assert len(found) == lines
        for status, _, message in found:
            assert status == fmi2.fmi2Warning
            assert re.match(r"alarm\.bed_depth: the bed of deck 1 is 0\.\d+ m deep", message)
            assert "more than 5 apertures (0.08 m): feed less" in message
    screen.set({"feed.mass_flow_rate": 60.0, "motion.frequency": 25.0})
    screen.step(1.0)
    found = [line[2] for line in told()]
    assert found[0].startswith("alarm.transport: the throw number of deck 1 is 8.927, above 4.5")
    assert found[1].startswith("alarm.plausibility: K = 12.58")


def test_a_start_in_the_steady_state_has_its_efficiency(make: Callable[[], Instance]) -> None:
    instance = make()
    instance.slave.setInteger(instance.references(["bed.initial"]), [2])
    instance.start()
    names = ["performance.efficiency", "performance.undersize_recovery"]
    steady = Screen(ScreenConfig.default()).solve_steady()
    # one deck: what passes it is the undersize
    assert instance.get(names) == pytest.approx([steady.efficiency] * 2, abs=1e-4)


def test_fractions_do_not_matter_without_feed(screen: Instance) -> None:
    screen.set({"feed.mass_flow_rate": 0.0, "feed.mass_fraction[1]": np.nan})
    screen.step(5.0)
    assert screen.get(["undersize.mass"]) == [0.0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda s: s.set({"deck[1].width": 2.0}),
            "deck[1].width is a fixed parameter of a model that runs",
        ),
        (lambda s: s.set({"bed.hold_up": 2.0}), "bed.hold_up is not an input or a parameter"),
        (lambda s: s.slave.setReal([10_000], [1.0]), "value reference 10000 is no variable"),
        (lambda s: s.slave.getReal([10_000]), "value reference 10000 is no variable"),
        (lambda s: s.set({"passage.law": 1.0}), "passage.law is of type Enumeration"),
        (
            lambda s: s.slave.getBoolean(s.references(["passage.law"])),
            "passage.law is of type Enumeration",
        ),
        (
            lambda s: s.slave.setInteger(s.references([CONSTANT]), [1]),
            "size_classes.subdivision is not an input or a parameter",
        ),
        (
            lambda s: s.slave.setInteger(s.references(["passage.law"]), [1]),
            "passage.law is a fixed parameter",
        ),
        (
            lambda s: s.slave.setBoolean(s.references(["alarm.capacity"]), [True]),
            "alarm.capacity is not an input",
        ),
        (lambda s: s.slave.getString([0]), "material.bulk_density is of type Real"),
        (lambda s: s.slave.setString([0], ["x"]), "material.bulk_density is of type Real"),
    ],
)
def test_bad_calls_are_refused(
    screen: Instance, call: Callable[[Instance], object], message: str
) -> None:
    before = screen.state
    for _ in range(3):
        with pytest.raises(FMICallException, match=FATAL):
            call(screen)
    assert message in screen.log[0][2]
    assert screen.state == before
    screen.step(1.0)


def test_a_reset_starts_anew(screen: Instance) -> None:
    before = screen.state
    screen.set({"motion.frequency": 10.0})
    screen.step(50.0)
    screen.slave.reset()
    screen.set({"deck[1].width": 2.4})
    screen.start()
    assert screen.state == before


# --- state ---------------------------------------------------------------------------------------
def play(instance: Instance, seed: int, steps: int = 20) -> list[list[float]]:
    rng = np.random.default_rng(seed)
    outputs = []
    for _ in range(steps):
        changes = random_inputs(rng)
        if changes:
            instance.set(changes)
        instance.step(float(rng.uniform(0.1, 30.0)))
        outputs.append(instance.get(list(REAL_OUTPUTS)))
    return outputs


def test_a_restored_state_continues_bit_for_bit(
    screen: Instance, make: Callable[[], Instance]
) -> None:
    play(screen, 1)
    kept, blob = screen.slave.getFMUstate(), screen.state
    expected = play(screen, 2)
    screen.slave.setFMUstate(kept)
    assert play(screen, 2) == expected
    screen.slave.freeFMUstate(kept)
    fresh = make()
    fresh.state = blob
    assert play(fresh, 2) == expected


def test_a_state_continues_in_another_process(fmu: Path, screen: Instance, tmp_path: Path) -> None:
    """Bit for bit, from a file."""
    play(screen, 1)
    blob = tmp_path / "state"
    blob.write_bytes(screen.state)
    names = list(STREAMS)
    expected = []
    for frequency in CONTINUED:
        screen.set({"motion.frequency": frequency})
        screen.step(7.0)
        expected.append(" ".join(value.hex() for value in screen.get(names)))
    assert run_python(CONTINUE, fmu, blob, *names) == expected
    assert len(set(expected)) == len(CONTINUED)


def test_a_state_brings_its_fixed_parameters(make: Callable[[], Instance]) -> None:
    first = make()
    first.set({"deck[1].panel[1].aperture": 12 * MM, "deck[1].panel[1].open_area": 0.5})
    first.start()
    play(first, 1)
    blob, expected = first.state, play(first, 2)
    other = make()
    other.start()
    other.state = blob
    assert other.get(["deck[1].panel[1].aperture"]) == [12 * MM]
    assert play(other, 2) == expected
    # it runs: fixed parameters are closed
    with pytest.raises(FMICallException, match=FATAL):
        other.set({"deck[1].panel[1].aperture": 13 * MM})


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda blob: blob[:-8], "cut or changed on the way"),
        (lambda blob: blob[:-1] + bytes([blob[-1] ^ 1]), "cut or changed on the way"),
        (lambda blob: b"", "are no state of a VibratingScreen"),
        (lambda blob: b"x" * 100, "are no state of a VibratingScreen"),
        (lambda blob: blob[:8] + bytes(16) + blob[24:], "another build of the FMU"),
    ],
)
def test_a_spoilt_state_is_refused(
    screen: Instance, spoil: Callable[[bytes], bytes], message: str
) -> None:
    screen.step(10.0)
    before = screen.state
    with pytest.raises(FMICallException, match=FATAL):
        screen.state = spoil(before)
    assert message in screen.log[0][2]
    assert screen.state == before


# --- several instances ---------------------------------------------------------------------------
def test_instances_do_not_touch_each_other(make: Callable[[], Instance]) -> None:
    alone = make()
    alone.start()
    expected = play(alone, 3)
    one, two = make(), make()
    one.start()
    two.start()
    two.set({"deck[1].panel[1].open_area": 0.2})
    rng = np.random.default_rng(3)
    outputs = []
    for _ in range(20):
        changes = random_inputs(rng)
        if changes:
            one.set(changes)
        two.step(7.0)
        one.step(float(rng.uniform(0.1, 30.0)))
        outputs.append(one.get(list(REAL_OUTPUTS)))
    assert outputs == expected


def test_instances_run_in_threads(make: Callable[[], Instance]) -> None:
    instances = [make() for _ in range(4)]
    results: dict[int, list[list[float]]] = {}

    def run(k: int) -> None:
        instances[k].start()
        results[k] = play(instances[k], 4)

    threads = [threading.Thread(target=run, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == dict.fromkeys(range(4), results[0])


def test_many_instances_in_turn(unzipped: Path, description: ModelDescription) -> None:
    """pythonfmu's library miscounts references for every instance; none of it may show."""
    path = [*sys.path]
    for _ in range(100):
        instance = Instance(unzipped, description)
        instance.start()
        with pytest.raises(FMICallException, match=FATAL):
            instance.set({"bed.hold_up": 1.0})
        instance.step(1.0)
        instance.slave.terminate()
        instance.slave.freeInstance()
    gc.collect()
    assert sys.path == path


# --- processes ----------------------------------------------------------------------------------
STARTED = """
from pathlib import Path
from tempfile import mkdtemp

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

def started(fmu):
    folder = extract(fmu, unzipdir=mkdtemp(dir=Path(fmu).parent))
    description = read_model_description(folder)
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="screen",
    )
    slave.instantiate(loggingOn=True)
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave, {v.name: v.valueReference for v in description.modelVariables}
"""
RUN = (
    STARTED
    + """
for fmu in sys.argv[1:]:
    slave, place = started(fmu)
    slave.doStep(0.0, 10.0)
    print(*slave.getReal([place["bed.hold_up"], place["deck[1].panel[1].aperture"]]))
    slave.freeInstance()
"""
)
CONTINUED = (15.5, 0.0, 12.0, 15.5)
CONTINUE = f"""{STARTED}
from pathlib import Path

fmu, blob, *names = sys.argv[1:]
slave, place = started(fmu)
state = slave.deSerializeFMUstate(Path(blob).read_bytes())
slave.setFMUstate(state)
slave.freeFMUstate(state)
for frequency in {CONTINUED}:
    slave.setReal([place["motion.frequency"]], [frequency])
    slave.doStep(0.0, 7.0)
    print(*(value.hex() for value in slave.getReal([place[name] for name in names])))
slave.freeInstance()
"""
WRITE = """
from pathlib import Path
from vibroscreen.config import ScreenConfig
from vibroscreen_fmu.package import write_fmu
write_fmu(ScreenConfig.default(), Path(sys.argv[1]))
"""
ENGINES = """
import re
packages = {name.partition(".")[0] for name in sys.modules}
pattern = "vibroscreen(_[0-9a-f]{12})?"
print(sum(re.fullmatch(pattern, name) is not None for name in packages))
"""
COMPILED = """
library = next(m for n, m in sys.modules.items() if n.endswith(".kernels.library"))
print(library.library().parent == library.FOLDER, "numba" in sys.modules, "llvmlite" in sys.modules)
"""


def run_python(script: str, *arguments: Path | str) -> list[str]:
    """Lines that a script prints in a process of its own, which must end well; without alarms."""
    script = f"import sys\n{script}"
    command = [sys.executable, "-W", "error", "-c", script, *map(str, arguments)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return [line for line in run.stdout.splitlines() if not line.startswith("[WARNING] alarm.")]


def test_processes_end_well(fmu: Path, two_decks: Path) -> None:
    """Of six that run one FMU, and six that run two; without our care more than half abort."""
    runs = [(fmu,), (fmu, two_decks)] * 6
    with ThreadPoolExecutor(max_workers=2) as pool:
        found = list(pool.map(lambda fmus: run_python(RUN, *fmus), runs))
    assert found == [found[0], found[1]] * 6
    assert [len(lines) for lines in found[:2]] == [1, 2]
    assert float(found[0][0].split()[0]) > 0.0


def test_the_engine_is_inside_and_nothing_is_compiled(fmu: Path) -> None:
    assert run_python(RUN + COMPILED, fmu)[-1] == "True False False"


def test_builds_live_side_by_side(fmu: Path, tmp_path: Path) -> None:
    """Another configuration and another version of the engine in one process, beside ours."""
    text = ScreenConfig.default().to_toml().replace("aperture_mm = 16.0", "aperture_mm = 12.0")
    finer = write_fmu(ScreenConfig.loads(text), tmp_path)
    for module in (vibroscreen, vibroscreen_fmu):
        kernels = shutil.ignore_patterns("kernels", "__pycache__")
        shutil.copytree(Path(module.__file__).parent, tmp_path / module.__name__, ignore=kernels)
    # The kernels are the same ones, where they are compiled already.
    own = tmp_path / "vibroscreen" / "__init__.py"
    first = "from __future__ import annotations\n"
    more = f"__path__.append({str(Path(vibroscreen.__file__).parent)!r})\n"
    own.write_text(own.read_text().replace(first, first + more, 1))
    with (tmp_path / "vibroscreen" / "units.py").open("a") as source:
        source.write("# a new version\n")
    newer = tmp_path / "newer"
    run_python(f"sys.path.insert(0, {str(tmp_path)!r})\n" + WRITE, newer)
    ours = f"sys.path.insert(0, {str(Path(vibroscreen.__file__).parents[1])!r})\n"
    fmus = (fmu, finer, newer / fmu.name, fmu)
    lines = run_python(ours + "import vibroscreen\n" + RUN + ENGINES, *fmus)
    assert [line.split()[1] for line in lines[:4]] == ["0.016", "0.012", "0.016", "0.016"]
    assert lines[0] == lines[2] == lines[3] != lines[1]
    # ours, that of the first two FMUs, the newer one
    assert lines[4:] == ["3"]


# --- vibroscreen build ---------------------------------------------------------------------------
def command(*arguments: str | Path) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["build", *map(str, arguments)])
    return result.exit_code, result.stdout, result.stderr


def test_the_command_says_what_it_built(tmp_path: Path) -> None:
    config = tmp_path / "screen.toml"
    config.write_text(
        'name = "fines screen"\n[size_classes]\nedges_mm = [0, 2, 4, 8]\n'
        "[[deck]]\nwidth_m = 1.5\n[[deck.panel]]\naperture_mm = 4\n"
    )
    code, said, _ = command(config, "--output", tmp_path / "out")
    assert code == 0
    path = tmp_path / "out" / "VibratingScreen.fmu"
    assert said.splitlines()[0].startswith(f"{path} (")
    assert said.splitlines()[1:] == [
        "Vibrating screen (fines screen): 1.5 x 6 m at 4 mm, 3 size classes",
        "fmpy found no problem, two steps ran",
    ]
    assert "feed.mass_fraction[4]" not in {
        v.name for v in read_model_description(str(path)).modelVariables
    }


def test_the_command_builds_what_is_set(tmp_path: Path) -> None:
    code, said, _ = command(
        SCREENS / "quarry.toml", "-o", tmp_path, "--set", "deck[1].panel[1].aperture_mm=18"
    )
    assert code == 0
    assert said.splitlines()[1].endswith("2.4 x 6 m at 18 mm, 12 size classes")


def test_the_command_tells_of_a_folder_that_ends_a_host(tmp_path: Path) -> None:
    folder = tmp_path / "R&D é" / "x86 (1)"
    code, said, _ = command("--output", folder, "--runtime", "python")
    assert code == 0
    assert said.splitlines()[-3:-1] == list(IN_SHORT)
    assert said.splitlines()[-1] == f"do not unzip it in {folder}: & é ( ) in that path"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[size_classes]\nedges = [0, 1]\n", "size_classes.edges = [0, 1] is unknown"),
        ("name = 1", "size_classes is missing"),
    ],
)
def test_the_command_refuses_a_bad_configuration(tmp_path: Path, text: str, message: str) -> None:
    config = tmp_path / "screen.toml"
    config.write_text(text)
    code, said, error = command(config, "--output", tmp_path)
    assert (code, said) == (1, "")
    assert message in error
    assert str(config) in error
    assert not list(tmp_path.glob("*.fmu"))


def test_the_command_refuses_what_does_not_exist(tmp_path: Path) -> None:
    code, _, error = command(tmp_path / "none.toml")
    assert code == 1
    assert "none.toml" in error
    code, _, error = command("--runtime", "naive")
    assert code == 2
    assert "runtime = 'naive' does not exist: choose native, python or both" in error
    code, _, error = command("--runtime", "python", "--platform", "win64")
    assert code == 2
    assert "Invalid value for --platform: it is for runtime = native" in error
    code, _, error = command("--set", "feed.rate_t_h=200")
    assert code == 2
    assert "Invalid value for --set: it changes keys of a file: give SCREEN" in error


def test_a_screen_that_cannot_run_is_refused_at_once(tmp_path: Path) -> None:
    config = ScreenConfig.default().replace(solver=Solver(packages=10))
    with pytest.raises(ConfigError, match=r"solver\.packages = 10 is too little room"):
        build_fmu.build(config, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_build_that_fails_leaves_the_last_good_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = tmp_path / "VibratingScreen.fmu"
    good.write_bytes(b"good")
    monkeypatch.setattr(vibroscreen_fmu.build, "_trial", lambda path: ["it does not run"])
    with pytest.raises(RuntimeError, match=r"is of no use and was removed:\nit does not run"):
        build_fmu.build(ScreenConfig.default(), tmp_path)
    assert list(tmp_path.iterdir()) == [good]
    assert good.read_bytes() == b"good"


def test_registered_models_stay_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry._models["passage"], "mine", registry.SubModel(3))
    config = ScreenConfig.default()
    own = config.replace(passage=type(config.passage)(law="mine"))
    with pytest.raises(ConfigError, match=r"passage\.law = 'mine' is a registered sub-model"):
        write_fmu(own, tmp_path)


# --- without a library ---------------------------------------------------------------------------
def test_the_slave_is_plain_python(tmp_path: Path) -> None:
    """The slave as pythonfmu calls it, without the library."""
    config = ScreenConfig.default().replace(bed=Bed(initial="steady"))
    (tmp_path / CONFIG_FILE).write_text(config.to_toml())
    slave = ScreenSlave(instance_name="screen", resources=str(tmp_path))
    slave.setup_experiment(0.0, None, 1e-3)
    slave.exit_initialization_mode()
    assert slave.do_step(0.0, 10.0)
    with pytest.raises(
        RuntimeError, match=r"solver\.tolerance is a fixed parameter of a model that runs"
    ):
        slave.setup_experiment(0.0, 1.0, 1e-3)
    slave.setup_experiment(0.0)
    assert slave.get_real([]) == []
    with pytest.raises(RuntimeError, match="value reference -1 is no variable"):
        slave.get_real([-1])
    slave.set_real([], [])
    with pytest.raises(RuntimeError, match="75 per cent"):
        raise slave.refusal(ValueError("75% of it"))
    assert slave.do_step(10.0, -1.0) is False
    slave.note("100% full", Fmi2Status.warning)
    assert [entry.category for entry in slave.log_queue] == [
        *["logStatusError"] * 4,
        "logStatusWarning",
    ]
    assert slave.log_queue[-1].msg == "100 per cent full"
    # pythonfmu's library never gives back a category that it logs: it gets the same one again
    assert len({id(entry.category) for entry in slave.log_queue}) == 2
