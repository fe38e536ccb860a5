"""What an FMI variable is: its unit and how people see it, its choices, its place.

Apart from the variables of the screen, so that FMUs of other units of a plant need no engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vibroscreen.units import DEG, KN, KW, KWH_T, MINUTE, MM, RPM, T_H, T_M3, TONNE

__all__ = ["TOLERANCE", "UNITS", "Enumeration", "Port", "Steps", "Unit"]

Steps = tuple[str | int, ...]
# Where a configuration has the tolerance that a host may give for its experiment.
TOLERANCE: Steps = ("solver", "tolerance")


@dataclass(frozen=True)
class Unit:
    """A unit by its base units; how people at a plant see it: a name and its size in the unit."""

    base: Mapping[str, int]
    display: str | None = None
    display_size: float = 1.0
    nominal: float = 1.0


UNITS = {
    "1": Unit({}),
    "kg/s": Unit({"kg": 1, "s": -1}, "t/h", T_H, nominal=100.0),
    "kg": Unit({"kg": 1}, "t", TONNE, nominal=1000.0),
    "m": Unit({"m": 1}, "mm", MM, nominal=0.01),
    "m/s": Unit({"m": 1, "s": -1}, nominal=0.1),
    "s": Unit({"s": 1}, "min", MINUTE, nominal=100.0),
    "rad": Unit({"rad": 1}, "deg", DEG),
    "Hz": Unit({"s": -1}, "1/min", RPM, nominal=10.0),
    "kg/m3": Unit({"kg": 1, "m": -3}, "t/m3", T_M3, nominal=1000.0),
    "N": Unit({"kg": 1, "m": 1, "s": -2}, "kN", KN, nominal=100_000.0),
    "W": Unit({"kg": 1, "m": 2, "s": -3}, "kW", KW, nominal=10_000.0),
    "J/kg": Unit({"m": 2, "s": -2}, "kWh/t", KWH_T, nominal=10_000.0),
}


@dataclass(frozen=True)
class Enumeration:
    """A choice: the name of its type, and its items (name, meaning), numbered from 1."""

    name: str
    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Port:
    """An FMI variable.

    reference: value reference, the place in the buffer from the first parameter on. kind: FMI type.
    display: whether it is shown in the unit's display unit. least and most: limits, None where
    there is none. start: None for what is calculated. path: where a parameter sits in ScreenConfig.
    """

    name: str
    reference: int
    description: str
    causality: str
    variability: str
    kind: str
    unit: str = "1"
    display: bool = True
    least: float | None = None
    most: float | None = None
    start: float | None = None
    enumeration: Enumeration | None = None
    path: Steps = ()
