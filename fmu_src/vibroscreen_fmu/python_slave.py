"""The slave of the python runtime: copy in, advance, copy out; no physics.

pythonfmu calls the methods below from its library. Variables lie in a row in the screen's buffer,
so that setting and getting moves slices.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import dataclasses
import functools
import os
import struct
import sys
import zlib
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray
from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.fields import in_place
from vibroscreen.screen import Screen
from vibroscreen_fmu.ports import Port, ports

__all__ = ["CONFIG_FILE", "ScreenSlave", "configured", "slave_class", "take_reference"]

CONFIG_FILE = "screen.toml"  # in the resources of the FMU

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Steps = tuple[str | int, ...]
Places = slice | NDArray[np.intp]

_REAL, _INTEGER, _BOOLEAN = ("Real",), ("Integer", "Enumeration"), ("Boolean",)
# Lists of value references whose places are remembered. Masters use a few, over and over.
_MOST_REMEMBERED = 256
# A saved state: mark and version, build it belongs to, whether it runs, checksum, buffer.
_STATE_HEAD = struct.Struct("<8s16sQQ")
_STATE_MARK = b"vscreen1"


def _refusing(
    hook: Callable[Concatenate[ScreenSlave, Arguments], Result],
) -> Callable[Concatenate[ScreenSlave, Arguments], Result]:
    """A hook that logs what it raises, and an instance that outlives it."""

    @functools.wraps(hook)
    def guarded(
        self: ScreenSlave, /, *arguments: Arguments.args, **named: Arguments.kwargs
    ) -> Result:
        try:
            return hook(self, *arguments, **named)
        except Exception as error:
            raise self.refusal(error) from error

    return guarded


class ScreenSlave(Fmi2Slave):
    """A screen behind FMI 2.0; `build` names what it was built from, its state belongs to that."""

    build = ""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        resources = Path(self.resources)
        self._in_library = "logger" in kwargs
        if self._in_library:
            _finalize_at_exit(resources)
            # All is imported: the host's path need not lead here, once more for every instance.
            sys.path[:] = [place for place in sys.path if place != self.resources]
        self._config = ScreenConfig.load(resources / CONFIG_FILE)
        table = ports(self._config)
        self._ports = {port.reference: port for port in table}
        self._fixed = [p.reference for p in table if p.path and p.variability == "fixed"]
        self._running = False
        self._take(Screen(self._config))

    # --- life of the instance -----------------------------------------------------------------
    @_refusing
    def exit_initialization_mode(self) -> None:
        """Start with the parameters and inputs set so far: outputs hold from here on."""
        sections = self._screen.layout.section
        screen = self._screen_of(self._screen.buffer[sections["parameters"]])
        # Parameters and inputs lie at the same place in the buffer of every screen of this build.
        screen.buffer[sections["inputs"]] = self._screen.buffer[sections["inputs"]]
        screen.initialise()
        self._take(screen)
        self._running = True

    @_refusing
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance by the step; raises InputError, with nothing changed, if the inputs are bad."""
        del current_time
        self._screen.advance(step_size)
        return True

    # --- variables ----------------------------------------------------------------------------
    @_refusing
    def get_real(self, vrs: list[int]) -> list[float]:
        """Values of real variables."""
        values: list[float] = self._get(vrs, _REAL).tolist()
        return values

    @_refusing
    def get_integer(self, vrs: list[int]) -> list[int]:
        """Values of whole numbers and choices."""
        return [int(value) for value in self._get(vrs, _INTEGER)]

    @_refusing
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Values of alarms."""
        return [bool(value) for value in self._get(vrs, _BOOLEAN)]

    @_refusing
    def get_string(self, vrs: list[int]) -> list[str]:
        """There are no texts."""
        return [str(value) for value in self._get(vrs, ())]

    @_refusing
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set inputs and parameters."""
        self._set(vrs, _REAL, values)

    @_refusing
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set choices."""
        self._set(vrs, _INTEGER, values)

    @_refusing
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Alarms are outputs: there is nothing to set."""
        self._set(vrs, _BOOLEAN, values)

    @_refusing
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """There are no texts."""
        self._set(vrs, (), values)

    # --- state --------------------------------------------------------------------------------
    @_refusing
    def _get_fmu_state(self) -> bytes:
        body = self._screen.state
        return _STATE_HEAD.pack(_STATE_MARK, self._owner(), self._running, zlib.crc32(body)) + body

    @_refusing
    def _set_fmu_state(self, state: bytes) -> None:
        head, body = state[: _STATE_HEAD.size], state[_STATE_HEAD.size :]
        given = f"state = {len(state)} bytes"
        if len(head) < _STATE_HEAD.size or not head.startswith(_STATE_MARK):
            raise ValueError(f"{given} are no state of a VibratingScreen: give what one wrote")
        _, owner, running, checksum = _STATE_HEAD.unpack(head)
        if owner != self._owner():
            raise ValueError(f"{given} are of another build of the FMU: give a state of this one")
        if checksum != zlib.crc32(body):
            raise ValueError(f"{given}, cut or changed on the way: give them as they were written")
        screen = self._screen_of(np.frombuffer(body, count=self._built_with.size))
        screen.state = body
        self._take(screen)
        self._running = bool(running)

    # A state is bytes from the start. They are checked when they are set, where the instance is
    # known that has to outlive a refusal.
    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state

    def _owner(self) -> bytes:
        """Sixteen bytes that only states of the same build have."""
        return sha256(self.build.encode()).digest()[:16]

    # --- inside -------------------------------------------------------------------------------
    def refusal(self, error: Exception) -> RuntimeError:
        """The error to raise in the place of `error`, which is logged.

        pythonfmu's library gives back its references to the instance, its class and its log when a
        hook raises, but keeps using them: they are taken once more.
        """
        message = str(error) if isinstance(error, ValueError) else repr(error)
        # A host may take the message for a format.
        message = message.replace("%", " per cent")
        self.log(message, Fmi2Status.error)
        if self._in_library:
            for kept in (self, type(self), self.log_queue):
                take_reference(kept)
        return RuntimeError(message)

    def _take(self, screen: Screen) -> None:
        sections = screen.layout.section
        self._screen = screen
        self._built_with = screen.buffer[sections["parameters"]].copy()
        self._values = screen.buffer[sections["parameters"].start : sections["outputs"].stop]
        self._remembered: dict[tuple[Any, ...], Places] = {}

    def _screen_of(self, parameters: NDArray[np.float64]) -> Screen:
        """A screen with these parameters: the one there is, unless a fixed one differs."""
        fixed = self._fixed
        if np.array_equal(parameters[fixed], self._built_with[fixed]):
            return self._screen
        table = [port for port in self._ports.values() if port.causality == "parameter"]
        changed = {port.path for port in table if parameters[port.reference] != port.start}
        values = {port: float(parameters[port.reference]) for port in table if port.path in changed}
        return Screen(configured(self._config, values))

    def _get(self, vrs: list[int], kinds: tuple[str, ...]) -> NDArray[np.float64]:
        key = (kinds, *vrs)
        places = self._remembered.get(key)
        if places is None:
            places = self._remember(key, self._places(vrs, kinds))
        self._screen.read()
        return self._values[places]

    def _set(self, vrs: list[int], kinds: tuple[str, ...], values: Sequence[Any]) -> None:
        key = ("set", kinds, *vrs)
        places = self._remembered.get(key)
        if places is None:
            found = self._places(vrs, kinds)
            for reference in vrs:
                self._check_settable(self._ports[reference])
            places = self._remember(key, found)
        self._values[places] = values

    def _remember(self, key: tuple[Any, ...], places: Places) -> Places:
        if len(self._remembered) >= _MOST_REMEMBERED:
            self._remembered.clear()
        self._remembered[key] = places
        return places

    def _places(self, vrs: list[int], kinds: tuple[str, ...]) -> Places:
        """Where the variables lie in the row of values: a slice if they are neighbours."""
        for reference in vrs:
            port = self._ports.get(reference)
            if port is None:
                raise ValueError(f"value reference {reference} is no variable of this FMU")
            if port.kind not in kinds:
                raise ValueError(f"{port.name} is of type {port.kind}: use the functions of that")
        first = vrs[0] if vrs else 0
        if vrs == list(range(first, first + len(vrs))):
            return slice(first, first + len(vrs))
        return np.array(vrs, dtype=np.intp)

    def _check_settable(self, port: Port) -> None:
        if port.causality not in ("input", "parameter"):
            raise ValueError(f"{port.name} is not an input or a parameter: it cannot be set")
        if self._running and port.variability == "fixed":
            raise ValueError(
                f"{port.name} is a fixed parameter of a running screen: set it before "
                "initialisation ends, or reset the instance"
            )


