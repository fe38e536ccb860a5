"""Calls for tests/fmu/replay.c, drawn at random; what a library and the python runtime answer.

A call is a letter and its arguments; `record` writes calls, `answer` is what the slave of the
python runtime gives for them, byte by byte as replay.c writes it.
"""

from __future__ import annotations

import os
import random
import shutil
import struct
import subprocess
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from vibroscreen.compiler import machine
from vibroscreen.config import ScreenConfig
from vibroscreen.kernels import library
from vibroscreen_fmu.package import build_of, engine, screen_model
from vibroscreen_fmu.port import Port
from vibroscreen_fmu.python_slave import CONFIG_FILE, ScreenSlave
from vibroscreen_fmu.row_slave import slave_class

HEADERS = Path(fmpy.__file__).parent / "c-code"
HOST = str(library.host())
REPLAY = Path(__file__).with_name("replay.c")
OK, WARNING, ERROR = b"\x00", b"\x01", b"\x03"
NUMBERS = {"R": "d", "I": "i", "r": "", "b": ""}
REFUSED = 5
STRANGE = (np.nan, np.inf, -np.inf, -1.0, 1e9, -1e-12, 2.5)

Call = tuple[Any, ...]


def walk(table: Sequence[Port], steps: int, seed: int, *, hostile: bool = False) -> Iterator[Call]:
    """A run of `steps` steps with feed, vibration and tunable parameters drawn at random.

    Every value stays in its limits but for some that are refused; steps are short and long; states
    are saved, set and carried to another instance. hostile: nothing of that is rare.
    """
    rng = random.Random(seed)
    inputs = [port for port in table if port.causality == "input"]
    scalars = [port for port in inputs if "fraction" not in port.name]
    fractions = [port for port in inputs if "fraction" in port.name]
    tunable = [port for port in table if port.variability == "tunable"]
    fixed = [p for p in table if p.variability == "fixed" and p.kind == "Real"]
    outputs = [port.reference for port in table if port.causality == "output"]
    reals = [p.reference for p in table if p.reference in outputs and p.kind == "Real"]
    alarms = [p.reference for p in table if p.kind == "Boolean"]
    often = 8 if hostile else 1

    def near(port: Port) -> float:
        low = port.least if port.least is not None else -np.inf
        high = port.most if port.most is not None else np.inf
        start = port.start or 0.0
        return float(min(high, max(low, start * rng.uniform(0.8, 1.2))))

    def start() -> Iterator[Call]:
        if rng.random() < (0.5 if hostile else 0.2):
            port = rng.choice(fixed)
            yield "R", [port.reference], [near(port)]
        if hostile and rng.random() < 0.3:
            yield "t", rng.choice((1e-3, 2e-4, *STRANGE))
        yield ("X",)

    yield from start()
    for what in range(REFUSED if hostile else 0):
        yield from refused(rng, what, inputs, fixed, outputs)
    for step in range(steps):
        if rng.random() < 0.3:
            port = rng.choice(scalars)
            yield "R", [port.reference], [near(port)]
        if rng.random() < 0.1:
            share = np.array([rng.random() for _ in fractions])
            yield "R", [p.reference for p in fractions], (share / share.sum()).tolist()
        if rng.random() < 0.03:
            port = rng.choice(tunable)
            yield "R", [port.reference], [near(port)]
        if rng.random() < 0.02:
            yield "R", [scalars[0].reference, scalars[1].reference], [0.0, near(scalars[1])]
        if rng.random() < 0.01 * often:
            yield from refused(rng, rng.randrange(REFUSED), inputs, fixed, outputs)
        yield "D", rng.choice((1.0, 1.0, 1.0, 0.1, 5.0, 10.0 ** rng.uniform(-3.0, 2.5)))
        if rng.random() < 0.7:
            yield "r", reals
        if rng.random() < 0.2:
            yield "b", alarms
        if step % 50 == 0:
            yield ("S",)
        if rng.random() < 0.01 * often:
            yield (rng.choice("KkkN"),)
        if rng.random() < 0.002 * often:
            yield ("Z",)
            yield from start()
        if hostile and rng.random() < 0.1:
            yield "C", rng.getrandbits(31)
            yield "B", rng.randbytes(rng.choice((0, 7, 40, 500)))
    yield ("S",)
    yield ("T",)
    yield "D", 1.0
    yield "r", reals


