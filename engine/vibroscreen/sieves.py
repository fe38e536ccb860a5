"""Sieve analyses as laboratories write them: a table of sizes and of what passes or stays.

Separated by semicolons, tabs, commas or blanks, with decimal points or commas; coarsest or finest
first; per cent, fractions or masses; passing, retained by sieve or retained in all. The head says
which, in words that are used for it (size in mm, um or in; passing or finer; retained; cumulative);
without a head the numbers do, where they leave no doubt.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from vibroscreen.errors import InputError
from vibroscreen.fields import to_si
from vibroscreen.lab_text import decoded
from vibroscreen.units import INCH, MICROMETRE, MM, PERCENT

__all__ = ["Sieves", "read_sieves"]

# Words of heads; a column is what the first of these that fits says.
PASSING = r"pass|finer|undersize|through|smaller|<"
RETAINED = r"retain|\bret\b|coarser|oversize|\bon\b|larger|>"
CUMULATIVE = r"cum|total|coarser|oversize|larger|>"
PER_CENT = r"%|\bpct\b|per\s*cent|percent"
MASS = r"\bk?g\b|grams?|kilo|mass|weight"
UNITS = ((r"\b(um|micron\w*)\b|[µμ]m", MICROMETRE), (r"\bmm\b", MM), (r'\b(in|inch\w*)\b|"', INCH))
PAN = r"pan|bottom|rest|receiver|fines"
SUMS = r"total|sum|all|products?"
# Sieves of ISO 565, R 20/3, from which a coarser limit is taken where none passes all [mm].
COARSER = (1, 1.4, 2, 2.8, 4, 5.6, 8, 11.2, 16, 22.4, 31.5, 45, 63, 90, 125, 180, 250, 355, 500)
# What the coarsest sieve may hold back for a limit above it to be taken; sums may err by this much.
TOP, LOSS = 0.2, 0.02
# Passing that falls with size by less is round-off of a table.
FALL = 0.002


@dataclass(frozen=True)
class Sieves:
    """A sieve analysis: limits of classes [m] from 0 up, and what is finer than each [1], 0 to 1.

    notes: what was taken for granted, a sentence each.
    """

    edges: tuple[float, ...]
    passing: tuple[float, ...]
    notes: tuple[str, ...] = ()


class Row(NamedTuple):
    """A line of the table: its number, the size as written, 0 for the pan, and the cells behind it.

    upper: of a row that is a class, such as 16-22.4; the size is its lower limit.
    """

    line: int
    size: float
    upper: float | None
    cells: tuple[float | None, ...]


def read_sieves(path: str | Path) -> Sieves:
    """A sieve analysis from a text file. Raises InputError that names the line, OSError."""
    path = Path(path)
    try:
        return _sieves(_lines(path))
    except InputError as error:
        error.add_note(f"in {path}")
        raise


def _lines(path: Path) -> list[tuple[int, str]]:
    """Lines that hold something, with their numbers; from # on is comment."""
    raw = path.read_bytes()
    if raw.startswith(b"PK"):
        raise InputError("the file is a spreadsheet: save the table as CSV", "sieves")
    text = decoded(raw)
    if text is None:
        raise InputError("the file is no text: save the table as CSV", "sieves")
    parted = enumerate((line.split("#")[0].strip() for line in text.splitlines()), start=1)
    return [(number, line) for number, line in parted if line.strip(";,\t ")]


