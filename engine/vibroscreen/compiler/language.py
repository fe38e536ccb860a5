"""What kernels are written in: plain Python functions, marked, over views of flat arrays.

    kernel(function)             a function that other kernels call
    record(buffer, place, kind)  numbers that lie side by side in a buffer, read and written by name
    numbers(row)                 the same as a row of numbers
    own_model(family, *kinds)    what calls a sub-model of one's own by its address

An entry is a kernel that Python and C call too (library.py); what takes four numbers at once is in
fours.py. Kernels are plain Python until they are compiled (whole.py): nothing here needs numba.
What stands below is the plain meaning of what the compiler makes by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

# Kinds of a signature: rows of doubles, whole numbers, numbers.
KINDS = ("vector", "matrix", "int64", "float64")
RETURNED = ("void", "int64", "float64")

KERNELS: list[Callable[..., Any]] = []
ENTRIES: dict[str, Entry] = {}
# What calls sub-models of one's own, by family, and what they take: of KINDS, or a record.
OWN_MODELS: dict[str, tuple[Callable[..., Any], tuple[str | Record, ...]]] = {}
# Such sub-models by their address, where kernels run as plain Python.
PLAIN_MODELS: dict[int, Callable[..., None]] = {}


def kernel(function: Callable[..., Any]) -> Any:
    """Mark a function as one that the compiler takes with the entries that call it."""
    KERNELS.append(function)
    return function


class Entry:
    """A kernel that Python calls: the first call looks for the engine that it runs in.

    function: the kernel as plain Python; signature: such as "int64(vector, float64)", of KINDS and
    RETURNED; engine: gives the engine.
    """

    def __init__(
        self, function: Callable[..., Any], signature: str, engine: Callable[[], Any]
    ) -> None:
        returned, _, arguments = signature.rstrip(")").partition("(")
        self.function = function
        self.name = function.__name__
        self.__doc__ = function.__doc__
        self.returned = returned
        self.arguments = tuple(kind.strip() for kind in arguments.split(","))
        assert returned in RETURNED, f"{self.name} returns {returned}"
        assert set(self.arguments) <= set(KINDS), f"{self.name} takes {arguments}"
        self._engine = engine
        self.call: Callable[..., Any] = self._find
        ENTRIES[self.name] = self

    def _find(self, *arguments: Any) -> Any:
        self.call = self._engine().caller(self)
        return self.call(*arguments)

    def __call__(self, *arguments: Any) -> Any:
        return self.call(*arguments)

    def on(self, buffer: Any) -> Callable[..., Any]:
        """The kernel for one buffer that lives on where it is: a swifter call."""
        made: Callable[..., Any] = self._engine().caller_on(self, buffer)
        return made


def own_model(family: str, *kinds: str | Record) -> Callable[..., Any]:
    """What kernels call with the address of a sub-model and what it takes (KINDS, records)."""

    def call(address, *arguments):
        PLAIN_MODELS[int(address)](*arguments)

    call.__qualname__ = f"own_model({family}: {kinds})"
    OWN_MODELS[family] = call, kinds
    return call


# --- records -------------------------------------------------------------------------------------
class Record(tuple[str, ...]):
    """Names of numbers that lie side by side in a buffer, apart by spaces.

    Those in `whole` are whole numbers.
    """

    whole: frozenset[str]
    place: dict[str, int]

    def __new__(cls, *names: str, whole: str = "") -> Record:
        made = super().__new__(cls, " ".join(names).split())
        made.whole = frozenset(whole.split())
        made.place = {name: k for k, name in enumerate(made)}
        assert made.whole <= made.place.keys(), f"{sorted(made.whole)} are not all in {names}"
        return made

    def __getnewargs_ex__(self) -> tuple[tuple[str, ...], dict[str, Any]]:
        return tuple(self), {"whole": " ".join(sorted(self.whole))}

    def __repr__(self) -> str:
        return f"Record({', '.join(self)}; whole: {', '.join(sorted(self.whole))})"

    @property
    def dtype(self) -> np.dtype:
        """What numpy calls it: a structure of doubles."""
        return np.dtype([(name, float) for name in self])


class Places(tuple[str, ...]):
    """Names, apart by spaces, that stand for whole numbers from `first` on."""

    first: int

    def __new__(cls, first: int, *names: str) -> Places:
        made = super().__new__(cls, " ".join(names).split())
        made.first = first
        return made

    def __getnewargs__(self) -> tuple[int | str, ...]:
        return self.first, *self

    def __getattr__(self, name: str) -> int:
        if name not in self:
            raise AttributeError(name)
        return self.first + self.index(name)

    def __repr__(self) -> str:
        return f"Places({self.first}: {', '.join(self)})"


class Row:
    """The numbers of a record at a place of a buffer, as plain Python reads and writes them."""

    __slots__ = ("_buffer", "_kind", "_place")

    def __init__(self, buffer: Any, place: int, kind: Record) -> None:
        for name, value in (("_buffer", buffer), ("_place", place), ("_kind", kind)):
            object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        value = self._buffer[self._at(name)]
        return int(value) if name in self._kind.whole else value

    def __setattr__(self, name: str, value: Any) -> None:
        self._buffer[self._at(name)] = value

    def _at(self, name: str) -> int:
        place = self._kind.place.get(name)
        if place is None:
            raise AttributeError(f"{name} is none of {', '.join(self._kind)}", name=name)
        return self._place + place


# --- what the compiler makes by itself, in plain Python ------------------------------------------
def record(buffer, place, kind):
    """The numbers of a record that begin at a place of the flat buffer; no copy."""
    return Row(buffer, int(place), kind)


def numbers(row):
    """The numbers of a record as a row; no copy."""
    return row._buffer[row._place : row._place + len(row._kind)]


def view1(buffer, offset, size):
    """View of `size` numbers of the flat buffer from `offset` on; no copy, no allocation."""
    return buffer[offset : offset + size]


def view2(buffer, offset, rows, columns):
    """Matrix view of the flat buffer."""
    return buffer[offset : offset + rows * columns].reshape(rows, columns)


def bits_of(number):
    """The bits of a number as a whole number."""
    return int(np.float64(number).view(np.int64))


def number_of(bits):
    """The number that has these bits."""
    return float(np.int64(bits).view(np.float64))