def refused(
    rng: random.Random,
    what: int,
    inputs: Sequence[Port],
    fixed: Sequence[Port],
    outputs: Sequence[int],
) -> Iterator[Call]:
    """Something that is refused, one of REFUSED kinds, and what makes it good again."""
    port = rng.choice(inputs)
    if what == 0:
        yield "R", [port.reference], [rng.choice(STRANGE)]
        yield "D", 1.0
        yield "R", [port.reference], [port.start]
        if "fraction" in port.name:
            yield "R", [p.reference for p in inputs], [p.start for p in inputs]
    elif what == 1:
        yield "D", rng.choice((0.0, -1.0, np.nan, np.inf))
    elif what == 2:
        yield "R", [port.reference, rng.choice(fixed).reference], [0.0, 1.0]
    elif what == 3:
        yield "R", [rng.choice(outputs)], [1.0]
        yield "I", [port.reference], [1]
    else:
        yield "r", [port.reference, rng.getrandbits(rng.choice((8, 31)))]
        yield ("X",)


def record(calls: Sequence[Call], guid: str) -> bytes:
    """The calls as replay.c reads them."""
    parts = [guid.encode()]
    for call, *rest in calls:
        parts.append(call.encode())
        if call in NUMBERS:
            references = rest[0]
            count = len(references)
            parts.append(struct.pack(f"<I{count}I", count, *references))
            if NUMBERS[call]:
                parts.append(struct.pack(f"<{count}{NUMBERS[call]}", *rest[1]))
        elif call in ("D", "t"):
            parts.append(struct.pack("<d", rest[0]))
        elif call in ("C", "m"):
            parts.append(struct.pack("<I", rest[0]))
        elif call == "M":
            times, to_set, given, to_get, noise = rest
            values = struct.pack(f"<I{len(to_set)}I", len(to_set), *to_set)
            values += struct.pack(f"<{len(given)}d", *given)
            values += struct.pack(f"<I{len(to_get)}I", len(to_get), *to_get) + struct.pack(
                "<d", noise
            )
            parts.append(struct.pack("<I", times) + values)
        elif call == "B":
            parts.append(struct.pack("<I", len(rest[0])) + rest[0])
    return b"".join(parts)


def compiled(source: Path, made: Path, *flags: str, target: str | None = None) -> Path:
    """A program from C, for this machine or for a platform of the linker."""
    found = machine.find_linker()
    assert found, "nothing here compiles C"
    command, crossing = found
    if target:
        # Optimised and stripped as the engine is: what ziglang compiles for a platform is there.
        flags = ("-target", machine.PLATFORMS[target].zig, "-s", "-fno-sanitize=all", *flags)
    elif crossing and shutil.which("cc"):
        command = ("cc",)
    warnings = ("-std=gnu99", "-Wall", "-Wextra", "-Werror")
    libraries = () if target == "win64" else ("-ldl", "-lm")
    call = [*command, *warnings, "-O2", "-I", HEADERS, source, *flags, "-o", made, *libraries]
    subprocess.run(list(map(str, call)), check=True)
    return made


def replayed(
    program: Sequence[str | Path],
    library: Path,
    calls: Sequence[Call],
    guid: str,
    folder: Path,
    resources: str = "",
    **environment: str,
) -> bytes:
    """What the library of an unzipped FMU answers, with what it reads and nothing else.

    resources: the location of what it reads, which does not lie beside it then.
    """
    place, fmu = folder / "alone", library.parents[2]
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(library.parent, place / library.parent.relative_to(fmu))
    if not resources:
        shutil.copytree(fmu / "resources", place / "resources")
    (place / "calls").write_bytes(record(calls, guid))
    # What it says goes to a file: a pipe would be held open by the server that wine leaves behind.
    with (place / "said").open("w") as said:
        done = subprocess.run(
            [*map(str, program), f"./{library.relative_to(fmu)}", "calls", "out", resources],
            cwd=place,
            env={**os.environ, **environment},
            stdout=said,
            stderr=said,
            check=False,
        )
    assert done.returncode == 0, (place / "said").read_text()
    return (place / "out").read_bytes()


