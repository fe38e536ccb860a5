"""Crusher, mixer and conveyor as FMI 2.0 slaves: streams come in and go out, step by step.

A stream is its mass flow rate and its composition, `<name>.mass_flow_rate` in kg/s and
`<name>.mass_fraction[i]`, finest class first, as those of the screen. Outputs are means over the
last step and change only in a step: before the first one nothing has flowed.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from components.conveyor import Conveyor
from components.crusher import ConeCrusher
from components.mixer import mix
from components.stream import Array
from vibroscreen.errors import InputError
from vibroscreen.stream import Feed
from vibroscreen_fmu.port import Port
from vibroscreen_fmu.row_slave import RowSlave

__all__ = ["UNIT_FILE", "ConveyorSlave", "CrusherSlave", "MixerSlave", "Unit"]

UNIT_FILE = "unit.json"  # in the resources of the FMU


@dataclass(frozen=True)
class Unit:
    """What a unit is built for: N + 1 limits of its size classes, m, and its own numbers, SI."""

    edges: tuple[float, ...]
    numbers: Mapping[str, float]
    composition: tuple[float, ...]  # of streams before they flow, 1

    def to_json(self) -> str:
        """The text that `from_json` reads."""
        return json.dumps(vars(self) | {"numbers": dict(self.numbers)}, indent=1)

    @classmethod
    def from_json(cls, text: str) -> Unit:
        """What `to_json` wrote."""
        read = json.loads(text)
        return cls(tuple(read["edges"]), read["numbers"], tuple(read["composition"]))


def _port(name: str, unit: str, text: str, causality: str, **more: Any) -> Port:
    """A real variable of the model's own; it gets its place in the row later."""
    kept: dict[str, Any] = {"variability": "continuous", "start": None, "least": None}
    return Port(
        name=name,
        reference=-1,
        description=text,
        causality=causality,
        kind="Real",
        unit=unit,
        most=None,
        enumeration=None,
        path=(),
        display=True,
        **(kept | more),
    )


def _stream(name: str, text: str, causality: str, unit: Unit, rate: float = 0.0) -> Iterator[Port]:
    """Rate and composition of a stream; an input starts at `rate` kg/s."""
    given = causality == "input"
    yield _port(
        f"{name}.mass_flow_rate",
        "kg/s",
        text,
        causality,
        start=rate if given else None,
        least=0.0,
    )
    for i, fraction in enumerate(unit.composition, start=1):
        yield _port(
            f"{name}.mass_fraction[{i}]",
            "1",
            f"{text}: mass fraction of class {i}",
            causality,
            start=fraction if given else None,
            least=0.0,
        )


def _numbered(ports: Iterable[Port]) -> tuple[Port, ...]:
    return tuple(replace(port, reference=place) for place, port in enumerate(ports))


class UnitSlave(RowSlave):
    """A unit operation: its variables lie in a row, its size classes among them as constants."""

    def __init__(self, **kwargs: Any) -> None:
        text = (Path(kwargs["resources"]) / UNIT_FILE).read_text(encoding="utf-8")
        self._unit = Unit.from_json(text)
        table = self.table(self._unit)
        super().__init__(table, **kwargs)
        self._place = {port.name: port.reference for port in table}
        values = np.array([0.0 if port.start is None else port.start for port in table])
        self.take(values)
        for port in table:
            if port.causality == "output" and port.name.endswith(".mass_flow_rate"):
                values[self._fractions(port.name.rpartition(".")[0])] = self._unit.composition

    @classmethod
    def table(cls, unit: Unit) -> tuple[Port, ...]:
        """All variables of the unit."""
        classes = (
            _port(
                f"size_class[{i}].{title}",
                "m",
                f"{title.capitalize()} limit of size class {i}",
                "local",
                variability="constant",
                start=unit.edges[i - 1 + (title == "upper")],
            )
            for i in range(1, len(unit.edges))
            for title in ("lower", "upper")
        )
        return _numbered((*cls.own_ports(unit), *classes))

    @classmethod
    @abstractmethod
    def own_ports(cls, unit: Unit) -> Iterable[Port]:
        """Parameters, inputs and outputs."""

    # --- the row ------------------------------------------------------------------------------
    def value(self, name: str) -> float:
        """Value of a variable."""
        return float(self._values[self._place[name]])

    def put(self, name: str, value: float) -> None:
        """Set an output."""
        self._values[self._place[name]] = value

    def rates(self, name: str) -> Array:
        """Rate by class of a stream that comes in, kg/s; raises InputError as a Feed does."""
        try:
            fractions = self._values[self._fractions(name)]
            return Feed(self.value(f"{name}.mass_flow_rate"), tuple(fractions.tolist())).class_rates
        except InputError as error:
            raise InputError(f"{name}{str(error).removeprefix('feed')}") from None

    def put_rates(self, name: str, rates: Array) -> None:
        """Set a stream that goes out; without flow its composition stays."""
        total = float(rates.sum())
        self.put(f"{name}.mass_flow_rate", total)
        if total > 0.0:
            self._values[self._fractions(name)] = rates / total

    def _fractions(self, name: str) -> slice:
        first = self._place[f"{name}.mass_fraction[1]"]
        return slice(first, first + len(self._unit.composition))

    # --- state --------------------------------------------------------------------------------
    def memory(self) -> bytes:
        """The row, and what the unit holds."""
        return self._values.tobytes() + self.held().tobytes()

    def recall(self, memory: bytes) -> None:
        """Take back what `memory` gave."""
        numbers = np.frombuffer(memory)
        self._values[:], held = numbers[: self._values.size], numbers[self._values.size :]
        self.hold(held)

    def held(self) -> Array:
        """What the unit remembers besides its variables: nothing."""
        return np.empty(0)

    def hold(self, held: Array) -> None:
        """Take back what `held` gave."""


