"""A unit of a circuit as an FMI 2.0 slave: streams come in and go out, step by step.

A stream is its mass flow rate and its composition, `<name>.mass_flow_rate` in kg/s and
`<name>.mass_fraction[i]`, finest class first, as those of the screen. Outputs are means over the
last step and change only in a step: before the first one nothing has flowed.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vibroscreen.circuit.crusher import ConeCrusher, Crusher, JawCrusher
from vibroscreen.circuit.handling import Bin, Conveyor, Mixer, Splitter
from vibroscreen.circuit.unit import Array, Running, Unit, numbers_of
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.fields import read_table, write_table
from vibroscreen.stream import Feed
from vibroscreen_fmu.port import Port
from vibroscreen_fmu.row_slave import RowSlave

__all__ = ["UNIT_FILE", "Inlet", "UnitModel", "UnitSlave"]

UNIT_FILE = "unit.json"  # in the resources of the FMU
KINDS = {kind.__name__: kind for kind in (ConeCrusher, JawCrusher, Mixer, Splitter, Conveyor, Bin)}


@dataclass(frozen=True)
class Inlet:
    """What a unit is fed at an inlet unless it is connected: kg/s, and composition by class."""

    rate: float
    composition: tuple[float, ...]


@dataclass(frozen=True)
class UnitModel:
    """A unit on its size classes (N + 1 limits, m), with its inlets."""

    unit: Unit
    edges: tuple[float, ...]
    inlets: tuple[Inlet, ...]

    def to_json(self) -> str:
        """The text that `from_json` reads."""
        told = {
            "kind": type(self.unit).__name__,
            "unit": write_table(self.unit),
            "edges": self.edges,
            "inlets": [dataclasses.asdict(inlet) for inlet in self.inlets],
        }
        return json.dumps(told, indent=1)

    @classmethod
    def from_json(cls, text: str) -> UnitModel:
        """What `to_json` wrote."""
        told = json.loads(text)
        unit = read_table(KINDS[told["kind"]], told["unit"], "", Path())
        inlets = (Inlet(inlet["rate"], tuple(inlet["composition"])) for inlet in told["inlets"])
        return cls(unit, tuple(told["edges"]), tuple(inlets))

    def feeds(self) -> tuple[str, ...]:
        """Names of the streams that come in."""
        count = len(self.inlets)
        return ("feed",) if count == 1 else tuple(f"feed[{k}]" for k in range(1, count + 1))

    def ports(self) -> tuple[Port, ...]:
        """All variables; the place of each is its value reference."""
        found = (*self._numbers(), *self._streams(), *self._rest(), *self._classes())
        return tuple(dataclasses.replace(port, reference=k) for k, port in enumerate(found))

    def _numbers(self) -> Iterator[Port]:
        for field, entry in numbers_of(type(self.unit)).items():
            value = getattr(self.unit, field)
            if value is not None:
                about = {"variability": entry.variability, "start": value}
                least, most = entry.bounds
                text = entry.tells or field.replace("_", " ").capitalize()
                yield _port(field, entry.unit, text, "parameter", least=least, most=most, **about)

    def _streams(self) -> Iterator[Port]:
        for name, inlet in zip(self.feeds(), self.inlets, strict=True):
            yield from _stream(name, "What comes in", "input", inlet)
        for outlet in self.unit.targets:
            inlet = self.inlets[0]
            yield from _stream(outlet, f"What leaves as {outlet}", "output", inlet)

    def _rest(self) -> Iterator[Port]:
        if self.unit.has_drive:
            yield _port("drive.power", "W", "Electric power of the drive", "output")
        if isinstance(self.unit, Conveyor | Bin | Crusher):
            yield _port("held.mass", "kg", "What lies inside", "output")
        if isinstance(self.unit, Crusher):
            text = "Fed more than it takes: it would choke"
            yield dataclasses.replace(
                _port("alarm.capacity", "1", text, "output"), kind="Boolean", variability="discrete"
            )

    def _classes(self) -> Iterator[Port]:
        for i in range(1, len(self.edges)):
            for title in ("lower", "upper"):
                yield _port(
                    f"size_class[{i}].{title}",
                    "m",
                    f"{title.capitalize()} limit of size class {i}",
                    "local",
                    variability="constant",
                    start=self.edges[i - 1 + (title == "upper")],
                )


def _port(name: str, unit: str, text: str, causality: str, **more: Any) -> Port:
    """A real variable of the model's own; it gets its place in the row later."""
    kept: dict[str, Any] = {"variability": "continuous", "reference": -1}
    return Port(
        name=name, description=text, causality=causality, kind="Real", unit=unit, **(kept | more)
    )


