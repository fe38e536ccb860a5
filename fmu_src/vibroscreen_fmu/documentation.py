"""What people see of an FMU: its documentation page and its picture."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence

from lxml import etree
from lxml.builder import E
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from vibroscreen_fmu.ports import UNITS, Port

__all__ = ["index_html", "model_png"]

STYLE = """
body { font-family: sans-serif; margin: 2em auto; max-width: 75em; line-height: 1.4; color: #222 }
table { border-collapse: collapse; margin: 1em 0 }
td, th { border-bottom: 1px solid #ccc; padding: .2em .8em .2em 0; text-align: left }
"""
ABOUT = (
    "A vibrating screen: feed rate, feed composition and vibration go in at every communication "
    "step, undersize and oversize come out. Inside, slices of the bed ride along the decks; grains "
    "segregate in them and pass the openings (cell model of Ivanov and Vaisberg).",
    "Streams are means over the last communication step, size classes are numbered from the "
    "finest, decks from the top, panels from the feed end. With several decks, undersize is what "
    "falls through the lowest deck, oversize leaves over the top deck, and intermediate[k] over "
    "deck k + 1. Outputs change only when a step or the initialisation ends. Any step size works.",
)
REFUSALS = (
    "A step with an input that cannot be used (not finite, negative, fractions that do not sum to "
    "1) is refused: the log (category logStatusError) names the variable, its value, the limit and "
    "the cure, and the state stays as before the call. Switch logging on to read it (in fmpy: "
    "debug_logging=True). pythonfmu knows one status for every "
    "refusal, fmi2Fatal; after it the instance still works.",
    "Fixed parameters can be set until initialisation ends, tunable ones at any time: they take "
    "effect at the next step.",
)
COLUMNS = ("name", "type", "unit", "shown in", "start", "min", "max", "meaning")


def index_html(
    description: str, ports: Iterable[Port], requirements: Sequence[str], python: str
) -> bytes:
    """The documentation page: what the FMU models, its variables, what the host needs.

    python: version of Python that the kernels were compiled for.
    """
    table = tuple(ports)
    kinds = {
        "Inputs": [p for p in table if p.causality == "input"],
        "Outputs": [p for p in table if p.causality == "output"],
        "Tunable parameters": [p for p in table if p.variability == "tunable"],
        "Fixed parameters": [p for p in table if p.variability in ("fixed", "constant")],
    }
    needs = ", ".join(requirements)
    page = E.html(
        E.head(
            E.meta(charset="utf-8"),
            E.title("VibratingScreen"),
            E.style(STYLE),
        ),
        E.body(
            E.h1("VibratingScreen"),
            E.p(description),
            *(E.p(text) for text in ABOUT),
            E.h2("What the host needs"),
            E.p(
                f"Python 3.11 or newer with {needs} (resources/requirements.txt); linux64 or "
                "win64. A host that is not Python itself must find libpython. The kernels are "
                f"compiled for Python {python} and the processor of the machine that built the "
                "FMU; elsewhere the first instance compiles them, which takes a minute or two."
            ),
            E.h2("Errors"),
            *(E.p(text) for text in REFUSALS),
            *(part for title, rows in kinds.items() for part in (E.h2(title), _table(rows))),
            E.p("Licence: MIT. The licence of pythonfmu lies beside this page."),
        ),
    )
    text: bytes = etree.tostring(page, method="html", doctype="<!DOCTYPE html>", encoding="utf-8")
    return text


def _table(ports: Iterable[Port]) -> etree._Element:
    header = E.tr(*(E.th(title) for title in COLUMNS))
    rows = (E.tr(*(E.td(text) for text in _cells(port))) for port in ports)
    return E.table(header, *rows)


def _cells(port: Port) -> tuple[str, ...]:
    unit = UNITS[port.unit].display if port.display else None
    real = port.kind == "Real"
    meaning = port.description
    if port.enumeration:
        items = enumerate(port.enumeration.items, 1)
        meaning += ": " + "; ".join(f"{i} {name}, {text}" for i, (name, text) in items)
    numbers = (
        "" if value is None else f"{value:.6g}" for value in (port.start, port.least, port.most)
    )
    return (port.name, port.kind, port.unit if real else "", unit or "", *numbers, meaning)


def model_png() -> bytes:
    """A picture of a screen for the tool's diagram: a sloping deck, grains over and under it."""
    figure = Figure(figsize=(2.56, 2.56), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, 10), ylim=(0, 10))
    axes.set_axis_off()
    axes.add_patch(
        Polygon([(0.8, 7.4), (0.8, 4.4), (9.2, 2.6), (9.2, 5.6)], closed=True, fc="#e8ecef")
    )

    def deck(x: float) -> float:
        return 4.9 - 0.214 * (x - 0.8)

    for left in (0.8 + 0.6 * k for k in range(14)):
        ends = (left, left + 0.38)
        axes.plot(ends, [deck(x) for x in ends], color="#2b3a42", lw=3, solid_capstyle="butt")
    for x, height, radius in (
        (1.6, 0.55, 0.42),
        (2.7, 0.6, 0.5),
        (3.9, 0.5, 0.36),
        (5.1, 0.6, 0.48),
        (6.6, 0.55, 0.44),
        (8.2, 0.6, 0.5),
    ):
        axes.add_patch(Circle((x, deck(x) + height), radius, fc="#b07d48", ec="#5d4226"))
    for x, fall in ((1.9, 1.0), (2.7, 1.9), (3.3, 0.9), (4.2, 1.7), (5.0, 1.0), (5.9, 1.6)):
        axes.add_patch(Circle((x, deck(x) - fall), 0.17, fc="#d9b382", ec="#5d4226"))
    arrow = {"arrowstyle": "<|-|>", "color": "#c0392b", "lw": 2.5}
    axes.annotate("", xy=(6.9, 9.3), xytext=(5.0, 7.2), arrowprops=arrow)
    target = io.BytesIO()
    # Without the library's name the picture is the same for every version that draws the same.
    figure.savefig(target, format="png", transparent=True, metadata={"Software": None})
    return target.getvalue()
