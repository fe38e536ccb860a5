"""The documentation page of an FMU."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lxml import etree
from lxml.builder import E

from vibroscreen_fmu.port import UNITS, Port
from vibroscreen_fmu.python_limits import Paragraph

__all__ = ["index_html"]

# Prose about 70 characters wide; wide tables and commands scroll in boxes of their own.
STYLE = """
body { font: 16px/1.5 sans-serif; margin: 0 auto; padding: 2em 1.5em 4em; max-width: 72em;
  color: #222; overflow-wrap: break-word }
h1, h2, p, ul { max-width: 34em }
h1 { line-height: 1.2; margin-top: 0 }
h2 { font-size: 1.25em; margin: 2em 0 .5em }
li { margin: .4em 0 }
.wide { overflow-x: auto; margin: 1em 0 }
table { border-collapse: collapse; font-size: .9em }
td, th { border-bottom: 1px solid #ccc; padding: .3em 1em .3em 0; text-align: left;
  vertical-align: top; white-space: nowrap }
td:last-child { white-space: normal; min-width: 20em; max-width: 38em }
pre { background: #f3f3f3; padding: .8em 1em; margin: 0; font-size: .85em; width: max-content;
  min-width: 100%; box-sizing: border-box }
img { float: right; width: 160px; margin: 0 0 1em 2em }
@media (max-width: 40em) {
  body { padding: 1em 1em 3em }
  img { float: none; display: block; margin: 0 0 1em }
}
"""
REFUSALS = (
    "A step with an input that cannot be used (not finite, negative, fractions that do not sum to "
    "1) is refused: the log (category logStatusError) names the variable, its value, the limit and "
    "the cure, and the state stays as before the call. fmi2DoStep returns fmi2Discard (python "
    "runtime) or fmi2Error (native). Switch logging on to read it (in fmpy: debug_logging=True). "
    "After fmi2Discard fmpy's simulate_fmu ends early without an exception: compare the last time "
    "of its result with the stop time.",
    "Fixed parameters can be set until initialisation ends, tunable ones at any time: they take "
    "effect at the next step.",
)
COLUMNS = ("name", "type", "unit", "shown in", "start", "min", "max", "meaning")


def index_html(
    name: str,
    description: str,
    chapters: Iterable[tuple[str, Sequence[Paragraph]]],
    ports: Iterable[Port],
    licence: str,
) -> bytes:
    """The documentation page: what an FMU models, what its host needs, its variables, its licence.

    chapters: title ("" for none) and paragraphs of what is said of this model and this runtime; a
    tuple of texts is a list, a text of several lines is commands.
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
        E.head(
            E.meta(charset="utf-8"),
            E.meta(name="viewport", content="width=device-width, initial-scale=1"),
            E.title(name),
            E.style(STYLE),
        ),
        E.body(
            E.img(src="../model.png", alt=name),
            E.h1(name),
            E.p(description),
            *(part for title, paragraphs in texts for part in _chapter(title, paragraphs)),
            *(
                part
                for title, rows in kinds.items()
                if rows
                for part in (E.h2(title), _wide(_table(rows)))
            ),
            E.h2("Licence"),
            E.p(licence),
        ),
    )
    text: bytes = etree.tostring(page, method="html", doctype="<!DOCTYPE html>", encoding="utf-8")
    return text


def _chapter(title: str, paragraphs: Sequence[Paragraph]) -> list[etree._Element]:
    heading = [E.h2(title)] if title else []
    return heading + [_paragraph(text) for text in paragraphs]


def _paragraph(text: Paragraph) -> etree._Element:
    if isinstance(text, tuple):
        return E.ul(*(E.li(item) for item in text))
    return _wide(E.pre(text)) if "\n" in text else E.p(text)


def _wide(element: etree._Element) -> etree._Element:
    """A box that scrolls where the page is narrower than what is in it."""
    return E.div({"class": "wide"}, element)


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
