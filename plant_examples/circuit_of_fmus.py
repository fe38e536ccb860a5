"""Does a co-simulation tool run the closed circuit as it should? FMUs, an SSP, and what to expect.

The units of closed_circuit.py as FMUs, wired as there:

    fresh feed -> Mixer -> ConeCrusher -> VibratingScreen -> product
                    ^                            |
                    +-------- Conveyor <---------+ oversize

`python plant_examples/circuit_of_fmus.py` writes four FMUs and `closed_circuit.ssp` to
dist/circuit and runs them with fmpy. The steady circulating load does not depend on how a tool
couples them, only on the units: it is computed apart, from the steady state of the screen and the
matrix of the crusher. A tool that couples right finds it to the accuracy of the engine.
"""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from lxml import etree

from closed_circuit import (
    CLOSED_SIDE_SETTING,
    CONVEYOR_DELAY,
    FEED_EXPONENT,
    FEED_SIZE,
    ROOT,
    SCHEDULE,
    rosin_rammler,
)
from components.crusher import ConeCrusher
from components.fmus import conveyor_model, crusher_model, mixer_model
from components.mixer import Rates
from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen.stream import Feed
from vibroscreen.units import MINUTE, PERCENT
from vibroscreen_fmu.native.fmu import write_native_fmu
from vibroscreen_fmu.package import write_model

FRESH_FEED = SCHEDULE[0].fresh_feed
STEP = 2.0  # s, communication step
DURATION = 40 * MINUTE  # about thirty turns
# Element of the circuit -> model; a stream from an element to another.
ELEMENTS = {
    "mixer": "Mixer",
    "crusher": "ConeCrusher",
    "screen": "VibratingScreen",
    "conveyor": "Conveyor",
}
STREAMS = (
    ("mixer", "outlet", "crusher", "feed"),
    ("crusher", "product", "screen", "feed"),
    ("screen", "oversize", "conveyor", "feed"),
    ("conveyor", "discharge", "mixer", "inlet[2]"),
)
# What a run is judged by, at its end.
OVERSIZE = ("screen", "oversize.mass_flow_rate")
PRODUCT = ("screen", "undersize.mass_flow_rate")
STARTED = 0.0

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


def write_circuit(folder: Path, screen: Path | None = None) -> dict[str, Path]:
    """Write the FMUs of the circuit's elements into a folder; `screen` is taken if it is given."""
    config = ScreenConfig.default()
    edges = np.array(config.size_classes.edges)
    fresh = rosin_rammler(edges, FEED_SIZE, FEED_EXPONENT)
    folder.mkdir(parents=True, exist_ok=True)
    if screen is None:
        made = write_native_fmu(config, folder)
    else:
        made = Path(shutil.copyfile(screen, folder / "VibratingScreen.fmu"))
    return {
        "mixer": write_model(mixer_model(edges, fresh, FRESH_FEED), folder),
        "crusher": write_model(crusher_model(edges, fresh, CLOSED_SIDE_SETTING), folder),
        "screen": made,
        "conveyor": write_model(conveyor_model(edges, fresh, CONVEYOR_DELAY), folder),
    }


def connections(classes: int) -> Iterator[tuple[str, str, str, str]]:
    """Element, output, element, input of every connected variable."""
    variables = ("mass_flow_rate", *(f"mass_fraction[{i}]" for i in range(1, classes + 1)))
    for source, output, target, given in STREAMS:
        for variable in variables:
            yield source, f"{output}.{variable}", target, f"{given}.{variable}"


def write_ssp(path: Path, fmus: Mapping[str, Path]) -> Path:
    """Write the circuit as an SSP 1.0 archive: elements, connectors and connections."""
    wires = tuple(connections(ScreenConfig.default().size_classes.count))
    root = etree.Element(
        f"{{{SSD}}}SystemStructureDescription",
        {"name": "closed_circuit", "version": "1.0"},
        nsmap={"ssd": SSD, "ssc": SSC},
    )
    system = etree.SubElement(root, f"{{{SSD}}}System", name="closed_circuit")
    elements = etree.SubElement(system, f"{{{SSD}}}Elements")
    for element, fmu in fmus.items():
        component = etree.SubElement(
            elements,
            f"{{{SSD}}}Component",
            name=element,
            type="application/x-fmu-sharedlibrary",
            source=f"resources/{fmu.name}",
        )
        connectors = etree.SubElement(component, f"{{{SSD}}}Connectors")
        outputs = dict.fromkeys(name for source, name, _, _ in wires if source == element)
        outputs |= dict.fromkeys(name for owner, name in (OVERSIZE, PRODUCT) if owner == element)
        inputs = [name for _, _, target, name in wires if target == element]
        for kind, names in (("output", outputs), ("input", inputs)):
            for name in names:
                connector = etree.SubElement(
                    connectors, f"{{{SSD}}}Connector", name=name, kind=kind
                )
                etree.SubElement(connector, f"{{{SSC}}}Real")
    connected = etree.SubElement(system, f"{{{SSD}}}Connections")
    for source, output, target, given in wires:
        etree.SubElement(
            connected,
            f"{{{SSD}}}Connection",
            startElement=source,
            startConnector=output,
            endElement=target,
            endConnector=given,
        )
    etree.SubElement(
        root, f"{{{SSD}}}DefaultExperiment", startTime=str(STARTED), stopTime=str(DURATION)
    )
    xml = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", xml)
        for fmu in fmus.values():
            archive.write(fmu, f"resources/{fmu.name}")
    return path