def _stream(name: str, text: str, causality: str, inlet: Inlet) -> Iterator[Port]:
    """Rate and composition of a stream; an input starts with what it is fed."""
    given = causality == "input"
    rate = inlet.rate if given else None
    yield _port(f"{name}.mass_flow_rate", "kg/s", text, causality, start=rate, least=0.0)
    for i, fraction in enumerate(inlet.composition, start=1):
        yield _port(
            f"{name}.mass_fraction[{i}]",
            "1",
            f"{text}: mass fraction of class {i}",
            causality,
            start=fraction if given else None,
            least=0.0,
        )


class UnitSlave(RowSlave):
    """A unit operation: its variables lie in a row, its size classes among them as constants."""

    _unit: Unit
    _machine: Running

    def __init__(self, **kwargs: Any) -> None:
        text = (Path(kwargs["resources"]) / UNIT_FILE).read_text(encoding="utf-8")
        self._model = UnitModel.from_json(text)
        table = self._model.ports()
        super().__init__(table, **kwargs)
        self._place = {port.name: port.reference for port in table}
        self._edges = np.array(self._model.edges)
        values = np.array([0.0 if port.start is None else port.start for port in table])
        self.take(values)
        for outlet in self._model.unit.targets:
            values[self._fractions(outlet)] = self._model.inlets[0].composition
        self._unit, self._machine = self._model.unit, self._model.unit.start(self._edges)

    # --- the row ------------------------------------------------------------------------------
    def value(self, name: str) -> float:
        """Value of a variable."""
        return float(self._values[self._place[name]])

    def rates(self, name: str) -> Array:
        """Rate by class of a stream that comes in, kg/s; raises InputError as a Feed does."""
        try:
            fractions = self._values[self._fractions(name)]
            return Feed(self.value(f"{name}.mass_flow_rate"), tuple(fractions.tolist())).class_rates
        except InputError as error:
            raise InputError(f"{name}{str(error).removeprefix('feed')}") from None

    def _fractions(self, name: str) -> slice:
        first = self._place[f"{name}.mass_fraction[1]"]
        return slice(first, first + self._edges.size - 1)

    # --- the unit -----------------------------------------------------------------------------
    def start(self) -> None:
        """The unit with the numbers set so far, empty."""
        self._unit = self._with_numbers()
        self._machine = self._unit.start(self._edges)

    def advance(self, duration: float) -> None:
        """A step under what comes in; nothing changes if it is refused."""
        if not 0.0 < duration < np.inf:
            raise InputError(
                f"dt = {duration!r} s is not a finite positive time: give it in seconds"
            )
        feed = np.sum([self.rates(name) for name in self._model.feeds()], axis=0)
        unit = self._with_numbers()
        if unit != self._unit:
            machine = unit.start(self._edges)
            machine.memory = self._machine.memory
            self._unit, self._machine = unit, machine
        before = self._machine.memory
        try:
            left = self._machine.step(feed, duration)
        except InputError:
            self._machine.memory = before
            raise
        for outlet, rates in left.items():
            total = float(rates.sum())
            self._put(f"{outlet}.mass_flow_rate", total)
            if total > 0.0:
                self._values[self._fractions(outlet)] = rates / total
        if unit.has_drive:
            self._put(
                "drive.power", float(np.squeeze(unit.power(self._edges, feed, left["product"])))
            )
        if isinstance(unit, Conveyor | Bin | Crusher):
            self._put("held.mass", float(self._machine.held.sum()))
        if isinstance(unit, Crusher):
            self._put("alarm.capacity", float(feed.sum() > unit.most()))

    def _with_numbers(self) -> Unit:
        """The unit with the numbers in the row; raises InputError for one out of range."""
        numbers: dict[str, Any] = {
            field: self.value(field)
            for field in numbers_of(type(self._unit))
            if field in self._place
        }
        try:
            return dataclasses.replace(self._unit, **numbers)
        except ConfigError as error:
            raise InputError(str(error).removeprefix(f"{self._unit.name}.")) from None

    def _put(self, name: str, value: float) -> None:
        self._values[self._place[name]] = value

    # --- state --------------------------------------------------------------------------------
    def memory(self) -> bytes:
        """The row, and what the unit remembers."""
        return self._values.tobytes() + self._machine.memory.tobytes()

    def recall(self, memory: bytes) -> None:
        """Take back what `memory` gave."""
        numbers = np.frombuffer(memory)
        self._values[:] = numbers[: self._values.size]
        self.start()
        self._machine.memory = numbers[self._values.size :]
