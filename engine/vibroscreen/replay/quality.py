"""What is wrong with the numbers of a historian: found, counted, never mended in silence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import InputError

__all__ = ["Finding", "Limits", "limited", "spikes", "stuck"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Neighbours that a value is compared with, itself among them, and the least scatter that counts, as
# a part of the usual value: steadier signals move so much for good reasons.
WINDOW, LEAST_SCATTER = 5, 0.01


class Finding(NamedTuple):
    """What is to be told of the data: of which column, in how many rows, when first."""

    column: str
    what: str
    rows: int
    first: str


@dataclass(frozen=True)
class Limits:
    """When a value is told to be wrong.

    spike: so many times the usual scatter beyond all of its neighbours, 0 for never; stuck: the
    same number for longer than this [s], 0 for never; gap: rows further apart are a gap in time
    [s], None for three times the usual interval.
    """

    spike: float = 10.0
    stuck: float = 1800.0
    gap: float | None = None

    def __post_init__(self) -> None:
        for name in ("spike", "stuck", "gap"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < np.inf:
                raise InputError(f"{name} = {value:g} is not a number from 0 up: give one", name)


def spikes(values: Array, times: float) -> Mask:
    """Single values far above or below all four neighbours; not beside a stop."""
    found = np.zeros(values.size, dtype=bool)
    there = np.flatnonzero(np.isfinite(values))
    if times == 0.0 or there.size < WINDOW:
        return found
    windows = np.lib.stride_tricks.sliding_window_view(values[there], WINDOW)
    middle, around = windows[:, WINDOW // 2], np.delete(windows, WINDOW // 2, axis=1)
    scatter = 1.4826 * np.median(np.abs(middle - np.median(windows, axis=1)))
    limit = times * max(scatter, LEAST_SCATTER * float(np.median(np.abs(middle))))
    away = np.maximum(middle - around.max(axis=1), around.min(axis=1) - middle)
    far = (away > limit) & (around > 0.0).all(axis=1) & (middle != 0.0)
    found[there[WINDOW // 2 : -(WINDOW // 2)]] = far
    return found


def stuck(values: Array, seconds: Array, longest: float) -> Mask:
    """Where the same number, other than 0, stands for longer than `longest` s."""
    found = np.zeros(values.size, dtype=bool)
    if longest == 0.0 or values.size == 0:
        return found
    change = np.flatnonzero(np.diff(values) != 0.0) + 1  # nan differs from all
    for first, last in zip([0, *change], [*change, values.size], strict=True):
        if seconds[last - 1] - seconds[first] > longest and values[first] != 0.0:
            found[first:last] = True
    return found


def limited(values: Array, least: float, most: float) -> tuple[Mask, Mask]:
    """Where values lie below zero though they may not, and where they are out of all limits."""
    with np.errstate(invalid="ignore"):
        below = (values < 0.0) & (least >= 0.0)
        return below, ((values < least) & ~below) | (values > most)
