"""An FMI slave whose variables lie in a row of numbers: setting and getting move slices.

pythonfmu calls the methods below from its library; what a model does is left to its own class.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import os
import sys
import threading
from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from vibroscreen.errors import told
from vibroscreen_fmu.port import Port
from vibroscreen_fmu.saved_state import packed, unpacked

__all__ = ["RowSlave", "refusing", "slave_class", "take_reference"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Kind = TypeVar("Kind", bound="RowSlave")
Places = slice | NDArray[np.intp]

_REAL, _INTEGER, _BOOLEAN = ("Real",), ("Integer", "Enumeration"), ("Boolean",)
# cofmupy reads every output as a real number.
_READ_AS_REAL = (*_REAL, *_INTEGER, *_BOOLEAN)
# Lists of value references whose places are remembered. Masters use a few, over and over.
_MOST_REMEMBERED = 256


@functools.lru_cache(maxsize=256)
def _same_text(text: str) -> str:
    """A text as the object that it was before; pythonfmu's library keeps those that it logs."""
    return text


class _Last(NamedTuple):
    """The list of value references that was used last, and where its variables lie."""

    references: Sequence[int]
    kinds: tuple[str, ...]
    places: Places


def refusing(
    hook: Callable[Concatenate[Kind, Arguments], Result],
) -> Callable[Concatenate[Kind, Arguments], Result]:
    """A hook that logs what it raises, and an instance that outlives it.

    Kernels run while others of the process do: a caller that sets what is being stepped waits.
    """

    @functools.wraps(hook)
    def guarded(self: Kind, /, *arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        try:
            with self.one_at_a_time:
                return hook(self, *arguments, **named)
        except Exception as error:
            raise self.refusal(error) from error

    return guarded


class RowSlave(Fmi2Slave):
    """A model behind FMI 2.0; `build` names what it was built from, its state belongs to that.

    A model says which variables it has (`ports`), where they lie (`take`), and what it does when
    initialisation ends (`start`), in a step (`advance`), before variables are read (`read`), and
    when its state is taken and given back (`memory`, `recall`).
    """

    build = ""
    _last_got: _Last
    _last_set: _Last

    def __init__(self, ports: Iterable[Port], **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.one_at_a_time = threading.Lock()
        self._ports = {port.reference: port for port in ports}
        self._remembered: dict[tuple[Any, ...], Places] = {}
        self._forget()
        self._in_library = "logger" in kwargs
        self._running = self._ended = False
        self._time = 0.0
        if self._in_library:
            _finalize_at_exit(Path(self.resources))
            # All is imported: the host's path need not lead here, once more for every instance.
            sys.path[:] = [place for place in sys.path if place != self.resources]

    # --- what a model is ----------------------------------------------------------------------
    def take(self, values: NDArray[np.float64]) -> None:
        """The row of values of all variables from now on, by value reference."""
        self._values = values

    @abstractmethod
    def start(self) -> None:
        """Initialisation ends: from here on outputs hold for the parameters and inputs set."""

    @abstractmethod
    def advance(self, duration: float) -> None:
        """Advance by `duration` s with the inputs in the row; changes nothing if it raises."""

    def read(self) -> None:
        """Bring outputs up to date that are found only when they are read."""

    @abstractmethod
    def memory(self) -> bytes:
        """All that the model remembers, variables included."""

    @abstractmethod
    def recall(self, memory: bytes) -> None:
        """Go back to what `memory` gave; changes nothing if it raises."""

    # --- life of the instance -----------------------------------------------------------------
    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """The time that it begins at, s."""
        del stop_time, tolerance
        self._time = start_time

    @refusing
    def exit_initialization_mode(self) -> None:
        """Start with the parameters and inputs set so far."""
        if self._running:
            raise ValueError(told("started"))
        self.start()
        self._running = True
        self._forget()

    @refusing
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance by the step; False (fmi2Discard), logged, with nothing changed, if it cannot.

        Not raised: pythonfmu's library logs an exception once more, as fatal and without a
        category, which ends some hosts. What is raised here is a defect of the model.
        """
        try:
            if not self._running or self._ended:
                raise ValueError(told("no_step"))
            self.advance(step_size)
            self._time = current_time + step_size
        except ValueError as error:
            self.note(str(error))
            return False
        return True

    @refusing
    def terminate(self) -> None:
        """The run ends: values can be read, steps are refused until a reset."""
        self._ended = True

    # --- variables ----------------------------------------------------------------------------
    @refusing
    def get_real(self, vrs: list[int]) -> list[float]:
        """Values of real variables; of others their number, 1 for true."""
        values: list[float] = self._get(vrs, _READ_AS_REAL).tolist()
        return values

    @refusing
    def get_integer(self, vrs: list[int]) -> list[int]:
        """Values of whole numbers and choices."""
        return [int(value) for value in self._get(vrs, _INTEGER)]

    @refusing
    def get_boolean(self, vrs: list[int]) -> list[bool]:
        """Values of alarms."""
        return [bool(value) for value in self._get(vrs, _BOOLEAN)]

    @refusing
    def get_string(self, vrs: list[int]) -> list[str]:
        """There are no texts."""
        return [str(value) for value in self._get(vrs, ())]

    @refusing
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set inputs and parameters."""
        self._set(vrs, _REAL, values)

    @refusing
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        """Set choices."""
        self._set(vrs, _INTEGER, values)

    @refusing
    def set_boolean(self, vrs: list[int], values: list[bool]) -> None:
        """Alarms are outputs: there is nothing to set."""
        self._set(vrs, _BOOLEAN, values)

    @refusing
    def set_string(self, vrs: list[int], values: list[str]) -> None:
        """There are no texts."""
        self._set(vrs, (), values)

    # --- state --------------------------------------------------------------------------------
    @refusing
    def _get_fmu_state(self) -> bytes:
        return packed(self.build, self._running, self._time, self.memory())

    @refusing
    def _set_fmu_state(self, state: bytes) -> None:
        running, time, body = unpacked(self.build, type(self).__name__, state)
        self.recall(body)
        self._running, self._ended, self._time = running, False, time
        self._forget()

    # A state is bytes from the start. They are checked when they are set, where the instance is
    # known that has to outlive a refusal.
    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return state

    def note(self, text: str, status: Fmi2Status = Fmi2Status.error) -> str:
        """Log a text for the host, in the category of its status; returns it as it is logged."""
        # A host may take the message for a format.
        message = _same_text(text.replace("%", " per cent"))
        self.log(message, status, category=_same_text(f"logStatus{status.name.capitalize()}"))
        return message

    # --- inside -------------------------------------------------------------------------------
    def refusal(self, error: Exception) -> RuntimeError:
        """The error to raise in the place of `error`, which is logged.

        pythonfmu's library gives back its references to the instance, its class and its log when a
        hook raises, but keeps using them: they are taken once more.
        """
        message = self.note(str(error) if isinstance(error, ValueError) else repr(error))
        if self._in_library:
            for kept in (self, type(self), self.log_queue):
                take_reference(kept)
        return RuntimeError(message)

    def _get(self, vrs: list[int], kinds: tuple[str, ...]) -> NDArray[np.float64]:
        last = self._last_got
        if vrs != last.references or kinds is not last.kinds:
            last = self._last_got = self._found(vrs, kinds, to_set=False)
        self.read()
        return self._values[last.places]

    def _set(self, vrs: list[int], kinds: tuple[str, ...], values: Sequence[Any]) -> None:
        last = self._last_set
        if vrs != last.references or kinds is not last.kinds:
            last = self._last_set = self._found(vrs, kinds, to_set=True)
        self._values[last.places] = values

    def _found(self, vrs: list[int], kinds: tuple[str, ...], *, to_set: bool) -> _Last:
        """Where variables lie that may be read, or set; looked up once for every list."""
        key = (to_set, kinds, *vrs)
        places = self._remembered.get(key)
        if places is None:
            places = self._places(vrs, kinds)
            for reference in vrs if to_set else ():
                self._check_settable(self._ports[reference])
            if len(self._remembered) >= _MOST_REMEMBERED:
                self._remembered.clear()
            self._remembered[key] = places
        return _Last(vrs, kinds, places)

    def _forget(self) -> None:
        """What may be set is another now."""
        self._remembered.clear()
        self._last_got = self._last_set = _Last((), (), slice(0))

    def _places(self, vrs: list[int], kinds: tuple[str, ...]) -> Places:
        """Where the variables lie in the row of values: a slice if they are neighbours."""
        for reference in vrs:
            port = self._ports.get(reference)
            if port is None:
                raise ValueError(told("no_variable", value=reference))
            if port.kind not in kinds:
                raise ValueError(told("other_type", name=port.name, kind=port.kind))
        first = vrs[0] if vrs else 0
        if vrs == list(range(first, first + len(vrs))):
            return slice(first, first + len(vrs))
        return np.array(vrs, dtype=np.intp)

    def _check_settable(self, port: Port) -> None:
        if port.causality not in ("input", "parameter"):
            raise ValueError(told("not_settable", name=port.name))
        if self._running and port.variability == "fixed":
            raise ValueError(told("fixed", name=port.name))


class _Found(ABCMeta):
    """What pythonfmu's library sees of a class when it looks for the slave in the script.

    It asks every class for all that it derives from, for every instance, and never gives back a
    copy of that: here the least that it needs.
    """

    @property
    def __mro__(cls) -> tuple[type, ...]:
        return (cls, Fmi2Slave)


@functools.cache
def slave_class(kind: type[RowSlave], name: str, build: str) -> type[RowSlave]:
    """The class of a build's slaves; the same one for all instances in a process."""
    made: Any = _Found(name, (kind,), {"build": build})
    return cast("type[RowSlave]", made)


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
