"""FMUs wired to a circuit: stepped with fmpy, and as an SSP for other tools."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeAlias

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from lxml import etree

__all__ = ["Wire", "step_along", "write_archive"]

Wire: TypeAlias = tuple[str, str, str, str]
"""Element, output, element, input of a connected variable."""

STARTED = 0.0
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


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


def step_along(
    fmus: Mapping[str, Path], wires: Sequence[Wire], asked: tuple[str, str], steps: int, step: float
) -> float:
    """Step element by element in the order of the wires; an element's variable at the end."""
    with ExitStack() as stack:
        units = {name: stack.enter_context(running(fmu, name)) for name, fmu in fmus.items()}
        links = []
        for source, target in dict.fromkeys((source, target) for source, _, target, _ in wires):
            between = [(o, i) for s, o, t, i in wires if (s, t) == (source, target)]
            outputs = [units[source][1][name] for name, _ in between]
            inputs = [units[target][1][name] for _, name in between]
            links.append((units[source][0], outputs, units[target][0], inputs))
        for count in range(steps):
            for slave, outputs, follower, inputs in links:
                slave.doStep(count * step, step)
                follower.setReal(inputs, slave.getReal(outputs))
        slave, reference = units[asked[0]]
        (value,) = slave.getReal([reference[asked[1]]])
    return float(value)


def write_archive(
    path: Path,
    fmus: Mapping[str, Path],
    wires: Sequence[Wire],
    shown: Sequence[tuple[str, str]],
    duration: float,
) -> Path:
    """Write an SSP 1.0 archive: elements, connectors, connections, and outputs that are shown."""
    root = etree.Element(
        f"{{{SSD}}}SystemStructureDescription",
        {"name": path.stem, "version": "1.0"},
        nsmap={"ssd": SSD, "ssc": SSC},
    )
    system = etree.SubElement(root, f"{{{SSD}}}System", name=path.stem)
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
        outputs |= dict.fromkeys(name for owner, name in shown if owner == element)
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
        root, f"{{{SSD}}}DefaultExperiment", startTime=str(STARTED), stopTime=str(duration)
    )
    xml = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", xml)
        for fmu in fmus.values():
            archive.write(fmu, f"resources/{fmu.name}")
    return path
