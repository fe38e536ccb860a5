"""A circuit in a co-simulation tool: `python tests/fmu/masters.py TOOL FOLDER [CASE]` prints rates.

FOLDER holds what plant_examples/circuit_of_fmus.py writes, or two_stage.py for that case. A tool runs
in a process of its own, so that it must also end well. Every function returns rates at the end over
the fresh feed, 1: of the closed circuit the circulating load, of the other the products.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import two_stage
from circuit_of_fmus import DURATION, FRESH_FEED, OVERSIZE, SSP, STEP, run
from components.coupling import at_end_of_ssp
from vibroscreen_fmu.circuit.ssp import Circuit

ELEMENTS = ("mixer", "crusher", "screen", "belt")  # each in an FMU of that name
STREAMS = (
    ("mixer", "product", "crusher", "feed"),
    ("crusher", "product", "screen", "feed"),
    ("screen", "oversize", "belt", "feed"),
    ("belt", "product", "mixer", "feed[2]"),
)
CLASSES = 12
NANOSECONDS = 1_000_000_000
# An iterating master solves every step anew: longer steps, and no delay that they add.
LONG_STEP = 20.0
CONTAINER = "closed_circuit_container"


@dataclass(frozen=True)
class Case:
    """An SSP, how long it runs in which steps [s], and elements and variables to be read."""

    ssp: str
    duration: float
    step: float
    asked: tuple[tuple[str, str], ...]
    fresh: float

    def shares(self, rates: list[float]) -> list[float]:
        """Rates over the fresh feed."""
        return [float(rate) / self.fresh for rate in rates]


CLOSED = Case(SSP, DURATION, STEP, (OVERSIZE,), FRESH_FEED)
TWO_STAGE = Case(
    two_stage.SSP,
    two_stage.DURATION,
    two_stage.STEP,
    two_stage.ASKED,
    two_stage.TODAY.feeds[0].mass_flow_rate,
)
CASES = {"closed": CLOSED, "two_stage": TWO_STAGE}


def circuit_in(folder: Path) -> Circuit:
    """The FMUs of the closed circuit in a folder, wired as the flowsheet says."""
    return Circuit({name: folder / f"{name}.fmu" for name in ELEMENTS}, STREAMS, CLASSES)


def fmpy_loop(folder: Path) -> list[float]:
    """A script that steps element by element."""
    return [run(circuit_in(folder))]


def fmpy_ssp(folder: Path, case: Case = CLOSED) -> list[float]:
    """fmpy's own SSP simulation."""
    return case.shares(at_end_of_ssp(folder / case.ssp, case.asked, case.duration, case.step))


def libcosimpy(folder: Path, case: Case = CLOSED) -> list[float]:
    """libcosim of the Open Simulation Platform, in C++."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver

    log_output_level(CosimLogLevel.WARNING)
    step = round(case.step * NANOSECONDS)
    execution = CosimExecution.from_ssp_file(str(folder / case.ssp), step_size=step)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    assert execution.simulate_until(target_time=round(case.duration * NANOSECONDS))
    places = {slave.name.decode(): slave.index for slave in execution.slave_infos()}
    rates = []
    for element, variable in case.asked:
        variables = execution.slave_variables(places[element])
        reference = next(v.reference for v in variables if v.name.decode() == variable)
        rates += observer.last_real_values(places[element], [reference])
    return case.shares(rates)


def ecospy(folder: Path, case: Case = CLOSED) -> list[float]:
    """Ecos, in C++; it needs libtbb.so.12, which the package tbb brings."""
    library = Path(sys.prefix, "lib", "libtbb.so.12")
    if library.exists():
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation

    with EcosSimulation(ssp_path=str(folder / case.ssp), step_size=case.step) as simulation:
        simulation.init()
        simulation.step_until(case.duration)
        rates = [simulation.get_real("::".join(variable)) for variable in case.asked]
        simulation.terminate()
    return case.shares(rates)


def container(folder: Path) -> list[float]:
    """One FMU of the four by the FMU manipulation toolbox, which plugs their terminals."""
    from fmpy import simulate_fmu

    lines = ["rule;from_fmu;from_port;to_fmu;to_port"]
    lines += [f"FMU;{element}.fmu;;;" for element in ELEMENTS]
    lines += [
        f"LINK;{source}.fmu;{output};{target}.fmu;{given}"
        for source, output, target, given in STREAMS
    ]
    element, variable = OVERSIZE
    lines.append(f"OUTPUT;{element}.fmu;{variable};;oversize")
    (folder / f"{CONTAINER}.csv").write_text("\n".join(lines) + "\n")
    tool = "from fmu_manipulation_toolbox.cli.fmucontainer import fmucontainer as f; f()"
    command = [sys.executable, "-c", tool, "-no-auto-output"]
    command += ["-fmu-directory", str(folder), "-container", f"{CONTAINER}.csv:{STEP:g}"]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    said = made.stdout + made.stderr
    assert made.returncode == 0, said
    assert "plug" not in said, said
    path = folder / f"{CONTAINER}.fmu"
    result = simulate_fmu(str(path), stop_time=DURATION, step_size=STEP, output_interval=STEP)
    assert result["time"][-1] == DURATION  # a discarded step ends the run without an exception
    return CLOSED.shares([result["oversize"][-1]])


def pathsim(folder: Path) -> list[float]:
    """PathSim, with its blocks for FMUs; an input without a wire is 0 to it: a constant feeds it."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import Constant
    from pathsim_fmi import CoSimulationFMU

    units = {
        element: CoSimulationFMU(str(folder / f"{element}.fmu"), element, dt=STEP)
        for element in ELEMENTS
    }
    wires = [
        Connection(units[source][output], units[target][given])
        for source, output, target, given in circuit_in(folder).wires
    ]
    wired = {(target, given) for _, _, target, given in circuit_in(folder).wires}
    constants = []
    for element, unit in units.items():
        for name, value in inputs(folder / f"{element}.fmu").items():
            if (element, name) not in wired:
                constants.append(Constant(value))
                wires.append(Connection(constants[-1], unit[name]))
    Simulation([*constants, *units.values()], wires, dt=STEP, log=False).run(DURATION)
    element, variable = OVERSIZE
    return CLOSED.shares([units[element].outputs[variable]])