def expected_load() -> float:
    """Steady oversize over fresh feed, 1, without any coupling: o = oversize of S(C (f + o))."""
    config = ScreenConfig.default()
    screen = Screen(config)
    edges = np.array(config.size_classes.edges)
    crusher = ConeCrusher(edges, CLOSED_SIDE_SETTING)
    fresh = FRESH_FEED * rosin_rammler(edges, FEED_SIZE, FEED_EXPONENT)
    oversize: Rates = np.zeros_like(fresh)
    before = -1.0
    while abs(oversize.sum() - before) > 1e-12 * FRESH_FEED:
        before = oversize.sum()
        rates = crusher.crush(fresh + oversize)
        feed = Feed(float(rates.sum()), tuple((rates / rates.sum()).tolist()))
        oversize = screen.solve_steady(feed).oversize.class_rates
    return float(oversize.sum() / FRESH_FEED)


@contextmanager
def running(fmu: Path, name: str) -> Iterator[tuple[FMU2Slave, dict[str, int]]]:
    """An instance of an FMU that has started, and the references of its variables."""
    description = read_model_description(str(fmu))
    folder = extract(str(fmu))
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=name,
    )
    try:
        slave.instantiate(loggingOn=True)
        slave.setupExperiment(startTime=STARTED)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        yield slave, {v.name: v.valueReference for v in description.modelVariables}
        slave.terminate()
    finally:
        slave.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)


def run(fmus: Mapping[str, Path], step: float = STEP, duration: float = DURATION) -> float:
    """Circulating load at the end, 1: element by element along the streams."""
    wires = tuple(connections(ScreenConfig.default().size_classes.count))
    with ExitStack() as stack:
        units = {name: stack.enter_context(running(fmu, name)) for name, fmu in fmus.items()}
        links = []
        for source, _, target, _ in STREAMS:
            between = [(o, i) for s, o, t, i in wires if (s, t) == (source, target)]
            outputs = [units[source][1][name] for name, _ in between]
            inputs = [units[target][1][name] for _, name in between]
            links.append((units[source][0], outputs, units[target][0], inputs))
        for count in range(round(duration / step)):
            for slave, outputs, follower, inputs in links:
                slave.doStep(count * step, step)
                follower.setReal(inputs, slave.getReal(outputs))
        slave, reference = units[OVERSIZE[0]]
        (oversize,) = slave.getReal([reference[OVERSIZE[1]]])
    return float(oversize / FRESH_FEED)


def main(
    output: Annotated[Path, typer.Option(help="Where the FMUs and the SSP go.")] = (
        ROOT / "dist" / "circuit"
    ),
    screen: Annotated[
        Path | None, typer.Option(help="Another FMU of the default screen, such as a python one.")
    ] = None,
) -> tuple[float, float]:
    """Write the circuit, run it with fmpy; return the load it found and the one to expect, 1."""
    fmus = write_circuit(output, screen)
    ssp = write_ssp(output / "closed_circuit.ssp", fmus)
    found, expected = run(fmus), expected_load()
    print(f"{', '.join(fmu.name for fmu in fmus.values())} and {ssp.name} are in {output}")
    print(
        f"After {DURATION / MINUTE:g} min in steps of {STEP:g} s the circulating load is "
        f"{found / PERCENT:.4f} %, expected {expected / PERCENT:.4f} %: "
        f"{'it couples right' if abs(found - expected) < 1e-3 else 'SOMETHING IS WRONG'}."
    )
    return found, expected


if __name__ == "__main__":
    typer.run(main)
