"""Callers that do what no caller should, over the C functions of an FMU alone.

    python tests/fmu/hostile.py FMU [--sequences N] [--calls M] [--threads T] [--seed S]

A sequence makes an instance, calls functions of FMI 2.0 in an order and with values drawn at
random, legal ones and others, and frees it. What must hold: no crash; every call returns a status
of the standard; whatever happened, the instance works again after a reset; what an accepted step
gave is finite. Prints JSON: sequences, calls, refusals, bytes that a sequence leaves behind, and
what went wrong. Any FMU of a screen will do, whatever its runtime; it is unzipped to a path with a
space.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import math
import random
import shutil
import sys
import tempfile
import threading
import xml.etree.ElementTree as ET
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median

ROUNDS = 5  # after each of which memory is read
OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
Component = State = ctypes.c_void_p
Reference = ctypes.c_uint
LOGGER = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)
FUNCTIONS = {
    "fmi2Instantiate": (
        Component,
        [
            *(ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p),
            *(ctypes.c_void_p, ctypes.c_int, ctypes.c_int),
        ],
    ),
    "fmi2FreeInstance": (None, [Component]),
    "fmi2SetDebugLogging": (
        ctypes.c_int,
        [Component, ctypes.c_int, ctypes.c_size_t, ctypes.POINTER(ctypes.c_char_p)],
    ),
    "fmi2SetupExperiment": (
        ctypes.c_int,
        [Component, ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_int, ctypes.c_double],
    ),
    "fmi2EnterInitializationMode": (ctypes.c_int, [Component]),
    "fmi2ExitInitializationMode": (ctypes.c_int, [Component]),
    "fmi2Terminate": (ctypes.c_int, [Component]),
    "fmi2Reset": (ctypes.c_int, [Component]),
    "fmi2DoStep": (ctypes.c_int, [Component, ctypes.c_double, ctypes.c_double, ctypes.c_int]),
    "fmi2CancelStep": (ctypes.c_int, [Component]),
    "fmi2GetRealStatus": (
        ctypes.c_int,
        [Component, ctypes.c_int, ctypes.POINTER(ctypes.c_double)],
    ),
    "fmi2GetBooleanStatus": (
        ctypes.c_int,
        [Component, ctypes.c_int, ctypes.POINTER(ctypes.c_int)],
    ),
    "fmi2GetFMUstate": (ctypes.c_int, [Component, ctypes.POINTER(State)]),
    "fmi2SetFMUstate": (ctypes.c_int, [Component, State]),
    "fmi2FreeFMUstate": (ctypes.c_int, [Component, ctypes.POINTER(State)]),
    "fmi2SerializedFMUstateSize": (
        ctypes.c_int,
        [Component, State, ctypes.POINTER(ctypes.c_size_t)],
    ),
    "fmi2SerializeFMUstate": (ctypes.c_int, [Component, State, ctypes.c_char_p, ctypes.c_size_t]),
    "fmi2DeSerializeFMUstate": (
        ctypes.c_int,
        [Component, ctypes.c_char_p, ctypes.c_size_t, ctypes.POINTER(State)],
    ),
}
NUMBER = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}
FUNCTIONS |= {
    f"fmi2{verb}{kind}": (
        ctypes.c_int,
        [Component, ctypes.POINTER(Reference), ctypes.c_size_t, ctypes.POINTER(number)],
    )
    for verb in ("Get", "Set")
    for kind, number in NUMBER.items()
}
# Large ones, such that what is fed in a sequence is still a number.
STRANGE = (
    *(0.0, -0.0, 1.0, -1.0, 1e-300, 5e-324, 1e150, -1e150, 1e-9, 1e9, 0.5, 2.0),
    *(math.nan, math.inf, -math.inf),
)
# Numbers of the standard that a caller may ask for the status of, and others.
STATUS_KINDS = (0, 1, 2, 3, -1, 7)


class Callbacks(ctypes.Structure):
    """What the standard wants from a host."""

    _fields_ = (
        ("logger", LOGGER),
        ("allocate", ctypes.c_void_p),
        ("free", ctypes.c_void_p),
        ("finished", ctypes.c_void_p),
        ("environment", ctypes.c_void_p),
    )


class Library:
    """The C functions of an unzipped FMU, and what its description says of its variables."""

    def __init__(self, folder: Path) -> None:
        root = ET.parse(folder / "modelDescription.xml").getroot()
        self.guid = root.attrib["guid"].encode()
        name = root.find("CoSimulation").attrib["modelIdentifier"]
        self.resources = (folder / "resources").as_uri().encode()
        self.c = ctypes.CDLL(str(folder / "binaries" / "linux64" / f"{name}.so"))
        for function, (result, arguments) in FUNCTIONS.items():
            entry = getattr(self.c, function)
            entry.restype, entry.argtypes = result, arguments
        self.inputs: list[tuple[int, float]] = []
        self.outputs: list[int] = []
        self.parameters: list[tuple[int, float]] = []
        self.references: dict[str, list[int]] = {kind: [] for kind in (*NUMBER, "Enumeration")}
        for variable in root.find("ModelVariables"):
            (kind,) = (child for child in variable if child.tag in self.references)
            reference = int(variable.attrib["valueReference"])
            self.references[kind.tag].append(reference)
            if kind.tag != "Real":
                continue
            causality = variable.attrib["causality"]
            if causality == "output":
                self.outputs.append(reference)
            elif causality in ("input", "parameter"):
                settable = self.inputs if causality == "input" else self.parameters
                settable.append((reference, float(kind.attrib["start"])))
        # Loggers may be called for as long as the library is loaded.
        libc = ctypes.CDLL(None)
        self.said = Counter[str]()
        self._logger = LOGGER(self._log)
        self.callbacks = Callbacks(
            self._logger,
            ctypes.cast(libc.calloc, ctypes.c_void_p),
            ctypes.cast(libc.free, ctypes.c_void_p),
            None,
            None,
        )

    def _log(self, _: object, __: bytes, status: int, ___: bytes, message: bytes) -> None:
        self.said["messages"] += 1
        if b"%" in message:
            self.said["a message that may be taken for a format"] += 1
        if status not in range(PENDING + 1):
            self.said[f"a message of status {status}"] += 1


@dataclass
class Found:
    """What sequences of calls gave."""

    sequences: int = 0
    calls: int = 0
    refused: int = 0
    wrong: Counter[str] = field(default_factory=Counter)


class Caller:
    """One instance and one who treats it badly."""

    def __init__(self, library: Library, rng: random.Random, found: Found) -> None:
        self.library, self.rng, self.found = library, rng, found
        self.states: list[State] = []
        self.blobs: list[bytes] = []
        self.time = 0.0
        made = library.c.fmi2Instantiate(
            b"hostile",
            1,  # co-simulation
            library.guid,
            library.resources,
            ctypes.byref(library.callbacks),
            0,
            rng.random() < 0.5,
        )
        assert made, "no instance"
        self.component = Component(made)

    def call(self, name: str, *arguments: object) -> int:
        """Status of a call; anything but one of the standard is a fault."""
        status: int = getattr(self.library.c, name)(self.component, *arguments)
        self.found.calls += 1
        if status not in range(PENDING + 1):
            self.found.wrong[f"{name} returned {status}"] += 1
        self.found.refused += status in (DISCARD, ERROR, FATAL)
        return status

    # --- what a caller does -------------------------------------------------------------------
    def start(self) -> None:
        """As it should be, mostly; sometimes a part of it."""
        for step in (self.setup, self.enter, self.leave):
            if self.rng.random() < 0.9:
                step()

    def setup(self) -> None:
        self.call("fmi2SetupExperiment", 0, 0.0, 0.0, 0, 0.0)

    def enter(self) -> None:
        self.call("fmi2EnterInitializationMode")

    def leave(self) -> None:
        self.call("fmi2ExitInitializationMode")

    def step(self) -> None:
        """A step of any length."""
        duration = self.rng.choice((1.0, 10.0, 0.01, 1e4, 10.0 ** self.rng.uniform(-6, 6)))
        self._step(self.time, duration)

    def strange_step(self) -> None:
        """A step of no length, or of one that is none, from a time that is not now."""
        self._step(self.rng.choice((self.time, *STRANGE)), self.rng.choice(STRANGE))

    def _step(self, time: float, duration: float) -> None:
        if self.call("fmi2DoStep", time, duration, 1) != OK:
            return
        self.time += duration
        values = self.read("Real", self.library.outputs)
        if values is None or not all(map(math.isfinite, values)):
            self.found.wrong[f"an output that is not finite after a step of {duration} s"] += 1

    def good_inputs(self) -> None:
        """Inputs near their start values; fractions keep their sum."""
        factor = self.rng.uniform(0.8, 1.2)
        rate, *rest = self.library.inputs
        values = [(rate[0], rate[1] * factor), *rest]
        self.write("Real", [r for r, _ in values], [v for _, v in values])

    def strange_values(self) -> None:
        """Some inputs and parameters to anything."""
        chosen = self.rng.sample(self.library.inputs + self.library.parameters, 2)
        self.write("Real", [r for r, _ in chosen], [self.rng.choice(STRANGE) for _ in chosen])

    def good_parameters(self) -> None:
        """Some parameters to nearly what they are."""
        chosen = self.rng.sample(self.library.parameters, 2)
        factor = self.rng.uniform(0.99, 1.01)
        self.write("Real", [r for r, _ in chosen], [v * factor for _, v in chosen])

    def strange_references(self) -> None:
        """Get or set what is not there, or is of another type, or is an output."""
        everything = [r for many in self.library.references.values() for r in many]
        count = self.rng.choice((0, 1, 3, 40, 300))
        known = self.rng.random() < 0.5
        chosen = [
            self.rng.choice(everything) if known else self.rng.getrandbits(self.rng.choice((8, 32)))
            for _ in range(count)
        ]
        kind = self.rng.choice(tuple(NUMBER))
        if self.rng.random() < 0.7:
            self.read(kind, chosen)
        elif kind == "Real":
            self.write(kind, chosen, [self.rng.choice(STRANGE) for _ in chosen])
        else:
            self.write(kind, chosen, [self.rng.randint(-3, 3) for _ in chosen])

    def choices(self) -> None:
        """Models by number, also by numbers that are none."""
        chosen = self.library.references["Enumeration"]
        self.write("Integer", chosen, [self.rng.randint(0, 5) for _ in chosen])

    def read_all(self) -> None:
        for kind in NUMBER:
            self.read(kind, self.library.references[kind])

    def take_state(self) -> None:
        state = State()
        if self.call("fmi2GetFMUstate", ctypes.byref(state)) == OK:
            self.states.append(state)

    def give_state(self) -> None:
        if self.states:
            self.call("fmi2SetFMUstate", self.rng.choice(self.states))

    def drop_state(self) -> None:
        if self.states:
            self.call("fmi2FreeFMUstate", ctypes.byref(self.states.pop()))

    def write_state(self) -> None:
        """A state as bytes."""
        if not self.states:
            return
        size, state = ctypes.c_size_t(), self.states[-1]
        if self.call("fmi2SerializedFMUstateSize", state, ctypes.byref(size)) == OK:
            blob = ctypes.create_string_buffer(size.value)
            if self.call("fmi2SerializeFMUstate", state, blob, size.value) == OK:
                self.blobs.append(blob.raw)

    def read_state(self) -> None:
        """Bytes as a state: such as were written, cut, changed, or made up."""
        blob = self.rng.choice(self.blobs) if self.blobs else self.rng.randbytes(100)
        how = self.rng.choice(("as it was", "cut", "changed", "longer", "empty", "made up"))
        if how == "cut":
            blob = blob[: self.rng.randrange(len(blob))]
        elif how == "changed":
            place = self.rng.randrange(len(blob))
            blob = blob[:place] + bytes([blob[place] ^ 1]) + blob[place + 1 :]
        elif how == "longer":
            blob += self.rng.randbytes(9)
        elif how == "empty":
            blob = b""
        elif how == "made up":
            blob = self.rng.randbytes(self.rng.choice((1, 40, 5000)))
        state = State()
        if self.call("fmi2DeSerializeFMUstate", blob, len(blob), ctypes.byref(state)) == OK:
            self.call("fmi2SetFMUstate", state)
            self.call("fmi2FreeFMUstate", ctypes.byref(state))

    def logging(self) -> None:
        names = (ctypes.c_char_p * 2)(b"logStatusError", b"no such category")
        self.call("fmi2SetDebugLogging", self.rng.randint(0, 1), self.rng.randint(0, 2), names)

    def ask(self) -> None:
        """What only asynchronous slaves know."""
        kind = self.rng.choice(STATUS_KINDS)
        self.call("fmi2GetRealStatus", kind, ctypes.byref(ctypes.c_double()))
        self.call("fmi2GetBooleanStatus", kind, ctypes.byref(ctypes.c_int()))
        self.call("fmi2CancelStep")

    def step_and_set(self) -> None:
        """Steps in one thread, inputs set and outputs read in another."""

        def meddle() -> None:
            for _ in range(5):
                self.good_inputs()
                self.read("Real", self.library.outputs)

        meddler = threading.Thread(target=meddle)
        meddler.start()
        for _ in range(5):
            self.call("fmi2DoStep", self.time, 10.0, 1)
        meddler.join()

    def terminate(self) -> None:
        self.call("fmi2Terminate")

    def reset(self) -> None:
        self.call("fmi2Reset")
        self.time = 0.0

    # --- reading and writing ------------------------------------------------------------------
    def read(self, kind: str, references: list[int]) -> list[float] | None:
        count = len(references)
        values = (NUMBER[kind] * count)()
        given = (Reference * count)(*references)
        status = self.call(f"fmi2Get{kind}", given, count, values)
        return list(values) if status == OK else None

    def write(self, kind: str, references: list[int], values: list[float]) -> None:
        count = len(references)
        given = (Reference * count)(*references)
        self.call(f"fmi2Set{kind}", given, count, (NUMBER[kind] * count)(*values))

    def end(self) -> None:
        """Whatever was: after a reset it works, and then it goes."""
        self.reset()
        statuses = [
            self.call("fmi2SetupExperiment", 0, 0.0, 0.0, 0, 0.0),
            self.call("fmi2EnterInitializationMode"),
            self.call("fmi2ExitInitializationMode"),
            self.call("fmi2DoStep", 0.0, 10.0, 1),
        ]
        if statuses != [OK] * 4:
            self.found.wrong[f"statuses {statuses} after a reset"] += 1
        while self.states:
            self.drop_state()
        self.library.c.fmi2FreeInstance(self.component)


ACTIONS: tuple[tuple[Callable[[Caller], None], int], ...] = (
    (Caller.start, 4),
    (Caller.step, 6),
    (Caller.good_inputs, 3),
    (Caller.strange_step, 2),
    (Caller.strange_values, 2),
    (Caller.good_parameters, 1),
    (Caller.strange_references, 3),
    (Caller.choices, 1),
    (Caller.read_all, 1),
    (Caller.take_state, 3),
    (Caller.give_state, 2),
    (Caller.drop_state, 1),
    (Caller.write_state, 2),
    (Caller.read_state, 2),
    (Caller.setup, 1),
    (Caller.enter, 1),
    (Caller.leave, 1),
    (Caller.logging, 1),
    (Caller.ask, 1),
    (Caller.step_and_set, 1),
    (Caller.terminate, 1),
    (Caller.reset, 1),
)


def run(library: Library, rng: random.Random, sequences: int, calls: int) -> Found:
    """Sequences of about so many calls, one after the other."""
    found = Found()
    actions, weights = zip(*ACTIONS, strict=True)
    for _ in range(sequences):
        caller = Caller(library, rng, found)
        if rng.random() < 0.7:
            caller.start()
        for action in rng.choices(actions, weights, k=rng.randrange(2 * calls)):
            action(caller)
        caller.end()
        found.sequences += 1
    return found


def resident() -> int:
    """Memory of this process, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


