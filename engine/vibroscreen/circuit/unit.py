"""What every unit of a circuit is: a name, where its outlets lead, what it makes of a feed.

A stream is its mass flow rate by size class, finest first [kg/s]. Many designs of one flowsheet are
computed together: arrays have the design first, [design, class].
"""

from __future__ import annotations

import dataclasses
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.errors import ConfigError
from vibroscreen.fields import Number, Text, check_fields, entries, fields_alone, said

__all__ = ["Array", "Given", "Name", "Running", "Target", "Unit", "apply", "numbers_of"]

Array = NDArray[np.float64]

Given: TypeAlias = Mapping[str, Array]
"""Numbers of a unit that are not the same in all designs, by field: [design]."""

_NAME = re.compile(r"\w[\w /+-]*")


class Name(Text):
    """What a unit, a feed or a product is called: it begins variables, so it has no dot."""

    def check(self, name: str, value: Any) -> str:
        text = super().check(name, value)
        if not _NAME.fullmatch(text):
            raise ConfigError(
                f"{name} = {text!r} is no name: use letters, digits, spaces and / + - _"
            )
        return text


class Target(Text):
    """Where an outlet leads: the name of a unit or a product."""


@dataclass(frozen=True)
class Unit(ABC):
    """A unit operation. Raises ConfigError with name, value, limit and cure."""

    name: str = said(dataclasses.MISSING, Name("name"))

    def __post_init__(self) -> None:
        check_fields(self, self.name if isinstance(self.name, str) else "unit")

    @property
    def targets(self) -> dict[str, str]:
        """Name of the unit or product that each outlet leads to."""
        return {
            outlet: getattr(self, outlet)
            for outlet, entry in entries(type(self)).items()
            if isinstance(entry, Target)
        }

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """The same unit with other numbers by field, SI, checked again."""
        return dataclasses.replace(self, **values)

    __getstate__ = fields_alone
    has_drive: ClassVar = False

    def power(self, edges: Array, feed: Array, product: Array, given: Given | None = None) -> Array:
        """Electric power under a feed and its product [..., N; kg/s], W; 0 without a drive."""
        return np.zeros(feed.shape[:-1])

    def number(self, given: Given | None, field: str) -> Array:
        """A number of every design [design, 1], or the one of all [1, 1]."""
        own = getattr(self, field)
        return of_designs(own if given is None else given.get(field, own))

    @abstractmethod
    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        """What each outlet gets of the feed: a share by class [1 or design, class], or a matrix.

        A matrix [1 or design, class out, class in] where grains change their size. `edges`: the
        limits of the classes [m].
        """

    @abstractmethod
    def start(self, edges: Array) -> Running:
        """The unit as it runs through time, empty."""


class Running(ABC):
    """A unit that runs through time."""

    @property
    def held(self) -> Array:
        """Mass inside the unit by size class [kg], shape [N]; 0 unless it holds something."""
        return np.zeros(1)

    @property
    def memory(self) -> Array:
        """All that it remembers from one step to the next, a row of numbers."""
        return np.empty(0)

    @memory.setter
    def memory(self, row: Array) -> None:
        """Go back to what `memory` gave."""
        assert row.size == 0  # it holds nothing

    @abstractmethod
    def step(self, feed: Array, dt: float) -> dict[str, Array]:
        """Mean rates by class [kg/s] of every outlet over a step of dt [s], the feed constant."""


class Mixed(Running):
    """A unit in which all that it holds is perfectly mixed, and nothing else is remembered."""

    def __init__(self, edges: Array) -> None:
        """Empty; `edges`: the limits of the classes."""
        self._held = np.zeros(edges.size - 1)

    @property
    def held(self) -> Array:
        return self._held

    @property
    def memory(self) -> Array:
        return self._held.copy()

    @memory.setter
    def memory(self, row: Array) -> None:
        self._held = row.copy()


def apply(transfer: Array, streams: Array) -> Array:
    """What a transfer makes of streams [design, class, any number of them]."""
    if transfer.ndim == 3:
        return np.asarray(transfer @ streams)
    return transfer[:, :, None] * streams


def numbers_of(kind: type) -> dict[str, Number]:
    """The numbers of a unit that may differ between designs, by field."""
    return {
        field: entry
        for field, entry in entries(kind).items()
        if isinstance(entry, Number) and not entry.whole
    }


def of_designs(value: ArrayLike) -> Array:
    """A number of every design [design, 1], or the one of all."""
    return np.atleast_1d(np.asarray(value, dtype=float))[:, None]
