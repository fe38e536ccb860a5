"""Numbers of the model that are fitted: names, bounds, scales."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.errors import InputError

__all__ = ["Parameter"]

Array = NDArray[np.float64]

SCALES = ("log", "linear")


@dataclass(frozen=True)
class Parameter:
    """A number to be fitted between its bounds, in the unit of the variable.

    name: of the FMU's variable, such as "passage.velocity". sets: the variables that take its
    value, where they are others or several (`("bed.contact_depth", "bed.layer_depth")`), or none
    for a number that only a closure reads. start: the first start, by default the value of the
    first run's configuration or, without one, the middle. scale: "log" for what is known by its
    order of magnitude, or "linear". runs: the names of the runs that it acts on, all unless given;
    so one variable may have a number for every run, under names of their own. Raises InputError.
    """

    name: str
    lower: float
    upper: float
    start: float | None = None
    scale: str = "log"
    sets: tuple[str, ...] | None = None
    runs: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.scale not in SCALES:
            raise InputError(
                f"{self.name}: scale = {self.scale!r} is unknown: give one of {', '.join(SCALES)}"
            )
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise InputError(
                f"{self.name} has the bounds {self.lower:g} to {self.upper:g}: give finite ones"
            )
        if self.lower >= self.upper:
            raise InputError(
                f"{self.name} has the lower bound {self.lower:g}, not below the upper one "
                f"{self.upper:g}: give the lower bound first"
            )
        if self.scale == "log" and self.lower <= 0.0:
            raise InputError(
                f'{self.name} has the lower bound {self.lower:g}, and scale "log" needs one above '
                '0: raise it, or use scale = "linear"'
            )
        if self.start is not None and not self.lower <= self.start <= self.upper:
            raise InputError(
                f"{self.name} starts at {self.start:g}, outside of its bounds {self.lower:g} to "
                f"{self.upper:g}: widen them or give another start"
            )

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables that take the value."""
        return (self.name,) if self.sets is None else self.sets

    def acts_on(self, run: str) -> bool:
        """Whether a run takes the value."""
        return self.runs is None or run in self.runs

    def to_scale(self, value: float | Array) -> Any:
        """The value on its scale."""
        return np.log(value) if self.scale == "log" else value

    def from_scale(self, place: float | Array) -> Any:
        return np.exp(np.clip(place, -300.0, 300.0)) if self.scale == "log" else place
