"""The documentation page of an FMU."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lxml import etree
from lxml.builder import E

from vibroscreen_fmu.port import UNITS, Port

__all__ = ["index_html"]

STYLE = """
body { font-family: sans-serif; margin: 2em auto; max-width: 75em; line-height: 1.4; color: #222 }
table { border-collapse: collapse; margin: 1em 0 }
td, th { border-bottom: 1px solid #ccc; padding: .2em .8em .2em 0; text-align: left }
img { float: right; margin: 0 0 1em 2em }
"""
REFUSALS = (
    "A step with an input that cannot be used (not finite, negative, fractions that do not sum to "
    "1) is refused: the log (category logStatusError) names the variable, its value, the limit and "
    "the cure, and the state stays as before the call. Switch logging on to read it (in fmpy: "
    "debug_logging=True).",
    "Fixed parameters can be set until initialisation ends, tunable ones at any time: they take "
    "effect at the next step.",
)
COLUMNS = ("name", "type", "unit", "shown in", "start", "min", "max", "meaning")


def index_html(
    name: str,
    description: str,
    chapters: Iterable[tuple[str, Sequence[str]]],
    ports: Iterable[Port],
    licence: str,
) -> bytes:
    """The documentation page: what an FMU models, what its host needs, its variables, its licence.

    chapters: title ("" for none) and paragraphs of what is said of this model and this runtime.
    """
    table = tuple(ports)
    kinds = {
        "Inputs": [p for p in table if p.causality == "input"],
        "Outputs": [p for p in table if p.causality == "output"],
        "Tunable parameters": [p for p in table if p.variability == "tunable"],
        "Fixed parameters": [p for p in table if p.variability in ("fixed", "constant")],
    }
    texts = (*chapters, ("Errors", REFUSALS))
    page = E.html(
        E.head(E.meta(charset="utf-8"), E.title(name), E.style(STYLE)),
        E.body(
            E.img(src="../model.png", alt=name, width="160"),
            E.h1(name),
            E.p(description),
            *(part for title, paragraphs in texts for part in _chapter(title, paragraphs)),
            *(p for title, rows in kinds.items() if rows for p in (E.h2(title), _table(rows))),
            E.h2("Licence"),
            E.p(licence),
        ),
    )
    text: bytes = etree.tostring(page, method="html", doctype="<!DOCTYPE html>", encoding="utf-8")
    return text


def _chapter(title: str, paragraphs: Sequence[str]) -> list[etree._Element]:
    heading = [E.h2(title)] if title else []
    return heading + [E.p(text) for text in paragraphs]


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
