"""modelDescription.xml (FMI 2.0.3, co-simulation) from the table of ports."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Iterable
from uuid import UUID

from lxml import etree
from pythonfmu.fmi2slave import Fmi2Slave

from vibroscreen_fmu.port import TOLERANCE, UNITS, Port

__all__ = ["guid_of", "model_description"]

# Ten minutes of operation in steps of a second: a circuit settles and shows its dynamics.
STOP_TIME, STEP_SIZE = 600.0, 1.0
AUTHOR = "the vibroscreen authors"  # as in LICENSE
# What the python runtime can do; what it cannot is false by default.
PYTHON_RUNTIME = "vibroscreen with pythonfmu"
CAPABILITIES = (
    "needsExecutionTool",
    "canHandleVariableCommunicationStepSize",
    "canNotUseMemoryManagementFunctions",
    "canGetAndSetFMUstate",
    "canSerializeFMUstate",
)


def model_description(
    name: str, ports: Iterable[Port], description: str, tool: str = PYTHON_RUNTIME
) -> bytes:
    """The XML file of an FMU; only the python runtime needs more on its host than the file."""
    table = tuple(ports)
    return _xml(name, table, description, guid_of(name, table, description), tool)


def guid_of(name: str, ports: Iterable[Port], description: str) -> str:
    """A hash of all the rest of the XML file but the runtime: equal contracts have equal ones."""
    nameless = _xml(name, tuple(ports), description, "", PYTHON_RUNTIME)
    return f"{{{UUID(bytes=hashlib.sha256(nameless).digest()[:16])}}}"


def _xml(name: str, ports: tuple[Port, ...], description: str, guid: str, tool: str) -> bytes:
    root = etree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=name,
        guid=guid,
        description=description,
        author=AUTHOR,
        version=importlib.metadata.version("vibroscreen"),
        copyright=f"Copyright (c) 2026 {AUTHOR}",
        license="MIT",
        generationTool=tool,
        variableNamingConvention="structured",
    )
    flags = dict.fromkeys(CAPABILITIES, "true")
    if tool != PYTHON_RUNTIME:
        flags["needsExecutionTool"] = "false"
    etree.SubElement(root, "CoSimulation", modelIdentifier=name, **flags)
    _add_units(etree.SubElement(root, "UnitDefinitions"), ports)
    if any(port.enumeration for port in ports):
        _add_types(etree.SubElement(root, "TypeDefinitions"), ports)
    categories = etree.SubElement(root, "LogCategories")
    for name, text in Fmi2Slave.log_categories.items():
        etree.SubElement(categories, "Category", name=name, description=text)
    experiment = {"startTime": "0", "stopTime": repr(STOP_TIME), "stepSize": repr(STEP_SIZE)}
    for port in ports:
        if port.path == TOLERANCE:  # other units of a plant have none
            experiment["tolerance"] = repr(port.start)
    etree.SubElement(root, "DefaultExperiment", experiment)
    variables = etree.SubElement(root, "ModelVariables")
    for port in ports:
        _add_variable(variables, port)
    structure = etree.SubElement(root, "ModelStructure")
    outputs = [place for place, port in enumerate(ports, 1) if port.causality == "output"]
    # Outputs change only when a step or the initialisation ends: they follow from the state alone,
    # and a master that closes a loop over them meets no algebraic loop.
    for title in ("Outputs", "InitialUnknowns"):
        unknowns = etree.SubElement(structure, title)
        for place in outputs:
            etree.SubElement(
                unknowns, "Unknown", index=str(place), dependencies="", dependenciesKind=""
            )
    xml: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return xml


def _add_units(parent: etree._Element, ports: tuple[Port, ...]) -> None:
    used = {port.unit for port in ports if port.kind == "Real"}
    for name, unit in UNITS.items():
        if name in used:
            element = etree.SubElement(parent, "Unit", name=name)
            exponents = {base: str(power) for base, power in unit.base.items()}
            etree.SubElement(element, "BaseUnit", **exponents)
            if unit.display:
                factor = f"{1.0 / unit.display_size:.16g}"  # 3.6, not 3.5999999999999996
                etree.SubElement(element, "DisplayUnit", name=unit.display, factor=factor)


def _add_types(parent: etree._Element, ports: tuple[Port, ...]) -> None:
    types = {port.enumeration.name: port for port in reversed(ports) if port.enumeration}
    for name, port in reversed(types.items()):
        enumeration = port.enumeration
        assert enumeration is not None
        kind = etree.SubElement(
            parent, "SimpleType", name=name, description=f"Choice of {port.name}"
        )
        items = etree.SubElement(kind, "Enumeration")
        for value, (name, text) in enumerate(enumeration.items, 1):
            etree.SubElement(items, "Item", name=name, value=str(value), description=text)


def _add_variable(parent: etree._Element, port: Port) -> None:
    variable = etree.SubElement(
        parent,
        "ScalarVariable",
        name=port.name,
        valueReference=str(port.reference),
        description=port.description,
        causality=port.causality,
        variability=port.variability,
    )
    # An input has no `initial`: the standard forbids it.
    if port.causality != "input":
        variable.set("initial", "calculated" if port.start is None else "exact")
    kind = etree.SubElement(variable, port.kind)
    if port.enumeration:
        kind.set("declaredType", port.enumeration.name)
    if port.kind == "Real":
        _set_unit(kind, port)
    for attribute, value in (("min", port.least), ("max", port.most), ("start", port.start)):
        if value is not None:
            kind.set(attribute, repr(value) if port.kind == "Real" else str(int(value)))


def _set_unit(kind: etree._Element, port: Port) -> None:
    unit = UNITS[port.unit]
    kind.set("unit", port.unit)
    if port.display and unit.display:
        kind.set("displayUnit", unit.display)
    if unit.nominal != 1.0:
        kind.set("nominal", repr(unit.nominal))