def _sieves(lines: Sequence[tuple[int, str]]) -> Sieves:
    head, rows = _table(lines)
    notes: list[str] = []
    unit = _unit(head[0], notes)
    column, kind = _column(head, rows)
    shares: dict[float, tuple[float, int]] = {}
    for row in rows:
        cell = row.cells[column - 1] if column <= len(row.cells) else None
        if cell is None:
            raise InputError(f"line {row.line} has no number in column {column + 1}", "sieves")
        if not math.isfinite(cell) or cell < 0.0:
            raise InputError(f"line {row.line}: {cell:g} is no share of a mass: mend it", "sieves")
        before = shares.setdefault(row.size, (cell, row.line))
        if before[1] != row.line and (before[0] != cell or kind is _retained):
            raise InputError(
                f"lines {before[1]} and {row.line} give size {row.size:g} twice: leave one",
                "sieves",
            )
    coarsest = max(rows, key=lambda row: row.size)
    if coarsest.upper is not None and kind is not _passing:
        shares[coarsest.upper] = (0.0, coarsest.line)
    sizes = sorted(shares)
    label = head[column] if column < len(head) else ""
    passing = kind(sizes, [shares[size][0] for size in sizes], label, notes)
    return _closed(sizes, passing, unit, notes)


# --- the table -----------------------------------------------------------------------------------
def _number(cell: str, *, comma: bool) -> float | None:
    """A cell as a number, None if it is none; `comma`: whether decimals may stand behind one."""
    text = cell.strip().strip('"').rstrip("% ").strip()
    text = text.replace(",", ".") if comma and text.count(",") == 1 else text
    try:
        return float(text)
    except ValueError:
        return None


class Split(NamedTuple):
    """A way to part a line: by a separator, any blanks for None; whether commas are decimal."""

    separator: str | None
    comma: bool


SPLITS = (Split(";", True), Split("\t", True), Split(None, True), Split(",", False))


def _table(lines: Sequence[tuple[int, str]]) -> tuple[list[str], list[Row]]:
    """Head by column and rows, by the first separator that gives any."""
    for split in SPLITS:
        head, rows = _rows(lines, split)
        if len(rows) > 1:
            return head, rows
    raise InputError(
        "the file holds no table of sizes and shares: give a line for each sieve, such as 16;54.6, "
        "and a head that says what it is, such as size_mm;passing_pct",
        "sieves",
    )


def _rows(lines: Sequence[tuple[int, str]], split: Split) -> tuple[list[str], list[Row]]:
    heads: list[list[str]] = []
    rows: list[Row] = []
    for number, line in lines:
        cells = line.split(split.separator)
        values = tuple(_number(cell, comma=split.comma) for cell in cells[1:])
        limits = _limits(cells[0], comma=split.comma)
        # Between blanks every word would be a cell.
        full = None not in values if split.separator is None else set(values) != {None}
        if limits is not None and values and full:
            rows.append(Row(number, *limits, values))
        elif not rows:
            heads.append(cells)
        elif re.fullmatch(rf"\W*({SUMS})\W*", cells[0], re.IGNORECASE):
            continue
        elif len(rows) > 1:
            raise InputError(
                f"line {number} ({line[:40]!r}) is no sieve: give a size and a share, or pan for "
                "what is finer than all",
                "sieves",
            )
    columns = range(max(map(len, heads), default=1))
    labels = (" ".join(cells[k] for cells in heads if k < len(cells)) for k in columns)
    return [label.lower().replace("_", " ") for label in labels], rows


def _limits(cell: str, *, comma: bool) -> tuple[float, float | None] | None:
    """Size that a row begins with, and the upper limit of a class; 0 for what no sieve keeps."""
    text = re.sub(r"mm|um|[µμ]m|in\b|\"", "", cell).strip()
    if re.fullmatch(PAN, text, re.IGNORECASE):
        return 0.0, None
    number = r"([\d.,]*\d(?:e[+-]?\d+)?)"
    upper_first = re.fullmatch(rf"[-<]\s*{number}\s*[+>]\s*{number}", text)
    both = re.fullmatch(rf"{number}\s*(?:-|\u2013|/|to|\.\.+)\s*{number}", text)
    match = upper_first or both or re.fullmatch(rf"([-<+>≥]?)=?\s*{number}", text)
    if match is None:
        return None
    if not (upper_first or both):
        size = _number(match[2], comma=comma)
        return None if size is None else (0.0, size) if match[1] in ("-", "<") else (size, None)
    one, other = (_number(part, comma=comma) for part in match.groups())
    return None if one is None or other is None else (min(one, other), max(one, other))