@contextmanager
def unzipped(fmu: Path) -> Iterator[Path]:
    """The FMU in a folder of its own, whose name has spaces."""
    place = Path(tempfile.mkdtemp(prefix="a path with spaces "))
    try:
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(place)
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def main(fmu: Path, sequences: int, calls: int, threads: int, seed: int) -> dict[str, object]:
    """Run `threads` callers at once, each its share of the sequences, in `ROUNDS` rounds.

    What is kept once comes with some round: what most rounds add is lost.
    """
    share = max(1, sequences // (ROUNDS * threads))
    results: list[Found] = []
    with unzipped(fmu) as place:
        library = Library(place)

        def work(number: int, this: int) -> None:
            results.append(run(library, random.Random(f"{seed} {number} {this}"), share, calls))

        memory = []
        for this in range(ROUNDS):
            workers = [threading.Thread(target=work, args=(k, this)) for k in range(threads)]
            for worker in workers:
                worker.start()
            for worker in workers:
                worker.join()
            gc.collect()
            memory.append(resident())
    assert len(results) == ROUNDS * threads, "a thread has ended early"
    messages = library.said.pop("messages", 0)
    return {
        "sequences": sum(found.sequences for found in results),
        "calls": sum(found.calls for found in results),
        "refused": sum(found.refused for found in results),
        "messages": messages,
        "left_bytes": median(b - a for a, b in pairwise(memory)) / (share * threads),
        "wrong": dict(sum((found.wrong for found in results), library.said)),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fmu", type=Path)
    parser.add_argument("--sequences", type=int, default=10_000)
    parser.add_argument("--calls", type=int, default=12, help="in a sequence, about")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    print(json.dumps(main(**vars(chosen))))
    sys.stdout.flush()
