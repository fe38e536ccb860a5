"""The slave of the python runtime: copy in, advance, copy out; no physics."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pythonfmu.enums import Fmi2Status

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import given, told
from vibroscreen.figures import ALARMS
from vibroscreen.kernels.entry import CHECK, run
from vibroscreen.kernels.state import ACCEPTED, FIRST_ALARM
from vibroscreen.screen import Screen, fill, refusal, slice_layout
from vibroscreen_fmu.port import TOLERANCE, Port, Steps
from vibroscreen_fmu.ports import ports
from vibroscreen_fmu.row_slave import RowSlave, refusing

__all__ = ["CONFIG_FILE", "ScreenSlave", "configured"]

CONFIG_FILE = "screen.toml"  # in the resources of the FMU
ALARM_PLACE = {alarm.name: place for place, alarm in enumerate(ALARMS)}


class ScreenSlave(RowSlave):
    """A screen behind FMI 2.0: its variables lie in a row in the screen's buffer."""

    def __init__(self, **kwargs: Any) -> None:
        self._config, self._table = _read(kwargs["resources"])
        super().__init__(self._table, **kwargs)
        self._fixed = [p.reference for p in self._table if p.path and p.variability == "fixed"]
        self._take_screen(Screen(self._config))

    @refusing
    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """The host's tolerance becomes `solver.tolerance`; what is set later counts.

        One outside of its limits is told of with a warning, and the parameter stays.
        """
        super().setup_experiment(start_time, stop_time, tolerance)
        if tolerance is None:
            return
        port = next(port for port in self._table if port.path == TOLERANCE)
        self._check_settable(port)
        assert port.least is not None
        assert port.most is not None
        if port.least <= tolerance <= port.most:
            self._values[port.reference] = tolerance
            return
        stays = self._values[port.reference]
        about = {"given": given("tolerance", tolerance), "other": port.name, "number": stays}
        limits = {"limit": port.least, "other_limit": port.most}
        self.note(told("no_tolerance", **about, **limits), Fmi2Status.warning)

    def start(self) -> None:
        """A screen with the parameters and inputs set so far: its decks are empty or full."""
        self._screen.check()
        sections = self._screen.layout.section
        screen = self._screen_of(self._screen.buffer[sections["parameters"]])
        # Parameters and inputs lie at the same place in the buffer of every screen of this build.
        screen.buffer[sections["inputs"]] = self._screen.buffer[sections["inputs"]]
        screen.initialise()
        self._take_screen(screen)
        self._known[:] = 0.0
        self._tell_alarms()

    def advance(self, duration: float) -> None:
        """Advance the screen."""
        self._screen.advance(duration)
        if self._alarms.tobytes() != self._known.tobytes():
            self._tell_alarms()

    def read(self) -> None:
        """Find the sizes of cuts and products."""
        if self._screen.read():
            self._tell_alarms()

    def _tell_alarms(self) -> None:
        """Tell why alarms came on that were not known of."""
        if (self._alarms > self._known).any():
            for name, reason in self._screen.alarm_reasons().items():
                if not self._known[ALARM_PLACE[name]]:
                    self.note(f"{name}: {reason}", Fmi2Status.warning)
        self._known[:] = self._alarms

    def memory(self) -> bytes:
        """The buffer of the screen."""
        return self._screen.state

    def recall(self, memory: bytes) -> None:
        """Take the buffer back; it brings its fixed parameters."""
        screen = self._screen_of(np.frombuffer(memory, count=self._built_with.size))
        screen.state = memory
        self._take_screen(screen)

    def _take_screen(self, screen: Screen) -> None:
        sections = screen.layout.section
        self._screen = screen
        self._built_with = screen.buffer[sections["parameters"]].copy()
        row = slice(sections["parameters"].start, sections["outputs"].stop)
        self.take(screen.buffer[row])
        self._alarms = screen.view("output")[FIRST_ALARM:]
        self._known = self._alarms.copy()

    def _screen_of(self, parameters: NDArray[np.float64]) -> Screen:
        """A screen with these parameters: the one there is, unless a fixed one differs."""
        fixed = self._fixed
        if np.array_equal(parameters[fixed], self._built_with[fixed]):
            return self._screen
        self._check_fixed(parameters)
        # Tunable ones have no part in how a screen is laid out: a state that was tuned since fits.
        table = [port for port in self._table if port.causality == "parameter" and port.path]
        changed = [port for port in table if parameters[port.reference] != port.start]
        paths = {port.path for port in changed if port.variability == "fixed"}
        values = {port: float(parameters[port.reference]) for port in table if port.path in paths}
        screen = Screen(configured(self._config, values))
        row = screen.buffer[screen.layout.section["parameters"]]
        for port in changed:
            row[port.reference] = parameters[port.reference]
        return screen

    def _check_fixed(self, parameters: NDArray[np.float64]) -> None:
        """Check the fixed parameters of a screen that is to be."""
        layout = slice_layout(self._config)
        buffer = layout.buffer()
        fill(layout, buffer, self._config)
        buffer[layout.section["parameters"]][self._fixed] = parameters[self._fixed]
        if run(buffer, CHECK, 0.0, 0.0) != ACCEPTED:
            raise refusal(layout, buffer)


@functools.lru_cache(maxsize=4)
def _read(resources: str) -> tuple[ScreenConfig, tuple[Port, ...]]:
    """What an FMU was built for, read once for all of its instances."""
    config = ScreenConfig.load(Path(resources) / CONFIG_FILE).explicit()
    return config, ports(config)


def configured(config: ScreenConfig, changed: Mapping[Port, float]) -> ScreenConfig:
    """The configuration with other values of parameters, which were checked."""
    values: dict[Steps, Any] = {}
    for port, value in changed.items():
        choices = port.enumeration
        values[port.path] = choices.items[int(value) - 1][0] if choices else value
    if ("passage", "velocity") in values:
        values["passage", "velocity_table"] = None
    return _replaced(config, values) if values else config


def _replaced(part: Any, values: Mapping[Steps, Any]) -> Any:
    """A dataclass or tuple with other values at paths into it, checked once as a whole."""
    inside: dict[str | int, dict[Steps, Any]] = {}
    for (first, *rest), value in values.items():
        inside.setdefault(first, {})[tuple(rest)] = value

    def item(old: Any, changes: dict[Steps, Any]) -> Any:
        return changes[()] if () in changes else _replaced(old, changes)

    if not isinstance(part, tuple):
        changed = {str(k): item(getattr(part, str(k)), change) for k, change in inside.items()}
        return dataclasses.replace(part, **changed)
    items = list(part)
    for place, change in inside.items():
        assert isinstance(place, int)
        items[place] = item(items[place], change)
    return tuple(items)