def _unit(label: str, notes: list[str]) -> float:
    """Unit of the sizes, from the head of their column."""
    for pattern, unit in UNITS:
        if re.search(pattern, label):
            return unit
    if "mesh" in label:
        raise InputError(
            "sizes are given as mesh numbers, which do not say how wide an opening is: give the "
            "clear opening, size_mm",
            "sieves",
        )
    notes.append("no unit is given for the sizes: taken as mm")
    return MM


# --- what the shares are -------------------------------------------------------------------------
Reading = Callable[[Sequence[float], Sequence[float], str, list[str]], list[float]]


def _column(head: Sequence[str], rows: Sequence[Row]) -> tuple[int, Reading]:
    """The column to read and how; passing before what is retained in all before that by sieve."""
    found: list[tuple[int, int, Reading]] = []
    for place, label in enumerate(head):
        if place == 0:
            continue
        if re.search(PASSING, label):
            found.append((0, place, _passing))
        elif re.search(RETAINED, label) and re.search(CUMULATIVE, label):
            found.append((1, place, _coarser))
        elif re.search(RETAINED, label) or re.search(MASS, label):
            found.append((3 if re.search(MASS, label) else 2, place, _retained))
    if found:
        _, place, kind = min(found, key=lambda one: one[:2])
        return place, kind
    widths = {len([cell for cell in row.cells if cell is not None]) for row in rows}
    if widths != {1}:
        raise InputError(
            "the head does not say which column is meant: name one of them passing_pct or "
            "retained_pct",
            "sieves",
        )
    return 1, _by_shape(rows)


def _by_shape(rows: Sequence[Row]) -> Reading:
    """What a column without a name is, by its numbers."""
    ordered = [row.cells[0] or 0.0 for row in sorted(rows, key=lambda row: row.size)]
    whole = 100.0 if max(ordered) > 1.5 else 1.0
    rises = all(low <= high for low, high in pairwise(ordered))
    falls = all(low >= high for low, high in pairwise(ordered))
    by_sieve = abs(math.fsum(ordered) - whole) <= LOSS * whole
    could = [
        kind
        for kind, is_so in (
            (_passing, rises and ordered[-1] >= (1.0 - TOP) * whole),
            (_coarser, falls and ordered[-1] <= TOP * whole < ordered[0]),
            (_retained, by_sieve),
        )
        if is_so
    ]
    if len(could) != 1:
        raise InputError(
            "the numbers do not say whether they are what passes or what is retained: give a head, "
            "such as size_mm;passing_pct or size_mm;retained_pct",
            "sieves",
        )
    return could[0]


def _scale(values: Sequence[float], label: str) -> float:
    """What a share is to be multiplied by; a whole of 1 is one, also below a sign of per cent."""
    if re.search(PER_CENT, label) and 1.0 not in (max(values), math.fsum(values)):
        return PERCENT
    return PERCENT if max(values) > 1.5 and "fraction" not in label else 1.0


def _passing(
    sizes: Sequence[float], values: Sequence[float], label: str, notes: list[str]
) -> list[float]:
    del notes
    scale = _scale(values, label)
    found = [value * scale for value in values]
    for size, value in zip(sizes, found, strict=True):
        if value > 1.0 + FALL:
            raise InputError(
                f"{value / PERCENT:.4g} % pass size {size:g}, more than all: correct it", "sieves"
            )
    for (low, below), (high, above) in pairwise(zip(sizes, found, strict=True)):
        if above < below - FALL:
            raise InputError(
                f"{below / PERCENT:.4g} % pass size {low:g} and {above / PERCENT:.4g} % pass size "
                f"{high:g}: passing never falls with size; is it what is retained? Then say so in "
                "the head",
                "sieves",
            )
    return found


