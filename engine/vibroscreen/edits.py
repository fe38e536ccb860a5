"""Changes of a screen file by key: 18 for `deck[1].panel[1].aperture_mm`."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from vibroscreen.errors import ConfigError
from vibroscreen.fields import leaves

__all__ = ["edited"]


def edited(kind: Any, tree: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The tree of a TOML file with other values by key; None takes a key out.

    kind: the dataclass that the file describes. A place is needed only where there are several of a
    kind. What says the same by another key goes, as `feed.mass_fraction` where `feed.passing` is
    given. A key that is unknown goes in all the same: who reads the tree tells of it. Raises
    ConfigError for a place that the file does not have.
    """
    whole = copy.deepcopy(dict(tree))
    for key, value in changes.items():
        _put(kind, whole, key, value)
    return whole


def _put(kind: Any, whole: dict[str, Any], key: str, value: Any) -> None:
    table: Any = whole
    *tables, last = steps = key.split(".")
    for depth, step in enumerate(tables, start=1):
        name, place = _parted(key, step)
        inside = table.setdefault(name, {} if place is None else [{}])
        if isinstance(inside, list):
            inside = inside[_place(key, ".".join(steps[:depth]), inside, place)]
        if not isinstance(inside, dict):
            raise ConfigError(f"{key}: {'.'.join(steps[:depth])} is no table of the file")
        table = inside
    name, place = _parted(key, last)
    if place is not None:
        values = table.get(name)
        if not isinstance(values, list):
            raise ConfigError(f"{key}: the file gives no list {name} there: give all of it")
        values[_place(key, key, values, place)] = value
        return
    plain = re.sub(r"\[\d+\]", "", key)
    for other in next((entry.keys for path, entry in leaves(kind) if path == plain), ()):
        table.pop(other, None)
    table[name] = value
    if value is None:
        del table[name]


def _parted(key: str, step: str) -> tuple[str, int | None]:
    """The name of a step and its place in a list, from 1."""
    match = re.fullmatch(r"([\w-]+)(?:\[(\d+)\])?", step)
    if match is None:
        raise ConfigError(
            f"{key} is no key: write it as deck[1].panel[1].aperture_mm, with the words of the file"
        )
    return match[1], None if match[2] is None else int(match[2])


def _place(key: str, name: str, items: list[Any], place: int | None) -> int:
    """The index in a list; without a place that of the only item."""
    several = len(items) > 1
    stem = name.rpartition("[")[0] if place is not None else name
    if place is None and several:
        raise ConfigError(f"{key}: the file has {stem}[1] to {stem}[{len(items)}]: say which")
    if place is not None and not 1 <= place <= len(items):
        there = f"{stem}[1] to {stem}[{len(items)}]" if several else f"{stem}[1] only"
        raise ConfigError(f"{key}: the file has {there}: give one of these, or add it to the file")
    return 0 if place is None else place - 1
