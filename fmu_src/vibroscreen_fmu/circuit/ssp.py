"""A flowsheet as FMUs, one a unit, and as an SSP 1.0 archive that wires them."""

from __future__ import annotations

import keyword
import re
import shutil
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from vibroscreen.circuit.flowsheet import Flowsheet
from vibroscreen.circuit.handling import Mixer
from vibroscreen.circuit.screening import ScreenUnit
from vibroscreen.stream import Feed
from vibroscreen.units import HOUR
from vibroscreen_fmu.circuit.pictures import picture_of
from vibroscreen_fmu.circuit.unit_slave import UNIT_FILE, Inlet, UnitModel, UnitSlave
from vibroscreen_fmu.native.fmu import write_native_fmu
from vibroscreen_fmu.package import Model, write_model

__all__ = ["Circuit", "Wire", "write_circuit", "write_ssp"]

Wire = tuple[str, str, str, str]
"""Element, output, element, input that are connected."""

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
STREAMS = (
    "Outputs are means over the last step and change only in a step: no output depends on an input "
    "of the same instant, a loop over the unit is no algebraic loop. Size classes are numbered "
    "from the finest and are those of the screens of the circuit."
)


@dataclass(frozen=True)
class Circuit:
    """The FMUs of a flowsheet by element, and the streams between them, one wire a stream.

    Elements are the units; a screen that several streams lead to has a mixer before it. They come
    in the order of the streams once loops are cut.
    """

    fmus: dict[str, Path]
    streams: tuple[Wire, ...]
    classes: int

    @property
    def wires(self) -> tuple[Wire, ...]:
        """The variables of the streams: the rate and every fraction."""
        variables = (
            "mass_flow_rate",
            *(f"mass_fraction[{i}]" for i in range(1, self.classes + 1)),
        )
        return tuple(
            (source, f"{output}.{variable}", target, f"{given}.{variable}")
            for source, output, target, given in self.streams
            for variable in variables
        )


def write_circuit(
    flowsheet: Flowsheet, folder: Path, screens: Mapping[str, Path] | None = None
) -> Circuit:
    """Write the FMU of every unit into a folder; those of screens are native, or copies.

    A fresh feed is the start value of the input that it leads to. screens: FMUs that are there, by
    the name of the screen.
    """
    folder.mkdir(parents=True, exist_ok=True)
    fmus: dict[str, Path] = {}
    streams: list[Wire] = []
    for unit in (flowsheet.unit[name] for name in flowsheet.order):
        feeds = [feed for feed in flowsheet.feeds if feed.to == unit.name]
        sources = [
            (source.name, outlet)
            for source in flowsheet.units
            for outlet, target in source.targets.items()
            if target == unit.name
        ]
        element, inlets = unit.name, len(feeds) + len(sources)
        screen = isinstance(unit, ScreenUnit)
        if screen and inlets > 1:
            element = f"{unit.name} feed"
            streams.append((element, "product", unit.name, "feed"))
        if not screen or inlets > 1:
            rest = Inlet(0.0, flowsheet.feeds[0].mass_fraction)
            given = [Inlet(feed.mass_flow_rate, feed.mass_fraction) for feed in feeds]
            model_of = Mixer(name=element, product=unit.name) if screen else unit
            model = UnitModel(
                model_of, flowsheet.size_classes.edges, (*given, *[rest] * len(sources))
            )
            fmus[element] = write_unit(model, folder)
        if isinstance(unit, ScreenUnit):
            duty = feeds[0] if inlets == 1 and feeds else unit.config.feed
            fmus[unit.name] = _write_screen(unit, duty, folder, (screens or {}).get(unit.name))
        several = inlets > 1
        for k, (source, outlet) in enumerate(sources, start=len(feeds) + 1):
            streams.append((source, outlet, element, f"feed[{k}]" if several else "feed"))
    return Circuit(fmus, tuple(streams), flowsheet.size_classes.count)


def _write_screen(unit: ScreenUnit, duty: Feed, folder: Path, ready: Path | None) -> Path:
    """Write the FMU of a screen with its duty, or copy one that is ready."""
    path = folder / f"{_identifier(unit.name)}.fmu"
    if ready:
        return shutil.copyfile(ready, path)
    feed = Feed(duty.mass_flow_rate, duty.mass_fraction)
    return write_native_fmu(unit.config.replace(feed=feed), folder).rename(path)


def write_unit(model: UnitModel, folder: Path) -> Path:
    """Write the FMU of a unit that is no screen."""
    kind = type(model.unit)
    about = (kind.__doc__ or "").split("\n\n")
    return write_model(
        Model(
            name=_identifier(model.unit.name),
            slave=(UnitSlave.__module__, UnitSlave.__name__),
            description=f"{model.unit.name}: {about[0].strip().rstrip('.')}",
            about=(("", (*(" ".join(part.split()) for part in about), STREAMS)),),
            ports=model.ports(),
            resources={UNIT_FILE: model.to_json().encode()},
            picture=picture_of(kind),
        ),
        folder,
    )


def write_ssp(
    flowsheet: Flowsheet,
    path: Path,
    duration: float = HOUR,
    screens: Mapping[str, Path] | None = None,
) -> Circuit:
    """Write a flowsheet as an SSP 1.0 archive for other tools; its FMUs lie beside it.

    duration: how long a tool runs it by default [s]. screens: as of `write_circuit`. Shown outputs:
    the rates of the products.
    """
    circuit = write_circuit(flowsheet, path.parent, screens)
    shown = [(unit, f"{outlet}.mass_flow_rate") for unit, outlet in flowsheet.leaving]
    wires = circuit.wires
    root = etree.Element(
        f"{{{SSD}}}SystemStructureDescription",
        {"name": path.stem, "version": "1.0"},
        nsmap={"ssd": SSD, "ssc": SSC},
    )
    system = etree.SubElement(root, f"{{{SSD}}}System", name=path.stem)
    elements = etree.SubElement(system, f"{{{SSD}}}Elements")
    for element, fmu in circuit.fmus.items():
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
    etree.SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime="0.0", stopTime=str(duration))
    xml = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("SystemStructure.ssd", xml)
        for fmu in circuit.fmus.values():
            archive.write(fmu, f"resources/{fmu.name}")
    return circuit


def _identifier(name: str) -> str:
    """A name as one in C and in Python."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if plain.isidentifier() and not keyword.iskeyword(plain) else f"unit_{plain}"