def _coarser(
    sizes: Sequence[float], values: Sequence[float], label: str, notes: list[str]
) -> list[float]:
    """From what all sieves from a size on retain together."""
    scale = _scale(values, label)
    finer = [1.0 - value * scale for value in values]
    if min(finer) < -FALL:
        raise InputError(
            f"{(1.0 - min(finer)) / PERCENT:.4g} % are retained in all, more than there is: "
            "correct it",
            "sieves",
        )
    return _passing(sizes, finer, "fraction", notes)


def _retained(
    sizes: Sequence[float], values: Sequence[float], label: str, notes: list[str]
) -> list[float]:
    """From what each sieve retains: a mass, or a share."""
    total = math.fsum(values)
    shares = not re.search(MASS, label) or re.search(PER_CENT, label)
    whole = 1.0 / _scale(values, label) if shares else total
    if total <= 0.0:
        raise InputError("nothing is retained on any sieve: give what was weighed", "sieves")
    pan = sizes[0] == 0.0
    falls = all(low >= high for low, high in pairwise(values))
    if total > whole * (1.0 + LOSS) and falls and values[0] <= whole * (1.0 + FALL):
        return _coarser(sizes, values, label, notes)  # by no sieve alone
    if total > whole * (1.0 + LOSS) or (pan and total < whole * (1.0 - LOSS)):
        raise InputError(
            f"what is retained sums to {total:.6g}, not to {whole:g}: correct it"
            + (", or say in the head that it is cumulative" if total > whole else ""),
            "sieves",
        )
    if pan or total > whole:
        if abs(total / whole - 1.0) > 1e-3:
            notes.append(f"what is retained sums to {total:.5g}, not to {whole:g}: scaled to it")
        whole = total
    elif not shares:
        notes.append(f"there is no pan: nothing is taken to be finer than size {sizes[0]:g}")
    return [1.0 - math.fsum(values[place:]) / whole for place in range(len(values))]


# --- from 0 to all -------------------------------------------------------------------------------
def _closed(
    sizes: Sequence[float], passing: Sequence[float], unit: float, notes: list[str]
) -> Sieves:
    """Limits from 0 up to what all passes, each finer share at least that below it."""
    finer = list(_rising(passing))
    places = [size * unit / MM for size in sizes]
    edges = [to_si(size, unit) for size in sizes]
    if edges[0] > 0.0:
        edges, finer, places = [0.0, *edges], [0.0, *finer], [0.0, *places]
    elif finer[0] > FALL:
        raise InputError(
            f"{finer[0] / PERCENT:.4g} % are finer than nothing: the share of the pan is 0 in a "
            "table of what passes",
            "sieves",
        )
    finer[0] = 0.0
    if finer[-1] < 1.0 - TOP:
        raise InputError(
            f"only {finer[-1] / PERCENT:.4g} % pass the largest sieve, {places[-1]:.4g} mm: give a "
            "sieve that all passes",
            "sieves",
        )
    if finer[-1] < 1.0 - 0.5 * FALL:
        coarser = next((size for size in COARSER if size > 1.2 * places[-1]), 1.4 * places[-1])
        notes.append(
            f"{(1.0 - finer[-1]) / PERCENT:.3g} % are coarser than the largest sieve, "
            f"{places[-1]:.4g} mm: taken as up to {coarser:.4g} mm"
        )
        edges, finer = [*edges, to_si(coarser, MM)], [*finer, 1.0]
    last = next(k for k, value in enumerate(finer) if value >= 1.0 - 0.5 * FALL)
    whole = [round(value, 6) for value in finer[:last]]
    return Sieves(tuple(edges[: last + 1]), (*whole, 1.0), tuple(notes))


def _rising(passing: Sequence[float]) -> Iterator[float]:
    most = 0.0
    for value in passing:
        most = min(max(most, value), 1.0)
        yield most