@functools.cache
def slave_class(name: str, build: str) -> type[ScreenSlave]:
    """The class of a build's slaves; the same one for all instances in a process."""
    return type(name, (ScreenSlave,), {"build": build})


def configured(config: ScreenConfig, changed: Mapping[Port, float]) -> ScreenConfig:
    """The configuration with other values of parameters. Raises ConfigError that names one."""
    values: dict[Steps, Any] = {}
    for port, value in changed.items():
        if port.enumeration:
            names = [name for name, _ in port.enumeration.items]
            if not 1 <= value <= len(names):
                choice = ", ".join(f"{i} {name}" for i, name in enumerate(names, 1))
                raise ConfigError(f"{port.name} = {value:g} is none of the choices: give {choice}")
            values[port.path] = names[int(value) - 1]
        elif values.setdefault(port.path, value) != value:
            raise ConfigError(
                f"{port.name} = {value:.6g} m differs from the limit of the class beside it "
                f"({values[port.path]:.6g} m): set both to the same"
            )
    if ("passage", "velocity") in values:
        values["passage", "velocity_table"] = None
    return _replaced(config, values) if values else config


# What a part of a configuration is called in messages.
_TITLES = {"decks": "deck", "panels": "deck.panel"}


def _replaced(part: Any, values: Mapping[Steps, Any], title: str = "") -> Any:
    """A dataclass or tuple with other values at paths into it, checked once as a whole."""
    inside: dict[str | int, dict[Steps, Any]] = {}
    for (first, *rest), value in values.items():
        inside.setdefault(first, {})[tuple(rest)] = value

    def item(old: Any, changes: dict[Steps, Any], title: str) -> Any:
        return changes[()] if () in changes else _replaced(old, changes, title)

    if not isinstance(part, tuple):
        changes = {
            str(name): item(getattr(part, str(name)), change, _TITLES.get(str(name), ""))
            for name, change in inside.items()
        }
        return dataclasses.replace(part, **changes)
    items = list(part)
    for place, change in inside.items():
        assert isinstance(place, int)
        with in_place(title, place + 1):
            items[place] = item(items[place], change, title)
    return tuple(items)


def take_reference(kept: object) -> None:
    """Take a reference to an object in the place of one that is given back without being owned."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))


_finalized: set[Path] = set()


def _finalize_at_exit(resources: Path) -> None:
    """End pythonfmu's library before the process does.

    Left alone, the library releases its interpreter twice when the process ends, and aborts it.
    """
    for path in (resources.parent / "binaries").glob("linux64/*.so"):
        if sys.platform == "linux" and path not in _finalized:
            # A host that loaded it from elsewhere has nothing to end here.
            with contextlib.suppress(OSError):
                library = ctypes.CDLL(str(path), mode=os.RTLD_NOW | os.RTLD_NOLOAD)
                atexit.register(library.finalizePythonInterpreter)
                _finalized.add(path)