def unzipped_library(fmu: Path, folder: Path) -> Path:
    """The library for this machine of an FMU that is unzipped into a folder."""
    fmpy.extract(str(fmu), unzipdir=str(folder))
    (found,) = (folder / "binaries" / HOST).glob("VibratingScreen.*")
    return found


class Python:
    """The python runtime as replay.c would see it: the answer to calls."""

    def __init__(self, config: ScreenConfig, folder: Path) -> None:
        model = screen_model(config)
        module, kind = model.slave
        assert kind == "ScreenSlave"
        self.kind = slave_class(ScreenSlave, model.name, build_of(model, engine(module)))
        folder.joinpath(CONFIG_FILE).write_bytes(model.resources[CONFIG_FILE])
        self.folder, self.ports = folder, model.ports
        self.out: list[bytes] = []

    def make(self) -> ScreenSlave:
        return self.kind(instance_name="screen", resources=str(self.folder))

    def answer(self, calls: Sequence[Call]) -> bytes:
        """What replay.c writes for the calls."""
        self.out = []
        slave, kept = self.make(), b""
        for call, *rest in calls:
            if call == "R":
                self._try(slave.set_real, *rest)
            elif call == "I":
                self._try(slave.set_integer, *rest)
            elif call in ("r", "b"):
                get, code = (slave.get_real, "d") if call == "r" else (slave.get_boolean, "i")
                values = self._try(get, *rest) or [0] * len(rest[0])
                self.out.append(struct.pack(f"<{len(values)}{code}", *values))
            elif call == "D":
                self._step(slave, *rest)
            elif call == "t":
                self._set_up(slave, *rest)
            elif call == "X":
                slave.setup_experiment(0.0)
                self._try(slave.exit_initialization_mode)
            elif call == "T":
                self._try(slave.terminate)
            elif call == "Z":
                slave = self.make()
                self.out.append(OK)
            elif call == "S":
                state = slave._get_fmu_state()
                self.out.append(struct.pack("<QI", len(state), zlib.crc32(state)))
            elif call == "K":
                kept = slave._get_fmu_state()
                self.out.append(OK)
            elif call == "k":
                if kept:
                    self._try(slave._set_fmu_state, kept)
                else:
                    self.out.append(OK)
            elif call == "N":
                state, kept = slave._get_fmu_state(), b""
                slave = self.make()
                self._try(slave._set_fmu_state, state)
            elif call == "B":
                self._try(slave._set_fmu_state, *rest)
            elif call == "C":
                state = slave._get_fmu_state()
                place = rest[0] % len(state)
                changed = bytes([state[place] ^ 1])
                self._try(slave._set_fmu_state, state[:place] + changed + state[place + 1 :])
                self._try(slave._set_fmu_state, state[:place])
        return b"".join(self.out)

    def _step(self, slave: ScreenSlave, duration: float) -> None:
        """A refused step is logged, not raised: fmi2Discard here, fmi2Error of a library."""
        before = len(slave.log_queue)
        if slave.do_step(0.0, duration):
            self.out.append(warned(slave, before) + OK)
        else:
            self.out.append(f"logStatusError {slave.log_queue[-1].msg}\n".encode() + ERROR)

    def _set_up(self, slave: ScreenSlave, tolerance: float) -> None:
        """A tolerance that is none is told as a warning; that the slave cannot return."""
        self._try(slave.setup_experiment, 0.0, None, tolerance)
        said = self.out[-1].removesuffix(OK)
        if self.out[-1].endswith(OK) and said:
            self.out[-1] = said + WARNING

    def _try(self, hook: Any, *arguments: Any) -> Any:
        before = len(hook.__self__.log_queue)
        try:
            result = hook(*arguments)
        except RuntimeError as error:
            self.out.append(f"logStatusError {error}\n".encode() + ERROR)
            return None
        self.out.append(warned(hook.__self__, before) + OK)
        return result


def warned(slave: ScreenSlave, before: int) -> bytes:
    """What a slave warned of since its log was so long: alarms that came on."""
    return b"".join(f"logStatusWarning {line.msg}\n".encode() for line in slave.log_queue[before:])
