"""What tools draw of an FMU: its picture, and its terminals, streams that connect at once.

terminalsAndIcons.xml is that of FMI 3.0, which tools for FMI 2.0 read as well.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from lxml import etree

from vibroscreen_fmu.port import Port

__all__ = ["PICTURES", "model_png", "terminal_files"]

FOLDER = "terminalsAndIcons"
STREAM = re.compile(r"(.+)\.(mass_flow_rate|mass_fraction\[\d+\])")
STREAM_KIND = "solids_stream"
# The diagram is 200 wide and high, a terminal 20.
HALF, TERMINAL = 100, 10
PICTURES = Path(__file__).with_name("pictures")  # made by drawing.py


def model_png() -> bytes:
    """The picture of a screen."""
    return PICTURES.joinpath("model.png").read_bytes()


def terminal_files(ports: Iterable[Port], picture: bytes) -> dict[str, bytes]:
    """The folder terminalsAndIcons: what can be connected at once, the picture, that of a stream.

    A stream is a terminal: its rate and fractions, from whatever side, plug into those of another.
    """
    root = etree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    # In the coordinates of the standard's default; with a frame of our own before the terminals,
    # fmu-manipulation-toolbox 2.0 does not find them.
    terminals = etree.SubElement(root, "Terminals")
    table = tuple(ports)
    for causality, side in (("input", -HALF), ("output", HALF)):
        streams = _streams(port for port in table if port.causality == causality)
        for place, (name, members) in enumerate(streams.items(), start=1):
            terminal = etree.SubElement(
                terminals,
                "Terminal",
                name=name,
                matchingRule="plug",
                terminalKind=STREAM_KIND,
                description=f"Rate and composition of the {causality} {name}",
            )
            for member, variable in members.items():
                etree.SubElement(
                    terminal,
                    "TerminalMemberVariable",
                    variableName=variable,
                    memberName=member,
                    variableKind="signal",
                )
            height = round(HALF - 2 * HALF * place / (len(streams) + 1))
            etree.SubElement(
                terminal,
                "TerminalGraphicalRepresentation",
                defaultConnectionColor="93 66 38",
                x1=str(side - TERMINAL),
                y1=str(height - TERMINAL),
                x2=str(side + TERMINAL),
                y2=str(height + TERMINAL),
                iconBaseName="stream",
            )
    xml = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return {
        f"{FOLDER}/terminalsAndIcons.xml": xml,
        f"{FOLDER}/icon.png": picture,
        f"{FOLDER}/stream.png": PICTURES.joinpath("stream.png").read_bytes(),
    }


def _streams(ports: Iterable[Port]) -> dict[str, dict[str, str]]:
    """Variables of streams: name of the stream, name in it -> name of the variable."""
    found: dict[str, dict[str, str]] = {}
    for port in ports:
        if parts := STREAM.fullmatch(port.name):
            found.setdefault(parts[1], {})[parts[2]] = port.name
    return found
