"""A circuit that runs through time: every unit steps in the order of the streams."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vibroscreen.circuit.flowsheet import Flowsheet
from vibroscreen.circuit.screening import RunningScreen
from vibroscreen.circuit.unit import Array
from vibroscreen.errors import InputError
from vibroscreen.stream import Feed

__all__ = ["RunningCircuit"]


class RunningCircuit:
    """A flowsheet that starts empty and takes steps.

    Where its loops are cut, what comes back arrives one step later; it is on its way until then,
    and counts as held. So a steady state is that of `solve_circuit`, whatever the step.
    """

    def __init__(self, flowsheet: Flowsheet) -> None:
        self.flowsheet = flowsheet
        self.units = {u.name: u.start(flowsheet.edges) for u in flowsheet.units}
        self.power: dict[str, float] = {}  # of every unit with a drive, over the last step, W
        self.fed = self.left = 0.0  # kg since the start
        self._coming = {name: np.zeros(flowsheet.size_classes.count) for name in flowsheet.cut}

    @property
    def held(self) -> float:
        """Mass inside the circuit [kg]: in the units, and on its way back."""
        units = sum(float(unit.held.sum()) for unit in self.units.values())
        return units + sum(float(mass.sum()) for mass in self._coming.values())

    @property
    def balance_error(self) -> float:
        """Fed less left and held since the start [kg]."""
        return self.fed - self.left - self.held

    def screen(self, name: str) -> RunningScreen:
        """The screen of that name; its `motion` may be set, `result` is that of the last step."""
        unit = self.units.get(name)
        if not isinstance(unit, RunningScreen):
            raise InputError(f"{name} is no screen of this circuit: give the name of one", name)
        return unit

    def step(
        self, dt: float, feeds: Mapping[str, Feed] | None = None
    ) -> dict[tuple[str, str], Array]:
        """Mean rates by class [kg/s] of every unit and outlet over a step of dt [s].

        feeds: fresh feeds by name that are not as the flowsheet says. Raises InputError.
        """
        if not 0.0 < dt < np.inf:
            raise InputError(f"dt = {dt!r} s is not a finite positive time: give it in seconds")
        sheet, given = self.flowsheet, dict(feeds or {})
        inflow = {name: np.zeros(sheet.size_classes.count) for name in sheet.unit}
        for name, mass in self._coming.items():
            inflow[name] += mass / dt
        products = 0.0
        fed = 0.0
        for feed in sheet.feeds:
            now = given.pop(feed.name, feed)
            now.check_classes(sheet.size_classes.count)
            fed += now.mass_flow_rate
            if feed.to in inflow:
                inflow[feed.to] += now.class_rates
            else:
                products += now.mass_flow_rate
        for name in given:
            raise InputError(f"{name} is no feed of this circuit: give the name of one", name)
        coming = {name: np.zeros_like(mass) for name, mass in self._coming.items()}
        streams: dict[tuple[str, str], Array] = {}
        for name in sheet.order:
            unit = sheet.unit[name]
            left = self.units[name].step(inflow[name], dt)
            for outlet, target in unit.targets.items():
                streams[name, outlet] = left[outlet]
                if target in coming:
                    coming[target] += left[outlet] * dt
                elif target in inflow:
                    inflow[target] += left[outlet]
                else:
                    products += float(left[outlet].sum())
            if unit.has_drive:
                power = unit.power(sheet.edges, inflow[name], left["product"])
                self.power[name] = float(np.squeeze(power))
            elif isinstance(running := self.units[name], RunningScreen) and running.result:
                self.power[name] = running.result.drive_power
        self._coming = coming
        self.fed += fed * dt
        self.left += products * dt
        return streams