def gemseo(folder: Path) -> list[float]:
    """GEMSEO, elements one after the other; what has one name is connected."""
    from gemseo_fmu.disciplines.do_step_fmu_discipline import DoStepFMUDiscipline
    from gemseo_fmu.disciplines.time_stepping_system import TimeSteppingSystem

    outputs: dict[str, dict[str, str]] = {element: {} for element in ELEMENTS}
    given: dict[str, dict[str, str]] = {element: {} for element in ELEMENTS}
    for source, output, target, name in circuit_in(folder).wires:
        outputs[source][output] = given[target][name] = f"{source}.{output}"
    units = [
        DoStepFMUDiscipline(
            folder / f"{element}.fmu",
            input_names=tuple(given[element]),
            output_names=tuple(outputs[element]),
            name=element,
            variable_names=outputs[element] | given[element],
        )
        for element in ELEMENTS
    ]
    system = TimeSteppingSystem(units, DURATION, STEP, mda_name="MDAGaussSeidel")
    return CLOSED.shares([system.execute()[".".join(OVERSIZE)][-1]])


def inputs(path: Path) -> dict[str, float]:
    """Start values of an FMU's inputs, for tools that take 0 for what they are not told."""
    from fmpy import read_model_description

    variables = read_model_description(str(path)).modelVariables
    return {v.name: float(v.start) for v in variables if v.causality == "input"}


def cofmupy_jacobi(folder: Path) -> list[float]:
    """CoFmuPy, all elements fed by the outputs of the step before."""
    return _cofmupy(folder, "jacobi", iterative=False, step=STEP)


def cofmupy_gauss_seidel(folder: Path) -> list[float]:
    """CoFmuPy, elements one after the other."""
    return _cofmupy(folder, "gauss_seidel", iterative=False, step=STEP)


def cofmupy_iterative(folder: Path) -> list[float]:
    """CoFmuPy, every step repeated from saved states until the loop is closed."""
    return _cofmupy(folder, "gauss_seidel", iterative=True, step=LONG_STEP)


def _cofmupy(folder: Path, method: str, *, iterative: bool, step: float) -> list[float]:
    from cofmupy import Coordinator

    paths = circuit_in(folder).fmus
    configuration = {
        "fmus": [
            {"id": element, "name": element, "path": str(path), "initialization": inputs(path)}
            for element, path in paths.items()
        ],
        "connections": [
            {
                "source": {"id": source, "variable": output, "unit": "", "type": "fmu"},
                "target": [{"id": target, "variable": given, "unit": "", "type": "fmu"}],
            }
            for source, output, target, given in circuit_in(folder).wires
        ],
        "cosim_method": method,
        "iterative": iterative,
        "edge_sep": " -> ",
        "root": "",
    }
    coordinator = Coordinator()
    coordinator.start(configuration)
    for _ in range(round(DURATION / step)):
        coordinator.do_step(step)
    return CLOSED.shares([coordinator.get_variable(OVERSIZE)[-1]])


OF_SSP = (fmpy_ssp, libcosimpy, ecospy)  # these take a case
TOOLS = (fmpy_loop, *OF_SSP, container, pathsim)
# Beside packages of their own, for an fmpy of their own: what pip installs for them.
COFMUPY = (
    "cofmupy==1.0.0",
    "fmpy==0.3.20",
    "networkx==3.2.1",
    "confluent-kafka",
    "plotly",
    "narwhals",
)
GEMSEO = (
    *("gemseo==6.3.3", "gemseo-fmu==3.1.1", "fmpy==0.3.19", "delta", "docstring-inheritance"),
    *("genson", "h5py", "networkx", "prettytable", "pydantic-settings", "python-dotenv"),
    *("StrEnum", "tqdm", "wcwidth", "xxhash"),
)
APART = {
    cofmupy_jacobi: COFMUPY,
    cofmupy_gauss_seidel: COFMUPY,
    cofmupy_iterative: COFMUPY,
    gemseo: GEMSEO,
}


if __name__ == "__main__":
    chosen = next(tool for tool in (*TOOLS, *APART) if tool.__name__ == sys.argv[1])
    with contextlib.redirect_stdout(sys.stderr):
        rates = chosen(Path(sys.argv[2]), *(CASES[name] for name in sys.argv[3:]))
    print(json.dumps(rates))