class CrusherSlave(UnitSlave):
    """A cone crusher: `feed` becomes `product` at once."""

    _made: ConeCrusher | None = None

    @classmethod
    def own_ports(cls, unit: Unit) -> Iterable[Port]:
        """Setting, feed, product, power."""
        yield _port(
            "closed_side_setting",
            "m",
            "Smallest gap between mantle and concave",
            "parameter",
            variability="tunable",
            start=unit.numbers["closed_side_setting"],
        )
        yield from _stream("feed", "What is crushed", "input", unit)
        yield from _stream("product", "What leaves the crusher", "output", unit)
        yield _port("drive.power", "W", "Electric power of the drive", "output")

    def start(self) -> None:
        """Refuse a setting that is none."""
        self._crusher()

    def advance(self, duration: float) -> None:
        """Crush the feed; nothing is held."""
        _check(duration)
        feed, crusher = self.rates("feed"), self._crusher()
        self.put_rates("product", crusher.crush(feed))
        self.put("drive.power", crusher.power(feed))

    def _crusher(self) -> ConeCrusher:
        setting = self.value("closed_side_setting")
        if self._made is None or self._made.closed_side_setting != setting:
            self._made = ConeCrusher(np.array(self._unit.edges), setting)
        return self._made


class MixerSlave(UnitSlave):
    """A chute: `inlet[1]`, `inlet[2]`, ... become `outlet` at once."""

    @classmethod
    def own_ports(cls, unit: Unit) -> Iterable[Port]:
        """Inlets, the first of which may flow from the start, and the outlet."""
        for k in range(1, cls._inlets(unit) + 1):
            rate = unit.numbers["fresh_feed"] if k == 1 else 0.0
            yield from _stream(f"inlet[{k}]", f"What comes in at inlet {k}", "input", unit, rate)
        yield from _stream("outlet", "What leaves the mixer", "output", unit)

    @staticmethod
    def _inlets(unit: Unit) -> int:
        return int(unit.numbers["inlets"])

    def start(self) -> None:
        """Nothing to do: nothing is held."""

    def advance(self, duration: float) -> None:
        """Add the streams class by class."""
        _check(duration)
        inlets = range(1, self._inlets(self._unit) + 1)
        self.put_rates("outlet", mix(*(self.rates(f"inlet[{k}]") for k in inlets)))


class ConveyorSlave(UnitSlave):
    """A belt: `feed` leaves as `discharge` a fixed time later."""

    _belt: Conveyor | None = None

    @classmethod
    def own_ports(cls, unit: Unit) -> Iterable[Port]:
        """Delay, feed, discharge, what lies on the belt."""
        yield _port(
            "delay",
            "s",
            "Time on the belt: its length over its speed",
            "parameter",
            variability="fixed",
            start=unit.numbers["delay"],
        )
        yield from _stream("feed", "What is loaded", "input", unit)
        yield from _stream("discharge", "What leaves the belt", "output", unit)
        yield _port("belt.mass", "kg", "What lies on the belt", "output")

    def start(self) -> None:
        """An empty belt."""
        self._belt = Conveyor(self.value("delay"), len(self._unit.composition))

    def advance(self, duration: float) -> None:
        """Load what comes in, unload what has travelled long enough."""
        _check(duration)
        assert self._belt is not None  # it has started
        self.put_rates("discharge", self._belt.carry(self.rates("feed"), duration))
        self.put("belt.mass", float(self._belt.held.sum()))

    def held(self) -> Array:
        """Parcels on the belt; none before the start."""
        return np.empty(0) if self._belt is None else self._belt.parcels

    def hold(self, held: Array) -> None:
        """Put parcels on the belt."""
        self._belt = None
        if held.size:
            self._belt = Conveyor(self.value("delay"), len(self._unit.composition))
            self._belt.parcels = held.reshape(-1, 1 + len(self._unit.composition))


def _check(duration: float) -> None:
    if not 0.0 < duration < np.inf:
        raise InputError(f"dt = {duration!r} s is not a finite positive time: give it in seconds")
