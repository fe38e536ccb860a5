"""Which columns of an export are read, and as what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vibroscreen.columns import input_column, passing_columns, product_column
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.replay.table import column_named
from vibroscreen.stream import MOST_FED

__all__ = ["GRADATION", "INPUT", "PRODUCT", "RATE", "Channel", "channels_of"]

# What a channel is: a number of feed or motion, the gradation of the feed, a product as measured.
INPUT, GRADATION, PRODUCT = "input", "gradation", "product"
RATE = "mass_flow_rate"


@dataclass(frozen=True)
class Channel:
    """What one or, of a gradation, several columns give.

    name: what people read; key: field of Feed or Motion, or the product; factor: from a cell to SI;
    least, most: limits in SI.
    """

    role: str
    name: str
    key: str
    columns: tuple[str, ...]
    factor: float = 1.0
    least: float = -np.inf
    most: float = np.inf

    @property
    def is_rate(self) -> bool:
        """Whether it is what a scale reads: such numbers never stand still, unless at 0."""
        return self.role == PRODUCT or self.key == RATE


def channels_of(
    columns: Sequence[str], told: Mapping[str, str], config: ScreenConfig
) -> tuple[Channel, ...]:
    """Channels among the columns of a file; told: columns by key, others are known by their names.

    Raises InputError.
    """
    decks = len(config.decks)
    by_key = {key.lower(): column_named(columns, name, key) for key, name in told.items()}
    for column in columns:
        key = column.strip().lower()
        if column not in by_key.values() and _known(key, decks):
            by_key.setdefault(key, column)
    passing = passing_columns(by_key, config.size_classes.edges)
    gradation = tuple(passing.values())
    found = [_channel(key, name, decks) for key, name in by_key.items() if key not in gradation]
    keys = [channel.key for channel in found]
    if twice := {key for key in keys if keys.count(key) > 1}:
        names = " and ".join(repr(one.name) for one in found if one.key in twice)
        raise InputError(f"columns {names} give the same number: leave one", "column")
    if RATE not in keys:
        named = ", ".join(column for column in columns if column)[:300]
        raise InputError(f"no column is told to be the feed rate: give --rate; there are {named}")
    if gradation:
        found.append(Channel(GRADATION, "passing", "passing", tuple(by_key[k] for k in gradation)))
    return tuple(found)


def _channel(key: str, name: str, decks: int) -> Channel:
    if (product := product_column(key, decks)) is not None:
        return Channel(PRODUCT, name, product[0], (name,), product[1], 0.0, MOST_FED)
    column = input_column(key)
    return Channel(INPUT, name, column.field, (name,), column.factor, *column.entry.limits)


def _known(key: str, decks: int) -> bool:
    """Whether a column is known by its name, which must tell a unit."""
    if key.startswith("passing_") or product_column(key, decks) is not None:
        return True
    try:
        return input_column(key).factor != 0.0
    except InputError:
        return False
