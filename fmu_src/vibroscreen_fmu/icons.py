"""What tools draw of an FMU: its picture, and its terminals, streams that connect at once.

terminalsAndIcons.xml is that of FMI 3.0, which tools for FMI 2.0 read as well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable

from lxml import etree
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from PIL import Image

from vibroscreen_fmu.port import Port

__all__ = ["COARSE", "FINE", "STEEL", "model_png", "png", "terminal_files"]

FOLDER = "terminalsAndIcons"
STREAM = re.compile(r"(.+)\.(mass_flow_rate|mass_fraction\[\d+\])")
STREAM_KIND = "solids_stream"
# The diagram is 200 wide and high, a terminal 20.
HALF, TERMINAL = 100, 10

STEEL, PLATE, COARSE, FINE, RIM = "#2b3a42", "#dfe5e9", "#b07d48", "#d9b382", "#5d4226"
ARROW = "#c0392b"
COLOURS = 64


def png(draw: Callable[[Axes], None], pixels: int = 256) -> bytes:
    """A square picture of what `draw` draws between 0 and 10, on nothing."""
    figure = Figure(figsize=(pixels / 100, pixels / 100), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, 10), ylim=(0, 10))
    axes.set_axis_off()
    draw(axes)
    drawn, target = io.BytesIO(), io.BytesIO()
    # Without the library's name the picture is the same for every version that draws the same.
    figure.savefig(drawn, format="png", transparent=True, metadata={"Software": None})
    few = Image.open(drawn).convert("RGBA").quantize(COLOURS)
    few.save(target, format="png", optimize=True)
    return target.getvalue()


def model_png() -> bytes:
    """A screen: a sloping deck in a box on springs, grains over and under it, its vibration."""
    return png(_draw_screen)


def _draw_screen(axes: Axes) -> None:
    slope = -0.2

    def deck(x: float) -> float:
        return 5.6 + slope * (x - 0.6)

    box = [(0.6, 2.2), (0.6, -1.5), (9.4, -1.5), (9.4, 2.2)]
    axes.add_patch(Polygon([(x, deck(x) + dy) for x, dy in box], fc=PLATE, ec=STEEL, lw=2))
    for left in (0.7 + 0.62 * k for k in range(14)):
        ends = (left, left + 0.38)
        axes.plot(ends, [deck(x) for x in ends], color=STEEL, lw=4, solid_capstyle="butt")
    for x in (1.6, 8.4):  # springs
        top = deck(x) - 1.5
        zigzag = [(x + 0.3 * (-1) ** k, top - (k + 0.5) * (top - 0.7) / 6) for k in range(6)]
        points = [(x, top), *zigzag, (x, 0.7)]
        axes.plot(*zip(*points, strict=True), color=STEEL, lw=2)
        axes.plot((x - 0.6, x + 0.6), (0.6, 0.6), color=STEEL, lw=3)
    for x, height, radius in (
        (1.3, 0.55, 0.4),
        (1.9, 1.3, 0.46),
        (2.4, 0.55, 0.36),
        (3.5, 0.6, 0.46),
        (4.6, 0.52, 0.36),
        (5.7, 0.6, 0.46),
        (7.1, 0.55, 0.42),
        (8.6, 0.6, 0.48),
    ):
        axes.add_patch(Circle((x, deck(x) + height), radius, fc=COARSE, ec=RIM))
    for x, fall in ((1.4, 0.6), (2.1, 1.1), (2.9, 0.6), (3.7, 1.1), (4.9, 0.7), (6.2, 1.0)):
        axes.add_patch(Circle((x, deck(x) - fall), 0.17, fc=FINE, ec=RIM))
    arrow = {"arrowstyle": "<|-|>", "color": ARROW, "lw": 3, "mutation_scale": 16}
    axes.annotate("", xy=(7.4, 9.7), xytext=(5.4, 7.7), arrowprops=arrow)


def _draw_stream(axes: Axes) -> None:
    arrow = {"arrowstyle": "-|>", "color": RIM, "lw": 6, "mutation_scale": 30}
    axes.annotate("", xy=(9.6, 5.0), xytext=(0.4, 5.0), arrowprops=arrow)


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
        f"{FOLDER}/stream.png": png(_draw_stream, 32),
    }


def _streams(ports: Iterable[Port]) -> dict[str, dict[str, str]]:
    """Variables of streams: name of the stream, name in it -> name of the variable."""
    found: dict[str, dict[str, str]] = {}
    for port in ports:
        if parts := STREAM.fullmatch(port.name):
            found.setdefault(parts[1], {})[parts[2]] = port.name
    return found
