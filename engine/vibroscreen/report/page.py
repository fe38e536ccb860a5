"""The page of a report: what fills its template, and how it becomes a PDF.

Every text of a file stands on the page as text: the template escapes all that it is given, and what
no page may hold (control characters) shows as a mark in its place.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import vibroscreen
from vibroscreen.report.contents import BOX, DECK, LOAD, RULES, Sheet, settings_of, text_of
from vibroscreen.report.pictures import product_name

__all__ = ["fill", "print_page", "visible"]

TEMPLATE = "report.html.j2"
NEEDS = "a report needs {}, which is not installed: pip install 'vibroscreen[report]'"
# Characters that HTML forbids (control characters, noncharacters), and those that set the direction
# of the text behind them.
UNFIT = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\u202a-\u202e\u2066-\u2069"
    + "".join(chr(plane << 16 | last) for plane in range(17) for last in (0xFFFE, 0xFFFF))
    + "]"
)
# Letters of a name that stand in a headline.
HEADLINE = 90


def fill(sheets: Sequence[Sheet], day: date) -> str:
    """The page as HTML. Raises ImportError without jinja2 or matplotlib."""
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
        from markupsafe import Markup
    except ImportError:
        raise ImportError(NEEDS.format("jinja2")) from None

    def number(value: float, unit: str = "") -> Markup:
        """A number in a unit, with its exact value in SI beside it for machines."""
        return Markup('<data value="{}">{}</data>').format(repr(float(value)), text_of(value, unit))

    def plain(value: Any) -> Any:
        return value if isinstance(value, Markup) or not isinstance(value, str) else visible(value)

    page = Environment(
        loader=PackageLoader("vibroscreen.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=plain,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters.update(number=number, headline=_headline, product=product_name)
    return page.get_template(TEMPLATE).render(
        sheets=sheets,
        BOX=BOX,
        DECK=DECK,
        LOAD=LOAD,
        RULES=RULES,
        settings=list(settings_of(sheets)),
        day=day,
        version=vibroscreen.__version__,
    )


def visible(text: str) -> str:
    """Text with a mark for every character that a page may not hold, or that turns text around."""
    return UNFIT.sub("\ufffd", text)


def _headline(text: str) -> str:
    """The first letters of a name; "no name" for one without letters."""
    words = " ".join(text.split()) or "no name"
    return words if len(words) <= HEADLINE else f"{words[:HEADLINE]}…"


def print_page(page: str, path: Path) -> None:
    """Write a page as PDF. Raises ImportError without plutoprint, OSError."""
    try:
        import plutoprint
    except ImportError:
        raise ImportError(NEEDS.format("plutoprint")) from None
    book = plutoprint.Book(plutoprint.PAGE_SIZE_A4, media=plutoprint.MEDIA_TYPE_PRINT)
    book.load_html(page)
    book.write_to_pdf(str(path))
