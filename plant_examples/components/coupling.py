"""FMUs wired to a circuit: stepped with fmpy, and as an SSP for other tools."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TypeAlias

from lxml import etree

from components.instance import STARTED, running

__all__ = ["Wire", "step_along", "wires", "write_archive"]

Wire: TypeAlias = tuple[str, str, str, str]
"""Element, output, element, input of a connected variable."""

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"


def wires(streams: Iterable[Wire], classes: int) -> tuple[Wire, ...]:
    """The variables of streams that have so many size classes: the rate and every fraction."""
    variables = ("mass_flow_rate", *(f"mass_fraction[{i}]" for i in range(1, classes + 1)))
    return tuple(
        (source, f"{output}.{variable}", target, f"{given}.{variable}")
        for source, output, target, given in streams
        for variable in variables
    )


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
