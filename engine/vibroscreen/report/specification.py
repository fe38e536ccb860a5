"""Specification of a product: between which limits its gradation has to lie."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.errors import InputError
from vibroscreen.fields import nearest
from vibroscreen.stream import ROUND_OFF, Stream
from vibroscreen.units import MM, PERCENT

__all__ = ["Reading", "Specification", "read_specification"]

Array = NDArray[np.float64]

SIZE, LEAST, MOST, PRODUCT = "size_mm", "least_percent", "most_percent", "product"
UNDERSIZE = "undersize"


class Reading(NamedTuple):
    """What passes a size [m] in a product, and between which limits it should lie [1]."""

    size: float
    least: float
    most: float
    passing: float

    @property
    def met(self) -> bool:
        """Whether it lies between them."""
        return self.least - ROUND_OFF <= self.passing <= self.most + ROUND_OFF


@dataclass(frozen=True, eq=False, init=False)
class Specification:
    """Limits of the gradation of a product.

    product: "undersize", "oversize" or "intermediate[k]"; size [m], ascending; least and most: mass
    fraction finer than each size [1]. Raises InputError.
    """

    product: str
    size: Array
    least: Array
    most: Array

    def __init__(self, product: str, size: ArrayLike, least: ArrayLike, most: ArrayLike) -> None:
        given = {"size": size, "least": least, "most": most}
        object.__setattr__(self, "product", product)
        for name, values in given.items():
            object.__setattr__(self, name, np.asarray(values, dtype=float))
        self._check()

    def _check(self) -> None:
        shapes = {self.size.shape, self.least.shape, self.most.shape}
        if len(shapes) > 1 or self.size.ndim != 1 or self.size.size == 0:
            raise InputError(
                f"specification of {self.product}: {self.size.size} sizes, {self.least.size} least "
                f"and {self.most.size} most passing: give one of each a size, in rows of one length"
            )
        for k, (size, least, most) in enumerate(zip(self.size, self.least, self.most, strict=True)):
            here = f"specification of {self.product} at {size / MM:.6g} mm"
            if not (math.isfinite(size) and size > 0.0):
                raise InputError(f"{here}: not a finite size above 0: give the opening of a sieve")
            if k > 0 and size <= self.size[k - 1]:
                raise InputError(
                    f"{here}: not larger than the size before, {self.size[k - 1] / MM:.6g} mm: "
                    "give every size once"
                )
            for share in (least, most):
                if not 0.0 <= share <= 1.0:
                    raise InputError(
                        f"{here}: {share / PERCENT:.6g} % passing is out of range (0 to 100 %)"
                    )
            if least > most:
                raise InputError(
                    f"{here}: at least {least / PERCENT:.6g} % and at most {most / PERCENT:.6g} % "
                    "exclude each other: swap them"
                )

    def readings(self, edges: Sequence[float], product: Stream) -> tuple[Reading, ...]:
        """The product at every size; between limits of classes [m] the mass lies evenly."""
        passing = np.interp(self.size, edges, product.passing)
        rows = zip(self.size, self.least, self.most, passing, strict=True)
        return tuple(Reading(*map(float, row)) for row in rows)


def read_specification(path: str | Path) -> tuple[Specification, ...]:
    """Specifications of a CSV file: size_mm, least_percent, most_percent, and product if several.

    An empty cell is no limit; without the column `product` it is the undersize. Lines from # on
    are comment. Raises InputError with the line of what cannot be used, OSError.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        return _specifications([(k, line) for k, line in enumerate(lines, start=1)])
    except InputError as error:
        error.add_note(f"in {path}")
        raise


def _specifications(lines: Sequence[tuple[int, str]]) -> tuple[Specification, ...]:
    kept = [(k, line.split("#")[0]) for k, line in lines if line.split("#")[0].strip()]
    rows = [next(csv.reader([line])) for _, line in kept]
    names = [cell.strip() for cell in rows[0]] if rows else []
    for name in names:
        if name not in (SIZE, LEAST, MOST, PRODUCT):
            known = (SIZE, LEAST, MOST, PRODUCT)
            raise InputError(f"column {name!r} is unknown: did you mean {nearest(name, known)!r}?")
    for name in (SIZE, LEAST, MOST):
        if name not in names:
            raise InputError(
                f"column {name!r} is missing: a specification has {SIZE}, {LEAST} and {MOST}"
            )
    found: dict[str, list[tuple[float, float, float]]] = {}
    for (number, _), cells in zip(kept[1:], rows[1:], strict=True):
        if len(cells) != len(names):
            raise InputError(f"line {number} has not {len(names)} cells as the head")
        row = dict(zip(names, (cell.strip() for cell in cells), strict=True))
        limits = (
            _number(number, row, SIZE) * MM,
            _number(number, row, LEAST, empty=0.0) * PERCENT,
            _number(number, row, MOST, empty=100.0) * PERCENT,
        )
        found.setdefault(row.get(PRODUCT) or UNDERSIZE, []).append(limits)
    if not found:
        raise InputError("the specification holds no rows: give one a size")
    return tuple(Specification(name, *np.array(sorted(rows)).T) for name, rows in found.items())


def _number(line: int, row: dict[str, str], column: str, empty: float | None = None) -> float:
    """A cell as a number; `empty` for an empty one, if that may be."""
    text = row[column]
    if not text and empty is not None:
        return empty
    try:
        return float(text)
    except ValueError:
        raise InputError(f"line {line}: {column} = {text!r} is not a number: give one") from None
